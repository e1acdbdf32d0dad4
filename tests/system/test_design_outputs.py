"""From a goal to the report: one command, one page, nothing fetched from elsewhere."""

from __future__ import annotations

import json
import re
from pathlib import Path

import paper_goal
import pytest

from amulor.cli import main
from amulor.survey import Survey

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder in which the paper's goal was answered with all outputs."""
    folder = tmp_path_factory.mktemp("design")
    words = [
        "design", str(paper_goal.PAPER), "-o", "s.toml", "--report", "r.html",
        "--figures", "figures", "--confirm",
    ]  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(words) == 0
        # What is there is kept.
        assert main(words) == 1
    return folder


def test_the_design_page_opens_without_a_survey_file(
    capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    served = []
    monkeypatch.setattr(
        "amulor.cli.design.serve", lambda content, **options: served.append(content)
    )
    assert main(["design", str(paper_goal.PAPER), "--interactive"]) == 0
    assert len(served) == 1
    assert "amulor survey check" not in capsys.readouterr().out


def test_the_report_stands_alone_and_says_what_was_found(folder: Path) -> None:
    page = (folder / "r.html").read_text()
    assert not re.findall(r'(?:src|href)="(?!data:)', page)
    assert "<script" not in page
    for heading in (
        "Components", "Requirements", "Where it works",
        "Trade-off of time, frequency and error", "Measurements before a purchase",
        "Assumptions that would change the answer", "Confirmed by scans and photons",
    ):  # fmt: skip
        assert f"<h2>{heading}</h2>" in page, heading
    best = paper_goal.choice().best
    assert f"{best.error * 1e3:.3g} mm at {best.worst_distance:.3g} m" in page
    # The paper's own choice: 39 MHz, crossed polarizers.
    assert "39 MHz" in page
    assert "VH" in page
    assert page.count("data:image/png;base64,") == 4


def test_figures_and_survey_are_written(folder: Path) -> None:
    names = sorted(path.name for path in (folder / "figures").iterdir())
    assert names == ["fronts.png", "map.png", "runner-up-map.png", "sensitivity.png"]
    assert Survey.from_toml(folder / "s.toml").instrument.polarizations == ("VH",)


def test_the_command_prints_all_of_it_as_json(tmp_path: Path, capsys) -> None:
    words = ["design", str(paper_goal.PAPER), "-o", str(tmp_path / "s.toml")]
    assert main([*words, "--figures", str(tmp_path / "figures"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["best"]["parameters"]["polarization"] == "VH"
    first, *rest = found["sensitivity"]["numbers"]
    assert all(first["total"] >= one["total"] for one in rest)
    labels = {one["label"] for one in found["what_if"]}
    assert {"attenuation of the water", "phase floor"} <= labels
    assert len(found["trade"]["error"]) == len(found["trade"]["scan_time"])
    assert found["confirmation"] == []
