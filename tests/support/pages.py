"""Pointing at a page in a browser, and waiting for it however busy the machine is."""

from __future__ import annotations

import base64
import io
import time
from typing import Any

import matplotlib.image
import numpy as np

#: The timers of the page that were set before end first; then frames follow, in which
#: what was asked for is drawn, sizes are found anew, and that is drawn.
_SETTLED = """async () => {
  await new Promise((done) => setTimeout(done, 250));
  for (let frame = 0; frame < 4; frame += 1)
    await new Promise((done) => requestAnimationFrame(done));
}"""


def settled(tab_page: Any) -> None:
    """Wait until the page has drawn all that was asked for so far."""
    tab_page.evaluate(_SETTLED)


def until(tab_page: Any, expression: str, timeout: float = 120.0) -> None:
    """Wait [s] until something holds; the page's policy forbids it to wait itself."""
    deadline = time.monotonic() + timeout
    while not tab_page.evaluate(expression):
        assert time.monotonic() < deadline, expression
        tab_page.wait_for_timeout(60)


_PICTURE = "(name) => document.getElementById(name).toDataURL('image/png')"


def drawn(tab_page: Any, name: str) -> np.ndarray:
    """Return what a canvas shows, rows of red, green, blue, cover."""
    data = tab_page.evaluate(_PICTURE, name).partition(",")[2]
    picture = matplotlib.image.imread(io.BytesIO(base64.b64decode(data)))
    return np.round(picture * 255).astype(int)


def place(tab_page: Any, pixel: tuple[int, int]) -> dict[str, float]:
    """Return where the middle of a pixel is on the screen."""
    spot = tab_page.evaluate(
        "(pixel) => amulor.views.map.spot(amulor.scene, pixel)", list(pixel)
    )
    box = tab_page.locator("#map").bounding_box()
    ratio = tab_page.evaluate("document.getElementById('map').width") / box["width"]
    return {"x": box["x"] + spot[0] / ratio, "y": box["y"] + spot[1] / ratio}


def click(tab_page: Any, pixel: tuple[int, int]) -> None:
    """Pick a pixel in the map."""
    spot = place(tab_page, pixel)
    tab_page.mouse.click(spot["x"], spot["y"])


def drag(tab_page: Any, first: tuple[int, int], last: tuple[int, int]) -> None:
    """Drag from one pixel of the map to another."""
    start, end = place(tab_page, first), place(tab_page, last)
    tab_page.mouse.move(start["x"], start["y"])
    tab_page.mouse.down()
    tab_page.mouse.move(end["x"], end["y"], steps=4)
    tab_page.mouse.up()
