"""Views and annotations come back: after a reload, by file, and in a saved page."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pages import settled, until

from amulor import imaging, io, rejection, samples
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


#: A place of the screen where a point of the cloud is.
SOMEWHERE = """() => {
  const canvas = document.getElementById("space");
  const box = canvas.getBoundingClientRect();
  const ratio = canvas.width / box.width;
  for (let y = 0.2 * box.height; y < 0.8 * box.height; y += 4)
    for (let x = 0.2 * box.width; x < 0.8 * box.width; x += 4)
      if (amulor.views.seenAt(x * ratio, y * ratio)) return [box.left + x, box.top + y];
  return null;
}"""


def test_a_cloud_has_views_and_annotations_of_its_own(
    tab: Callable[..., Any], tmp_path: Path
) -> None:
    path = tmp_path / "ladder.ply"
    image = imaging.range_image(rejection.cross_polarized(samples.cube("ladder")))
    io.write_ply(imaging.point_cloud(image), path)
    kept = tmp_path / "ladder.ply.notes.json"
    with page.background(page.space.opened(path)) as address:
        opened = tab()
        shown = opened.open(address)
        shown.select_option("#up", "y")
        shown.keyboard.press("Escape")
        shown.focus("#space")
        shown.keyboard.press("2")
        shown.keyboard.press("ArrowLeft")
        look = "[amulor.views.camera.turn, amulor.up, amulor.layerName]"
        pose = shown.evaluate(look)
        shown.keyboard.press("c")
        shown.keyboard.type("from the left")
        shown.keyboard.press("Enter")
        spot = shown.evaluate(SOMEWHERE)
        shown.mouse.click(*spot)
        place = shown.evaluate(
            "amulor.cursor.place.map((part, k) => part + amulor.scene.centre[k])"
        )
        shown.keyboard.press("n")
        shown.keyboard.type("worn edge")
        shown.keyboard.press("Enter")
        until(shown, "document.getElementById('book-note').textContent !== ''")
        shown.wait_for_timeout(500)
        # A view saved after an annotation awaits its name, too.
        shown.keyboard.press("c")
        shown.keyboard.type("second view")
        shown.keyboard.press("Enter")
        shown.wait_for_timeout(500)
        note = json.loads(kept.read_text(encoding="utf-8"))
        assert [view["name"] for view in note["views"]] == [
            "from the left",
            "second view",
        ]
        assert note["annotations"][0]["name"] == "worn edge"
        assert note["annotations"][0]["place"] == pytest.approx(place)
        shown.reload()
        shown.wait_for_selector("html[data-complete=yes]")
        assert shown.evaluate(look) != pose
        shown.locator("#book .view button").first.click()
        settled(shown)
        assert shown.evaluate(look) == pytest.approx(pose)
        shown.click("#book .annotation button")
        settled(shown)
        at = shown.evaluate(
            "amulor.cursor.place.map((part, k) => part + amulor.scene.centre[k])"
        )
        # The page has 32 bits of each coordinate.
        assert at == pytest.approx(place, abs=1e-6)
        assert opened.errors == []
    page.save_page(page.space.opened(path), tmp_path / "page.html")
    shown = tab().open((tmp_path / "page.html").as_uri())
    assert shown.input_value("#book .annotation .name") == "worn edge"
    first = shown.locator("#book .view .name").first
    assert first.input_value() == "from the left"
