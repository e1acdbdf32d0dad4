"""Simulated stage controller and pan-tilt head: units, limits, refusals, frames."""

from __future__ import annotations

import math
from typing import Any

import pytest
from stand_in_bench import StandInBench

from amulor.acquisition.protocols import SIMULATOR
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.pelco_head import SimulatedPelcoHead
from amulor.acquisition.simulated.pi import SimulatedPiController


def controller(**scanner: Any) -> SimulatedPiController:
    settings = Settings.model_validate({"scanner": scanner})
    return SimulatedPiController(StandInBench(), settings)


def test_a_controller_says_what_it_is_and_understands() -> None:
    device = controller()
    assert device.answer("*IDN?") == [f"(c) Physik Instrumente, C-884, 0, {SIMULATOR}"]
    assert device.answer("csv?") == ["2.0"]
    assert device.answer("VER?") == [f"FW: {SIMULATOR}"]
    assert device.answer("SAI?") == ["1 ", "2 ", "3 ", "4 ", "5"]
    assert device.answer("CST? 2") == ["2=SIMULATED"]
    assert device.answer("CST?")[0] == "1=SIMULATED "
    assert device.answer("SVO? 1 5") == ["1=1 ", "5=1"]
    assert device.answer("FRF?") == ["1=1 ", "2=1 ", "3=1 ", "4=1 ", "5=1"]
    assert device.answer("ONT?") == ["1=1 ", "2=0 ", "3=1 ", "4=1 ", "5=1"]
    assert device.answer("\x05") == ["2"]
    assert device.answer("\x07") == ["\xb1"]
    assert device.answer("") == []
    assert device.at_once == b"\x05\x07\x18"
    words = device.answer("HLP?")
    assert words[0] == "The following commands are valid: "
    assert words[-1] == "end of help"
    listed = {word.strip() for word in words[1:-1]}
    assert listed == {
        "#5", "#7", "#24", "*IDN?", "ERR?", "CSV?", "VER?", "SAI?", "CST?", "SVO?",
        "FRF?", "ONT?", "POS?", "MOV?", "TMN?", "TMX?", "VEL?", "HLP?", "MOV", "MVR",
        "SVO", "VEL", "FRF", "HLT", "STP",
    }  # fmt: skip
    for _ in range(1001):
        device.answer("ERR?")
    assert len(device.lines) == 1000


def test_axes_have_their_unit_zero_and_speed() -> None:
    device = controller(
        angle_per_unit="-2 deg", azimuth_zero=3.0, elevation_zero=-1.0,
        azimuth_axis="A", elevation_axis="B",
    )  # fmt: skip
    assert device.answer("POS? A B") == ["A=3.0000000 ", "B=-1.0000000"]
    # A quarter of a turn either way of the zero.
    assert device.answer("TMN?") == [
        "A=-42.0000000 ", "B=-46.0000000 ", "3=-360.0000000 ", "4=-360.0000000 ",
        "5=-1000.0000000",
    ]  # fmt: skip
    assert device.answer("TMX? A B") == ["A=48.0000000 ", "B=44.0000000"]
    device.answer("MOV A 13 B 4")
    ((goals, speed),) = device.bench.sent
    assert goals["azimuth"] == pytest.approx(-math.radians(20))
    assert goals["elevation"] == pytest.approx(-math.radians(10))
    assert speed == pytest.approx(5.0)
    assert device.answer("MOV? A") == ["A=13.0000000"]
    device.answer("MVR A -3")
    assert device.answer("MOV? A") == ["A=10.0000000"]
    degrees = math.degrees(5.0) / 2
    assert device.answer("VEL? A 3 5") == [
        f"A={degrees:.7f} ", f"3={math.degrees(10.0):.7f} ", "5=200.0000000"
    ]  # fmt: skip
    device.answer("VEL 5 100 A 7")
    device.answer("MOV 5 20")
    assert device.bench.sent[-1] == ({"target": pytest.approx(0.02)}, 0.1)
    device.answer("MOV A 4 5 20")
    # The speed is that of the first axis.
    assert device.bench.sent[-1][1] == pytest.approx(7 * math.radians(2))


def test_a_refused_line_moves_nothing() -> None:
    device = controller()
    device.answer("SVO 2 0")
    for line, code in (
        ("MOV 1 5 2 5", 5), ("MOV 1 5 9 1", 15), ("MOV 1 1000", 7), ("MOV 1", 1),
        ("MOV 1 2 3", 1), ("MVR 5 1000.1", 7), ("FRF 7", 15), ("VEL 1 0", 8),
        ("SVO 1 0.5", 17), ("POS? 7", 15), ("WHAT", 2), ("WHAT?", 2),
    ):  # fmt: skip
        assert device.answer(line) == []
        assert device.answer("ERR?") == [str(code)]
        assert device.answer("ERR?") == ["0"]
    assert device.bench.sent == []
    for line in ("MVR 5 1000", "FRF", "FRF 1", "SVO 2 1"):
        assert device.answer(line) == []
        assert device.answer("ERR?") == ["0"]
    device.answer("HLT 2 5")
    assert device.bench.sent[-1] == ["elevation", "target"]
    assert device.answer("ERR?") == ["10"]
    device.answer("STP 1")
    assert len(device.bench.sent[-1]) == 5
    device.bench.sent.clear()
    assert device.answer("\x18") == []
    assert len(device.bench.sent[-1]) == 5


def test_a_head_reads_frames_after_any_octets() -> None:
    cutter = SimulatedPelcoHead(StandInBench()).cutter()
    frame = bytes([255, 1, 0, 0x51, 0, 0, 0x52])
    assert [*cutter.split(b"")] == []
    # The mark of a frame may be the first octet.
    assert [*cutter.split(frame)] == [frame]
    assert [*cutter.split(b"\x00\x01")] == []
    assert [*cutter.split(frame[:6])] == []
    assert [*cutter.split(frame[6:] + frame)] == [frame, frame]
    # A mark within a broken frame begins the next one.
    assert [*cutter.split(frame[:3] + frame)] == [frame]
