"""Scans end to end: over the network, killed, on a full disk, by the command line."""

from __future__ import annotations

import json
import os
import random
import resource
import select
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from amulor import acquisition, imaging, io, rejection
from amulor.acquisition import plan
from amulor.acquisition.journal import FILE_NAME, Journal
from amulor.acquisition.plan import SCAN, Key
from amulor.acquisition.rehearsal import rehearse
from amulor.acquisition.settings import Settings
from amulor.cli import main
from amulor.cube import UNUSABLE
from amulor.errors import AmulorError, InstrumentError
from amulor.simulation import simulate
from amulor.survey import Survey

FEW = Settings.model_validate({"procedure": {"dark_readings": 2}})


@pytest.fixture
def folder() -> Iterator[Path]:
    """Return a folder in memory where there is one: disks differ, promises do not."""
    memory = Path("/dev/shm")
    place = tempfile.mkdtemp(dir=memory if memory.is_dir() else None)
    yield Path(place)
    shutil.rmtree(place)


def sized(plate_text: str, *, columns: int, rows: int, shots: int = 2) -> str:
    """Return the survey of the plate with other sizes and one reading a sample."""
    return (
        plate_text.replace("columns = 12", f"columns = {columns}")
        .replace("rows = 6", f"rows = {rows}")
        .replace('dwell = "125 ms"', 'dwell = "50 ms"')
        .replace("repeats = 8", f"repeats = {shots}")
    )


@pytest.fixture
def text(plate_text: str) -> str:
    """Return a survey file of 8 x 4 pixels in two polarizations."""
    return sized(plate_text, columns=8, rows=4)


@pytest.fixture
def survey(text: str) -> Survey:
    """Return that survey."""
    return Survey.from_text(text)


@pytest.fixture
def tiny(plate_text: str) -> Survey:
    """Return a survey of 4 x 2 pixels."""
    return Survey.from_text(sized(plate_text, columns=4, rows=2, shots=1))


def ranges(cube) -> np.ndarray:
    """Return the slant ranges of a cube, as the commands make them."""
    image = imaging.range_image(rejection.open_water(cube).sel(polarization=["VH"]))
    assert not (image["quality_flag"].values & UNUSABLE).any()
    return image["slant_range"].values


# -- the same cube as the simulation ---------------------------------------------------


def test_an_acquired_cube_is_the_simulated_one_within_noise(plate, folder) -> None:
    acquisition.acquire(plate, folder)
    acquired = io.read_cube(acquisition.recover(folder))
    ideal = simulate(plate, rng=2)
    for name, coordinate in ideal.coords.items():
        assert acquired[name].shape == coordinate.shape
    for name in ("in_phase_uncertainty", "quadrature_uncertainty"):
        # The variance follows from the noisy mean output here, from truth there.
        np.testing.assert_allclose(acquired[name], ideal[name], rtol=0.15)
    difference = ranges(acquired) - ideal["truth_slant_range"].values
    # Noise of a pixel is 1.8 mm; the mean of 72 shares the error of the reference.
    assert abs(difference.mean()) < 2e-3
    assert 1e-3 < difference.std() < 3e-3
    assert acquired.attrs["simulated"] == 1


@pytest.mark.parametrize("model", ["sr844", "sr865a"])
def test_a_scan_over_the_network_gives_the_same_ranges(text, folder, model) -> None:
    if model == "sr865a":  # it ends at 4 MHz
        text = text.replace('"39 MHz"', '"3.9 MHz"')
    survey = Survey.from_text(text)
    with rehearse(survey, FEW, model=model, speed=500) as rehearsal:
        outcome = acquisition.acquire(survey, folder, settings=rehearsal.settings)
        assert outcome.finished
        assert not rehearsal.bench.laser_on
        word = {"sr844": "AUXO", "sr865a": "AUXV"}[model]
        gates = [line for line in rehearsal.lock_in.lines if line.startswith(word)]
        assert gates[-1] == f"{word} 1,0.000;{word}? 1"
        assert "STP" in rehearsal.stages.lines[-6:]
    cube = io.read_cube(acquisition.recover(folder))
    assert model.upper() in cube.attrs["source"]
    assert cube.attrs["simulated"] == 1
    image = imaging.range_image(rejection.open_water(cube).sel(polarization=["VH"]))
    error = image["slant_range"] / simulate(survey, rng=1)["truth_slant_range"] - 1
    # A tenth of the frequency is ten times the range error of 2 mm.
    assert float(np.abs(error).mean()) < (0.003 if model == "sr844" else 0.03)


def test_the_same_scan_goes_over_pyvisa(survey, folder) -> None:
    pytest.importorskip("pyvisa_py", reason="PyVISA-py is not installed")
    with rehearse(survey, FEW, speed=1000) as rehearsal:
        content = rehearsal.settings.model_dump(exclude_unset=True)
        for part in content.values():
            if part.get("address"):
                host, port = part["address"].removeprefix("tcp://").split(":")
                part["address"] = f"TCPIP::{host}::{port}::SOCKET"
        settings = Settings.model_validate(content)
        assert acquisition.acquire(survey, folder, settings=settings).finished
    assert ranges(io.read_cube(acquisition.recover(folder))).shape == (4, 8)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("lost-link@40", "closed the link|has not answered"),
        ("timeout@40", "has not answered"),
        ("unlock@40x99", "lost its reference"),
        ("overload@40x999", "in a row are overloaded"),
        ("stuck@40x999", "not on target"),
    ],
)
def test_faults_over_the_network_leave_the_laser_off(
    tiny, folder, fault, message
) -> None:
    base = Settings.model_validate(
        {
            "lock_in": {"timeout": 0.3},
            "scanner": {"timeout": 0.3, "move_timeout": 1.0},
            "procedure": {"dark_readings": 2, "patience": 3},
            "simulation": {"faults": [fault]},
        }
    )
    with rehearse(tiny, base, speed=1000) as rehearsal:
        with pytest.raises(InstrumentError, match=message) as caught:
            acquisition.acquire(tiny, folder, settings=rehearsal.settings)
        assert not rehearsal.bench.laser_on
        gates = [line for line in rehearsal.lock_in.lines if line.startswith("AUXO")]
        assert gates[-1] == "AUXO 1,0.000;AUXO? 1"
        assert "STP" in rehearsal.stages.lines[-12:]
    assert "--resume" in str(caught.value)


def test_a_scan_over_a_lost_link_is_gone_on_with(tiny, folder) -> None:
    lost = Settings.model_validate(
        {"procedure": {"dark_readings": 2}, "simulation": {"faults": ["lost-link@42"]}}
    )
    with rehearse(tiny, lost, speed=1000) as first, pytest.raises(InstrumentError):
        acquisition.acquire(tiny, folder, settings=first.settings)
    # Mended: another port, no fault, the same instrument.
    with rehearse(tiny, FEW, speed=1000) as second:
        settings = second.settings
        assert acquisition.acquire(
            tiny, folder, settings=settings, resume=True
        ).finished
    cube = io.read_cube(acquisition.recover(folder))
    assert {*cube["user_segment"].values.ravel()} == {1, 2}
    assert len(json.loads(cube.attrs["segments"])) == 2


# -- killed ----------------------------------------------------------------------------


def _child(survey: Survey, folder: Path, told: int) -> None:
    """Scan in a process of its own and tell each acknowledged sample."""
    numbers = {step.key: n for n, step in enumerate(plan.steps(survey, FEW.procedure))}

    def tell(key: Key) -> None:
        os.write(told, struct.pack("i", numbers.get(key, -1)))

    acquisition.acquire(
        survey, folder, settings=FEW, resume=(folder / FILE_NAME).exists(),
        acknowledged=tell,
    )  # fmt: skip


def _killed(
    survey: Survey, folder: Path, after: float, *, begun: bool
) -> tuple[list[int], bool]:
    """Return the samples that a scan acknowledged before it was killed.

    The time counts from the first acknowledged sample if `begun`, else from the start.
    """
    told, told_in = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            _child(survey, folder, told_in)
            code = 0
        finally:
            os._exit(code)
    os.close(told_in)
    if begun:
        select.select([told], [], [])
    time.sleep(after)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    with os.fdopen(told, "rb") as end:
        content = end.read()
    numbers = [n for (n,) in struct.iter_unpack("i", content[: len(content) // 4 * 4])]
    ended = os.WIFEXITED(status)
    assert not ended or os.WEXITSTATUS(status) == 0
    return numbers, not ended


def _kill_loop(survey: Survey, home: Path, kills: int) -> dict[str, int]:
    rng = random.Random(7)
    planned = [step.key for step in plan.steps(survey, FEW.procedure)]
    for name in ("first", "whole"):  # the first one loads compiled code, too
        start = time.monotonic()
        acquisition.acquire(survey, home / name, settings=FEW)
        whole = time.monotonic() - start
    counts = {"kills": 0, "acknowledged": 0, "folders": 0, "lost": 0, "twice": 0}
    while counts["kills"] < kills:
        folder = home / str(counts["folders"])
        counts["folders"] += 1
        acknowledged: list[int] = []
        while counts["kills"] < kills:
            numbers, was_killed = _killed(
                survey, folder, rng.uniform(0, whole), begun=rng.random() < 0.75
            )
            counts["kills"] += was_killed
            acknowledged += [number for number in numbers if number >= 0]
            counts["acknowledged"] += len(numbers)
            if (folder / FILE_NAME).exists():
                with Journal.read(folder) as journal:
                    keys = journal.keys()
                    counts["twice"] += journal.count() - len(keys)
                counts["lost"] += sum(planned[n] not in keys for n in acknowledged)
            if not was_killed:
                break
        counts["twice"] += len(acknowledged) - len({*acknowledged})
        resume = (folder / FILE_NAME).exists()
        outcome = acquisition.acquire(survey, folder, settings=FEW, resume=resume)
        assert outcome.finished
        with Journal.read(folder) as journal:
            keys = journal.keys()
        assert {*planned} <= keys
        # None invented: what is more are references after breaks.
        assert not any(key.kind == SCAN for key in keys - {*planned})
        with Journal.read(folder) as journal:
            cube = acquisition.build(journal)
        assert np.isfinite(cube["in_phase"]).all()
        shutil.rmtree(folder)
    return counts


needs_fork = pytest.mark.skipif(
    not hasattr(os, "fork"), reason="SIGKILL and fork are needed"
)


@needs_fork
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_ten_kills_lose_no_acknowledged_sample(tiny, folder) -> None:
    counts = _kill_loop(tiny, folder, 10)
    assert (counts["lost"], counts["twice"]) == (0, 0)
    assert counts["acknowledged"] > 50


@needs_fork
@pytest.mark.study
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_two_hundred_kills_lose_no_acknowledged_sample(tiny, folder) -> None:
    counts = _kill_loop(tiny, folder, 200)
    print(counts)
    assert counts["kills"] == 200
    assert (counts["lost"], counts["twice"]) == (0, 0)
    assert counts["acknowledged"] > 2000


# -- a full disk -----------------------------------------------------------------------


@contextmanager
def _largest_file(size: int) -> Iterator[None]:
    """Let no file grow beyond a size, as a full disk would not."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_ends_a_scan_with_all_acknowledged_kept(survey, folder) -> None:
    told: list[Key] = []
    place = folder / "scan"
    with (
        _largest_file(300_000),
        pytest.raises(AmulorError, match=r"free some space.*--resume"),
    ):
        acquisition.acquire(survey, place, settings=FEW, acknowledged=told.append)
    assert len(told) > 10
    with Journal.read(place) as journal:
        assert journal.keys() == {*told}
    assert acquisition.acquire(survey, place, settings=FEW, resume=True).finished
    acquisition.recover(place)


def _mount(place: Path) -> bool:
    place.mkdir()
    if os.geteuid() != 0 or shutil.which("mount") is None:
        return False
    words = ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", str(place)]
    return subprocess.run(words, capture_output=True, check=False).returncode == 0


def test_a_small_file_system_fills_up_and_the_scan_goes_on_elsewhere(
    survey, folder
) -> None:
    place = folder / "small"
    if not _mount(place):
        pytest.skip("a file system of its own needs the right to mount one")
    told: list[Key] = []
    try:
        scan = place / "scan"
        with pytest.raises(AmulorError, match="free some space"):
            acquisition.acquire(survey, scan, settings=FEW, acknowledged=told.append)
        assert len(told) > 10
        # Somebody moves the folder to a disk with room.
        shutil.copytree(scan, folder / "moved")
    finally:
        subprocess.run(["umount", str(place)], check=True)
    with Journal.read(folder / "moved") as journal:
        assert journal.keys() >= {*told}
    again = acquisition.acquire(survey, folder / "moved", settings=FEW, resume=True)
    assert again.finished


# -- the command line ------------------------------------------------------------------


def test_the_commands_take_a_scan_to_a_point_cloud(
    text, folder, capsys, monkeypatch
) -> None:
    (folder / "tank.toml").write_text(text)
    monkeypatch.chdir(folder)
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
    assert "39 MHz: +0.0" in printed or "39 MHz: -0.0" in printed
    first, second = (
        io.read_cube(folder / name) for name in ("scan/cube.nc", "again.nc")
    )
    np.testing.assert_array_equal(first["in_phase"], second["in_phase"])


def test_a_termination_leaves_a_folder_that_resumes(plate_text, folder) -> None:
    # Large enough that it is still going on when it is told to end.
    (folder / "tank.toml").write_text(sized(plate_text, columns=100, rows=40))
    words = [sys.executable, "-m", "amulor", "acquire", str(folder / "tank.toml")]
    words += ["-o", str(folder / "scan"), "--json"]
    running = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    journal = folder / "scan" / FILE_NAME
    deadline = time.monotonic() + 60
    while not _count(journal.parent) > 200:
        assert running.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.05)
    running.send_signal(signal.SIGTERM)
    _, errors = running.communicate(timeout=60)
    assert running.returncode == 130, errors
    assert b"Traceback" not in errors
    with Journal.read(journal.parent) as found:
        assert found.segments()[-1]["reason"] == "interrupted by KeyboardInterrupt"
        assert found.count() > 200


def _count(folder: Path) -> int:
    if not (folder / FILE_NAME).exists():
        return 0
    with Journal.read(folder) as journal:
        return journal.count()


def test_mistakes_of_a_command_get_one_line(text, folder, capsys) -> None:
    (folder / "tank.toml").write_text(text)
    tank, scan = str(folder / "tank.toml"), str(folder / "scan")
    assert main(["acquire", tank, "-o", scan, "--resume"]) == 1
    assert main(["acquire", tank, "-o", scan, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["finished"]
    for words, message in (
        (["acquire", tank, "-o", scan], "holds a scan already"),
        (["recover", scan], "exists already"),
        (["recover", str(folder)], "holds no journal"),
        (["acquire", tank, "-o", scan, "--devices", tank], "lock_in"),
    ):
        assert main(words) == 1
        printed = capsys.readouterr().err
        assert message in printed or words[-1] == tank
        assert "Traceback" not in printed
    assert main(["acquire", tank, "-o", scan, "--resume", "--json"]) == 0


@pytest.mark.skipif(sys.platform == "win32", reason="a terminal of another kind")
def test_ctrl_c_asks_and_the_scan_goes_on_or_ends(plate_text, folder) -> None:
    import pty

    (folder / "tank.toml").write_text(sized(plate_text, columns=60, rows=40))
    master, terminal = pty.openpty()
    words = [sys.executable, "-m", "amulor", "acquire", str(folder / "tank.toml")]
    running = subprocess.Popen(
        [*words, "-o", str(folder / "scan")], stdin=terminal, stdout=terminal,
        stderr=terminal, start_new_session=True,
    )  # fmt: skip
    os.close(terminal)
    try:
        shown = _shown(master, b" left, ")
        running.send_signal(signal.SIGINT)
        shown += _shown(master, b"Go on with the scan? [Y/n]")
        os.write(master, b"y\n")
        _shown(master, b" left, ")
        running.send_signal(signal.SIGINT)
        _shown(master, b"Go on with the scan? [Y/n]")
        os.write(master, b"n\n")
        shown += _shown(master, b"--resume")
        assert running.wait(timeout=60) == 130
    finally:
        running.kill()
        running.wait()
    os.close(master)
    assert b"/s, " in shown
    assert b"flagged" in shown
    assert b"Paused: laser off, stage stopped." in shown
    with Journal.read(folder / "scan") as journal:
        assert [part["reason"] for part in journal.segments()] == ["paused", "paused"]


def _shown(master: int, until: bytes) -> bytes:
    """Return what a terminal shows up to some words."""
    found, deadline = b"", time.monotonic() + 60
    while until not in found:
        assert time.monotonic() < deadline, found[-500:]
        if select.select([master], [], [], 1.0)[0]:
            try:
                found += os.read(master, 65536)
            except OSError:  # the other end is gone
                break
    assert until in found
    return found


# -- what must be shown ----------------------------------------------------------------


@pytest.mark.study
def test_a_full_scan_over_the_network_goes_through_the_whole_chain(
    plate_text, folder
) -> None:
    (folder / "tank.toml").write_text(sized(plate_text, columns=100, rows=40))
    survey = Survey.from_toml(folder / "tank.toml")
    words = [sys.executable, "-m", "amulor", "devices", "simulate"]
    words += [str(folder / "tank.toml"), "-o", str(folder / "devices.toml")]
    serving = subprocess.Popen([*words, "--speed", "1000"], stdout=subprocess.PIPE)
    try:
        assert serving.stdout is not None
        for _ in range(3):
            serving.stdout.readline()
        settings = Settings.from_toml(folder / "devices.toml")
        rates = []
        for number in range(3):
            place = folder / str(number)
            start = time.monotonic()
            outcome = acquisition.acquire(survey, place, settings=settings)
            rates.append(outcome.done / (time.monotonic() - start))
        print("samples per second:", rates)
    finally:
        serving.send_signal(signal.SIGTERM)
        serving.communicate(timeout=30)
    # Samples: 4000 pixels in each of two polarizations, and the references.
    assert outcome.done == 8000 + 2 * (15 * 2 + 10)
    assert max(rates) > 1000
    slant = ranges(io.read_cube(acquisition.recover(folder / "0")))
    truth = simulate(survey, rng=1)["truth_slant_range"].values
    assert abs((slant - truth).mean()) < 2e-3
