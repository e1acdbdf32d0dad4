"""The page states measurements only as far as they hold, and keeps their record."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from pages import drag

from amulor.view import page

pytestmark = pytest.mark.slow


def fitted(shown: Any, kind: str, first: tuple[int, int], last: tuple[int, int]) -> Any:
    """Fit a shape to a region; returns its entry in the list."""
    count = shown.evaluate("amulor.measurements.length")
    if shown.evaluate("amulor.tool") != kind:
        shown.click(f"#tools button[data-kind={kind}]")
    drag(shown, first, last)
    shown.wait_for_selector(f"#measurements li:nth-child({count + 1})")
    return shown.locator("#measurements li").nth(count)


def test_a_shape_that_does_not_fit_is_amber_and_has_no_number(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    one = tab()
    with page.background(steps) as address:
        shown = one.open(address)
        wall = fitted(shown, "plane", (2, 25), (20, 37))
        assert wall.locator(".value").inner_text().partition("tilt")[1]
        assert wall.locator(".doubt").count() == 0
        # The board stands 60 mm before the wall.
        both = fitted(shown, "plane", (2, 8), (20, 32)).locator(".value.doubt")
        assert "does not fit this shape (chi-square" in both.inner_text()
        flat = fitted(shown, "cylinder", (2, 25), (20, 37)).locator(".value.doubt")
        assert "radius not constrained by these pixels" in flat.inner_text()
        assert "±" not in both.inner_text() + flat.inner_text()
        amber = shown.evaluate("""() => {
          const colour = (of) => getComputedStyle(document.querySelector(of)).color;
          return [colour("#measurements .doubt"), colour("#measurements .value")];
        }""")
        assert amber[0] != amber[1]
        text = shown.evaluate("import('./static/tools.js').then(m => m.asText(amulor))")
        assert text.count("diameter") == 0
        assert text.count("does not fit this shape") == 1
        assert one.errors == []
