"""A clip box limits what is drawn and measured, by keyboard and by dragging."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from pages import click, drag, drawn, settled

from amulor.view import page

pytestmark = pytest.mark.slow


def surface(shown: Any) -> float:
    """Share of the view in space that is not background."""
    colours = drawn(shown, "cloud")[..., :3]
    return float((abs(colours - colours[5, 5]).sum(axis=-1) > 60).mean())


def test_a_clip_box_cuts_views_picks_and_fits(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    with page.background(steps) as address:
        opened = tab()
        shown = opened.open(address)
        before = surface(shown)
        shown.keyboard.press("b")
        settled(shown)
        map_before = drawn(shown, "map")
        assert shown.get_attribute("#clip", "aria-expanded") == "true"
        # The board is 1.44 m, the wall 1.5 m before the instrument.
        assert float(
            shown.get_attribute("#clip-low-2", "placeholder")
        ) == pytest.approx(1440, abs=15)
        shown.fill("#clip-low-2", "1470")
        shown.press("#clip-low-2", "Enter")
        settled(shown)
        assert (drawn(shown, "map") != map_before).any()
        shown.click("#tools button[data-kind=distance]")
        click(shown, (12, 8))
        assert "outside the clip box" in shown.inner_text("#hint")
        assert shown.evaluate("amulor.picks.length") == 0
        # A plane through both is one of the wall alone.
        shown.click("#tools button[data-kind=plane]")
        drag(shown, (2, 8), (20, 37))
        shown.wait_for_selector("#measurements li")
        found = shown.evaluate("amulor.measurements[0]")
        assert found["clip"] == "forward from 1470.0 mm"
        assert found["found"]["doubt"] is None or found["found"]["doubt"] == ""
        assert shown.locator("#measurements .doubt").count() == 0
        text = shown.evaluate("import('./static/tools.js').then(m => m.asText(amulor))")
        assert "clip box forward from 1470.0 mm" in text
        # Without the panel, everything is drawn again.
        shown.click("#clear")
        shown.keyboard.press("Escape")
        half = surface(shown)
        shown.keyboard.press("b")
        shown.evaluate("document.activeElement.blur()")
        settled(shown)
        assert surface(shown) == pytest.approx(before, rel=0.05)
        assert half < before
        assert opened.errors == []


def test_a_side_of_the_box_is_dragged(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    with page.background(steps) as address:
        opened = tab()
        shown = opened.open(address)
        shown.click("#clip")
        shown.click("#front")
        settled(shown)
        # From the front, the right side of the box is right of the middle.
        spot, scale = shown.evaluate("""() => {
          const get = (k, side) => Number(document.getElementById(`clip-${side}-${k}`)
            .placeholder) / 1e3;
          const middle = [0, 1, 2].map((k) => (get(k, 'low') + get(k, 'high')) / 2);
          const m = amulor.views.cloud.matrix;
          const { canvas } = amulor.views.cloud;
          const box = canvas.getBoundingClientRect();
          const at = (p) => {
            const w = m[3]*p[0] + m[7]*p[1] + m[11]*p[2] + m[15];
            return box.left + (0.5 + (m[0]*p[0] + m[4]*p[1] + m[8]*p[2] + m[12])/w/2)
              * box.width;
          };
          const y = (p) => {
            const w = m[3]*p[0] + m[7]*p[1] + m[11]*p[2] + m[15];
            return box.top + (0.5 - (m[1]*p[0] + m[5]*p[1] + m[9]*p[2] + m[13])/w/2)
              * box.height;
          };
          const end = [get(0, 'high'), middle[1], middle[2]];
          return [[at(end), y(end)], (at(end) - at(middle)) / (end[0] - middle[0])];
        }""")
        wide = float(shown.get_attribute("#clip-high-0", "placeholder")) / 1e3
        shown.mouse.move(*spot)
        shown.mouse.down()
        shown.mouse.move(spot[0] - 40, spot[1], steps=5)
        shown.mouse.up()
        settled(shown)
        limit = float(shown.input_value("#clip-high-0")) / 1e3
        assert limit == pytest.approx(wide - 40 / scale, abs=0.003)
        # The view itself has not turned, and nothing was picked.
        assert shown.evaluate("amulor.views.cloud.camera.turn") == 0
        shown.click("#clip-whole")
        assert shown.input_value("#clip-high-0") == ""
        assert opened.errors == []
