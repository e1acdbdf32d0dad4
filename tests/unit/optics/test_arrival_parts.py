"""Parts of the search for arrivals, with a few bins, by hand."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm

from amulor.optics import arrivals
from amulor.optics.arrivals import photon_arrivals

BINS = np.arange(120)


def photons(counts: np.ndarray, parts: list[np.ndarray]) -> arrivals._Photons:
    """Return photons of a pulse of one bin, in bins that were always ready."""
    pulse = np.zeros(counts.size)
    pulse[2] = 1.0
    search = arrivals._search(
        pulse, gate=(-np.inf, np.inf), photons=True, periodic=False
    )
    echoes = search.echo_at(np.arange(-2.0, counts.size - 2))
    return arrivals._Photons(search, echoes, counts, np.ones(counts.size), parts)


def test_chance_is_that_of_one_place_and_of_the_way_between_places() -> None:
    assert_allclose(arrivals._chance(2.0, 0.0), norm.sf(2.0), rtol=1e-12)
    found = arrivals._chance(np.array([3.0, 1.0]), 4 * np.pi)
    expected = [norm.sf(3.0) + 2 * np.exp(-4.5), 1.0]
    assert_allclose(found, expected, rtol=1e-12)


def test_length_of_a_curve_is_the_sum_of_its_angles() -> None:
    angle = np.array([0.0, 0.5, 0.7, 0.7 + np.pi])
    curve = np.stack([np.cos(angle), np.sin(angle)])
    assert_allclose(arrivals._length(curve), 0.7 + np.pi, rtol=1e-7)


def test_mean_of_places_is_weighed_by_the_likelihood_of_positive_scores() -> None:
    place = np.array([0.0, 1.0, 3.0])
    middle, error = arrivals._mean(place, np.array([-5.0, 2.0, 0.0]))
    weight = np.exp([0.0, 2.0, 0.0]) / (np.exp(2) + 2)
    assert_allclose(middle, weight @ place, rtol=1e-12)
    variance = weight @ (place - weight @ place) ** 2
    assert_allclose(error, np.sqrt(variance), rtol=1e-12)


def test_a_gate_is_in_samples_and_endless_if_none_is_stated() -> None:
    assert arrivals._ends(None, 2.0) == (-np.inf, np.inf)
    assert arrivals._ends((3.0, 8.0), 2.0) == (1.5, 4.0)


def test_places_are_searched_down_to_the_width_of_the_likelihood() -> None:
    asked = []

    def score_at(place: np.ndarray) -> np.ndarray:
        asked.append(place)
        return -((place - 0.3217) ** 2)

    fine, score = arrivals._finely(score_at, 0.0, 3.0, 0.1)
    assert len(asked) == 1
    assert_allclose(fine, np.linspace(-3, 3, 61))
    assert_allclose(score, -((fine - 0.3217) ** 2))
    asked.clear()
    fine, _ = arrivals._finely(score_at, 0.0, 3.0, 0.01)
    # The next search has two steps, or six spreads, on each side of the best place.
    assert len(asked) == 2
    assert_allclose(fine, 0.3 + np.linspace(-0.2, 0.2, 61))
    asked.clear()
    fine, _ = arrivals._finely(score_at, 0.0, 3.0, 0.04)
    assert_allclose(fine, 0.3 + np.linspace(-0.24, 0.24, 61))


@pytest.mark.parametrize(("first", "other"), [(30.0, 10.0), (12.0, 11.0)])
def test_share_of_an_echo_in_one_of_two_bins_is_closed(
    first: float, other: float
) -> None:
    # The likelihood n log(1 + s) + m log(1 - s) is largest at (n - m) / (n + m).
    counts, null = np.array([first, other]), np.array([0.5, 0.5])
    gain, share = arrivals._Photons._gains(counts, np.eye(2), null)
    expected = (first - other) / (first + other)
    assert_allclose(share, [expected, 0.0], rtol=1e-9)
    largest = first * np.log1p(expected) + other * np.log1p(-expected)
    assert_allclose(gain, [largest, 0.0], rtol=1e-9)


def test_all_photons_in_one_bin_are_almost_all_echo() -> None:
    counts, null = np.array([5.0, 0.0]), np.array([0.25, 0.75])
    gain, share = arrivals._Photons._gains(counts, np.eye(2), null)
    # Half of what is missing is added in each of twelve steps.
    assert_allclose(share[0], 1 - 0.7 / 2**12, rtol=1e-12)
    assert_allclose(gain[0], 5 * np.log1p(share[0] * 3), rtol=1e-12)
    assert share[1] == gain[1] == 0


def test_shares_of_backgrounds_are_those_of_their_photons() -> None:
    parts = [np.array([1.0, 0, 0, 0, 0, 0, 0, 0]), np.array([0, 1.0, 1, 0, 0, 0, 0, 0])]
    counts = np.array([30.0, 4, 6, 0, 0, 60, 0, 0])
    beam = photons(counts, parts)
    assert_allclose(beam.mix, [0.5, 0.5])
    assert_allclose(beam.parts, [parts[0], parts[1] / 2])
    # An echo of its own explains the other sixty.
    echo = np.eye(8)[5]
    assert_allclose(beam._mixed([echo]), [0.75, 0.25], rtol=1e-9)
    beam.mix = np.array([0.75, 0.25])
    expected = np.array([0.75, 0.125, 0.125, 0, 0, 0, 0, 0])
    assert_allclose(beam._background(), expected, atol=1e-15)
    alone = photons(counts, parts[:1])
    assert_array_equal(alone._mixed([echo]), [1.0])


def test_size_of_an_echo_is_its_number_of_photons() -> None:
    counts = np.full(8, 2.0)
    counts[4] = 20.0
    beam = photons(counts, [np.ones(8)])
    null = np.full(8, 1 / 8)
    size, spread = beam._size(counts, np.ones(8), null, 2.0)
    # The background is that of the other bins: 14 in 7.
    assert_allclose(size, 18.0, rtol=1e-9)
    assert_allclose(spread, np.sqrt(20.0), rtol=1e-9)


def test_power_of_places_is_the_likelihood_of_the_counts() -> None:
    counts = np.array([0.0, 3, 1, 0, 2, 0, 0, 0])
    beam = photons(counts, [np.ones(8)])
    null = np.full(8, 1 / 8)
    own = counts + np.eye(8)[7]
    ready = np.ones(8)
    found = beam._power(own, ready, null, 0.4, None)
    mean = 0.4 * np.eye(8) + 0.6 / 8
    assert_allclose(found, own @ np.log(mean), rtol=1e-12)
    moved = beam._power(own, ready, null, 0.4, 5 * np.eye(8)[:, [1, 4]])
    assert_allclose(moved, found[[1, 4]], rtol=1e-12)


def test_neighbors_that_were_seldom_ready_count_for_less() -> None:
    rng = np.random.default_rng(3)
    ready = rng.uniform(0.3, 1.0, (3, 3, 120))
    light = np.exp(-0.5 * ((BINS - 70) / 3.0) ** 2)
    counts = (400 * light / light.sum() + 1.0) * ready
    options = {"pulse": np.exp(-0.5 * ((BINS - 40) / 3.0) ** 2), "bin_width": 1.0}
    found = photon_arrivals(counts, exposure=ready, neighbors=1, **options)
    assert_allclose(found.time, 30, atol=0.05)
    expected = np.sum(400 * light / light.sum() * ready, axis=-1)
    assert_allclose(found.amplitude, expected, rtol=0.03)


def test_water_must_be_constant_in_shape_with_the_constant_beside_it() -> None:
    pulse = np.exp(-0.5 * ((BINS - 40) / 3.0) ** 2)
    search = arrivals._search(pulse, gate=(30.0, 90.0), photons=False, periodic=False)
    water = np.exp(-BINS / 20)
    fixed = arrivals._fixed(search, water, BINS.size)
    assert fixed.shape == (60, 2)
    assert_allclose(fixed.T @ fixed, np.eye(2), atol=1e-12)
    for column in (np.ones(60), water[30:90]):
        assert_allclose(fixed @ (fixed.T @ column), column, atol=1e-12)
    alone = arrivals._fixed(search, None, BINS.size)
    assert_allclose(np.abs(alone), 60**-0.5, rtol=1e-12)


def test_a_gate_has_at_least_four_samples() -> None:
    pulse = np.zeros(40)
    pulse[5:7] = 1.0
    options = {"photons": False, "periodic": False}
    search = arrivals._search(pulse, gate=(10.0, 14.0), **options)
    assert search.inside.sum() == 4
    assert search.place[0] >= 4
    assert search.place[-1] <= 8
    with pytest.raises(ValueError, match=r"^the gate has 3 samples, and"):
        arrivals._search(pulse, gate=(10.0, 13.0), **options)
    # Half of the light of the pulse lies within the gate.
    with pytest.raises(ValueError, match="shorter than the pulse"):
        arrivals._search(np.ones(40) + pulse, gate=(10.0, 14.0), **options)
