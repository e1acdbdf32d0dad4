"""The whole quick study by its command, and the gallery page beside it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from scripts import script

from amulor.cli import main
from amulor.studies.ricci2010 import parameters, reproduce

DOCS = Path(__file__).parents[2] / "docs"
KEPT = json.loads((DOCS / "images" / "ricci2010" / "checks.json").read_text())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return what `amulor reproduce ricci2010 --quick` writes."""
    output = tmp_path_factory.mktemp("study") / "ricci2010"
    words = ["reproduce", "ricci2010", "--quick", "--json", "--output", str(output)]
    assert main(words) == 0
    return output


@pytest.fixture(scope="module")
def quick(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "checks.json").read_text())


@pytest.mark.study
def test_every_figure_is_drawn(folder: Path) -> None:
    for name in reproduce.output_names(reproduce.FIGURES):
        assert (folder / name).stat().st_size > 10_000, name
    for number in reproduce.FIGURES:
        picture = (folder / f"{reproduce.stem_of(number)}.svg").read_text()
        # Figure 1 is theory alone; all others show what would be measured.
        assert ("synthetic" in picture) == (number != 1), number


@pytest.mark.study
def test_the_gallery_shows_the_statements_and_outcomes_of_this_code(
    quick: dict[str, Any],
) -> None:
    for kept, found in zip(KEPT["figures"], quick["figures"], strict=True):
        # Fewer photons and pixels, but no statement may turn for that.
        before, now = (
            [(c["statement"], c["role"], c["passed"]) for c in figure["checks"]]
            for figure in (kept, found)
        )
        assert before == now, f"figure {kept['number']}: python docs/make_gallery.py"
        assert kept["caption"] == found["caption"]
        assert kept["title"] == found["title"]


def test_the_gallery_was_made_with_these_numbers() -> None:
    stated = {
        name: (entry.shown, entry.basis, entry.reason)
        for name, entry in parameters.load().items()
    }
    kept = {
        e["name"]: (e["shown"], e["basis"], e["reason"]) for e in KEPT["parameters"]
    }
    assert kept == stated, "run: python docs/make_gallery.py"


def test_the_page_is_made_from_the_kept_checks() -> None:
    module = script("docs/make_gallery.py")
    page = (DOCS / "gallery" / "ricci2010.md").read_text()
    assert page == module.page(KEPT), "run: python docs/make_gallery.py --page"


def test_every_number_that_a_figure_reads_is_used() -> None:
    names = set(parameters.load())
    folder = Path(reproduce.__file__).parent
    files = [*folder.rglob("*.py"), folder / "scans.toml"]
    code = "".join(path.read_text() for path in files)
    for name in names:
        stem = name.rstrip("123")
        options = [f'"{name}"', f'"{stem}{{', f'f"{name.rsplit("_", 1)[0]}_{{']
        assert any(option in code for option in options), name
