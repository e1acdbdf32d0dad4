"""Lengths of beams through a window and back, part by part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light

from amulor.optics import rays

WET = rays.Medium(refractive_index=1.34, group_index=1.38)
DRY = replace(
    WET,
    window_distance=0.3,
    window_thickness=0.02,
    window_refractive_index=1.47,
    window_group_index=1.50,
)
AHEAD = np.array([0.0, 0.0, 1.0])


def test_water_alone_has_no_window() -> None:
    assert WET.window_distance is None
    assert WET.window_thickness == 0.0
    assert WET.window_refractive_index == WET.window_group_index == 1.0
    start, vector = np.array([[0.1, 0.2, 0.3]]), np.array([[0.6, 0.0, 0.8]])
    beam = rays.enter_water(start, vector, medium=WET)
    assert_array_equal(beam.entry, start)
    assert_array_equal(beam.direction, vector)
    assert_array_equal(beam.length_before, [0.0])
    assert_array_equal(beam.optical_length_before, [0.0])
    start[:], vector[:] = 7.0, 7.0
    assert_array_equal(beam.entry, [[0.1, 0.2, 0.3]])
    assert_array_equal(beam.direction, [[0.6, 0.0, 0.8]])


def test_a_slanted_beam_shifts_in_each_layer_by_its_angle() -> None:
    azimuth, elevation = 0.5, 0.3
    outside = rays.direction(azimuth, elevation)
    sine = np.hypot(outside[0], outside[1])
    heading = outside[:2] / sine
    beam = rays.enter_water([0.01, -0.02, 0.1], outside, medium=DRY)
    air, glass, water = (np.arcsin(sine / index) for index in (1.0, 1.47, 1.34))
    aside = 0.2 * np.tan(air) + 0.02 * np.tan(glass)
    assert_allclose(beam.entry[:2], [0.01, -0.02] + aside * heading, rtol=1e-12)
    assert_allclose(beam.entry[2], 0.32, rtol=1e-12)
    expected = [*np.sin(water) * heading, np.cos(water)]
    assert_allclose(beam.direction, expected, rtol=1e-12)
    lengths = 0.2 / np.cos(air), 0.02 / np.cos(glass)
    assert_allclose(beam.length_before, sum(lengths), rtol=1e-12)
    assert_allclose(
        beam.optical_length_before, lengths[0] + 1.5 * lengths[1], rtol=1e-12
    )


def test_the_way_back_has_three_layers_of_one_invariant() -> None:
    # From the angles to the place: the sine in air is 0.5.
    ways = [
        (depth, np.arcsin(0.5 / index)) for depth, index in
        ((0.25, 1.0), (0.02, 1.47), (1.2, 1.34))
    ]  # fmt: skip
    aside = sum(depth * np.tan(angle) for depth, angle in ways)
    air, glass, water = (depth / np.cos(angle) for depth, angle in ways)
    point = [0.6 * aside + 0.02, 0.8 * aside, 1.52]
    receiver = [0.02, 0.0, 0.05]
    found = rays.return_length(point, receiver, medium=DRY)
    assert_allclose(found, air + 1.5 * glass + 1.38 * water, rtol=1e-10)
    assert_allclose(rays.return_distance(point, receiver, medium=DRY), water)
    straight = np.sqrt((0.6 * aside) ** 2 + (0.8 * aside) ** 2 + 1.47**2)
    assert_allclose(rays.return_distance(point, receiver, medium=WET), straight)
    assert_allclose(rays.return_length(point, receiver, medium=WET), 1.38 * straight)


def test_the_optical_path_is_the_sum_of_the_ways_out_and_back() -> None:
    receiver = np.array([0.1, 0.0, 0.0])
    wet = rays.enter_water([[0.0, 0.0, 0.0]], [AHEAD], medium=WET)
    found = rays.optical_path([2.0], wet, receiver, medium=WET)
    assert_allclose(found, 1.38 * (2 + np.hypot(2, 0.1)))
    dry = rays.enter_water([[0.0, 0.0, 0.1]], [AHEAD], medium=DRY)
    sink = np.array([0.0, 0.0, 0.2])
    found = rays.optical_path([2.0], dry, sink, medium=DRY)
    out = 0.2 + 1.5 * 0.02 + 1.38 * (2 - 0.22)
    assert_allclose(found, out + 1.38 * (2 - 0.22) + 1.5 * 0.02 + 0.1)
    # Nothing is nearer than the face of the window.
    near = rays.optical_path([0.1], dry, sink, medium=DRY)
    assert_allclose(near, 0.2 + 2 * 1.5 * 0.02 + 0.1)


@pytest.mark.parametrize(
    ("frequency", "smallest"),
    [([40e6, 50e6, 90e6], 10e6), ([5e6, 30e6], 5e6), ([70e6], 70e6)],
)
def test_without_an_interval_paths_have_one_period(
    frequency: list[float], smallest: float
) -> None:
    beam = rays.enter_water([[0.0, 0.0, 0.0]], [AHEAD], medium=WET)
    receiver = np.array([0.1, 0.0, 0.0])
    options = {"medium": WET, "modulation_frequency": frequency}
    low, high = rays.path_limits(None, beam, receiver, **options)
    assert_allclose(low, 1.38 * 0.1)
    assert_allclose(high, 1.38 * 0.1 + speed_of_light / smallest)
    low, high = rays.path_limits((0.0, 2.0), beam, receiver, **options)
    assert_allclose(low, 1.38 * 0.1)
    assert_allclose(high, 1.38 * (2 + np.hypot(2, 0.1)))


@pytest.mark.parametrize("interval", [(-0.1, 2.0), (2.0, 2.0), (3.0, 1.0)])
def test_an_interval_runs_from_0_on_to_a_larger_range(
    interval: tuple[float, float],
) -> None:
    beam = rays.enter_water([[0.0, 0.0, 0.0]], [AHEAD], medium=WET)
    text = (
        r"^interval must run from at least 0 to a larger range \[m\], got "
        rf"{interval[0]:g} to {interval[1]:g}$"
    )
    with pytest.raises(ValueError, match=text):
        rays.path_limits(
            interval, beam, np.zeros(3), medium=WET, modulation_frequency=[4e7]
        )


@pytest.mark.parametrize("medium", [WET, DRY], ids=["wet", "dry"])
def test_a_path_too_short_for_the_beam_has_no_range(medium: rays.Medium) -> None:
    beam = rays.enter_water([[0.0, 0.0, 0.0]], [AHEAD], medium=medium)
    receiver = np.array([0.2, 0.0, 0.0])
    shortest = rays.optical_path([0.0], beam, receiver, medium=medium)
    for less, found in ((1e-3, False), (-1e-3, True)):
        slant_range = rays.slant_range_of_path(
            shortest - less, beam, receiver, medium=medium
        )
        assert np.isfinite(slant_range).all() == found
        assert np.all(~np.isfinite(slant_range) | (slant_range >= beam.length_before))


def test_ranges_of_a_whole_scan_are_found_at_once() -> None:
    azimuth = np.linspace(-0.4, 0.4, 5)[:, None]
    vector = rays.direction(azimuth, np.array([[0.1, -0.2]]))
    beam = rays.enter_water(np.zeros(3), vector, medium=DRY)
    slant_range = 1.0 + np.arange(10.0).reshape(5, 2)
    receiver = np.array([0.15, 0.05, 0.02])
    path = rays.optical_path(slant_range, beam, receiver, medium=DRY)
    found = rays.slant_range_of_path(path, beam, receiver, medium=DRY)
    assert_allclose(found, slant_range, rtol=1e-10)
