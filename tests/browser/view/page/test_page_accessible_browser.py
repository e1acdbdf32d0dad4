"""Every page, in all three themes, has no violation that axe finds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import skips
from pages import click, drag, settled, until

from amulor import acquisition, handover, io, simulation
from amulor.imaging import point_cloud
from amulor.survey import Survey
from amulor.view import page
from amulor.view.design.explorer import Asked, Explorer
from amulor.view.page import space

pytestmark = pytest.mark.slow

#: All rules that decide by themselves, those of good practice included.
_RUN = """async () => {
  const { violations, passes } = await axe.run(document);
  const found = violations.flatMap(({ id, impact, nodes }) => nodes.map(
    ({ target, failureSummary }) => `${id} (${impact}) ${target}: ${failureSummary}`));
  return { found, passed: passes.length };
}"""


@pytest.fixture(scope="module")
def axe() -> str:
    return skips.need_axe().read_text(encoding="utf-8")


def check(shown: Any, axe: str) -> None:
    """Let axe look at a page as it is, in all three themes."""
    shown.evaluate(axe)
    themes = []
    for _ in range(3):
        settled(shown)
        result = shown.evaluate(_RUN)
        theme = shown.evaluate("document.documentElement.dataset.theme")
        assert result["found"] == [], theme
        assert result["passed"] > 15
        themes.append(theme)
        # A key would not reach the page behind a dialog.
        shown.evaluate("document.getElementById('theme').click()")
    assert sorted(themes) == ["contrast", "dark", "light"]


def test_axe_finds_what_is_wrong(
    tab: Callable[..., Any], steps: page.Recording, axe: str
) -> None:
    with page.background(steps) as address:
        shown = tab().open(address)
        shown.evaluate("""() => {
          document.getElementById("help").ariaLabel = "";
          document.getElementById("help").title = "";
          document.getElementById("help").textContent = "";
          document.getElementById("hint").style.color = "#ccc";
        }""")
        with pytest.raises(AssertionError, match=r"button-name.*#help"):
            check(shown, axe)
        shown.evaluate("document.getElementById('help').textContent = '?'")
        with pytest.raises(AssertionError, match=r"color-contrast.*#hint"):
            check(shown, axe)


@pytest.mark.parametrize("width", [1440, 420])
def test_the_page_of_a_scan(
    tab: Callable[..., Any], steps: page.Recording, axe: str, tmp_path: Path, width: int
) -> None:
    page.save_page(steps, tmp_path / "page.html")
    size = {"width": width, "height": 900}
    check(tab(viewport=size).open((tmp_path / "page.html").as_uri()), axe)
    with page.background(steps) as address:
        shown = tab(viewport=size).open(address)
        check(shown, axe)
        # With measurements, one of which does not fit, a wrong hint, and all flags.
        shown.click("#tools button[data-kind=distance]")
        shown.locator("#map").scroll_into_view_if_needed()
        for pixel in ((12, 32), (12, 8)):
            click(shown, pixel)
        shown.wait_for_selector("#measurements li")
        shown.click("#tools button[data-kind=cylinder]")
        shown.locator("#map").scroll_into_view_if_needed()
        drag(shown, (2, 2), (20, 37))
        shown.wait_for_selector("#measurements li:nth-child(2), #hint.wrong")
        shown.keyboard.press("w")
        shown.click("#tools button[data-kind=height]")
        shown.locator("#map").scroll_into_view_if_needed()
        click(shown, (12, 32))
        shown.wait_for_selector("#hint.wrong")
        for key in "2345678":
            shown.keyboard.press(key)
        check(shown, axe)
        shown.keyboard.press("?")
        check(shown, axe)


@pytest.mark.parametrize("width", [1440, 420])
def test_panels_of_the_page_of_a_scan(
    tab: Callable[..., Any], steps: page.Recording, axe: str, tmp_path: Path, width: int
) -> None:
    """The clip box, an annotation, a saved view, deviations and an error are shown."""
    io.write_cube(steps.channel().shown.whole(), tmp_path / "steps.nc")
    recording = page.opened(tmp_path / "steps.nc")
    recording.against = handover.comparison(tmp_path / "steps.nc", unit="m")
    with page.background(recording) as address:
        shown = tab(viewport={"width": width, "height": 900}).open(address)
        for key in "bct":
            shown.keyboard.press(key)
            settled(shown)
            # The field that the key opens would get the next letter.
            shown.evaluate("document.activeElement.blur()")
        shown.fill("#book .annotation .text", "worn edge")
        shown.press("#book .annotation .text", "Tab")
        until(shown, "document.getElementById('book-note').textContent !== ''")
        field = shown.locator("#clip-fields input").first
        field.fill("900000")
        field.press("Tab")
        for name in ("deviation", "significant", "deviation_uncertainty"):
            shown.click(f"#tabs button[data-layer={name}]")
            until(shown, f"amulor.layerName === '{name}'")
        assert shown.is_visible("#clip-panel")
        check(shown, axe)
        page.save_page(recording, tmp_path / "page.html")
        shown = tab(viewport={"width": width, "height": 900}).open(
            (tmp_path / "page.html").as_uri()
        )
        shown.keyboard.press("b")
        assert shown.is_visible("#clip-panel")
        assert shown.is_visible("#book .annotation")
        check(shown, axe)


def test_the_page_of_a_cloud(
    tab: Callable[..., Any], steps: page.Recording, axe: str, tmp_path: Path
) -> None:
    cloud = point_cloud(steps.channel().shown.around([], []))
    path = tmp_path / "steps.ply"
    io.write_cloud(cloud, path)
    for width in (1440, 420):
        with page.background(space.opened(path)) as address:
            shown = tab(viewport={"width": width, "height": 900}).open(address)
            check(shown, axe)
            shown.focus("#space")
            shown.keyboard.press("Enter")
            shown.click("#tools button[data-kind=height]")
            shown.focus("#space")
            shown.keyboard.press("Enter")
            shown.keyboard.press("ArrowLeft")
            shown.keyboard.press("Enter")
            shown.wait_for_selector("#measurements li")
            check(shown, axe)


def test_the_page_of_a_live_scan(
    tab: Callable[..., Any], plate: Survey, axe: str, tmp_path: Path
) -> None:
    survey = plate.with_(
        {
            "scan.columns": 12,
            "scan.rows": 8,
            "scan.dwell": "50 ms",
            "scan.open_water": {"columns": 3, "rows": 2, "repeats": 3},
        }
    )
    acquisition.acquire(survey, tmp_path / "scan", scene=simulation.scene_light)
    live = page.Live(tmp_path / "scan")
    with page.background(live) as address:
        shown = tab().open(address)
        until(shown, "document.documentElement.dataset.state === 'finished'")
        check(shown, axe)
    live.stop()


def test_the_dialog_of_products(
    tab: Callable[..., Any], steps: page.Recording, axe: str
) -> None:
    products = handover.PageProducts()
    with page.background(steps, products=products) as address:
        shown = tab().open(address)
        shown.click("#products")
        for kind in shown.eval_on_selector_all(
            "#product-kind option", "(all) => all.map((one) => one.value)"
        ):
            shown.select_option("#product-kind", kind)
            check(shown, axe)


def test_the_page_of_a_design(tab: Callable[..., Any], axe: str) -> None:
    design = Explorer(
        Survey.preset("amulor-2010"),
        asked=[Asked(distance=1.5, attenuation=0.5, accuracy=1e-3)],
    )
    with page.background(design) as address:
        for width in (1440, 420):
            shown = tab(viewport={"width": width, "height": 900}).open(address)
            check(shown, axe)
            shown.focus("#map")
            shown.keyboard.press("ArrowUp")
            check(shown, axe)
