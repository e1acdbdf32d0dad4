"""Light starts around the place of its source, across its axis, tilted or not."""

from __future__ import annotations

import numpy as np

from amulor.transport._kernels.batch import launch
from amulor.transport._kernels.types import Beam
from amulor.transport._runs import random_state

CENTRE = np.array([0.3, -0.2, 0.1])
AXIS = np.array([0.36, 0.48, 0.8])
#: Perpendicular to it, and not along an axis of the scene.
ACROSS = np.array([0.8, -0.6, 0.0])
MANY = 20_000


def drawn(*, radius: float, divergence: float) -> tuple[np.ndarray, ...]:
    beam = Beam(
        centre=CENTRE, axis=AXIS, across=ACROSS, radius=radius, divergence=divergence,
        stokes=np.array([1.0, 0, 0, 0]),
    )  # fmt: skip
    state = random_state(7, 0)
    rays = [launch.py_func(state, beam) for _ in range(MANY)]
    return tuple(np.array([ray[part] for ray in rays]) for part in range(3))


def test_places_have_the_moments_of_a_tilted_gaussian_beside_the_axis() -> None:
    radius = 0.05
    place, direction, across = drawn(radius=radius, divergence=0.0)
    np.testing.assert_array_equal(direction, np.broadcast_to(AXIS, (MANY, 3)))
    np.testing.assert_array_equal(across, np.broadcast_to(ACROSS, (MANY, 3)))
    off = place - CENTRE
    np.testing.assert_allclose(off @ AXIS, 0, atol=1e-15)
    # exp(-r^2 / R^2) has no mean and R^2 / 2 along each of two directions: in the
    # scene R^2 / 2 (1 - n n^T). Four standard errors, those of R^2 r^2 at most.
    bound = 4 * radius / np.sqrt(2 * MANY)
    assert np.all(np.abs(off.mean(axis=0)) < bound)
    expected = radius**2 / 2 * (np.eye(3) - np.outer(AXIS, AXIS))
    assert np.all(np.abs(off.T @ off / MANY - expected) < 4 * radius**2 / MANY**0.5)


def test_directions_have_the_moments_of_a_tilted_cone() -> None:
    spread = 0.1
    place, direction, across = drawn(radius=0.0, divergence=spread)
    np.testing.assert_array_equal(place, np.broadcast_to(CENTRE, (MANY, 3)))
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(np.sum(across * direction, axis=1), 0, atol=1e-12)
    theta = np.linspace(0, 1, 20_001)
    weight = np.sin(theta) * np.exp(-((theta / spread) ** 2))
    weight /= weight.sum()
    along, aside = weight @ np.cos(theta), weight @ np.sin(theta) ** 2 / 2
    mean = direction.mean(axis=0)
    assert np.all(np.abs(mean - along * AXIS) < 4 * spread / np.sqrt(2 * MANY))
    flat = direction - np.outer(direction @ AXIS, AXIS)
    expected = aside * (np.eye(3) - np.outer(AXIS, AXIS))
    assert np.all(np.abs(flat.T @ flat / MANY - expected) < 4 * spread**2 / MANY**0.5)
    # The frame turns the shortest way: on the mean it stays where it was.
    turned = across.mean(axis=0) / np.linalg.norm(across.mean(axis=0))
    np.testing.assert_allclose(turned, ACROSS, atol=0.01)
