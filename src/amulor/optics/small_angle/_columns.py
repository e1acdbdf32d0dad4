"""Columns of water in the small-angle form, taken from arguments of any shape."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics import _bounds
from amulor.optics._water_column import (
    Receiver,
    checked,
    phase_per_depth,
    refuse_behind_receiver,
)
from amulor.optics.small_angle._tables import PhaseFunction, Table, table

__all__ = ["Arguments", "Column", "fit_of", "looks", "overlap_of", "response_of"]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Many = Callable[[Array, Array, "Column", Table], Complex]
_Fitted = TypeVar("_Fitted")


@dataclass(frozen=True, kw_only=True)
class Arguments(Receiver):
    """Water, beam and receiver of many columns; floats or arrays."""

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
    """A column of water seen by an instrument (SI units).

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
        """Return how all depths are looked at, or zeros where each has its own."""
        view = {name: getattr(self, name) for name in LOOK}
        each = any(np.ndim(value) for value in view.values())
        return dict.fromkeys(view, 0.0) if each else view

    def loss(self, spread: Table) -> float:
        """Return 2 k', by which light is lost on its way there and back [1/m]."""
        return 2 * (self.absorption + self.scattering * (1 - spread.fraction))


def looks(depth: Array, column: Column) -> Array:
    """Return depths and how they are looked at as rows, for the compiled loops."""
    view = (getattr(column, name) for name in LOOK)
    return np.stack(np.broadcast_arrays(depth, *view), axis=1)


def overlap_of(
    light: Callable[[Array, Column, Table], Array],
    depth: ArrayLike,
    arguments: Arguments,
    *,
    phase_function: PhaseFunction,
    split_angle: float,
) -> Array:
    """Return F(z), with light giving that of the depths of one water and receiver."""
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
    for part in _alike([flat[name] for name in varied], z.size):
        fields: dict[str, Any] = {name: float(flat[name][part[0]]) for name in shared}
        fields |= {name: flat[name][part] for name in LOOK}
        column = Column(**fields)
        out.flat[part] = light(z.ravel()[part], column, spread)
    return out


def _alike(values: list[Array], count: int) -> list[NDArray[np.intp]]:
    """Return where all of some values are the same, for each that there are."""
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
    many: Many | None = None,
    fewest: int = 2,
) -> NDArray[np.complex128]:
    """Return the response, with integral giving that of exp(i w z) F(z) for many w.

    many gives it for at least the fewest columns that differ in where beam and receiver
    look only.
    """
    phases, columns, spread, vsf = _prepared(
        modulation_frequency,
        arguments,
        group_index=group_index,
        phase_function=phase_function,
        split_angle=split_angle,
        backscatter_vsf=backscatter_vsf,
    )
    together = None if many is None else _views(phases, columns, fewest)
    if many is None or together is None:
        result = _by_column(integral, phases, columns, spread)
    else:
        view, column, scatter = together
        result = scatter(many(phases.ravel(), view, column, spread))
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
    """Return a fit to columns that differ in where beam and receiver look only."""
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
    """Return phases per depth, columns, table and beta_pi of arguments in range."""
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
    """Return each view of columns that share the rest, and what arranges its results.

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
    each, back = np.unique(view.T, axis=0, return_inverse=True)

    def scatter(found: Complex) -> Complex:
        """Return the results of each view, (view, phase), in the shape of the call."""
        found = found[back.ravel()].reshape(*wide, phases.size)
        # The frequencies go to where they were.
        lifted = np.moveaxis(found, -1, 0).reshape(phases.size, *wide)
        out: Complex = np.empty(shape, dtype=complex)
        for number, index in enumerate(np.ndindex(padded)):
            place = tuple(
                slice(i, i + 1) if size > 1 else slice(None)
                for i, size in zip(index, padded, strict=True)
            )
            out[place] = lifted[number]
        return out

    return each, Column(**shared, **dict.fromkeys(VIEW, 0.0)), scatter


def _columns(arguments: Arguments, **others: Any) -> dict[str, NDArray[Any]]:
    """Return the arguments as arrays, if they broadcast with the others."""
    columns = {name: np.asarray(value) for name, value in arguments.named().items()}
    if any(np.ndim(value) for value in (*columns.values(), *others.values())):
        _bounds.broadcast(**others, **columns)
    return columns


def _by_column(
    integral: Callable[[Array, Column, Table], NDArray[np.complex128]],
    phases: Array,
    columns: dict[str, NDArray[Any]],
    spread: Table,
) -> NDArray[np.complex128]:
    """Return the integrals at all phases, once for each column."""
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
