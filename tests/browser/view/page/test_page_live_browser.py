"""A running scan grows in the browser, survives losses, and is shown once more."""

from __future__ import annotations

import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from amulor import acquisition, simulation
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.settings import Settings
from amulor.survey import Survey
from amulor.view import page

pytestmark = pytest.mark.slow

KNOWN = """amulor.scene.maps.get(amulor.scene.main).values
    .reduce((sum, value) => sum + (Number.isFinite(value) ? 1 : 0), 0)"""


def until(tab_page: Any, expression: str, timeout: float = 30_000) -> None:
    """Wait until something holds; the page's policy forbids it to wait by itself."""
    deadline = time.monotonic() + timeout / 1000
    while not tab_page.evaluate(expression):
        assert time.monotonic() < deadline, expression
        tab_page.wait_for_timeout(60)


@pytest.fixture
def folder() -> Iterator[Path]:
    memory = Path("/dev/shm")
    place = tempfile.mkdtemp(dir=memory if memory.is_dir() else None)
    yield Path(place) / "scan"
    shutil.rmtree(place, ignore_errors=True)


def test_a_scan_grows_while_the_page_is_open(
    tab: Callable[..., Any], plate: Survey, folder: Path
) -> None:
    survey = plate.with_(
        {
            "scan.columns": 16,
            "scan.rows": 10,
            "scan.dwell": "50 ms",
            "scan.open_water": {"columns": 3, "rows": 2, "repeats": 3},
        }
    )
    go_on = threading.Event()

    def slowly(now: acquisition.Progress) -> None:
        # Half of the first channel, then no further before the page is open.
        if now.done > 90:
            go_on.wait(120)
            time.sleep(0.03)

    thread = threading.Thread(
        target=acquisition.acquire,
        args=(survey, folder),
        kwargs={
            "settings": Settings.model_validate({"procedure": {"dark_readings": 2}}),
            "scene": simulation.scene_light,
            "progress": slowly,
        },
    )
    thread.start()
    while not (folder / FILE_NAME).exists():
        time.sleep(0.05)
    live = page.Live(folder)
    try:
        one = tab()
        with page.background(live) as address:
            shown = one.open(address)
            until(shown, "document.documentElement.dataset.done > 50")
            go_on.set()
            until(shown, "document.documentElement.dataset.rows > 0", timeout=90_000)
            first = shown.evaluate(KNOWN)
            until(shown, f"({KNOWN}) > {first}", timeout=90_000)
            assert shown.inner_text("#scan-card .state").startswith("taking")
            assert "time left" in shown.inner_text("#scan-card")
            # Loss of the connection: said, and mended by itself.
            shown.evaluate("amulor.live.socket.close()")
            shown.wait_for_selector("#scan-card .state.lost", timeout=20_000)
            until(
                shown,
                "amulor.live.socket.readyState === 1 && amulor.live.tries === 0",
                timeout=30_000,
            )
            # A reload in the middle shows at once what is there.
            shown = one.open(address)
            until(shown, f"({KNOWN}) >= {first}", timeout=60_000)
            until(
                shown,
                "document.documentElement.dataset.state === 'finished'",
                timeout=120_000,
            )
            until(shown, f"({KNOWN}) >= 155", timeout=90_000)
            assert shown.evaluate("amulor.scene.byName.has('range_before')")
            assert one.errors == []
            # Once more from the start.
            shown.wait_for_selector("#scan-card .replay:not([hidden])")
            whole = shown.evaluate(KNOWN)
            slider = shown.locator("#scan-card .replay input")
            slider.fill("400")
            until(shown, "document.documentElement.dataset.replayed === '0.4'")
            assert 0 < shown.evaluate(KNOWN) < whole
            slider.fill("1000")
            until(shown, "document.documentElement.dataset.replayed === '1'")
            assert shown.evaluate(KNOWN) == whole
    finally:
        go_on.set()
        thread.join(120)
        live.stop()
