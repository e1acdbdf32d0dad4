"""Products ordered in a real browser arrive as files; pictures need no server."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from amulor import handover
from amulor.view import page

pytestmark = pytest.mark.slow


def test_a_section_is_ordered_along_the_line_that_was_drawn(
    tab: Callable[..., Any], steps: page.Recording, tmp_path: Path
) -> None:
    with page.background(steps, products=handover.PageProducts()) as address:
        opened = tab()
        shown = opened.open(address)
        shown.click("#products")
        shown.select_option("#product-kind", "section")
        assert "draw a line" in shown.inner_text("#product-said")
        assert shown.is_disabled("#product-make")
        shown.keyboard.press("Escape")
        shown.keyboard.press("l")
        box = shown.locator("#map").bounding_box()
        middle = box["y"] + box["height"] / 2
        shown.mouse.move(box["x"] + 0.1 * box["width"], middle)
        shown.mouse.down()
        shown.mouse.move(box["x"] + 0.9 * box["width"], middle, steps=4)
        shown.mouse.up()
        line = shown.evaluate("amulor.section")
        shown.keyboard.press("x")
        shown.select_option("#product-ending", ".csv")
        with shown.expect_download() as download:
            shown.click("#product-make")
        path = tmp_path / "section.csv"
        download.value.save_as(path)
        assert download.value.suggested_filename == "steps-section.csv"
        assert "standard uncertainty" in shown.inner_text("#product-said")
        rows = [row for row in path.read_text().splitlines() if row[:1].isdigit()]
        # The board stands 60 mm before the wall, and the line crosses its edge.
        height = [float(row.split(",")[2]) for row in rows]
        assert max(height) - min(height) == pytest.approx(0.06, abs=0.01)
        assert abs(line[1][1] - line[0][1]) > 20
        # A number that cannot be is refused before it travels.
        shown.select_option("#product-kind", "dem")
        shown.fill("#product-cell", "-3")
        shown.click("#product-make")
        assert "cell" in shown.inner_text("#product-said")
        assert opened.errors == []


def test_pictures_and_profiles_are_kept_without_a_server(
    tab: Callable[..., Any], steps: page.Recording, tmp_path: Path
) -> None:
    path = tmp_path / "steps.html"
    page.save_page(steps, path)
    opened = tab()
    shown = opened.open(path.as_uri())
    assert shown.is_hidden("#products")
    for button, name, start in (
        ("#map-picture", "steps-range.png", b"\x89PNG"),
        ("#cloud-picture", "steps-view.png", b"\x89PNG"),
        ("#profile-csv", "steps-profile.csv", b"row,column,along_m"),
    ):
        with shown.expect_download() as download:
            shown.click(button)
        assert download.value.suggested_filename == name
        kept = tmp_path / name
        download.value.save_as(kept)
        assert kept.read_bytes().startswith(start)
    assert opened.errors == []
