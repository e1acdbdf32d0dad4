"""Simulated Stanford lock-ins understand what the manuals say, and nothing else."""

from __future__ import annotations

import pytest

from amulor.acquisition.connect import simulated_bench
from amulor.acquisition.simulated.sr865a import SimulatedSr865a
from amulor.acquisition.simulated.stanford import SimulatedSr844
from amulor.simulation import scene_light


@pytest.fixture
def bench(small, settings, clock):
    """Return a simulated instrument without light."""
    return simulated_bench(small, settings, scene=scene_light, clock=clock)


def test_the_gate_of_an_sr865a_is_its_output_zero(bench) -> None:
    device = SimulatedSr865a(bench)
    assert device.answer("AUXV 1,5.0;AUXV? 1") == ["5.000"]
    assert not bench.laser_on
    assert device.answer("AUXV 0,5.0;AUXV? 0") == ["5.000"]
    assert bench.laser_on
    # What is no output is an error, and nothing is answered.
    assert device.answer("AUXV 4,0.0") == []
    assert device.answer("AUXV? 4") == []
    assert device.answer("*ESR?") == ["16"]
    assert bench.laser_on


def test_the_gate_of_an_sr844_is_its_output_one(bench) -> None:
    device = SimulatedSr844(bench)
    assert device.answer("AUXO 2,5.0;AUXO? 2") == ["5.000"]
    assert not bench.laser_on
    assert device.answer("AUXO 1,5.0") == []
    assert bench.laser_on
    assert device.answer("AUXO 3,5.0;AUXO? 3") == []
    assert device.answer("*ESR?") == ["16"]
