"""Steps of the signal chain one by one, on a few samples."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light
from signal_chains import FREQUENCIES, chain

from amulor.simulation import instrument_errors, lock_in
from amulor.simulation.geometry import Setup
from amulor.simulation.instrument_errors import Chain
from amulor.simulation.lock_in import Light
from amulor.survey import Survey

#: Four readings of 0.125 s in each pixel.
STEP = 0.5


def light(*shape: int, seed: int = 1) -> Light:
    """Return drawn light of two frequencies and two channels."""
    rng = np.random.default_rng(seed)
    size = (2, 2, *shape)
    return Light(rng.normal(size=size) + 1j * rng.normal(size=size), rng.random(size))


def times(survey: Survey) -> np.ndarray:
    """Return the starts of all pixels of a scan in rows to the right."""
    return STEP * np.arange(24).reshape(4, 6)


def test_a_chain_has_errors_and_a_seed_of_its_own(survey: Survey) -> None:
    assert Chain.of(Setup(survey), 7) is None
    one, again, other = chain(survey), chain(survey), chain(survey, seed=8)
    assert one.entropy == again.entropy
    assert one.entropy != other.entropy
    rng = np.random.default_rng(7)
    setup = Setup(survey.with_({"instrument.errors": {}}))
    first, second = Chain.of(setup, rng), Chain.of(setup, rng)
    assert first is not None
    assert second is not None
    assert first.entropy != second.entropy
    # The generator itself goes on as if there were no errors.
    assert rng.normal() == np.random.default_rng(7).normal()


def test_a_clock_multiplies_all_frequencies(survey: Survey) -> None:
    assert_allclose(chain(survey).frequencies, FREQUENCIES)
    fast = chain(survey, clock={"frequency_error": 1e-3})
    assert_allclose(fast.frequencies, FREQUENCIES * 1.001)
    setup = fast.light_setup
    assert_allclose(setup.survey.instrument.modulation_frequencies, FREQUENCIES * 1.001)
    plain = chain(survey)
    assert plain.light_setup is plain.setup


def test_light_is_computed_at_harmonics_once_each(survey: Survey) -> None:
    found = chain(survey, harmonic={"fraction": 0.1, "order": 3})
    # Three times 20 MHz is the other frequency.
    expected = [20e6, 60e6, 180e6]
    assert_allclose(found._light_frequencies, expected)
    assert_allclose(
        found.light_setup.survey.instrument.modulation_frequencies, expected
    )
    values = np.arange(12.0).reshape(3, 2, 2)
    whole = Light(values + 0j, 2 * values, 3 * values)
    low = found.fundamental(whole)
    assert_array_equal(low.modulated, values[:2])
    assert_array_equal(low.mean, 2 * values[:2])
    assert_array_equal(np.asarray(low.variance), 3 * values[:2])
    high = found._at(whole, 3 * FREQUENCIES)
    assert_array_equal(high.mean, 2 * values[1:])
    exact = found.fundamental(Light(values + 0j, values))
    assert exact.variance == 0


def test_backlash_lags_behind_each_way(survey: Survey) -> None:
    time = times(survey)
    azimuth, elevation = np.zeros((4, 6)), np.ones((4, 6))
    still = chain(survey)
    assert still.pointed((azimuth, elevation, time))[0] is azimuth
    lag = chain(survey, pointing={"backlash": 0.02})
    found = lag.pointed((azimuth, elevation, time))
    assert_allclose(found[0], np.tile([[0.01], [-0.01]], (2, 6)))
    assert_array_equal(found[1], elevation)
    assert found[2] is time
    one_way = chain(survey.with_({"scan.order": "raster"}), pointing={"backlash": 0.02})
    assert_allclose(one_way.pointed((azimuth, elevation, time))[0], 0.01)


def test_jitter_of_a_row_does_not_depend_on_the_rows_around_it(survey: Survey) -> None:
    wide = survey.with_({"scan.columns": 400})
    time = STEP * np.arange(1600).reshape(4, 400)
    found = chain(wide, pointing={"jitter": 0.01})
    zero = np.zeros((4, 400))
    azimuth, elevation, _ = found.pointed((zero, zero, time))
    for angle in (azimuth, elevation):
        assert angle.std() == pytest.approx(0.01, rel=0.1)
        assert angle.mean() == pytest.approx(0, abs=0.001)
    assert abs(np.mean(azimuth * elevation)) < 0.01**2 / 10
    part = found.pointed((zero[2:3], zero[2:3], time[2:3]))
    assert_array_equal(part[0], azimuth[2:3])
    assert_array_equal(part[1], elevation[2:3])


@pytest.mark.parametrize(
    ("errors", "drifts"),
    [
        ({}, False),
        ({"drift": {}}, True),
        ({"crosstalk": {"amplitude": 1e-3}}, False),
        ({"crosstalk": {"amplitude": 1e-3, "change": -0.1}}, True),
        ({"noise": {"white": 1e-3}}, False),
        ({"noise": {"pink": 1e-3}}, True),
    ],
)
def test_references_are_in_rounds_about_the_scan_if_something_drifts(
    survey: Survey, errors: dict[str, Any], drifts: bool
) -> None:
    found = chain(survey, **errors)
    # Six directions, five times each.
    azimuth = np.repeat(np.arange(6.0), 5)
    elevation = azimuth + 10
    turned = found.shots(azimuth, elevation)
    expected = np.tile(np.arange(6.0), 5) if drifts else azimuth
    assert_array_equal(turned[0], expected)
    assert_array_equal(turned[1], expected + 10)
    # Three of five rounds come before the scan, or all of them.
    before = 18 if drifts else 30
    assert found.scan_start == STEP * before
    place = np.arange(30)
    place[before:] += 24
    assert_allclose(found.shot_times, STEP * place)
    assert found._duration == STEP * 53
    bare = chain(survey.with_({"scan.open_water": None}), **errors)
    assert bare.shots(azimuth, elevation)[0] is azimuth
    assert bare.scan_start == 0
    assert bare.shot_times.size == 0
    assert bare._duration == STEP * 23


def test_a_scan_of_one_pixel_lasts_a_step(survey: Survey) -> None:
    small = {"scan.columns": 1, "scan.rows": 1, "scan.open_water": None}
    assert chain(survey.with_(small))._duration == STEP


def test_a_drift_is_even_or_settles(survey: Survey) -> None:
    time = np.array([0.0, 5.3, 26.5])
    for errors in ({}, {"drift": {"phase": 0.1}}):
        assert_allclose(chain(survey, **errors)._course(time), time / 26.5)
    found = chain(survey, drift={"settling_time": 4.0})._course(time)
    assert_allclose(found, (1 - np.exp(-time / 4)) / (1 - np.exp(-26.5 / 4)))


def test_a_distance_turns_light_there_and_back(survey: Survey) -> None:
    index = Setup(survey).water
    found = chain(survey)._turn(1.5, 4)
    assert found.shape == (2, 1, 1, 1)
    turns = 2 * FREQUENCIES * index.group_index * 1.5 / speed_of_light
    assert_allclose(found.ravel(), np.exp(2j * np.pi * turns))
    places = chain(survey)._turn(np.full((2, 2, 5), 1.5), 3)
    assert_allclose(places, np.broadcast_to(found[..., 0], (2, 2, 5)))


def test_a_plume_adds_light_and_weakens_what_is_behind(survey: Survey) -> None:
    target, water = light(1, 3), light(1, 3, seed=2)
    azimuth = np.array([[-0.1, 0.02, 0.05]])
    unchanged = chain(survey)._behind_plume(target, water, azimuth)
    assert unchanged[0] is target
    plume = {"fraction": 0.3, "distance": 1.2, "optical_thickness": 0.4}
    for more, profile in (
        ({}, np.ones(3)),
        ({"width": 0.04, "azimuth": 0.02}, np.exp([-4.5, 0, -0.28125])),
    ):
        found = chain(survey, plume=plume | more)
        behind, before = found._behind_plume(target, water, azimuth)
        passed = np.exp(-0.8 * profile)
        assert_allclose(behind.modulated, target.modulated * passed)
        assert_allclose(behind.mean, target.mean * passed)
        added = 0.3 * profile * water.mean
        assert_allclose(before.mean, water.mean + added)
        turned = added * found._turn(1.2, 4)
        assert_allclose(before.modulated, water.modulated + turned)


def test_bubbles_are_bright_by_the_square_of_their_distance(survey: Survey) -> None:
    water = Light(np.ones((2, 2, 8000), complex), np.full((2, 2, 8000), 0.5))
    bubbles = {"number": 2.5, "fraction": 0.4, "nearest": 1.0, "farthest": 4.0}
    found = chain(survey, bubbles=bubbles)
    added = found._bubbles([3], water, part="scan")
    # The mean of (1 / d)^2 from 1 m to 4 m is 1 / 4.
    size = added.mean / (0.4 * 0.5)
    error = size.std() / np.sqrt(size.size)
    assert size.mean() == pytest.approx(2.5 / 4, abs=4 * error)
    assert error < 0.01
    assert size.max() > 1
    # None in a sample without a bubble: exp(-2.5) of them.
    assert np.mean(size == 0) == pytest.approx(np.exp(-2.5), abs=0.01)
    assert_array_equal(found._bubbles([3], water, part="scan").mean, added.mean)
    other = found._bubbles([4], water, part="scan").mean
    assert not np.array_equal(other, added.mean)


def test_bubbles_at_one_distance_have_its_phase_and_their_part(survey: Survey) -> None:
    water = light(50)
    bubbles = {"number": 3.0, "fraction": 0.4, "nearest": 2.0, "farthest": 2.000001}
    found = chain(survey, bubbles=bubbles | {"part": "open_water"})
    added = found._bubbles([3], water, part="open_water")
    assert_allclose(added.modulated, added.mean * found._turn(2.0, 3), rtol=1e-4)
    count = added.mean / (0.4 * water.mean)
    assert_allclose(count, np.rint(count), atol=1e-4)
    assert count.max() >= 5
    none = found._bubbles([3], water, part="scan")
    assert not none.mean.any()
    assert not none.modulated.any()
    assert none.modulated.shape == (2, 2, 50)
    assert not chain(survey)._bubbles([3], water, part="scan").mean.any()


def test_leakage_is_light_behind_the_analyzer(survey: Survey) -> None:
    leak = {"fraction": 0.01, "delay": 3e-9, "depolarization": 0.5, "part": "scan"}
    found, given = chain(survey, optical_leakage=leak), light(2, 3)
    # Half of the light is vertical still: VV passes 3/4, VH 1/4.
    assert_allclose(found._passed(found.errors.optical_leakage), [0.75, 0.25])
    added = found._detected(given, part="scan")
    share = 0.01 * np.array([0.75, 0.25])[:, None, None]
    turn = np.exp(2j * np.pi * FREQUENCIES * 3e-9)[:, None, None, None]
    assert_allclose(added.modulated, given.modulated + share * turn)
    assert_allclose(added.mean, given.mean + share)
    assert found._detected(given, part="open_water") is given


def test_a_counter_loses_pulses_and_adds_late_ones(survey: Survey) -> None:
    lit = survey.with_(
        {"instrument.detector.dark_rate": 2e6, "daylight": {
            "radiance": 1e6, "bandwidth": 1e-9}}
    )  # fmt: skip
    found = chain(lit, counting={"dead_time": 1e-7, "after_pulse_probability": 0.05,
                                 "after_pulse_delay": 2e-9})  # fmt: skip
    setup = found.setup
    given = light(3)
    scaled = Light(given.modulated * 1e-9, given.mean * 1e-9, given.mean)
    out = found._detected(scaled, part="scan")
    daylight = setup.daylight_rate
    assert np.all(daylight > 1e3)
    rate = setup.full_rate * scaled.mean + 2e6 + daylight[:, None]
    live = 1 / (1 + rate * 1e-7)
    after = 1 + 0.05 / (1 - 2j * np.pi * FREQUENCIES * 2e-9)[:, None, None]
    assert_allclose(out.modulated, scaled.modulated * live**2 * after)
    assert_allclose(out.mean, scaled.mean * live * 1.05)
    factor = np.abs(live**2 * after) ** 2
    assert_allclose(np.asarray(out.variance), given.mean * factor)


def test_exact_light_stays_exact(survey: Survey) -> None:
    given = light(3)
    found = instrument_errors._scaled(given, modulated=np.array(2j), mean=np.array(3.0))
    assert_allclose(found.modulated, 2j * given.modulated)
    assert_allclose(found.mean, 3 * given.mean)
    assert found.variance == 0


def test_rows_are_found_by_the_times_of_their_pixels(survey: Survey) -> None:
    time = times(survey)
    time[1] = time[1, ::-1]
    assert chain(survey)._rows(time[1:3]).tolist() == [1, 2]


def test_a_reference_drifts_with_the_light(survey: Survey) -> None:
    signal = np.ones((2, 2, 3), complex)
    time = np.array([0.0, 5.3, 26.5])
    drift = {"power": -0.2, "modulation_depth": 0.1, "phase": 0.3}
    found = chain(survey, drift=drift).reference_samples(signal, time)
    course = time / 26.5
    expected = (1 - 0.2 * course) * (1 + 0.1 * course) * np.exp(0.3j * course)
    assert_allclose(found, expected + 0 * signal)
    assert_array_equal(chain(survey).reference_samples(signal, time), signal)
    noisy = chain(survey, noise={"white": 1e-3})
    noise = noisy.reference_samples(signal, time) - signal
    assert len(np.unique(noise)) == 12
    assert_array_equal(noisy.reference_samples(signal, time) - signal, noise)
    assert np.abs(noise).max() < 6e-3
    # Crosstalk of the scan reaches the reference, too.
    stray = {"amplitude": 1e-3, "part": "scan"}
    assert_allclose(
        chain(survey, crosstalk=stray).reference_samples(signal, time), 1.001
    )


class Quiet:
    """Draws without noise."""

    def standard_normal(self, size: tuple[int, ...]) -> np.ndarray:
        return np.zeros(size)

    def gamma(self, shape: float, scale: float, size: tuple[int, ...]) -> np.ndarray:
        return np.ones(size)


def test_samples_of_the_scan_follow_the_references_before_it(survey: Survey) -> None:
    time = times(survey)
    target, water = light(4, 6), light(4, 6, seed=2)
    target = Light(1e-9 * target.modulated, 1e-9 * target.mean)
    water = Light(1e-9 * water.modulated, 1e-9 * water.mean)
    drift = {"power": 0.3, "modulation_depth": -0.1, "phase": 0.4}
    found = chain(survey, drift=drift)
    plain = chain(survey)
    zero = np.zeros((4, 6))

    def outputs(one: Chain) -> lock_in.Samples:
        return one.scan_samples(target, water, time, azimuth=zero, rng=Quiet())

    course = (STEP * 18 + time) / 26.5
    expected = (1 + 0.3 * course) * (1 - 0.1 * course) * np.exp(0.4j * course)
    assert_allclose(outputs(found).signal, outputs(plain).signal * expected)
    shots = light(30, seed=3)
    shots = Light(1e-9 * shots.modulated, 1e-9 * shots.mean)
    ratio = (
        found.shot_samples(shots, rng=Quiet()).signal
        / plain.shot_samples(shots, rng=Quiet()).signal
    )
    course = found.shot_times / 26.5
    expected = (1 + 0.3 * course) * (1 - 0.1 * course) * np.exp(0.4j * course)
    assert_allclose(ratio, expected + 0 * ratio)


@pytest.mark.parametrize(("order", "turned"), [(3, True), (5, False), (7, True)])
def test_a_harmonic_is_turned_back_by_four_samples_a_period(
    survey: Survey, order: int, turned: bool
) -> None:
    found = chain(survey, harmonic={"fraction": 0.1, "order": order})
    frequencies = found._light_frequencies
    rng = np.random.default_rng(1)
    size = (frequencies.size, 2, 4, 6)
    water = Light(1e-9 * (rng.normal(size=size) + 1j * rng.normal(size=size)),
                  np.full(size, 1e-9))  # fmt: skip
    dark = Light(0 * water.modulated, 0 * water.mean)
    samples = found.scan_samples(
        dark, water, times(survey), azimuth=np.zeros((4, 6)), rng=Quiet()
    )
    volts = found.setup.volt_per_power * water.modulated
    low, high = (
        volts[np.searchsorted(frequencies, factor * FREQUENCIES)]
        for factor in (1, order)
    )
    expected = low + 0.1 * (high.conj() if turned else high)
    assert_allclose(samples.signal, expected)
