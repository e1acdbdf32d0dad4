"""Simulated devices of a scan on a bench whose outputs and axes are set."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from stand_in_bench import SIGNAL, StandInBench

from amulor.acquisition.protocols import SIMULATOR, Overload
from amulor.acquisition.simulated.devices import (
    FULL_SCALES,
    SimulatedDigitiser,
    SimulatedLaser,
    SimulatedLaserDriver,
    SimulatedLockIn,
    SimulatedMount,
    SimulatedNavigation,
    SimulatedScanner,
    SimulatedShutter,
    SimulatedTargetStage,
    wait_for,
)
from amulor.errors import InstrumentError


@pytest.mark.parametrize(
    ("kind", "make"),
    [
        ("lock-in", SimulatedLockIn), ("scanner", SimulatedScanner),
        ("rotation mount", lambda bench: SimulatedMount(bench, "launch")),
        ("laser", SimulatedLaser), ("shutter", SimulatedShutter),
        ("target stage", SimulatedTargetStage), ("digitiser", SimulatedDigitiser),
        ("navigation", lambda bench: SimulatedNavigation(bench, None, 0.0)),
    ],
)  # fmt: skip
def test_a_device_says_that_it_is_simulated(kind, make) -> None:
    assert make(StandInBench()).identity() == f"amulor,{kind},0,{SIMULATOR}"


class Axes(StandInBench):
    """Axes that arrive half a second after they are sent."""

    def __init__(self, late: float = 0.5) -> None:
        super().__init__()
        self.late, self.due = late, -math.inf

    def send(self, goals: dict[str, float], *, speed: float) -> None:
        super().send(goals, speed=speed)
        self.due = self.clock.now() + self.late

    def arrived(self, name: str) -> bool:
        return self.clock.now() >= self.due

    def arrival(self, name: str) -> float:
        return self.due


def test_moves_wait_for_their_axis_and_read_back() -> None:
    bench = Axes()
    scanner = SimulatedScanner(bench)
    assert scanner.move(0.1, -0.2, timeout=3.0) == (0.1, -0.2)
    assert bench.clock.now() == 0.5
    assert bench.sent == [({"azimuth": 0.1, "elevation": -0.2}, 5.0)]
    assert scanner.log == ["move"]
    mount = SimulatedMount(bench, "analyser")
    assert mount.rotate(1.0, timeout=3.0) == 1.0
    assert bench.sent[-1] == ({"analyser": 1.0}, 10.0)
    stage = SimulatedTargetStage(bench)
    assert stage.take_out(timeout=3.0) == 0.2
    assert bench.sent[-1] == ({"target": 0.2}, 0.2)
    assert stage.bring_in(timeout=3.0) == 0.0
    assert bench.clock.now() == 2.0
    stuck = Axes(math.inf)
    for device, name, move in (
        (SimulatedScanner(stuck), "scanner", lambda d: d.move(0, 0, timeout=2.0)),
        (SimulatedMount(stuck, "launch"), "mount", lambda d: d.rotate(1, timeout=2.0)),
        (SimulatedTargetStage(stuck), "target", lambda d: d.take_out(timeout=2.0)),
    ):
        begun = stuck.clock.now()
        with pytest.raises(InstrumentError) as caught:
            move(device)
        assert str(caught.value) == (
            f"the simulated {name} has not come to where it was sent within 2 s; see "
            "what holds it"
        )
        assert stuck.clock.now() - begun == pytest.approx(2.02)


def test_a_wait_looks_again_every_hundredth_of_its_timeout() -> None:
    bench = Axes()
    bench.due = 0.5
    bench.arrival = lambda name: 0.1
    wait_for(bench, "azimuth", device="it", timeout=2.0)
    assert bench.clock.now() == pytest.approx(0.5, abs=0.021)


def test_a_sweep_is_as_fast_as_its_longer_way() -> None:
    bench = Axes()
    bench.places |= {"azimuth": 0.1, "elevation": 0.5}
    scanner = SimulatedScanner(bench)
    scanner.begin_sweep(0.4, 0.4, duration=2.0)
    assert bench.sent[-1] == (
        {"azimuth": 0.4, "elevation": 0.4}, pytest.approx(0.15)
    )  # fmt: skip
    bench.places |= {"azimuth": 0.1, "elevation": 0.5}
    scanner.begin_sweep(0.0, -0.5, duration=2.0)
    assert bench.sent[-1][1] == pytest.approx(0.5)
    scanner.make_safe()
    assert bench.sent[-1] is None
    scanner.close()
    assert scanner.log == ["sweep", "sweep", "safe", "close"]


def test_laser_and_shutter_log_their_commands() -> None:
    bench = StandInBench()
    bench.set_shutter = lambda *, closed: bench.sent.append(closed)
    laser, shutter = SimulatedLaser(bench), SimulatedShutter(bench)
    laser.on()
    assert bench.laser_on
    laser.check()
    laser.make_safe()
    assert not bench.laser_on
    assert laser.log == ["on", "off"]
    bench.interlock_is_closed = False
    with pytest.raises(InstrumentError) as caught:
        laser.check()
    assert str(caught.value) == (
        "the interlock of the simulated laser is open; see who opened it, and close it"
    )
    shutter.shut()
    shutter.open()
    shutter.make_safe()
    assert bench.sent == [True, False, True]
    assert shutter.log == ["shut", "open", "safe"]


def test_readings_of_a_lock_in_end_at_its_scale() -> None:
    bench = StandInBench()
    bench.frequencies = [20e6, 39e6]
    lock_in = SimulatedLockIn(bench)
    first, second = lock_in.read_all()
    assert (first.signal, second.signal) == (SIGNAL, SIGNAL * 2 / abs(SIGNAL * 2))
    assert first.overload == second.overload == Overload.OUTPUT
    assert (first.modulation_frequency, second.modulation_frequency) == (20e6, 39e6)
    assert first.mean == 0.25
    assert not first.unlocked
    bench.frequencies = [39e6]
    assert lock_in.read().overload == Overload.NONE
    bench.signal = 0j
    assert lock_in.sharpen(0.05)
    assert lock_in.read().signal == 0
    bench.is_locked = False
    assert lock_in.read().unlocked


def test_faults_of_a_lock_in_are_errors_and_bits() -> None:
    lock_in = SimulatedLockIn(
        StandInBench("lost-link@1", "timeout@2", "overload@3", "unlock@4")
    )
    for text in ("the simulated lock-in: the link is lost",
                 "the simulated lock-in does not answer in time"):  # fmt: skip
        with pytest.raises(InstrumentError) as caught:
            lock_in.read()
        assert str(caught.value) == text
    assert lock_in.read().overload == Overload.INPUT
    assert lock_in.read().unlocked


def test_a_lock_in_waits_for_its_reference() -> None:
    class Locks(StandInBench):
        def locked(self) -> bool:
            return self.clock.now() >= 0.045

    bench = Locks()
    lock_in = SimulatedLockIn(bench)
    assert lock_in.set_frequency(20e6, timeout=1.0) == 20e6
    assert bench.clock.now() == pytest.approx(0.05)
    assert lock_in.set_frequencies([20e6, 39e6], timeout=1.0) == [20e6, 39e6]
    never = StandInBench()
    never.is_locked = False
    with pytest.raises(InstrumentError) as caught:
        SimulatedLockIn(never).set_frequency(20e6, timeout=0.1)
    assert str(caught.value) == "the simulated lock-in has not locked within 0.1 s"
    assert never.clock.now() == pytest.approx(0.11)


def test_scales_go_by_tens_and_only_if_light_allows_it() -> None:
    lock_in = SimulatedLockIn(StandInBench())
    assert not lock_in.relieve(Overload.OUTPUT)
    assert lock_in.sharpen(0.05)
    assert lock_in.full_scale() == pytest.approx(0.1)
    assert not lock_in.sharpen(0.00501)
    assert lock_in.relieve(Overload.OUTPUT)
    for _ in range(7):
        assert lock_in.sharpen(0.0)
    assert lock_in.full_scale() == pytest.approx(1e-7)
    assert not lock_in.sharpen(0.0)


class Traced(StandInBench):
    """A bench whose trace is one row for each interval since its start."""

    trace_start = 0.0

    def start_trace(self, interval: float, **more: Any) -> None:
        super().start_trace(interval, **more)
        self.trace_start, self._interval = self.clock.now(), interval

    def trace(self) -> list[list[complex]]:
        passed = self.clock.now() - self.trace_start
        count = int(passed / self._interval + 1e-9) + 1
        return [[complex(k), 2j * k] for k in range(count)]


def test_a_record_has_ten_points_in_a_time_constant() -> None:
    bench = Traced("unlock@1")
    bench.frequencies, bench.signal = [20e6, 39e6], 1e-3
    lock_in = SimulatedLockIn(bench)
    lock_in.prepare(time_constant=0.2)
    assert bench.time_constant == 0.2
    bench.clock.sleep(3.0)
    recorded = lock_in.record(0.1)
    assert bench.traces == [(pytest.approx(0.02), {"most": 6})]
    assert bench.clock.now() == pytest.approx(3.1)
    assert_allclose(recorded.times, 0.02 * np.arange(6))
    assert_allclose(recorded.signals, np.outer(np.arange(6), [1, 2j]))
    assert recorded.mean == 0.25
    assert recorded.modulation_frequencies == (20e6, 39e6)
    # Signals of up to 10 V are beyond the scale of 1 V.
    assert recorded.overload == Overload.OUTPUT
    assert recorded.unlocked
    short = lock_in.record(0.0)
    assert short.times.tolist() == [0.0]
    assert short.overload == Overload.NONE
    assert not short.unlocked


def test_a_stream_returns_what_is_new() -> None:
    bench = Traced("unlock@2")
    bench.frequencies, bench.signal = [20e6, 39e6], 1e-3
    lock_in = SimulatedLockIn(bench)
    lock_in.prepare(time_constant=0.2)
    bench.clock.sleep(3.0)
    lock_in.begin_stream(0.11)
    assert bench.traces == [(pytest.approx(0.02), {"most": 2 + 6})]
    first = lock_in.fetch()
    assert_allclose(first.times, [3.0])
    assert first.overload == Overload.NONE
    assert not first.unlocked
    bench.clock.sleep(0.041)
    second = lock_in.fetch()
    assert_allclose(second.times, [3.02, 3.04])
    assert_allclose(second.signals, [[1, 2j], [2, 4j]])
    assert second.mean == 0.25
    assert second.modulation_frequencies == (20e6, 39e6)
    assert second.overload == Overload.OUTPUT
    assert second.unlocked
    empty = lock_in.fetch()
    assert empty.signals.shape == (0, 2)
    assert empty.overload == Overload.NONE


class Instant(StandInBench):
    def instant(self) -> tuple[list[complex], float]:
        self.readings += 1
        return [self.signal] * len(self.frequencies), 0.25


def digitiser(*faults: str, **more: Any) -> SimulatedDigitiser:
    bench = Instant(*faults)
    bench.frequencies, bench.signal, bench.noise = [1e6], 0.02j, 0.0
    made = SimulatedDigitiser(bench, **{"sample_rate": 8e6, **more})
    made.set_range(2)
    made.puts_out = True
    return made


def test_a_digitizer_records_the_detector_by_its_own_clock() -> None:
    card = digitiser(clock_offset=0.25, bits=24)
    wave = card.acquire(2e-4)
    assert wave.signal.size == wave.reference.size == 1600
    assert card.bench.clock.now() == pytest.approx(2e-4)
    assert (wave.sample_rate, wave.shows_mean, wave.clipped) == (8e6, True, False)
    # Its clock runs at 10 MHz: ten samples are a period.
    assert_allclose(wave.signal[10:] - wave.signal[:-10], 0, atol=1e-6)
    assert wave.signal.mean() == pytest.approx(0.25, abs=1e-6)
    assert np.abs(wave.signal - 0.25).max() == pytest.approx(0.02, rel=0.06)
    # The reference is 0.1 V with a noise of 0.1 mV; the echo is a quarter late.
    turn = np.exp(2j * np.pi * np.arange(1600) / 10)
    echo, drive = (2 * (part * turn).mean() for part in (wave.signal, wave.reference))
    assert abs(drive) == pytest.approx(0.1, rel=1e-3)
    assert echo / drive == pytest.approx(0.2j, abs=1e-3)
    rest = wave.reference - (np.conj(drive) * turn).real
    assert rest.std() == pytest.approx(1e-4, rel=0.15)


def test_a_record_has_1024_samples_to_all_of_the_memory() -> None:
    card = digitiser(memory=2000)
    for duration, count in ((1e-9, 1024), (1.5e-4, 1200), (1.0, 2000)):
        assert card.acquire(duration).signal.size == count


def test_a_digitizer_has_the_noise_of_its_band() -> None:
    card = digitiser(memory=16_384)
    card.bench.signal, card.bench.noise = 0j, 1e-4
    wave = card.acquire(1.0)
    # The variance behind a filter of 10 ms, in half of 8 MHz.
    expected = 1e-4 * math.sqrt(0.01 * 8e6)
    assert wave.signal.std() == pytest.approx(expected, rel=0.03)


def test_a_digitizer_clips_and_rounds_at_its_range() -> None:
    card = digitiser(bits=8)
    card.bench.signal = 2.0
    wave = card.acquire(1e-4)
    step = 1.0 / 2**7
    assert wave.signal.max() == 1 - step
    assert wave.signal.min() == -1.0
    assert wave.clipped
    assert_allclose(wave.signal / step, np.round(wave.signal / step))
    card.bench.signal = 0.7
    assert not card.acquire(1e-4).clipped
    card.set_range(3)
    assert card.acquire(1e-4).signal.max() == pytest.approx(0.95, abs=0.05)


def test_faults_of_a_digitizer() -> None:
    card = digitiser("timeout@1", "lost-link@2", "overload@3", "unlock@4")
    for _ in range(2):
        with pytest.raises(InstrumentError) as caught:
            card.acquire(1e-4)
        assert str(caught.value) == ("the simulated digitizer does not answer in time")
    assert card.acquire(1e-4).clipped
    assert np.abs(card.acquire(1e-4).reference).max() < 1e-3
    assert np.abs(card.acquire(1e-4).reference).max() > 0.05
    card.make_safe()
    assert np.abs(card.acquire(1e-4).reference).max() < 1e-3
    assert card.set_frequencies([1e6, 2e6], timeout=1.0) == [1e6, 2e6]
    assert card.puts_out
    card.prepare()
    assert not card.puts_out


def test_a_laser_driver_answers_and_warms_up() -> None:
    bench = StandInBench()
    driver = SimulatedLaserDriver(bench)
    asked = lambda line: driver.answer(line)[0]  # noqa: E731
    assert asked("*IDN?") == f"amulor,laser diode driver,0,{SIMULATOR}"
    assert asked("OUTP?") == "0"
    assert asked("SOUR:CURR?") == "8.000000e-02"
    assert asked("MEAS:CURR?") == "0.000000e+00"
    assert asked("MEAS:TEMP?") == "25.000"
    assert asked("INP:ILOCK?") == "1"
    assert driver.answer("SOUR:CURR 0.05") == []
    assert driver.answer("OUTP ON") == []
    assert bench.laser_on
    assert asked("OUTP?") == "1"
    assert asked("MEAS:CURR?") == "5.000000e-02"
    # Half a degree in ten seconds.
    bench.clock.sleep(4.0)
    assert asked("MEAS:TEMP?") == "25.200"
    bench.clock.sleep(40.0)
    assert asked("MEAS:TEMP?") == "25.500"
    assert driver.answer("WHAT") == []
    assert asked("SYST:ERR?") == '-113,"Undefined header"'
    assert asked("SYST:ERR?") == '0,"No error"'
    bench.interlock_is_closed = False
    assert asked("OUTP?") == "0"
    assert not bench.laser_on
    assert driver.answer("OUTP ON") == []
    assert asked("SYST:ERR?") == '-221,"Settings conflict; interlock open"'
    assert asked("INP:ILOCK?") == "0"
    bench.interlock_is_closed = True
    assert asked("OUTP?") == "0"
    driver.answer("OUTP ON")
    driver.answer("OUTP OFF")
    assert not bench.laser_on
    assert driver.lines[-1] == "OUTP OFF"


def test_messages_of_a_vehicle_are_those_since_the_last_call() -> None:
    class Vehicle:
        def messages(self, begin: float, end: float) -> list[tuple[float, str]]:
            return [(begin, "from"), (end, "to")]

    bench = StandInBench()
    bench.clock.sleep(100.0)
    navigation = SimulatedNavigation(bench, Vehicle(), 7.0)
    navigation.begin()
    # The scan began 7 s before.
    assert bench.scan_start == 93.0
    bench.clock.sleep(2.0)
    assert navigation.messages() == [(100.0, "from"), (102.0, "to")]
    bench.clock.sleep(1.0)
    assert navigation.messages() == [(102.0, "from"), (103.0, "to")]


def test_full_scales_are_powers_of_ten() -> None:
    assert_allclose(FULL_SCALES, 10.0 ** np.arange(-7, 1))
