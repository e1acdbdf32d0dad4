"""Simulated UHFLI: nodes, ranges, oscillators and streams of its manual."""

from __future__ import annotations

import pytest
from numpy.testing import assert_allclose
from stand_in_bench import SIGNAL, StandInBench

from amulor.acquisition.simulated.zurich import CLOCKBASE, SimulatedUhfli


def uhfli(*faults: str, options: str = "MF") -> SimulatedUhfli:
    return SimulatedUhfli(StandInBench(*faults), options=options)


def test_ranges_of_a_uhfli_are_the_next_larger_ones() -> None:
    device = uhfli()
    for path, asked, got in (
        ("sigins/0/range", 0.0101, 0.02), ("sigins/0/range", 0.01, 0.01),
        ("sigins/1/range", 0.305, 0.31), ("sigins/0/range", 9.0, 0.01),
        ("sigouts/0/range", 0.1, 0.15), ("sigouts/1/range", 0.15, 0.15),
        ("sigouts/0/range", 0.2, 1.5),
    ):  # fmt: skip
        device.handle(path, asked)
        if asked < 9:
            assert device.handle(path) == pytest.approx(got)
    fastest = CLOCKBASE / 128
    for asked, got in (
        (fastest, fastest), (2 * fastest, fastest), (fastest / 2.9, fastest / 4),
        (fastest / 2.7, fastest / 2), (1000.0, fastest / 2**14),
    ):  # fmt: skip
        device.handle("demods/0/rate", asked)
        assert device.handle("demods/0/rate") == pytest.approx(got)


def test_a_uhfli_has_the_nodes_of_its_manual_only() -> None:
    device = uhfli()
    assert device.oscs[0].freq() == 10e6
    assert str(device.demods[3].sample) == f"/{device.serial}/demods/3/sample"
    assert device.clockbase() == 1.8e9
    assert device.features.options() == "MF"
    with pytest.raises(AttributeError):
        device.__getattr__("_hidden")
    device.oscs[7].freq(5e6)
    assert device.handle("oscs/7/freq") == 5e6
    for path in ("oscs/8/freq", "demods/8/order", "sigins/2/range", "auxouts/4/offset"):
        with pytest.raises(RuntimeError) as caught:
            device.handle(path)
        assert str(caught.value) == (
            f"ZIException: the path /{device.serial}/{path} was not found"
        )
    with pytest.raises(RuntimeError) as caught:
        device.subscribe("oscs/0/freq")
    assert str(caught.value) == "ZIException: node oscs/0/freq cannot be streamed"
    defaults = {
        "demods/2/order": 3, "demods/2/harmonic": 1, "demods/2/timeconstant": 0.01,
        "demods/2/rate": 1716.0, "sigins/1/range": 1.5, "sigouts/1/on": 0,
        "sigouts/1/amplitudes/7": 0.0, "auxouts/3/offset": 0.0,
    }  # fmt: skip
    assert {path: device.handle(path) for path in defaults} == defaults


def test_time_constant_and_gate_of_a_uhfli_act_on_the_bench() -> None:
    device = uhfli()
    device.demods[1].timeconstant(0.5)
    assert device.bench.time_constant == 0.01
    device.demods[0].timeconstant(0.25)
    assert device.bench.time_constant == 0.25
    for kind, offset, on in ((0, 5.0, False), (-1, 5.0, True), (-1, 2.01, True),
                             (-1, 1.99, False)):  # fmt: skip
        device.auxouts[0].outputselect(kind)
        device.auxouts[0].offset(offset)
        assert device.bench.laser_on is on
        assert device.handle("auxouts/0/value") == (offset if kind == -1 else 0)
    device.auxouts[1].outputselect(-1)
    device.auxouts[1].offset(5.0)
    assert not device.bench.laser_on


def driven(device: SimulatedUhfli, *numbers: int) -> None:
    for k in numbers:
        device.oscs[k].freq(20e6 + k)
        device.sigouts[0].enables[k](1)
    device.sigouts[0].on(1)


def test_enabled_oscillators_modulate_the_bench() -> None:
    device = uhfli()
    driven(device, 1, 4)
    assert device.bench.frequencies == [20e6 + 1, 20e6 + 4]
    count = len(device.bench.sent)
    device.demods[0].order(1)
    device.sigouts[0].offset(0.1)
    assert len(device.bench.sent) == count
    device.oscs[1].freq(30e6)
    assert device.bench.frequencies == [30e6, 20e6 + 4]
    # Without the option all demodulators use the first oscillator.
    single = uhfli(options="")
    driven(single, 3)
    assert single.bench.frequencies == [10e6]
    driven(single, 5)
    assert single.bench.frequencies == [10e6]


def test_samples_of_a_uhfli_are_those_of_the_oscillator() -> None:
    device = uhfli()
    driven(device, 0, 2)
    device.demods[1].oscselect(2)
    device.demods[3].oscselect(5)
    device.bench.clock.sleep(0.5)
    sample = device.demods[0].sample()
    assert sample["x"][0] == pytest.approx(0.3)
    assert sample["y"][0] == pytest.approx(0.4)
    assert sample["timestamp"][0] == round(0.5 * 1.8e9)
    assert sample["frequency"][0] == 20e6
    assert sample["auxin0"][0] == 0.25
    assert sample["auxin1"][0] == 0.0
    second = device.demods[1].sample()
    assert second["x"][0] == pytest.approx(0.6)
    assert second["frequency"][0] == 20e6 + 2
    # An oscillator that drives nothing has no signal.
    assert device.demods[3].sample()["x"][0] == 0
    reached = abs(SIGNAL) * 3 / 1.5
    assert device.sigins[0].max() == pytest.approx(reached)
    assert device.sigins[0].min() == pytest.approx(-reached)
    assert device.handle("status/time") == round(0.5 * 1.8e9)
    full = uhfli("overload@1")
    full.demods[0].sample()
    assert full.sigins[0].max() == 1.0


def test_a_poll_returns_the_rows_of_enabled_demodulators() -> None:
    device = uhfli()
    driven(device, 0)
    device.demods[0].rate(1716.0)
    rate = CLOCKBASE / 128 / 2**13
    for number in (0, 1, 2):
        device.demods[number].sample.subscribe()
    device.demods[0].enable(1)
    device.demods[2].enable(1)
    assert device.bench.traces[-1][0] == pytest.approx(1 / rate)
    assert device.bench.traces[-1][1] == {"most": 200_000, "start": 0.0}
    device.bench.rows = [[SIGNAL], [2 * SIGNAL]]
    polled = device.poll(0.25)
    assert device.bench.clock.now() == 0.25
    assert len(polled) == 2
    assert [*polled] == [f"/{device.serial}/demods/{n}/sample" for n in (0, 2)]
    rows = polled[device.demods[0].sample]
    assert_allclose(rows["x"], [0.3, 0.6])
    assert_allclose(rows["y"], [0.4, 0.8])
    assert rows["timestamp"].tolist() == [0, round(1.8e9 / rate)]
    assert_allclose(rows["frequency"], 20e6)
    assert_allclose(rows["auxin0"], 0.25)
    assert_allclose(rows["auxin1"], 0.0)
    # The stream goes on where it ended.
    assert device.bench.traces[-1][1]["start"] == pytest.approx(2 / rate)
    device.bench.rows = []
    assert len(device.poll()) == 0
    assert device.bench.clock.now() == pytest.approx(0.35)
