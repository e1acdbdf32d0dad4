"""The ambiguity interval is settled by maximum likelihood, or said to be open."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light

from amulor.optics.ambiguity import fit, optical_path


def _phases(path: np.ndarray, frequency: np.ndarray) -> np.ndarray:
    turn = 2 * np.pi * frequency[:, None] * path / speed_of_light
    return np.angle(np.exp(1j * turn))


@given(
    st.lists(st.floats(0.01, 29.0), min_size=1, max_size=5),
    st.sampled_from([(10e6,), (10e6, 70e6), (30e6, 40e6), (30e6, 40e6, 170e6)]),
)
def test_a_path_inside_the_interval_is_found_exactly(
    paths: list[float], frequencies: tuple[float, ...]
) -> None:
    path, frequency = np.array(paths), np.array(frequencies)
    phase = _phases(path, frequency)
    found = optical_path(
        phase,
        np.full(phase.shape, 1e-3),
        modulation_frequency=frequency,
        shortest=np.zeros(path.shape),
        longest=np.full(path.shape, 29.5),
    )
    assert_allclose(found.length, path, atol=1e-9)
    assert found.settled.all()


def test_one_frequency_cannot_settle_two_intervals() -> None:
    frequency = np.array([100e6])
    path = np.array([1.0])
    found = optical_path(
        _phases(path, frequency),
        np.full((1, 1), 1e-3),
        modulation_frequency=frequency,
        shortest=np.zeros(1),
        longest=np.full(1, 10.0),
    )
    assert not found.settled.any()


def test_a_stated_interval_settles_it() -> None:
    frequency = np.array([100e6])
    path = np.array([7.0])
    found = optical_path(
        _phases(path, frequency),
        np.full((1, 1), 1e-3),
        modulation_frequency=frequency,
        shortest=np.full(1, 6.0),
        longest=np.full(1, 8.0),
    )
    assert_allclose(found.length, 7.0)
    assert found.settled.all()


def test_a_path_outside_the_interval_is_not_settled() -> None:
    frequency = np.array([100e6])
    found = optical_path(
        _phases(np.array([1.0]), frequency),
        np.full((1, 1), 1e-3),
        modulation_frequency=frequency,
        shortest=np.full(1, 1.5),
        longest=np.full(1, 3.5),
    )
    assert not found.settled.any()


def test_frequencies_that_contradict_each_other_are_not_trusted() -> None:
    frequency = np.array([10e6, 100e6])
    phase = _phases(np.array([5.0]), frequency)
    phase[0] += 0.5  # 0.5 rad at 10 MHz are 2.4 m, far off at 1e-3 rad
    found = optical_path(
        phase,
        np.full(phase.shape, 1e-3),
        modulation_frequency=frequency,
        shortest=np.zeros(1),
        longest=np.full(1, 29.0),
    )
    assert not found.settled.any()


def test_the_uncertainty_holds_and_is_that_of_the_weighted_mean() -> None:
    rng = np.random.default_rng(3)
    frequency = np.array([30e6, 40e6, 150e6])
    sigma = np.array([0.02, 0.03, 0.04])[:, None]
    path = np.full(20_000, 12.0)
    phase = _phases(path, frequency) + sigma * rng.standard_normal((3, path.size))
    found = optical_path(
        phase,
        np.broadcast_to(sigma, phase.shape),
        modulation_frequency=frequency,
        shortest=np.zeros(path.size),
        longest=np.full(path.size, 29.0),
    )
    by_hand = (
        np.sum((2 * np.pi * frequency / speed_of_light / sigma[:, 0]) ** 2) ** -0.5
    )
    assert_allclose(found.uncertainty, by_hand, rtol=1e-12)
    # The test of agreement refuses one in ten thousand by chance.
    assert found.settled.mean() > 0.999
    z = (found.length - path)[found.settled] / by_hand
    # Variance of a mean square: 2 / n; five standard errors.
    assert abs(np.mean(z**2) - 1) < 5 * np.sqrt(2 / z.size)
    assert abs(z.mean()) < 5 / np.sqrt(z.size)


def test_an_interval_without_end_is_refused() -> None:
    with pytest.raises(ValueError, match="narrow it"):
        optical_path(
            np.zeros((1, 1)),
            np.ones((1, 1)),
            modulation_frequency=np.array([1e9]),
            shortest=np.zeros(1),
            longest=np.full(1, 1e6),
        )


@pytest.mark.parametrize("sigma", [0.25, 0.35])
def test_the_stated_probability_of_a_wrong_interval_is_how_often_it_is_wrong(
    sigma: float,
) -> None:
    rng = np.random.default_rng(8)
    frequency = np.array([20e6, 80e6])
    wavelength = 299792458.0 / frequency
    # Four repetitions of 80 MHz in one of 20 MHz.
    true = rng.uniform(1.0, 1.0 + wavelength[0], 40_000)
    noise = sigma * rng.standard_normal((2, true.size))
    found = optical_path(
        2 * np.pi * true / wavelength[:, None] + noise,
        np.full((2, true.size), sigma),
        modulation_frequency=frequency,
        shortest=np.full(true.size, 1.0),
        longest=np.full(true.size, 1.0 + wavelength[0]),
    )
    wrong = np.abs(found.length - true) > wavelength[1] / 2
    # Ten thousand and more in the middle, away from the ends of the limits.
    inside = (true > 3.0) & (true < wavelength[0] - 1.0)
    stated, happened = found.wrong[inside].mean(), wrong[inside].mean()
    assert happened > 2e-3
    chance = np.sqrt(happened / inside.sum())
    assert abs(stated - happened) < 4 * chance + 0.05 * happened


_SWEEP = 5e6 + 9.4e6 * np.arange(16)


@given(
    seed=st.integers(0, 2**32 - 1),
    spoiled=st.lists(st.integers(0, 15), min_size=1, max_size=3, unique=True),
    turn=st.floats(0.3, 2.8),
)
def test_phases_that_stand_alone_are_left_out_and_the_rest_decides(
    seed: int, spoiled: list[int], turn: float
) -> None:
    rng = np.random.default_rng(seed)
    sigma = 5e-3
    path = rng.uniform(4.0, 7.0, 40)
    phase = _phases(path, _SWEEP) + sigma * rng.standard_normal((16, 40))
    phase[spoiled, 7] += turn
    found = optical_path(
        phase,
        np.full(phase.shape, sigma),
        modulation_frequency=_SWEEP,
        shortest=np.full(40, 3.0),
        longest=np.full(40, 8.0),
    )
    # Noise alone may take one of 40 pixels, or a phase of it, in a draw of thousands.
    assert found.settled[7]
    assert found.settled.sum() >= 39
    assert_allclose(np.flatnonzero(found.left_out[:, 7]), sorted(spoiled))
    assert found.left_out.sum() <= len(spoiled) + 1
    # What the others say with these samples gone, by textbook least squares.
    rest = np.setdiff1d(np.arange(16), spoiled)
    wavenumber = 2 * np.pi * _SWEEP[rest] / speed_of_light
    off = np.angle(np.exp(1j * (phase[rest, 7] - wavenumber * path[7])))
    expected = path[7] + (wavenumber @ off) / (wavenumber @ wavenumber)
    assert_allclose(found.length[7], expected, rtol=0, atol=1e-9)
    error = sigma / np.sqrt(wavenumber @ wavenumber)
    assert_allclose(found.uncertainty[7], error, rtol=1e-9)
    assert_allclose(found.weight[spoiled, 7], 0)
    assert_allclose(found.residual[spoiled, 7], 0)


def test_what_many_pixels_have_in_common_is_not_left_out() -> None:
    rng = np.random.default_rng(4)
    path = rng.uniform(4.0, 7.0, 100)
    phase = _phases(path, _SWEEP) + 5e-3 * rng.standard_normal((16, 100))
    phase[0, :40] += 0.4
    found = optical_path(
        phase,
        np.full(phase.shape, 5e-3),
        modulation_frequency=_SWEEP,
        shortest=np.full(100, 3.0),
        longest=np.full(100, 8.0),
    )
    assert not found.left_out.any()
    assert not found.settled[:40].any()
    assert found.settled[40:].all()


def test_two_frequencies_that_disagree_do_not_tell_which_one_is_wrong() -> None:
    frequency = np.array([20e6, 80e6])
    phase = _phases(np.array([5.0, 5.0]), frequency)
    phase[1, 1] += 0.3
    found = optical_path(
        phase,
        np.full(phase.shape, 5e-3),
        modulation_frequency=frequency,
        shortest=np.full(2, 3.0),
        longest=np.full(2, 8.0),
    )
    assert found.settled.tolist() == [True, False]
    assert not found.left_out.any()


@pytest.mark.parametrize(
    ("outside", "settled"), [(-1.0, True), (1.5, True), (3.0, False)]
)
@pytest.mark.parametrize("end", ["near", "far"])
def test_a_path_well_outside_of_its_limits_is_no_result(
    outside: float, settled: bool, end: str
) -> None:
    frequency = np.array([30e6, 150e6])
    near, far, error = 4.0, 8.0, 0.02
    sigma = error * speed_of_light / frequency[-1] / (2 * np.pi)
    true = near - outside * sigma if end == "near" else far + outside * sigma
    phase = np.angle(np.exp(2j * np.pi * frequency * true / speed_of_light))
    found = optical_path(
        phase[:, None],
        np.full((2, 1), error),
        modulation_frequency=frequency,
        shortest=np.array([near]),
        longest=np.array([far]),
    )
    assert found.settled.item() is settled


@pytest.mark.parametrize("outliers", [0, 10, 60])
def test_rows_solved_by_the_choices_of_their_scan_are_those_of_the_whole(
    outliers: int,
) -> None:
    rng = np.random.default_rng(4)
    frequency = np.array([20e6, 45e6, 70e6, 90e6])
    sigma = np.array([0.02, 0.01, 0.01, 0.01])[:, None]
    path = rng.uniform(1.0, 14.0, 100)
    phase = 2 * np.pi * frequency[:, None] * path / speed_of_light
    phase += sigma * rng.standard_normal(phase.shape)
    phase[2, :outliers] += 1.5
    known = {"modulation_frequency": frequency}
    limits = {"shortest": np.zeros(100), "longest": np.full(100, 14.9)}
    sigma = np.broadcast_to(sigma, phase.shape)
    whole, choices = fit(phase, sigma, **known, **limits)
    # Of a hundred pixels fifteen may lose a frequency, more may not.
    assert choices.order[0] == 3
    assert choices.outliers_left_out == (outliers <= 15)
    for rows in (slice(0, 5), slice(5, 100)):
        some = {name: limit[rows] for name, limit in limits.items()}
        part = optical_path(
            phase[:, rows], sigma[:, rows], **known, **some, choices=choices
        )
        for name, values in vars(part).items():
            assert_array_equal(values, getattr(whole, name)[..., rows])


@pytest.mark.parametrize("left_out", [[], [1]])
def test_a_path_rate_is_a_correlated_error_of_the_readings(left_out):
    """Compared with generalized least squares by the inverse of the full covariance."""
    rng = np.random.default_rng(4)
    frequency = np.array([20e6, 35e6, 60e6, 90e6])
    per_phase = speed_of_light / frequency / (2 * np.pi)
    motion = np.array([-0.03, 0.01, 0.0, 0.05])
    length = 8.0 + motion * 1.3
    sigma = np.array([2e-3, 4e-3, 1e-3, 3e-3])
    sigma[left_out] = np.inf
    noise = np.where(np.isfinite(sigma), sigma, 0) * rng.standard_normal(4)
    found = optical_path(
        np.angle(np.exp(1j * (length / per_phase + noise)))[:, None],
        sigma[:, None],
        modulation_frequency=frequency,
        shortest=np.array([5.0]),
        longest=np.array([10.0]),
        motion=motion[:, None],
    )
    used = np.isfinite(sigma)
    paths = (length + noise * per_phase)[used]
    covariance = np.diag((sigma * per_phase)[used] ** 2)
    inverse = np.linalg.inv(covariance + np.outer(motion[used], motion[used]))
    weight = inverse.sum(axis=0) / inverse.sum()
    error = paths - weight @ paths
    assert found.settled[0]
    np.testing.assert_allclose(found.weight[used, 0], weight, atol=1e-9)
    np.testing.assert_allclose(found.length, weight @ paths, rtol=1e-12)
    np.testing.assert_allclose(found.uncertainty, inverse.sum() ** -0.5, rtol=1e-9)
    np.testing.assert_allclose(found.strain, error @ inverse @ error, rtol=1e-6)
