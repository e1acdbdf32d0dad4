"""The page with sliders in a real browser: maps by mouse, keys and on a phone."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from amulor.survey import Survey
from amulor.view import page
from amulor.view.design.explorer import Asked, Explorer

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    shown = Explorer(
        Survey.preset("amulor-2010"),
        asked=[Asked(distance=1.5, attenuation=0.5, accuracy=1e-3)],
    )
    with page.background(shown) as found:
        yield found


def _settled(shown: Any) -> None:
    """Wait until the last wish is drawn."""
    for _ in range(400):
        if not shown.evaluate("amulor.busy || amulor.wanted"):
            return
        shown.wait_for_timeout(25)
    raise AssertionError("the page is still busy")


def test_sliders_redraw_the_map_and_nothing_is_asked_elsewhere(
    tab: Callable[..., Any], address: str
) -> None:
    one = tab()
    shown = one.open(address)
    before = shown.evaluate("amulor.found.error.slice()")
    assert shown.locator("#said li").inner_text().startswith("1.5 m, 0.5 1/m")
    shown.focus("#slider-power")
    for _ in range(6):
        shown.keyboard.press("ArrowLeft")
        _settled(shown)
    shown.keyboard.press("Home")
    _settled(shown)
    after = shown.evaluate("amulor.found.error.slice()")
    # Less light, more noise, wherever there is a range.
    pairs = [(a, b) for a, b in zip(before, after, strict=True) if a and b]
    assert len(pairs) > 900
    assert all(b >= a * 0.999 for a, b in pairs)
    assert max(b / a for a, b in pairs) > 1.05
    # Without the time that the loaded server of a test takes, drawing is quick.
    assert min(shown.evaluate("amulor.timing.map((one) => one.draw)")) < 40
    shown.keyboard.press("r")
    _settled(shown)
    assert shown.evaluate("amulor.found.error.slice()") == before
    assert one.errors == []
    assert all(url.startswith(address) for url in one.asked)


def test_keys_move_the_mark_and_the_survey_is_kept(
    tab: Callable[..., Any], address: str
) -> None:
    shown = tab().open(address)
    at = shown.evaluate("amulor.mark.slice()")
    shown.focus("#map")
    shown.keyboard.press("ArrowRight")
    shown.keyboard.press("ArrowUp")
    assert shown.evaluate("amulor.mark.slice()") == [at[0] + 1, at[1] + 1]
    error = shown.evaluate(
        "amulor.found.error[amulor.mark[1] * amulor.scene.distance.length"
        " + amulor.mark[0]]"
    )
    assert f"{error:.3g}"[:4] in shown.locator("#readout").inner_text()
    shown.select_option("#water", "3C")
    _settled(shown)
    with shown.expect_download() as download:
        shown.keyboard.press("Escape")
        shown.click("#save")
    survey = Survey.from_toml(download.value.path())
    assert survey.water.type == "3C"


def test_a_phone_shows_map_and_sliders_without_scrolling_aside(
    tab: Callable[..., Any], address: str
) -> None:
    shown = tab(viewport={"width": 390, "height": 844}).open(address)
    assert shown.evaluate("document.documentElement.scrollWidth") <= 390
    box = shown.locator("#map").bounding_box()
    assert box["width"] > 300
    for name in ("power", "frequency", "baseline", "radius", "field_of_view", "dwell"):
        # A finger needs room.
        assert shown.locator(f"#slider-{name}").bounding_box()["height"] >= 28
