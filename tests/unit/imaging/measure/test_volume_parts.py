"""Parts of volumes: gaps between pixels, and derivatives by the ranges."""

from __future__ import annotations

import sys

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.errors import CubeError
from amulor.imaging.measure import volumes

module = sys.modules["amulor.imaging.measure.volumes"]
ROWS, COLUMNS = 12, 15
#: Pixels of the base around the middle.
BASE = np.ones((ROWS, COLUMNS), dtype=bool)
BASE[3:9, 4:11] = False


def _image() -> xr.Dataset:
    """Tilted plane with a smooth heap of 30 mm in the middle."""
    azimuth, elevation, unit = scenes.directions(ROWS, COLUMNS)
    row, column = np.mgrid[0:ROWS, 0:COLUMNS]
    heap = 0.03 * np.exp(-((row - 5.5) ** 2 + (column - 7) ** 2) / 8)
    ranges = 1.5 / (unit @ np.array([0.1, -0.05, 1.0])) - np.where(BASE, 0.0, heap)
    return scenes.image_of(ranges, azimuth, elevation, own=1e-3, shared=5e-4)


def test_gaps_reach_from_one_usable_pixel_to_the_next() -> None:
    usable = np.array(
        [[True, False, False, True, True], [False, True, False, False, False]]
    )
    low, high, gap = module._neighbors(usable)
    assert_array_equal(low, [[0, 0, 0, 3, 4], [0, 1, 1, 1, 1]])
    assert_array_equal(high, [[0, 3, 3, 3, 4], [1, 1, 4, 4, 4]])
    inf = np.inf
    assert_array_equal(gap, [[0, 3, 3, 0, 0], [inf, 0, inf, inf, inf]])


def test_missing_pixels_lie_between_their_nearest_neighbors() -> None:
    usable = np.ones((4, 5), dtype=bool)
    usable[1, 1:3] = False  # between columns 0 and 3, and rows 0 and 2
    usable[3, 4] = False  # at a corner
    values = np.arange(20.0).reshape(4, 5) ** 2
    matrix, gaps = module._interpolation(usable)
    filled = (matrix @ np.where(usable, values, 0.0).ravel()).reshape(4, 5)
    assert_allclose(filled[usable], values[usable])
    # Two rows apart is nearer than three columns.
    assert filled[1, 1] == pytest.approx((values[0, 1] + values[2, 1]) / 2)
    assert filled[1, 2] == pytest.approx((values[0, 2] + values[2, 2]) / 2)
    assert filled[3, 4] == 0
    assert gaps[3, 4] == 0
    assert_array_equal(gaps[1], [1, 2, 2, 1, 1])
    assert_array_equal(gaps[0], np.ones(5))
    usable[0, 1:3] = False
    matrix, gaps = module._interpolation(usable)
    filled = (matrix @ np.where(usable, values, 0.0).ravel()).reshape(4, 5)
    # Along the row: a third and two thirds of the way.
    assert filled[0, 1] == pytest.approx((2 * values[0, 0] + values[0, 3]) / 3)
    assert filled[1, 2] == pytest.approx((values[1, 0] + 2 * values[1, 3]) / 3)
    assert_array_equal(gaps[0], [1, 3, 3, 1, 1])


def _value(image: xr.Dataset) -> float:
    everything = np.ones((ROWS, COLUMNS), dtype=bool)
    return volumes.volume(image, everything, base=BASE).value


@pytest.mark.parametrize("place", [(5, 7), (4, 5), (0, 0), (11, 6), (2, 14)])
def test_the_noise_of_a_volume_is_by_the_derivatives_of_its_ranges(
    place: tuple[int, int],
) -> None:
    """Surface and base of a pixel's range, by differences of whole volumes."""
    image = _image()
    everything = np.ones((ROWS, COLUMNS), dtype=bool)
    surface = module._Surface(image, everything)
    ground = module._Ground(image, BASE)
    value, by_point, by_plane = module._sum(surface, ground)
    assert value == pytest.approx(_value(image))
    gradient = surface.by_range(by_point) + ground.by_range(by_plane)
    ends = []
    for sign in (1, -1):
        moved = image.copy(deep=True)
        moved["slant_range"].values[place] += sign * 1e-5
        ends.append(_value(moved))
    change = (ends[0] - ends[1]) / 2e-5
    assert gradient[place] == pytest.approx(change, rel=1e-3, abs=1e-7)


def test_random_and_shared_errors_of_a_volume_add() -> None:
    image = _image()
    gradient = np.random.default_rng(2).normal(size=(ROWS, COLUMNS))
    gradient[:2] = 0.0
    random, shared = module._variances(image, gradient, spacing=1)
    assert random == pytest.approx(1e-6 * (gradient**2).sum())
    # Errors that all pixels share, of one phase of the water: cosines of their ranges.
    ranges = image["slant_range"].values.ravel()
    per_range = 4 * np.pi * 39e6 * 1.38 / 299792458.0
    cosine = np.cos(per_range * (ranges[:, None] - ranges))
    flat = gradient.ravel()
    assert shared == pytest.approx(25e-8 * flat @ cosine @ flat, rel=1e-6)
    # Blocks of three rows and columns stand for their pixels.
    _, lumped = module._variances(image, np.abs(gradient), spacing=3)
    flat = np.abs(flat)
    assert lumped == pytest.approx(25e-8 * flat @ cosine @ flat, rel=1e-2)


def test_edges_between_pixels_are_unknown_by_their_spacing() -> None:
    """A step of 0.1 m along a straight edge of eight rows, seen straight on."""
    azimuth, elevation, _ = scenes.directions(9, 12)
    ranges = np.where(np.arange(12) < 6, 1.4, 1.5) * np.ones((9, 12))
    image = scenes.image_of(ranges, azimuth, elevation, own=1e-4)
    surface = module._Surface(image, np.ones((9, 12), dtype=bool))
    assert surface.steps[0][:, 5].all()
    normal = np.array([0.0, 0.0, -1.0])
    found = surface.edge_variance(normal)
    across = 0.08 / 11 * 1.45
    down = 2 * 0.04 * 9 / 12 / 8 * 1.45
    # One error of the edge along all rows, with an even distribution over a pixel.
    expected = (0.1 * across * down * 9) ** 2 / 12
    assert found == pytest.approx(expected, rel=0.15)


def test_regions_without_a_cell_are_one_line() -> None:
    image = _image()
    for mask, words in (
        (np.zeros((ROWS, COLUMNS), dtype=bool), "the region has no pixel; enlarge it"),
        (np.eye(ROWS, COLUMNS, dtype=bool),
         "the region has no cell of four pixels; enlarge it"),
    ):  # fmt: skip
        with pytest.raises(CubeError) as caught:
            volumes.volume(image, mask, base=BASE)
        assert str(caught.value) == words
    rough = image.copy(deep=True)
    rough["slant_range"].values[:] += 0.02 * np.random.default_rng(3).normal(
        size=(ROWS, COLUMNS)
    )
    with pytest.raises(CubeError, match=r"^the base is no plane: does not fit"):
        volumes.volume(rough, np.ones((ROWS, COLUMNS), dtype=bool), base=BASE)
