"""Views and annotations come back: after a reload, by file, and in a saved page."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pages import settled, until

from amulor import io, rejection, samples
from amulor.view import page

pytestmark = pytest.mark.slow

POSE = "[amulor.views.cloud.camera.turn, amulor.views.cloud.camera.orthographic]"


def test_a_view_and_an_annotation_are_kept_beside_the_data(
    tab: Callable[..., Any], tmp_path: Path
) -> None:
    path = tmp_path / "ladder.nc"
    io.write_cube(rejection.open_water(samples.cube("ladder")), path)
    kept = tmp_path / "ladder.nc.notes.json"
    with page.background(page.opened(path)) as address:
        opened = tab()
        shown = opened.open(address)
        shown.keyboard.press("2")
        until(shown, "amulor.layerName === 'amplitude'")
        shown.keyboard.press("o")
        shown.focus("#cloud")
        for _ in range(3):
            shown.keyboard.press("ArrowRight")
        pose = shown.evaluate(POSE)
        shown.keyboard.press("c")
        # The new view awaits its name.
        shown.keyboard.type("tread")
        shown.keyboard.press("Enter")
        shown.focus("#map")
        shown.keyboard.press("ArrowRight")
        pixel = shown.evaluate("amulor.cursor")
        shown.keyboard.press("t")
        shown.fill("#book .annotation .text", "worn <b>edge</b>")
        shown.press("#book .annotation .text", "Tab")
        until(shown, "document.getElementById('book-note').textContent !== ''")
        shown.wait_for_timeout(500)
        note = json.loads(kept.read_text(encoding="utf-8"))
        assert note["views"][0]["name"] == "tread"
        assert note["annotations"][0]["text"] == "worn <b>edge</b>"
        assert [note["annotations"][0][key] for key in ("row", "column")] == pixel
        # Keys typed into a field are text, not commands.
        assert shown.evaluate("amulor.layerName") == "amplitude"
        shown.keyboard.press("Escape")
        shown.reload()
        shown.wait_for_selector("html[data-complete=yes]")
        assert shown.evaluate("amulor.layerName") == "range"
        shown.click("#book .view button")
        until(shown, "amulor.layerName === 'amplitude'")
        settled(shown)
        assert shown.evaluate(POSE) == pytest.approx(pose)
        shown.mouse.move(1, 1)
        shown.click("#book .annotation button")
        assert shown.evaluate("amulor.pinned") == pixel
        assert opened.errors == []


def test_a_saved_page_has_the_notes_and_keeps_changes_in_the_browser(
    tab: Callable[..., Any], tmp_path: Path
) -> None:
    path = tmp_path / "ladder.nc"
    io.write_cube(rejection.open_water(samples.cube("ladder")), path)
    with page.background(page.opened(path)) as address:
        shown = tab().open(address)
        shown.keyboard.press("t")
        shown.keyboard.type("first")
        shown.keyboard.press("Enter")
        shown.wait_for_timeout(500)
    page.save_page(page.opened(path), tmp_path / "page.html")
    before = (tmp_path / "ladder.nc.notes.json").read_bytes()
    opened = tab()
    shown = opened.open((tmp_path / "page.html").as_uri())
    assert shown.input_value("#book .annotation .name") == "first"
    shown.click("#annotate")
    shown.wait_for_timeout(300)
    shown.reload()
    shown.wait_for_selector("html[data-complete=yes]")
    assert shown.locator("#book .annotation").count() == 2
    assert "in this browser" in shown.inner_text("#book-note")
    assert (tmp_path / "ladder.nc.notes.json").read_bytes() == before
    assert opened.errors == []
