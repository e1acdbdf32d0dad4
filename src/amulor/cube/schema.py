"""Error-budget terms, quality flags, and variables of each processing level."""

from __future__ import annotations

import enum
import functools
from dataclasses import dataclass, replace
from typing import Any, Literal


@dataclass(frozen=True, kw_only=True)
class Term:
    """Error source of a slant range, in the terms of the GUM."""

    name: str
    """Name in variables and reports."""
    meaning: str
    """Meaning of the term, in a few words."""
    kind: Literal["A", "B", "A, B"]
    """Type of evaluation of the uncertainty: A from the scatter of measurements, B from
    other knowledge."""


#: All terms, in the order of reports.
TERMS = {
    term.name: term
    for term in (
        Term(name="counting", meaning="noise of the samples", kind="A"),
        Term(
            name="fluctuation",
            meaning="random change of the water signal from sample to sample",
            kind="A",
        ),
        Term(
            name="reference",
            meaning="noise, fit and interpolation of the open-water reference",
            kind="A",
        ),
        Term(
            name="drift",
            meaning="change of the water signal between reference and scan",
            kind="B",
        ),
        Term(name="column", meaning="water column behind the target", kind="B"),
        Term(
            name="water_model",
            meaning="errors of strength and shape of the modeled water signal",
            kind="A, B",
        ),
        Term(
            name="polarization_optics",
            meaning="errors of depolarization ratios and polarizers",
            kind="B",
        ),
        Term(
            name="signal",
            meaning="errors that the rejection method does not divide into terms",
            kind="A, B",
        ),
        Term(
            name="late_echo",
            meaning="delay of the echo by scattering, beyond the subtracted estimate",
            kind="B",
        ),
        Term(name="delay", meaning="error of the delay of the instrument", kind="B"),
        Term(
            name="group_index",
            meaning="error of the group index of the water",
            kind="B",
        ),
        Term(
            name="geometry",
            meaning="errors of the receiver position and the beam directions",
            kind="B",
        ),
        Term(
            name="instrument",
            meaning="leakage, walk, harmonics and drift of the instrument",
            kind="A, B",
        ),
        Term(
            name="corners",
            meaning="light that concave corners of the scene reflect twice",
            kind="B",
        ),
        Term(
            name="surroundings",
            meaning="scattered light of brighter or darker surroundings",
            kind="B",
        ),
    )
}
#: Terms that a rejection method may add to its target signal.
SIGNAL_TERMS = (
    "counting",
    "fluctuation",
    "reference",
    "drift",
    "column",
    "water_model",
    "polarization_optics",
)
#: Terms that the pixels of a scan share. Changing water, in a combination of channels,
#: affects each sample separately.
SHARED_TERMS = ("reference", "drift", "column", "polarization_optics")
#: Terms that move all pixels of an image the same way.
ALIKE_TERMS = (
    "late_echo",
    "delay",
    "group_index",
    "geometry",
    "instrument",
    "corners",
    "surroundings",
)
#: Terms in proportion to the water, the same part of it at all pixels.
WATER_TERMS = ("drift", "column")
#: Prefix of the names of variables with one term.
RANGE_PREFIX, PHASE_PREFIX = "slant_range_uncertainty_", "phase_uncertainty_"


#: Schema version; increased when older files cannot be read unchanged.
SCHEMA_VERSION = "1"
CONVENTIONS = "CF-1.11"


class QualityFlag(enum.IntFlag):
    """Quality flags of a pixel: reasons to exclude it or to use it with care.

    The bits add up.

    Examples
    --------
    >>> from amulor.cube import QualityFlag
    >>> QualityFlag(5)
    <QualityFlag.MISSING|NO_TARGET: 5>
    >>> [flag.name for flag in QualityFlag(5)]
    ['MISSING', 'NO_TARGET']
    """

    GOOD = 0
    MISSING = 1
    """The pixel was not measured."""
    SATURATED = 2
    """The detector signal left its linear range."""
    NO_TARGET = 4
    """Signal not significant above noise and residual water."""
    AMBIGUOUS = 8
    """The ambiguity interval of the distance is uncertain."""
    WATER_RESIDUAL = 16
    """Residual water signal moves the range by more than its uncertainty."""
    NO_OPEN_WATER = 32
    """The water signal was not removed: the range has an unknown error."""
    MIXED = 64
    """The beam meets two surfaces at once, and the range lies between them."""
    OUTLIER = 128
    """A sample disagrees with the rest of its pixel or of the scan."""
    RELATIVE = 256
    """The range may be wrong by whole ambiguity intervals."""
    CORNER = 512
    """Light reflected twice in a corner moves the range by more than other errors."""
    MOVED = 1024
    """Readings from a vehicle at different times disagree beyond errors and motion."""


class WaterResidualCause(enum.IntFlag):
    """Tests that a `WATER_RESIDUAL` sample failed, as bit flags.

    Examples
    --------
    >>> from amulor.cube import WaterResidualCause
    >>> WaterResidualCause(8)
    <WaterResidualCause.MODEL_MISFIT: 8>
    """

    PHASE_SHIFT = 1
    """Residual water turns the phase by more than its standard uncertainty."""
    STRONG_COLUMN = 2
    """At a single frequency, the water behind the target is too strong to separate."""
    WATER_SHAPE = 4
    """The target signal has the same shape as the water signal over all samples."""
    MODEL_MISFIT = 8
    """The samples contradict joint estimation, or are on no line of `phasor-lines`."""
    MODEL_DEPARTURE = 16
    """Joint estimation: departures from the model move the range considerably."""
    WATER_CHANGED = 32
    """The water of the scan differs from that of the open-water shots."""
    INSTRUMENT = 64
    """No water explains both shots and scan: an instrument error, or corner light."""


@functools.cache
def flag_words() -> dict[str, dict[str, dict[str, str]]]:
    """Return the texts of flags.toml by kind of flag, flag name and purpose."""
    import tomllib
    from importlib import resources

    text = resources.files("amulor.cube").joinpath("flags.toml").read_text("utf-8")
    return tomllib.loads(text)


#: A pixel with one of these has no range; with the others it has one, with care.
UNUSABLE = (
    QualityFlag.MISSING
    | QualityFlag.SATURATED
    | QualityFlag.NO_TARGET
    | QualityFlag.AMBIGUOUS
)

#: A pixel with one of these has a range of unknown error: no uncertainty is stated.
ERROR_UNKNOWN = QualityFlag.NO_OPEN_WATER | QualityFlag.RELATIVE

#: A pixel with one of these has a range, but a doubtful one.
DOUBTFUL = (
    QualityFlag.WATER_RESIDUAL
    | QualityFlag.MIXED
    | QualityFlag.OUTLIER
    | QualityFlag.CORNER
    | QualityFlag.MOVED
    | ERROR_UNKNOWN
)


_CAUSE = "failed tests of the water signal behind WATER_RESIDUAL, 0 if none"


def flag_attributes() -> dict[str, Any]:
    """Return the CF attributes that explain a `quality_flag` variable."""
    import numpy as np

    of_pixels = "reason why a pixel is unusable or doubtful, 0 if neither"
    return _bits_explained(QualityFlag, of_pixels, np.int16)


def cause_attributes() -> dict[str, Any]:
    """Return the CF attributes that explain a `water_residual_cause` variable."""
    import numpy as np

    return _bits_explained(WaterResidualCause, _CAUSE, np.int8)


def _bits_explained(
    flags: type[enum.IntFlag], long_name: str, dtype: type
) -> dict[str, Any]:
    """Return the CF attributes of a variable whose bits are flags."""
    import numpy as np

    bits = [flag for flag in flags if flag]
    values: Any = np.array([int(flag) for flag in bits], dtype=dtype)
    return {
        "long_name": long_name,
        "units": "1",
        "flag_masks": values,
        "flag_values": values,
        "flag_meanings": " ".join(str(flag.name).lower() for flag in bits),
    }


@dataclass(frozen=True, kw_only=True)
class Variable:
    """Schema of one variable: dimensions, unit and meaning."""

    dimensions: tuple[str, ...]
    units: str
    long_name: str
    required: bool


def _needed(dimensions: tuple[str, ...], units: str, long_name: str) -> Variable:
    return Variable(
        dimensions=dimensions, units=units, long_name=long_name, required=True
    )


def _optional(dimensions: tuple[str, ...], units: str, long_name: str) -> Variable:
    return Variable(
        dimensions=dimensions, units=units, long_name=long_name, required=False
    )


@dataclass(frozen=True)
class Level:
    """Schema of one processing level: its variables and their coordinates."""

    name: str
    variables: dict[str, Variable]
    coordinates: dict[str, Variable]


_SAMPLE = ("modulation_frequency", "polarization", "row", "column")
_CHANNEL = ("modulation_frequency", "polarization")
_PIXEL = ("row", "column")
_POINT = ("point",)

_PIXEL_COORDINATES = {
    "azimuth": _needed(_PIXEL, "rad", "direction of the beam to the right"),
    "elevation": _needed(_PIXEL, "rad", "direction of the beam upwards"),
    "origin_x": _optional(_PIXEL, "m", "start of the beam, to the right"),
    "origin_y": _optional(_PIXEL, "m", "start of the beam, downwards"),
    "origin_z": _optional(_PIXEL, "m", "start of the beam, forwards"),
    "time": _optional(_PIXEL, "s", "time since the start of the scan"),
    "geometry": _needed((), "1", "position of the instrument and indices of the water"),
}
_SAMPLE_COORDINATES = {
    "modulation_frequency": _needed(
        ("modulation_frequency",), "Hz", "frequency of the intensity modulation"
    ),
    "polarization": _needed(
        ("polarization",), "1", "launched and analyzed state of polarization"
    ),
    **_PIXEL_COORDINATES,
    "reading_time": _optional(
        _SAMPLE, "s", "middle of the integration window since the start of the scan"
    ),
    "reading_duration": _optional(_SAMPLE, "s", "length of the integration window"),
}
_READING = ("reading", "row", "column")
#: Times of the readings of a range, which may have several frequencies and channels.
_READING_COORDINATES = {
    "reading_time": _optional(
        _READING, "s", "middle of the integration window since the start of the scan"
    ),
    "reading_duration": _optional(_READING, "s", "length of the integration window"),
    "reading_weight": _optional(
        ("reading",), "1", "weight of the reading in the range, sum 1"
    ),
}
_MEASURED = {
    "in_phase": _needed(_SAMPLE, "V", "lock-in output in phase with the reference"),
    "quadrature": _needed(
        _SAMPLE, "V", "lock-in output a quarter period behind the reference"
    ),
    "in_phase_uncertainty": _needed(
        _SAMPLE, "V", "standard uncertainty of the in-phase output"
    ),
    "quadrature_uncertainty": _needed(
        _SAMPLE, "V", "standard uncertainty of the quadrature output"
    ),
    "in_phase_quadrature_covariance": _optional(
        _SAMPLE, "V2", "covariance of the two outputs"
    ),
    "saturated": _optional(_SAMPLE, "1", "1 where the detector was overloaded"),
}

#: Statistics of the tests behind the flags of a pixel, stored in the range image.
PIXEL_TESTS = {
    "no_target_probability": _optional(
        _PIXEL,
        "1",
        "p-value of chi-square without a target, NaN if there is a target",
    ),
    "column_over_target": _optional(
        _PIXEL, "1", "water signal behind the target over target signal, maximum"
    ),
    "water_shape_significance": _optional(
        _PIXEL,
        "1",
        "part of the signal like the water signal over its error, if flagged",
    ),
    "water_shape_probability": _optional(
        _PIXEL, "1", "p-value of the signal without its part like the water, if flagged"
    ),
    "joint_detection": _optional(
        _PIXEL, "1", "decrease of chi-square by a target, joint estimation"
    ),
    "joint_misfit_probability": _optional(
        _PIXEL, "1", "p-value of chi-square, joint estimation"
    ),
    "joint_departure": _optional(
        _PIXEL, "m", "shift of the slant range by departures from the model"
    ),
    "joint_departure_limit": _optional(
        _PIXEL, "m", "shift of the slant range above which the pixel is flagged"
    ),
}
#: Test statistics that are computed with the range image.
_IMAGE_TESTS = {
    "ambiguous_interval_probability": _optional(
        _PIXEL, "1", "probability of another interval, for ambiguous pixels"
    ),
    "moved_probability": _optional(
        _PIXEL, "1", "p-value of the readings from a vehicle, for moved pixels"
    ),
    "ambiguous_misfit_probability": _optional(
        _PIXEL, "1", "p-value of the phases of all frequencies, for ambiguous pixels"
    ),
    "range_spread": _optional(
        _PIXEL, "m", "standard deviation of the range within a mixed beam"
    ),
}
#: Test statistics of each sample.
SAMPLE_TESTS = {
    "signal_significance": _optional(
        _SAMPLE, "1", "target signal over its standard error, from both outputs"
    ),
    "residual_phase_ratio": _optional(
        _SAMPLE, "1", "phase shift by residual water over phase error, if flagged"
    ),
    "channel_disagreement": _optional(
        _SAMPLE, "1", "phase difference between channels over its scatter, maximum"
    ),
}

#: Results of joint estimation for every pixel; NaN without a target.
_JOINT = {
    "joint_slant_range": _optional(
        _PIXEL, "m", "distance from the emitter along the beam"
    ),
    "joint_slant_range_uncertainty": _optional(
        _PIXEL, "m", "standard uncertainty of the slant range"
    ),
    "joint_slant_range_common_uncertainty": _optional(
        _PIXEL, "m", "part of the uncertainty that all pixels share"
    ),
    "joint_slant_range_bound": _optional(
        _PIXEL, "m", "Cramer-Rao bound of the slant range"
    ),
    "joint_slant_range_lower": _optional(_PIXEL, "m", "lower end of the 68 % interval"),
    "joint_slant_range_upper": _optional(_PIXEL, "m", "upper end of the 68 % interval"),
    "joint_nearer_surface": _optional(
        _PIXEL, "m", "nearer of two surfaces in one beam"
    ),
    "joint_farther_surface": _optional(
        _PIXEL, "m", "farther of two surfaces in one beam"
    ),
    "joint_wrong_interval_probability": _optional(
        _PIXEL, "1", "probability of another ambiguity interval"
    ),
    "joint_misfit": _optional(_PIXEL, "1", "chi-square over its degrees of freedom"),
}
#: One standard uncertainty of the phase for each part of a target signal's errors.
_PHASE_TERMS = {
    f"{PHASE_PREFIX}{name}": _optional(
        _SAMPLE, "rad", f"standard uncertainty due to {TERMS[name].meaning}"
    )
    for name in SIGNAL_TERMS
}
#: One standard uncertainty of the slant range for each term; their squares add up.
_RANGE_TERMS = {
    f"{RANGE_PREFIX}{term.name}": _optional(
        _PIXEL, "m", f"standard uncertainty due to {term.meaning}"
    )
    for term in TERMS.values()
}
#: Old names of variables, from files of version 1.
FORMER_NAMES = {
    "user_joint_slant_range": "joint_slant_range",
    "user_joint_uncertainty": "joint_slant_range_uncertainty",
    "user_joint_common_uncertainty": "joint_slant_range_common_uncertainty",
    "user_joint_bound": "joint_slant_range_bound",
    "user_joint_lower": "joint_slant_range_lower",
    "user_joint_upper": "joint_slant_range_upper",
    "user_joint_wrong_interval": "joint_wrong_interval_probability",
    "user_joint_misfit": "joint_misfit",
}

LEVELS = {
    level.name: level
    for level in (
        Level("samples", _MEASURED, _SAMPLE_COORDINATES),
        Level(
            "target_signal",
            {
                **_MEASURED,
                "water_in_phase": _needed(
                    _SAMPLE, "V", "subtracted water signal, in phase"
                ),
                "water_quadrature": _needed(
                    _SAMPLE, "V", "subtracted water signal, quadrature"
                ),
                "residual_in_phase": _optional(
                    _SAMPLE, "V", "estimated residual water signal, in phase"
                ),
                "residual_quadrature": _optional(
                    _SAMPLE, "V", "estimated residual water signal, quadrature"
                ),
                "common_in_phase_uncertainty": _optional(
                    _SAMPLE, "V", "part of the uncertainty that all pixels share"
                ),
                "common_quadrature_uncertainty": _optional(
                    _SAMPLE, "V", "part of the uncertainty that all pixels share"
                ),
                "common_covariance": _optional(
                    _SAMPLE, "V2", "covariance of the errors that all pixels share"
                ),
                "smoothing_gain": _optional(
                    _PIXEL, "1", "weight of the neighbors in the range of a pixel"
                ),
                "quality_flag": _needed(_SAMPLE, "1", "reason why a pixel is doubtful"),
                "water_residual_cause": _optional(_SAMPLE, "1", _CAUSE),
                **SAMPLE_TESTS,
                **PIXEL_TESTS,
                **_JOINT,
                **_PHASE_TERMS,
            },
            _SAMPLE_COORDINATES,
        ),
        Level(
            "range_image",
            {
                "slant_range": _needed(
                    _PIXEL, "m", "distance from the emitter along the beam"
                ),
                "slant_range_uncertainty": _needed(
                    _PIXEL, "m", "standard uncertainty of the slant range"
                ),
                "slant_range_bias": _optional(
                    _PIXEL, "m", "estimated error by residual water signal"
                ),
                "slant_range_common_uncertainty": _optional(
                    _PIXEL, "m", "part of the uncertainty that all pixels share"
                ),
                "slant_range_wrong_interval": _optional(
                    _PIXEL, "1", "probability of another ambiguity interval"
                ),
                "slant_range_photon_limit": _optional(
                    _PIXEL, "m", "uncertainty by photon counting alone"
                ),
                "slant_range_bound": _optional(
                    _PIXEL, "m", "Cramer-Rao bound of the slant range"
                ),
                "slant_range_late_echo": _optional(
                    _PIXEL, "m", "subtracted delay of the echo by scattering"
                ),
                **_RANGE_TERMS,
                "intensity": _needed(_PIXEL, "V", "amplitude of the target signal"),
                "quality_flag": _needed(_PIXEL, "1", "reason why a pixel is doubtful"),
                "water_residual_cause": _optional(_PIXEL, "1", _CAUSE),
                **PIXEL_TESTS,
                **_IMAGE_TESTS,
                **{
                    name: replace(spec, dimensions=_PIXEL)
                    for name, spec in SAMPLE_TESTS.items()
                },
            },
            {**_PIXEL_COORDINATES, **_READING_COORDINATES},
        ),
        Level(
            "point_cloud",
            {
                "x": _needed(_POINT, "m", "position to the right"),
                "y": _needed(_POINT, "m", "position downwards"),
                "z": _needed(_POINT, "m", "position forwards"),
                "intensity": _needed(_POINT, "V", "amplitude of the target signal"),
                "slant_range_uncertainty": _needed(
                    _POINT, "m", "standard uncertainty of the slant range"
                ),
                "slant_range_common_uncertainty": _optional(
                    _POINT, "m", "part of the uncertainty that all points share"
                ),
                "x_uncertainty": _optional(_POINT, "m", "standard uncertainty of x"),
                "y_uncertainty": _optional(_POINT, "m", "standard uncertainty of y"),
                "z_uncertainty": _optional(_POINT, "m", "standard uncertainty of z"),
                "xy_covariance": _optional(_POINT, "m2", "covariance of x and y"),
                "xz_covariance": _optional(_POINT, "m2", "covariance of x and z"),
                "yz_covariance": _optional(_POINT, "m2", "covariance of y and z"),
                "quality_flag": _optional(
                    _POINT, "1", "reason why a point is doubtful"
                ),
                "time": _optional(
                    _POINT, "s", "mean time of the readings, by the trajectory's clock"
                ),
                "row": _needed(_POINT, "1", "row of the scan"),
                "column": _needed(_POINT, "1", "column of the scan"),
            },
            {"geometry": _PIXEL_COORDINATES["geometry"]},
        ),
    )
}

#: Groups of a file; in memory their variables carry the name as a prefix, so that
#: selecting a frequency or a channel selects it in the group too.
GROUPS = ("open_water", "truth")

_SHOT = ("modulation_frequency", "polarization", "shot")
OPEN_WATER_VARIABLES = {
    "in_phase": _needed(_SHOT, "V", "lock-in output without a target, in phase"),
    "quadrature": _needed(_SHOT, "V", "lock-in output without a target, quadrature"),
    "in_phase_uncertainty": _needed(
        _SHOT, "V", "standard uncertainty of the in-phase output"
    ),
    "quadrature_uncertainty": _needed(
        _SHOT, "V", "standard uncertainty of the quadrature output"
    ),
    "in_phase_quadrature_covariance": _optional(
        _SHOT, "V2", "covariance of the two outputs"
    ),
    "common_in_phase_uncertainty": _optional(
        _CHANNEL, "V", "part of the in-phase error that all shots share"
    ),
    "common_quadrature_uncertainty": _optional(
        _CHANNEL, "V", "part of the quadrature error that all shots share"
    ),
    "common_covariance": _optional(
        _CHANNEL, "V2", "covariance of the errors that all shots share"
    ),
    "azimuth": _optional(("shot",), "rad", "direction of the beam"),
    "elevation": _optional(("shot",), "rad", "direction of the beam"),
}

#: Inputs of a simulated cube.
TRUTH_VARIABLES = {
    "slant_range": _needed(_PIXEL, "m", "distance from the emitter along the beam"),
    "target": _needed(_PIXEL, "1", "number of the target met, -1 for none"),
    "target_in_phase": _needed(_SAMPLE, "V", "target signal, in phase"),
    "target_quadrature": _needed(_SAMPLE, "V", "target signal, quadrature"),
    "water_in_phase": _needed(_SAMPLE, "V", "water signal, in phase"),
    "water_quadrature": _needed(_SAMPLE, "V", "water signal, quadrature"),
}
GROUP_VARIABLES = {"open_water": OPEN_WATER_VARIABLES, "truth": TRUTH_VARIABLES}

#: Attributes of the scalar coordinate `geometry`, by which a phase becomes a point in
#: space. Positions [m] are (right, down, forward).
GEOMETRY_ATTRIBUTES = {
    "group_index": "group index of the water, for the speed of the modulation [1]",
    "refractive_index": "phase index of the water, for the refraction of the beam [1]",
    "emitter_position": "start of the beam, if the cube has no origin_x, _y, _z [m]",
    "receiver_position": "middle of the receiver's aperture [m]",
}
#: Present together, or not at all (emitter in the water).
WINDOW_ATTRIBUTES = {
    "window_distance": "forward coordinate of the near face of the window [m]",
    "window_thickness": "thickness of the window [m]",
    "window_refractive_index": "phase index of the window [1]",
    "window_group_index": "group index of the window [1]",
}
#: Attributes of target signals and range images on errors of the instrument, and the
#: attribute of samples that simulated light in corners needs.
INSTRUMENT_ATTRIBUTES = {
    "channel_phase_probability": "probability of the phase between channels by chance "
    "[1]",
    "channel_phase_rad": "largest phase between channels of the target, for each "
    "frequency; present if the probability is below 1e-4 [rad]",
    "frequency_phase_probability": "probability by chance of the deviations of two or "
    "more frequencies from one optical path [1]",
    "frequency_phase_rad": "deviation of each frequency from the optical path of all; "
    "present if the probability is below 1e-4 [rad]",
    "amplitude_phase_probability": "probability by chance of a phase step between "
    "darker and brighter neighboring pixels [1]",
    "amplitude_phase_rad": "phase of the brighter pixels minus phase of the darker "
    "pixels; present if the probability is below 1e-4 [rad]",
    "output_step_volt": "largest step of outputs that are rounded coarsely [V]",
    "output_step_ratio": "largest ratio of the rounding error to the stated noise [1]",
    "uncalibrated_share": "fraction of the samples whose amplitude is beyond those of "
    "the calibration [1]",
    "phase_error_gain_<channel>": "phase error of the target signal per phase error of "
    "the instrument, for each frequency [1]",
    "calibration": "text of the calibration that was applied to the samples (TOML)",
    "calibration_delay_uncertainty_s": "standard uncertainty of the calibrated delay, "
    "equal for all frequencies [s]",
    "calibration_phase_uncertainty_rad": "standard uncertainty of the calibrated "
    "phases, for each frequency [rad]",
    "reference_calibrated": "1 if the samples are corrected to the phase that the "
    "standing reference had during the calibration of the delay",
    "reference_drift_rad": "phase of the standing reference minus the mean of its "
    "smallest and largest phase, for each frequency, channel and time [rad]",
    "reference_phase_rad": "phase of the standing reference to which the samples are "
    "corrected, for each frequency and channel [rad]",
    "reference_phase_uncertainty_rad": "standard uncertainty of the subtracted phase "
    "drift, for each frequency [rad]",
    "reference_time_s": "times of reference_drift_rad [s]",
    "leakage_uncertainty_volt": "standard uncertainty of the subtracted leakage, for "
    "each frequency [V]",
    "offset_uncertainty_volt": "standard uncertainty of the subtracted offset of the "
    "demodulator outputs, for each frequency [V]",
    "demodulator_calibrated": "1 if gain and angle of the demodulator outputs were "
    "corrected",
    "channel_gain_uncertainty": "standard uncertainty of the corrected gain of the "
    "channels, for each frequency [1]",
    "channel_crosstalk_uncertainty": "standard uncertainty of the corrected cross-talk "
    "of the channels [1]",
    "temperature_delay_uncertainty_s": "standard uncertainty of the delay by the "
    "instrument temperature, for each frequency [s]",
    "temperature_recorded": "1 if the phases are corrected for the instrument "
    "temperature, 0 if no temperature was recorded",
    "shutter": "`closed` in samples that were recorded with a closed shutter",
    "corner_light": "`present` or `absent`: whether the samples contain light that "
    "corners reflect twice. Default: absent in simulated samples, else present",
    "surroundings_light": "`present` or `absent`: whether the samples contain "
    "scattered light of the surroundings. Default: absent in simulated samples, else "
    "present",
}
