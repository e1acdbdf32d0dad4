"""The page states measurements only as far as they hold, and keeps their record."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pages import click, drag, drawn, settled, until

from amulor import rejection, samples
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


def distance(shown: Any, first: tuple[int, int], second: tuple[int, int]) -> None:
    """Measure a distance and wait until it is in the list."""
    count = shown.evaluate("amulor.measurements.length")
    if shown.evaluate("amulor.tool") != "distance":
        shown.click("#tools button[data-kind=distance]")
    click(shown, first)
    click(shown, second)
    shown.wait_for_selector(f"#measurements li:nth-child({count + 1})")


def as_text(shown: Any) -> str:
    text: str = shown.evaluate(
        "import('./static/tools.js').then(m => m.asText(amulor))"
    )
    return text


def kept(shown: Any, button: str) -> str:
    """Return the file that a button gives."""
    with shown.expect_download() as download:
        shown.click(button)
    return Path(download.value.path()).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def ladder() -> page.Recording:
    target = rejection.open_water(samples.cube("ladder"))
    return page.recording_of(target, name="ladder.nc")


def test_a_measurement_keeps_what_it_was_made_in(
    tab: Callable[..., Any], ladder: page.Recording
) -> None:
    one = tab()
    with page.background(ladder) as address:
        shown = one.open(address)
        shown.select_option("#average", label="3 × 3")
        distance(shown, (20, 8), (20, 60))
        first = shown.evaluate("amulor.measurements[0].found.lines[0].value")
        shown.select_option("#channel", "VH")
        until(shown, "amulor.scene.channel === 'VH' && amulor.scene.maps.has('flags')")
        settled(shown)
        text = as_text(shown)
        assert text.count("channel VV, water removed, map range, means of 3 × 3") == 1
        assert "VH" not in text
        shown.keyboard.press("2")
        until(shown, "amulor.layerName === 'amplitude'")
        shown.select_option("#average", label="1")
        distance(shown, (20, 8), (20, 60))
        rows = list(csv.DictReader(kept(shown, "#measured-csv").splitlines()))
        said = [(r["channel"], r["map"], r["averaged"], r["water"]) for r in rows]
        assert said == [
            ("VV", "Range", "3 × 3", "removed"),
            ("VH", "Amplitude", "1 × 1", "removed"),
        ]
        assert {row["file"] for row in rows} == {"ladder.nc"}
        assert float(rows[0]["value"]) == first
        found = json.loads(kept(shown, "#measured-json"))
        assert [m["channel"] for m in found["measurements"]] == ["VV", "VH"]
        assert found["measurements"][0]["found"]["lines"][0]["value"] == first
        captions = shown.evaluate("""import('./static/tools.js').then(
            m => amulor.measurements.map(m.captioned))""")
        assert [text.rpartition("(")[2] for text in captions] == [
            "channel VV)",
            "channel VH)",
        ]
        assert one.errors == []


def test_the_record_outlives_a_reload_and_removing_is_undone(
    tab: Callable[..., Any], ladder: page.Recording
) -> None:
    one = tab()
    with page.background(ladder) as address:
        shown = one.open(address)
        for column in (60, 70):
            distance(shown, (20, 8), (20, column))
        before = as_text(shown)
        shown.reload()
        shown.wait_for_selector("html[data-complete=yes]")
        assert as_text(shown) == before
        shown.click("#measurements li:first-child .remove")
        assert shown.locator("#measurements li").count() == 1
        shown.click("#clear")
        assert shown.locator("#measurements li").count() == 0
        shown.click("#undo")
        shown.keyboard.press("Control+z")
        assert as_text(shown) == before
        # A number is never given twice.
        distance(shown, (20, 8), (20, 75))
        assert shown.evaluate("amulor.measurements.map((one) => one.number)") == [
            1,
            2,
            3,
        ]
        assert one.errors == []


def test_a_saved_page_keeps_its_record_over_a_reload(
    tab: Callable[..., Any], ladder: page.Recording, tmp_path: Path
) -> None:
    path = tmp_path / "page.html"
    page.save_page(ladder, path)
    one = tab()
    shown = one.open(path.as_uri())
    distance(shown, (20, 8), (20, 60))
    shown.reload()
    shown.wait_for_selector("html[data-complete=yes]")
    assert shown.locator("#measurements li").count() == 1
    assert one.errors == []


def test_a_late_answer_leaves_the_newer_hint(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    with page.background(steps) as address:
        shown = tab().open(address)
        held: list[Any] = []
        shown.route("**/measure", lambda route: held.append(route))
        shown.click("#tools button[data-kind=sphere]")
        drag(shown, (2, 25), (20, 37))
        until(shown, "document.getElementById('hint').textContent === 'Measuring…'")
        shown.click("#tools button[data-kind=cylinder]")
        for _ in range(100):
            if held:
                break
            shown.wait_for_timeout(60)
        held[0].continue_()
        shown.wait_for_selector("#measurements li")
        assert "over the pipe" in shown.inner_text("#hint")


def test_with_the_water_left_in_no_number_has_an_interval(
    tab: Callable[..., Any], tmp_path: Path
) -> None:
    raw = rejection.keep_water(samples.cube("ladder"))
    path = tmp_path / "raw.html"
    page.save_page(page.recording_of(raw, name="raw.nc"), path)
    one = tab()
    shown = one.open(path.as_uri())
    click(shown, (20, 8))
    settled(shown)
    texts = shown.evaluate(
        "[...document.querySelectorAll('#readout, #notes')]"
        ".map(part => part.innerText).join(' ')"
    )
    words = "water not removed: error unknown, expect centimeters"
    assert words in texts.lower()
    assert "±" not in texts
    assert shown.locator("#water button:visible").all_inner_texts() == ["Water in"]
    distance(shown, (20, 8), (20, 60))
    entry = shown.locator("#measurements li").first.inner_text()
    assert "±" not in entry
    assert words in entry
    text = shown.evaluate("import('page/tools.js').then(m => m.asText(amulor))")
    assert "±" not in text
    assert one.errors == []


def test_a_volume_over_a_plane_by_keyboard(
    tab: Callable[..., Any], steps: page.Recording
) -> None:
    one = tab()
    with page.background(steps) as address:
        shown = one.open(address)

        def rectangle(kind: str, last: tuple[int, int], first: tuple[int, int]) -> None:
            """Set two corners by arrow keys and Enter."""
            count = shown.evaluate("amulor.measurements.length")
            shown.focus(f"#tools button[data-kind={kind}]")
            shown.keyboard.press("Enter")
            shown.focus("#map")
            for corner in (first, last):
                now = shown.evaluate("amulor.cursor")
                for at, keys in ((0, ("Up", "Down")), (1, ("Left", "Right"))):
                    for _ in range(abs(corner[at] - now[at])):
                        shown.keyboard.press(f"Arrow{keys[corner[at] > now[at]]}")
                assert shown.evaluate("amulor.cursor") == list(corner)
                shown.keyboard.press("Enter")
            shown.wait_for_selector(f"#measurements li:nth-child({count + 1})")

        # Without a plane there is nothing over which the volume is one.
        shown.click("#tools button[data-kind=volume]")
        drag(shown, (2, 8), (20, 34))
        shown.wait_for_selector("#hint.wrong")
        assert "Fit a plane to the ground first" in shown.inner_text("#hint")
        shown.click("#tools button[data-kind=volume]")
        rectangle("plane", (20, 36), (3, 26))
        assert shown.evaluate("amulor.measurements[0].region") == [3, 26, 20, 36]
        head = shown.inner_text("#measurements li:first-child .value")
        # The wall is a plane across the view.
        assert "tilt" in head
        assert "flatness" in head
        rectangle("volume", (2, 8), (20, 34))
        found = shown.evaluate("amulor.measurements[1]")
        assert found["region"] == [2, 8, 20, 34]
        line = found["found"]["lines"][0]
        # The board, 60 mm before the wall, and its shadow: beams between two planes.
        # Its edge is straight ahead; columns and rows are 8 / 39 and 4.8 / 23 deg.
        wide = math.tan(math.radians(11.5 * 8 / 39))
        tall = math.tan(math.radians(9.5 * 4.8 / 23)) + math.tan(
            math.radians(8.5 * 4.8 / 23)
        )
        true = wide * tall * (1.5**3 - 1.44**3) / 3
        assert line["unit"] == "m3"
        assert line["value"] == pytest.approx(true, rel=0.05)
        assert abs(line["value"] - true) < 2 * line["uncertainty"]
        entry = shown.inner_text("#measurements li:nth-child(2)")
        assert " ± " in entry
        assert "cm³" in entry
        assert one.errors == []


def test_a_measurement_has_a_name_and_a_place_and_is_drawn_in_space(
    tab: Callable[..., Any], steps: page.Recording, tmp_path: Path
) -> None:
    one = tab()
    with page.background(steps) as address:
        shown = one.open(address)
        plain = drawn(shown, "cloud")
        fitted(shown, "plane", (2, 25), (20, 37))
        settled(shown)
        # The rectangle is drawn on the surface.
        assert (drawn(shown, "cloud") != plain).any(axis=-1).sum() > 100
        field = "#measurements li:first-child .name"
        shown.fill(field, 'wall, "east"')
        shown.press(field, "Enter")
        settled(shown)
        assert shown.evaluate("amulor.chosen.name") == 'wall, "east"'
        rows = list(csv.DictReader(kept(shown, "#measured-csv").splitlines()))
        assert {row["name"] for row in rows} == {'wall, "east"'}
        # The wall is 1.5 m before the instrument; the rectangle is from column 25 to
        # 37 of 40 over 8 degrees, about its middle.
        right = 1.5 * math.tan(math.radians((31 - 19.5) * 8 / 39))
        assert float(rows[0]["place_forward_m"]) == pytest.approx(1.5, abs=0.01)
        assert float(rows[0]["place_right_m"]) == pytest.approx(right, abs=0.003)
        assert '1. wall, "east": plane' in as_text(shown)
        with shown.expect_download() as download:
            shown.click("#save")
        saved = tmp_path / "page.html"
        download.value.save_as(saved)
        shown.click("#undo")
        assert shown.input_value(field) == ""
        assert shown.locator("#measurements li").count() == 1
        # By keyboard, a number selects its measurement.
        shown.evaluate("amulor.chosen = null")
        shown.focus("#measurements li:first-child .number")
        shown.keyboard.press("Enter")
        assert shown.evaluate("amulor.chosen.number") == 1
        shown = one.open(saved.as_uri())
        assert shown.input_value(field) == 'wall, "east"'
        assert one.errors == []
