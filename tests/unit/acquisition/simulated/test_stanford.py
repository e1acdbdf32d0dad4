"""Simulated Stanford lock-ins understand what the manuals say, and nothing else."""

from __future__ import annotations

import socket

import pytest
from shared_light import scene_light

from amulor.acquisition.connect import simulated_bench
from amulor.acquisition.links.tcp import DeviceServer
from amulor.acquisition.simulated.pi import SimulatedPiController
from amulor.acquisition.simulated.sr865a import SimulatedSr865a
from amulor.acquisition.simulated.stanford import SimulatedSr844


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


@pytest.mark.parametrize(
    ("model", "gate", "angle"),
    [(SimulatedSr844, "AUXO 1", "OUTP? 5"), (SimulatedSr865a, "AUXV 0", "OUTP? 3")],
)
def test_auto_phase_puts_all_of_the_signal_into_x(
    bench, clock, model, gate, angle
) -> None:
    device = model(bench)
    device.answer(f"{gate},5.0")
    clock.sleep(10.0)
    (before,) = map(float, device.answer(angle))
    assert abs(before) > 30
    device.answer("APHS")
    (after,) = map(float, device.answer(angle))
    assert after == pytest.approx(0, abs=5)
    (phase,) = map(float, device.answer("PHAS?"))
    assert phase == pytest.approx(before, abs=5)


def test_the_displays_of_an_sr844_show_x_and_y(bench, clock) -> None:
    device = SimulatedSr844(bench)
    device.answer("AUXO 1,5.0")
    clock.sleep(10.0)
    shown = [float(device.answer(f"OUTR? {channel}")[0]) for channel in (1, 2)]
    outputs = [float(device.answer(f"OUTP? {code}")[0]) for code in (1, 2)]
    assert shown == pytest.approx(outputs, rel=0.05)


@pytest.mark.parametrize(
    ("model", "low", "high"),
    # SR844: 25 kHz to 200 MHz; SR865A: 1 mHz to 4 MHz.
    [(SimulatedSr844, 25e3, 200e6), (SimulatedSr865a, 1e-3, 4e6)],
)
@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "-5", "0", "1e12", "1_0", ""])
def test_a_frequency_beyond_the_manual_is_an_error(
    bench, model, low, high, text
) -> None:
    device = model(bench)
    before = bench.frequency
    for argument in (text, repr(0.9 * low), repr(1.1 * high)):
        assert device.answer(f"FREQ {argument}") == []
        assert device.answer("*ESR?") == ["16"]
    assert bench.frequency == before
    for argument in (low, high):
        assert device.answer(f"FREQ {argument!r}") == []
        assert bench.frequency == pytest.approx(argument, rel=1e-3)
    assert device.answer("*ESR?") == ["0"]


@pytest.mark.parametrize(
    ("model", "line", "status"),
    [
        # An SR865A needs a space before a parameter and forbids one before "?".
        (SimulatedSr865a, "OFLT5", "32"),
        (SimulatedSr865a, "FREQ ?", "16"),
        *[
            (model, line, status)
            for model in (SimulatedSr844, SimulatedSr865a)
            for line, status in [
                ("FREQ? 7", "32"), ("*IDN? 5", "32"), ("*CLS 5", "32"),
                ("OFLT? 99", "16"), ("OFLT 1_0", "16"), ("OFLT 5.5", "16"),
                ("LIAS? 99", "16"), ("*SRE -1", "16"), ("*ESE 256", "16"),
                ("*ESE 8,1", "16"), ("*ESE 3,7", "16"), ("\u00e9", "32"),
            ]
        ],
        (SimulatedSr844, "PHAS? 5", "32"),
        (SimulatedSr844, "APHS 5", "32"),
        *[
            (SimulatedSr865a, f"{word} 5", "32")
            for word in (
                "FREQINT?", "FREQDET?", "FREQEXT?", "SNAPD?", "ILVL?", "ENBW?", "APHS",
                "CUROVLDSTAT?", "CAPTURELEN?", "CAPTURERATE?", "CAPTURESTOP",
            )
        ],
        *[(SimulatedSr844, f"OUTP? {code}", "16") for code in (0, 6, 10, -1)],
        *[(SimulatedSr844, f"OUTR? {code}", "16") for code in (0, 3)],
        *[
            (SimulatedSr865a, line, "16")
            for line in (
                "CAPTURESTART CONT,IMM", "OUTR? -1", "OAUX? -1", "CAPTURERATE -1",
                "CAPTURECFG -1", "CAPTUREGET? -1,1", "PSTF? -1",
                "CDSP -1,0", "CDSP? 4",
            )
        ],
    ],
)  # fmt: skip
def test_forms_that_manuals_do_not_have_are_errors(bench, model, line, status) -> None:
    device = model(bench)
    assert device.answer(line) == []
    assert device.answer("*ESR?") == [status]


@pytest.mark.parametrize("model", [SimulatedSr844, SimulatedSr865a])
@pytest.mark.parametrize("text", ["5", "5.0", "0.5E1"])
def test_a_code_may_be_written_as_any_number(bench, model, text) -> None:
    device = model(bench)
    assert device.answer(f"OFLT {text}") == []
    assert device.answer("OFLT?") == ["5"]
    assert device.answer("*ESR?") == ["0"]


def test_an_sr844_takes_spaces_anywhere(bench) -> None:
    device = SimulatedSr844(bench)
    (answer,) = device.answer("SNAP ? 1.0, 2.0")
    assert answer.count(",") == 1
    assert device.answer("FREQ ?;*ESR ?") == [device.answer("FREQ?")[0], "0"]


def test_an_sr865a_joins_the_answers_of_a_line(bench) -> None:
    device = SimulatedSr865a(bench)
    (one,) = device.answer("FREQ?")
    assert device.answer("FREQ?;FREQ?") == [f"{one};{one}"]
    assert device.answer("FREQ 1E6;PHAS 0") == []


def test_an_sr865a_takes_units_and_words(bench, clock) -> None:
    device = SimulatedSr865a(bench)
    for text, expected in (("10 kHz", 1e4), ("2 MHZ", 2e6), ("500 HZ", 500.0)):
        device.answer(f"FREQ {text}")
        assert bench.frequency == pytest.approx(expected)
    device.answer("CAPTURECFG XY")
    device.answer("CAPTURESTART ONE,IMM")
    assert device.answer("CAPTURESTAT?") == ["3"]
    assert device.answer("*ESR?") == ["0"]


@pytest.mark.parametrize(("model", "idle"), [(SimulatedSr844, 3), (SimulatedSr865a, 0)])
def test_service_is_requested_by_an_enabled_event(bench, model, idle) -> None:
    device = model(bench)
    assert device.answer("*STB?") == [str(idle)]
    device.answer("*ESE 32;*SRE 32;NONSENSE")
    # Event (32) and request of service (64).
    assert device.answer("*STB?") == [str(idle + 96)]
    assert device.answer("*STB? 6") == ["1"]


def test_an_sr844_notes_a_new_frequency(bench, clock) -> None:
    device = SimulatedSr844(bench)
    device.answer("FREQ 39E6")
    clock.sleep(1.0)
    device.answer("LIAS?")
    device.answer("FREQ 39.1E6")
    clock.sleep(1.0)
    assert int(device.answer("LIAS?")[0]) & 128 == 0
    device.answer("FREQ 50E6")
    assert int(device.answer("LIAS?")[0]) & 128 == 128
    assert int(device.answer("LIAS?")[0]) & 128 == 0


@pytest.fixture
def stages(bench, settings):
    """Return a simulated controller of five axes."""
    return SimulatedPiController(bench, settings)


def test_a_halt_stops_the_named_axes_only(stages, clock) -> None:
    stages.answer("MOV 1 20 2 20")
    clock.sleep(0.01)
    stages.answer("HLT 1")
    assert stages.answer("ERR?") == ["10"]
    assert stages.answer("ONT? 1 2") == ["1=1 ", "2=0"]
    clock.sleep(10.0)
    one, two = (float(line.partition("=")[2]) for line in stages.answer("POS? 1 2"))
    assert 0 < one < 19
    assert two == pytest.approx(20, abs=0.01)


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("VEL 1 1e9", "8"), ("VEL 1 nan", "8"), ("SVO 1 nan", "17"),
        ("SVO 1 2", "17"), ("MOV 1 1_0", "1"), ("MOV 1 nan", "7"), ("HLT 9", "15"),
    ],
)  # fmt: skip
def test_a_controller_refuses_by_the_codes_of_its_manual(stages, line, code) -> None:
    assert stages.answer(line) == []
    assert stages.answer("ERR?") == [code]


def test_octets_that_are_no_ascii_do_not_end_a_link(bench) -> None:
    device = SimulatedSr844(bench)
    with DeviceServer(device) as server:
        host, port = server.address.removeprefix("tcp://").split(":")
        with socket.create_connection((host, int(port)), timeout=5) as link:
            link.sendall(b"\xff\xe9\nFREQ nan\n*ESR?\n")
            assert link.recv(100) == b"48\n"


@pytest.mark.parametrize(
    ("model", "line"),
    [
        *[
            (model, line)
            for model in (SimulatedSr844, SimulatedSr865a)
            for line in (
                "*CLS", "*RST", "*SRE 8", "*ESE 3,1", "ERRE 1", "LIAE 2", "OFLT 5",
                "PHAS 10", "FREQ 1E6",
            )
        ],
        (SimulatedSr844, "AUXO 1,0.5"),
        (SimulatedSr844, "APHS"),
        *[
            (SimulatedSr865a, line)
            for line in (
                "APHS", "AUXV 1,0.5", "CDSP 0,2", "FREQINT 1E6", "CAPTURELEN 64",
                "CAPTURECFG XY", "CAPTURERATE 2", "CAPTURESTART ONE,IMM", "CAPTURESTOP",
            )
        ],
    ],
)  # fmt: skip
def test_a_setting_has_no_answer_and_the_next_command_has(bench, model, line) -> None:
    device = model(bench)
    assert device.answer(f"{line};*ESR?") == ["0"]
