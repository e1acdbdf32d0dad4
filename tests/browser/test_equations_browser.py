"""Equations of the theory pages in a browser: none is cut where nobody can scroll."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import skips

DOCS = Path(__file__).parents[2] / "docs"
#: The part of the settings of the site that equations hang on.
SETTINGS = """
extensions = ["myst_parser", "sphinx-mathjax-offline"]
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_dmath_double_inline = True
html_theme = "pydata_sphinx_theme"
html_static_path = ["_static"]
html_css_files = ["site.css"]
"""
#: How far the symbols of each equation start before the box that shows them [px], and
#: whether that box scrolls.
MEASURE = """() => [...document.querySelectorAll("div.math")].map((equation) => {
  const symbols = [...equation.querySelectorAll("mjx-c")];
  let left = Math.min(...symbols.map((s) => s.getBoundingClientRect().left));
  let hidden = 0, scrolls = false;
  for (let box = symbols[0]; box !== document.body; box = box.parentElement) {
    const overflow = getComputedStyle(box).overflowX;
    const edge = box.getBoundingClientRect().left;
    if (overflow !== "visible") hidden = Math.max(hidden, edge - left);
    if (overflow === "auto" && box.scrollWidth > box.clientWidth) {
      scrolls = true;
      left = Math.max(left, edge);
    }
  }
  return [hidden, scrolls];
})"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the page with the most equations, built without the rest of the site."""
    pytest.importorskip("sphinx", reason="pip install 'amulor[docs]'")
    source = tmp_path_factory.mktemp("site")
    shutil.copytree(DOCS / "_static", source / "_static")
    text = (DOCS / "theory" / "water-signal.md").read_text(encoding="utf-8")
    # Links and pictures lead out of what is built here.
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    (source / "index.md").write_text(text, encoding="utf-8")
    (source / "conf.py").write_text(SETTINGS, encoding="utf-8")
    built = source / "html"
    command = [sys.executable, "-m", "sphinx", "-q", "-b", "html", source, built]
    subprocess.run(command, check=True, capture_output=True)
    return built / "index.html"


# The text is as wide at 660 px as at 1280 px with the columns of the site beside it.
@pytest.mark.slow
@pytest.mark.parametrize("width", [660, 420])
def test_no_equation_is_cut_at_the_left(site: Path, width: int) -> None:
    chromium = skips.need_browser()
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(
            executable_path=chromium, args=["--no-sandbox"]
        )
        page: Any = browser.new_page(viewport={"width": width, "height": 900})
        page.goto(site.as_uri())
        page.evaluate("MathJax.startup.promise.then(() => true)")
        found = page.evaluate(MEASURE)
        browser.close()
    assert len(found) > 30
    # Half a pixel is rounding.
    assert [hidden for hidden, _ in found if hidden > 0.5] == []
    # Some are wider than the text, or this shows nothing.
    assert any(scrolls for _, scrolls in found)
