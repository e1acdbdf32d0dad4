"""Integral of the diffusion form over the depth, for arguments of any shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.optics._quadrature.rule import RULE
from amulor.optics._small_angle_arguments import checked
from amulor.optics.small_angle_diffusion import _kernels

__all__ = ["integral"]

# A column shorter than this holds nothing that a double can tell from 0 [m].
_SMALLEST_LENGTH = 1e-250


def integral(**arguments: ArrayLike) -> NDArray[np.complex128]:
    """Return the integral of eq. (46) between start and end."""
    f, a, b_f, b_d, moment, vsf, n_g, rho, radius, acceptance, *rest = checked(
        **arguments
    )
    wavenumber = np.asarray(4 * np.pi / speed_of_light * f * n_g)
    factor = np.pi * vsf * (radius * acceptance) ** 2
    *rest, start, end = rest
    columns = [a + b_d, 2 / 3 * b_f * moment, rho, radius, acceptance, *rest]
    columns += [limit * (limit > _SMALLEST_LENGTH) for limit in (start, end)]
    if all(isinstance(column, float) for column in columns):
        result = _integrals(np.array([columns]), wavenumber.reshape(1, -1))
        return np.asarray(factor * result.reshape(wavenumber.shape))
    inner = np.broadcast_shapes(*(np.shape(column) for column in columns))
    geometry = np.empty((*inner, len(columns)))
    for i, column in enumerate(columns):
        geometry[..., i] = column
    rows = geometry.reshape(-1, len(columns))
    # Axes along which the water changes come first; along the others a column is
    # laid out in panels once for all frequencies.
    shape = np.broadcast_shapes(wavenumber.shape, inner)
    inner = (1,) * (len(shape) - len(inner)) + inner
    first = [axis for axis, size in enumerate(inner) if size != 1]
    axes = first + [axis for axis, size in enumerate(inner) if size == 1]
    outer = (1,) * (len(shape) - wavenumber.ndim) + wavenumber.shape
    if any(outer[axis] != 1 for axis in first):
        table = np.broadcast_to(wavenumber, shape).transpose(axes)
        table = table.reshape(len(rows), -1)
    else:
        table = wavenumber.reshape(outer).transpose(axes).reshape(1, -1)
    result = _integrals(rows, table).reshape([shape[axis] for axis in axes])
    return np.asarray(factor * result.transpose(np.argsort(axes)))


def _integrals(
    rows: NDArray[np.float64], wavenumber: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Return the integrals of the kernel, for wavenumbers in any order."""
    out = np.empty((len(rows), wavenumber.shape[1]), dtype=complex)
    # Copied, since a view may be read-only, for which the kernel is compiled again.
    table = np.array(wavenumber, order="C")
    unresolved = _kernels.water_column(rows, table, RULE, out)
    if unresolved < 0:
        order = np.argsort(wavenumber, axis=1)
        rising = np.take_along_axis(wavenumber, order, axis=1)
        back = np.argsort(order, axis=1)
        return np.take_along_axis(_integrals(rows, rising), back, axis=1)
    if unresolved > 0:
        raise ArithmeticError(
            f"{unresolved} of {len(rows)} water columns cannot be integrated in double "
            "precision; receiver_radius or acceptance_angle may be far too small"
        )
    return out
