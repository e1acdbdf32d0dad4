"""Scans by the command line: the whole chain, wrong inputs, Ctrl-C, terminations."""

from __future__ import annotations

import builtins
import json
import re
import shlex
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from shared_light import scene_light

from amulor import acquisition, io
from amulor.acquisition import plan
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.rehearsal import rehearse
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Settings
from amulor.cli import acquire, main
from amulor.survey import Survey
from amulor.view.page.live import Live

#: Embedded devices that take their time, so that a scan can be caught in the middle.
PACED = "[procedure]\ndark_readings = 2\n[simulation]\nspeed = 10\n"
WRONG_USE = (
    ("acquire tank.toml -o new --retake-flagged", "--resume"),
    ("devices simulate tank.toml -o d.toml --speed 0", "speed must be above 0"),
    ("devices simulate tank.toml -o d.toml --stage-port 70000", "ports must be"),
    ("devices simulate tank.toml -o d.toml --fault fire@3", "--fault fire@3: "),
    ("calibrate plate scan/cube.nc --distance 1500 -o c.toml", "without a unit"),
)


@pytest.fixture
def here(survey: Survey, folder: Path, monkeypatch) -> Path:
    """Return the working folder, with a survey file in it."""
    (folder / "tank.toml").write_text(survey.to_toml())
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.slow
def test_the_commands_take_a_scan_to_a_point_cloud(here, capsys) -> None:
    for words in (
        "acquire tank.toml -o scan",
        "recover scan -o again.nc",
        "reject scan/cube.nc --method open-water -o target.nc",
        "image target.nc --polarization VH -o range.nc",
        "export range.nc -o cloud.ply",
        "devices calibrate target.nc --distance 1.5m -o calibration.toml",
        "recover scan --calibration calibration.toml -o calibrated.nc",
    ):
        assert main(words.split()) == 0, words
    printed = capsys.readouterr().out
    assert "samples, " in printed
    assert re.search(r"39 MHz [^\n]* [+-]0\.0", printed)
    first, second = (io.read_cube(here / name) for name in ("scan/cube.nc", "again.nc"))
    np.testing.assert_array_equal(first["in_phase"], second["in_phase"])


def test_mistakes_of_a_command_get_one_line(here, capsys) -> None:
    assert main(["acquire", "tank.toml", "-o", "scan", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["finished"]
    shutil.copytree("scan", "old")
    other = Survey.from_toml("tank.toml").with_({"targets.0.reflectance": 0.2})
    Path("other.toml").write_text(other.to_toml())
    Path("slow.toml").write_text("[procedure]\nsettling = 6.0\n")
    Path("odd.toml").write_text("[lock_in]\ntimout = 1\n")
    devices = (
        '[lock_in]\ndriver = "sr844"\naddress = "tcp://127.0.0.1:1"\n'
        '[scanner]\ndriver = "pi_gcs"\naddress = "tcp://127.0.0.1:1"\n'
        '[launch]\ndriver = "none"\n[analyser]\ndriver = "none"\n'
        '[laser]\ndriver = "lock_in_output"\n[target]\ndriver = '
    )
    Path("by-hand.toml").write_text(f'{devices}"operator"\n')
    Path("far.toml").write_text(f'{devices}"pi_gcs"\naddress = "tcp://127.0.0.1:1"\n')
    for words, message in (
        (
            "acquire tank.toml -o scan",
            "holds a scan already; go on with it by --resume",
        ),
        ("acquire tank.toml -o typo --resume", "leave out --resume to begin one"),
        ("acquire tank.toml -o no/where", "inside one that exists"),
        ("acquire tank.toml -o tank.toml", "cannot be made"),
        ("acquire other.toml -o scan --resume", "another survey"),
        ("acquire tank.toml -o scan --resume --devices slow.toml", "what it is told"),
        ("acquire tank.toml -o new --devices odd.toml", "did you mean 'timeout'"),
        ("acquire tank.toml -o new --devices far.toml", "check address, cable"),
        ("acquire tank.toml -o new --devices by-hand.toml", "this is no terminal"),
        ("acquire tank.toml -o new --devices none.toml", "cannot be read"),
        ("recover scan", "exists already"),
        ("recover .", "holds no journal"),
        *WRONG_USE,
    ):
        code = 2 if (words, message) in WRONG_USE else 1
        assert main(words.split()) == code, words
        printed = capsys.readouterr().err
        assert message in printed
        assert printed.count("\n") == 1
    assert not any(Path(name).exists() for name in ("typo", "d.toml", "c.toml"))
    for name in ("cube.nc", FILE_NAME):
        assert Path("scan", name).read_bytes() == Path("old", name).read_bytes()


def test_recovering_a_damaged_journal_ends_with_1_and_the_rest(here, capsys) -> None:
    assert main(["acquire", "tank.toml", "-o", "scan"]) == 0
    connection = sqlite3.connect(Path("scan", FILE_NAME), isolation_level=None)
    connection.execute("UPDATE samples SET in_phase = 7.0 WHERE number IN (90, 92)")
    connection.close()
    capsys.readouterr()
    assert main(["recover", "scan", "-o", "rest.nc"]) == 1
    told = capsys.readouterr()
    lines = told.err.splitlines()
    assert [line.split(": ")[2] for line in lines[:2]] == ["row 90", "row 92"]
    assert "damaged at the places named above" in lines[2]
    assert len(lines) == 3
    whole, rest = (io.read_cube(name) for name in ("scan/cube.nc", "rest.nc"))
    assert "2 samples missing" in told.out
    kept = rest["in_phase"].notnull()
    assert kept.size - int(kept.sum()) == 2
    np.testing.assert_array_equal(
        rest["in_phase"].values[kept], whole["in_phase"].values[kept]
    )


def built(folder: Path) -> xr.Dataset:
    """Return the cube of a journal without its file, which takes longer."""
    with Journal.read(folder) as journal:
        return acquisition.build(journal)


@pytest.mark.slow
def test_a_resumed_command_takes_the_devices_of_the_scan(here, capsys) -> None:
    Path("mine.toml").write_text(
        '[procedure]\nsettling = 6.0\n[simulation]\nfaults = ["saturation@80x3"]\n'
    )
    assert main(["acquire", "tank.toml", "-o", "scan", "--devices", "mine.toml"]) == 0
    assert main(["acquire", "scan/survey.toml", "-o", "scan", "--resume"]) == 0
    cube = built(Path("scan"))
    assert int(cube["saturated"].sum()) == 3
    # Somebody has mended it: the same devices, but for the fault.
    Path("mended.toml").write_text("[procedure]\nsettling = 6.0\n")
    words = "acquire tank.toml -o scan --devices mended.toml --resume --retake-flagged"
    assert main(words.split()) == 0
    capsys.readouterr()
    cube = built(Path("scan"))
    assert not cube["saturated"].any()
    assert int((cube["user_takes"] == 2).sum()) == 3
    assert not (cube["user_sample_flag"].values & SampleFlag.OVERLOAD).any()


@pytest.mark.slow
def test_a_resumed_command_keeps_the_calibration_of_the_cube(here, capsys) -> None:
    Path("calibration.toml").write_text(
        "[[frequencies]]\nmodulation_frequency = '39 MHz'\n"
        "amplitudes = ['1 mV']\nphases = ['0.2 rad']\n"
    )
    for words in (
        "acquire tank.toml -o scan",
        "recover scan --calibration calibration.toml --overwrite",
        "acquire tank.toml -o scan --resume",
    ):
        assert main(words.split()) == 0, words
    calibrated = io.read_cube("scan/cube.nc")
    assert "0.2 rad" in calibrated.attrs["calibration"]
    assert main(["acquire", "tank.toml", "-o", "scan", "--resume", "--overwrite"]) == 0
    plain = io.read_cube("scan/cube.nc")
    assert "calibration" not in plain.attrs
    turned = np.exp(-0.2j) * (plain["in_phase"] + 1j * plain["quadrature"])
    np.testing.assert_allclose(calibrated["in_phase"], turned.real)
    capsys.readouterr()


def test_a_laser_that_stays_on_is_no_success(here, capsys, monkeypatch) -> None:
    outcome = acquisition.Outcome(
        finished=False, done=3, total=9, flagged=0, unsafe=["laser could not be made"]
    )
    monkeypatch.setattr(acquisition, "acquire", lambda *_, **__: outcome)
    assert main(["acquire", "tank.toml", "-o", "scan"]) == 1
    assert capsys.readouterr().err == "amulor: laser could not be made\n"


def test_what_is_unsafe_after_ctrl_c_is_shown(here, capsys, monkeypatch) -> None:
    def interrupted(*_, **__):
        error = KeyboardInterrupt()
        error.add_note("laser could not be made safe")
        raise error

    monkeypatch.setattr(acquisition, "acquire", interrupted)
    assert main(["acquire", "tank.toml", "-o", "scan"]) == 130
    assert "amulor: laser could not be made safe\n" in capsys.readouterr().err


# -- signals ---------------------------------------------------------------------------


def press(*names: str) -> None:
    """Send signals to this program, those that there are here, each heard at once."""
    for name in names:
        if hasattr(signal, name):
            signal.raise_signal(getattr(signal, name))


def test_devices_are_made_safe_however_often_ctrl_c_is_pressed() -> None:
    safe: list[bool] = []
    before = {number: signal.getsignal(number) for number in range(1, 16)}

    def scan() -> None:
        with acquire._Interrupts(acquire._Screen()):
            try:
                press("SIGINT", "SIGINT")  # the second one ends the scan at once
                pytest.fail("the scan goes on")
            finally:
                press("SIGINT", "SIGTERM", "SIGHUP", "SIGTSTP", "SIGQUIT", "SIGINT")
                safe.append(True)

    with pytest.raises(KeyboardInterrupt):
        scan()
    assert safe
    assert before == {number: signal.getsignal(number) for number in range(1, 16)}


@pytest.mark.parametrize("name", ["SIGINT", "SIGTSTP"])
def test_ctrl_c_and_ctrl_z_ask_first(name) -> None:
    if not hasattr(signal, name):
        pytest.skip("there is no such signal here")
    with acquire._Interrupts(acquire._Screen()) as control:
        assert not control.pause_wanted()
        press(name)
        assert control.pause_wanted()
        assert not control.go_on()  # nobody is there to be asked
        assert not control.pause_wanted()


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGQUIT"])
def test_other_signals_end_at_once(name) -> None:
    if not hasattr(signal, name):
        pytest.skip("there is no such signal here")

    def scan() -> None:
        with acquire._Interrupts(acquire._Screen()):
            press(name)
            pytest.fail("the scan goes on")

    with pytest.raises(KeyboardInterrupt):
        scan()


@pytest.mark.parametrize("name", ["SIGHUP", "SIGINT", "SIGTERM"])
def test_what_a_program_was_started_to_ignore_ends_no_scan(name) -> None:
    # As nohup does with a terminal that is closed, and a script with Ctrl-C.
    if not hasattr(signal, name):
        pytest.skip("there is no such signal here")
    number = getattr(signal, name)
    before = signal.signal(number, signal.SIG_IGN)
    try:
        ended = False
        with acquire._Interrupts(acquire._Screen()) as control:
            try:
                press(name)
            except KeyboardInterrupt:
                ended = True
            assert control.pause_wanted() is ended
        # What is to end it does so all the same.
        assert ended is (name == "SIGTERM")
        assert signal.getsignal(number) is signal.SIG_IGN
    finally:
        signal.signal(number, before)


def test_the_end_of_the_input_is_no_answer(monkeypatch, capsys) -> None:
    def ended() -> str:
        raise EOFError

    monkeypatch.setattr(builtins, "input", ended)
    screen = acquire._Screen()
    with pytest.raises(KeyboardInterrupt):
        screen.ask("Go on? ")
    assert not screen.asking
    # A question is seen where the outcome goes to a file.
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == ("", "Go on? ")


def begun(folder: Path, *, samples: int) -> Callable[[], bool]:
    """Return what tells whether a scan has so many samples."""

    def reached() -> bool:
        if not (folder / FILE_NAME).exists():
            return False
        with Journal.read(folder) as journal:
            return journal.count() >= samples

    return reached


def test_a_termination_leaves_the_laser_off_and_a_folder_that_resumes(
    here, survey
) -> None:
    base = Settings.model_validate({"procedure": {"dark_readings": 2}})
    reached, ended = begun(here / "scan", samples=80), threading.Event()
    with rehearse(survey, base, speed=20, scene=scene_light) as rehearsal:
        answer = rehearsal.lock_in.answer

        def slowly(line: str) -> Sequence[str | bytes]:
            # From then on the scan does not run away from the one who is to end it.
            if not ended.is_set() and reached():
                ended.wait(0.5)
            return answer(line)

        rehearsal.lock_in.answer = slowly  # type: ignore[method-assign]
        Path("devices.toml").write_text(rehearsal.settings.to_toml())
        words = [
            "acquire",
            "tank.toml",
            "-o",
            "scan",
            "--devices",
            "devices.toml",
            "--json",
        ]
        running = subprocess.Popen(
            [sys.executable, "-m", "amulor", *words],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        )  # fmt: skip
        deadline = time.monotonic() + 240
        while not reached():
            assert running.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        assert rehearsal.bench.laser_on
        running.send_signal(signal.SIGTERM)
        ended.set()
        _, errors = running.communicate(timeout=240)
        assert running.returncode == 130, errors
        assert not rehearsal.bench.laser_on
        assert "HLT" in rehearsal.stages.lines[-12:]
        assert b"Traceback" not in errors
        assert b"go on with: amulor acquire scan/survey.toml -o scan --resume" in errors
        with Journal.read(here / "scan") as found:
            assert found.segments()[-1]["reason"] == "interrupted by KeyboardInterrupt"
            assert found.count() >= 80
        assert main(["acquire", "scan/survey.toml", "-o", "scan", "--resume"]) == 0


@pytest.mark.slow
def test_who_watches_a_scan_that_was_killed_is_given_the_command_that_resumes_it(
    here, sized, capsys
) -> None:
    Path("tank.toml").write_text(sized(columns=12, rows=6).to_toml())
    Path("paced.toml").write_text(PACED)
    words = ["acquire", "tank.toml", "-o", "scan", "--devices", "paced.toml"]
    running = subprocess.Popen([sys.executable, "-m", "amulor", *words, "--json"])
    deadline = time.monotonic() + 240
    try:
        reached = begun(here / "scan", samples=80)
        while not reached():
            assert running.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
        # Halted, so that it does not end before it is looked at.
        if hasattr(signal, "SIGSTOP"):
            running.send_signal(signal.SIGSTOP)
        live = Live(Path("scan"))
        live.look()
        assert live.status["state"] == "running"
    finally:
        running.kill()
        running.wait()
    live.look()
    command = live.status["resume"]
    assert live.status["state"] == "stopped"
    assert live.status["left"] is live.status["rate"] is None
    assert command == "amulor acquire scan/survey.toml -o scan --resume"
    assert main(["watch", "scan", "--once"]) == 0
    out = capsys.readouterr().out
    assert "stopped, " in out
    assert f"note: stopped (without notice) at {live.status['done']} of " in out
    assert f"; resume with: {command}\n" in out
    # Word for word as in a shell.
    assert main(shlex.split(command)[1:]) == 0
    live.look()
    live.stop()
    assert live.status["state"] == "finished"
    assert live.status["resume"] is None
    assert live.status["done"] == live.status["total"]
    assert not any("stopped" in one for one in live.status["advice"])


@pytest.mark.slow
def test_ctrl_c_asks_and_the_scan_goes_on_or_ends_and_is_resumed(
    here, sized, terminal, capsys
) -> None:
    # Long enough not to end by itself while somebody is slow to press a key.
    survey = sized(columns=24, rows=10)
    Path("tank.toml").write_text(survey.to_toml())
    Path("paced.toml").write_text(PACED)
    Path("fast.toml").write_text(PACED.partition("[simulation]")[0])
    words = ["acquire", "tank.toml", "-o", "scan", "--devices", "paced.toml"]
    running = subprocess.Popen(
        [sys.executable, "-m", "amulor", *words], stdin=terminal.near,
        stdout=terminal.near, stderr=terminal.near, start_new_session=True,
    )  # fmt: skip
    terminal.begun()
    try:
        terminal.read_until(begun(here / "scan", samples=80))
        running.send_signal(signal.SIGINT)
        terminal.wait_for(b"Go on with the scan? [Y/n]")
        terminal.type(b"y\n")
        with Journal.read(here / "scan") as journal:
            first = journal.count()
        # Past the reference that is taken once more.
        terminal.read_until(begun(here / "scan", samples=first + 36))
        running.send_signal(signal.SIGINT)
        terminal.wait_for(b"Go on with the scan? [Y/n]")
        terminal.type(b"n\n")
        terminal.wait_for(b"--resume")
        assert running.wait(timeout=240) == 130
    finally:
        running.kill()
        running.wait()
    for words in (
        b"/s, ",
        b" left, ",
        b"flagged",
        b"Paused: laser off, stage stopped.",
    ):
        assert words in terminal.text
    words = ["scan/survey.toml", "-o", "scan", "--resume", "--devices", "fast.toml"]
    assert main(["acquire", *words]) == 0
    capsys.readouterr()
    procedure = Settings.from_toml("paced.toml").procedure
    planned = {step.key for step in plan.steps(survey, procedure)}
    extra = {
        step.key
        for number in range(2)
        for step in plan.extra_reference(survey, procedure, number=number)
    }
    with Journal.read(here / "scan") as journal:
        reasons = [part["reason"] for part in journal.segments()]
        assert reasons == ["paused", "paused", "finished"]
        assert journal.keys() == planned | extra
        assert journal.count() == len(planned) + len(extra)
    cube = io.read_cube("scan/cube.nc")
    assert {*cube["user_segment"].values.ravel()} == {1, 2, 3}
    assert sum(key.kind == SCAN for key in planned) == cube["in_phase"].size
