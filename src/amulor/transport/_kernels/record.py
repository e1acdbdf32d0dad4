"""Record of path lengths in compiled loops: deposits, and their transform.

Light that arrives is kept by the length of its path, in even bins, so that all
frequencies and absorptions are evaluated afterwards. Two arrays share the nodes: mass,
for light of one length, and edge, the derivative of light spread evenly over a range
of lengths. Both are split among four nodes by Lagrange's cubic, so a phasor comes out
with an error of 3/128 of the fourth power of its phase per node. Paths beyond the last
node go into exact sums, one per frequency. Theory: docs/theory/photon-transport.md, the
end of "A path is joined where it is the least accidental". Compiled, as there is a
deposit for each pair of segments that meets.
"""

from __future__ import annotations

import numpy as np

from amulor.transport._kernels.compiled import entry, kernel
from amulor.transport._kernels.types import Array, Complex, Record


@kernel
def add_at(
    array: Array, part: int, scaled: float, component: int, light: float
) -> None:
    """Split light among four nodes around a place, with the weights of a cubic."""
    node = max(int(scaled) - 1, 0)
    a = scaled - node
    b, c, d = a - 1.0, a - 2.0, a - 3.0
    inner, outer = 0.5 * light * b * c, 0.5 * light * a * d
    array[part, component, node] -= inner * d * (1.0 / 3.0)
    array[part, component, node + 1] += outer * c
    array[part, component, node + 2] -= outer * b
    array[part, component, node + 3] += inner * a * (1.0 / 3.0)


#: Rows of the sum of a group: light that met water only, and light of the target.
WATER, TARGET = range(2)


@kernel
def add_to(total: Array, kind: int, light: Array) -> None:
    """Add light to the sum of its kind."""
    for k in range(light.size):
        total[kind, k] += light[k]


@kernel
def add_beyond(
    record: Record, part: int, low: float, high: float, light: Array
) -> None:
    """Add light spread over path lengths that are beyond the last node, exactly."""
    beyond, wavenumber = record.beyond, record.wavenumber
    for f in range(wavenumber.size):
        q = wavenumber[f]
        span = q * (high - low)
        factor = np.exp(0.5 * q * (low + high))
        if abs(span) > 1e-6:
            factor *= 2.0 * np.sinh(0.5 * span) / span
        for k in range(beyond.shape[1]):
            beyond[part, k, f] += light[k] * factor


@kernel
def add_point(record: Record, part: int, length: float, light: Array) -> None:
    """Add light of one path length; the light has as many components as the record."""
    mass = record.mass
    scaled = length / record.spacing
    if scaled < mass.shape[2] - 3:
        for k in range(mass.shape[1]):
            add_at(mass, part, scaled, k, light[k])
    else:
        add_beyond(record, part, length, length, light)


@kernel
def add_range(record: Record, part: int, low: float, high: float, light: Array) -> None:
    """Add light spread evenly over path lengths from low to high."""
    edge, spacing = record.edge, record.spacing
    if high - low < 0.05 * spacing:
        add_point(record, part, 0.5 * (low + high), light)
        return
    scaled_low, scaled_high = low / spacing, high / spacing
    if scaled_high < edge.shape[2] - 3:
        per_length = 1.0 / (high - low)
        for k in range(edge.shape[1]):
            add_at(edge, part, scaled_low, k, light[k] * per_length)
            add_at(edge, part, scaled_high, k, -light[k] * per_length)
    else:
        add_beyond(record, part, low, high, light)


@entry
def transform(
    mass: Array, edge: Array, wavenumber: Complex, spacing: float, out: Complex
) -> None:
    """Add to out the integral of the record times exp(wavenumber x path length)."""
    parts, components, nodes = mass.shape
    last = np.zeros((parts, components), dtype=np.int64)
    used = 0
    for p in range(parts):
        for k in range(components):
            for n in range(nodes):
                if mass[p, k, n] != 0.0 or edge[p, k, n] != 0.0:
                    last[p, k] = n + 1
            used = max(used, last[p, k])
    point = np.empty(used, dtype=np.complex128)
    ramp = np.empty(used, dtype=np.complex128)
    for f in range(wavenumber.size):
        q = wavenumber[f]
        per_node = np.exp(q * spacing)
        inverse = 0.0j if q == 0.0 else 1.0 / q
        phasor = 1.0 + 0.0j
        for n in range(used):
            length = n * spacing
            if n % 32 == 0:  # so that errors of the products do not grow
                phasor = np.exp(q * length)
            point[n] = phasor
            # -(exp(q L) - 1) / q, for the edges of which the sum is zero.
            if abs(q) * length < 1e-4:
                ramp[n] = -length * (1.0 + 0.5 * q * length)
            else:
                ramp[n] = (1.0 - phasor) * inverse
            phasor *= per_node
        for p in range(parts):
            for k in range(components):
                total = 0.0 + 0.0j
                for n in range(last[p, k]):
                    total += mass[p, k, n] * point[n] + edge[p, k, n] * ramp[n]
                out[p, k, f] += total
