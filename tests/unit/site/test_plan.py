"""The plan of a site joins scans by their errors, tile by tile."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import drawn_sites
import exact_scenes as scenes
import numpy as np
import pytest

from amulor.errors import CubeError
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


def test_layers_of_a_plan_are_weighted_and_counted() -> None:
    scans = [scan_of(0.5, sigma=1e-3), scan_of(0.503, sigma=2e-3, name="b")]
    scans[1] = replace(scans[1], doubtful=np.ones(len(scans[1].doubtful)))
    window = plan.bounds(scans)
    alone = [plan.orthoplan([scan], cell=0.01, window=window) for scan in scans]
    raster = plan.orthoplan(scans, cell=0.01)
    at = raster.height.shape[0] // 2, raster.height.shape[1] // 2
    # Weights of 4 and 1 for the light, and 0.8 x 1 mm and 0.2 x 2 mm for the noise.
    light = 0.8 * alone[0].amplitude[at] + 0.2 * alone[1].amplitude[at]
    assert raster.amplitude[at] == pytest.approx(light, rel=1e-9)
    own = np.hypot(0.8 * alone[0].own[at], 0.2 * alone[1].own[at])
    assert raster.own[at] == pytest.approx(own, rel=1e-9)
    # A cell is doubtful if any scan in it is.
    assert raster.layers["doubtful"][at] == 1
    assert alone[0].layers["doubtful"][at] == 0
    assert np.isnan(raster.height).any() == (raster.layers["scans"] == 0).any()


@pytest.mark.parametrize(
    ("step", "sigma", "cell", "scans"),
    [
        # Five standard errors, 5 (1, 1) mm = 7.07 mm, of cells that are small.
        (6.9e-3, 1e-3, 2e-3, 2),
        (7.2e-3, 1e-3, 2e-3, 1),
        # Or two cells.
        (0.019, 1e-3, 0.01, 2),
        (0.021, 1e-3, 0.01, 1),
    ],
)
def test_a_surface_far_above_another_hides_it(
    step: float, sigma: float, cell: float, scans: int
) -> None:
    both = [scan_of(0.5, sigma=sigma), scan_of(0.5 + step, sigma=sigma, name="b")]
    for order in (both, both[::-1]):
        raster = plan.orthoplan(order, cell=cell)
        at = raster.height.shape[0] // 2, raster.height.shape[1] // 2
        assert raster.layers["scans"][at] == scans
        expected = 0.5 + step / 2 if scans == 2 else 0.5 + step
        assert raster.height[at] == pytest.approx(expected, abs=1e-9)


def test_bounds_are_those_of_triangles_and_cells_of_a_plan_are_whole() -> None:
    scan = scan_of(0.5, sigma=1e-3)
    far = scan.surface.position.copy()
    unused = np.setdiff1d(np.arange(len(far)), scan.surface.triangles)
    far[unused] = 1e3
    scan = replace(scan, surface=replace(scan.surface, position=far))
    west, east, south, north = plan.bounds([scan])
    used = far[np.unique(scan.surface.triangles)]
    assert (west, south) == tuple(used[:, :2].min(axis=0))
    assert (east, north) == tuple(used[:, :2].max(axis=0))
    raster = plan.orthoplan([scan], cell=0.01)
    assert raster.left / 0.01 == pytest.approx(round(raster.left / 0.01))
    assert raster.left <= west < raster.left + 0.01
    assert raster.top - 0.01 < north <= raster.top
    rows, columns = raster.height.shape
    assert raster.left + 0.01 * columns >= east > raster.left + 0.01 * (columns - 1)
    assert raster.top - 0.01 * rows <= south < raster.top - 0.01 * (rows - 1)


def test_a_window_without_a_surface_is_refused() -> None:
    scan = scan_of(0.5, sigma=1e-3)
    with pytest.raises(CubeError, match="no scan has a surface in this part"):
        plan.orthoplan([scan], cell=0.01, window=(5.0, 6.0, 5.0, 6.0))


@pytest.mark.parametrize(
    ("left", "top", "rows", "columns", "inner"),
    [
        # Cells of 0.5 m of a raster of 6 x 8 from (10, 20): inside, and over each side.
        (5.5, 9.0, (2, 5), (1, 5), (slice(0, 3), slice(0, 4))),
        (4.0, 9.0, (2, 5), (0, 2), (slice(0, 3), slice(2, 4))),
        (8.5, 9.0, (2, 5), (7, 8), (slice(0, 3), slice(0, 1))),
        (5.5, 10.5, (0, 2), (1, 5), (slice(1, 3), slice(0, 4))),
        (5.5, 7.5, (5, 6), (1, 5), (slice(0, 1), slice(0, 4))),
        (1.0, 9.0, (2, 5), (0, 0), (slice(0, 3), slice(8, 8))),
    ],
)
def test_a_part_covers_the_cells_that_both_rasters_have(
    left: float, top: float, rows: tuple[int, int], columns: tuple[int, int],
    inner: tuple[slice, slice],
) -> None:  # fmt: skip
    part = SimpleNamespace(left=left, top=top, height=np.zeros((3, 4)))
    found = plan._overlap(part, (6, 8), 0.5, 10.0, 20.0)
    assert found[:2] == (slice(*rows), slice(*columns))
    assert found[2] == inner


def test_small_parts_of_an_outline_and_gaps_are_not_drawn() -> None:
    scan = scan_of(0.5, sigma=1e-3)
    x, y = scan.surface.position[scan.surface.triangles].mean(axis=1)[:, :2].T
    middle = (np.abs(x) < 2.5e-3) & (np.abs(y) < 8e-3)

    def outlines(keep: np.ndarray) -> list[np.ndarray]:
        triangles = scan.surface.triangles[keep]
        part = replace(scan.surface, triangles=triangles)
        return plan.footprint(replace(scan, surface=part), cell=1e-3)

    assert outlines(x > np.inf) == []
    # A hole is no outline, and neither is a gap of five cells between two halves.
    assert len(outlines(~middle)) == 1
    assert len(outlines(np.abs(x) > 2.5e-3)) == 1
    assert len(outlines(np.abs(x) > 8e-3)) == 2
    # Of an area of 120 mm x 80 mm, a fiftieth is 14 mm x 14 mm.
    for size, count in ((3e-3, 1), (11e-3, 2)):
        corner = (x > x.max() - 2 * size) & (y > y.max() - 2 * size)
        assert len(outlines(corner | (x < x.max() - 2 * size - 0.02))) == count
