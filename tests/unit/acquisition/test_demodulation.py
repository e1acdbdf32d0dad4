"""Records of a digitiser: exact sinusoids, leakage, clocks, noise, clipping, a scan."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as settings_of_hypothesis
from hypothesis import strategies as st
from shared_light import scene_light

from amulor import acquisition
from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import simulated_bench
from amulor.acquisition.demodulation import clock_offset, demodulate
from amulor.acquisition.devices import Devices
from amulor.acquisition.drivers.digitiser import DigitiserLockIn
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.plan import SCAN
from amulor.acquisition.protocols import Overload
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.devices import (
    SimulatedDigitiser,
    SimulatedLaser,
    SimulatedMount,
    SimulatedScanner,
    SimulatedTargetStage,
)
from amulor.errors import InstrumentError
from amulor.simulation import simulate
from amulor.survey import Survey

light = functools.cache(scene_light)
RATE = 125e6
COMB = (20.0e6, 31.0e6, 39.3e6, 47.123_456e6)


def exact(count: int, tones: dict[float, complex], *, rate: float = RATE, start=0.0):
    """Return sinusoids by extended precision, in no way that the program works."""
    time = (np.arange(count).astype(np.longdouble) / np.longdouble(rate)) + start
    two_pi = 2 * np.arccos(np.longdouble(-1))
    total = np.zeros(count, dtype=np.longdouble)
    for frequency, signal in tones.items():
        phase = two_pi * np.longdouble(frequency) * time - np.angle(signal)
        total += abs(signal) * np.cos(phase)
    return np.asarray(total, dtype=float)


@given(
    phases=st.lists(st.floats(-3.1, 3.1), min_size=4, max_size=4),
    sizes=st.lists(st.floats(1e-4, 1.0), min_size=4, max_size=4),
    offset=st.floats(-1, 1), count=st.integers(3000, 6000),
)  # fmt: skip
@settings_of_hypothesis(max_examples=25)
def test_exact_sinusoids_are_found_whatever_part_of_a_period_they_end_in(
    phases, sizes, offset, count
) -> None:
    signals = {
        f: a * np.exp(1j * p) for f, a, p in zip(COMB, sizes, phases, strict=True)
    }
    record = offset + exact(count, signals)
    found = demodulate(record, sample_rate=RATE, frequencies=COMB)
    np.testing.assert_allclose(found.signals, [*signals.values()], atol=1e-10)
    assert found.offset == pytest.approx(offset, abs=1e-10)
    assert (found.spreads < 1e-10).all()


def test_a_long_record_is_worked_on_in_parts_and_loses_no_digit() -> None:
    signals = dict(zip(COMB, [0.1, 0.2j, -0.3, 0.4 + 0.1j], strict=True))
    found = demodulate(exact(200_001, signals), sample_rate=RATE, frequencies=COMB)
    np.testing.assert_allclose(found.signals, [*signals.values()], atol=1e-10)


def test_a_strong_tone_does_not_leak_into_a_weak_one_beside_it() -> None:
    signals = {39.0e6: 1.0 + 0j, 39.02e6: 1e-5 * np.exp(0.7j)}
    record = exact(10_007, signals)
    found = demodulate(record, sample_rate=RATE, frequencies=[*signals])
    assert found.signals[1] == pytest.approx(signals[39.02e6], abs=1e-11)
    # A mixer and a mean, as a lock-in has it, would see the strong one there.
    time = np.arange(record.size) / RATE
    mixed = 2 * np.mean(record * np.exp(2j * np.pi * 39.02e6 * time))
    assert abs(mixed - signals[39.02e6]) > 1e-2


def test_undersampled_tones_are_found_and_those_that_alias_together_refused() -> None:
    signals = {71.0e6: 0.3 * np.exp(1j), 82.5e6: 0.1j}
    slow = exact(5000, signals, rate=10.1e6)
    found = demodulate(slow, sample_rate=10.1e6, frequencies=[*signals])
    np.testing.assert_allclose(found.signals, [*signals.values()], atol=1e-9)
    for pair in ((20e6, 30e6), (20e6, 20.000_001e6)):
        with pytest.raises(ValueError, match="do not tell the frequencies 20"):
            demodulate(slow, sample_rate=10e6, frequencies=pair)
    with pytest.raises(ValueError, match="at least 20 samples"):
        demodulate(slow[:19], sample_rate=10e6, frequencies=[2e6, 3e6])


@pytest.mark.parametrize("coloured", [False, True])
def test_the_stated_error_is_that_of_the_noise_beside_a_tone(coloured) -> None:
    rng = np.random.default_rng(5)
    count, runs = 4096, 120
    signals = dict(zip(COMB, [0.1, 0.2j, -0.3, 0.4], strict=True))
    clean = exact(count, signals)
    errors, stated = [], []
    for _ in range(runs):
        noise = 0.05 * rng.standard_normal(count)
        if coloured:  # ten times as strong at low frequencies as at the highest tone
            spectrum = np.fft.rfft(noise)
            spectrum *= 1 + 9 * np.exp(-np.linspace(0, 6, spectrum.size))
            noise = np.fft.irfft(spectrum, count)
        found = demodulate(clean + noise, sample_rate=RATE, frequencies=COMB)
        errors.append(found.signals - [*signals.values()])
        stated.append(found.spreads**2)
    error = np.array(errors)
    scatter = (error.real.var(axis=0) + error.imag.var(axis=0)) / 2
    # 240 numbers each: 9.1 % of a variance, five of them.
    np.testing.assert_allclose(np.mean(stated, axis=0) / scatter, 1.0, atol=0.46)
    if not coloured:
        np.testing.assert_allclose(scatter, 2 * 0.05**2 / count, rtol=0.46)
    else:
        assert scatter[0] > 2 * scatter[3]


@pytest.mark.parametrize("offset", [0.0, 3e-7, -2.1e-5, 9e-5])
def test_the_clock_of_the_generator_is_found_in_the_reference(offset) -> None:
    rng = np.random.default_rng(3)
    tones = {f * (1 + offset): 0.1 * np.exp(1j * f) for f in COMB}
    record = exact(50_000, tones, start=0.37)
    found = clock_offset(record, sample_rate=RATE, frequencies=COMB)
    assert found == pytest.approx(offset, abs=1e-12)
    noisy = record + 1e-3 * rng.standard_normal(record.size)
    found = clock_offset(noisy, sample_rate=RATE, frequencies=COMB)
    # By Cramer and Rao: sqrt(6 / n) * noise / amplitude / (pi f T), four tones.
    time = record.size / RATE
    error = np.sqrt(6 / record.size) * 1e-3 / 0.1 / np.pi / time
    error /= np.sqrt(np.sum(np.square(COMB)))
    assert abs(found - offset) < 6 * error


# -- as a lock-in ----------------------------------------------------------------------


@pytest.fixture(scope="session")
def four(small: Survey) -> Survey:
    """Return a survey of four frequencies at once."""
    return small.with_(
        {
            "instrument.modulation_frequencies": [f"{f / 1e6:.6f} MHz" for f in COMB],
            "instrument.modulation_depth": 0.25,
            "scan.dwell": "100 us",
            "instrument.lock_in.time_constant": "20 us",
            "scan.columns": 4,
            "scan.rows": 2,
            "scan.open_water": {"columns": 2, "rows": 2, "repeats": 1},
            "water.signal_fluctuation": "0 %",
            "instrument.lock_in.phase_floor": "0 deg",
        }
    )


def made(survey: Survey, *, faults=(), **more: object) -> tuple[Settings, Devices]:
    """Return settings and devices with a simulated digitiser."""
    settings = Settings.model_validate(
        {
            "procedure": {
                "dark_readings": 2, "frequencies_at_once": 4, "references": 1,
            },
            "simulation": {"faults": faults},
        }
    )  # fmt: skip
    clock = VirtualClock()
    bench = simulated_bench(survey, settings, scene=light, clock=clock)
    return settings, Devices(
        laser=SimulatedLaser(bench),
        lock_in=DigitiserLockIn(SimulatedDigitiser(bench, **more), clock=clock),
        scanner=SimulatedScanner(bench),
        launch=SimulatedMount(bench, "launch"),
        analyser=SimulatedMount(bench, "analyser"),
        target=SimulatedTargetStage(bench),
        clock=clock,
    )


@pytest.mark.parametrize("offset", [pytest.param(0.0, marks=pytest.mark.slow), 2e-5])
def test_a_scan_by_records_states_its_errors(four, folder, cube_of, offset) -> None:
    settings, devices = made(four, clock_offset=offset, memory=4096)
    outcome = acquisition.acquire(four, folder, settings=settings, devices=devices)
    assert outcome.finished
    assert not devices.lock_in._digitiser.puts_out
    cube = cube_of(folder)
    truth = simulate(four, rng=1)
    for name in ("in_phase", "quadrature"):
        expected = truth[f"truth_target_{name}"] + truth[f"truth_water_{name}"]
        pulls = ((cube[name] - expected) / cube[f"{name}_uncertainty"]).values
        assert abs(pulls.mean()) < 5 / np.sqrt(pulls.size)
        # Stated errors are known to 12 % themselves.
        assert abs(pulls.std() - 1) < 5 / np.sqrt(2 * pulls.size) + 0.02
    with Journal.read(folder) as journal:
        records = [record for _, record in journal.samples(SCAN)]
    # 4096 samples at 125 MHz, over and over in 100 us.
    assert {record.readings for record in records} == {3}
    assert all(record.spread > 0 for record in records)


def test_a_clipped_record_makes_room_and_is_flagged_where_there_is_none(
    four, folder
) -> None:
    _, devices = made(four)
    lock_in = devices.lock_in
    lock_in.prepare(time_constant=0.01)
    lock_in.set_frequencies(COMB, timeout=1.0)
    lock_in._set_range(0)
    lock_in._digitiser.ranges = (1e-7, 1e-6, 1e-5, 10.0)
    devices.laser.on()
    assert lock_in.record(0.0).overload == Overload.INPUT
    assert lock_in.relieve(Overload.INPUT)
    settings, devices = made(four, faults=["overload@10x9"])
    acquisition.acquire(four, folder, settings=settings, devices=devices)
    with Journal.read(folder) as journal:
        flags = [
            r.flags for kind in (SCAN, "open_water") for _, r in journal.samples(kind)
        ]
    assert any(flag & SampleFlag.OVERLOAD for flag in flags)


def test_a_lost_reference_is_no_sample_and_a_silent_card_an_error(four, folder) -> None:
    settings, devices = made(four, faults=["unlock@10x1"])
    outcome = acquisition.acquire(
        four, folder / "a", settings=settings, devices=devices
    )
    assert (outcome.finished, outcome.flagged) == (True, 4)
    settings, devices = made(four, faults=["timeout@20"])
    with pytest.raises(InstrumentError, match="does not answer in time"):
        acquisition.acquire(four, folder / "b", settings=settings, devices=devices)
    assert not devices.lock_in._digitiser.puts_out
    assert not devices.laser.bench.laser_on
