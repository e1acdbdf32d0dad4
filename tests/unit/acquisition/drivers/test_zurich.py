"""The UHFLI driver against a contract fake: which nodes are set and read, no more."""

from __future__ import annotations

import math
import sys
import types

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.acquisition.connect import LockInGate
from amulor.acquisition.drivers.zurich import ZurichLockIn
from amulor.acquisition.protocols import Overload
from amulor.acquisition.settings import LaserSettings
from amulor.errors import InstrumentError, MissingExtraError


class Node:
    """A node of the contract fake: with a value it is set, without one it is read."""

    def __init__(self, path: str, values: dict[str, object]) -> None:
        self._path, self._values = path, values

    def __getattr__(self, name: str) -> Node:
        return Node(f"{self._path}/{name}", self._values)

    def __getitem__(self, number: int) -> Node:
        return Node(f"{self._path}/{number}", self._values)

    def __call__(self, *value: object) -> object:
        if value:
            self._values[self._path] = value[0]
            self._values["order"].append((self._path, value[0]))
            # In manual mode an auxiliary output puts out its offset.
            if self._path.startswith("/auxouts"):
                output = self._path.rpartition("/")[0]
                if self._values.get(f"{output}/outputselect") == -1:
                    self._values[f"{output}/value"] = self._values[f"{output}/offset"]
            return None
        return self._values[self._path]


class Device(Node):
    """A contract fake of a connected UHFLI; no instrument behaves in it."""

    device_type = "UHFLI"
    serial = "dev2006"

    def __init__(self) -> None:
        values: dict[str, object] = {
            "order": [],
            "/features/options": "PID\nRUB",
            "/sigins/0/max": 0.2,
            "/sigins/0/min": -0.2,
            "/demods/0/sample": {
                "x": np.array([3e-3]),
                "y": np.array([-4e-3]),
                "frequency": np.array([39e6]),
                "auxin0": np.array([0.125]),
            },
        }
        super().__init__("", values)
        self.values = values


@pytest.fixture
def device() -> Device:
    """Return a contract fake."""
    return Device()


@pytest.fixture
def lock_in(device, clock) -> ZurichLockIn:
    """Return a driver in front of it."""
    return ZurichLockIn(
        device, mean_output_input=1, modulation_amplitude=0.1, clock=clock
    )


def test_preparing_sets_a_one_pole_filter_on_the_own_oscillator(
    lock_in, device
) -> None:
    lock_in.prepare(time_constant=0.01)
    for node, value in {
        "oscselect": 0, "order": 1, "sinc": 0, "timeconstant": 0.01, "enable": 1,
        "harmonic": 1, "phaseshift": 0.0,
    }.items():  # fmt: skip
        assert device.values[f"/demods/0/{node}"] == value
    assert device.values["/sigouts/0/on"] == 1
    assert lock_in.set_frequency(39e6, timeout=1.0) == 39e6
    assert device.values["/oscs/0/freq"] == 39e6


def test_a_sample_becomes_a_peak_amplitude_with_the_phase_of_a_delay(lock_in) -> None:
    reading = lock_in.read()
    assert_allclose(reading.signal, math.sqrt(2) * (3e-3 + 4e-3j))
    assert (reading.mean, reading.modulation_frequency) == (0.125, 39e6)
    assert reading.overload == Overload.NONE


def test_a_full_input_is_an_overload_and_its_range_makes_room(lock_in, device) -> None:
    lock_in.prepare(time_constant=0.01)
    assert lock_in.sharpen(1e-3)
    assert device.values["/sigins/0/range"] == 1.0
    device.values["/sigins/0/min"] = -1.0
    assert lock_in.read().overload == Overload.INPUT
    assert lock_in.relieve(Overload.INPUT)
    assert device.values["/sigins/0/range"] == lock_in.full_scale() == 1.5
    assert not lock_in.relieve(Overload.INPUT)


def test_the_gate_of_a_laser_is_an_auxiliary_output(lock_in, device) -> None:
    gate = LockInGate(lock_in, LaserSettings(driver="lock_in_output", output=3))
    gate.on()
    assert device.values["/auxouts/2/value"] == 5.0
    # Manual mode with what stood there before would be light that nobody asked for.
    order = [path for path, _ in device.values["order"]]
    assert order == ["/auxouts/2/offset", "/auxouts/2/outputselect"]
    gate.make_safe()
    assert device.values["/auxouts/2/offset"] == 0.0
    assert device.values["/auxouts/2/outputselect"] == -1
    lock_in.make_safe()
    assert device.values["/sigouts/0/on"] == 0


def test_the_toolkit_is_asked_for_by_its_extra(clock, monkeypatch) -> None:
    for name in ("zhinst", "zhinst.toolkit"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtraError, match=r"amulor\[zi\]"):
        connected("localhost:dev1", clock)
    with pytest.raises(InstrumentError, match="server:device"):
        connected("localhost", clock)


def connected(address: str, clock) -> ZurichLockIn:
    return ZurichLockIn.connect(
        address, mean_output_input=None, modulation_amplitude=0.1, clock=clock
    )


@pytest.mark.parametrize(
    ("address", "hf2"), [("localhost:dev2006", {}), ("hf2:lab:dev18", {"hf2": True})]
)
def test_an_hf2_has_a_data_server_of_its_own(
    clock, monkeypatch, device, address, hf2
) -> None:
    asked = []

    class Session:
        def __init__(self, server: str, **words: object) -> None:
            asked.append((server, words))

        def connect_device(self, serial: str) -> Device:
            asked.append(serial)
            return device

    toolkit = types.ModuleType("zhinst.toolkit")
    toolkit.Session = Session
    monkeypatch.setitem(sys.modules, "zhinst", types.ModuleType("zhinst"))
    monkeypatch.setitem(sys.modules, "zhinst.toolkit", toolkit)
    connected(address, clock)
    server, serial = address.split(":")[-2:]
    assert asked == [(server, hf2), serial]


@pytest.mark.parametrize(
    ("kind", "options", "channel", "level", "reach"),
    [
        ("UHFLI", "PID", 3, 0.1 * math.sqrt(2), 0.15),
        ("UHFLI", "PID\nMF", 0, 0.1 * math.sqrt(2), 0.15),
        # The HF2LI counts in fractions of its range.
        ("HF2LI", "", 6, 0.1 * math.sqrt(2), 1.0),
    ],
)
def test_the_modulation_output_is_set_and_not_assumed(
    lock_in, device, kind, options, channel, level, reach
) -> None:
    # Mixer channels as zhinst.utils.default_output_mixer_channel gives them.
    device.device_type = kind
    device.values["/features/options"] = options
    lock_in.prepare(time_constant=0.01)
    values = device.values
    assert values["/sigouts/0/range"] == reach
    assert_allclose(values[f"/sigouts/0/amplitudes/{channel}"], level)
    assert values[f"/sigouts/0/enables/{channel}"] == 1
    assert values["/sigouts/0/offset"] == 0.0
    assert values.get("/sigouts/0/imp50") == (None if kind == "HF2LI" else 1)
    if "MF" in options:
        assert [values[f"/sigouts/0/enables/{n}"] for n in range(1, 8)] == [0] * 7
    # Off while it is set, on at the end.
    switched = [value for path, value in values["order"] if path == "/sigouts/0/on"]
    assert switched == [0, 1]
    assert values["order"][-1] == ("/sigouts/0/on", 1)


def test_a_level_beyond_the_output_is_refused(device, clock) -> None:
    loud = ZurichLockIn(
        device, mean_output_input=None, modulation_amplitude=1.5, clock=clock
    )
    with pytest.raises(
        InstrumentError, match=r"ends at 1\.5 V peak, stated is 2\.12 V"
    ):
        loud.prepare(time_constant=0.01)
    assert device.values.get("/sigouts/0/on") is None


def test_an_output_that_does_not_follow_is_told(device, lock_in, clock) -> None:
    device.values["/auxouts/0/value"] = 5.0
    gate = LockInGate(lock_in, LaserSettings(driver="lock_in_output"))
    stuck = Node.__call__

    def ignores(node: Node, *value: object) -> object:
        found = stuck(node, *value)
        device.values["/auxouts/0/value"] = 5.0
        return found

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Node, "__call__", ignores)
        with pytest.raises(InstrumentError, match="stands at 5 V and not at 0 V"):
            gate.off()
    assert clock.now() == pytest.approx(1.0, abs=0.05)
