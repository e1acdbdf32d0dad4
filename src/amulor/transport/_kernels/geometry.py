"""Straight ways in compiled loops: through layers, and inside of the receiver's cone.

Compiled, as each local estimate of docs/theory/photon-transport.md needs both.
"""

from __future__ import annotations

import math

from amulor.transport._kernels.compiled import kernel
from amulor.transport._kernels.types import Array


@kernel
def transmission_depth(
    z_start: float, z_end: float, length: float, edge: Array, attenuation: Array
) -> float:
    """Return the optical thickness of a straight way between two depths."""
    low, high = min(z_start, z_end), max(z_start, z_end)
    if high - low < 1e-9 * length or attenuation.size == 1:
        for k in range(attenuation.size):
            if low < edge[k + 1] or k == attenuation.size - 1:
                return float(attenuation[k] * length)
    total = 0.0
    for k in range(attenuation.size):
        within = min(high, edge[k + 1]) - max(low, edge[k])
        if within > 0.0:
            total += attenuation[k] * within
    return total * length / (high - low)


@kernel
def cone_window(
    x: float,
    y: float,
    slope_x: float,
    slope_y: float,
    radius: float,
    slope: float,
    z_low: float,
    z_high: float,
) -> tuple[float, float]:
    """Return the part of a line that lies in a cone which widens with z from z = 0.

    The line is (x + slope_x z, y + slope_y z), the cone has the radius radius +
    slope z. The part is empty if the second number is not above the first.
    """
    low, high = max(z_low, 0.0), z_high
    a = slope_x * slope_x + slope_y * slope_y - slope * slope
    b = x * slope_x + y * slope_y - radius * slope
    c = x * x + y * y - radius * radius
    inside = b * b - a * c
    if abs(a) < 1e-14:
        if abs(b) < 1e-300:
            return (low, high) if c < 0 else (1.0, 0.0)
        root = -0.5 * c / b
        return (low, min(high, root)) if b > 0 else (max(low, root), high)
    if inside <= 0.0:
        return (1.0, 0.0) if a > 0 else (low, high)
    # Roots without cancellation.
    q = -(b + math.copysign(math.sqrt(inside), b))
    first, second = q / a, c / q if q != 0.0 else q / a
    smaller, larger = min(first, second), max(first, second)
    if a > 0:
        return max(low, smaller), min(high, larger)
    return max(low, larger), high
