"""`amulor acquire`: settings of the acquisition, and words on its result."""

from __future__ import annotations

import io as streams
import json
import signal
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from amulor import acquisition, io, simulation
from amulor.acquisition import Outcome, Progress, Settings
from amulor.cli import acquire as commands
from amulor.cli import main
from amulor.survey import Survey

Named: Any = SimpleNamespace
#: The command that goes on with a scan.
RESUME = "amulor acquire scan/survey.toml -o scan --resume"


class Bench:
    """Acquisition that is not run, and cubes that are not written."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: list[Any] = []
        self.outcome: Outcome | BaseException = Outcome(
            finished=True, done=12, total=12, flagged=3, unsafe=[]
        )
        self.attributes: dict[str, str] = {}
        self.empty = False
        self.described: Any = Named(platform=None)
        monkeypatch.setattr(Survey, "from_toml", lambda path: self.described)
        monkeypatch.setattr(acquisition, "acquire", self.acquire)
        monkeypatch.setattr(acquisition, "recover", self.recover)
        monkeypatch.setattr(Settings, "from_toml", lambda path: f"settings {path}")
        calibration = acquisition.Calibration
        monkeypatch.setattr(calibration, "from_toml", lambda path: f"file {path}")
        monkeypatch.setattr(
            calibration, "from_text", lambda text, name: f"text {text} of {name}"
        )
        monkeypatch.setattr(io, "read_cube", self.read)
        monkeypatch.setattr(
            "amulor.acquisition.cube.build.shows_no_target", lambda cube: self.empty
        )

    def acquire(self, described: Any, output: Path, **more: Any) -> Outcome:
        assert described is self.described
        assert more.pop("scene") is simulation.scene_light
        for name in ("control", "progress"):
            assert callable(getattr(more[name], "go_on", more[name]))
            del more[name]
        self.calls.append((output, more))
        if isinstance(self.outcome, BaseException):
            raise self.outcome
        return self.outcome

    def recover(self, folder: Path, **more: Any) -> Path:
        told, damaged = more.pop("told"), more.pop("damaged", None)
        told("told")
        if damaged is not None:
            for line in self.attributes.get("damage", "").split():
                damaged(line)
        self.calls.append(("recover", folder, more))
        path: Path = more.get("output") or folder / "cube.nc"
        return path

    def read(self, path: Path) -> xr.Dataset:
        values = np.array([1.0, np.nan, np.nan, 2.0])
        return xr.Dataset({"in_phase": ("sample", values)}, attrs=self.attributes)


@pytest.fixture
def bench(here: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    """Return an acquisition in a temporary folder, without a terminal."""
    monkeypatch.setattr(sys, "stdin", streams.StringIO())
    return Bench(monkeypatch)


WORDS = ["acquire", "s.toml", "-o", "scan"]
PLAIN = {"resume": False, "retake_flagged": False, "ask": None, "shutter_closed": False}


def test_a_complete_scan_has_its_cube(bench: Bench, capsys) -> None:
    """By default devices are simulated, and nothing is calibrated or replaced."""
    assert main(WORDS) == 0
    (output, asked), recovered = bench.calls
    assert output == Path("scan")
    assert asked.pop("settings") == Settings()
    assert asked == PLAIN
    assert recovered == (
        "recover", Path("scan"), {"calibration": None, "overwrite": False}
    )  # fmt: skip
    text = capsys.readouterr()
    assert text.out == "scan/cube.nc: 12 samples, 3 flagged in this run\n"
    assert text.err == "amulor: told\n"


def test_a_scan_takes_devices_calibration_and_shutter(bench: Bench) -> None:
    """Options go to the acquisition and to the cube."""
    words = ["--devices", "d.toml", "--calibration", "c.toml", "--overwrite"]
    assert main([*WORDS, *words]) == 0
    (_, asked), (*_, recovered) = bench.calls
    assert asked["settings"] == "settings d.toml"
    assert recovered == {"calibration": "file c.toml", "overwrite": True}
    bench.calls.clear()
    assert main([*WORDS, "--shutter-closed"]) == 0
    assert bench.calls[0][1]["shutter_closed"] is True


def test_a_resumed_scan_keeps_devices_and_calibration(bench: Bench, here: Path) -> None:
    """Devices are those of the folder; the calibration is that of the first cube."""
    words = [*WORDS, "--resume", "--retake-flagged"]
    bench.attributes["calibration"] = "old"
    assert main(words) == 0
    (_, asked), (*_, recovered) = bench.calls
    assert asked.pop("settings") == Settings()
    assert asked == PLAIN | {"resume": True, "retake_flagged": True}
    assert recovered == {"calibration": None, "overwrite": True}
    (here / "scan").mkdir()
    for name in ("devices.toml", "cube.nc", "journal.sqlite"):
        (here / "scan" / name).touch()
    bench.calls.clear()
    assert main(words) == 0
    (_, asked), (*_, recovered) = bench.calls
    assert asked["settings"] == "settings scan/devices.toml"
    assert recovered["calibration"] == "text old of scan/cube.nc"
    bench.calls.clear()
    assert main([*words, "--devices", "d.toml", "--overwrite"]) == 0
    (_, asked), (*_, recovered) = bench.calls
    assert asked["settings"] == "settings d.toml"
    assert recovered["calibration"] is None
    # Without --resume, the devices of another scan are not those of this one.
    bench.calls.clear()
    assert main([*WORDS, "--overwrite"]) == 0
    assert bench.calls[0][1]["settings"] == Settings()


def test_a_cube_of_an_earlier_scan_is_kept(bench: Bench, here: Path, capsys) -> None:
    """A folder without a scan may hold a cube; it is looked at before the scan."""
    (here / "scan").mkdir()
    (here / "scan" / "cube.nc").touch()
    assert main(WORDS) == 1
    assert "cube.nc exists already" in capsys.readouterr().err
    assert bench.calls == []
    assert main([*WORDS, "--overwrite"]) == 0
    assert main([*WORDS, "--resume"]) == 0


def test_a_scan_without_a_target_says_so(bench: Bench, capsys) -> None:
    """With a closed shutter none is expected; the next command is another one."""
    bench.empty = True
    assert main(WORDS) == 0
    told, line = capsys.readouterr().err.splitlines()
    assert line == (
        "amulor: scan/cube.nc: no sample differs from the open-water shots by more "
        "than 5 standard errors: the target was not in the beam, its echo is too weak, "
        "or the driver of the lock-in does not read the instrument; 'amulor reject' "
        "will find no target"
    )
    bench.attributes["shutter"] = "closed"
    assert main(WORDS) == 0
    assert capsys.readouterr().err == f"{told}\n"


@pytest.mark.parametrize(("shutter", "following"), [
    ("open", "amulor reject scan/cube.nc --method auto -o target.nc"),
    ("closed", "amulor calibrate leakage scan/cube.nc -o leakage.toml"),
])  # fmt: skip
def test_the_next_command_is_that_of_the_shutter(
    bench: Bench, monkeypatch, shutter: str, following: str
) -> None:
    """A scan with a closed shutter is one of leakage."""
    printed: list[str] = []
    bench.attributes["shutter"] = shutter
    monkeypatch.setattr("amulor.cli._output.print_next", printed.append)
    assert main(WORDS) == 0
    assert printed == [following]


def test_a_scan_from_a_vehicle_has_a_trajectory(bench: Bench, here, capsys) -> None:
    """A survey with a platform has one if it was recorded."""
    bench.described = Named(platform="vehicle")
    assert main(WORDS) == 0
    assert "trajectory" not in capsys.readouterr().out
    (here / "scan").mkdir()
    (here / "scan" / "cube.trajectory.csv").touch()
    assert main(WORDS) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[1] == "scan/cube.trajectory.csv: for amulor export --trajectory"
    bench.described = Named(platform=None)
    assert main(WORDS) == 0
    assert "trajectory" not in capsys.readouterr().out


def test_a_scan_in_json_has_its_counts(bench: Bench, here, capsys) -> None:
    """Text is not printed, and a paused scan has no cube."""
    assert main([*WORDS, "--json"]) == 0
    counts = {"finished": True, "done": 12, "total": 12, "flagged": 3, "unsafe": []}
    content = json.loads(capsys.readouterr().out)
    assert content == counts | {"cube": "scan/cube.nc"}
    bench.outcome = Outcome(finished=False, done=5, total=12, flagged=1, unsafe=[])
    assert main([*WORDS, "--json"]) == 130
    content = json.loads(capsys.readouterr().out)
    assert content == counts | {"finished": False, "done": 5, "flagged": 1}


def test_a_paused_scan_names_the_command_that_goes_on(bench: Bench, capsys) -> None:
    """The exit code is that of an interrupt, or of devices that are not safe."""
    bench.outcome = Outcome(finished=False, done=5, total=12, flagged=1, unsafe=[])
    assert main(WORDS) == 130
    assert capsys.readouterr().out == f"scan: 5 of 12 samples; go on with: {RESUME}\n"
    bench.outcome = Outcome(
        finished=True, done=12, total=12, flagged=0, unsafe=["laser", "stage"]
    )
    assert main(WORDS) == 1
    assert capsys.readouterr().err.splitlines()[1:] == [
        "amulor: laser",
        "amulor: stage",
    ]


def test_an_interrupted_scan_names_what_is_unsafe(bench: Bench, here, capsys) -> None:
    """Without a journal there is nothing to go on with."""
    bench.outcome = KeyboardInterrupt()
    bench.outcome.add_note("the laser is on")
    assert main(WORDS) == 130
    end = ["amulor: the laser is on", "amulor: interrupted"]
    assert capsys.readouterr().err.splitlines() == end
    (here / "scan").mkdir()
    (here / "scan" / "journal.sqlite").touch()
    assert main(WORDS) == 130
    expected = [end[0], f"scan: go on with: {RESUME}", end[1]]
    assert capsys.readouterr().err.splitlines() == expected


def test_a_cube_of_a_journal_counts_missing_samples(bench: Bench, capsys) -> None:
    """Places of damage are named, and make an error at the end."""
    assert main(["recover", "scan"]) == 0
    assert capsys.readouterr().out == "scan/cube.nc: 2 samples missing\n"
    bench.attributes["damage"] = "one two"
    words = ["-o", "x.nc", "--calibration", "c.toml", "--overwrite"]
    assert main(["recover", "scan", *words]) == 1
    assert bench.calls == [
        ("recover", Path("scan"),
         {"output": None, "calibration": None, "overwrite": False}),
        ("recover", Path("scan"),
         {"output": Path("x.nc"), "calibration": "file c.toml", "overwrite": True}),
    ]  # fmt: skip
    text = capsys.readouterr()
    assert text.out == "x.nc: 2 samples missing\n"
    assert text.err.splitlines() == [
        "amulor: told", "amulor: one", "amulor: two",
        "amulor: scan: the journal is damaged at the places named above; the rest is "
        "in x.nc",
    ]  # fmt: skip
    assert main(["recover", "scan", "-o", "x.txt"]) == 2


def progress(**changes: Any) -> Progress:
    """Return the progress of a scan with two hours to go."""
    fields: dict[str, Any] = {
        "done": 5, "total": 9, "rate": 3.6, "left": 7384.6, "flagged": 7,
        "kind": "open_water",
    }  # fmt: skip
    return Progress(**(fields | changes))


def test_a_line_of_progress_has_hours_minutes_and_seconds() -> None:
    """7385 s are 2 h 3 min 5 s."""
    words = "open water, 4/s, 2:03:05 left, 7 flagged"
    assert commands.words(progress()) == words
    assert commands.words(progress(left=59.4)).split(", ")[2] == "0:00:59 left"
    assert commands.words(progress(left=59.6)).split(", ")[2] == "0:01:00 left"


class Bar:
    """Recorder of what a bar shows."""

    def __init__(self) -> None:
        self.calls: list[Any] = []

    def add_task(self, *words: Any, **more: Any) -> str:
        self.calls.append(("task", words, more))
        return "number"

    def update(self, task: str, **more: Any) -> None:
        self.calls.append((task, more))

    def start(self) -> None:
        self.calls.append("start")

    def stop(self) -> None:
        self.calls.append("stop")


def test_a_bar_shows_progress_ten_times_a_second(monkeypatch) -> None:
    """The end is shown at once."""
    now = [100.0]
    monkeypatch.setattr(commands.time, "monotonic", lambda: now[0])
    bar = Bar()
    screen = commands._Screen(bar)
    assert bar.calls == [("task", ("starting",), {"total": None})]
    for moment, done in (
        (100.0, 1),
        (100.09, 2),
        (100.11, 3),
        (100.12, 8),
        (100.13, 9),
    ):
        now[0] = moment
        screen.show(progress(done=done))
    words = {"total": 9, "description": commands.words(progress())}
    expected = [("number", {"completed": done} | words) for done in (1, 3, 9)]
    assert bar.calls[1:] == expected
    commands._Screen().show(progress())


def test_a_question_stops_the_bar_and_waits(monkeypatch, capsys) -> None:
    """The end of input is an interrupt; the bar goes on in any case."""
    bar = Bar()
    screen = commands._Screen(bar)
    seen: list[bool] = []
    monkeypatch.setattr("builtins.input", lambda: seen.append(screen.asking) or "yes")
    assert screen.ask("Go on? ") == "yes"
    assert capsys.readouterr() == ("", "Go on? ")
    assert (seen, screen.asking) == ([True], False)
    assert bar.calls[1:] == ["stop", "start"]
    screen.request("Close the shutter")
    assert capsys.readouterr().err == "Close the shutter; then press Enter. "

    def ended() -> str:
        raise EOFError

    monkeypatch.setattr("builtins.input", ended)
    with pytest.raises(KeyboardInterrupt):
        screen.ask("Go on? ")
    assert screen.asking is False
    assert bar.calls[-2:] == ["stop", "start"]


def interrupts(answer: str, *, terminal: bool, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return a handler of signals whose questions get an answer."""
    monkeypatch.setattr(sys, "stdin", Named(isatty=lambda: terminal))
    asked: list[str] = []
    screen: Any = Named(ask=lambda text: asked.append(text) or answer, asking=False)
    control = commands._Interrupts(screen)
    return control, asked


@pytest.mark.parametrize(
    ("answer", "goes_on"),
    [
        ("", True),
        ("y", True),
        (" YES ", True),
        ("n", False),
        ("no", False),
        ("q", False),
    ],
)
def test_a_paused_scan_goes_on_if_the_operator_says_so(
    monkeypatch, answer: str, goes_on: bool
) -> None:
    """Without a terminal, nobody can say so."""
    control, asked = interrupts(answer, terminal=True, monkeypatch=monkeypatch)
    assert control.pause_wanted() is False
    control._want(signal.SIGINT, None)
    assert control.pause_wanted() is True
    assert control.go_on() is goes_on
    assert control.pause_wanted() is False
    assert asked == ["Paused: laser off, stage stopped. Go on with the scan? [Y/n] "]
    control, asked = interrupts("y", terminal=False, monkeypatch=monkeypatch)
    assert control.go_on() is False
    assert asked == []


@pytest.mark.parametrize("how", ["second", "asking", "end"])
def test_a_second_signal_ends_a_scan(monkeypatch, how: str, capfd) -> None:
    """Further ones are ignored while the devices are made safe."""
    control, asked = interrupts("y", terminal=True, monkeypatch=monkeypatch)
    if how == "second":
        control._want(signal.SIGINT, None)
    control._screen.asking = how == "asking"
    ended = control._end if how == "end" else control._want
    with pytest.raises(KeyboardInterrupt):
        ended(signal.SIGINT, None)
    assert control.pause_wanted() is True
    assert control.go_on() is False
    assert asked == []
    control._want(signal.SIGINT, None)
    control._end(signal.SIGTERM, None)
    assert capfd.readouterr().err == "\namulor: devices are being made safe\n" * 2


def test_signals_of_a_scan_are_handled_until_its_end(monkeypatch) -> None:
    """Ignored signals stay so, except a termination."""
    names = ("SIGINT", "SIGTSTP", "SIGTERM", "SIGHUP", "SIGQUIT")
    numbers = [getattr(signal, name) for name in names]
    before = {number: signal.getsignal(number) for number in numbers}
    control, _ = interrupts("", terminal=False, monkeypatch=monkeypatch)
    try:
        for number in numbers[1:4]:
            signal.signal(number, signal.SIG_IGN)
        signal.signal(signal.SIGQUIT, signal.SIG_DFL)
        with control:
            handlers = [signal.getsignal(number) for number in numbers]
        after = [signal.getsignal(number) for number in numbers[1:]]
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    ignored = signal.SIG_IGN
    assert handlers == [control._want, ignored, control._end, ignored, control._end]
    assert after == [ignored, ignored, ignored, signal.SIG_DFL]


def test_a_scan_has_a_bar_on_a_terminal_only(monkeypatch) -> None:
    """JSON is for programs, which see no bar."""
    with commands._live(quiet=False) as screen:
        assert screen._bar is None
    monkeypatch.setattr(sys, "stderr", Named(isatty=lambda: True, write=lambda _: 0))
    with commands._live(quiet=True) as screen:
        assert screen._bar is None
