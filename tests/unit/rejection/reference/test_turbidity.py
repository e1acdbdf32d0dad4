"""Turbidity by shots of a known model, and phases of a scan against one distance."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from amulor.cube import WaterResidualCause
from amulor.rejection.covariance import Covariance
from amulor.rejection.reference import before_target, late_phase, model
from amulor.rejection.reference.before_target import (
    ScanPhases,
    Strength,
    Turbidity,
    contradiction,
    turbidity_of,
)
from amulor.survey import Survey

FREQUENCY = np.array([20e6, 40e6, 60e6, 80e6])


@pytest.fixture(autouse=True)
def low_pass_water(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the model: a low-pass whose corner grows with the turbidity.

    The paper's form turns twice as far.
    """

    def open_water(
        survey: float, places: np.ndarray, frequency: np.ndarray, *, paper: bool
    ) -> np.ndarray:
        corner = 30e6 * survey / (1 + paper)
        level = 1 + places[:, 0]
        return level / (1 - 1j * frequency[:, None] / corner)

    monkeypatch.setattr(model, "open_water", open_water)
    monkeypatch.setattr(
        before_target, "by_coefficients", lambda survey, factor: survey * factor
    )


def found_in(
    factor: float,
    *,
    frequency: np.ndarray = FREQUENCY,
    noise: float = 1e-3,
    seed: int = 1,
    paper: bool = False,
    excess: float = 1.0,
    add: complex = 0.0,
    shared: bool = False,
) -> Turbidity:
    """Return the turbidity of shots of the model, with noise."""
    rng = np.random.default_rng(seed)
    azimuth = np.linspace(-0.1, 0.1, 20).reshape(4, 5)
    scan: Any = SimpleNamespace(
        azimuth=azimuth, elevation=0 * azimuth, frequency=frequency
    )
    level = 1 + azimuth
    corner = 30e6 * factor / (1 + paper)
    of = level / (1 - 1j * frequency[:, None, None] / corner)
    water = np.stack([of, 0.3 * of], axis=1) + add
    # Errors of a fit of all shots are those of each direction.
    drawn = (*water.shape[:2], 1, 1) if shared else water.shape
    draws = rng.standard_normal((2, *drawn))
    water = water + excess * noise * (draws[0] + 1j * draws[1])
    variance = np.full(water.shape, noise**2)
    survey: Any = 1.0
    return turbidity_of(
        scan, survey, water, Covariance(variance, variance, 0 * variance)
    )


@pytest.mark.parametrize("factor", [0.4, 1.0, 2.7])
def test_the_factor_is_found_within_its_error(factor: float) -> None:
    scores, stated = [], []
    for seed in range(20):
        found = found_in(factor, seed=seed)
        scores.append(np.log(found.factor / factor) / found.uncertainty)
        stated.append(found.uncertainty)
        assert not found.is_extreme
        assert not found.paper
        assert found.survey == pytest.approx(found.factor)
        steeper: Any = found.steeper
        assert np.log(steeper / found.factor) == pytest.approx(found.uncertainty)
    # Nine directions of one sample each, whose errors are taken as one: three times as
    # wide as they scatter here.
    assert 0.2 < np.sqrt(np.mean(np.square(scores))) < 0.55
    # By the model's derivative: chi-square of one direction rises by one.
    of = [
        np.exp(1j * 0) / (1 - 1j * FREQUENCY / (30e6 * factor * np.exp(step)))
        for step in (-1e-4, 1e-4)
    ]
    plain, slope = (of[0] + of[1]) / 2, (of[1] - of[0]) / 2e-4
    across = slope - plain * np.vdot(plain, slope).real / np.vdot(plain, plain).real
    information = 1.09 * np.vdot(across, across).real / 1e-6
    assert np.mean(stated) == pytest.approx(information**-0.5, rel=0.25)


def test_scatter_beyond_the_errors_widens_the_uncertainty() -> None:
    plain, noisy = (found_in(1.0, excess=excess, seed=3) for excess in (1.0, 6.0))
    # By chi-square over 2 x 4 x 2 outputs less two strengths and a factor.
    assert noisy.uncertainty / plain.uncertainty == pytest.approx(6.0, rel=0.35)


@pytest.mark.parametrize(
    ("factor", "is_extreme"),
    [(0.2515, True), (0.26, False), (3.85, False), (3.98, True), (6.0, True)],
)
def test_a_factor_next_to_four_or_a_fourth_is_extreme(
    factor: float, is_extreme: bool
) -> None:
    # Steps of 6 %; half a step from the ends is the limit.
    found = found_in(factor, noise=1e-5)
    assert found.is_extreme == is_extreme
    if is_extreme:
        # Beyond the tested range by a factor of two.
        assert found.uncertainty >= np.log(2)


def test_an_uncertainty_is_a_factor_of_four_at_most() -> None:
    found = found_in(1.0, frequency=np.array([1e3, 2e3, 3e3, 4e3]), noise=0.1)
    assert found.uncertainty == pytest.approx(np.log(4))


def test_another_form_is_taken_where_it_is_much_better() -> None:
    # Half the corner is water of half the turbidity, as long as that is tried.
    same = found_in(2.0, paper=True)
    assert not same.paper
    assert same.factor == pytest.approx(1.0, rel=0.01)
    other = found_in(0.3, paper=True)
    assert other.paper
    assert other.factor == pytest.approx(0.3, rel=0.01)
    # A form that misses less than 2 % of the water is not doubted.
    near = found_in(0.486, paper=True)
    assert not near.paper
    assert near.is_extreme


@pytest.mark.parametrize(
    ("count", "unseen"), [(1, 0.05), (2, 0.01), (3, 0.005), (4, 0)]
)
def test_few_frequencies_do_not_show_the_error_of_a_model(
    count: int, unseen: float
) -> None:
    found = found_in(1.0, frequency=FREQUENCY[:count], noise=1e-6, excess=0.0)
    assert found.misfit == pytest.approx(unseen, abs=2e-4)
    assert found.shown == pytest.approx(0.0, abs=2e-4)


def test_light_that_is_no_water_is_a_misfit() -> None:
    found = found_in(1.0, noise=1e-3, excess=0.0, add=0.02)
    level = 1 + np.linspace(-0.1, 0.1, 20)[np.linspace(0, 19, 9).astype(int)]
    plain = level / (1 - 1j * FREQUENCY[:, None] / 30e6)
    channels = [plain + 0.02, 0.3 * plain + 0.02]

    def square(logarithm: float) -> float:
        model = level / (1 - 1j * FREQUENCY[:, None] / (30e6 * np.exp(logarithm)))
        power = np.sum(np.abs(model) ** 2)
        strengths = [np.sum(model.conj() * one).real / power for one in channels]
        rests = [one - s * model for one, s in zip(channels, strengths, strict=True)]
        return float(sum(np.sum(np.abs(rest) ** 2) for rest in rests))

    best = minimize_scalar(square, (-0.1, 0.0, 0.2))
    assert np.log(found.factor) == pytest.approx(best.x, abs=1e-3)
    # What chance explains is 13 for each of nine directions.
    power = sum(np.sum(np.abs(one) ** 2) for one in channels)
    expected = np.sqrt((best.fun - 9 * 13 * 1e-6) / power)
    assert found.shown == pytest.approx(expected, rel=1e-3)
    assert found.misfit == found.shown
    # Errors are scaled by chi-square over its expectation.
    scale = best.fun / 1e-6 / 9 / 13
    step = 0.01
    bend = (square(best.x + step) + square(best.x - step) - 2 * best.fun) / step**2
    width = np.sqrt(2 * scale * 9 / (bend / 1e-6))
    assert found.uncertainty == pytest.approx(width, rel=0.01)
    # Far more than the water itself is all of it, at most.
    assert found_in(1.0, noise=1e-4, add=-1e3).misfit <= 1.0
    assert found_in(1.0, noise=1e-4, add=-1e3).shown <= 1.0


@pytest.mark.parametrize("shared", [True, False])
def test_shots_lost_in_noise_are_no_contradiction(shared: bool) -> None:
    lost = [found_in(1.0, noise=5.0, seed=seed, shared=shared) for seed in range(60)]
    assert np.mean([found.misfit > 0.2 for found in lost]) > 0.2
    assert not any(found.is_real for found in lost)
    # Light of twice the noise in all directions, frequencies and channels is real.
    assert found_in(1.0, noise=5.0, shared=shared, add=40.0).is_real
    assert found_in(1.0, noise=1e-3, shared=shared, add=0.02).is_real


def turbidity(**changed: Any) -> Turbidity:
    values: dict[str, Any] = {
        "survey": None, "factor": 1.0, "uncertainty": 0.1, "steeper": None,
        "misfit": 0.01, "shown": 0.01,
    }  # fmt: skip
    return Turbidity(**values | changed)


@pytest.mark.parametrize(
    ("change", "uncertainty", "others", "cause"),
    [
        # A change of 30 % beyond three standard uncertainties.
        (0.301, 0.0, {}, "WATER_CHANGED"),
        (0.299, 0.0, {}, ""),
        (-0.361, 0.02, {}, "WATER_CHANGED"),
        (-0.359, 0.02, {}, ""),
        # Water of negative strength.
        (-1.0, 0.01, {}, "INSTRUMENT"),
        (-0.999, 0.01, {}, "WATER_CHANGED"),
        (-1.2, 0.31, {}, ""),
        (1.2, 0.01, {}, "WATER_CHANGED"),
        # Noise explains it.
        (0.0, 0.0, {"misfit": 0.9, "is_real": False}, ""),
        (0.0, 0.0, {"shown": 0.9, "is_extreme": True, "is_real": False}, ""),
        # Shots that are off any water by 20 %, or by 5 % of the most extreme one.
        (0.0, 0.0, {"misfit": 0.201}, "INSTRUMENT"),
        (0.0, 0.0, {"misfit": 0.199}, ""),
        (0.0, 0.0, {"shown": 0.051, "is_extreme": True}, "INSTRUMENT"),
        (0.0, 0.0, {"shown": 0.049, "is_extreme": True}, ""),
        (0.0, 0.0, {"shown": 0.051}, ""),
    ],
)
def test_causes_have_their_limits(
    change: float, uncertainty: float, others: dict[str, Any], cause: str
) -> None:
    strength = Strength(change=change, uncertainty=uncertainty)
    expected = WaterResidualCause[cause] if cause else WaterResidualCause(0)
    assert contradiction(strength, turbidity(**others)) == expected


@pytest.mark.parametrize(("least", "sure"), [(0.301, True), (0.299, False)])
def test_frequencies_that_only_a_large_change_explains_have_a_cause(
    least: float, sure: bool
) -> None:
    phases = ScanPhases(
        phase=np.zeros(2), probability=0.1, of_change=0.0, least_change=least
    )
    strength = Strength(change=0.0, uncertainty=0.02, phases=phases)
    expected = WaterResidualCause.INSTRUMENT if sure else WaterResidualCause(0)
    assert contradiction(strength, None) == expected


def test_phases_of_a_scan_are_tested_against_one_distance() -> None:
    rng = np.random.default_rng(9)
    shape = 2, 2, 40
    phase = 0.1 * rng.standard_normal(shape)
    turn = rng.standard_normal((2, 2, 1)) + 0.1 * rng.standard_normal(shape)
    wavenumber = np.array([0.4, 1.7])[:, None, None]
    independent = rng.uniform(0.05, 0.2, shape)
    shared = rng.uniform(0.005, 0.01, shape)
    valid = rng.random(shape) < 0.8
    found = before_target._scan_phases(
        phase, turn, wavenumber, independent=independent, shared=shared, valid=valid
    )
    assert found is not None
    means = [
        np.array(
            [[values[f, c][valid[f, c]].mean() for c in range(2)] for f in range(2)]
        )
        for values in (phase, turn, independent, shared)
    ]
    count = valid.sum(axis=2)
    error = np.sqrt(means[3] ** 2 + means[2] ** 2 / count)
    # One path and one change of the water for all four.
    design = np.stack([np.repeat(wavenumber.ravel(), 2), means[1].ravel()], axis=1)
    design /= error.reshape(-1, 1)
    right = means[0].ravel() / error.ravel()
    rest = right - design @ np.linalg.lstsq(design, right)[0]
    assert found.of_change == pytest.approx(chi2.sf(rest @ rest, 2))
    # One path for the means of both frequencies, with water that changes by 2 %.
    weight = error**-2 / (error**-2).sum(axis=1, keepdims=True)
    mean, water, together = (
        (weight * part).sum(axis=1) for part in (*means[:2], error)
    )
    together = np.hypot(together, 0.02 * water)
    path = np.sum(wavenumber.ravel() * mean / together**2) / np.sum(
        wavenumber.ravel() ** 2 / together**2
    )
    off = mean - wavenumber.ravel() * path
    assert_allclose(found.phase, off, rtol=1e-9)
    assert found.probability == pytest.approx(chi2.sf(np.sum((off / together) ** 2), 1))
    assert found.least_change == 0.0


@pytest.mark.parametrize("count", [9, 10])
def test_phases_of_few_pixels_or_samples_are_not_tested(count: int) -> None:
    shape = 2, 2, 12
    valid = np.ones(shape, dtype=bool)
    valid[1, 1, count:] = False
    values = np.random.default_rng(1).uniform(0.1, 1, (4, *shape))
    words: Any = {"independent": values[2], "shared": values[3]}
    wavenumber = np.array([1.0, 2.0])[:, None, None]
    found = before_target._scan_phases(
        values[0], values[1], wavenumber, valid=valid, **words
    )
    assert (found is None) == (count < 10)
    # Two samples leave no freedom beside path and change.
    words = {name: part[:, :1] for name, part in words.items()}
    assert (
        before_target._scan_phases(
            values[0][:, :1], values[1][:, :1], wavenumber, valid=valid[:, :1] | True,
            **words,
        )
        is None
    )  # fmt: skip


def test_shots_look_at_nine_directions_of_a_scan() -> None:
    assert before_target._spread(9).tolist() == list(range(9))
    assert before_target._spread(3).tolist() == [0, 1, 2]
    assert before_target._spread(81).tolist() == list(range(0, 81, 10))


@pytest.mark.parametrize(("asymmetry_only", "part"), [(True, 0.75), (False, 1.0)])
def test_the_response_of_late_light_is_that_of_natural_water(
    monkeypatch: pytest.MonkeyPatch, asymmetry_only: bool, part: float
) -> None:
    response = np.exp(np.arange(6.0).reshape(2, 1, 3) * (0.1 + 0.05j))
    survey = Survey.preset("amulor-2010")
    monkeypatch.setattr(late_phase, "_late_light", lambda scan: (survey, {}))
    monkeypatch.setattr(late_phase, "late_echo_response", lambda *_, **__: response)
    monkeypatch.setattr(
        late_phase, "states_asymmetry_only", lambda survey: asymmetry_only
    )
    scan: Any = SimpleNamespace(frequency=FREQUENCY[:2])
    found = late_phase.late_response(scan, np.arange(3.0))
    assert found is not None
    assert_allclose(found, part * np.log(response[:, 0]))
    monkeypatch.setattr(late_phase, "_late_light", lambda scan: None)
    assert late_phase.late_response(scan, np.arange(3.0)) is None


def test_delays_of_late_light_have_the_errors_of_natural_water(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    survey = Survey.preset("amulor-2010")
    words = {"water": SimpleNamespace(group_index=1.4)}
    monkeypatch.setattr(late_phase, "_late_light", lambda scan: (survey, words))
    depths = []

    def delay(*_: Any, depth: np.ndarray, **__: Any) -> np.ndarray:
        depths.append(depth)
        return np.array([0.02, 0.01])[:, None, None]

    monkeypatch.setattr(late_phase, "late_echo_delay", delay)
    scan: Any = SimpleNamespace(frequency=np.array([20e6, 60e6]))
    path = np.array([[2.0, 4.0, 8.0, np.nan]])
    slope = 4 * np.pi * scan.frequency * 1.4 / 299792458.0
    # Phases less those of the one distance that fits best.
    mean = np.sum(slope**2 * [0.02, 0.01]) / np.sum(slope**2)
    apart = slope * (np.array([0.02, 0.01]) - mean)
    for asymmetry_only, part, relative in (
        (False, 1.0, 0.3),
        # Half to all of it, evenly: 3/4, and 1/3 of that over the root of three.
        (True, 0.75, np.hypot(0.3, 1 / 3 / np.sqrt(3))),
    ):
        monkeypatch.setattr(
            late_phase, "states_asymmetry_only", lambda s, only=asymmetry_only: only
        )
        found = late_phase.late_phase(scan, path)
        assert found is not None
        phase, error = found
        expected = part * apart[:, None] * (path[0] / 4) ** 2
        assert_allclose(phase[:, 0], expected, rtol=1e-9)
        assert_allclose(error[:, 0], relative * expected, rtol=1e-9)
    # In the middle of the scan.
    assert_allclose(depths[0], [4 / 2.8])
    assert late_phase.late_phase(scan, np.full((1, 2), np.nan)) is None
