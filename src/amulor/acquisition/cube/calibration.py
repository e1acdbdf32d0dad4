"""Calibration of an instrument: its measured errors, and their correction."""

from __future__ import annotations

import datetime
import math
import warnings
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Self, TypeVar

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from pydantic import Field, model_validator

from amulor import cube as cubes
from amulor.cube.error import UNCALIBRATED_SHARE
from amulor.errors import CubeError, FormatError
from amulor.optics import detection
from amulor.rejection.covariance import Covariance, along
from amulor.rejection.observation import Observation
from amulor.survey import toml_file
from amulor.survey.properties import TEMPERATURE_UNCERTAINTY, quadrature_phase_error
from amulor.survey.quantity import (
    Angle,
    Description,
    Frequency,
    Temperature,
    Time,
    Voltage,
)

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Relative difference up to which two frequencies are equal: a read-back one varies in
#: its last digits, and a delay of 5 ns changes by 1.2 mrad at 39 MHz for this much [1].
_SAME_FREQUENCY = 1e-3
#: Bit of `user_sample_flag`: the amplitude is outside of the calibration.
UNCALIBRATED = 32
#: Cross-talk of a channel is smaller [1].
MOST_CROSSTALK = 0.5


class FrequencyCalibration(Description):
    """Phase delay of the instrument at one modulation frequency."""

    modulation_frequency: Annotated[Frequency, Field(gt=0)]
    """Modulation frequency [Hz]."""
    amplitudes: Annotated[
        tuple[Annotated[Voltage, Field(gt=0)], ...], Field(min_length=1)
    ]
    """Peak amplitudes of the calibration, increasing [V]."""
    phases: tuple[Angle, ...]
    """Phase delay at each amplitude [rad]."""
    phase_uncertainties: tuple[Annotated[Angle, Field(ge=0)], ...] = ()
    """Standard uncertainty of each phase, without that of the distance; unknown if
    empty [rad]."""

    @model_validator(mode="after")
    def _lists_fit(self) -> Self:
        if len(self.phases) != len(self.amplitudes):
            raise ValueError(
                f"{len(self.amplitudes)} amplitudes and {len(self.phases)} phases; "
                "each amplitude needs its phase"
            )
        if len(self.phase_uncertainties) not in (0, len(self.phases)):
            raise ValueError(
                f"{len(self.phases)} phases and {len(self.phase_uncertainties)} "
                "phase_uncertainties; state one for each phase, or none"
            )
        if any(b <= a for a, b in pairwise(self.amplitudes)):
            raise ValueError(
                "amplitudes must increase; found "
                + ", ".join(f"{value * 1e3:g} mV" for value in self.amplitudes)
            )
        return self


_Output = Annotated[Voltage, Field(ge=-1e4, le=1e4)]


class Leakage(Description):
    """Output of one channel with the laser on and without light from the water.

    The leakage of the scan can differ from that of the open-water references, which
    are recorded with another gain, or with the target away.
    """

    modulation_frequency: Annotated[Frequency, Field(gt=0)]
    """Modulation frequency [Hz]."""
    polarization: str
    """Channel, such as "VH"."""
    scan: tuple[_Output, _Output]
    """In-phase and quadrature output in the scan [V]."""
    scan_uncertainty: Annotated[Voltage, Field(ge=0)]
    """Standard uncertainty of each of the two [V]."""
    open_water: tuple[_Output, _Output]
    """In-phase and quadrature output in the open-water references [V]."""
    open_water_uncertainty: Annotated[Voltage, Field(ge=0)]
    """Standard uncertainty of each of the two [V]."""
    change: Annotated[Voltage, Field(ge=0)] | None = None
    """Change of the output in the scan from the first to the last measurement; unknown
    if there was only one [V]."""


class ReferencePhase(Description):
    """Phase of the standing reference in one channel, at the time of a calibration."""

    modulation_frequency: Annotated[Frequency, Field(gt=0)]
    """Modulation frequency [Hz]."""
    polarization: str
    """Channel, such as "VH"."""
    phase: Angle
    """Phase to which the samples of the plate were corrected [rad]."""
    uncertainty: Annotated[Angle, Field(ge=0)]
    """Standard uncertainty of the correction [rad]."""
    times: tuple[Time, ...] = ()
    """Times since the start of the recording [s]."""
    changes: tuple[Angle, ...] = ()
    """Phase at these times minus `phase` [rad]."""


class NeutralFilter(Description):
    """Neutral filter of a phase calibration, with its measured transmission."""

    density: Annotated[float, Field(ge=0, le=10)]
    """Stated optical density [1]."""
    transmission: Annotated[float, Field(gt=0, le=10)]
    """Transmission, relative to the stated one of the first filter [1]."""
    uncertainty: Annotated[float, Field(ge=0)] = 0.0
    """Standard uncertainty of the transmission; 0 for the first filter [1]."""


class TemperatureCoefficient(Description):
    """Dependence of the phase on the instrument temperature at one frequency."""

    modulation_frequency: Annotated[Frequency, Field(gt=0)]
    """Modulation frequency [Hz]."""
    phase_per_degree: Angle
    """Change of the phase per degree [rad]."""
    uncertainty: Annotated[Angle, Field(ge=0)]
    """Standard uncertainty of this change [rad]."""
    temperatures: Annotated[tuple[Temperature, ...], Field(min_length=2)]
    """Instrument temperatures of the run [degC]."""
    phases: tuple[Angle, ...]
    """Phase at each temperature, relative to the reference temperature [rad]."""

    @model_validator(mode="after")
    def _lists_fit(self) -> Self:
        if len(self.phases) != len(self.temperatures):
            raise ValueError(
                f"{len(self.temperatures)} temperatures and {len(self.phases)} phases; "
                "each temperature needs its phase"
            )
        return self


class DemodulatorOutputs(Description):
    """Errors of the two demodulator outputs at one modulation frequency.

    The quadrature output is (1 + g) (Q cos e + I sin e) + offset, in place of Q.
    """

    modulation_frequency: Annotated[Frequency, Field(gt=0)]
    """Modulation frequency [Hz]."""
    offset: tuple[_Output, _Output]
    """In-phase and quadrature output without an input signal [V]."""
    offset_uncertainty: Annotated[Voltage, Field(ge=0)]
    """Standard uncertainty of each of the two [V]."""
    quadrature_gain: Annotated[float, Field(gt=-1, le=10)] = 0.0
    """Gain error g: gain of the quadrature output over that of the in-phase output,
    minus 1 [1]."""
    quadrature_gain_uncertainty: Annotated[float, Field(ge=0)] | None = None
    """Standard uncertainty of g; unknown if only the offset was measured [1]."""
    quadrature_phase: Annotated[Angle, Field(ge=-1.5, le=1.5)] = 0.0
    """Angle error e: angle between the two reference waves, minus 90 degrees [rad]."""
    quadrature_phase_uncertainty: Annotated[Angle, Field(ge=0)] | None = None
    """Standard uncertainty of e; unknown if only the offset was measured [rad]."""
    outputs: tuple[tuple[_Output, _Output], ...] = ()
    """Outputs for a signal of constant amplitude at several phases [V]."""


class ChannelResponse(Description):
    """Response of one channel to light of the two polarizations of its pair."""

    modulation_frequency: Annotated[Frequency, Field(gt=0)]
    """Modulation frequency [Hz]."""
    polarization: str
    """Channel, such as "VH"."""
    gain: tuple[float, float]
    """Real and imaginary part of the gain relative to the first channel [1]."""
    gain_uncertainty: Annotated[float, Field(ge=0)]
    """Standard uncertainty of each of the two [1]."""
    crosstalk: Annotated[float, Field(gt=-MOST_CROSSTALK, lt=MOST_CROSSTALK)]
    """Response to the orthogonal polarization, divided by that to the polarization of
    the channel [1]."""
    crosstalk_uncertainty: Annotated[float, Field(ge=0)]
    """Standard uncertainty of the cross-talk [1]."""


_Entry = TypeVar("_Entry", Leakage, ReferencePhase, ChannelResponse)


class Calibration(Description):
    """Phase delays by modulation frequency and amplitude, and leakage by channel.

    Examples
    --------
    >>> from amulor.acquisition import Calibration
    >>> calibration = Calibration.from_text(
    ...     '''
    ...     [[frequencies]]
    ...     modulation_frequency = "39 MHz"
    ...     amplitudes = ["1 mV", "10 mV"]
    ...     phases = ["0.20 rad", "0.21 rad"]
    ...     '''
    ... )
    >>> calibration.frequencies[0].phases
    (0.2, 0.21)
    """

    date: datetime.date | None = None
    """Day of the measurement, such as 2026-05-01."""
    inputs: tuple[str, ...] = ()
    """SHA-256 digests of the files with the measurements."""
    frequencies: tuple[FrequencyCalibration, ...] = ()
    """Phase delays at each modulation frequency of a scan, in any order; empty if only
    the leakage was measured."""
    filters: tuple[NeutralFilter, ...] = ()
    """Neutral filters with which the phases were measured; not used for scans."""
    gain_change: Annotated[float, Field(gt=-1, le=10)] | None = None
    """Change of the gain from zero to `gain_amplitude`, for which samples are
    corrected; unknown by default [1]."""
    gain_change_uncertainty: Annotated[float, Field(ge=0)] | None = None
    """Standard uncertainty of this change [1]."""
    gain_amplitude: Annotated[Voltage, Field(gt=0)] | None = None
    """Largest amplitude behind the filters; without it samples are not corrected
    [V]."""
    leakage: tuple[Leakage, ...] = ()
    """Leakage of each channel, which is subtracted before the phase is corrected."""
    reference: tuple[ReferencePhase, ...] = ()
    """Phase of the standing reference during the calibration. Samples of later scans
    are corrected to it."""
    demodulator: tuple[DemodulatorOutputs, ...] = ()
    """Offset, gain and angle of the demodulator outputs at each frequency."""
    channels: tuple[ChannelResponse, ...] = ()
    """Gain and cross-talk of each channel."""
    temperature: tuple[TemperatureCoefficient, ...] = ()
    """Dependence of the phase on the instrument temperature, at each frequency."""
    reference_temperature: Annotated[Temperature, Field(ge=-60, le=100)] | None = None
    """Temperature to which the phases of scans are corrected; needed by `temperature`
    [degC]."""
    delay_uncertainty: Annotated[Time, Field(ge=0, le=1e-6)] | None = None
    """Standard uncertainty of the delay that all frequencies share, from the distance
    of the plate and the group index; unknown by default [s]."""
    group_index: Annotated[float, Field(ge=1, le=2)] | None = None
    """Group index that plates at several distances show; not applied to ranges [1]."""
    group_index_uncertainty: Annotated[float, Field(ge=0)] | None = None
    """Standard uncertainty of this group index; unknown by default [1]."""

    @model_validator(mode="after")
    def _has_a_measurement(self) -> Self:
        if not (
            self.frequencies
            or self.leakage
            or self.demodulator
            or self.channels
            or self.reference
            or self.temperature
        ):
            raise ValueError(
                "at least one is needed of frequencies (amulor calibrate plate), "
                "leakage (amulor calibrate leakage), demodulator (amulor calibrate "
                "demodulator), channels (amulor calibrate polarizer), reference "
                "(amulor calibrate reference) and temperature (amulor calibrate "
                "temperature)"
            )
        if self.temperature and self.reference_temperature is None:
            raise ValueError(
                "reference_temperature is missing; state the temperature to which the "
                'phases are corrected, such as "20 degC"'
            )
        return self

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a calibration file.

        Parameters
        ----------
        path : str or pathlib.Path
            File from `to_toml`.

        Returns
        -------
        Calibration
            Calibration in SI units.

        Raises
        ------
        FormatError
            If the file is invalid; the message has one line per error.
        """
        text = toml_file.text_of(path, error=FormatError)
        return cls.from_text(text, name=str(Path(path)))

    @classmethod
    def from_text(cls, text: str, *, name: str = "calibration") -> Self:
        """Read a calibration from the text of its file.

        Parameters
        ----------
        text : str
            Content of a calibration file (TOML), or of the attribute `calibration` of a
            cube.
        name : str
            Name of the calibration in messages.

        Returns
        -------
        Calibration
            Calibration in SI units.

        Raises
        ------
        FormatError
            As `from_toml`.
        """
        return toml_file.described(
            text, cls, name=name, what="a calibration", error=FormatError
        )

    def to_toml(self) -> str:
        """Return the calibration as TOML text, each quantity with its SI unit.

        Returns
        -------
        str
            Text that `from_toml` converts back to an equal calibration.
        """
        import tomli_w

        return tomli_w.dumps(self.model_dump(mode="json", exclude_defaults=True))


def _entry(
    calibration: Calibration, modulation_frequency: float
) -> FrequencyCalibration:
    """Return the phase delays at a modulation frequency."""
    return _nearest(calibration.frequencies, modulation_frequency)


_ByFrequency = TypeVar(
    "_ByFrequency", FrequencyCalibration, TemperatureCoefficient, DemodulatorOutputs
)


def _nearest(
    entries: Sequence[_ByFrequency], modulation_frequency: float
) -> _ByFrequency:
    """Return the entry at a modulation frequency; raise if there is none."""
    nearest = min(
        entries,
        key=lambda entry: abs(entry.modulation_frequency - modulation_frequency),
    )
    if not math.isclose(
        nearest.modulation_frequency, modulation_frequency, rel_tol=_SAME_FREQUENCY
    ):
        raise FormatError(
            f"the calibration has no {modulation_frequency / 1e6:g} MHz; record the "
            "plate at the frequencies of the scan"
        )
    return nearest


def phase_correction(
    calibration: Calibration,
    amplitude: NDArray[np.float64],
    *,
    modulation_frequency: float,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return phase corrections [rad], and whether the table covers the amplitudes."""
    nearest = _entry(calibration, modulation_frequency)
    at = np.asarray(nearest.amplitudes)
    with np.errstate(divide="ignore", invalid="ignore"):
        correction = np.interp(
            np.log(amplitude), np.log(at), np.asarray(nearest.phases)
        )
    if at.size == 1:
        return correction, np.isfinite(amplitude)
    return correction, (amplitude >= at[0]) & (amplitude <= at[-1])


def phase_uncertainty(
    calibration: Calibration, amplitude: Floats, *, modulation_frequency: float
) -> tuple[Floats, Floats]:
    """Return phase uncertainties [rad]: of the table, and of extrapolation beyond it.

    Beyond its ends the table could go on with the slope at this end. The correction
    does not, so the whole of this extrapolation is the standard uncertainty.
    """
    entry = _entry(calibration, modulation_frequency)
    at = np.log(np.asarray(entry.amplitudes))
    errors = np.asarray(entry.phase_uncertainties or [0.0] * at.size)
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.log(amplitude)
    table = np.interp(size, at, errors)
    if at.size == 1:
        return table, np.zeros(size.shape)
    slopes = np.diff(np.asarray(entry.phases)) / np.diff(at)
    of_slopes = np.hypot(errors[1:], errors[:-1]) / np.diff(at)
    below = np.clip(at[0] - size, 0, None) * math.hypot(slopes[0], of_slopes[0])
    above = np.clip(size - at[-1], 0, None) * math.hypot(slopes[-1], of_slopes[-1])
    beyond = np.where(np.isfinite(size), below + above, 0.0)
    return table, beyond


def leakage_of(
    calibration: Calibration, cube: xr.Dataset, part: str
) -> tuple[Complex, Floats]:
    """Return leakage [V] and its uncertainty [V] in the scan or in the references.

    Shape (frequency, polarization). A channel without a measurement is refused.
    """
    if not calibration.leakage:
        return np.zeros((1, 1), dtype=complex), np.zeros((1, 1))
    entries = _by_channel(
        calibration.leakage,
        cube,
        what="leakage",
        remedy="measure it with the shutter closed",
    )
    leak = [[complex(*getattr(entry, part)) for entry in row] for row in entries]
    uncertainty = [
        [getattr(entry, f"{part}_uncertainty") for entry in row] for row in entries
    ]
    return np.array(leak), np.array(uncertainty)


def _has_offset(calibration: Calibration, cube: xr.Dataset) -> bool:
    """Return whether the offset is in the samples after subtraction of leakage."""
    dark = [cube.attrs.get(f"dark_{name}", 0.0) for name in ("in_phase", "quadrature")]
    return not (calibration.leakage or np.any(dark))


def demodulated(
    calibration: Calibration, cube: xr.Dataset, signal: Complex, errors: Covariance
) -> tuple[Complex, Covariance]:
    """Correct offset, gain and angle of the outputs; return signal and covariance.

    Dark readings and leakage contain the offset already.
    """
    if not calibration.demodulator:
        return signal, errors
    entries = [
        _nearest(calibration.demodulator, value)
        for value in cube["modulation_frequency"].values
    ]
    shape = (len(entries), *[1] * (signal.ndim - 1))
    if _has_offset(calibration, cube):
        offset = [complex(*entry.offset) for entry in entries]
        signal = signal - np.reshape(offset, shape)
    angle = np.reshape([entry.quadrature_phase for entry in entries], shape)
    gain = np.reshape([1 + entry.quadrature_gain for entry in entries], shape)
    slope, scale = np.tan(angle), 1 / (gain * np.cos(angle))
    quadrature = scale * signal.imag - slope * signal.real
    return signal.real + 1j * quadrature, Covariance(
        errors.in_phase,
        scale**2 * errors.quadrature
        + slope**2 * errors.in_phase
        - 2 * scale * slope * errors.cross,
        scale * errors.cross - slope * errors.in_phase,
    )


def demodulator_uncertainty(
    calibration: Calibration, cube: xr.Dataset
) -> tuple[Floats, Floats]:
    """Return phase [rad] and offset [V] uncertainties of the outputs, by frequency."""
    frequency = cube["modulation_frequency"].values
    if not calibration.demodulator:
        return np.zeros(frequency.size), np.zeros(frequency.size)
    entries = [_nearest(calibration.demodulator, value) for value in frequency]
    gain = np.array([entry.quadrature_gain_uncertainty or 0.0 for entry in entries])
    angle = np.array([entry.quadrature_phase_uncertainty or 0.0 for entry in entries])
    offset = np.array([entry.offset_uncertainty for entry in entries])
    offset = offset * _has_offset(calibration, cube)
    return quadrature_phase_error(gain, angle), offset


def with_constant_gain(
    calibration: Calibration, signal: Complex, errors: Covariance, *, amplitude: Floats
) -> tuple[Complex, Covariance]:
    """Correct the gain that changes with the amplitude; return signal and covariance.

    The logarithm of the gain is proportional to the amplitude. Above the amplitudes of
    the filters, the gain is that of the largest amplitude.
    """
    if calibration.gain_change is None or calibration.gain_amplitude is None:
        return signal, errors
    part = np.clip(np.nan_to_num(amplitude) / calibration.gain_amplitude, 0.0, 1.0)
    factor = (1 + calibration.gain_change) ** -part
    corrected = factor * signal
    error = part * (calibration.gain_change_uncertainty or 0.0)
    return corrected, Covariance(
        factor**2 * errors.in_phase,
        factor**2 * errors.quadrature,
        factor**2 * errors.cross,
    ) + along(np.nan_to_num(corrected), error)


def separated(
    calibration: Calibration, cube: xr.Dataset, signal: Complex, errors: Covariance
) -> tuple[Complex, Covariance, dict[str, object]]:
    """Correct gains and cross-talk; return signal, covariance and error attributes.

    Errors of the two channels are independent before the correction. The covariance
    that the correction makes between them is omitted, since cross-talk is small.
    """
    if not calibration.channels:
        return signal, errors, {}
    entries = _by_channel(
        calibration.channels,
        cube,
        what="gain",
        remedy="measure it (amulor calibrate polarizer)",
    )
    shape = (*signal.shape[:2], *[1] * (signal.ndim - 2))
    gain = np.reshape([complex(*e.gain) for row in entries for e in row], shape)
    share = np.reshape([e.crosstalk for row in entries for e in row], shape)
    names = cube.amulor.polarizations
    partner = [names.index(_partner(name, names)) for name in names]
    both = 1 - share * share[:, partner]
    own, other = 1 / gain / both, -share / gain[:, partner] / both
    part = (slice(None), partner)
    phase = np.max([[e.gain_uncertainty for e in row] for row in entries], axis=1)
    crosstalk = max(e.crosstalk_uncertainty for row in entries for e in row)
    return (
        own * signal + other * signal[:, partner],
        errors.turned(own) + errors.part(part).turned(other),
        {
            "channel_gain_uncertainty": phase,
            "channel_crosstalk_uncertainty": crosstalk,
        },
    )


_ORTHOGONAL = {"V": "H", "H": "V", "P": "M", "M": "P"}


def _partner(name: str, names: Sequence[str]) -> str:
    """Return the channel with the orthogonal analyzer; raise if there is none."""
    partner = name[:-1] + _ORTHOGONAL.get(name[-1], "")
    if partner == name[:-1] or partner not in names:
        raise FormatError(
            f"the calibration has a cross-talk, but the scan has no channel {partner} "
            f"beside {name}; record both, or calibrate without the polarizer"
        )
    return partner


def _by_channel(
    entries: Sequence[_Entry], cube: xr.Dataset, *, what: str, remedy: str
) -> list[list[_Entry]]:
    """Return the entry of each frequency and channel of a cube."""
    result: list[list[_Entry]] = []
    for frequency in cube["modulation_frequency"].values:
        result.append([])
        for channel in cube.amulor.polarizations:
            nearest = min(
                (entry for entry in entries if entry.polarization == channel),
                key=lambda entry: abs(entry.modulation_frequency - frequency),
                default=None,
            )
            if nearest is None or not math.isclose(
                nearest.modulation_frequency, frequency, rel_tol=_SAME_FREQUENCY
            ):
                raise FormatError(
                    f"the calibration has no {what} at {frequency / 1e6:g} MHz in "
                    f"{channel}; {remedy} at the frequencies and channels of the scan"
                )
            result[-1].append(nearest)
    return result


def reference_shift(
    calibration: Calibration, cube: xr.Dataset
) -> tuple[Floats, dict[str, object]]:
    """Return phase shifts of the standing reference [rad], and the changed attributes.

    The drift of a scan was corrected to one phase of its standing reference. The shift
    corrects it to the phase during the calibration. Shape (frequency, polarization).
    """
    if not calibration.reference:
        return np.zeros((1, 1)), {}
    present = cube.attrs.get("reference_phase_rad")
    if present is None:
        raise FormatError(
            "the calibration refers to a standing reference, but the scan has none; "
            "record it with [scan.reference], or calibrate without one"
        )
    entries = _by_channel(
        calibration.reference,
        cube,
        what="phase of the standing reference",
        remedy="record it (amulor calibrate reference)",
    )
    phase = np.array([[entry.phase for entry in row] for row in entries])
    error = np.array([max(entry.uncertainty for entry in row) for row in entries])
    shift = np.angle(np.exp(1j * (np.reshape(present, phase.shape) - phase)))
    here = cube.attrs["reference_phase_uncertainty_rad"]
    return shift, {
        "reference_phase_rad": phase.ravel(),
        "reference_phase_uncertainty_rad": np.hypot(here, error),
        "reference_calibrated": np.int32(1),
        "instrument_drift_uncertainty_s": np.zeros(error.size),
    }


def temperature_shift(
    calibration: Calibration, cube: xr.Dataset
) -> tuple[Floats, dict[str, object]]:
    """Return the phase shift by instrument temperature [rad], and error attributes.

    Without a recorded temperature, the phase is zero, and the temperature has an even
    distribution over that of the run. Shape (frequency, 1).
    """
    if not calibration.temperature:
        return np.zeros((1, 1)), {}
    frequency = cube["modulation_frequency"].values
    reference = calibration.reference_temperature
    assert reference is not None
    entries = [_nearest(calibration.temperature, value) for value in frequency]
    survey = cube.amulor.survey
    recorded = None if survey is None else survey.scan.instrument_temperature
    if survey is None or recorded is None:
        run = [value for entry in entries for value in entry.temperatures]
        warmer = 0.0
        error = max(max(run) - reference, reference - min(run)) / math.sqrt(3)
    else:
        warmer = recorded - reference
        stated = survey.scan.instrument_temperature_uncertainty
        error = TEMPERATURE_UNCERTAINTY if stated is None else stated
    slope = np.array([entry.phase_per_degree for entry in entries])
    of_slope = np.array([entry.uncertainty for entry in entries])
    phase_error = np.hypot(np.hypot(slope, of_slope) * error, of_slope * warmer)
    return (slope * warmer)[:, None], {
        "temperature_delay_uncertainty_s": phase_error / (2 * np.pi * frequency),
        "temperature_recorded": np.int32(recorded is not None),
    }


def calibrated(cube: xr.Dataset, calibration: Calibration) -> xr.Dataset:
    r"""Subtract leakage and correct phases, in samples and open-water references.

    If the calibration has phases of the standing reference, the samples are corrected
    to them.

    Parameters
    ----------
    cube : xarray.Dataset
        Cube of level `samples` without a calibration.
    calibration : Calibration
        Leakage, phase delays, or both.

    Returns
    -------
    xarray.Dataset
        The corrected cube. The attributes `leakage_uncertainty_volt` and
        `calibration_phase_uncertainty_rad` have one value for each frequency,
        `calibration_delay_uncertainty_s` has one for all. Ranging adds them to the
        error that all pixels share. `uncalibrated_share` is the fraction of samples
        beyond the amplitudes of the calibration.

    Raises
    ------
    CubeError
        If the cube is of another level, or has a calibration already.
    FormatError
        If a frequency or channel was not calibrated.

    Notes
    -----
    A sample beyond the amplitudes of the calibration has the phase of the nearest one.
    The error of its outputs includes the phase that the slope of the table adds up to
    this sample.

    Examples
    --------
    >>> from amulor import acquisition, samples
    >>> cube = samples.cube("ladder")
    >>> turned = acquisition.calibrated(
    ...     cube,
    ...     acquisition.Calibration.from_text(
    ...         "[[frequencies]]\nmodulation_frequency = '39 MHz'\n"
    ...         "amplitudes = ['1 mV']\nphases = ['0.1 rad']\n"
    ...         "phase_uncertainties = ['1 mrad']"
    ...     ),
    ... )
    >>> print(turned.attrs["calibration_phase_uncertainty_rad"])
    [0.001]
    """
    cubes.check(cube, "samples", name="the cube to calibrate")
    if "calibration" in cube.attrs:
        raise CubeError(
            "the cube has a calibration already; make it again from its journal with "
            "another one (amulor recover --calibration --overwrite)"
        )
    frequency = cube["modulation_frequency"].values
    shift, attributes = reference_shift(calibration, cube)
    warmer, of_temperature = temperature_shift(calibration, cube)
    if not calibration.reference:
        # The standing reference has shown the effect of the temperature already.
        shift, attributes = shift + warmer, attributes | of_temperature
    attributes["calibration"] = calibration.to_toml()
    changed: dict[str, xr.DataArray] = {}
    of_phase, of_offset = demodulator_uncertainty(calibration, cube)
    squares = np.zeros(frequency.size)
    table_known = bool(calibration.frequencies) and all(
        entry.phase_uncertainties for entry in calibration.frequencies
    )
    for prefix, part in (("", "scan"), ("open_water_", "open_water")):
        if f"{prefix}in_phase" not in cube:
            continue
        leak, of_leak = leakage_of(calibration, cube, part)
        squares = squares + np.max(of_leak, axis=1) ** 2
        outputs = {
            name: cube[f"{prefix}{name}"]
            for name in _OUTPUTS
            if f"{prefix}{name}" in cube
        }
        signal = outputs["in_phase"].values + 1j * outputs["quadrature"].values
        axes = (slice(None), slice(None), *[None] * (signal.ndim - 2))
        signal, errors = demodulated(
            calibration,
            cube,
            signal - leak[axes],
            Observation(cube=xr.Dataset(outputs)).covariance,
        )
        amplitude = np.abs(signal)
        delay, table, beyond = (np.zeros(signal.shape) for _ in range(3))
        outside = np.zeros(signal.shape, dtype=bool)
        if calibration.frequencies:
            for number, value in enumerate(frequency):
                where = {"modulation_frequency": float(value)}
                delay[number], inside = phase_correction(
                    calibration, amplitude[number], **where
                )
                outside[number] = np.isfinite(amplitude[number]) & ~inside
                table[number], beyond[number] = phase_uncertainty(
                    calibration, amplitude[number], **where
                )
        turn = np.exp(-1j * (np.nan_to_num(delay) + shift[axes]))
        signal = signal * turn
        errors = errors.turned(turn) + Covariance(
            *detection.phase_floor_covariance(np.nan_to_num(signal), phase_floor=beyond)
        )
        signal, errors = with_constant_gain(
            calibration, signal, errors, amplitude=amplitude
        )
        signal, errors, of_channels = separated(calibration, cube, signal, errors)
        values = {
            "in_phase": signal.real,
            "quadrature": signal.imag,
            "in_phase_uncertainty": np.sqrt(errors.in_phase),
            "quadrature_uncertainty": np.sqrt(errors.quadrature),
            "in_phase_quadrature_covariance": errors.cross,
        }
        for name, array in values.items():
            like = outputs.get(name)
            if like is None:
                like = outputs["in_phase"].assign_attrs(
                    units="V2", long_name="covariance of the two outputs"
                )
            changed[f"{prefix}{name}"] = like.copy(data=array)
        if part == "scan" and calibration.frequencies:
            measured = np.isfinite(amplitude)
            attributes[UNCALIBRATED_SHARE] = float(
                outside.sum() / max(measured.sum(), 1)
            )
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", RuntimeWarning)  # nothing measured
                middle = np.nanmedian(
                    np.where(np.isfinite(amplitude), table, np.nan), axis=(1, 2, 3)
                )
            if table_known:
                of_phase = np.hypot(of_phase, np.nan_to_num(middle))
            if "user_sample_flag" in cube:
                flag = cube["user_sample_flag"]
                changed["user_sample_flag"] = flag.copy(
                    data=(flag.values | UNCALIBRATED * outside).astype(flag.dtype)
                )
    if calibration.demodulator:
        attributes["offset_uncertainty_volt"] = of_offset
        if all(e.quadrature_gain_uncertainty for e in calibration.demodulator):
            attributes["demodulator_calibrated"] = np.int32(1)
    attributes |= of_channels
    if calibration.channels:
        gain_error = np.asarray(of_channels["channel_gain_uncertainty"])
        of_phase = np.hypot(of_phase, gain_error)
    if calibration.demodulator or calibration.channels or table_known:
        attributes["calibration_phase_uncertainty_rad"] = of_phase
    if calibration.leakage:
        attributes["leakage_uncertainty_volt"] = np.sqrt(squares)
    if calibration.frequencies and calibration.delay_uncertainty is not None:
        attributes["calibration_delay_uncertainty_s"] = calibration.delay_uncertainty
    return cube.assign(changed).assign_attrs(attributes)


_OUTPUTS = (
    "in_phase",
    "quadrature",
    "in_phase_uncertainty",
    "quadrature_uncertainty",
    "in_phase_quadrature_covariance",
)
