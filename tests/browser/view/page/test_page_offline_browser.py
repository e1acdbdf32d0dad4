"""Measurements in a saved page against those of the library, on the same numbers."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import exact_shapes
import numpy as np
import pytest
import xarray as xr

from amulor import cube
from amulor.cube import QualityFlag
from amulor.view import page
from amulor.view.page.measuring import measured
from amulor.view.page.pictures import values_of
from amulor.view.page.recording import recording_of

pytestmark = pytest.mark.slow

SIDE = 60
#: Column where each surface begins: a plane, a ball, a pipe.
PLANE, BALL, PIPE = 0, 60, 120
RADIUS = 0.11


def scene(*, line_window: int = 0) -> xr.Dataset:
    """Return a plane, a ball and a pipe beside each other, with noise."""
    rng = np.random.default_rng(41)
    azimuth, elevation = np.meshgrid(
        np.linspace(-0.3, 0.3, 3 * SIDE), -np.linspace(-0.1, 0.1, SIDE)
    )
    zero = np.zeros(azimuth.shape)

    def built(ranges: np.ndarray) -> xr.Dataset:
        single = np.float32
        maps = {
            "slant_range": ranges,
            "slant_range_uncertainty": 1.1e-3 + 2e-4 * azimuth,
            "slant_range_common_uncertainty": zero + 7e-4,
            "slant_range_uncertainty_drift": zero + 3e-4,
            "slant_range_uncertainty_delay": zero + 2e-4,
            "intensity": zero + 0.01,
        }
        flags = np.zeros(azimuth.shape, dtype=np.int16)
        flags[::7, ::11] = QualityFlag.MIXED
        attributes = cube.attributes(
            "range_image",
            title="shapes",
            source="test",
            polarization="none",
            modulation_frequencies=np.array([80e6, 190e6]),
        )
        attributes["open_water_degree"] = 2
        if line_window:
            attributes["phasor_line_window"] = line_window
        return cube.build(
            "range_image",
            # A page has 32 bits of each number.
            {key: values.astype(single).astype(float) for key, values in maps.items()}
            | {"quality_flag": flags},
            {"azimuth": azimuth, "elevation": elevation},
            geometry={
                "group_index": 1.36,
                "refractive_index": 1.34,
                "emitter_position": np.zeros(3),
                "receiver_position": np.array([0.07, 0.0, 0.0]),
            },
            attributes=attributes,
        )

    beams = values_of(built(zero + 1.5))
    base, aim = beams[..., :3], beams[..., 3:6]
    normal = np.array([0.2, 0.1, -1.0]) / np.sqrt(1.05)
    plane = (1.5 * normal[2] - base @ normal) / (aim @ normal)
    ball = _first(base - [0.0, 0.0, 1.6], aim, RADIUS)
    axis = np.array([0.3, 1.0, 0.1]) / np.sqrt(1.1)
    across = np.eye(3) - np.outer(axis, axis)
    pipe = _first((base - [0.3, 0.0, 1.6]) @ across, aim @ across, RADIUS)
    ranges = np.where(np.arange(3 * SIDE) < BALL, plane, pipe)
    ranges[:, BALL:PIPE] = ball[:, BALL:PIPE]
    return built(ranges + rng.normal(0, 8e-4, ranges.shape))


def _first(place: np.ndarray, aim: np.ndarray, radius: float) -> np.ndarray:
    """Return where beams enter a round object; NaN beside it."""
    square, half = (aim**2).sum(-1), (aim * place).sum(-1)
    inside = half**2 - square * ((place**2).sum(-1) - radius**2)
    return (-half - np.sqrt(np.where(inside > 0, inside, np.nan))) / square


#: Measurements in the page, with the beams of the library instead of interpolated ones.
MEASURE = """async ([requests, beams]) => {
  const { measuredHere } = await import("page/offline.js");
  const { scene } = amulor;
  const count = (size) => Array.from({ length: size }, (_, k) => k);
  const own = scene.beams;
  if (beams) Object.assign(scene.beams, {
    rows: count(scene.rows), columns: count(scene.columns),
    values: Float64Array.from(beams),
  });
  const out = [];
  for (const { kind, axis, pixels, region, base, clip, reach } of requests)
    out.push(await measuredHere(scene, { kind, axis },
      { picks: pixels, region, base, clip: clip ?? null, reach: reach ?? 0 }));
  return out;
}"""


def words(answer: dict[str, Any]) -> str:
    """Return the doubt about a fit without its number."""
    return re.sub(r"\d\S*", "", answer.get("doubt", ""))


WHOLE = {
    "plane": [5, PLANE + 4, 56, PLANE + 50],
    "sphere": [12, BALL + 12, 46, BALL + 46],
    "cylinder": [6, PIPE + 16, 52, PIPE + 44],
}
CORNERS = [[10, 8], [12, 40], [50, 44], [48, 6]]
REQUESTS: list[dict[str, Any]] = [
    *({"kind": kind, "region": region} for kind, region in WHOLE.items()),
    # A ball and a flat board that are no plane and no ball.
    {"kind": "plane", "region": WHOLE["sphere"]},
    {"kind": "sphere", "region": WHOLE["plane"]},
    {
        "kind": "plane",
        "region": WHOLE["plane"],
        "clip": {"low": [-0.4, None, 1.0], "high": [None, 0.05, None]},
    },
    {"kind": "circle", "pixels": [[30, 20], [20, 30], [30, 41], [41, 30], [22, 23]]},
    *(
        {"kind": kind, "pixels": CORNERS[:count], "reach": reach}
        for kind, count in (("distance", 2), ("angle", 3), ("area", 4))
        for reach in (0, 2)
    ),
    # The ball over the plane of the board, with missing pixels and a step about it.
    {
        "kind": "volume",
        "region": [0, BALL - 12, 59, PIPE - 1],
        "base": WHOLE["plane"],
    },
    {
        "kind": "volume",
        "region": [0, PLANE, 59, PIPE - 1],
        "base": [5, 4, 20, 20],
        "clip": {"low": [-0.5, -0.05, None], "high": [0.02, None, None]},
    },
    {"kind": "height", "pixels": CORNERS[:2], "axis": [0, 0, -1], "reach": 1},
]


@pytest.mark.parametrize("line_window", [0, 9])
def test_a_saved_page_measures_as_the_library_does(
    tab: Callable[..., Any], tmp_path: Path, line_window: int
) -> None:
    image = scene(line_window=line_window)
    recording = recording_of(image, name="shapes.nc")
    page.save_page(recording, tmp_path / "page.html")
    opened = tab()
    shown = opened.open((tmp_path / "page.html").as_uri())
    # The noise of the scene is no noise of phasor lines, so its plane is no base.
    requests = [
        request
        for request in REQUESTS
        if request["kind"] != "volume" or not line_window
    ]
    interpolated = shown.evaluate(MEASURE, [requests, None])
    exact = shown.evaluate(MEASURE, [requests, values_of(image).ravel().tolist()])
    for request, found, rough in zip(requests, exact, interpolated, strict=True):
        expected = measured(recording, request)
        assert words(found) == words(expected), request
        assert found["pixels"] == expected["pixels"], request
        assert len(found["lines"]) == len(expected["lines"])
        for line, near, right in zip(
            found["lines"], rough["lines"], expected["lines"], strict=True
        ):
            where = (request, right["label"])
            assert line["label"] == right["label"]
            assert line["unit"] == right["unit"]
            for key in ("value", "uncertainty"):
                assert line[key] == pytest.approx(right[key], rel=1e-6, abs=1e-9), where
            # Interpolated beams are at most 2 um off.
            error = max(right["uncertainty"], 1e-4)
            assert abs(near["value"] - right["value"]) < 0.02 * error, where
        for key in ("random", "residual", "misfit"):
            if key in expected:
                assert found[key] == pytest.approx(expected[key], rel=1e-6), request
    radii = {
        request["kind"]: line
        for request, answer in zip(REQUESTS[:3], exact, strict=False)
        for line in answer["lines"]
        if line["label"] == "radius"
    }
    for line in radii.values():
        assert abs(line["value"] - RADIUS) < 4 * line["uncertainty"]
    assert opened.errors == []


def test_a_plane_is_fitted_by_dragging(tab: Callable[..., Any], tmp_path: Path) -> None:
    page.save_page(recording_of(scene(), name="shapes.nc"), tmp_path / "page.html")
    opened = tab()
    shown = opened.open((tmp_path / "page.html").as_uri())
    shown.click("#tools button[data-kind=plane]")
    box = shown.locator("#map").bounding_box()
    y = box["y"] + box["height"] / 2
    shown.mouse.move(box["x"] + 0.1 * box["width"], y - 15)
    shown.mouse.down()
    shown.mouse.move(box["x"] + 0.25 * box["width"], y + 15, steps=4)
    shown.mouse.up()
    shown.wait_for_selector("#measurements li")
    text = shown.inner_text("#measurements")
    assert "tilt" in text
    assert "flatness" in text
    assert shown.is_enabled("#tools button[data-kind=volume]")
    assert shown.locator("#average").is_visible()
    assert opened.errors == []


def jar(scan: exact_shapes.Beams) -> np.ndarray:
    """Return ranges of a jar whose radius grows and shrinks with the height [m].

    Points of the jar are solutions of |across| = radius(height), by steps along a beam.
    """
    foot = np.array([0.01, 0.12, 1.55])
    up = np.array([0.06, -1.0, 0.09]) / np.linalg.norm([0.06, -1.0, 0.09])

    def off(ranges: np.ndarray) -> np.ndarray:
        away = ranges[..., None] * scan.unit - foot
        height = away @ up
        radial = np.linalg.norm(away - height[..., None] * up, axis=-1)
        wide = 0.05 + 0.03 * np.sin(np.pi * height / 0.3)
        return np.where(np.abs(height - 0.12) < 0.12, radial - wide, 1.0)

    steps = np.linspace(1.3, 1.6, 601)
    outside = np.stack([off(np.full(scan.unit.shape[:2], step)) for step in steps])
    first = np.argmax(outside < 0, axis=0)
    near, far = steps[np.maximum(first - 1, 0)], steps[first]
    for _ in range(40):
        middle = (near + far) / 2
        near, far = (
            np.where(off(middle) > 0, middle, near),
            np.where(off(middle) > 0, far, middle),
        )
    return np.where((outside < 0).any(axis=0) & (first > 0), far, np.nan)


def test_a_saved_page_measures_half_profiles_as_the_library_does(
    tab: Callable[..., Any], tmp_path: Path
) -> None:
    scan = exact_shapes.beams(rows=40, columns=40, half=0.085)
    ranges = jar(scan)
    ranges += exact_shapes.errors(ranges, np.random.default_rng(41))
    # A handle, which is no part of the profile.
    ranges[14:20, 24:27] -= 0.03
    image = exact_shapes.image(scan, ranges)
    recording = recording_of(image, name="jar.nc")
    page.save_page(recording, tmp_path / "page.html")
    opened = tab()
    shown = opened.open((tmp_path / "page.html").as_uri())
    request = {"kind": "profile", "region": [0, 0, 39, 39]}
    beams = values_of(image).ravel().tolist()
    (found,) = shown.evaluate(MEASURE, [[request], beams])
    expected = measured(recording, request)
    assert found["doubt"] == expected["doubt"] == ""
    assert found["left_out"] == expected["left_out"] > 5
    assert found["pixels"] == expected["pixels"]
    for line, right in zip(found["lines"], expected["lines"], strict=True):
        assert line["label"] == right["label"]
        assert line["unit"] == right["unit"]
        error = right["uncertainty"]
        # The robust start of both fits ends at slightly different places.
        assert abs(line["value"] - right["value"]) < 0.01 * error, right["label"]
        assert line["uncertainty"] == pytest.approx(error, rel=0.01), right["label"]
    largest = found["lines"][1]
    assert abs(largest["value"] - 0.16) < 4 * largest["uncertainty"]
    assert found["misfit"] == pytest.approx(expected["misfit"], rel=1e-3)
    for key in ("height", "radius"):
        np.testing.assert_allclose(
            found["profile"][key], expected["profile"][key], rtol=0, atol=2e-6
        )
    np.testing.assert_allclose(found["axis"], expected["axis"], rtol=0, atol=2e-5)
    # A board has no axis; both refuse it in words.
    for wrong in ([0, 0, 1, 1], [14, 24, 19, 26]):
        with pytest.raises(Exception, match="60"):
            shown.evaluate(MEASURE, [[{**request, "region": wrong}], beams])
    assert opened.errors == []
