"""The documentation site: its tables are the code's, its pages are all reached."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from numpy.testing import assert_allclose
from scripts import script

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLES = sorted((DOCS.parent / "examples" / "gallery").glob("plot_*.py"))


def _script(name: str) -> ModuleType:
    return script(f"docs/{name}.py")


def test_the_figures_look_up_what_the_models_say() -> None:
    script = _script("make_learn_tables")
    text = script.FILE.read_text()
    kept = json.loads(text.removeprefix("window.amulorTables=").rstrip(";\n"))
    fresh = script.tables()
    assert set(kept) == set(fresh)
    for name, values in fresh.items():
        # Six digits are written; the water of one column falls through zero.
        assert_allclose(kept[name], values, rtol=2e-5, atol=1e-13, err_msg=name)


def test_each_figure_of_a_chapter_is_drawn() -> None:
    script = (DOCS / "_static" / "learn" / "learn.js").read_text()
    drawn = set(re.findall(r'^  "([a-z-]+)": \{$', script, flags=re.MULTILINE))
    shown = {
        name
        for page in (DOCS / "learn").glob("*.md")
        for name in re.findall(r'data-figure="([a-z-]+)"', page.read_text())
    }
    assert shown == drawn
    assert len(shown) == 6


def test_every_page_stands_in_a_table_of_contents() -> None:
    pages = {
        path.relative_to(DOCS).with_suffix("").as_posix()
        for path in DOCS.rglob("*.md")
        if not {"_build", "api", "examples"} & set(path.relative_to(DOCS).parts)
    }
    listed = {"index"}
    for page in pages:
        text = (DOCS / f"{page}.md").read_text()
        for block in re.findall(r"```\{toctree\}\n(.*?)```", text, flags=re.DOTALL):
            for line in block.splitlines():
                if line and not line.startswith(":"):
                    found = (DOCS / page).parent.joinpath(line).resolve()
                    folder = found.parent
                    listed |= {
                        one.relative_to(DOCS).with_suffix("").as_posix()
                        for one in folder.glob(f"{found.name}.md")
                    }
    # A list for the repository, and parts of other pages, one written by each build.
    parts = {"gallery/ricci2010-discussion", "reference/presets-where"}
    made = {"trust/benchmark-tables"}
    assert pages - listed - made == {"README"} | parts


def test_a_link_that_leads_nowhere_is_found(tmp_path: Path) -> None:
    (tmp_path / "api").mkdir()
    (tmp_path / "index.html").write_text(
        '<a href="api/one.html#here"></a><a href="https://example.org/gone"></a>'
        '<a href="api/one.html#there"></a><a href="two.html"></a><a href="#top"></a>'
        '<h1 id="top"></h1><img src="_images/no.png"><a href="api"></a>'
    )
    (tmp_path / "api" / "one.html").write_text(
        '<p id="here"></p><a href="../index.html#top"></a><a href="../x%20y.txt"></a>'
    )
    (tmp_path / "x y.txt").write_text("")
    assert _script("check_links").broken(tmp_path) == [
        "index.html: api/one.html#there: no such place in it",
        "index.html: two.html: no such file",
        "index.html: _images/no.png: no such file",
        "index.html: api: no such file",
    ]


@pytest.mark.slow
def test_the_site_builds_without_a_warning_or_a_broken_link(tmp_path: Path) -> None:
    pytest.importorskip("sphinx", reason="pip install --group docs")
    built = tmp_path / "html"
    # The examples of the gallery run in studies and in make docs.
    done = subprocess.run(
        [
            sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-E",
            "-t", "bare", "-D", "plot_gallery=0", "-d", tmp_path / "doctrees",
            DOCS, built,
        ],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert _script("check_links").broken(built) == []
    listing = DOCS.parent / "tests" / "reference" / "public_surface.txt"
    public = [line.split()[:2] for line in listing.read_text().splitlines()]
    shown = {
        name
        for page in (built / "api").rglob("*.html")
        for name in re.findall(r'<dt [^>]*id="(amulor[\w.]*)"', page.read_text())
    }
    # Of names in amulor itself the page is under the room that defines them.
    asked = {
        name
        for name, kind in public
        if kind in {"class", "function"} and name.count(".") > 1
    }
    assert asked - shown == set()


@pytest.mark.study
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(path: Path) -> None:
    done = subprocess.run(
        [sys.executable, path.name],
        cwd=path.parent, env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_the_trust_figure_shows_each_scene_of_the_table() -> None:
    from amulor.studies.trust.table import _APART, written

    figure = script("docs/_ext/trust_figure.py")
    rows = list(written((DOCS / figure.TABLE).read_text(encoding="utf-8")))
    shown = [scene for scenes in figure.KINDS.values() for scene in scenes]
    with_target = {row.scene for row in rows if "empty" not in row.scene}
    assert sorted(shown) == sorted(with_target - set(_APART))
    # Lowest, median and highest of eight rows, read off the table by eye.
    trusted, inside = figure.spans(rows)["simulated acquisition", "open-water"]
    assert trusted == (99.2, 100.0, 100.0)
    assert inside == (92.4, 96.1, 99.7)
    assert len(figure.figure(rows).axes) == 2


def test_the_trust_figure_shows_each_kind_of_instrument_error() -> None:
    from amulor.studies.trust import instrument
    from amulor.studies.trust.scenes.instrument import KINDS

    figure = script("docs/_ext/trust_figure.py")
    table = (DOCS / figure.INSTRUMENT_TABLE).read_text(encoding="utf-8")
    rows = list(instrument.written(table))
    drawn = figure.instrument_figure(rows)
    labels = [label.get_text() for label in drawn.axes[0].get_yticklabels()]
    assert labels == [name for name in KINDS if name != "perfect"]
    (row,) = (
        row
        for row in rows
        if row.key == instrument.Key(
            kind="harmonic", size=1.0, count=1, state="uncalibrated",
            method="open-water",
        )
    )  # fmt: skip
    # Mean error of 3.2 mm, stated 18.1 mm.
    assert figure.errors([row]) == {
        ("harmonic", 1.0, 1): pytest.approx(row.mean / row.stated)
    }
    assert row.mean / row.stated == pytest.approx(0.178, abs=0.003)


def test_the_summary_of_the_paper_counts_as_its_tables_do() -> None:
    summary = (DOCS / "gallery" / "paper.md").read_text()
    tables = (DOCS / "gallery" / "ricci2010.md").read_text()
    stated = re.search(
        r"(\d+) of (\d+) statements of the paper hold\. For (\d+) more statements, "
        r".*? and (\d+) of these hold\. The study adds (\d+) checks .*?, and (\d+) of",
        tables,
    )
    assert stated is not None
    hold, of, chosen, right, own, passed = stated.groups()
    for cells in ((of, hold), (chosen, right), (own, passed)):
        assert f"| {cells[0]} | {cells[1]} |" in summary
    parts = re.findall(r"\| (\d+) of (\d+) \|", summary)
    assert sum(int(part) for part, _ in parts) == int(hold)
    assert sum(int(part) for _, part in parts) == int(of)
