"""Normal equations of what the pixels share, about an estimate of it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels import normal as kernels
from amulor.rejection.joint._kernels.bundles import Derivatives, Parameters, Sums
from amulor.rejection.joint._kernels.threads import FEWEST, spread
from amulor.rejection.joint.model import (
    all_changes,
    foreground,
    shape_changes,
    water_at,
)
from amulor.rejection.joint.pixels import Pixels, weight
from amulor.rejection.joint.priors import Layout, Shared

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Sums that are added up side by side.
_PORTIONS = 8


@dataclass(frozen=True, kw_only=True)
class Normal:
    """Normal equations of the shared parameters, the pixels' own eliminated."""

    matrix: Floats
    """Information, (parameter, parameter)."""
    vector: Floats
    """Half the downhill slope of the sum of squares."""
    square: float
    """Sum of squared errors in units of their standard deviation [1]."""
    freedom: int
    """Outputs that count, less the parameters that the pixels have of their own."""

    def __add__(self, other: Normal) -> Normal:
        """Return those of both groups of samples."""
        return Normal(
            matrix=self.matrix + other.matrix,
            vector=self.vector + other.vector,
            square=self.square + other.square,
            freedom=self.freedom + other.freedom,
        )

    @classmethod
    def zero(cls, size: int) -> Normal:
        """Return those of no samples at all."""
        return cls(
            matrix=np.zeros((size, size)), vector=np.zeros(size), square=0.0, freedom=0
        )


@dataclass(frozen=True)
class Fitted:
    """Samples with the paths and amplitudes that were fitted to them."""

    pixels: Pixels
    """Samples."""
    path: Floats
    """Optical paths; infinite for open water [m]."""
    amplitude: Floats
    """Amplitude of the target in each channel, 0 for open water [V]."""
    is_shot: bool = False
    """Whether they are open-water shots, which may be of other water."""


@dataclass(frozen=True, kw_only=True)
class Modelled:
    """Parts of the model at the paths of some pixels."""

    water: Complex
    """Water signal of unit strength, (pixel, frequency) [1]."""
    slope: Complex
    """Its derivative with respect to the path [1/m]."""
    foreground: Complex
    """Light of unit strength from in front of all targets [1]."""
    echo: Complex
    """Echo of unit amplitude, without its departure; 0 for open water [1]."""
    depth: Floats
    """Depth where the water ends [m]."""
    water_signal: Complex
    """Water signal, (pixel, channel, frequency) [V]."""
    residual: Complex
    """Samples less the model; 0 where none is usable [V]."""


def modelled(
    state: Shared, fitted: Fitted, *, transfer: Complex, phase_per_path: Floats
) -> Modelled:
    """Return the parts of the model, and the residual.

    Parameters
    ----------
    state : Shared
        What the pixels share.
    fitted : Fitted
        Samples with paths and amplitudes.
    transfer : ndarray of complex
        What the echo has beyond its delay, as known [1].
    phase_per_path : ndarray
        2 pi f / c_0 of each frequency [rad/m].

    Returns
    -------
    Modelled
        Arrays over the pixels.
    """
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


def normal_equations(
    state: Shared,
    fitted: Fitted,
    layout: Layout,
    used: int,
    *,
    transfer: Complex,
    phase_per_path: Floats,
) -> Normal:
    """Return the normal equations of the first parameters about a state.

    Parameters
    ----------
    state : Shared
        What the pixels share.
    fitted : Fitted
        Samples with paths and amplitudes.
    layout : Layout
        Where the parameters stand.
    used : int
        Number of parameters: all of them, or the parametric ones.
    transfer, phase_per_path : ndarray
        As in `modelled`.

    Returns
    -------
    Normal
        With the paths and amplitudes eliminated (Schur complement).
    """
    pixels = fitted.pixels
    parts = modelled(state, fitted, transfer=transfer, phase_per_path=phase_per_path)
    deviation = None
    if state.fluctuation > 0:
        deviation = state.fluctuation * parts.water_signal
    is_target = np.isfinite(fitted.path)
    base = parts.water[:, None] + state.departure * parts.foreground[:, None]
    changes = shape_changes(pixels, parts.depth, state.table, phase_per_path)
    if used == layout.size:
        changes = all_changes(
            pixels, parts.depth, parts.water, state.table, phase_per_path
        )
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
    own = int(is_target.sum()) * (1 + fitted.amplitude.shape[1])
    return Normal(
        matrix=sums.matrix.sum(axis=0),
        vector=sums.vector.sum(axis=0),
        square=float(sums.square.sum()),
        freedom=2 * int(pixels.usable.sum()) - own,
    )
