"""Whatever happens to a scan, light is off, data are kept, and somebody is told."""

from __future__ import annotations

import dataclasses
import os
from types import SimpleNamespace
from typing import Any, cast

import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition import connect as connecting
from amulor.acquisition import plan, run
from amulor.acquisition.connect import OperatorTargetStage, connect
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.errors import FormatError, InstrumentError, SurveyError


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ("lost-link@30", "link is lost"),
        ("timeout@30", "does not answer in time"),
        ("unlock@30x99", "lost its reference in 4 samples"),
        ("stuck@30x99999", "has not come to where it was sent"),
        ("saturation@30x99", "6 samples in a row are overloaded"),
        ("overload@30x99", "6 samples in a row are overloaded"),
    ],
)
def test_a_fault_pauses_keeps_the_data_and_tells_the_next_step(
    small, settings, folder, fault, text, made, safe
) -> None:
    own = made(
        settings, simulation={"faults": [fault]}, procedure={"patience": 5},
    )  # fmt: skip
    devices = connect(small, own, scene=scene_light)
    told: list[plan.Key] = []
    with pytest.raises(InstrumentError, match=text) as caught:
        acquisition.acquire(
            small, folder, settings=own, devices=devices, acknowledged=told.append
        )
    assert safe(devices)
    assert f"{len(told)} samples are kept in {folder}" in str(caught.value)
    assert "--resume" in str(caught.value)
    assert "\n" not in str(caught.value)
    with Journal.read(folder) as journal:
        assert journal.keys() == {*told}
        (part,) = journal.segments()
    assert text in part["reason"]
    # The fault was in the simulated devices, not in what makes up the instrument.
    whole = acquisition.acquire(
        small,
        folder,
        settings=made(own, simulation={"faults": []}),
        resume=True,
        scene=scene_light,
    )
    assert whole.finished


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, MemoryError])
def test_devices_are_safe_after_any_exception(
    small, settings, folder, error, safe
) -> None:
    devices = connect(small, settings, scene=scene_light)

    def fail(key: plan.Key) -> None:
        if key.kind == SCAN:
            raise error

    with pytest.raises(error):
        acquisition.acquire(
            small, folder, settings=settings, devices=devices, acknowledged=fail
        )
    assert safe(devices)
    with Journal.read(folder) as journal:
        assert error.__name__ in journal.segments()[0]["reason"]


def test_one_device_that_cannot_be_made_safe_does_not_keep_the_others(
    small, settings, folder, monkeypatch
) -> None:
    devices = connect(small, settings, scene=scene_light)

    def refuse() -> None:
        raise InstrumentError("it does not listen")

    monkeypatch.setattr(devices.scanner, "make_safe", refuse)
    outcome = acquisition.acquire(small, folder, settings=settings, devices=devices)
    assert outcome.unsafe == [
        "scanner could not be made safe, see to it by hand: it does not listen"
    ]
    assert not devices.lock_in.bench.laser_on
    assert devices.lock_in.log[-1] == "safe"


@pytest.mark.parametrize("error", [KeyboardInterrupt, InstrumentError("no answer")])
def test_whoever_ends_a_scan_is_told_that_the_laser_may_be_on(
    small, settings, folder, monkeypatch, error
) -> None:
    devices = connect(small, settings, scene=scene_light)

    def refuse() -> None:
        raise InstrumentError("it does not listen")

    def fail(key: plan.Key) -> None:
        monkeypatch.setattr(devices.laser, "make_safe", refuse)
        raise error

    with pytest.raises((KeyboardInterrupt, InstrumentError)) as caught:
        acquisition.acquire(
            small, folder, settings=settings, devices=devices, acknowledged=fail
        )
    told = "\n".join([str(caught.value), *getattr(caught.value, "__notes__", ())])
    assert "laser could not be made safe, see to it by hand" in told
    with Journal.read(folder) as journal:
        assert "laser could not be made safe" in journal.segments()[0]["reason"]


def test_a_pause_in_which_the_laser_stays_on_ends_the_scan(
    small, settings, folder, monkeypatch, Stop
) -> None:
    devices = connect(small, settings, scene=scene_light)

    def refuse() -> None:
        raise InstrumentError("it does not listen")

    monkeypatch.setattr(devices.laser, "make_safe", refuse)
    control = Stop(30, go_on=True)
    outcome = acquisition.acquire(
        small, folder, settings=settings, devices=devices, control=control
    )
    # "Laser off" would not have been true.
    assert control.asked == 0
    assert (outcome.finished, outcome.done) == (False, 30)
    assert "laser" in outcome.unsafe[0]


def test_a_scan_that_is_refused_touches_no_device(
    small, settings, folder, monkeypatch, Stop
) -> None:
    devices = connect(small, settings, scene=scene_light)

    class Second(Stop):
        """Begins the same scan twice more while the first one is in the middle."""

        def pause_wanted(self) -> bool:
            if super().pause_wanted():
                before = {name: [*device.log] for name, device in devices.all()}
                for resume in (False, True):
                    with pytest.raises(FormatError, match="another program"):
                        acquisition.acquire(
                            small, folder, settings=settings, devices=devices,
                            resume=resume,
                        )  # fmt: skip
                now = {name: device.log for name, device in devices.all()}
                assert now == before
                assert devices.lock_in.bench.laser_on
                self.asked += 1
            return False

    control = Second(30, go_on=True)
    outcome = acquisition.acquire(
        small, folder, settings=settings, devices=devices, control=control
    )
    assert (outcome.finished, control.asked) == (True, 1)

    def connected(*_, **__):
        pytest.fail("devices were connected before the folder was looked at")

    monkeypatch.setattr(run, "connect", connected)
    with pytest.raises(FormatError, match="holds a scan already"):
        acquisition.acquire(small, folder, settings=settings, scene=scene_light)
    other = small.model_copy(update={"name": "Another one"})
    with pytest.raises(SurveyError, match="another survey"):
        acquisition.acquire(
            other, folder, settings=settings, resume=True, scene=scene_light
        )
    with pytest.raises(FormatError, match="leave out --resume"):
        acquisition.acquire(
            small, folder / "typo", settings=settings, resume=True, scene=scene_light
        )
    assert not (folder / "typo").exists()


def test_nobody_is_asked_into_the_beam_with_the_laser_on(
    small, settings, folder, made
) -> None:
    simulated = connect(small, settings, scene=scene_light)
    bench, asked = simulated.lock_in.bench, []

    def ask(text: str) -> None:
        asked.append(text)
        assert not bench.laser_on

    devices = dataclasses.replace(simulated, target=OperatorTargetStage(ask))
    own = made(settings, target={"driver": "operator"}, laser={"warm_up": 0.5})
    seen: set[tuple[str, bool]] = set()

    def note(key: plan.Key) -> None:
        seen.add((key.kind, bench.laser_on))

    acquisition.acquire(small, folder, settings=own, devices=devices, acknowledged=note)
    # Out before the scan, in for it, out after it.
    assert ["out" in text for text in asked] == [True, False, True]
    assert seen == {("dark", False), ("open_water", True), ("scan", True)}


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="permissions of another kind")
def test_a_folder_that_cannot_be_written_is_told_before_light_goes_on(
    small, settings, folder
) -> None:
    blocked = folder / "file"
    blocked.write_text("no folder")
    devices = connect(small, settings, scene=scene_light)
    with pytest.raises(FormatError, match="cannot be made"):
        acquisition.acquire(small, blocked, settings=settings, devices=devices)
    assert "on" not in devices.laser.log


def test_a_journal_that_can_no_longer_be_written_ends_the_scan_safely(
    small, settings, folder, monkeypatch, safe
) -> None:
    devices = connect(small, settings, scene=scene_light)
    commit = Journal.commit

    def full(journal: Journal, key, record) -> None:
        if journal.count() >= 20:
            journal._connection.execute("PRAGMA query_only = ON")
        commit(journal, key, record)

    monkeypatch.setattr(Journal, "commit", full)
    with pytest.raises(FormatError, match=r"20 samples are kept .* --resume"):
        acquisition.acquire(small, folder, settings=settings, devices=devices)
    assert safe(devices)
    monkeypatch.undo()
    assert acquisition.acquire(
        small, folder, settings=settings, resume=True, scene=scene_light
    ).finished


def test_the_link_of_a_laser_that_does_not_answer_is_closed(monkeypatch) -> None:
    closed = []

    def silent(*_: object) -> None:
        raise InstrumentError("no answer")

    link = SimpleNamespace(close=lambda: closed.append(True))
    monkeypatch.setattr(connecting, "linked", lambda part: link)
    monkeypatch.setattr(connecting, "ScpiLaser", silent)
    settings: Any = SimpleNamespace(laser=SimpleNamespace(driver="scpi"))
    with pytest.raises(InstrumentError, match="no answer"):
        connecting._laser(settings, cast(Any, None), cast(Any, None))
    assert closed == [True]
