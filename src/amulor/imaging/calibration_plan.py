"""Range errors due to the instrument, before and after each calibration."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.constants import speed_of_light

from amulor.optics import ranging
from amulor.optics._geometry import Geometry
from amulor.survey import Survey
from amulor.survey.calibration import Calibration
from amulor.survey.counting import reference_variance
from amulor.survey.properties import (
    MIXER,
    TEMPERATURE_UNCERTAINTY,
    group_index_uncertainty,
    phase_uncertainty,
    quadrature_phase_error,
    uncalibrated_factor,
)
from amulor.survey.view import medium_of

#: Uncertainty of a distance by tape measure, and of each receiver coordinate [m].
TAPE = 1e-3
#: Uncertainty of beam directions after an alignment [rad].
_ALIGNED = math.radians(0.05)
#: Drift of the delay in a scan, of 10 to 100 ps in the first hour [s].
_DRIFT = 30e-12
#: Change of the delay per degree: 10 m of coaxial cable at 100 ppm [s].
_PER_DEGREE = 5e-12
#: Delay between channels: 3 mm of another path or cable [s].
_BETWEEN_CHANNELS = 10e-12
#: Gain [1] and angle [rad] errors of the outputs after their calibration.
_OUTPUTS = 1e-3, math.radians(0.1)
#: Phase error of a standing reference that the survey does not describe [rad].
_READING = 1e-3
#: Uncertainties of temperature [degC] and practical salinity [1] by common probes.
_PROBE = {"temperature_uncertainty": 0.5, "salinity_uncertainty": 0.5}
#: Temperature [degC] and practical salinity [1] of water that states neither.
_STATE = {"temperature": 15.0, "salinity": 35.0}


@dataclass(frozen=True, kw_only=True)
class CalibrationLine:
    """Range error due to one property of the instrument."""

    name: str
    """Name of the property."""
    now: float | None
    """Standard uncertainty of the range by the survey as it is; None if unknown [m]."""
    calibrated: float
    """Standard uncertainty of the range after the calibration [m]."""
    how: str
    """Calibration, with the uncertainty that it is assumed to have."""

    @property
    def gain(self) -> float:
        """Decrease of the variance; infinite if the present error is unknown [m^2]."""
        if self.now is None:
            return math.inf
        return self.now**2 - min(self.now, self.calibrated) ** 2


def calibration_plan(survey: Survey, *, slant_range: float) -> list[CalibrationLine]:
    """Return instrument range errors at scan center, before and after each calibration.

    The frequencies are weighted by their squares, as those of equal phase noise. A
    calibration never makes a stated error larger. Without a standing reference, the
    delay drifts by 30 ps; half of a drift is subtracted.
    """
    geometry = Geometry(
        azimuth=np.array(survey.scan.azimuth),
        elevation=np.array(survey.scan.elevation),
        emitter=np.array(survey.instrument.emitter.position),
        receiver=np.array(survey.instrument.receiver.position),
        medium=medium_of(survey),
    )
    path = geometry.optical_path(np.array(slant_range))
    _, slope = geometry.slant_range_and_slope(path)
    stated = survey.calibration or Calibration()
    frequency = np.array(survey.instrument.modulation_frequencies)
    weight = frequency**2 / np.sum(frequency**2)
    per_phase = 2 * ranging.range_per_phase(frequency, group_index=1.0)
    by_phase = float(slope * np.linalg.norm(weight * per_phase))
    by_delay = float(slope * speed_of_light)
    place = stated.receiver_position_uncertainty
    turn = stated.direction_uncertainty
    index = group_index_uncertainty(survey)
    probed = survey.model_copy(
        update={
            "calibration": Calibration(**_PROBE),
            "water": survey.water.model_copy(
                update={
                    name: value
                    for name, value in _STATE.items()
                    if getattr(survey.water, name) is None
                }
            ),
        }
    )
    probed_index = group_index_uncertainty(probed)
    assert probed_index is not None
    referenced = survey.scan.reference is not None
    reading = _reading_error(survey)
    tape = 2 * geometry.medium.group_index * TAPE / speed_of_light
    lines = [
        (
            "delay",
            None
            if stated.delay_uncertainty is None
            else by_delay * stated.delay_uncertainty,
            by_delay * tape,
            "amulor calibrate plate, distance to 1 mm",
        ),
        (
            "drift",
            by_phase * reading if referenced else by_delay * _DRIFT / math.sqrt(12),
            by_phase * reading,
            "amulor calibrate reference, phase to 1 mrad",
        ),
        *_temperature_line(survey, by_delay),
        (
            "leakage, walk, harmonics",
            by_phase * phase_uncertainty(survey, demodulator_measured=True),
            by_phase
            * phase_uncertainty(
                survey,
                leakage_measured=True,
                demodulator_measured=True,
                phases_measured=True,
            ),
            "amulor calibrate leakage, then plate",
        ),
        *_demodulator_line(survey, by_phase),
        *_channel_line(survey, by_delay, by_phase),
        (
            "group index",
            None if index is None else float(geometry.error_by_index(path, index)),
            float(geometry.error_by_index(path, probed_index)),
            "temperature to 0.5 degC, salinity to 0.5",
        ),
        (
            "geometry",
            None
            if place is None or turn is None
            else float(geometry.error_by_place(path, place, turn)),
            float(geometry.error_by_place(path, TAPE, _ALIGNED)),
            "receiver to 1 mm, directions to 0.05 degrees",
        ),
    ]
    return [
        CalibrationLine(
            name=name,
            now=now,
            calibrated=calibrated if now is None else min(now, calibrated),
            how=how,
        )
        for name, now, calibrated, how in lines
    ]


def _temperature_line(
    survey: Survey, by_delay: float
) -> list[tuple[str, float | None, float, str]]:
    """Return a list with the temperature line; empty if other lines cover its error.

    A standing reference shows the effect of the temperature. A delay uncertainty that
    applies to the time of the scan contains it.
    """
    stated = survey.calibration or Calibration()
    warmer, slope = stated.instrument_temperature_uncertainty, stated.delay_per_degree
    unknown = warmer is None or slope is None
    if survey.scan.reference is not None or (
        unknown and stated.delay_uncertainty is not None
    ):
        return []
    recorded = survey.scan.instrument_temperature_uncertainty
    error = TEMPERATURE_UNCERTAINTY if recorded is None else recorded
    return [
        (
            "temperature",
            None if warmer is None or slope is None else by_delay * slope * warmer,
            by_delay * (_PER_DEGREE if slope is None else slope) * error,
            f"amulor calibrate temperature, temperature to {error:g} degC",
        )
    ]


def _demodulator_line(
    survey: Survey, by_phase: float
) -> list[tuple[str, float | None, float, str]]:
    """Return a list with the line of an analog demodulator; empty without one.

    A stated phase uncertainty contains the errors of the demodulator.
    """
    instrument = survey.instrument
    if (
        instrument.lock_in.demodulator != "analog"
        or instrument.phase_uncertainty is not None
    ):
        return []
    now, calibrated = (
        by_phase * float(quadrature_phase_error(*errors))
        for errors in (MIXER, _OUTPUTS)
    )
    now *= uncalibrated_factor(len(instrument.modulation_frequencies))
    how = "amulor calibrate demodulator, to 0.1 % and 0.1 degrees"
    return [("demodulator", now, calibrated, how)]


def _channel_line(
    survey: Survey, by_delay: float, by_phase: float
) -> list[tuple[str, float | None, float, str]]:
    """Return a list with the line of the delay between channels; empty for one.

    A stated phase uncertainty contains it.
    """
    instrument = survey.instrument
    if len(instrument.polarizations) < 2 or instrument.phase_uncertainty is not None:
        return []
    how = "amulor calibrate polarizer, phase to 1 mrad"
    return [("channels", by_delay * _BETWEEN_CHANNELS, by_phase * _READING, how)]


def _reading_error(survey: Survey) -> float:
    """Return the phase error of one reading of the standing reference [rad]."""
    reference = survey.scan.reference
    if reference is None:
        return _READING
    return math.sqrt(reference_variance(survey)) / reference.amplitude


def first_calibration(lines: list[CalibrationLine]) -> CalibrationLine | None:
    """Return the calibration that decreases the error most; None if none does.

    Unknown errors come first, in the order of the lines.
    """
    best = max(lines, key=lambda line: line.gain)
    return best if best.gain > 0 else None
