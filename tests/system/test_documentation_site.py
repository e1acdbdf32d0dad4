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
    # A list for the repository, and a part of another page.
    assert pages - listed == {"README", "gallery/ricci2010-discussion"}


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
def test_the_links_of_the_built_site_lead_somewhere() -> None:
    if not (DOCS / "_build" / "html" / "index.html").exists():
        pytest.skip("the site is not built; make docs")
    assert _script("check_links").broken(DOCS / "_build" / "html") == []


@pytest.mark.study
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_runs(path: Path) -> None:
    done = subprocess.run(
        [sys.executable, path.name],
        cwd=path.parent, env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
