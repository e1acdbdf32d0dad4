"""Planes that fit the corners of a site."""

from __future__ import annotations

import numpy as np

from amulor.site.registration.landmarks import _planes

#: Normals and distances of five planes, the first with most points.
NORMALS = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0], [0.6, 0, 0.8], [0, 0.6, 0.8]])
COUNTS = (90, 80, 70, 60, 50)


def test_the_three_planes_with_most_points_are_found() -> None:
    rng = np.random.default_rng(3)
    parts, normals = [], []
    for number, (normal, count) in enumerate(zip(NORMALS, COUNTS, strict=True)):
        across = np.linalg.svd(normal[None])[2][1:]
        inside = rng.uniform(-1, 1, (count, 2)) @ across
        parts.append(inside + (3 + number) * normal)
        normals.append(np.tile(normal, (count, 1)))
    found = _planes(np.concatenate(parts), np.concatenate(normals), 1e-6)
    assert len(found) == 3
    for (center, normal), true, distance in zip(
        found, NORMALS, (3, 4, 5), strict=False
    ):
        assert abs(abs(normal @ true) - 1) < 1e-9
        assert abs(center @ true - distance) < 1e-9
