"""The page makes products, for its browser only, and writes nothing beside the scan."""

from __future__ import annotations

import csv
import io
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from starlette.testclient import TestClient

from amulor import handover, imaging
from amulor import io as files
from amulor.cli import main
from amulor.errors import CubeError
from amulor.handover import page as page_products
from amulor.view import page
from amulor.view.page import pictures

TOKEN = "a-token-for-tests"


@pytest.fixture
def maker() -> handover.PageProducts:
    return handover.PageProducts()


@pytest.fixture
def client(
    served: Callable[..., TestClient],
    recording: page.Recording,
    maker: handover.PageProducts,
) -> TestClient:
    return served(recording, products=maker)


@pytest.fixture
def nothing_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the folder of temporary files, to see that none stays."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


def ask(client: TestClient, **wanted: Any) -> Any:
    return client.post(f"/{TOKEN}/product", json=wanted)


def table(text: str) -> dict[str, np.ndarray]:
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    rows = list(csv.reader(lines))
    return {
        name: np.array([float(row[at]) for row in rows[1:]])
        for at, name in enumerate(rows[0])
    }


@pytest.mark.slow
def test_what_is_offered_is_made_in_each_of_its_formats(
    client: TestClient, nothing_left: Path
) -> None:
    offered = client.get(f"/{TOKEN}/products").json()
    assert [one["product"] for one in offered] == [
        "report", "orthoimage", "dem", "contours", "section", "profile",
        "mesh", "cloud",
    ]  # fmt: skip
    starts = {
        ".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<", ".ply": b"ply",
        ".laz": b"LASF", ".las": b"LASF", ".e57": b"ASTM-E57", ".html": b"<!DOCTYPE",
        ".tif": b"II", ".nc": b"\x89HDF",
    }  # fmt: skip
    more = {
        "section": {"pixels": [[3, 1], [3, 10]]},
        "contours": {"contours": 0.001, "cell": 0.02},
        "orthoimage": {"cell": 0.01},
    }
    for one in offered:
        if one["product"] in ("contours", "profile"):
            continue  # a plate has none; asked for below
        for ending in one["endings"]:
            answer = ask(
                client, product=one["product"], ending=ending, channel="VV",
                **more.get(one["product"], {}),
            )  # fmt: skip
            assert answer.status_code == 200, (one, ending, answer.text)
            assert answer.content.startswith(starts.get(ending, b""))
            assert len(answer.content) > 100
            assert answer.headers["content-disposition"] == (
                f"attachment; filename*=UTF-8''plate-VV-{one['product']}{ending}"
            )
            assert answer.headers["content-type"] == "application/octet-stream"
            assert unquote(answer.headers["amulor-said"])
    plain = ask(client, product="contours", channel="VV", contours=0.001, cell=0.02)
    assert plain.status_code == 422
    assert "no contour line" in plain.json()["error"]
    flat = ask(client, product="profile", channel="VV")
    assert flat.status_code == 422
    assert "do not settle" in flat.json()["error"]
    assert list(nothing_left.iterdir()) == []


def test_a_section_runs_between_the_pixels_of_the_line(
    client: TestClient, target: xr.Dataset
) -> None:
    ends = [[1, 2], [4, 10]]
    answer = ask(client, product="section", ending=".csv", channel="VV", pixels=ends)
    found = table(answer.text)
    image = imaging.flag_outliers(
        imaging.flag_mixed(imaging.range_image(target, polarization="VV"))
    )
    cloud = imaging.point_cloud(image)
    for (row, column), at in zip(ends, (0, -1), strict=True):
        own = (cloud["row"].values == row) & (cloud["column"].values == column)
        # In a drawing of the front up is against y.
        assert found["right [m]"][at] == pytest.approx(cloud["x"].values[own][0])
        assert found["up [m]"][at] == pytest.approx(-cloud["y"].values[own][0])


def test_the_ends_of_a_section_lie_apart_in_the_drawing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    image = xr.Dataset({"slant_range": (("row", "column"), np.ones((1, 4)))})
    # The second pixel lies behind the first, the third opposite to it.
    places = {"x": [0.3, 0.3, -0.3, 0.3], "y": [0.2, 0.2, 0.2, -0.2], "z": [1, 2, 1, 1]}
    pixels = {"row": [0, 0, 0, 0], "column": [0, 1, 2, 3]}
    cloud = xr.Dataset({k: ("point", v) for k, v in {**places, **pixels}.items()})
    monkeypatch.setattr(imaging, "point_cloud", lambda image, frame: cloud)
    monkeypatch.setattr(
        imaging.products, "plane_of", lambda *_: SimpleNamespace(axes=np.eye(3))
    )

    def line(column: int) -> tuple[float, ...]:
        frame: Any = None
        return page_products._line(image, frame, "front", [[0, 0], [0, column]])

    assert line(2) == (0.3, 0.2, -0.3, 0.2)
    assert line(3) == (0.3, 0.2, 0.3, -0.2)
    with pytest.raises(CubeError) as refused:
        line(1)
    assert str(refused.value) == (
        "seen from the front, both ends of the section are at the same place"
    )


def test_deviations_are_from_the_mesh_that_was_given_at_the_start(
    served: Callable[..., TestClient], recording: page.Recording, tmp_path: Path
) -> None:
    trimesh = pytest.importorskip("trimesh")
    wall = trimesh.creation.box((4000.0, 4000.0, 10.0))
    wall.apply_translation((0, 0, 1505.0))  # its face at 1.5 m, where the plate is
    path = tmp_path / "wall.stl"
    wall.export(path)
    maker = handover.PageProducts(against=path, unit="mm")
    client = served(recording, products=maker)
    names = [one["product"] for one in client.get(f"/{TOKEN}/products").json()]
    assert "deviation" in names
    answer = ask(client, product="deviation", ending=".csv", channel="VV")
    found = table(answer.text)
    ratio = found["deviation [m]"] / found["standard_uncertainty [m]"]
    assert np.mean(np.abs(ratio) < 3) > 0.9
    assert np.abs(found["deviation [m]"]).max() < 0.05


def test_options_are_those_of_the_command(
    client: TestClient, target: xr.Dataset, tmp_path: Path
) -> None:
    image = imaging.flag_outliers(
        imaging.flag_mixed(imaging.range_image(target, polarization="VV"))
    )
    files.write_cube(image, tmp_path / "image.nc")
    out = tmp_path / "heights.tif"
    words = ["export", str(tmp_path / "image.nc"), "-o", str(out), "--cell", "2 cm"]
    assert main([*words, "--axes", "z-up", "--title", "plate"]) == 0
    answer = ask(
        client, product="dem", ending=".tif", channel="VV", cell=0.02, axes="z-up",
    )  # fmt: skip
    tifffile = pytest.importorskip("tifffile")
    mine = tifffile.imread(io.BytesIO(answer.content))
    assert_allclose(mine, tifffile.imread(out), equal_nan=True)


@pytest.mark.parametrize(
    ("wanted", "words"),
    [
        ({}, "no product ''"),
        ({"product": "../../etc/passwd"}, "no product"),
        ({"product": "deviation"}, "no product 'deviation'"),
        ({"product": "dem", "ending": ".exe"}, "not '.exe'"),
        ({"product": "dem", "ending": "/../x.tif"}, "is written to"),
        ({"product": "dem", "output": "/tmp/x.tif"}, "no option 'output'"),
        ({"product": "dem", "against": "/etc/passwd"}, "no option 'against'"),
        ({"product": "mesh", "cell": 0.1}, "no option 'cell'"),
        ({"product": "dem", "cell": -1}, "from 1e-05 to 1"),
        ({"product": "dem", "cell": "1"}, "must be a number"),
        ({"product": "dem", "cell": True}, "must be a number"),
        ({"product": "dem", "scale": 1e9}, "from 0.1"),
        ({"product": "dem", "side": "below"}, "one of front, top"),
        ({"product": "dem", "good_only": "yes"}, "true or false"),
        ({"product": "dem", "axes": "pose"}, "pose"),
        ({"product": "contours"}, "interval"),
        ({"product": "section"}, "two pixels"),
        ({"product": "section", "pixels": [[0, 0], [99, 0]]}, "two pixels"),
        ({"product": "section", "pixels": [[0, 0.5], [1, 0]]}, "two pixels"),
        ({"product": "section", "pixels": [[1, 1], [1, 1]]}, "same pixel"),
        ({"product": "cloud", "channel": "../VV"}, "no channel"),
        ({"product": "cloud", "largest_uncertainty": 1e-8}, ""),
    ],
)
def test_a_request_that_makes_no_sense_is_answered_in_words(
    client: TestClient, nothing_left: Path, wanted: dict[str, Any], words: str
) -> None:
    answer = ask(client, **wanted)
    assert answer.status_code == 422
    assert words in answer.json()["error"]
    assert list(nothing_left.iterdir()) == []


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"origin": "http://evil.example"}, 403),
        ({"origin": "null"}, 403),
        ({"host": "evil.example"}, 421),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"content-length": "9999999"}, 413),
    ],
)
def test_products_are_made_for_the_page_only(
    client: TestClient, headers: dict[str, str], status: int
) -> None:
    for method, address in (("POST", "product"), ("GET", "products")):
        answer = client.request(
            method, f"/{TOKEN}/{address}", json={"product": "cloud"}, headers=headers
        )
        assert answer.status_code == status
    for address in ("/product", "/another-token/product", "/products"):
        assert client.post(address, json={"product": "cloud"}).status_code == 404
    for method in ("GET", "PUT", "DELETE"):
        assert client.request(method, f"/{TOKEN}/product").status_code == 405


def test_names_of_files_stay_names_of_files(
    served: Callable[..., TestClient], target: xr.Dataset, maker: handover.PageProducts
) -> None:
    evil = page.recording_of(target, name='../a"b\r\nx: y/ö.nc')
    answer = ask(served(evil, products=maker), product="cloud", ending=".xyz")
    assert answer.headers["content-disposition"].isascii()
    name = unquote(answer.headers["content-disposition"].partition("''")[2])
    assert name == "a_b__x__y_ö-VV-cloud.xyz"


def test_one_product_at_a_time_and_none_that_is_too_large(
    maker: handover.PageProducts,
    target: xr.Dataset,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    image = imaging.range_image(target, polarization="VV")
    begun, go_on = threading.Event(), threading.Event()

    def slow(*_: Any, **__: Any) -> str:
        begun.set()
        go_on.wait(20)
        raise CubeError("broken off")

    wanted = {"product": "cloud", "ending": ".xyz"}
    said: list[str] = []

    def first() -> None:
        try:
            maker.make(image, wanted, stem="a")
        except CubeError as error:
            said.append(str(error))

    monkeypatch.setattr(page_products, "hand_over", slow)
    other = threading.Thread(target=first)
    other.start()
    assert begun.wait(20)
    with pytest.raises(CubeError, match="another product is being made"):
        maker.make(image, wanted, stem="b")
    go_on.set()
    other.join(20)
    assert said == ["broken off"]
    # One that broke off is in nobody's way.
    monkeypatch.setattr(page_products, "hand_over", handover.hand_over)
    assert maker.make(image, wanted, stem="c").name == "c-cloud.xyz"
    monkeypatch.setattr(page_products, "MOST_PIXELS", 10)
    with pytest.raises(CubeError, match="use amulor export"):
        maker.make(image, wanted, stem="d")


def test_without_a_maker_there_are_no_products(
    served: Callable[..., TestClient], recording: page.Recording
) -> None:
    client = served(recording)
    assert client.get(f"/{TOKEN}/products").json() == []
    assert "no products" in ask(client, product="cloud").json()["error"]


def test_an_image_that_is_read_in_bands_says_which_command_to_use(
    served: Callable[..., TestClient],
    target: xr.Dataset,
    maker: handover.PageProducts,
    tmp_path: Path,
) -> None:
    path = tmp_path / "large.nc"
    files.write_cube(imaging.range_image(target, polarization="VV"), path)
    shown = page.Recording("large.nc", image=pictures.large_picture(path))
    answer = ask(served(shown, products=maker), product="cloud")
    assert answer.status_code == 422
    assert "use amulor export" in answer.json()["error"]


@pytest.mark.parametrize(
    ("name", "field", "low", "high"),
    [
        ("cell", "cell", 1e-5, 1.0),
        ("contours", "contours", 1e-5, 10.0),
        ("farthest", "farthest", 1e-6, 100.0),
        ("scale", "scale", 0.1, 1e4),
        ("dpi", "dots_per_inch", 10.0, 1200.0),
    ],
)
def test_numbers_of_an_order_have_limits(maker, name, field, low, high) -> None:
    image: Any = None
    for value in (low, high):
        order = maker._order("mesh", {name: value}, image, image)
        assert getattr(order, field) == value
    for value in (0.99 * low, 1.01 * high, -high, float("nan")):
        with pytest.raises(CubeError, match=f"^{name} must be from {low:g} to "):
            maker._order("mesh", {name: value}, image, image)
    for word in (True, "1", [1.0]):
        with pytest.raises(CubeError, match=f"^{name} must be a number"):
            maker._order("mesh", {name: word}, image, image)


def test_what_an_order_leaves_out_has_its_usual_value(maker) -> None:
    image: Any = None
    order = maker._order("mesh", {}, image, image)
    assert (order.product, order.side) == ("mesh", "front")
    assert (order.cell, order.contours, order.farthest, order.scale) == (None,) * 4
    assert order.dots_per_inch == 300
    assert maker._order("mesh", {"side": "top"}, image, image).side == "top"
    with pytest.raises(CubeError, match="side must be one of front, top"):
        maker._order("mesh", {"side": "left"}, image, image)
