"""A scan as text: what stands in a terminal is what was measured."""

from __future__ import annotations

import contextlib
import importlib
import io
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rich.console import Console

from amulor import acquisition, simulation
from amulor.acquisition.settings import Settings
from amulor.cli import main
from amulor.survey import Survey
from amulor.view import terminal
from amulor.view.page import Live

NOW = datetime(2026, 5, 4, 12, 30)
watch_module = importlib.import_module("amulor.cli.watch")


def test_blocks_are_means_of_what_is_known() -> None:
    values = np.arange(12.0).reshape(3, 4)
    values[0, 0] = np.nan
    values[2, :2] = np.nan
    found = terminal.shrunk(values, 2, 4)
    assert_allclose(found, [[(1 + 4 + 5) / 3, (2 + 3 + 6 + 7) / 4], [np.nan, 10.5]])


def test_small_maps_are_enlarged_and_large_ones_keep_their_aspect() -> None:
    assert terminal.shrunk(np.ones((2, 5)), 40, 23).shape == (8, 20)
    assert terminal.shrunk(np.ones((400, 100)), 40, 80).shape == (40, 10)
    assert terminal.shrunk(np.ones((30, 1000)), 40, 80).shape == (3, 77)


def test_half_blocks_hold_two_pixels_of_the_right_colours() -> None:
    text = terminal.picture(np.array([[0.0, np.nan], [1.0, 1.0]]), colours="gray")
    assert text.plain == "▀▄"
    styles = [str(span.style) for span in text.spans]
    assert styles == ["rgb(0,0,0) on rgb(255,255,255)", "rgb(255,255,255)"]


def test_without_colours_a_larger_value_is_a_darker_letter() -> None:
    values = np.array([[0.0, 0.3, 0.6, 1.0], [np.nan, 1.0, 1.0, 0.0]])
    lines = terminal.picture(values, colours="gray", plain=True).plain.split("\n")
    order = [terminal._SHADES.index(letter) for letter in lines[0]]
    assert order == sorted(order)
    assert order[0] > 0
    assert lines[1][0] == " "


def test_a_line_says_what_an_operator_wants_to_know() -> None:
    status = {
        "state": "running",
        "kind": "scan",
        "done": 1200,
        "total": 4800,
        "rate": 10.2,
        "left": 3600,
        "flagged": {"overload": 12},
        "drift": {"elapsed": [0.0, 9.0], "total": {"size": 0.043, "error": 0.004}},
    }
    line = terminal.going(status, ratio=812.4, now=NOW)
    assert line == (
        "scan, 1,200 of 4,800 samples (25%), 10/s, 1:00:00 left, ends at 13:30, "
        "12 overload, signal/noise 812, open water +4.3 ± 0.4 %"
    )
    assert terminal.going({}, ratio=None, now=NOW) == "not begun"


@pytest.fixture(scope="module")
def folder(plate: Survey, tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("watched") / "scan"
    acquisition.acquire(
        plate.with_(
            {
                "scan.columns": 8,
                "scan.rows": 3,
                "scan.dwell": "50 ms",
                "scan.open_water": {"columns": 3, "rows": 2, "repeats": 3},
            }
        ),
        place,
        settings=Settings.model_validate({"procedure": {"dark_readings": 2}}),
        scene=simulation.scene_light,
    )
    return place


@pytest.mark.parametrize("plain", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_screen_fits_and_shows_the_scan(folder: Path, plain: bool) -> None:
    live = Live(folder)
    live.look()
    live.stop()
    console = Console(file=io.StringIO(), width=60, height=24, force_terminal=True)
    shown = terminal.screen(
        live, channel="VH", layer="range", size=(60, 24), plain=plain, now=NOW
    )
    with console.capture() as taken:
        console.print(shown)
    lines = taken.get().splitlines()
    assert len(lines) <= 24
    assert "scan, VH" in lines[0]
    (scale,) = (line for line in lines if " m" in line and "range" in line)
    low, high = (float(word) for word in scale.split() if word[:2] in ("1.", "\x1b"))
    # A plate 1.5 m away.
    assert 1.45 < low < high < 1.55
    assert "finished" in taken.get()


def test_nothing_measured_is_said(folder: Path) -> None:
    live = Live(folder)
    shown = terminal.screen(
        live, channel="VV", layer="range", size=(60, 24), plain=True, now=NOW
    )
    console = Console(file=io.StringIO(), width=60)
    with console.capture() as taken:
        console.print(shown)
    assert "nothing measured yet" in taken.get()


def test_the_command_in_a_pipe(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted((p.name, p.stat().st_mtime_ns) for p in folder.iterdir())
    assert main(["watch", str(folder)]) == 0
    out = capsys.readouterr().out
    assert len(out.splitlines()) == 1
    # 3 x 8 pixels, 3 x 2 x 3 shots, two dark readings before and after, two channels.
    samples = 2 * (3 * 8 + 3 * 2 * 3 + 2 * 2)
    assert f"finished, {samples} of {samples} samples (100%)" in out
    assert "signal/noise" in out
    # Watching leaves no trace.
    assert sorted((p.name, p.stat().st_mtime_ns) for p in folder.iterdir()) == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--polarization", "HH"], "the scan has no channel 'HH', only VV, VH"),
        (["--every", "0 s"], "--every: needed is a time above 0, found 0 s"),
        (["--every", "3 m"], "--every"),
    ],
)
def test_wrong_words_get_one_line(
    words: list[str], said: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(path.name for path in folder.iterdir())
    assert main(["watch", str(folder), *words]) == 2
    assert sorted(path.name for path in folder.iterdir()) == before
    captured = capsys.readouterr()
    assert said in captured.err
    assert captured.err.count("\n") == 1


def test_a_folder_without_a_scan_gets_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["watch", str(tmp_path)]) == 1
    assert "holds no journal" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("after", "name"),
    [([np.nan, np.nan], "range_before"), ([np.nan, 1.5], "range")],
)
def test_a_map_is_that_before_water_rejection_until_there_is_one(
    after: list[float], name: str
) -> None:
    live = cast(Live, SimpleNamespace(now=lambda *_: np.array(after)))
    assert terminal.map_name(live, "VH", "range") == name


def test_the_screen_is_drawn_anew_until_the_scan_is_finished(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    status = {"state": "running"}
    followed = SimpleNamespace(status=status, looks=0)
    drawn: list[object] = []

    def look() -> None:
        followed.looks += 1
        status["state"] = "finished" if followed.looks == 3 else "running"

    class Screen(contextlib.AbstractContextManager[Any]):
        def __init__(self, first: object, **options: object) -> None:
            drawn.append(first)

        def update(self, picture: object, *, refresh: bool) -> None:
            assert refresh
            drawn.append(picture)

        def __exit__(self, *error: object) -> None:
            return None

    followed.look = look
    monkeypatch.setattr(watch_module, "_POLL", 0.0)
    monkeypatch.setattr("rich.live.Live", Screen)
    monkeypatch.setattr(terminal, "screen", lambda live, **_: f"look {live.looks}")
    watch_module._on_screen(cast(Live, followed), "VV", "range", once=False)
    assert drawn == ["look 0", "look 1", "look 2", "look 3"]
