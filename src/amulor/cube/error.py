"""Pixel flags derived from sample flags, and images with unknown range error."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube.schema import ERROR_UNKNOWN, QualityFlag, flag_words
from amulor.optics.ambiguity import BREAKDOWN
from amulor.survey import Survey
from amulor.survey.properties import phase_uncertainty

__all__ = [
    "JOINT_OUTLIERS",
    "SHAPE_KNOWN",
    "WATER_NOT_REMOVED",
    "error_unknown",
    "flags_of_pixels",
    "without_unknown_errors",
]


#: A test of the instrument fails if chance makes so large a result in fewer cases [1].
LARGEST_CHANCE = 1e-4
#: Attributes with the result of the test of all frequencies against one distance.
FREQUENCY_PROBABILITY = "frequency_phase_probability"
FREQUENCY_PHASES = "frequency_phase_rad"
#: Attributes with the result of the test of the phases against the amplitude.
AMPLITUDE_PROBABILITY = "amplitude_phase_probability"
AMPLITUDE_PHASE = "amplitude_phase_rad"
#: Attribute with the fraction of samples beyond the amplitudes of a calibration [1].
UNCALIBRATED_SHARE = "uncalibrated_share"
#: Attributes with the largest step of rounded outputs [V], and with the largest ratio
#: of the rounding error to the stated noise [1].
OUTPUT_STEP = "output_step_volt"
OUTPUT_STEP_RATIO = "output_step_ratio"
#: A target counts as present if no more than this fraction of the frequencies lacks it
#: [1].
_HALF = 0.5
#: Joint estimation has excluded its outliers itself, so that any fraction below all is
#: accepted [1].
JOINT_OUTLIERS = 1 - 1e-9
#: Frequencies from which on the samples show the shape of the water signal. With fewer
#: ones, errors of a joint estimation contain the late light of water of any shape.
SHAPE_KNOWN = 4


def flags_of_pixels(
    flag: NDArray[np.int16], *, most_outliers: float = BREAKDOWN
) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
    """Return pixel flags combined over frequencies, and a mask of ignored samples."""
    unseen = (flag & QualityFlag.NO_TARGET) != 0
    # A target at half of the frequencies is present; the other frequencies are omitted.
    unseen &= unseen.mean(axis=0) <= _HALF
    outlying = (flag & QualityFlag.OUTLIER) != 0
    # The other frequencies determine the range without a few outliers.
    outlying &= outlying.mean(axis=0) <= most_outliers
    flags = np.where(unseen, flag & ~QualityFlag.NO_TARGET, flag)
    flags = np.where(outlying, flags & ~QualityFlag.OUTLIER, flags)
    return np.bitwise_or.reduce(flags, axis=0).astype(np.int16), unseen | outlying


def may_contain(cube: xr.Dataset, light: str) -> bool:
    """Return whether samples may contain light of a kind (cube attribute).

    Measured samples do unless they say otherwise. Models that do not mention such light
    simulate none.
    """
    default = "absent" if cube.attrs.get("simulated", 0) else "present"
    return str(cube.attrs.get(light, default)) != "absent"


def instrument_phase(channel: xr.Dataset, survey: Survey | None) -> NDArray[np.float64]:
    """Return the phase uncertainty of the instrument at each frequency [rad].

    The stated or typical size, the errors of calibrated phases and of the drift that a
    standing reference shows, and the phase between channels where chance does not
    explain it. The combination of channels multiplies all but the last.
    `channel` is a target signal with one channel.
    """
    count = channel.sizes["modulation_frequency"]
    measured = "leakage_uncertainty_volt" in channel.attrs
    stated = 0.0
    if survey is not None:
        stated = phase_uncertainty(
            survey,
            leakage_measured=measured,
            demodulator_measured="demodulator_calibrated" in channel.attrs,
            phases_measured=UNCALIBRATED_SHARE in channel.attrs,
            frequencies=count,
        )
    table = by_frequency(channel, "calibration_phase_uncertainty_rad", 0.0)
    gain = by_frequency(channel, f"phase_error_gain_{_name(channel)}", 1.0)
    drift = by_frequency(channel, "reference_phase_uncertainty_rad", 0.0)
    phase = np.hypot(
        np.hypot(stated, np.hypot(table, drift)) * gain,
        by_frequency(channel, "channel_phase_rad", 0.0),
    )
    return np.broadcast_to(phase, (count,))


def leakage_volt(channel: xr.Dataset) -> NDArray[np.float64]:
    """Return the target-signal error [V] by measured leakage and offset, by frequency.

    The combination of channels multiplies it, by the smallest factor on phases: that of
    the strongest channel of the result.
    """
    gains = [
        by_frequency(channel, str(name), 1.0)
        for name in channel.attrs
        if str(name).startswith("phase_error_gain_")
    ]
    gain = np.min(gains, axis=0) if gains else 1.0
    leakage = by_frequency(channel, "leakage_uncertainty_volt", 0.0)
    offset = by_frequency(channel, "offset_uncertainty_volt", 0.0)
    return np.asarray(np.hypot(leakage, offset) * gain)


def by_frequency(channel: xr.Dataset, name: str, default: float) -> NDArray[np.float64]:
    """Return an attribute of a channel as numbers, one for each frequency."""
    values = np.atleast_1d(np.asarray(channel.attrs.get(name, default), dtype=float))
    count = channel.sizes["modulation_frequency"]
    # The cube has a single selected frequency.
    return values if values.size == count else np.full(count, values.max())


def _name(channel: xr.Dataset) -> str:
    return str(np.atleast_1d(channel["polarization"].values)[0])


WATER_NOT_REMOVED = flag_words()["pixel"]["NO_OPEN_WATER"]["short"]
_UNSETTLED = flag_words()["pixel"]["RELATIVE"]["short"]
#: Attribute of images and clouds with the reason.
_WORDS = "error_unknown"
#: Combined uncertainties; those of single terms are not changed.
_COMBINED = (
    "slant_range_uncertainty",
    "slant_range_common_uncertainty",
    "x_uncertainty",
    "y_uncertainty",
    "z_uncertainty",
)


def without_unknown_errors(cube: xr.Dataset) -> xr.Dataset:
    """Return a cube with combined uncertainties NaN where the error is unknown.

    Parameters
    ----------
    cube : xarray.Dataset
        Cube of any level; only range images and point clouds have such errors.

    Returns
    -------
    xarray.Dataset
        Cube in which uncertainties of pixels and points with a flag of `ERROR_UNKNOWN`
        are NaN. Its attribute `error_unknown` states the reason.

    Examples
    --------
    >>> from amulor import cube as cubes, imaging, rejection, samples
    >>> raw = rejection.keep_water(samples.cube("ladder"))
    >>> image = imaging.range_image(raw, polarization="VV")
    >>> image["slant_range_uncertainty"][:] = 0.001  # as if somebody knew
    >>> image = cubes.without_unknown_errors(image)
    >>> print(int(image["slant_range_uncertainty"].notnull().sum()), "stated")
    0 stated
    """
    names = [name for name in _COMBINED if name in cube]
    if not names or "quality_flag" not in cube:
        return cube
    valid = (cube["quality_flag"].values & ERROR_UNKNOWN) == 0
    if valid.all():
        return cube
    return cube.assign(
        {
            name: cube[name].copy(data=np.where(valid, cube[name].values, np.nan))
            for name in names
        }
    ).assign_attrs({_WORDS: _words(cube)})


def error_unknown(cube: xr.Dataset) -> str:
    """Return the reason why the ranges of an image or a cloud have an unknown error.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `range_image` or `point_cloud`.

    Returns
    -------
    str
        Statement without a full stop, with an estimate of the error caused by the water
        if the image has one. Empty if every range states its error.

    Examples
    --------
    >>> from amulor import cube as cubes, imaging, rejection, samples
    >>> raw = rejection.keep_water(samples.cube("ladder"))
    >>> cubes.error_unknown(imaging.range_image(raw, polarization="VV"))
    'water not removed: error unknown, expect centimeters'
    """
    words = _words(cube)
    bias, why = cube.get("slant_range_bias"), cube.attrs.get("interval_unsettled")
    if WATER_NOT_REMOVED in words and bias is not None and bias.notnull().any():
        middle = float(np.nanmedian(bias.values)) * 1e3
        estimate = (
            f"{WATER_NOT_REMOVED} (median of the estimated bias {middle:+.3g} mm)"
        )
        words = words.replace(WATER_NOT_REMOVED, estimate)
    if _UNSETTLED in words and why:
        words = words.replace(_UNSETTLED, f"{_UNSETTLED}: {why}")
    return words


def _words(cube: xr.Dataset) -> str:
    """Return the reason for an unknown range error, from flags and attributes."""
    flag = cube["quality_flag"].values if "quality_flag" in cube else np.zeros(1, int)
    attribute = str(cube.attrs.get(_WORDS, ""))
    reasons = {
        WATER_NOT_REMOVED: QualityFlag.NO_OPEN_WATER,
        _UNSETTLED: QualityFlag.RELATIVE,
    }
    return "; ".join(
        words
        for words, reason in reasons.items()
        if words in attribute or (flag & reason).any()
    )
