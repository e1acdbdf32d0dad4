"""One surface of a stepped-frequency range profile, without water and others."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor.cube import QualityFlag
from amulor.cube.schema import WaterResidualCause
from amulor.errors import CubeError
from amulor.optics import range_profile as profiles
from amulor.optics.late_echo import RELATIVE_UNCERTAINTY
from amulor.rejection import quality
from amulor.rejection.build import target_cube
from amulor.rejection.covariance import Covariance
from amulor.rejection.methods import method
from amulor.rejection.observation import Observation
from amulor.rejection.reference.late_phase import late_response

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Departure from the model, over its assumed error, that is a misfit [1].
_MISFIT = 2.0
#: Least amplitude of the nearest or farthest surface, in parts of the strongest: errors
#: of the model look like weaker surfaces [1].
_SECOND = 0.1
#: Least distance of another surface, in parts of the range resolution: late light of
#: turbid water looks like a surface closer behind the first [1].
_APART = 0.75

#: Resolutions in the interval of a comparison, at least [1].
_CELLS = 10
#: Distances at which the late light is computed, over the interval.
_DEPTHS = 9

#: Surface of each beam that the target signal has.
Surface = Literal["strongest", "nearest", "farthest"]


@dataclass(frozen=True)
class _Beam:
    """Result of one beam in one channel."""

    target: Complex
    """Samples without water and other surfaces, shape (frequencies,) [V]."""
    variance: Floats
    """Variance of each output, shape (frequencies,) [V^2]."""
    place: float | None
    """Slant range of the surface [m]; None if none is significant."""
    misfit: bool
    """Whether the samples depart from the model by more than its error."""


def _unsuited(cube: xr.Dataset, interval: tuple[float, float] | None) -> str:
    """Return why the frequencies resolve no surfaces; empty if they do."""
    frequency = cube["modulation_frequency"].values
    if np.unique(frequency).size < 2:
        return "one modulation frequency has no range profile"
    index = float(cube["geometry"].attrs["group_index"])
    width = profiles.resolution(modulation_frequency=frequency, group_index=index)
    nearest, farthest = interval or (
        0.0,
        profiles.unambiguous_span(modulation_frequency=frequency, group_index=index),
    )
    if farthest - nearest >= _CELLS * width:
        return ""
    return (
        f"a bandwidth of {np.ptp(frequency) / 1e6:.3g} MHz resolves {width:.2g} m; a "
        f"profile needs a tenth of the interval, {(farthest - nearest) / _CELLS:.2g} m"
    )


@method(
    "range-profile",
    simplicity=7,
    unsuited=_unsuited,
    remark="of several surfaces in a beam, the range is that of the strongest",
)
def range_profile(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    most: int = 3,
    model_error: float = 0.01,
    surface: Surface = "strongest",
) -> xr.Dataset:
    r"""Separate one surface of each beam from others by its range profile.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with two more modulation frequencies than surfaces, five by
        default. Open-water shots give the shape of the water signal. Without them the
        method is right only at frequencies far above the cut-off of the water.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m]. By default the
        unambiguous span of the frequencies.
    most : int
        Largest number of surfaces in a beam.
    model_error : float
        Standard uncertainty of the model at each frequency, relative to the sample:
        gains of the frequencies, and scattering, which weakens high frequencies [1].
    surface : {"strongest", "nearest", "farthest"}
        Surface of each beam: a net in front of a wall is the nearest one. Surfaces with
        less than a tenth of the strongest amplitude do not count as nearest or
        farthest.

    Returns
    -------
    xarray.Dataset
        Level `target_signal`. The signal is that of the chosen surface.

        - `NO_TARGET`: no surface is significant.
        - `WATER_RESIDUAL` with the cause `MODEL_MISFIT`: the samples depart from
          water and surfaces by more than the error of the model, or another surface
          is closer than three quarters of the range resolution. In turbid water that
          the survey does not state, it is the late light of the same surface.

    Raises
    ------
    CubeError
        If there are too few frequencies, or the interval is longer than the
        unambiguous span.
    ValueError
        If an argument is out of range, or there is no such surface.

    Notes
    -----
    The model of a beam is that of `optics.range_profile.surfaces`,

    .. math:: S(f_k) = \sum_j a_j e^{4 \pi i f_k z_j / v} + c\, W(f_k),

    with the mean open-water signal W, amplitudes :math:`a_j > 0` and a factor c of the
    beam. If the survey states the water, echoes have the loss and the delay of
    forward-scattered light at their distance, with an error of 5 % of both. The water
    behind the target is not cut off: a short column and its water are distinguished at
    frequencies where W is small, as in frequency-domain reflectometry [1]_. The stated
    variance of the signal is larger than that of the samples, so that its range has the
    uncertainty of the fit of all parameters.

    References
    ----------
    .. [1] D. W. Illig et al., "Statistical backscatter suppression technique for a
       wideband hybrid lidar-radar ranging system" (2014).

    Examples
    --------
    A plate in milky water, measured from 100 MHz to 1 GHz:

    >>> import amulor
    >>> from amulor import imaging, rejection
    >>> frequencies = [f"{100 + 50 * k} MHz" for k in range(19)]
    >>> survey = amulor.Survey.preset("amulor-2010").with_(
    ...     {
    ...         "instrument.modulation_frequencies": frequencies,
    ...         "scan.rows": 1,
    ...         "scan.columns": 3,
    ...     }
    ... )
    >>> cube = amulor.simulate(survey, rng=1)
    >>> target = rejection.range_profile(cube, interval=(0.5, 2.4))
    >>> image = imaging.range_image(target, polarization="VH", interval=(0.5, 2.4))
    >>> error = image["slant_range"].values - cube.amulor.truth["slant_range"].values
    >>> bool((abs(error) < 3 * image["slant_range_uncertainty"].values).all())
    True
    """
    if most < 1 or not model_error > 0:
        raise ValueError(
            f"most must be 1 or more and model_error above 0, got {most} and "
            f"{model_error:g}"
        )
    if surface not in get_args(Surface):
        raise ValueError(
            f"surface must be strongest, nearest or farthest, got {surface!r}"
        )
    scan = Observation(cube=cubes.checked(cube, "samples"))
    index = float(scan.cube["geometry"].attrs["group_index"])
    places = _places(scan.frequency, index, interval, most)
    late = _LateLight.of(scan, places)
    water, fluctuation, common = _open_water(scan)
    shape = scan.signal.shape
    target = np.full(shape, np.nan, dtype=complex)
    variance = np.full(shape, np.nan)
    flag, cause = np.zeros(shape, dtype=np.int16), np.zeros(shape, dtype=np.int8)
    for channel, row, column in np.ndindex(shape[1:]):
        at = (slice(None), channel, row, column)
        if not scan.usable[at].all():
            continue
        stated = np.maximum(
            scan.covariance.in_phase[at], scan.covariance.quadrature[at]
        )
        of_model = (model_error * np.abs(scan.signal[at])) ** 2
        beam = _separated(
            scan.signal[at],
            np.sqrt(stated + fluctuation[:, channel] + of_model),
            late,
            None if water is None else water[:, channel],
            frequency=scan.frequency,
            group_index=index,
            interval=places,
            most=most,
            surface=surface,
        )
        target[at], variance[at] = beam.target, beam.variance
        if beam.place is None:
            flag[at] |= QualityFlag.NO_TARGET
        if beam.misfit:
            cause[at] |= WaterResidualCause.MODEL_MISFIT
    errors = Covariance(variance, variance, np.zeros(shape))
    shared = None if common is None else _over_pixels(common, shape)
    result = target_cube(
        scan.cube,
        target,
        errors if shared is None else errors + shared,
        common=shared,
        water_signal=scan.signal - target,
        step=f"reject, range profile with up to {most} surfaces, the {surface} one",
        frequencies_share_errors=np.int32(0),
    )
    result = quality.add_water_residual(result, cause)
    result["quality_flag"] = result["quality_flag"].copy(
        data=result["quality_flag"].values | flag
    )
    return result


def _places(
    frequency: Floats,
    group_index: float,
    interval: tuple[float, float] | None,
    most: int,
) -> tuple[float, float]:
    """Return the searched slant ranges [m]; CubeError if they repeat."""
    if np.unique(frequency).size < profiles.fewest(most):
        raise CubeError(
            f"a range profile with up to {most} surfaces needs "
            f"{profiles.fewest(most)} modulation frequencies or more, got "
            f"{np.unique(frequency).size}; use another method"
        )
    span = profiles.unambiguous_span(
        modulation_frequency=frequency, group_index=group_index
    )
    if interval is None:
        return 0.0, span
    nearest, farthest = interval
    if farthest - nearest > span:
        raise CubeError(
            f"the interval of {farthest - nearest:.3g} m is longer than the "
            f"unambiguous span of the frequencies, {span:.3g} m; state a shorter "
            "interval"
        )
    return nearest, farthest


def _open_water(
    scan: Observation,
) -> tuple[Complex | None, Floats, Covariance | None]:
    """Return the mean open-water signal, its fluctuation, and the mean's covariance.

    Arrays over (frequency, channel). The fluctuation of the water is a variance of each
    output: the scatter of the references beyond their stated noise.
    """
    nothing = np.zeros(scan.signal.shape[:2])
    if scan.shots is None:
        return None, nothing, None
    signal = scan.shots.signal
    count = signal.shape[2]
    mean = signal.mean(axis=2)
    if count < 2:
        return mean, nothing, None
    spread = signal - mean[:, :, None]
    scale = 1 / (count * (count - 1))
    common = Covariance(
        scale * np.sum(spread.real**2, axis=2),
        scale * np.sum(spread.imag**2, axis=2),
        scale * np.sum(spread.real * spread.imag, axis=2),
    )
    stated = scan.shots.covariance
    fluctuation = [
        count * scattered - noise.mean(axis=2)
        for scattered, noise in (
            (common.in_phase, stated.in_phase),
            (common.quadrature, stated.quadrature),
        )
    ]
    return mean, np.maximum(0.0, np.maximum(*fluctuation)), common


def _over_pixels(errors: Covariance, shape: tuple[int, ...]) -> Covariance:
    return Covariance(
        *(
            np.broadcast_to(part[:, :, None, None], shape).copy()
            for part in vars(errors).values()
        )
    )


@dataclass(frozen=True)
class _LateLight:
    """Logarithm of echoes with late light over those without, by their place."""

    place: Floats
    """Slant ranges [m]."""
    logarithm: Complex
    """Logarithm, shape (frequencies, places) [1]."""

    @classmethod
    def of(cls, scan: Observation, interval: tuple[float, float]) -> _LateLight | None:
        """Return the late light of the survey; None without any that matters."""
        nearest, farthest = interval
        place = np.linspace(max(nearest, farthest / 20), farthest, _DEPTHS)
        logarithm = late_response(scan, place)
        if logarithm is None or not np.isfinite(logarithm).all():
            return None
        return cls(place, logarithm)

    def at(self, place: float) -> Complex:
        """Return the logarithm at a place, over (frequencies)."""
        return np.array([np.interp(place, self.place, row) for row in self.logarithm])


def _separated(
    signal: Complex,
    error: Floats,
    late: _LateLight | None,
    water: Complex | None,
    **options: Any,
) -> _Beam:
    """Return a surface of a beam, without water and other surfaces.

    Late light makes an echo weaker and later at high frequencies, as a second surface
    does. A first search without it gives the place, and a second one divides by it.
    """
    beam = _one_surface(signal, error, water, **options)
    if late is None or beam.place is None:
        return beam
    logarithm = late.at(beam.place)
    response = np.exp(logarithm)
    doubt = RELATIVE_UNCERTAINTY * np.abs(logarithm) * np.abs(signal)
    beam = _one_surface(
        signal / response,
        np.hypot(error, doubt) / np.abs(response),
        None if water is None else water / response,
        **options,
    )
    return replace(
        beam,
        target=beam.target * response,
        variance=beam.variance * np.abs(response) ** 2,
    )


def _one_surface(
    signal: Complex,
    error: Floats,
    water: Complex | None,
    *,
    frequency: Floats,
    group_index: float,
    interval: tuple[float, float],
    most: int,
    surface: Surface,
) -> _Beam:
    """Return a surface of a beam without late light."""
    found = profiles.surfaces(
        signal,
        standard_uncertainty=error,
        modulation_frequency=frequency,
        group_index=group_index,
        interval=interval,
        water_signal=water,
        most=most,
    )
    wave = 4 * math.pi * frequency * group_index / speed_of_light
    echoes = found.amplitude * np.exp(1j * np.outer(wave, found.slant_range))
    rest = signal - echoes.sum(axis=1)
    if water is not None:
        size = np.sum(np.abs(water / error) ** 2)
        rest = rest - water * float(
            np.sum((water.conj() * rest).real / error**2) / size
        )
    # Echo, its place and the water are fitted.
    freedom = 2 * frequency.size - 2 * found.amplitude.size - (water is not None)
    misfit = float(np.sum(np.abs(rest / error) ** 2)) > _MISFIT**2 * max(freedom, 1)
    if not found.amplitude.size:
        return _Beam(rest, error**2, None, misfit)
    chosen = int(found.amplitude.argmax())
    if surface != "strongest":
        counted = np.flatnonzero(found.amplitude > _SECOND * found.amplitude[chosen])
        chosen = int(counted[0 if surface == "nearest" else -1])
    target = rest + echoes[:, chosen]
    alone = np.sum((wave * np.abs(target) / error) ** 2)
    scale = max(1.0, float(found.covariance[chosen, chosen] * alone))
    distance = np.abs(np.delete(found.slant_range - found.slant_range[chosen], chosen))
    width = profiles.resolution(modulation_frequency=frequency, group_index=group_index)
    misfit |= bool(np.any(distance < _APART * width))
    return _Beam(target, scale * error**2, float(found.slant_range[chosen]), misfit)
