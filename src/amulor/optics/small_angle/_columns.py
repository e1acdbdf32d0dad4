"""Columns of water in the small-angle form, taken from arguments of any shape."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.optics._small_angle_arguments import checked
from amulor.optics.small_angle._tables import PhaseFunction, Table, table

__all__ = ["Column", "overlap_of", "response_of"]

Array = NDArray[np.float64]


class Column(NamedTuple):
    """A column of water seen by an instrument (SI units)."""

    absorption: float
    scattering: float
    baseline: float
    receiver_radius: float
    acceptance_angle: float
    beam_radius: float
    beam_divergence: float
    tilt: float
    cross_tilt: float
    standoff: float
    end: float = np.inf

    def loss(self, spread: Table) -> float:
        """Return 2 k', by which light is lost on its way there and back [1/m]."""
        return 2 * (self.absorption + self.scattering * (1 - spread.fraction))


def overlap_of(
    light: Callable[[Array, Column, Table], Array],
    depth: ArrayLike,
    *,
    phase_function: PhaseFunction,
    split_angle: float,
    **column: ArrayLike,
) -> Array:
    """Return F(z), with light giving that of the depths of one column."""
    z, *columns = (np.asarray(value) for value in checked(depth=depth, **column))
    spread = table(phase_function, split_angle)
    return np.asarray(_by_column(light, z, columns, spread, dtype=float))


def response_of(
    integral: Callable[[Array, Column, Table], NDArray[np.complex128]],
    modulation_frequency: ArrayLike,
    *,
    phase_function: PhaseFunction,
    split_angle: float,
    backscatter_vsf: ArrayLike | None,
    group_index: ArrayLike,
    **column: ArrayLike,
) -> NDArray[np.complex128]:
    """Return the response, with integral giving that of exp(i w z) F(z) for many w."""
    f, n_g = checked(modulation_frequency=modulation_frequency, group_index=group_index)
    columns = [np.asarray(value) for value in checked(**column)]
    spread = table(phase_function, split_angle)
    if backscatter_vsf is None:
        at_180 = float(np.asarray(phase_function(np.array([np.pi])))[0])
        vsf = np.asarray(column["scattering"], dtype=float) * at_180
    else:
        (vsf,) = checked(backscatter_vsf=backscatter_vsf)
    wavenumber = np.asarray(4 * np.pi / speed_of_light * f * n_g)
    wavenumber = np.broadcast_to(
        wavenumber, np.broadcast_shapes(wavenumber.shape, np.shape(vsf))
    )
    result = _by_column(integral, wavenumber, columns, spread, dtype=complex)
    return np.asarray(vsf * result)


def _by_column(
    evaluate: Callable[[Array, Column, Table], Any],
    free: Array,
    columns: list[Array],
    spread: Table,
    *,
    dtype: type,
) -> Any:
    """Return what evaluate makes of the free argument, once for each column."""
    inner = np.broadcast_shapes(*(value.shape for value in columns))
    shape = np.broadcast_shapes(free.shape, inner)
    inner = (1,) * (len(shape) - len(inner)) + inner
    columns = [np.broadcast_to(value, inner) for value in columns]
    free = np.broadcast_to(free, shape)
    out: NDArray[Any] = np.empty(shape, dtype=dtype)
    # Axes along which only the free argument changes share one column.
    for index in np.ndindex(inner):
        place = tuple(
            slice(None) if size == 1 else slice(i, i + 1)
            for i, size in zip(index, inner, strict=True)
        )
        part = np.ascontiguousarray(free[place]).reshape(-1)
        column = Column(*(float(value[index]) for value in columns))
        out[place] = evaluate(part, column, spread).reshape(out[place].shape)
    return out
