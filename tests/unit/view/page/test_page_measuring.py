"""Requests of the page for measurements: pixels, regions, clip boxes and answers."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.imaging import measure
from amulor.imaging.observation import geometry_of
from amulor.view import page
from amulor.view.page import measuring
from amulor.view.page.pictures import MemoryPicture

#: A picture of 5 rows and 8 columns.
SMALL: Any = SimpleNamespace(shape=(5, 8))


@pytest.fixture(scope="module")
def recording() -> page.Recording:
    """Return a wall at 1.5 m of 20 x 30 pixels."""
    return page.recording_of(scenes.plane((0.1, 0.05, 1), 1.5, rows=20, columns=30))


@pytest.mark.parametrize(
    ("value", "words"),
    [(3, None), (7, None), (2, "row must be from 3 to 7, got 2"),
     (8, "row must be from 3 to 7, got 8"), (True, "row must be a whole number"),
     (4.0, "row must be a whole number"), ("4", "row must be a whole number")],
)  # fmt: skip
def test_whole_numbers_have_limits(value: Any, words: str | None) -> None:
    if words is None:
        assert measuring._integer(value, "row", 3, 7) == value
        return
    with pytest.raises(CubeError) as refused:
        measuring._integer(value, "row", 3, 7)
    assert str(refused.value) == words


def test_an_axis_has_three_numbers_and_a_length() -> None:
    assert measuring._axis([0, -2, "1"]) == (0.0, -2.0, 1.0)
    assert measuring._axis([0, 0, 1e-9]) == (0.0, 0.0, 1e-9)
    for wrong in ([0, 1], 3, ["a", 0, 0]):
        with pytest.raises(
            CubeError, match=r"^an axis is three numbers: right, down, "
        ):
            measuring._axis(wrong)
    for wrong in ([0, 0, 0], [math.inf, 0, 0], [math.nan, 0, 0]):
        with pytest.raises(CubeError, match="has no direction"):
            measuring._axis(wrong)


def test_rows_near_others_stay_within_the_scan() -> None:
    assert measuring._near([1, 8], 2, 10) == [0, 1, 2, 3, 6, 7, 8, 9]
    assert measuring._near([4], 0, 10) == [4]
    assert measuring._near([9], 1, 10) == [8, 9]


def test_pixels_are_rows_and_columns_of_the_scan() -> None:
    assert measuring._pixels(SMALL, [[0, 7], [4, 0]]) == [(0, 7), (4, 0)]
    assert len(measuring._pixels(SMALL, [[0, 0]] * 200)) == 200
    for wrong, words in (
        ([], "^pick 1 to 200 pixels$"), ([[0, 0]] * 201, "^pick 1 to 200 pixels$"),
        (None, "^pick 1 to 200 pixels$"), ([[0]], "^a pixel is a row and a column$"),
        ([(0, 0)], "^a pixel is a row and a column$"),
        ([[5, 0]], "^row must be from 0 to 4, got 5$"),
        ([[0, 8]], "^column must be from 0 to 7, got 8$"),
    ):  # fmt: skip
        with pytest.raises(CubeError, match=words):
            measuring._pixels(SMALL, wrong)


@pytest.mark.parametrize(
    ("corners", "most", "rows", "columns"),
    [([1, 2, 3, 4], 99, [1, 2, 3], [2, 3, 4]), ([3, 4, 1, 2], 9, [1, 2, 3], [2, 3, 4]),
     ([1, 2, 3, 4], 8, [1, 3], [2, 4]), ([0, 0, 4, 7], 10, [0, 2, 4], [0, 2, 4, 6]),
     ([0, 0, 4, 7], 9, [0, 3], [0, 3, 6])],
)  # fmt: skip
def test_a_region_of_many_pixels_is_thinned(corners, most, rows, columns) -> None:
    assert measuring._lines(SMALL, corners, most=most) == (rows, columns)
    pixels = measuring._region(SMALL, corners, most=most)
    assert pixels == [(row, column) for row in rows for column in columns]


def test_a_region_has_two_corners_inside_the_scan() -> None:
    for wrong in (None, [0, 0, 1], [0, 0, 1, 1, 1]):
        with pytest.raises(CubeError) as refused:
            measuring._region(SMALL, wrong)
        assert str(refused.value) == (
            "a region has a first row and column, and a last row and column"
        )
    for wrong, limit in (([0, 0, 5, 0], "0 to 4, got 5"), ([0, 8, 0, 0], "7, got 8")):
        with pytest.raises(CubeError, match=f"^a corner of the region .*{limit}$"):
            measuring._region(SMALL, wrong)
    # 1500 pixels, unless stated otherwise.
    large: Any = SimpleNamespace(shape=(100, 100))
    assert len(measuring._region(large, [0, 0, 29, 49])) == 1500
    assert len(measuring._region(large, [0, 0, 29, 50])) == 15 * 26


def test_a_clip_box_keeps_what_is_inside_its_limits(recording) -> None:
    image = recording.channel().shown.whole()
    beam = geometry_of(image).beam
    ranges = image["slant_range"].values
    place = beam.entry + ranges[..., None] * beam.direction
    assert measuring._inside(image, None).all()
    low = float(np.median(place[..., 0]))
    high = float(np.median(place[..., 1]))
    clip = {"low": [low, None, None], "high": [None, high, None]}
    inside = measuring._inside(image, clip)
    expected = (place[..., 0] >= low) & (place[..., 1] <= high)
    assert 0 < expected.sum() < expected.size / 2
    assert (inside == expected).all()
    for wrong in ([], {"low": [0, 0, 0]}, {"low": [0, 0], "high": [0, 0, 0]}):
        with pytest.raises(
            CubeError, match=r"^a clip box has three low and three high"
        ):
            measuring._inside(image, wrong)
    with pytest.raises(CubeError, match=r"^limits of a clip box are numbers"):
        measuring._inside(image, {"low": ["a", 0, 0], "high": [0, 0, 0]})


FIT = measure.Fit(
    kind="plane", values={"offset": 1.5, "tilt": 0.1}, residual=5e-3, misfit=25 / 9,
    uncertainties={"offset": 1e-3, "tilt": math.nan}, pixels=53,
)  # fmt: skip


def test_a_flatness_has_the_error_of_its_variance() -> None:
    # 5 mm, of which 3 mm are noise: a variance of 9 mm^2, known to a fifth.
    found = measuring._flatness(FIT)
    assert found["value"] == pytest.approx(4e-3)
    assert found["uncertainty"] == pytest.approx(9e-6 / 5 / (2 * 4e-3))
    assert (found["label"], found["unit"]) == ("flatness", "m")
    flat = measuring._flatness(replace(FIT, misfit=0.5, residual=3e-3))
    assert flat["value"] == 0
    assert flat["uncertainty"] == pytest.approx(math.sqrt(18e-6 / 5))
    # Where little is left, the error is at most the root of that of the variance.
    rough = measuring._flatness(replace(FIT, residual=3.01e-3, misfit=(3.01 / 3) ** 2))
    assert rough["uncertainty"] == pytest.approx(math.sqrt(9e-6 / 5))
    few = measuring._flatness(replace(FIT, pixels=3, misfit=1.0, residual=1e-3))
    assert few["uncertainty"] == pytest.approx(math.sqrt(math.sqrt(2) * 1e-6))


def test_a_fit_is_described_unless_it_is_in_doubt() -> None:
    lines = [{"label": "offset"}]
    found = measuring._described(FIT, lines)
    assert found == {
        "lines": lines, "doubt": "", "residual": 5e-3, "misfit": 25 / 9, "pixels": 53,
    }  # fmt: skip
    doubted = measuring._described(replace(FIT, doubt="bent", misfit=math.inf), lines)
    assert (doubted["lines"], doubted["doubt"], doubted["misfit"]) == ([], "bent", None)


def test_numbers_that_are_not_known_are_none() -> None:
    found = [measuring._or_none(value) for value in (math.nan, math.inf, 0.0, 3, "m")]
    assert found == [None, math.inf, 0.0, 3, "m"]


def _fitted(monkeypatch, recording, kind: str, values: dict[str, float]):
    """Measurement of a shape whose fit has the given values and errors of a tenth."""
    taken = {}

    def fit(image, region):
        taken["region"] = region
        errors = {name: 0.1 * value for name, value in values.items()}
        return replace(FIT, values=values, uncertainties=errors)

    monkeypatch.setitem(measuring._FITS, kind, fit)
    picture = recording.channel().shown
    found = measuring._fit(picture, kind, [(1, 2), (3, 4), (3, 5)])
    return found, taken["region"]


def test_a_plane_states_tilt_and_flatness_first(monkeypatch, recording) -> None:
    values = {"normal_x": 0.2, "offset": 1.5, "tilt": 0.4}
    found, region = _fitted(monkeypatch, recording, "plane", values)
    assert [(line["label"], line["unit"]) for line in found["lines"]] == [
        ("tilt", "rad"), ("flatness", "m"), ("normal x", "1"), ("offset", "m"),
    ]  # fmt: skip
    assert found["lines"][0]["value"] == 0.4
    assert found["lines"][0]["uncertainty"] == pytest.approx(0.04)
    assert np.argwhere(region).tolist() == [[1, 2], [3, 4], [3, 5]]


def test_a_sphere_states_its_diameter_first(monkeypatch, recording) -> None:
    values = {"radius": 0.3, "centre_x": 0.1, "point_y": 0.2, "axis_z": 1.0}
    found, _ = _fitted(monkeypatch, recording, "sphere", values)
    assert [(line["label"], line["unit"]) for line in found["lines"]] == [
        ("diameter", "m"), ("radius", "m"), ("centre x", "m"), ("point y", "m"),
        ("axis z", "1"),
    ]  # fmt: skip
    assert found["lines"][0]["value"] == pytest.approx(0.6)
    assert found["lines"][0]["uncertainty"] == pytest.approx(0.06)
    no_radius, _ = _fitted(monkeypatch, recording, "circle", {"axis_z": 1.0})
    assert [line["label"] for line in no_radius["lines"]] == ["axis z"]


def test_mixed_pixels_and_outliers_belong_to_no_surface() -> None:
    image = scenes.plane((0, 0, 1), 1.5, rows=4, columns=6).copy(deep=True)
    flags = image["quality_flag"].values
    flags[0, 0], flags[0, 1] = QualityFlag.MIXED, QualityFlag.OUTLIER
    flags[0, 2] = QualityFlag.NO_OPEN_WATER
    pixels = [(0, 0), (0, 1), (0, 2), (3, 5)]
    _, region = measuring._surface_in(MemoryPicture(image), pixels, None)
    assert np.argwhere(region).tolist() == [[0, 2], [3, 5]]


@pytest.mark.parametrize(("kind", "count"), [("distance", 2), ("height", 2),
                                             ("angle", 3)])  # fmt: skip
def test_figures_need_their_number_of_points(recording, kind, count) -> None:
    for other in (count - 1, count + 1):
        request = {"kind": kind, "pixels": [[n, 2 * n] for n in range(other)]}
        with pytest.raises(CubeError) as refused:
            measuring.measured(recording, request)
        assert str(refused.value) == f"{kind} needs {count} points, got {other}"


def test_figures_are_those_of_the_library(recording) -> None:
    image = recording.channel().shown.whole()
    at = [(2, 3), (15, 4), (12, 25)]
    pixels = [list(pixel) for pixel in at]
    known = {
        "distance": (measure.distance(image, *at[:2], reach=2), 2, {}),
        "height": (measure.height(image, *at[:2], axis=(0, 0, 1.0), reach=2), 2,
                   {"axis": [0, 0, 1]}),
        "angle": (measure.angle(image, *at, reach=2), 3, {}),
        "area": (measure.area(image, at, reach=2), 3, {}),
    }  # fmt: skip
    for kind, (figure, count, more) in known.items():
        request = {"kind": kind, "pixels": pixels[:count], "reach": 2, **more}
        found = measuring.measured(recording, request)
        (line,) = found["lines"]
        assert line == {
            "label": kind, "value": figure.value, "uncertainty": figure.uncertainty,
            "unit": figure.unit,
        }  # fmt: skip
        assert found["pixels"] == figure.pixels
        assert found["random"] == figure.random
        assert (found["kind"], found["channel"]) == (kind, recording.channels[0])
        assert found["group_index"] == image["geometry"].attrs["group_index"]
    single = {"kind": "distance", "pixels": pixels[:2]}
    alone = measuring.measured(recording, single)
    assert alone["lines"][0]["value"] == measure.distance(image, *at[:2]).value
    for reach in (-1, 21):
        with pytest.raises(
            CubeError, match=f"^reach must be from 0 to 20, got {reach}"
        ):
            measuring.measured(recording, {**single, "reach": reach})
    assert measuring.measured(recording, {**single, "reach": 20})["pixels"] > 2


def test_a_height_is_upwards_unless_an_axis_is_stated(recording) -> None:
    image = recording.channel().shown.whole()
    request = {"kind": "height", "pixels": [[15, 4], [2, 3]]}
    (line,) = measuring.measured(recording, request)["lines"]
    assert line["value"] > 0
    upwards = measure.height(image, (15, 4), (2, 3), axis=(0.0, -1.0, 0.0))
    assert line["value"] == upwards.value


def test_what_cannot_be_measured_is_named(recording) -> None:
    with pytest.raises(CubeError) as refused:
        measuring.measured(recording, {"kind": "w" * 50})
    assert str(refused.value) == (
        f"'{'w' * 40}' cannot be measured, only distance, height, angle, area, plane, "
        "circle, sphere, cylinder, volume, profile"
    )


def test_a_volume_is_between_a_region_and_the_plane_of_another(
    recording, monkeypatch
) -> None:
    taken = {}

    def volume(image, body, *, base, grid):
        taken.update(body=body, base=base, grid=grid)
        return SimpleNamespace(
            value=2e-6, uncertainty=math.nan, unit="m^3", random=math.nan, pixels=7
        )

    monkeypatch.setattr(measure, "volume", volume)
    clip = {"low": [None, None, None], "high": [None, None, 99.0]}
    request = {"kind": "volume", "region": [2, 3, 4, 6], "base": [10, 11, 10, 13]}
    found = measuring.measured(recording, {**request, "clip": clip})
    assert found["lines"] == [
        {"label": "volume", "value": 2e-6, "uncertainty": None, "unit": "m^3"}
    ]
    assert (found["random"], found["pixels"]) == (None, 7)
    rows, columns = np.nonzero(taken["body"])
    assert (set(rows), set(columns)) == ({2, 3, 4}, {3, 4, 5, 6})
    assert np.argwhere(taken["base"]).tolist() == [[10, 11], [10, 12], [10, 13]]
    assert taken["grid"] == ([2, 3, 4], [3, 4, 5, 6])
    beyond = {"low": [None, None, 99.0], "high": [None, None, None]}
    measuring.measured(recording, {**request, "clip": beyond})
    assert not taken["body"].any()


def test_a_half_profile_names_three_diameters_and_the_tilt(
    recording, monkeypatch
) -> None:
    tilted = {"axis_x": 0.6, "axis_y": -0.8, "axis_z": 0.0, "point_x": 1.0,
              "point_y": 2.0, "point_z": 3.0}  # fmt: skip
    turned = measure.Revolution(
        fit=replace(FIT, values=tilted, uncertainties={"axis_x": 3e-3, "axis_z": 4e-3}),
        height=np.array([-0.1, 0.0, 0.2]), radius=np.array([0.05, 0.09, 0.07]),
        uncertainty=np.array([1e-3, 2e-3, np.nan]), left_out=4,
    )  # fmt: skip
    monkeypatch.setattr(measure, "revolution", lambda image, region: turned)
    request = {"kind": "profile", "region": [0, 0, 19, 29]}
    found = measuring.measured(recording, request)
    lines = {line["label"]: line for line in found["lines"]}
    assert {name: line["value"] for name, line in lines.items()} == pytest.approx(
        {"rim diameter": 0.14, "largest diameter": 0.18, "base diameter": 0.1,
         "tilt of the axis": math.acos(0.8)}
    )  # fmt: skip
    assert [line["uncertainty"] for line in lines.values()] == [
        None, pytest.approx(4e-3), pytest.approx(2e-3), pytest.approx(5e-3),
    ]  # fmt: skip
    assert [line["unit"] for line in lines.values()] == ["m", "m", "m", "rad"]
    assert found["left_out"] == 4
    assert_allclose(found["axis"], [[0.94, 2.08, 3.0], [1.12, 1.84, 3.0]])
    profile = found["profile"]
    assert profile["height"] == pytest.approx([0.0, 0.1, 0.3])
    assert profile["radius"] == [0.05, 0.09, 0.07]
    assert profile["uncertainty"] == [1e-3, 2e-3, None]
