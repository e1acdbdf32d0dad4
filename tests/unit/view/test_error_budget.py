"""Error budgets are shown as they are in the image: info, report, point clouds."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.colors import to_hex

from amulor import imaging, io, rejection
from amulor.cli import main
from amulor.cube.schema import ALIKE_TERMS, SHARED_TERMS
from amulor.simulation import simulate
from amulor.survey import Survey
from amulor.view import Picture, Table, image_report, write_report
from amulor.view.accuracy import accuracy_statement, error_budgets
from amulor.view.report import Heading, Paragraph, png
from amulor.view.style import COLOURS

STATED = """
[calibration]
date = 2026-05-01
delay_uncertainty = "0.02 ns"
group_index_uncertainty = 0.001
"""


@pytest.fixture(scope="module")
def image(plate_text: str) -> xr.Dataset:
    made = Survey.from_text(plate_text + STATED)
    cube = rejection.open_water(simulate(made, rng=1)).assign_attrs(late_echo="present")
    return imaging.range_image(cube, polarization="VH")


def test_the_budget_is_that_of_the_pixels(image: xr.Dataset) -> None:
    budget = imaging.error_budget(image)
    total = image["slant_range_uncertainty"].values
    assert budget.combined == np.nanmedian(total)
    assert budget.expanded == 2 * budget.combined
    assert [term.name for term in budget.unknown] == ["geometry"]
    assert budget.calibrated == "2026-05-01"
    lines = {line.term.name: line for line in budget.lines}
    assert {"late_echo", "delay", "group_index"} < set(lines)
    delay = image["slant_range_uncertainty_delay"].values
    assert lines["delay"].uncertainty == np.nanmedian(delay)
    assert lines["delay"].share == np.nanmedian((delay / total) ** 2)
    assert lines["delay"].term.kind == "B"
    assert sum(line.share for line in budget.lines) == pytest.approx(1, abs=0.02)
    assert budget.late == np.nanmedian(image["slant_range_late_echo"].values)


def test_an_image_from_before_there_were_terms_has_no_lines(image: xr.Dataset) -> None:
    old = image.drop_vars([n for n in image if "uncertainty_" in str(n)])
    del old.attrs["uncertainty_unknown"], old.attrs["late_echo_correction"]
    budget = imaging.error_budget(old)
    assert budget.lines == budget.unknown == ()
    assert error_budgets({"old": old}) == []


@pytest.mark.slow
def test_the_report_shows_every_term_and_what_is_not_known(
    image: xr.Dataset, tmp_path: Path
) -> None:
    heading, picture, table, text = error_budgets({"plate": image})
    assert isinstance(heading, Heading)
    assert isinstance(picture, Picture)
    assert png(picture.figure).startswith(b"\x89PNG")
    # A bar for each term, one that is not known, and the combined one.
    bars = [p.get_width() for p in picture.figure.axes[0].patches]
    lines = imaging.error_budget(image).lines
    assert len(bars) == len(lines) + 2
    assert bars[: len(lines)] == [1e3 * line.uncertainty for line in lines]
    assert isinstance(table, Table)
    rows = {row[0]: row for row in table.rows}
    assert rows["geometry"][4] == "!not known"
    assert rows["delay"][2] == "B"
    shown = float(rows["expanded, k = 2"][4])
    assert shown == pytest.approx(2 * float(rows["combined"][4]), rel=6e-3)
    assert isinstance(text, Paragraph)
    assert "late. It is subtracted" in text.text
    assert "geometry" in text.text
    path = tmp_path / "report.html"
    image_report.write(path, {"plate": image})
    assert "delay of the echo by scattering" in path.read_text()


def test_the_caption_explains_the_bars_that_are_drawn(image: xr.Dataset) -> None:
    shared = [*ALIKE_TERMS, *SHARED_TERMS]
    names = [f"slant_range_uncertainty_{name}" for name in shared]
    own = image.drop_vars([name for name in names if name in image])
    own = own.assign_attrs(uncertainty_unknown="")
    for shown, dark in ((image, True), (own, False)):
        _, picture, *_ = error_budgets({"plate": shown})
        colours = [to_hex(p.get_facecolor()) for p in picture.figure.axes[0].patches]
        assert (COLOURS[0].lower() in colours) == dark
        assert ("Dark" in picture.caption) == dark
        assert ("atched" in picture.caption) == dark


def test_a_shared_part_that_is_not_known_is_no_nan(image: xr.Dataset) -> None:
    other = image.copy(deep=True)
    other["slant_range_common_uncertainty"][:] = np.nan
    tables = [
        part
        for part in accuracy_statement({"plate": other}, {})
        if isinstance(part, Table)
    ]
    cells = [cell for table in tables for row in table.rows for cell in row]
    assert "not known" in cells
    assert "nan" not in cells


def test_a_report_names_files_and_no_folders_of_this_computer(
    image: xr.Dataset, tmp_path: Path
) -> None:
    survey = image.attrs["survey"] + '\n# file = "/home/me/scans/jar.ply"\n'
    history = "reject 'C:\\Users\\me\\water.nc'"
    path = tmp_path / "report.html"
    made = image.assign_attrs(survey=survey, history=history)
    image_report.write(path, {"plate": made})
    text = path.read_text()
    listings = html.unescape(" ".join(re.findall(r"<pre>.*?</pre>", text, re.DOTALL)))
    assert 'file = "jar.ply"' in listings
    assert "reject 'water.nc'" in listings
    assert "/home/me" not in text
    assert "Users" not in listings


def test_info_says_the_budget(image: xr.Dataset, tmp_path: Path, capsys) -> None:
    path = tmp_path / "range.nc"
    io.write_cube(image, path)
    assert main(["info", str(path), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["uncertainty"]
    budget = imaging.error_budget(image)
    assert found["combined_m"] == budget.combined
    assert found["unknown"] == ["geometry"]
    assert found["terms"]["delay"]["type"] == "B"
    assert main(["info", str(path)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert f"{budget.expanded * 1e3:.3g} mm with k = 2" in text
    assert "not known, and not in it: geometry" in text
    assert "delay calibrated on 2026-05-01" in text


def test_a_point_cloud_keeps_the_total_and_the_common_part(
    image: xr.Dataset, tmp_path: Path
) -> None:
    cloud = imaging.point_cloud(image)
    usable = image["slant_range"].notnull().values
    for name in ("slant_range_uncertainty", "slant_range_common_uncertainty"):
        np.testing.assert_array_equal(cloud[name], image[name].values[usable])
    io.write_ply(cloud, tmp_path / "cloud.ply")
    header, data = (tmp_path / "cloud.ply").read_bytes().split(b"end_header\n")
    assert b"property double scalar_slant_range_common_uncertainty" in header
    names = [
        line.split()[1:]
        for line in header.decode().splitlines()
        if line.startswith("property")
    ]
    kinds = {"double": "<f8", "int": "<i4"}
    points = np.frombuffer(data, dtype=[(name, kinds[kind]) for kind, name in names])
    np.testing.assert_array_equal(
        points["scalar_slant_range_common_uncertainty"],
        cloud["slant_range_common_uncertainty"],
    )


def test_words_of_a_table_stand_at_the_left(tmp_path: Path) -> None:
    rows = [["delay", "time in the cables", "!not known"], ["noise", "photons", "0.3"]]
    path = tmp_path / "report.html"
    write_report(path, "Terms", [Table(["term", "what", "mm"], rows, "Terms.")])
    text = path.read_text()
    assert '<th class="text">what</th>' in text
    assert '<td class="text">time in the cables</td>' in text
    assert "<th>mm</th>" in text
    assert '<td class="warning">not known</td>' in text
    assert "<td>0.3</td>" in text


def test_the_table_of_a_budget_has_its_numbers(image: xr.Dataset) -> None:
    _, _, table, _ = error_budgets({"plate": image})
    budget = imaging.error_budget(image)
    assert isinstance(table, Table)
    rows = {row[0]: row for row in table.rows}
    assert len(rows) == len(budget.lines) + len(budget.unknown) + 2
    assert {len(row) for row in table.rows} == {len(table.header)}
    for line in budget.lines:
        row = rows[line.term.name.replace("_", " ")]
        assert row[4] == f"{1e3 * line.uncertainty:.3g}"
        assert row[5] == f"{100 * line.share:.1f}%"
    assert rows["combined"][4] == f"{1e3 * budget.combined:.3g}"
    assert rows["expanded, k = 2"][4] == f"{2e3 * budget.combined:.3g}"
