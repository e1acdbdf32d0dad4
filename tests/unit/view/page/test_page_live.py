"""A page that follows a scan reads what is there, and its writer does not notice."""

from __future__ import annotations

import json
import struct
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from starlette.testclient import TestClient
from websockets import Origin
from websockets.sync.client import connect

from amulor import acquisition, simulation
from amulor.acquisition.journal.file import FILE_NAME
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import Key
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Settings
from amulor.errors import FormatError
from amulor.survey import Survey
from amulor.view import page
from amulor.view.page import live as live_module
from amulor.view.page import server
from amulor.view.page.live import Live
from amulor.view.page.progress import Change, Drift, Going, Progress, advice

TOKEN = "a-token-for-tests"
OWN = {"host": "127.0.0.1:8000", "origin": "http://127.0.0.1:8000"}


@pytest.fixture(scope="module")
def survey(plate: Survey) -> Survey:
    return plate.with_(
        {
            "scan.columns": 8,
            "scan.rows": 3,
            "scan.dwell": "50 ms",
            "scan.open_water": {"columns": 3, "rows": 2, "repeats": 3},
        }
    )


def scan(
    survey: Survey, folder: Path, acknowledged: Callable[[Key], None] = lambda key: None
) -> None:
    acquisition.acquire(
        survey,
        folder,
        settings=Settings.model_validate({"procedure": {"dark_readings": 2}}),
        scene=simulation.scene_light,
        acknowledged=acknowledged,
    )


def sample(signal: complex, *, elapsed: float) -> Record:
    return Record(
        in_phase=signal.real,
        quadrature=signal.imag,
        mean=None,
        readings=1,
        full_scale=1.0,
        flags=0,
        commanded_azimuth=0.0,
        commanded_elevation=0.0,
        azimuth=0.0,
        elevation=0.0,
        modulation_frequency=39e6,
        elapsed=elapsed,
        segment=0,
    )


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.mark.slow
def test_a_scan_grows_on_the_page_and_ends_as_its_cube(
    survey: Survey, folder: Path
) -> None:
    clock = Clock()
    shown: list[Live] = []
    done: list[int] = []
    rows: list[tuple[int, float]] = []
    blank: list[float] = []

    def looked(key: Key) -> None:
        clock.now += 0.05
        if not shown:
            shown.append(Live(folder, clock=clock))
            first = shown[0].recording.layer("VV", "range", 1)
            blank.append(float(np.isfinite(first).mean()))
        if key.kind == "scan" and key.column % 8 == 7:
            live = shown[0]
            live.look()
            done.append(live.status["done"])
            _, status, fresh = live.snapshot(0)
            assert status["state"] == "running"
            assert "error" not in status
            # As long as the water is not known, rows come with it left in.
            assert all("range_before" in one.layers for one in fresh)
            corrected = [one for one in fresh if "range" in one.layers]
            rows.extend((one.row, float(one.layers["range"][3])) for one in corrected)

    scan(survey, folder, looked)
    live = shown[0]
    assert blank == [0.0]
    assert done == sorted(done)
    assert len(done) == 6
    # Rows that came one by one lie where the plate is, the water taken out.
    assert rows
    assert_allclose([value for _, value in rows], 1.5, rtol=0, atol=0.06)
    live.look()
    assert live.status["state"] == "finished"
    assert live.status["done"] == live.status["total"]
    with Journal.read(folder) as journal:
        cube = acquisition.build(journal)
    expected = page.recording_of(cube)
    for name in ("range", "range_before", "uncertainty"):
        np.testing.assert_array_equal(
            live.recording.layer("VH", name, 1), expected.layer("VH", name, 1)
        )
    assert live.recording.layer("VH", "time", 1).shape == (3, 8)
    live.stop()


@pytest.mark.slow
def test_following_writes_nothing_and_leaves_no_reader_in_the_way(
    survey: Survey, folder: Path
) -> None:
    from amulor.acquisition.journal import file as journal_file

    kept: list[Live] = []

    def looked(key: Key) -> None:
        if not kept:
            kept.append(Live(folder))
        if key.column == 2:
            kept[0].look()

    scan(survey, folder, looked)
    before = (folder / FILE_NAME).read_bytes()
    kept[0].look()
    assert (folder / FILE_NAME).read_bytes() == before
    # A reader that holds on would keep the writer's log from being emptied.
    connection = journal_file.writer(folder / FILE_NAME)
    busy, *_ = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    connection.close()
    assert busy == 0
    kept[0].stop()


def test_the_websocket_brings_status_and_rows(
    survey: Survey, folder: Path, served: Callable[..., TestClient]
) -> None:
    scan(survey, folder)
    live = Live(folder)
    client = served(live)
    with client.websocket_connect(f"/{TOKEN}/live", headers=OWN) as socket:
        said = []
        while {"status", "picture"} - {one["type"] for one in said}:
            said.append(json.loads(socket.receive_text()))
    status = next(one for one in said if one["type"] == "status" and one.get("done"))
    assert status["state"] == "finished"
    scene = client.get(f"/{TOKEN}/scene").json()
    assert scene["live"] is True
    live.stop()


def test_a_row_travels_as_numbers_behind_a_head() -> None:
    from amulor.view.page.live import Rows
    from amulor.view.page.server import message_of

    sent = message_of(Rows(1, "VV", 3, {"range": np.array([1.0, 2.0])}))
    (size,) = struct.unpack_from("<I", sent)
    head = json.loads(sent[4 : 4 + size])
    assert head["row"] == 3
    assert (4 + size) % 4 == 0
    assert np.frombuffer(sent, "<f4", offset=4 + size).tolist() == [1.0, 2.0]


@pytest.mark.slow
def test_a_journal_that_breaks_gives_words_and_comes_back(
    survey: Survey, folder: Path
) -> None:
    scan(survey, folder)
    live = Live(folder)
    path = folder / FILE_NAME
    moved = path.with_name("elsewhere")
    path.rename(moved)
    live.look()
    assert "holds no journal" in live.status["error"]
    moved.rename(path)
    live.look()
    live.stop()
    assert "error" not in live.status
    assert live.status["state"] == "finished"
    with pytest.raises(FormatError, match="holds no journal"):
        Live(folder.parent)


def test_a_scan_that_was_looked_at_before_is_followed_by_another_thread(
    survey: Survey, folder: Path
) -> None:
    """`amulor view` looks once before its server runs, and that one follows."""
    scan(survey, folder)
    live = Live(folder)
    live.look()
    first = live._journal
    with ThreadPoolExecutor(1) as other:
        other.submit(live.look).result()
    assert "error" not in live.status
    # By the same connection: none is left open in a thread that is gone.
    assert live._journal is first
    live.stop()


def test_a_scan_is_followed_from_its_start_to_its_stop(
    survey: Survey, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan(survey, folder)
    live = Live(folder)
    looks: list[str] = []
    looked = threading.Event()

    def look() -> None:
        looks.append(threading.current_thread().name)
        looked.set()

    monkeypatch.setattr(live, "look", look)
    live.start()
    live.start()  # a second start changes nothing
    assert looked.wait(10)
    live.stop()
    count = len(looks)
    assert set(looks) == {looks[0]} != {threading.current_thread().name}
    time.sleep(0.05)
    assert len(looks) == count


def test_newer_samples_are_those_after_a_number(survey: Survey, folder: Path) -> None:
    scan(survey, folder)
    with Journal.read(folder) as journal:
        everything = journal.newer(0)
        assert len(everything) == journal.count()
        middle = everything[50][0]
        assert journal.newer(middle) == everything[51:]
        assert journal.newer(everything[-1][0]) == []
        kinds = [(key, record) for _, key, record in everything if key.kind == "dark"]
        assert kinds == [*journal.samples("dark")]


def test_drift_is_found_within_its_error_where_a_channel_sees_no_water(
    survey: Survey,
) -> None:
    """A channel of noise alone, as VH in milk, must not tell that the water changed."""
    rng = np.random.default_rng(7)
    found, errors = [], []
    meta = {"devices": ""}
    (frequency,) = survey.instrument.modulation_frequencies
    for _ in range(300):
        progress = Progress(survey, meta, clock=Clock())
        for channel, size in (("VV", 1.0), ("VH", 0.003)):
            for place in range(6):
                for repeat in range(3):
                    true = size * (1 + 0.02 * repeat) * np.exp(0.7j)
                    noise = 0.003 * (rng.normal() + 1j * rng.normal())
                    record = sample(true + noise, elapsed=float(repeat))
                    key = Key(
                        kind="open_water",
                        frequency=frequency,
                        polarization=channel,
                        row=0,
                        column=place,
                        repeat=repeat,
                    )
                    progress.take(key, record)
        drift = progress.drift()
        found.append((drift.total.size - 0.04 / 1.02) / drift.total.error)
        errors.append(drift.total.error)
    z = np.array(found)
    # 0.003 of noise twice, in six directions; VH adds nothing to it.
    assert_allclose(np.median(errors), 0.003 * (2 / 6) ** 0.5, rtol=0.25)
    # Six directions that count, three rounds: Student's t, and 300 draws.
    assert abs(z.mean()) < 4 / 300**0.5 * z.std()
    assert 0.8 < np.quantile(abs(z), 0.68) < 1.4


BEGUN = {"number": 1, "started": "", "ended": None, "reason": None}


def test_a_scan_without_a_writer_is_stopped_and_a_pause_is_not_in_the_rate(
    survey: Survey,
) -> None:
    (frequency,) = survey.instrument.modulation_frequencies
    clock = Clock()
    progress = Progress(survey, {"devices": ""}, clock=clock)
    planned = progress.total
    keys = iter(
        Key("scan", row, column, frequency, "VV", 0)
        for row in range(3)
        for column in range(8)
    )

    def taken(count: int, *, key: Key | None = None) -> None:
        for _ in range(count):
            clock.now += 0.5
            progress.take(key or next(keys), sample(1j, elapsed=clock.now))
            running.append(progress.status([BEGUN], resume=None))

    running: list[dict[str, object]] = []
    taken(9)
    assert running[-1]["rate"] == pytest.approx(2.0)
    assert running[-1]["row"] == 0
    clock.now += 600
    command = "amulor acquire scan/survey.toml -o scan --resume"
    stopped = progress.status([BEGUN], resume=command)
    assert stopped["state"] == "stopped"
    assert stopped["rate"] is stopped["left"] is None
    assert stopped["advice"][0] == (
        f"stopped (without notice) at 9 of {planned} samples; resume with: {command}"
    )
    assert not any("no sample for" in one for one in stopped["advice"])
    # Ten minutes later it goes on: by a reference, which the plan does not count.
    clock.now += 600
    again = progress.status([BEGUN], resume=None)
    assert again["state"] == "running"
    assert again["resume"] is None
    assert not any("stopped" in one or "no sample" in one for one in again["advice"])
    repeats = survey.scan.open_water.repeats if survey.scan.open_water else 0
    taken(1, key=Key("open_water", 0, 0, frequency, "VV", repeats))
    taken(9)
    assert running[-1]["rate"] == pytest.approx(2.0)
    assert running[-1]["total"] == planned + 1
    assert running[-1]["left"] == round((planned + 1 - 19) / 2)
    assert running[-1]["row"] == 1


@pytest.mark.parametrize(
    ("reason", "held", "state"),
    [
        ("paused", True, "paused"),
        ("paused", False, "stopped"),
        ("the lock-in is silent", False, "stopped"),
        ("finished", True, "finished"),
        ("finished", False, "finished"),
        ("finished; laser: still on", False, "finished; laser: still on"),
    ],
)
def test_a_state_needs_the_end_of_the_last_part_and_the_lock(
    survey: Survey, reason: str, held: bool, state: str
) -> None:
    progress = Progress(survey, {"devices": ""}, clock=Clock())
    ended = {**BEGUN, "ended": "2026-05-04", "reason": reason}
    found = progress.status([ended], resume=None if held else "again")
    assert found["state"] == state
    said = [f"stopped ({reason}) at 0 of {progress.total} samples; resume with: again"]
    assert found["advice"] == (said if state == "stopped" else [])
    assert found["resume"] == ("again" if state == "stopped" else None)


def test_spoiled_shots_and_rounds_that_are_not_whole_tell_nothing_of_the_water(
    survey: Survey,
) -> None:
    (frequency,) = survey.instrument.modulation_frequencies
    progress = Progress(survey, {"devices": ""}, clock=Clock())
    rng = np.random.default_rng(3)
    grid = [(row, column) for row in range(2) for column in range(3)]
    seen = []
    for repeat in range(3):
        for channel in ("VV", "VH"):
            for row, column in grid:
                signal = 1 + 0.01 * rng.normal() + repeat * 0.001j
                record = sample(signal, elapsed=10.0 * repeat)
                if (repeat, row, column) == (1, 0, 2):
                    dark = int(SampleFlag.NO_LIGHT)
                    record = replace(record, in_phase=0.0, flags=dark)
                key = Key("open_water", row, column, frequency, channel, repeat)
                progress.take(key, record)
                seen.append(len(progress.drift().elapsed))
    # Nothing before the second round is whole, then two rounds, then three.
    assert seen == [0] * 23 + [2] * 12 + [3]
    # Without the direction that was dark once, in which the water changed by a third.
    assert np.abs(progress.drift().change).max() < 0.015


GOOD = {"running": True, "done": 500, "scanned": 400, "open_water": 80, "dark": 20}


def test_a_scan_that_goes_well_needs_no_advice() -> None:
    steady = Drift(total=Change(size=0.004, error=0.01, chance=0.7))
    assert advice(Going(**GOOD, rate=8.0, silent=0.2, drift=steady)) == []


@pytest.mark.parametrize(
    ("size", "error", "chance", "said"),
    [
        (0.04, 0.005, 1e-6, ["+4.0 % (± 0.5 %): take a reference"]),
        (-0.134, 0.021, 1e-4, ["-13.4 % (± 2.1 %): take a reference"]),
        (0.04, 0.02, 0.2, []),
        (0.015, 0.001, 1e-9, []),
        (0.5, float("inf"), 1.0, []),
    ],
)
def test_drift_is_worth_a_reference_if_it_is_sure(
    size: float, error: float, chance: float, said: list[str]
) -> None:
    change = Change(size=size, error=error, chance=chance)
    for drift, words in (
        (Drift(total=change), "open water drifted"),
        (Drift(newest=change), "the newest shots of open water jumped"),
        (Drift(total=change, newest=change), "open water drifted"),
    ):
        found = advice(Going(**GOOD, drift=drift))
        assert found == [f"{words} {one}" for one in said]


def test_flags_silence_and_missing_references_are_told() -> None:
    found = advice(
        Going(
            running=True,
            done=500,
            scanned=400,
            open_water=0,
            dark=0,
            flagged={"overload": 25, "off position": 2},
            rate=2.0,
            silent=60.0,
        )
    )
    assert "no sample for 60 s" in found[0]
    assert found[1].startswith("5% of the samples overload")
    assert "no open-water shots" in found[2]
    assert "no dark readings" in found[3]
    assert len(found) == 4


def test_the_websocket_stays_open_beyond_the_limits_of_requests(
    survey: Survey, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "_HEADER_TIME", 0.2)
    monkeypatch.setattr(server, "_BODY_TIME", 0.2)
    monkeypatch.setenv("no_proxy", "*")
    scan(survey, folder)
    live = Live(folder)
    with page.background(live) as address:
        url = f"{address.replace('http', 'ws', 1)}live"
        origin = Origin(address.rsplit("/", 2)[0])
        with connect(url, origin=origin) as socket:
            assert json.loads(socket.recv(20))["type"] in ("status", "picture")
            time.sleep(0.5)
            assert socket.ping().wait(20)
            assert socket.close_code is None
    live.stop()


def test_a_row_comes_with_the_water_and_without_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken: dict[str, np.ndarray] = {}

    def noted(row: xr.Dataset, signal: np.ndarray, ending: str) -> dict[str, object]:
        taken[ending] = signal
        return {}

    monkeypatch.setattr(live_module, "quick_layers", noted)
    measured = np.array([[3.0 + 4.0j, 1.0 - 1.0j]])
    place = ("modulation_frequency", "row", "column")
    water = xr.Dataset(
        {
            "water_in_phase": (place, np.array([[[0.5, 0.25]]])),
            "water_quadrature": (place, np.array([[[2.0, -3.0]]])),
        }
    )
    rows = {0: water, 1: water[[]], 2: None}
    followed = SimpleNamespace(
        recording=SimpleNamespace(one_row=lambda channel, row: rows[row]),
        _progress=SimpleNamespace(row_signal=lambda channel, row: measured),
    )
    assert Live._quick(cast(Live, followed), "VV", 0) == {}
    assert_allclose(taken.pop("_before"), measured)
    assert_allclose(taken.pop(""), [[2.5 + 2.0j, 0.75 + 2.0j]])
    Live._quick(cast(Live, followed), "VV", 1)
    assert list(taken) == ["_before"]
    taken.clear()
    assert Live._quick(cast(Live, followed), "VV", 2) == {}
    assert not taken
