"""The drawings of a site: plan, sections of all visits, and details."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import drawn_sites
import ezdxf
import numpy as np
import pytest
import tifffile
import underwater_sites as oracle
from matplotlib.figure import Figure
from pdf_archive import archive_faults
from pdf_files import letter_sizes, pages_of

from amulor.cli import main
from amulor.handover.site_drawings import _cross, _ellipse, _middle_lines, _tiles
from amulor.site import Site
from amulor.site.registration.result import read_registration, write_registration
from amulor.view.sheet import Station, error_ellipse
from amulor.view.site_plan import annotations_of, label_plan

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """Return a site file with its registration: two visits of four scans each."""
    folder = tmp_path_factory.mktemp("site")
    rng = np.random.default_rng(5)
    bed = oracle.bed(rng)
    drawn = drawn_sites.two_visits(bed, bed, rng, rows=40)
    path = drawn_sites.written(drawn, folder)
    registration = drawn_sites.known_registration(drawn)
    write_registration(registration, folder / "poses.json")
    return path


def draw(site: Path, *words: str) -> int:
    output = ["-o", str(site.with_name("site.pdf")), "--overwrite"]
    poses = ["--poses", str(site.with_name("poses.json"))]
    return main(["site", "drawings", str(site), *poses, *output, *words])


@pytest.fixture(scope="module")
def drawings(site) -> Path:
    assert draw(site) == 0
    return site.parent


def test_the_largest_ellipse_is_as_large_as_it_may_be(site) -> None:
    described = Site.from_toml(site)
    known = read_registration(site.with_name("poses.json"))
    places = {
        f"pose {scan.name}": (6 * number, 6 * number + 6)
        for number, scan in enumerate(described.scan)
    }
    errors = 1e-6 * np.eye(6 * len(places))
    registration = replace(known, places=places, covariance=errors)
    scans = [SimpleNamespace(name=s.name, epoch=s.epoch) for s in described.scan]
    found = annotations_of(described, registration, scans, largest=0.1)
    axes = [
        np.sqrt(np.linalg.eigvalsh(station.covariance)[-1])
        for station in found.stations.values()
    ]
    # The factor is round: 1, 2 or 5 times a power of ten.
    assert 0.1 / 2.51 < found.enlarged * max(axes) <= 0.1


def ids_of(path: Path) -> list[str]:
    return [element.get("id", "") for element in ET.parse(path).iter()]


def texts_of(path: Path) -> set[str]:
    return {text.text or "" for text in ET.parse(path).iter(f"{SVG}text")}


def test_the_plan_has_what_a_reader_of_plans_needs(drawings) -> None:
    plan = drawings / "site_plan.svg"
    ids, texts = ids_of(plan), texts_of(plan)
    assert ids.count("footprint") == 4
    assert ids.count("error-ellipse") == 4
    assert {"north", "east [m]", "north [m]", "A", "A'", "B", "B'"} <= texts
    assert {"b1", "b2", "b3", "b4"} <= texts
    assert "a1" not in texts
    assert any(text.startswith("Visit two, 4 scans") for text in texts)
    assert "no surface measured" in texts
    assert "scale-bar" in " ".join(ids)


def test_the_map_of_uncertainty_states_its_limit(drawings) -> None:
    path = drawings / "site_uncertainty.svg"
    ids, texts = ids_of(path), texts_of(path)
    assert {"uncertainty [mm]", "2 of 4", "site: uncertainty"} & texts == {
        "uncertainty [mm]",
        "2 of 4",
    }
    assert ids.count("footprint") == ids.count("error-ellipse") == 4
    assert "A" not in texts
    limit = next(m for t in texts if (m := re.match(r"At most (\S+) mm in 95 %", t)))
    # The second band of the heights is their standard uncertainty.
    sigma = tifffile.imread(drawings / "site_plan.tif")[1]
    beyond = (sigma > float(limit[1]) * 1e-3).sum() / np.isfinite(sigma).sum()
    # The limit has two digits: 5 % of its value to either side.
    assert 0.01 < beyond < 0.12


def test_a_section_shows_all_visits(drawings) -> None:
    texts = texts_of(drawings / "site_section_A.svg")
    assert {"one", "two", "A", "A'", "section line"} <= texts
    document = ezdxf.readfile(drawings / "site_section_A.dxf")
    layers = {entity.dxf.layer for entity in document.modelspace()}
    assert {"one", "two", "uncertainty"} <= layers


def test_the_plan_opens_in_cad_and_gis(drawings) -> None:
    document = ezdxf.readfile(drawings / "site_plan.dxf")
    layers = {entity.dxf.layer for entity in document.modelspace()}
    assert {"contours", "footprints", "stations", "sections"} <= layers
    assert "error ellipses" in layers
    (block,) = document.modelspace().query("INSERT")
    attributes = {attribute.dxf.tag: attribute.dxf.text for attribute in block.attribs}
    assert attributes["SHEET"] == "1 of 4"
    assert attributes["SCALE"].startswith("1:")
    # Texts that no project file states stay blank.
    assert attributes["FIND_NUMBER"] == attributes["AUTHOR"] == ""
    heights = tifffile.imread(drawings / "site_plan.tif")[0]
    # The sea bed of the oracle has relief of some centimeters about zero.
    assert np.isfinite(heights).any()
    assert np.nanmax(np.abs(heights)) < 1.0


def test_all_sheets_are_pages_with_readable_letters(drawings) -> None:
    assert pages_of(drawings / "site.pdf") == 4
    assert archive_faults(drawings / "site.pdf") == []
    assert min(letter_sizes(drawings / "site.pdf")) >= 7


def test_a_larger_scale_adds_details(site, capsys) -> None:
    assert draw(site, "--scale", "1:4") == 0
    said = capsys.readouterr().out
    details = sorted(site.parent.glob("site_detail_*.svg"))
    assert len(details) >= 2
    assert f"{4 + len(details)} sheets" in said
    assert any("1:4 on " in text for text in texts_of(details[0]))
    # The plan shows where each detail lies.
    plan = site.with_name("site_plan.svg")
    assert ids_of(plan).count("detail") == len(details)
    assert {str(number + 1) for number in range(len(details))} <= texts_of(plan)
    # An overview on A3 remains the first sheet.
    assert any(
        text.endswith(" on A3") for text in texts_of(site.parent / "site_plan.svg")
    )


def test_unknown_visits_and_lines_off_the_site_are_one_line(site, capsys) -> None:
    assert draw(site, "--epoch", "three") == 1
    assert "no scan of the visit 'three'" in capsys.readouterr().err
    assert draw(site, "--line=50m,50m,51m,50m") == 1
    assert "no scan meets the section A-A'" in capsys.readouterr().err


def test_poses_that_are_not_good_are_refused(site, tmp_path, capsys) -> None:
    content = json.loads(site.with_name("poses.json").read_text())
    content["poses"].pop("b4")
    (tmp_path / "poses.json").write_text(json.dumps(content))
    words = ["--poses", str(tmp_path / "poses.json"), "-o", str(tmp_path / "o.pdf")]
    assert main(["site", "drawings", str(site), *words]) == 1
    assert capsys.readouterr().err
    assert not (tmp_path / "o.pdf").exists()


def test_an_error_ellipse_has_the_axes_of_its_covariance() -> None:
    turn = np.radians(30)
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    covariance = axes @ np.diag([4e-6, 1e-6]) @ axes.T
    ellipse = error_ellipse((1.0, 2.0), covariance, factor=100, colour="#000000")
    assert ellipse.get_center() == (1.0, 2.0)
    # Semi-axes of 2 and 1 mm, a hundred times enlarged, as diameters.
    assert ellipse.get_width() == pytest.approx(0.4)
    assert ellipse.get_height() == pytest.approx(0.2)
    assert ellipse.get_angle() % 180 == pytest.approx(30)
    Figure().add_subplot().add_patch(ellipse)


def test_ellipses_of_a_cad_file_have_the_axes_of_their_covariance() -> None:
    covariance = np.array([[4e-6, 0.0], [0.0, 1e-6]])
    station = Station(position=np.array([1.0, 2.0]), covariance=covariance, colour="")
    points = _ellipse(station, 100.0).points - (1.0, 2.0)
    # Semi-axes of 2 and 1 mm, a hundred times enlarged: 0.2 m east and 0.1 m north.
    assert np.ptp(points[:, 0]) == pytest.approx(0.4, rel=2e-3)
    assert np.ptp(points[:, 1]) == pytest.approx(0.2, rel=2e-3)
    on_ellipse = (points[:, 0] / 0.2) ** 2 + (points[:, 1] / 0.1) ** 2
    assert on_ellipse == pytest.approx(1.0)


def test_the_report_shows_the_same_plan(site) -> None:
    report = site.with_name("site.html")
    poses = ["--poses", str(site.with_name("poses.json"))]
    assert main(["site", "report", str(site), *poses, "-o", str(report)]) == 0
    text = report.read_text()
    first = text[: text.index("<table")]
    assert first.count("<img") == 1
    assert "Visit two from above, shaded" in first
    # All poses are exact: the factor is a round number of the series 1, 2, 5.
    enlarged = re.search(r"enlarged (\S+) times", first)
    assert enlarged is not None
    assert float(enlarged[1]) >= 1


def test_coordinates_of_a_report_have_all_digits() -> None:
    figure = Figure()
    axes = figure.add_subplot()
    axes.plot([512_343.2, 512_346.5], [4_599_998.1, 4_600_000.9])
    label_plan(axes)
    figure.draw_without_rendering()
    for axis, first in ((axes.xaxis, "51234"), (axes.yaxis, "4")):
        assert axis.get_offset_text().get_text() == ""
        labels = [text.get_text() for text in axis.get_ticklabels()]
        assert len(labels) >= 3
        assert all(re.fullmatch(first + r"\d+(\.\d)?", label) for label in labels)
        assert len(set(labels)) == len(labels)


def test_the_plan_states_the_error_of_the_whole_site(site, drawings) -> None:
    registration = read_registration(site.with_name("poses.json"))
    first = registration.covariance_of("pose a1")[:3, :3]
    # The largest standard uncertainty of the position in any direction.
    turns = np.random.default_rng(1).normal(size=(20_000, 3))
    turns /= np.linalg.norm(turns, axis=1)[:, None]
    largest = np.sqrt(np.einsum("ni,ij,nj->n", turns, first, turns).max())
    words = " ".join(
        element.text or ""
        for element in ET.parse(drawings / "site_plan.svg").iter(f"{SVG}text")
    )
    stated = re.search(r"of the whole site, (\S+) mm", words)
    assert stated is not None, words
    assert float(stated[1]) == pytest.approx(1e3 * largest, rel=0.05)


def test_the_largest_ellipse_is_some_millimeters_large_on_paper(drawings) -> None:
    texts = " ".join(texts_of(drawings / "site_plan.svg"))
    (factor,) = re.findall(r"error ellipses \(k = 1, x ([\d.e+]+)\)", texts)
    (scale,) = set(re.findall(r"1:(\d+) on A\d", texts))
    # The poses have no errors; 1 nm is the smallest that is shown.
    paper = float(factor) * 1e-9 / float(scale)
    # To be seen, and smaller than the fields of the drawing.
    assert 2e-3 < paper < 1e-2


def test_a_station_is_a_cross_of_four_millimeters_with_its_name_once() -> None:
    first, second = _cross(np.array([3.0, 4.0]), "b1", "stations", 50.0)
    np.testing.assert_allclose(first.points, [[2.9, 4.0], [3.1, 4.0]])
    np.testing.assert_allclose(second.points, [[3.0, 3.9], [3.0, 4.1]])
    assert (first.label, second.label) == ("b1", "")
    assert first.layer == second.layer == "stations"


def test_sections_of_a_site_cross_in_its_middle_the_longer_one_first() -> None:
    # 3 % of the longer side beyond each end.
    assert _middle_lines(0.0, 10.0, 1.0, 5.0) == (
        (-0.3, 3.0, 10.3, 3.0),
        (5.0, 0.7, 5.0, 5.3),
    )
    assert _middle_lines(0.0, 4.0, 0.0, 10.0)[0] == (2.0, -0.3, 2.0, 10.3)


def test_details_cover_a_site_from_the_north_west_on() -> None:
    window = (10.0, 16.0, 0.0, 4.0)
    assert _tiles(None, 50.0, window) == []
    assert _tiles(50.0, 50.0, window) == []
    # All of it fits one sheet.
    assert _tiles(40.0, 50.0, window) == []
    parts = _tiles(10.0, 50.0, window)
    assert parts[0][0] == 10.0
    assert parts[0][3] == 4.0
    assert parts[-1][1] == 16.0
    assert parts[-1][2] == 0.0
    area = sum((east - west) * (north - south) for west, east, south, north in parts)
    assert area == pytest.approx(24.0)
    # Each fits A3 at 1:10, of 420 by 297 mm.
    assert all(e - w < 4.2 and n - s < 2.97 for w, e, s, n in parts)
