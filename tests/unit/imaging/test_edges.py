"""Pixels whose beam meets two surfaces: found at edges, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor import cube as cubes
from amulor import imaging
from amulor.imaging.edges import (
    _SIDE,
    _along_edge,
    _off_lines,
    _step_scores,
    reached,
    steps,
)

Make = Callable[..., xr.Dataset]
#: Of the images of `written` [m].
SIGMA = 1e-3


def _step(width: float, *, turned: bool) -> np.ndarray:
    """Return an edge of 10 cm seen by a beam that covers so many pixels.

    The mixture is that of the phasors at 39 MHz, both surfaces equally bright.
    """
    share = np.clip((np.arange(20) - 9.9) / width + 0.5, 0, 1)
    wavenumber = 4 * np.pi * 39e6 * 1.38 / 299792458.0
    sum_of_both = (1 - share) * np.exp(1j * wavenumber * 1.5) + share * np.exp(
        1j * wavenumber * 1.4
    )
    line = np.angle(sum_of_both) / wavenumber
    image = np.broadcast_to(line, (8, 20))
    return image.T if turned else image


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("width", [1.0, 2.0])
def test_mixed_pixels_of_an_edge_are_found(
    written: Make, width: float, turned: bool
) -> None:
    distance = _step(width, turned=turned)
    rng = np.random.default_rng(1)
    noisy = distance + SIGMA * rng.standard_normal(distance.shape)
    found = imaging.mixed_pixels(written(noisy))
    off = np.minimum(abs(distance - distance.max()), abs(distance - distance.min()))
    clearly = off > 2e-2
    assert clearly.sum() >= 8
    assert found[clearly].all()
    assert not found[off < 1e-6].any()


@pytest.mark.parametrize("turned", [False, True])
def test_a_gap_of_a_few_times_the_noise_is_seen_along_its_edge(
    written: Make, turned: bool
) -> None:
    # Two columns between surfaces 16 standard errors apart, 6.4 from either: means of
    # five pixels see all but a few, and single pixels a fourth of them.
    share = np.clip((np.arange(24) - 10.5) / 2.5, 0, 1)
    share[[11, 12]] = 0.4, 0.6
    share[13:] = 1
    seen = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        noise = SIGMA * rng.standard_normal((16, 24))
        distance = 2.4 + 16 * SIGMA * share + noise
        found = imaging.mixed_pixels(written(distance.T if turned else distance))
        found = found.T if turned else found
        seen.append(found[:, 11:13].mean())
        assert found[:, [*range(11), *range(13, 24)]].mean() < 0.003
    assert np.mean(seen) > 0.9


def test_a_slanting_edge_without_mixed_pixels_has_none(written: Make) -> None:
    rows, columns = np.indices((16, 24))
    surface = np.where(columns > 8 + rows / 2, 2.42, 2.4)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        noisy = surface + SIGMA * rng.standard_normal(surface.shape)
        assert imaging.mixed_pixels(written(noisy)).mean() < 0.005


@pytest.mark.parametrize(
    "surface",
    [
        np.where(np.arange(20) < 10, 1.5, 1.4) * np.ones((8, 1)),
        1.5 + 0.03 * np.arange(20) * np.ones((8, 1)),
        1.5 + 2e-4 * (np.arange(20) - 10.0) ** 2 * np.ones((8, 1)),
    ],
    ids=["sharp step", "slope", "bowl"],
)
def test_clean_surfaces_have_none(written: Make, surface: np.ndarray) -> None:
    rng = np.random.default_rng(2)
    noisy = surface + SIGMA * rng.standard_normal(surface.shape)
    assert not imaging.mixed_pixels(written(noisy)).any()


@settings(max_examples=20)
@given(shift=st.floats(-1, 1), common=st.floats(0, 0.1))
def test_what_pixels_share_changes_nothing(
    written: Make, shift: float, common: float
) -> None:
    distance = _step(2.0, turned=False)
    plain = imaging.mixed_pixels(written(distance))
    moved = imaging.mixed_pixels(written(distance + shift, common=common))
    np.testing.assert_array_equal(plain, moved)


def test_a_missing_neighbour_decides_nothing(written: Make) -> None:
    distance = _step(1.0, turned=False).copy()
    distance[:, 8] = np.nan
    distance[:, 12] = np.nan
    assert not imaging.mixed_pixels(written(distance), reach=1)[:, 9:12].any()


def test_the_mark_is_written_into_the_image(written: Make) -> None:
    image = imaging.flag_mixed(written(_step(1.0, turned=False)))
    cubes.check(image, "range_image")
    np.testing.assert_array_equal(
        image["user_mixed"].values == 1, imaging.mixed_pixels(image)
    )
    assert image["user_mixed"].values.any()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [({"significance": 0.0}, "above 0"), ({"reach": 0}, "at least 1 pixel")],
)
def test_odd_arguments_are_refused(written: Make, arguments: dict, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        imaging.mixed_pixels(written(_step(1.0, turned=False)), **arguments)


@pytest.mark.parametrize("common", [1e5, 1e9])
def test_errors_that_pixels_share_almost_wholly_divide_nothing_by_zero(
    written: Make, common: float
) -> None:
    # The own error of 1 mm is lost in the rounding of 100 km and more; where the light
    # of a scan is the same along columns, so are the ranges, and 0 over 0 is no number.
    distance = _step(2.0, turned=False)
    image = written(distance, common=common)
    nothing = image.assign(
        slant_range_uncertainty=0 * image["slant_range_uncertainty"],
        slant_range_common_uncertainty=0 * image["slant_range_uncertainty"],
    )
    with np.errstate(all="raise"):
        assert not imaging.mixed_pixels(
            written(np.full((8, 8), 2.0), common=common)
        ).any()
        # A step of 10 cm is nothing against what 1e9 m are rounded by, 15 m.
        found = imaging.mixed_pixels(image)
        assert found.any() == (common < 1e6)
        exact = imaging.mixed_pixels(nothing)
    between = np.minimum(distance.max() - distance, distance - distance.min()) > 2e-2
    assert exact[between].all()


@pytest.mark.parametrize("turned", [False, True])
def test_a_step_is_found_where_it_is_also_beside_a_gap(turned: bool) -> None:
    rng = np.random.default_rng(7)
    noise = 6e-3
    surface = 1.5 + 0.002 * np.arange(40) + noise * rng.normal(size=(40, 40))
    surface[:, 20:] -= 0.04
    holed = surface.copy()
    holed[:, 19:21] = np.nan
    for image in (surface, holed):
        flat = image.T if turned else image
        across, down = steps(flat, np.full(flat.shape, noise**2))
        found = down.T if turned else across
        other = across.T if turned else down
        # Between columns 19 and 20, or at the gap, in every row; hardly anywhere else.
        assert found[:, 18:21].any(axis=1).all()
        assert found[:, :15].mean() + found[:, 25:].mean() < 0.005
        assert other.mean() < 0.005
        part = reached(across, down, (10, 15), 6)
        part = part.T if turned else part
        assert not part[:, 21:].any()


def test_slopes_and_curves_are_no_steps() -> None:
    rng = np.random.default_rng(8)
    along = np.arange(60.0)
    for line in (1.5 + 0.01 * along, 1.5 + 1e-4 * (along - 30) ** 2):
        image = line + 1e-4 * rng.normal(size=(40, 60))
        across, _ = steps(image, np.full(image.shape, 1e-8))
        # Four standard errors are exceeded by 6 of 100,000; the rim sees one side.
        assert across[:, 4:-5].mean() < 1e-3


@pytest.mark.parametrize("first", [1, -1, 2])
def test_a_pixel_is_compared_with_lines_through_its_neighbours(first: int) -> None:
    # Weighted least squares of numpy for the line at place 0, which all pixels beside
    # the middle lie on; their errors are propagated through it.
    rng = np.random.default_rng(3)
    distance = (1.5 + 0.01 * np.arange(13.0))[None] + 1e-6 * rng.normal(size=(1, 13))
    variance = 1e-6 * (1 + rng.random((1, 13)))
    distance[0, 6] += 0.02
    two, four = _off_lines(distance, variance, 1, first)
    side = 1 if first > 0 else -1
    for count, score in ((2, two), (4, four)):
        place = abs(first) + np.arange(count)
        gain = np.linalg.pinv(np.stack([np.ones(count), place], axis=1))[0]
        beside = 6 + side * place
        line = gain @ distance[0, beside]
        spread = gain**2 @ variance[0, beside]
        expected = (distance[0, 6] - line) / np.sqrt(variance[0, 6] + spread)
        assert_allclose(score[0, 6], expected, rtol=1e-9)


def test_four_pixels_that_are_not_straight_are_no_line() -> None:
    # Their misfit has two degrees of freedom; a bend of a hundred errors is none.
    straight = np.full((1, 9), 1.5)
    bent = straight + 0.1 * (np.arange(9) % 3 == 0)
    variance = np.full((1, 9), 1e-6)
    assert np.isfinite(_off_lines(straight, variance, 1, 1)[1][0, 2])
    two, four = _off_lines(bent, variance, 1, 1)
    assert np.isfinite(two[0, 2])
    assert np.isnan(four[0, 2])


@pytest.mark.parametrize("axis", [0, 1])
def test_a_line_through_five_pixels_is_taken_at_the_pixel_itself(axis: int) -> None:
    # numpy's line through the five around a pixel, or the last five of the rim.
    rng = np.random.default_rng(9)
    distance = 1.5 + 1e-3 * np.arange(9.0) + 1e-4 * rng.normal(size=9)
    variance = 1e-6 * (1 + rng.random(9))
    shaped = [
        np.moveaxis(np.tile(part, (3, 1)), 1, axis) for part in (distance, variance)
    ]
    line, spread = (
        np.moveaxis(part, axis, 1)[1] for part in _along_edge(*shaped, axis)
    )
    for pixel in range(9):
        begin = min(max(pixel - 2, 0), 4)
        place = np.arange(begin, begin + 5)
        gain = np.linalg.pinv(np.stack([np.ones(5), place - pixel], axis=1))[0]
        assert line[pixel] == pytest.approx(gain @ distance[place], rel=1e-12)
        assert spread[pixel] == pytest.approx(gain**2 @ variance[place], rel=1e-12)
    assert _along_edge(np.ones((4, 4)), np.ones((4, 4)), axis) is None


def test_five_pixels_off_a_line_by_chance_only_are_a_line() -> None:
    # Off by d in the middle of five: 0.8 d^2 over the variance of 1 mm^2.
    for off in (1e-3, 2e-2):
        distance = np.full((5, 5), 1.5)
        distance[:, 2] += off
        line, _ = _along_edge(distance, np.full((5, 5), 1e-6), 1)
        straight = np.isfinite(line)
        assert straight.all() if off < 2e-3 else not straight.any()


def test_a_step_is_that_of_a_weighted_fit_of_two_lines_with_one_slope() -> None:
    # For each column of the middle row: means of three rows, then a constant, a slope
    # and a step between the columns before and after, by least squares.
    rng = np.random.default_rng(10)
    distance = 1.5 + 1e-3 * rng.standard_normal((3, 12))
    distance[:, 6:] += 0.01
    distance[0, 3] = np.nan
    variance = 1e-6 * (1 + rng.random((3, 12)))
    valid = np.isfinite(distance)
    mean = np.nanmean(distance, axis=0)
    weight = valid.sum(axis=0) ** 2 / np.where(valid, variance, 0).sum(axis=0)
    scores = _step_scores(distance, variance, 1)[1]
    for column in range(11):
        near = np.arange(max(column + 1 - _SIDE, 0), min(column + 1 + _SIDE, 12))
        place = near - column - 0.5
        design = np.stack([np.ones(near.size), place, np.sign(place) / 2], axis=1)
        root = np.sqrt(weight[near])[:, None]
        inverse = np.linalg.pinv((design * root).T @ (design * root))
        fit = inverse @ (design * root**2).T @ mean[near]
        rest = (mean[near] - design @ fit) * root[:, 0]
        excess = max(rest @ rest / max(near.size - 3, 1), 1.0)
        if np.linalg.matrix_rank(design) < 3:
            assert scores[column] == 0
            continue
        expected = abs(fit[2]) / np.sqrt(excess * inverse[2, 2])
        assert scores[column] == pytest.approx(expected, rel=1e-6), column
    assert scores.argmax() == 5


def test_steps_do_not_depend_on_how_far_away_the_scene_is() -> None:
    rng = np.random.default_rng(7)
    # Multiples of 2^-20 m, which are exact 2^30 m farther away, too.
    distance = np.round(2**20 * rng.normal(2.0, 1e-3, (40, 12))) / 2**20
    variance = np.full(distance.shape, SIGMA**2)
    near = _step_scores(distance, variance, 2)
    assert near.max() > 2
    assert_allclose(_step_scores(distance + 2**30, variance, 2), near, atol=1e-3)
