"""Beams through a flat window, and the way of the light back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.optimize import minimize

from amulor.optics import rays

WET = rays.Medium(refractive_index=1.34, group_index=1.38)
DRY = rays.Medium(
    refractive_index=1.34,
    group_index=1.38,
    window_distance=0.3,
    window_thickness=0.02,
    window_refractive_index=1.47,
    window_group_index=1.50,
)
ANGLE = st.floats(-0.6, 0.6)


@given(ANGLE, ANGLE)
def test_directions_are_unit_vectors_to_the_right_and_up(az: float, el: float) -> None:
    vector = rays.direction(az, el)
    assert_allclose(np.linalg.norm(vector), 1, rtol=1e-14)
    assert np.sign(vector[0]) == np.sign(np.sin(az))
    # Down is the second axis, so that right, down, forward are right-handed.
    assert np.sign(vector[1]) == -np.sign(np.sin(el))
    assert_allclose(np.cross([1, 0, 0], [0, 1, 0]), [0, 0, 1])


@given(ANGLE, ANGLE)
def test_the_window_bends_by_the_phase_index(az: float, el: float) -> None:
    outside = rays.direction(az, el)
    beam = rays.enter_water([0.0, 0.0, 0.0], outside, medium=DRY)
    sine_air = np.hypot(outside[0], outside[1])
    sine_water = np.hypot(beam.direction[0], beam.direction[1])
    # Snell, with the phase index 1.34 and not the group index 1.38.
    assert_allclose(sine_air, 1.34 * sine_water, rtol=1e-12, atol=1e-15)
    assert_allclose(np.linalg.norm(beam.direction), 1, rtol=1e-13)
    # Same plane of incidence.
    assert_allclose(
        outside[0] * beam.direction[1], outside[1] * beam.direction[0], atol=1e-15
    )


def test_straight_through_the_window_counts_each_layer_with_its_group_index() -> None:
    beam = rays.enter_water([0.0, 0.0, 0.1], [0.0, 0.0, 1.0], medium=DRY)
    assert_allclose(beam.length_before, 0.2 + 0.02)
    assert_allclose(beam.optical_length_before, 0.2 + 1.50 * 0.02)
    assert_allclose(beam.entry, [0, 0, 0.32])


@given(
    st.floats(-0.5, 0.5),
    st.floats(-0.5, 0.5),
    st.floats(0.4, 5.0),
    st.floats(-0.2, 0.2),
)
def test_the_way_back_is_the_one_of_least_phase_travel_time(
    x: float, y: float, z: float, receiver_x: float
) -> None:
    point, sink = np.array([x, y, z]), np.array([receiver_x, 0.0, 0.0])

    # Fermat: the two crossing points of the faces that make the phase path shortest.
    def legs(crossings: np.ndarray) -> tuple[float, float, float]:
        near = np.array([crossings[0], crossings[1], 0.3])
        far = np.array([crossings[2], crossings[3], 0.32])
        return (
            float(np.linalg.norm(near - sink)),
            float(np.linalg.norm(far - near)),
            float(np.linalg.norm(point - far)),
        )

    def phase_path(crossings: np.ndarray) -> float:
        air, glass, water = legs(crossings)
        return air + 1.47 * glass + 1.34 * water

    start = np.array([receiver_x, 0.0, receiver_x, 0.0])
    best = minimize(phase_path, start, method="BFGS", options={"gtol": 1e-12})
    air, glass, water = legs(best.x)
    expected = air + 1.50 * glass + 1.38 * water
    found = rays.return_length(point, sink, medium=DRY)
    # The minimiser finds the crossings to about 1e-7 m, which moves a path that is
    # not at its own minimum (group, not phase) by as much.
    assert_allclose(found, expected, rtol=0, atol=1e-6)


def test_without_a_window_the_way_back_is_straight() -> None:
    found = rays.return_length([0.3, 0.0, 0.4], [0.0, 0.0, 0.0], medium=WET)
    assert_allclose(found, 1.38 * 0.5, rtol=1e-15)


@pytest.mark.parametrize("medium", [WET, DRY], ids=["wet", "dry"])
@given(
    st.floats(-0.4, 0.4), st.floats(-0.3, 0.3), st.floats(0.8, 20.0), st.floats(0, 0.5)
)
def test_the_slant_range_is_recovered_from_the_path(
    medium: rays.Medium, az: float, el: float, slant_range: float, baseline: float
) -> None:
    receiver = np.array([baseline, 0.0, 0.0])
    beam = rays.enter_water([0.0, 0.0, 0.0], rays.direction([az], [el]), medium=medium)
    spot = beam.entry + (slant_range - beam.length_before)[..., None] * beam.direction
    path = (
        beam.optical_length_before
        + medium.group_index * (slant_range - beam.length_before)
        + rays.return_length(spot, receiver, medium=medium)
    )
    found = rays.slant_range_of_path(path, beam, receiver, medium=medium)
    assert_allclose(found, slant_range, rtol=1e-9)


def test_ignoring_the_baseline_would_be_wrong_by_what_pythagoras_says() -> None:
    # A wall 1.5 m straight ahead, receiver 7 cm aside.
    path = 1.38 * (1.5 + np.hypot(1.5, 0.07))
    beam = rays.enter_water([[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], medium=WET)
    found = rays.slant_range_of_path([path], beam, np.array([0.07, 0, 0]), medium=WET)
    assert_allclose(found, 1.5, rtol=1e-13)
    assert path / (2 * 1.38) - 1.5 == pytest.approx(0.07**2 / (4 * 1.5), rel=1e-3)


def test_a_path_shorter_than_any_has_no_range() -> None:
    beam = rays.enter_water([[0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]], medium=WET)
    receiver = np.array([0.2, 0.0, 0.0])
    found = rays.slant_range_of_path([0.1 * 1.38], beam, receiver, medium=WET)
    assert np.isnan(found).all()


@pytest.mark.parametrize(
    ("start", "vector", "text"),
    [
        ([0, 0, 0.4], [0, 0, 1.0], "must start before it"),
        ([0, 0, 0], [0, 1.0, 0], "must point forwards"),
    ],
)
def test_a_beam_that_cannot_meet_the_window_is_refused(
    start: list[float], vector: list[float], text: str
) -> None:
    with pytest.raises(ValueError, match=text):
        rays.enter_water(start, vector, medium=DRY)


@pytest.mark.parametrize("aside", [0.0, 0.01, 0.5, 3.0, 30.0])
@pytest.mark.parametrize("thickness", [0.001, 0.2])
def test_the_way_back_follows_the_law_of_refraction_to_grazing(
    aside: float, thickness: float
) -> None:
    medium = replace(DRY, window_thickness=thickness)
    depths = (0.3, thickness, 0.7 - thickness)
    indices, groups = (1.0, 1.47, 1.34), (1.0, 1.50, 1.38)

    def legs(sine: float) -> list[tuple[float, float]]:
        return [
            (depth * sine / np.sqrt(index**2 - sine**2), index)
            for depth, index in zip(depths, indices, strict=True)
        ]

    # The sine in air, by bisection of its distance from 1 on a scale of logarithms.
    low, high = -40.0, 0.0
    for _ in range(200):
        middle = (low + high) / 2
        covered = sum(way for way, _ in legs(1 - np.exp(middle)))
        low, high = (middle, high) if covered > aside else (low, middle)
    sine = 1 - np.exp((low + high) / 2)
    expected = sum(
        group * depth * index / np.sqrt(index**2 - sine**2)
        for depth, index, group in zip(depths, indices, groups, strict=True)
    )
    found = rays.return_length([aside, 0.0, 1.0], [0.0, 0.0, 0.0], medium=medium)
    # At 30 m beside 0.3 m of air, 1 - sine has ten digits.
    assert_allclose(found, expected, rtol=1e-8)
