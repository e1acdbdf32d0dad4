"""Rasters, contours, surfaces and deviations of a few triangles, by hand."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm

from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.imaging.frame import frame_of
from amulor.imaging.products.deviation import (
    _barycentric,
    _met,
    _significant,
    deviation,
)
from amulor.imaging.products.raster import Raster, contours, gains, raster
from amulor.imaging.products.surface import Plane, Surface, plane_of, surface
from amulor.survey import Pose

module = sys.modules["amulor.imaging.products.raster"]
IMAGE = scenes.plane((0, 0, 1), 1.5, rows=4, columns=5)
FRAME = frame_of(IMAGE)
PLANE = plane_of(FRAME)


def _surface(
    position: Any, triangles: Any = ((0, 1, 2), (1, 3, 2)), **changes: Any
) -> Surface:
    """Surface seen from the front; positions are (right, up, towards the viewer)."""
    place = np.asarray(position, dtype=float) @ PLANE.axes
    count = len(place)
    fields: dict[str, Any] = {
        "position": place,
        "direction": np.tile([0.0, 0.0, 1.0], (count, 1)),
        "normal": np.tile([0.0, 0.0, -1.0], (count, 1)),
        "own": 1e-3 * np.arange(1.0, count + 1),
        "shared": 2e-3 * np.arange(1.0, count + 1),
        "amplitude": np.arange(1.0, count + 1),
        "pixel": np.arange(count),
        "triangles": np.asarray(triangles),
        "shape": (2, 2),
        "frame": FRAME,
        "attributes": {},
    }
    return Surface(**{**fields, **changes})


#: Corners of a square of 4 x 2 cells of 10 mm; height 0.1 m, rising to the right.
SQUARE = [(0.0, 0.02, 0.1), (0.0, 0.0, 0.1), (0.04, 0.02, 0.14), (0.04, 0.0, 0.14)]


def _weights(right: float, up: float) -> np.ndarray:
    """Weights of the corners at a place within the square."""
    s, t = right / 0.04, 1 - up / 0.02
    if s + t <= 1:
        return np.array([1 - s - t, t, s, 0.0])
    return np.array([0.0, 1 - s, 1 - t, s + t - 1])


def test_small_cells_have_the_values_of_their_middle() -> None:
    made = _surface(SQUARE, attributes={"a": 1})
    found = raster(made, PLANE, cell=0.01, layers={"n": [1.0, 2.0, 3.0, np.nan]})
    assert found.height.shape == (2, 4)
    assert (found.left, found.top) == pytest.approx((0.0, 0.02))
    assert_allclose(found.columns, [0.005, 0.015, 0.025, 0.035])
    assert_allclose(found.rows, [0.015, 0.005])
    assert found.cell == 0.01
    assert found.plane is PLANE
    assert found.surface is made
    for row in range(2):
        for column in range(4):
            w = _weights(found.columns[column], found.rows[row])
            at = row, column
            assert found.height[at] == pytest.approx(0.1 + found.columns[column])
            noise = np.sqrt(((w * made.own) ** 2).sum())
            assert found.own[at] == pytest.approx(noise)
            sigma = np.hypot(noise, w @ made.shared)
            assert found.uncertainty[at] == pytest.approx(sigma)
            assert found.amplitude[at] == pytest.approx(w @ made.amplitude)
            layer = (w[:3] @ [1.0, 2.0, 3.0]) / w[:3].sum()
            assert found.layers["n"][at] == pytest.approx(layer)


def test_large_cells_have_the_mean_of_points_as_dense_as_the_pixels() -> None:
    # Nine vertices 20 mm apart, that in the middle 10 mm higher; all diagonals meet it.
    x, y = (
        values.ravel() for values in np.meshgrid([0.0, 0.02, 0.04], [0.04, 0.02, 0])
    )
    place = np.stack([x, y, np.where(np.arange(9) == 4, 0.01, 0.0)], axis=1)
    triangles = [(4, 0, 1), (4, 1, 2), (4, 2, 5), (4, 5, 8), (4, 8, 7), (4, 7, 6)]
    made = _surface(place, [*triangles, (4, 6, 3), (4, 3, 0)])
    # One and a half times the spacing of 20 to 22 mm: the middle of a cell alone.
    small = raster(made, PLANE, cell=0.03)
    assert small.height[1, 0] == pytest.approx(0.0075)
    # Twice the spacing: four points, half way from the middle to the corners.
    large = raster(made, PLANE, cell=0.04)
    assert large.height.shape == (1, 1)
    assert large.height[0, 0] == pytest.approx(0.005)
    weight = np.array([1, 0, 1, 0, 4, 0, 1, 0, 1]) / 8
    noise = np.sqrt(((weight * made.own) ** 2).sum())
    assert large.own[0, 0] == pytest.approx(noise)
    assert large.amplitude[0, 0] == pytest.approx(weight @ made.amplitude)
    sigma = np.hypot(noise, weight @ made.shared)
    assert large.uncertainty[0, 0] == pytest.approx(sigma)


def test_bands_of_rows_are_put_together(monkeypatch: pytest.MonkeyPatch) -> None:
    made = _surface(SQUARE)
    whole = raster(made, PLANE, cell=0.004, layers={"n": np.arange(4.0)})
    for most in (1, 10, 25):
        monkeypatch.setattr(module, "_AT_ONCE", most)
        part = raster(made, PLANE, cell=0.004, layers={"n": np.arange(4.0)})
        for name in ("height", "own", "uncertainty", "amplitude"):
            assert_array_equal(getattr(part, name), getattr(whole, name))
        assert_array_equal(part.layers["n"], whole.layers["n"])


def test_the_nearer_surface_hides_the_other() -> None:
    behind = [(x, y, z - 0.05) for x, y, z in SQUARE]
    triangles = [(0, 1, 2), (1, 3, 2), (4, 5, 6), (5, 7, 6)]
    found = raster(_surface(SQUARE + behind, triangles), PLANE, cell=0.01)
    assert_allclose(found.height[0], 0.1 + found.columns)
    turned = raster(_surface(behind + SQUARE, triangles), PLANE, cell=0.01)
    assert_allclose(turned.height, found.height)


def test_cells_are_whole_multiples_and_at_least_one() -> None:
    shifted = [(x + 0.013, y - 0.027, z) for x, y, z in SQUARE]
    found = raster(_surface(shifted), PLANE, cell=0.01)
    assert (found.left, found.top) == pytest.approx((0.01, 0.0))
    assert found.height.shape == (3, 5)
    # Vertices that no triangle uses do not count.
    away = [*SQUARE, (9.0, 9.0, 0.0)]
    assert raster(_surface(away), PLANE, cell=0.01).height.shape == (2, 4)


def test_pose_errors_add_to_the_heights() -> None:
    pose = Pose(position_uncertainty=0.03)
    frame = frame_of(IMAGE, axes="pose", pose=pose)
    plane = plane_of(frame)
    place = np.asarray(SQUARE) @ plane.axes
    made = replace(_surface(SQUARE, frame=frame), position=place)
    nearer = np.tile(plane.axes[2], (4, 1))
    made = replace(made, normal=nearer, direction=-nearer)
    found = raster(made, plane, cell=0.01)
    plain = raster(_surface(SQUARE), PLANE, cell=0.01)
    assert_allclose(found.uncertainty, np.hypot(plain.uncertainty, 0.03))
    leaning = Pose(position_uncertainty=0.0, level_uncertainty=0.01)
    frame = frame_of(IMAGE, axes="pose", pose=leaning)
    made = replace(made, frame=frame, own=np.zeros(4), shared=np.zeros(4))
    found = raster(made, plane, cell=0.01)
    # Turned about the instrument, a height of the front view changes with the place up.
    shifts = frame.shared_errors(
        np.stack(
            [found.columns, np.full(4, found.rows[1]), found.height[1]], axis=1
        ) @ plane.axes
    ) @ plane.axes[2]  # fmt: skip
    assert_allclose(found.uncertainty[1], np.sqrt((shifts**2).sum(axis=0)))
    assert found.uncertainty[0, 0] != pytest.approx(found.uncertainty[1, 0], rel=1e-6)


def test_gains_are_by_beam_and_normal_and_limited() -> None:
    normal = np.array([[0.6, 0, -0.8], [1.0, 0, 0], [0.999, 0, -0.0447], [np.nan] * 3])
    beam = np.tile([0.28, 0.0, 0.96], (4, 1))
    made = _surface(SQUARE, normal=normal, direction=beam)
    found = gains(made, np.array([0.0, 0.0, -1.0]))
    assert found[0] == pytest.approx((0.6 * 0.28 - 0.8 * 0.96) / 0.8)
    # Without an own slope, the beam's part along the axis.
    assert found[1] == pytest.approx(-0.96)
    assert found[3] == pytest.approx(-0.96)
    steep = gains(made, np.array([0.01, 0.0, 0.0]))
    assert np.isfinite(steep).all()
    assert found[2] == pytest.approx((0.999 * 0.28 - 0.0447 * 0.96) / 0.0447, rel=1e-3)
    edge = _surface(SQUARE, normal=np.tile([0.9999, 0, -0.01], (4, 1)), direction=beam)
    assert_allclose(gains(edge, np.array([0.0, 0.0, -1.0])), 20.0)
    assert_allclose(gains(edge, np.array([0.0, 0.0, 1.0])), -20.0)


def test_rasters_that_cannot_be_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def refusal(kind: type[Exception], **options: Any) -> str:
        made = _surface(options.pop("position", SQUARE))
        with pytest.raises(kind) as caught:
            raster(made, PLANE, **options)
        return str(caught.value)

    for cell in (0.0, -0.01, float("nan")):
        words = f"cell must be above 0 m, got {cell:g} m"
        assert refusal(ValueError, cell=cell) == words
    line = [(0.0, 0.0, 0.1), (0.0, 0.004, 0.1), (0.0, 0.001, 0.2), (0.0, 0.002, 0.1)]
    assert refusal(CubeError, cell=0.01, position=line) == (
        "no cell of 10 mm holds a surface seen from the front; take smaller cells, or "
        "look from the other side"
    )
    monkeypatch.setattr(module, "MOST_CELLS", 7)
    assert refusal(CubeError, cell=0.01) == (
        "a raster of 4 x 2 cells of 10 mm, averaged over 1 x 1 points each, is too "
        "large; at most 7e+00 points fit: take larger cells, a smaller scale, or fewer "
        "dots per inch"
    )
    monkeypatch.setattr(module, "MOST_CELLS", 8)
    assert raster(_surface(SQUARE), PLANE, cell=0.01).height.size == 8
    monkeypatch.setattr(module, "MOST_CELLS", 3)
    assert "over 2 x 2 points" in refusal(CubeError, cell=0.058)


def _raster(height: np.ndarray, *, own: float = 1e-4) -> Raster:
    """Raster with cells of 10 mm, whose left upper corner is at (0.1, 0.5) m."""
    rows = np.arange(height.shape[0])[:, None] * np.ones(height.shape)
    return Raster(
        height=height, uncertainty=1e-3 * (1 + rows), own=np.full(height.shape, own),
        amplitude=height, cell=0.01, left=0.1, top=0.5, plane=PLANE,
        surface=_surface(SQUARE), layers={},
    )  # fmt: skip


def test_contours_of_a_slope_are_straight_lines_at_multiples() -> None:
    # 2 mm per column, from -9 mm on.
    height = -9e-3 + 2e-3 * np.arange(12.0) * np.ones((8, 1))
    found = contours(_raster(height), interval=5e-3)
    assert [line.level for line in found] == pytest.approx([-5e-3, 0.0, 5e-3, 10e-3])
    for line in found:
        column = (line.level + 9e-3) / 2e-3
        assert_allclose(line.points[:, 0], 0.1 + 0.01 * (column + 0.5))
        assert sorted({round(float(y), 6) for y in line.points[:, 1]}) == pytest.approx(
            0.5 - 0.01 * (np.arange(8)[::-1] + 0.5)
        )
        # The median of eight rows of 1 to 8 mm.
        assert line.uncertainty == pytest.approx(4.5e-3)
    coarse = contours(_raster(height), interval=9e-3)
    assert [line.level for line in coarse] == pytest.approx([0.0, 9e-3])


@pytest.mark.parametrize(("own", "drawn"), [(0.99, True), (1.01, False)])
def test_a_line_is_drawn_from_six_standard_errors_on(own: float, drawn: bool) -> None:
    # Three cells to both sides: 12 mm, the mean of eight rows with noise on both.
    height = -9e-3 + 2e-3 * np.arange(12.0) * np.ones((8, 1))
    limit = 12e-3 * 8 / (6 * np.sqrt(2 * 8))
    assert bool(contours(_raster(height, own=own * limit), interval=1.0)) is drawn


def test_a_line_near_a_rim_is_compared_as_far_as_there_is_a_surface() -> None:
    height = np.full((8, 12), np.nan)
    height[:, 4:8] = [-3.5e-3, -1.5e-3, 0.5e-3, 2.5e-3]
    # Between the middles of two cells, one cell aside: 4 mm in eight rows.
    limit = 4e-3 * 8 / (6 * np.sqrt(2 * 8))
    (line,) = contours(_raster(height, own=0.99 * limit), interval=1.0)
    assert line.level == 0.0
    noisy = _raster(height, own=1.01 * limit)
    assert contours(noisy, interval=1.0) == []
    # One point has no surface to either side.
    assert not module._is_significant(noisy, np.array([[0.0, 0.0], [0.0, 0.01]]))


def test_uncertainties_along_a_line_are_those_of_its_cells() -> None:
    made = _raster(np.zeros((4, 3)))
    points = np.array([[0.105, 0.495], [0.115, 0.485], [0.199, 0.401]])
    # Cells of the rows 0, 1, and beyond the last.
    assert module._along(made, points) == pytest.approx(2e-3)
    assert_array_equal(module._cells(made, points), [[0, 0], [1, 1], [9, 9]])
    made.uncertainty[:] = np.nan
    assert np.isnan(module._along(made, points))


def test_contours_that_cannot_be_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    height = -9e-3 + 2e-3 * np.arange(12.0) * np.ones((8, 1))

    def refusal(kind: type[Exception], interval: float, values: np.ndarray) -> str:
        with pytest.raises(kind) as caught:
            contours(_raster(values), interval=interval)
        return str(caught.value)

    for interval in (0.0, -1.0):
        words = f"interval must be above 0 m, got {interval:g} m"
        assert refusal(ValueError, interval, height) == words
    assert refusal(CubeError, 0.01, 0.001 + 0.0 * height) == (
        "the surface goes from 0.0010 to 0.0010 m and crosses no multiple of 10 mm; "
        "take a smaller interval"
    )
    monkeypatch.setattr(module, "_MOST_LEVELS", 3)
    assert refusal(CubeError, 5e-3, height) == (
        "4 contour levels are too many, at most 3; take an interval above 7.33 mm"
    )
    monkeypatch.setattr(module, "_MOST_LEVELS", 4)
    assert len(contours(_raster(height), interval=5e-3)) == 4
    few = "contours need two rows and two columns; take smaller cells"
    assert refusal(CubeError, 5e-3, height[:1]) == few
    assert refusal(CubeError, 5e-3, height[:, :1] * [[1.0]] * 0.0 - 5e-3) == few


def test_planes_of_view_have_axes_and_names() -> None:
    assert_array_equal(plane_of(FRAME).axes, [[1, 0, 0], [0, -1, 0], [0, 0, -1]])
    top = plane_of(FRAME, "top")
    assert_array_equal(top.axes, [[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    assert (top.side, top.names) == ("top", ("right", "forward", "up"))
    pose = frame_of(IMAGE, axes="pose", pose=Pose(heading=np.pi / 6))
    front = plane_of(pose, "front")
    half, long = 0.5, 3**0.5 / 2
    expected = [[long, -half, 0], [0, 0, 1], [-half, -long, 0]]
    assert_allclose(front.axes, expected, atol=1e-12)
    assert front.names == ("right", "up", "nearer")
    above = plane_of(pose, "top")
    assert_array_equal(above.axes, np.eye(3))
    assert above.names == ("east", "north", "up")
    assert isinstance(front, Plane)


def _image(distance: np.ndarray, *, own: float = 1e-4) -> xr.Dataset:
    azimuth, elevation, _ = scenes.directions(*distance.shape)
    return scenes.image_of(distance, azimuth, elevation, own=own, shared=3e-4)


def test_each_square_of_pixels_is_two_triangles() -> None:
    found = surface(IMAGE)
    assert len(found.triangles) == 2 * 3 * 4
    assert found.shape == (4, 5)
    corner = found.position[found.triangles]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert (area[:, 2] < 0).all()
    assert_allclose(found.normal, np.tile([0.0, 0.0, -1.0], (20, 1)), atol=1e-9)
    assert_allclose(found.own, 1e-4)
    assert_allclose(found.shared, 0.0, atol=1e-9)
    assert_array_equal(found.pixel, np.arange(20))
    assert found.attributes["title"] == "scene"


def test_flagged_pixels_are_no_vertices() -> None:
    image = _image(np.full((4, 5), 1.5))
    flags = (QualityFlag.MIXED, QualityFlag.OUTLIER, QualityFlag.NO_TARGET)
    for column, flag in enumerate(flags):
        image["quality_flag"].values[0, column] = flag
    image["quality_flag"].values[0, 3] = QualityFlag.NO_OPEN_WATER
    image["slant_range"].values[3, 0] = np.nan
    found = surface(image)
    expected = [n for n in range(20) if n not in (0, 1, 2, 15)]
    assert found.pixel.tolist() == expected
    assert_allclose(found.shared, 3e-4)
    assert_allclose(found.amplitude, image["intensity"].values.ravel()[expected])
    # Of the last square of the first row half is left of its complete neighbors.
    used = {tuple(sorted(found.pixel[t])) for t in found.triangles}
    assert (3, 4, 9) in used or (3, 4, 8) in used
    assert (3, 7, 8) in used
    assert (10, 11, 16) in used
    assert len(used) == 2 + 1 + 8 + 7


@pytest.mark.parametrize(
    ("step", "own", "joined"),
    # 80 degrees are 5.67 times the distance across, of some 30 mm.
    [
        (0.165, 1e-4, True),
        (0.175, 1e-4, False),
        (0.175, 0.034, False),
        (0.175, 0.036, True),
    ],
)
def test_steep_steps_are_joined_within_their_noise(
    step: float, own: float, joined: bool
) -> None:
    across = 0.08 / 4 * 1.5
    distance = np.full((3, 5), 1.5)
    distance[:, 3:] += step * across / 0.03
    found = surface(_image(distance, own=own))
    assert len(found.triangles) == (16 if joined else 12)


def test_the_diagonal_follows_the_smaller_step() -> None:
    for low, diagonal in (((1, 1), {0, 4}), ((0, 1), {1, 3})):
        distance = np.full((2, 3), 1.5)
        distance[low] += 0.01
        distance[:, 2] = np.nan
        found = surface(_image(distance))
        ends = [set(found.pixel[t].tolist()) for t in found.triangles]
        shared = ends[0] & ends[1]
        other = {0, 1, 3, 4} - diagonal
        assert shared == other, (low, shared)


def test_surfaces_that_cannot_be_are_one_line() -> None:
    for angle in (0.0, np.pi / 2):
        with pytest.raises(ValueError, match="steepest must") as caught:
            surface(IMAGE, steepest=angle)
        assert str(caught.value) == (
            f"steepest must lie between 0 and 90 degrees, got {np.degrees(angle):g}"
        )
    image = _image(np.full((4, 5), 1.5))
    image["slant_range"].values[1:] = np.nan
    with pytest.raises(CubeError) as refused:
        surface(image)
    assert str(refused.value) == (
        "no three neighboring pixels of the range image have a range, so there is no "
        "surface to draw; look at its quality flags"
    )


def test_barycentric_coordinates_are_shares_of_the_corners() -> None:
    corner = np.array([[[0.0, 0, 0], [2.0, 0, 0], [0.0, 3.0, 1.0]]] * 2)
    weight = np.array([[0.2, 0.3, 0.5], [0.6, 0.1, 0.3]])
    place = np.einsum("nk,nki->ni", weight, corner)
    assert_allclose(_barycentric(corner, place), weight)


def test_of_two_references_the_nearer_one_counts() -> None:
    made = surface(_image(np.full((4, 5), 1.5)))
    sheet = np.array([[-2.0, -2, 0], [2, -2, 0], [-2, 2, 0], [2, 2, 0]])
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    before, behind = (sheet + np.array([0, 0, z]) for z in (1.45, 1.53))
    vertices = np.concatenate([before, behind])
    both = np.concatenate([faces, faces + 4])
    hit, face = _met(made, vertices, both)
    assert_array_equal(hit, np.arange(20))
    assert (face >= 2).all()
    _, face = _met(made, vertices + np.array([0, 0, 0.03]), both)
    assert (face < 2).all()
    # Nothing behind the instrument.
    hit, _ = _met(made, sheet - np.array([0, 0, 0.1]), faces)
    assert len(hit) == 0


def test_a_deviation_has_errors_of_the_scan_and_of_the_reference() -> None:
    made = surface(_image(np.full((4, 5), 1.5)))
    sheet = np.array([[-2.0, -2, 1.49], [2, -2, 1.49], [-2, 2, 1.49], [2, 2, 1.49]])
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    plain = deviation(made, sheet, faces)
    facing = made.direction[:, 2]
    place = made.position
    # 1.5 m along the beam is nearer than that at the rim.
    assert_allclose(plain.value, -(place[:, 2] - 1.49), atol=1e-12)
    assert_allclose(plain.own, 1e-4 * facing)
    assert_allclose(plain.uncertainty, np.hypot(1e-4, 3e-4) * facing)
    assert plain.mean == pytest.approx(np.mean(plain.value))
    assert plain.spread == pytest.approx(np.std(plain.value))
    noise = np.sqrt(np.sum((1e-4 * facing) ** 2)) / 20
    expected = np.hypot(noise, np.mean(3e-4 * facing))
    assert plain.mean_uncertainty == pytest.approx(expected)
    stated = deviation(
        made,
        sheet,
        faces,
        own=np.full(4, 2e-4),
        shared=np.array([1e-3, 2e-3, 3e-3, 4e-3]),
    )
    x, y = (place[:, :2] / place[:, 2:] * 1.49 + 2).T / 4
    share = np.stack([1 - x - y, x, y, 0 * x], axis=1)
    other = np.stack([0 * x, 1 - y, 1 - x, x + y - 1], axis=1)
    share = np.where((x + y <= 1)[:, None], share, other)
    noise = np.sqrt(1e-8 + ((2e-4 * share) ** 2).sum(axis=1)) * facing
    assert_allclose(stated.own, noise)
    common = np.hypot(3e-4, share @ [1e-3, 2e-3, 3e-3, 4e-3]) * facing
    assert_allclose(stated.uncertainty, np.hypot(noise, common))
    one = deviation(made, sheet, faces, own=np.full(4, 2e-4))
    assert_allclose(one.own, noise)
    # No farther than stated.
    limit = float(np.sort(np.abs(plain.value))[9])
    near = deviation(made, sheet, faces, farthest=limit)
    assert np.isfinite(near.value).sum() == np.sum(np.abs(plain.value) <= limit)
    assert_array_equal(np.isfinite(near.own), np.isfinite(near.value))


def test_significance_limits_the_share_of_false_ones() -> None:
    value = np.array([5.0, -4.0, 1.0, 0.0, np.nan])
    found = _significant(value, np.array([1.0, 1.0, 1.0, 0.0, 1.0]))
    assert_array_equal(found, [True, True, False, False, False])
    # Of two with 2 % each, the limit of both is 5 % by rank: 2.5 % and 5 %.
    score = norm.isf(0.01)
    assert_array_equal(_significant(np.array([score, -score]), np.ones(2)), [True] * 2)
    one = _significant(np.array([norm.isf(0.013), 0.0]), np.ones(2))
    assert_array_equal(one, [False, False])
