"""Pixels that stand alone are flagged; edges, ropes and rough ground are not."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from exact_scenes import directions, image_of
from hypothesis import given, settings
from hypothesis import strategies as st

from amulor import cube as cubes
from amulor import imaging
from amulor.cube import QualityFlag
from amulor.imaging.outliers import _standing

Make = Callable[..., xr.Dataset]
#: Of the images of `written` [m].
SIGMA = 1e-3
SHAPE = (12, 20)


def _noise(seed: int) -> np.ndarray:
    return SIGMA * np.random.default_rng(seed).standard_normal(SHAPE)


@settings(max_examples=40)
@given(
    row=st.integers(0, SHAPE[0] - 1),
    column=st.integers(0, SHAPE[1] - 1),
    size=st.sampled_from([-60, -12, 12, 60]),
    lean=st.floats(-0.02, 0.02),
    common=st.floats(0, 0.1),
)
def test_a_spike_on_a_leaning_wall_is_found_wherever_it_is(
    written: Make, row: int, column: int, size: float, lean: float, common: float
) -> None:
    distance = 1.5 + lean * np.arange(SHAPE[1]) + _noise(3)
    clean = imaging.outlying_pixels(written(distance, common=common))
    assert not clean.any()
    distance[row, column] += size * SIGMA
    outlying = imaging.outlying_pixels(written(distance, common=common))
    corner = row in (0, SHAPE[0] - 1) or column in (0, SHAPE[1] - 1)
    # At the rim the line is continued, with five times the variance.
    if abs(size) > 20 or not corner:
        assert outlying[row, column]
    # Where one is found, the noise that is next in size may be called one as well.
    assert outlying.sum() <= 2


def test_the_rate_of_false_alarms_is_below_one_in_ten_thousand(written: Make) -> None:
    rng = np.random.default_rng(5)
    noisy = 1.5 + SIGMA * rng.standard_normal((400, 500))
    assert imaging.outlying_pixels(written(noisy)).mean() < 1e-4


@pytest.mark.parametrize(
    "surface",
    [
        np.where(np.arange(20) < 10, 1.5, 1.4) * np.ones((12, 1)),
        np.where(np.arange(20) == 10, 1.4, 1.5) * np.ones((12, 1)),
        np.where(np.eye(12, 20, 4), 1.4, 1.5),
        1.5 + 2e-3 * (np.arange(20) - 10.0) ** 2 * np.ones((12, 1)),
    ],
    ids=["step", "rope", "slanting rope", "bowl"],
)
def test_shapes_that_go_on_are_no_outliers(written: Make, surface: np.ndarray) -> None:
    assert not imaging.outlying_pixels(written(surface + _noise(7))).any()


def test_rough_ground_has_few(written: Make) -> None:
    rng = np.random.default_rng(11)
    gravel = 1.5 + 20 * SIGMA * rng.standard_normal((200, 200))
    assert imaging.outlying_pixels(written(gravel)).mean() < 0.01


def test_small_spikes_are_found_where_there_are_many(written: Make) -> None:
    rng = np.random.default_rng(9)
    clean = 1.5 + SIGMA * rng.standard_normal((60, 60))
    hit = rng.random(clean.shape) < 0.05
    off = SIGMA * rng.uniform(3, 6, clean.shape) * rng.choice([-1, 1], clean.shape)
    noise = (clean - 1.5) / SIGMA
    spoiled = clean + np.where(hit, off, 0)
    found = imaging.outlying_pixels(written(spoiled))
    # By the fixed limit of 3 in all four ways alone, it is 55 %; three errors above.
    large = hit & (np.abs(noise + off / SIGMA) > 3.5)
    assert found[large].mean() > 0.66
    # A tenth of what is flagged may be chance: twice that is beyond three errors.
    assert found[~hit].sum() < 0.2 * found.sum()
    # With the same noise and one spike, what the others do does not count.
    assert imaging.outlying_pixels(written(clean)).sum() <= 1


def test_small_spikes_are_found_side_by_side_and_at_the_rim(written: Make) -> None:
    rng = np.random.default_rng(10)
    distance = 1.5 + SIGMA * rng.standard_normal((60, 60))
    places = rng.choice(29 * 29, 60, replace=False)
    row, column = 2 * (places // 29) + 1, 2 * (places % 29) + 1
    distance[row, column] += 30 * SIGMA
    beside = (row[:12], column[:12] + 1)
    rim = (np.zeros(12, dtype=int), np.arange(2, 60, 5))
    for here in (beside, rim):
        distance[here] = 1.5 + 6 * SIGMA
    found = imaging.outlying_pixels(written(distance))
    assert found[row, column].all()
    # With each pixel compared once none of the former, and 3 of the latter.
    assert found[beside].mean() > 0.6
    assert found[rim].mean() > 0.6


def test_a_pixel_that_no_neighbour_supports_stands_alone(written: Make) -> None:
    distance = np.full(SHAPE, np.nan)
    distance[5, 5] = 1.0
    distance[0, 19] = 2.0
    # Two side by side that are not as far support each other not.
    distance[9, 9:11] = 1.2, 1.9
    found = imaging.outlying_pixels(written(distance))
    assert np.array_equal(found, np.isfinite(distance))
    # Of a single pixel nobody can tell.
    assert not imaging.outlying_pixels(written(np.array([[1.0]]))).any()


def test_small_targets_in_the_dark_are_no_noise(written: Make) -> None:
    columns = np.arange(SHAPE[1])
    rope, rung, two, line = np.full((4, *SHAPE), np.nan)
    # A rope one pixel wide, aslant, that sags; a rung with a gap; two pixels.
    rope[columns // 2, columns] = 1.5 + 2e-3 * columns
    rung[4, 3:9] = 1.8
    rung[4, 5] = np.nan
    two[7, 7], two[8, 8] = 2.0, 2.003
    line[0] = 1.5
    for distance in (rope, rung, two, line, line[:1], rope.T[:, :1]):
        noisy = distance + SIGMA * np.random.default_rng(4).standard_normal(
            distance.shape
        )
        assert not imaging.outlying_pixels(written(noisy)).any()


def test_the_flag_is_added_to_those_that_are_there(written: Make) -> None:
    distance = 1.5 + _noise(1)
    distance[4, 7] += 0.05
    image = imaging.flag_outliers(written(distance))
    cubes.check(image, "range_image")
    flags = image["quality_flag"].values
    assert flags[4, 7] == QualityFlag.OUTLIER
    assert np.count_nonzero(flags) == 1


def test_an_odd_significance_is_refused(written: Make) -> None:
    with pytest.raises(ValueError, match="above 0"):
        imaging.outlying_pixels(written(np.ones(SHAPE)), significance=0.0)


def _continued(values: dict[int, float], errors: dict[int, float]):
    """Return line and variance at place 0 from the rules of the documentation."""
    if not np.isnan([values[-1], values[1]]).any():
        return (values[-1] + values[1]) / 2, (errors[-1] + errors[1]) / 4, True
    # At a rim the next four pixels, or the next two where one of the four is missing.
    for side in (-1, 1):
        near, next_, far = (values[side * step] for step in (1, 2, 4))
        if not np.isnan([near, next_, far]).any():
            parts = (1.0, 1), (0.5, 2), (-0.5, 4)
            break
    else:
        for side in (-1, 1):
            if not np.isnan([values[side], values[2 * side]]).any():
                parts = (2.0, 1), (-1.0, 2)
                break
        else:
            return np.nan, np.nan, False
    line = sum(weight * values[side * step] for weight, step in parts)
    spread = sum(weight**2 * errors[side * step] for weight, step in parts)
    return line, spread, False


def test_a_pixel_is_compared_with_lines_in_four_directions() -> None:
    rng = np.random.default_rng(12)
    distance = rng.standard_normal((7, 8))
    distance[rng.random((7, 8)) < 0.15] = np.nan
    variance = rng.uniform(0.5, 2, (7, 8))
    found = _standing(distance, variance, distance)
    for row, column in np.ndindex(7, 8):
        deviations, spreads, scores, both = [], [], [], 0
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            values, errors = dict.fromkeys(range(-4, 5), np.nan), {}
            for step in range(-4, 5):
                r, c = row + step * down, column + step * right
                if 0 <= r < 7 and 0 <= c < 8:
                    values[step], errors[step] = distance[r, c], variance[r, c]
            line, spread, between = _continued(values, {**values, **errors})
            both += between
            if np.isfinite(distance[row, column] - line):
                deviations.append(distance[row, column] - line)
                spreads.append(spread)
                scores.append(
                    abs(deviations[-1]) / np.sqrt(variance[row, column] + spread)
                )
        at = (row, column)
        assert found.directions[at] == len(deviations)
        assert found.between[at] == both
        if not deviations:
            assert np.isnan(found.average[at])
            continue
        sizes = np.abs(deviations)
        agreed = len({*np.sign(deviations)}) == 1
        assert found.agreed[at] == agreed
        middle = np.median(deviations)
        unlike = np.max(np.abs(deviations - middle) / np.sqrt(spreads))
        for name, expected in (
            ("least", sizes.min()), ("average", sizes.mean()), ("middle", abs(middle)),
            ("spread", np.median(spreads)), ("unlike", unlike),
            ("score", min(scores) if agreed else 0.0),
        ):  # fmt: skip
            assert getattr(found, name)[at] == pytest.approx(expected), (name, at)


@pytest.mark.parametrize("significance", [2.7, 3.0])
def test_a_spike_is_an_outlier_from_the_stated_significance_on(significance) -> None:
    # The line of two neighbors has half the variance of a pixel.
    limit = significance * np.sqrt(1.5) * SIGMA
    for size, flagged in ((0.999 * limit, 0), (1.001 * limit, 1)):
        distance = np.full(SHAPE, 1.5)
        distance[5, 8] -= size
        azimuth, elevation, _ = directions(*SHAPE)
        image = image_of(distance, azimuth, elevation, own=SIGMA)
        found = imaging.outlying_pixels(image, significance=significance)
        assert found.sum() == found[5, 8] == flagged
