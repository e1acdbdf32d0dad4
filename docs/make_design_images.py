"""Draws docs/images/design: what docs/how-to/design.md shows.

The page with sliders needs the Chromium of the system and playwright.
"""

from __future__ import annotations

import shutil
import sys
from dataclasses import replace
from pathlib import Path

from amulor.cli.design import explorer_of, reasons_of
from amulor.design import Goal, Recommendation, recommend
from amulor.view import page
from amulor.view.design.figures import error_maps
from amulor.view.design.report import error_of, figures_of, waters_of
from amulor.view.report import png

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "images" / "design"


def recommended(name: str) -> Recommendation:
    """Return what is recommended for one of the goals among the examples."""
    return recommend(Goal.from_toml(ROOT / "examples" / "goals" / f"{name}.toml"))


def paper(found: Recommendation) -> bytes:
    """Return the paper's frequencies beside each other, crossed polarizers."""
    goal, best = found.goal, found.best.parameters
    maps = {
        f"{frequency / 1e6:g} MHz, {best.polarization}": error_of(
            goal, replace(best, frequencies=(frequency,))
        )
        for (frequency,) in goal.components.modulation.sets
    }
    ends = sorted(set(waters_of(goal, best)))
    asked = [(distance, water) for distance in goal.asked for water in ends]
    return png(error_maps(maps, asked=asked))


def shot(found: Recommendation, browser: str) -> bytes:
    """Return the page with sliders as it opens."""
    from playwright.sync_api import sync_playwright

    shown = explorer_of(found.goal, found)
    with page.background(shown) as address, sync_playwright() as driver:
        chromium = driver.chromium.launch(
            executable_path=browser, args=["--no-sandbox"]
        )
        tab = chromium.new_page(viewport={"width": 1280, "height": 800})
        tab.goto(address)
        tab.wait_for_selector("html[data-complete=yes]", timeout=60_000)
        tab.wait_for_timeout(2000)
        # How long this computer took is not part of the picture.
        tab.evaluate("document.getElementById('timing').textContent = ''")
        picture = bytes(tab.screenshot())
        chromium.close()
    return picture


def draw(browser: str | None) -> None:
    """Draw all pictures."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    milk, wall = recommended("paper_milk"), recommended("harbour_wall")
    (FOLDER / "paper.png").write_bytes(paper(milk))
    for name, figure in figures_of(wall, reasons_of(wall, confirm=False)).items():
        (FOLDER / f"wall-{name}.png").write_bytes(png(figure))
    if browser is None:
        sys.exit("no Chromium: the picture of the page was not drawn")
    (FOLDER / "page.png").write_bytes(shot(wall, browser))


if __name__ == "__main__":
    draw(shutil.which("chromium"))
