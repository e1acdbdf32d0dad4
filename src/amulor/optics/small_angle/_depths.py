"""Integral of exp(i w z) F(z) over the depth, in panels halved until they settle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from amulor.optics._quadrature.kernels import ORDER
from amulor.optics._quadrature.rule import RULE
from amulor.optics.small_angle import _kernels

__all__ = ["depth_rule", "integral", "panels"]

Array = NDArray[np.float64]

_TOLERANCE = 1e-8  # of the response at zero frequency, for each panel
_ROUNDING = 1e-11  # of the light on the axis, to which F(z) off the axis is known
_MOST_PANELS = 2048  # waiting to be halved, before the integral counts as unsettled


def integral(
    phase_per_depth: Array, edges: Array, values: Array
) -> NDArray[np.complex128]:
    """Return the integrals of exp(i w z) times the values in panels."""
    order = np.argsort(phase_per_depth)
    sums = np.zeros((2, phase_per_depth.size))
    _kernels.add_panels(edges, values, phase_per_depth[order], RULE, sums)
    result = np.empty(phase_per_depth.size, dtype=complex)
    result[order] = sums[0] + 1j * sums[1]
    return result


def panels(
    light: Callable[[Array], Array],
    on_axis: Callable[[Array], Array],
    *,
    loss: float,
    length: float,
    step: float,
    end: float,
    known: float,
    breaks: Sequence[float] = (),
) -> tuple[Array, Array, float]:
    """Return edges of panels, F(z) at their nodes, and the integral of it.

    light is F(z); on_axis is at least as large but for the loss, and falls with the
    square of the depth beyond the length. The first panel is a step wide; at breaks
    F(z) need not be smooth. What is known of the response adds to the scale.
    """
    node, weight, tail = depth_rule()

    def rest(depth: float) -> float:
        """Return more than what all water behind a depth can send."""
        reach = min(depth + length, 1 / loss if loss > 0 else np.inf)
        return float(on_axis(np.array(depth)) * np.exp(-loss * depth) * reach)

    edges, values, total = np.empty((0, 2)), np.empty((0, node.size)), 0.0
    start = 0.0
    while start < end:
        limits = [start]
        for _ in range(4):
            width = step if limits[-1] == 0 else 2 * limits[-1]
            width = min(width, 12 / loss if loss > 0 else np.inf)
            limits.append(min(limits[-1] + width, end))
        inside = [depth for depth in breaks if start < depth < limits[-1]]
        start = limits[-1]
        each = np.unique(limits + inside)
        waiting = np.stack([each[:-1], each[1:]], axis=1)
        while waiting.size:
            half = (waiting[:, 1] - waiting[:, 0]) / 2
            depth = waiting[:, :1] + half[:, None] * (node + 1)
            taken = light(depth.ravel()).reshape(depth.shape)
            part = half * (taken @ weight)
            unresolved = 2 * half * np.max(np.abs(taken @ tail), axis=1)
            scale = known + total + abs(part.sum())
            rounding = _ROUNDING * on_axis(waiting[:, 0]) * half
            done = unresolved <= np.maximum(_TOLERANCE * scale, rounding)
            edges = np.concatenate([edges, waiting[done]])
            values = np.concatenate([values, taken[done]])
            total += max(part[done].sum(), 0.0)
            low, high = waiting[~done].T
            middle = (low + high) / 2
            waiting = np.concatenate(
                [np.stack([low, middle], 1), np.stack([middle, high], 1)]
            )
            if len(waiting) > _MOST_PANELS:
                raise ArithmeticError(
                    f"the water column does not settle about {low[0]:g} m; "
                    "receiver_radius or acceptance_angle may be far too small"
                )
        # What is sent from beyond this depth does not count.
        enough = start
        while enough < end and rest(enough) > _TOLERANCE * (known + total):
            enough *= 1.25
        end = min(end, enough)
    return edges, values, total


@cache
def depth_rule() -> tuple[Array, Array, Array]:
    """Return nodes and weights of a panel, and what gives its last Legendre terms."""
    size = 2 * ORDER
    node, weight = legendre.leggauss(size)
    order = np.arange(size)
    series = (order + 0.5) * legendre.legvander(node, size - 1) * weight[:, None]
    return node, weight, np.ascontiguousarray(series[:, -4:])
