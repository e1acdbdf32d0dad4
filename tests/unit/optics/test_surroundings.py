"""Light beside a beam and the view of a receiver there, in closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.optics._spot import Spot
from amulor.optics._surroundings import Surroundings
from amulor.optics.phase_functions.models import henyey_greenstein_function

NARROW = henyey_greenstein_function(asymmetry=0.999)
DEPTH, STANDOFF = np.exp(0.7), 0.3
VIEW: dict[str, Any] = {
    "phase_function": NARROW,
    "split_angle": 0.03,
    "scattering": 0.0,
    "absorption": 0.0,
    "standoff": np.array([STANDOFF]),
    "beam_radius": 0.05,
    "beam_divergence": 0.03,
    "receiver_radius": 0.04,
    "acceptance_angle": 0.08,
}


def surroundings(*, baseline: float = 0.0, tilt: float = 0.0) -> Surroundings:
    """Return two pixels, one straight ahead and one aside, and a receiver."""
    ahead = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8]])
    sight = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    across = np.array([[1.0, 0.0, 0.0], [0.8, 0.0, -0.6]])
    # The same view of each: a baseline and a tilt across its beam.
    sights = np.cos(tilt) * ahead - np.sin(tilt) * across
    assert sight.shape == (3,)
    return Surroundings(
        np.array([[0.0, 0.0, 0.0], [0.5, -0.2, 0.1]]),
        ahead,
        np.array([DEPTH, DEPTH]),
        sight_start=np.array([[0, 0, 0], [0.5, -0.2, 0.1]]) + baseline * across,
        sight=sights,
    )


def spot(**changes: Any) -> Spot:
    return Spot(
        **{
            "phase_function": NARROW,
            "split_angle": 0.03,
            "scattering": 0.0,
            "depth": np.array([DEPTH]),
            "way": np.array([DEPTH + STANDOFF]),
            "radius": 0.0,
            "semi_angle": 0.05,
        }
        | changes
    )


# ------------------------------------------------------------------ one cross-section


def test_light_of_a_point_has_the_phase_of_its_longer_way() -> None:
    rate, way, gamma = -0.3 + 8j, DEPTH + STANDOFF, 0.05
    power, square = spot().unscattered(rate)
    r = np.array([0.0, 0.05, 0.15])
    found = power * np.exp(-(r**2) / square) / square
    expected = np.exp(-((r / (gamma * way)) ** 2) + rate * r**2 / (2 * way))
    assert_allclose(found, expected / (gamma * way) ** 2, rtol=1e-12)


def test_width_of_a_beam_adds_its_radius_and_loses_what_is_scattered() -> None:
    power, square = spot(radius=0.03, scattering=0.7).unscattered(0j)
    fraction, _ = NARROW.forward_split(0.03)
    assert_allclose(power, np.exp(-0.7 * fraction * DEPTH), rtol=1e-12)
    assert_allclose(square, 0.03**2 + (0.05 * (DEPTH + STANDOFF)) ** 2, rtol=1e-12)


def test_light_that_is_scattered_often_is_a_gaussian() -> None:
    water = spot(scattering=40.0, semi_angle=0.0, radius=0.01)
    fraction, moment = NARROW.forward_split(0.03)
    # The mean square of the distance grows with the cube of the depth. Of 80
    # scatterings the tails are a few percent.
    square = 0.01**2 + 40 * fraction * moment * DEPTH**3 / 3
    distance = np.sqrt(square) * np.array([[0.3, 0.8, 1.2]])
    found = water.scattered(distance, 1e-4j)
    expected = np.exp(-(distance**2) / square) / (np.pi * square)
    assert_allclose(found.real, expected, rtol=0.12)
    assert_allclose(found.imag, 0, atol=1e-3 * expected.max())


@pytest.mark.parametrize("semi_angle", [0.0, 0.02])
def test_scattered_and_unscattered_light_are_all_of_the_light(
    semi_angle: float,
) -> None:
    water = spot(scattering=0.5, semi_angle=semi_angle, radius=0.01)
    distance = np.geomspace(1e-5, 0.4, 300)[None]
    light = water.scattered(distance, 1e-4j)[0].real
    power, _ = water.unscattered(1e-4j)
    total = np.trapezoid(2 * np.pi * distance[0] ** 2 * light, np.log(distance[0]))
    assert_allclose(total, 1 - power.real[0], rtol=0.015)


def test_cross_sections_of_several_depths_are_what_each_is_alone() -> None:
    depth = np.array([1.0, 2.5])
    options: dict[str, Any] = {"scattering": 0.8, "radius": 0.01}
    distance = np.array([[0.01, 0.03, 0.1], [0.02, 0.05, 0.2]])
    both = spot(depth=depth, way=depth + 0.2, **options).scattered(distance, -0.1 + 2j)
    for k in range(2):
        one = spot(depth=depth[k : k + 1], way=depth[k : k + 1] + 0.2, **options)
        alone = one.scattered(distance[k : k + 1], -0.1 + 2j)
        assert_allclose(both[k], alone[0], rtol=0.01)


# ------------------------------------------------------------------------- pixels


def summed(pixels: Surroundings, wavenumber: float = 0.0, **changes: Any) -> np.ndarray:
    """Return all light that is seen, middle and rings, shape (beam,)."""
    middle, rings = pixels.weights(VIEW | changes, np.array([wavenumber]))
    return middle[0] + sum(weights[0].sum(axis=0) for _, weights in rings)


@pytest.mark.parametrize(
    ("baseline", "tilt"), [(0.0, 0.0), (0.15, 0.0), (0.1, 0.06), (0.0, -0.05)]
)
def test_light_that_is_seen_in_clear_water_is_the_overlap_of_two_gaussians(
    baseline: float, tilt: float
) -> None:
    beam = 0.05**2 + (0.03 * DEPTH) ** 2
    view = 0.04**2 + (0.08 * (DEPTH + STANDOFF)) ** 2
    offset = baseline - np.tan(tilt) * DEPTH
    expected = np.exp(-(offset**2) / (beam + view)) / (np.pi * (beam + view))
    found = summed(surroundings(baseline=baseline, tilt=tilt))
    assert_allclose(found.real, expected, rtol=0.01)


def test_absorption_and_phase_are_those_of_the_way_along_the_view() -> None:
    pixels = surroundings(baseline=0.2, tilt=0.1)
    narrow = {"receiver_radius": 0.3, "acceptance_angle": 1e-6, "beam_divergence": 0.0}
    still, slow = (
        pixels.weights(VIEW | narrow | change, np.array([0.0]))[1]
        for change in ({}, {"absorption": 0.7})
    )
    _, fast = pixels.weights(VIEW | narrow, np.array([5.0]))
    for (aside, one), (_, absorbed), (_, turned) in zip(still, slow, fast, strict=True):
        along = np.sum((aside - pixels.axis) * pixels.sight, axis=-1)
        assert_allclose(absorbed[0], one[0] * np.exp(-0.7 * along), rtol=1e-3)
        assert_allclose(turned[0], one[0] * np.exp(5j * along), rtol=2e-3)


def test_rings_hold_the_light_of_a_gaussian_between_their_edges() -> None:
    pixels = surroundings()
    _, rings = pixels.weights(
        VIEW | {"receiver_radius": 50.0, "acceptance_angle": 1e-6}, np.array([0.0])
    )
    radius = np.geomspace(2e-3, 1.0, 20) * DEPTH
    half = np.sqrt(radius[1] / radius[0])
    square = 0.05**2 + (0.03 * DEPTH) ** 2
    for number, (aside, weights) in enumerate(rings):
        assert aside.shape == (16, 2, 3)
        assert_allclose(np.linalg.norm(aside, axis=-1), radius[number], rtol=1e-12)
        assert_allclose(np.sum(aside * pixels.ahead, axis=-1), 0, atol=1e-12)
        assert_allclose(aside.sum(axis=0), 0, atol=1e-12)
        edges = radius[number] / half, radius[number] * half
        share = np.subtract(*(np.exp(-(edge**2) / square) for edge in edges))
        expected = share / (np.pi * 50.0**2)
        assert_allclose(weights[0].sum(axis=0).real, expected, rtol=2e-3, atol=1e-12)
    assert number == 19


def test_each_ring_is_turned_against_the_one_before() -> None:
    _, rings = surroundings().weights(VIEW, np.array([0.0]))
    first, second = (next(rings)[0][:, 0] for _ in range(2))
    angles = [np.unwrap(np.arctan2(part[:, 1], part[:, 0])) for part in (first, second)]
    for angle in angles:
        assert_allclose(np.abs(np.diff(angle)), 2 * np.pi / 16, rtol=1e-9)
    turn = (angles[1][0] - angles[0][0]) % (2 * np.pi / 16)
    golden = np.pi * (3 - np.sqrt(5)) / 16
    assert min(abs(turn - golden), abs(turn - 2 * np.pi / 16 + golden)) < 1e-9


def test_a_ray_of_no_width_is_all_in_the_middle() -> None:
    narrow = {"beam_radius": 0.0, "beam_divergence": 0.0, "receiver_radius": 20.0}
    pixels = surroundings()
    middle, rings = pixels.weights(
        VIEW | narrow | {"acceptance_angle": 1e-6}, np.array([0.0])
    )
    assert_allclose(middle[0].real, 1 / (np.pi * 400), rtol=1e-3)
    assert all(np.all(weights == 0) for _, weights in rings)


def test_scattered_light_is_spread_over_the_rings() -> None:
    # A receiver that sees all alike: the power of the middle and of the rings is one.
    wide = {"receiver_radius": 50.0, "acceptance_angle": 1e-6, "beam_divergence": 0.0}
    water = {"phase_function": henyey_greenstein_function(asymmetry=0.98)}
    water |= {"split_angle": np.pi / 2, "scattering": 0.8}
    pixels = surroundings()
    middle, rings = pixels.weights(VIEW | wide | water, np.array([0.0]))
    parts = np.array([weights[0].sum(axis=0).real for _, weights in rings])
    fraction, _ = water["phase_function"].forward_split(np.pi / 2)
    # The view is scattered as well, and its losses beyond the rings are small.
    total = (middle[0].real + parts.sum(axis=0)) * np.pi * 50.0**2
    assert_allclose(total, 1.0, rtol=0.05)
    # More than the unscattered share is within a few widths of the beam.
    near = (middle[0].real + parts[:12].sum(axis=0)) * np.pi * 50.0**2
    assert np.all(near > np.exp(-0.8 * fraction * DEPTH))


def test_ways_to_places_aside_are_those_of_points() -> None:
    pixels = surroundings()
    aside = np.array([[[0.3, 0.4, 0.0], [0.0, 0.5, 0.0]]])
    length, direction = pixels.ways(aside)
    assert_allclose(length, np.full((1, 2), np.hypot(DEPTH, 0.5)))
    expected = np.array([[0.3, 0.4, DEPTH], [0.6 * DEPTH, 0.5, 0.8 * DEPTH]])
    assert_allclose(direction[0], expected / np.hypot(DEPTH, 0.5))
