"""The UHFLI driver against a contract fake: which nodes are set and read, no more."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.acquisition.drivers.zurich import ZurichLockIn
from amulor.acquisition.gate import LockInGate
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
            return None
        return self._values[self._path]


class Device(Node):
    """A contract fake of a connected UHFLI; no instrument behaves in it."""

    device_type = "UHFLI"
    serial = "dev2006"

    def __init__(self) -> None:
        values: dict[str, object] = {
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
    return ZurichLockIn(device, mean_output_input=1, clock=clock)


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
    assert device.values["/auxouts/2/offset"] == 5.0
    gate.make_safe()
    assert device.values["/auxouts/2/offset"] == 0.0
    assert device.values["/auxouts/2/outputselect"] == -1
    lock_in.make_safe()
    assert device.values["/sigouts/0/on"] == 0


def test_the_toolkit_is_asked_for_by_its_extra(clock, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "zhinst", None)
    with pytest.raises(MissingExtraError, match=r"amulor\[zi\]"):
        ZurichLockIn.connect("localhost:dev1", mean_output_input=None, clock=clock)
    with pytest.raises(InstrumentError, match="server:device"):
        ZurichLockIn.connect("localhost", mean_output_input=None, clock=clock)
