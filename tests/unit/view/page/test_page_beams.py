"""Beams between nodes of the page, and the lines of a scan from a vehicle."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.view.page import coverage, pictures
from amulor.view.page.pictures import MemoryPicture, Nodes


def nodes_at(rows: list[int], columns: list[int], values: np.ndarray) -> Nodes:
    return Nodes(np.array(rows), np.array(columns), values.astype(np.float32))


def test_places_of_nodes_include_the_last_one() -> None:
    assert pictures._places(7, 3).tolist() == [0, 3, 6]
    assert pictures._places(8, 3).tolist() == [0, 3, 6, 7]
    assert pictures._places(1, 64).tolist() == [0]


def test_weights_between_nodes_are_those_of_a_straight_line() -> None:
    before, after, weight = pictures._between(
        np.array([0, 4, 6]), np.array([0, 3, 5, 6])
    )
    assert before.tolist() == [0, 0, 1, 2]
    assert after.tolist() == [1, 1, 2, 2]
    assert weight.tolist() == [0, 0.75, 0.5, 0]


def test_beams_between_nodes_are_bilinear() -> None:
    rows, columns = np.array([0, 4, 6]), np.array([0, 5])
    row, column = np.meshgrid(rows, columns, indexing="ij")
    values = np.stack([row + 10.0 * column + 2.0 * row * column] * 8, axis=-1)
    found = pictures.interpolated(
        nodes_at([0, 4, 6], [0, 5], values), np.array([1, 5, 6]), np.array([0, 2, 5])
    )
    row, column = np.meshgrid([1, 5, 6], [0, 2, 5], indexing="ij")
    assert found.shape == (3, 3, 8)
    assert_allclose(found[..., 7], row + 10.0 * column + 2.0 * row * column)


def reader(bend: float, *, of: int = 3) -> Any:
    """Beams whose value number `of` bends along the columns."""

    def read(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        values = np.zeros((len(rows), len(columns), 8))
        values[..., of] = bend * np.asarray(columns) ** 2
        return values

    return read


def test_nodes_are_as_coarse_as_the_tolerance_allows() -> None:
    # Between columns that are d apart, a parabola b x^2 leaves b d^2 / 4 at most.
    for step in (64, 32, 16, 8):
        bend = 2e-6 / (step / 2) ** 2
        for of, far in ((0, 1.0), (3, 1.0), (5, 4.0)):
            for factor, expected in ((0.95, step), (1.05, step // 2)):
                size = bend * factor / (far if of > 2 else 1.0)
                read = reader(size, of=of)
                nodes = pictures.nodes_of(read, (3, 129), farthest=far)
                assert np.diff(nodes.columns)[0] == expected, (of, step, factor)
    # Angles alone need no finer nodes, and nodes are not finer than drawn pixels.
    angles = pictures.nodes_of(reader(1.0, of=6), (3, 129), farthest=1.0)
    assert angles.columns.tolist() == [0, 64, 128]
    jumps = pictures.nodes_of(reader(1.0), (3, 129), farthest=1.0, stride=5)
    assert jumps.columns[:3].tolist() == [0, 5, 10]
    every = pictures.nodes_of(reader(1.0), (3, 129), farthest=1.0)
    assert every.columns.tolist() == list(range(129))


def test_beams_of_an_image_begin_where_the_range_is_zero() -> None:
    image = scenes.plane((0.1, 0.05, 1), 1.5, rows=4, columns=6)
    picture = MemoryPicture(image)
    found = picture.beams()(np.array([1, 3]), np.array([0, 5]))
    assert found.shape == (2, 2, 8)
    assert_allclose(np.linalg.norm(found[..., 3:6], axis=-1), 1)
    part = image.isel(row=[1, 3], column=[0, 5])
    assert_allclose(found[..., 6], part["azimuth"])
    assert_allclose(found[..., 7], part["elevation"])
    # Points on the plane n x = 1.5 n_z, with n along (0.1, 0.05, 1).
    points = found[..., :3] + part["slant_range"].values[..., None] * found[..., 3:6]
    distance = points @ np.array([0.1, 0.05, 1.0])
    assert_allclose(distance, distance[0, 0], rtol=1e-6)
    assert picture.shape == (4, 6)
    assert picture.place(2, 3) == (2, 3)
    strided = picture.values("slant_range", 3)
    assert_allclose(strided, image["slant_range"].values[[0, 3]][:, [0, 3]])
    assert (picture.has("slant_range"), picture.has("amplitude")) == (True, False)


def test_columns_of_a_footprint_stand_for_those_around_them() -> None:
    columns, edges = coverage._thinned(23)
    assert columns.tolist() == list(range(0, 23, 2))
    assert edges[:2] == [(0, 2), (2, 4)]
    assert edges[-1] == (22, 23)
    columns, edges = coverage._thinned(5)
    assert columns.tolist() == [0, 1, 2, 3, 4]
    assert edges == [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5)]
    columns, edges = coverage._thinned(120)
    assert len(columns) == 12
    assert (columns[0], columns[-1]) == (0, 119)
    assert edges[0] == (0, 6)


def test_beams_downwards_give_a_plan_and_others_an_elevation() -> None:
    down = np.array([[0.1, 0.0, -1.0], [-0.1, 0.0, -1.0]])
    axes, plan = coverage._plane(down)
    assert plan
    assert axes.tolist() == [[1, 0, 0], [0, 1, 0]]
    # To the north: right is east; to the east: right is south.
    for beam, right in (((0, 1, -0.9), (1, 0, 0)), ((1, 0, -0.9), (0, -1, 0)),
                        ((3, 4, 1), (0.8, -0.6, 0))):  # fmt: skip
        axes, plan = coverage._plane(np.array([beam, beam], dtype=float))
        assert not plan
        assert_allclose(axes, [right, (0, 0, 1)], atol=1e-12)
    steep = np.array([[0.0, np.sqrt(1 - 0.71**2), -0.71]])
    assert coverage._plane(steep)[1]
    flat = np.array([[0.0, np.sqrt(1 - 0.69**2), -0.69]])
    assert not coverage._plane(flat)[1]


def test_areas_between_lines_are_those_of_parallelograms() -> None:
    columns = np.array([0, 3, 5])
    line = np.array([[0.0, 0.0], [0.3, 0.0], [0.5, 0.0]])
    flat = np.stack(
        [line + np.array(shift) for shift in ((0, 0), (0.05, 0.2), (0.05, 0.6))]
    )
    flat[2, 1] = np.nan
    area, count = coverage._areas(flat, columns)
    # The cell at the right of the unknown place is not known.
    assert_allclose(area, [0.5 * 0.2, 0.3 * 0.4])
    assert count.tolist() == [5, 3]


def test_numbers_of_a_course_may_be_unknown() -> None:
    values = np.array([1.0, 3.0, np.nan, 2.0, np.nan])
    assert coverage._last(values) == 2.0
    assert np.isnan(coverage._last(np.full(2, np.nan)))
    assert coverage._median(values) == 2.0
    assert coverage._median(np.full(2, np.nan)) is None
    assert (coverage._number(1.5), coverage._number(np.inf)) == (1.5, None)
    places = np.array([[1.23456, 2.0], [np.nan, 1.0]])
    assert coverage._listed(places) == [[1.2346, 2.0], None]


def test_poses_end_at_the_clock_of_the_scan() -> None:
    recorded: Any = SimpleNamespace(
        trajectory=SimpleNamespace(time=np.array([10.0, 50.0])), origin=12.0,
        mounting=SimpleNamespace(clock_offset=3.0),
    )  # fmt: skip
    assert coverage._end(recorded) == 35.0
    recorded.trajectory = None
    assert coverage._end(recorded) == np.inf


@pytest.mark.parametrize(
    ("kind", "begin", "counted"),
    [("scan", 5.0, True), ("scan", None, False), ("dark", 5.0, False)],
)
def test_times_of_pixels_are_the_middles_of_their_readings(
    plate, kind, begin, counted
) -> None:
    taken = coverage.Coverage(plate)
    key: Any = SimpleNamespace(kind=kind, row=2, column=7)
    for duration, more in ((0.4, 0.0), (None, 1.0)):
        start = None if begin is None else begin + more
        record: Any = SimpleNamespace(begin=start, duration=duration)
        taken.take(key, record)
    assert taken._count.sum() == (2 if counted else 0)
    assert taken._sum[2, 7] == (pytest.approx(5.2 + 6.0) if counted else 0)
    assert taken.version == 0
    assert taken.state == {}
