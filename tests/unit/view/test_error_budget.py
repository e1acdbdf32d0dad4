"""Error budgets are shown as they are in the image: info, report, point clouds."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from amulor import imaging, io, rejection
from amulor.cli import main
from amulor.simulation import simulate
from amulor.survey import Survey
from amulor.view import Picture, Table, image_report
from amulor.view.error_budget import error_budgets
from amulor.view.report import Heading, Paragraph, png

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
    assert "late; that is taken off" in text.text
    assert "geometry" in text.text
    path = tmp_path / "report.html"
    image_report.write(path, {"plate": image})
    assert "light scattered on its way" in path.read_text()


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
