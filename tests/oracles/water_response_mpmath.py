"""Water response by Gauss quadrature in 30 digits, to check the fast one.

Run as a script, it writes tests/reference/water_response_mpmath.csv:

    python tests/oracles/water_response_mpmath.py

Each integral is taken twice, with 24 and with 34 nodes a panel, and refused unless
the two agree to 1e-20 of the value at zero frequency. Nothing is shared with the
package but the formula, eq. (46) of Ricci et al. 2010, as rebuilt and conjugated.
"""

from __future__ import annotations

import math
import random
import sys
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import mpmath

TABLE = Path(__file__).parents[1] / "reference" / "water_response_mpmath.csv"
HEADER = (
    "# Source: tests/oracles/water_response_mpmath.py, Gauss quadrature in 30 digits"
    " of eq. (46) of Ricci et al. 2010, as rebuilt, for backscatter_vsf = 1"
)
SPEED_OF_LIGHT = 299792458


class Column(NamedTuple):
    """A water column between start and end, seen by an instrument (SI units)."""

    absorption: float
    forward_scattering: float
    diffuse_scattering: float
    second_moment: float
    group_index: float
    baseline: float
    receiver_radius: float
    acceptance_angle: float
    tilt: float = 0.0
    cross_tilt: float = 0.0
    standoff: float = 0.0
    start: float = 0.0
    end: float = math.inf


def _terms(column, z, number):
    """Return S(z) and the exponent of F(z) in the arithmetic of number."""
    gamma = number(column.acceptance_angle)
    path = z + number(column.standoff)
    spread = number(column.forward_scattering) * number(column.second_moment) * 2 / 3
    area = number(column.receiver_radius) ** 2 + (gamma * path) ** 2 + spread * z**3
    along = number(column.baseline) - number(column.tilt) * path
    across = number(column.cross_tilt) * path
    loss = 2 * (number(column.absorption) + number(column.diffuse_scattering)) * z
    return area, -loss - (along**2 + across**2) / area


def _panels(column, wavenumber):
    """Return panels that hold all but 1e-27 of the integral at zero frequency."""

    def level(z):
        area, exponent = _terms(column, z, float)
        return exponent - math.log(area)

    loss = column.absorption + column.diffuse_scattering
    spread = column.forward_scattering * column.second_moment * 2 / 3
    tilt = math.hypot(column.tilt, column.cross_tilt)
    depth, edges, levels = column.start, [column.start], [level(column.start)]
    highest = levels[0]
    while depth < column.end:
        area, _ = _terms(column, depth, float)
        scale = math.sqrt(area) / column.acceptance_angle
        if spread > 0:
            scale = min(scale, (area / spread) ** (1 / 3))
        # What follows is less than that, since S grows and the offset only takes.
        rest = math.log(scale / area) - 2 * loss * depth
        if rest < highest - 75:
            break
        step = min(0.6 * scale, 2 / loss, column.end - depth)
        if tilt > 0:
            step = min(step, 2 * math.sqrt(area) / tilt)
        while abs(level(depth + step) - levels[-1]) > 6 and step > 1e-9 * depth:
            step /= 2
        depth += step
        edges.append(depth)
        levels.append(level(depth))
        highest = max(highest, levels[-1])
    panels = []
    for i in range(len(edges) - 1):
        a, b = edges[i], edges[i + 1]
        if max(levels[i], levels[i + 1]) > highest - 70:
            parts = 1 + int(wavenumber * (b - a) / 20)
            cuts = [a + (b - a) * j / parts for j in range(parts)] + [b]
            panels += pairwise(cuts)
    return panels


def _gauss(order):
    """Return the nodes and weights of Gauss-Legendre quadrature in 30 digits."""
    nodes, weights = [], []
    for i in range(order):
        x = mpmath.cos(mpmath.pi * (i + 0.75) / (order + 0.5))
        for _ in range(8):
            before, value = mpmath.mpf(1), x
            for n in range(1, order):
                before, value = value, ((2 * n + 1) * x * value - n * before) / (n + 1)
            slope = order * (before - x * value) / (1 - x * x)
            x -= value / slope
        nodes.append(x)
        weights.append(2 / ((1 - x * x) * slope * slope))
    return nodes, weights


def integrals(column, frequencies):
    """Return the responses of a column for backscatter_vsf 1, the first at 0 Hz."""
    with mpmath.workdps(30):
        frequencies = [0.0, *frequencies]
        scale = 4 * mpmath.pi * mpmath.mpf(column.group_index) / SPEED_OF_LIGHT
        wavenumbers = [scale * mpmath.mpf(f) for f in frequencies]
        panels = _panels(column, float(max(wavenumbers)))
        aperture = mpmath.mpf(column.receiver_radius) * column.acceptance_angle
        both = []
        for order in (24, 34):
            nodes, weights = _gauss(order)
            totals = [mpmath.mpc(0)] * len(frequencies)
            for a, b in panels:
                half = (mpmath.mpf(b) - mpmath.mpf(a)) / 2
                for x, weight in zip(nodes, weights, strict=True):
                    z = mpmath.mpf(a) + half * (1 + x)
                    area, exponent = _terms(column, z, mpmath.mpf)
                    value = half * weight * mpmath.exp(exponent) / area
                    for i, k in enumerate(wavenumbers):
                        totals[i] += value * mpmath.expj(k * z) if k else value
            both.append([mpmath.pi * aperture**2 * total for total in totals])
        first, second = both
        for a, b in zip(first, second, strict=True):
            if abs(a - b) > mpmath.mpf("1e-20") * abs(second[0]):
                raise ArithmeticError(f"not settled: {column}, {frequencies}")
        return second


def corners():
    """Return columns with a narrow, distant, deep or many-sided integrand."""
    clear = {
        "absorption": 0.02,
        "forward_scattering": 0.0,
        "diffuse_scattering": 0.0,
        "second_moment": 0.0,
        "group_index": 1.34,
        "baseline": 0.5,
        "receiver_radius": 1e-3,
        "acceptance_angle": 1e-3,
    }
    milky = {
        "absorption": 0.3,
        "forward_scattering": 5.0,
        "diffuse_scattering": 0.5,
        "second_moment": 0.3,
        "group_index": 1.38,
        "baseline": 0.2,
        "receiver_radius": 0.02,
        "acceptance_angle": 0.08,
    }
    return [
        Column(**clear),  # peak at 230 m
        Column(**clear | {"baseline": 0.0}),  # nearly eq. (49)
        Column(**clear, tilt=0.1),  # a few centimetres wide, at 5 m
        Column(**clear, tilt=0.3, cross_tilt=1e-3),
        Column(**clear, tilt=0.1, end=5.0),  # cut in its peak
        Column(**clear, tilt=0.1, start=5.0),
        Column(**clear, tilt=0.05, end=9.9),  # cut before its peak
        Column(**clear, tilt=0.1, start=5.3),  # cut behind its peak
        Column(**clear | {"acceptance_angle": 0.2, "receiver_radius": 0.05}),
        Column(**clear | {"forward_scattering": 1e-3, "second_moment": 1e-3}),
        Column(
            **clear | {"forward_scattering": 1e-3, "second_moment": 1e-3}, tilt=-0.3
        ),
        Column(**clear | {"forward_scattering": 0.05, "second_moment": 0.05}, tilt=0.2),
        Column(**clear | {"absorption": 5.0}),  # 1e-200 of the light
        Column(**clear | {"absorption": 5.0}, standoff=1.0, end=0.5),
        Column(**clear | {"absorption": 5.0, "acceptance_angle": 0.2}),
        Column(**clear | {"baseline": 0.01}, tilt=0.3, standoff=0.02),
        Column(**clear | {"baseline": 0.01}, tilt=0.02, cross_tilt=0.02),
        Column(**milky),
        Column(**milky, end=0.5),
        Column(**milky, tilt=0.4, standoff=0.3),
        Column(**milky | {"receiver_radius": 1e-3, "acceptance_angle": 0.2}),
        Column(**milky | {"receiver_radius": 0.05, "acceptance_angle": 1e-3}),
        Column(**milky | {"receiver_radius": 1e-3, "acceptance_angle": 1e-3}),
        Column(**milky, start=10.0),
    ]


def drawn(count, seed):
    """Return columns drawn over the whole range that the package must serve."""
    rng = random.Random(seed)

    def spread(low, high):
        return math.exp(rng.uniform(math.log(low), math.log(high)))

    columns = []
    while len(columns) < count:
        loss, share = spread(0.02, 5.0), rng.choice((0.0, 0.3, 1.0))
        baseline = rng.choice((0.0, *(rng.uniform(0.0, 0.5) for _ in range(6))))
        aimed = baseline / rng.uniform(0.5, 8.0)
        columns.append(
            Column(
                absorption=share * loss,
                forward_scattering=rng.choice((0.0, *[rng.uniform(0.0, 5.0)] * 3)),
                diffuse_scattering=(1 - share) * loss,
                second_moment=rng.uniform(0.0, 0.3),
                group_index=rng.uniform(1.33, 1.39),
                baseline=baseline,
                receiver_radius=spread(1e-3, 0.05),
                acceptance_angle=spread(1e-3, 0.2),
                tilt=rng.choice((0.0, aimed, rng.uniform(-0.1, 0.3))),
                cross_tilt=rng.choice((0.0, 0.0, rng.uniform(-0.05, 0.05))),
                standoff=rng.choice((0.0, rng.uniform(0.0, 1.0))),
                start=rng.choice((0.0, 0.0, 0.0, rng.uniform(0.5, 10.0))),
            )
        )
        if columns[-1].start == 0.0 and rng.random() < 0.5:
            columns[-1] = columns[-1]._replace(end=rng.uniform(0.5, 10.0))
    return columns


def main():
    """Write the table."""
    rng = random.Random(46)
    names = ["modulation_frequency", *Column._fields, "at_zero", "real", "imaginary"]
    lines = [HEADER, "# " + ",".join(names)]
    for column in corners() + drawn(96, seed=958360):
        frequencies = [10 ** rng.uniform(5.5, 8.2), 10 ** rng.uniform(8.0, 9.0)]
        if rng.random() < 0.2:
            frequencies[1] = 1e9
        depth = max(b for _, b in _panels(column, 0.0))
        frequencies[1] = min(frequencies[1], 4e10 / depth)  # for the time it takes
        at_zero, *others = integrals(column, frequencies)
        for frequency, value in zip(frequencies, others, strict=True):
            row = [repr(v) for v in (frequency, *column)]
            row += [mpmath.nstr(v, 20) for v in (at_zero.real, value.real, value.imag)]
            lines.append(",".join(row))
        sys.stdout.write(f"{len(lines) - 2} rows\n")
        sys.stdout.flush()
    TABLE.parent.mkdir(exist_ok=True)
    TABLE.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
