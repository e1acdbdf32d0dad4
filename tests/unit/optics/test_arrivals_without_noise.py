"""Arrivals of echoes without noise, against closed forms of a Gaussian pulse."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm

from amulor.optics import arrivals
from amulor.optics.arrivals import matched_filter, photon_arrivals, side_lobe

WIDTH = 4.0
COUNT = 240
BINS = np.arange(COUNT)
STEP = 2e-9
#: Inverse bandwidth of the pulse: root of the square over the squared differences.
BAND = 1 / np.sqrt(2 * (1 - np.exp(-1 / (4 * WIDTH**2))))
#: Step of a search, a third of it.
SEARCH = BAND / 3


def pulse(place: float) -> np.ndarray:
    """Return a Gaussian that repeats after all samples."""
    distance = (BINS - place + COUNT / 2) % COUNT - COUNT / 2
    return np.exp(-0.5 * (distance / WIDTH) ** 2)


def light(place: float) -> np.ndarray:
    """Return the share of an echo in each bin."""
    return pulse(place) / (WIDTH * np.sqrt(2 * np.pi))


def score_of(record: np.ndarray, noise: float) -> float:
    """Return the score of a Gaussian of size 1 that is where it was expected."""
    shape = pulse(80.0) - pulse(80.0).mean()
    return float(shape @ record / np.linalg.norm(shape) / noise)


def length() -> float:
    """Return the length of the curve of normalized echoes at the steps of a search."""
    power, level = np.sqrt(np.pi) * WIDTH, 2 * np.pi * WIDTH**2 / COUNT
    chord = power * np.exp(-((SEARCH / WIDTH) ** 2) / 4) - level
    return float((np.ceil(COUNT / SEARCH) - 1) * np.arccos(chord / (power - level)))


def chance(score: float) -> float:
    """Return the bound of Davies for a score anywhere in the record."""
    return float(norm.sf(score) + length() / (2 * np.pi) * np.exp(-(score**2) / 2))


def test_a_pulse_has_its_delay_its_size_and_the_errors_of_the_bound() -> None:
    noise = 0.02
    records = np.array([[2.0 * pulse(117.3) + 5.0], [0.5 * pulse(96.0) - 1.0]])
    found = matched_filter(
        records, pulse=pulse(80.0), noise=noise, sample_interval=STEP
    )
    assert found.time.shape == (2, 1)
    assert_allclose(found.time[:, 0] / STEP, [37.3, 16.0], atol=1e-4)
    assert_allclose(found.amplitude[:, 0], [2.0, 0.5], rtol=1e-4)
    power = np.sqrt(np.pi) * WIDTH - 2 * np.pi * WIDTH**2 / COUNT
    assert_allclose(found.amplitude_uncertainty, noise / np.sqrt(power), rtol=1e-4)
    slope = np.sqrt(np.sqrt(np.pi) / 2 / WIDTH)
    bound = noise / slope / np.array([2.0, 0.5]) * STEP
    assert_allclose(found.uncertainty[:, 0], bound, rtol=2e-3)
    assert np.all(found.probability < 1e-30)
    assert np.all(found.elsewhere < 1e-30)
    assert np.all(found.second == 1.0)


@pytest.mark.parametrize("score", [2.9, 3.6, 4.4])
def test_a_faint_pulse_is_as_improbable_as_its_score(score: float) -> None:
    noise = score_of(pulse(80.0), 1.0) / score
    found = matched_filter(
        3 + pulse(80.0), pulse=pulse(80.0), noise=noise, sample_interval=1.0,
        periodic=True,
    )  # fmt: skip
    assert_allclose(found.probability, chance(score), rtol=5e-3)


@pytest.mark.parametrize(("other", "score"), [(1, 3.3), (-1, 3.3), (1, 4.1)])
def test_a_second_pulse_is_as_improbable_as_its_score(other: int, score: float) -> None:
    noise = score_of(pulse(80.0), 1.0) / score
    record = 8 * pulse(80.0) + other * pulse(80 + 64 * SEARCH)
    found = matched_filter(
        record, pulse=pulse(80.0), noise=noise, sample_interval=1.0, periodic=True
    )
    # The constant is estimated, so that each of two echoes lowers the other.
    assert_allclose(found.second, 2 * chance(score), rtol=0.05)
    assert_allclose(found.time, 0, atol=1e-6)
    assert_allclose(found.amplitude, 8, rtol=0.01)


def test_two_equal_pulses_are_each_the_echo_with_the_probability_of_a_half() -> None:
    record = pulse(80.0) + pulse(80 + 64 * SEARCH)
    options = {"pulse": pulse(80.0), "sample_interval": 1.0, "periodic": True}
    found = matched_filter(record, noise=0.3, **options)
    assert_allclose(found.elsewhere, 0.5, atol=0.02)
    # Of unequal ones the weights are those of their likelihoods, over their widths.
    unequal = matched_filter(
        pulse(80.0) + 0.9 * pulse(80 + 64 * SEARCH), noise=0.35, **options
    )
    large, small = (score_of(size * pulse(80.0), 0.35) for size in (1.0, 0.9))
    ratio = np.exp((small**2 - large**2) / 2) * large / small
    assert_allclose(unequal.elsewhere, ratio / (1 + ratio), rtol=0.1)


def test_a_record_that_repeats_finds_a_pulse_across_its_ends() -> None:
    options = {"pulse": pulse(80.0), "noise": 0.01, "sample_interval": 1.0}
    found = matched_filter(pulse(2.6), periodic=True, **options)
    assert_allclose(found.time % COUNT, 162.6, atol=1e-3)
    assert_allclose(found.amplitude, 1, rtol=1e-4)
    # The last delays of the search are beside the first ones.
    assert matched_filter(pulse(80.0), periodic=True, **options).elsewhere < 1e-9


@pytest.mark.parametrize(("period", "expected"), [(np.inf, 5 / 11), (10.0, 2 / 11)])
def test_delays_elsewhere_are_weighed_by_their_likelihood(
    period: float, expected: float
) -> None:
    place = np.array([0.0, 1.0, 5.0, 9.5])
    score = np.sqrt(2 * np.log([4.0, 2.0, 2.0, 3.0]))
    found = arrivals._elsewhere(place, score, 0.2, 1.0, period=period)
    assert_allclose(found, expected, rtol=1e-12)


@pytest.mark.parametrize("size", [1.0, 50.0, 5000.0])
def test_strong_echoes_have_the_error_of_the_bound_too(size: float) -> None:
    options = {"pulse": pulse(80.0), "sample_interval": 1.0}
    found = matched_filter(size * pulse(110.27), noise=0.1, **options)
    bound = 0.1 / size / np.sqrt(np.sqrt(np.pi) / 2 / WIDTH)
    assert_allclose(found.uncertainty, bound, rtol=5e-3)
    assert_allclose(found.time, 30.27, atol=1e-4)
    photons = 100 * size
    counts = np.broadcast_to(photons * light(110.27), (3, 3, COUNT))
    for neighbors in (0, 1):
        arrived = photon_arrivals(
            counts, pulse=pulse(80.0), bin_width=1.0, neighbors=neighbors
        )
        error = arrived.uncertainty[1, 1]
        assert_allclose(error, WIDTH / np.sqrt(photons), rtol=0.03)
        assert_allclose(arrived.time[1, 1], 30.27, atol=3e-3)


def test_water_of_any_size_and_a_constant_move_no_pulse() -> None:
    water = np.exp(-np.maximum(BINS - 30, 0) / 25) * (BINS > 30)
    options = {"pulse": pulse(80.0), "noise": 0.01, "sample_interval": 1.0}
    expected = matched_filter(pulse(110.3), water=water, **options)
    found = matched_filter(7 * water + pulse(110.3) - 2, water=water, **options)
    assert_allclose(found.time, 30.3, atol=1e-3)
    for name in ("uncertainty", "amplitude", "amplitude_uncertainty"):
        assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9)
    # The part of the pulse that neither water nor a constant explains.
    others = np.stack([water, np.ones(COUNT)], axis=1)
    explained = others @ np.linalg.lstsq(others, pulse(110.3), rcond=None)[0]
    size = np.linalg.norm(pulse(110.3) - explained)
    assert_allclose(found.amplitude_uncertainty, 0.01 / size, rtol=1e-4)


def test_a_gate_leaves_the_samples_between_its_times() -> None:
    record = pulse(110.0) + 30 * pulse(180.0)
    options = {"pulse": pulse(80.0), "noise": 0.01, "sample_interval": STEP}
    assert_allclose(matched_filter(record, **options).time, 100 * STEP, rtol=1e-6)
    found = matched_filter(record, gate=(90 * STEP, 140 * STEP), **options)
    assert_allclose(found.time, 30 * STEP, rtol=1e-4)
    inside = arrivals._search(
        pulse(80.0), gate=(90.0, 140.0), photons=False, periodic=False
    ).inside
    assert list(np.flatnonzero(inside)[[0, -1]]) == [90, 139]
    assert inside.sum() == 50


def test_delays_of_a_search_hold_half_of_the_pulse_three_to_a_width() -> None:
    search = arrivals._search(
        pulse(80.0), gate=(90.0, 140.0), photons=False, periodic=False
    )
    assert_allclose(search.width, BAND, rtol=1e-3)
    assert_allclose(np.diff(search.place), SEARCH, rtol=1e-3)
    assert 10 <= search.place[0] < 10 + search.width / 3
    assert 59 - search.width / 3 < search.place[-1] <= 59.5
    echo = search.echo_at(np.array([21.0]))
    assert_allclose(echo, pulse(101.0)[90:140, None], atol=1e-12)


@pytest.mark.parametrize("place", [0.0, 2.0, 120.0, 238.7])
def test_width_of_a_pulse_that_repeats_does_not_depend_on_its_place(
    place: float,
) -> None:
    options = {"gate": (-np.inf, np.inf), "photons": False}
    search = arrivals._search(pulse(place), periodic=True, **options)
    assert_allclose(search.width, BAND, rtol=1e-7)
    assert_allclose(np.diff(search.place), search.width / 3, rtol=1e-9)
    assert search.place[0] == 0
    assert COUNT - search.width / 3 <= search.place[-1] < COUNT
    # A pulse that ends with the record ends without a step.
    cut = np.exp(-0.5 * ((BINS - COUNT + 3.0) / WIDTH) ** 2)
    found = arrivals._search(cut, periodic=False, **options).width
    expected = np.sqrt(np.sum(cut**2) / np.sum((cut[1:] - cut[:-1]) ** 2))
    assert_allclose(found, expected, rtol=1e-9)


def test_echoes_between_bins_conserve_the_photons_of_a_pulse() -> None:
    shape = np.array([0.0, 0.0, 0.2, 0.5, 0.3, 0.0, 0.0, 0.0])
    everything = (-np.inf, np.inf)
    search = arrivals._search(shape, gate=everything, photons=True, periodic=False)
    echo = search.echo_at(np.array([0.0, 1.0, 1.4, 7.0]))
    assert_allclose(echo[:, 0], shape, atol=1e-15)
    assert_allclose(echo[1:, 1], shape[:-1], atol=1e-15)
    assert_allclose(echo.sum(axis=0), [1, 1, 1, 0], atol=1e-15)
    assert np.all(echo >= 0)
    # Two thirds of the light of 0 at the end are not in the record any more.
    early = search.echo_at(np.array([-3.0]))[:, 0]
    assert_allclose(early, [0.5, 0.3, 0, 0, 0, 0, 0, 0], atol=1e-15)


@pytest.mark.parametrize("background", [0.0, 0.2])
def test_photons_without_noise_have_the_errors_of_their_information(
    background: float,
) -> None:
    mean = 400 * light(110.0) + background
    found = photon_arrivals(mean[None, None], pulse=7 * pulse(80.0), bin_width=STEP)
    assert found.time.shape == (1, 1)
    assert_allclose(found.time / STEP, 30, atol=2e-3)
    assert_allclose(found.amplitude, 400, rtol=2e-3)
    known = np.sum(light(110.0) ** 2 / mean)
    assert_allclose(found.amplitude_uncertainty, 1 / np.sqrt(known), rtol=2e-3)
    slope = 400 * light(110.0) * (BINS - 110) / WIDTH**2
    expected = STEP / np.sqrt(np.sum(slope**2 / mean))
    assert_allclose(found.uncertainty, expected, rtol=0.01)
    assert found.probability < 1e-30
    assert found.elsewhere < 1e-30


def test_faint_photons_are_as_improbable_as_their_likelihood() -> None:
    # A sixth of the photons comes from the target.
    mean = 10 * light(80 - COUNT + 143 * SEARCH) + 50 / COUNT
    found = photon_arrivals(mean[None, None], pulse=pulse(80.0), bin_width=STEP)
    gain = np.sum(mean * np.log(mean / (60 / COUNT)))
    score = np.sqrt(2 * gain)
    expected = norm.sf(score) + length() / (2 * np.pi) * np.exp(-gain)
    assert_allclose(found.probability, expected, rtol=0.05)
    assert_allclose(found.amplitude, 10, rtol=0.01)


def test_a_second_echo_of_photons_is_as_improbable_as_its_likelihood() -> None:
    first, other = (light(80 - COUNT + k * SEARCH) for k in (127, 180))
    mean = 300 * first + 13 * other + 60 / COUNT
    found = photon_arrivals(mean[None, None], pulse=pulse(80.0), bin_width=STEP)
    assert_allclose(found.time / STEP, 127 * SEARCH - COUNT, atol=0.01)
    one = (300 * first + 73 / COUNT) / 373
    shares = np.linspace(0, 0.2, 2001)[:, None]
    gain = np.log(((1 - shares) * one + shares * other) / one) @ mean
    assert gain.max() > 4
    expected = norm.sf(np.sqrt(2 * gain.max())) + length() / (2 * np.pi) * np.exp(
        -gain.max()
    )
    assert_allclose(found.second, expected, rtol=0.3)


def test_a_faint_echo_has_its_photons_even_where_it_proves_nothing() -> None:
    mean = 2 * light(110.0) + 60 / COUNT
    found = photon_arrivals(mean[None, None], pulse=pulse(80.0), bin_width=1.0)
    assert_allclose(found.amplitude, 2, rtol=0.15)
    assert found.probability == 1


def test_two_equal_echoes_of_photons_are_each_as_probable() -> None:
    places = (80 - COUNT + k * SEARCH for k in (137, 180))
    mean = sum(30 * light(place) for place in places) + 1 / COUNT
    found = photon_arrivals(mean[None, None], pulse=pulse(80.0), bin_width=1.0)
    assert_allclose(found.elsewhere, 0.5, atol=0.02)


def test_echoes_of_photons_are_apart_if_their_correlation_is_below_0_4() -> None:
    everything = (-np.inf, np.inf)
    search = arrivals._search(
        pulse(80.0), gate=everything, photons=True, periodic=False
    )
    ones = np.ones(COUNT)
    beam = arrivals._Photons(search, search.echo_at(search.place), ones, ones, [ones])
    apart = beam._apart(ones / COUNT, light(110.0))
    # Of two Gaussians at a distance s, exp(-s^2 / 4 w^2).
    far = np.abs(search.place - 30) > 2 * WIDTH * np.sqrt(-np.log(0.4))
    assert np.array_equal(apart, far)


def test_water_of_any_size_moves_no_photons() -> None:
    water = np.exp(-np.maximum(BINS - 30, 0) / 25) * (BINS > 30)
    mean = 300 * light(110.0) + 40 * water + 0.1
    options = {"pulse": pulse(80.0), "bin_width": 1.0}
    found = photon_arrivals(mean[None, None], water=3 * water, **options)
    assert_allclose(found.time, 30, atol=0.01)
    assert_allclose(found.amplitude, 300, rtol=0.01)
    assert found.second > 0.9
    # Light between the water and the echo is unexplained if no water is stated.
    assert photon_arrivals(mean[None, None], **options).second < 1e-6


def test_bins_that_were_seldom_ready_count_for_less() -> None:
    ready = np.where(BINS < 112, 0.4, 1.0)
    mean = (300 * light(110.0) + 0.2) * ready
    options = {"pulse": pulse(80.0), "bin_width": 1.0}
    found = photon_arrivals(mean[None, None], exposure=ready[None, None], **options)
    assert_allclose(found.time, 30, atol=0.01)
    assert_allclose(found.amplitude, 300 * light(110.0) @ ready, rtol=0.01)
    assert photon_arrivals(mean[None, None], **options).time > 31


def test_pixels_without_photons_have_no_time_and_prove_nothing() -> None:
    counts = np.zeros((1, 2, COUNT))
    counts[0, 1] = 50 * light(110.0)
    found = photon_arrivals(counts, pulse=pulse(80.0), bin_width=1.0)
    assert np.isnan(found.time[0, 0])
    assert np.isnan(found.uncertainty[0, 0])
    assert np.isnan(found.amplitude_uncertainty[0, 0])
    assert found.amplitude[0, 0] == 0
    for name in ("probability", "elsewhere", "second"):
        assert getattr(found, name)[0, 0] == 1
    assert_allclose(found.time[0, 1], 30, atol=0.01)


def test_neighbors_add_their_photons_to_the_tests_and_not_to_the_amplitude() -> None:
    # Whole photons: the sums over neighbors are rounded.
    row = np.zeros(COUNT)
    row[[109, 110, 111]] = 1, 2, 1
    counts = np.broadcast_to(row, (3, 4, COUNT))
    options = {"pulse": pulse(80.0), "bin_width": 1.0}
    alone = photon_arrivals(counts, **options)
    found = photon_arrivals(counts, neighbors=1, **options)
    assert_allclose(alone.time, 30, atol=0.02)
    assert_allclose(found.time, 30, atol=0.02)
    assert_allclose(found.amplitude, 4, rtol=0.01)
    # Nine pixels in the middle, six at a side, four at a corner: their gains add up.
    nine = photon_arrivals(9 * row[None, None], **options).probability[0, 0]
    four = photon_arrivals(4 * row[None, None], **options).probability[0, 0]
    assert_allclose(found.probability[1, 1], nine, rtol=1e-6)
    assert_allclose(found.probability[0, 0], four, rtol=1e-6)
    assert four > nine


@pytest.mark.parametrize(
    ("code", "periodic", "expected"),
    [
        # Products of the shifted code by hand, over that without a shift.
        ([1, 2, 1], False, 1 / 6),
        ([3, 1, 0, 0], True, 4 / 6),
        ([1, 0, 0, 1, 0], False, 1 / 2),
        ([2, -1, 1], False, 3 / 6),
        ([0, 1, 0, 0, 0, 0], True, 0.2),
    ],
)
def test_side_lobe_of_a_code_of_a_few_samples(
    code: list[int], periodic: bool, expected: float
) -> None:
    assert_allclose(side_lobe(code, periodic=periodic), expected, rtol=1e-12)
