"""Volumes of bumps with steep flanks are what they are, and have the error stated."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import underwater_sites as oracle
from drawn_sites import DrawnSite, known_registration, two_visits

from amulor.site.change.distances import change, region_of, regions
from amulor.site.merging.cloud import Merged, merge

#: Almost nothing shared: the poses are true, and change is that of the surface.
NOISE = oracle.Noise(own=1e-3, delay=1e-5, index=1e-6, reference=1e-5)
#: Of a plateau with flanks by a smooth step: 16 x 16 cm of its height [m^2].
PLATEAU = 0.16**2


@cache
def bumped(height: float) -> tuple[DrawnSite, Merged]:
    rng = np.random.default_rng(1)
    before = oracle.bed(rng, high=(0.03, 0.08))
    after = replace(before, bump=height, middle=(0.1, 0.05))
    drawn = two_visits(before, after, rng, rows=70, noise=NOISE)
    cloud = merge(drawn.site, known_registration(drawn), drawn.surfaces, drawn.images)
    return drawn, cloud


@pytest.mark.parametrize(
    "height",
    [0.01, *(pytest.param(h, marks=pytest.mark.slow) for h in (0.002, -0.02, 0.05))],
)
def test_the_volume_of_a_bump_is_within_its_stated_error(height: float) -> None:
    drawn, cloud = bumped(height)
    found = change(drawn.site, known_registration(drawn), drawn.surfaces, cloud)
    place = regions(found)[0]
    true = height * PLATEAU
    assert abs(place.volume - true) < 2.5 * place.volume_uncertainty
    assert place.volume_uncertainty < 0.06 * abs(true) + 4e-6
    # The whole bump was seen, and its flanks are compared.
    assert place.lost < 0.05 * PLATEAU
    assert np.linalg.norm(place.centre[:2] - [0.1, 0.05]) < 0.03


def test_what_cannot_be_compared_is_stated_beside_the_volume() -> None:
    drawn, cloud = bumped(0.01)
    found = change(drawn.site, known_registration(drawn), drawn.surfaces, cloud)
    place = regions(found)[0]
    off = np.linalg.norm(found.position[:, :2] - [0.1, 0.05], axis=1)
    # In the rim: places of the bump that are no significant ones.
    rim = np.isfinite(found.value) & (off < 0.11)
    rim[place.members] = False
    hole = np.flatnonzero(rim)
    assert len(hole) > 0
    blind = np.where(np.isin(np.arange(len(off)), hole), np.nan, found.value)
    some = region_of(replace(found, value=blind), place.members)
    assert some.lost - place.lost == pytest.approx(found.area[hole].sum())
    # The volume there is that of its neighbors, with a larger error.
    assert abs(place.volume - some.volume) < 3 * some.volume_uncertainty
    assert some.volume_uncertainty > place.volume_uncertainty
    assert some.area_uncertainty > place.area_uncertainty


def test_cells_of_a_level_surface_add_up_to_its_area() -> None:
    # Cells were cubes: of a bed on a face of cubes, noise filled those on both sides.
    rng = np.random.default_rng(2)
    drawn = two_visits(oracle.Bed(), oracle.Bed(), rng, rows=50, count=2, noise=NOISE)
    cloud = merge(drawn.site, known_registration(drawn), drawn.surfaces, drawn.images)
    found = change(drawn.site, known_registration(drawn), drawn.surfaces, cloud)
    inside = np.abs(found.position[:, :2]).max(axis=1) < 0.3
    assert found.area[inside].sum() == pytest.approx(0.36, rel=0.12)
