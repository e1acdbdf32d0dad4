"""Water signal in front of the target: open-water signal less the hidden part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor._progress import tell
from amulor.cube import WaterResidualCause
from amulor.cube.error import LARGEST_CHANCE
from amulor.cube.tiles import Span
from amulor.optics import detection, interference
from amulor.optics.ambiguity import Choices
from amulor.rejection.covariance import Covariance
from amulor.rejection.observation import Observation
from amulor.rejection.reference import column, model
from amulor.rejection.reference.column import Column
from amulor.rejection.reference.shots import (
    Reference,
    ShotsFit,
    expected_at_pixels,
    fit_shots,
    fluctuation_of,
    real_drift_of,
)
from amulor.survey import Survey
from amulor.survey.properties import by_coefficients

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: Factors of a and b that are tried, in even steps of the logarithm [1].
_FACTORS = np.geomspace(0.25, 4.0, 49)
#: Every which of them is tried first.
_COARSE = 6
#: Directions of the scan whose open water is compared with the model.
_DIRECTIONS = 9
#: What the model may be off by where too few frequencies could show it, in parts of
#: the open water, by the number of frequencies [1].
_UNSEEN = {1: 0.05, 2: 0.01, 3: 0.005}

#: A small-angle form that misses more than this of the open water is doubted [1], and
#: the diffusion form taken where it leaves less than this part of the square [1].
_WRONG, _BETTER = 0.02, 0.25


@dataclass(frozen=True, kw_only=True)
class Turbidity:
    """Turbidity of the survey's water, estimated from the open-water shots."""

    survey: Survey
    """Survey with absorption and scattering multiplied by the factor."""
    factor: float
    """Factor on absorption and scattering [1]."""
    uncertainty: float
    """Standard uncertainty of the logarithm of the factor [1]."""
    steeper: Survey
    """Survey with the factor increased by one standard uncertainty."""
    misfit: float
    """Root-mean-square model error beyond chance, relative to the open-water signal; an
    upper bound for few frequencies [1]."""
    shown: float
    """Part of the misfit that is detected in the shots [1]."""
    is_real: bool = True
    """Whether the noise of the shots does not explain the misfit."""
    is_extreme: bool = False
    """Whether the best factor lies at an end of the tested range, or beyond."""
    paper: bool = False
    """Whether the paper's diffusion model is used instead of the small-angle model."""


def turbidity_of(
    scan: Observation, survey: Survey, open_water: Complex, errors: Covariance
) -> Turbidity:
    r"""Estimate the factor for absorption and scattering that best fits open water.

    `model.water_signal` computes the open water of the survey. Its amplitude in each
    channel is free. The phases of the shots depend on the depth from which the light
    comes, so one frequency suffices. The amplitudes depend on the spread of this depth.
    The uncertainty of the factor is the change that increases chi-square by one, or by
    chi-square per degree of freedom if that is larger. The small-angle form is the
    model, unless it deviates from the open water by more than 2 % and the diffusion
    form of the paper by less than half as much. The remaining deviation at the best
    factor is the error of the model.
    """
    from scipy.special import chdtrc

    directions = _spread(scan.azimuth.size)
    frequencies, channels = open_water.shape[:2]

    def some(values: NDArray[np.generic]) -> NDArray[np.generic]:
        return values.reshape(frequencies, channels, -1)[..., directions]

    measured: Complex = some(open_water)  # type: ignore[assignment]
    variance = np.asarray(some(errors.in_phase + errors.quadrature), dtype=float) / 2
    # Shots without any error still need weights.
    floor = (1e-6 * np.abs(measured).max(initial=0.0)) ** 2 + np.finfo(float).tiny
    weight = 1 / np.maximum(variance, floor)
    places = np.stack(
        [angle.ravel()[directions] for angle in (scan.azimuth, scan.elevation)]
    ).T

    def minimum(*, paper: bool) -> tuple[float, float, float]:
        """Return index, value and curvature of the minimum of chi-square."""
        square = _near_minimum(
            lambda factor: _chi_square(
                model.open_water(
                    scaled(survey, factor), places, scan.frequency, paper=paper
                ),
                measured,
                weight,
            )
        )
        return _minimum(square)

    step = float(np.log(_FACTORS[1] / _FACTORS[0]))
    place, lowest, curvature = minimum(paper=False)
    power = float(np.sum(weight * np.abs(measured) ** 2))
    paper = False
    if lowest > _WRONG**2 * power:
        other = minimum(paper=True)
        if other[1] < _BETTER * lowest:
            (place, lowest, curvature), paper = other, True
    factor = float(_FACTORS[0] * np.exp(place * step))
    # The two outputs of a sample count twice; directions share their shots.
    freedom = max(2 * frequencies * channels - channels - 1, 1)
    scale = max(lowest / len(directions) / freedom, 1.0)
    width = step * float(np.sqrt(2 * scale * len(directions) / max(curvature, 1e-12)))
    uncertainty = min(width, float(np.log(4.0)))
    is_extreme = not 0.5 < place < len(_FACTORS) - 1.5
    if is_extreme:
        # The best factor is beyond the tested range.
        uncertainty = max(uncertainty, float(np.log(2.0)))
    explained = len(directions) * freedom
    unexplained = max(lowest - explained, 0.0) / power if power > 0 else 1.0
    misfit = float(np.hypot(np.sqrt(unexplained), _UNSEEN.get(frequencies, 0.0)))
    return Turbidity(
        survey=scaled(survey, factor),
        factor=factor,
        uncertainty=uncertainty,
        steeper=scaled(survey, factor * float(np.exp(uncertainty))),
        misfit=min(misfit, 1.0),
        shown=min(float(np.sqrt(unexplained)), 1.0),
        # Directions may share the errors of all shots.
        is_real=bool(chdtrc(freedom, lowest / len(directions)) < LARGEST_CHANCE),
        is_extreme=is_extreme,
        paper=paper,
    )


def scaled(survey: Survey, factor: float) -> Survey:
    """Return a survey with absorption and scattering multiplied by a factor."""
    return by_coefficients(survey, factor=factor)


def _spread(count: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, count - 1, min(_DIRECTIONS, count)).astype(np.intp))


def _chi_square(model: Complex, measured: Complex, weight: Floats) -> float:
    """Return chi-square of a model, with the signal strength fitted in each channel."""
    total = 0.0
    for channel in range(measured.shape[1]):
        signal, w = measured[:, channel], weight[:, channel]
        power = float(np.sum(w * np.abs(model) ** 2))
        product = float(np.sum(w * (model.conj() * signal).real))
        strength = max(product / power, 0.0) if power > 0 else 0.0
        total += float(np.sum(w * np.abs(signal - strength * model) ** 2))
    return total


def _near_minimum(chi_square: Callable[[float], float]) -> Floats:
    """Evaluate chi-square at the `_FACTORS` near its minimum; infinite elsewhere.

    Each sixth factor first, then halfway, then neighbors until none is lower.
    """
    values = np.full(len(_FACTORS), np.inf)
    last = len(_FACTORS) - 1
    waiting = set(range(0, last + 1, _COARSE))
    while waiting:
        for k in waiting:
            values[k] = chi_square(float(_FACTORS[k]))
        is_fine = np.isfinite(values).sum() > last // _COARSE + 1
        best = int(np.clip(values.argmin(), 1, last - 1))
        reach = 1 if is_fine else _COARSE // 2
        around = {max(best - reach, 0), best, min(best + reach, last)}
        waiting = {k for k in around if np.isinf(values[k])}
    return values


def _minimum(square: Floats) -> tuple[float, float, float]:
    """Return index, value and second difference of a minimum, by a parabola."""
    k = int(np.clip(np.argmin(square), 1, len(square) - 2))
    before, middle, after = square[k - 1 : k + 2]
    curvature = float(before - 2 * middle + after)
    if curvature <= 0:
        return float(np.argmin(square)), float(square.min()), 0.0
    off = float(np.clip((before - after) / (2 * curvature), -1.0, 1.0))
    lowest = float(middle - curvature * off**2 / 2)
    return k + off, max(lowest, 0.0), curvature


@dataclass(frozen=True, kw_only=True)
class WaterFit:
    """Scan-wide fit of the water in front of the targets."""

    shots: ShotsFit
    """Interpolation of the shots over the scan."""
    estimated_turbidity: Turbidity | None
    """Turbidity estimated from the shots; None without a survey."""
    choices: Choices | None
    """Frequency choices of the path estimate, common to all pixels; None without a
    survey."""
    first: tuple[Choices | None, Column] | None
    """Frequency choices and column of the first pass; None without a survey."""
    column: Column | None
    """Fractions of the open-water signal from behind targets; None without a survey."""
    steeper: Column | None
    """Fractions for water more turbid by one standard uncertainty; None if the survey
    is not corrected."""


@dataclass(frozen=True, kw_only=True)
class WaterBeforeTarget:
    """Water signal in front of the targets, arrays of the shape of the samples."""

    fits: list[Reference]
    """Fits of the shots, frequency by frequency, channel by channel."""
    to_the_end: Complex
    """Water signal without a target, from the shots [V]."""
    difference: Complex
    """Samples less `to_the_end`: target signal less the hidden water signal [V]."""
    hidden_fraction: Complex | None
    """Fraction of `to_the_end` from behind the target; NaN where the distance is
    unknown, None if no survey describes the water [1]."""
    hidden_error: Covariance | None
    """Covariance of the hidden water from errors of turbidity and model, common to all
    pixels; None if the survey is not corrected [V^2]."""
    survey: Survey | None
    """Survey used for the hidden fraction."""
    turbidity: Turbidity | None
    """Turbidity used to correct the survey; None without correction."""
    estimated_turbidity: Turbidity | None
    """Turbidity estimated from the shots, even if the survey is not corrected."""
    signal: Complex
    """Water signal up to the target; open-water signal if the distance is unknown
    [V]."""
    fluctuation: Covariance
    """Covariance of the fluctuation of `signal` from sample to sample [V^2]."""
    common: Covariance
    """Covariance of the reference error, common to all pixels [V^2]."""
    path: NDArray[np.float64]
    """Round-trip optical path of every pixel, NaN if unknown [m]."""
    fit: WaterFit
    """Scan-wide fit, for other rows of the scan."""

    @property
    def drift(self) -> Complex:
        """Relative change from first to last reference; 0 if not significant."""
        return real_drift_of(self.fits, self.signal.shape)


def water_before_target(
    scan: Observation,
    *,
    interval: tuple[float, float] | None,
    survey_is_right: bool = False,
    fit: WaterFit | None = None,
    span: Span | None = None,
) -> WaterBeforeTarget:
    """Compute the water signal in front of the target for every sample.

    `survey_is_right` says that the survey's absorption and scattering are taken as they
    stand, not corrected by what the shots show. CubeError as `open_water`.
    """
    tell("open water at each pixel", 0.0)
    fits, by_shots = fit_shots(scan, fit=None if fit is None else fit.shots, span=span)
    water, common = expected_at_pixels(fits, scan.signal.shape)
    difference = interference.target_signal(scan.signal, water)
    survey = scan.survey
    estimate, turbidity, hidden, steeper = None, None, None, None
    first = None if fit is None else fit.first
    choices = None if fit is None else fit.choices
    behind = None if fit is None else fit.column
    steeper_behind = None if fit is None else fit.steeper
    path = np.full(water.shape[2:], np.nan)
    if survey is not None:
        tell("turbidity that the shots tell", 0.2)
        estimate = None if fit is None else fit.estimated_turbidity
        if estimate is None:
            estimate = turbidity_of(scan, survey, water, common)
        if not survey_is_right:
            turbidity, survey = estimate, estimate.survey
        errors = scan.covariance + common
        tell("water behind the targets", 0.6)
        paper = turbidity is not None and turbidity.paper
        depth, _, first_choices = column.depth(
            scan,
            difference,
            errors,
            survey,
            interval=interval,
            fit=None if first is None else first[0],
        )
        hidden, first_column = column.hidden_fraction(
            scan, survey, depth, paper=paper, fit=None if first is None else first[1]
        )
        first = first_choices, first_column
        # The column shifts the phase that determines its depth: a second pass.
        depth, path, choices = column.depth(
            scan,
            difference + np.nan_to_num(hidden) * water,
            errors,
            survey,
            interval=interval,
            fit=choices,
        )
        hidden, behind = column.hidden_fraction(
            scan, survey, depth, paper=paper, fit=behind
        )
        if turbidity is not None:
            steeper, steeper_behind = column.hidden_fraction(
                scan, turbidity.steeper, depth, paper=paper, fit=steeper_behind
            )
    signal = water if hidden is None else (1 - np.nan_to_num(hidden)) * water
    return WaterBeforeTarget(
        fits=fits,
        to_the_end=water,
        difference=difference,
        hidden_fraction=hidden,
        hidden_error=(
            None
            if turbidity is None or hidden is None or steeper is None
            else column.hidden_error(water, hidden, steeper, misfit=turbidity.misfit)
        ),
        survey=survey,
        turbidity=turbidity,
        estimated_turbidity=estimate,
        signal=signal,
        fluctuation=fluctuation_of(fits, signal),
        common=common,
        path=path,
        fit=WaterFit(
            shots=by_shots,
            estimated_turbidity=estimate,
            first=first,
            choices=choices,
            column=behind,
            steeper=steeper_behind,
        ),
    )


#: Relative standard deviation by which water departs from its reference unseen [1].
DEPARTURE = 0.02
#: Phase uncertainty beyond which a phase has no information [rad].
_BLURRED = 0.2
#: Phases farther off than this many standard errors are spikes [1].
_SPIKE = 5.0
#: Pixels that are enough, however large the scan.
_ENOUGH = 20_000
#: Ratio of estimate to expected size beyond which the prior is widened [1].
_SURPRISE = 3.0
#: A larger change of the water, surely so, is another water than that of the shots [1].
LARGEST_CHANGE = 0.3
#: Shots that depart from any water of the survey by more are not water alone [1].
LARGEST_MISFIT = 0.2
#: And by so much where not even four times or a fourth of its turbidity is enough [1].
_EXTREME_MISFIT = 0.05
#: A limit must be exceeded by so many standard uncertainties [1].
_SURE = 3.0
#: A surprising change of the water is confirmed by samples with a larger chance [1].
_CONFIRMED = 0.01
#: Pixels from which on a mean is a good one.
_FEWEST_PIXELS = 10


@dataclass(frozen=True, kw_only=True)
class Strength:
    """Relative change of the water signal from its reference to the scan."""

    change: float
    """Relative change; the scan's water is (1 + change) times the reference [1]."""
    uncertainty: float
    """Standard uncertainty of the change [1]."""
    is_untested: bool = False
    """Whether the change is surprising and no other data test it."""
    phases: ScanPhases | None = None
    """Phases of two frequencies that no change of the water brings to one distance;
    None if a change does, or is not surprising."""

    @property
    def subtracted(self) -> float:
        """Part of the change that is subtracted [1].

        Leakage, a delay between channels or a layer of other water looks like a change
        of all water, but its effect on the range is smaller or larger. Half of an
        untested change is subtracted.
        """
        return self.change / 2 if self.is_untested else self.change

    @property
    def error(self) -> float:
        """Standard uncertainty of the subtracted part [1]."""
        untested = self.change if self.is_untested else 0.0
        return float(np.hypot(self.uncertainty, untested))


@dataclass(frozen=True, kw_only=True)
class ScanPhases:
    """Deviations of the scan's mean phases from one distance, by frequency."""

    phase: Floats
    """Deviation of each frequency, all channels together [rad]."""
    probability: float
    """Probability of so large deviations by chance and usual changes of the water
    [1]."""
    of_change: float
    """Probability of the deviations that a changed water leaves [1]."""
    least_change: float = 0.0
    """Least size of the change of the water that would explain the frequencies [1]."""


def _scan_phases(
    phase: Floats,
    turn: Floats,
    wavenumber: Floats,
    *,
    independent: Floats,
    shared: Floats,
    valid: NDArray[np.bool_],
) -> ScanPhases | None:
    """Test the mean phases of a scan against one distance.

    Arguments are those of `_fit`, with phase errors. None if they leave no freedom, or
    if a frequency has too few valid pixels in a channel.
    """
    from scipy.special import chdtrc

    counts = valid.sum(axis=2)
    if counts.size < 3 or counts.min() < _FEWEST_PIXELS:
        return None
    phase, turn, independent, shared = (
        np.sum(np.where(valid, values, 0.0), axis=2) / counts
        for values in (phase, turn, independent, shared)
    )
    error = np.hypot(shared, independent / np.sqrt(counts))
    scale = np.broadcast_to(wavenumber[:, :, 0], phase.shape)

    def misfit(values: Floats, errors: Floats, *columns: Floats) -> Floats:
        design = np.stack([(column / errors).ravel() for column in columns], axis=1)
        whitened = (values / errors).ravel()
        best = np.linalg.lstsq(design, whitened)[0]
        return np.asarray((whitened - design @ best).reshape(values.shape) * errors)

    rest = misfit(phase, error, scale, turn) / error
    of_change = chdtrc(phase.size - 2, float(np.sum(rest**2)))
    # Errors that pixels share may be shared by the channels, too.
    weight = error**-2 / np.sum(error**-2, axis=1, keepdims=True)
    mean, water, together = (
        np.sum(weight * values, axis=1) for values in (phase, turn, error)
    )
    together = np.hypot(together, DEPARTURE * water)
    deviation = misfit(mean, together, scale[:, 0])
    square = float(np.sum((deviation / together) ** 2))
    return ScanPhases(
        phase=deviation,
        probability=float(chdtrc(deviation.size - 1, square)),
        of_change=float(of_change),
    )


def contradiction(
    strength: Strength, turbidity: Turbidity | None
) -> WaterResidualCause:
    """Return the cause of a disagreement of references and scan; 0 if they agree."""
    sure = abs(strength.change) - _SURE * strength.uncertainty > LARGEST_CHANGE
    # No water has a negative strength or resembles these shots.
    negative = sure and strength.change <= -1
    unlike = (
        turbidity is not None
        and turbidity.is_real
        and (
            turbidity.misfit > LARGEST_MISFIT
            or (turbidity.is_extreme and turbidity.shown > _EXTREME_MISFIT)
        )
    )
    phases = strength.phases
    if negative or unlike or (phases and phases.least_change > LARGEST_CHANGE):
        return WaterResidualCause.INSTRUMENT
    return WaterResidualCause.WATER_CHANGED if sure else WaterResidualCause(0)


def strength_of(
    target: Complex,
    water_signal: Complex,
    independent: Covariance,
    common: Covariance,
    *,
    modulation_frequency: Floats,
    path: Floats,
    late: tuple[Floats, Floats] | None = None,
) -> Strength:
    r"""Estimate the relative change of the water signal from its reference to the scan.

    The path L of a pixel is the same in all channels and frequencies. A relative change
    c of the water signal shifts each phase by :math:`c\, \mathrm{Im}(W / T)`:

    .. math:: \varphi = 2 \pi f L / c_0 + c\, \mathrm{Im}(W / T) .

    The fit is least squares over all samples, with a free path for each pixel and one c
    for the scan. One frequency in one channel does not determine c. Errors common to
    all pixels do not average out. The prior of c is :math:`0 \pm 2 \%`, unless c is
    clearly larger. In a large scan the fit uses 20,000 evenly spaced pixels. Phases by
    late light differ between frequencies as those of changed water do. `late` are these
    phases with their uncertainties, over (frequency, row, column).
    """
    frequency = modulation_frequency.reshape(-1, 1, 1)
    if len(frequency) == 1:
        # Any path with the mean phase of all channels is suitable.
        phase = np.angle(np.nansum(target[0], axis=0))
        path = phase * speed_of_light / (2 * np.pi * modulation_frequency[0])
    pixels = np.flatnonzero(np.isfinite(path))
    if pixels.size > _ENOUGH:
        pixels = pixels[np.linspace(0, pixels.size - 1, _ENOUGH).astype(np.intp)]
    target, water_signal = (_at(values, pixels) for values in (target, water_signal))
    independent, common = (
        Covariance(*(_at(values, pixels) for values in vars(errors).values()))
        for errors in (independent, common)
    )
    path = path.ravel()[pixels]
    wavenumber = 2 * np.pi * frequency / speed_of_light
    valid = np.isfinite(target) & np.isfinite(water_signal) & (target != 0)
    safe = np.where(valid, target, 1.0)
    sigma, shared = (
        detection.phase_uncertainty(
            safe,
            in_phase_variance=np.where(valid, errors.in_phase, 1.0),
            quadrature_variance=np.where(valid, errors.quadrature, 1.0),
            covariance=np.where(valid, errors.cross, 0.0),
        )
        for errors in (independent, common)
    )
    total = np.hypot(sigma, shared)
    valid &= (total < _BLURRED) & (sigma > 0)
    late_turn = late_error = np.zeros((len(frequency), 1, 1))
    if late is not None:
        late_turn, late_error = (
            np.nan_to_num(part.reshape(len(frequency), 1, -1)[:, :, pixels])
            for part in late
        )
    phase = np.angle(safe * np.exp(-1j * (wavenumber * path + late_turn)))
    turn = np.where(valid, (water_signal / safe).imag, 0.0)
    weight = np.divide(1.0, total**2, out=np.zeros(total.shape), where=valid)
    fit = _fit(phase, turn, wavenumber, weight)
    if fit is not None:
        off = phase - wavenumber * fit.path - fit.change * turn
        weight = np.where(np.abs(off) < _SPIKE * total, weight, 0.0)
        fit = _fit(phase, turn, wavenumber, weight)
    if fit is None:
        return Strength(change=0.0, uncertainty=DEPARTURE)
    # Independent errors average out over the pixels, common errors add up.
    by_independent = np.sum((fit.gain * sigma) ** 2)
    by_shared = np.sum(np.sum(np.abs(fit.gain * shared), axis=2) ** 2)
    # One delay is wrong in all pixels and frequencies.
    by_late = np.sum(fit.gain * late_error) ** 2
    variance = float(by_independent + by_shared + by_late)
    expected = DEPARTURE**2
    surprise = bool(fit.change**2 > _SURPRISE**2 * (expected + variance))
    if surprise:
        expected = fit.change**2 - variance
    change = fit.change * expected / (expected + variance)
    uncertainty = float(np.sqrt(expected * variance / (expected + variance)))
    strength = Strength(
        change=change,
        uncertainty=uncertainty,
        is_untested=surprise and len(frequency) == 1,
    )
    if not surprise or len(frequency) != 2:
        return strength
    phases = _scan_phases(
        phase,
        turn,
        wavenumber,
        independent=sigma,
        shared=shared,
        valid=weight > 0,
    )
    if phases is None or phases.of_change < _CONFIRMED:
        strength = replace(strength, is_untested=True)
    if strength.is_untested and phases and phases.probability < LARGEST_CHANCE:
        least = abs(change) - _SURE * uncertainty
        phases = replace(phases, least_change=least)
        return Strength(change=0.0, uncertainty=DEPARTURE, phases=phases)
    return strength


def _at(values: NDArray[Any], pixels: NDArray[np.intp]) -> NDArray[Any]:
    """Return the samples of selected pixels, shape (frequency, channel, pixel)."""
    return values.reshape(*values.shape[:2], -1)[:, :, pixels]


@dataclass(frozen=True, kw_only=True)
class _Fit:
    change: float
    path: Floats
    """Correction of the path of each pixel [m]."""
    gain: Floats
    """Derivative of the change by each phase [1/rad]."""


def _fit(
    phase: Floats, turn: Floats, wavenumber: Floats, weight: Floats
) -> _Fit | None:
    """Fit a common water-signal change and each pixel's path; None if undetermined."""

    def summed(values: Floats) -> Floats:
        total: Floats = np.sum(weight * values, axis=(0, 1))
        return total

    square = summed(wavenumber**2 + 0 * turn)
    determined = square > 0
    inverse = np.divide(1.0, square, out=np.zeros(square.shape), where=determined)
    mean_turn = summed(wavenumber * turn) * inverse
    across = turn - wavenumber * mean_turn
    information = float(np.sum(weight * across * turn))
    if information <= 0 or not np.isfinite(information):
        return None
    gain = weight * across / information
    change = float(np.sum(gain * phase))
    path = (summed(wavenumber * phase) * inverse) - change * mean_turn
    return _Fit(change=change, path=path, gain=gain)


def raised_to_shot_amplitude(
    scan: Observation,
    water: Complex,
    *,
    fit: WaterFit | None = None,
    span: Span | None = None,
) -> tuple[Complex, WaterFit]:
    """Return the water signal, at least as strong as the references, and the fit.

    The result has the phases of `water` and the larger of both amplitudes [V]. It is
    for errors proportional to the water signal. A fluctuation that makes the estimated
    target too strong makes the estimated water too weak, and so would make its error
    too small. The phase is not changed: in a shadow the sample contains only water,
    and no error perpendicular to it may remain.
    """
    before = water_before_target(scan, interval=None, fit=fit, span=span)
    return _at_least(water, np.abs(before.signal)), before.fit


def raised_to_median_amplitude(
    water: Complex, usual: Floats | None = None
) -> tuple[Complex, Floats]:
    """Return the water signal, raised to at least the median, and the median.

    As `raised_to_shot_amplitude`, for cubes without shots. Also return the median
    amplitude of each frequency and channel, or `usual` if given [V].
    """
    if usual is None:
        amplitude = np.abs(water)
        finite = np.where(np.isfinite(amplitude), amplitude, 0.0)
        usual = np.asarray(np.median(finite, axis=(2, 3), keepdims=True))
    return _at_least(water, usual), usual


def _at_least(water: Complex, size: Floats) -> Complex:
    amplitude = np.abs(water)
    longer = np.divide(
        size, amplitude, out=np.ones(amplitude.shape), where=amplitude > 0
    )
    return np.asarray(water * np.maximum(longer, 1.0))
