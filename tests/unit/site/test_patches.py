"""Curved patches through points: a surface of second degree is met exactly."""

from __future__ import annotations

import numpy as np
import pytest

from amulor.site.change.distances import _patches


def tangents(normal):
    """Return two directions across a normal, from its null space."""
    return np.linalg.svd(normal[None])[2][1:]


#: Of the cylinder that holds the points [m].
RADIUS = 0.03
HALF = np.sqrt(0.5)
NORMALS = [[0.0, 0, 1], [1.0, 0, 0], [0, 1.0, 0], [0.6, -0.48, 0.64]]


@pytest.fixture(params=[*NORMALS, [HALF, HALF, 0.0], [HALF, 0.0, HALF]])
def patch(request):
    normal = np.array(request.param)
    rng = np.random.default_rng(5)
    place = rng.uniform(-0.02, 0.02, (60, 2))
    return normal, place, place @ tangents(normal)


def design(place):
    x, y = place.T
    return np.stack([np.ones_like(x), x, y, x**2, x * y, y**2], axis=1)


def test_a_bent_surface_has_its_height_at_the_middle(patch) -> None:
    normal, place, off = patch
    # Slopes of 10 degrees and radii of centimetres, seen with 0.1 mm.
    along = design(place) @ [3e-3, 0.17, -0.1, 8.0, 12.0, -5.0]
    owner = np.zeros(len(off), dtype=np.intp)
    found = _patches(owner, along, off, normal[None], np.full(len(off), 1e8), RADIUS)
    np.testing.assert_allclose(found.height, 3e-3, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.share @ along, 3e-3, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.share.sum(), 1.0, rtol=1e-6)
    assert found.good.all()


def test_its_noise_is_that_of_least_squares(patch) -> None:
    normal, place, off = patch
    sigma = np.where(np.arange(60) % 3, 1e-4, 3e-4)
    owner = np.zeros(60, dtype=np.intp)
    found = _patches(owner, np.zeros(60), off, normal[None], sigma**-2, RADIUS)
    scaled = design(place / 0.02) / sigma[:, None]
    covariance = np.linalg.inv(scaled.T @ scaled)
    np.testing.assert_allclose(found.own, np.sqrt(covariance[0, 0]), rtol=1e-5)


def test_a_point_far_off_does_not_move_it(patch) -> None:
    normal, place, off = patch
    along = design(place) @ [3e-3, 0.17, -0.1, 8.0, 12.0, -5.0]
    along[7] += 5e-3
    owner = np.zeros(60, dtype=np.intp)
    found = _patches(owner, along, off, normal[None], np.full(60, 1e8), RADIUS)
    np.testing.assert_allclose(found.height, 3e-3, rtol=0, atol=1e-9)
    assert found.share[7] == 0.0


def test_points_far_off_are_found_behind_one_another(patch) -> None:
    normal, place, off = patch
    along = design(place) @ [3e-3, 0.17, -0.1, 8.0, 12.0, -5.0]
    # The first hides the second in the scatter until it is left out.
    along[[7, 30]] += [1.0, 5e-3]
    owner = np.zeros(60, dtype=np.intp)
    found = _patches(owner, along, off, normal[None], np.full(60, 1e8), RADIUS)
    np.testing.assert_allclose(found.height, 3e-3, rtol=0, atol=1e-9)
    assert found.share[7] == found.share[30] == 0.0
