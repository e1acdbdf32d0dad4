"""Parts of the sharp receiver: lenses of two circles, and where views begin and end."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.small_angle import sharp_receiver
from amulor.optics.small_angle._columns import Column, table

COLUMN = Column(
    absorption=0.1, scattering=0.4, baseline=0.1, receiver_radius=0.02,
    acceptance_angle=0.08, beam_radius=0.0, beam_divergence=0.0, tilt=0.0,
    cross_tilt=0.0, standoff=0.0, end=9.0,
)  # fmt: skip


def lens(distance: float, one: float, other: float) -> float:
    """Return the area that two circles have in common, as textbooks write it."""
    first = (distance**2 + one**2 - other**2) / (2 * distance)
    second = distance - first
    return float(
        one**2 * np.arccos(first / one)
        - first * np.sqrt(one**2 - first**2)
        + other**2 * np.arccos(second / other)
        - second * np.sqrt(other**2 - second**2)
    )


def common(offset: float, path: float) -> float:
    found = sharp_receiver._common(np.array([offset]), COLUMN, np.array([path]))
    return float(found[0])


@pytest.mark.parametrize("path", [0.25, 0.5, 1.0])
def test_light_seen_by_a_part_of_the_aperture_is_a_lens_of_solid_angle(
    path: float,
) -> None:
    radius, view = 0.02, 0.08 * path
    for share in (0.05, 0.4, 0.7, 0.99):
        offset = abs(radius - view) + share * 2 * min(radius, view)
        expected = lens(offset, radius, view) / path**2
        assert_allclose(common(offset, path), expected, rtol=1e-7)


@pytest.mark.parametrize("path", [0.1, 0.25, 1.0])
def test_light_seen_by_all_or_none_has_the_smaller_circle_or_nothing(
    path: float,
) -> None:
    radius, view = 0.02, 0.08 * path
    inside, outside = abs(radius - view), radius + view
    whole = np.pi * min(radius, view) ** 2 / path**2
    assert_allclose(common(0.0, path), whole, rtol=1e-14)
    assert_allclose(common(0.999 * inside, path), whole, rtol=1e-14)
    assert common(1.0001 * outside, path) == 0
    assert 0 < common(0.999 * outside, path) < 0.01 * whole
    assert_allclose(sharp_receiver._on_axis(np.array(path), COLUMN), whole)


def test_segments_of_a_circle_keep_their_digits_when_they_are_thin() -> None:
    angle = np.array([0.0, 1e-4, 0.01, 0.0499, 0.0501, 0.3, 3.0])
    found = sharp_receiver._segment(angle)
    # Taylor series of angle - sin(2 angle) / 2, up to where it is exact.
    double = 2 * angle
    series = double**3 / 12 * (1 - double**2 / 20 * (1 - double**2 / 42))
    assert_allclose(found[:5], series[:5], rtol=1e-9)
    assert_allclose(found[4:], angle[4:] - np.sin(double[4:]) / 2, rtol=1e-12)


def test_a_straight_view_begins_where_the_cone_meets_the_beam() -> None:
    found = np.array(sharp_receiver._edges_of_view(COLUMN))
    # The cone is as wide as the aperture at 0.25 m; the aperture sees the beam
    # from 1 m on, and all of it does from 1.5 m on.
    assert_allclose(np.sort(found[found > 0]), [0.25, 1.0, 1.5], rtol=1e-9)
    behind = sharp_receiver._edges_of_view(COLUMN._replace(standoff=0.3))
    assert_allclose(np.sort(behind), np.sort(found) - 0.3, rtol=1e-9)


@pytest.mark.parametrize(("tilt", "cross"), [(0.05, 0.0), (0.12, 0.03), (0.02, 0.1)])
def test_edges_of_a_tilted_view_touch_the_beam(tilt: float, cross: float) -> None:
    column = COLUMN._replace(tilt=tilt, cross_tilt=cross)
    edges = np.array(sharp_receiver._edges_of_view(column)[1:])
    offset = np.hypot(0.1 - tilt * edges, cross * edges)
    touching = np.stack([0.08 * edges - 0.02, 0.08 * edges + 0.02])
    apart = np.min(np.abs(np.abs(touching) - offset), axis=0)
    assert_allclose(apart, 0, atol=1e-9)
    # Each side meets the beam twice, or never.
    path = np.linspace(1e-3, 50, 200_001)
    gap = np.hypot(0.1 - tilt * path, cross * path) - 0.08 * path
    for side in (0.02, -0.02):
        turns = path[1:][np.diff(np.sign(gap - side)) != 0]
        for turn in turns:
            assert np.min(np.abs(edges - turn)) < 1e-3


def test_light_of_a_thin_beam_is_that_of_its_rays_where_nothing_is_scattered() -> None:
    clear = COLUMN._replace(scattering=0.0, tilt=0.03, cross_tilt=0.01, standoff=0.2)
    depth = np.array([0.9, 1.2, 3.0])
    spread = table(henyey_greenstein_function(asymmetry=0.95), 1.5)
    path = depth + 0.2
    offset = np.hypot(0.1 - 0.03 * path, 0.01 * path)
    expected = [common(d, p) for d, p in zip(offset, path, strict=True)]
    found = sharp_receiver._light(depth, clear, spread)
    assert_allclose(found, np.exp(-2 * 0.1 * depth) * expected, rtol=1e-12)
    unscattered = sharp_receiver._unscattered(depth, clear._replace(scattering=0.4))
    assert_allclose(unscattered, np.exp(-2 * 0.5 * depth) * expected, rtol=1e-12)
