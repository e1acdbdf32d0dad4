"""Eight hours of a scan in simulated time, with faults, pages open, commands beside it.

The writer, the page's server and the commands are processes of their own, as in use.
The writer is broken off by faults, and killed after some samples, and goes on. Pages
come and go over websockets. Afterwards: nothing that was acknowledged is missing, the
memory of the server and its open files are what they were, and the writer never waited
for a reader.
"""

from __future__ import annotations

import ast
import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trials import keep

from amulor import acquisition, imaging, rejection
from amulor.acquisition import plan
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.settings import Settings
from amulor.survey import Survey

WRITER = Path(__file__).parents[2] / "support" / "soak_writer.py"
#: One of each kind that a scan meets; each run of the writer ends by one at the latest.
FAULTS = ("unlock@300x2", "saturation@520x3", "overload@700x2", "stuck@900x2")
COMMAND = [sys.executable, "-m", "amulor"]


@dataclass
class Watched:
    """What was seen of the server, over time."""

    memory: list[float] = field(default_factory=list)
    """Resident memory [MB]."""
    files: list[int] = field(default_factory=list)
    """Open file descriptors."""
    log: list[int] = field(default_factory=list)
    """Size of the journal's write-ahead log [byte]."""

    def look(self, process: int, folder: Path) -> None:
        status = Path(f"/proc/{process}/status").read_text()
        (resident,) = [line for line in status.splitlines() if "VmRSS" in line]
        self.memory.append(int(resident.split()[1]) / 1024)
        self.files.append(len(os.listdir(f"/proc/{process}/fd")))
        log = folder / f"{FILE_NAME}-wal"
        with contextlib.suppress(FileNotFoundError):
            self.log.append(log.stat().st_size)


class Page:
    """A page over the wire: follows the scan, fetches the maps anew, and reconnects."""

    def __init__(self, address: str, *, stays: float) -> None:
        self.address, self.stays = address, stays
        self.rows = self.pictures = self.connections = 0
        self.done = 0
        self.problems: list[str] = []
        self.end = threading.Event()
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        from websockets.sync.client import connect

        origin = self.address.split("/", 3)
        live = self.address.replace("http", "ws") + "live"
        while not self.end.is_set():
            try:
                with connect(
                    live, origin="/".join(origin[:3]), max_size=None
                ) as socket:
                    self.connections += 1
                    leave = time.monotonic() + self.stays
                    while not self.end.is_set() and time.monotonic() < leave:
                        with contextlib.suppress(TimeoutError):
                            self._take(socket.recv(timeout=0.5))
            except Exception as error:  # whatever it is, the test tells it
                self.problems.append(f"{type(error).__name__}: {error}")
                time.sleep(1)

    def _take(self, message: str | bytes) -> None:
        if isinstance(message, bytes):
            self.rows += 1
            return
        said = json.loads(message)
        if said["type"] == "picture":
            self.pictures += 1
            scene = json.loads(self._got("scene"))
            for layer in scene["layers"]:
                values = self._got(f"layer/{scene['channel']}/{layer['name']}")
                width = 2 if layer["kind"] == "flags" else 4
                assert len(values) == width * scene["rows"] * scene["columns"]
        elif "done" in said:
            self.done = max(self.done, said["done"])

    def _got(self, name: str) -> bytes:
        with urllib.request.urlopen(self.address + name, timeout=60) as answer:
            content: bytes = answer.read()
            return content


@contextlib.contextmanager
def served(folder: Path) -> Iterator[tuple[str, int]]:
    """Run `amulor view` beside the scan; yields its address and its process."""
    process = subprocess.Popen(
        [*COMMAND, "view", str(folder)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert process.stdout is not None
        yield process.stdout.readline().split()[1], process.pid
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
        process.stdout.close()


def beside(
    folder: Path, place: Path, end: threading.Event, codes: list[str], pause: float
) -> None:
    """Make cube, target signal, range image and report, again and again.

    The last round begins after the end, so that it sees the whole scan.
    """
    cube, target, image = (place / f"{name}.nc" for name in ("cube", "target", "image"))
    words = [
        ["recover", str(folder), "-o", str(cube)],
        ["reject", str(cube), "--method", "open-water", "-o", str(target)],
        ["image", str(target), "--polarization", "VV", "-o", str(image)],
        ["report", str(image), "-o", str(place / "report.html")],
    ]
    ended = False
    while not ended:
        ended = end.is_set()
        for line in words:
            done = subprocess.run(
                [*COMMAND, *line, "--overwrite"], capture_output=True, text=True
            )
            codes.append(f"{line[0]} {done.returncode}")
            if done.returncode:
                # A scan that has not met the target yet has no picture; said so.
                assert done.returncode == 1, done.stderr
                assert done.stderr.startswith("amulor: "), done.stderr
                break
        end.wait(pause)


def scan_of(plate: Survey, hours: float, rows: int, columns: int) -> Survey:
    """Return a scan that takes so long, most of it for dwelling."""
    shots = 3 * 2 * 6
    dwell = hours * 3600 / (2 * (rows * columns + shots))
    return plate.with_(
        {
            "instrument.lock_in.time_constant": f"{dwell / 12:.4f} s",
            "scan.rows": rows,
            "scan.columns": columns,
            "scan.dwell": f"{dwell:.4f} s",
            "scan.open_water": {"columns": 3, "rows": 2, "repeats": 6},
        }
    )


def soak(
    survey: Survey, place: Path, *, wall: float, hours: float, pages: int, killed: int
) -> dict[str, Any]:
    """Run the scan to its end, and return what there is to say of it."""
    folder, acknowledged = place / "scan", place / "acknowledged.txt"
    text = place / "survey.toml"
    text.write_text(survey.to_toml())
    speed = hours * 3600 / wall
    chance = random.Random(5)
    keys = [
        key for step in plan.steps(survey, Settings().procedure) for key in step.keys
    ]

    seen, codes, ends = Watched(), [], []  # type: ignore[var-annotated]
    over = threading.Event()
    worker: threading.Thread | None = None
    with contextlib.ExitStack() as stack:
        stack.callback(over.set)
        server, open_pages = 0, []  # type: ignore[var-annotated]

        def watch() -> None:
            """Look at the server, once there is a scan that it can show."""
            nonlocal server, worker
            if not server and (folder / FILE_NAME).exists():
                with contextlib.suppress(Exception):
                    with Journal.read(folder) as journal:
                        journal.meta()
                    address, server = stack.enter_context(served(folder))
                    open_pages.extend(
                        Page(address, stays=wall * (2 if n == 0 else 0.05))
                        for n in range(pages)
                    )
                    worker = threading.Thread(
                        target=beside,
                        args=(folder, place, over, codes, max(wall / 360, 1.0)),
                        daemon=True,
                    )
                    worker.start()
            if server:
                seen.look(server, folder)

        deadline = time.monotonic() + 6 * wall + 600
        finished = False
        while not finished:
            assert time.monotonic() < deadline, ends
            # Pages are open before the scan goes on, however slow the computer is.
            watch()
            # Somewhere in what is left of the scan, a few times.
            kills = ends.count("killed") < killed
            after = int(chance.uniform(0.1, 0.3) * len(keys)) if kills else 0
            writer = subprocess.Popen(
                [
                    sys.executable, str(WRITER), str(text), str(folder),
                    str(acknowledged), repr(speed), str(after), *FAULTS,
                ],
                stdout=subprocess.PIPE, text=True,
            )  # fmt: skip
            while writer.poll() is None:
                time.sleep(min(0.5, wall / 100))
                watch()
            assert writer.stdout is not None
            said = writer.stdout.read().strip()
            writer.stdout.close()
            finished = writer.returncode == 0
            assert said or writer.returncode in (0, -signal.SIGKILL)
            ends.append(said or ("finished" if finished else "killed"))
            print(f"run {len(ends)}: {ends[-1]}", flush=True)
        # Commands and pages see the end of the scan, too.
        last = time.monotonic() + 60
        while open_pages[0].done == 0 or time.monotonic() < last - 50:
            time.sleep(0.5)
            seen.look(server, folder)
            assert time.monotonic() < last, "the page heard nothing"
        over.set()
        assert worker is not None
        worker.join(240)
        for one in open_pages:
            one.end.set()
        for one in open_pages:
            one.thread.join(10)
        time.sleep(2)
        seen.look(server, folder)
    return {
        "seen": seen, "codes": codes, "ends": ends, "pages": open_pages,
        "folder": folder, "acknowledged": acknowledged, "planned": len(keys),
        "last_files": seen.files[-1], "wall": wall, "killed": killed,
    }  # fmt: skip


def check(found: dict[str, Any], *, hours: float) -> str:
    """Check what must hold, and return the figures in a line."""
    seen: Watched = found["seen"]
    lines = [
        line.split("\t") for line in found["acknowledged"].read_text().splitlines()
    ]
    told = [ast.literal_eval(key) for key, _ in lines]
    with Journal.read(found["folder"]) as journal:
        taken = journal.keys()
        elapsed = journal.last_elapsed()
        cube = acquisition.build(journal)
    kept = {tuple(key) for key in taken}
    third = len(seen.memory) // 3
    second, last = seen.memory[third : 2 * third], seen.memory[2 * third :]
    gaps = np.array([float(gap) for _, gap in lines])
    pages: list[Page] = found["pages"]
    with_report = found["codes"].count("report 0")
    keep(
        "soak", scan_h=hours, minutes=found["wall"] / 60, simulated_h=elapsed / 3600,
        acknowledged=len(told), lost=len(set(told) - kept),
        twice=len(told) - len(set(told)), runs=len(found["ends"]),
        killed=found["ends"].count("killed"),
        pages=sum(one.connections for one in pages),
        pictures=sum(one.pictures for one in pages), reports=with_report,
        memory_second_third_mb=float(np.median(second)),
        memory_last_third_mb=float(np.median(last)), files_lowest=min(seen.files),
        files_highest=max(seen.files), log_highest_mb=max(seen.log) / 1e6,
        gap_median_s=float(np.median(gaps)),
        gap_999_s=float(np.quantile(gaps, 0.999)),
    )  # fmt: skip
    assert len(set(told)) == len(told), "a sample was taken twice"
    assert set(told) <= kept, "an acknowledged sample is missing"
    assert len(kept) >= found["planned"]
    assert elapsed > 0.9 * hours * 3600
    for name in ("in_phase", "quadrature"):
        # Faults flag samples; the plan was finished, so that each of them is there.
        assert np.isfinite(cube[name].values).all()
    image = imaging.range_image(rejection.open_water(cube), polarization="VV")
    middle = float(np.nanmedian(image["slant_range"].values))
    assert middle == pytest.approx(1.5, abs=0.02)
    # Memory: the last third is what the second one was.
    growth = float(np.median(last) - np.median(second))
    assert growth < 0.05 * np.median(second) + 4, (np.median(second), np.median(last))
    # Files: with all pages gone no more than before most of them came.
    assert found["last_files"] <= min(seen.files[third:]) + 1
    assert max(seen.files[2 * third :]) <= max(seen.files[: 2 * third]) + 2
    # The log was emptied again and again: no reader held on to it.
    assert max(seen.log) < 8_000_000
    assert [one.problems for one in pages] == [[] for _ in pages]
    assert all(one.pictures > 0 and one.rows > 0 for one in pages[:1])
    assert with_report > 0
    assert 1 <= found["ends"].count("killed") <= found["killed"]
    return (
        f"{elapsed / 3600:.2f} h simulated, {len(told)} samples acknowledged, "
        f"{len(kept)} kept, {len(found['ends'])} runs ({found['ends'].count('killed')} "
        f"killed), {sum(one.connections for one in pages)} pages, "
        f"{sum(one.pictures for one in pages)} pictures, {with_report} reports, memory "
        f"{np.median(second):.0f} -> {np.median(last):.0f} MB, files "
        f"{min(seen.files)} to {max(seen.files)}, log at most "
        f"{max(seen.log) / 1e6:.1f} MB, between samples median "
        f"{np.median(gaps) * 1e3:.1f} ms, 99.9 % {np.quantile(gaps, 0.999):.2f} s"
    )


@pytest.mark.study
@pytest.mark.timeout(900)
def test_half_an_hour_with_faults_and_pages_loses_nothing(
    plate: Survey, tmp_path: Path
) -> None:
    survey = scan_of(plate, 0.5, 20, 30)
    found = soak(survey, tmp_path, wall=25, hours=0.5, pages=2, killed=1)
    print(check(found, hours=0.5))


@pytest.mark.study
@pytest.mark.timeout(7200)
def test_eight_hours_with_faults_and_pages_lose_nothing(
    plate: Survey, tmp_path: Path
) -> None:
    # More minutes need `-o faulthandler_timeout=3600`: tests end after 15 by default.
    minutes = float(os.environ.get("AMULOR_SOAK_MINUTES", "4"))
    survey = scan_of(plate, 8, 40, 60)
    found = soak(survey, tmp_path, wall=60 * minutes, hours=8, pages=4, killed=4)
    print(check(found, hours=8))
