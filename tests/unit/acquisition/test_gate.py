"""The laser behind an output of the lock-in: what counts as off, and as closed."""

from __future__ import annotations

import pytest

from amulor.acquisition.connect import LockInGate
from amulor.acquisition.settings import LaserSettings
from amulor.errors import InstrumentError


class Outputs:
    """A lock-in whose outputs stand where they are told, or where they are held."""

    def __init__(self, *, left: float = 0.0, input_voltage: float = 0.0) -> None:
        self.left, self.input_voltage = left, input_voltage

    def identity(self) -> str:
        return "a lock-in"

    def set_output(self, number: int, voltage: float) -> float:
        return voltage or self.left

    def input(self, number: int) -> float:
        return self.input_voltage

    def reconnect(self) -> None:
        raise AssertionError("no link is lost")


@pytest.mark.parametrize("left", [0.0, 0.1, -0.1])
def test_a_tenth_of_a_volt_is_off(left) -> None:
    LockInGate(Outputs(left=left), LaserSettings(driver="lock_in_output")).off()


@pytest.mark.parametrize("left", [0.11, -0.11, 0.8])
def test_more_than_a_tenth_of_a_volt_is_not_off(left) -> None:
    # An enable input of TTL levels is low up to 0.8 V: a margin of eight.
    gate = LockInGate(Outputs(left=left), LaserSettings(driver="lock_in_output"))
    with pytest.raises(InstrumentError, match=f"stands at {left:g} V"):
        gate.off()
