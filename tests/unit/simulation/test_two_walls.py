"""Doubly reflected light of one ray, and of a wall that takes in half of space."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.simulation import second_reflection as module
from amulor.simulation.scene import Hits
from amulor.simulation.second_reflection import _directions, second_reflection
from amulor.survey import Survey

FREQUENCY = 50e6
LIT = np.array([0.3, -0.1, 2.0])
SECOND = np.array([0.9, 0.2, 2.4])
RECEIVER = np.array([0.1, 0.05, 0.0])
#: Unit normal of the second surface.
NORMAL = np.array([-0.6, 0.0, -0.8])


class Wall:
    """Scene in which some rays of each point meet one place, all others nothing."""

    def __init__(self, share: float, seen: float, texture: float) -> None:
        self.share, self.seen, self.bright = share, seen, texture
        self.started: list[np.ndarray] = []

    def texture(self, hits: Hits) -> np.ndarray:
        return np.full(len(hits.target), self.bright)

    def cast(self, start: np.ndarray, way: np.ndarray) -> Hits:
        self.started.append(start)
        count = len(start)
        met = np.arange(count) % 512 < 512 * self.share
        return Hits(
            target=np.where(met, 1, -1),
            distance=np.where(met, np.linalg.norm(SECOND - LIT), np.inf),
            point=np.where(met[:, None], SECOND, np.nan),
            normal=np.where(met[:, None], NORMAL, np.nan),
            triangle=np.where(met, 0, -1),
        )

    def visible_fraction(self, hits: Hits, ends: Any, weight: Any) -> np.ndarray:
        assert ends.shape == (1, len(hits.target), 3)
        assert weight.tolist() == [1]
        return np.where(hits.target >= 0, self.seen, 0.0)


def lit_hits(count: int = 2) -> Hits:
    """Return a hit of the first target, and misses."""
    target = np.full(count, -1)
    target[0] = 0
    point = np.full((count, 3), np.nan)
    normal = np.full((count, 3), np.nan)
    point[0], normal[0] = LIT, (0.0, 0.0, -1.0)
    return Hits(target=target, distance=np.zeros(count), point=point, normal=normal,
                triangle=target)  # fmt: skip


def ratio(
    plate: Survey, wall: Any, receiver: np.ndarray = RECEIVER, **changes: Any
) -> np.ndarray:
    plates = [
        {"kind": "plate", "position": (0, 0, 2), "width": 1, "height": 1,
         "reflectance": value} for value in (0.4, 0.7)
    ]  # fmt: skip
    survey = plate.with_(
        {"targets": plates, "instrument.modulation_frequencies": [FREQUENCY], **changes}
    )
    water: Any = SimpleNamespace(reduced_attenuation=0.25)
    return second_reflection(
        survey, wall, lit_hits(), receiver, water=water, group_index=1.36
    )


def test_light_of_one_place_is_that_of_the_formula(plate: Survey) -> None:
    both = {"instrument.receiver.acceptance": "0.3 rad", "scan.moves": "both"}
    wall: Any = Wall(0.25, 0.5, 0.9)
    found = ratio(plate, wall, **both)
    assert found.shape == (2, 2)
    assert not found[:, 1].any()
    back, direct = RECEIVER - SECOND, RECEIVER - LIT
    back_length, direct_length = np.linalg.norm(back), np.linalg.norm(direct)
    cosine = back @ NORMAL / back_length
    assert cosine > 0.5
    longer = np.linalg.norm(SECOND - LIT) + back_length - direct_length
    # Texture and reflectance of both surfaces, and half of the receiver sees it.
    size = 0.25 * 0.5 * (0.9 * 0.4) * (0.9 * 0.7) * cosine
    size *= (direct_length / back_length) ** 2 * math.exp(-0.25 * longer)
    aside = math.acos(back @ direct / (back_length * direct_length))
    # A receiver that does not move with the beam sees the whole scene.
    still = ratio(plate, Wall(0.25, 0.5, 0.9))
    assert_allclose(still[0, 0], size, rtol=1e-9)
    size *= math.exp(-((aside / 0.3) ** 2))
    turn = 2 * math.pi * FREQUENCY * 1.36 / speed_of_light * longer
    assert_allclose(found[0, 0], size, rtol=1e-9)
    assert_allclose(found[1, 0], size * np.exp(1j * turn), rtol=1e-9)
    # Rays begin a micrometer above the lit surface.
    assert_allclose(wall.started[0], np.tile(LIT - [0, 0, 1e-6], (512, 1)), rtol=1e-12)
    each = ratio(plate, Wall(0.25, 0.5, 0.9), np.tile(RECEIVER, (2, 1)), **both)
    assert_allclose(each, found)


def test_a_surface_that_faces_away_sends_nothing_back(plate: Survey) -> None:
    behind = np.array([3.0, 0.05, 5.0])
    assert (behind - SECOND) @ NORMAL < 0
    assert not ratio(plate, Wall(0.25, 0.5, 0.9), behind).any()


def test_points_are_worked_on_in_parts(
    plate: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = ratio(plate, Wall(0.5, 1.0, 1.0))
    monkeypatch.setattr(module, "_AT_ONCE", 512)
    assert_allclose(ratio(plate, Wall(0.5, 1.0, 1.0)), whole)


def test_rays_leave_about_their_normal_by_the_cosine() -> None:
    normals = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [0.36, 0.48, 0.8]])
    rays = _directions(normals)
    assert rays.shape == (3, 512, 3)
    assert_allclose(np.linalg.norm(rays, axis=2), 1)
    for normal, ray in zip(normals, rays, strict=True):
        height = ray @ normal
        assert height.min() > 0
        # Squared sines are even between 0 and 1.
        assert_allclose(
            np.sort(1 - height**2), (np.arange(512) + 0.5) / 512, atol=1e-12
        )
        assert_allclose(ray.mean(axis=0), 2 / 3 * normal, atol=5e-3)
