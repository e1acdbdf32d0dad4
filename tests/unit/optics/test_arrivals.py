"""Arrival times against closed forms, and against records of other shape and noise."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import max_len_seq

from amulor.optics.arrivals import (
    matched_filter,
    photon_arrivals,
    side_lobe,
    time_bound,
)

WIDTH = 4.0
BINS = np.arange(300)
BARKER = [1, 1, 1, 1, 1, -1, -1, 1, 1, -1, 1, -1, 1]


def pulse(place: float | np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * ((BINS - np.asarray(place)[..., None]) / WIDTH) ** 2)


def light(place: float) -> np.ndarray:
    return pulse(place) / (WIDTH * np.sqrt(2 * np.pi))


def test_bound_of_a_gaussian_pulse_is_the_closed_form() -> None:
    # The integral of the squared slope is sqrt(pi) / 2 s, in samples.
    expected = 0.1 / 0.7 * np.sqrt(2 * WIDTH / np.sqrt(np.pi)) * 2e-9
    found = time_bound(pulse(150.0), sample_interval=2e-9, noise=0.1, amplitude=0.7)
    assert_allclose(found, expected, rtol=1e-4)


@pytest.mark.parametrize("order", [3, 5, 7, 9])
def test_side_lobe_of_a_periodic_maximal_length_sequence(order: int) -> None:
    # Of N chips it is 1 / N, and 1 / (N - 1) without the mean.
    code = np.repeat(max_len_seq(order)[0], 3)
    assert_allclose(side_lobe(code, periodic=True), 1 / (2**order - 2), rtol=1e-9)


def test_side_lobe_of_the_longest_barker_code() -> None:
    assert_allclose(side_lobe(np.repeat(BARKER, 2)), 1 / 13, rtol=1e-9)


def test_delays_of_pulses_scatter_as_the_bound_and_as_stated() -> None:
    rng = np.random.default_rng(1)
    place = rng.uniform(100, 250, 300)
    records = 3 + 0.7 * pulse(place) + 0.05 * rng.standard_normal((300, 300))
    found = matched_filter(records, pulse=pulse(50.0), noise=0.05, sample_interval=1e-9)
    error = 1e9 * found.time - (place - 50)
    bound = 1e9 * time_bound(
        pulse(150.0), sample_interval=1e-9, noise=0.05, amplitude=0.7
    )
    assert_allclose(np.sqrt(np.mean(error**2)), bound, rtol=0.12)
    assert_allclose(np.median(1e9 * found.uncertainty), bound, rtol=0.05)
    assert np.mean(np.abs(error) < 1.96e9 * found.uncertainty) > 0.92
    assert_allclose(np.mean(found.amplitude), 0.7, rtol=0.01)
    assert np.all(found.probability < 1e-6)
    assert np.all(found.elsewhere < 1e-6)
    assert np.mean(found.second < 0.01) < 0.03


def test_a_code_below_the_noise_of_a_sample_is_found() -> None:
    rng = np.random.default_rng(2)
    code = np.repeat(max_len_seq(8)[0], 2).astype(float)
    records = 0.8 * np.roll(code, 77) + rng.standard_normal((40, code.size))
    found = matched_filter(
        records, pulse=code, noise=1.0, sample_interval=1.0, periodic=True
    )
    assert np.all(found.probability < 1e-3)
    assert np.abs(found.time - 77).max() < 1.0
    assert np.mean(np.abs(found.time - 77) < 1.96 * found.uncertainty) > 0.85


@pytest.mark.slow
def test_noise_is_rarely_an_echo() -> None:
    rng = np.random.default_rng(3)
    records = rng.standard_normal((400, 300))
    found = matched_filter(records, pulse=pulse(50.0), noise=1, sample_interval=1e-9)
    assert np.mean(found.probability < 0.05) < 0.08
    counts = rng.poisson(0.1, (10, 15, 300))
    photons = photon_arrivals(counts, pulse=pulse(50.0), bin_width=1e-9)
    assert np.mean(photons.probability < 0.05) < 0.09


@pytest.mark.slow
def test_water_is_a_second_echo_unless_it_is_stated() -> None:
    rng = np.random.default_rng(4)
    water = 5 * np.exp(-np.maximum(BINS - 60, 0) / 20) * (BINS > 60)
    records = water + pulse(200.0) + 0.05 * rng.standard_normal((20, 300))
    options = {"pulse": pulse(50.0), "noise": 0.05, "sample_interval": 1.0}
    assert np.all(matched_filter(records, **options).second < 1e-3)
    found = matched_filter(records, water=water, **options)
    assert np.mean(found.second < 1e-3) < 0.1
    assert np.abs(found.time - 150).max() < 5 * found.uncertainty.max()
    gated = matched_filter(records, gate=(170, 230), **options)
    assert np.abs(gated.time - 150).max() < 6 * gated.uncertainty.max()
    counts = rng.poisson(4 * water + 200 * light(200.0), (4, 5, 300))
    photons = {"pulse": pulse(50.0), "bin_width": 1.0}
    assert np.all(photon_arrivals(counts, **photons).second < 1e-3)
    known = photon_arrivals(counts, water=water, **photons)
    assert np.abs(known.time - 150).max() < 5 * known.uncertainty.max()
    assert np.mean(known.second < 1e-3) < 0.2


@pytest.mark.slow
def test_photons_without_background_have_the_error_of_a_mean() -> None:
    rng = np.random.default_rng(5)
    counts = rng.poisson(400 * light(220.4), (10, 14, 300))
    found = photon_arrivals(counts, pulse=pulse(50.0), bin_width=1.0)
    error = found.time - 170.4
    assert_allclose(np.sqrt(np.mean(error**2)), WIDTH / 20, rtol=0.15)
    assert_allclose(np.median(found.uncertainty), WIDTH / 20, rtol=0.05)
    assert np.mean(np.abs(error) < 1.96 * found.uncertainty) > 0.92
    assert_allclose(np.mean(found.amplitude), 400, rtol=0.01)
    assert_allclose(np.median(found.amplitude_uncertainty), 20, rtol=0.1)


@pytest.mark.slow
def test_photons_in_a_background_as_strong_as_the_echo() -> None:
    rng = np.random.default_rng(6)
    counts = rng.poisson(25 * light(220.4) + 25 / 300, (10, 14, 300))
    found = photon_arrivals(counts, pulse=pulse(50.0), bin_width=1.0)
    sure = (found.probability < 1e-3) & (found.elsewhere < 0.01)
    error = np.abs(found.time - 170.4)
    assert sure.mean() > 0.98
    assert np.mean(error[sure] < 1.96 * found.uncertainty[sure]) > 0.92


@pytest.mark.slow
def test_neighbors_find_the_echo_of_one_or_two_photons() -> None:
    rng = np.random.default_rng(7)
    place = 200 + np.linspace(0, 4, 13)[:, None] + np.zeros((13, 13))
    mean = 2 * pulse(place) / (WIDTH * np.sqrt(2 * np.pi)) + 2 / 300
    counts = rng.poisson(mean)
    options = {"pulse": pulse(50.0), "bin_width": 1.0}
    alone = photon_arrivals(counts, **options)
    found = photon_arrivals(counts, neighbors=1, **options)
    assert np.mean(alone.probability < 1e-3) < 0.2
    sure = (found.probability < 1e-3) & (found.elsewhere < 0.5)
    assert sure.mean() > 0.6
    error = (found.time - (place - 50))[sure]
    assert np.sqrt(np.mean(error**2)) < WIDTH
    assert np.mean(np.abs(error) < 1.96 * found.uncertainty[sure]) > 0.9


def test_photons_of_an_edge_are_outside_of_the_window_of_the_neighbors() -> None:
    rng = np.random.default_rng(8)
    place = np.full((5, 5), 120.0)
    place[2, 2] = 220.0
    counts = rng.poisson(20 * pulse(place) / (WIDTH * np.sqrt(2 * np.pi)))
    found = photon_arrivals(counts, pulse=pulse(50.0), bin_width=1.0, neighbors=1)
    assert found.elsewhere[2, 2] > 0.99
    assert np.all(found.elsewhere[0] < 0.01)


def test_wrong_arguments_are_named() -> None:
    one = pulse(50.0)
    with pytest.raises(ValueError, match="pulse must not be constant"):
        time_bound(np.ones(9), sample_interval=1, noise=1)
    with pytest.raises(ValueError, match="at least three samples"):
        side_lobe([0, 0, 0])
    with pytest.raises(ValueError, match="same samples on the last axis"):
        matched_filter(one[:9], pulse=one, noise=1, sample_interval=1)
    with pytest.raises(ValueError, match="two increasing times"):
        matched_filter(one, pulse=one, noise=1, sample_interval=1, gate=(2, 1))
    with pytest.raises(ValueError, match="needed are at least 4 samples"):
        matched_filter(one, pulse=one, noise=1, sample_interval=1, gate=(2, 4))
    with pytest.raises(ValueError, match="shorter than the pulse"):
        matched_filter(one, pulse=one, noise=1, sample_interval=1, gate=(2, 6))
    with pytest.raises(ValueError, match="water must have 300 samples"):
        matched_filter(one, pulse=one, noise=1, sample_interval=1, water=[1.0])
    with pytest.raises(ValueError, match="rows, columns, bins"):
        photon_arrivals(np.ones(300), pulse=one, bin_width=1)
    with pytest.raises(ValueError, match="exposure must have the shape"):
        photon_arrivals(np.ones((1, 1, 300)), pulse=one, bin_width=1, exposure=[1.0])
