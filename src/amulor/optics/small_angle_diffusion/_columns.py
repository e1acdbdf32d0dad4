"""Integral of the diffusion form over the depth, for arguments of any shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics import _bounds
from amulor.optics._quadrature.rule import RULE
from amulor.optics._water_column import (
    Receiver,
    checked,
    phase_per_depth,
    refuse_behind_receiver,
)
from amulor.optics.small_angle_diffusion import _kernels

__all__ = ["Column", "integral"]

# A column shorter than this holds nothing that a double can tell from 0 [m].
_SMALLEST_LENGTH = 1e-250


@dataclass(frozen=True, kw_only=True)
class Column(Receiver):
    """Water in the diffusion form and the receiver it is seen by."""

    absorption: Any
    forward_scattering: Any
    diffuse_scattering: Any
    second_moment: Any

    @property
    def reduced_attenuation(self) -> Any:
        """k', by which light is lost on one way [1/m]."""
        return self.absorption + self.diffuse_scattering

    @property
    def spreading(self) -> Any:
        """Factor of z^3 in S(z) of eq. (43) [1/m]."""
        return 2 / 3 * self.forward_scattering * self.second_moment


def integral(
    column: Column,
    *,
    modulation_frequency: ArrayLike,
    group_index: ArrayLike,
    backscatter_vsf: ArrayLike,
    start: ArrayLike,
    end: ArrayLike,
) -> NDArray[np.complex128]:
    """Return beta_pi times the integral of eq. (46) between start and end."""
    refuse_behind_receiver(column.standoff)
    phases = phase_per_depth(modulation_frequency, group_index=group_index)
    vsf = checked("backscatter_vsf", backscatter_vsf)
    # Both limits are what the caller knows as the end of the water.
    start, end = checked("end", start), checked("end", end)
    try:
        return _integral(column, phases, vsf, start, end)
    except ValueError:
        # Says by name what does not broadcast, if that is the reason.
        _bounds.broadcast(
            modulation_frequency=phases,
            **column.named(),
            backscatter_vsf=vsf,
            end=end if np.ndim(end) else start,
        )
        raise


def _integral(
    column: Column, phase_per_depth: NDArray[np.float64], vsf: Any, start: Any, end: Any
) -> NDArray[np.complex128]:
    radius, acceptance = column.receiver_radius, column.acceptance_angle
    factor = np.pi * vsf * (radius * acceptance) ** 2
    geometry = _kernels.Geometry(
        reduced_attenuation=column.reduced_attenuation,
        spreading=column.spreading,
        baseline=column.baseline,
        receiver_radius=radius,
        acceptance_angle=acceptance,
        tilt=column.tilt,
        cross_tilt=column.cross_tilt,
        standoff=column.standoff,
        start=start * (start > _SMALLEST_LENGTH),
        end=end * (end > _SMALLEST_LENGTH),
    )
    if set(map(type, geometry)) == {float}:
        result = _integrals(np.array([geometry]), phase_per_depth.reshape(1, -1))
        return np.asarray(factor * result.reshape(phase_per_depth.shape))
    inner = np.broadcast_shapes(*(np.shape(value) for value in geometry))
    table = np.empty((*inner, len(geometry)))
    for i, value in enumerate(geometry):
        table[..., i] = value
    rows = table.reshape(-1, len(geometry))
    # Axes along which the water changes come first; along the others a column is
    # laid out in panels once for all frequencies.
    shape = np.broadcast_shapes(phase_per_depth.shape, inner)
    inner = (1,) * (len(shape) - len(inner)) + inner
    first = [axis for axis, size in enumerate(inner) if size != 1]
    axes = first + [axis for axis, size in enumerate(inner) if size == 1]
    outer = (1,) * (len(shape) - phase_per_depth.ndim) + phase_per_depth.shape
    if any(outer[axis] != 1 for axis in first):
        phases = np.broadcast_to(phase_per_depth, shape).transpose(axes)
        phases = phases.reshape(len(rows), -1)
    else:
        phases = phase_per_depth.reshape(outer).transpose(axes).reshape(1, -1)
    result = _integrals(rows, phases).reshape([shape[axis] for axis in axes])
    return np.asarray(factor * result.transpose(np.argsort(axes)))


def _integrals(
    rows: NDArray[np.float64], phase_per_depth: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """Return the integrals of the kernel, for frequencies in any order."""
    out = np.empty((len(rows), phase_per_depth.shape[1]), dtype=complex)
    # Copied, since a view may be read-only, for which the kernel is compiled again.
    phases = np.array(phase_per_depth, order="C")
    unresolved = _kernels.water_column(rows, phases, RULE, out)
    if unresolved < 0:
        order = np.argsort(phase_per_depth, axis=1)
        rising = np.take_along_axis(phase_per_depth, order, axis=1)
        back = np.argsort(order, axis=1)
        return np.take_along_axis(_integrals(rows, rising), back, axis=1)
    if unresolved > 0:
        raise ArithmeticError(
            f"{unresolved} of {len(rows)} water columns cannot be integrated in double "
            "precision; receiver_radius or acceptance_angle may be far too small"
        )
    return out
