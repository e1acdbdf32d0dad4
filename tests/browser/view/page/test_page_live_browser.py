"""A running scan grows in the browser, survives losses, and is shown once more."""

from __future__ import annotations

import re
import shutil
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pages import drawn, until

from amulor import acquisition, simulation
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.settings import Settings
from amulor.survey import Survey
from amulor.view import page

pytestmark = pytest.mark.slow

KNOWN = """amulor.scene.maps.get(amulor.scene.main).values
    .reduce((sum, value) => sum + (Number.isFinite(value) ? 1 : 0), 0)"""

#: Closes the connection, and keeps what the card says even if it is mended at once.
CLOSED = """() => {
  const card = document.querySelector("#scan-card .state");
  window.states = [];
  new MutationObserver(() => window.states.push(card.className))
    .observe(card, { attributes: true });
  amulor.live.socket.close();
}"""


#: Draws the drift of the water, and returns its labels with the pixel that each begins
#: at.
LABELS = """(change) => {
  const { fillText } = CanvasRenderingContext2D.prototype;
  const found = [];
  CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
    const width = this.measureText(text).width;
    found.push([text, this.textAlign === "right" ? x - width : x]);
    return fillText.call(this, text, x, y);
  };
  const { live } = amulor;
  const drift = { elapsed: [0, 60], change, error: [0.01, 0.01] };
  live.status = { ...live.status, drift: { ...live.status.drift, ...drift } };
  live.draw();
  CanvasRenderingContext2D.prototype.fillText = fillText;
  return found.filter(([text]) => text.endsWith("%"));
}"""


@pytest.fixture
def folder() -> Iterator[Path]:
    memory = Path("/dev/shm")
    place = tempfile.mkdtemp(dir=memory if memory.is_dir() else None)
    yield Path(place) / "scan"
    shutil.rmtree(place, ignore_errors=True)


def recorded(
    survey: Survey,
    folder: Path,
    progress: Callable[[acquisition.Progress], None],
    **procedure: float,
) -> threading.Thread:
    """Start a simulated scan in a thread; return it once there is a journal."""
    thread = threading.Thread(
        target=acquisition.acquire,
        args=(survey, folder),
        kwargs={
            "settings": Settings.model_validate({"procedure": procedure}),
            "scene": simulation.scene_light,
            "progress": progress,
        },
    )
    thread.start()
    while not (folder / FILE_NAME).exists():
        time.sleep(0.05)
    return thread


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
    go_on, grow, finish = (threading.Event() for _ in range(3))

    def slowly(now: acquisition.Progress) -> None:
        # Half of the first channel, then no further before the page is open, has shown
        # some rows, and has shown what a running scan shows.
        for done, event in ((90, go_on), (120, grow), (now.total - 20, finish)):
            if now.done > done:
                event.wait(300)
        if now.done > 90:
            time.sleep(0.03)

    thread = recorded(survey, folder, slowly, dark_readings=2)
    live = page.Live(folder)
    try:
        one = tab()
        with page.background(live) as address:
            shown = one.open(address)
            until(shown, "document.documentElement.dataset.done > 50")
            go_on.set()
            until(shown, "document.documentElement.dataset.rows > 0")
            first = shown.evaluate(KNOWN)
            # The signals of a pixel appear when its row is measured.
            signal = "amulor.spectrum?.after?.amplitude[0]"
            below = first // 16 + 1
            until(shown, f"amulor.cursor[0] < {below}")
            for _ in range(below - shown.evaluate("amulor.cursor[0]")):
                shown.press("#map", "ArrowDown")
            until(shown, f"amulor.spectrum && !({signal} > 0)")
            grow.set()
            until(shown, f"({KNOWN}) > {first}")
            until(shown, f"{signal} > 0")
            shown.evaluate("amulor.pinned = null")
            assert shown.inner_text("#scan-card .state").startswith("taking")
            assert "time left" in shown.inner_text("#scan-card")
            # The band across the top, and the title of the tab.
            until(shown, "document.querySelector('#band .end') !== null")
            assert re.fullmatch(
                r"ends (\w{3} )?\d\d:\d\d", shown.inner_text("#band .end")
            )
            share = shown.evaluate("document.querySelector('#band progress').value")
            assert 0 < share < 1
            assert re.fullmatch(rf"\d+ % · {survey.name} · amulor", shown.title())
            # Signals over time: all kinds of samples, with the newest value.
            until(shown, "document.documentElement.dataset.traced > 90")
            assert "open water" in shown.inner_text("#traces-note")
            label = shown.get_attribute("#strips canvas", "aria-label")
            assert re.search(r"amplitude [\d.]+ ± [\d.]+ [mµ]V$", label), label
            picture = drawn(shown, "strips-amplitude")
            assert (picture[..., 3] > 0).mean() > 0.01
            # The pointer is in the newest row, until it is moved.
            until(shown, "amulor.cursor[0] === amulor.live.status.row")
            assert "none" not in shown.inner_text("#readout")
            shown.press("#map", "ArrowUp")
            shown.press("#map", "ArrowUp")
            pointed = shown.evaluate("amulor.cursor[0]")
            until(shown, f"({KNOWN}) >= 155")
            assert shown.evaluate("amulor.live.status.row !== amulor.cursor[0]")
            assert shown.evaluate("amulor.cursor[0]") == pointed
            # Loss of the connection: said, and mended by itself.
            shown.evaluate(CLOSED)
            until(shown, "window.states.some((state) => state.includes('lost'))")
            until(
                shown, "amulor.live.socket.readyState === 1 && amulor.live.tries === 0"
            )
            # A reload in the middle shows at once what is there.
            shown = one.open(address)
            until(shown, f"({KNOWN}) >= {first}")
            finish.set()
            until(shown, "document.documentElement.dataset.state === 'finished'")
            until(shown, f"({KNOWN}) >= 155")
            until(shown, "document.title.startsWith('finished · ')")
            assert shown.evaluate("amulor.scene.byName.has('range_before')")
            assert one.errors == []
            # Nobody moved the view in space, so that it looks at the middle of all.
            until(shown, "Math.abs(amulor.views.cloud.camera.target[1]) < 0.002")
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
        for event in (go_on, grow, finish):
            event.set()
        thread.join(120)
        live.stop()


def test_messages_go_with_their_cause_and_labels_of_the_drift_are_whole(
    tab: Callable[..., Any], plate: Survey, folder: Path
) -> None:
    survey = plate.with_(
        {
            "scan.columns": 4,
            "scan.rows": 2,
            "scan.dwell": "50 ms",
            "scan.open_water": {"columns": 3, "rows": 2, "repeats": 3},
        }
    )
    acquisition.acquire(survey, folder, scene=simulation.scene_light)
    live = page.Live(folder)
    # As the command does, in its own thread, before the server runs.
    live.look()
    with page.background(live) as address:
        one = tab()
        shown = one.open(address)
        until(shown, "document.documentElement.dataset.state === 'finished'")
        assert shown.is_hidden("#message")
        elsewhere = folder.with_name("elsewhere")
        folder.rename(elsewhere)
        # A folder that is gone is noticed when the journal is opened again.
        with live._reading:
            live._close()
        message = "document.getElementById('message')"
        until(shown, f"{message}.textContent.includes('holds no journal')")
        assert shown.is_visible("#message")
        elsewhere.rename(folder)
        until(shown, f"{message}.hidden")
        for change in ([0, 0.05], [0, -0.13], [0, 0.004], [0.07, -0.7], [0, -1e-4]):
            labels = shown.evaluate(LABELS, change)
            assert all(left >= 0 for _, left in labels), labels
            signs = {text[0] for text, _ in labels}
            assert {"0", "+", "\N{MINUS SIGN}"} <= signs, labels
    live.stop()


def test_track_and_coverage_of_a_vehicle_are_shown_while_it_drives(
    tab: Callable[..., Any], plate: Survey, folder: Path
) -> None:
    survey = plate.with_(
        {
            "instrument.modulation_frequencies": ["39 MHz"],
            "instrument.polarizations": ["VV"],
            "scan.columns": 4,
            "scan.rows": 12,
            "scan.azimuth_span": 0.1,
            "scan.elevation_span": 0.0,
            "scan.dwell": "50 ms",
            "scan.open_water": {"columns": 3, "rows": 1, "repeats": 3},
            "pose": {"position": [0.0, 0.0, -8.0], "pitch": "-90 deg"},
            "platform": {
                "readings": "at-once",
                "course": {
                    "kind": "line", "start": [0.0, 0.0, -8.0], "speed": "0.05 m/s",
                },
                "mounting": {"pitch": "-90 deg"},
            },
        }
    )  # fmt: skip
    go_on = threading.Event()

    def slowly(now: acquisition.Progress) -> None:
        if now.done > now.total - 20:
            go_on.wait(300)

    thread = recorded(survey, folder, slowly, dark_readings=2, settling=20)
    live = page.Live(folder)
    try:
        one = tab()
        with page.background(live) as address:
            shown = one.open(address)
            until(shown, "document.documentElement.dataset.lines > 4")
            text = shown.inner_text("#vehicle-card")
            assert re.search(r"speed\s+0\.05 m/s, 0\.05 planned", text)
            assert re.search(r"between lines\s+[\d.]+ mm, 10 wanted", text)
            until(shown, "amulor.live.status.advice[0]?.startsWith('too fast')")
            assert "Too fast: " in shown.inner_text("#band .advice")
            until(shown, "/covered/.test(document.body.innerText)")
            picture = drawn(shown, "vehicle-plan")
            assert (picture[..., 3] > 0).mean() > 0.01
            label = shown.get_attribute("#vehicle-plan", "aria-label")
            assert "points per m²" in label
            go_on.set()
            until(shown, "document.documentElement.dataset.state === 'finished'")
            until(shown, "document.documentElement.dataset.lines === '12'")
            assert one.errors == []
    finally:
        go_on.set()
        thread.join(120)
        live.stop()
