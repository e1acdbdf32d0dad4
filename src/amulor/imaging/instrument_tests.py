"""Instrument tests from the data of a scan, with causes and remedial measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import QualityFlag
from amulor.imaging.observation import Observation
from amulor.optics import ambiguity, detection

Floats = NDArray[np.float64]

#: A test fails where chance makes a result so large in fewer cases [1].
LARGEST_CHANCE = 1e-4
#: Frequencies from which on their phases can contradict each other for a whole scan.
_FEWEST_FREQUENCIES = 3
#: Pixels from which on a median is a good one.
_FEWEST_PIXELS = 10
#: Attributes with the result of the test of the frequencies.
PROBABILITY, PHASES = "frequency_phase_probability", "frequency_phase_rad"


@dataclass(frozen=True, kw_only=True)
class FrequencyPhase:
    """Phase deviations of all frequencies from a common optical path, scan medians."""

    phase: Floats
    """Deviation of each frequency from the common path [rad]."""
    probability: float
    """Probability of so large deviations by chance and stated errors [1]."""

    @property
    def attributes(self) -> dict[str, float | Floats]:
        """Attributes of a range image; the phases only where they are significant."""
        values: dict[str, float | Floats] = {PROBABILITY: self.probability}
        if self.probability < LARGEST_CHANCE:
            values[PHASES] = self.phase
        return values


def frequency_phase(
    observation: Observation, path: ambiguity.Path
) -> FrequencyPhase | None:
    """Test whether a common path explains the phases; None with too few frequencies.

    The path of each pixel is free. Errors that pixels share and the water that is left
    count for each frequency on its own. The stated phase error of the instrument does
    not: the hypothesis is an instrument without errors.
    """
    from scipy.special import chdtrc

    if len(observation.frequency) < _FEWEST_FREQUENCIES:
        return None
    valid = observation.usable & np.isfinite(path.length)
    valid &= ~path.left_out.any(axis=0)
    # Phases of two surfaces contradict each other without any error.
    valid &= (observation.flag & QualityFlag.MIXED) == 0
    if valid.sum() < _FEWEST_PIXELS:
        return None
    middle = np.median((path.residual / observation.path_per_phase)[:, valid], axis=1)
    random = np.median(observation.own_sigma[:, valid], axis=1)
    shared = observation.shared_sigma(observation.usable)
    parts = [detection.ERROR_OF_MEDIAN * random / np.sqrt(valid.sum())]
    if shared is not None:
        parts.append(np.median(shared[:, valid], axis=1))
    shift = np.abs(observation.shift[:, valid])
    if not np.isfinite(shift).all():
        return None
    parts.append(np.median(shift, axis=1))
    error = np.sqrt(np.sum(np.square(parts), axis=0))
    if not np.all(error > 0):
        return None
    # As paths: one path is free for the scan, too.
    length = middle * observation.path_per_phase.ravel()
    weight = (error * observation.path_per_phase.ravel()) ** -2.0
    length = length - np.sum(weight * length) / np.sum(weight)
    misfit = float(np.sum(weight * length**2))
    return FrequencyPhase(
        phase=length / observation.path_per_phase.ravel(),
        probability=float(chdtrc(len(length) - 1, misfit)),
    )


@dataclass(frozen=True, kw_only=True)
class InstrumentTest:
    """One failed test of the instrument, in words."""

    name: str
    """Name: "channels", "frequencies", "drift" or "methods"."""
    result: str
    """Measured contradiction, with its size."""
    probability: float
    """Largest probability of such a result by chance [1]."""
    cause: str
    """Probable causes."""
    measurement: str
    """Measurement for confirmation or removal of the cause."""


_LEAKAGE = (
    "block the receiver with the laser on (leakage), and calibrate the phase against "
    "the amplitude"
)


def instrument_tests(cube: xr.Dataset) -> tuple[InstrumentTest, ...]:
    """Return the failed tests of a target signal or range image."""
    attributes = cube.attrs
    failed = []
    if "channel_phase_rad" in attributes:
        size = float(np.max(attributes["channel_phase_rad"]))
        failed.append(
            InstrumentTest(
                name="channels",
                result=f"the channels differ by {1e3 * size:.3g} mrad",
                probability=float(attributes["channel_phase_probability"]),
                cause="leakage, a phase that depends on the amplitude, or other water "
                "before the target than in the references",
                measurement=_LEAKAGE,
            )
        )
    if PHASES in attributes:
        size = float(np.max(np.abs(attributes[PHASES])))
        failed.append(
            InstrumentTest(
                name="frequencies",
                result=f"the frequencies differ from one distance by up to "
                f"{1e3 * size:.3g} mrad",
                probability=float(attributes[PROBABILITY]),
                cause="leakage, harmonics, reflections in a cable, or other water than "
                "that of the survey",
                measurement=f"{_LEAKAGE}; calibrate the phase of each frequency with a "
                "plate",
            )
        )
    if "instrument_drift_delay_s" in attributes:
        delays = np.atleast_1d(attributes["instrument_drift_delay_s"])
        size = float(delays[np.argmax(np.abs(delays))])
        failed.append(
            InstrumentTest(
                name="drift",
                result=f"the delay of the references changed by {1e12 * size:.3g} ps",
                # Six standard errors, at any of several frequencies.
                probability=2e-9 * delays.size,
                cause="drift of the instrument, as by temperature; not a change of the "
                "water",
                measurement="let laser and detector warm up, and record references "
                "during the scan",
            )
        )
    if "method_disagreement_m" in attributes:
        size = float(attributes["method_disagreement_m"])
        failed.append(
            InstrumentTest(
                name="methods",
                result=f"two rejection methods differ by {1e3 * size:.3g} mm",
                # Four standard errors.
                probability=6.4e-5,
                cause="leakage, a phase that depends on the amplitude, or other water "
                "before the target than in the references",
                measurement=_LEAKAGE,
            )
        )
    return tuple(failed)
