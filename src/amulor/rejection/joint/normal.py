"""Normal equations of the joint fit: water signal and derivatives from tables."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.covariance import times
from amulor.rejection.joint._kernels import model as model_kernels
from amulor.rejection.joint._kernels import normal as kernels
from amulor.rejection.joint._kernels.bundles import (
    Derivatives,
    Parameters,
    Signals,
    Sums,
)
from amulor.rejection.joint._kernels.compiled import FEWEST, spread
from amulor.rejection.joint.priors import Layout, Shared
from amulor.rejection.joint.samples import Pixels, coefficients, places, weight
from amulor.rejection.joint.tables import Table, from_pairs

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def water_at(
    pixels: Pixels, path: Floats, table: Table, phase_per_path: Floats
) -> tuple[Floats, Complex, Complex]:
    """Return depth [m], water signal of unit strength, and its path derivative."""
    count, frequencies = len(pixels), phase_per_path.size
    out = Signals(
        np.empty(count),
        np.empty((count, 2, frequencies)),
        np.empty((count, 2, frequencies)),
    )
    spread(
        model_kernels.water_at, count, path, places(pixels, table), table.arrays,
        phase_per_path, out,
    )  # fmt: skip
    return out.depth, from_pairs(out.water), from_pairs(out.change)


def foreground(pixels: Pixels, table: Table, phase_per_path: Floats) -> Complex:
    """Return the water signal from depths in front of all targets."""
    level = times(coefficients(pixels, table), table.level[:, None])[:, 0]
    turn: Complex = np.exp(1j * pixels.offset[:, None] * phase_per_path)
    return level[:, None] * turn


def all_changes(
    pixels: Pixels, depth: Floats, water: Complex, table: Table, phase_per_path: Floats
) -> Complex:
    """Return the derivatives of the water signal by its shape and drift parameters."""
    changes = shape_changes(pixels, depth, table, phase_per_path)
    if not pixels.trends.shape[1]:
        return changes
    by_time = pixels.trends[:, :, None] * water[:, None]
    return np.concatenate([changes, by_time], axis=1)


def shape_changes(
    pixels: Pixels, depth: Floats, table: Table, phase_per_path: Floats
) -> Complex:
    """Return the derivatives of the water signal by its shape parameters."""
    changes = table.changes
    shape = (len(pixels), len(changes.value), phase_per_path.size)
    out = np.empty(shape, dtype=complex)
    spread(
        model_kernels.interpolate, len(pixels), depth, table.step,
        coefficients(pixels, changes), changes.value.view(float), out.view(float),
    )  # fmt: skip
    turn = np.exp(1j * pixels.offset[:, None] * phase_per_path)
    out *= turn[:, None, :]
    return out


#: Sums that are added up side by side.
_PORTIONS = 8


@dataclass(frozen=True, kw_only=True)
class Normal:
    """Normal equations of the shared parameters, with pixel parameters eliminated."""

    matrix: Floats
    """Information matrix, (parameter, parameter)."""
    vector: Floats
    """Negative half gradient of the sum of squares."""
    square: float
    """Sum of squared errors in units of their standard deviation [1]."""
    freedom: int
    """Usable outputs less the parameters of single pixels."""

    def __add__(self, other: Normal) -> Normal:
        """Return the sum of the normal equations of two groups of samples."""
        return Normal(
            matrix=self.matrix + other.matrix,
            vector=self.vector + other.vector,
            square=self.square + other.square,
            freedom=self.freedom + other.freedom,
        )

    @classmethod
    def zero(cls, size: int) -> Normal:
        """Return the normal equations without samples."""
        return cls(
            matrix=np.zeros((size, size)), vector=np.zeros(size), square=0.0, freedom=0
        )


@dataclass(frozen=True)
class Fitted:
    """Samples with fitted optical paths and amplitudes."""

    pixels: Pixels
    """Samples."""
    path: Floats
    """Optical paths; infinite for open water [m]."""
    amplitude: Floats
    """Amplitude of the target in each channel, 0 for open water [V]."""
    is_shot: bool = False
    """Whether the samples are open-water shots, whose water may differ."""


@dataclass(frozen=True, kw_only=True)
class Modelled:
    """Parts of the signal model at each pixel's optical path."""

    water: Complex
    """Water signal of unit strength, (pixel, frequency) [1]."""
    slope: Complex
    """Derivative of the water signal with respect to the path [1/m]."""
    foreground: Complex
    """Water signal of unit strength from depths in front of all targets [1]."""
    echo: Complex
    """Modeled echo of unit amplitude, without departure; 0 for open water [1]."""
    depth: Floats
    """Depth where the water ends [m]."""
    water_signal: Complex
    """Water signal, (pixel, channel, frequency) [V]."""
    residual: Complex
    """Samples less the model; 0 for unusable samples [V]."""


def modelled(
    state: Shared, fitted: Fitted, *, transfer: Complex, phase_per_path: Floats
) -> Modelled:
    """Return the parts of the signal model, and the residuals of the samples."""
    pixels = fitted.pixels
    depth, water, slope = water_at(pixels, fitted.path, state.table, phase_per_path)
    front = foreground(pixels, state.table, phase_per_path)
    water_signal = state.water_signal(water, front)
    if fitted.is_shot:
        water_signal = state.shot_signal(water_signal, front)
    is_target = np.isfinite(fitted.path)
    path = np.where(is_target, fitted.path, 0.0)
    echo = np.exp(1j * path[:, None] * phase_per_path) * transfer
    echo[~is_target] = 0
    target_signal = fitted.amplitude[..., None] * (echo * (1 + state.echo))[:, None]
    model = water_signal + target_signal
    return Modelled(
        water=water,
        slope=slope,
        foreground=front,
        echo=echo,
        depth=depth,
        water_signal=water_signal,
        residual=np.where(pixels.usable, pixels.signal - model, 0),
    )


def path_derivatives(
    state: Shared, fitted: Fitted, model: Modelled, phase_per_path: Floats
) -> Complex:
    """Return the derivatives of the samples by the path of their pixel [V/m]."""
    echo = (model.echo * (1 + state.echo))[:, None]
    return np.asarray(
        1j * phase_per_path * fitted.amplitude[..., None] * echo
        + state.strength[:, None] * model.slope[:, None]
    )


def normal_equations(
    state: Shared,
    fitted: Fitted,
    layout: Layout,
    used: int,
    *,
    transfer: Complex,
    phase_per_path: Floats,
) -> Normal:
    """Return the normal equations of the first `used` parameters; 0 for the square."""
    pixels = fitted.pixels
    parts = modelled(state, fitted, transfer=transfer, phase_per_path=phase_per_path)
    deviation = None
    if state.fluctuation > 0:
        deviation = state.fluctuation * parts.water_signal
    is_target = np.isfinite(fitted.path)
    base = parts.water[:, None] + state.departure * parts.foreground[:, None]
    changes = np.zeros((len(pixels), 0, phase_per_path.size), dtype=complex)
    if used == layout.size:
        changes = all_changes(
            pixels, parts.depth, parts.water, state.table, phase_per_path
        )
    elif used:
        changes = shape_changes(pixels, parts.depth, state.table, phase_per_path)
    if fitted.is_shot:
        base = state.shot_factor * base
        changes = state.shot_factor * changes
    derivatives = Derivatives(
        residual=parts.residual,
        weight=weight(pixels, deviation, state.noise_scale),
        base=base,
        changes=changes,
        foreground=parts.foreground,
        echo=parts.echo,
        slope=parts.slope,
        amplitude=fitted.amplitude,
        is_target=is_target,
    )
    parameters = Parameters(
        strength=state.strength,
        factor=1 + state.echo,
        phase_per_path=phase_per_path,
        first_departure=layout.blocks[1].start,
        first_echo=layout.blocks[2].start,
        first_doubt=layout.doubt.start if fitted.is_shot and layout.doubts else -1,
        is_free=used == layout.size,
    )
    sums = Sums(
        matrix=np.zeros((_PORTIONS, used, used)),
        vector=np.zeros((_PORTIONS, used)),
        square=np.zeros(_PORTIONS),
    )
    spread(
        kernels.accumulate, _PORTIONS, derivatives, parameters, sums,
        fewest=math.ceil(_PORTIONS * FEWEST / max(len(pixels), 1)),
    )  # fmt: skip
    amplitudes = int(is_target.sum()) * (1 + fitted.amplitude.shape[1])
    return Normal(
        matrix=sums.matrix.sum(axis=0),
        vector=sums.vector.sum(axis=0),
        square=float(sums.square.sum()),
        freedom=2 * int(pixels.usable.sum()) - amplitudes,
    )
