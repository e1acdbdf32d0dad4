"""A site's scans and visits come in one view, with poses, overlap and change."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import drawn_sites
import numpy as np
import pytest

from amulor.cli import main
from amulor.cli.site import changes_between, opened
from amulor.view.page.sites import site_space
from amulor.view.page.space import Space

#: A plateau of this height appears here between the visits [m].
HEIGHT, MIDDLE = 0.02, (0.1, 0.05)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a site file with its registration: two visits of four scans each."""
    folder = tmp_path_factory.mktemp("site")
    return drawn_sites.bumped_site(folder, rows=50, height=HEIGHT, middle=MIDDLE)


@pytest.fixture(scope="module")
def shown(site: Path) -> Space:
    merged = opened(site, site.with_name("poses.json"))
    change, *_ = changes_between(merged, ("one", "two"))
    return site_space(merged.cloud, merged.registration, change=change)


def test_scans_have_a_visit_a_color_and_a_pose(shown: Space) -> None:
    scene = shown.describe()
    scans = scene["scans"]
    assert [scan["name"] for scan in scans] == [
        "a1",
        "a2",
        "a3",
        "a4",
        *["b1", "b2", "b3", "b4"],
    ]
    assert {scan["visit"] for scan in scans} == {"one", "two"}
    numbers = np.frombuffer(shown.values("scan"), "<f4")
    assert np.bincount(numbers.astype(int)).tolist() == [s["points"] for s in scans]
    colors = np.frombuffer(shown.values("colour"), "u1").reshape(-1, 3)
    for number, scan in enumerate(scans):
        assert (colors[numbers == number] == scan["colour"]).all()
    # Poses are relative to that of the first scan.
    assert scans[0]["position_uncertainty"] == 0
    assert all(scan["position_uncertainty"] >= 0 for scan in scans)
    assert shown.up == "z"


def test_residuals_come_from_the_registration_the_worst_pair_first(site: Path) -> None:
    merged = opened(site, site.with_name("poses.json"))
    quiet, wide = (
        {
            "source": source,
            "target": "a1",
            "points": 1200,
            "moved_points": moved,
            "misfit": misfit,
            "median_distance_m": distance,
            "trust": 1.0,
            "loose": [[0.0] * 6] * loose,
            "moved_pixels": [],
        }
        for source, moved, misfit, distance, loose in (
            ("a2", 0, 0.98, 4e-4, 0),
            ("a3", 17, 1.9, 2.5e-3, 3),
        )
    )
    registration = replace(merged.registration, pairs=(quiet, wide))
    first, second = site_space(merged.cloud, registration).describe()["pairs"]
    assert first == {
        "source": "a3",
        "target": "a1",
        "points": 1200,
        "distance": 2.5e-3,
        "misfit": 1.9,
        "moved": 17,
        "directions": 3,
        "trust": 1.0,
    }
    assert (second["source"], second["directions"]) == ("a2", 6)


def test_the_bump_is_the_change_that_is_significant(shown: Space) -> None:
    place = np.frombuffer(shown.values("position"), "<f4").reshape(-1, 3)
    place = place + shown.centre
    value, sure, sigma = (
        np.frombuffer(shown.values(f"change{end}"), "<f4")
        for end in ("", "_significant", "_uncertainty")
    )
    away = np.linalg.norm(place[:, :2] - MIDDLE, axis=1)
    top, outside = away < 0.04, (away > 0.25) & np.isfinite(value)
    assert np.isfinite(value[top]).mean() > 0.9
    inside = top & np.isfinite(value)
    off = (value[inside] - HEIGHT) / sigma[inside]
    assert abs(np.median(off)) < 2
    assert np.isfinite(sure[inside]).mean() > 0.95
    assert np.isfinite(sure[outside]).mean() < 0.1
    assert any(
        note.startswith("Change: from visit one") for note in shown.describe()["notes"]
    )


def test_a_place_is_in_several_scans(shown: Space) -> None:
    overlap = np.frombuffer(shown.values("overlap"), "<f4")
    assert overlap.min() >= 1
    # Four stations around the bed look at its middle.
    assert np.median(overlap) >= 2
    assert overlap.max() <= 4


@pytest.mark.slow
def test_the_command_saves_a_site_as_one_page(
    site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    saved = tmp_path / "site.html"
    words = ["--poses", str(site.with_name("poses.json")), "--save", str(saved)]
    assert main(["view", str(site), *words]) == 0
    assert "one page" in capsys.readouterr().out
    text = saved.read_text(encoding="utf-8")
    # One region changed: its place, area, mean and volume are in the notes.
    place = r"Change 1: at \(0\.1\d+, 0\.0\d+, [\d.-]+\) m, \d+ \\u00b1 \d+ cm2"
    assert re.search(place, text)
    assert 'data-name="layer/space/change_significant"' in text
    assert 'data-name="layer/space/scan"' in text


def test_poses_go_with_a_site(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses = str(site.with_name("poses.json"))
    assert main(["view", "a.nc", "--poses", poses]) == 2
    assert "--poses" in capsys.readouterr().err
    assert main(["view", str(site), "--unit", "mm"]) == 2
