"""Shots tell whether noise is stated right, for one frequency already."""

from __future__ import annotations

import numpy as np
import pytest

from amulor.rejection.covariance import Covariance
from amulor.rejection.observation import Observation
from amulor.rejection.reference.shots import (
    NOISE_SCALE,
    noise_scale,
    scatter_of,
    with_measured_noise,
)
from amulor.rejection.reference.surface import places_of
from amulor.simulation import simulate
from amulor.studies.trust.surveys import survey

#: 27 directions, ten shots each, and a signal that falls off by a factor of seven.
DIRECTIONS = np.stack(
    [part.ravel() for part in np.meshgrid(np.linspace(-1, 1, 9), np.linspace(0, 1, 3))],
    axis=1,
)
PLACES = places_of(np.repeat(DIRECTIONS, 10, axis=0))
SIGNAL = np.repeat(np.exp(-2 * DIRECTIONS[:, 0] ** 2 + 0.5j), 10)
STATED = 0.01


def _scale(
    seed: int, *, factor: float, signal: np.ndarray = SIGNAL, spikes: float = 0.0
) -> float:
    """Return what two channels tell that fluctuate by 3 %, the second one dim."""
    rng = np.random.default_rng(seed)
    scatters = []
    for strength in (1.0, 0.2):
        noise = rng.standard_normal((2, len(signal))) * factor * STATED
        shots = signal * strength * (1 + 0.03 * rng.standard_normal(len(signal)))
        shots = shots + noise[0] + 1j * noise[1]
        shots = shots + 40 * STATED * (rng.random(len(signal)) < spikes)
        variance = np.full(len(signal), STATED**2)
        errors = Covariance(variance, variance, np.zeros(len(signal)))
        scatters += scatter_of(shots, errors, PLACES)
    return noise_scale(scatters)


@pytest.mark.parametrize("factor", [1.5, 2.0, 4.0, 20.0])
def test_understated_noise_is_found_beside_a_fluctuation(factor: float) -> None:
    found = np.array([_scale(seed, factor=factor) for seed in range(20)])
    # 972 deviations about 54 means: 2.5 % each, somewhat more beside the fluctuation.
    assert found.mean() == pytest.approx(factor, rel=0.04)
    assert found.std() < 0.05 * factor


def test_noise_that_is_stated_right_or_too_large_stays() -> None:
    for seed in range(60):
        assert _scale(seed, factor=1.0) == 1
        assert _scale(seed, factor=0.5) == 1


def test_a_particle_in_a_shot_is_no_noise() -> None:
    found = [_scale(seed, factor=1.0, spikes=0.004) for seed in range(20)]
    # Two of 540 shots, each 40 times the noise: 2.6 by a mean square.
    assert np.mean(np.array(found) > 1) <= 0.1


@pytest.mark.parametrize("signal", [1.0, 1e-4], ids=["bright", "dim"])
def test_directions_that_are_all_alike_tell_nothing(signal: float) -> None:
    rng = np.random.default_rng(4)
    noise = 0.1 * (rng.standard_normal(270) + 1j * rng.standard_normal(270))
    variance = np.full(270, STATED**2)
    errors = Covariance(variance, variance, np.zeros(270))
    single = places_of(np.zeros((270, 2)))
    assert noise_scale(list(scatter_of(signal + noise, errors, single))) == 1


def test_samples_and_shots_are_scaled_once() -> None:
    cube = simulate(survey(1, columns=3, rows=2), rng=1)
    names = [name for name in cube if str(name).endswith("_uncertainty")]
    understated = cube.assign({name: cube[name] / 2 for name in names})
    scaled, _ = with_measured_noise(Observation(cube=understated))
    found = scaled.cube
    factor = found.attrs[NOISE_SCALE]
    assert factor == pytest.approx(2, rel=0.15)
    for name in names:
        np.testing.assert_allclose(found[name], cube[name] * factor / 2)
    for again in (scaled, Observation(cube=cube)):
        assert with_measured_noise(again)[0] is again
