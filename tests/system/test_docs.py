"""What the documentation shows is what the code is."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType

import pytest
from scripts import script

ROOT = Path(__file__).parents[2]


def _generator() -> ModuleType:
    return script("docs/make_reference.py")


@pytest.mark.parametrize(
    "name",
    [
        "survey-file.md",
        "cube.md",
        "flags.md",
        "samples.md",
        pytest.param("presets-where.md", marks=pytest.mark.slow),
    ],
)
def test_the_reference_pages_are_up_to_date(name: str) -> None:
    page = _generator().PAGES[name]()
    found = (ROOT / "docs" / "reference" / name).read_text(encoding="utf-8")
    assert found == page, "run: python docs/make_reference.py"


PAGES = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text("utf-8")):
        assert (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_options_stand_in_code(page: Path) -> None:
    # Sphinx makes a dash of two hyphens outside of code, and the option is lost.
    text = page.read_text("utf-8")
    blocks = re.compile(r"^(```+|~~~+).*?^\1", flags=re.DOTALL | re.MULTILINE)
    prose = re.sub(r"`[^`]*`", "", blocks.sub("", text))
    assert re.findall(r"(?<=[\s(])--[a-z][a-z-]*", prose) == []


def test_a_root_below_a_slash_is_in_brackets() -> None:
    # "a / m \sqrt N" reads as a product: (a / m) \sqrt N.
    for page in PAGES:
        found = re.findall(r"/ *\w+ *\\sqrt", page.read_text("utf-8"))
        assert found == [], page


@pytest.mark.slow
def test_the_tutorial_runs_as_it_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from amulor import io
    from amulor.cli import main

    text = (ROOT / "docs" / "tutorial.md").read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    (survey,) = re.findall(r"```toml\n(.*?)```", text, flags=re.DOTALL)
    (tmp_path / "tank.toml").write_text(survey)
    commands = re.findall(r"^\$ amulor (.+)$", text, flags=re.MULTILINE)
    assert len(commands) == 9
    for command in commands:
        assert main(command.split()) == 0, command
    capsys.readouterr()
    before, after = (
        io.read_cube(tmp_path / f"{name}.nc") for name in ("before", "after")
    )
    error = [
        float((cube["slant_range"] - cube["truth_slant_range"]).mean())
        for cube in (before, after)
    ]
    # "Too near, and bent" before; "flat at 1.5 m" after.
    assert error[0] < -0.02
    assert abs(error[1]) < 0.003
    spread = [
        float((cube["slant_range"] - cube["truth_slant_range"]).mean("row").std())
        for cube in (before, after)
    ]
    assert spread[0] > 5 * spread[1]
    assert (tmp_path / "plate.laz").stat().st_size > 0
