"""The device of a plan by a scan that is driven step by step, without any engine."""

from __future__ import annotations

import asyncio
import threading
from types import SimpleNamespace
from typing import Any

import pytest
from given_journals import journal_of, key, record

from amulor.acquisition import bluesky
from amulor.acquisition.bluesky import ScanDevice, _Status
from amulor.acquisition.journal.documents import data_keys
from amulor.acquisition.plan import DARK, SCAN
from amulor.acquisition.run import Outcome
from amulor.acquisition.settings import Settings
from amulor.errors import InstrumentError


def device_of(small: Any, folder: Any, **more: Any) -> ScanDevice:
    return ScanDevice(small, folder, patience=more.pop("patience", 5.0), **more)


def test_a_status_is_resolved_once_and_tells_its_callbacks() -> None:
    status, told = _Status(), []
    status.add_callback(told.append)
    assert (status.done, status.success, status.exception()) == (False, False, None)
    status.resolve(None)
    status.resolve(ValueError("late"))
    assert (status.done, status.success, status.exception()) == (True, True, None)
    status.add_callback(told.append)
    assert told == [status, status]
    failed = _Status()
    error = ValueError("it broke")
    failed.resolve(error)
    assert (failed.done, failed.success) == (True, False)
    assert failed.exception(1.0) is error


def test_samples_are_those_of_the_journal_by_number(small, folder) -> None:
    device = device_of(small, folder)
    entries = [(key(DARK), record(1 + 2j)), (key(SCAN, 1, 2), record(3j))]
    with journal_of(folder, small, entries) as journal:
        first, second = device.set(1), device.set(2)
        assert not first.done
        device._note_samples(None)
        assert first.success
        assert second.success
        assert device.stream == SCAN
        found = device.read()
        assert found["quadrature"]["value"] == 3.0
        assert found["row"]["value"] == 1
        assert found["quadrature"]["timestamp"] > 1e9
        assert found.keys() == device.describe().keys() == data_keys().keys()
        assert device.hints == {"fields": ["in_phase", "quadrature"]}
        # A number that is set again is there still.
        assert device.set(2).success
        assert device._samples.keys() == {2}
        third = device.set(3)
        assert not third.done
        journal.commit(key(SCAN, 1, 3), record(4j))
        device._note_samples(None)
        assert third.success
        assert device.read()["column"]["value"] == 3
    assert not device.finished_before(4)
    device._ended = True
    assert device.finished_before(4)
    assert not device.finished_before(3)
    about = device.about()
    assert about == {
        "plan_name": "amulor_scan",
        "detectors": ["lock_in"],
        "motors": ["azimuth", "elevation"],
        "survey": small.to_toml(),
        "identities": {"lock_in": "a lock-in"},
        "folder": str(folder),
        "resumed": False,
    }
    device._journal.close()


def test_the_scan_waits_for_the_next_number(small, folder) -> None:
    device = device_of(small, folder, patience=0.01)
    assert not device._ready.done
    # Nobody asks in time: the light goes out.
    assert device.pause_wanted()
    assert device._ready.success
    device.set(1)
    assert not device.pause_wanted()
    device._acquired = 1
    assert device.pause_wanted()
    device.set(2)
    device._pause_requested = True
    assert device.pause_wanted()
    # A new number ends the pause.
    device.set(2)
    assert not device._pause_requested
    assert device.go_on()
    assert not device._paused
    device._end_requested = True
    assert device.pause_wanted()
    assert not device.go_on()


def test_a_pause_lasts_until_a_sample_is_missing(small, folder) -> None:
    device = device_of(small, folder)
    device._acquired, device._requested = 1, 1
    answers: list[bool] = []
    thread = threading.Thread(target=lambda: answers.append(device.go_on()))
    thread.start()
    device._wait_for_pause()
    asyncio.run(device.stop())
    assert device._pause_requested
    assert answers == []
    device.set(2)
    thread.join(5.0)
    assert answers == [True]


def test_a_scan_runs_from_stage_to_unstage(small, folder) -> None:
    device = device_of(small, folder)
    begun = threading.Event()

    def run() -> Outcome:
        begun.set()
        assert device.pause_wanted()
        return Outcome(finished=False, done=0, total=9, flagged=0, unsafe=[])

    device._run = run
    ready = device.stage()
    with pytest.raises(InstrumentError) as caught:
        device.stage()
    assert str(caught.value) == (
        "this scan was staged before; make another one, with resume=True"
    )
    assert begun.wait(5.0)
    over = device.unstage()
    over.exception(5.0)
    assert ready.success
    assert over.success
    device._thread.join(5.0)
    # What is asked for after the end is over at once, without a sample.
    late = device.set(1)
    assert late.success
    assert device.finished_before(1)
    never = device_of(small, folder)
    assert never.unstage().success
    asyncio.run(never.stop())


def test_errors_of_a_scan_reach_those_who_wait(small, folder) -> None:
    device = device_of(small, folder)
    error = InstrumentError("it broke")

    def run() -> Outcome:
        raise error

    device._run = run
    waiting = device.set(1)
    ready = device.stage()
    assert ready.exception(5.0) is error
    device._thread.join(5.0)
    assert waiting.exception() is error
    assert device._over.success
    unsafe = device_of(small, folder)
    unsafe._run = lambda: SimpleNamespace(unsafe=["laser is on", "stage moves"])
    unsafe.stage()
    unsafe._thread.join(5.0)
    assert str(unsafe._over.exception(5.0)) == "laser is on; stage moves"


def test_a_resumed_scan_counts_from_its_last_sample(small, folder) -> None:
    entries = [(key(DARK), record(1)), (key(SCAN), record(2))]
    with journal_of(folder, small, entries) as journal:
        resumed = device_of(small, folder, resume=True)
        assert resumed.in_step

        def run() -> Outcome:
            journal.commit(key(SCAN, 0, 1), record(5))
            resumed._note_samples(None)
            return Outcome(finished=True, done=3, total=3, flagged=0, unsafe=[])

        resumed._run = run
        resumed.set(1)
        resumed.stage()
        resumed._thread.join(5.0)
        assert resumed._acquired == 1
        assert resumed.read()["in_phase"]["value"] == 5
        assert resumed.about()["resumed"]


def test_a_moving_beam_cannot_wait_for_a_plan(small, folder) -> None:
    procedure = {"mode": "continuous", "output_filter": "known", "readings": "buffer"}
    settings = Settings.model_validate({"procedure": procedure})
    with pytest.raises(InstrumentError) as caught:
        ScanDevice(small, folder, settings=settings)
    assert str(caught.value) == (
        "a plan waits for each sample before the next one, and the beam cannot move on "
        'without stops; take procedure.mode = "continuous" out of the devices file, or '
        "run the scan by 'amulor acquire'"
    )
    assert bluesky._PATIENCE == 10.0
