"""What scans of a moved body tell together of its motion, and what they do not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import sparse

from amulor.site.change import moved
from amulor.site.registration.pair import Pair

RADIUS, LENGTH = 0.1, 0.4
MIDDLE = np.array([1.0, 2.0, 3.0])


def pair_of(first: float, last: float, **changes: Any) -> Pair:
    """Return what two scans tell of a tube along x that they see from a side [rad]."""
    along, around = np.meshgrid(
        np.linspace(-LENGTH / 2, LENGTH / 2, 9), np.linspace(first, last, 12)
    )
    normal = np.stack([0 * around, np.cos(around), np.sin(around)], axis=-1)
    place = RADIUS * normal + along[..., None] * [1.0, 0.0, 0.0]
    place, normal = place.reshape(-1, 3) + MIDDLE, normal.reshape(-1, 3)
    pivot = place.mean(axis=0)
    rows = np.hstack([normal, np.cross(place - pivot, normal)])
    size = len(rows)
    fields = {
        "source": "b", "target": "a", "keys": (), "pivot": pivot, "place": place,
        "distance": np.zeros(size), "weight": np.full(size, 1e6), "by_target": rows,
        "by_source": rows, "along": np.ones(size), "source_pixel": np.arange(size),
        "window": sparse.csr_matrix((size, 1)), "misfit": 1.0, "held": np.eye(6),
        "loose": (), "unsure": 1e-3, "moved": np.zeros(0, dtype=int),
    }  # fmt: skip
    return Pair(**{**fields, **changes})


@pytest.mark.parametrize("sides", [[(0.2, 1.0), (1.4, 2.4)], [(0.0, 3.0)]])
def test_a_tube_tells_neither_its_slide_nor_its_turn_about_its_axis(
    sides: list[tuple[float, float]],
) -> None:
    held, loose = moved._held([pair_of(*side) for side in sides], MIDDLE)
    # Both lie in what was found: a slide along x, a turn about x through the middle.
    assert len(loose) == 2
    for motion in ([1.0, 0, 0, 0, 0, 0], [0, 0, 0, 1.0, 0, 0]):
        np.testing.assert_allclose(held @ motion, 0.0, atol=1e-9)
        share = np.linalg.lstsq(np.stack(loose, axis=1), motion, rcond=None)[1]
        np.testing.assert_allclose(share, 0.0, atol=1e-12)
    # All else is held as it is.
    for motion in np.eye(6)[[1, 2, 4, 5]]:
        np.testing.assert_allclose(held @ motion, motion, atol=1e-9)


def test_what_single_pairs_do_not_hold_is_no_matter_where_others_do() -> None:
    sides = [(0.2, 1.0), (1.4, 2.4)]
    # Each by itself would leave out other directions; together they are not asked.
    spoiled = [np.diag([0.0, 0, 1, 1, 1, 1]), np.diag([0.0, 1, 0, 1, 1, 1])]
    pairs = [pair_of(*side) for side in sides]
    other = [pair_of(*side, held=one) for side, one in zip(sides, spoiled, strict=True)]
    for whole, one in zip(
        moved._sums(pairs, MIDDLE, np.eye(6), steady=False),
        moved._sums(other, MIDDLE, np.eye(6), steady=False),
        strict=True,
    ):
        np.testing.assert_array_equal(whole, one)
