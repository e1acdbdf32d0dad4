"""Scatter between pixels, detection and outliers: likelihoods written out, limits."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from amulor.rejection.covariance import Covariance
from amulor.rejection.joint import scatter
from amulor.rejection.joint.samples import Pixels
from amulor.rejection.joint.scatter import (
    are_inliers,
    disagrees,
    is_detected,
    outlier_candidates,
    part_of,
    scatter_of,
    typical_misfit,
)
from amulor.rejection.joint.search import Estimates


def pixels_of(variance: np.ndarray, cross: np.ndarray, usable: np.ndarray) -> Pixels:
    """Return samples with errors; nothing else of them is read."""
    count = len(usable)
    nothing = np.zeros(count)
    return Pixels(
        signal=np.zeros(usable.shape, dtype=complex),
        covariance=Covariance(variance[0], variance[1], cross),
        usable=usable,
        interpolation=np.ones((count, 1)),
        offset=nothing,
        shortest=nothing,
        longest=nothing + 9,
        depths=np.zeros((count, 3)),
        trends=np.zeros((count, 0)),
    )


def residuals(
    seed: int,
    count: int,
    *,
    parameters: int = 2,
    neighbors: bool = True,
    scale: float = 1.0,
    fluctuation: float = 0.0,
    lost: float = 0.1,
) -> Any:
    """Return residuals of noise and of a fluctuation of the water signal."""
    rng = np.random.default_rng(seed)
    shape = count, 2, 3
    variance = rng.uniform(1, 2, (2, *shape))
    cross = 0.6 * np.sqrt(variance.prod(axis=0))
    usable = rng.random(shape) > lost
    water = rng.uniform(5, 30, shape) * np.exp(2j * np.pi * rng.random(shape))
    draws = rng.standard_normal((3, *shape))
    first = np.sqrt(variance[0]) * draws[0]
    second = cross / np.sqrt(variance[0]) * draws[0]
    second = second + np.sqrt(variance[1] - cross**2 / variance[0]) * draws[1]
    noise = scale * (first + 1j * second) + fluctuation * draws[2] * water
    slopes = rng.standard_normal((2, *shape, parameters))
    return scatter._Residuals(
        pixels=pixels_of(variance, cross, usable),
        residual=np.where(usable, noise, 0.0),
        water_signal=water,
        derivatives=slopes[0] + 1j * slopes[1],
        freedom=2 * int(usable.sum()) - parameters * count,
        neighbors=neighbors,
    )


def by_dense_algebra(part: Any, ratio: float) -> tuple[np.ndarray, float, np.ndarray]:
    """Return whitened residuals without parameters, log determinants, and usable."""
    errors, water = part.pixels.covariance, ratio * part.water_signal
    rows, volume, used = [], 0.0, []
    for n in range(len(part.residual)):
        whitened, columns, use = [], [], []
        for c, f in np.ndindex(part.residual.shape[1:]):
            if not part.pixels.usable[n, c, f]:
                whitened += [0.0, 0.0]
                columns += [np.zeros(part.derivatives.shape[-1])] * 2
                use += [False, False]
                continue
            xx, yy, xy = (v[n, c, f] for v in vars(errors).values())
            move = np.array([water[n, c, f].real, water[n, c, f].imag])
            square = np.array([[xx, xy], [xy, yy]]) + np.outer(move, move)
            # The transposed factor of the inverse leaves the second output alone.
            root = np.linalg.cholesky(np.linalg.inv(square)).T
            rest, slope = part.residual[n, c, f], part.derivatives[n, c, f]
            whitened += [*(root @ [rest.real, rest.imag])]
            columns += [*(root @ np.stack([slope.real, slope.imag]))]
            use += [True, True]
            volume += np.log(np.linalg.det(square))
        jacobian, values = np.array(columns), np.array(whitened)
        if jacobian.shape[1]:
            volume += np.log(np.linalg.det(jacobian.T @ jacobian))
            values = values - jacobian @ np.linalg.lstsq(jacobian, values)[0]
        rows.append(values)
        used.append(use)
    return np.array(rows), volume, np.array(used)


@pytest.mark.parametrize(
    ("count", "neighbors", "pairs"),
    [(11, True, False), (12, True, True), (12, False, False)],
)
@pytest.mark.parametrize("parameters", [0, 2])
@pytest.mark.parametrize("ratio", [0.0, 0.07])
def test_sums_of_squares_and_determinants_are_those_of_dense_algebra(
    count: int, neighbors: bool, pairs: bool, parameters: int, ratio: float
) -> None:
    part = residuals(count, count, parameters=parameters, neighbors=neighbors)
    square, freedom, volume = part.sums(ratio)
    rows, expected, used = by_dense_algebra(part, ratio)
    assert volume == pytest.approx(expected, rel=1e-6)
    assert freedom == 2 * part.pixels.usable.sum() - parameters * count
    if not pairs:
        assert square == pytest.approx(np.sum(rows**2), rel=1e-6)
        return
    # Half the squares of differences, for as many pairs as there are samples.
    both = used[1:] & used[:-1]
    half = 0.5 * np.sum(np.where(both, np.diff(rows, axis=0), 0.0) ** 2)
    assert square == pytest.approx(half * used.sum() / both.sum(), rel=1e-6)


def found_in(monkeypatch: pytest.MonkeyPatch, parts: list[Any]) -> scatter.Scatter:
    """Return the scatter of residuals that are given."""
    waiting = iter(parts)
    monkeypatch.setattr(scatter, "_residuals_of", lambda *_, **__: next(waiting))
    nothing: Any = None
    return scatter_of(nothing, parts, transfer=nothing, phase_per_path=nothing)


@pytest.mark.parametrize("scale", [1.0, 1.5])
@pytest.mark.parametrize("fluctuation", [0.0, 0.06, 0.2])
def test_noise_and_fluctuation_come_back(
    monkeypatch: pytest.MonkeyPatch, scale: float, fluctuation: float
) -> None:
    parts = [
        residuals(seed, 150, scale=scale, fluctuation=fluctuation, parameters=seed)
        for seed in (0, 2)
    ]
    found = found_in(monkeypatch, parts)
    # 3,200 outputs, whose differences are correlated: standard errors of 1.5 %.
    assert found.noise_scale == pytest.approx(scale, rel=0.06 if scale > 1 else 1e-12)
    assert found.fluctuation == pytest.approx(fluctuation, rel=0.1, abs=1e-12)

    def cost(logarithm: float) -> float:
        sums = np.sum([part.sums(np.exp(logarithm)) for part in parts], axis=0)
        square = max(sums[0] / sums[1], 1.0)
        return float(sums[1] * np.log(square) + sums[0] / square + sums[2])

    if fluctuation:
        near = np.log(fluctuation / scale)
        best = minimize_scalar(cost, (near - 0.3, near, near + 0.3), tol=1e-6)
        # Seven steps of the golden section of a bracket of 1.4 are 0.05.
        ratio = found.fluctuation / found.noise_scale
        assert np.log(ratio) == pytest.approx(best.x, abs=0.05)


def test_a_fluctuation_that_is_larger_than_the_signal_is_all_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    parts = [residuals(3, 100, scale=3.0, fluctuation=3.0, parameters=0)]
    assert found_in(monkeypatch, parts).fluctuation == 1.0


@pytest.mark.parametrize(("gain", "significant"), [(8.9, False), (9.1, True)])
def test_a_fluctuation_needs_nine_in_twice_the_logarithm_of_the_likelihood(
    monkeypatch: pytest.MonkeyPatch, gain: float, significant: bool
) -> None:
    def sums(ratio: float) -> tuple[float, float, float]:
        return 100.0, 100.0, 0.0 if ratio == 0 else -gain + abs(np.log(ratio / 0.02))

    found = found_in(monkeypatch, [SimpleNamespace(sums=sums, freedom=100)])
    assert found.noise_scale == 1.0
    assert (found.fluctuation > 0) == significant
    if significant:
        assert found.fluctuation == pytest.approx(0.02, rel=0.05)


@pytest.mark.parametrize(("beyond", "scale"), [(0.99, 1.0), (1.01, None)])
def test_noise_is_scaled_beyond_three_standard_errors(
    beyond: float, scale: float | None
) -> None:
    # Squares have the variance 2 / freedom; differences that share a pixel 3 / freedom.
    square = 1 + beyond * 3 * np.sqrt(3 / 400)
    parts: Any = [SimpleNamespace(freedom=100), SimpleNamespace(freedom=300)]
    found = scatter._significant_scale(square, parts)
    assert found == pytest.approx(np.sqrt(square) if scale is None else scale)
    # One output, or none, tells little.
    for freedom in (0, 1):
        few: Any = [SimpleNamespace(freedom=freedom)]
        limit = 1 + 3 * np.sqrt(3)
        assert scatter._significant_scale(0.999 * limit, few) == 1.0
        assert scatter._significant_scale(1.001 * limit, few) > 1.0


def test_pixels_of_similar_distances_follow_each_other() -> None:
    is_target = np.ones(100, dtype=bool)
    is_target[[3, 50, 51, 99]] = False
    order = np.random.default_rng(1).permutation(100)
    mixed = scatter._mixed(order, is_target)
    assert_array_equal(np.sort(mixed), np.arange(100))
    assert set(mixed[-4:]) == {3, 50, 51, 99}
    # 96 targets are four blocks of 24, each in another order.
    targets = order[is_target[order]]
    for block in range(4):
        part = slice(24 * block, 24 * block + 24)
        assert set(mixed[part]) == set(targets[part])
        assert (mixed[part] != targets[part]).any()
    few = scatter._mixed(order[:7], is_target)
    assert set(few) == set(order[:7])


def estimates(count: int, **changed: Any) -> Estimates:
    """Return estimates of one channel and eight outputs."""
    values: dict[str, Any] = {
        name: np.zeros(count) for name in Estimates.__dataclass_fields__
    }
    values |= {
        "path": np.full(count, 5.0),
        "amplitude": np.ones((count, 1)),
        "explained": np.full(count, 100.0),
        "used": np.full(count, 8),
        "which": np.zeros(count, dtype=int),
        "influence": np.zeros((count, 1, 4), dtype=complex),
    }
    return Estimates(**values | changed)


def test_a_target_explains_25_of_chi_square_by_a_positive_echo() -> None:
    found = estimates(
        5,
        explained=np.array([25.0, 24.999, 30.0, 30.0, 30.0]),
        path=np.array([1.0, 1.0, np.inf, 1.0, np.nan]),
        amplitude=np.array([[0.0, 0.1], [1, 1], [1, 1], [0.0, -1.0], [1.0, 1.0]]),
    )
    assert is_detected(found).tolist() == [True, False, False, False, False]


def test_outlying_pixels_are_one_in_a_million_beside_the_median() -> None:
    # 8 outputs less path and amplitude; without a target none less.
    usual, empty = float(chi2.median(6)), float(chi2.median(8))
    cost = np.full(9, 2 * usual)
    limit = 2 * float(chi2.isf(1e-6, 6))
    cost[:2] = 0.999 * limit, 1.001 * limit
    explained = np.full(9, 100.0)
    explained[2:4] = 0.0
    none = np.full(9, 2 * empty)
    none[2:4] = 2 * np.array([0.999, 1.001]) * float(chi2.isf(1e-6, 8))
    found = estimates(9, cost=cost, empty_cost=none, explained=explained)
    assert typical_misfit(found) == pytest.approx(2.0)
    assert are_inliers(found).tolist() == [True, False, True, False] + [True] * 5
    # A fit better than expected is no reason to be stricter.
    assert typical_misfit(estimates(3, cost=np.full(3, 0.1))) == 1.0
    assert typical_misfit(estimates(0)) == 1.0
    assert are_inliers(estimates(0)).shape == (0,)
    # Two outputs of a target leave one degree of freedom at least.
    few = estimates(1, used=np.array([2]), cost=np.array([5.0]))
    assert typical_misfit(few) == pytest.approx(5.0 / chi2.median(1))


@pytest.mark.parametrize("typical", [1.0, 3.0])
def test_a_sample_disagrees_by_a_chance_of_one_in_a_thousand(typical: float) -> None:
    # The largest of four chi-squares of two outputs: 4 exp(-x / 2) is the chance.
    limit = 2 * typical * np.log(4 / 1e-3)
    found = estimates(2, outlying=np.array([0.999, 1.001]) * limit)
    assert disagrees(found, typical).tolist() == [False, True]
    single = estimates(2, outlying=limit * np.ones(2), used=np.array([0, 2]))
    assert disagrees(single, typical).all()
    assert not disagrees(
        estimates(1, outlying=np.array([0.999 * 2 * np.log(1e3)]), used=np.array([0]))
    ).any()


def test_a_frequency_that_disagrees_in_many_pixels_is_no_outlier() -> None:
    def candidates(numbers: list[int], count: int) -> list[bool]:
        which = np.repeat(np.arange(len(numbers)), numbers)
        which = np.append(which, np.zeros(count - len(which), dtype=int))
        outlying = np.where(np.arange(count) < sum(numbers), 1e3, 0.0)
        found = estimates(count, which=which, outlying=outlying)
        return [bool(v) for v in outlier_candidates(found, (2, 3), 1.0).ravel()]

    # Three times the median of 2, and four standard errors, sqrt(3): 12.9.
    rare = [True] * 5
    assert candidates([12, 2, 2, 2, 2, 2], 1000) == [True, *rare]
    assert candidates([13, 2, 2, 2, 2, 2], 1000) == [False, *rare]
    # 15 % of the pixels, at least one.
    assert candidates([9, 2, 2, 2, 2, 2], 60) == [True, *rare]
    assert candidates([10, 2, 2, 2, 2, 2], 60) == [False, *rare]
    assert candidates([1, 0, 0, 0, 0, 0], 3) == [True, *rare]
    assert candidates([2, 0, 0, 0, 0, 0], 3) == [False, *rare]


def test_a_part_of_estimates_holds_all_of_some_pixels() -> None:
    found = estimates(4, cost=np.arange(4.0), path=10 + np.arange(4.0))
    part = part_of(found, np.array([2, 0]))
    assert part.cost.tolist() == [2, 0]
    assert part.path.tolist() == [12, 10]
    assert part.influence.shape == (2, 1, 4)


def test_outliers_are_removed_one_by_one_until_a_third_is_gone() -> None:
    variance = np.ones((2, 4, 1, 6))
    pixels = pixels_of(variance, 0 * variance[0], np.ones((4, 1, 6), dtype=bool))
    signal = np.arange(24.0).reshape(4, 1, 6) + 1j
    pixels.signal[...] = signal
    # Number of outliers that each pixel still has, and what the next one costs more.
    left = np.array([0, 1, 2, 9])
    margin = np.array([0.0, 8.9, 9.1, 9.1])

    def state(usable: np.ndarray, index: np.ndarray) -> Estimates:
        removed = (~usable).sum(axis=(1, 2))
        bad = removed < left[index]
        return estimates(
            len(index),
            used=np.full(len(index), 12),
            which=removed,
            outlying=np.where(bad, 100.0, 0.0),
            next_outlying=100.0 - margin[index],
            path=10.0 * index + removed,
        )

    index = np.arange(4)

    def again(part: Pixels) -> Estimates:
        places = part.signal.real.max(axis=(1, 2)).astype(int) // 6
        assert_array_equal(part.signal[~part.usable], 0)
        return state(part.usable, places)

    every = np.ones((1, 6), dtype=bool)
    whole = state(pixels.usable, index)
    found = scatter.without_outliers(pixels, whole, again, every, 1.0)
    # Of six samples two may go; the fourth pixel has more outliers than that.
    assert (~found.pixels.usable).sum(axis=(1, 2)).tolist() == [0, 1, 2, 2]
    assert not found.pixels.usable[2, 0, :2].any()
    assert found.estimates.path.tolist() == [0, 11, 22, 32]
    assert found.unsettled.tolist() == [False, True, False, True]
    assert_array_equal(found.pixels.signal[~found.pixels.usable], 0)
    assert pixels.usable.all()
    # Twice the usual misfit: an outlier costs more.
    strict = scatter.without_outliers(pixels, whole, again, every, 1.02)
    assert strict.unsettled.tolist() == [False, True, True, True]
    # A frequency that may not be left out ends the search.
    some = np.array([[True, False, True, True, True, True]])
    kept = scatter.without_outliers(pixels, whole, again, some, 1.0)
    assert (~kept.pixels.usable).sum(axis=(1, 2)).tolist() == [0, 1, 1, 1]
    none = scatter.without_outliers(pixels, whole, again, ~every, 1.0)
    assert none.pixels is pixels
    assert none.estimates is whole
    back = found.restored(pixels, whole, np.array([3]))
    assert back.pixels.usable[3].all()
    assert_array_equal(back.pixels.signal[3], signal[3])
    assert back.unsettled.tolist() == [False, True, False, False]
    assert back.estimates.path.tolist() == [0, 11, 22, 30]
    assert found.estimates.path[3] == 32
    assert found.restored(pixels, whole, np.array([], dtype=int)) is found
