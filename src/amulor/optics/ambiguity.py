"""Resolution of the 2 pi phase ambiguity by several modulation frequencies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

from amulor.optics._reading_weights import ReadingWeights

Floats = NDArray[np.float64]

#: The runner-up must fit worse by this much in chi-square, or the choice is open.
MARGIN = 16.0
#: So many standard errors outside of its limits a path is still a candidate,
_SLACK = 4.0
#: and so many still a result: it was measured.
_OUTSIDE = 2.0
#: Frequencies that disagree with the best path by more than this chance say so.
DISAGREEMENT = 1e-4
_MOST_CANDIDATES = 10_000
#: One phase is an outlier if the others agree without it, and if they fit better than
#: without any other one by this much in chi-square.
_CULPRIT = 16.0
#: At most this fraction of the frequencies can be left out of a pixel [1].
BREAKDOWN = 1 / 3
#: Outliers are looked for where at most this fraction of the pixels is unsettled [1].
_MOST_SPOILED = 0.7
#: What so many pixels have in common is no outlier but a wrong model [1].
_RARE = 0.15
#: Phases stated to be without any error still need weights [rad].
_SMALLEST_PHASE_ERROR = 1e-9


@dataclass(frozen=True, kw_only=True)
class Path:
    """Two-way optical path of each pixel, with quality measures.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.optics.ambiguity import optical_path
    >>> found = optical_path(
    ...     np.array([[np.pi]]), np.array([[0.01]]),
    ...     modulation_frequency=np.array([50e6]),
    ...     shortest=np.array([0.0]), longest=np.array([5.9]),
    ... )
    >>> print(found.length.round(4), found.settled)
    [2.9979] [ True]
    """

    length: Floats
    """Two-way optical path: group index times geometric length [m]."""
    uncertainty: Floats
    """Standard uncertainty of the optical path [m]."""
    weight: Floats
    """Weight of each frequency in the result, along the first axis [1]."""
    settled: NDArray[np.bool_]
    """Whether a single ambiguity interval fits, clearly better than the next."""
    wrong: Floats
    """Probability of a wrong ambiguity interval, for normal phase errors [1]."""
    residual: Floats
    """Phase residuals as paths, along the first axis; 0 for outliers [m]."""
    strain: Floats
    """Sum of squared residuals over their variances, `doubt` included [1]."""
    left_out: NDArray[np.bool_]
    """Mask of phases excluded as outliers, frequencies along the first axis."""


@dataclass(frozen=True, kw_only=True)
class Choices:
    """Outlier search and frequency order, chosen once for all pixels of a scan.

    Examples
    --------
    >>> from amulor.optics.ambiguity import Choices
    >>> Choices(order=(1, 0))
    Choices(order=(1, 0), outliers_searched=True, outliers_left_out=True)
    """

    order: tuple[int, ...]
    """Frequency indices, sorted by rising median path error."""
    outliers_searched: bool = True
    """Whether outliers are searched, as ambiguous pixels are few."""
    outliers_left_out: bool = True
    """Whether outliers are excluded, as they are rare."""


def optical_path(
    phase: Floats,
    uncertainty: Floats,
    *,
    modulation_frequency: Floats,
    shortest: Floats,
    longest: Floats,
    doubt: Floats | float = 0.0,
    motion: Floats | None = None,
    choices: Choices | None = None,
) -> Path:
    """Return the two-way optical path that best fits the phases at all frequencies.

    Parameters
    ----------
    phase, uncertainty : ndarray, shape (frequencies, ...)
        Wrapped phase of the target and its standard uncertainty [rad].
    modulation_frequency : ndarray, shape (frequencies,)
        Modulation frequencies [Hz].
    shortest, longest : ndarray, shape (...)
        Limits of the optical path, apart from its error [m].
    doubt : ndarray or float
        Possible phase errors beyond the uncertainty, such as by residual water signal
        [rad]. They only permit larger disagreement between frequencies.
    motion : ndarray, optional
        Standard deviation of the path at each reading, by a path rate that all readings
        of a pixel share; its sign is that of the time since the instant to which the
        path belongs [m].
    choices : Choices, optional
        Scan-wide choices, from `fit` on the pixels of a whole scan or a sample of it;
        by default from these pixels.

    Returns
    -------
    Path
        Arrays of the shape of one frequency's phase.

    Raises
    ------
    ValueError
        If the limits contain too many ambiguity intervals for the phases to resolve.

    Notes
    -----
    Each candidate is the path of the most precise frequency plus whole wavelengths of
    the modulation. It is refined by the weighted mean of all frequencies, unwrapped
    about the candidate. Its misfit is the sum of squared phase errors: maximum
    likelihood for normal errors. The same sums give the probability that another
    candidate is right, with equal prior probabilities. At the ends of a full ambiguity
    interval both ends are candidates. A path within a few standard errors of an end is
    therefore not settled, nor is a path outside by more than two.

    With `motion` b, the covariance of the paths at all frequencies is the diagonal of
    their variances plus :math:`b b^T`: the rate is a nuisance parameter with a normal
    prior. Residuals are those about the most probable rate.

    With three or more frequencies, a frequency is an outlier if all together disagree
    and all others agree. Outliers are excluded one after the other, up to a third of
    the frequencies. If more than 15 % of the pixels would lose a frequency, none does:
    such errors are not random.

    Examples
    --------
    A path of 8 m at 40 and 50 MHz, phases wrapped; their difference of 10 MHz settles
    up to 30 m.

    >>> import numpy as np
    >>> from scipy.constants import speed_of_light
    >>> from amulor.optics.ambiguity import optical_path
    >>> frequency = np.array([40e6, 50e6])
    >>> phase = np.angle(np.exp(2j * np.pi * frequency * 8.0 / speed_of_light))
    >>> found = optical_path(
    ...     phase[:, None], np.full((2, 1), 0.01), modulation_frequency=frequency,
    ...     shortest=np.array([0.0]), longest=np.array([29.0]),
    ... )
    >>> print(f"{found.length[0]:.4f} m", bool(found.settled[0]))
    8.0000 m True
    """
    return _solved(
        phase,
        uncertainty,
        modulation_frequency=modulation_frequency,
        shortest=shortest,
        longest=longest,
        doubt=doubt,
        motion=motion,
        choices=choices,
    )[0]


def fit(
    phase: Floats,
    uncertainty: Floats,
    *,
    modulation_frequency: Floats,
    shortest: Floats,
    longest: Floats,
    doubt: Floats | float = 0.0,
    motion: Floats | None = None,
) -> tuple[Path, Choices]:
    """Return the two-way optical path of each pixel, and choices for the whole scan.

    Parameters
    ----------
    phase, uncertainty, modulation_frequency, shortest, longest, doubt, motion : ndarray
        As in `optical_path`.

    Returns
    -------
    tuple of Path and Choices
        Path as from `optical_path`, and choices by which other rows of the same scan
        are solved alike.

    Examples
    --------
    The frequency of the smallest error as a length comes first:

    >>> import numpy as np
    >>> from amulor.optics.ambiguity import fit
    >>> path, choices = fit(
    ...     np.full((2, 1), np.pi), np.full((2, 1), 0.01),
    ...     modulation_frequency=np.array([10e6, 50e6]),
    ...     shortest=np.array([0.0]), longest=np.array([29.0]),
    ... )
    >>> print(f"{path.length[0]:.2f} m", choices.order)
    14.99 m (1, 0)
    """
    return _solved(
        phase,
        uncertainty,
        modulation_frequency=modulation_frequency,
        shortest=shortest,
        longest=longest,
        doubt=doubt,
        motion=motion,
        choices=None,
    )


def _solved(
    phase: Floats,
    uncertainty: Floats,
    *,
    modulation_frequency: Floats,
    shortest: Floats,
    longest: Floats,
    doubt: Floats | float,
    motion: Floats | None,
    choices: Choices | None,
) -> tuple[Path, Choices]:
    """Return two-way optical paths and scan-wide choices, as given or computed."""
    if choices is None:
        order = _by_error(uncertainty, modulation_frequency)
    else:
        order = choices.order
    phases = _Phases(
        phase=phase,
        uncertainty=uncertainty,
        modulation_frequency=modulation_frequency,
        shortest=np.broadcast_to(shortest, phase.shape[1:]),
        longest=np.broadcast_to(longest, phase.shape[1:]),
        doubt=np.broadcast_to(np.asarray(doubt, dtype=float), phase.shape),
        motion=None if motion is None else np.broadcast_to(motion, phase.shape),
        order=order,
    )
    path = _best_path(phases)
    if len(modulation_frequency) < 3:
        return path, Choices(order=order)
    usable = np.isfinite(path.length)
    unsettled = usable & ~path.settled
    if choices is None:
        # Where hardly any pixel agrees, it is the errors that are stated too small.
        most = max(_MOST_SPOILED * usable.sum(), 1)
        is_searched = bool(unsettled.sum() <= most)
    else:
        is_searched = choices.outliers_searched
    wrong = _wrong(path, unsettled, phases) if is_searched and unsettled.any() else None
    if choices is not None:
        is_left_out = choices.outliers_left_out
    elif wrong is None:
        is_left_out = True
    else:
        everywhere = path.left_out.copy()
        everywhere[:, unsettled] = wrong[0] & wrong[1]
        often = everywhere[:, usable].sum(axis=1).max()
        is_left_out = bool(often <= max(_RARE * usable.sum(), 1))
    if is_left_out and wrong is not None:
        _leave_out(path, unsettled, phases, *wrong)
    chosen = Choices(
        order=order, outliers_searched=is_searched, outliers_left_out=is_left_out
    )
    return path, chosen


def _by_error(uncertainty: Floats, modulation_frequency: Floats) -> tuple[int, ...]:
    """Return frequency indices, sorted by rising median path error."""
    per_phase = speed_of_light / modulation_frequency / (2 * np.pi)
    sigma = np.maximum(uncertainty, _SMALLEST_PHASE_ERROR).reshape(len(per_phase), -1)
    return tuple(int(k) for k in np.argsort(np.nanmedian(sigma, axis=1) * per_phase))


@dataclass(frozen=True, kw_only=True)
class _Phases:
    """Measured phases over (frequency, ...), with their errors and path limits."""

    phase: Floats
    uncertainty: Floats
    modulation_frequency: Floats
    shortest: Floats
    longest: Floats
    doubt: Floats
    motion: Floats | None
    order: tuple[int, ...]
    """Frequency indices, smallest path error first."""

    def part(
        self, pixels: tuple[NDArray[np.intp], ...], left_out: NDArray[np.bool_]
    ) -> _Phases:
        """Return the phases of selected pixels, infinite errors for outliers."""
        index: tuple[Any, ...] = (slice(None), *pixels)
        return replace(
            self,
            phase=self.phase[index],
            uncertainty=np.where(left_out, np.inf, self.uncertainty[index]),
            shortest=self.shortest[pixels],
            longest=self.longest[pixels],
            doubt=self.doubt[index],
            motion=None if self.motion is None else self.motion[index],
        )


def _wrong(
    path: Path, unsettled: NDArray[np.bool_], phases: _Phases
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks: outlying phases, and ambiguous pixels resolved without them."""
    left_out = path.left_out[:, unsettled]
    strain = path.strain[unsettled]
    cured = np.zeros(strain.size, dtype=bool)
    going_on = np.ones(strain.size, dtype=bool)
    for _ in range(int(len(left_out) * BREAKDOWN)):
        active = np.flatnonzero(going_on)
        if active.size == 0:
            break
        pixels = np.zeros(unsettled.shape, dtype=bool)
        pixels.reshape(-1)[np.flatnonzero(unsettled)[active]] = True
        strains, settled = _without_each(phases, pixels, left_out[:, active])
        order = np.argsort(strains, axis=0)
        column = np.arange(active.size)
        best, next_best = (strains[order[k], column] for k in (0, 1))
        with np.errstate(invalid="ignore"):
            better = strain[active] - best > _CULPRIT
            sure = settled[order[0], column] & (next_best - best > _CULPRIT)
        left_out[order[0][better], active[better]] = True
        strain[active] = best
        cured[active] = better & sure
        going_on[active] = better & ~sure
    return left_out, cured


def _leave_out(
    path: Path,
    unsettled: NDArray[np.bool_],
    phases: _Phases,
    left_out: NDArray[np.bool_],
    cured: NDArray[np.bool_],
) -> None:
    """Recompute, in place, the paths of pixels that are resolved without outliers."""
    if not cured.any():
        return
    places = np.zeros(unsettled.shape, dtype=bool)
    places[unsettled] = cured
    solved = _grouped(phases, places, left_out[:, cured])
    for name in ("length", "uncertainty", "settled", "wrong", "strain"):
        getattr(path, name)[places] = getattr(solved, name)
    for name in ("weight", "residual", "left_out"):
        getattr(path, name)[:, places] = getattr(solved, name)


def _without_each(
    phases: _Phases, pixels: NDArray[np.bool_], left_out: NDArray[np.bool_]
) -> tuple[Floats, NDArray[np.bool_]]:
    """Return chi-square, and whether resolved, with each frequency omitted in turn."""
    strains = np.full(left_out.shape, np.inf)
    settled = np.zeros(left_out.shape, dtype=bool)
    for index in range(len(left_out)):
        without = left_out.copy()
        without[index] = True
        tried = _grouped(phases, pixels, without)
        # Phases that are already excluded cannot be excluded again.
        strains[index] = np.where(left_out[index], np.inf, tried.strain)
        settled[index] = tried.settled & ~left_out[index]
    return strains, settled


def _grouped(
    phases: _Phases, pixels: NDArray[np.bool_], left_out: NDArray[np.bool_]
) -> Path:
    """Return the best-fitting path of each pixel, with its outliers excluded."""
    masks, group = np.unique(left_out, axis=1, return_inverse=True)
    places = np.flatnonzero(pixels)
    parts: dict[str, NDArray[Any]] = {}
    for number, mask in enumerate(masks.T):
        members = np.flatnonzero(group.ravel() == number)
        chosen = np.unravel_index(places[members], pixels.shape)
        solved = _best_path(phases.part(chosen, mask[:, None]))
        for name, values in vars(solved).items():
            collected = parts.setdefault(
                name, np.empty((*values.shape[:-1], len(places)), values.dtype)
            )
            collected[..., members] = values
    return Path(**parts)


def _best_path(phases: _Phases) -> Path:
    """Return the path of least chi-square; phases of infinite error are ignored."""
    phase, modulation_frequency = phases.phase, phases.modulation_frequency
    shortest, longest = phases.shortest, phases.longest
    wavelength = speed_of_light / modulation_frequency
    cycle = wavelength.reshape(-1, *[1] * (phase.ndim - 1))
    sigma = np.maximum(phases.uncertainty, _SMALLEST_PHASE_ERROR) * cycle / (2 * np.pi)
    measured = np.mod(phase, 2 * np.pi) * cycle / (2 * np.pi)
    precision = sigma**-2
    measured_anywhere = np.isfinite(sigma).reshape(len(sigma), -1).any(axis=1)
    best = next((k for k in phases.order if measured_anywhere[k]), phases.order[0])
    step = wavelength[best]
    span = float(np.nanmax(longest - shortest)) / step
    if span > _MOST_CANDIDATES:
        raise ValueError(
            f"the interval holds {span:.3g} ambiguity intervals of "
            f"{modulation_frequency[best] / 1e6:g} MHz; narrow it"
        )
    # Of the best frequency, which was measured a little before or after the others.
    own = (
        sigma[best]
        if phases.motion is None
        else np.hypot(sigma[best], phases.motion[best])
    )
    slack = np.minimum(_SLACK * own, step / 2)
    nearest = shortest - slack + np.mod(measured[best] - shortest + slack, step)
    rated = ReadingWeights.of(precision, phases.motion)
    length = np.full(nearest.shape, np.nan)
    lowest = np.full(nearest.shape, np.inf)
    second = np.full(nearest.shape, np.inf)
    strain = np.full(nearest.shape, np.inf)
    # Likelihoods of all candidates over that of the best one so far.
    total = np.zeros(nearest.shape)
    excused = ReadingWeights.of(
        1 / (sigma**2 + (phases.doubt * cycle / (2 * np.pi)) ** 2), phases.motion
    )
    for count in range(int(np.ceil(span + 1)) + 1):
        candidate = nearest + count * step
        turns = np.round((candidate - measured) / cycle)
        unwrapped = measured + turns * cycle
        refined = np.sum(rated.weight * unwrapped, axis=0)
        error = unwrapped - refined
        misfit = rated.square(error)
        misfit = np.where(candidate <= longest + slack, misfit, np.inf)
        better = misfit < lowest
        with np.errstate(invalid="ignore"):
            ratio = np.exp(-np.abs(misfit - lowest) / 2)
        ratio = np.where(np.isfinite(misfit) & np.isfinite(lowest), ratio, 0.0)
        total = np.where(better, 1 + ratio * total, total + ratio)
        second = np.where(better, lowest, np.minimum(second, misfit))
        length = np.where(better, refined, length)
        strain = np.where(better, excused.square(error), strain)
        lowest = np.where(better, misfit, lowest)
    turns = np.round((length - measured) / cycle)
    residual = rated.without_rate(measured + turns * cycle - length)
    residual = np.where(precision > 0, residual, 0.0)
    freedom = (precision > 0).sum(axis=0) - 1
    with np.errstate(invalid="ignore"):
        settled = np.isfinite(lowest) & (second - lowest > MARGIN)
        settled &= (freedom == 0) | (strain < _chi_square_limits(len(phase))[freedom])
        outside = np.minimum(_OUTSIDE * own, step / 2)
        settled &= (length >= shortest - outside) & (length <= longest + outside)
    return Path(
        length=length,
        uncertainty=rated.information**-0.5,
        weight=rated.weight,
        settled=settled,
        wrong=np.where(total > 0, 1 - 1 / np.maximum(total, 1.0), 1.0),
        residual=residual,
        strain=strain,
        left_out=precision == 0,
    )


def _chi_square_limits(count: int) -> Floats:
    """Return the largest acceptable chi-square for 0, 1, 2, ... degrees of freedom."""
    from scipy.special import chdtri

    return np.asarray(chdtri(np.arange(count), DISAGREEMENT), dtype=float)
