"""Light, lock-in samples, noise by rows and spread-out rows, on a few numbers."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import tiles
from amulor.errors import SurveyError
from amulor.optics import detection
from amulor.simulation import ClosureModel, lock_in, measurement, scene_light
from amulor.simulation.by_rows import RowNoise, SimulatedRows
from amulor.simulation.geometry import Setup, trace
from amulor.simulation.gradient import GradientModel, with_gradient
from amulor.simulation.instrument_errors import Chain
from amulor.simulation.lock_in import Light
from amulor.simulation.standing_reference import ReferenceReadings
from amulor.survey import Survey, counting
from amulor.survey.instrument_errors import Gradient


@pytest.fixture(scope="module")
def survey(plate: Survey) -> Survey:
    return plate.with_(
        {
            "instrument.modulation_frequencies": [20e6, 60e6],
            "scan.columns": 6,
            "scan.rows": 4,
            "instrument.detector.dark_rate": 3e5,
        }
    )


def light(*shape: int, seed: int = 1, variance: bool = False) -> Light:
    rng = np.random.default_rng(seed)
    modulated = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    return Light(modulated, rng.random(shape), rng.random(shape) if variance else 0.0)


@pytest.mark.parametrize("variance", [False, True])
def test_light_is_split_into_readings_and_joined(variance: bool) -> None:
    whole = light(2, 3, 4, 5, variance=variance)
    readings = [whole.reading(f, p) for f in range(2) for p in range(3)]
    assert_array_equal(readings[4].modulated, whole.modulated[1, 1])
    assert_array_equal(readings[4].mean, whole.mean[1, 1])
    joined = Light.of_readings(readings, (2, 3))
    for part in ("modulated", "mean", "variance"):
        assert_array_equal(getattr(joined, part), getattr(whole, part))
    other = light(2, 3, 4, 5, seed=2, variance=variance)
    both = whole + other
    for part in ("modulated", "mean", "variance"):
        expected = getattr(whole, part) + getattr(other, part)
        assert_array_equal(getattr(both, part), expected)
    assert Light(np.zeros(1, complex), np.zeros(1)).variance == 0


def test_light_below_zero_by_rounding_is_none() -> None:
    response = np.array([[-1e-20, 2.0], [0.5 + 0.1j, 1j]])
    found = lock_in._light(response)
    assert found.mean.tolist() == [[0, 2]]
    assert found.modulated.tolist() == [[0.5 + 0.1j, 1j]]
    assert found.variance == 0
    exact = lock_in._light(response, np.array([[9.0, 9], [2, 3]]))
    assert np.asarray(exact.variance).tolist() == [[4, 9]]


class Drawn:
    """Constant draws in a row: one value for each call."""

    def __init__(self, *values: float) -> None:
        self.values = list(values)

    def standard_normal(self, size: tuple[int, ...]) -> np.ndarray:
        return np.full(size, self.values.pop(0))

    def gamma(self, shape: float, scale: float, /, size: tuple[int, ...]) -> np.ndarray:
        assert (shape, scale) == (4, 0.25)
        assert size == (2, 3)
        return np.full(size, self.values.pop(0))


def test_a_sample_has_each_of_its_draws(survey: Survey) -> None:
    setup = Setup(
        survey.with_({"water.signal_fluctuation": 0.1, "daylight": {
            "radiance": 1e6, "bandwidth": 1e-9}})
    )  # fmt: skip
    whole = light(2, 2, 3, variance=True)
    target, water = (
        Light(
            1e-9 * each.modulated, 1e-9 * each.mean, 1e-20 * np.asarray(each.variance)
        )
        for each in (whole, light(2, 2, 3, seed=2, variance=True))
    )
    found = lock_in.sample(setup, target, water, rng=Drawn(2.0, 0.5, -1.5, 3.0))
    volt = setup.volt_per_power
    detector = setup.survey.instrument.detector
    daylight = setup.daylight_rate[:, None]
    rate = setup.full_rate * (target.mean + 1.2 * water.mean) + daylight
    time = counting.integration_time(setup.survey)
    counted = counting.counting_variance(setup.survey, rate=rate, integration_time=time)
    floor = setup.survey.instrument.lock_in.phase_floor
    noise = np.sqrt(counted) * (0.5 - 1.5j)
    expected = volt * (target.modulated + 1.2 * water.modulated)
    expected = expected * np.exp(3j * floor) + noise
    assert_allclose(found.signal, expected, rtol=1e-12)
    circle = detection.phase_floor_covariance(expected, phase_floor=floor)
    model = volt**2 * (np.asarray(target.variance) + np.asarray(water.variance)) / 2
    assert_allclose(found.in_phase_variance, counted + model + circle[0])
    assert_allclose(found.quadrature_variance, counted + model + circle[1])
    assert_allclose(found.covariance, circle[2])
    assert not found.saturated.any()
    assert found.saturated.dtype == np.int8
    assert detector.dark_rate == 3e5


def test_a_sample_without_light_counts_one_electron(survey: Survey) -> None:
    dark = survey.with_({"instrument.detector.dark_rate": 0.0})
    setup = Setup(dark)
    none = Light(np.zeros((2, 2, 3), complex), np.zeros((2, 2, 3)))
    found = lock_in.sample(setup, none, none, rng=Drawn(0.0, 0.0, 0.0, 0.0))
    time = counting.integration_time(dark)
    one = counting.counting_variance(dark, rate=1 / time, integration_time=time)
    assert_allclose(found.in_phase_variance, one)
    assert not found.signal.any()
    # The water may not fluctuate below no light.
    lit = Light(np.full((2, 2, 3), 1e-9 + 0j), np.full((2, 2, 3), 1e-9))
    low = lock_in.sample(setup, none, lit, rng=Drawn(-30.0, 0.0, 0.0, 0.0))
    assert_allclose(low.signal, -0.5 * setup.volt_per_power * 1e-9)
    assert_allclose(low.in_phase_variance, one, rtol=1e-3)


@pytest.mark.parametrize(("factor", "flagged"), [(0.99, 0), (1.01, 1)])
def test_a_mean_output_beyond_the_linear_range_is_flagged(
    survey: Survey, factor: float, flagged: int
) -> None:
    setup = Setup(survey)
    detector = survey.instrument.detector
    rate = factor * detector.saturation / detector.volt_per_photoelectron_rate - 3e5
    power = np.full((2, 2, 3), rate / setup.full_rate)
    none = Light(np.zeros((2, 2, 3), complex), np.zeros((2, 2, 3)))
    lit = Light(power.astype(complex), power)
    found = lock_in.sample(setup, lit, none, rng=Drawn(0.0, 0.0, 0.0, 0.0))
    assert set(found.saturated.ravel()) == {flagged}


def test_speckle_is_one_power_for_all_frequencies(survey: Survey) -> None:
    speckled = survey.with_({"instrument.receiver.speckle_cells": 4})
    given = light(2, 2, 3, variance=True)
    found = lock_in._speckled(speckled, given, rng=Drawn(0.5))
    assert_array_equal(found.modulated, 0.5 * given.modulated)
    assert_array_equal(found.mean, 0.5 * given.mean)
    assert_array_equal(found.variance, 0.25 * np.asarray(given.variance))
    assert lock_in._speckled(survey, given, rng=Drawn()) is given
    # Draws of each sample: water, speckle by channel, two outputs and the floor.
    assert lock_in.draws(survey) == [("standard_normal", 4)] * 4
    assert lock_in.draws(speckled) == [
        ("standard_normal", 4), ("gamma", 2), *[("standard_normal", 4)] * 3
    ]  # fmt: skip


def test_detection_acts_on_all_light_before_it_is_counted(survey: Survey) -> None:
    setup = Setup(survey.with_({"water.signal_fluctuation": 0}))
    target, water = light(2, 2, 3), light(2, 2, 3, seed=2)
    target, water = (Light(1e-9 * x.modulated, 1e-9 * x.mean) for x in (target, water))
    seen: list[Light] = []

    def detect(whole: Light) -> Light:
        seen.append(whole)
        return Light(2 * whole.modulated, 3 * whole.mean)

    found = lock_in.sample(
        setup, target, water, rng=Drawn(0.0, 0.0, 0.0, 0.0), detect=detect
    )
    assert_allclose(seen[0].modulated, target.modulated + water.modulated)
    expected = 2 * setup.volt_per_power * (target.modulated + water.modulated)
    assert_allclose(found.signal, expected)
    rate = setup.full_rate * 3 * (target.mean + water.mean)
    time = counting.integration_time(setup.survey)
    counted = counting.counting_variance(setup.survey, rate=rate, integration_time=time)
    floor = setup.survey.instrument.lock_in.phase_floor
    circle = detection.phase_floor_covariance(expected, phase_floor=floor)
    assert_allclose(found.in_phase_variance, counted + circle[0])


def test_columns_end_at_the_target_or_at_the_end_of_the_water(survey: Survey) -> None:
    view: Any = SimpleNamespace(tilt=np.zeros((1, 3)))
    ends = np.array([[0.5, 2.0, np.inf]])
    frequency, stop = lock_in._column_axes(survey, view, ends)
    assert frequency.shape == (3, 1, 1, 1)
    assert frequency.ravel().tolist() == [0, 20e6, 60e6]
    assert stop.tolist() == [[0.5, 2, np.inf]]
    assert np.isinf(lock_in._column_axes(survey, view, None)[1])
    short = survey.with_({"water.column_end": "1.8 m"})
    assert lock_in._column_axes(short, view, ends)[1].tolist() == [[0.5, 1.8, 1.8]]
    assert lock_in._column_axes(short, view, None)[1] == 1.8


SHAPE = (5, 3)


def whole_noise(seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((2, *SHAPE)), rng.gamma(2.5, 0.4, size=(1, *SHAPE))


def test_rows_have_the_noise_of_the_whole_in_any_order() -> None:
    draws = [("standard_normal", 2), ("gamma", 1)]
    noise = RowNoise(np.random.default_rng(1), draws, shape=SHAPE, gamma=2.5)
    normal, gamma = whole_noise()
    for begin, end in ((0, 2), (2, 3), (3, 5), (1, 4), (0, 5), (4, 5), (4, 5)):
        rows = noise.rows(begin, end)
        height = end - begin
        found = rows.standard_normal((2, height, 3))
        assert_array_equal(found, normal[:, begin:end])
        found = rows.gamma(2.5, 0.4, size=(1, height, 3))
        assert_array_equal(found, gamma[:, begin:end])


def test_noise_is_refused_where_it_is_another_draw() -> None:
    draws = [("standard_normal", 2)]
    noise = RowNoise(np.random.default_rng(1), draws, shape=SHAPE)
    with pytest.raises(RuntimeError, match=r"gamma\(2\) is asked for, not 1"):
        noise.rows(0, 1).gamma(2.0, 0.5, size=(1, 1, 3))
    for size in ((2, 2, 3), (2, 1, 4)):
        with pytest.raises(RuntimeError, match="draw 1 of a scan is standard_normal"):
            noise.rows(0, 1).standard_normal(size)
    with pytest.raises(ValueError, match="zip"):
        noise.rows(0, 1).standard_normal((3, 1, 3))


@pytest.mark.parametrize(
    ("rows", "columns", "high", "wide"),
    [(90, 14, 8, 10), (90, 3, 26, 3), (90, 1, 80, 1), (4, 900, 4, 20), (1, 900, 1, 80)],
)
def test_rows_and_columns_of_a_sample_are_spread_from_edge_to_edge(
    monkeypatch: pytest.MonkeyPatch, rows: int, columns: int, high: int, wide: int
) -> None:
    monkeypatch.setattr(tiles, "SAMPLE", 80)
    found = measurement._spread(rows, columns)
    for name, whole, count in (("rows", rows, high), ("columns", columns, wide)):
        values = found[name]
        assert values.size == count
        assert (values[0], values[-1]) == (0, whole - 1)
        steps = np.diff(values)
        assert steps.size == 0 or np.ptp(steps) <= 1


def test_a_simulation_states_what_its_light_contains(survey: Survey) -> None:
    setting = measurement.Setting.of(survey, rng=3, model=ClosureModel())
    found = setting.attributes
    assert found["title"] == "Plate in a small tank"
    assert found["source"] == f"simulation by amulor, {ClosureModel().title}"
    assert (found["simulated"], found["late_echo"]) == (1, "absent")
    assert found["corner_light"] == "absent"
    assert found["surroundings_light"] == "absent"
    assert found["seed"] == 3
    assert found["modulation_depth"] == 0.8
    assert Survey.from_text(found["survey"]) == survey
    assert setting.seed == 3
    assert setting.reference is setting.chain is None
    assert setting.light_setup is setting.setup
    free = measurement.Setting.of(
        survey, rng=np.random.default_rng(3), model=ClosureModel()
    )
    assert free.seed is None
    wrong = survey.with_({"instrument.errors": {"clock": {"frequency_error": 1e-3}}})
    off = measurement.Setting.of(wrong, rng=3, model=ClosureModel())
    frequencies = off.light_setup.survey.instrument.modulation_frequencies
    assert_allclose(frequencies, [20.02e6, 60.06e6])


def test_a_gradient_changes_the_light_by_its_distance(plate: Survey) -> None:
    water: Any = SimpleNamespace(reduced_attenuation=0.3)
    model: Any = SimpleNamespace(
        title="slab", late_echo="absent", echo=lambda *_, **__: 2.0
    )
    depth = np.array([0.5, 2.0, 4.0])
    richer = GradientModel(model, Gradient(change_per_meter=0.3))
    # The integral of 0.3 z up to the distance, there and back.
    passed = np.exp(-2 * 0.3 * 0.15 * depth**2)
    assert_allclose(richer._passed(depth, water), passed)
    assert_allclose(richer._strength(depth, water), (1 + 0.3 * depth) * passed)
    common: Any = {"survey": None, "view": None, "water": water}
    found = richer.echo(np.array([1e7]), surface={"depth": depth}, **common)
    assert_allclose(found, 2 * passed)
    assert richer.title == "slab, water +0.3 per meter"
    assert richer.late_echo == "absent"
    # Half a part less each metre: clear from 2 m on, where one part less is missing.
    poorer = GradientModel(model, Gradient(change_per_meter=-0.5))
    missing = np.array([0.25 * 0.5**2, 1.0, 1.0 + 2.0])
    assert_allclose(poorer._passed(depth, water), np.exp(0.6 * missing))
    assert_allclose(poorer._strength(depth, water)[1:], 0, atol=1e-12)
    assert poorer._strength(0.5, water) == pytest.approx(0.75 * np.exp(0.6 * 0.0625))
    for errors in ({}, {"clock": {"frequency_error": 0.0}}):
        stated = plate.with_({"instrument.errors": errors})
        assert with_gradient(model, stated) is model
    stated = plate.with_({"instrument.errors": {"gradient": {"change_per_meter": 0.3}}})
    assert with_gradient(model, stated) == richer


def test_a_reference_is_read_before_each_row_and_round(survey: Survey) -> None:
    stated = survey.with_(
        {"scan.reference": {"amplitude": "1 V", "azimuth": 0.1, "elevation": 0.0},
         "scan.open_water": {
            "columns": 3, "rows": 2, "repeats": 4}}
    )  # fmt: skip
    assert ReferenceReadings.of(survey, None, 1) is None
    found = ReferenceReadings.of(stated, None, 1)
    assert found is not None
    # A row of six pixels with four readings of 125 ms.
    assert_allclose(found.drift.time[1, 0], 3.0 * np.arange(4))
    assert found.chain is None
    signal = np.ones((2, 2, 6), complex)
    assert found.shots(signal) is signal
    setup = Setup(stated.with_({"instrument.errors": {"drift": {"phase": 0.5}}}))
    chain = Chain.of(setup, 1)
    assert chain is not None
    drifting = ReferenceReadings.of(setup.survey, chain, 1)
    assert drifting is not None
    # Two rounds of six shots are before the scan, two after it.
    expected = np.concatenate([6 + 3.0 * np.arange(4), [0, 3, 18, 21]])
    assert_allclose(drifting.drift.time[0, 1], np.sort(expected))
    # Drift by 0.5 rad over all 47 steps of half a second is taken out.
    time = 0.5 * np.arange(24.0).reshape(4, 6)
    drifted = np.exp(0.5j * (6 + time) / 23.5) * np.ones((2, 2, 1, 1))
    corrected = drifting.scan(drifted, time)
    assert np.ptp(np.angle(corrected)) < 0.02
    shots = np.exp(0.5j * chain.shot_times / 23.5) * np.ones((2, 2, 1))
    # The drift is known up to the last reading, at the start of the last round.
    assert np.ptp(np.angle(drifting.shots(shots))[..., :19]) < 0.02


def test_rates_of_a_scene_are_those_of_its_mean_light(survey: Survey) -> None:
    setup = Setup(survey)
    found = scene_light(survey, model=ClosureModel())
    geometry = trace(setup)
    water = lock_in.water_light(
        setup, geometry.view, end=geometry.depth, model=ClosureModel()
    )
    target = lock_in.target_light(setup, geometry, model=ClosureModel())
    here = found.with_target
    for rate, signal, given in (
        (here.water_rate, here.water, water), (here.target_rate, here.target, target)
    ):  # fmt: skip
        assert rate.shape == (2, 2, 24)
        assert_allclose(rate.reshape(2, 2, 4, 6), setup.full_rate * given.mean)
        volts = setup.volt_per_power * given.modulated
        assert_allclose(signal.reshape(2, 2, 4, 6), volts)
    assert_array_equal(here.azimuth, geometry.azimuth.ravel())
    assert_array_equal(here.elevation, geometry.elevation.ravel())
    # Open water in the directions of its 15 shots and of the scan, and no target.
    there = found.open_water
    assert there.azimuth.size == 15 + 24
    assert_array_equal(there.azimuth[15:], here.azimuth)
    assert_array_equal(there.elevation[15:], here.elevation)
    assert not there.target.any()
    assert np.all(there.water_rate > 0)
    assert found.vehicle is None
    bare = scene_light(survey.with_({"scan.open_water": None}), model=ClosureModel())
    assert bare.open_water.azimuth.size == 24


def test_rows_of_a_scan_have_its_directions(survey: Survey) -> None:
    source = SimulatedRows(survey, rng=1, model=ClosureModel())
    assert (source.rows, source.columns) == (4, 6)
    found, whole = source.directions(1, 3), trace(Setup(survey))
    assert dict(found.sizes) == {"row": 2, "column": 6}
    assert_array_equal(found["azimuth"], whole.azimuth[1:3])
    assert_array_equal(found["elevation"], whole.elevation[1:3])


def test_harmonics_of_readings_in_turn_from_a_vehicle_are_refused(
    survey: Survey,
) -> None:
    setup = Setup(survey.with_({"instrument.errors": {"harmonic": {"fraction": 0.1}}}))
    chain = Chain.of(setup, 1)
    assert chain is not None
    with pytest.raises(SurveyError, match=r"instrument\.errors\.harmonic: is not"):
        measurement._refuse_harmonics_in_turn(setup, chain)
    plain = replace(chain, errors=chain.errors.model_copy(update={"harmonic": None}))
    measurement._refuse_harmonics_in_turn(setup, plain)
