"""The sampler by devices that log what they are told: order, waits, records."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from logged_devices import (
    FREQUENCY,
    Logged,
    reading,
    sampler,
    step,
    words,
)

from amulor.acquisition import sampler as samplers
from amulor.acquisition.devices import Devices
from amulor.acquisition.dwell import Dwell
from amulor.acquisition.plan import (
    DARK,
    OPEN_WATER,
    REFERENCE,
    SCAN,
    SHUTTER,
    Key,
    Step,
)
from amulor.acquisition.protocols import Overload
from amulor.acquisition.sampler import SampleFlag, Sampler
from amulor.acquisition.sweep import Swept
from amulor.errors import InstrumentError
from amulor.survey import Survey


def test_a_dwell_configures_what_differs_then_reads_once(small, devices, log) -> None:
    made = sampler(small, devices)
    (record,) = made.take(step(), elapsed=7.0, segment=3)
    # The survey has a time constant of 10 ms, and 5 of them are waited.
    assert log == [
        ("lock_in.set_frequency", FREQUENCY, 10.0),
        ("launch.rotate", 0.0, 30.0),
        ("analyser.rotate", math.pi / 2, 30.0),
        ("target.bring_in", 60.0),
        ("laser.on",),
        ("sleep", 0.0),
        ("scanner.move", 0.1, -0.2, 30.0),
        ("sleep", 0.05),
        ("lock_in.read",),
        ("laser.check",),
        ("lock_in.full_scale",),
    ]
    assert vars(record) == {
        "in_phase": 0.5, "quadrature": -1.0, "mean": 0.25, "readings": 1,
        "interval": None, "spread": None, "edge": None, "full_scale": 2.0, "flags": 0,
        "commanded_azimuth": 0.1, "commanded_elevation": -0.2, "azimuth": 0.1,
        "elevation": -0.2, "modulation_frequency": FREQUENCY, "elapsed": 7.0,
        "begin": pytest.approx(7.03), "duration": pytest.approx(0.02), "segment": 3,
        "launch": 1e-3, "analyser": math.pi / 2, "target": 0.01,
        "laser_current": None, "laser_temperature": None,
    }  # fmt: skip
    del log[:]
    made.take(step(column=3), elapsed=8.0, segment=3)
    assert words(log)[:2] == ["scanner.move", "sleep"]
    # After that all are configured again.
    made.forget()
    del log[:]
    made.take(step(), elapsed=9.0, segment=3)
    assert words(log)[:3] == [
        "lock_in.set_frequency",
        "launch.rotate",
        "analyser.rotate",
    ]


def test_a_window_before_the_scan_begins_with_it(small, devices) -> None:
    (record,) = sampler(small, devices).take(step(), elapsed=-0.04, segment=1)
    assert record.begin == 0.0


def test_light_is_off_for_dark_readings_and_awaited(small, devices, log) -> None:
    settings = {"laser": {"warm_up": "3 s"}}
    made = sampler(small, devices, settings)
    made.take(step(DARK), elapsed=0.0, segment=1)
    assert words(log) == [
        "lock_in.set_frequency", "launch.rotate", "analyser.rotate", "laser.off",
        "sleep", "scanner.move", "sleep", "lock_in.read", "lock_in.full_scale",
    ]  # fmt: skip
    # Ten time constants until the output has no echo.
    assert [entry[1] for entry in log if entry[0] == "sleep"] == [0.1, 0.05]
    del log[:]
    made.take(step(OPEN_WATER), elapsed=0.0, segment=1)
    assert [entry for entry in log if entry[0] != "scanner.move"][:4] == [
        ("target.take_out", 60.0), ("laser.on",), ("sleep", 3.0), ("sleep", 0.05)
    ]  # fmt: skip
    del log[:]
    # A reference is where the target is; open water needs it out once.
    for kind in (OPEN_WATER, REFERENCE, OPEN_WATER):
        made.take(step(kind), elapsed=0.0, segment=1)
    assert not {"target.take_out", "target.bring_in", "laser.on"} & {*words(log)}
    made.take(step(SCAN), elapsed=0.0, segment=1)
    assert ("target.bring_in", 60.0) in log


def with_shutter(devices: Devices, log: list[Any]) -> Devices:
    return dataclasses.replace(
        devices, shutter=Logged("shutter", log, shut=None, open=None)
    )


def test_a_shutter_is_closed_for_its_readings(small, devices, log) -> None:
    shuttered = with_shutter(devices, log)
    made = sampler(small, shuttered, {"shutter": {"driver": "simulated"}})
    moves = ("shutter.shut", "shutter.open", "laser.on", "laser.off")
    for kind, expected in (
        (SCAN, ["shutter.open", "laser.on"]), (SHUTTER, ["shutter.shut"]),
        (SHUTTER, []), (DARK, ["laser.off"]), (SCAN, ["shutter.open", "laser.on"]),
    ):  # fmt: skip
        del log[:]
        made.take(step(kind), elapsed=0.0, segment=1)
        assert [word for word in words(log) if word in moves] == expected
        if kind == SHUTTER and expected:
            shut = words(log).index("shutter.shut")
            assert log[shut + 1] == ("sleep", 0.1)
    # A scan with a closed shutter keeps it closed.
    del log[:]
    closed = sampler(small, shuttered, shutter_closed=True)
    closed.take(step(SCAN), elapsed=0.0, segment=1)
    assert "shutter.shut" in words(log)


def test_an_operator_reaches_into_no_beam(small, devices, log) -> None:
    shuttered = with_shutter(devices, log)
    settings = {
        "shutter": {"driver": "operator"}, "target": {"driver": "operator"}
    }  # fmt: skip
    made = sampler(small, shuttered, settings)
    for kind in (SCAN, SHUTTER, SCAN, OPEN_WATER):
        made.take(step(kind), elapsed=0.0, segment=1)
    lit = False
    for word in words(log):
        lit = {"laser.on": True, "laser.off": False}.get(word, lit)
        if word in ("shutter.shut", "shutter.open", "target.take_out"):
            assert not lit
    assert words(log).count("laser.on") == 4


def test_a_source_modulates_in_place_of_the_lock_in(small, devices, log) -> None:
    source = Logged("source", log, set_frequency=None)
    sourced = dataclasses.replace(devices, source=source)
    sampler(small, sourced).take(step(), elapsed=0.0, segment=1)
    assert [entry for entry in log if "set_frequency" in entry[0]] == [
        ("source.set_frequency", FREQUENCY, 5.0),
        ("lock_in.set_frequency", FREQUENCY, 10.0),
    ]


def test_a_mount_may_be_off_by_half_a_degree(small, devices, log) -> None:
    for degrees, good in (
        (0.49, True),
        (0.51, False),
        (-0.51, False),
        (math.nan, False),
    ):
        devices.launch.answers["rotate"] = lambda angle, timeout, off=degrees: (
            angle + math.radians(off)
        )
        made = sampler(small, devices)
        if good:
            made.take(step(), elapsed=0.0, segment=1)
            continue
        with pytest.raises(InstrumentError) as caught:
            made.take(step(), elapsed=0.0, segment=1)
        assert str(caught.value) == (
            f"the launch mount stands at {degrees:.2f} degrees and was sent to 0.00; "
            "see what holds it, and reference it"
        )


def test_fixed_polarizers_are_not_turned(small, devices, log) -> None:
    fixed = dataclasses.replace(devices, launch=None)
    (record,) = sampler(small, fixed).take(step(), elapsed=0.0, segment=1)
    assert record.launch is None
    (record,) = sampler(small, devices).take(step(pair="none"), elapsed=0, segment=1)
    assert (record.launch, record.analyser) == (None, None)
    with pytest.raises(InstrumentError) as caught:
        sampler(small, devices).take(step(pair="VR"), elapsed=0.0, segment=1)
    assert str(caught.value) == (
        "the devices file states no angle of the analyser mount for the state R; add "
        "analyser.angles.R"
    )


def comb_step() -> Step:
    keys = [Key(SCAN, 0, 0, value, "VV", 0) for value in (20e6, 39e6)]
    # The sample of 20 MHz is there already.
    return Step(keys[1], 0.1, -0.2, (), (20e6, 39e6))


def test_a_comb_has_a_record_for_each_missing_frequency(small, devices, log) -> None:
    comb = [
        reading(1.0, modulation_frequency=20e6),
        reading(2j, modulation_frequency=39.001e6),
    ]
    devices.lock_in.answers |= {
        "read_all": lambda: comb, "set_frequencies": lambda f, timeout: [*f]
    }  # fmt: skip
    made = sampler(small, devices)
    (record,) = made.take(comb_step(), elapsed=0.0, segment=1)
    assert ("lock_in.set_frequencies", (20e6, 39e6), 10.0) in log
    assert complex(record.in_phase, record.quadrature) == 2j
    assert record.modulation_frequency == 39.001e6
    # All frequencies share the input.
    devices.lock_in.answers["sharpen"] = True
    for _ in range(19):
        made.take(comb_step(), elapsed=0.0, segment=1)
    assert log[-1] == ("lock_in.sharpen", 3.0)
    devices.lock_in.answers["set_frequencies"] = lambda f, timeout: [39e6, 39e6]
    with pytest.raises(InstrumentError) as caught:
        sampler(small, devices).take(comb_step(), elapsed=0.0, segment=1)
    assert str(caught.value) == (
        "the lock-in makes 39 MHz of both 20 and 39 MHz; move the modulation "
        "frequencies of the survey apart"
    )
    del devices.lock_in.answers["read_all"]
    with pytest.raises(InstrumentError) as caught:
        sampler(small, devices).take(comb_step(), elapsed=0.0, segment=1)
    assert str(caught.value) == (
        "lock_in has no read_all; take procedure.frequencies_at_once out of the "
        "devices file"
    )


def test_readings_of_the_laser_are_in_the_record(small, devices) -> None:
    devices.laser.answers["readings"] = {"laser_current": 0.08}
    (record,) = sampler(small, devices).take(step(), elapsed=0.0, segment=1)
    assert record.laser_current == 0.08


def test_an_unsettled_dwell_is_flagged(small, devices) -> None:
    made = sampler(small, devices)
    dwell = Dwell(
        signals=[1j], modulation_frequencies=[FREQUENCY], means=[0.2, 0.4], readings=3,
        interval=0.5, spreads=[0.1], overload=Overload.NONE, unlocked=False, begin=2.0,
        duration=0.7, settled=False, edges=[0.3],
    )  # fmt: skip
    made._reader = SimpleNamespace(take=lambda **_: dwell)
    (record,) = made.take(step(), elapsed=10.0, segment=1)
    assert record.flags == SampleFlag.UNSETTLED
    assert (record.interval, record.spread, record.edge) == (0.5, 0.1, 0.3)
    assert record.mean == pytest.approx(0.3)
    assert (record.begin, record.duration) == (12.0, 0.7)


def swept(off: float = 0.0, azimuth: float = 0.1, size: float = 1.0, **more: Any):
    dwell = Dwell(
        **{
            "signals": [complex(size)], "modulation_frequencies": [FREQUENCY],
            "means": [0.5], "readings": 5, "interval": 0.01, "spreads": [None],
            "overload": Overload.NONE, "unlocked": False, "begin": 1.0,
            "duration": 0.05, "edges": [0.0], **more,
        }
    )  # fmt: skip
    return Swept(dwell=dwell, azimuth=azimuth, elevation=-0.2, begin=1.0, off=off)


def moving(small: Survey, devices: Devices, rows: list[list[Swept]]) -> Sampler:
    """Return a sampler whose sweeps find these rows, one after another."""
    made = sampler(small, devices)
    made._sweeper = SimpleNamespace(
        start_of=lambda steps: -0.5, take=lambda *_, **more: rows.pop(0)
    )
    return made


def test_pixels_of_a_sweep_are_flagged_one_by_one(small, devices, log) -> None:
    rows = [
        [
            swept(), swept(off=1.1e-4), swept(azimuth=0.1002), swept(off=0.9e-4),
            swept(overload=Overload.OUTPUT),
        ]
    ]  # fmt: skip
    made = moving(small, devices, rows)
    steps = [step(column=k) for k in range(5)]
    records = made.sweep(steps, elapsed=10.0, segment=2)
    flags = [record.flags for (record,) in records]
    assert flags == [0, 8, 8, 0, 1]
    # The run of the clock before the row counts: nothing here but the warm-up of 0 s.
    assert [record.elapsed for (record,) in records] == [11.0] * 5
    assert records[0][0].begin == 11.0
    assert ("scanner.move", -0.5, -0.2, 30.0) in log
    assert log[log.index(("scanner.move", -0.5, -0.2, 30.0)) + 1] == ("sleep", 0.05)
    assert "lock_in.relieve" in words(log)


def test_a_row_is_repeated_after_lost_lock_or_overload(small, devices, log) -> None:
    lost, bad = swept(unlocked=True), swept(overload=Overload.INPUT)
    devices.lock_in.answers["relieve"] = True
    made = moving(small, devices, [[lost, swept()], [swept(), bad], [swept()] * 2])
    records = made.sweep([step(column=k) for k in range(2)], elapsed=0.0, segment=1)
    assert [record.flags for (record,) in records] == [2 | 4] * 2
    moves = [k for k, entry in enumerate(log) if entry[0] == "scanner.move"]
    # It settles after the first arrangement and the new scale, not after lost lock.
    settled = [log[k + 1][0] == "sleep" for k in moves]
    assert settled == [True, False, True]
    made = moving(small, devices, [[lost, swept()]] * 4)
    with pytest.raises(InstrumentError, match="lost its reference in 4 samples"):
        made.sweep([step(column=k) for k in range(2)], elapsed=0.0, segment=1)


def test_a_finer_scale_follows_calm_rows(small, devices, log) -> None:
    row = [swept(size=0.1 * k) for k in range(10)]
    steps = [step(column=k) for k in range(10)]
    made = moving(small, devices, [row, row, row])
    made.sweep(steps, elapsed=0.0, segment=1)
    assert "lock_in.sharpen" not in words(log)
    made.sweep(steps, elapsed=0.0, segment=1)
    assert ("lock_in.sharpen", pytest.approx(0.9)) in log
    # Not if a pixel has no light.
    del log[:]
    made._dark_level.add("VH", [0.5, 0.5])
    made.sweep(steps, elapsed=0.0, segment=1)
    assert "lock_in.sharpen" not in words(log)


def test_a_lock_in_is_prepared_with_the_time_constant(small, devices, log) -> None:
    made = sampler(small, devices)
    made.take(step(), elapsed=0.0, segment=1)
    del log[:]
    made.prepare()
    assert log == [("lock_in.prepare", 0.01)]
    made.take(step(), elapsed=0.0, segment=1)
    assert "laser.on" in words(log)


def test_angles_that_spoil_a_sample_are_those_of_the_list() -> None:
    assert int(samplers.SPOILED) == 1 + 8 + 64 + 128
    assert np.log2([int(flag) for flag in SampleFlag]).astype(int).tolist() == [
        0, 1, 2, 3, 4, 6, 7, 8
    ]  # fmt: skip
