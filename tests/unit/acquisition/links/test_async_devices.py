"""Devices with an event loop of their own, by stand-ins without any package."""

from __future__ import annotations

import asyncio
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from amulor.acquisition.links import ophyd_device
from amulor.acquisition.links.ophyd_device import (
    AsyncLoop,
    OphydDevice,
    closed_if_it_fails,
    done,
    value_of,
)
from amulor.acquisition.plugins import Wiring
from amulor.errors import InstrumentError, MissingExtraError


class Signal:
    """A signal with a value that can be set."""

    def __init__(self, value: Any) -> None:
        self.value = value

    async def get_value(self) -> Any:
        return self.value

    def set(self, value: Any) -> Any:
        async def act() -> None:
            self.value = value

        return act()


class Head:
    """A device of a beamline with parts by name and by number."""

    made: list[Head] = []  # noqa: RUF012  of all tests

    def __init__(self, name: str = "", *, wrong: bool = False) -> None:
        self.name, self._wrong, self.connected = name, wrong, None
        self.pan = Signal(0.5)
        self.stage = SimpleNamespace(tilt=Signal(0.25))
        self.out = {1: Signal(7.0)}
        self.model = Signal("PT-100")
        Head.made.append(self)

    def set_name(self, name: str) -> None:
        self.name = name

    async def connect(self, *, timeout: float) -> None:
        self.connected = timeout
        if self._wrong:
            raise OSError("no route")


@pytest.fixture(autouse=True)
def beamline(monkeypatch):
    """Install a module with the device."""
    module = ModuleType("some_beamline")
    module.Head = Head
    Head.__module__, Head.__qualname__ = "some_beamline", "Head"
    monkeypatch.setitem(sys.modules, "some_beamline", module)
    Head.made.clear()
    return module


def wiring(**options: Any) -> Wiring:
    known = {"class": "some_beamline:Head", "move": "pan"}
    return Wiring(address=None, timeout=2.0, clock=None, options={**known, **options})


def made(**options: Any) -> OphydDevice:
    return OphydDevice.made(
        "scanner", wiring(**options), needed=("move",), more=("park",)
    )


def test_a_device_is_connected_named_and_prepared() -> None:
    device = made(identity="model", prepare={"stage.tilt": 1.5}, park="home")
    (head,) = Head.made
    assert head.name == "scanner"
    assert head.connected == 2.0
    assert head.stage.tilt.value == 1.5
    identity = "ophyd-async some_beamline:Head scanner, PT-100"
    assert device.identity() == identity
    assert device.value("pan") == 0.5
    assert device.value("out.1") == 7.0
    device.set("pan", 0.75)
    assert head.pan.value == 0.75
    assert device.part("") is head
    device.close()
    device.close()
    named = made(arguments={"name": "own"})
    assert named.identity() == "ophyd-async some_beamline:Head own"
    named.close()


@pytest.mark.parametrize("path", ["pan.x", "out.2", "nothing"])
def test_a_part_that_is_missing_is_named(path) -> None:
    device = made()
    with pytest.raises(InstrumentError) as caught:
        device.value(path)
    assert str(caught.value) == (
        f"some_beamline:Head scanner has no {path!r}; see the options of this device "
        "in the devices file"
    )
    device.close()


def test_options_that_are_missing_or_unknown_are_named() -> None:
    for options, lacks, has in (
        ({"where": 1}, "nothing", "where"), ({"parc": 1, "x": 2}, "nothing", "parc, x")
    ):  # fmt: skip
        with pytest.raises(InstrumentError) as caught:
            made(**options)
        assert str(caught.value) == (
            f"scanner.options lacks {lacks} and has {has} that is not known; needed "
            "are class, move"
        )
    with pytest.raises(InstrumentError) as caught:
        OphydDevice.made(
            "laser", Wiring(address=None, timeout=1.0, clock=None),
            needed=("on", "off"), more=(),
        )  # fmt: skip
    assert str(caught.value) == (
        "laser.options lacks class, on, off and has nothing that is not known; needed "
        "are class, on, off"
    )


def test_a_device_that_cannot_be_made_says_why(monkeypatch) -> None:
    for options, text in (
        (
            {"arguments": {"wrong": True}},
            "the scanner some_beamline:Head cannot be connected: OSError: no route; "
            "check scanner.options and power",
        ),
        (
            {"class": "some_beamline:Tail"},
            "some_beamline has no 'Tail'; see scanner.options.class, such as "
            "my_beamline.devices:Head",
        ),
        (
            {"class": "no_beamline:Head"},
            "scanner.options.class 'no_beamline:Head' cannot be imported: No module "
            "named 'no_beamline'",
        ),
        (
            {"prepare": {"nothing": 1}},
            "some_beamline:Head scanner has no 'nothing'; see the options of this "
            "device in the devices file",
        ),
    ):
        with pytest.raises(InstrumentError) as caught:
            made(**options)
        assert str(caught.value) == text

    def absent(name: str) -> Any:
        raise ModuleNotFoundError(name, name="ophyd_async.core")

    monkeypatch.setattr(ophyd_device.importlib, "import_module", absent)
    with pytest.raises(MissingExtraError, match="a scanner by some_beamline:Head"):
        made()


def test_a_failure_names_action_and_time() -> None:
    device = made()

    async def broken() -> None:
        raise ValueError("a\n b")

    async def slow() -> None:
        await asyncio.sleep(5.0)

    for call, timeout, text in (
        (broken, None, "ValueError: a b"),
        (slow, 0.01, "TimeoutError: not done within 0.01 s"),
    ):
        with pytest.raises(InstrumentError) as caught:
            device.call("turn", call, timeout=timeout)
        assert str(caught.value) == (
            f"some_beamline:Head scanner has failed to turn: {text}; check device, "
            "power and network"
        )
    own = InstrumentError("its own words")

    def refuse() -> None:
        raise own

    with pytest.raises(InstrumentError) as caught:
        device.call("turn", refuse)
    assert caught.value is own
    assert device.call("count", lambda: 3) == 3
    device.device.pan = SimpleNamespace(get_value=broken)
    with pytest.raises(InstrumentError, match="failed to tell its pan: ValueError"):
        device.value("pan")
    with pytest.raises(InstrumentError, match="failed to set stage to 5: Attribute"):
        device.set("stage", 5)
    device.close()


def test_a_value_is_that_of_a_signal_an_axis_or_a_single_reading() -> None:
    class Axis:
        async def locate(self) -> dict[str, float]:
            return {"setpoint": 1.0, "readback": 2.0}

    class Reading:
        async def read(self) -> dict[str, Any]:
            return {"only": {"value": 3.0, "timestamp": 0.0}}

    for part, value in ((Signal(1.5), 1.5), (Axis(), 2.0), (Reading(), 3.0)):
        assert asyncio.run(value_of(part)) == value

    async def five() -> int:
        return 5

    assert asyncio.run(done(five())) == 5


def test_a_loop_ends_what_it_runs_and_only_its_own() -> None:
    loop = AsyncLoop()
    assert loop.run(lambda: 1, timeout=1.0) == 1
    thread = loop._thread
    loop.close()
    assert not thread.is_alive()
    assert loop._loop.is_closed()
    other = asyncio.new_event_loop()
    shared = AsyncLoop(other)
    shared.close()
    assert not other.is_closed()
    other.close()


def test_a_device_is_closed_if_a_block_fails() -> None:
    closed: list[int] = []
    device = SimpleNamespace(close=lambda: closed.append(1))
    with closed_if_it_fails(device):
        pass
    assert closed == []
    with pytest.raises(KeyError), closed_if_it_fails(device):
        raise KeyError
    assert closed == [1]
