"""Slant ranges and their uncertainty from the phase of the target signal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor._progress import tell
from amulor.cube import LEVELS, QualityFlag
from amulor.cube.error import JOINT_OUTLIERS, instrument_phase
from amulor.cube.readings import reading_weight
from amulor.cube.schema import PIXEL_TESTS
from amulor.cube.tiles import Span
from amulor.imaging import budget
from amulor.imaging.amplitude_phase import AmplitudePhase, amplitude_phase
from amulor.imaging.common import with_flag
from amulor.imaging.corners import Patches
from amulor.imaging.instrument_tests import FrequencyPhase, frequency_phase
from amulor.imaging.late_light import LateFit, dispersion
from amulor.imaging.observation import Observation, channel_of, noise_scale, observe
from amulor.imaging.ranges import (
    Ranges,
    RangesFit,
    ranges_of_joint,
    ranges_of_path,
    weight_of,
)
from amulor.imaging.surroundings import SurroundingLight
from amulor.optics import ambiguity, ranging
from amulor.optics._mixed_beam import SpreadFit, mixed_beams
from amulor.survey.reach import unsettled_interval

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PathFit:
    """Scan-wide statistics for the estimate of optical paths."""

    first: ambiguity.Choices
    """Ambiguity statistics before late light is subtracted."""
    weight: Floats
    """Weights of the frequencies, normalized to a sum of 1 [1]."""
    late: LateFit
    """Statistics of late light, from the paths before its subtraction."""
    second: ambiguity.Choices | None = None
    """Ambiguity statistics after subtraction of late light; None if not subtracted."""


@dataclass(frozen=True, kw_only=True)
class RangeImageFit:
    """Scan-wide statistics from which a range image is computed."""

    ranges: RangesFit
    """Statistics for slant ranges: frequency weights and error terms."""
    late: LateFit
    """Statistics for late light in the final ranges."""
    around: SurroundingLight | None = None
    """Light of the surroundings; None for a cube without such light."""
    patches: Patches | None = None
    """Surface patches with mutual illumination; None for a cube without such light."""
    phases: FrequencyPhase | None = None
    """Test of the phases of all frequencies; None with one frequency."""
    steps: AmplitudePhase | None = None
    """Test of the phases against the amplitude; None with one frequency."""
    path: PathFit | None = None
    """Statistics for optical paths; None after a joint estimation."""
    noise_scale: float = 1.0
    """Ratio of the observed noise of the phases to the stated noise [1]."""
    rescaled: PathFit | None = None
    """Statistics for optical paths with scaled noise; None without scaling."""
    spread: SpreadFit | None = None
    """Typical fall of the amplitudes with the frequency; None if unknown."""


def range_image(
    cube: xr.Dataset,
    *,
    polarization: str | None = None,
    interval: tuple[float, float] | None = None,
) -> xr.Dataset:
    r"""Slant range and uncertainty of every pixel from the phase of the target signal.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `target_signal`. All its frequencies are used together.
    polarization : str, optional
        Channel to use; needed if there are several.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m]. By default from 0 to
        where the phases repeat, if the targets of the cube's survey lie in between.

    Returns
    -------
    xarray.Dataset
        Level `range_image`:

        - Pixels with an unusable flag are NaN.
        - If the water was not removed, or the ambiguity interval is unknown, the
          errors are unknown and the combined uncertainties are NaN.
        - If neither an interval nor the survey determines the ambiguity interval,
          ranges are those of the first. All pixels are flagged `RELATIVE`, and the
          attribute `interval_unsettled` states the reason.

    Raises
    ------
    CubeError
        If the channel is missing, or must be chosen among several.
    ValueError
        If the interval is empty or contains far too many ambiguity intervals.

    Notes
    -----
    The optical path follows from eq. (1) of [1]_, and the slant range from the path and
    the geometry of emitter, receiver and window. `slant_range_uncertainty` is
    propagated from the uncertainty of the samples. `slant_range_photon_limit` is eq.
    (2) for the photons of the target alone. `slant_range_bias` is the shift by the
    estimated residual water signal. `slant_range_wrong_interval` is the probability
    that another ambiguity interval within the limits is right. If the phases of several
    frequencies scatter more than stated, the stated noise is multiplied by the
    attribute `noise_scale`.

    Two surfaces in a beam turn the phases of all frequencies nearly alike, but weaken
    high frequencies. To second order the logarithm of the amplitude at a phase per
    range :math:`\kappa` falls by :math:`\kappa^2 \sigma_z^2 / 2`, where
    :math:`\sigma_z` is the standard deviation of the range within the beam,
    `range_spread`. A pixel whose amplitudes fall by five standard errors more than in
    the scan is `MIXED`. This needs two frequencies, and one surface in most of the
    beams.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)  # the water is still in: a little too near
    >>> found = float(image["slant_range"][20, 2])
    >>> print(f"{found:.2f} m, true {float(image['truth_slant_range'][20, 2]):.2f} m")
    1.49 m, true 1.50 m
    """
    return fitted_range_image(cube, polarization=polarization, interval=interval)[0]


def fitted_range_image(
    cube: xr.Dataset,
    *,
    polarization: str | None = None,
    interval: tuple[float, float] | None = None,
    fit: RangeImageFit | None = None,
    span: Span | None = None,
) -> tuple[xr.Dataset, RangeImageFit]:
    """Range image, and its scan-wide statistics, taken from `fit` if given."""
    cube = cubes.checked(cube, "target_signal")
    joint = "joint_slant_range" in cube
    if joint and polarization is None:
        polarization = cube.amulor.polarizations[0]
    most = JOINT_OUTLIERS if joint else ambiguity.BREAKDOWN
    observation = observe(channel_of(cube, polarization), most_outliers=most, span=span)
    of_ranges = None if fit is None else fit.ranges
    of_path = None if fit is None else fit.path
    rescaled = None if fit is None else fit.rescaled
    factor = 1.0 if fit is None else fit.noise_scale
    phases = None if fit is None else fit.phases
    steps = None if fit is None else fit.steps
    spread = None if fit is None else fit.spread
    if joint:
        ranges, of_ranges = ranges_of_joint(
            observation, interval=interval, fit=of_ranges
        )
    else:
        tell("ranges and their intervals", 0.0)
        path, of_path = _settled_path(observation, interval, fit=of_path)
        if fit is None:
            factor = noise_scale(
                path,
                observation.own_sigma,
                path_per_phase=observation.path_per_phase,
                motion=observation.motion(of_path.weight),
                refit=lambda factor: _settled_path(
                    observation.with_noise(factor), interval
                )[0],
            )
        if factor > 1:
            tell("ranges with the noise that shows", 0.3)
            observation = observation.with_noise(factor)
            path, rescaled = _settled_path(observation, interval, fit=rescaled)
        ranges, of_ranges = ranges_of_path(observation, path, fit=of_ranges)
        ranges, spread = _with_mixed(
            observation, ranges, spread, fitted=fit is not None
        )
        if fit is None:
            phases = frequency_phase(observation, path)
            steps = amplitude_phase(observation, path, weight=of_path.weight)
    samples = cube if joint else observation.channel
    weight = np.asarray(of_ranges.weight)
    if joint:
        weight = reading_weight(observation.frequency, len(cube.amulor.polarizations))
    readings = _readings(samples, weight)
    deviations = [] if phases is None or not phases.is_real else [phases.phase]
    if steps is not None and steps.is_real:
        # The darker or the brighter pixels may be right.
        deviations.append(np.full(observation.frequency.size, steps.step))
    if deviations:
        size = np.linalg.norm(deviations, axis=0)
        observation = observation.with_frequency_phase(size)
    tell("error budget", 0.6)
    late = None if fit is None else fit.late
    patches = None if fit is None else fit.patches
    around = None if fit is None else fit.around
    image, late, patches, around = _image(
        observation, ranges, interval=interval, fit=late, patches=patches, around=around
    )
    image = image.assign_coords(readings)
    if "truth_reading_slant_range" in samples:
        true = _in_order(samples, "truth_reading_slant_range")
        image["truth_slant_range"].values = np.tensordot(weight, true, 1)
    for test in (phases, steps):
        if test is not None:
            image = image.assign_attrs(test.attributes)
    reason = ""
    if interval is None:
        reason = unsettled_interval(
            observation.survey, modulation_frequency=observation.frequency
        )
    if reason:
        image = with_flag(image, QualityFlag.RELATIVE, True)
        image = cubes.without_unknown_errors(image)
        image = image.assign_attrs(interval_unsettled=reason)
    step = f"image, channel {image.attrs['polarization']}"
    image = cubes.note(
        image, f"{step}, ranges of the joint estimation" if joint else step
    )
    return image, RangeImageFit(
        ranges=of_ranges,
        late=late,
        patches=patches,
        around=around,
        phases=phases,
        steps=steps,
        path=of_path,
        noise_scale=factor,
        rescaled=rescaled,
        spread=spread,
    )


def _with_mixed(
    observation: Observation,
    ranges: Ranges,
    fit: SpreadFit | None,
    *,
    fitted: bool,
) -> tuple[Ranges, SpreadFit | None]:
    """Ranges with mixed beams flagged by their amplitudes, and the fit of the scan."""
    if fitted and fit is None:
        return ranges, None
    # Amplitudes of phasor lines are those of the samples, with the water.
    if "phasor_line_window" in observation.channel.attrs:
        return ranges, None
    per_range = ranging.phase_per_range(
        observation.frequency, group_index=observation.geometry.medium.group_index
    )
    mixed, spread, fit = mixed_beams(
        np.abs(observation.signal),
        observation.sigma,
        phase_per_range=per_range,
        slant_range=np.where(ranges.usable, ranges.slant_range, np.nan),
        uncertainty=ranges.total,
        fit=fit,
    )
    if not mixed.any():
        return ranges, fit
    flag = np.where(mixed, ranges.flag | np.int16(QualityFlag.MIXED), ranges.flag)
    tests = {**ranges.tests, "range_spread": np.where(mixed, spread, np.nan)}
    return replace(ranges, flag=flag, tests=tests), fit


def _settled_path(
    observation: Observation,
    interval: tuple[float, float] | None,
    *,
    fit: PathFit | None = None,
) -> tuple[ambiguity.Path, PathFit]:
    """Best-fitting optical path of a channel's phases, and the statistics used."""
    usable, phase = observation.usable, observation.phase
    if fit is None:
        weight = weight_of(observation.frequency, observation.sigma, usable)
    else:
        weight = fit.weight
    shortest, longest = observation.geometry.path_limits(
        interval, observation.frequency
    )
    instrument = instrument_phase(observation.channel, observation.survey)
    doubt = np.hypot(
        np.nan_to_num(np.abs(observation.shift), nan=np.inf),
        instrument[:, None, None],
    )
    motion = observation.motion(weight)

    def path_of(
        phase: Floats, doubt: Floats, choices: ambiguity.Choices | None
    ) -> tuple[ambiguity.Path, ambiguity.Choices]:
        arguments: dict[str, Any] = {
            "phase": phase,
            "uncertainty": observation.sigma,
            "modulation_frequency": observation.frequency,
            "shortest": shortest,
            "longest": longest,
            "doubt": doubt,
            "motion": motion,
        }
        if choices is None:
            return ambiguity.fit(**arguments)
        return ambiguity.optical_path(**arguments, choices=choices), choices

    path, first = path_of(phase, doubt, None if fit is None else fit.first)
    late, late_fit = dispersion(
        observation,
        np.where(usable, observation.geometry.slant_range(path.length), np.nan),
        weight=weight,
        fit=None if fit is None else fit.late,
    )
    second = None
    if late is not None:
        second = None if fit is None else fit.second
        path, second = path_of(phase - late[0], np.hypot(doubt, late[1]), second)
    return path, PathFit(first=first, weight=weight, late=late_fit, second=second)


def image_of_path(
    observation: Observation,
    path: ambiguity.Path,
    *,
    interval: tuple[float, float] | None,
) -> xr.Dataset:
    """Range image from given optical paths."""
    return _image(observation, ranges_of_path(observation, path)[0], interval=interval)[
        0
    ]


def _image(
    observation: Observation,
    ranges: Ranges,
    *,
    interval: tuple[float, float] | None,
    fit: LateFit | None = None,
    patches: Patches | None = None,
    around: SurroundingLight | None = None,
) -> tuple[xr.Dataset, LateFit, Patches | None, SurroundingLight | None]:
    """Range image with error budget; return also the statistics of its terms."""
    ranges, attributes, fit, patches, around = budget.completed(
        observation, ranges, fit=fit, patches=patches, around=around
    )
    channel, usable = observation.channel, ranges.usable
    variables: dict[str, NDArray[Any]] = {
        "slant_range": ranges.slant_range,
        **budget.uncertainties(ranges),
        **ranges.others,
    }
    if "photon_noise_volt" in channel.attrs:
        variables["slant_range_photon_limit"] = _photon_limit(observation)
    variables = {
        name: np.where(usable, values, np.nan) for name, values in variables.items()
    }
    intensity = np.abs(observation.signal[0])
    image = cubes.build(
        "range_image",
        variables
        | {"intensity": intensity, "quality_flag": ranges.flag}
        | _tests_of(channel)
        | ranges.tests,
        {
            str(name): channel[name].values
            for name in channel.coords
            if name in LEVELS["range_image"].coordinates
            and name not in ("geometry", *_WINDOWS)
        },
        geometry=channel.amulor.geometry,
        attributes={
            **channel.attrs,
            "level": "range_image",
            "polarization": str(channel["polarization"].item()),
            "modulation_frequencies": observation.frequency,
            **({} if interval is None else {"interval": np.array(interval)}),
            **attributes,
        },
    )
    truth = channel.amulor.truth
    if truth is not None:
        pixel_truth = truth[[n for n in truth if truth[n].dims == ("row", "column")]]
        image = cubes.attach(image, pixel_truth, "truth")
    return cubes.without_unknown_errors(image), fit, patches, around


#: Times of readings, which an image has for all readings of its ranges.
_WINDOWS = ("reading_time", "reading_duration")


def _readings(samples: xr.Dataset, weight: Floats) -> dict[str, xr.Variable]:
    """Return times and weights of the readings of the ranges.

    `samples` has all frequencies of a channel, or of all channels of a joint
    estimation, and so have the weights. Readings at the same time count once.
    """
    if not all(name in samples.coords for name in _WINDOWS):
        return {}
    time, duration = (_in_order(samples, name) for name in _WINDOWS)
    if (time == time[:1]).all():
        time, duration, weight = time[:1], duration[:1], np.ones(1)
    values = time, duration, weight
    specs = LEVELS["range_image"].coordinates
    return {
        name: xr.Variable(
            specs[name].dimensions,
            array,
            {"units": specs[name].units, "long_name": specs[name].long_name},
        )
        for name, array in zip((*_WINDOWS, "reading_weight"), values, strict=True)
    }


def _in_order(samples: xr.Dataset, name: str) -> Floats:
    """Return a quantity of all readings, shape (reading, row, column)."""
    values = samples[name]
    order = [
        dimension
        for dimension in ("polarization", "modulation_frequency")
        if dimension in values.dims
    ]
    ordered = values.transpose(*order, "row", "column").values
    return np.asarray(ordered.reshape(-1, *ordered.shape[-2:]), dtype=float)


#: Statistic of a pixel from those of its frequencies: the one nearest to a flag.
_OF_FREQUENCIES = {
    "signal_significance": np.fmin.reduce,
    "residual_phase_ratio": np.fmax.reduce,
    "channel_disagreement": np.fmax.reduce,
}


def _tests_of(channel: xr.Dataset) -> dict[str, NDArray[Any]]:
    """Test statistics behind the flags of a channel's pixels."""
    tests = {name: channel[name].values for name in PIXEL_TESTS if name in channel}
    for name, reduce in _OF_FREQUENCIES.items():
        if name in channel:
            tests[name] = reduce(channel[name].values, axis=0)
    if "water_residual_cause" in channel:
        cause = channel["water_residual_cause"].values
        tests["water_residual_cause"] = np.bitwise_or.reduce(cause, axis=0)
    return tests


def _photon_limit(observation: Observation) -> Floats:
    """Range uncertainty from photon noise of the target signal alone [m]."""
    attributes = observation.channel.attrs
    depth = float(attributes["modulation_depth"])
    amplitude = np.abs(observation.signal)
    # The counting variance of an amplitude A is volt * A / depth = 2 A^2 / depth^2 N.
    with np.errstate(divide="ignore"):
        photoelectrons = (
            2 * amplitude / (depth * float(attributes["photon_noise_volt"]))
        )
        sigma = ranging.photon_limited_uncertainty(
            np.maximum(photoelectrons, np.finfo(float).tiny),
            modulation_depth=depth,
            modulation_frequency=observation.frequency[:, None, None],
            group_index=observation.geometry.medium.group_index,
        )
    return ranging.weights_and_uncertainty(sigma)[1]
