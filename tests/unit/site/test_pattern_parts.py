"""Parts of the tests for systematic range errors, against sums on paper."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import sparse
from scipy.stats import norm

from amulor.site.registration import patterns
from amulor.site.registration.network import Layout, State, System
from amulor.site.registration.patterns import (
    PATTERNS,
    PatternTest,
    Undetected,
    contradicted,
    mean_square,
    pattern_values,
)
from amulor.site.registration.pose import ScanPose

NAMES = list(PATTERNS)
COUNT = len(PATTERNS)
#: 80 % power and a chance of 1e-4: quantiles of 5e-5 and of 20 %.
POWERFUL = norm.isf(5e-5) + norm.isf(0.2)


def _test(scan: str, pattern: str, score: float) -> PatternTest:
    return PatternTest(
        scan=scan, pattern=pattern, size=1e-3 * score, uncertainty=1e-3,
        detectable=4e-3, score=score,
    )  # fmt: skip


def test_values_are_scaled_over_the_smooth_pixels() -> None:
    values = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 99.0]])
    at = values < 50
    expected = [[-1.0, -0.5, 0.0], [0.5, 1.0, 0.0]]
    assert_allclose(patterns._scaled(values, at), expected)
    assert_array_equal(patterns._scaled(np.full((2, 3), 7.0), at), np.zeros((2, 3)))
    tiny = 7.0 + 2e-9 * at
    assert_array_equal(patterns._scaled(tiny, at), np.zeros((2, 3)))
    small = 7.0 + 1e-8 * values
    assert_allclose(patterns._scaled(small, at), expected, atol=1e-6)


def test_the_mean_range_is_that_of_a_window_of_15_pixels_or_a_quarter() -> None:
    step = np.where(np.arange(40) < 20, 1.0, 2.0) * np.ones((30, 40))
    at = np.ones(step.shape, dtype=bool)
    mean = patterns._mean_around(step, at)
    # Seven pixels to either side.
    assert_allclose(
        mean[15, [12, 13, 20, 26, 27]], [1, 1 + 1 / 15, 1 + 8 / 15, 1 + 14 / 15, 2]
    )
    assert_allclose(mean[0, :13], 1.0)
    at[:, :20] = False
    assert_allclose(patterns._mean_around(step, at)[15, 13:], 2.0)
    assert_allclose(patterns._mean_around(step, at)[15, 12], 0.0)
    wide = np.where(np.arange(90) < 45, 1.0, 2.0) * np.ones((80, 90))
    mean = patterns._mean_around(wide, np.ones(wide.shape, dtype=bool))
    # 20 pixels, a quarter of the rows.
    assert_allclose(np.diff(mean[40])[35:55].sum(), 1.0)
    assert np.count_nonzero(np.diff(mean[40]) > 1e-9) == 20


def test_rows_of_a_moving_instrument_are_its_course() -> None:
    course = np.linspace(0.0, 1.0, 12).reshape(3, 4)
    course[0, 0] = np.nan
    surface: Any = SimpleNamespace(
        distance=np.ones((3, 4)), smooth=np.ones((3, 4), dtype=bool),
        normal=np.tile([0.0, 0.0, -1.0], (3, 4, 1)),
        direction=np.tile([0.0, 0.0, 1.0], (3, 4, 1)),
        motion=SimpleNamespace(course=course),
    )  # fmt: skip
    values = pattern_values(surface)
    row = 2 * course - 1
    row[0, 0] = 0.0
    assert_allclose(values[1], row)
    assert_allclose(values[2], 1 - 2 * row**2)


def _pair(source: str = "a", target: str = "b") -> Any:
    """Three compared points of scans with four pixels."""
    return SimpleNamespace(
        source=source, target=target,
        distance=np.array([1e-3, -2e-3, 3e-3]),
        along=np.array([0.5, 0.7, 0.9]), along_apart=np.array([0.4, 0.6, 0.8]),
        source_pixel=np.array([0, 2, 3]), target_pixel=np.array([1, 1, 2]),
        target_pixel_apart=np.array([1, 2, 3]), misfit=1.5,
        by_target=np.arange(9.0).reshape(3, 3) / 10,
        by_source=np.arange(9.0)[::-1].reshape(3, 3) / 7,
        window=sparse.csr_matrix(np.arange(12.0).reshape(3, 4) / 20),
    )  # fmt: skip


def test_derivatives_are_minus_along_for_the_source_and_one_for_the_target() -> None:
    shapes = np.arange(8.0).reshape(2, 4)
    pair, weight = _pair(), np.array([1.0, 0.0, 2.0])
    of_source = patterns._derivatives(
        "a", shapes, pair, weight, pair.along, pair.target_pixel
    )
    assert_allclose(of_source, [[0.0, -2.0], [0.0, 0.0], [-2.7, -6.3]])
    of_target = patterns._derivatives(
        "b", shapes, pair, weight, pair.along, pair.target_pixel
    )
    assert_allclose(of_target, [[1.0, 5.0], [0.0, 0.0], [2.0, 6.0]])
    other = patterns._derivatives(
        "c", shapes, pair, weight, pair.along, pair.target_pixel
    )
    assert_array_equal(other, np.zeros((3, 2)))


def _surface(rows: int = 2, columns: int = 2) -> Any:
    """Surface of four pixels with ranges and angles that differ."""
    facing = np.array([[1.0, 0.8], [0.6, 0.5]])
    normal = np.stack([np.sqrt(1 - facing**2), 0 * facing, -facing], axis=-1)
    return SimpleNamespace(
        distance=np.array([[1.0, 1.2], [1.5, 2.0]]), normal=normal,
        direction=np.tile([0.0, 0.0, 1.0], (rows, columns, 1)),
        smooth=np.ones((rows, columns), dtype=bool), motion=None,
        own=np.array([[1e-3, 2e-3], [3e-3, np.nan]]),
    )  # fmt: skip


def _base() -> System:
    rng = np.random.default_rng(6)
    system = System(4)
    system.gradient = rng.normal(size=4)
    system.scatter = np.diag([0.1, 0.2, 0.3, 0.4])
    system.combined = np.eye(4) + 0.1 * rng.normal(size=(4, 4))
    return system


def test_sums_of_a_scan_let_poses_absorb_its_patterns() -> None:
    rng = np.random.default_rng(7)
    inverse, base = rng.normal(size=(4, 4)), _base()
    weight = np.array([2.0, 0.0, 3.0])
    reached = rng.normal(size=(3, 4))
    compared = [
        patterns._Compared(_pair(), reached, weight),
        patterns._Compared(_pair("c", "b"), reached, weight),
        patterns._Compared(_pair("c", "a"), 2 * reached, weight),
    ]
    sums = patterns._sums_of("a", _surface(), compared, inverse, base)
    shapes = pattern_values(_surface()).reshape(COUNT, 4)
    crossed, back = np.zeros((COUNT, 4)), np.zeros((4, COUNT))
    squares, total = np.zeros((COUNT, COUNT)), np.zeros(COUNT)
    for pair, share, sign in ((_pair(), 1, -1), (_pair("c", "a"), 2, 1)):
        if sign < 0:
            near = -shapes[:, pair.source_pixel] * pair.along
            apart = -shapes[:, pair.source_pixel] * pair.along_apart
        else:
            near = shapes[:, pair.target_pixel]
            apart = shapes[:, pair.target_pixel_apart]
        heavy = np.diag(weight)
        crossed += apart @ heavy @ pair.by_target @ (share * reached)
        back += (near @ heavy @ pair.by_source @ (share * reached)).T
        squares += apart @ heavy @ near.T
        total += apart @ heavy @ pair.distance
        key = pair.source, pair.target
        assert_allclose(sums.factors[key], (apart * (weight > 0)).T)
    assert set(sums.factors) == {("a", "b"), ("c", "a")}
    absorbed = -crossed @ inverse
    assert_allclose(sums.squares, np.diag(squares))
    assert_allclose(sums.back, base.combined @ back)
    assert_allclose(sums.effect, np.diag(squares + absorbed @ base.combined @ back))
    assert_allclose(sums.combined, absorbed @ base.combined)
    assert_allclose(sums.total, total + absorbed @ base.gradient)
    assert_allclose(sums.variance, np.diag(absorbed @ base.scatter @ absorbed.T))


def test_noise_of_pixels_reaches_tests_through_points_and_patches() -> None:
    rng = np.random.default_rng(8)
    reached, weight = rng.normal(size=(3, 4)), np.array([2.0, 0.0, 3.0])
    item = patterns._Compared(_pair(), reached, weight)
    combined = rng.normal(size=(COUNT, 4))
    factors = rng.normal(size=(3, COUNT))
    own = np.nan_to_num(_surface().own.ravel())

    def variance(owner: str, factors_of: dict[tuple[str, str], np.ndarray]) -> Any:
        sums = patterns._Sums(
            combined=combined, effect=np.ones(COUNT), squares=np.ones(COUNT),
            back=np.zeros((4, COUNT)), total=np.zeros(COUNT),
            variance=np.zeros(COUNT), factors=factors_of,
        )  # fmt: skip
        patterns._add_noise(owner, _surface(), [item], {"a": sums})
        return sums.variance

    pair = _pair()
    rows = pair.by_source @ reached @ combined.T + factors
    rows = 1.5 * weight[:, None] * rows
    effect = np.zeros((4, COUNT))
    effect[pair.source_pixel] = rows * pair.along[:, None]
    expected = ((effect * own[:, None]) ** 2).sum(axis=0)
    assert_allclose(variance("a", {("a", "b"): factors}), expected)
    through = pair.window.toarray().T @ rows
    expected = ((through * own[:, None]) ** 2).sum(axis=0)
    assert_allclose(variance("b", {("a", "b"): factors}), expected)
    assert_array_equal(variance("c", {("a", "b"): factors}), np.zeros(COUNT))
    plain = 1.5 * weight[:, None] * (pair.by_source @ reached @ combined.T)
    expected = (((pair.window.toarray().T @ plain) * own[:, None]) ** 2).sum(axis=0)
    assert_allclose(variance("b", {}), expected)


def test_a_test_is_the_sum_over_its_standard_error() -> None:
    effect = np.array([4.0, -1.0, 0.9e-6, 1.1e-6, 2.0, 5.0, 5.0])
    squares = np.array([4.0, 1.0, 1.0, 1.0, 0.0, -1.0, 8.0])
    rng = np.random.default_rng(9)
    back, inverse = rng.normal(size=(3, COUNT)), rng.normal(size=(3, 3))
    sums = patterns._Sums(
        combined=np.zeros((COUNT, 3)), effect=effect, squares=squares, back=back,
        total=np.array([6.0, 1, 1, 1e-6, 1, 1, -2.0]),
        variance=np.array([9.0, 1, 1, 1e-12, 1, 1, 4.0]), factors={},
    )  # fmt: skip
    tests, changes = patterns._tests_of("a", sums, inverse)
    assert [(test.scan, test.pattern) for test in tests] == [
        ("a", NAMES[0]), ("a", NAMES[3]), ("a", NAMES[6]),
    ]  # fmt: skip
    first, _, last = tests
    assert first.score == pytest.approx(-2.0)
    assert first.uncertainty == pytest.approx(0.75)
    assert first.size == pytest.approx(-1.5)
    assert first.detectable == pytest.approx(POWERFUL * 0.75)
    assert last.score == pytest.approx(1.0)
    assert last.uncertainty == pytest.approx(0.4)
    assert_allclose(changes[0], POWERFUL * 0.75 * inverse @ back[:, 0])
    assert_allclose(changes[2], POWERFUL * 0.4 * inverse @ back[:, 6])


def test_undetected_errors_state_the_largest_change_of_each_pose() -> None:
    poses = {name: ScanPose(np.eye(3), np.zeros(3)) for name in "abc"}
    state = State(poses, {}, {"delay": 0.0})
    layout = Layout(state, "a")
    changes = np.zeros((3, layout.size))
    b, c = layout.at["pose", "b"].start, layout.at["pose", "c"].start
    changes[0, b : b + 3], changes[0, b + 3 : b + 6] = [3.0, 4.0, 0.0], [0.0, 0.0, 0.1]
    changes[1, b : b + 3], changes[1, b + 3 : b + 6] = [0.0, 4.9, 0.0], [0.3, 0.4, 0.0]
    changes[2, c : c + 3] = [0.0, 0.0, -2.0]
    tests = [
        _test("a", "rows", 1.0),
        _test("b", "angle", 2.0),
        _test("c", "range", 3.0),
    ]
    found = patterns._undetected(state, layout, tests, list(changes))
    assert found == {
        "a": Undetected(shift=0.0, turn=0.0, scan="a", pattern="rows"),
        "b": Undetected(
            shift=pytest.approx(5.0), turn=pytest.approx(0.5), scan="a", pattern="rows"
        ),
        "c": Undetected(shift=2.0, turn=0.0, scan="c", pattern="range"),
    }
    assert patterns._undetected(state, layout, [], []) == {}


@pytest.mark.parametrize("count", [1, 7, 40])
def test_an_error_is_contradicted_by_one_in_a_thousand_sites(count: int) -> None:
    limit = norm.isf(5e-4 / count)
    quiet = [_test("a", "rows", 0.1)] * (count - 1)
    for sign in (1, -1):
        above = _test("b", "angle", sign * (limit + 1e-6))
        assert contradicted([*quiet, above]) is above
        assert (
            contradicted([*quiet, _test("b", "angle", sign * (limit - 1e-6))]) is None
        )
    assert contradicted([]) is None


def test_suspected_errors_of_all_scans_add() -> None:
    tests = [
        _test("a", "rows", 3.0),
        replace(_test("b", "angle", 5.0), detectable=8e-3),
    ]
    changes = [np.array([0.008, 0.0]), np.array([0.0, 0.016])]
    spread = patterns._suspected(tests, changes, np.zeros((2, 2)))
    # A quarter and an eighth of the changes by errors of the detectable size.
    expected = np.diag([mean_square(3.0) * 0.002**2, mean_square(5.0) * 0.002**2])
    assert_allclose(spread, expected)
    together = [np.array([0.008, 0.008])]
    spread = patterns._suspected(tests[:1], together, np.zeros((2, 2)))
    assert_allclose(spread, mean_square(3.0) * 0.002**2 * np.ones((2, 2)))
