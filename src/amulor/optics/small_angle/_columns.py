"""Small-angle model: tables of the phase function, water columns, depth integrals.

F(z) is the overlap of beam and receiver at the depth z [sr], and w the phase per depth
[rad/m]. A panel is a depth interval with quadrature nodes, a view the receiver geometry
(baseline, tilts, end) of a water column.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike, NDArray
from scipy.special import j0, j1

from amulor.optics import _bounds
from amulor.optics._quadrature import ORDER, RULE, bessel, bessel_nodes, monomials
from amulor.optics._water_column import (
    Receiver,
    checked,
    phase_per_depth,
    refuse_behind_receiver,
)
from amulor.optics.phase_functions.henyey_greenstein import forward_split
from amulor.optics.small_angle import _kernels

__all__ = [
    "FEWEST",
    "Arguments",
    "Column",
    "Light",
    "PhaseFunction",
    "Shared",
    "Table",
    "depth_rule",
    "disc",
    "fit_of",
    "integral",
    "integrals",
    "light_of",
    "looks",
    "overlap_of",
    "panels",
    "response_of",
    "table",
]


Array = NDArray[np.float64]
PhaseFunction = Callable[[Array], ArrayLike]

_OCTAVES = 16  # of the table beyond its cells of equal width
_SMALLEST = 1e-18  # angle below which a peak counts as forward [rad]


class Table(NamedTuple):
    """Forward fraction of a phase function, and table of its mean Hankel transform."""

    split: float
    fraction: float
    cells: Array

    def __eq__(self, other: object) -> bool:
        """Whether `other` is this very object; table values are not compared."""
        return self is other

    def __hash__(self) -> int:
        """Hash of the object identity, for use as a key of caches."""
        return id(self)


def table(phase_function: PhaseFunction, split_angle: float) -> Table:
    """Return the Hankel-transform table of a phase function, cached if hashable."""
    split = float(split_angle)
    if isinstance(phase_function, Hashable):
        return _cached_table(phase_function, split)
    return _computed_table(phase_function, split)


def _computed_table(phase_function: PhaseFunction, split: float) -> Table:
    """Compute forward fraction and Hankel-transform table of a phase function."""
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


_cached_table = lru_cache(maxsize=32)(_computed_table)


def _spread_by_transform(
    transform: Callable[..., ArrayLike], edge: Array, x: Array, split: float
) -> Array:
    """Return (1 - mean Hankel transform from 0 to x) / x^2, by a given transform."""
    node, weight = _gauss()
    at_zero = float(np.asarray(transform(np.zeros(1), split_angle=split))[0])
    if not abs(at_zero - 1) < 1e-6:
        raise ValueError(
            f"phase_function.hankel must be 1 at frequency 0, got {at_zero:g}; divide "
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
    """Return (1 - mean Hankel transform from 0 to x) / x^2, by sums over angle."""
    coarse = _angle_panels(phase_function, split)
    angle, weight = _angle_rule(coarse[:-1], coarse[1:])
    forward = np.sum(weight * _density(phase_function, angle))
    linear, per = _kernels.LINEAR, _kernels.PER_OCTAVE
    starts = [0, *range(linear, len(x), per)]
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
    """Return edges of angle intervals in which a phase function is smooth [rad]."""
    count = int(np.ceil(np.log(split / _SMALLEST)))
    edges = np.geomspace(_SMALLEST, split, count + 1)
    edges[-1] = split
    lower, upper = edges[:-1], edges[1:]
    edge_sets = [np.array([_SMALLEST, split])]
    for _ in range(40):
        middle = np.sqrt(lower * upper)
        coarse, first, second = (
            np.sum(weight * _density(phase_function, angle), axis=1)
            for angle, weight in (
                _angle_rule(low, high)
                for low, high in ((lower, upper), (lower, middle), (middle, upper))
            )
        )
        rough = np.abs(coarse - first - second) > 1e-10
        edge_sets += [lower, middle]
        if not np.any(rough):
            break
        lower, upper = (
            np.concatenate([lower[rough], middle[rough]]),
            np.concatenate([middle[rough], upper[rough]]),
        )
    return np.unique(np.concatenate(edge_sets))


def _angle_rule(low: Array, high: Array) -> tuple[Array, Array]:
    """Return angles at Gauss-Legendre nodes in ln(angle), and weights [rad]."""
    node, weight = _gauss()
    half = np.log(high / low)[:, None] / 2
    angle = low[:, None] * np.exp(half * (node + 1))
    angle = np.clip(angle, low[:, None], high[:, None])
    return angle, weight * half * angle


def _density(phase_function: PhaseFunction, angle: Array) -> Array:
    """Return the scattering density per polar angle, 2 pi p sin(angle) [1/rad]."""
    value = np.asarray(phase_function(angle.ravel()), dtype=float)
    return 2 * np.pi * value.reshape(angle.shape) * np.sin(angle)


@cache
def _gauss() -> tuple[Array, Array]:
    """Return 16 Gauss-Legendre nodes and weights on -1..1."""
    node, weight = legendre.leggauss(16)
    return node, weight


@cache
def disc() -> Array:
    """Return polynomials for the disc transform 2 J1(x) / x, in cells of width 1."""
    return monomials(2 * j1(bessel_nodes()) / bessel_nodes())


@cache
def _mean_table() -> Array:
    """Return polynomials, per unit cell, for (1 - mean of J0 from 0 to x) / x^2."""
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


_TOLERANCE = 1e-8  # of the response at zero frequency, for each panel
_ROUNDING = 1e-11  # of the light on the axis, to which F(z) off the axis is known
_MOST_PANELS = 2048  # waiting to be halved, before the integral counts as unsettled


def integral(
    phase_per_depth: Array, edges: Array, values: Array
) -> NDArray[np.complex128]:
    """Integrate exp(i w z) times the overlap F(z) over depth, from F at panel nodes."""
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
    partial_sum: float,
    breaks: Sequence[float] = (),
) -> tuple[Array, Array, float]:
    """Return edges of depth panels, overlap F(z) at the nodes, and integral of F(z).

    light is F(z); on_axis is at least as large but for the loss, and falls with the
    square of the depth beyond the length. The first panel is a step wide; at breaks
    F(z) need not be smooth. partial_sum is response summed already.
    """
    node, weight, tail = depth_rule()

    def rest(depth: float) -> float:
        """Return an upper limit of the integral of F(z) beyond a depth."""
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
        limits_inside = np.array(sorted({*limits, *inside}))
        waiting = np.array([limits_inside[:-1], limits_inside[1:]]).T
        while waiting.size:
            half = (waiting[:, 1] - waiting[:, 0]) / 2
            depth = waiting[:, :1] + half[:, None] * (node + 1)
            samples = light(depth.ravel()).reshape(depth.shape)
            part = half * (samples @ weight)
            unresolved = 2 * half * np.max(np.abs(samples @ tail), axis=1)
            scale = partial_sum + total + abs(part.sum())
            rounding = _ROUNDING * on_axis(waiting[:, 0]) * half
            done = unresolved <= np.maximum(_TOLERANCE * scale, rounding)
            edges = np.concatenate([edges, waiting[done]])
            values = np.concatenate([values, samples[done]])
            total += max(part[done].sum(), 0.0)
            if done.all():
                break
            low, high = waiting[~done].T
            middle = (low + high) / 2
            waiting = np.concatenate(
                [np.array([low, middle]).T, np.array([middle, high]).T]
            )
            if len(waiting) > _MOST_PANELS:
                raise ArithmeticError(
                    f"the water column does not settle about {low[0]:g} m; "
                    "receiver_radius or acceptance_angle may be far too small"
                )
        # What is sent from beyond this depth does not count.
        enough = start
        while enough < end and rest(enough) > _TOLERANCE * (partial_sum + total):
            enough *= 1.25
        end = min(end, enough)
    return edges, values, total


@cache
def depth_rule() -> tuple[Array, Array, Array]:
    """Return Gauss-Legendre rule, and matrix to the last four Legendre coefficients."""
    size = 2 * ORDER
    node, weight = legendre.leggauss(size)
    order = np.arange(size)
    series = (order + 0.5) * legendre.legvander(node, size - 1) * weight[:, None]
    return node, weight, np.ascontiguousarray(series[:, -4:])


#: Columns from which on a table is less work than one after the other.
FEWEST = 64
_CELL = 0.5  # width of a cell in ln(1 + q)
_MOST_CELLS = 40
_DEGREE = 10


class Shared(NamedTuple):
    """Water, receiver and tables shared by all water columns of a scan."""

    water: _kernels.Water
    """Water and receiver; its baseline and tilts are ignored."""
    cells: Array
    """Transform table of the phase function."""
    rule: Array
    """Nodes and weights of one panel of spatial frequency."""


class Light(NamedTuple):
    """Overlap of forward-scattered light, by depth and offset of the receiver axis."""

    edge: Array
    """Depth intervals in which the light is smooth, shape (panel, 2) [m]."""
    span: Array
    """Start and width of the cells in ln(1 + q) at each node, shape (node, 2)."""
    cells: Array
    """Polynomial coefficients of the cells, shape (node, cell, 10)."""


def light_of(view: Array, shared: Shared, panels_of: Callable[[Array], Array]) -> Light:
    """Tabulate the overlap of forward-scattered light for the water columns of a scan.

    A row of view is baseline, tilt, cross tilt and end of a column; `panels_of` gives
    the edges of panels in which the light of one such row is smooth.
    """
    edge = _common(np.concatenate([panels_of(view[i]) for i in _spread(view)]))
    node, _ = legendre.leggauss(2 * ORDER)
    depth = (edge[:, :1] + np.diff(edge) * (node + 1) / 2).ravel()
    return Light(edge, *_tables(depth, view, shared))


def integrals(
    phase_per_depth: Array, view: Array, shared: Shared, light: Light
) -> NDArray[np.complex128]:
    """Integrate exp(i w z) times tabulated overlap over depth, for each water column.

    A column is the same whatever others come with it.
    """
    edge, span, cells = light
    size = 2 * ORDER
    node, weight = legendre.leggauss(size)
    order = np.argsort(phase_per_depth)
    sums = np.zeros((len(view), 2, phase_per_depth.size))
    degree = np.arange(size)
    series = (degree + 0.5) * legendre.legvander(node, size - 1) * weight[:, None]
    _kernels.add_columns(
        np.ascontiguousarray(view),
        edge,
        span,
        cells,
        shared.water,
        phase_per_depth[order],
        (RULE, node, np.ascontiguousarray(series)),
        sums,
    )
    result = np.empty((len(view), phase_per_depth.size), dtype=complex)
    result[:, order] = sums[:, 0] + 1j * sums[:, 1]
    return result


def _spread(view: Array) -> NDArray[np.intp]:
    """Return row indices of representative views: extremes, and three evenly spaced."""
    extremes = np.concatenate([view.argmin(axis=0), view.argmax(axis=0)])
    even = np.linspace(0, len(view) - 1, 3).astype(np.intp)
    return np.unique(np.concatenate([extremes, even]))


def _common(edges: Array) -> Array:
    """Merge the panel edges of several water columns into common depth panels [m]."""
    distinct = np.unique(edges)
    # Edges that are the same but for rounding, and slivers between two columns.
    keep = np.append(True, np.diff(distinct) > 1e-6 * distinct[1:])
    distinct = distinct[keep]
    return np.stack([distinct[:-1], distinct[1:]], axis=1)


def _tables(depth: Array, view: Array, shared: Shared) -> tuple[Array, Array]:
    """Tabulate the overlap at each depth, in cells of ln(1 + offset^2 / width^2)."""
    water = shared.water
    path = depth[:, None] + water.standoff
    area = water.radius_squared + water.angle_squared * path**2
    low, high = np.full(depth.size, np.inf), np.full(depth.size, -np.inf)
    # Not all columns at once, for the memory.
    for first in range(0, len(view), 512):
        baseline, tilt, cross, _ = view[first : first + 512].T
        apart = (baseline - tilt * path) ** 2 + (cross * path) ** 2
        separation = np.log1p(apart / area)
        low = np.minimum(low, separation.min(axis=1))
        high = np.maximum(high, separation.max(axis=1))
    count = int(np.clip(np.ceil(np.max(high - low) / _CELL), 1, _MOST_CELLS))
    width = np.maximum((high - low) / count, 1e-9)
    node = np.cos(np.pi * (np.arange(_DEGREE) + 0.5) / _DEGREE)
    place = np.arange(count)[:, None] + (node + 1) / 2
    apart = low[:, None, None] + width[:, None, None] * place
    offset = np.sqrt(np.maximum(np.expm1(apart), 0.0) * area[:, :, None])
    # Depth, baseline, tilts and standoff of receivers that look straight ahead.
    look = np.zeros((offset.size, 5))
    look[:, 0] = np.broadcast_to(depth[:, None, None], offset.shape).ravel()
    look[:, 1] = offset.ravel()
    look[:, 4] = water.standoff
    out = np.empty(len(look))
    _kernels.scattered(
        look,
        water,
        shared.cells,
        bessel(),
        shared.rule,
        out,
    )
    values = out.reshape(-1, _DEGREE)
    cells = monomials(values).reshape(depth.size, count, _DEGREE)
    return np.stack([low, width], axis=1), cells


Complex = NDArray[np.complex128]
Many = Callable[[Array, Array, "Column", Table], Complex]
_Fitted = TypeVar("_Fitted")


@dataclass(frozen=True, kw_only=True)
class Arguments(Receiver):
    """Water, beam and receiver arguments of water columns, as floats or arrays."""

    absorption: Any
    scattering: Any
    beam_radius: Any
    beam_divergence: Any
    end: Any = np.inf


#: What columns of one table may differ in, in the order of its rows.
VIEW = ("baseline", "tilt", "cross_tilt", "end")
#: What depths of one call may differ in, in the order of the rows of `looks`.
LOOK = ("baseline", "tilt", "cross_tilt", "standoff")


class Column(NamedTuple):
    """Optical properties of a water column, with beam and receiver geometry (SI).

    Where each depth is looked at in its own way, such as the pixels of a target, what
    `LOOK` names has an element for each depth.
    """

    absorption: float
    scattering: float
    baseline: Any
    receiver_radius: float
    acceptance_angle: float
    beam_radius: float
    beam_divergence: float
    tilt: Any
    cross_tilt: Any
    standoff: Any
    end: float

    def look(self) -> dict[str, float]:
        """Return the receiver geometry common to all depths; zeros if it varies."""
        view = {name: getattr(self, name) for name in LOOK}
        varies = any(np.ndim(value) for value in view.values())
        return dict.fromkeys(view, 0.0) if varies else view

    def loss(self, spread: Table) -> float:
        """Return the two-way attenuation 2 k', without forward scattering [1/m]."""
        return 2 * (self.absorption + self.scattering * (1 - spread.fraction))


def looks(depth: Array, column: Column) -> Array:
    """Return an array with a row per depth: depth, baseline, tilts and standoff."""
    rows = np.empty((depth.size, 1 + len(LOOK)))
    rows[:, 0] = depth
    for place, name in enumerate(LOOK, 1):
        rows[:, place] = getattr(column, name)
    return rows


def overlap_of(
    light: Callable[[Array, Column, Table], Array],
    depth: ArrayLike,
    arguments: Arguments,
    *,
    phase_function: PhaseFunction,
    split_angle: float,
) -> Array:
    """Return the overlap F(z) for arrays of arguments, one water column at a time."""
    z = np.asarray(checked("depth", depth))
    spread = table(phase_function, split_angle)
    columns = _columns(arguments, depth=z)
    refuse_behind_receiver(columns["standoff"], z)
    names, values = list(columns), list(columns.values())
    z, *values = np.broadcast_arrays(z, *values)
    out = np.empty(z.shape)
    flat = {n: value.ravel() for n, value in zip(names, values, strict=True)}
    shared = [name for name in names if name not in LOOK]
    varied = [name for name in shared if columns[name].size > 1]
    for part in _equal_columns([flat[name] for name in varied], z.size):
        fields: dict[str, Any] = {name: float(flat[name][part[0]]) for name in shared}
        fields |= {name: flat[name][part] for name in LOOK}
        column = Column(**fields)
        out.flat[part] = light(z.ravel()[part], column, spread)
    return out


def _equal_columns(values: list[Array], count: int) -> list[NDArray[np.intp]]:
    """Group the indices of water columns that have equal arguments."""
    if count == 0:
        return []
    if not values:
        return [np.arange(count)]
    _, group = np.unique(np.stack(values, axis=1), axis=0, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    return np.split(order, np.flatnonzero(np.diff(group.ravel()[order])) + 1)


def response_of(
    integral: Callable[[Array, Column, Table], NDArray[np.complex128]],
    modulation_frequency: ArrayLike,
    arguments: Arguments,
    *,
    group_index: ArrayLike,
    phase_function: PhaseFunction,
    split_angle: float,
    backscatter_vsf: ArrayLike | None,
    batched: Many | None = None,
    fewest: int = 2,
) -> NDArray[np.complex128]:
    """Return the water signal for arrays of arguments, by a given depth integral.

    batched gives it for at least the fewest columns that differ only in the view.
    """
    phases, columns, spread, vsf = _prepared(
        modulation_frequency,
        arguments,
        group_index=group_index,
        phase_function=phase_function,
        split_angle=split_angle,
        backscatter_vsf=backscatter_vsf,
    )
    together = None if batched is None else _views(phases, columns, fewest)
    if batched is None or together is None:
        result = _by_column(integral, phases, columns, spread)
    else:
        view, column, scatter = together
        result = scatter(batched(phases.ravel(), view, column, spread))
    return np.asarray(vsf * result)


def fit_of(
    fit: Callable[[Array, Array, Column, Table], _Fitted],
    modulation_frequency: ArrayLike,
    arguments: Arguments,
    *,
    group_index: ArrayLike,
    phase_function: PhaseFunction,
    split_angle: float,
    backscatter_vsf: ArrayLike | None,
) -> _Fitted | None:
    """Apply `fit` to water columns if they differ only in receiver view; else None."""
    phases, columns, spread, _ = _prepared(
        modulation_frequency,
        arguments,
        group_index=group_index,
        phase_function=phase_function,
        split_angle=split_angle,
        backscatter_vsf=backscatter_vsf,
    )
    together = _views(phases, columns, 1)
    if together is None:
        return None
    return fit(phases.ravel(), *together[:2], spread)


def _prepared(
    modulation_frequency: ArrayLike,
    arguments: Arguments,
    *,
    group_index: ArrayLike,
    phase_function: PhaseFunction,
    split_angle: float,
    backscatter_vsf: ArrayLike | None,
) -> tuple[Array, dict[str, NDArray[Any]], Table, Any]:
    """Check arguments; return phases per depth, columns, transform table and VSF."""
    refuse_behind_receiver(arguments.standoff)
    phases = phase_per_depth(modulation_frequency, group_index=group_index)
    spread = table(phase_function, split_angle)
    if backscatter_vsf is None:
        at_180 = float(np.asarray(phase_function(np.array([np.pi])))[0])
        vsf = np.asarray(arguments.scattering, dtype=float) * at_180
    else:
        vsf = checked("backscatter_vsf", backscatter_vsf)
    columns = _columns(arguments, modulation_frequency=phases, backscatter_vsf=vsf)
    phases = np.broadcast_to(phases, np.broadcast_shapes(phases.shape, np.shape(vsf)))
    return phases, columns, spread, vsf


def _views(
    phases: Array, columns: dict[str, NDArray[Any]], fewest: int
) -> tuple[Array, Column, Callable[[Complex], Complex]] | None:
    """Return distinct receiver views, common column, and function to expand results.

    None for too few columns, where they share less, and where frequencies have no axes
    of their own.
    """
    inner = np.broadcast_shapes(*(value.shape for value in columns.values()))
    if int(np.prod(inner)) < fewest:
        return None
    shape = np.broadcast_shapes(phases.shape, inner)
    padded = (1,) * (len(shape) - phases.ndim) + phases.shape
    wide = (1,) * (len(shape) - len(inner)) + inner
    if any(p > 1 and w > 1 for p, w in zip(padded, wide, strict=True)):
        return None
    shared = {}
    for name, value in columns.items():
        if name not in VIEW:
            if value.size == 0 or np.ptp(value) != 0:
                return None
            shared[name] = float(value.flat[0])
    view = np.stack([np.broadcast_to(columns[name], inner).ravel() for name in VIEW])
    # Pixels that look the same way at the same end are worked out once.
    distinct, back = np.unique(view.T, axis=0, return_inverse=True)

    def scatter(results: Complex) -> Complex:
        """Expand results per distinct view to the broadcast shape of the arguments."""
        results = results[back.ravel()].reshape(*wide, phases.size)
        # Original order of the frequencies.
        lifted = np.moveaxis(results, -1, 0).reshape(phases.size, *wide)
        out: Complex = np.empty(shape, dtype=complex)
        for number, index in enumerate(np.ndindex(padded)):
            place = tuple(
                slice(i, i + 1) if size > 1 else slice(None)
                for i, size in zip(index, padded, strict=True)
            )
            out[place] = lifted[number]
        return out

    return distinct, Column(**shared, **dict.fromkeys(VIEW, 0.0)), scatter


def _columns(arguments: Arguments, **arrays: Any) -> dict[str, NDArray[Any]]:
    """Convert the arguments to arrays, checked to broadcast with further arrays."""
    columns = {name: np.asarray(value) for name, value in arguments.named().items()}
    if any(np.ndim(value) for value in (*columns.values(), *arrays.values())):
        _bounds.broadcast(**arrays, **columns)
    return columns


def _by_column(
    integral: Callable[[Array, Column, Table], NDArray[np.complex128]],
    phases: Array,
    columns: dict[str, NDArray[Any]],
    spread: Table,
) -> NDArray[np.complex128]:
    """Return depth integrals for arrays of arguments, one water column at a time."""
    inner = np.broadcast_shapes(*(value.shape for value in columns.values()))
    shape = np.broadcast_shapes(phases.shape, inner)
    inner = (1,) * (len(shape) - len(inner)) + inner
    columns = {name: np.broadcast_to(value, inner) for name, value in columns.items()}
    phases = np.broadcast_to(phases, shape)
    out: NDArray[np.complex128] = np.empty(shape, dtype=complex)
    # Axes along which only the phase changes share one column.
    for index in np.ndindex(inner):
        place = tuple(
            slice(None) if size == 1 else slice(i, i + 1)
            for i, size in zip(index, inner, strict=True)
        )
        part = np.ascontiguousarray(phases[place]).reshape(-1)
        column = Column(
            **{name: float(value[index]) for name, value in columns.items()}
        )
        out[place] = integral(part, column, spread).reshape(out[place].shape)
    return out
