"""Parts of an acquisition run: writer, reach, strips, messages, end, next step."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from given_journals import key, record
from logged_devices import logged_devices, step

from amulor.acquisition import plan, run
from amulor.acquisition.run import Keeper, refuse_beyond_reach, refuse_unlike_vehicle
from amulor.acquisition.settings import Settings
from amulor.errors import FormatError, InstrumentError, SurveyError
from amulor.survey import Survey
from amulor.survey.directions import open_water_directions, scan_directions


class Kept:
    """A journal that notes what is committed, and its end."""

    folder = Path("a scan")

    def __init__(self) -> None:
        self.commits: list[Any] = []
        self.ended: list[Any] = []
        self.parts: list[dict[str, Any]] = []
        self.wrong: Exception | None = None

    def commit_together(self, samples: Any, messages: Any = ()) -> None:
        if self.wrong is not None:
            raise self.wrong
        self.commits.append(([*samples], [*messages]))

    def end_segment(self, number: int, reason: str) -> None:
        self.ended.append((number, reason))

    def segments(self) -> list[dict[str, Any]]:
        return self.parts

    def last_elapsed(self) -> float:
        return 0.0

    def keys(self) -> set[Any]:
        return set()

    def samples(self, kind: str) -> list[Any]:
        return []


@pytest.mark.parametrize(("took", "at_once"), [(0.0, False), (1.0, True), (1.0, False)])
def test_a_slow_disk_writes_beside_the_next_dwell(monkeypatch, took, at_once) -> None:
    monkeypatch.setattr(run, "SLOW", 0.3e-3)
    kept, told = Kept(), []
    with Keeper(kept, lambda *given: told.append(given), at_once=at_once) as keeper:
        keeper._took = took
        keeper.keep(step(), [record()], [(1.0, "a pose")])
        beside = took > 0 and not at_once
        assert len(told) == (0 if beside else 1)
        keeper.settle()
        assert told == [(step(), 1)]
        keeper.settle()
        assert len(told) == 1
        keeper.keep(step(column=4), [record()])
    assert [messages for _, messages in kept.commits] == [[(1.0, "a pose")], []]
    assert kept.commits[0][0] == [(step().key, record())]
    # A tenth of the newest commit counts.
    assert keeper._took == pytest.approx(0.81 * took, abs=0.01)


def test_a_commit_that_fails_is_told_once(monkeypatch) -> None:
    monkeypatch.setattr(run, "SLOW", 0.3e-3)
    kept, told = Kept(), []
    kept.wrong = FormatError("the disk is full")
    with Keeper(kept, lambda *given: told.append(given), at_once=False) as keeper:
        keeper._took = 1.0
        keeper.keep(step(), [record()])
        with pytest.raises(FormatError, match="the disk is full"):
            keeper.settle()
        keeper.settle()
    assert told == []


def asked_of(survey: Survey, **settings: Any) -> dict[str, Any]:
    asked: dict[str, Any] = {}

    def limited(name: str) -> Any:
        return SimpleNamespace(
            refuse_beyond_reach=lambda *places: asked.update({name: places})
        )

    devices = SimpleNamespace(
        **{name: limited(name) for name in ("scanner", "launch", "analyser", "target")}
    )
    refuse_beyond_reach(survey, Settings.model_validate(settings), devices)
    return asked


def test_stages_are_asked_for_all_their_places(small: Survey) -> None:
    asked = asked_of(small)
    azimuth, elevation, _ = scan_directions(small)
    shots = open_water_directions(small)
    across = np.concatenate([azimuth.ravel(), shots[0]])
    up = np.concatenate([elevation.ravel(), shots[1]])
    ends = [across.min(), across.max()], [up.min(), up.max()]
    assert asked["scanner"] == ends
    assert asked["launch"] == ([0.0, 0.0],)
    assert asked["analyser"] == ([0.0, math.pi / 2],)
    assert asked["target"] == ()
    # Without shots the target stays; the standing reference is met, too.
    still = small.with_(
        {
            "scan.open_water": None,
            "scan.reference": {
                "azimuth": "30 deg", "elevation": "-20 deg", "amplitude": "20 mV"
            },
            "instrument.polarizations": ["none"],
        }
    )  # fmt: skip
    asked = asked_of(still)
    assert set(asked) == {"scanner"}
    (low, high), (down, top) = asked["scanner"]
    assert low == azimuth.min()
    assert high == pytest.approx(math.radians(30))
    assert down == pytest.approx(math.radians(-20))
    assert top == elevation.max()
    # States without an angle are no question.
    assert "launch" not in asked_of(small, launch={"angles": {"P": "1 deg"}})


def test_a_vehicle_needs_a_fitting_procedure(small: Survey) -> None:
    refuse_unlike_vehicle(small, Settings(), retake=True)
    source = Settings.model_validate(
        {name: {"driver": "none"} for name in ("launch", "analyser", "target")}
        | {
            "lock_in": {"driver": "sr844", "address": "a"},
            "scanner": {"driver": "pi_gcs", "address": "b"},
            "laser": {"driver": "lock_in_output"},
            "navigation": {"address": "c", "crs": "EPSG:32632"},
        }
    )
    course = {"kind": "line", "start": [0, 0, -8], "speed": 0.5}
    moving = small.with_({"platform": {"course": course}, "scan.open_water": None})
    once = moving.with_({"platform.readings": "at-once"})
    refuse_unlike_vehicle(moving, Settings(), retake=False)
    single = once.with_({"instrument.polarizations": ["VV"]})
    refuse_unlike_vehicle(single, Settings(), retake=False)
    for survey, settings, retake, text in (
        (
            small, source, False,
            "platform: is missing, but the devices file has a part navigation; state "
            "course and mounting in [platform], or take the part out",
        ),
        (
            once, Settings(), False,
            'platform.readings: is "at-once", but 2 readings of a pixel follow one '
            "another by the devices file; state procedure.frequencies_at_once = 1 "
            "there and one polarization here, or platform.readings = \"in-turn\"",
        ),
        (
            moving, Settings(), True,
            "platform: the vehicle has moved on, so that samples cannot be acquired "
            "again; leave out --retake-flagged",
        ),
    ):  # fmt: skip
        with pytest.raises(SurveyError) as caught:
            refuse_unlike_vehicle(survey, settings, retake=retake)
        assert str(caught.value) == text


def test_a_command_resumes_a_folder_with_any_name() -> None:
    assert run.resume_command(Path("my scan")) == (
        "amulor acquire 'my scan/survey.toml' -o 'my scan' --resume"
    )


def test_devices_that_stay_unsafe_are_in_the_message() -> None:
    unsafe = SimpleNamespace(make_safe=lambda: ["laser is on", "stage moves"])
    with (
        pytest.raises(InstrumentError, match=r"^laser is on; stage moves; it broke$"),
        run._left_safe(unsafe),
    ):
        raise InstrumentError("it broke")
    with pytest.raises(KeyError) as caught, run._left_safe(unsafe):
        raise KeyError("it broke")
    assert caught.value.__notes__ == ["laser is on; stage moves"]
    safe = SimpleNamespace(make_safe=list)
    with pytest.raises(InstrumentError, match=r"^it broke$"), run._left_safe(safe):
        raise InstrumentError("it broke")


def run_of(small: Survey, settings: Any = None, **devices: Any):
    log: list[Any] = []
    made = dataclasses.replace(logged_devices(log), **devices)
    kept = Kept()
    content = Settings.model_validate(settings or {})
    return run._Run(
        small, content, made, kept, retake=False, shutter_closed=False
    ), kept, made  # fmt: skip


def test_strips_are_single_dwells_or_up_to_20_s(small: Survey) -> None:
    steps = [step(column=k) for k in range(30)]

    def lengths(dwell: str, **procedure: Any) -> list[int]:
        survey = small.with_({"scan.dwell": dwell})
        made, _, _ = run_of(survey, {"procedure": procedure})
        return [len(strip) for strip in made._strips(steps)]

    assert lengths("50 ms") == [1] * 30
    made, _, _ = run_of(small)
    made._settings = SimpleNamespace(procedure=SimpleNamespace(mode="continuous"))
    for dwell, expected in ((1.0, [20, 10]), (0.9, [22, 8]), (7.0, [4] * 7 + [2])):
        made._survey = small.with_({"scan.dwell": dwell})
        assert [len(strip) for strip in made._strips(steps)] == expected


def test_messages_are_timed_by_the_scan(small: Survey) -> None:
    texts = iter([[(5.0, "a"), (6.0, "b")], [], [(9.0, "c")] * 9])
    navigation = SimpleNamespace(
        messages=lambda: next(texts), make_safe=lambda: None, begin=lambda: None
    )
    made, _, devices = run_of(small, navigation=navigation)
    made._clock_start, made._elapsed = 3.0, 100.0
    assert made._messages() == [(102.0, "a"), (103.0, "b")]
    devices.clock.sleep(4.0)
    # Nine messages after the last sample at 101 s end the wait.
    messages = made._last_messages()
    assert messages == [(106.0, "c")] * 9
    assert devices.clock.now() == pytest.approx(4.05)
    still, _, _ = run_of(small)
    assert still._messages() == still._last_messages() == []


def test_the_wait_for_the_last_poses_ends_after_two_seconds(small: Survey) -> None:
    navigation = SimpleNamespace(messages=lambda: [(1.0, "old")], make_safe=list)
    made, _, devices = run_of(small, navigation=navigation)
    devices.clock.sleep(4.0)
    made._last_messages()
    assert devices.clock.now() == pytest.approx(6.0, abs=0.051)


def test_the_end_makes_safe_and_keeps_the_last_messages(small: Survey) -> None:
    navigation = SimpleNamespace(
        messages=lambda: [(1.0, "pose")], make_safe=lambda: None
    )
    made, kept, _ = run_of(small, navigation=navigation)
    keeper = SimpleNamespace(settle=lambda: None)
    unsafe = made._end(3, "paused", keeper)
    # The logged devices have no safe state, the navigation has one.
    assert len(unsafe) == 6
    assert unsafe[0].startswith("laser could not be made safe, see to it by hand: ")
    assert kept.commits == [([], [(1.0, "pose")])]
    assert kept.ended == [(3, "; ".join(["paused", *unsafe]))]

    def broken() -> None:
        raise FormatError("the disk is full")

    made._end(4, "stopped", SimpleNamespace(settle=broken))
    assert kept.ended[-1][0] == 4
    kept.wrong = FormatError("the disk is full")
    made._end(5, "stopped", keeper)
    assert kept.ended[-1][0] == 5
    silent, kept, _ = run_of(small)
    silent._end(1, "finished", keeper)
    assert kept.commits == []


def test_a_failure_says_what_is_kept_and_how_to_go_on(small: Survey) -> None:
    made, _, _ = run_of(small)
    made._done = {key(), key(column=1)}
    assert made._with_next_step(InstrumentError("it broke")) == (
        "it broke; 2 samples are kept in a scan. Mend it, then go on with: amulor "
        "acquire 'a scan/survey.toml' -o 'a scan' --resume"
    )


def test_progress_counts_samples_and_the_time_that_is_left(
    small: Survey, monkeypatch
) -> None:
    made, _, _ = run_of(small)
    now = [100.0]
    monkeypatch.setattr(run.time, "monotonic", lambda: now[0])
    made._begin_to_count()
    made._done = {key(column=k) for k in range(4)}
    made._taken, made._flagged = 2, 3
    now[0] = 104.0
    progress = made._progress(step(plan.DARK), 14)
    assert vars(progress) == {
        "done": 4, "total": 14, "rate": 0.5, "left": 20.0, "flagged": 3, "kind": "dark"
    }  # fmt: skip


def test_a_resumed_scan_on_a_vehicle_counts_the_break(small: Survey) -> None:
    made, kept, _ = run_of(small)
    kept.parts = [{"started": "2026-01-01T00:00:00.000000Z"}]
    assert made._passed() == 0.0
    made._settings = SimpleNamespace(simulated=False, navigation=None)
    assert made._passed() == 0.0
    made._settings = SimpleNamespace(simulated=False, navigation=object())
    began = run.datetime.datetime(2026, 1, 1, tzinfo=run.datetime.UTC)
    passed = (run.datetime.datetime.now(run.datetime.UTC) - began).total_seconds()
    assert made._passed() == pytest.approx(passed, abs=10)
    kept.parts = []
    assert made._passed() == 0.0


def test_references_are_repeated_once_the_scan_began(small: Survey) -> None:
    made, _, _ = run_of(small, {"procedure": {"dark_readings": 1}})
    assert [*made._again(3)] == []
    made._done = {key(plan.DARK)}
    assert [*made._again(3)] == []
    made._done = {key(plan.SCAN)}
    again = [found.key.repeat for found in made._again(3)]
    expected = [
        found.key.repeat
        for found in plan.extra_reference(small, made._settings.procedure, number=1)
    ]
    assert again == expected
    assert again[0] == 3


def test_copies_are_written_once(tmp_path) -> None:
    kept = SimpleNamespace(
        folder=tmp_path, meta=lambda: {"survey": "one\n", "devices": "two\n"}
    )
    (tmp_path / "devices.toml").write_text("mine\n")
    run._keep_copies(kept)
    assert (tmp_path / "survey.toml").read_text() == "one\n"
    assert (tmp_path / "devices.toml").read_text() == "mine\n"
    assert run._in_step(SimpleNamespace(in_step=True))
    assert not run._in_step(object())
