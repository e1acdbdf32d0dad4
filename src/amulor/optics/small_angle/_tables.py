"""Tables of a phase function, and of Bessel functions, for the small-angle model."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray
from scipy.special import j0, j1

from amulor.optics._quadrature.bessel import bessel_nodes, monomials
from amulor.optics.phase_functions.henyey_greenstein import forward_split
from amulor.optics.small_angle import _kernels

__all__ = ["PhaseFunction", "Table", "disc", "table"]

Array = NDArray[np.float64]
PhaseFunction = Callable[[Array], ArrayLike]

_OCTAVES = 16  # of the table beyond its cells of equal width
_SMALLEST = 1e-18  # angle below which a peak counts as forward [rad]


class Table(NamedTuple):
    """What the small-angle model needs to know of a phase function."""

    split: float
    fraction: float
    cells: Array


def table(phase_function: PhaseFunction, split_angle: float) -> Table:
    """Return the table of a phase function, kept if it can be told from others."""
    split = float(split_angle)
    if isinstance(phase_function, Hashable):
        return _kept_table(phase_function, split)
    return _fresh_table(phase_function, split)


def _fresh_table(phase_function: PhaseFunction, split: float) -> Table:
    """Return forward fraction, and (1 - mean transform up to x) / x^2 in cells."""
    fraction, _ = forward_split(phase_function, split_angle=split)
    degree = 10
    node = np.cos(np.pi * (np.arange(degree) + 0.5) / degree)
    unit = _kernels.WIDTH / split
    edge: Array = float(unit) * np.arange(_kernels.LINEAR + 1, dtype=np.float64)
    octaves = np.arange(_OCTAVES * _kernels.PER_OCTAVE + 1)
    grown = edge[-1] * 2.0 ** (octaves / _kernels.PER_OCTAVE)
    edge = np.concatenate([edge[:-1], grown])
    x: Array = edge[:-1, None] + np.diff(edge)[:, None] * (node + 1) / 2
    ratio = 2 ** ((node + 1) / 2 / _kernels.PER_OCTAVE)
    x[_kernels.LINEAR :] = edge[_kernels.LINEAR : -1, None] * ratio
    transform = getattr(phase_function, "hankel", None)
    if transform is None:
        values = _spread_by_quadrature(phase_function, x, split)
    else:
        values = _spread_by_transform(transform, edge, x, split)
    return Table(split, fraction, monomials(values))


_kept_table = lru_cache(maxsize=32)(_fresh_table)


def _spread_by_transform(
    transform: Callable[..., ArrayLike], edge: Array, x: Array, split: float
) -> Array:
    """Return (1 - mean of the transform up to x) / x^2 at the nodes of the cells."""
    node, weight = _gauss()
    one = float(np.asarray(transform(np.zeros(1), split_angle=split))[0])
    if not abs(one - 1) < 1e-6:
        raise ValueError(
            f"phase_function.hankel must be 1 at frequency 0, got {one:g}; divide "
            "the forward part by its integral"
        )
    width = np.diff(edge)[:, None]
    points = edge[:-1, None] + width * (node + 1) / 2
    flat = np.asarray(transform(points.ravel(), split_angle=split), dtype=float)
    # Legendre series of each cell, integrated from its start to its nodes and end.
    order = np.arange(node.size)
    series = legendre.legvander(node, node.size - 1) * weight[:, None] * (order + 0.5)
    stops = np.concatenate([2 * (x - edge[:-1, None]) / width - 1, 1 + 0 * width], 1)
    powers = legendre.legvander(stops, node.size)
    integral = np.empty((*stops.shape, node.size))
    integral[..., 0] = stops + 1
    integral[..., 1:] = (powers[..., 2:] - powers[..., :-2]) / (2 * order[1:] + 1)
    terms = (1 - flat.reshape(points.shape)) @ series * (width / 2)
    lost = np.einsum("csn,cn->cs", integral, terms)
    before = np.append(0.0, np.cumsum(lost[:-1, -1]))
    return np.asarray((before[:, None] + lost[:, :-1]) / x**3)


def _spread_by_quadrature(
    phase_function: PhaseFunction, x: Array, split: float
) -> Array:
    """Return the same from the phase function itself."""
    coarse = _angle_panels(phase_function, split)
    angle, weight = _angle_rule(coarse[:-1], coarse[1:])
    forward = np.sum(weight * _density(phase_function, angle))
    whole, per = _kernels.LINEAR, _kernels.PER_OCTAVE
    starts = [0, *range(whole, len(x), per)]
    out = np.empty(x.shape)
    for first, last in zip(starts, [*starts[1:], len(x)], strict=True):
        group = np.ascontiguousarray(x[first:last])
        # The oscillations of the transform are followed to the end of its table.
        fine = 16 / group.max()
        reach = min(_kernels.FAR / group.min(), split)
        even = np.linspace(0, reach, int(np.ceil(reach / fine)) + 1)[1:]
        edges = np.union1d(coarse, even)
        angle, weight = _angle_rule(edges[:-1], edges[1:])
        weight = weight * _density(phase_function, angle) / forward
        flat = np.empty(group.size)
        _kernels.spread(
            group.ravel(), angle.ravel(), weight.ravel(), _mean_table(), flat
        )
        out[first:last] = flat.reshape(group.shape)
    return out


def _angle_panels(phase_function: PhaseFunction, split: float) -> Array:
    """Return edges of panels in which a phase function is smooth [rad]."""
    count = int(np.ceil(np.log(split / _SMALLEST)))
    edges = np.geomspace(_SMALLEST, split, count + 1)
    edges[-1] = split
    left, right = edges[:-1], edges[1:]
    kept = [np.array([_SMALLEST, split])]
    for _ in range(40):
        middle = np.sqrt(left * right)
        whole, lower, upper = (
            np.sum(weight * _density(phase_function, angle), axis=1)
            for angle, weight in (
                _angle_rule(low, high)
                for low, high in ((left, right), (left, middle), (middle, right))
            )
        )
        rough = np.abs(whole - lower - upper) > 1e-10
        kept += [left, middle]
        if not np.any(rough):
            break
        left, right = (
            np.concatenate([left[rough], middle[rough]]),
            np.concatenate([middle[rough], right[rough]]),
        )
    return np.unique(np.concatenate(kept))


def _angle_rule(low: Array, high: Array) -> tuple[Array, Array]:
    """Return angles and weights of panels that are even in the logarithm."""
    node, weight = _gauss()
    half = np.log(high / low)[:, None] / 2
    angle = low[:, None] * np.exp(half * (node + 1))
    angle = np.clip(angle, low[:, None], high[:, None])
    return angle, weight * half * angle


def _density(phase_function: PhaseFunction, angle: Array) -> Array:
    """Return the phase function per angle, over all azimuths [1/rad]."""
    value = np.asarray(phase_function(angle.ravel()), dtype=float)
    return 2 * np.pi * value.reshape(angle.shape) * np.sin(angle)


@cache
def _gauss() -> tuple[Array, Array]:
    """Return nodes and weights on -1..1 of a rule of 16 points."""
    node, weight = legendre.leggauss(16)
    return node, weight


@cache
def disc() -> Array:
    """Return the table of 2 J1(x) / x in cells of width 1."""
    return monomials(2 * j1(bessel_nodes()) / bessel_nodes())


@cache
def _mean_table() -> Array:
    """Return the table of (1 - mean of J0 up to x) / x^2 in cells of width 1."""
    gauss, weight = _gauss()
    node = np.cos(np.pi * (np.arange(10) + 0.5) / 10)
    stop = np.append((node + 1) / 2, 1.0)
    start = np.arange(_kernels.FAR)[:, None, None]
    y = start + stop[:, None] * (gauss + 1) / 2
    half = y / 2
    # 1 - J0 without loss of digits near 0.
    series = half**2 * (1 - half**2 / 4 * (1 - half**2 / 9 * (1 - half**2 / 16)))
    lost = np.where(y < 0.03, series, 1 - j0(y)) @ weight * stop / 2
    before = np.append(0.0, np.cumsum(lost[:-1, -1]))
    x = np.arange(_kernels.FAR)[:, None] + stop[:-1]
    return monomials((before[:, None] + lost[:, :-1]) / x**3)
