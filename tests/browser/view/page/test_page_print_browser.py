"""The printed page is one sheet: pictures, scales, measurements, source of data."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pages import click, drawn, settled, until

from amulor import io, rejection, samples
from amulor.view import page

pytestmark = pytest.mark.slow

_SHOWN = """() => [...document.body.children]
  .filter((one) => getComputedStyle(one).display !== 'none').map((one) => one.id)"""
#: Number of colors in each picture of the sheet, and its size.
_PICTURES = """() => [...document.querySelectorAll('#sheet canvas:not(.scale *)')].map((one) => {
  const { data } = one.getContext('2d').getImageData(0, 0, one.width, one.height);
  const colours = new Set();
  for (let k = 0; k < data.length; k += 64) colours.add(data[k] + 256 * data[k + 1]);
  return [one.width, one.height, colours.size, data[0], data[1], data[2]];
})"""  # noqa: E501


def test_the_printed_page_is_one_sheet_with_its_source(
    tab: Callable[..., Any], tmp_path: Path
) -> None:
    path = tmp_path / "ladder.nc"
    io.write_cube(rejection.open_water(samples.cube("ladder")), path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    with page.background(page.opened(path)) as address:
        opened = tab(viewport={"width": 1280, "height": 800}, color_scheme="dark")
        shown = opened.open(address)
        until(shown, "amulor.digest !== ''")
        shown.click("#tools button[data-kind=distance]")
        click(shown, (20, 8))
        click(shown, (20, 60))
        shown.wait_for_selector("#measurements li")
        shown.mouse.move(1, 1)
        settled(shown)
        value = shown.inner_text("#measurements li .value").removeprefix("1").strip()
        screen = drawn(shown, "map")
        pdf = shown.pdf(format="A4")
        assert len(re.findall(rb"/Type\s*/Page\b", pdf)) == 1
        shown.emulate_media(media="print")
        assert shown.evaluate(_SHOWN) == ["sheet"]
        text = shown.inner_text("#sheet")
        for words in ("Ladder in milky water", f"sha256:{digest}", value, "[m]"):
            assert words in text
        assert re.search(r"printed \d{4}-\d\d-\d\d", text)
        pictures = shown.evaluate(_PICTURES)
        assert len(pictures) == 2
        for width, height, colours, *corner in pictures:
            assert width * height > 500_000
            assert colours > 50
            # Paper is white, whatever the theme of the screen.
            assert corner == [255, 255, 255]
        shown.emulate_media(media="screen")
        settled(shown)
        assert shown.evaluate("document.documentElement.dataset.theme") == "dark"
        # A canvas that was resized smooths the edges of lines differently.
        change = abs(drawn(shown, "map") - screen).max(axis=-1)
        assert change.max() < 64
        assert (change > 0).mean() < 0.01
        assert opened.errors == []
