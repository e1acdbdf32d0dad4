"""Range profiles and surfaces of echoes without noise, in closed form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light
from scipy.stats import norm

from amulor.optics.range_profile import (
    fewest,
    range_profile,
    resolution,
    surfaces,
    unambiguous_span,
)

FREQUENCY = np.array([60, 20, 40, 140, 100, 80, 120, 30]) * 1e6
WAVE = 4 * np.pi * FREQUENCY * 1.38 / speed_of_light
ERROR = np.array([1.0, 2.0, 1.5, 1.0, 3.0, 1.0, 2.0, 1.0]) * 1e-3
OPTIONS: dict[str, Any] = {"modulation_frequency": FREQUENCY, "group_index": 1.38}
SEARCH: dict[str, Any] = OPTIONS | {
    "standard_uncertainty": ERROR,
    "interval": (0.4, 3.4),
}


def echo(distance: float) -> np.ndarray:
    return np.exp(1j * WAVE * distance)


def test_resolution_and_span_follow_from_the_widest_and_narrowest_differences() -> None:
    speed = speed_of_light / 1.38
    assert_allclose(resolution(**OPTIONS), speed / (2 * 120e6), rtol=1e-12)
    assert_allclose(unambiguous_span(**OPTIONS), speed / (2 * 10e6), rtol=1e-12)
    assert fewest(1) == 3
    assert fewest(4) == 6


def test_a_profile_is_the_weighted_mean_of_samples_turned_back() -> None:
    signal = np.stack([0.5 * echo(1.2), 2 * echo(0.7)], axis=1)
    error = np.stack([ERROR, 2 * ERROR], axis=1)
    weight = np.arange(1.0, 9)
    place = np.array([1.2, 0.7, 1.0])
    found, spread = range_profile(
        signal,
        standard_uncertainty=error,
        slant_range=place,
        weight=weight,
        **OPTIONS,
    )
    share = weight / 36
    assert found.shape == (3, 2)
    assert_allclose([found[0, 0], found[1, 1]], [0.5, 2.0], rtol=1e-12)
    for row, distance in enumerate(place):
        expected = np.sum(share * 2 * echo(0.7) * np.conj(echo(distance)))
        assert_allclose(found[row, 1], expected, rtol=1e-12)
    assert_allclose(spread[1], 2 * np.sqrt(np.sum((share * ERROR) ** 2)), rtol=1e-12)
    assert_allclose(spread[0], spread[1] / 2, rtol=1e-12)
    even, _ = range_profile(
        signal[:, 0], standard_uncertainty=ERROR, slant_range=1.0, **OPTIONS
    )
    assert_allclose(even, np.mean(0.5 * echo(1.2) * np.conj(echo(1.0))), rtol=1e-12)


def test_one_surface_has_its_range_and_the_errors_of_its_information() -> None:
    found = surfaces(0.3 * echo(1.7), **SEARCH)
    assert_allclose(found.slant_range, [1.7], atol=1e-7)
    assert_allclose(found.amplitude, [0.3], rtol=1e-7)
    variance = [1 / np.sum((0.3 * WAVE / ERROR) ** 2), 1 / np.sum(ERROR**-2.0)]
    assert_allclose(found.covariance, np.diag(variance), rtol=1e-6, atol=1e-15)
    assert_allclose(found.uncertainty, np.sqrt(variance[:1]), rtol=1e-6)
    assert found.misfit < 1e-6
    assert found.probability.shape == (2,)
    assert found.probability[0] < 1e-30
    assert found.probability[1] == 1


def test_surfaces_are_sorted_by_their_range() -> None:
    signal = 0.2 * echo(2.9) + 0.5 * echo(1.1) + 0.3 * echo(2.0)
    found = surfaces(signal, **SEARCH)
    assert_allclose(found.slant_range, [1.1, 2.0, 2.9], atol=1e-6)
    assert_allclose(found.amplitude, [0.5, 0.3, 0.2], rtol=1e-5)
    # Derivatives by hand give the information of all six.
    place = np.array([1.1, 2.0, 2.9])
    turn = np.exp(1j * np.outer(WAVE, place)) / ERROR[:, None]
    columns = np.concatenate(
        [1j * WAVE[:, None] * turn * np.array([0.5, 0.3, 0.2]), turn], axis=1
    )
    information = (columns.conj().T @ columns).real
    assert_allclose(found.covariance, np.linalg.inv(information), rtol=1e-3, atol=1e-9)
    fewer = surfaces(signal, most=2, **SEARCH)
    assert fewer.slant_range.size == 2
    assert fewer.probability.shape == (3,)
    assert fewer.misfit > 100


def test_water_of_any_size_moves_no_surface() -> None:
    water = 0.4 * np.exp(1j * WAVE * 0.3) / (1 - 0.5j * WAVE)
    alone = surfaces(0.3 * echo(1.7), **SEARCH)
    found = surfaces(0.3 * echo(1.7) + 5 * water, water_signal=water, **SEARCH)
    assert_allclose(found.slant_range, alone.slant_range, atol=1e-6)
    assert_allclose(found.amplitude, alone.amplitude, rtol=1e-6)
    assert np.all(found.uncertainty >= alone.uncertainty)
    only = surfaces(5 * water, water_signal=water, **SEARCH)
    assert only.slant_range.size == 0
    assert only.covariance.shape == (0, 0)
    assert only.misfit < 1e-9


@pytest.mark.parametrize("score", [2.5, 3.4, 4.2])
def test_a_faint_surface_is_as_improbable_as_its_score(score: float) -> None:
    step = speed_of_light / 1.38 / (2 * 120e6) / 8
    grid = np.linspace(0.4, 3.4, 2 + int(3.0 / step))
    precision = ERROR**-2.0
    amplitude = score / np.sqrt(precision.sum())
    found = surfaces(amplitude * echo(grid[17]), error_rate=1e-9, **SEARCH)
    share = precision / precision.sum()
    turn = np.arccos(share @ np.cos(WAVE * (grid[1] - grid[0])))
    length = (grid.size - 1) * turn
    expected = norm.sf(score) + length / (2 * np.pi) * np.exp(-(score**2) / 2)
    assert_allclose(found.probability, [min(expected, 1.0)], rtol=1e-6)
    assert found.slant_range.size == 0
    # It is a surface where such a chance is accepted.
    likely = surfaces(amplitude * echo(grid[17]), error_rate=0.999, **SEARCH)
    assert (likely.slant_range.size > 0) == (expected < 0.999)
