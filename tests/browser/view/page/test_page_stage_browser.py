"""The stage: map and 3-D view fit the scan and the window; plots are in a drawer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from pages import drawn, settled, until

from amulor import rejection, samples
from amulor.view import page

pytestmark = pytest.mark.slow

#: Elements that a user needs at first.
NEEDED = (
    "#tabs",
    "#bar",
    "#map",
    "#cloud",
    "#light-note",
    "#readout",
    "#tools",
    "#hint",
    "#drawer",
)
SPLIT = "document.getElementById('stage-card').dataset.split"


@pytest.fixture(scope="module")
def ladder() -> page.Recording:
    target = rejection.open_water(samples.cube("ladder"))
    return page.recording_of(target, name="ladder.nc")


@pytest.mark.parametrize("drawer", ["open", "closed"])
def test_nothing_needed_is_below_the_first_screen(
    tab: Callable[..., Any], ladder: page.Recording, drawer: str
) -> None:
    with page.background(ladder) as address:
        opened = tab(viewport={"width": 1280, "height": 800})
        shown = opened.open(address)
        if drawer == "closed":
            shown.click("#drawer-toggle")
            settled(shown)
        assert shown.is_visible("#plots") == (drawer == "open")
        for name in NEEDED:
            box = shown.locator(name).bounding_box()
            assert box["x"] >= 0, name
            assert box["x"] + box["width"] <= 1280, name
            assert box["y"] + box["height"] <= 800, name
        low = "document.querySelector('main').scrollHeight <= innerHeight"
        assert shown.evaluate(low)
        boxes = [shown.locator(name).bounding_box() for name in ("#map", "#cloud")]
        # One beside or below the other, never one over the other.
        beside = boxes[0]["x"] + boxes[0]["width"] <= boxes[1]["x"]
        above = boxes[0]["y"] + boxes[0]["height"] <= boxes[1]["y"]
        assert beside != above
        assert opened.errors == []


def test_the_drawer_gives_its_place_to_the_views_and_is_remembered(
    tab: Callable[..., Any], ladder: page.Recording
) -> None:
    with page.background(ladder) as address:
        opened = tab()
        shown = opened.open(address)
        toggle = shown.locator("#drawer-toggle")
        assert toggle.get_attribute("aria-expanded") == "true"
        before = shown.locator("#stages").bounding_box()["height"]
        shown.keyboard.press("g")
        settled(shown)
        assert toggle.get_attribute("aria-expanded") == "false"
        assert shown.locator("#stages").bounding_box()["height"] > before + 120
        shown.reload()
        shown.wait_for_selector("html[data-complete=yes]")
        assert not shown.is_visible("#plots")
        # A profile along a line needs its plot.
        shown.keyboard.press("l")
        settled(shown)
        assert shown.is_visible("#profile")
        assert drawn(shown, "profile")[..., 3].any()
        assert opened.errors == []


def test_views_are_shown_alone_or_together_by_keyboard(
    tab: Callable[..., Any], ladder: page.Recording
) -> None:
    with page.background(ladder) as address:
        opened = tab()
        shown = opened.open(address)
        wide = shown.locator("#map").bounding_box()
        # The ladder is 2.5 times as wide as high; in this window, the views are
        # stacked without the plots.
        shown.keyboard.press("m")
        settled(shown)
        alone = shown.locator("#map").bounding_box()
        assert shown.evaluate(SPLIT) == "map"
        assert not shown.is_visible("#cloud")
        assert alone["width"] * alone["height"] > 1.8 * wide["width"] * wide["height"]
        shown.keyboard.press("m")
        settled(shown)
        assert shown.evaluate(SPLIT) == "cloud"
        assert not shown.is_visible("#map")
        assert shown.get_attribute("#views [data-view=cloud]", "aria-pressed") == "true"
        # A tool that draws on the map shows the map.
        shown.click("#tools button[data-kind=plane]")
        settled(shown)
        assert shown.evaluate(SPLIT) == "map"
        shown.click("#views [data-view=both]")
        settled(shown)
        assert shown.evaluate(SPLIT) in ("row", "column")
        shown.reload()
        shown.wait_for_selector("html[data-complete=yes]")
        assert shown.evaluate(SPLIT) in ("row", "column")
        assert opened.errors == []


def test_a_narrow_window_shows_one_view_that_fills_it(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    with page.background(steps) as address:
        opened = tab(viewport={"width": 420, "height": 800})
        shown = opened.open(address)
        assert shown.evaluate(SPLIT) == "map"
        assert not shown.is_visible("#cloud")
        assert not shown.is_visible("#views [data-view=both]")
        shown.click("#views [data-view=cloud]")
        until(shown, "amulor.views.cloud.canvas.width > 300")
        settled(shown)
        colours = drawn(shown, "cloud")
        away = abs(colours[..., :3] - colours[5, 5, :3]).sum(axis=-1) > 60
        # The surface fills most of the width.
        assert away.any(axis=0).mean() > 0.6
        # Wider, both views return.
        shown.click("#views [data-view=map]")
        shown.set_viewport_size({"width": 1280, "height": 800})
        settled(shown)
        assert shown.evaluate(SPLIT) == "map"
        assert shown.is_visible("#views [data-view=both]")
        assert opened.errors == []
