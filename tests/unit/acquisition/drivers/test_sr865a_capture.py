"""What an SR865A captures is taken over in one packet, and none of it is too old."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import simulated_bench
from amulor.acquisition.drivers.stanford_sr865a import Sr865a
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.protocols import Overload
from amulor.acquisition.rehearsal import rehearse
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.sr865a import SimulatedSr865a
from amulor.errors import InstrumentError
from amulor.simulation import simulate
from amulor.survey import Survey

light = functools.cache(scene_light)


class Wire:
    """A conversation with the simulated instrument that takes its time, and counts."""

    address = "a wire"

    def __init__(self, speaker: SimulatedSr865a, clock: VirtualClock, late: float):
        self.speaker, self.clock, self.late = speaker, clock, late
        self.asked: list[str] = []

    def send(self, line: str) -> None:
        assert not self.speaker.answer(line)

    def ask(self, line: str, *, answers: int = 1) -> list[str]:
        self.clock.sleep(self.late)
        self.asked.append(line)
        found = [text for one in line.split("\n") for text in self.speaker.answer(one)]
        self.clock.sleep(self.late)
        assert len(found) == answers
        return found


@pytest.fixture(scope="session")
def slow_light(small: Survey) -> Survey:
    """Return a survey of a frequency that an SR865A has."""
    return small.with_(
        {
            "instrument.modulation_frequencies": ["3.9 MHz"],
            "instrument.lock_in.time_constant": "3 ms",
            "scan.dwell": "15 ms",
            "water.signal_fluctuation": "0 %",
        }
    )


@pytest.fixture
def wire(slow_light, clock, request) -> tuple[Sr865a, Wire]:
    """Return a driver and its wire, which is late by what a test asks for."""
    bench = simulated_bench(slow_light, Settings(), scene=light, clock=clock)
    link = Wire(SimulatedSr865a(bench), clock, getattr(request, "param", 1e-4))
    driver = Sr865a(
        link, mean_output_input=1, modulation_amplitude=0.1, clock=clock
    )  # fmt: skip
    driver.prepare(time_constant=3e-3)
    driver.set_frequency(3.9e6, timeout=1.0)
    return driver, link


@pytest.mark.parametrize("wire", [0.0, 1e-4, 2e-3, 0.05], indirect=True)
def test_no_point_is_older_than_the_call_and_all_follow_each_other(wire) -> None:
    driver, link = wire
    bench = link.speaker.bench
    driver.record(0.015)  # the first one has to find out where the buffer is
    questions = 0
    for _ in range(20):
        # Light from the moment of the call on, in a filter that was empty before: the
        # points tell by themselves when they were taken.
        bench.set_laser(False)
        link.clock.sleep(0.1)
        bench._noise = bench._dark_variance = 0.0
        bench._variance_per_rate = 0.0
        bench.set_laser(True)
        called = link.clock.now()
        link.asked.clear()
        found = driver.record(0.015)
        took = link.clock.now() - called
        rate = 1 / found.times[1]
        assert 4 / 3e-3 <= rate < 8 / 3e-3
        assert 0.015 <= found.times[-1] < 0.015 + 1 / rate
        full = abs(bench._tones[0].input)
        part = np.abs(found.signals[:, 0]) / full
        since = -3e-3 * np.log1p(-np.minimum(part, 1 - 1e-12))
        # A phase floor turns the input by a milliradian; the noise is off.
        assert since[0] > -1e-5
        assert np.diff(since[part < 0.99]) == pytest.approx(1 / rate, rel=0.05)
        # And the call takes no longer than the dwell, two points of the buffer, a
        # packet or two, and what clocks may run apart in the 0.1 s between two calls.
        step = 1 / float(link.speaker.answer("CAPTURERATE?")[0])
        packets = 2 * link.late * len(link.asked)
        assert took < found.times[-1] + 2 * step + packets + 5e-4 * 0.3
        assert len(link.asked) <= 3
        questions += len(link.asked)
    # Late by more than the dwell, what is known from before is of little use.
    assert questions < 30 or link.late > 0.01


def test_answers_that_vary_in_lateness_make_no_point_older(wire) -> None:
    driver, link = wire
    rng = np.random.default_rng(3)
    bench = link.speaker.bench
    driver.record(0.015)
    for _ in range(30):
        link.late = float(rng.choice([1e-4, 2e-4, 4e-3]))
        bench.set_laser(False)
        link.clock.sleep(0.05)
        bench._noise = bench._dark_variance = bench._variance_per_rate = 0.0
        bench.set_laser(True)
        link.asked.clear()
        found = driver.record(0.015)
        part = np.abs(found.signals[0, 0]) / abs(bench._tones[0].input)
        assert -3e-3 * np.log1p(-part) > -1e-5
        assert len(link.asked) <= 3


def test_a_buffer_that_does_not_count_its_points_as_they_come_is_told(wire) -> None:
    driver, link = wire
    answer = link.speaker.answer

    def in_blocks(line: str) -> list[str]:
        found = answer(line)
        if line == "CAPTUREBYTES?":
            found = [str(int(found[0]) // 2048 * 2048)]
        return found

    link.speaker.answer = in_blocks
    with pytest.raises(InstrumentError, match="does not count its points as they come"):
        [driver.record(0.015) for _ in range(30)]


def test_the_buffer_begins_anew_before_it_is_full(wire, monkeypatch) -> None:
    driver, link = wire
    monkeypatch.setattr(
        "amulor.acquisition.drivers.stanford_sr865a._CAPACITY", 256
    )  # fmt: skip
    sent: list[str] = []
    send = link.send
    link.send = lambda line: (sent.append(line), send(line))
    for _ in range(40):
        assert len(driver.record(0.015).times) > 10
    assert sent.count("CAPTURESTART 0,0") > 2
    assert link.speaker.answer("CAPTURELEN?") == ["2"]


def test_an_overload_and_a_lost_reference_are_in_the_record(wire) -> None:
    driver, link = wire
    assert driver.record(0.015).overload == Overload.NONE
    link.speaker.answer("IRNG 4")  # 10 mV, behind the back of the driver
    link.speaker.bench.set_laser(True)
    link.clock.sleep(0.1)
    scale = abs(link.speaker.bench._tones[0].input)
    found = driver.record(0.015).overload
    assert bool(found & Overload.INPUT) == (scale > 0.01)
    link.speaker.answer("FREQ 3.8E6")
    assert driver.record(0.015).unlocked


def test_a_buffer_that_stands_still_is_told(wire) -> None:
    driver, link = wire
    driver.record(0.015)
    link.speaker.answer("CAPTURESTOP")
    with pytest.raises(InstrumentError, match=r"capture of SR865A.*has been stopped"):
        driver.record(0.015)


def test_a_scan_from_the_buffer_states_its_errors(slow_light, folder, cube_of) -> None:
    settings = Settings.model_validate(
        {
            "procedure": {
                "dark_readings": 2, "output_filter": "known", "readings": "buffer",
            }
        }
    )  # fmt: skip
    with rehearse(
        slow_light, settings, scene=light, model="sr865a", speed=5
    ) as rehearsal:
        outcome = acquisition.acquire(slow_light, folder, settings=rehearsal.settings)
        assert outcome.finished
        assert not rehearsal.bench.laser_on
    cube = cube_of(folder)
    truth = simulate(slow_light, rng=1)
    for name in ("in_phase", "quadrature"):
        expected = truth[f"truth_target_{name}"] + truth[f"truth_water_{name}"]
        pulls = ((cube[name] - expected) / cube[f"{name}_uncertainty"]).values
        assert abs(pulls.mean()) < 5 / np.sqrt(pulls.size)
        assert abs(pulls.std() - 1) < 5 / np.sqrt(2 * pulls.size)
    with Journal.read(folder) as journal:
        records = [record for _, record in journal.samples(SCAN)]
    assert all(record.readings >= 20 for record in records)
