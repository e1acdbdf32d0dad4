"""Statements of the files of a handover, and what they leave out."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.cube import QualityFlag
from amulor.errors import AmulorError, CubeError
from amulor.handover import (
    Order,
    drawings,
    hand_over,
    order,
    page,
    products,
    references,
)
from amulor.handover.archive import check
from amulor.handover.site_drawings import _cross, _ellipse, _middle_lines
from amulor.imaging import Frame, frame_of
from amulor.imaging.products import surface


def framed(name: str, **changes: Any) -> Frame:
    fields: dict[str, Any] = {
        "name": name, "rotation": np.eye(3), "position": np.array([1.5, -2.0, 3.25])
    }  # fmt: skip
    return Frame(**(fields | changes))


def test_only_a_pose_states_where_the_instrument_is(ladder: xr.Dataset) -> None:
    stated = order.statements_of(ladder, framed("pose"))
    assert stated[0].startswith("Axes: ")
    assert stated[1] == "Instrument at (1.5, -2, 3.25) m; pose as stated"
    others = order.statements_of(ladder, frame_of(ladder))
    assert not [line for line in others if "Instrument at" in line]
    assert not [line for line in others if "Reference system" in line]


def test_a_reference_system_is_stated_with_what_to_add(ladder: xr.Dataset) -> None:
    frame = framed("pose", crs="EPSG:25832", crs_offset=(500000.25, 6.0e6, 0.0))
    stated = order.statements_of(ladder, frame)
    assert "Reference system: EPSG:25832; add (500000.25, 6000000, 0) m" in stated


def test_a_mesh_has_no_mixed_pixels(
    ladder: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    flag = ladder["quality_flag"].values.copy()
    flag[3, 5:9] |= QualityFlag.MIXED
    image = ladder.assign(quality_flag=ladder["quality_flag"].copy(data=flag))
    written: list[xr.Dataset] = []
    monkeypatch.setattr(
        "amulor.io.write_ply", lambda cloud, *words, **more: written.append(cloud)
    )
    order.write_mesh(image, Path("m.ply"), surface(image), overwrite=True)
    there = {
        (int(row), int(column))
        for row, column in zip(
            written[0]["row"].values, written[0]["column"].values, strict=True
        )
    }
    assert (3, 4) in there
    assert not there & {(3, 5), (3, 6), (3, 7), (3, 8)}


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (None, None), (2, 2.0), (2.5, 2.5), (1, 1.0), (3.0, 3.0),
        (True, "must be a number"), ("2", "must be a number"),
        ([2], "must be a number"),
        (0.999, "must be from 1 to 3, got 0.999"), (3.001, "must be from 1 to 3, got"),
        (float("nan"), "must be from 1 to 3"),
    ],
)  # fmt: skip
def test_a_number_of_a_page_is_one_between_its_limits(
    value: Any, expected: float | str | None
) -> None:
    request = {} if value is None else {"cell": value}
    if isinstance(expected, str):
        with pytest.raises(CubeError, match=f"cell {expected}"):
            page._number(request, "cell", 1.0, 3.0)
    else:
        assert page._number(request, "cell", 1.0, 3.0) == expected


def described(
    image: xr.Dataset, chosen: Order, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> list[str]:
    """Return the statements of a picture, or of a sheet."""
    said: list[list[str]] = []

    def picture(pixels: Any, path: Path, *, texts: dict[str, str], **_: Any) -> None:
        said.append(texts["Description"].split("\n"))

    def block_of(plane: Any, order: Any, title: str, statements: list[str]) -> Any:
        said.append(list(statements))
        return SimpleNamespace()

    monkeypatch.setattr(products.formats, "write_picture", picture)
    monkeypatch.setattr(products.drawings, "block_of", block_of)
    monkeypatch.setattr(products, "sheet", lambda *words, **more: None)
    monkeypatch.setattr(products.drawings, "save_sheet", lambda *words, **more: None)
    ending = "png" if chosen.contours is None else "pdf"
    hand_over(image, tmp_path / f"sheet.{ending}", chosen)
    return said[0]


#: A slope of 0.3 / 0.954 over 0.12 m, 1.5 m ahead.
SLOPE = scenes.plane((0.3, 0.0, 0.954), 1.5, own=2e-4)


def test_a_picture_states_its_colors_first(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    chosen = Order(product="orthoimage", show="height")
    stated = described(SLOPE, chosen, monkeypatch, tmp_path)
    words = re.fullmatch(r"height from (-\d+) to (-\d+) mm", stated[0])
    assert words is not None, stated[0]
    low, high = (float(word) for word in words.groups())
    # In the middle 1.5 / 0.954 m, from edge to edge some 38 mm.
    assert (low + high) / 2 == pytest.approx(-1500 / 0.954, abs=2)
    assert 30 < high - low < 50


def test_a_sheet_states_its_relief_and_its_contours_first(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    chosen = Order(product="orthoimage", show="relief", contours=0.01)
    stated = described(SLOPE, chosen, monkeypatch, tmp_path)
    assert "elief" in stated[0]
    assert stated[1] == "Contours every 10 mm"


def test_triangles_without_area_are_no_reference(tmp_path: Path) -> None:
    path = tmp_path / "model.obj"
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nv 0 0 1\n"
    # The second has three corners on a line; the third has an area in one plane.
    path.write_text(corners + "f 1 2 3\nf 1 2 4\nf 1 2 5\n")
    vertices, faces = references.read_mesh(path, unit=1.0)
    assert len(faces) == 2
    areas = [
        np.linalg.norm(np.cross(b - a, c - a)) / 2
        for a, b, c in (vertices[face] for face in faces)
    ]
    assert_allclose(areas, 0.5)
    path.write_text(corners + "f 1 2 4\n")
    with pytest.raises(AmulorError, match="holds no triangle to compare with"):
        references.read_mesh(path, unit=1.0)


def test_an_error_ellipse_is_that_of_its_covariance() -> None:
    covariance = np.array([[4e-6, 1e-6], [1e-6, 2e-6]])
    station: Any = SimpleNamespace(covariance=covariance, position=np.array([3.0, 4.0]))
    line = _ellipse(station, 50.0)
    off = (line.points - [3.0, 4.0]) / 50.0
    scores = np.einsum("ni,ij,nj->n", off, np.linalg.inv(covariance), off)
    assert_allclose(scores, 1.0)
    # It is closed, and goes all the way round once.
    assert_allclose(line.points[0], line.points[-1], atol=1e-9)
    angles = np.unwrap(np.arctan2(off[:, 1], off[:, 0]))
    assert abs(angles[-1] - angles[0]) == pytest.approx(2 * np.pi)
    assert line.layer == "error ellipses"


def test_a_cross_has_arms_of_four_millimeters_of_paper() -> None:
    first, second = _cross(np.array([1.0, 2.0]), "S1", "stations", 100.0)
    assert_allclose(first.points, [[0.8, 2.0], [1.2, 2.0]])
    assert_allclose(second.points, [[1.0, 1.8], [1.0, 2.2]])
    assert (first.label, second.label) == ("S1", "")
    assert {first.layer, second.layer} == {"stations"}


def test_sections_go_through_the_middle_the_longer_one_first() -> None:
    wide = _middle_lines(0.0, 10.0, 0.0, 4.0)
    high = _middle_lines(0.0, 4.0, 0.0, 10.0)
    (x0, y0, x1, y1), (x2, y2, x3, y3) = wide
    assert y0 == y1 == 2.0
    assert x2 == x3 == 5.0
    # Both go beyond the site by the same length, on either side.
    assert -x0 == pytest.approx(x1 - 10.0)
    assert -y2 == pytest.approx(y3 - 4.0)
    assert -x0 == pytest.approx(-y2)
    assert x0 < 0
    (upwards, across) = high
    assert_allclose(upwards, (2.0, x0, 2.0, x1))
    assert_allclose(across, (x0, 5.0, 4.0 - x0, 5.0))


def test_fields_of_scans_that_are_missing_or_empty_are_problems(tmp_path: Path) -> None:
    fields = list(check.layout.SCAN_FIELDS)
    assert fields[0] == "scan"

    def write(*rows: list[str]) -> None:
        path = tmp_path / check.layout.SCANS
        path.parent.mkdir(exist_ok=True)
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(rows)

    full = [f"some {name}" for name in fields]
    write(fields, full, [" ", *full[1:]])
    problems: list[str] = []
    assert len(check._scan_table(tmp_path, problems)) == 2
    assert len(problems) == 1
    assert "the field 'scan' is empty" in problems[0]
    write(fields[:-1], full[:-1])
    problems = []
    check._scan_table(tmp_path, problems)
    assert problems == [
        f"{check.layout.SCANS}: scan some scan: the field '{fields[-1]}' is missing"
    ]


def test_a_field_of_a_table_is_missing_or_empty(tmp_path: Path) -> None:
    (tmp_path / "about.csv").write_text("field,value\na,1\nb,  \n")
    problems: list[str] = []
    found = check._field_table(tmp_path, "about.csv", ("a", "b", "c"), problems)
    assert found == {"a": "1", "b": ""}
    assert problems == [
        "about.csv: the field 'b' is empty", "about.csv: the field 'c' is missing"
    ]  # fmt: skip
    problems = []
    assert check._field_table(tmp_path, "gone.csv", ("a",), problems) == {}
    assert problems == ["gone.csv is missing"]


def test_a_half_profile_has_its_axis_its_mirror_and_its_diameters() -> None:
    turned: Any = SimpleNamespace(
        radius=np.array([0.1, 0.3, 0.2]), uncertainty=np.full(3, 1e-3)
    )
    words = {"upper end": "40 cm", "lower end": "20 cm", "widest place": "60 cm"}
    drawing = drawings._profile_drawing(
        turned, np.array([0.0, 0.5, 0.9]), words, "vase", [], Order(product="profile")
    )
    lines = {line.layer: line for line in drawing.lines}
    assert_allclose(lines["axis"].points, [[0, 0], [0, 0.9]])
    assert_allclose(lines["profile"].points, [[-0.1, 0], [-0.3, 0.5], [-0.2, 0.9]])
    assert_allclose(lines["outline"].points, [[0.1, 0], [0.3, 0.5], [0.2, 0.9]])
    across = {line.label: line for line in drawing.lines if line.layer == "diameters"}
    assert_allclose(across["Ø 40 cm"].points, [[-0.2, 0.9], [0, 0.9]])
    assert_allclose(across["Ø 20 cm"].points, [[-0.1, 0], [0, 0]])
