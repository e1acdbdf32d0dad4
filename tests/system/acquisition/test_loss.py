"""Nothing is lost: scans are killed at random times, and disks run full."""

from __future__ import annotations

import os
import random
import resource
import select
import shutil
import signal
import sqlite3
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from amulor import acquisition
from amulor.acquisition import plan
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import SCAN, Key
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.scene import SceneLight
from amulor.errors import AmulorError
from amulor.simulation import scene_light
from amulor.survey import Survey

RECORD = Record(
    in_phase=1e-3, quadrature=-2e-3, mean=None, readings=1, full_scale=1.0, flags=0,
    commanded_azimuth=0.0, commanded_elevation=0.0, azimuth=0.0, elevation=0.0,
    modulation_frequency=39e6, elapsed=0.0, segment=1,
)  # fmt: skip
FEW = Settings.model_validate({"procedure": {"dark_readings": 2}})

# -- killed ----------------------------------------------------------------------------


def _known_light(survey: Survey) -> SceneLight:
    """Return the light of a survey, worked out before any process was forked.

    The library that casts rays has threads of its own, and a child has none of them: it
    would wait for them for ever, now and then.
    """
    if survey not in _LIGHT:
        _LIGHT[survey] = scene_light(survey)
    return _LIGHT[survey]


_LIGHT: dict[Survey, SceneLight] = {}


def _planned(survey: Survey, settings: Settings) -> list[Key]:
    steps = plan.steps(survey, settings.procedure)
    return [key for step in steps for key in step.keys]


def _child(survey: Survey, folder: Path, told: int, settings: Settings) -> None:
    """Scan in a process of its own and tell each acknowledged sample."""
    numbers = {key: n for n, key in enumerate(_planned(survey, settings))}

    def tell(key: Key) -> None:
        os.write(told, struct.pack("i", numbers.get(key, -1)))

    acquisition.acquire(
        survey, folder, settings=settings, resume=(folder / FILE_NAME).exists(),
        acknowledged=tell,
        scene=_known_light,
    )  # fmt: skip


def _killed(
    survey: Survey, folder: Path, after: float, *, begun: bool, settings: Settings
) -> tuple[list[int], bool]:
    """Return the samples that a scan acknowledged before it was killed.

    The time counts from the first acknowledged sample if `begun`, else from the start.
    """
    told, told_in = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            _child(survey, folder, told_in, settings)
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


def _kill_loop(
    survey: Survey, home: Path, kills: int, settings: Settings = FEW
) -> dict[str, int]:
    rng = random.Random(7)
    planned = _planned(survey, settings)
    for name in ("first", "whole"):  # the first one loads compiled code, too
        start = time.monotonic()
        acquisition.acquire(survey, home / name, settings=settings, scene=_known_light)
        whole = time.monotonic() - start
    counts = {"kills": 0, "acknowledged": 0, "folders": 0, "lost": 0, "twice": 0}
    while counts["kills"] < kills:
        folder = home / str(counts["folders"])
        counts["folders"] += 1
        acknowledged: list[int] = []
        while counts["kills"] < kills:
            numbers, was_killed = _killed(
                survey, folder, rng.uniform(0, whole), begun=rng.random() < 0.75,
                settings=settings,
            )  # fmt: skip
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
        outcome = acquisition.acquire(
            survey, folder, settings=settings, resume=resume, scene=_known_light
        )
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
@pytest.mark.parametrize(
    ("name", "procedure", "faults"),
    [
        ("as it is", {}, ()),
        ("without waiting for the filter", {"output_filter": "known"}, ()),
        ("with faults", {}, ("unlock@9x2", "overload@15", "overload@40x2")),
        ("two frequencies in four polarizations", {"references": 3}, ()),
        (
            "two frequencies at once in four polarizations, from the buffer",
            {"frequencies_at_once": 2, "readings": "buffer"},
            ("unlock@9x2", "overload@15"),
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_thousand_kills_lose_no_acknowledged_sample(
    tiny, folder, name, procedure, faults
) -> None:
    settings = Settings.model_validate(
        {
            "procedure": {"dark_readings": 2, **procedure},
            "simulation": {"faults": faults},
        }
    )
    if "four" in name:
        tiny = tiny.with_(
            {
                "instrument.modulation_frequencies": ["30 MHz", "41 MHz"],
                "instrument.polarizations": ["VV", "VH", "HV", "HH"],
                "instrument.modulation_depth": 0.4,
            }
        )
    counts = _kill_loop(tiny, folder, 200, settings)
    print(name, counts)
    assert counts["kills"] == 200
    assert (counts["lost"], counts["twice"]) == (0, 0)
    assert counts["acknowledged"] > 2000


# -- readers ---------------------------------------------------------------------------

READER = """
import sys
from pathlib import Path
from amulor.acquisition import Journal

print("ready", flush=True)
last = looks = 0
while last < int(sys.argv[2]):
    with Journal.read(Path(sys.argv[1])) as journal:
        keys = [key.column for key, _ in journal.samples("scan")]
    assert keys == [*range(len(keys))], "samples are missing, or not in order"
    assert len(keys) >= last, "samples are gone"
    last, looks = len(keys), looks + 1
print(looks)
"""


@pytest.mark.study
def test_a_writer_and_readers_in_other_programs_do_not_disturb_each_other(
    folder,
) -> None:
    total, readers = 20_000, 3
    meta = {"survey_digest": "1", "instrument_digest": "2", "identities": "{}"}
    slowest = 0.0
    with Journal.create(folder, meta=meta) as journal:
        running = [
            subprocess.Popen(
                [sys.executable, "-c", READER, str(folder), str(total)],
                stdout=subprocess.PIPE, stderr=subprocess.PIPE,
            )
            for _ in range(readers)
        ]  # fmt: skip
        for one in running:
            assert one.stdout is not None
            assert one.stdout.readline() == b"ready\n"
        began = time.monotonic()
        for number in range(total):
            start = time.monotonic()
            journal.commit(Key(SCAN, 0, number, 39e6, "VV", 0), RECORD)
            slowest = max(slowest, time.monotonic() - start)
        took = time.monotonic() - began
        found = [one.communicate(timeout=120) for one in running]
    assert [one.returncode for one in running] == [0] * readers, found
    looks = [int(out.split()[0]) for out, _ in found]
    print(
        f"{total} commits in {took:.1f} s, the slowest {slowest * 1e3:.0f} ms, beside "
        f"{looks} looks at the whole journal by {readers} programs"
    )
    assert min(looks) > 5
    # A lock would have been waited for, for up to 10 s.
    assert slowest < 2.0
    connection = sqlite3.connect(folder / FILE_NAME)
    assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    connection.close()


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
        acquisition.acquire(
            survey, place, settings=FEW, acknowledged=told.append, scene=scene_light
        )
    assert len(told) > 10
    with Journal.read(place) as journal:
        assert journal.keys() == {*told}
    assert acquisition.acquire(
        survey, place, settings=FEW, resume=True, scene=scene_light
    ).finished
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
            acquisition.acquire(
                survey, scan, settings=FEW, acknowledged=told.append, scene=scene_light
            )
        assert len(told) > 10
        # Somebody moves the folder to a disk with room.
        shutil.copytree(scan, folder / "moved")
    finally:
        subprocess.run(["umount", str(place)], check=True)
    with Journal.read(folder / "moved") as journal:
        assert journal.keys() >= {*told}
    again = acquisition.acquire(
        survey, folder / "moved", settings=FEW, resume=True, scene=scene_light
    )
    assert again.finished
