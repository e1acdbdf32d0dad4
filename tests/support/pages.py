"""Waits for what a page in a browser does, however busy the machine is."""

from __future__ import annotations

import time
from typing import Any

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
