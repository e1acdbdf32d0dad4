"""Answers of simulated lock-ins that no driver asks for, whole and in their units."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from stand_in_bench import ANGLE, SIGNAL, StandInBench

from amulor.acquisition.links.tcp import LinkLostError
from amulor.acquisition.protocols import SIMULATOR
from amulor.acquisition.simulated.sr865a import SimulatedSr865a
from amulor.acquisition.simulated.stanford import SimulatedSr844


def number(device: Any, question: str) -> float:
    (answer,) = device.answer(question)
    return float(answer)


@pytest.mark.parametrize(("model", "name"), [
    (SimulatedSr844, "SR844"), (SimulatedSr865a, "SR865A")
])  # fmt: skip
def test_a_lock_in_says_what_it_is(model, name) -> None:
    device = model(StandInBench())
    identity = f"Stanford_Research_Systems,{name},s/n00000,{SIMULATOR}"
    assert device.answer("*IDN?") == [identity]
    assert device.answer("*OPC?") == ["1"]
    assert device.answer("*TST?") == ["0"]
    assert device.lines == ["*IDN?", "*OPC?", "*TST?"]
    for _ in range(1001):
        device.answer("*OPC?")
    assert len(device.lines) == 1000


@pytest.mark.parametrize("model", [SimulatedSr844, SimulatedSr865a])
@pytest.mark.parametrize("turn", [360, -360, 170])
def test_an_automatic_phase_stays_within_half_a_turn(model, turn) -> None:
    device = model(StandInBench())
    device.answer(f"PHAS {turn}")
    device.answer("APHS")
    assert number(device, "PHAS?") == pytest.approx(ANGLE, abs=0.006)
    opposite = model(StandInBench())
    opposite.bench.signal = -1 + 1e-3j
    opposite.answer("PHAS -90")
    opposite.answer("APHS")
    assert abs(number(opposite, "PHAS?")) <= 180


def test_no_light_has_no_level_in_decibels() -> None:
    device = SimulatedSr844(StandInBench())
    device.bench.signal = 0j
    assert device.answer("OUTP? 4") == ["-INF"]
    assert device.answer("OUTP? 3") == ["0.000000E+00"]


@pytest.mark.parametrize("model", [SimulatedSr844, SimulatedSr865a])
def test_a_reading_can_be_lost_or_late(model) -> None:
    device = model(StandInBench("timeout@2", "lost-link@3"))
    assert len(device.answer("SNAP? 1,2")) == 1
    assert device.answer("*OPC?;SNAP? 1,2;*OPC?") == []
    assert device.bench.readings == 2
    with pytest.raises(LinkLostError):
        device.answer("SNAP? 1,2")
    assert device.bench.readings == 3
    # Other questions are answered meanwhile.
    assert device.answer("*OPC?") == ["1"]


@pytest.mark.parametrize(
    ("model", "unlocked", "overloaded"),
    [(SimulatedSr844, 1, 16), (SimulatedSr865a, 8, 16)],
)
def test_faults_latch_status_bits(model, unlocked, overloaded) -> None:
    device = model(StandInBench("unlock@1", "overload@2"))
    for expected in (unlocked, overloaded, 0):
        device.answer("SNAP? 1,2")
        bits = int(device.answer("LIAS?")[0])
        assert bits & (unlocked | overloaded) == expected
    device.bench.is_locked = False
    assert int(device.answer("LIAS?")[0]) & unlocked
    device.bench.is_locked = True
    assert not int(device.answer("LIAS?")[0]) & unlocked


@pytest.mark.parametrize(
    ("model", "question", "other"),
    [(SimulatedSr844, "AUXI? 2", "OUTP? 1"), (SimulatedSr865a, "OAUX? 1", "OAUX? 2")],
)
def test_the_interlock_is_at_the_second_input(model, question, other) -> None:
    device = model(StandInBench())
    assert number(device, question) == 5.0
    device.bench.interlock_is_closed = False
    assert number(device, question) == 0.0
    assert device.answer(other)
    device.answer("AUXI? 3" if model is SimulatedSr844 else "OAUX? 4")
    assert device.answer("*ESR?") == ["16"]


def test_inputs_and_noise_of_an_sr865a() -> None:
    device = SimulatedSr865a(StandInBench())
    device.answer("OFLT 8")
    assert number(device, "OAUX? 0") == 0.25
    assert number(device, "OAUX? 2") == number(device, "OAUX? 3") == 0
    noise = 0.2 / math.sqrt(2 * (1 / 4) / 0.01)
    shown = number(device, "OUTP? 9")
    assert shown == number(device, "OUTP? 8") == pytest.approx(noise)
    assert number(device, "FREQEXT?") == 0
    assert number(device, "FREQDET?") == number(device, "FREQINT?") == 39e6
    # Channels are told by number or name, and shown together.
    device.answer("CDSP 0,R")
    assert device.answer("CDSP? 0") == ["2"]
    (shown,) = device.answer("SNAPD?")
    values = [float(text) for text in shown.split(",")]
    assert_allclose(values, [0.5, 0.4, 0.5, ANGLE], rtol=1e-6)
    device.answer("CDSP 1,16")
    assert device.answer("CDSP? 1") == ["16"]
    device.answer("CDSP 1,-1")
    assert device.answer("*ESR?") == ["16"]


def test_present_overloads_leave_the_latched_ones() -> None:
    device = SimulatedSr865a(StandInBench())
    device.answer("SCAL 1;SNAP? 0,1")
    latched = int(device.answer("LIAS? 0")[0])
    assert latched == 0
    device.answer("SCAL 2;SNAP? 0,1")
    device.answer("SCAL 0")
    assert device.answer("CUROVLDSTAT?") == ["0"]
    assert device.answer("LIAS? 0") == ["1"]
    device.bench.is_locked = False
    assert int(device.answer("CUROVLDSTAT?")[0]) == 8


def capture(config: str, kilobytes: int = 2) -> SimulatedSr865a:
    device = SimulatedSr865a(StandInBench())
    device.answer(f"OFLT 0;CAPTURELEN {kilobytes};CAPTURECFG {config}")
    device.answer("CAPTURESTART ONE,IMM")
    return device


def test_a_capture_has_rows_at_its_rate() -> None:
    device = capture("XY")
    # 16 points in 1 us are more than its fastest rate.
    ((interval, more),) = device.bench.traces
    assert interval == pytest.approx(1 / 1.25e6)
    assert more == {"most": 256}
    device.bench.rows = [[SIGNAL], [2 * SIGNAL], [3 * SIGNAL]]
    assert device.answer("CAPTURESTAT?") == ["3"]
    assert device.answer("CAPTUREBYTES?") == ["24"]
    assert device.answer("CAPTUREVAL? 1") == ["6.000000000e-01,8.000000000e-01"]
    assert device.answer("CAPTUREVAL? 3") == ["0.000000000e+00,0.000000000e+00"]
    assert device.answer("CAPTUREPROG?") == []
    device.answer("CAPTURESTOP")
    device.bench.rows = []
    assert device.answer("*ESR?") == ["16"]
    assert device.answer("CAPTURESTAT?") == ["2"]
    assert device.answer("CAPTUREBYTES?") == ["24"]
    assert device.answer("CAPTUREPROG?") == ["2"]
    (block,) = device.answer("CAPTUREGET? 0,1")
    assert block[:6] == b"#41024"
    values = struct.unpack("<256f", block[6:])
    assert_allclose(values[:7], [0.3, 0.4, 0.6, 0.8, 0.9, 1.2, 0], rtol=1e-6)
    # A new one forgets them.
    device.answer("CAPTURESTART ONE,IMM")
    assert device.answer("CAPTUREBYTES?") == ["0"]


@pytest.mark.parametrize(
    ("config", "shown"),
    [
        ("X", [0.3]), ("XY", [0.3, 0.4]), ("RT", [0.5, ANGLE]),
        ("XYRT", [0.3, 0.4, 0.5, ANGLE]),
    ],
)  # fmt: skip
def test_values_of_a_capture_are_those_of_its_columns(config, shown) -> None:
    device = capture(config)
    device.bench.rows = [[SIGNAL]]
    (text,) = device.answer("CAPTUREVAL? 0")
    assert_allclose([float(value) for value in text.split(",")], shown, rtol=1e-6)
    assert device.answer("CAPTUREBYTES?") == [str(4 * len(shown))]
    device.answer("PHAS 90")
    (text,) = device.answer("CAPTUREVAL? 0")
    assert float(text.split(",")[0]) == pytest.approx(
        0.4 if config != "RT" else 0.5, rel=1e-6
    )


def test_a_full_buffer_ends_and_begins_again() -> None:
    device = capture("X")
    device.bench.rows = [[complex(k)] for k in range(511)]
    assert device.answer("CAPTURESTAT?") == ["3"]
    device.bench.rows = [[complex(k)] for k in range(512)]
    assert device.answer("CAPTURESTAT?") == ["6"]
    (block,) = device.answer("CAPTUREGET? 1,2")
    values = struct.unpack("<512f", block[6:])
    # From the second kilobyte on, and then the first one.
    assert_allclose(
        np.array(values) * math.sqrt(2), [*range(256, 512), *range(256)], rtol=1e-6
    )
    (block,) = device.answer("CAPTUREGET? 0,64")
    assert len(block) == 6 + 4096
    device.answer("CAPTURECFG XY")
    assert device.answer("CAPTURESTAT?") == ["0"]
    assert device.answer("CAPTUREBYTES?") == ["0"]
    device.answer("CAPTURESTART ONE,IMM;*RST")
    assert device.answer("CAPTURESTAT?;CAPTURELEN?;CAPTURECFG?") == ["0;2;0"]


def test_lengths_are_whole_blocks_of_two_kilobytes() -> None:
    device = SimulatedSr865a(StandInBench())
    assert device.answer("CAPTURELEN?") == ["2"]
    for asked, got in (("1", "2"), ("2", "2"), ("3", "4"), ("4096", "4096")):
        device.answer(f"CAPTURELEN {asked}")
        assert device.answer("CAPTURELEN?") == [got]
