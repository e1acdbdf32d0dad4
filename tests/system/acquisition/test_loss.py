"""Nothing is lost: scans are killed at random times, and disks run full."""

from __future__ import annotations

import ast
import math
import os
import random
import resource
import select
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from driven_devices import devices_of
from shared_light import scene_light
from trials import keep

from amulor import acquisition
from amulor.acquisition import plan
from amulor.acquisition import run as keeper
from amulor.acquisition.bluesky import ScanDevice
from amulor.acquisition.connect import connect
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import SCAN, Key
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.scene import LightByDirection, SceneLight
from amulor.errors import AmulorError
from amulor.platform import pose_line
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
#: Interval of the messages of the navigation [s].
_INTERVAL = 0.01


class _Carried:
    """A vehicle without rays: the light of the first direction, and numbered poses."""

    def __init__(self, light: LightByDirection, seed: int, start: float) -> None:
        self._light = replace(
            light,
            **{
                field.name: getattr(light, field.name)[..., :1]
                for field in fields(light)
            },
        )

    def light(self, time: float, direction: int) -> LightByDirection:
        return self._light

    def messages(self, begin: float, end: float) -> list[tuple[float, str]]:
        first, last = (math.ceil(time / _INTERVAL) for time in (begin, end))
        return [
            (
                number * _INTERVAL,
                pose_line(
                    time=number * _INTERVAL,
                    position=[0.0, 1e-3 * number, -8.0],
                    attitude=[0, 0, 0, 1],
                    covariance=1e-6 * np.eye(6),
                ),
            )
            for number in range(first, last)
        ]


def _light_of_vehicle(survey: Survey) -> SceneLight:
    """Light of a survey on a vehicle, without rays after the fork."""
    if survey not in _LIGHT:
        standing = scene_light(survey.with_({"platform": None}))
        _LIGHT[survey] = replace(
            standing, vehicle=partial(_Carried, standing.with_target)
        )
    return _LIGHT[survey]


def _last_elapsed(folder: Path) -> float:
    if not (folder / FILE_NAME).exists():
        return 0.0
    with Journal.read(folder) as journal:
        return journal.last_elapsed()


def _lost_messages(journal: Journal, begin: float, told: set[Key]) -> int:
    """Count the messages before the last acknowledged sample that are missing."""
    kinds = (plan.DARK, plan.OPEN_WATER, SCAN)
    ends = [
        record.elapsed
        for kind in kinds
        for key, record in journal.samples(kind)
        if key in told
    ]
    there = {round(arrival / _INTERVAL) for _, arrival, _ in journal.messages()}
    first, last = (
        math.ceil(time / _INTERVAL) for time in (begin, max(ends, default=0.0))
    )
    return len({*range(first, last)} - there)


_SLOW = keeper.SLOW


def _planned(survey: Survey, settings: Settings) -> list[Key]:
    steps = plan.steps(survey, settings.procedure)
    return [key for step in steps for key in step.keys]


def _scan(
    survey: Survey,
    folder: Path,
    settings: Settings,
    *,
    way: str,
    acknowledged: Callable[[Key], None] = lambda key: None,
) -> bool:
    """Run or go on with a scan, by one of the ways that devices are driven."""
    resume = (folder / FILE_NAME).exists()
    part = 0
    if resume:
        with Journal.read(folder) as journal:
            part = len(journal.segments())
    embedded = way in ("plan", "beside")
    if way == "vehicle":
        devices = connect(
            survey, settings, scene=_light_of_vehicle, part=part,
            elapsed=_last_elapsed(folder),
        )  # fmt: skip
    else:
        devices = devices_of(
            "embedded" if embedded else way, survey, settings, scene=_known_light,
            part=part,
        )  # fmt: skip
    # As on a disk that takes its time.
    keeper.SLOW = 0.0 if way == "beside" else _SLOW
    try:
        if way != "plan":
            return acquisition.acquire(
                survey, folder, settings=settings, resume=resume, devices=devices,
                acknowledged=acknowledged,
            ).finished  # fmt: skip
        return _by_plan(
            ScanDevice(
                survey, folder, settings=settings, resume=resume, devices=devices
            ),
            acknowledged,
        )
    finally:
        keeper.SLOW = _SLOW
        devices.close()


def _by_plan(device: ScanDevice, acknowledged: Callable[[Key], None]) -> bool:
    """Do what a RunEngine does with the plan of a scan; an event acknowledges."""
    number = 0
    error = device.stage().exception(60)
    while error is None and not device.finished_before(number + 1):
        error = device.set(number + 1).exception(60)
        if error is None and not device.finished_before(number + 1):
            number += 1
            data = {name: one["value"] for name, one in device.read().items()}
            acknowledged(Key(device.stream, *(data[name] for name in Key._fields[1:])))
    device.unstage().exception(60)
    if error is not None:
        raise error
    return True


def _child(
    survey: Survey, folder: Path, told: int, settings: Settings, way: str
) -> None:
    """Scan in a process of its own and tell each acknowledged sample, in a line."""

    def tell(key: Key) -> None:
        os.write(told, f"{tuple(key)!r}\n".encode())

    _scan(survey, folder, settings, way=way, acknowledged=tell)


def _killed(
    survey: Survey,
    folder: Path,
    *,
    samples: int,
    after: float,
    settings: Settings,
    way: str,
) -> tuple[list[Key], bool]:
    """Return the samples that a scan acknowledged before it was killed.

    The time counts from so many acknowledged samples on, of none from the start: how
    many there are before a kill is not for the machine to say.
    """
    told, told_in = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        try:
            _child(survey, folder, told_in, settings, way)
            code = 0
        finally:
            os._exit(code)
    os.close(told_in)
    content = b""
    with os.fdopen(told, "rb", buffering=0) as end:
        while content.count(b"\n") < samples:
            if not select.select([end], [], [], 240)[0]:
                break
            if not (more := end.read(4096)):  # it has ended by itself
                break
            content += more
        time.sleep(after)
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        content += end.read()
    lines = content.decode().split("\n")[:-1]
    ended = os.WIFEXITED(status)
    assert not ended or os.WEXITSTATUS(status) == 0
    return [Key(*ast.literal_eval(line)) for line in lines], not ended


def _kill_loop(
    survey: Survey,
    home: Path,
    kills: int,
    settings: Settings = FEW,
    way: str = "embedded",
) -> dict[str, int]:
    rng = random.Random(7)
    planned = _planned(survey, settings)
    for name in ("first", "whole"):  # the first one loads compiled code, too
        start = time.monotonic()
        assert _scan(survey, home / name, settings, way=way)
        whole = time.monotonic() - start
    counts = {"kills": 0, "acknowledged": 0, "folders": 0, "lost": 0, "twice": 0}
    # One in four while it begins or goes on, the others in the middle of dwells.
    dwell = whole / len(planned)
    while counts["kills"] < kills:
        folder = home / str(counts["folders"])
        counts["folders"] += 1
        acknowledged: list[Key] = []
        while counts["kills"] < kills:
            early, begin = counts["kills"] % 4 == 3, _last_elapsed(folder)
            told, was_killed = _killed(
                survey, folder,
                samples=0 if early else rng.randrange(1, len(planned) * 5 // 4),
                after=rng.uniform(0, whole / 4 if early else 2 * dwell),
                settings=settings, way=way,
            )  # fmt: skip
            counts["kills"] += was_killed
            acknowledged += told
            counts["acknowledged"] += len(told)
            if (folder / FILE_NAME).exists():
                with Journal.read(folder) as journal:
                    keys = journal.keys()
                    counts["twice"] += journal.count() - len(keys)
                    if way == "vehicle":
                        counts["lost"] += _lost_messages(journal, begin, {*told})
                counts["lost"] += len({*acknowledged} - keys)
            else:
                counts["lost"] += len(acknowledged)
            if not was_killed:
                break
        counts["twice"] += len(acknowledged) - len({*acknowledged})
        assert _scan(survey, folder, settings, way=way)
        with Journal.read(folder) as journal:
            keys = journal.keys()
        assert {*planned} <= keys
        # None invented: what is more are references after breaks.
        assert not any(key.kind == SCAN for key in keys - {*planned})
        with Journal.read(folder) as journal:
            cube = acquisition.build(journal)
        if way == "vehicle":
            assert not (cube["user_sample_flag"] & SampleFlag.NO_POSE).any()
        assert np.isfinite(cube["in_phase"]).all()
        shutil.rmtree(folder)
    return counts


needs_fork = pytest.mark.skipif(
    not hasattr(os, "fork"), reason="SIGKILL and fork are needed"
)


@needs_fork
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_kills_lose_no_pose_before_an_acknowledged_sample(tiny, folder) -> None:
    counts = _kill_loop(_prepared("", "vehicle", tiny), folder, 4, FEW, "vehicle")
    assert (counts["lost"], counts["twice"]) == (0, 0)
    assert counts["acknowledged"] > 10


@needs_fork
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_ten_kills_lose_no_acknowledged_sample(tiny, folder) -> None:
    counts = _kill_loop(tiny, folder, 10)
    assert (counts["lost"], counts["twice"]) == (0, 0)
    assert counts["acknowledged"] > 50


#: What stands in front of the scan, how it is taken, and what goes wrong.
WAYS = [
    ("as it is", "embedded", {}, ()),
    ("without waiting for the filter", "embedded", {"output_filter": "known"}, ()),
    ("with faults", "embedded", {}, ("unlock@9x2", "overload@15", "overload@40x2")),
    ("two frequencies in four polarizations", "embedded", {"references": 3}, ()),
    (
        "two frequencies at once in four polarizations, from the buffer",
        "embedded",
        {"frequencies_at_once": 2, "readings": "buffer"},
        ("unlock@9x2", "overload@15"),
    ),
    (
        "capture of an SR865A, and stages",
        "sr865a",
        {"output_filter": "known", "readings": "buffer"},
        (),
    ),
    (
        "two frequencies at once in four polarizations, streamed by a UHFLI",
        "uhfli",
        {"output_filter": "known", "readings": "buffer", "frequencies_at_once": 2},
        (),
    ),
    ("records of a digitiser", "digitiser", {}, ("unlock@9", "overload@20")),
    ("mirrors on outputs", "mirrors", {"position_tolerance": 1e-3}, ()),
    ("a pan-tilt head", "head", {"position_tolerance": 1e-3}, ()),
    ("events of a plan of bluesky", "plan", {}, ("unlock@9x2", "overload@15")),
    (
        "rows without stops",
        "embedded",
        {"output_filter": "known", "readings": "buffer", "mode": "continuous"},
        ("unlock@9x2", "overload@40"),
    ),
    (
        "rows without stops by an SR865A, and stages",
        "sr865a",
        {"output_filter": "known", "readings": "buffer", "mode": "continuous"},
        (),
    ),
    ("carried by a vehicle", "vehicle", {}, ()),
    ("commits beside the next dwell", "beside", {}, ("unlock@9x2", "overload@15")),
]


def _prepared(name: str, way: str, survey: Survey) -> Survey:
    """Return the survey of a way."""
    changes: dict[str, object] = {}
    if "four" in name:
        changes = {
            "instrument.modulation_frequencies": ["30 MHz", "41 MHz"],
            "instrument.polarizations": ["VV", "VH", "HV", "HH"],
            "instrument.modulation_depth": 0.4,
        }
    if way == "vehicle":
        course = {"kind": "hover", "start": [0.0, 0.0, -8.0]}
        changes = {"platform": {"course": course}}
    if way == "sr865a":
        changes |= {"instrument.modulation_frequencies": ["3.9 MHz"]}
    if way == "digitiser":
        # Records of 8 us: a tone needs a few periods in one.
        changes |= {"scan.dwell": "50 us", "instrument.lock_in.time_constant": "10 us"}
    return survey.with_(changes) if changes else survey


@needs_fork
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize(
    ("name", "way", "procedure", "faults"), WAYS[5:], ids=lambda value: str(value)[:20]
)
def test_a_kill_of_each_way_loses_no_acknowledged_sample(
    tiny, folder, name, way, procedure, faults
) -> None:
    settings = Settings.model_validate(
        {
            "procedure": {"dark_readings": 2, **procedure},
            "simulation": {"faults": faults},
        }
    )
    counts = _kill_loop(_prepared(name, way, tiny), folder, 3, settings, way)
    assert (counts["lost"], counts["twice"]) == (0, 0)
    assert counts["acknowledged"] > 10


@needs_fork
@pytest.mark.study
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize(
    ("name", "way", "procedure", "faults"),
    WAYS,
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_thousand_kills_lose_no_acknowledged_sample(
    tiny, folder, name, way, procedure, faults
) -> None:
    settings = Settings.model_validate(
        {
            "procedure": {"dark_readings": 2, **procedure},
            "simulation": {"faults": faults},
        }
    )
    kills = int(os.environ.get("AMULOR_KILLS", "100"))
    counts = _kill_loop(_prepared(name, way, tiny), folder, kills, settings, way)
    print(name, counts)
    keep(
        "kills", what="scan", way=name, kills=counts["kills"],
        acknowledged=counts["acknowledged"], lost=counts["lost"], twice=counts["twice"],
        parts=0,
    )  # fmt: skip
    assert counts["kills"] == kills
    assert (counts["lost"], counts["twice"]) == (0, 0)
    assert counts["acknowledged"] > 3 * kills


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
