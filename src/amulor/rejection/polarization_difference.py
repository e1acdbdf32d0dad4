"""Weighted difference of two polarization channels, with a weight from the scan."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.constants import speed_of_light
from scipy.special import gammainccinv

from amulor import cube as cubes
from amulor.cube import QualityFlag, tiles
from amulor.cube.schema import WaterResidualCause
from amulor.errors import CubeError
from amulor.rejection import quality
from amulor.rejection.build import present_terms, saturated_in_any, target_cube
from amulor.rejection.channel_ratios import (
    MOST_PIXELS,
    Pair,
    Prior,
    RatioFit,
    TargetRatio,
    fit_ratio,
    misfit_of,
    of_open_water,
    pair_of_samples,
    target_ratio_of_neighbors,
)
from amulor.rejection.channels import pair_of
from amulor.rejection.covariance import Covariance, along
from amulor.rejection.methods import Needs, method
from amulor.rejection.observation import Observation

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Pixels that are worked on at once.
_BLOCK = 4096
#: Probability of a larger misfit by chance, below which a pixel is flagged [1].
_IMPROBABLE = 1e-3
#: Prior standard uncertainty of a ratio that nothing constrains [1].
_FREE = 1.0
#: That of the echo, for which scattering near the target is a smaller part [s].
_ECHO_LATER = 0.02e-9
#: Difference of stated and measured ratio in standard uncertainties: a contradiction.
_CONTRADICTION = 4.0
#: Patches along rows and along columns.
_PATCHES = 4
#: Largest number of further fits without the pixels in which earlier ones find no
#: target.
_FITS = 4
#: Fewest pixels for an estimate.
_FEWEST = 12
#: Smallest difference of the ratios of target and water [1].
_CONTRAST = 1e-3


def _target_ratio(
    first: Observation,
    second: Observation,
    stated: float | None,
    uncertainty: float,
    fluctuation: float,
    empty: NDArray[np.bool_] | None,
) -> TargetRatio:
    """Return the stated ratio of the targets with its test, or that of neighbors."""
    estimate = target_ratio_of_neighbors(
        first, second, fluctuation=fluctuation, empty=empty
    )
    if stated is None:
        if estimate is None:
            raise CubeError(
                "neighboring target pixels of one distance do not differ in "
                "reflectance, so the depolarization ratio of the target is not known; "
                "state target_ratio and target_ratio_uncertainty, measured on a sample "
                "of it"
            )
        return estimate
    # The crossed echo is later than the parallel one by a part of the delay of water.
    later = 2 * np.pi * first.frequency.max() * _ECHO_LATER * stated
    ratio = TargetRatio(
        real=stated,
        uncertainty=(uncertainty, float(later)),
        tested=estimate is not None,
    )
    if estimate is None:
        return ratio
    apart = abs(estimate.real - stated) / np.hypot(uncertainty, estimate.uncertainty[0])
    return replace(ratio, contradicted=bool(apart > _CONTRADICTION))


def _water_prior(
    first: Observation,
    second: Observation,
    stated: float | None,
    uncertainty: float,
    fluctuation: float | None,
    **spreads: float,
) -> Prior:
    """Return the prior of the water ratio: stated, of open water, or free."""
    expected, error = stated, uncertainty
    if first.shots is not None and second.shots is not None:
        ratio, scatter = of_open_water(first.shots, second.shots)
        fluctuation = scatter if fluctuation is None else fluctuation
        if stated is None:
            # Late light is lacking before a target, and the fit has a new delay.
            expected, error = ratio, spreads["spread"] * abs(ratio)
    count = first.frequency.size
    return Prior(
        water=None if expected is None else np.full(count, expected, dtype=complex),
        uncertainty=_FREE if expected is None else error,
        fluctuation=fluctuation or 0.0,
        **spreads,
    )


def _path(
    scan: Observation, wave: Floats, interval: tuple[float, float] | None
) -> tuple[float, float]:
    """Return the shortest and the longest possible path [m]."""
    geometry = scan.cube["geometry"].attrs
    aside = float(
        np.linalg.norm(
            np.asarray(geometry["receiver_position"])
            - np.asarray(geometry["emitter_position"])
        )
    )
    if interval is None:
        steps = np.diff(np.concatenate([[0.0], np.sort(wave)]))
        return 0.0, float(2 * np.pi / steps[steps > 0].min())
    return 2 * interval[0], 2 * interval[1] + aside


@dataclass(frozen=True)
class _Shared:
    """Errors of the target signal that all pixels share."""

    water: Covariance
    """Covariance by the ratio of the water."""
    target: Covariance
    """Covariance by the ratio of the targets."""


def _shared(
    fit: RatioFit,
    haze: Complex,
    target: Complex,
    independent: Covariance,
    wave: Floats,
) -> _Shared:
    """Return the errors by the ratios.

    They are correlated between frequencies. A factor of the pixel gives the path the
    variance that it has with these correlations.
    """
    count = wave.size
    shape = (count, *[1] * (haze.ndim - 1))
    ramp = (wave / wave.max()).reshape(shape)
    contrast = (fit.target.at(wave) - fit.water).reshape(shape)
    of_water = Covariance(
        *(
            np.broadcast_to(np.diag(block).reshape(shape), haze.shape)
            for block in (
                fit.covariance[:count, :count],
                fit.covariance[count : 2 * count, count : 2 * count],
                fit.covariance[:count, count : 2 * count],
            )
        )
    ).turned(-haze / contrast)
    real, imaginary = fit.target.uncertainty
    plain = target / contrast
    of_target = along(plain, real) + along(1j * ramp * plain, imaginary)
    parts = (independent, of_water, of_target)
    variance = sum(part.in_phase + part.quadrature for part in parts)
    with np.errstate(divide="ignore", invalid="ignore"):
        weight = wave.reshape(shape) * np.abs(target) ** 2 / variance
        by_water, by_target = -haze / contrast / target, -1 / contrast
    turns = np.nan_to_num(
        np.concatenate(
            [
                weight * by_water.imag,
                weight * by_water.real,
                weight * by_target.imag,
                weight * ramp * by_target.real,
            ]
        )
    ).reshape(4, count, -1)
    gradient = np.concatenate([*turns[:2], turns[2:].sum(axis=1)])
    joint = np.einsum("ip,ij,jp->p", gradient, fit.covariance, gradient)
    apart = np.zeros_like(joint)
    for k in range(count):
        own = np.concatenate([turns[:2, k], turns[2:, k]])
        pick = [k, count + k, 2 * count, 2 * count + 1]
        block = fit.covariance[np.ix_(pick, pick)].copy()
        block[:2, 2:] = block[2:, :2] = 0.0
        block[2, 3] = block[3, 2] = 0.0
        apart += np.einsum("ip,ij,jp->p", own, block, own)
    scale = np.divide(joint, apart, out=np.ones_like(joint), where=apart > 0)
    factor = scale.reshape(haze.shape[1:])[None]
    return _Shared(of_water.scaled(factor), of_target.scaled(factor))


def _difference(
    cube: xr.Dataset, *, fit: RatioFit | None = None, **options: Any
) -> tuple[xr.Dataset, RatioFit]:
    """Subtract the channels of a scan or, with `fit`, some of its rows."""
    if fit is not None:
        return _separated(cube, fit=fit, **options)
    result, fit = _separated(cube, **options)
    empty = np.zeros((cube.sizes["row"], cube.sizes["column"]), dtype=bool)
    for _ in range(_FITS):
        flag = result["quality_flag"].values[:, 0]
        # Neighbors of which one is water do not show the ratio of the target.
        found = ((flag & QualityFlag.NO_TARGET) != 0).all(axis=0) & ~empty
        if not found.any():
            break
        empty |= found
        result, fit = _separated(cube, empty=empty, **options)
    if empty.any():
        # An echo of positive amplitude is fitted to their noise, too.
        return _separated(cube, empty=empty, left_out=empty, **options)
    return result, fit


def _separated(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    water_ratio: float | None = None,
    water_ratio_uncertainty: float = 0.0,
    target_ratio: float | None = None,
    target_ratio_uncertainty: float = 0.0,
    water_fluctuation: float | None = None,
    ratio_spread: float = 0.05,
    model_error: float = 0.01,
    fit: RatioFit | None = None,
    empty: NDArray[np.bool_] | None = None,
    left_out: NDArray[np.bool_] | None = None,
) -> tuple[xr.Dataset, RatioFit]:
    """Subtract the channels of a scan.

    Pixels `empty` have no target, and pixels `left_out` do not show the water ratio.
    """
    for name, ratio in (("target_ratio", target_ratio), ("water_ratio", water_ratio)):
        if ratio is not None and not 0 <= ratio <= 1:
            raise ValueError(f"{name} must lie between 0 and 1, got {ratio:g}")
    if not ratio_spread > 0 or not model_error > 0:
        raise ValueError(
            "ratio_spread and model_error must be above 0, got "
            f"{ratio_spread:g} and {model_error:g}"
        )
    cube = cubes.checked(cube, "samples")
    co, cross = pair_of(cube)
    scan = Observation(cube=cube)
    first, second = (
        Observation(cube=cube.sel(polarization=[name])) for name in (co, cross)
    )
    if np.unique(scan.frequency).size < 2:
        raise CubeError(
            "the cube has one modulation frequency, but the ratio of the water follows "
            "from two or more; use the method polarization"
        )
    index = float(cube["geometry"].attrs["group_index"])
    wave = 2 * np.pi * scan.frequency * index / speed_of_light
    path = _path(scan, wave, interval)
    pair = pair_of_samples(first, second)
    usable = (first.usable & second.usable)[:, 0].all(axis=0).ravel()
    if fit is None:
        chosen = np.flatnonzero(
            usable if left_out is None else usable & ~left_out.ravel()
        )
        if chosen.size < _FEWEST:
            raise CubeError(
                f"{chosen.size} pixels have numbers in {co} and {cross} at all "
                f"frequencies, needed are {_FEWEST} to estimate the ratio of the water"
            )
        chosen = chosen[:: -(-chosen.size // MOST_PIXELS)]
        prior = _water_prior(
            first,
            second,
            water_ratio,
            water_ratio_uncertainty,
            water_fluctuation,
            spread=ratio_spread,
            gain=model_error,
        )
        of_target = _target_ratio(
            first,
            second,
            target_ratio,
            target_ratio_uncertainty,
            prior.fluctuation,
            empty,
        )
        if prior.water is not None:
            _check_contrast(of_target.real, prior.water, 0.0)
        fit = fit_ratio(
            pair.part(chosen),
            wave,
            scan.frequency,
            path,
            prior,
            of_target,
            _patches(chosen, first.signal.shape[2:]),
        )
        errors = np.sqrt(np.diag(fit.covariance)[: wave.size])
        error = math.hypot(fit.target.uncertainty[0], float(errors.min()))
        _check_contrast(fit.target.real, fit.water, error)
    a, b = first.signal, second.signal
    water = fit.water[:, None, None, None]
    contrast = fit.target.at(scan.frequency)[:, None, None, None] - water
    target = (b - water * a) / contrast
    haze = a - target
    independent = second.covariance.turned(np.broadcast_to(1 / contrast, a.shape))
    independent += first.covariance.turned(np.broadcast_to(water / contrast, a.shape))
    fluctuation = along(haze * water / contrast, math.sqrt(2) * fit.fluctuation)
    counting, fluctuation = (
        errors.scaled(fit.scale) for errors in (independent, fluctuation)
    )
    independent = counting + fluctuation
    shared = _shared(fit, haze, target, independent, wave)
    common = shared.water + shared.target
    terms = present_terms(
        {
            "counting": counting,
            "fluctuation": fluctuation,
            "polarization_optics": common,
        },
        fit.terms or None,
    )
    result = target_cube(
        saturated_in_any(first.cube, cube.sel(polarization=[co, cross])),
        target,
        independent + common,
        water_signal=haze,
        common=common,
        proportional=shared.target,
        terms=terms,
        step=f"reject, difference of {cross} and {co}, ratios of target "
        f"{fit.target.real:.3g}, of water {abs(fit.water[0]):.3g}",
        frequencies_share_errors=np.int32(0),
        target_ratio=fit.target.real,
        target_ratio_uncertainty=fit.target.uncertainty[0],
        target_ratio_tested=np.int32(fit.target.tested),
        water_ratio=np.abs(fit.water),
        water_ratio_phase=np.angle(fit.water),
        water_ratio_uncertainty=np.sqrt(np.diag(fit.covariance)[: wave.size]),
    )
    cause = np.zeros(a.shape, dtype=np.int8)
    cause[:, 0, _misfits(pair, fit, wave, path, usable).reshape(a.shape[2:])] = (
        WaterResidualCause.MODEL_MISFIT
    )
    if fit.target.contradicted:
        cause[:] = WaterResidualCause.MODEL_MISFIT
    return quality.add_water_residual(result, cause), replace(fit, terms=tuple(terms))


def _patches(chosen: NDArray[np.intp], shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Return the number of the patch of each pixel; 4 x 4 patches cover the scan."""
    row, column = np.divmod(chosen, shape[1])
    across, down = (
        place * _PATCHES // size
        for place, size in ((column, shape[1]), (row, shape[0]))
    )
    return np.asarray(down * _PATCHES + across)


def _check_contrast(target: float, water: Complex, error: float) -> None:
    """Raise a CubeError if the ratios of target and water are not different."""
    contrast = float(np.abs(target - water).min())
    if contrast < max(_CONTRAST, 2 * error):
        raise CubeError(
            f"the depolarization ratios of target, {target:.3g}, and water, "
            f"{abs(water[0]):.3g}, differ by {contrast:.2g} with an uncertainty of "
            f"{error:.2g}; polarization cannot separate them: record open water, or "
            "use another method"
        )


def _misfits(
    pair: Pair,
    fit: RatioFit,
    wave: Floats,
    path: tuple[float, float],
    usable: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Return the pixels whose difference is not a single echo."""
    # Quantile of chi-square of 2 (count - 1) degrees of freedom.
    limit = 2 * gammainccinv(wave.size - 1, _IMPROBABLE) * fit.scale
    misfits = np.zeros(len(usable), dtype=bool)
    contrast = fit.gain * (fit.target.at(wave) - fit.water)
    places = np.flatnonzero(usable)
    for start in range(0, places.size, _BLOCK):
        block = places[start : start + _BLOCK]
        misfits[block] = (
            misfit_of(pair.part(block), fit.water, wave, path, contrast, fit.unsteady)
            > limit
        )
    return misfits


def _unsuited(cube: xr.Dataset, interval: tuple[float, float] | None) -> str:
    """Return why shots make the method needless; empty without shots."""
    if cube.amulor.open_water is None:
        return ""
    return "not needed: the open-water shots show the water signal"


@method(
    "polarization-difference",
    needs=Needs(channel_pair=True),
    simplicity=4,
    unsuited=_unsuited,
    fitter=partial(tiles.fit_on_sample, _difference, needs_span=False),
)
def polarization_difference(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    water_ratio: float | None = None,
    water_ratio_uncertainty: float = 0.0,
    target_ratio: float | None = None,
    target_ratio_uncertainty: float = 0.0,
    water_fluctuation: float | None = None,
    ratio_spread: float = 0.05,
    model_error: float = 0.01,
) -> xr.Dataset:
    r"""Separate target and water by a weighted difference of two channels.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with a co-polarized channel, its cross-polarized partner, and
        two or more modulation frequencies. Neither open-water shots nor a survey of the
        water is needed.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].
    water_ratio, water_ratio_uncertainty : float, optional
        Cross-polarized over co-polarized signal of the water at low frequencies, and
        its standard uncertainty [1]. By default that of the open-water shots within
        `ratio_spread`. Without shots the scan alone determines it.
    target_ratio, target_ratio_uncertainty : float, optional
        The same of the targets, as far as it is known: 1 for paint that depolarizes all
        light [1]. By default it is estimated from neighbors of different reflectance,
        of which none is open water.
    water_fluctuation : float, optional
        Relative change of the water signal from sample to sample, which differs in the
        two channels if they are measured one after the other [1]. By default that of
        the open-water shots, else 0.
    ratio_spread : float
        Standard deviation of the crossed water signal between frequencies, relative to
        its largest value [1].
    model_error : float
        Standard deviation of the gain of the echo between frequencies [1].

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with one channel, the co-polarized one. The attributes
        state both ratios with their uncertainties, and whether neighbors tested that of
        the target. `WATER_RESIDUAL` with the cause `MODEL_MISFIT` marks

        - pixels whose difference is not a single echo,
        - all pixels, if neighbors contradict the stated ratio of the targets.

    Raises
    ------
    CubeError
        If a channel or the second frequency is missing, if the ratio of the target can
        neither be estimated nor is stated, or if both ratios are too similar.
    ValueError
        If a ratio is not between 0 and 1, or an error is not above 0.

    Notes
    -----
    With co-polarized :math:`A = T + W` and cross-polarized :math:`B = r_t T + r_w W`,

    .. math:: B - r_w A = (r_t - r_w)\, T ,

    the difference image of active polarization descattering [1]_. A single echo T has
    one amplitude and a phase in proportion to frequency. The ratio of the water is that
    for which the differences of all pixels are such echoes. It is complex, since
    crossed light of water is scattered more often and arrives later. Second differences
    of neighbors, in which the water cancels, give :math:`r_t = \Delta B / \Delta A`.

    All parameters are fitted together, with priors for the deviations between
    frequencies. The errors of both ratios are common to all pixels.

    References
    ----------
    .. [1] T. Treibitz and Y. Y. Schechner, "Active polarization descattering",
       IEEE Trans. Pattern Anal. Mach. Intell. 31, 385 (2009),
       :doi:`10.1109/TPAMI.2008.85`.

    Examples
    --------
    A plate with dark spots in milky water. The ratio of the water was not stated:

    >>> import numpy as np
    >>> import amulor
    >>> from amulor import cube as cubes, rejection
    >>> survey = amulor.Survey.preset("amulor-2010").with_(
    ...     {
    ...         "water.scattering": "1 1/m",
    ...         "water.signal_fluctuation": 0,
    ...         "instrument.modulation_frequencies": ["20 MHz", "80 MHz", "140 MHz"],
    ...         "scan.rows": 6,
    ...         "scan.columns": 20,
    ...     }
    ... )
    >>> cube = cubes.without_groups(amulor.simulate(survey, rng=1), "open_water")
    >>> spots = 0.6 * np.random.default_rng(1).integers(0, 2, cube["azimuth"].shape)
    >>> for name in ("in_phase", "quadrature"):
    ...     cube[name] -= spots * cube[f"truth_target_{name}"]
    >>> target = rejection.polarization_difference(cube, interval=(0.5, 2.5))
    >>> echo = cube["truth_target_in_phase"] + 1j * cube["truth_target_quadrature"]
    >>> for signal in (cube, target):
    ...     part = signal.amulor.signal.sel(polarization="VV")
    ...     turn = np.angle(part * echo.sel(polarization="VV").conj()).mean((1, 2))
    ...     print(np.abs(1e3 * turn).round(0), "mrad off")
    [151.  59.  47.] mrad off
    [0. 1. 1.] mrad off
    """
    return _difference(
        cube,
        interval=interval,
        water_ratio=water_ratio,
        water_ratio_uncertainty=water_ratio_uncertainty,
        target_ratio=target_ratio,
        target_ratio_uncertainty=target_ratio_uncertainty,
        water_fluctuation=water_fluctuation,
        ratio_spread=ratio_spread,
        model_error=model_error,
    )[0]
