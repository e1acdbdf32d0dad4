"""The simulated instrument settles, locks, drifts and makes noise as it must."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from shared_light import scene_light

from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.connect import simulated_bench
from amulor.acquisition.protocols import Overload
from amulor.acquisition.settings import Settings
from amulor.acquisition.simulated.bench import LOCK_TIME, SCAN_SPEED, Bench
from amulor.acquisition.simulated.devices import SimulatedLockIn, SimulatedScanner
from amulor.acquisition.uncertainty import reading_variance, variance_ratio
from amulor.simulation import simulate
from amulor.survey import Survey

QUIET = {"launch": {"V": 0.0, "H": 1.5}, "analyser": {"V": 0.0, "H": 1.5}}
TAU = 0.01


def bench(survey: Survey, clock: VirtualClock, **simulation: object) -> Bench:
    settings = Settings.model_validate({"simulation": simulation})
    return simulated_bench(survey, settings, clock=clock, scene=scene_light)


@pytest.fixture
def quiet(small: Survey) -> Survey:
    """Return the survey with next to no noise: strong light, calm water, no jitter."""
    instrument = small.instrument.model_copy(
        update={
            "lock_in": small.instrument.lock_in.model_copy(update={"phase_floor": 0.0}),
            "detector": small.instrument.detector.model_copy(
                update={"volt_per_photoelectron_rate": 8e-18}
            ),
            "power": 20e3,
        }
    )
    water = small.water.model_copy(update={"signal_fluctuation": 0.0})
    return small.model_copy(update={"instrument": instrument, "water": water})


def test_a_settled_output_is_the_noiseless_signal_of_the_simulation(
    quiet, clock
) -> None:
    found = bench(quiet, clock, position_error=0.0)
    cube = simulate(quiet, rng=1)
    found.set_laser(True)
    for row, column in ((0, 0), (1, 3), (2, 4)):
        for pair, angle in (("VV", 0.0), ("VH", math.pi / 2)):
            where = cube.isel(row=row, column=column)
            goals = {
                "azimuth": float(where["azimuth"]),
                "elevation": float(where["elevation"]),
            }
            found.send(goals, speed=SCAN_SPEED)
            found.send({"analyser": angle}, speed=10.0)
            clock.sleep(1.0)
            here = where.sel(polarization=pair, modulation_frequency=39e6)
            expected = sum(
                complex(
                    here[f"truth_{part}_in_phase"], here[f"truth_{part}_quadrature"]
                )
                for part in ("target", "water")
            )
            # 1e-4: what is left of shot noise at this light, six standard errors.
            assert_allclose(found.output()[0], expected, rtol=1e-4)


def test_the_output_approaches_a_new_level_by_its_time_constant(quiet, clock) -> None:
    found = bench(quiet, clock, position_error=0.0)
    found.set_laser(True)
    clock.sleep(1.0)
    before, _ = found.output()
    found.set_laser(False)
    for passed in (1, 2, 5):
        clock.sleep(TAU if passed == 1 else TAU * (1 if passed == 2 else 3))
        after, _ = found.output()
        assert_allclose(abs(after / before), math.exp(-passed), rtol=1e-2)


def test_noise_has_the_variance_and_the_memory_of_the_filter(small, clock) -> None:
    water = small.water.model_copy(update={"signal_fluctuation": 0.0})
    found = bench(small.model_copy(update={"water": water}), clock, position_error=0.0)
    found.set_laser(True)
    clock.sleep(1.0)
    mean = found.output()[1]
    count, group = 4000, 4
    values = np.empty(count, dtype=complex)
    for number in range(count):
        clock.sleep(TAU)
        values[number] = found.output()[0]
    rate = mean / small.instrument.detector.volt_per_photoelectron_rate
    one = float(reading_variance(small, rate=rate, time_constant=TAU))
    for part in (values.real, values.imag):
        # A variance of n samples correlated by e^-1 has the relative standard error
        # sqrt(2 / n * (1 + r^2) / (1 - r^2)) = 2.6 %; five of them.
        assert_allclose(part.var(), one, rtol=0.13)
        averaged = part.reshape(-1, group).mean(axis=1).var()
        share = float(variance_ratio(group, spacing=1.0))
        assert_allclose(averaged, one * share, rtol=0.25)


def test_the_mean_output_counts_all_light_and_dark_counts(small, clock) -> None:
    detector = small.instrument.detector.model_copy(update={"dark_rate": 2e6})
    instrument = small.instrument.model_copy(update={"detector": detector})
    found = bench(small.model_copy(update={"instrument": instrument}), clock)
    clock.sleep(1.0)
    assert_allclose(found.output()[1], 2e6 * 8e-12)
    found.set_laser(True)
    clock.sleep(1.0)
    signal, mean = found.output()
    # Depth 0.8 at most of it comes back modulated.
    assert abs(signal) < 0.8 * (mean - 2e6 * 8e-12) * 1.2


def test_open_water_is_seen_with_the_target_out(quiet, clock) -> None:
    found = bench(quiet, clock, position_error=0.0)
    found.set_laser(True)
    clock.sleep(1.0)
    with_target, _ = found.output()
    found.send({"target": 0.2}, speed=0.2)
    clock.sleep(3.0)
    without, _ = found.output()
    shots = simulate(quiet, rng=1).amulor.open_water
    # The middle of the scan is the middle column of the first or second row of shots.
    expected = np.hypot(shots["in_phase"], shots["quadrature"]).isel(polarization=0)
    assert expected.min() * 0.9 < abs(without) < expected.max() * 1.1
    assert abs(without) != pytest.approx(abs(with_target), rel=1e-2)


def test_imperfections_are_what_they_say(quiet, clock) -> None:
    plain = bench(quiet, clock, position_error=0.0)
    odd = bench(
        quiet, clock, position_error=0.0, cable_delay=2e-9, pickup=3e-6, phase_walk=0.1
    )
    for one in (plain, odd):
        one.set_laser(True)
    clock.sleep(1.0)
    ideal, found = plain.output()[0], odd.output()[0] - 3e-6
    walk = 0.1 * math.log10(abs(ideal))
    expected = 2 * math.pi * 39e6 * 2e-9 + walk
    turned = np.angle(found / ideal * np.exp(-1j * expected))
    assert_allclose(turned, 0.0, atol=1e-3)
    odd.set_laser(False)
    clock.sleep(1.0)
    assert_allclose(odd.output()[0], 3e-6, atol=1e-9)


def test_phase_drifts_with_time(quiet, clock) -> None:
    found = bench(quiet, clock, position_error=0.0, phase_drift=0.01)
    found.set_laser(True)
    clock.sleep(1.0)
    first, _ = found.output()
    clock.sleep(10.0)
    later, _ = found.output()
    assert_allclose(np.angle(later / first), 0.1, atol=1e-3)


def test_motion_takes_its_time_and_can_be_stopped(small, clock) -> None:
    found = bench(small, clock, position_error=0.0)
    found.send({"azimuth": 0.5, "elevation": 0.0}, speed=5.0)
    clock.sleep(0.09)
    assert not found.arrived("azimuth")
    clock.sleep(0.02)
    assert found.arrived("azimuth")
    assert found.place("azimuth") == 0.5
    found.send({"azimuth": 0.0}, speed=5.0)
    found.stop()
    clock.sleep(1.0)
    assert found.place("azimuth") == 0.5


def test_the_phase_is_that_of_the_frequency_that_is_set(quiet, clock) -> None:
    # Far enough off the planned 39 MHz that the way of 3 m and more turns the phase.
    found = bench(quiet, clock, position_error=0.0)
    found.set_laser(True)
    clock.sleep(1.0)
    planned, _ = found.output()
    for frequency in (38.5e6, 40e6, 39e6):
        found.set_frequency(frequency)
        clock.sleep(1.0)
        level, _ = found.output()
        path = "instrument.modulation_frequencies"
        cube = simulate(quiet.with_({path: [frequency]}), rng=1)
        # Azimuth and elevation 0: the middle of an odd number of rows and columns.
        here = cube.isel(row=1, column=2, modulation_frequency=0, polarization=0)
        expected = sum(
            complex(here[f"truth_{part}_in_phase"], here[f"truth_{part}_quadrature"])
            for part in ("target", "water")
        )
        # As above: what is left of shot noise.
        assert_allclose(level, expected, rtol=1e-4)
        if frequency != 39e6:
            assert abs(np.angle(level / planned)) > 0.02


def test_a_new_frequency_is_locked_to_after_a_while(small, clock) -> None:
    found = bench(small, clock)
    assert found.locked()
    found.set_frequency(40e6)
    assert not found.locked()
    clock.sleep(LOCK_TIME)
    assert found.locked()


def test_a_lock_in_has_full_scales_of_100_nv_to_1_v(quiet, clock) -> None:
    lock_in = SimulatedLockIn(bench(quiet, clock))
    scales = [lock_in.full_scale()]
    assert not lock_in.relieve(Overload.OUTPUT)
    # A finer scale for amplitudes up to a twentieth of the present one.
    assert not lock_in.sharpen(0.0501)
    while lock_in.sharpen(0.0499 * scales[-1]):
        scales.append(lock_in.full_scale())
    assert_allclose(scales, [1, 0.1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7])
    assert lock_in.relieve(Overload.OUTPUT)
    assert_allclose(lock_in.full_scale(), 1e-6)


@pytest.mark.parametrize("axis", ["azimuth", "elevation"])
@pytest.mark.parametrize("begin", [-0.2, 0.1])
def test_a_sweep_lasts_its_duration_from_any_direction(
    small, clock, axis, begin
) -> None:
    found = bench(small, clock, position_error=0.0)
    found.send({axis: begin}, speed=SCAN_SPEED)
    clock.sleep(1.0)
    goals = {"azimuth": 0.0, "elevation": 0.0, axis: 0.2}
    SimulatedScanner(found).begin_sweep(*goals.values(), duration=2.0)
    clock.sleep(1.0)
    assert found.place(axis) == pytest.approx((begin + 0.2) / 2)
    clock.sleep(0.99)
    assert not found.arrived(axis)
    clock.sleep(0.02)
    assert found.arrived(axis)


@pytest.mark.parametrize(
    "change",
    [
        lambda found: found.set_laser(False),
        lambda found: found.set_shutter(closed=True),
        lambda found: found.set_time_constant(1.0),
        lambda found: found.set_frequency(10e6),
        lambda found: found.send({"azimuth": 0.4}, speed=1e6),
    ],
)
def test_an_input_changes_the_output_from_its_own_moment_on(
    quiet, clock, change
) -> None:
    plain, changed = (bench(quiet, clock, position_error=0.0) for _ in range(2))
    plain.set_laser(True)
    changed.set_laser(True)
    # The output still rises.
    clock.sleep(TAU)
    change(changed)
    # As above: what is left of shot noise.
    assert_allclose(changed.output()[0], plain.output()[0], rtol=1e-4)
