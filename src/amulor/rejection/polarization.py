"""Polarization methods: water preserves polarization, painted targets depolarize."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import WaterResidualCause, tiles
from amulor.errors import CubeError
from amulor.rejection import quality, ratios
from amulor.rejection.build import present_terms, saturated_in_any, target_cube
from amulor.rejection.channels import (
    CO_POLARIZED,
    CROSS_POLARIZED,
    pair_of,
)
from amulor.rejection.covariance import Covariance, along
from amulor.rejection.merit import merit
from amulor.rejection.methods import Needs, method
from amulor.rejection.observation import Observation
from amulor.rejection.open_water import cube_of
from amulor.rejection.reference.before_target import (
    WaterFit,
    contradiction,
    raised_to_median_amplitude,
    raised_to_shot_amplitude,
)
from amulor.rejection.reference.shots import (
    Noise,
    ShotsFit,
    fit_shots,
    fluctuation_of,
    with_measured_noise,
)
from amulor.rejection.subtraction import subtract_open_water

Floats = NDArray[np.float64]


def _with_water(
    cube: xr.Dataset,
    *,
    channels: tuple[str, ...] | None = None,
    name: str = "",
    fit: tuple[str, ...] | None = None,
    span: tiles.Span | None = None,
) -> tuple[xr.Dataset, tuple[str, ...]]:
    """Return channels without water rejection, and the names of their error terms.

    `channels` are the names to keep, of the kind `name`; all by default.
    """
    cube = cubes.checked(cube, "samples")
    step = "reject, nothing taken out"
    if channels is not None:
        present = cube.amulor.polarizations
        chosen = [channel for channel in present if channel in channels]
        if not chosen:
            raise CubeError(
                f"the cube has the channels {', '.join(present)}, none of which is "
                f"{name} ({', '.join(channels)}); record one, or use another method"
            )
        cube = cube.sel(polarization=chosen)
        step = f"reject, {name} channel {', '.join(chosen)}"
    scan = Observation(cube=cube)
    terms = present_terms({"counting": scan.covariance}, fit)
    target = target_cube(
        cube,
        scan.signal,
        scan.covariance,
        terms=terms,
        water_signal=np.zeros_like(scan.signal),
        water_is_in=True,
        step=step,
    )
    return target, tuple(terms)


@method("none", fitter=partial(tiles.fit_on_sample, _with_water))
def keep_water(cube: xr.Dataset) -> xr.Dataset:
    """Return the samples as target signal, flagged as containing the water signal.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`.

    Returns
    -------
    xarray.Dataset
        Level `target_signal`, with the unchanged signal and every sample flagged
        `NO_OPEN_WATER`. It shows the picture before rejection.

    Examples
    --------
    >>> from amulor import rejection, samples
    >>> raw = rejection.keep_water(samples.cube("ladder"))
    >>> raw.amulor.level, raw.amulor.polarizations
    ('target_signal', ['VV', 'VH'])
    """
    return _with_water(cube)[0]


@method(
    "cross-polarized",
    needs=Needs(open_water=False),
    simplicity=0,
    fitter=partial(
        tiles.fit_on_sample,
        _with_water,
        channels=CROSS_POLARIZED,
        name="cross-polarized",
    ),
)
def cross_polarized(cube: xr.Dataset) -> xr.Dataset:
    """Keep the cross-polarized channels, in which the water is dark.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with a crossed linear or an equal circular pair.

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with these channels only. The residual water signal is
        unknown, so every sample is flagged `NO_OPEN_WATER`.

    Raises
    ------
    CubeError
        If there is no such channel.

    Examples
    --------
    >>> from amulor import rejection, samples
    >>> rejection.cross_polarized(samples.cube("ladder")).amulor.polarizations
    ['VH']
    """
    return _with_water(cube, channels=CROSS_POLARIZED, name="cross-polarized")[0]


@method(
    "co-polarized",
    fitter=partial(
        tiles.fit_on_sample, _with_water, channels=CO_POLARIZED, name="co-polarized"
    ),
)
def co_polarized(cube: xr.Dataset) -> xr.Dataset:
    """Keep the co-polarized channels, in which target and water are bright.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with an equal linear or a crossed circular pair.

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with these channels only, flagged `NO_OPEN_WATER`.

    Raises
    ------
    CubeError
        If there is no such channel.

    Examples
    --------
    >>> from amulor import rejection, samples
    >>> rejection.co_polarized(samples.cube("ladder")).amulor.polarizations
    ['VV']
    """
    return _with_water(cube, channels=CO_POLARIZED, name="co-polarized")[0]


#: Least difference of target and water ratio for a separation [1].
_SMALLEST_CONTRAST = 1e-3


@dataclass(frozen=True, kw_only=True)
class ChannelChoice:
    """Channel with the smallest range error, with figures of merit of all channels."""

    polarization: str
    """The chosen channel."""
    reason: str
    """Reason for the choice."""
    channels: tuple[str, ...]
    """All channels of the cube."""
    ratio: Floats
    """Signal-to-optical-noise ratio (54), (modulation_frequency, channel) [1]."""
    noise: Floats
    """Random slant-range error, (modulation_frequency, channel) [m]."""
    shift: Floats
    """Root-mean-square slant-range error caused by the water, (modulation_frequency,
    channel) [m]."""


def choose_channel(
    cube: xr.Dataset, *, interval: tuple[float, float] | None = None
) -> ChannelChoice:
    r"""Choose the polarization channel with the smallest range error.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with open-water shots and any channels, linear or circular.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    ChannelChoice
        The choice and its reason.

    Raises
    ------
    CubeError
        If there are no open-water shots, or no pixel shows a target in any channel.

    Notes
    -----
    A crossed channel contains less water, but also less of the target. Which channel is
    better depends on the noise. The criterion is random error and shift of the slant
    range together, without water subtraction, at the best frequency of each channel.

    Examples
    --------
    >>> from amulor import rejection, samples
    >>> cube = samples.cube("ladder").isel(row=[18], shot=slice(0, None, 4))
    >>> choice = rejection.choose_channel(cube)
    >>> choice.polarization, choice.channels
    ('VH', ('VV', 'VH'))
    """
    cube = cubes.checked(cube, "samples")
    figures = merit(Observation(cube=cube), interval=interval)
    error = np.where(np.isfinite(figures.error), figures.error, np.inf)
    lowest = error.min(axis=0)
    if not np.isfinite(lowest).any():
        raise CubeError(
            "no pixel shows a target in any channel after the water signal is removed; "
            "raise power or dwell, or look for the target elsewhere"
        )
    names = cube.amulor.polarizations
    best = int(np.argmin(lowest))
    at = error.argmin(axis=0)
    texts = [
        f"{name} {figures.ratio[k, c]:.3g} times the water, shift "
        f"{figures.shift[k, c] * 1e3:.3g} mm, noise {figures.noise[k, c] * 1e3:.3g} mm"
        for c, (name, k) in enumerate(zip(names, at, strict=True))
        if np.isfinite(lowest[c])
    ]
    kind = (
        "cross-polarized"
        if names[best] in CROSS_POLARIZED
        else "co-polarized"
        if names[best] in CO_POLARIZED
        else "mixed"
    )
    return ChannelChoice(
        polarization=names[best],
        reason=f"{names[best]} ({kind}) errs least: {'; '.join(texts)}",
        channels=tuple(names),
        ratio=figures.ratio,
        noise=figures.noise,
        shift=figures.shift,
    )


@dataclass(frozen=True, kw_only=True)
class PolarizationFit:
    """Scan-wide parameters of unmixing; None if given by the user or not needed."""

    noise: Noise
    """Corrections of the stated noise."""
    target_ratio: ratios.Ratio | None
    """Depolarization ratio of the targets."""
    water_ratio: ratios.Ratio | None
    """Depolarization ratio of the water."""
    fluctuation: FluctuationFit
    """Scan-wide statistics of the water fluctuation."""
    contradiction: WaterResidualCause
    """Cause INSTRUMENT if no water explains the references, else 0."""
    terms: tuple[str, ...]
    """Names of the error terms that are not zero everywhere."""


@dataclass(frozen=True, kw_only=True)
class FluctuationFit:
    """Scan-wide statistics of water fluctuations, from scan and open-water shots."""

    usual: Floats | None = None
    """Median water amplitude of the scan [V]; None with open-water shots."""
    water: WaterFit | None = None
    """Scan-wide fit of the water in front of the targets."""
    channels: tuple[ShotsFit, ...] = ()
    """Open-water fits of the co-polarized and the cross-polarized channel."""


def _unmix(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    target_ratio: float | None = None,
    water_ratio: float | None = None,
    target_ratio_uncertainty: float = 0.0,
    water_ratio_uncertainty: float = 0.0,
    water_fluctuation: float | None = None,
    fit: PolarizationFit | None = None,
    span: tiles.Span | None = None,
) -> tuple[xr.Dataset, PolarizationFit]:
    """Unmix a scan or, with `fit`, some of its rows; return also the fit."""
    scan = Observation(cube=cubes.checked(cube, "samples"))
    scan, noise = with_measured_noise(scan, None if fit is None else fit.noise)
    cube = scan.cube
    co, cross = pair_of(cube)
    of_target = None if fit is None else fit.target_ratio
    of_water = None if fit is None else fit.water_ratio
    cause = WaterResidualCause(0) if fit is None else fit.contradiction
    if target_ratio is None:
        if of_target is None:
            subtracted = subtract_open_water(scan, interval=interval)
            of_target = ratios.ratio_of(cube_of(scan, subtracted)[0])
            # Leakage in the references is in the scan, too, and unmixing amplifies it.
            cause = WaterResidualCause.INSTRUMENT & contradiction(
                subtracted.fit.strength, subtracted.water.turbidity
            )
        target_ratio = ratios.possible(of_target, name="target_ratio")
        target_ratio_uncertainty = of_target.uncertainty
    else:
        target_ratio_uncertainty = ratios.stated_uncertainty(
            cube, target_ratio, target_ratio_uncertainty
        )
    if water_ratio is None:
        if of_water is None:
            of_water = ratios.water_ratio(cube)
        water_ratio = ratios.possible(of_water, name="water_ratio")
        water_ratio_uncertainty = of_water.uncertainty
    else:
        water_ratio_uncertainty = ratios.stated_uncertainty(
            cube, water_ratio, water_ratio_uncertainty
        )
    for name, ratio in (("target_ratio", target_ratio), ("water_ratio", water_ratio)):
        if not 0 <= ratio <= 1:
            raise ValueError(f"{name} must lie between 0 and 1, got {ratio:g}")
    contrast = target_ratio - water_ratio
    if abs(contrast) < _SMALLEST_CONTRAST:
        raise ValueError(
            f"target_ratio ({target_ratio:g}) and water_ratio ({water_ratio:g}) are "
            f"closer than {_SMALLEST_CONTRAST:g}; polarization cannot tell them apart"
        )
    first, second = (
        Observation(cube=cube.sel(polarization=[name])) for name in (co, cross)
    )
    a, b = first.signal, second.signal
    target = (b - water_ratio * a) / contrast
    water = a - target
    both, fluctuation = _fluctuations(
        first,
        second,
        water,
        water_fluctuation,
        fit=None if fit is None else fit.fluctuation,
        span=span,
    )
    fluctuations = [
        covariance.scaled((water_ratio / contrast) ** 2) for covariance in both
    ]
    independent = second.covariance.scaled(contrast**-2)
    independent += first.covariance.scaled((water_ratio / contrast) ** 2)
    # dT/dr_t = -T / contrast and dT/dr_w = -W / contrast.
    by_target_ratio = along(target, target_ratio_uncertainty / contrast)
    common = by_target_ratio + along(water, water_ratio_uncertainty / contrast)
    # A phase between the channels, as by a delay, rotates the difference.
    turned = np.zeros_like(target)
    for signal, estimate in ((target, of_target), (water, of_water)):
        if estimate is not None and estimate.across is not None:
            turned += estimate.across.reshape(-1, 1, 1, 1) * signal
    common += along(1j * turned, 1 / contrast)
    terms = present_terms(
        {
            "counting": independent,
            "fluctuation": fluctuations[0] + fluctuations[1],
            "polarization_optics": common,
        },
        None if fit is None else fit.terms,
    )
    # Leakage of the same size in both channels, independent of each other.
    gain: dict[str, Any] = {
        f"phase_error_gain_{co}": float(np.hypot(1, water_ratio)) / abs(contrast)
    }
    result = target_cube(
        saturated_in_any(first.cube, cube.sel(polarization=[co, cross])),
        target,
        independent + fluctuations[0] + fluctuations[1] + common,
        water_signal=water,
        common=common,
        proportional=by_target_ratio,
        terms=terms,
        step=f"reject, unmix {co} and {cross}, ratios of target {target_ratio:g}, "
        f"of water {water_ratio:g}",
        target_ratio=target_ratio,
        target_ratio_uncertainty=target_ratio_uncertainty,
        water_ratio=water_ratio,
        water_ratio_uncertainty=water_ratio_uncertainty,
        **gain,
    )
    bits = np.full(result["quality_flag"].shape, cause, dtype=np.int8)
    return quality.add_water_residual(result, bits), PolarizationFit(
        noise=noise,
        target_ratio=of_target,
        water_ratio=of_water,
        fluctuation=fluctuation,
        contradiction=cause,
        terms=tuple(terms),
    )


@method(
    "polarization",
    needs=Needs(channel_pair=True),
    simplicity=3,
    fitter=partial(tiles.fit_on_sample, _unmix),
)
def polarization(
    cube: xr.Dataset,
    *,
    interval: tuple[float, float] | None = None,
    target_ratio: float | None = None,
    water_ratio: float | None = None,
    target_ratio_uncertainty: float = 0.0,
    water_ratio_uncertainty: float = 0.0,
    water_fluctuation: float | None = None,
) -> xr.Dataset:
    r"""Separate target and water by their depolarization ratios.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with a co-polarized channel and its cross-polarized partner.
    interval : tuple of float, optional
        Nearest and farthest possible slant range [m], for the estimate of an omitted
        ratio of the target. From 0 to the unambiguous range by default.
    target_ratio, water_ratio : float, optional
        Cross-polarized over co-polarized signal of target and water, between 0 and 1
        and different from each other; :math:`(1 - m_{22}) / (1 + m_{22})` for linear
        light on a diagonal Mueller matrix [1]. An omitted ratio is estimated with its
        uncertainty, by `target_ratio` or `water_ratio`. An estimate that exceeds 0 or 1
        by less than its error is set to this limit.
    target_ratio_uncertainty, water_ratio_uncertainty : float
        Standard uncertainties of the stated ratios [1], without those by cross-talk and
        gain of the channels, which are added. The errors that they cause are common to
        all pixels.
    water_fluctuation : float, optional
        Relative change of the water signal from sample to sample, which differs in the
        two channels since they are measured one after the other [1]. By default it is
        estimated from the open-water shots. It is needed if the cube has none.

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with one channel, the co-polarized one.

    Raises
    ------
    CubeError
        If one of the channels is missing, or the fluctuation of the water is unknown.
        Also if an omitted ratio cannot be estimated, or lies outside 0 to 1 by more
        than its error.
    ValueError
        If a stated ratio is out of range, or both are equal, which makes unmixing
        impossible.

    Notes
    -----
    With co-polarized :math:`A = T + W` and cross-polarized
    :math:`B = r_t T + r_w W`, :math:`T = (B - r_w A) / (r_t - r_w)`.

    Examples
    --------
    >>> from amulor import rejection, samples
    >>> target = rejection.polarization(
    ...     samples.cube("ladder"),
    ...     target_ratio=0.242, water_ratio=0.099, water_fluctuation=0.137,
    ... )
    >>> target.amulor.polarizations
    ['VV']
    """
    return _unmix(
        cube,
        interval=interval,
        target_ratio=target_ratio,
        water_ratio=water_ratio,
        target_ratio_uncertainty=target_ratio_uncertainty,
        water_ratio_uncertainty=water_ratio_uncertainty,
        water_fluctuation=water_fluctuation,
    )[0]


def _fluctuations(
    co: Observation,
    cross: Observation,
    water: NDArray[np.complex128],
    relative: float | None,
    *,
    fit: FluctuationFit | None,
    span: tiles.Span | None,
) -> tuple[list[Covariance], FluctuationFit]:
    """Return the water-fluctuation covariance of both channels, and its fit."""
    if relative is not None:
        size, usual = raised_to_median_amplitude(
            water, None if fit is None else fit.usual
        )
        return 2 * [along(size, relative)], FluctuationFit(usual=usual)
    if co.shots is None:
        raise CubeError(
            "the cube has no open-water shots to tell how much the water signal "
            "fluctuates; state water_fluctuation (command line: --water-fluctuation, "
            '0 for still water, such as "5 %")'
        )
    size, before = raised_to_shot_amplitude(
        co, water, fit=None if fit is None else fit.water, span=span
    )
    covariances, channels = [], []
    for number, channel in enumerate((co, cross)):
        fits, of_shots = fit_shots(
            channel,
            fit=None if fit is None else fit.channels[number],
            span=span,
        )
        covariances.append(fluctuation_of(fits, size))
        channels.append(of_shots)
    return covariances, FluctuationFit(water=before, channels=tuple(channels))
