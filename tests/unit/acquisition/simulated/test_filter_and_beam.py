"""Parts of the simulated bench by closed forms: places, output filter, axes, faults."""

from __future__ import annotations

import cmath
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from shared_light import scene_light

from amulor.acquisition.connect import simulated_bench
from amulor.acquisition.settings import Settings, SimulationSettings
from amulor.acquisition.simulated.bench import Bench, Fault, Faults, in_steps
from amulor.acquisition.simulated.scene import Places, Tone, mount_angles
from amulor.survey import Survey

TAU = 0.01


def places(*directions: complex) -> Places:
    at = np.array(directions)
    return Places(SimpleNamespace(azimuth=at.real, elevation=at.imag))


def test_a_place_is_the_nearest_direction() -> None:
    row = places(0, 0.1, 0.1 + 0.1j, 0.3)
    for azimuth, elevation, number in (
        (0.04, 0.0, 0), (0.06, 0.0, 1), (0.06, 0.09, 2), (0.19, 0.0, 1), (0.21, 0, 3)
    ):  # fmt: skip
        assert row.nearest(azimuth, elevation) == number
        # Again, from memory.
        assert row.nearest(azimuth, elevation) == number
    # Directions within 10 urad count as one, others do not.
    fine = places(0, 3e-5)
    assert fine.nearest(1.4e-5, 0.0) == 0
    assert fine.nearest(1.6e-5, 0.0) == 1
    assert fine.nearest(0.0, 1.0) == 0


def test_a_beam_passes_the_borders_between_places() -> None:
    row = places(0, 0.1, 0.2, 0.3, 0.1 + 5j)
    passed = row.passed(0.02 + 0j, 0.22 + 0j)
    # Borders at 0.05 and 0.15 of a way of 0.2.
    assert_allclose([part for part, _ in passed], [0.15, 0.65])
    assert [number for _, number in passed] == [1, 2]
    back = row.passed(0.22 + 0j, 0.02 + 0j)
    assert_allclose([part for part, _ in back], [0.35, 0.85])
    assert [number for _, number in back] == [1, 0]
    # Up: the border between 0.1 and 5j above it is at 2.5.
    up = row.passed(0.1 + 1j, 0.1 + 4j)
    assert up == [(pytest.approx(0.5), 4)]
    assert row.passed(0.0 + 0j, 0.04 + 0j) == []
    assert row.passed(0.0 + 0j, 0.05 - 1e-9 + 0j) == []
    # Places that are left at the same moment: the one that goes on farthest is next.
    corner = places(0, 0.1, 0.1j, 0.1 + 0.1j)
    assert corner.passed(0j, 0.1 + 0.1j) == [(pytest.approx(0.5), 3)]


def test_angles_of_mounts_are_those_of_a_pair(small: Survey) -> None:
    survey = small.with_({"instrument.polarizations": ["VH", "PR"]})
    found = mount_angles(survey, {"V": 0.1}, {"H": 0.2, "R": 0.3})
    assert found == [complex(0.1, 0.2), complex(1000, 0.3)]


def test_faults_last_for_their_readings() -> None:
    faults = Faults.parse(["unlock@500x3", "stuck@2"])
    assert faults.planned == (Fault("unlock", 500, 3), Fault("stuck", 2, 1))
    active = [n for n in range(498, 505) if faults.active("unlock", n)]
    assert active == [500, 501, 502]
    assert [n for n in range(5) if faults.active("stuck", n)] == [2]
    assert not faults.active("timeout", 500)


class NoNoise:
    """Random numbers that are all one."""

    def standard_normal(self, shape: Any = None) -> Any:
        return np.ones(shape) if shape else 1.0


def tone(level: complex, aim: complex, noise: complex = 0j) -> Tone:
    made = Tone(39e6, places(0), places(0), 0)
    made.level, made.input, made.noise = level, aim, noise
    return made


def test_a_filter_approaches_its_input_in_equal_steps() -> None:
    tones = [tone(1 + 1j, 3.0, 0.5), tone(0, 2j)]
    rows = in_steps(
        tones, start=1.0, interval=0.5 * TAU, count=3, time_constant=TAU, spread=0.1,
        settings=SimulationSettings(pickup=0.25), rng=NoNoise(),
    )  # fmt: skip
    keep = math.exp(-0.5)
    fresh = math.sqrt(1 - keep**2) * 0.1 * (1 + 1j)
    noise = [0.5, 0.0]
    for number, row in enumerate(rows, start=1):
        for k, (begin, aim) in enumerate(((1 + 1j, 3.25), (0, 0.25 + 2j))):
            noise[k] = keep * noise[k] + fresh
            level = aim + (begin - aim) * keep**number
            assert row[k] == pytest.approx(level + noise[k])
    assert len(rows) == 3
    for k, one in enumerate(tones):
        assert one.level + one.noise == pytest.approx(rows[-1][k])
        assert one.noise == pytest.approx(noise[k])


def test_a_drifting_input_turns_with_each_step() -> None:
    (only,) = in_steps(
        [tone(0, 1.0)], start=2.0, interval=0.1, count=1, time_constant=0.05,
        spread=0.0, settings=SimulationSettings(phase_drift=0.3), rng=NoNoise(),
    )  # fmt: skip
    expected = (1 - math.exp(-2)) * cmath.exp(0.3j * 2.1)
    assert only[0] == pytest.approx(expected)


@pytest.fixture
def quiet(small: Survey) -> Survey:
    """Return calm water without noise of phases; the light of one pixel counts."""
    return small.with_(
        {
            "water.signal_fluctuation": 0.0,
            "instrument.lock_in.phase_floor": "0 rad",
            "instrument.detector.dark_rate": "1e6 1/s",
        }
    )


def bench_of(survey: Survey, clock: Any, **simulation: Any) -> Bench:
    content = {"position_error": 0.0, **simulation}
    settings = Settings.model_validate({"simulation": content})
    made = simulated_bench(survey, settings, clock=clock, scene=scene_light)
    made._rng = SimpleNamespace(standard_normal=lambda: 0.0)
    return made


def test_a_settled_filter_has_its_input_and_a_moving_one_the_rest(quiet, clock) -> None:
    found = bench_of(quiet, clock, pickup=1e-3, leakage=2e-3)
    assert found.output() == (0, pytest.approx(8e-12 * 1e6))
    assert found.readings == 1
    clock.sleep(TAU)
    level = found.output()[0]
    assert level == pytest.approx(1e-3 * (1 - math.exp(-1)))
    found.set_laser(True)
    target = found._tones[0].input
    assert abs(target - 2e-3) > 1e-4
    clock.sleep(2 * TAU)
    aim = target + 1e-3
    level = aim + (level - aim) * math.exp(-2)
    assert found.output()[0] == pytest.approx(level)
    # A closed shutter leaves the leakage, and no light of the scene.
    found.set_shutter(closed=True)
    clock.sleep(1.0)
    signal, mean = found.output()
    assert signal == pytest.approx(3e-3)
    assert mean == pytest.approx(8e-12 * 1e6)
    found.set_shutter(closed=False)
    found.set_laser(False)
    clock.sleep(1.0)
    assert found.output()[0] == pytest.approx(1e-3)


def test_the_trace_has_the_output_at_each_interval(quiet, clock) -> None:
    found = bench_of(quiet, clock, pickup=1.0)
    found._rng = NoNoise()
    found._spread = 0.0
    found._renew = lambda **_: None
    found.start_trace(0.5 * TAU, most=5)
    assert found.trace_start == 0.0
    clock.sleep(1.2 * TAU)
    rows = np.array(found.trace())[:, 0]
    assert_allclose(rows, 1 - np.exp(-0.5 * np.arange(3)))
    clock.sleep(10 * TAU)
    rows = np.array(found.trace())[:, 0]
    assert_allclose(rows, 1 - np.exp(-0.5 * np.arange(5)))
    # Later steps follow from the time that passed.
    assert found.output()[0] == pytest.approx(1 - math.exp(-11.2))
    found.start_trace(TAU, most=2, start=1.0)
    assert found.trace() == []
    assert found.trace_start == 1.0
    clock.sleep(1.0 - clock.now())
    assert len(found.trace()) == 1
    assert found.time_constant == TAU


def test_water_and_target_change_as_they_are_told(quiet, clock) -> None:
    found = bench_of(quiet, clock, water_drift=0.5)
    found.set_laser(True)
    light = found._tones[0].scan.light
    here = (0, 0, found._tones[0].scan.nearest(0.0, 0.0))
    for passed, change in ((0.0, 1.0), (0.4, 1.2)):
        clock.sleep(passed)
        found._renew()
        expected = light.target[here] + change * light.water[here]
        assert found._tones[0].input == pytest.approx(expected)
        rate = light.target_rate[here] + change * light.water_rate[here]
        assert found._mean == pytest.approx(8e-12 * (rate + 1e6))
    drier = bench_of(quiet, clock, water_drift=-0.9)
    drier.set_laser(True)
    clock.sleep(10.0)
    drier._renew()
    assert drier._tones[0].input == pytest.approx(complex(light.target[here]))
    # Fluctuations of the water are one number for all frequencies.
    moving = bench_of(quiet.with_({"water.signal_fluctuation": 0.1}), clock)
    moving._rng = SimpleNamespace(standard_normal=lambda: 2.0)
    moving.set_laser(True)
    expected = light.target[here] + 1.2 * light.water[here]
    assert moving._tones[0].input == pytest.approx(expected)


def test_phases_have_cable_walk_and_floor(quiet, clock) -> None:
    survey = quiet.with_({"instrument.lock_in.phase_floor": "0.01 rad"})
    found = bench_of(survey, clock, cable_delay="2 ns", phase_walk="0.1 rad")
    found._drawn = {1: 3.0, 2: -1.0}
    base = 2 * math.pi * 39e6 * 2e-9
    assert found._phase_error(0.01, 39e6, 0) == pytest.approx(base - 0.2 + 0.03)
    assert found._phase_error(1.0, 39e6, 1) == pytest.approx(base - 0.01)
    assert found._phase_error(0.0, 39e6, 0) == pytest.approx(base + 0.03)


def test_noise_is_that_of_the_light(quiet, clock) -> None:
    found = bench_of(quiet, clock)
    # 2 F r / T of F = 1.2 and two time constants, times (8e-12 V s)^2.
    per_rate = (8e-12) ** 2 * 2 * 1.2 / (2 * TAU)
    assert found.noise == pytest.approx(math.sqrt(per_rate * 1e6))
    found.set_laser(True)
    rate = found._mean / 8e-12
    assert found.noise == pytest.approx(math.sqrt(per_rate * rate))
    found.set_time_constant(4 * TAU)
    assert found.noise == pytest.approx(math.sqrt(per_rate / 4 * rate))


def test_axes_arrive_together_at_the_speed_of_the_longest_way(small, clock) -> None:
    found = bench_of(small, clock)
    found.send({"azimuth": 0.5, "elevation": -0.1}, speed=5.0)
    assert found.arrival("azimuth") == found.arrival("elevation") == 0.1
    clock.sleep(0.05)
    assert found.place("azimuth") == pytest.approx(0.25)
    assert found.place("elevation") == pytest.approx(-0.05)
    assert found.goal("elevation") == -0.1
    assert not found.arrived("azimuth")
    # A new goal begins where the axis is.
    found.send({"azimuth": 0.0}, speed=5.0)
    assert found.arrival("azimuth") == pytest.approx(0.1)
    clock.sleep(0.025)
    assert found.place("azimuth") == pytest.approx(0.125)
    found.stop(["azimuth"])
    clock.sleep(1.0)
    assert found.place("azimuth") == pytest.approx(0.125)
    assert found.place("elevation") == -0.1
    assert found.arrived("azimuth")
    assert found.goal("azimuth") == pytest.approx(0.125)
    assert found.arrival("azimuth") == -math.inf


def test_a_stuck_axis_never_arrives(small, clock) -> None:
    found = bench_of(small, clock, faults=["stuck@0"])
    found.send({"azimuth": 0.5}, speed=5.0)
    clock.sleep(1e6)
    assert not found.arrived("azimuth")
    assert found.place("azimuth") == 0.0


def test_a_scanner_misses_its_place_and_others_do_not(small, clock) -> None:
    found = bench_of(small, clock, position_error=1e-3)
    found._rng = SimpleNamespace(standard_normal=lambda: 2.0)
    found.send({"azimuth": 0.5, "target": 0.1, "elevation": 0.2}, speed=5.0)
    clock.sleep(1.0)
    assert found.place("azimuth") == pytest.approx(0.502)
    assert found.place("elevation") == pytest.approx(0.202)
    assert found.place("target") == 0.1


def test_a_moving_beam_sees_the_places_on_its_way(quiet, clock) -> None:
    found = bench_of(quiet, clock)
    found.set_laser(True)
    light = found._tones[0].scan.light
    left, right = float(light.azimuth.min()), float(light.azimuth.max())
    row = float(np.sort(np.unique(light.elevation))[1])
    found.send({"azimuth": left, "elevation": row}, speed=5.0)
    clock.sleep(1.0)
    found.place("azimuth")
    found.send({"azimuth": right, "elevation": row}, speed=right - left)
    seen = []
    for _ in range(5):
        found.place("azimuth")
        seen.append(found._beam_place)
        clock.sleep(0.25)
    columns = [found._tones[0].scan.nearest(left + k * (right - left) / 4, row)
               for k in range(5)]  # fmt: skip
    # Five columns: the borders are passed at 1/8, 3/8 and so on of the way.
    assert seen[0] is None
    assert seen[1:4] == columns[1:4]
    found.place("azimuth")
    assert found._beam_place is None


def test_locking_lasts_50_ms(small, clock) -> None:
    found = bench_of(small, clock)
    found.set_frequencies([20e6, 39e6])
    assert found.frequencies == [20e6, 39e6]
    assert found.frequency == 20e6
    clock.sleep(0.0499)
    assert not found.locked()
    clock.sleep(0.0002)
    assert found.locked()


def test_new_frequencies_begin_at_the_outputs_before(quiet, clock) -> None:
    found = bench_of(quiet, clock, pickup=1.0)
    clock.sleep(1.0)
    assert found.output()[0] == pytest.approx(1.0)
    found.set_frequencies([39e6, 50e6])
    first, second = found.outputs()[0]
    assert (first, second) == (pytest.approx(1.0), 0)
    # Light at a frequency that is not planned is kept for sixteen of them.
    for number in range(20):
        found.set_frequency(60e6 + number)
    assert len(found._others) == 16
    assert 60e6 not in found._others
    assert 60e6 + 19 in found._others


def test_faults_block_the_light_or_saturate(quiet, clock) -> None:
    found = bench_of(
        quiet, clock, faults=["darkness@2", "saturation@4", "interlock@5x2"]
    )
    found.set_laser(True)
    dark = 8e-12 * 1e6
    means = [found.output()[1] for _ in range(6)]
    lit = means[0]
    assert lit > 2 * dark
    saturated = 2 * quiet.instrument.detector.saturation
    assert means == pytest.approx([lit, dark, lit, saturated, dark, dark])
    assert not found.interlock_is_closed
    found.output()
    assert found.interlock_is_closed


def test_the_filter_input_turns_and_has_the_pickup(quiet, clock) -> None:
    found = bench_of(quiet, clock, pickup=1e-3, phase_drift="0.3 rad")
    found.set_laser(True)
    clock.sleep(2.0)
    (signal,), mean = found.instant()
    assert found.readings == 1
    expected = found._tones[0].input * cmath.exp(0.6j) + 1e-3
    assert signal == pytest.approx(expected)
    assert mean == found._mean


def test_a_standing_reference_is_met_within_0_3_mrad(quiet, clock) -> None:
    survey = quiet.with_(
        {"scan.reference": {
            "azimuth": "0.2 rad", "elevation": "0.1 rad", "amplitude": "20 mV"}}
    )  # fmt: skip
    found = bench_of(survey, clock)
    found.set_laser(True)
    for off, amplitude in ((0.0, 0.02), (2.9e-4, 0.02), (3.1e-4, None)):
        for azimuth, elevation in ((0.2 + off, 0.1), (0.2, 0.1 - off)):
            found.send({"azimuth": azimuth, "elevation": elevation}, speed=5.0)
            clock.sleep(1.0)
            found.outputs()
            assert found._reference == amplitude
            if amplitude:
                assert abs(found._tones[0].input) == pytest.approx(0.02)
                rate = 0.02 / (0.8 * 8e-12)
                assert found._mean == pytest.approx(8e-12 * (rate + 1e6))


def test_the_pair_is_that_of_the_nearest_angles(small, clock) -> None:
    found = bench_of(small, clock)
    # VV and VH: the analyzer at 0 and at 90 degrees.
    for analyser, pair in ((0.7, 0), (0.9, 1)):
        found.send({"analyser": analyser}, speed=10.0)
        clock.sleep(1.0)
        found.place("analyser")
        assert found._polarization() == pair


def test_open_water_begins_at_5_cm_of_the_target(quiet, clock) -> None:
    found = bench_of(quiet, clock)
    found.set_laser(True)
    scan, water = found._tones[0].scan.light, found._tones[0].open_water.light
    here = (0, 0, found._tones[0].scan.nearest(0.0, 0.0))
    there = (0, 0, found._tones[0].open_water.nearest(0.0, 0.0))
    for place, expected in (
        (0.049, scan.target[here] + scan.water[here]),
        (-0.051, water.target[there] + water.water[there]),
    ):
        found.send({"target": place}, speed=0.2)
        clock.sleep(10.0)
        found.place("target")
        assert found._tones[0].input == pytest.approx(complex(expected))
