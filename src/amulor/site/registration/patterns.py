r"""Tests for systematic range errors over rows, columns, range and incidence angle.

A pose absorbs most of a drift, and the misfit hardly grows. So each pattern is tested
as one unknown more, with poses and shared errors free to absorb it (data snooping,
W. Baarda, A testing procedure for use in geodetic networks, 1968). With the normal
equations :math:`A`, the gradient :math:`g` and the row :math:`l = (-A_{jb}
A_{bb}^{-1}, 1)` of a pattern j the sum :math:`l g` has the mean zero without it, and
its variance is that of pixels, start poses and shared errors.

An error of the minimal detectable size changes the unknowns by :math:`A_{bb}^{-1}
A_{bj}` times that size (external reliability). No test may show it. So the largest such
change of each pose is stated beside its covariance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.special import expit, logit
from scipy.stats import norm

from amulor.site.registration.network import (
    Layout,
    State,
    System,
    Ties,
    drift_effect,
    pair_unknowns,
    projector,
    system_of,
)
from amulor.site.registration.pair import Pair
from amulor.site.registration.reliability import non_centrality
from amulor.site.registration.surface import ScanSurface

Floats = NDArray[np.float64]

#: Patterns of a scan, in the order of their test, with words for a message.
PATTERNS = {
    "constant": "by one amount",
    "rows": "from the first row to the last",
    "rows, bent": "over the rows, most in the middle",
    "columns": "from the first column to the last",
    "columns, bent": "over the columns, most in the middle",
    "range": "with the range",
    "angle": "with the angle of incidence",
}
#: Smallest window of the mean range, in pixels [1].
_WINDOW = 15
#: Chance of a false alarm in a site [1].
_CHANCE = 1e-3
#: Probability of each error before its test, and the standard deviation of its size
#: over the standard uncertainty of the test [1].
_PRIOR, _PRIOR_SIZE = 0.01, 5.0
#: Change of poses that start poses, stated errors and targets exclude, in their
#: standard errors [1].
_EXCLUDED = 3.0
#: Least score of a pattern that is named beside the strongest one, over its score [1].
_ALIKE = 0.85
#: Least part of excluded points and least misfit, over that of other pairs, in each
#: pair of a scan that fits none [1]; sites without an error of a scan have 0 and 1.
_MOVED, _MISFIT = 0.1, 1.2
#: Least misfit over that of other pairs in each pair of a scan at a wrong pose [1].
_WILD = 10.0
#: Minimal detectable size over the standard uncertainty: power 80 %, chance 1e-4 [1].
_POWERFUL = non_centrality(1e-4)


@dataclass(frozen=True, kw_only=True)
class PatternTest:
    """Test of one scan for one kind of systematic range error."""

    scan: str
    """Name of the scan."""
    pattern: str
    """Key of `PATTERNS`."""
    size: float
    """Estimated half of the difference of both ends of the pattern [m]."""
    uncertainty: float
    """Standard uncertainty of the size [m]."""
    detectable: float
    """Minimal detectable size: 80 % power, chance 1e-4 of a false alarm [m]."""
    score: float
    """Size over its standard uncertainty [1]."""


@dataclass(frozen=True, kw_only=True)
class Undetected:
    """Largest change of a pose by a systematic range error of the detectable size."""

    shift: float
    """Largest change of the position [m]."""
    turn: float
    """Largest change of the attitude [rad]."""
    scan: str
    """Scan of the error that changes the position most."""
    pattern: str
    """Key of `PATTERNS` of that error."""


def pattern_values(surface: ScanSurface) -> Floats:
    """Shapes of all tested range errors, -1 to 1, (pattern, row, column) [1]."""
    shape = surface.distance.shape
    row, column = np.meshgrid(
        *(np.linspace(-1, 1, size) for size in shape), indexing="ij"
    )
    if surface.motion is not None:
        row = np.nan_to_num(2 * surface.motion.course - 1)
    facing = np.abs(np.einsum("ijk,ijk->ij", surface.normal, surface.direction))
    values = [
        np.ones(shape),
        row,
        1 - 2 * row**2,
        column,
        1 - 2 * column**2,
        _scaled(_mean_around(surface.distance, surface.smooth), surface.smooth),
        _scaled(1 / np.maximum(facing, 0.1), surface.smooth),
    ]
    return np.array(values)


def _mean_around(values: Floats, at: NDArray[np.bool_]) -> Floats:
    """Means of values over wide windows that average out the noise of single pixels.

    A pattern that contained the noise of the ranges would correlate with the distances.
    """
    size = max(_WINDOW, min(values.shape) // 4)
    total, count = (
        ndimage.uniform_filter(part, size, mode="constant")
        for part in (np.where(at, values, 0.0), at.astype(float))
    )
    return np.asarray(total / np.maximum(count, 1e-9))


def _scaled(values: Floats, at: NDArray[np.bool_]) -> Floats:
    """Values scaled to the interval -1 to 1 over selected pixels, 0 elsewhere."""
    low, high = float(values[at].min()), float(values[at].max())
    if high - low < 1e-9:
        return np.zeros(values.shape)
    return np.where(at, 2 * (values - low) / (high - low) - 1, 0.0)


def pattern_tests(
    state: State,
    pairs: Sequence[Pair],
    ties: Ties,
    trust: Sequence[float],
    surfaces: Mapping[str, ScanSurface],
    *,
    free: int,
) -> tuple[tuple[PatternTest, ...], dict[str, Undetected], Floats]:
    """Return range-error tests, undetected pose changes, and suspected covariance.

    The second value is the largest change of each pose by an undetected error, the
    third is the covariance of all unknowns by suspected errors.
    """
    layout = Layout(state, ties.fixed)
    projection, _ = projector(state, pairs, trust, layout, free)
    base = system_of(state, pairs, ties, trust, layout, projection, surfaces=surfaces)
    inverse = np.asarray(np.linalg.inv(base.matrix), dtype=float)
    compared = []
    for pair, weight in zip(pairs, trust, strict=True):
        at, spread = pair_unknowns(pair, state, layout)
        # Rows of the projector for the unknowns of the pair; fixed ones have none.
        reached = spread[:, at >= 0] @ projection[at[at >= 0]]
        compared.append(_Compared(pair, reached, weight * pair.weight))
    sums = {
        name: _sums_of(name, surface, compared, inverse, base)
        for name, surface in surfaces.items()
        if any(name in (pair.source, pair.target) for pair in pairs)
    }
    for name, surface in surfaces.items():
        _add_noise(name, surface, compared, sums)
    tests: list[PatternTest] = []
    changes: list[Floats] = []
    for name, of_scan in sums.items():
        tests_of_scan, changes_of_scan = _tests_of(name, of_scan, inverse)
        tests += tests_of_scan
        changes += changes_of_scan
    return (
        tuple(tests),
        _undetected(state, layout, tests, changes),
        _suspected(tests, changes, base.scatter),
    )


def _suspected(
    tests: Sequence[PatternTest], changes: Sequence[Floats], known: Floats
) -> Floats:
    """Return the covariance of all unknowns due to suspected errors, of any scan.

    The strongest test may be a consequence of an error of another scan. `known` is the
    information of start poses, stated errors and targets. They exclude an error that
    would move the poses by more than three standard errors away from them.
    """
    spread = np.zeros(known.shape)
    for test, change in zip(tests, changes, strict=True):
        step = change * test.uncertainty / test.detectable
        limit = _EXCLUDED / np.sqrt(max(float(step @ known @ step), 1e-300))
        spread += mean_square(test.score, limit) * np.outer(step, step)
    return spread


def mean_square(score: float, limit: float = np.inf) -> float:
    r"""Return the mean square of an error of a scan after its test [1].

    Its unit is the variance of the test. Before the test, the error exists with the
    probability p, and has the variance :math:`t^2`. With :math:`k = t^2 / (1 + t^2)`, a
    score z changes the odds of the error by :math:`\sqrt{1 - k} \exp(k z^2 / 2)`. The
    mean square is :math:`k^2 z^2 + k`, at most the square of `limit`, times the new
    probability.
    """
    shrunk = _PRIOR_SIZE**2 / (1 + _PRIOR_SIZE**2)
    odds = logit(_PRIOR) + np.log1p(-shrunk) / 2 + shrunk * score**2 / 2
    return float(expit(odds) * min(shrunk**2 * score**2 + shrunk, limit**2))


def _undetected(
    state: State,
    layout: Layout,
    tests: Sequence[PatternTest],
    changes: Sequence[Floats],
) -> dict[str, Undetected]:
    """Largest change of each pose by one error of the minimal detectable size."""
    largest = {}
    for name in state.poses if tests else ():
        at = layout.columns("pose", [name], 6)
        by_pattern = np.where(at >= 0, np.array(changes)[:, at], 0.0)
        shift, turn = (
            np.linalg.norm(by_pattern[:, part], axis=1)
            for part in (slice(3), slice(3, 6))
        )
        worst = int(np.argmax(shift))
        largest[name] = Undetected(
            shift=float(shift[worst]), turn=float(turn.max()),
            scan=tests[worst].scan, pattern=tests[worst].pattern,
        )  # fmt: skip
    return largest


@dataclass(frozen=True)
class _Compared:
    """Compared pair of scans, with its part of the normal equations."""

    pair: Pair
    reached: Floats
    weight: Floats


@dataclass
class _Sums:
    """Sums of one scan's range errors over all pairs, one row for each pattern."""

    combined: Floats
    effect: Floats
    squares: Floats
    back: Floats
    total: Floats
    variance: Floats
    factors: dict[tuple[str, str], Floats]


def _sums_of(
    name: str,
    surface: ScanSurface,
    compared: Sequence[_Compared],
    inverse: Floats,
    base: System,
) -> _Sums:
    """Sum the range errors of one scan over its pairs, without noise of pixels."""
    shapes = pattern_values(surface).reshape(len(PATTERNS), -1)
    count, size = len(shapes), len(base.gradient)
    crossed, squares = np.zeros((count, size)), np.zeros((count, count))
    back, sums = np.zeros((size, count)), np.zeros(count)
    factors = {}
    for item in compared:
        pair = item.pair
        if name not in (pair.source, pair.target):
            continue
        # Factors are independent of the noise of the distances, as in `pair`. With
        # factors at the point itself, the rows of a plane seem to drift by 1 mm.
        columns = _derivatives(
            name, shapes, pair, item.weight, pair.along, pair.target_pixel
        )
        apart = _derivatives(
            name, shapes, pair, item.weight, pair.along_apart, pair.target_pixel_apart
        )
        factors[pair.source, pair.target] = apart
        weighted = apart * item.weight[:, None]
        crossed += weighted.T @ pair.by_target @ item.reached
        squares += weighted.T @ columns
        back += ((columns * item.weight[:, None]).T @ pair.by_source @ item.reached).T
        sums += weighted.T @ pair.distance
    absorbed = -crossed @ inverse
    back = base.combined @ back
    return _Sums(
        effect=np.diag(squares + absorbed @ back),
        squares=np.diag(squares),
        combined=absorbed @ base.combined,
        back=back,
        total=sums + absorbed @ base.gradient,
        variance=np.einsum("ij,jk,ik->i", absorbed, base.scatter, absorbed),
        factors=factors,
    )


def _add_noise(
    owner: str,
    surface: ScanSurface,
    compared: Sequence[_Compared],
    sums: Mapping[str, _Sums],
) -> None:
    """Add noise of one scan's pixels, and its drifts, to the variances of all tests."""
    shape = (surface.own.size, len(PATTERNS))
    of_pixel = {name: np.zeros(shape) for name in sums}
    of_drift: Floats = np.zeros((1, len(sums) * len(PATTERNS)))
    for item in compared:
        pair = item.pair
        if owner not in (pair.source, pair.target):
            continue
        back = None if owner == pair.source else pair.window.T.tocsr()
        by_test = []
        for of_scan in sums.values():
            rows = pair.by_source @ (item.reached @ of_scan.combined.T)
            rows += of_scan.factors.get((pair.source, pair.target), 0.0)
            by_test.append(rows * item.weight[:, None])
        if surface.motion is not None:
            of_drift = of_drift + drift_effect(
                owner, surface.motion, pair, np.hstack(by_test)
            )
        for name, rows in zip(sums, by_test, strict=True):
            noisy = pair.misfit * rows
            if back is None:
                of_pixel[name][pair.source_pixel] += noisy * pair.along[:, None]
            else:
                of_pixel[name] += back @ noisy
    noise = np.nan_to_num(surface.own.ravel())
    drifts = (of_drift**2).sum(axis=0).reshape(len(sums), len(PATTERNS))
    for (name, values), drift in zip(of_pixel.items(), drifts, strict=True):
        sums[name].variance += ((values * noise[:, None]) ** 2).sum(axis=0) + drift


def _tests_of(
    name: str, sums: _Sums, inverse: Floats
) -> tuple[list[PatternTest], list[Floats]]:
    """Test one scan for systematic range errors; return also undetected changes."""
    tests, changes = [], []
    bias = inverse @ sums.back
    for number, pattern in enumerate(PATTERNS):
        # Patterns that poses absorb completely cannot be tested.
        if not sums.effect[number] > 1e-6 * sums.squares[number] > 0:
            continue
        sigma = float(np.sqrt(sums.variance[number]))
        score = -float(sums.total[number]) / sigma
        spread = sigma / float(sums.effect[number])
        tests.append(
            PatternTest(
                scan=name, pattern=pattern, score=score, uncertainty=spread,
                size=score * spread, detectable=_POWERFUL * spread,
            )
        )  # fmt: skip
        changes.append(_POWERFUL * spread * bias[:, number])
    return tests, changes


def _derivatives(
    name: str,
    shapes: Floats,
    pair: Pair,
    weight: Floats,
    along: Floats,
    target_pixel: NDArray[np.intp],
) -> Floats:
    """Return the derivatives of distances with respect to a scan's range errors."""
    columns = np.zeros((len(pair.distance), len(shapes)))
    if name == pair.source:
        columns = -shapes[:, pair.source_pixel].T * along[:, None]
    elif name == pair.target:
        columns = shapes[:, target_pixel].T
    return np.where(weight[:, None] > 0, columns, 0.0)


def contradicted(tests: Sequence[PatternTest]) -> PatternTest | None:
    """Return the test with the most significant range error; None if insignificant.

    Other significant errors are mostly its consequences, because the fit of the poses
    transfers it to the neighbors of a scan.
    """
    if not tests:
        return None
    strongest = max(tests, key=lambda test: abs(test.score))
    limit = float(norm.isf(_CHANCE / 2 / len(tests)))
    return strongest if abs(strongest.score) > limit else None


def patterns_alike(
    tests: Sequence[PatternTest], strongest: PatternTest
) -> tuple[str, ...]:
    """Return further patterns of a scan that explain its ranges nearly as well."""
    return tuple(
        test.pattern
        for test in tests
        if test.scan == strongest.scan
        and test.pattern != strongest.pattern
        and abs(test.score) > _ALIKE * abs(strongest.score)
    )


def unfit_scan(pairs: Sequence[Pair], scans: Sequence[str]) -> tuple[str, float] | None:
    """Return the worst scan that fits no other, and its misfit; None if there is none.

    A bent scan has a large misfit and excluded points in each of its pairs. A moved
    body leaves the misfit of all other points at 1, and an understated noise excludes
    no points. A misfit that no noise explains is that of a wrong pose. Of two such
    scans the later is returned.
    """
    worst = None
    for name in scans:
        mine = [pair for pair in pairs if name in (pair.source, pair.target)]
        others = [
            pair.misfit for pair in pairs if name not in (pair.source, pair.target)
        ]
        if not mine:
            continue
        misfit = min(pair.misfit for pair in mine)
        ratio = misfit / float(np.median(others or [1.0]))
        apart = all(
            len(pair.moved) > _MOVED * (len(pair.moved) + pair.used) for pair in mine
        )
        bent = len(mine) > 1 and others and apart and ratio > _MISFIT
        if (bent or ratio > _WILD) and (worst is None or misfit >= worst[1]):
            worst = (name, misfit)
    return worst
