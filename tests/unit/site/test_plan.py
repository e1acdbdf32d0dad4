"""The plan of a site joins scans by their errors, tile by tile."""

from __future__ import annotations

from dataclasses import replace

import drawn_sites
import exact_scenes as scenes
import numpy as np
import pytest

from amulor.imaging import Frame, products
from amulor.site.merging import plan
from amulor.site.merging.plan import PlacedScan

#: Axes of an instrument that looks straight down from a height of 2 m.
DOWN = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])


def scan_of(
    height: float, *, sigma: float, name: str = "a", east: float = 0.0
) -> PlacedScan:
    """Return a level surface of 0.12 m width at a height, with equal errors."""
    place = np.array([east, 0.0, 2.0])
    image = scenes.plane((0, 0, 1), 2.0 - height, own=sigma)
    frame = Frame(name="pose", rotation=DOWN, position=place)
    surface = products.surface(image, frame=frame)
    count = len(surface.position)
    return PlacedScan(
        name=name,
        epoch="one",
        surface=surface,
        upward=np.full(count, sigma),
        doubtful=np.zeros(count),
        moving=0,
    )


def test_heights_of_two_scans_are_weighted_by_their_errors() -> None:
    scans = [scan_of(0.5, sigma=1e-3), scan_of(0.503, sigma=2e-3, name="b")]
    raster = plan.orthoplan(scans, cell=0.01)
    middle = raster.height.shape[0] // 2, raster.height.shape[1] // 2
    # Weights of 4 and 1.
    assert raster.height[middle] == pytest.approx(0.5006, abs=1e-9)
    assert raster.uncertainty[middle] == pytest.approx(1.2e-3, rel=1e-9)
    assert raster.layers["scans"][middle] == 2


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_the_upper_of_two_surfaces_is_drawn(order) -> None:
    scans = [scan_of(0.5, sigma=1e-3), scan_of(0.8, sigma=3e-3, name="b")]
    raster = plan.orthoplan([scans[n] for n in order], cell=0.01)
    middle = raster.height.shape[0] // 2, raster.height.shape[1] // 2
    assert raster.height[middle] == pytest.approx(0.8, abs=1e-9)
    assert raster.layers["scans"][middle] == 1


def test_tiles_are_parts_of_the_whole_plan() -> None:
    scans = [
        scan_of(0.5, sigma=1e-3),
        scan_of(0.502, sigma=1e-3, name="b", east=0.05),
    ]
    cell = 0.005
    whole = plan.orthoplan(scans, cell=cell)
    left = 0.02
    tile = plan.orthoplan(scans, cell=cell, window=(left, 0.07, -0.02, 0.02))
    row = round((whole.top - tile.top) / cell)
    column = round((tile.left - whole.left) / cell)
    rows, columns = tile.height.shape
    part = np.s_[row : row + rows, column : column + columns]
    np.testing.assert_allclose(tile.height, whole.height[part], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(tile.layers["scans"], whole.layers["scans"][part])
    assert (rows, columns) == (8, 10)


def test_the_footprint_is_the_outline_of_the_scan() -> None:
    scan = scan_of(0.5, sigma=1e-3)
    (outline,) = plan.footprint(scan, cell=0.001)
    x, y = outline.T
    area = 0.5 * abs(float(x @ np.roll(y, 1) - y @ np.roll(x, 1)))
    # Beams to 40 mrad right and 27 mrad up, 1.5 m above the surface.
    expected = 4 * 1.5**2 * np.tan(0.04) * np.tan(0.04 * 20 / 30) / np.cos(0.04)
    assert area == pytest.approx(expected, rel=0.05)


def test_an_error_that_all_scans_share_is_no_error_against_the_first() -> None:
    drawn = drawn_sites.one_visit("plane", 3, rows=24)
    truth = drawn_sites.known_registration(drawn)
    names = [scan.name for scan in drawn.site.scan]
    count = len(truth.covariance)
    size = count + 6 * len(names)
    covariance = np.zeros((size, size))
    places = dict(truth.places)
    for number, name in enumerate(names):
        places[f"pose {name}"] = (count + 6 * number, count + 6 * number + 6)
    # The whole site may lie 20 mm higher; scan 2 alone another 3 mm.
    up = [places[f"pose {name}"][0] + 2 for name in names]
    covariance[np.ix_(up, up)] = 0.02**2
    covariance[up[1], up[1]] += 0.003**2
    registration = replace(truth, places=places, covariance=covariance)
    scans = plan.placed(drawn.site, registration, drawn.surfaces, drawn.images)
    for scan, extra in zip(scans[:3], (0.0, 0.003, 0.0), strict=True):
        noise = scan.surface.own * scan.surface.direction[:, 2]
        np.testing.assert_allclose(scan.upward, np.hypot(noise, extra), atol=1e-9)
