"""Straight ways through layers, cones and faces, against brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulor.transport._kernels.contributions import face_and_acceptance, face_point
from amulor.transport._kernels.mesh import cone_window, transmission_depth
from amulor.transport._kernels.polarization import any_frame
from amulor.transport._kernels.slab import way_out
from amulor.transport._kernels.trace import layer_of
from amulor.transport._kernels.types import Face
from amulor.transport._runs import random_state

EDGE = np.array([-1.0, 0.5, 2.0, 7.0])
ATTENUATION = np.array([0.3, 2.0, 0.7])


def thickness_by_sum(start, end, length):
    """Return the optical thickness as a sum over 200,000 steps."""
    z = start + (end - start) * (np.arange(200_000) + 0.5) / 200_000
    layer = np.searchsorted(EDGE, z, side="right") - 1
    return length * ATTENUATION[layer].mean()


@pytest.mark.parametrize(
    ("start", "end", "length"),
    [(-1, 7, 9.0), (3.3, -0.4, 4.0), (0.6, 1.7, 30.0), (0.5, 2.0, 1.5), (6.9, 0, 8)],
)
def test_optical_thickness_through_layers_is_the_sum_over_the_way(start, end, length):
    found = transmission_depth(start, end, length, EDGE, ATTENUATION)
    # The sum is off by two steps of the largest change at most.
    assert found == pytest.approx(thickness_by_sum(start, end, length), rel=1e-4)
    plain = transmission_depth.py_func(start, end, length, EDGE, ATTENUATION)
    assert found == pytest.approx(plain, rel=1e-14)


def test_a_level_way_lies_in_one_layer():
    assert transmission_depth(1.0, 1.0, 4.0, EDGE, ATTENUATION) == pytest.approx(8.0)
    nearly = transmission_depth(3.0, 3.0 + 1e-11, 2.0, EDGE, ATTENUATION)
    assert nearly == pytest.approx(1.4, rel=1e-9)


def test_water_without_bounds_has_one_attenuation():
    edge = np.array([-np.inf, np.inf])
    found = transmission_depth(-50.0, 80.0, 140.0, edge, np.array([0.25]))
    assert found == pytest.approx(35.0, rel=1e-14)


def test_the_way_out_of_a_slab_is_that_to_its_face():
    z, cosine = 1.2, 0.4
    depth, length = way_out(z, cosine, EDGE, ATTENUATION)
    assert length == pytest.approx((7.0 - z) / cosine, rel=1e-12)
    expected = (0.8 * 2.0 + 5.0 * 0.7) / cosine  # to 2 m, then to 7 m
    assert depth == pytest.approx(expected, rel=1e-12)
    depth, length = way_out(z, -cosine, EDGE, ATTENUATION)
    assert length == pytest.approx(2.2 / cosine, rel=1e-12)
    assert depth == pytest.approx((0.7 * 2.0 + 1.5 * 0.3) / cosine, rel=1e-12)


def test_layers_are_counted_from_the_first_and_end_outside():
    found = [layer_of(z, EDGE) for z in (-2, -1, 0.4, 0.5, 6.9, 7, 9)]
    assert found == [-1, 0, 0, 1, 2, 3, 3]


directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(
    lambda v: np.linalg.norm(v) > 1e-3
)


@given(directions)
def test_any_frame_is_a_unit_vector_across(direction):
    n = np.array(direction) / np.linalg.norm(direction)
    e = np.array(any_frame(tuple(n)))
    assert e @ n == pytest.approx(0, abs=1e-12)
    assert np.linalg.norm(e) == pytest.approx(1, abs=1e-12)


def inside_cone(z, line, radius, slope):
    x, y, slope_x, slope_y = line
    return np.hypot(x + slope_x * z, y + slope_y * z) - (radius + slope * z)


@given(
    st.tuples(*[st.floats(-2, 2)] * 4),
    st.floats(1e-3, 1),
    st.floats(1e-3, 3),
    st.floats(-2, 4),
    st.floats(0.01, 20),
)
def test_the_window_of_a_cone_is_the_part_of_the_line_inside(
    line, radius, slope, low, width
):
    high = low + width
    first, last = cone_window(*line, radius, slope, low, high)
    z = np.linspace(max(low, 0), high, 4001) if high > 0 else np.zeros(0)
    off = inside_cone(z, line, radius, slope)
    tolerance = 1e-6 * (1 + z)  # points that are on the cone but for rounding
    within = (z >= first) & (z <= last)
    assert np.all(off[within] <= tolerance[within])
    assert np.all(off[~within] >= -tolerance[~within])
    if first < last:
        assert first >= max(low, 0)
        assert last <= high
    assert cone_window.py_func(*line, radius, slope, low, high) == pytest.approx(
        (first, last), rel=1e-12, abs=1e-12
    )


@pytest.mark.parametrize("x", [0.0, 0.049, 0.06, 0.5])
def test_a_line_along_the_cone_has_no_end(x):
    # As steep as the cone: it enters at most once.
    first, last = cone_window(x, 0.0, 0.1, 0.0, 0.05, 0.1, 0.0, 30.0)
    if x < 0.05:
        assert (first, last) == (0.0, 30.0)
    else:
        assert first >= last
    across = cone_window(x, 0.0, -0.1, 0.0, 0.05, 0.1, 0.0, 30.0)
    # |x - 0.1 z| < 0.05 + 0.1 z from z = 5 (x - 0.05) on.
    assert across[0] == pytest.approx(max(0, 5 * (x - 0.05)), abs=1e-12)
    assert across[1] == 30.0


@pytest.mark.parametrize(
    ("x", "y", "z"), [(0.02, 0.01, 0.3), (0.03, 0.0, 2.0), (0.4, -0.2, 9.0)]
)
def test_points_drawn_on_the_face_stand_for_the_area_that_sees(x, y, z):
    # Overlap of the face and the disc of radius slope z around (x, y), by a grid.
    face, slope = 0.05, 0.035
    grid = np.linspace(-face, face, 1501)
    px, py = np.meshgrid(grid, grid)
    seen = (np.hypot(px, py) <= face) & (np.hypot(px - x, py - y) <= slope * z)
    expected = seen.sum() * (grid[1] - grid[0]) ** 2
    state = random_state(2, 0)
    points = np.array([face_point(state, (x, y, z), face, slope) for _ in range(8000)])
    hit = points[:, 2] > 0
    assert np.all(np.hypot(points[hit, 0], points[hit, 1]) <= face)
    assert np.all(
        np.hypot(points[hit, 0] - x, points[hit, 1] - y) <= slope * z * (1 + 1e-12)
    )
    error = points[:, 2].std() / np.sqrt(len(points))
    # The grid is off by a cell along the rim, some 2e-3.
    assert abs(points[:, 2].mean() - expected) <= 4 * error + 2e-3 * expected


def test_a_gaussian_receiver_is_the_mean_of_discs():
    # The fraction of discs that hold a point at s is exp(-s^2 / R^2), for angles too.
    state = random_state(4, 0)
    drawn = np.array(
        [face_and_acceptance(state, Face(0.05, 0.1, True)) for _ in range(20_000)]
    )
    for column, width in ((0, 0.05), (1, 0.1)):
        for place in (0.3, 0.8, 1.5):
            expected = np.exp(-(place**2))
            error = np.sqrt(expected * (1 - expected) / len(drawn))
            fraction = np.mean(drawn[:, column] > place * width)
            assert abs(fraction - expected) < 4 * error
    sharp = face_and_acceptance(state, Face(0.05, 0.1, False))
    assert sharp == (0.05, 0.1)
