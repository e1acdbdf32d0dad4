"""Compiled reflection and refraction of light at the faces of a slab.

A flat face is a plane across z. A rough face consists of facets with random slopes, in
which light may be reflected several times before it leaves. Theory:
docs/theory/photon-transport.md, "Plane layers with faces". Compiled, as each photon
meets a face at least twice.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from amulor.transport._kernels.polarization import (
    any_frame,
    between_frames,
    cross,
    turned_stokes,
)
from amulor.transport._kernels.sampling import uniform
from amulor.transport._kernels.types import (
    Array,
    States,
    Stokes,
    Vector,
    inner,
    kernel,
)


class Interface(NamedTuple):
    """Face of a slab."""

    ratio: float
    """Refractive index inside over that outside [1]."""
    slope: float
    """Root mean square slope of the facets along one axis; 0 for a flat face [1]."""
    outward: float
    """Direction out of the slab along z, 1 or -1."""


@kernel
def fresnel(cosine: float, index: float) -> Stokes:
    """Return elements m11, m12, m33 and m34 of the reflection of light by a plane.

    The cosine is that of the angle of incidence, the index that of the medium of the
    light over the one behind the plane. Field ratios r_par and r_perp give
    m33 - i m34 = r_par conj(r_perp), for fields that vary as exp(-i omega t).
    """
    sine_behind = (1.0 - cosine * cosine) * index * index
    if sine_behind >= 1.0:
        # Total reflection, with the cosine i kappa behind the plane: both field ratios
        # are (real - imaginary) / (real + imaginary part).
        kappa = math.sqrt(sine_behind - 1.0)
        turn = 2.0 * (
            math.atan2(kappa, index * cosine) - math.atan2(index * kappa, cosine)
        )
        return 1.0, 0.0, math.cos(turn), -math.sin(turn)
    behind = math.sqrt(1.0 - sine_behind)
    across = (index * cosine - behind) / (index * cosine + behind)
    along = (cosine - index * behind) / (cosine + index * behind)
    squares = across * across, along * along
    return (
        0.5 * (squares[1] + squares[0]),
        0.5 * (squares[1] - squares[0]),
        along * across,
        0.0,
    )


@kernel
def passed(element: Stokes) -> Stokes:
    """Return elements m11, m12, m33 and m34 of the light that a plane lets pass."""
    along = max(1.0 - element[0] - element[1], 0.0)
    across = max(1.0 - element[0] + element[1], 0.0)
    return 1.0 - element[0], -element[1], math.sqrt(along * across), 0.0


@kernel
def normal_number(state: States) -> float:
    """Draw a random number with a normal distribution of variance 1."""
    distance = math.sqrt(-2.0 * math.log(1.0 - uniform(state)))
    return distance * math.cos(2.0 * math.pi * uniform(state))


@kernel
def seen_slope(state: States, least: float) -> float:
    """Draw a number s above `least` with a density of (s - least) exp(-s^2 / 2)."""
    if least >= 0.0:
        while True:
            slope = math.sqrt(
                least * least - 2.0 * math.log(1.0 - uniform(state)) + 1e-300
            )
            if uniform(state) * slope < slope - least:
                return slope
    # A sum of a normal density times -least and, above 0, of s exp(-s^2 / 2).
    total = 1.0 / math.sqrt(2.0 * math.pi) - least
    while True:
        if uniform(state) * total >= -least:
            return math.sqrt(-2.0 * math.log(1.0 - uniform(state)))
        slope = normal_number(state)
        if slope >= 0.0 or -uniform(state) * least < slope - least:
            return slope


@kernel
def lambda_of(cotangent: float) -> float:
    """Return Smith's Lambda for a direction, by its cotangent over the rms slope.

    Directions towards the surface have a negative cotangent and Lambda below -1.
    """
    a = cotangent / math.sqrt(2.0)
    if a > 6.0:
        return 0.0
    if abs(a) < 1e-12:
        a = 1e-12
    return 0.5 * (math.erf(a) - 1.0) + math.exp(-a * a) / (2.0 * a * math.sqrt(math.pi))


@kernel
def next_level(
    state: States, n: Vector, away: float, slope: float, level: float
) -> float:
    """Draw the level at which light meets a rough face again; -1 if it leaves.

    A level is the fraction of the surface that is nearer to the slab, or to the outside
    for light inside. `away` is the direction along z away from the face.
    """
    up = away * n[2]
    sine = math.sqrt(max(1.0 - up * up, 1e-300))
    shadow = lambda_of(up / sine / slope)
    drawn = 1.0 - uniform(state)
    if shadow == 0.0 or (shadow > 0.0 and drawn <= level**shadow):
        return -1.0
    met: float = level * drawn ** (-1.0 / shadow)
    return min(met, 1.0)


@kernel
def seen_facet(state: States, n: Vector, away: float, slope: float) -> Vector:
    """Draw the normal of a facet that light along n meets, on the side of the light."""
    across = math.sqrt(n[0] * n[0] + n[1] * n[1])
    side = normal_number(state) * slope
    if across < 1e-12:
        x, y = normal_number(state) * slope, side
    else:
        ahead = slope * seen_slope(state, away * n[2] / across / slope)
        x = (ahead * n[0] - side * n[1]) / across
        y = (ahead * n[1] + side * n[0]) / across
    norm = 1.0 / math.sqrt(1.0 + x * x + y * y)
    return -x * norm, -y * norm, away * norm


@kernel
def in_plane(n: Vector, normal: Vector, now: Array) -> Vector:
    """Turn the light in `now` into the plane of n and a normal; return n x its axis."""
    x, y, z = cross(normal, n)
    norm = math.sqrt(x * x + y * y + z * z)
    if norm < 1e-12:
        x, y, z = cross(n, any_frame(n))
        norm = 1.0
    across = (x / norm, y / norm, z / norm)
    turn = between_frames(n, (now[0], now[1], now[2]), cross(across, n))
    now[4], now[5] = turned_stokes(now[4], now[5], turn)
    return across


@kernel
def apply_element(element: Stokes, now: Array) -> None:
    """Multiply the Stokes vector in `now` by a matrix, without change of its light."""
    i, q, u, v = now[3], now[4], now[5], now[6]
    scale = i / (element[0] * i + element[1] * q)
    now[4] = scale * (element[1] * i + element[0] * q)
    now[5] = scale * (element[2] * u + element[3] * v)
    now[6] = scale * (element[2] * v - element[3] * u)


@inner
def cross_interface(
    state: States,
    n: Vector,
    now: Array,
    polarized: bool,
    inside: bool,
    interface: Interface,
) -> tuple[bool, Vector]:
    """Follow light at a face until it leaves; return whether inside, and direction.

    Reflection or refraction is drawn by their fractions of the light.
    """
    level = 1.0
    while True:
        away = -interface.outward if inside else interface.outward
        if interface.slope > 0.0:
            level = next_level(state, n, away, interface.slope, level)
            if level < 0.0:
                return inside, n
            normal = seen_facet(state, n, away, interface.slope)
        elif away * n[2] > 0.0:
            return inside, n
        else:
            normal = (0.0, 0.0, away)
        index = interface.ratio if inside else 1.0 / interface.ratio
        cosine = -(n[0] * normal[0] + n[1] * normal[1] + n[2] * normal[2])
        cosine = min(max(cosine, 0.0), 1.0)
        element = fresnel(cosine, index)
        across = (0.0, 0.0, 0.0)
        fraction = element[0]
        if polarized:
            across = in_plane(n, normal, now)
            fraction += element[1] * now[4] / now[3]
        if uniform(state) < fraction:
            factor, along = 1.0, 2.0 * cosine
        else:
            element = passed(element)
            behind = math.sqrt(max(1.0 - (1.0 - cosine * cosine) * index * index, 0.0))
            factor, along = index, index * cosine - behind
            inside, level = not inside, max(1.0 - level, 1e-12)
        x = factor * n[0] + along * normal[0]
        y = factor * n[1] + along * normal[1]
        z = factor * n[2] + along * normal[2]
        norm = 1.0 / math.sqrt(x * x + y * y + z * z)
        n = (x * norm, y * norm, z * norm)
        if polarized:
            apply_element(element, now)
            now[0], now[1], now[2] = cross(across, n)
