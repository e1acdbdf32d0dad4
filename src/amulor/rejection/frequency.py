"""Single-frequency method: the modulation frequency with the smallest range error."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor import cube as cubes
from amulor.cube import QualityFlag, tiles
from amulor.errors import CubeError
from amulor.optics import extrema, low_pass, ranging
from amulor.rejection import quality
from amulor.rejection.build import present_terms, target_cube
from amulor.rejection.merit import Merit, merit
from amulor.rejection.methods import Needs, method
from amulor.rejection.observation import Observation
from amulor.rejection.quality import LARGEST_PHASE_ERROR
from amulor.rejection.reference.before_target import WaterFit, water_before_target
from amulor.rejection.reference.presence import CutColumns, shows_target
from amulor.rejection.reference.shots import shots_of

Floats = NDArray[np.float64]

#: A shift by water above this fraction of the ambiguity interval spoils a picture [1].
_LARGE_SHIFT = 0.02
#: Ambiguity intervals are compared to this precision: limits are measured, too [1].
_ROOM = 1e-6


@dataclass(frozen=True, kw_only=True)
class FrequencyChoice:
    """Best single frequency of a sweep, with figures of merit of all frequencies."""

    modulation_frequency: float
    """The chosen frequency [Hz]."""
    polarization: str
    """Channel for which the figures were computed."""
    cut_off: float | None
    """First-order cut-off of the open-water signal, fitted by `optics.low_pass.fit`
    [Hz]; None if the sweep shows none. `WaterFit` states the half-power frequency."""
    reason: str
    """Reason for the choice."""
    warnings: tuple[str, ...]
    """Limitations of the chosen frequency or of the sweep."""
    sweep: Floats
    """All frequencies of the sweep [Hz]."""
    amplitude: Floats
    """Amplitude of the sum of target and water [V]."""
    ratio: Floats
    """Signal-to-optical-noise ratio (54) [1]."""
    contrast: Floats
    """Contrast (54) [1]."""
    noise: Floats
    """Random error of the slant range [m]."""
    shift: Floats
    """Root-mean-square slant-range error caused by the water [m]."""
    ambiguity_interval: Floats
    """Ambiguity interval of each frequency alone [m]."""
    maxima: dict[str, Floats]
    """Frequencies at which amplitude, ratio and contrast are largest [Hz]."""

    @property
    def above_cut_off(self) -> bool | None:
        """Whether the chosen frequency is above the cut-off; None without a cut-off."""
        if self.cut_off is None:
            return None
        return self.modulation_frequency > self.cut_off


def choose_frequency(
    cube: xr.Dataset,
    *,
    polarization: str | None = None,
    interval: tuple[float, float] | None = None,
) -> FrequencyChoice:
    r"""Choose the frequency with the smallest range error from noise and water.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with open-water shots.
    polarization : str, optional
        Channel to evaluate, by default the channel with the smallest error.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    FrequencyChoice
        The choice, its reason, warnings, and the whole sweep.

    Raises
    ------
    CubeError
        If there are no open-water shots, the channel is missing, or no pixel shows a
        target at any frequency.

    Notes
    -----
    Amplitude, signal-to-optical-noise ratio and contrast, eq. (54) of Ricci et al.
    2010, are largest where target and water are in phase. There the water does not
    shift the phase. The water signal falls above its cut-off and the target signal does
    not. High frequencies therefore suffer less, but their phase repeats at shorter
    distances. The chosen frequency has the smallest error of the slant range, random
    error and shift together. Only frequencies that resolve the ambiguity interval alone
    are compared, or all if there are none.

    Examples
    --------
    >>> from amulor import rejection, samples
    >>> four = samples.cube("sweep").isel(modulation_frequency=[0, 4, 6, 8])
    >>> four = four.isel(row=[3, 4], column=slice(0, None, 8), shot=slice(0, None, 8))
    >>> choice = rejection.choose_frequency(four, polarization="VH")
    >>> print(four["modulation_frequency"].values / 1e6)
    [ 5. 20. 40. 80.]
    >>> print(f"{choice.modulation_frequency / 1e6:.0f} MHz")
    80 MHz
    """
    scan = Observation(cube=cubes.checked(cube, "samples"))
    figures = merit(scan, interval=interval)
    channel = _channel(scan.polarizations, figures, polarization)
    frequency = scan.frequency
    error = figures.error[:, channel]
    if not np.isfinite(error).any():
        raise CubeError(
            "no pixel shows a target at any frequency after the water signal is "
            "removed; raise power or dwell, or look for the target elsewhere"
        )
    intervals = ranging.ambiguity_interval(
        frequency, group_index=float(scan.cube["geometry"].attrs["group_index"])
    )
    span = None if interval is None else interval[1] - interval[0]
    clear = (
        np.ones(frequency.size, bool)
        if span is None
        else intervals * (1 + _ROOM) > span
    )
    eligible = clear & np.isfinite(error)
    candidates = eligible if eligible.any() else np.isfinite(error)
    best = int(np.argmin(np.where(candidates, error, np.inf)))
    cut_off = _fitted_cut_off(scan, channel)
    curves = {
        name: getattr(figures, name)[:, channel]
        for name in ("amplitude", "ratio", "contrast", "noise", "shift")
    }
    return FrequencyChoice(
        modulation_frequency=float(frequency[best]),
        polarization=scan.polarizations[channel],
        cut_off=cut_off,
        reason=_reason(frequency, best, curves, cut_off, eligible, error, span),
        warnings=_warnings(frequency, best, curves, intervals, span, eligible, clear),
        sweep=frequency,
        ambiguity_interval=np.asarray(intervals),
        maxima={
            name: _maxima(frequency, curves[name])
            for name in ("amplitude", "ratio", "contrast")
        },
        **curves,
    )


@dataclass(frozen=True, kw_only=True)
class FrequencyFit:
    """Scan-wide parameters of the single-frequency method."""

    choice: FrequencyChoice | None
    """Result of the frequency choice; None for a frequency given by the user."""
    water: WaterFit
    """Scan-wide fit of the water in front of the targets."""
    cut: CutColumns | None
    """Open-water signal truncated at depths, as in a shadow; None without a survey."""
    terms: tuple[str, ...]
    """Names of the error terms that are not zero everywhere."""


def _keep(
    cube: xr.Dataset,
    *,
    modulation_frequency: float | None = None,
    interval: tuple[float, float] | None = None,
    fit: FrequencyFit | None = None,
    span: tiles.Span | None = None,
) -> tuple[xr.Dataset, FrequencyFit]:
    """Select one frequency of a scan, or with `fit` of rows; return also the fit."""
    cube = cubes.checked(cube, "samples")
    scan = Observation(cube=cube)
    warnings: tuple[str, ...] = ()
    choice = None if fit is None else fit.choice
    if modulation_frequency is None:
        if choice is None:
            choice = choose_frequency(cube, interval=interval)
        modulation_frequency = choice.modulation_frequency
        reason, warnings = choice.reason, choice.warnings
    else:
        reason = "chosen by the user"
    which = np.flatnonzero(np.isclose(scan.frequency, modulation_frequency, rtol=1e-9))
    if len(which) == 0:
        listed = ", ".join(f"{value / 1e6:g}" for value in scan.frequency)
        raise CubeError(
            f"the cube has no sample at {modulation_frequency / 1e6:g} MHz, but at "
            f"{listed} MHz; choose one of these"
        )
    water = water_before_target(
        scan, interval=interval, fit=None if fit is None else fit.water, span=span
    )
    residual = water.signal
    if water.hidden_fraction is not None:
        residual = np.where(np.isfinite(water.hidden_fraction), residual, np.nan)
    errors = scan.covariance + water.fluctuation + water.common
    signal = scan.signal[which]
    terms = present_terms(
        {
            "counting": scan.covariance.part(which),
            "fluctuation": water.fluctuation.part(which),
            "reference": water.common.part(which),
        },
        None if fit is None else fit.terms,
    )
    # By all frequencies: one alone takes water that is cut off close by for a target.
    has_target, cut, chance = shows_target(
        scan, water, interval=interval, fit=None if fit is None else fit.cut
    )
    result = target_cube(
        cube.isel(modulation_frequency=which),
        signal,
        errors.part(which),
        water_signal=np.zeros_like(signal),
        residual=residual[which],
        common=water.common.part(which),
        terms=terms,
        tests={"no_target_probability": chance},
        step=f"reject, keep {modulation_frequency / 1e6:g} MHz alone",
        frequencies_share_errors=np.int32(0),
        frequency_choice=reason,
        frequency_warnings="; ".join(warnings),
    )
    return quality.add(result, QualityFlag.NO_TARGET, ~has_target), FrequencyFit(
        choice=choice, water=water.fit, cut=cut, terms=tuple(terms)
    )


@method(
    "frequency",
    needs=Needs(open_water=True),
    simplicity=2,
    keeps_one_frequency=True,
    fitter=partial(tiles.fit_on_sample, _keep),
)
def frequency(
    cube: xr.Dataset,
    *,
    modulation_frequency: float | None = None,
    interval: tuple[float, float] | None = None,
) -> xr.Dataset:
    """Keep a single frequency, by default the best; the water is not subtracted.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with open-water shots.
    modulation_frequency : float, optional
        Frequency to keep, exactly as in the cube [Hz]. By default the result of
        `choose_frequency`.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    xarray.Dataset
        Level `target_signal` with one frequency:

        - `in_phase`, `quadrature`: signal of the samples, water included. The
          uncertainty includes the fluctuation of the water and the error of the
          shots.
        - `residual_` variables: water signal by the shots, which determines the
          shift of the range.
        - `WATER_RESIDUAL`: the shift exceeds the uncertainty.
        - `NO_TARGET`: the signal is less than five times the water signal, or open
          water explains all frequencies.
        - `frequency_choice`, `frequency_warnings`: reasons for the choice.



    Raises
    ------
    CubeError
        As in `choose_frequency`, or if the cube has no such frequency.

    Examples
    --------
    >>> from amulor import rejection, samples
    >>> sweep = samples.cube("sweep").isel(row=[3], column=slice(0, None, 8))
    >>> kept = rejection.frequency(
    ...     sweep.isel(shot=slice(0, None, 8)), modulation_frequency=40e6
    ... )
    >>> kept.sizes["modulation_frequency"]
    1
    """
    return _keep(cube, modulation_frequency=modulation_frequency, interval=interval)[0]


def _channel(names: list[str], figures: Merit, polarization: str | None) -> int:
    if polarization is None:
        best = np.nanmin(
            np.where(np.isfinite(figures.error), figures.error, np.inf), axis=0
        )
        return int(np.argmin(best))
    if polarization not in names:
        raise CubeError(
            f"the cube has no channel {polarization!r}, but {', '.join(names)}; choose "
            "one"
        )
    return names.index(polarization)


def _fitted_cut_off(scan: Observation, channel: int) -> float | None:
    """Fit the first-order cut-off of open water [Hz]; None if outside the sweep."""
    signal, frequency = shots_of(scan).signal[:, channel], scan.frequency
    amplitude = np.abs(np.nanmean(signal, axis=-1))
    try:
        cut_off = low_pass.fit(frequency, amplitude).cut_off
    except ValueError:
        return None
    # A sweep that stays on one side of the cut-off does not show it.
    return float(cut_off) if frequency[0] < cut_off < frequency[-1] else None


def _maxima(frequency: Floats, values: Floats) -> Floats:
    good = np.isfinite(values)
    if good.sum() < 3:
        return np.empty(0)
    return extrema.find(frequency[good], values[good]).maxima


def _reason(
    frequency: Floats,
    best: int,
    curves: dict[str, Floats],
    cut_off: float | None,
    eligible: NDArray[np.bool_],
    error: Floats,
    span: float | None,
) -> str:
    where = "the sweep shows no cut-off of the water signal"
    if cut_off is not None:
        side = "above" if frequency[best] > cut_off else "below"
        where = f"{side} the cut-off of the water signal at {cut_off / 1e6:.3g} MHz"
    text = (
        f"{frequency[best] / 1e6:.6g} MHz, {where}: the signal is "
        f"{curves['ratio'][best]:.3g} times that of the water, which shifts the range "
        f"by {curves['shift'][best] * 1e3:.3g} mm; "
        f"noise {curves['noise'][best] * 1e3:.3g} mm"
    )
    rest = np.flatnonzero(np.isfinite(error) & (np.arange(error.size) != best))
    better = [k for k in rest if error[k] < error[best] and not eligible[k]]
    if better and span is not None:
        text += (
            f"; frequencies from {frequency[better[0]] / 1e6:.6g} MHz on would err "
            f"less, but repeat within the {span:.3g} m of the interval"
        )
    elif len(rest):
        worst = rest[int(np.argmax(error[rest]))]
        text += (
            f"; {error[worst] * 1e3:.3g} mm at {frequency[worst] / 1e6:.6g} MHz, the "
            "worst of the sweep"
        )
    return text


def _warnings(
    frequency: Floats,
    best: int,
    curves: dict[str, Floats],
    intervals: Floats,
    span: float | None,
    eligible: NDArray[np.bool_],
    clear: NDArray[np.bool_],
) -> tuple[str, ...]:
    warnings = []
    if frequency.size == 1:
        warnings.append("the cube has one frequency, so there was nothing to choose")
    if span is None:
        warnings.append(
            f"this frequency alone repeats after {intervals[best]:.3g} m; state the "
            "interval that is possible if targets may be farther"
        )
    elif not clear[best]:
        warnings.append(
            "useless without further knowledge: it repeats after "
            f"{intervals[best]:.3g} m and the interval spans {span:.3g} m; narrow it, "
            "or record a lower one"
        )
    if curves["noise"][best] > LARGEST_PHASE_ERROR / (2 * np.pi) * intervals[best]:
        warnings.append(
            f"useless for noise: {curves['noise'][best]:.3g} m is "
            f"{curves['noise'][best] / intervals[best]:.0%} of the ambiguity interval; "
            "raise power or dwell"
        )
    if curves["shift"][best] > _LARGE_SHIFT * intervals[best]:
        warnings.append(
            "the water still shifts the range by "
            f"{curves['shift'][best] * 1e3:.3g} mm; subtract open water instead"
        )
    at_an_end = best in (0, frequency.size - 1) and frequency.size > 1
    blocked = best + 1 < frequency.size and not eligible[best + 1]
    if at_an_end and not blocked:
        warnings.append(
            "the best frequency stands at the end of the sweep; a wider sweep may hold "
            "a better one"
        )
    return tuple(warnings)
