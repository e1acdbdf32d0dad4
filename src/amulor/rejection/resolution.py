"""Resolution of the demodulator's outputs: steps of the values, and their error."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube.error import OUTPUT_STEP, OUTPUT_STEP_RATIO
from amulor.rejection.observation import Observation

Floats = NDArray[np.float64]

#: Largest number of values of which a step is found.
_MOST = 4096
#: Least number of distinct values of which a step is found.
_FEWEST = 6
#: Values that differ by less, in parts of the largest, are equal [1].
_EQUAL = 1e-6
#: Largest root mean square distance from a multiple of the step, in parts of it [1].
_OFF_GRID = 0.02
#: A step below this multiple of the stated noise has no effect [1].
_LEAST = 0.5
#: Noise of this fraction of a step makes the rounding errors of repeats independent.
_DITHER = 0.5
#: Long name of the errors that all references share.
_SHARED = "error that all shots share, from the resolution of the outputs"


@dataclass(frozen=True, kw_only=True)
class Resolution:
    """Steps of the outputs of a scan and its references, arrays (frequency, channel).

    0 where the values are on no grid, or its step is small against the noise [V].
    """

    scan: Floats
    """Steps of the pixels."""
    shots: Floats | None
    """Steps of the open-water references; None without references."""

    @property
    def is_coarse(self) -> bool:
        """Whether any step is not small against the noise."""
        steps = (self.scan, self.shots)
        return any(step is not None and np.any(step > 0) for step in steps)


def resolution_of(scan: Observation) -> Resolution:
    """Estimate the steps of the outputs from values that are multiples of a step."""
    steps = _steps(scan)
    if scan.shots is None:
        return Resolution(scan=steps, shots=None)
    shots = _steps(scan.shots)
    # Few directions have few values: a coarse step shows in the pixels alone.
    return Resolution(
        scan=_if_on_grid(scan, steps, shots),
        shots=_if_on_grid(scan.shots, shots, steps),
    )


def _steps(samples: Observation) -> Floats:
    """Return the steps of the outputs of pixels or references [V]."""
    noise = _noise_of(samples)
    steps = np.zeros(noise.shape)
    for index in np.ndindex(steps.shape):
        step = step_of(_values(samples, index))
        # A step without a stated error has no ratio to it.
        if step > _LEAST * noise[index] > 0:
            steps[index] = step
    return steps


def _values(samples: Observation, index: tuple[int, ...]) -> Floats:
    """Return values of both outputs at a frequency and channel [V]."""
    values = samples.signal[index][samples.usable[index]]
    values = values[:: max(1, values.size // _MOST)]
    return np.concatenate([values.real, values.imag])


def _if_on_grid(samples: Observation, steps: Floats, others: Floats) -> Floats:
    """Return steps, with the other ones where there is none and values agree [V]."""
    noise = _noise_of(samples)
    steps = steps.copy()
    for index in np.argwhere((steps == 0) & (others > _LEAST * noise) & (noise > 0)):
        place = tuple(map(int, index))
        counts = _values(samples, place) / others[place]
        if np.sqrt(np.mean((counts - np.round(counts)) ** 2)) < _OFF_GRID:
            steps[place] = others[place]
    return steps


def _noise_of(samples: Observation) -> Floats:
    """Return the median stated noise of an output, (frequency, channel) [V]."""
    noise = np.sqrt(samples.covariance.in_phase)
    noise = np.where(samples.usable, noise, np.nan).reshape(*noise.shape[:2], -1)
    none = ~np.isfinite(noise).any(axis=-1)
    noise[none] = 0.0
    median: Floats = np.nanmedian(noise, axis=-1)
    return median


def step_of(values: Floats) -> float:
    """Return the step of which all values are multiples plus a constant; 0 if none."""
    ordered = np.unique(values)
    if ordered.size < _FEWEST:
        return 0.0
    gaps = np.diff(ordered)
    gaps = gaps[gaps > _EQUAL * np.abs(ordered).max()]
    if gaps.size < _FEWEST - 1:
        return 0.0
    counts = np.round(gaps / gaps.min())
    step = float(gaps.sum() / counts.sum())
    off = gaps / step - np.round(gaps / step)
    return step if np.sqrt(np.mean(off**2)) < _OFF_GRID else 0.0


def with_resolution(scan: Observation, resolution: Resolution) -> Observation:
    """Add the rounding error of the outputs to the stated errors of a scan.

    A rounding error has the standard deviation of a uniform distribution, the step over
    the root of 12. Repeats of a reference share it where their noise is below half of
    the step: it is an error of all references then, too.
    """
    if not resolution.is_coarse or OUTPUT_STEP in scan.cube.attrs:
        return scan
    larger: dict[str, xr.DataArray] = {}
    largest, ratio = 0.0, 0.0
    for prefix, steps, samples in (
        ("", resolution.scan, scan),
        ("open_water_", resolution.shots, scan.shots),
    ):
        if steps is None or samples is None:
            continue
        error, noise = steps * 12**-0.5, _noise_of(samples)
        axes = tuple(range(2, samples.signal.ndim))
        largest = max(largest, float(np.max(steps)))
        coarse = steps > 0
        ratio = max(ratio, float(np.max(error[coarse] / noise[coarse], initial=0.0)))
        for name in ("in_phase_uncertainty", "quadrature_uncertainty"):
            values = scan.cube[f"{prefix}{name}"]
            added = np.hypot(values.values, np.expand_dims(error, axes))
            larger[f"{prefix}{name}"] = values.copy(data=added)
        if prefix:
            shared = np.where(noise < _DITHER * steps, error, 0.0)
            larger |= _common(scan.cube, shared)
    attributes = {OUTPUT_STEP: largest, OUTPUT_STEP_RATIO: ratio}
    return Observation(cube=scan.cube.assign(larger).assign_attrs(attributes))


def _common(cube: xr.Dataset, error: Floats) -> dict[str, xr.DataArray]:
    """Return variables for an error that all references share, added to the present."""
    first = cube["open_water_in_phase"]
    added: dict[str, xr.DataArray] = {}
    for name in ("in_phase", "quadrature"):
        key = f"open_water_common_{name}_uncertainty"
        present = cube[key].values if key in cube else 0.0
        added[key] = xr.DataArray(
            np.hypot(error, present),
            dims=first.dims[:2],
            attrs={"units": "V", "long_name": _SHARED},
        )
    key = "open_water_common_covariance"
    if key not in cube:
        zero = np.zeros_like(error)
        added[key] = xr.DataArray(
            zero, dims=first.dims[:2], attrs={"units": "V2", "long_name": _SHARED}
        )
    return added
