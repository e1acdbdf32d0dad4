"""Normal equations of what the pixels share, about an estimate of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.joint._kernels import normal as kernels
from amulor.rejection.joint.model import near, shape_changes, water_at
from amulor.rejection.joint.pixels import Pixels, weight
from amulor.rejection.joint.priors import Layout, Shared

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Sums that are added up side by side.
_PORTIONS = 8


@dataclass(frozen=True)
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
            self.matrix + other.matrix,
            self.vector + other.vector,
            self.square + other.square,
            self.freedom + other.freedom,
        )


@dataclass(frozen=True)
class Seen:
    """Samples with what is thought to stand before the receiver."""

    pixels: Pixels
    """Samples."""
    path: Floats
    """Optical paths; infinite for open water [m]."""
    amplitude: Floats
    """Amplitude of the target in each channel, 0 for open water [V]."""


@dataclass(frozen=True)
class Modelled:
    """Parts of the model at the paths of some pixels."""

    water: Complex
    """Water signal of unit strength, (pixel, frequency) [1]."""
    slope: Complex
    """Its derivative with respect to the path [1/m]."""
    near: Complex
    """Light of unit strength from in front of all targets [1]."""
    echo: Complex
    """Echo of unit amplitude, without its departure; 0 for open water [1]."""
    depth: Floats
    """Depth where the water ends [m]."""
    light: Complex
    """Water signal, (pixel, channel, frequency) [V]."""
    left: Complex
    """Samples less the model; 0 where none is usable [V]."""


def modelled(
    state: Shared, seen: Seen, *, transfer: Complex, wavenumber: Floats
) -> Modelled:
    """Return the parts of the model, and what it leaves over.

    Parameters
    ----------
    state : Shared
        What the pixels share.
    seen : Seen
        Samples with paths and amplitudes.
    transfer : ndarray of complex
        What the echo has beyond its delay, as known [1].
    wavenumber : ndarray
        Phase per path of each frequency [1/m].

    Returns
    -------
    Modelled
        Arrays over the pixels.
    """
    pixels = seen.pixels
    depth, water, slope = water_at(pixels, seen.path, state.table, wavenumber)
    start = near(pixels, state.table, wavenumber)
    light = state.light(water, start)
    is_target = np.isfinite(seen.path)
    path = np.where(is_target, seen.path, 0.0)
    echo = np.exp(1j * path[:, None] * wavenumber) * transfer
    echo[~is_target] = 0
    model = light + seen.amplitude[..., None] * (echo * (1 + state.echo))[:, None]
    left = np.where(pixels.usable, pixels.signal - model, 0)
    return Modelled(water, slope, start, echo, depth, light, left)


def normal_equations(
    state: Shared,
    seen: Seen,
    layout: Layout,
    used: int,
    *,
    transfer: Complex,
    wavenumber: Floats,
) -> Normal:
    """Return the normal equations of the first parameters about a state.

    Parameters
    ----------
    state : Shared
        What the pixels share.
    seen : Seen
        Samples with paths and amplitudes.
    layout : Layout
        Where the parameters stand.
    used : int
        Number of parameters: all of them, or the parametric ones.
    transfer, wavenumber : ndarray
        As in `modelled`.

    Returns
    -------
    Normal
        With the paths and amplitudes eliminated (Schur complement).
    """
    pixels = seen.pixels
    parts = modelled(state, seen, transfer=transfer, wavenumber=wavenumber)
    stray = state.fluctuation * parts.light if state.fluctuation > 0 else None
    base = parts.water[:, None] + state.departure * parts.near[:, None]
    changes = shape_changes(pixels, parts.depth, state.table, wavenumber)
    is_target = np.isfinite(seen.path)
    matrix = np.zeros((_PORTIONS, used, used))
    vector = np.zeros((_PORTIONS, used))
    square = np.zeros(_PORTIONS)
    kernels.accumulate(
        parts.left,
        weight(pixels, stray),
        base,
        changes,
        parts.near,
        state.strength,
        parts.echo,
        1 + state.echo,
        seen.amplitude,
        parts.slope,
        wavenumber,
        is_target,
        layout.blocks[1].start,
        layout.blocks[2].start,
        used == layout.size,
        matrix,
        vector,
        square,
    )
    own = int(is_target.sum()) * (1 + seen.amplitude.shape[1])
    return Normal(
        matrix.sum(axis=0),
        vector.sum(axis=0),
        float(square.sum()),
        2 * int(pixels.usable.sum()) - own,
    )
