"""Devices by hand, and those that outputs of a lock-in drive: each word and voltage."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import pytest
from logged_devices import Logged
from shared_light import scene_light

from amulor.acquisition import connect as connections
from amulor.acquisition.clock import RealClock, VirtualClock
from amulor.acquisition.connect import (
    LockInGate,
    LockInShutter,
    OperatorShutter,
    OperatorTargetStage,
    connect,
    simulated_bench,
)
from amulor.acquisition.devices import Devices, digest, is_simulated
from amulor.acquisition.protocols import SIMULATOR
from amulor.acquisition.settings import LaserSettings, Settings, ShutterSettings
from amulor.errors import InstrumentError
from amulor.survey import Survey


def lock_in(log: list[Any], **answers: Any) -> Logged:
    known = {"set_output": lambda n, v: v, "input": 5.0, "reconnect": None}
    return Logged("a lock-in", log, **{**known, **answers})


def test_a_gate_is_on_while_its_interlock_is_closed() -> None:
    log: list[Any] = []
    part = LaserSettings(
        driver="lock_in_output", output=2, on_voltage=4.0, interlock_input=3,
        interlock_voltage=2.5,
    )  # fmt: skip
    device = lock_in(log)
    gate = LockInGate(device, part)
    assert gate.identity() == "output 2 of a lock-in"
    gate.on()
    gate.off()
    assert log == [
        ("a lock-in.input", 3), ("a lock-in.set_output", 2, 4.0),
        ("a lock-in.set_output", 2, 0.0),
    ]  # fmt: skip
    device.answers["input"] = 2.5
    gate.check()
    device.answers["input"] = 2.4
    for call in (gate.check, gate.on):
        del log[:]
        with pytest.raises(InstrumentError) as caught:
            call()
        assert str(caught.value) == (
            "the interlock of the laser is open: input 3 of the lock-in stands at 2.4 "
            "V, closed it has at least 2.5 V; see who opened it, and close it"
        )
        assert log == [("a lock-in.input", 3)]
    # Without a monitor nothing is read.
    del log[:]
    LockInGate(device, LaserSettings(driver="lock_in_output")).check()
    assert log == []


def test_a_gate_that_fails_is_made_safe_over_a_new_link() -> None:
    log: list[Any] = []
    left = [5.0, 0.0]
    gate = LockInGate(
        lock_in(log, set_output=lambda n, v: left.pop(0)),
        LaserSettings(driver="lock_in_output"),
    )
    gate.make_safe()
    assert [entry[0] for entry in log] == [
        "a lock-in.set_output", "a lock-in.reconnect", "a lock-in.set_output"
    ]  # fmt: skip
    with pytest.raises(InstrumentError) as caught:
        LockInGate(
            lock_in(log, set_output=-0.2), LaserSettings(driver="lock_in_output")
        ).off()
    assert str(caught.value) == (
        "output 1 of the lock-in stands at -0.2 V and not at 0 V: the laser may be on; "
        "switch it off by hand"
    )


def test_a_shutter_may_be_off_by_a_tenth_of_a_volt(clock) -> None:
    part = ShutterSettings(
        driver="lock_in_output", output=3, closed_voltage=-2.0, open_voltage=3.0
    )
    log: list[Any] = []
    for off, good in ((0.09, True), (-0.09, True), (0.11, False), (-0.11, False)):
        device = lock_in(log, set_output=lambda n, v, off=off: v + off)
        shutter = LockInShutter(device, part, clock)
        if good:
            shutter.shut()
            assert log[-1] == ("a lock-in.set_output", 3, -2.0)
            shutter.open()
            assert log[-1] == ("a lock-in.set_output", 3, 3.0)
            continue
        with pytest.raises(InstrumentError) as caught:
            shutter.open()
        assert str(caught.value) == (
            f"output 3 of the lock-in stands at {3 + off:g} V and not at 3 V: the "
            "shutter may be in the other position; see to its cable"
        )


def test_an_operator_gets_whole_requests() -> None:
    asked: list[str] = []
    shutter, stage = OperatorShutter(asked.append), OperatorTargetStage(asked.append)
    assert shutter.identity() == stage.identity() == "operator"
    shutter.shut()
    shutter.open()
    stage.bring_in(timeout=1.0)
    stage.take_out(timeout=1.0)
    for device in (shutter, stage):
        device.make_safe()
        device.close()
    assert asked == [
        "Close the shutter in front of the detector",
        "Open the shutter in front of the detector",
        "The laser is off. Put the target into the beam",
        "The laser is off. Take the target out: only water is to be in the beam",
    ]


def test_who_moves_target_and_shutter_is_there_before_the_scan(small: Survey) -> None:
    operator = Settings.model_validate({"target": {"driver": "operator"}})
    nobody = Settings.model_validate({"target": {"driver": "none"}})
    refuse = connections._refuse_target
    refuse(small, operator, print)
    refuse(small.with_({"scan.open_water": None}), nobody, None)
    refuse(small, Settings(), None)
    for settings, text in (
        (
            operator,
            'target.driver = "operator" needs somebody who moves the target, but this '
            "is no terminal; run it on one, or set target.driver to a stage, or to "
            '"none" for a survey without open-water shots',
        ),
        (
            nobody,
            'target.driver is "none", but the survey plans open-water shots, for which '
            "the target must leave the beam; take scan.open_water out of the survey, "
            'or set target.driver to "operator" or to a stage',
        ),
    ):
        with pytest.raises(InstrumentError) as caught:
            refuse(small, settings, None)
        assert str(caught.value) == text


def test_a_shutter_is_that_of_its_part(clock) -> None:
    find = connections._shutter
    log: list[Any] = []
    assert find(Settings(), lock_in(log), clock, print) is None
    wired = SimpleNamespace(
        shutter=ShutterSettings(driver="lock_in_output"),
        lock_in=SimpleNamespace(driver="a model"),
    )
    assert isinstance(find(wired, lock_in(log), clock, None), LockInShutter)
    with pytest.raises(InstrumentError) as caught:
        find(wired, object(), clock, None)
    assert str(caught.value) == (
        "the lock-in 'a model' has no outputs to move the shutter by; set "
        'shutter.driver to "operator", or take it out'
    )
    by_hand = SimpleNamespace(shutter=ShutterSettings(driver="operator"))
    assert isinstance(find(by_hand, object(), clock, print), OperatorShutter)
    with pytest.raises(InstrumentError) as caught:
        find(by_hand, object(), clock, None)
    assert str(caught.value) == (
        'shutter.driver = "operator" needs somebody who moves the shutter, but this is '
        "no terminal; run it on one, or take the part shutter out"
    )


def wired(**parts: Any) -> Settings:
    content: dict[str, Any] = {
        "lock_in": {"driver": "sr844", "address": "tcp://127.0.0.1:1"},
        "scanner": {"driver": "pi_gcs", "address": "tcp://127.0.0.1:2"},
        "launch": {"driver": "none", "address": "unused"},
        "analyser": {"driver": "pi_gcs", "address": "tcp://127.0.0.1:2"},
        "target": {"driver": "operator", "address": "unused"},
        "laser": {"driver": "lock_in_output"},
    }
    return Settings.model_validate({**content, **parts})


def test_addresses_are_those_of_devices_that_are_driven() -> None:
    find = connections._addresses
    assert find(wired()) == ["tcp://127.0.0.1:1", "tcp://127.0.0.1:2"]
    navigation = {"address": "ASRL9", "crs": "EPSG:32632"}
    assert find(wired(navigation=navigation))[0] == "ASRL9"
    options = {"class": "a:B", "arguments": {"n": 1}, "x": "y"}
    ophyd = {"driver": "ophyd_async", "options": options}
    assert find(wired(scanner=ophyd)) == [
        '["a:B", {"n": 1}]', "tcp://127.0.0.1:1", "tcp://127.0.0.1:2"
    ]  # fmt: skip
    with_address = {**ophyd, "address": "somewhere"}
    assert "somewhere" in find(wired(scanner=with_address))
    assert '["a:B", {"n": 1}]' not in find(wired(scanner=with_address))


def test_a_laser_behind_a_lock_in_needs_its_outputs(clock) -> None:
    part = LaserSettings(driver="lock_in_output", interlock_input=1)
    settings = SimpleNamespace(laser=part, lock_in=SimpleNamespace(driver="a model"))
    assert isinstance(connections._laser(settings, lock_in([]), clock), LockInGate)
    for lacks in ("set_output", "reconnect", "input"):
        device = lock_in([])
        del device.answers[lacks]
        with pytest.raises(InstrumentError) as caught:
            connections._laser(settings, device, clock)
        assert str(caught.value) == (
            f"the lock-in 'a model' has no {lacks!r} to drive and watch the laser by; "
            "choose another laser.driver, or take laser.interlock_input out"
        )
    # An input is needed for a monitor only.
    settings.laser = LaserSettings(driver="lock_in_output")
    assert connections._laser(settings, device, clock).identity()


def test_a_target_is_moved_by_nobody_an_operator_or_a_stage() -> None:
    find = connections._target
    part = Settings.model_validate({"target": {"driver": "none"}}).target
    assert find(part, None, None) is None
    part = Settings.model_validate({"target": {"driver": "operator"}}).target
    assert isinstance(find(part, None, print), OperatorTargetStage)


def test_simulated_devices_have_the_clock_and_the_shutter_they_need(small) -> None:
    plain = connect(small, Settings(), scene=scene_light)
    assert isinstance(plain.clock, VirtualClock)
    assert plain.shutter is None
    assert plain.navigation is None
    assert plain.laser.log == ["off"]
    fast = Settings.model_validate({"simulation": {"speed": 100.0}})
    clock = connect(small, fast, scene=scene_light).clock
    assert isinstance(clock, RealClock)
    assert clock._speed == 100.0
    closed = connect(small, Settings(), scene=scene_light, shutter_closed=True)
    assert closed.shutter is not None
    shuttered = Settings.model_validate({"shutter": {}})
    assert connect(small, shuttered, scene=scene_light).shutter is not None
    by_hand = Settings.model_validate({"shutter": {"driver": "operator"}})
    assert connect(small, by_hand, scene=scene_light).shutter is None


def test_each_part_of_a_scan_has_other_noise(small, clock) -> None:
    settings = Settings.model_validate({"simulation": {"seed": 5}})
    seeds = [
        simulated_bench(
            small, settings, scene=scene_light, clock=clock, part=part
        )._settings.seed
        for part in (0, 3)
    ]
    assert seeds == [5, 8]


def devices_of(log: list[Any], **answers: Any) -> Devices:
    names = ("laser", "lock_in", "scanner", "source", "target")
    made = {
        name: Logged(name, log, make_safe=None, close=None, **answers) for name in names
    }
    return Devices(
        **made, launch=None, analyser=None, clock=VirtualClock(),
        release=lambda: log.append(("released",)),
    )  # fmt: skip


def test_devices_are_made_safe_the_laser_first_and_all_of_them() -> None:
    log: list[Any] = []
    devices = devices_of(log)
    order = ("laser", "source", "scanner", "target", "lock_in")
    assert devices.identities() == {name: name for name in order}
    assert devices.make_safe() == []
    assert [entry[0] for entry in log] == [f"{name}.make_safe" for name in order]

    def broken(*_: Any) -> None:
        raise InstrumentError("it broke")

    devices.source.answers |= {"make_safe": broken, "close": broken}
    assert devices.make_safe() == [
        "source could not be made safe, see to it by hand: it broke"
    ]
    del log[:]
    devices.close()
    assert [entry[0] for entry in log] == [
        *(f"{name}.close" for name in order),
        "released",
    ]
    assert dataclasses.replace(devices, source=None).make_safe() == []


def test_a_digest_is_that_of_what_changes_samples() -> None:
    base = {"procedure": {"settling": 5.0}, "scanner": {}}
    first = digest(Settings.model_validate(base), {"laser": "a"})
    for changes, same in (
        ({"procedure": {"settling": 6.0}}, False),
        ({"procedure": {"settling": 5.0, "attempts": 7, "patience": 8}}, True),
        ({"procedure": {"settling": 5.0, "darkness_patience": 9}}, True),
        ({"procedure": {"settling": 5.0, "clock_speed": 2.0}}, True),
        ({"scanner": {"move_timeout": 7.0, "address": "elsewhere"}}, True),
        ({"scanner": {"azimuth_zero": 1.0}}, False),
        ({"simulation": {"seed": 7}}, True),
    ):
        other = digest(Settings.model_validate({**base, **changes}), {"laser": "a"})
        assert (other == first) is same, changes
    assert digest(Settings.model_validate(base), {"laser": "b"}) != first
    assert is_simulated({"a": "real", "b": f"x {SIMULATOR}"})
    assert not is_simulated({"a": "real"})
    assert not is_simulated({})
