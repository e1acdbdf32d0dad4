"""Phase drift of the instrument, from open-water references around the scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.rejection.observation import Observation
from amulor.rejection.reference.shots import directions_of

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: A drift is corrected from so many standard errors on: 72 comparisons without a drift
#: reached 4.0 [1].
SIGNIFICANT = 6.0
#: Channels, or frequencies with one delay, agree unless chance makes it rarer [1].
_AGREE = 1e-3
#: Attributes with the corrected drift and its error in the scan, as delays [s].
DRIFT, DRIFT_UNCERTAINTY = (
    "instrument_drift_delay_s",
    "instrument_drift_uncertainty_s",
)


@dataclass(frozen=True, kw_only=True)
class PhaseDrift:
    """Phase change between the first and second half of a reference measurement."""

    phase: Floats
    """Change from the first to the second half, by frequency [rad]."""
    uncertainty: Floats
    """Standard uncertainty of the change [rad]."""


def without_drift(cube: xr.Dataset) -> xr.Dataset:
    """Correct samples and references for the phase drift of the instrument.

    A rotation that all channels of the reference share belongs to the instrument, and
    turns the target, too. The scan lies between the halves of the reference: half of
    the rotation is removed from it. The attributes `instrument_drift_delay_s` and
    `instrument_drift_uncertainty_s` state the drift and what is left of it, an even
    distribution over its size.
    """
    if DRIFT in cube.attrs or cube.attrs.get("level") != "samples":
        return cube
    shots = cube.amulor.open_water
    if shots is None:
        return cube
    if shots["in_phase"].ndim != 3:
        # One frequency or channel was selected: this restores its dimension.
        cube = cubes.checked(cube, "samples")
    drift = drift_of_references(cube)
    if drift is None:
        return cube
    late = np.arange(shots.sizes["shot"]) >= shots.sizes["shot"] // 2
    turn = np.exp(-1j * drift.phase)[:, None, None]
    turned = _turned(cube, np.exp(-0.5j * drift.phase)[:, None, None, None], "")
    turned |= _turned(cube, np.where(late, turn, 1.0), "open_water_")
    rate = 2 * np.pi * cube["modulation_frequency"].values
    remaining = np.sqrt(drift.phase**2 / 12 + drift.uncertainty**2 / 4)
    return cube.assign(turned).assign_attrs(
        {DRIFT: drift.phase / rate, DRIFT_UNCERTAINTY: remaining / rate}
    )


def drift_of_references(cube: xr.Dataset) -> PhaseDrift | None:
    """Estimate the phase drift common to all channels; None if not significant.

    The second half of the shots against the first, in the directions that both have.
    One delay stands for all frequencies where it explains them. A change that is
    rather one of strength belongs to the water.
    """
    from scipy.special import chdtrc

    shots = Observation(cube=cube).shots
    if shots is None or shots.signal.shape[-1] < 4:
        return None
    places = directions_of(shots, shots)
    _, group = np.unique(np.round(places, 9), axis=0, return_inverse=True)
    change, error = _halves(shots.signal, group.ravel())
    if change is None or error is None:
        return None
    # Channels of a frequency together.
    weight = error**-2
    mean = np.sum(weight * change, axis=1) / weight.sum(axis=1)
    uncertainty = weight.sum(axis=1) ** -0.5
    apart = np.sum(weight * (change.imag - mean.imag[:, None]) ** 2)
    channels, frequencies = change.shape[1], change.shape[0]
    freedom = frequencies * (channels - 1)
    agree = freedom == 0 or chdtrc(freedom, apart) > _AGREE
    significant = np.max(np.abs(mean.imag) / uncertainty) > SIGNIFICANT
    of_water = np.abs(mean.real).max() > np.abs(mean.imag).max()
    if not agree or not significant or of_water:
        return None
    rate = 2 * np.pi * cube["modulation_frequency"].values
    information = float(np.sum((rate / uncertainty) ** 2))
    delay = float(np.sum(rate * mean.imag / uncertainty**2)) / information
    misfit = float(np.sum(((mean.imag - rate * delay) / uncertainty) ** 2))
    if frequencies > 1 and chdtrc(frequencies - 1, misfit) > _AGREE:
        return PhaseDrift(phase=rate * delay, uncertainty=rate * information**-0.5)
    return PhaseDrift(phase=mean.imag, uncertainty=uncertainty)


def _halves(
    signal: Complex, group: NDArray[np.intp]
) -> tuple[Complex | None, Floats | None]:
    """Return change between halves of references, and error; None if undetermined.

    Shape (frequency, channel); None where the halves have too little in common.
    """
    late = np.arange(signal.shape[2]) >= signal.shape[2] // 2
    recorded = np.isfinite(signal).all(axis=(0, 1))
    change: Complex = np.zeros(signal.shape[:2], dtype=complex)
    square = np.zeros(signal.shape[:2])
    information, freedom = 0.0, 0
    for number in range(group.max() + 1):
        before, after = (
            signal[..., (group == number) & recorded & half] for half in (~late, late)
        )
        sizes = before.shape[2], after.shape[2]
        if min(sizes) == 0:
            continue
        level = (before.mean(axis=2) + after.mean(axis=2)) / 2
        if np.any(level == 0):
            return None, None
        means = [half.mean(axis=2) for half in (before, after)]
        weight = sizes[0] * sizes[1] / sum(sizes)
        change = change + weight * (means[1] - means[0]) / level
        information += weight
        for half, mean in zip((before, after), means, strict=True):
            rest = ((half - mean[..., None]) / level[..., None]).imag
            square = square + np.sum(rest**2, axis=2)
        freedom += sum(sizes) - 2
    if not information or freedom < 4:
        return None, None
    error: Floats = np.sqrt(square / freedom / information)
    if not np.all(error > 0):
        return None, None
    return change / information, error


def _turned(cube: xr.Dataset, turn: Complex, prefix: str) -> dict[str, xr.DataArray]:
    """Return samples multiplied by a phasor, as variables of the cube.

    Their errors keep their axes: a drift turns them by a few degrees at most.
    """
    outputs = [cube[f"{prefix}{part}"] for part in ("in_phase", "quadrature")]
    signal = (outputs[0].values + 1j * outputs[1].values) * turn
    turned = {
        outputs[0].name: outputs[0].copy(data=signal.real),
        outputs[1].name: outputs[1].copy(data=signal.imag),
    }
    return {str(name): values for name, values in turned.items()}
