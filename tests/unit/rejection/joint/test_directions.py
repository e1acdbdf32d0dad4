"""Directions of a scan: as few nodes as follow what lies between them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.errors import CubeError
from amulor.rejection.joint.overlap import directions_of

AZIMUTH = np.radians([-9.5, 9.5])
ELEVATION = np.radians([-2.0, 2.0])


def bells(width: float, azimuth: np.ndarray, elevation: np.ndarray) -> np.ndarray:
    """Return bells over the direction that stand at different azimuths."""
    centre = np.radians([-6.0, 0.0, 4.0])
    square = (azimuth[:, None] - centre) ** 2 + elevation[:, None] ** 2
    return np.exp(-square / width**2)


def test_each_angle_gets_the_degree_that_it_needs() -> None:
    width = np.radians(6.0)
    found = directions_of(AZIMUTH, ELEVATION, lambda a, e: bells(width, a, e))
    # Bells of 6 degrees bend three times over 19 degrees, and hardly over 4.
    assert found.azimuth.size > 2 * found.elevation.size
    rng = np.random.default_rng(1)
    azimuth, elevation = rng.uniform(*AZIMUTH, 500), rng.uniform(*ELEVATION, 500)
    between = found.interpolation(azimuth, elevation) @ bells(width, *found.mesh)
    # 1e-4 is asked for at 25 places; the ends, where none is tried, are the worst.
    assert_allclose(between, bells(width, azimuth, elevation), atol=5e-4)


def test_the_nodes_make_up_every_polynomial_of_their_degree() -> None:
    found = directions_of(AZIMUTH, ELEVATION, lambda a, e: 1 + np.stack([a, e**2], 1))
    assert (found.azimuth.size, found.elevation.size) == (3, 3)
    azimuth, elevation = np.array([0.1, -0.02]), np.array([0.03, 0.01])
    at, up = found.mesh
    weights = found.interpolation(azimuth, elevation)
    assert_allclose(weights @ (at**2 * up), azimuth**2 * elevation, atol=1e-15)
    assert_allclose(found.centre @ np.cos(at), 1, atol=1e-4)


def test_a_scan_along_a_line_has_one_node_across() -> None:
    found = directions_of(
        AZIMUTH, np.zeros(2), lambda a, e: bells(np.radians(6.0), a, e)
    )
    assert found.elevation.size == 1


@pytest.mark.parametrize("width", [1e-3, 1e-2])
def test_a_view_that_is_far_narrower_than_the_scan_is_refused(width: float) -> None:
    with pytest.raises(CubeError, match="split the scan"):
        directions_of(AZIMUTH, ELEVATION, lambda a, e: bells(width, a, e))


def test_light_that_reaches_no_receiver_needs_the_fewest_nodes() -> None:
    found = directions_of(AZIMUTH, ELEVATION, lambda a, e: np.zeros((len(a), 3)))
    assert (found.azimuth.size, found.elevation.size) == (3, 3)
