"""The page gets the numbers of the cube, and words where there are none."""

from __future__ import annotations

import dataclasses
import re
import time
from collections.abc import Callable
from contextlib import closing
from http.client import HTTPConnection
from pathlib import Path
from typing import Any

import exact_shapes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from starlette.testclient import TestClient

from amulor import imaging, io
from amulor.cli import main
from amulor.cube import QualityFlag, schema
from amulor.errors import CubeError
from amulor.imaging import measure
from amulor.imaging.observation import geometry_of
from amulor.view import page
from amulor.view.page import measuring, pictures
from amulor.view.page import recording as recordings
from amulor.view.page.layers import packed, unpacked
from amulor.view.page.saved import static_files

TOKEN = "a-token-for-tests"


def layer(client: TestClient, channel: str, name: str, form: str = "<f4") -> np.ndarray:
    answer = client.get(f"/{TOKEN}/layer/{channel}/{name}")
    assert answer.status_code == 200, answer.text
    return np.frombuffer(answer.content, form)


def test_a_map_holds_the_numbers_of_the_range_image(
    client: TestClient, target: xr.Dataset
) -> None:
    scene = client.get(f"/{TOKEN}/scene", params={"channel": "VH"}).json()
    assert (scene["rows"], scene["columns"], scene["channel"]) == (6, 12, "VH")
    image = imaging.range_image(target, polarization="VH")
    for name, variable in (
        ("range", "slant_range"),
        ("uncertainty", "slant_range_uncertainty"),
        ("amplitude", "intensity"),
    ):
        assert_array_equal(
            layer(client, "VH", name),
            image[variable].values.astype(np.float32).ravel(),
        )
    flags = layer(client, "VH", "flags", "<u2").reshape(6, 12)
    assert_array_equal(
        flags & int(QualityFlag.NO_TARGET),
        image["quality_flag"].values & int(QualityFlag.NO_TARGET),
    )


def test_the_picture_before_rejection_lies_nearer(client: TestClient) -> None:
    before = layer(client, "VV", "range_before")
    after = layer(client, "VV", "range")
    # Milk: the water pulls the plate towards the instrument by centimetres.
    assert np.nanmedian(after) == pytest.approx(1.5, abs=0.02)
    assert np.nanmedian(after - before) > 0.02


def test_points_of_the_page_are_those_of_the_cloud(
    recording: page.Recording, target: xr.Dataset
) -> None:
    image = imaging.range_image(target, polarization="VV")
    nodes = recording.nodes("VV")
    found = pictures.interpolated(nodes, np.arange(6), np.arange(12))
    points = found[..., :3] + image["slant_range"].values[..., None] * found[..., 3:6]
    beam = geometry_of(image).beam
    exact = beam.entry + image["slant_range"].values[..., None] * beam.direction
    usable = np.isfinite(exact).all(axis=-1)
    assert_allclose(points[usable], exact[usable], rtol=0, atol=3e-6)
    assert_allclose(found[..., 6], image["azimuth"].values, rtol=0, atol=3e-6)


def test_beams_that_jitter_keep_a_node_each() -> None:
    rng = np.random.default_rng(1)

    def read(rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        values = np.zeros((50, 60, 8))
        values[..., 3:6] = np.random.default_rng(1).normal(size=(50, 60, 3))
        return values[np.ix_(rows, columns)]

    del rng
    nodes = pictures.nodes_of(read, (50, 60), farthest=2.0)
    assert nodes.values.shape == (50, 60, 8)
    smooth = pictures.nodes_of(
        lambda rows, columns: np.ones((len(rows), len(columns), 8)),
        (500, 600),
        farthest=2.0,
    )
    assert smooth.values.shape[0] < 12
    assert (smooth.rows[0], smooth.rows[-1]) == (0, 499)


def test_a_spectrum_is_that_of_the_samples(
    client: TestClient, target: xr.Dataset
) -> None:
    found = client.get(f"/{TOKEN}/spectrum/VV/2/7").json()
    one = target.sel(polarization="VV").isel(row=2, column=7)
    signal = one["in_phase"].values + 1j * one["quadrature"].values
    water = one["water_in_phase"].values + 1j * one["water_quadrature"].values
    assert_allclose(found["frequency"], target["modulation_frequency"].values)
    assert_allclose(found["after"]["amplitude"], np.abs(signal))
    assert_allclose(found["before"]["amplitude"], np.abs(signal + water))
    assert_allclose(found["water"]["phase"], np.angle(water))


def test_the_server_measures_what_the_library_measures(
    client: TestClient, target: xr.Dataset
) -> None:
    request = {"kind": "distance", "channel": "VV", "pixels": [[1, 1], [4, 10]]}
    found = client.post(f"/{TOKEN}/measure", json=request).json()
    image = imaging.flag_outliers(
        imaging.flag_mixed(imaging.range_image(target, polarization="VV"))
    )
    expected = imaging.measure.distance(image, (1, 1), (4, 10))
    assert found["lines"][0]["value"] == expected.value
    assert found["lines"][0]["uncertainty"] == expected.uncertainty
    # The plate is flat: 9 columns and 3 rows apart.
    assert found["lines"][0]["value"] == pytest.approx(0.093, abs=0.01)
    # A height without an axis is against that of elevation.
    request |= {"kind": "height"}
    found = client.post(f"/{TOKEN}/measure", json=request).json()
    upwards = imaging.measure.height(image, (1, 1), (4, 10), axis=(0.0, -1.0, 0.0))
    assert found["lines"][0]["value"] == upwards.value
    request = {"kind": "plane", "channel": "VV", "region": [5, 11, 0, 0]}
    found = client.post(f"/{TOKEN}/measure", json=request).json()
    offset = next(line for line in found["lines"] if line["label"] == "offset")
    assert abs(abs(offset["value"]) - 1.5) < 4 * offset["uncertainty"] + 0.005
    # A flat plate has no radius, and none is stated.
    found = client.post(f"/{TOKEN}/measure", json={**request, "kind": "sphere"}).json()
    assert "radius not constrained" in found["doubt"]
    assert found["lines"] == []


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"kind": "weight", "pixels": [[0, 0]]}, "cannot be measured"),
        ({"kind": "distance", "pixels": [[0, 0]]}, "needs 2 points, got 1"),
        ({"kind": "distance", "pixels": [[0, 0], [0, 99]]}, "column must be from 0"),
        ({"kind": "distance", "pixels": [[0, 0], [0, "1"]]}, "whole number"),
        ({"kind": "distance", "pixels": [[0, 0]] * 201}, "pick 1 to 200"),
        ({"kind": "distance", "pixels": [[0, 0], [0]]}, "a row and a column"),
        ({"kind": "height", "pixels": [[0, 0], [1, 1]], "axis": [0, 0]}, "an axis"),
        ({"kind": "height", "pixels": [[0, 0], [1, 1]], "axis": [0, 0, 0]}, "length"),
        ({"kind": "area", "pixels": [[0, 0], [1, 1]]}, "at least 3 corners"),
        ({"kind": "volume", "region": [0, 0, 5, 5]}, "a region has"),
        ({"kind": "plane", "region": [0, 0, 0]}, "a region has"),
        ({"kind": "sphere", "region": [0, 0, 1, 1]}, "at least 5 usable"),
        ({"kind": "distance", "channel": "RR", "pixels": [[0, 0]]}, "no channel 'RR'"),
        ([], "must be a JSON object"),
    ],
)
def test_a_request_that_makes_no_sense_is_answered_in_words(
    client: TestClient, request_: object, words: str
) -> None:
    answer = client.post(f"/{TOKEN}/measure", json=request_)
    assert answer.status_code == 422
    assert words in answer.json()["error"]


def test_no_json_and_no_such_thing_are_answered_in_words(client: TestClient) -> None:
    answer = client.post(f"/{TOKEN}/measure", content=b"{")
    assert answer.json() == {"error": "the request is no JSON"}
    deep = b"[" * 100_000
    assert client.post(f"/{TOKEN}/measure", content=deep).status_code == 422
    for path in ("layer/VV/nothing", "spectrum/VV/6/0", "scene?channel=XX"):
        assert client.get(f"/{TOKEN}/{path}").status_code == 422, path


def test_every_flag_has_words() -> None:
    words = schema.flag_words()["pixel"]
    assert {flag.name for flag in QualityFlag if flag} == set(words)
    assert all(entry["short"] for entry in words.values())


def test_numbers_come_back_from_a_page() -> None:
    content = np.random.default_rng(1).normal(size=1000).astype("<f4").tobytes()
    assert unpacked(packed(content, width=4), width=4) == content


def test_a_saved_page_holds_all_it_needs(
    recording: page.Recording, target: xr.Dataset, tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    page.save_page(recording, path, measurements=[{"kind": "distance"}])
    text = path.read_text()
    assert "http://" not in text.replace("http://www.w3.org/", "")
    assert 'src="static' not in text
    assert 'href="static' not in text
    start = text.index('data-name="layer/VV/range"')
    data = text[text.index(">", start) + 1 : text.index("</script>", start)]
    image = imaging.range_image(target, polarization="VV")
    assert_array_equal(
        np.frombuffer(unpacked(data, width=4), "<f4").reshape(6, 12),
        image["slant_range"].values.astype(np.float32),
    )
    with pytest.raises(Exception, match="exists"):
        page.save_page(recording, path)


@pytest.mark.parametrize("kept", [[{"kind": "distance"}] * 501, {"kind": "distance"}])
def test_a_page_is_saved_with_at_most_500_measurements(
    client: TestClient, kept: Any
) -> None:
    refused = client.post(f"/{TOKEN}/save", json={"measurements": kept})
    assert refused.status_code == 422
    assert "500 measurements" in refused.json()["error"]
    taken = client.post(
        f"/{TOKEN}/save", json={"measurements": [{"kind": "own"}] * 500}
    )
    assert taken.status_code == 200
    assert len(re.findall(r'"kind": ?"own"', taken.text)) == 500


def test_flatness_is_the_departure_without_the_noise() -> None:
    # Noise of 3 mm and a surface off its plane by 4 mm leave residuals of 5 mm.
    fit = measure.Fit(
        kind="plane",
        values={},
        uncertainties={},
        residual=5e-3,
        misfit=25 / 9,
        pixels=203,
    )
    line = measuring._flatness(fit)
    assert line["value"] == pytest.approx(4e-3)
    # A mean of 200 squares has the relative standard error of a tenth.
    assert line["uncertainty"] == pytest.approx(0.1 * 9e-6 / (2 * 4e-3))
    flat = measuring._flatness(dataclasses.replace(fit, residual=2e-3, misfit=0.9))
    assert flat["value"] == 0
    assert flat["uncertainty"] == pytest.approx(np.sqrt(0.1 * 4e-6 / 0.9))


def test_a_page_is_saved_with_typed_limits(client: TestClient) -> None:
    body = {"measurements": [], "limits": "range:1.2:1.5"}
    taken = client.post(f"/{TOKEN}/save", json=body)
    assert '"limits": "range:1.2:1.5"' in taken.text
    for limits in ("r" * 2001, ["range", 1.2, 1.5]):
        refused = client.post(f"/{TOKEN}/save", json={**body, "limits": limits})
        assert refused.status_code == 422
        assert "2000 letters" in refused.json()["error"]


def test_a_title_cannot_become_a_script(target: xr.Dataset) -> None:
    evil = target.assign_attrs(title="</script><script>alert(1)</script>")
    text = page.saved_page(page.recording_of(evil, name="<b>.nc"))
    assert "alert(1)</script>" not in text


def test_files_import_only_what_is_there() -> None:
    import re

    files = static_files()
    for name, content in files.items():
        if name.endswith(".js"):
            for used in re.findall(rb'from "([^"]+)"', content):
                assert used.startswith(b"./"), (name, used)
                assert used[2:].decode() in files, (name, used)


def test_many_pixels_are_drawn_by_strides(
    target: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recordings, "MOST_PIXELS", 20)
    thin = page.recording_of(target)
    scene = thin.describe("VV")
    assert scene["stride"] == 2
    image = imaging.range_image(target, polarization="VV")
    assert_array_equal(
        thin.layer("VV", "range", 2), image["slant_range"].values[::2, ::2]
    )


def test_a_large_file_is_read_in_bands_and_says_the_same(
    target: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = imaging.range_image(target, polarization="VV")
    path = tmp_path / "large.nc"
    io.write_cube(image, path)
    small = page.opened(path)
    monkeypatch.setenv("AMULOR_LARGE", "1")
    monkeypatch.setattr(pictures, "_BAND", 4)
    found = page.opened(path)
    assert found.channels == small.channels == ["VV"]
    for name in small.layers("VV"):
        for stride in (1, 2, 3):
            assert_array_equal(
                found.layer("VV", name, stride),
                small.layer("VV", name, stride).astype(
                    np.uint16 if name == "flags" else np.float32
                ),
            )
    assert_array_equal(found.nodes("VV").values, small.nodes("VV").values)
    assert found.describe()["sharing"]["alike"] == small.describe()["sharing"]["alike"]
    from amulor.view.page.measuring import measured

    request = {"kind": "distance", "channel": "VV", "pixels": [[1, 1], [4, 10]]}
    one, other = measured(found, request), measured(small, request)
    assert_allclose(
        one["lines"][0]["uncertainty"], other["lines"][0]["uncertainty"], rtol=1e-9
    )
    content = bytearray(path.read_bytes())
    content[5000] ^= 1
    path.write_bytes(content)
    with pytest.raises(Exception, match="is damaged"):
        page.opened(path)


def test_samples_beside_an_image_must_be_its_own(target: xr.Dataset) -> None:
    image = imaging.range_image(target, polarization="VV")
    with_both = page.recording_of(image, samples=target)
    assert "range_before" in with_both.layers("VV")
    assert with_both.has_spectrum
    with pytest.raises(CubeError, match="name the cube that the image was made from"):
        page.recording_of(image, samples=target.isel(row=slice(3)))
    with pytest.raises(CubeError, match="is of level 'point_cloud'"):
        page.recording_of(imaging.point_cloud(image))


def test_the_command_saves_a_page_and_explains_damage(
    target: xr.Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "target.nc", tmp_path / "page.html"
    io.write_cube(target, path)
    assert main(["view", str(path), "--save", str(out)]) == 0
    assert out.stat().st_size > 50_000
    assert main(["view", str(path), "--save", str(out)]) == 1
    assert "exists" in capsys.readouterr().err
    assert main(["view", str(path), "--save", str(tmp_path / "page.txt")]) == 2
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 255
    path.write_bytes(content)
    assert main(["view", str(path)]) == 1
    assert "is damaged" in capsys.readouterr().err


def test_a_file_that_is_damaged_while_it_is_open_gives_a_message(
    target: xr.Dataset,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    served: Callable[..., TestClient],
) -> None:
    path = tmp_path / "large.nc"
    io.write_cube(imaging.range_image(target, polarization="VV"), path)
    monkeypatch.setenv("AMULOR_LARGE", "1")
    client = served(page.opened(path))
    assert client.get(f"/{TOKEN}/scene").status_code == 200
    size = path.stat().st_size
    with path.open("r+b") as file:
        file.write(b"\0" * size)
    answer = client.get(f"/{TOKEN}/layer/VV/uncertainty")
    assert answer.status_code == 422
    assert "can no longer be read" in answer.json()["error"]


def test_fits_use_only_pixels_inside_the_clip_box(
    recording: page.Recording, target: xr.Dataset
) -> None:
    request = {"kind": "plane", "channel": "VV", "region": [0, 0, 5, 11]}
    image = imaging.range_image(target, polarization="VV")
    beam = geometry_of(image).beam
    place = beam.entry + image["slant_range"].values[..., None] * beam.direction
    middle = float(np.nanmedian(place[..., 0]))
    off = image["quality_flag"].values & (QualityFlag.MIXED | QualityFlag.OUTLIER)
    usable = np.isfinite(place).all(axis=-1) & (off == 0)
    clip = {"low": [None, None, 1.0], "high": [middle, None, None]}
    found = measuring.measured(recording, {**request, "clip": clip})
    expected = int((usable & (place[..., 0] <= middle)).sum())
    whole = measuring.measured(recording, request)
    assert 0 < found["pixels"] <= expected < whole["pixels"]
    for wrong in ({"low": [0, 0], "high": [1, 1, 1]}, [], {"low": ["a", 0, 0]}):
        with pytest.raises(CubeError, match="clip box"):
            measuring.measured(recording, {**request, "clip": wrong})


@pytest.mark.parametrize("large", [False, True])
def test_a_volume_of_many_pixels_is_that_of_a_coarser_surface(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, large: bool
) -> None:
    # A block, 8 cm high, on a plane that the beams meet 1.5 m ahead.
    scan = exact_shapes.beams(rows=48, columns=64)
    right, down = (scan.unit[..., k] / scan.unit[..., 2] for k in (0, 1))
    block = (np.abs(right) < 0.08) & (np.abs(down) < 0.06)
    ranges = np.where(block, 1.42, 1.5) / scan.unit[..., 2]
    path = tmp_path / "block.nc"
    io.write_cube(exact_shapes.image(scan, ranges), path)
    if large:
        monkeypatch.setenv("AMULOR_LARGE", "1")
        # Rows and columns of the coarse grid of the whole scan lie between.
        monkeypatch.setattr(pictures, "_MESH", 7)
    recording = page.opened(path)
    request = {"kind": "volume", "region": [2, 2, 45, 61], "base": [2, 2, 8, 61]}
    full = measuring.measured(recording, request)["lines"][0]
    monkeypatch.setattr(measuring, "_MOST_OF_VOLUME", 700)
    thinned = measuring.measured(recording, request)
    line = thinned["lines"][0]
    # The cone of beams between two planes; half a pixel at each edge is unknown.
    true = 0.16 * 0.12 * (1.5**3 - 1.42**3) / 3
    assert abs(full["value"] - true) < 2 * full["uncertainty"]
    assert abs(line["value"] - true) < 2 * line["uncertainty"]
    assert full["uncertainty"] < line["uncertainty"] < 0.3 * true
    assert thinned["pixels"] < 1100


def test_a_half_profile_has_the_diameters_of_a_cone() -> None:
    # A cone with its tip above, whose radius grows by a fifth of the depth below it.
    tip, tangent = np.array([-0.06, -0.5, 1.55]), 0.2
    down = np.array([0.10, 1.0, 0.08]) / np.linalg.norm([0.10, 1.0, 0.08])
    scan = exact_shapes.beams(rows=24, columns=24, half=0.07)
    square = 1 / (1 + tangent**2)
    along, height = scan.unit @ down, tip @ down
    a = along**2 - square
    b = square * (scan.unit @ tip) - along * height
    c = height**2 - square * (tip @ tip)
    root = np.sqrt(np.where(b**2 > a * c, b**2 - a * c, np.nan))
    both = np.stack([(-b - root) / a, (-b + root) / a])
    below = (both * along - height > 0) & (both > 0)
    image = exact_shapes.image(scan, np.min(np.where(below, both, np.nan), axis=0))
    request = {"kind": "profile", "region": [0, 0, 23, 23]}
    found = measuring.measured(page.recording_of(image, name="cone.nc"), request)
    ends = (np.array(found["axis"]) - tip) @ down
    diameters = {line["label"]: line["value"] for line in found["lines"]}
    assert diameters["base diameter"] == pytest.approx(2 * tangent * ends[0], abs=1e-6)
    assert diameters["rim diameter"] == pytest.approx(2 * tangent * ends[1], abs=1e-6)
    assert diameters["largest diameter"] == diameters["base diameter"]
    assert diameters["tilt of the axis"] == pytest.approx(np.arccos(down[1]), abs=1e-6)
    profile = found["profile"]
    assert profile["height"][-1] == pytest.approx(ends[0] - ends[1], abs=1e-6)
    assert len(profile["radius"]) == len(profile["uncertainty"])
    board = {"kind": "profile", "region": [0, 0, 1, 1]}
    with pytest.raises(CubeError, match="60"):
        measuring.measured(page.recording_of(image, name="cone.nc"), board)


def test_answers_of_a_kept_connection_do_not_wait_for_the_browser(
    target: xr.Dataset,
) -> None:
    with (
        page.background(page.recording_of(target), token=TOKEN) as address,
        closing(HTTPConnection(address.split("/")[2])) as link,
    ):

        def asked(*, anew: bool) -> float:
            if anew:
                link.close()
            begun = time.monotonic()
            link.request("GET", f"/{TOKEN}/scene")
            assert link.getresponse().read()
            return time.monotonic() - begun

        # A system acknowledges the first answers of a connection at once, later ones
        # after 40 ms: a server must not wait for that between head and content.
        first = min(asked(anew=True) for _ in range(8))
        later = min(asked(anew=False) for _ in range(8))
    assert later < 5 * first
