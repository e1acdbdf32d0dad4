"""Slant ranges of a scan from optical paths, and their errors, in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.optics._geometry import Geometry
from amulor.optics.rays import Medium

INDEX = 1.38
WATER = Medium(refractive_index=1.34, group_index=INDEX)
WINDOW = Medium(
    refractive_index=1.34,
    group_index=INDEX,
    window_distance=0.2,
    window_thickness=0.01,
    window_refractive_index=1.52,
    window_group_index=1.54,
)


def geometry(*, azimuth=0.0, elevation=0.0, baseline=0.0, medium=WATER) -> Geometry:
    return Geometry(
        azimuth=np.array([azimuth]),
        elevation=np.array([elevation]),
        emitter=np.zeros(3),
        receiver=np.array([baseline, 0.0, 0.0]),
        medium=medium,
    )


def test_depth_and_position_of_a_beam_begin_behind_the_window() -> None:
    straight = geometry(medium=WINDOW)
    assert_allclose(straight.depth(np.array([1.5])), 1.5 - 0.21)
    assert_allclose(straight.position(np.array([1.5])), [[0, 0, 1.5]], atol=1e-15)
    turned = geometry(azimuth=0.3, elevation=0.2)
    expected = [np.sin(0.3) * np.cos(0.2), -np.sin(0.2), np.cos(0.3) * np.cos(0.2)]
    assert_allclose(turned.position(np.array([2.0])), 2 * np.array([expected]))
    assert_allclose(turned.depth(np.array([2.0])), 2.0)


@pytest.mark.parametrize("medium", [WATER, WINDOW])
def test_slant_range_is_that_of_the_path_with_its_slope(medium: Medium) -> None:
    seen = geometry(azimuth=0.1, baseline=0.15, medium=medium)
    path = seen.optical_path(np.array([1.7]))
    found, slope = seen.slant_range_and_slope(path)
    assert_allclose(found, 1.7, rtol=1e-9)
    assert_allclose(seen.slant_range(path), 1.7, rtol=1e-9)
    change = seen.optical_path(np.array([1.701])) - seen.optical_path(np.array([1.699]))
    assert_allclose(slope, 0.002 / change, rtol=1e-4)


def test_slant_range_beside_the_beam_has_one_path_back() -> None:
    seen = geometry(baseline=0.4)
    path = INDEX * (1.5 + np.hypot(1.5, 0.4))
    assert_allclose(seen.optical_path(np.array([1.5])), path)
    assert_allclose(seen.slant_range(np.array([path])), 1.5)
    low, high = seen.path_limits((1.0, 2.0), np.array([40e6]))
    assert_allclose(low, INDEX * (1 + np.hypot(1, 0.4)))
    assert_allclose(high, INDEX * (2 + np.hypot(2, 0.4)))


@pytest.mark.parametrize("uncertainty", [0.0, 1e-4, 0.01])
def test_error_by_the_index_is_in_proportion_to_the_range(uncertainty: float) -> None:
    path = np.array([2 * INDEX * 1.5])
    found = geometry().error_by_index(path, uncertainty)
    # From s = L / 2 n, and to the third order for differences of 1 %.
    assert_allclose(found, 1.5 / INDEX * uncertainty, rtol=1e-4, atol=1e-15)


def test_error_by_the_place_of_the_receiver_is_half_of_it_along_the_beam() -> None:
    seen, path = geometry(), np.array([2 * INDEX * 1.5])
    assert_allclose(seen.error_by_place(path, 0.001, 0.0), 0.0005, rtol=1e-6)
    assert_allclose(seen.error_by_place(path, 0.001, 0.0, axes=2), 0, atol=1e-9)
    # A receiver aside moves by the direction cosines of the way back.
    aside, back = geometry(baseline=0.4), np.hypot(1.5, 0.4)
    path = np.array([INDEX * (1.5 + back)])
    change = 1 + 1.5 / back
    x, z = 0.4 / back / change, 1.5 / back / change
    found = aside.error_by_place(path, 0.001, 0.0)
    assert_allclose(found, 0.001 * np.hypot(x, z), rtol=1e-5)
    found = aside.error_by_place(path, 0.001, 0.0, axes=2)
    assert_allclose(found, 0.001 * x, rtol=1e-5)


def test_error_by_the_direction_of_the_beam_needs_a_receiver_aside() -> None:
    back = np.hypot(1.5, 0.4)
    path = np.array([INDEX * (1.5 + back)])
    expected = 1.5 * 0.4 / (1.5 + back) * 1e-3
    found = geometry(baseline=0.4).error_by_place(path, 0.0, 1e-3)
    assert_allclose(found, expected, rtol=1e-5)
    path = np.array([2 * INDEX * 1.5])
    assert_allclose(geometry().error_by_place(path, 0.0, 1e-3), 0, atol=1e-12)
    both = geometry(baseline=0.4)
    path = np.array([INDEX * (1.5 + back)])
    parts = [both.error_by_place(path, *error) for error in ((1e-3, 0), (0, 1e-3))]
    found = both.error_by_place(path, 1e-3, 1e-3)
    assert_allclose(found, np.hypot(*parts), rtol=1e-12)
    assert_allclose(both.error_by_place(path, 0.0, 0.0), 0.0)


def test_elevation_counts_for_a_receiver_below() -> None:
    below = Geometry(
        azimuth=np.zeros(1),
        elevation=np.zeros(1),
        emitter=np.zeros(3),
        receiver=np.array([0.0, 0.4, 0.0]),
        medium=WATER,
    )
    back = np.hypot(1.5, 0.4)
    found = below.error_by_place(np.array([INDEX * (1.5 + back)]), 0.0, 1e-3)
    assert_allclose(found, 1.5 * 0.4 / (1.5 + back) * 1e-3, rtol=1e-5)
