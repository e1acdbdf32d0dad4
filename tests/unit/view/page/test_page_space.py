"""Clouds and meshes in the page: every format gives its points, damage gives a line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from starlette.testclient import TestClient

from amulor import imaging, io
from amulor.cli import main
from amulor.errors import AmulorError, CubeError, FormatError
from amulor.io import laz
from amulor.io.shapes import spread
from amulor.view.page import save_page, space

TOKEN = "a-token-for-tests"


@pytest.fixture(scope="module")
def cloud(target: xr.Dataset) -> xr.Dataset:
    return imaging.point_cloud(imaging.range_image(target, polarization="VV"))


@pytest.fixture
def written(cloud: xr.Dataset, tmp_path: Path) -> Callable[[str], Path]:
    def write(ending: str) -> Path:
        path = tmp_path / f"cloud{ending}"
        if ending == ".nc":
            io.write_cube(cloud, path)
        else:
            io.write_cloud(cloud, path)
        return path

    return write


def in_order(shown: space.Space) -> np.ndarray:
    """Return points in an order of their own: the page shuffles them."""
    points = shown.position.astype(float) + shown.centre
    return points[np.lexsort(points.T)]


@pytest.mark.parametrize(
    ("ending", "error"),
    # What a format rounds to: text and LAS to a micrometre, the page to 32 bits.
    [(".ply", 1e-7), (".laz", 6e-7), (".las", 6e-7), (".e57", 1e-7), (".xyz", 6e-7),
     (".csv", 6e-7), (".nc", 1e-7)],
)  # fmt: skip
def test_a_cloud_comes_back_from_every_format(
    written: Callable[[str], Path], cloud: xr.Dataset, ending: str, error: float
) -> None:
    shown = space.opened(written(ending))
    wanted = np.stack([cloud[axis].values for axis in "xyz"], axis=1)
    # Sorting is by whole points; both have the same ones in the same places.
    away = np.abs(in_order(shown)[:, None, :] - wanted[None]).max(axis=2)
    assert away.min(axis=1).max() < error
    assert away.min(axis=0).max() < error
    described = shown.describe()
    assert (described["up"], described["beams"]) == ("-y", True)
    assert described["points"] == described["total"] == cloud.sizes["point"]
    if ending != ".e57":  # the only one that has no place for them
        sigma = np.sort(shown.scalars["uncertainty"])
        assert_allclose(sigma, np.sort(cloud["slant_range_uncertainty"]), rtol=1e-3)
        assert shown.layers[1]["name"] == "amplitude"
        assert shown.layers[1]["unit"] == "V"


def test_numbers_stay_with_their_points(
    written: Callable[[str], Path], cloud: xr.Dataset
) -> None:
    shown = space.opened(written(".ply"))
    wanted = np.stack([cloud[axis].values for axis in "xyz"], axis=1) - shown.centre
    for place, sigma, flags in zip(
        shown.position, shown.scalars["uncertainty"], shown.scalars["flags"],
        strict=True,
    ):  # fmt: skip
        own = int(np.argmin(np.abs(wanted - place).sum(axis=1)))
        assert sigma == np.float32(cloud["slant_range_uncertainty"].values[own])
        assert flags == cloud["quality_flag"].values[own]


@pytest.mark.parametrize(
    ("name", "text", "points"),
    [
        ("plain.xyz", "1 2 3\n4 5 6\n", 2),
        ("count.pts", "2\n1 2 3 9 255 0 0\n4 5 6 8 0 255 0\n", 2),
        ("named.csv", "z;y;x;Intensity\n3;2;1;7\n6;5;4;8\n", 2),
        ("tabs.txt", "# a note\n// another\n1\t2\t3\n\n4\t5\t6\n", 2),
        ("holes.xyz", "1 2 3\nnan nan nan\n4 5 6\n", 2),
    ],
)
def test_text_of_other_programs_is_read(
    tmp_path: Path, name: str, text: str, points: int
) -> None:
    path = tmp_path / name
    path.write_text(text)
    shown = space.opened(path)
    assert_allclose(in_order(shown), [[1, 2, 3], [4, 5, 6]], atol=1e-6)
    assert len(shown.position) == points
    assert shown.describe()["up"] == "z"
    if name == "count.pts":
        assert shown.colour is not None
        assert sorted(map(tuple, shown.colour.tolist())) == [(0, 255, 0), (255, 0, 0)]


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_ply_of_another_program_is_read(tmp_path: Path, form: str) -> None:
    # A square of two triangles' area, as one polygon.
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    header = (
        f"ply\nformat {form} 1.0\nelement vertex 4\nproperty float x\n"
        "property float y\nproperty float z\nproperty uchar red\n"
        "property uchar green\nproperty uchar blue\nelement face 1\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(form)
    if order is None:
        body = "".join(f"{x:g} {y:g} {z:g} 9 8 7\n" for x, y, z in corners)
        content = (body + "4 0 1 2 3\n").encode()
    else:
        table = np.zeros(4, [("p", order + "f4", 3), ("c", "u1", 3)])
        table["p"], table["c"] = corners, (9, 8, 7)
        face = np.array([0, 1, 2, 3], order + "i4").tobytes()
        content = table.tobytes() + b"\4" + face
    path = tmp_path / "square.ply"
    path.write_bytes(header.encode() + content)
    shown = space.opened(path, unit=1e-3)
    assert_allclose(shown.position + shown.centre, corners * 1e-3, atol=1e-9)
    assert shown.faces is not None
    # Which corner a triangle begins with does not matter; its sense does.
    first = np.argmin(shown.faces, axis=1)
    turned = [np.roll(face, -at) for face, at in zip(shown.faces, first, strict=True)]
    assert_array_equal(turned, [[0, 1, 2], [0, 2, 3]])
    assert shown.colour is not None
    assert_array_equal(shown.colour[2], [9, 8, 7])


def test_a_vertex_with_one_damaged_coordinate_does_not_move_the_view(
    tmp_path: Path,
) -> None:
    corners = "0 0 0\n1 0 0\n1 2 0\n1e30 0 nan\n"
    path = tmp_path / "damaged.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\n"
        "property double y\nproperty double z\nelement face 2\n"
        "property list uchar int vertex_indices\nend_header\n"
        f"{corners}3 0 1 2\n3 1 2 3\n"
    )
    shown = space.opened(path, unit=1.0)
    assert_array_equal(shown.faces, [[0, 1, 2]])
    assert_allclose(shown.centre, [0.5, 1, 0])
    assert_allclose(shown.size, [1, 2, 0])


def test_a_damaged_ply_header_gives_one_line(tmp_path: Path) -> None:
    good = (
        "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\n"
        "property float y\nproperty float z\nend_header\n1 2 3\n4 5 6\n"
    )
    path = tmp_path / "points.ply"
    for old, new in [
        ("vertex 2", "vertex 4000000000"),
        ("ascii", "binary_little_endian"),
        ("end_header\n", ""),
        ("4 5 6", "4 five 6"),
        ("4 5 6", "4 5"),
        ("property float z\n", ""),
        ("ply\n", "pli\n"),
    ]:
        path.write_text(good.replace(old, new))
        with pytest.raises(FormatError, match=r"points\.ply") as caught:
            space.opened(path)
        assert "\n" not in str(caught.value)
    path.write_text(good)
    assert len(space.opened(path).position) == 2


def test_meshes_are_read_in_the_unit_that_is_stated(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    box = trimesh.creation.box((20.0, 30.0, 40.0))
    for ending in (".stl", ".obj", ".off", ".ply"):
        path = tmp_path / f"box{ending}"
        box.export(path)
        with pytest.raises(FormatError, match="--unit"):
            space.opened(path)
        shown = space.opened(path, unit=1e-3)
        assert_allclose(shown.size, [0.02, 0.03, 0.04], atol=1e-7)
        assert shown.describe()["triangles"] == 12
    path = tmp_path / "box.glb"
    box.export(path)
    assert_allclose(space.opened(path).size, [20, 30, 40], rtol=1e-6)
    assert space.opened(path).up == "y"
    with pytest.raises(FormatError, match="meters by itself"):
        space.opened(path, unit=1e-3)


def test_a_mesh_opens_no_other_file(tmp_path: Path) -> None:
    pytest.importorskip("trimesh")
    secret = tmp_path / "secret.mtl"
    secret.write_text("newmtl red\nKd 1 0 0\nmap_Kd secret.png\n")
    path = tmp_path / "thing.obj"
    path.write_text(
        "mtllib secret.mtl\nusemtl red\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    )
    secret.chmod(0)
    shown = space.opened(path, unit=1.0)
    assert len(shown.position) == 3
    assert shown.colour is None


def test_many_points_are_thinned_evenly_and_the_number_is_said(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(space, "MOST_POINTS", 100)
    # A grid of 40 columns: an even step of 10 would leave four of them.
    row, column = np.divmod(np.arange(1000), 40)
    path = tmp_path / "many.xyz"
    np.savetxt(path, np.stack([column, row, 0 * row], axis=1), fmt="%g")
    shown = space.opened(path)
    found = in_order(shown)
    assert len(found) == 100
    assert len(np.unique(np.round(found[:, 0]))) > 25
    assert (
        "100 of 1,000 points are drawn, one of every 10." in shown.describe()["notes"]
    )
    every = spread(1003, 100)
    assert_array_equal(np.unique(every // 11), np.arange(92))
    # The same file looks the same again.
    assert_array_equal(space.opened(path).position, shown.position)


@pytest.fixture
def thinned_laz(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> np.ndarray:
    """Return 3,000 points along a line with errors, of which 600 are drawn."""
    import laspy

    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 1e-4)
    header.add_extra_dim(laspy.ExtraBytesParams(name="uncertainty", type=np.float32))
    points = laspy.ScaleAwarePointRecord.zeros(3000, header=header)
    place = np.stack([0.001 * np.arange(3000), np.arange(3000) % 7, np.zeros(3000)], 1)
    points.x, points.y, points.z = place.T
    points["uncertainty"] = (1e-3 + 1e-6 * np.arange(3000)).astype(np.float32)
    with laspy.open(tmp_path / "line.laz", "w", header=header) as file:
        file.write_points(points)
    monkeypatch.setattr(space, "MOST_POINTS", 600)
    monkeypatch.setattr(laz, "_CHUNK", 100)
    return place


def closer(shown: space.Space, low: list[float], high: list[float]) -> np.ndarray:
    """Return x, y, z and uncertainty of further points in a box of the file."""
    centre = shown.centre
    content = shown.closer((np.array(low) - centre), (np.array(high) - centre))
    count = int(np.frombuffer(content, "<u4", 1)[0])
    names = [entry["name"] for entry in shown.layers]
    values = np.frombuffer(content, "<f4", offset=4)
    assert values.size == count * (3 + len(names))
    place = values[: 3 * count].reshape(-1, 3) + centre
    column = values[3 * count :].reshape(len(names), -1)[names.index("uncertainty")]
    return np.column_stack([place, column])


def test_a_closer_view_gets_all_further_points_of_its_box(
    thinned_laz: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = space.opened(tmp_path / "line.laz")
    (entry,) = (entry for entry in shown.layers if entry["name"] == "uncertainty")
    assert (entry["label"], entry["unit"]) == ("Uncertainty", "m")
    assert (len(shown.position), shown.total) == (600, 3000)
    assert shown.describe()["closer"]
    assert "closer view loads more" in shown.describe()["notes"][0]
    drawn = np.round((shown.position + shown.centre)[:, 0] * 1000).astype(int)
    inside = np.arange(1000, 1251)
    found = closer(shown, [0.99995, -1, -1], [1.25005, 9, 1])
    further = np.round(found[:, 0] * 1000).astype(int)
    assert sorted([*further, *drawn[np.isin(drawn, inside)]]) == inside.tolist()
    assert_allclose(found[:, 3], 1e-3 + 1e-6 * further, rtol=1e-6)
    assert_allclose(found[:, 1], further % 7, atol=1e-6)
    # A budget takes an even part.
    monkeypatch.setattr(space, "MOST_CLOSER", 300)
    some = closer(shown, [0, -1, -1], [3, 9, 1])
    assert len(some) == 300
    assert abs(np.mean(some[:, 0]) - 1.5) < 4 * (3 / np.sqrt(12)) / np.sqrt(300)
    assert len(closer(shown, [7, 7, 7], [8, 8, 8])) == 0


def test_a_closer_view_reads_only_blocks_of_its_box(
    thinned_laz: np.ndarray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import laspy

    shown = space.opened(tmp_path / "line.laz")
    read = []
    original = laspy.LasReader.read_points
    monkeypatch.setattr(
        laspy.LasReader,
        "read_points",
        lambda self, count: read.append(count) or original(self, count),
    )
    closer(shown, [0.99995, -1, -1], [1.25005, 9, 1])
    assert read == [100, 100, 100]


def test_a_box_that_makes_no_sense_is_answered_in_words(
    thinned_laz: np.ndarray, tmp_path: Path, served: Callable[..., TestClient]
) -> None:
    client = served(space.opened(tmp_path / "line.laz"))
    for box in ({}, {"low": [0, 0], "high": [1, 1]}, {"low": ["a"], "high": 3},
                {"low": [0, 0, 0], "high": [1, 1, None]}):  # fmt: skip
        answer = client.post(f"/{TOKEN}/closer", json=box)
        assert answer.status_code == 422
        assert "three finite numbers" in answer.json()["error"]
    good = {"low": [-9, -9, -9], "high": [9, 9, 9]}
    content = client.post(f"/{TOKEN}/closer", json=good).content
    assert int(np.frombuffer(content, "<u4", 1)[0]) == 2400


def test_a_cloud_shown_whole_has_no_further_points(
    written: Callable[[str], Path],
) -> None:
    shown = space.opened(written(".laz"))
    assert not shown.describe()["closer"]
    with pytest.raises(CubeError, match="shown whole"):
        shown.closer([0, 0, 0], [1, 1, 1])


@pytest.mark.parametrize("some", [100_000, 300], ids=["all", "some"])
def test_dots_are_as_large_as_their_spacing(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, some: int
) -> None:
    monkeypatch.setattr("amulor.view.page.space._SOME", some)
    row, column = np.divmod(np.arange(1000), 40)
    scatter = np.random.default_rng(2).uniform(-0.2, 0.2, (2, 1000))
    path = tmp_path / "grid.xyz"
    table = np.stack([column + scatter[0], row + scatter[1], 0 * row], axis=1)
    np.savetxt(path, 0.01 * table, fmt="%.6f")
    spacing = space.opened(path).describe()["spacing"]
    assert 0.005 < spacing < 0.012


@pytest.mark.parametrize("ending", [".ply", ".laz", ".e57", ".csv", ".nc", ".stl"])
def test_damage_gives_one_line(
    written: Callable[[str], Path],
    tmp_path: Path,
    ending: str,
) -> None:
    if ending == ".stl":
        trimesh = pytest.importorskip("trimesh")
        path = tmp_path / "box.stl"
        trimesh.creation.box((1, 1, 1)).export(path)
    else:
        path = written(ending)
    unit = 1e-3 if ending == ".stl" else None
    content = path.read_bytes()
    rng = np.random.default_rng(3)
    said: list[str] = []
    cases = [content[: len(content) * part // 8] for part in range(8)]
    for _ in range(12):
        spoiled = bytearray(content)
        for place in rng.integers(0, len(content), 6):
            spoiled[place] = rng.integers(0, 256)
        cases.append(bytes(spoiled))
    for case in cases:
        path.write_bytes(case)
        try:
            shown = space.opened(path, unit=unit)
        except AmulorError as error:
            said.append(str(error))
        else:
            # What is still a cloud can be drawn.
            assert np.isfinite(shown.position).any()
            assert shown.describe()["points"] > 0
    assert len(said) >= (7 if ending != ".csv" else 1)
    assert [line for line in said if "\n" in line or path.name not in line] == []


def test_the_command_explains_what_does_not_go_together(
    written: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(".ply")
    assert main(["view", str(path), "--unit", "mm", "--save", "x.html"]) == 1
    assert "leave out --unit" in capsys.readouterr().err
    assert main(["view", str(path), "--nearest", "1m", "--farthest", "2m"]) == 2
    assert "not with a cloud" in capsys.readouterr().err
    assert main(["view", str(tmp_path / "none.stl"), "--unit", "mm"]) == 1
    assert "does not exist" in capsys.readouterr().err
    saved = tmp_path / "page.html"
    assert main(["view", str(path), "--save", str(saved)]) == 0
    page = saved.read_text()
    assert "http" not in page.replace("http-equiv", "").replace("www.w3.org", "")[:2000]
    assert 'data-name="layer/space/position"' in page


def test_the_server_gives_numbers_of_the_file_only(
    served: Callable[..., TestClient], written: Callable[[str], Path], tmp_path: Path
) -> None:
    shown = space.opened(written(".ply"))
    client = served(shown)
    assert client.get(f"/{TOKEN}/").text.count('src="static/space.js"') == 1
    scene = client.get(f"/{TOKEN}/scene").json()
    assert scene["points"] == len(shown.position)
    answer = client.get(f"/{TOKEN}/layer/space/position")
    assert answer.content == shown.position.tobytes()
    for name in ("faces", "..%2f..%2fetc%2fpasswd", "colour", "nothing"):
        wrong = client.get(f"/{TOKEN}/layer/space/{name}")
        assert wrong.status_code in (404, 422)
        assert b"root:" not in wrong.content
    for address in ("measure", "product", "spectrum/space/0/0"):
        assert client.get(f"/{TOKEN}/{address}").status_code == 404
    page = client.post(f"/{TOKEN}/save", json={"measurements": []})
    path = tmp_path / "page.html"
    save_page(shown, path)
    assert page.text == path.read_text()


def test_the_folder_of_a_scan_is_none_of_these(tmp_path: Path) -> None:
    folder = tmp_path / "scan.csv"
    folder.mkdir()
    assert not space.is_space(folder)
    assert not space.is_space(tmp_path / "none.nc")
    assert space.is_space(tmp_path / "none.STL")


def test_names_of_numbers_cannot_leave_their_place(tmp_path: Path) -> None:
    path = tmp_path / "evil.csv"
    path.write_text('x,y,z,../../etc,"<b>",position\n1,2,3,4,5,6\n4,5,6,7,8,9\n')
    shown = space.opened(path)
    names = [layer["name"] for layer in shown.layers]
    assert names == ["______etc", "_b_", "position 2"]
    assert shown.values("position 2") != shown.values("position")


def test_a_laz_file_of_more_parts_than_bytes_gets_a_line(
    written: Callable[[str], Path],
) -> None:
    path = written(".laz")
    content = bytearray(path.read_bytes())
    points = int.from_bytes(content[96:100], "little")
    table = int.from_bytes(content[points : points + 8], "little")
    content[table + 4 : table + 8] = (2**31 - 1).to_bytes(4, "little")
    path.write_bytes(content)
    # The package would ask for 34 GB, and end the program where it gets none.
    with pytest.raises(FormatError, match="2147483647 parts, more than bytes"):
        space.opened(path)
