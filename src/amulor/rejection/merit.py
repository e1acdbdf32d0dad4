"""How good each frequency and channel is with the water left in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import UNUSABLE
from amulor.optics import detection, interference, ranging
from amulor.rejection import quality
from amulor.rejection.build import covariance_of
from amulor.rejection.open_water import fit_shots, shots_of
from amulor.rejection.reference import column
from amulor.rejection.reference.fit import Covariance, fluctuation, stacked

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Merit:
    """Figures of merit, arrays over (modulation_frequency, polarization).

    Medians over the pixels that show a target; not a number where none does.
    """

    amplitude: Floats
    """Amplitude of target and water together [V]."""
    water_amplitude: Floats
    """Amplitude of the water in front of the target [V]."""
    ratio: Floats
    """Signal-to-optical-noise ratio, of (54) [1]."""
    contrast: Floats
    """Contrast against the water, of (54) [1]."""
    noise: Floats
    """Random error of the slant range, fluctuation of the water included [m]."""
    shift: Floats
    """Root mean square shift of the slant range by the water left in [m]."""
    usable: Floats
    """Share of the pixels that show a target [1]."""

    @property
    def error(self) -> Floats:
        """Noise and shift together [m]."""
        return np.hypot(self.noise, self.shift)


@dataclass(frozen=True)
class Water:
    """The water signal of every sample, from the open-water shots."""

    signal: Complex
    """Water signal up to the target, or to the end where that is not known [V]."""
    stray: Covariance
    """How it fluctuates [V^2]."""
    common: Covariance
    """Error of the reference, which the pixels share [V^2]."""
    settled: NDArray[np.bool_]
    """True where the column that ends at the target is known."""


def water_of(cube: xr.Dataset, *, interval: tuple[float, float] | None) -> Water:
    """Return the water signal in front of the target of every sample.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with open-water shots.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    Water
        Arrays of the shape of the samples.

    Raises
    ------
    CubeError
        As `open_water`.
    """
    fits = fit_shots(cube, shots_of(cube))
    signal = cube.amulor.signal.values
    shape = signal.shape
    water = np.array([fit.signal for fit in fits]).reshape(shape)
    common = stacked([fit.common for fit in fits], shape)
    target = interference.target_signal(signal, water)
    hidden = column.hidden_share(
        cube, target, covariance_of(cube) + common, interval=interval
    )
    settled = np.ones(shape, dtype=bool)
    if hidden is not None:
        settled = np.isfinite(hidden)
        water = (1 - np.nan_to_num(hidden)) * water
    stray = stacked(
        [
            fluctuation(fit.relative, level.ravel())
            for fit, level in zip(fits, water.reshape(-1, *shape[2:]), strict=True)
        ],
        shape,
    )
    return Water(water, stray, common, settled)


def merit(cube: xr.Dataset, *, interval: tuple[float, float] | None) -> Merit:
    """Return the figures of merit of every frequency and channel.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with open-water shots.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    Merit
        Arrays over (modulation_frequency, polarization).

    Raises
    ------
    CubeError
        As `open_water`.
    """
    water = water_of(cube, interval=interval)
    signal = cube.amulor.signal.values
    target = interference.target_signal(signal, water.signal)
    errors = covariance_of(cube) + water.stray
    flag = quality.flags(cube, target, errors + water.common)
    usable = ((flag & UNUSABLE) == 0) & (target != 0) & (signal != 0)
    sure = np.where(usable, signal, 1.0)
    phase = detection.phase_uncertainty(
        sure,
        in_phase_variance=np.where(usable, errors.in_phase, 0.0),
        quadrature_variance=np.where(usable, errors.quadrature, 0.0),
        covariance=np.where(usable, errors.cross, 0.0),
    )
    turned = interference.phase_error(
        np.where(usable, target, 1.0), np.where(usable, water.signal, 0.0)
    )
    to_range = ranging.range_per_phase(
        cube["modulation_frequency"].values[:, None],
        group_index=float(cube["geometry"].attrs["group_index"]),
    )
    amplitude = _median(np.abs(signal), usable)
    water_amplitude = _median(np.abs(water.signal), usable)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(water.signal == 0, np.inf, np.abs(signal / water.signal))
    contrast = interference.contrast(sure, np.where(usable, water.signal, 0.0))
    return Merit(
        amplitude=amplitude,
        water_amplitude=water_amplitude,
        ratio=_median(ratio, usable),
        contrast=_median(contrast, usable),
        noise=to_range * _median(phase, usable),
        shift=to_range * np.sqrt(_mean(turned**2, usable)),
        usable=usable.mean(axis=(2, 3)),
    )


def _median(values: Floats, usable: NDArray[np.bool_]) -> Floats:
    found = np.full(values.shape[:2], np.nan)
    for index in np.ndindex(found.shape):
        if usable[index].any():
            found[index] = np.median(values[index][usable[index]])
    return found


def _mean(values: Floats, usable: NDArray[np.bool_]) -> Floats:
    count = usable.sum(axis=(2, 3)).astype(float)
    total = np.where(usable, values, 0.0).sum(axis=(2, 3))
    mean: Floats = np.divide(
        total, count, out=np.full(count.shape, np.nan), where=count > 0
    )
    return mean
