"""From the phase of the target signal to slant ranges with their uncertainty."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import UNUSABLE, QualityFlag
from amulor.errors import CubeError, SurveyError
from amulor.imaging.geometry import beams_of, medium_of, receivers_of
from amulor.optics import ambiguity, detection, ranging, rays
from amulor.survey import Survey
from amulor.survey.reach import unsettled_interval

Floats = NDArray[np.float64]


def range_image(
    cube: xr.Dataset,
    *,
    polarization: str | None = None,
    interval: tuple[float, float] | None = None,
) -> xr.Dataset:
    """Turn the phase of the target signal into a slant range for every pixel.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `target_signal`. All its frequencies are used together.
    polarization : str, optional
        Channel to take; needed if there are several.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m]. By default from 0 to
        where the phases repeat, if the targets of the cube's survey lie in between.

    Returns
    -------
    xarray.Dataset
        Level `range_image`. Pixels with an unusable flag hold no number. Where neither
        an interval nor the survey says which repetition of the phases is right, ranges
        are those of the first, all pixels are flagged `RELATIVE`, and the attribute
        `interval_unsettled` says why.

    Raises
    ------
    CubeError
        If the channel is not there, or has to be chosen.
    ValueError
        If the interval is empty or holds far too many ambiguity intervals.

    Notes
    -----
    The optical path follows from (1) of [1]_, and the slant range from the path by the
    geometry of emitter, receiver and window. `slant_range_uncertainty` comes from the
    uncertainty of the samples, `slant_range_photon_limit` is (2) with the photons that
    the target alone sent, `slant_range_bias` the shift by the water signal estimated
    to be left in, `slant_range_wrong_interval` the probability that another interval
    within the limits is the right one.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.
    """
    cube = cubes.checked(cube, "target_signal")
    one = channel_of(cube, polarization)
    medium = medium_of(one)
    frequency = one["modulation_frequency"].values
    shortest, longest = rays.path_limits(
        interval,
        beams_of(one),
        receivers_of(one),
        medium=medium,
        modulation_frequency=frequency,
    )
    flag, sigma, shift = phase_errors(one)
    path = ambiguity.optical_path(
        np.where((flag & UNUSABLE) == 0, np.angle(one.amulor.signal.values), 0.0),
        sigma,
        modulation_frequency=frequency,
        shortest=shortest,
        longest=longest,
        doubt=np.nan_to_num(np.abs(shift), nan=np.inf),
    )
    image = image_of_path(one, path, interval=interval)
    reason = "" if interval is not None else _unsettled(one)
    if reason:
        flagged = image["quality_flag"] | np.int16(QualityFlag.RELATIVE)
        image["quality_flag"] = flagged.assign_attrs(image["quality_flag"].attrs)
        image = image.assign_attrs(interval_unsettled=reason)
    return cubes.note(image, f"image, channel {image.attrs['polarization']}")


def _unsettled(one: xr.Dataset) -> str:
    """Return why phases alone do not tell the range; empty if the survey settles it."""
    text = one.attrs.get("survey")
    try:
        survey = Survey.from_text(text) if text else None
    except SurveyError:
        survey = None
    return unsettled_interval(
        survey, modulation_frequency=one["modulation_frequency"].values
    )


def phase_errors(
    one: xr.Dataset,
) -> tuple[NDArray[np.int16], Floats, Floats]:
    """Return flags, phase errors and phase shifts by water of one channel.

    Parameters
    ----------
    one : xarray.Dataset
        Level `target_signal` without the dimension polarization.

    Returns
    -------
    tuple of three ndarrays
        Flags over (row, column), all frequencies together; phase error and shift by
        the water left in, over (modulation_frequency, row, column) [rad].
    """
    signal = one.amulor.signal.values
    flag = np.bitwise_or.reduce(one["quality_flag"].values, axis=0).astype(np.int16)
    sigma = _phase_uncertainty(one, signal, (flag & UNUSABLE) == 0, "")
    return flag, sigma, _phase_left_in(one, signal)


def image_of_path(
    one: xr.Dataset, path: ambiguity.Path, *, interval: tuple[float, float] | None
) -> xr.Dataset:
    """Return the range image that belongs to optical paths.

    Parameters
    ----------
    one : xarray.Dataset
        Level `target_signal` without the dimension polarization.
    path : amulor.optics.ambiguity.Path
        Optical path of every pixel.
    interval : tuple of float, optional
        Limits of the slant range that were used [m].

    Returns
    -------
    xarray.Dataset
        Level `range_image`.
    """
    medium = medium_of(one)
    frequency = one["modulation_frequency"].values
    beam, receiver = beams_of(one), receivers_of(one)
    signal = one.amulor.signal.values
    flag, _, shift = phase_errors(one)
    usable = (flag & UNUSABLE) == 0
    # The optical path, out and back, is twice the range at a group index of 1.
    to_path = 2 * ranging.range_per_phase(frequency[:, None, None], group_index=1.0)

    def to_range(length: Floats) -> Floats:
        return rays.slant_range_of_path(length, beam, receiver, medium=medium)

    slant_range = to_range(path.length)
    slope = (to_range(path.length + _DIFFERENCE) - slant_range) / _DIFFERENCE
    settled = path.settled & np.isfinite(slant_range) & np.isfinite(slope)
    flag[usable & ~settled] |= QualityFlag.AMBIGUOUS
    usable = (flag & UNUSABLE) == 0
    variance = path.uncertainty**2
    variables: dict[str, NDArray[Any]] = {}
    if "residual_in_phase" in one:
        bias = np.sum(path.weight * to_path * shift, axis=0)
        variables["slant_range_bias"] = slope * bias
    if "common_covariance" in one:
        shared = _phase_uncertainty(one, signal, usable, "common_")
        # Errors that pixels share may be shared by the frequencies as well: a wrong
        # depolarization ratio is. Added as such, they make an upper limit. References
        # are measured anew at each frequency.
        apart = np.sum((path.weight * to_path * shared) ** 2, axis=0)
        together = apart
        if one.attrs.get("frequencies_share_errors", 1):
            together = np.sum(path.weight * to_path * shared, axis=0) ** 2
        variance = variance - apart + together
        variables["slant_range_common_uncertainty"] = slope * np.sqrt(together)
    variables["slant_range"] = slant_range
    if frequency.size > 1:
        variables["slant_range_wrong_interval"] = path.wrong
    variables["slant_range_uncertainty"] = slope * np.sqrt(variance)
    if "photon_noise_volt" in one.attrs:
        variables["slant_range_photon_limit"] = _photon_limit(one, medium.group_index)
    variables = {
        name: np.where(usable, values, np.nan) for name, values in variables.items()
    }
    image = cubes.build(
        "range_image",
        variables | {"intensity": np.abs(signal[0]), "quality_flag": flag},
        {
            str(name): one[name].values
            for name in one.coords
            if name not in ("geometry", "modulation_frequency", "polarization")
        },
        geometry=one.amulor.geometry,
        attributes={
            **one.attrs,
            "level": "range_image",
            "polarization": str(one["polarization"].item()),
            "modulation_frequencies": frequency,
            **({} if interval is None else {"interval": np.array(interval)}),
        },
    )
    truth = one.amulor.truth
    if truth is not None:
        pixel_truth = truth[[n for n in truth if truth[n].dims == ("row", "column")]]
        image = cubes.attach(image, pixel_truth, "truth")
    return image


#: Step of the optical path for the derivative of the slant range [m].
_DIFFERENCE = 1e-5


def channel_of(cube: xr.Dataset, polarization: str | None) -> xr.Dataset:
    """Return one polarization channel of a cube.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `target_signal`.
    polarization : str, optional
        Channel to take; needed if there are several.

    Returns
    -------
    xarray.Dataset
        Without the dimension polarization.

    Raises
    ------
    CubeError
        If the channel is not there, or has to be chosen.
    """
    present = cube.amulor.polarizations
    if polarization is None and len(present) > 1:
        raise CubeError(
            f"the cube has the channels {', '.join(present)}; choose one with "
            "polarization (command line: --polarization)"
        )
    chosen = present[0] if polarization is None else polarization
    if chosen not in present:
        raise CubeError(
            f"the cube has no channel {chosen!r}, but {', '.join(present)}; choose one"
        )
    return cube.sel(polarization=chosen)


def _phase_left_in(cube: xr.Dataset, signal: NDArray[np.complex128]) -> Floats:
    """Return the phase shift by water left in, NaN where it is not known."""
    if "residual_in_phase" in cube:
        left = (
            cube["residual_in_phase"].values + 1j * cube["residual_quadrature"].values
        )
        return ranging.phase_shift(signal, residual=left)
    taken_out = (cube["quality_flag"].values & QualityFlag.NO_OPEN_WATER) == 0
    return np.where(taken_out, 0.0, np.nan)


def _phase_uncertainty(
    cube: xr.Dataset,
    signal: NDArray[np.complex128],
    usable: NDArray[np.bool_],
    prefix: str,
) -> Floats:
    """Return the phase error from the errors of the outputs, infinite if unusable."""
    in_phase = cube[f"{prefix}in_phase_uncertainty"].values ** 2
    quadrature = cube[f"{prefix}quadrature_uncertainty"].values ** 2
    if prefix:
        cross = cube[f"{prefix}covariance"].values
    else:
        cross = cube.amulor.covariance.values
    good = np.broadcast_to(usable, signal.shape)
    return detection.phase_uncertainty(
        np.where(good, signal, 1.0),
        in_phase_variance=np.where(good, in_phase, 1.0),
        quadrature_variance=np.where(good, quadrature, 1.0),
        covariance=np.where(good, cross, 0.0),
    )


def _photon_limit(cube: xr.Dataset, group_index: float) -> Floats:
    """Return (2) for the photons of the target alone, all frequencies together [m]."""
    depth = float(cube.attrs["modulation_depth"])
    amplitude = cube.amulor.amplitude.values
    frequency = cube["modulation_frequency"].values[:, None, None]
    # The counting variance of an amplitude A is volt * A / depth = 2 A^2 / depth^2 N.
    with np.errstate(divide="ignore"):
        photoelectrons = (
            2 * amplitude / (depth * float(cube.attrs["photon_noise_volt"]))
        )
        each = ranging.photon_limited_uncertainty(
            np.maximum(photoelectrons, np.finfo(float).tiny),
            modulation_depth=depth,
            modulation_frequency=frequency,
            group_index=group_index,
        )
    return ranging.weights_and_uncertainty(each)[1]
