"""What a polynomial misses between the shots is stated by a second one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.rejection.covariance import Covariance
from amulor.rejection.reference import surface
from amulor.rejection.reference.shots import fit_channel
from amulor.rejection.reference.surface import relative_fluctuation


def _directions(columns: int, rows: int, wide: float, tall: float) -> np.ndarray:
    across, up = np.meshgrid(
        np.linspace(-wide, wide, columns), np.linspace(-tall, tall, rows)
    )
    return np.stack([across.ravel(), up.ravel()], axis=1)


def _gaussian(places: np.ndarray, width: float) -> np.ndarray:
    """Return a signal that falls off as a Gaussian, with a phase that turns a bit."""
    square = (places**2).sum(axis=1)
    return np.exp(-square / width**2 + 0.4j * places[:, 0] / width)


@pytest.mark.parametrize("tall", [0.7, 1.0, 1.5])
def test_the_error_between_three_rows_is_within_what_is_stated(tall: float) -> None:
    rng = np.random.default_rng(1)
    places = np.repeat(_directions(9, 3, 0.5, tall), 10, axis=0)
    noise = 1e-3 * rng.standard_normal((2, len(places)))
    shots = _gaussian(places, 1.0) + noise[0] + 1j * noise[1]
    variance = np.full(len(shots), 1e-6)
    pixels = _directions(21, 41, 0.5, tall)
    found = fit_channel(
        shots, Covariance(variance, variance, 0 * variance), places, pixels
    )
    off = found.signal - _gaussian(pixels, 1.0)
    stated = np.sqrt(found.common.in_phase + found.common.quadrature)
    # The exact curve lies next to the second polynomial: one sigma, and its noise.
    assert np.max(np.abs(off) / np.hypot(stated, 5e-4)) < 2
    # From 2 % to a third of the signal, and none of it was stated before.
    assert np.abs(off).max() > 0.01


def test_dense_shots_state_no_more_than_their_noise() -> None:
    rng = np.random.default_rng(2)
    places = np.repeat(_directions(9, 5, 0.2, 0.2), 10, axis=0)
    noise = 1e-3 * rng.standard_normal((2, len(places)))
    shots = _gaussian(places, 1.0) + noise[0] + 1j * noise[1]
    variance = np.full(len(shots), 1e-6)
    pixels = _directions(21, 21, 0.2, 0.2)
    found = fit_channel(
        shots, Covariance(variance, variance, 0 * variance), places, pixels
    )
    stated = np.sqrt(found.common.in_phase)
    # 450 shots of 1e-3 for up to 15 coefficients.
    assert np.median(stated) < 3e-4


def test_what_drowns_in_noise_has_no_logarithm() -> None:
    rng = np.random.default_rng(3)
    shots = rng.standard_normal(60) + 1j * rng.standard_normal(60)
    group = np.repeat(np.arange(6), 10)
    assert surface.logarithms(shots, np.full(60, 2.0), group) is None
    strong = surface.logarithms(shots + 100, np.full(60, 2.0), group)
    assert strong is not None
    np.testing.assert_allclose(
        strong[1] * np.exp(strong[0]), (shots + 100).reshape(6, 10).mean(axis=1)
    )


def test_fluctuations_along_and_across_the_water_signal_are_separated() -> None:
    rng = np.random.default_rng(3)
    level = 2.0 * np.exp(1j * rng.uniform(-3, 3, 4000)) * rng.uniform(0.5, 1.5, 4000)
    true = np.array([[0.04, 0.01], [0.01, 0.02]])
    radial, tangential = np.linalg.cholesky(true) @ rng.standard_normal((2, 4000))
    root = 0.1 * rng.standard_normal((2, 2))
    noise = root @ rng.standard_normal((2, 4000))
    square = root @ root.T
    instrument = Covariance(
        *(np.full(4000, square[i, j]) for i, j in ((0, 0), (1, 1), (0, 1)))
    )
    shots = level * (1 + radial + 1j * tangential) + noise[0] + 1j * noise[1]
    found = relative_fluctuation(shots, level, instrument, freedom=4000)
    # Variances of 4000 draws have an error of 2 %, that of the noise included.
    assert_allclose(found, true, atol=5 * 0.022 * 0.04)
    # Half of the freedom doubles what is observed, before noise is subtracted.
    again = relative_fluctuation(shots, level, instrument.scaled(0.0), freedom=2000)
    whole = relative_fluctuation(shots, level, instrument.scaled(0.0), freedom=4000)
    assert_allclose(again, 2 * whole)
    # More noise than scatter is no negative variance.
    none = relative_fluctuation(shots, level, instrument.scaled(1e4), freedom=4000)
    assert_allclose(none, 0, atol=1e-12)
    for nothing in (0 * level, level[:0]):
        part = instrument.part(slice(nothing.size))
        result = relative_fluctuation(0 * nothing, nothing, part, freedom=1)
        assert np.all(result == 0)
    assert np.all(relative_fluctuation(shots, level, instrument, freedom=0) == 0)


def _shots(
    rng: np.random.Generator, places: np.ndarray, sigma: float, *, bend: float = 0.0
) -> np.ndarray:
    """Return 1 plus a quadratic function of the azimuth, with noise of both outputs."""
    noise = rng.standard_normal((2, len(places)))
    level = 1 + bend * (places[:, 0] / np.abs(places[:, 0]).max()) ** 2
    return level + sigma * (noise[0] + 1j * noise[1])


@pytest.mark.parametrize("repeats", [2, 6])
def test_a_constant_fails_the_test_of_its_degree_as_often_as_stated(
    repeats: int,
) -> None:
    rng = np.random.default_rng(8)
    directions = np.repeat(_directions(5, 3, 0.2, 0.1), repeats, axis=0)
    places = surface.places_of(directions)
    weight = np.ones(len(directions))
    draws = [
        surface._choose_degree(_shots(rng, directions, 0.1), places, weight)
        for _ in range(600)
    ]
    # One degree more than is needed is fitted; 5 % need one more by chance.
    assert 600 * 0.05 - 22 < sum(degree > 1 for degree, _ in draws) < 600 * 0.05 + 22
    assert min(degree for degree, _ in draws) == 1
    assert all(fits for _, fits in draws)


def test_degrees_follow_what_the_shots_can_tell() -> None:
    rng = np.random.default_rng(9)
    grid = _directions(5, 3, 0.2, 0.1)

    def degree(directions: np.ndarray, bend: float) -> tuple[int, bool]:
        shots = _shots(rng, directions, 0.01, bend=bend)
        places = surface.places_of(directions)
        return surface._choose_degree(shots, places, np.ones(len(shots)))

    # A quadratic function needs 2, and gets one more.
    assert degree(np.repeat(grid, 8, axis=0), 0.5) == (3, True)
    # Without a repeat nothing can be tested; with one, a constant is enough.
    assert degree(grid, 0.5) == (2, True)
    assert degree(np.concatenate([grid, grid[:1]]), 0.0) == (1, True)
    # One direction has one value.
    assert degree(np.repeat(grid[:1] + 0.1, 8, axis=0), 0.0) == (0, True)
    # Plans are judged by the same test, before there are shots.
    level = 1 + 0.5 * (grid[:, 0] / 0.2) ** 2 + 0j
    for repeats, expected in ((1, 0), (2, 3), (8, 3)):
        error = np.full((1, len(grid)), 0.01)
        assert surface.expected_degrees(level[None], error, repeats, grid) == [expected]
    flat = np.ones((1, len(grid)), dtype=complex)
    assert surface.expected_degrees(flat, np.full((1, 15), 0.01), 8, grid) == [1]


def test_a_surface_states_the_scatter_of_its_coefficients() -> None:
    rng = np.random.default_rng(10)
    directions = np.repeat(_directions(5, 3, 0.2, 0.1), 6, axis=0)
    places = surface.places_of(directions)
    sigma = 0.02
    variance = np.full(len(directions), sigma**2)
    noise = Covariance(variance, variance, 0 * variance)
    fits = [
        surface.surface_of(
            _shots(rng, directions, sigma, bend=0.5), noise, places, noise=noise
        )
        for _ in range(100)
    ]
    level = 1 + 0.5 * (directions[:, 0] / 0.2) ** 2
    score = []
    for fit in fits:
        design = surface.design_of(places.where, fit.powers)
        off = design @ fit.coefficients - level
        for part, spread in ((off.real, fit.spreads[0]), (off.imag, fit.spreads[1])):
            stated = np.einsum("ij,jk,ik->i", design, spread, design)
            score.append(part[[0, 44]] / np.sqrt(stated[[0, 44]]))
    # 400 squares of independent numbers: 1 +- 0.07.
    assert np.mean(np.square(score)) == pytest.approx(1, abs=0.25)
    common = [fit for fit in fits if fit.powers.sum(axis=1).max() == 3]
    assert len(common) > 80
    # Left out of a fit, the mean of a direction is off by its error over 1 - h.
    design = surface.design_of(places.distinct, common[0].powers)
    alone = 1 - np.diag(design @ np.linalg.pinv(design))
    missed = np.mean([fit.cross_validation for fit in common])
    assert missed == pytest.approx(np.mean(1 / alone), rel=0.2)
    assert np.mean([fit.excess for fit in fits]) < 0.3
    # Fluctuations beyond the noise of the instrument are small, and never negative.
    relative = np.array([fit.relative for fit in fits])
    assert np.all(np.linalg.eigvalsh(relative) > -1e-12)
    assert np.abs(relative).mean() < 0.3 * sigma**2
