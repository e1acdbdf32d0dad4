"""Volumes over a plane against those of boxes and pyramids."""

from __future__ import annotations

import exact_shapes as shapes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.imaging import measure

#: Distance of the plane, height of the box over it [m].
FAR, HIGH = 1.5, 0.08
ROWS, COLUMNS = 48, 64


def fan() -> shapes.Beams:
    return shapes.beams(rows=ROWS, columns=COLUMNS)


def slopes(scan: shapes.Beams) -> tuple[np.ndarray, np.ndarray]:
    """Right and down of each beam per forward."""
    unit = scan.unit
    return unit[..., 0] / unit[..., 2], unit[..., 1] / unit[..., 2]


def box(scan: shapes.Beams) -> tuple[np.ndarray, np.ndarray]:
    """Return ranges of a box before a plane, seen from the front, and its pixels."""
    right, down = slopes(scan)
    top = (np.abs(right) < 0.08) & (np.abs(down) < 0.06)
    forward = np.where(top, FAR - HIGH, FAR)
    return forward / scan.unit[..., 2], top


def everywhere(margin: int = 2) -> np.ndarray:
    mask = np.zeros((ROWS, COLUMNS), dtype=bool)
    mask[margin:-margin, margin:-margin] = True
    return mask


def visible_volume(scan: shapes.Beams, top: np.ndarray) -> float:
    """Return the volume of the box and its shadow: a cone of beams between two planes.

    Edges are midway between pixels. The cone from the instrument to the plane with the
    slopes a and b has the volume a b z^3 / 3.
    """
    right, down = slopes(scan)
    row, column = np.nonzero(top)
    middle = (row[len(row) // 2], column[len(column) // 2])
    across = right[middle[0]]
    along = down[:, middle[1]]
    first, last = column.min(), column.max()
    upper, lower = row.min(), row.max()
    wide = (across[last] + across[last + 1] - across[first - 1] - across[first]) / 2
    tall = (along[lower] + along[lower + 1] - along[upper - 1] - along[upper]) / 2
    return wide * tall * (FAR**3 - (FAR - HIGH) ** 3) / 3


def away(top: np.ndarray) -> np.ndarray:
    """Return the pixels of the plane, apart from those near the box."""
    wide = np.zeros_like(top)
    row, column = np.nonzero(top)
    wide[row.min() - 3 : row.max() + 4, column.min() - 3 : column.max() + 4] = True
    return everywhere() & ~wide


def test_a_box_on_a_plane_has_its_volume() -> None:
    scan = fan()
    ranges, top = box(scan)
    image = shapes.image(scan, ranges)
    found = measure.volume(image, everywhere(), base=away(top))
    true = visible_volume(scan, top)
    assert found.unit == "m3"
    # About the base of the box, 0.24 m x 0.18 m, by its height.
    assert true == pytest.approx(0.16 * FAR * 0.12 * FAR * HIGH, rel=0.1)
    # Straight walls between pixels instead of walls along beams: half a pixel of 5 mm
    # at one end of the wall, against 0.2 m.
    assert found.value == pytest.approx(true, rel=0.01)
    assert abs(found.value - true) < found.uncertainty


def test_a_coarse_grid_has_the_volume_of_its_own_cells() -> None:
    scan = fan()
    ranges, top = box(scan)
    image = shapes.image(scan, ranges)
    rows, columns = np.arange(3, ROWS - 2, 2), np.arange(3, COLUMNS - 2, 3)
    mask = np.zeros((ROWS, COLUMNS), dtype=bool)
    mask[np.ix_(rows, columns)] = True
    found = measure.volume(
        image, mask, base=away(top), grid=(rows.tolist(), columns.tolist())
    )
    # The image of these pixels alone has the same cells; its base is a plane as well.
    alone = image.isel(row=rows, column=columns)
    base = away(top)[np.ix_(rows, columns)]
    expected = measure.volume(alone, np.ones(base.shape, dtype=bool), base=base)
    assert found.value == pytest.approx(expected.value, rel=1e-6)
    assert abs(found.value - visible_volume(scan, top)) < 3 * found.uncertainty
    full = measure.volume(image, everywhere(), base=away(top))
    assert found.uncertainty > full.uncertainty


def test_a_plane_alone_has_no_volume_whatever_its_tilt() -> None:
    scan = fan()
    for normal in ([0.0, 0.0, 1.0], [0.4, -0.3, 0.9]):
        vector = np.array(normal) / np.linalg.norm(normal)
        image = shapes.image(scan, shapes.to_plane(scan, vector, FAR))
        found = measure.volume(image, everywhere(), base=everywhere(8))
        assert abs(found.value) < 1e-9


def test_a_pyramid_under_an_inclined_view_has_its_volume() -> None:
    # A wedge of two planes over a third one: a prism of which the cross section is a
    # triangle. The ridge is along the rows of the scan.
    scan = fan()
    right, down = slopes(scan)
    # Heights over z = FAR of a roof |y| < 0.1 m with slope 0.5, by intersection.
    ranges = np.full((ROWS, COLUMNS), FAR) / scan.unit[..., 2]
    for sign in (-1, 1):
        # z = FAR - 0.5 (0.1 - sign y), on sign y > 0
        forward = (FAR - 0.05) / (1 - 0.5 * sign * down)
        place = sign * down * forward
        on = (place >= 0) & (place < 0.1)
        ranges = np.where(on, forward / scan.unit[..., 2], ranges)
    image = shapes.image(scan, ranges)
    mask = np.zeros((ROWS, COLUMNS), dtype=bool)
    mask[2:-2, 10:54] = True
    base = np.abs(down * FAR) > 0.12
    found = measure.volume(image, mask, base=base)
    # Columns are planes through the instrument: the prism is as wide as they are apart
    # at each height, (2/3 of the area at the base, 1/3 over it: mean height 0.05/3).
    wide = float(right[ROWS // 2, 53] - right[ROWS // 2, 10])
    true = 0.1 * 0.05 * wide * (FAR - 0.05 / 3)
    # Ends of rows bend by the cosine of elevation; the ridge lies between pixels.
    assert found.value == pytest.approx(true, rel=0.02)


def test_the_volume_is_covered() -> None:
    """As often inside its interval as stated, with noise and shared errors drawn."""
    scan = fan()
    ranges, top = box(scan)
    base = away(top)
    exact = measure.volume(shapes.image(scan, ranges), everywhere(), base=base)
    found, scatter = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        drawn = shapes.image(scan, ranges + shapes.errors(ranges, rng))
        one = measure.volume(drawn, everywhere(), base=base)
        found.append(one.value)
        scatter.append(one)
    # The edges are the same in all draws; their variance is what is stated with
    # errors of nothing.
    none = shapes.image(scan, ranges)
    for name in none.data_vars:
        if str(name).startswith("slant_range_"):
            none[name] = none[name] * 1e-6
    edges = measure.volume(none, everywhere(), base=base).uncertainty
    stated = np.sqrt(np.mean([one.uncertainty**2 for one in scatter]) - edges**2)
    # The standard error of a standard deviation of 60 draws is 9.2 %.
    assert np.std(found) == pytest.approx(stated, rel=0.37)
    assert np.mean(found) == pytest.approx(
        exact.value, abs=4 * stated / np.sqrt(len(found))
    )


def test_mixed_pixels_of_an_edge_are_bridged() -> None:
    scan = fan()
    ranges, top = box(scan)
    image = shapes.image(scan, ranges)
    clean = measure.volume(image, everywhere(), base=away(top))
    flagged = image.copy(deep=True)
    row, column = np.nonzero(top)
    rim = np.zeros_like(top)
    rim[row.min() : row.max() + 1, column.min()] = True
    rim[row.min(), column.min() : column.max() + 1] = True
    flagged["quality_flag"].values[rim] |= int(QualityFlag.MIXED)
    flagged["slant_range"].values[rim] -= 0.5
    found = measure.volume(flagged, everywhere(), base=away(top))
    # The edge may now lie anywhere in two pixels instead of one.
    assert found.uncertainty > clean.uncertainty
    assert abs(found.value - clean.value) < found.uncertainty
    # Each edge moves by up to half a pixel: of 34 and 26 across.
    assert found.value == pytest.approx(clean.value, rel=0.04)


def test_the_shared_error_of_a_volume_is_that_of_all_ranges() -> None:
    """Ranges that are all too long by the same make a larger body farther away."""
    scan = fan()
    ranges, top = box(scan)
    base = away(top)
    apart = 1e-4
    changed = [
        measure.volume(shapes.image(scan, ranges + step), everywhere(), base=base)
        for step in (-apart, apart)
    ]
    slope = (changed[1].value - changed[0].value) / (2 * apart)
    image = shapes.image(scan, ranges)
    for name in image.data_vars:
        if str(name).startswith("slant_range_"):
            image[name] = image[name] * 1e-6
    edges = measure.volume(image, everywhere(), base=base).uncertainty
    shift = 2e-3
    image["slant_range_uncertainty_delay"] = xr.full_like(image["slant_range"], shift)
    image["slant_range_common_uncertainty"] = xr.full_like(image["slant_range"], shift)
    image["slant_range_uncertainty"] = xr.full_like(image["slant_range"], shift)
    found = measure.volume(image, everywhere(), base=base)
    shared = np.sqrt(found.uncertainty**2 - found.random**2 - edges**2)
    assert_allclose(shared, abs(slope) * shift, rtol=0.02)


def test_a_base_that_is_no_plane_and_an_empty_region_are_refused() -> None:
    scan = fan()
    ranges, top = box(scan)
    image = shapes.image(scan, ranges)
    with pytest.raises(CubeError, match="the base is no plane: does not fit"):
        measure.volume(image, everywhere(), base=everywhere())
    nothing = np.zeros_like(top)
    with pytest.raises(CubeError, match="the region has no pixel"):
        measure.volume(image, nothing, base=away(top))
    line = nothing.copy()
    line[5] = True
    with pytest.raises(CubeError, match="no cell of four pixels"):
        measure.volume(image, line, base=away(top))
    with pytest.raises(CubeError, match="they must agree"):
        measure.volume(image, nothing[1:], base=away(top))
