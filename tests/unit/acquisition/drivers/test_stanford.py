"""Stanford lock-ins as conversations: the lines sent and the lines answered."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from driven_devices import Lines
from numpy.testing import assert_allclose

from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import LockInGate
from amulor.acquisition.drivers.stanford import (
    SENSITIVITIES,
    TIME_CONSTANTS,
    Sr844,
)
from amulor.acquisition.drivers.stanford_sr865a import SCALES, Sr865a
from amulor.acquisition.protocols import Overload
from amulor.acquisition.settings import LaserSettings
from amulor.acquisition.simulated.bench import Faults
from amulor.acquisition.simulated.sr865a import SimulatedSr865a
from amulor.errors import InstrumentError

IDN_844 = (
    ("OUTX 0", []),
    ("*IDN?", ["Stanford_Research_Systems,SR844,s/n12345,ver1.006"]),
)
IDN_865 = ("*IDN?", ["Stanford_Research_Systems,SR865A,002764,V1.51"])
PREPARE_844 = [
    ("*RST", []), ("FMOD 1", []), ("HARM 0", []), ("PHAS 0", []), ("OFSL 1", []),
    ("OFLT 4", []), ("WRSV 1", []), ("CRSV 1", []), ("SENS 14", []), ("*ESR?", ["0"]),
]  # fmt: skip
PREPARE_865 = [
    ("*RST", []), ("RSRC 0", []), ("HARM 1", []), ("PHAS 0", []), ("OFSL 0", []),
    ("OFLT 8", []), ("ADVFILT 0", []), ("SYNC 0", []), ("IRNG 0", []), ("SCAL 0", []),
    ("IVMD 0", []), ("ISRC 0", []), ("ICPL 0", []), ("SLVL 0.3", []), ("SOFF 0", []),
    ("*ESR?", ["0"]),
]  # fmt: skip


@pytest.fixture
def sr844(script, clock):
    """Return a prepared SR844 and the script behind it."""
    link = script(*IDN_844, *PREPARE_844)
    found = Sr844(link, mean_output_input=1, clock=clock)
    found.prepare(time_constant=0.01)
    assert not link.turns
    return found, link


@pytest.fixture
def sr865a(script, clock):
    """Return a prepared SR865A and the script behind it."""
    link = script(IDN_865, *PREPARE_865)
    found = Sr865a(link, mean_output_input=2, modulation_amplitude=0.3, clock=clock)
    found.prepare(time_constant=0.01)
    assert not link.turns
    return found, link


def test_tables_are_those_of_the_front_panels() -> None:
    assert len(TIME_CONSTANTS) == 18
    assert_allclose(TIME_CONSTANTS[4], 0.01)
    assert_allclose(TIME_CONSTANTS[-1], 30e3)
    assert len(SENSITIVITIES) == 15
    assert_allclose(SENSITIVITIES[::7], [100e-9, 300e-6, 1.0])
    assert len(SCALES) == 28
    assert_allclose(SCALES[:4], [1.0, 0.5, 0.2, 0.1])
    assert_allclose(SCALES[-2:], [2e-9, 1e-9])


def test_an_sr844_answers_peak_amplitude_with_the_phase_of_a_delay(sr844) -> None:
    instrument, link = sr844
    # The answer of the manual's own example, page 4-25, with AUX IN 1 last.
    link.extend(("SNAP? 1,2,8,6;LIAS?", ["0.9514E-3,-1.2271E-5,2.770E7,-3.219", "0"]))
    reading = instrument.read()
    # X and Y are rms; a delayed echo has negative Y there, and positive here.
    assert_allclose(reading.signal.real, 0.9514e-3 * math.sqrt(2))
    assert_allclose(reading.signal.imag, 1.2271e-5 * math.sqrt(2))
    assert reading.modulation_frequency == 27.7e6
    assert reading.mean == -3.219
    assert reading.overload == Overload.NONE
    assert not reading.unlocked


def test_an_sr844_without_a_mean_output_asks_for_none(script, clock) -> None:
    link = script(*IDN_844, ("SNAP? 1,2,8;LIAS?", ["1e-3,0,3.9e7", "0"]))
    found = Sr844(link, mean_output_input=None, clock=clock).read()
    assert math.isnan(found.mean)


@pytest.mark.parametrize(
    ("bits", "overload", "unlocked"),
    [
        (1, Overload.NONE, True),
        (2, Overload.NONE, True),
        (8, Overload.NONE, False),
        (16, Overload.INPUT, False),
        (32, Overload.RESERVE, False),
        (64, Overload.OUTPUT, False),
        (16 + 64 + 128, Overload.INPUT | Overload.OUTPUT, False),
        (256, Overload.OUTPUT, False),
        (512, Overload.OUTPUT, False),
        (1024, Overload.MEAN, False),
        (128 + 2048, Overload.NONE, False),
    ],
)
def test_status_bits_of_an_sr844(sr844, bits, overload, unlocked) -> None:
    instrument, link = sr844
    link.extend(("SNAP? 1,2,8,6;LIAS?", ["1e-3,0,3.9e7,0.1", str(bits)]))
    reading = instrument.read()
    assert (reading.overload, reading.unlocked) == (overload, unlocked)


def test_an_sr844_waits_for_lock_and_reads_its_frequency_back(sr844, clock) -> None:
    instrument, link = sr844
    link.extend(
        ("FREQ 3.9e+07", []), ("LIAS?", ["129"]), ("LIAS?", ["1"]), ("LIAS?", ["3"]),
        ("LIAS?", ["0"]), ("FREQ?", ["3.9E7"]),
    )  # fmt: skip
    assert instrument.set_frequency(39e6, timeout=1.0) == 39e6
    assert not link.turns
    assert clock.now() == pytest.approx(0.02)


def test_an_sr844_that_does_not_lock_says_so(sr844) -> None:
    instrument, link = sr844
    link.extend(("FREQ 3.9e+07", []), *[("LIAS?", ["1"])] * 20)
    with pytest.raises(
        InstrumentError, match=r"not locked to 3\.9e\+07 Hz within 0\.1 s"
    ):
        instrument.set_frequency(39e6, timeout=0.1)


@pytest.mark.parametrize("frequency", [1e3, 201e6])
def test_an_sr844_refuses_what_it_cannot_detect(sr844, frequency) -> None:
    with pytest.raises(InstrumentError, match=r"25000 to 2e\+08 Hz"):
        sr844[0].set_frequency(frequency, timeout=1.0)


def test_an_sr844_makes_room_where_it_lacks_it_and_then_by_sensitivity(sr844) -> None:
    instrument, link = sr844
    for amplitude, line in ((1e-3, "SENS 13"), (1e-3, "SENS 12"), (1e-3, "SENS 11")):
        link.extend((line, []))
        assert instrument.sharpen(amplitude)
    assert not instrument.sharpen(0.3 * instrument.full_scale())
    assert_allclose(instrument.full_scale(), 0.03 * math.sqrt(2))
    link.extend(("WRSV 0", []), ("SENS 12", []), ("CRSV 0", []), ("SENS 13", []))
    assert instrument.relieve(Overload.INPUT)
    assert instrument.relieve(Overload.INPUT)
    assert instrument.relieve(Overload.RESERVE)
    assert instrument.relieve(Overload.OUTPUT)
    link.extend(("SENS 14", []))
    assert instrument.relieve(Overload.RESERVE)
    assert not instrument.relieve(Overload.OUTPUT)
    assert not link.turns


def test_a_time_constant_that_is_not_on_the_dial_is_refused(script, clock) -> None:
    found = Sr844(script(*IDN_844), mean_output_input=None, clock=clock)
    with pytest.raises(InstrumentError, match=r"it has 0\.01 s and 0\.03 s"):
        found.prepare(time_constant=0.02)


def test_another_instrument_at_the_address_is_refused(script, clock) -> None:
    with pytest.raises(InstrumentError, match="needed is SR844"):
        Sr844(script(("OUTX 0", []), IDN_865), mean_output_input=None, clock=clock)


def test_a_refused_setting_is_an_error(script, clock) -> None:
    link = script(*IDN_844, *PREPARE_844[:-1], ("*ESR?", ["16"]))
    found = Sr844(link, mean_output_input=None, clock=clock)
    with pytest.raises(InstrumentError, match="event status 16"):
        found.prepare(time_constant=0.01)


@pytest.mark.parametrize("answer", ["", "1,2,3", "1,2,3,x", "1,2,3,nan", "1,2,3,4,5"])
def test_a_garbled_answer_is_no_measurement(sr844, answer) -> None:
    instrument, link = sr844
    link.extend(("SNAP? 1,2,8,6;LIAS?", [answer, "0"]))
    with pytest.raises(InstrumentError, match="needed are 4 numbers"):
        instrument.read()


def test_an_sr865a_answers_peak_amplitude_with_the_phase_of_a_delay(sr865a) -> None:
    instrument, link = sr865a
    link.extend(
        ("FREQ 2000000", []), ("LIAS?", ["8"]), ("LIAS?", ["0"]), ("FREQ?", ["2e6"]),
        ("SNAP? 0,1,5\nLIAS?", ["1e-3,-2e-3,0.25", "0"]),
    )  # fmt: skip
    assert instrument.set_frequency(2e6, timeout=1.0) == 2e6
    reading = instrument.read()
    assert_allclose(reading.signal, math.sqrt(2) * (1e-3 + 2e-3j))
    assert (reading.mean, reading.modulation_frequency) == (0.25, 2e6)


@pytest.mark.parametrize(
    ("bits", "overload", "unlocked"),
    [
        (1, Overload.OUTPUT, False),
        (2, Overload.OUTPUT, False),
        (8, Overload.NONE, True),
        (16, Overload.INPUT, False),
        (32, Overload.NONE, False),
    ],
)
def test_status_bits_of_an_sr865a(sr865a, bits, overload, unlocked) -> None:
    instrument, link = sr865a
    link.extend(("SNAP? 0,1,5\nLIAS?", ["1e-3,0,0.1", str(bits)]))
    reading = instrument.read()
    assert (reading.overload, reading.unlocked) == (overload, unlocked)


def test_an_sr865a_has_nothing_beyond_its_largest_input_range(sr865a) -> None:
    instrument, link = sr865a
    assert not instrument.relieve(Overload.INPUT)
    link.extend(("SCAL 1", []), ("SCAL 0", []))
    assert instrument.sharpen(0.1)
    assert instrument.relieve(Overload.OUTPUT)
    assert not instrument.relieve(Overload.OUTPUT)
    with pytest.raises(InstrumentError, match=r"0\.001 to 4e\+06 Hz"):
        instrument.set_frequency(39e6, timeout=1.0)


def test_an_sr865a_begins_with_its_stated_input_range(script, clock) -> None:
    lines = [("IRNG 3", []) if line == "IRNG 0" else (line, answer)
             for line, answer in PREPARE_865]  # fmt: skip
    link = script(IDN_865, *lines)
    instrument = Sr865a(
        link, mean_output_input=1, modulation_amplitude=0.3, input_range=0.03,
        clock=clock,
    )  # fmt: skip
    instrument.prepare(time_constant=0.01)
    # Wider and wider at an overload of the input, whatever the scale, to the end.
    link.extend(("IRNG 2", []), ("IRNG 1", []), ("IRNG 0", []))
    for left in (True, True, True, False):
        assert instrument.relieve(Overload.INPUT) is left
    assert not link.turns
    # The next scan begins with what is stated again.
    link.extend(*lines)
    instrument.prepare(time_constant=0.01)
    assert not link.turns


def test_the_gate_of_a_laser_is_read_back(sr844) -> None:
    instrument, link = sr844
    gate = LockInGate(instrument, LaserSettings(driver="lock_in_output", output=2))
    link.extend(
        ("AUXO 2,5.000;AUXO? 2", ["5.000"]), ("AUXO 2,0.000;AUXO? 2", ["0.002"])
    )
    gate.on()
    gate.off()
    link.extend(("AUXO 2,0.000;AUXO? 2", ["4.9"]))
    with pytest.raises(InstrumentError, match="switch it off by hand"):
        gate.off()
    assert "output 2 of Stanford" in gate.identity()


@pytest.mark.parametrize("output", [1, 2, 3, 4])
def test_an_sr865a_counts_its_outputs_from_zero(sr865a, output) -> None:
    # The maker's package srsinst.sr860 names AUXV 0 to 3 for the outputs 1 to 4.
    instrument, link = sr865a
    gate = LockInGate(instrument, LaserSettings(driver="lock_in_output", output=output))
    link.extend(
        (f"AUXV {output - 1},5.000;AUXV? {output - 1}", ["5.000"]),
        (f"AUXV {output - 1},0.000;AUXV? {output - 1}", ["0.000"]),
    )
    gate.on()
    gate.off()
    assert not link.turns
    assert f"output {output} of Stanford" in gate.identity()


@pytest.mark.parametrize(
    ("address", "interface"),
    [
        ("GPIB0::8::INSTR", 1),
        ("TCPIP::10.0.0.5::gpib0,8::INSTR", 1),
        ("ASRL3::INSTR", 0),
        ("tcp://10.0.0.5:4001", 0),
    ],
)
def test_an_sr844_is_told_first_where_to_answer(
    script, clock, address, interface
) -> None:
    link = script((f"OUTX {interface}", []), *IDN_844[1:])
    link.address = address
    Sr844(link, mean_output_input=2, clock=clock)
    assert not link.turns


@pytest.mark.parametrize("number", [0, 3, 4])
def test_an_sr844_has_two_auxiliary_inputs(script, clock, number) -> None:
    # SNAP? 8 and 9 are the reference frequency and a display, not a voltage.
    link = script()
    with pytest.raises(InstrumentError, match="auxiliary inputs 1 to 2, stated is"):
        Sr844(link, mean_output_input=number, clock=clock)


def test_no_sensitivity_helps_an_auxiliary_input(sr844, script, clock) -> None:
    instrument, link = sr844
    link.extend(("SENS 13", []))
    assert instrument.sharpen(1e-3)
    assert not instrument.relieve(Overload.MEAN)
    assert not link.turns
    # Where the mean output is not wired, nobody asks what overloads there.
    bare = script(*IDN_844, ("SNAP? 1,2,8;LIAS?", ["1e-3,0,3.9e7", "1024"]))
    found = Sr844(bare, mean_output_input=None, clock=clock).read()
    assert found.overload == Overload.NONE


def test_an_output_that_is_not_there_is_refused_before_a_word(sr844, sr865a) -> None:
    for (instrument, link), number, last in ((sr844, 3, 2), (sr865a, 5, 4)):
        with pytest.raises(InstrumentError, match=f"auxiliary outputs 1 to {last}"):
            instrument.set_output(number, 5.0)
        assert not link.turns


def test_a_gate_is_made_safe_over_a_new_link(sr844) -> None:
    instrument, link = sr844
    gate = LockInGate(instrument, LaserSettings(driver="lock_in_output"))
    link.extend(
        ("AUXO 1,0.000;AUXO? 1", ["garbled"]),
        ("OUTX 0", []),
        ("AUXO 1,0.000;AUXO? 1", ["0"]),
    )
    gate.make_safe()
    assert link.reopened == 1
    assert not link.turns


@pytest.mark.parametrize(
    ("code", "limit"), [(0, 1.0), (1, 0.3), (2, 0.1), (3, 0.03), (4, 0.01)]
)
def test_an_input_range_of_an_sr865a_ends_at_its_voltage(code, limit) -> None:
    # Ranges as the manual names them (IRNG, 0 to 4: 1 V to 10 mV), peak voltages.
    bench = SimpleNamespace(
        faults=Faults(), readings=1, noise=0.0, interlock_is_closed=True,
        locked=lambda: True, frequency=1e6, set_laser=lambda on: None,
        set_time_constant=lambda constant: None,
    )  # fmt: skip
    speaker = SimulatedSr865a(bench)
    instrument = Sr865a(
        Lines(speaker.answer), mean_output_input=1, modulation_amplitude=0.5,
        clock=VirtualClock(),
    )  # fmt: skip
    instrument.prepare(time_constant=1e-3)
    speaker.answer(f"IRNG {code}")
    for peak, overload in ((0.98, Overload.NONE), (1.02, Overload.INPUT)):
        bench.output = lambda peak=peak: (complex(0.6, 0.8) * peak * limit, 0.0)
        assert instrument.read().overload == overload
    # What drives it begins at the widest one, whatever was set before.
    instrument.prepare(time_constant=1e-3)
    assert speaker.answer("IRNG?") == ["0"]
    bench.output = lambda: (0.98 + 0j, 0.0)
    assert instrument.read().overload == Overload.NONE
