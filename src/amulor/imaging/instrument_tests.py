"""Instrument tests from the data of a scan, with causes and remedial measurements."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube import QualityFlag, WaterResidualCause
from amulor.cube.error import (
    AMPLITUDE_PHASE,
    AMPLITUDE_PROBABILITY,
    FREQUENCY_PHASES,
    FREQUENCY_PROBABILITY,
    LARGEST_CHANCE,
    OUTPUT_STEP,
    OUTPUT_STEP_RATIO,
    UNCALIBRATED_SHARE,
)
from amulor.imaging.corners import is_corner_light
from amulor.imaging.observation import Observation, readable_survey
from amulor.optics import ambiguity, detection
from amulor.survey.properties import phase_uncertainty

Floats = NDArray[np.float64]

#: Pixels from which on a median is a good one.
_FEWEST_PIXELS = 10
#: Relative difference between the waters of scan and references that is usual [1].
_USUAL_CHANGE = 0.02
#: Tests that light of corners fails as well.
_FAILED_IN_CORNERS = ("references", "water", "channels", "frequencies", "methods")
#: A delay between channels explains their phases up to this share of the largest [1].
_LIKE_DELAY = 0.2


@dataclass(frozen=True, kw_only=True)
class FrequencyPhase:
    """Median phase deviation of each frequency from a common path, with probability."""

    phase: Floats
    """Deviation of each frequency from the common path [rad]."""
    probability: float
    """Probability of so large deviations by chance and stated errors [1]."""

    @property
    def is_real(self) -> bool:
        """Whether the deviations are significant."""
        return self.probability < LARGEST_CHANCE

    @property
    def size(self) -> float:
        """Norm of the deviations [rad]."""
        return float(np.linalg.norm(self.phase))

    @property
    def attributes(self) -> dict[str, float | Floats]:
        """Attributes of a range image; with the phases if these are significant."""
        values: dict[str, float | Floats] = {FREQUENCY_PROBABILITY: self.probability}
        if self.is_real:
            values[FREQUENCY_PHASES] = self.phase
        return values


def frequency_phase(
    observation: Observation, path: ambiguity.Path
) -> FrequencyPhase | None:
    """Test whether one path explains the phases of all frequencies; None if untestable.

    The path of each pixel is free. Errors that pixels share and the water that is left
    count for each frequency on its own. The stated phase error of the instrument does
    not: the hypothesis is an instrument without errors. If the phases of two
    frequencies contradict each other in all channels, the rejection method has stored
    this result. The darker and the brighter half of the pixels are tested, too, and
    the largest significant deviations count.
    """
    # From a vehicle, frequencies in turn belong to different distances.
    if len(observation.frequency) < 2 or observation.lag is not None:
        return None
    attributes = observation.channel.attrs
    if FREQUENCY_PHASES in attributes:
        return FrequencyPhase(
            phase=np.asarray(attributes[FREQUENCY_PHASES]),
            probability=float(attributes[FREQUENCY_PROBABILITY]),
        )
    valid = observation.usable & np.isfinite(path.length)
    valid &= ~path.left_out.any(axis=0)
    # Phases of two surfaces contradict each other without any error.
    valid &= (observation.flag & QualityFlag.MIXED) == 0
    if valid.sum() < _FEWEST_PIXELS:
        return None
    test = _deviations(observation, path, valid)
    # Errors that depend on the amplitude turn a part of the pixels.
    level = np.log(np.abs(np.where(valid, observation.signal, 1.0))).mean(axis=0)
    bright = level > np.median(level[valid])
    for part in (bright, ~bright):
        of_part = _deviations(observation, path, valid & part, tests=2)
        if of_part is None or not of_part.is_real:
            continue
        if test is None or not test.is_real or of_part.size > test.size:
            test = of_part
    return test


def _deviations(
    observation: Observation,
    path: ambiguity.Path,
    valid: NDArray[np.bool_],
    *,
    tests: int = 1,
) -> FrequencyPhase | None:
    """Test the phases of some pixels, one of several tests; None if untestable."""
    from scipy.special import chdtrc

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
        probability=min(1.0, tests * float(chdtrc(len(length) - 1, misfit))),
    )


@dataclass(frozen=True, kw_only=True)
class InstrumentTest:
    """One failed test of the instrument, in words."""

    name: str
    """Name: "references", "water", "channels", "frequencies", "amplitude", "drift",
    "methods", "resolution" or "calibration"."""
    result: str
    """Measured contradiction, with its size."""
    probability: float | None
    """Largest probability of such a result by chance; None if its size decides [1]."""
    cause: str
    """Probable causes."""
    measurement: str
    """Measurement that confirms or removes the cause."""


_LEAKAGE = (
    "block the receiver with the laser on (leakage), and calibrate the phase against "
    "the amplitude"
)


_WATER = "other water before the target than in the references"
_AMPLITUDE = "leakage, a phase that depends on the amplitude"


def instrument_tests(cube: xr.Dataset) -> tuple[InstrumentTest, ...]:
    """Return the failed tests of a target signal or range image."""
    tests = (
        _references, _water, _channels, _frequencies, _step, _drift, _methods,
        _resolution, _calibration,
    )  # fmt: skip
    failed = [result for test in tests if (result := test(cube)) is not None]
    if not _has_corner_light(cube):
        return tuple(failed)
    return tuple(
        replace(
            test,
            cause=f"light that corners reflect twice, or {test.cause}",
            measurement=f"scan a plate in the same water; {test.measurement}",
        )
        if test.name in _FAILED_IN_CORNERS
        else test
        for test in failed
    )


def _has_corner_light(cube: xr.Dataset) -> bool:
    """Return whether light of corners exceeds the other errors in a range image.

    The instrument's error does not count: it may be computed from phases that this
    light has changed.
    """
    if "slant_range_uncertainty_corners" not in cube:
        return False
    corners = cube["slant_range_uncertainty_corners"].values
    instrument = np.asarray(cube.get("slant_range_uncertainty_instrument", 0.0))
    total = cube["slant_range_uncertainty"].values
    rest = np.sqrt(np.maximum(total**2 - corners**2 - instrument**2, 0.0))
    return is_corner_light(corners, rest)


def _references(cube: xr.Dataset) -> InstrumentTest | None:
    """Test whether any water explains both the open-water references and the scan."""
    cause = np.asarray(cube.get("water_residual_cause", np.int8(0)))
    if "channel_phase_rad" in cube.attrs or not np.any(
        cause & WaterResidualCause.INSTRUMENT
    ):
        return None
    return InstrumentTest(
        name="references",
        result="no water explains the references and the scan",
        probability=None,
        cause=f"{_AMPLITUDE}, an offset of the demodulator, water that changes with "
        "the distance, or another position of the receiver than in the survey",
        measurement=_LEAKAGE,
    )


def _water(cube: xr.Dataset) -> InstrumentTest | None:
    """Test whether the scan and the open-water references have the same water."""
    from scipy.special import ndtr

    change = float(cube.attrs.get("open_water_change", 0.0))
    error = float(cube.attrs.get("open_water_change_uncertainty", 0.0))
    chance = 2 * float(ndtr(-abs(change) / np.hypot(_USUAL_CHANGE, error)))
    if not chance < LARGEST_CHANCE:
        return None
    further = (
        "phase errors of single frequencies, as by harmonics, reflections in a cable "
        "or the demodulator"
        if _frequency(cube).size > 1
        else "a delay between the channels"
    )
    return InstrumentTest(
        name="water",
        result=f"the water differs by {change:+.0%} from the references",
        probability=chance,
        cause=f"{_WATER}, {_AMPLITUDE}, or {further}",
        measurement=f"record references again; {_LEAKAGE}",
    )


def _channels(cube: xr.Dataset) -> InstrumentTest | None:
    """Test whether the echo has the same phase in all channels."""
    if "channel_phase_rad" not in cube.attrs:
        return None
    phase = np.atleast_1d(cube.attrs["channel_phase_rad"])
    cause, measurement = f"{_AMPLITUDE}, or {_WATER}", _LEAKAGE
    if _is_delay(phase, cube):
        cause = "a delay between the channels"
        measurement = "measure the delay of each channel with a plate"
    return InstrumentTest(
        name="channels",
        result=f"the channels differ by {1e3 * float(np.max(phase)):.3g} mrad",
        probability=float(cube.attrs["channel_phase_probability"]),
        cause=cause,
        measurement=measurement,
    )


def _is_delay(phase: Floats, cube: xr.Dataset) -> bool:
    """Return whether a single delay explains the phases at several frequencies."""
    frequency = _frequency(cube)
    if frequency.size != phase.size or phase.size < 2:
        return False
    slope = np.sum(frequency * phase) / np.sum(frequency**2)
    rest = np.abs(phase - slope * frequency)
    return bool(rest.max() < _LIKE_DELAY * phase.max())


def _frequency(cube: xr.Dataset) -> Floats:
    """Return the modulation frequencies of a target signal or a range image [Hz]."""
    if "modulation_frequency" in cube.coords:
        return np.atleast_1d(cube["modulation_frequency"].values)
    return np.atleast_1d(cube.attrs.get("modulation_frequencies", ()))


def _frequencies(cube: xr.Dataset) -> InstrumentTest | None:
    """Test whether the phases at all frequencies belong to one distance."""
    if FREQUENCY_PHASES not in cube.attrs:
        return None
    size = float(np.max(np.abs(cube.attrs[FREQUENCY_PHASES])))
    shared = (
        "harmonics, reflections in a cable, an error of the demodulator, a scale "
        "change, or frequencies without a calibration of their phase"
    )
    if "channel_phase_rad" in cube.attrs:
        cause = f"{_AMPLITUDE}, or {_WATER}"
    elif "channel_phase_probability" in cube.attrs:
        # Errors that depend on the echo differ between the channels.
        cause = shared
    else:
        cause = f"{_AMPLITUDE}, {_WATER}, {shared}"
    return InstrumentTest(
        name="frequencies",
        result=f"the frequencies differ from one distance by up to {1e3 * size:.3g} "
        "mrad",
        probability=float(cube.attrs[FREQUENCY_PROBABILITY]),
        cause=cause,
        measurement=f"{_LEAKAGE}; calibrate the phase of each frequency with a plate",
    )


def _step(cube: xr.Dataset) -> InstrumentTest | None:
    """Test whether neighbors of different brightness have phases of one distance."""
    if AMPLITUDE_PHASE not in cube.attrs:
        return None
    step = float(cube.attrs[AMPLITUDE_PHASE])
    return InstrumentTest(
        name="amplitude",
        result="the phases of brighter pixels differ from those of darker neighbors by "
        f"{1e3 * step:+.3g} mrad",
        probability=float(cube.attrs[AMPLITUDE_PROBABILITY]),
        cause="a phase that depends on the amplitude, or a scale change of the "
        "demodulator",
        measurement="calibrate the phase against the amplitude with a plate and "
        "filters, and hold the scale of the demodulator during the scan",
    )


def _drift(cube: xr.Dataset) -> InstrumentTest | None:
    """Test whether open-water references before and after a scan have equal delays."""
    if "instrument_drift_delay_s" not in cube.attrs:
        return None
    delays = np.atleast_1d(cube.attrs["instrument_drift_delay_s"])
    size = float(delays[np.argmax(np.abs(delays))])
    return InstrumentTest(
        name="drift",
        result=f"the delay of the references changed by {1e12 * size:.3g} ps",
        # Six standard errors, at any of several frequencies.
        probability=2e-9 * delays.size,
        cause="drift of the instrument, as by temperature; not a change of the water",
        measurement="let laser and detector warm up, and record references during the "
        "scan",
    )


def _methods(cube: xr.Dataset) -> InstrumentTest | None:
    """Test whether two rejection methods give the same distances."""
    if "method_disagreement_m" not in cube.attrs:
        return None
    size = float(cube.attrs["method_disagreement_m"])
    return InstrumentTest(
        name="methods",
        result=f"two rejection methods differ by {1e3 * size:.3g} mm",
        # Four standard errors.
        probability=6.4e-5,
        cause=f"{_AMPLITUDE}, or {_WATER}",
        measurement=_LEAKAGE,
    )


def _resolution(cube: xr.Dataset) -> InstrumentTest | None:
    """Test whether the steps of the outputs are finer than their stated noise."""
    ratio = float(cube.attrs.get(OUTPUT_STEP_RATIO, 0.0))
    if ratio <= 1:
        return None
    step = float(cube.attrs[OUTPUT_STEP])
    return InstrumentTest(
        name="resolution",
        result=f"the outputs have steps of {1e6 * step:.3g} uV, with an error of "
        f"{ratio:.3g} times the stated noise",
        probability=None,
        cause="the resolution of the demodulator or of the file; the stated error "
        "includes the rounding",
        measurement="choose a more sensitive range of the demodulator, or store more "
        "digits",
    )


def _calibration(cube: xr.Dataset) -> InstrumentTest | None:
    """Report samples outside calibrated amplitudes, or a missing phase calibration."""
    share = float(cube.attrs.get(UNCALIBRATED_SHARE, 0.0))
    survey = readable_survey(cube)
    if share > 0:
        result = f"{share:.1%} of the samples are beyond the calibrated amplitudes"
        cause = (
            "a brighter or darker target than in the calibration; the stated error "
            "includes the slope of the phase up to these amplitudes"
        )
    elif (
        cube.attrs.get("simulated", 0)
        or "calibration" in cube.attrs
        or survey is None
        or survey.instrument.phase_uncertainty is not None
    ):
        return None
    else:
        degrees = math.degrees(
            phase_uncertainty(survey, frequencies=_frequency(cube).size)
        )
        result = "the phases of the instrument are not calibrated"
        cause = (
            f"no calibration file and no phase_uncertainty in the survey; {degrees:g} "
            "degrees are assumed at each frequency"
        )
    return InstrumentTest(
        name="calibration",
        result=result,
        probability=None,
        cause=cause,
        measurement="measure a plate with filters (amulor calibrate plate)",
    )
