"""Water response of a sharp receiver in small-angle form by plain quadrature.

Nothing is shared with the package but the formula, eqs. (26) and (29) of Ricci et al.
2010, as rebuilt and conjugated, with uniform discs for aperture and acceptance. The
mean of the transform of the phase function is an integral over angles of the mean of
J0. The integral over the wavenumber is cut off far out and summed with a Gauss rule in
short equal steps; only the light that a thin beam keeps unscattered is taken out, as
the area that two circles share. The depth is cut at each edge of the view, into steps
that shrink towards it.
"""

import math
from itertools import pairwise

import numpy as np
from scipy.constants import speed_of_light
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq
from scipy.special import itj0y0, j0, j1

LAST = 100.0  # argument of the narrower disc at which the wavenumber is cut off
MOST_TURNS = 4e3  # or phase at which it is [rad]
FOLLOWED = 400.0  # argument up to which the mean of J0 oscillates


def gauss(edges, count):
    """Return nodes and weights of a Gauss rule in each panel, as flat arrays."""
    node, weight = np.polynomial.legendre.leggauss(count)
    half = np.diff(edges)[:, None] / 2
    return (edges[:-1, None] + half * (node + 1)).ravel(), (half * weight).ravel()


ARGUMENTS = np.arange(0.005, FOLLOWED + 0.01, 0.005)
MEAN_J0 = CubicSpline(
    np.append(0.0, ARGUMENTS), np.append(1.0, itj0y0(ARGUMENTS)[0] / ARGUMENTS)
)


def mean_j0(argument):
    """Return the mean of J0 from 0 to an argument, its ripple left out far away."""
    near = argument < FOLLOWED
    mean = 1 / np.where(near, 1.0, argument)
    mean[near] = MEAN_J0(argument[near])
    return mean


def mean_transform(phase_function, split_angle, *, kinks=()):
    """Return the forward fraction, and a function for P(x) / x of the forward part."""
    even = np.arange(0, 60, 0.05) / split_angle
    arguments = np.concatenate(
        [even, 60 / split_angle * np.exp(np.arange(0, 22, 0.04))]
    )
    edges = np.geomspace(1e-16, split_angle, 90)
    edges[-1] = split_angle
    edges = np.union1d(edges, [kink for kink in kinks if kink < split_angle])
    fine = np.linspace(0, FOLLOWED, 1 + int(FOLLOWED / 5))[1:]
    theta, weight = gauss(edges, 8)
    fraction = weight @ (2 * np.pi * np.sin(theta) * phase_function(theta))
    values = np.ones(arguments.size)
    for i, x in enumerate(arguments[1:], start=1):
        within = fine[fine < x * split_angle] / x
        theta, weight = gauss(np.union1d(edges, within), 8)
        density = 2 * np.pi * np.sin(theta) * phase_function(theta)
        values[i] = weight @ (density * mean_j0(x * theta)) / fraction
    return fraction, CubicSpline(arguments, values)


def lens(distance, first, second):
    """Return the area that two circles share."""
    if distance >= first + second:
        return 0.0
    if distance <= abs(first - second):
        return math.pi * min(first, second) ** 2
    x = (distance**2 + first**2 - second**2) / (2 * distance)
    y = math.sqrt(first**2 - x**2)
    area = first**2 * math.acos(x / first) - x * y
    rest = distance - x
    return area + second**2 * math.acos(rest / second) - rest * y


def offset(z, column):
    """Return the distance between beam and receiver axis."""
    path = z + column.get("standoff", 0.0)
    along = column["baseline"] - column.get("tilt", 0.0) * path
    return math.hypot(along, column.get("cross_tilt", 0.0) * path)


def unscattered(z, column):
    """Return F(z) of light of a thin beam that was not scattered."""
    path = z + column.get("standoff", 0.0)
    area = lens(
        offset(z, column), column["receiver_radius"], column["acceptance_angle"] * path
    )
    loss = 2 * (column["absorption"] + column["scattering"])
    return area / path**2 * math.exp(-loss * z)


def collected(z, column, fraction, mean, split_angle, *, turns=MOST_TURNS, last=LAST):
    """Return F(z), less the unscattered light where the beam is thin."""
    path = z + column.get("standoff", 0.0)
    radius, seen = column["receiver_radius"], column["acceptance_angle"] * path
    distance = offset(z, column)
    beam = column.get("beam_radius", 0.0) ** 2
    beam += (column.get("beam_divergence", 0.0) * path) ** 2
    turn = distance + radius + seen
    highest = min(last / min(radius, seen), turns / turn)
    if beam > 0:
        highest = min(highest, 11.5 / math.sqrt(beam))
    reach = z * split_angle
    steps = [
        np.arange(0, highest, 5 / turn),
        np.arange(0, min(highest, 100 / reach), 5 / reach),
        np.geomspace(0.1 / reach, highest, 30),
    ]
    if beam > 0:
        steps.append(np.linspace(0, highest, 20))
    edges = np.unique(np.concatenate(steps))
    kappa, weight = gauss(edges[edges <= highest], 8)
    exponent = 2 * column["scattering"] * fraction * z
    value = np.exp(exponent * (mean(kappa * z) - 1) - beam * kappa**2 / 4)
    if beam == 0:
        value -= math.exp(-exponent)
    discs = 4 * j1(kappa * radius) * j1(kappa * seen) / (kappa**2 * radius * seen)
    total = weight @ (kappa * j0(kappa * distance) * discs * value)
    loss = 2 * (column["absorption"] + column["scattering"] * (1 - fraction))
    flux = math.pi**2 * (radius * column["acceptance_angle"]) ** 2
    return flux / (2 * math.pi) * total * math.exp(-loss * z)


def edges_of_view(column, stop):
    """Return the depths at which the beam crosses the edge of what is seen."""
    grid = np.geomspace(1e-5, stop, 2000)
    radius, angle = column["receiver_radius"], column["acceptance_angle"]

    def margin(z, side):
        seen = angle * (z + column.get("standoff", 0.0))
        return offset(z, column) ** 2 - (radius + side * seen) ** 2

    found = [radius / angle - column.get("standoff", 0.0)]
    for side in (1, -1):
        signs = np.sign([margin(z, side) for z in grid])
        for i in np.flatnonzero(np.diff(signs)):
            found.append(brentq(margin, grid[i], grid[i + 1], args=(side,)))
    return [z for z in found if 0 < z < stop]


def water_response(
    frequencies, fraction, mean, split_angle, *, group_index, end=math.inf, **column
):
    """Return the response for one column and backscatter_vsf 1."""
    reduced = column["absorption"] + column["scattering"] * (1 - fraction)
    stop = min(end, 10 / reduced)
    cuts = edges_of_view(column, stop)
    rate = 4 * np.pi * np.asarray(frequencies) * group_index / speed_of_light
    near = 2e-3
    plain = [np.geomspace(near, stop, 4 + int(2 * math.log2(stop / near))), [0.0, stop]]
    plain += [np.arange(0, stop, 0.9), cuts]
    shrinking = 2.0 ** -np.arange(14)
    for cut in cuts:
        plain.append(cut + 0.3 * cut * shrinking[:2])
        plain.append(cut - 0.3 * cut * shrinking[:2])
    edges = np.unique(np.concatenate(plain))
    edges = edges[(edges >= 0) & (edges <= stop)]
    total = np.zeros(rate.size, dtype=complex)
    for low, high in pairwise(edges):
        z, weight = gauss(np.array([low, high]), 8)
        value = [collected(depth, column, fraction, mean, split_angle) for depth in z]
        total += np.exp(1j * np.multiply.outer(rate, z)) @ (weight * value)
    if column.get("beam_radius", 0.0) > 0:
        return total
    for cut in cuts:
        plain.append(cut * (1 + 0.3 * shrinking))
        plain.append(cut * (1 - 0.3 * shrinking))
    edges = np.unique(np.concatenate(plain))
    z, weight = gauss(edges[(edges >= 0) & (edges <= stop)], 12)
    value = np.array([unscattered(depth, column) for depth in z])
    return total + np.exp(1j * np.multiply.outer(rate, z)) @ (weight * value)
