"""Polynomials over references against dense algebra and refits without a direction."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

from amulor.rejection.covariance import Covariance
from amulor.rejection.reference import surface


def grid(columns: int, rows: int) -> np.ndarray:
    across, up = np.meshgrid(np.linspace(-0.1, 0.3, columns), np.linspace(0, 0.1, rows))
    return np.stack([across.ravel(), up.ravel()], axis=1)


def monomials(where: np.ndarray, degree: int) -> np.ndarray:
    """Return all products of powers up to a degree."""
    powers = [(i, j) for i, j in np.ndindex(5, 5) if i + j <= degree]
    return np.stack([where[:, 0] ** i * where[:, 1] ** j for i, j in powers], axis=1)


def test_directions_are_scaled_and_repeats_are_grouped() -> None:
    direction = np.repeat(grid(5, 3), [1, 2, 3] * 5, axis=0)
    # A scatter far below the span counts as one direction.
    direction[1:3] += [[1e-12, 0], [-1e-12, 0]]
    places = surface.places_of(direction)
    assert_allclose(places.centre, [0.1, 0.05])
    assert_allclose(places.scale, [0.2, 0.05])
    assert_allclose(places.scaled(np.array([[0.3, 0.0]])), [[1, -1]])
    expected = (direction - [0.1, 0.05]) / [0.2, 0.05]
    assert_allclose(places.where, expected, atol=1e-12)
    assert len(places.distinct) == 15
    assert places.size.sum() == 30
    values = np.arange(30.0) + 1j * np.arange(30.0) ** 2
    sums = np.array([values[places.group == k].sum() for k in range(15)])
    assert_allclose(places.sum_of(values), sums)
    assert_allclose(places.mean_of(values), sums / places.size)
    # Three rows determine a quadratic function of the elevation, of degree 4 in all.
    found = {(int(i), int(j)) for i, j in places.powers}
    assert found == {(i, j) for i, j in np.ndindex(5, 3) if i + j <= 4}
    assert len(places.up_to(2)) == 6
    assert len(places.up_to(0)) == 1
    assert_allclose(
        surface.design_of(places.where, places.up_to(2)), monomials(places.where, 2)
    )
    line = surface.places_of(np.array([[0.2, 0.0], [0.4, 0.0], [0.2, 0.0]]))
    assert_allclose(line.scale, [0.1, 1.0])
    assert line.powers.tolist() == [[0, 0], [1, 0]]


@pytest.mark.parametrize(
    ("shots", "degree"), [(5, 0), (6, 0), (7, 1), (9, 1), (10, 2), (14, 3), (19, 4)]
)
def test_a_degree_leaves_four_shots_beyond_its_terms(shots: int, degree: int) -> None:
    # 1, 3, 6, 10 and 15 terms; of the first shots only four are no term.
    assert surface.FEWEST_SHOTS == 5
    places = surface.places_of(grid(5, 5))
    assert places.highest(shots) == degree


def fluctuating(
    seed: int, repeats: int = 4
) -> tuple[np.ndarray, np.ndarray, Covariance]:
    """Return directions, shots that fluctuate, and their stated errors."""
    rng = np.random.default_rng(seed)
    direction = np.repeat(grid(5, 5), repeats, axis=0)
    x, y = direction.T
    level = (1 + 2 * x - y) * np.exp(1j * (0.3 + x))
    draws = rng.standard_normal((4, len(x)))
    variance = rng.uniform(1e-6, 4e-6, (2, len(x)))
    errors = Covariance(variance[0], variance[1], 0.3 * np.sqrt(variance.prod(axis=0)))
    noise = np.sqrt(variance) * draws[:2]
    shots = level * (1 + 0.02 * draws[2] + 0.01j * draws[3])
    return direction, shots + noise[0] + 1j * noise[1], errors


def matrices(errors: Covariance) -> np.ndarray:
    return np.array(
        [[errors.in_phase, errors.cross], [errors.cross, errors.quadrature]]
    ).transpose(2, 0, 1)


def turns(values: np.ndarray) -> np.ndarray:
    """Return the matrices of a multiplication by complex numbers."""
    a, b = values.real, values.imag
    return np.array([[a, -b], [b, a]]).transpose(2, 0, 1)


def scatter(
    shots: np.ndarray, level: np.ndarray, errors: Covariance, freedom: int
) -> np.ndarray:
    """Return the relative scatter along and across a level, beyond stated errors."""
    back = turns(np.exp(-1j * np.angle(level)))
    parts = back @ np.stack([(shots - level).real, (shots - level).imag], 1)[..., None]
    total = np.einsum("nik,njk->ij", parts, parts) * len(shots) / freedom
    total -= np.sum(back @ matrices(errors) @ back.transpose(0, 2, 1), axis=0)
    total /= np.sum(np.abs(level) ** 2)
    values, vectors = np.linalg.eigh(total)
    return np.asarray(vectors @ np.diag(np.maximum(values, 0)) @ vectors.T)


@pytest.mark.parametrize("modelled", [False, True])
def test_a_surface_is_weighted_least_squares_with_its_own_scatter(
    modelled: bool,
) -> None:
    direction, shots, errors = fluctuating(1)
    places = surface.places_of(direction)
    model = np.exp(1j * direction[:, 0]) * (1 + direction[:, 1]) if modelled else None
    noise = surface.noise_of(shots, errors, places)
    found = surface.surface_of(shots, errors, places, noise=noise, model=model)
    degree = int(found.powers.sum(axis=1).max())
    design = monomials(places.where, degree)
    assert len(found.powers) == design.shape[1]
    of = np.ones(len(shots)) if model is None else model
    weight, freedom = np.ones(len(shots)), len(shots) - design.shape[1]
    for _ in range(2):
        root = np.sqrt(weight) * np.abs(of)
        coefficients = np.linalg.lstsq(design * root[:, None], shots / of * root)[0]
        level = design @ coefficients * of
        relative = scatter(shots, level, errors, freedom)
        moved = turns(level)
        total = matrices(errors) + moved @ relative @ moved.transpose(0, 2, 1)
        weight = 2 / np.trace(total, axis1=1, axis2=2)
    assert_allclose(found.coefficients, coefficients, rtol=1e-9, atol=1e-12)
    assert_allclose(found.level, level, rtol=1e-9)
    unsure = freedom / (freedom - 1)
    assert_allclose(found.relative, unsure * relative, rtol=1e-9)
    solve = np.linalg.pinv(design * root[:, None]) * root
    back = turns(1 / of) @ total @ turns(1 / of).transpose(0, 2, 1)
    for spread, (i, j) in zip(found.spreads, ((0, 0), (1, 1), (0, 1)), strict=True):
        expected = unsure * (solve * back[:, i, j]) @ solve.T
        assert_allclose(spread, expected, rtol=1e-9, atol=1e-15)
    # Mean square of a direction that is left out, over the errors of its mean.
    assert found.excess == 0.0
    stated = noise.in_phase + noise.quadrature
    hat = design @ solve
    squares = []
    for k in range(25):
        here = places.group == k
        leverage = hat[np.ix_(here, here)].sum(axis=1)[0]
        alone = np.abs((shots - level)[here].mean()) / (1 - leverage)
        squares.append(alone**2 / (stated[here].sum() / here.sum() ** 2))
    assert found.cross_validation == pytest.approx(np.mean(squares), rel=1e-6)


def test_noise_is_that_about_the_mean_of_each_direction() -> None:
    direction, shots, errors = fluctuating(2)
    places = surface.places_of(direction)
    mean = np.array([shots[places.group == k].mean() for k in range(25)])[places.group]
    relative = scatter(shots, mean, errors, 100 - 25)
    expected = matrices(errors) + turns(mean) @ relative @ turns(mean).transpose(
        0, 2, 1
    )
    found = surface.noise_of(shots, errors, places)
    assert_allclose(matrices(found), expected, rtol=1e-9)
    assert 1e-4 < relative[0, 0] < 1e-3


def test_a_misfit_that_no_degree_explains_is_an_excess() -> None:
    direction, shots, errors = fluctuating(3, repeats=8)
    places = surface.places_of(direction)
    rng = np.random.default_rng(3)
    jumps = (0.1 + 0j) * rng.standard_normal(25)[places.group]
    noise = surface.noise_of(shots + jumps, errors, places)
    found = surface.surface_of(shots + jumps, errors, places, noise=noise)
    assert len(found.powers) == 15
    rest = (
        shots
        + jumps
        - surface.design_of(places.where, found.powers) @ (found.coefficients)
    )
    square = 0.0
    for k in range(25):
        here = places.group == k
        stated = (noise.in_phase + noise.quadrature)[here].sum() / 64
        square += np.abs(rest[here].mean()) ** 2 / stated
    # 25 directions less 15 terms, weighted by errors that differ.
    assert found.excess == pytest.approx(square / (25 - 15) - 1, rel=1e-6)


def test_shots_that_are_exact_have_equal_weights() -> None:
    direction, _, errors = fluctuating(4)
    places = surface.places_of(direction)
    exact = np.full(len(direction), 2 - 1j)
    none = errors.scaled(0.0)
    found = surface.surface_of(exact, none, places, noise=none)
    assert_allclose(found.level, exact, atol=1e-12)
    assert found.cross_validation == pytest.approx(0, abs=1e-20)
    assert found.excess == 0.0
    assert_allclose(found.spreads, 0, atol=1e-20)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_degrees_are_chosen_by_an_f_test(degree: int) -> None:
    # Deterministic scatter: two shots beside each mean, of a misfit that is given.
    direction = np.repeat(grid(5, 5), 2, axis=0)
    places = surface.places_of(direction)
    x = places.where[:, 0]
    sides = np.where(np.arange(50) % 2, 1.0, -1.0) * 0.01
    weight = np.linspace(1, 2, 25)[places.group]
    legendre = np.polynomial.legendre.Legendre.basis(degree + 1)(x)
    terms = (degree + 1) * (degree + 2) // 2
    freedom, repeats = 25 - terms, 25
    design = monomials(places.where, degree)
    root = np.sqrt(weight)
    rest = (
        legendre - design @ np.linalg.lstsq(design * root[:, None], legendre * root)[0]
    )
    pure = np.sum(weight * sides**2) / repeats
    limit = f_distribution.isf(0.05, 2 * freedom, 2 * repeats)
    size = np.sqrt(limit * pure * freedom / np.sum(weight * rest**2))
    for factor, chosen in ((0.999, degree + 1), (1.001, min(degree + 2, 4))):
        # What the degree follows exactly is large, so that lower ones fail.
        shots = 1 + x**degree + factor * size * legendre + sides + 0j
        assert surface._choose_degree(shots, places, weight) == (chosen, True)


def test_the_highest_degree_is_refused_by_one_in_a_thousand() -> None:
    direction = np.repeat(grid(6, 6), 2, axis=0)
    places = surface.places_of(direction)
    x = places.where[:, 0]
    sides = np.where(np.arange(72) % 2, 1.0, -1.0) * 0.01
    bend = np.polynomial.legendre.Legendre.basis(5)(x)
    design = monomials(places.where, 4)
    rest = bend - design @ np.linalg.lstsq(design, bend)[0]
    pure = np.sum(sides**2) / 36
    limit = f_distribution.isf(1e-3, 2 * 21, 2 * 36)
    size = np.sqrt(limit * pure * 21 / np.sum(rest**2))
    for factor, fits in ((0.999, True), (1.001, False)):
        shots = 1.0 + factor * size * bend + sides + 0j
        assert surface._choose_degree(shots, places, np.ones(72)) == (4, fits)


@pytest.mark.parametrize("degree", [0, 1, 2, 4])
@pytest.mark.parametrize("modelled", [False, True])
def test_errors_of_cross_validation_are_those_of_fits_without_a_direction(
    degree: int, modelled: bool
) -> None:
    direction = grid(6, 5)
    rng = np.random.default_rng(degree)
    parts = rng.standard_normal((2, 2, 30))
    signal: NDArray[np.complex128] = 3 + parts[0] + 1j * parts[1]
    model = np.exp(signal / 5) if modelled else None
    found = surface.cross_validation_errors(
        signal, 3, direction, model=model, degrees=[degree] * 2
    )
    where = surface.places_of(direction).where
    for k, n in itertools.product(range(2), range(30)):
        of = np.ones(30) if model is None else model[k]
        others = np.arange(30) != n
        design = monomials(where, degree)
        root = np.abs(of)[others]
        fit = np.linalg.lstsq(
            design[others] * root[:, None], (signal[k] / of)[others] * root
        )[0]
        off = abs(signal[k, n] - of[n] * (design[n] @ fit))
        assert found[k, n] == pytest.approx(off, rel=1e-6)
    assert_allclose(surface.cross_validation_errors(signal[:, :1], 3, direction[:1]), 0)


def test_directions_that_are_all_needed_lower_the_degree() -> None:
    direction = grid(3, 2)
    rng = np.random.default_rng(5)
    signal = (rng.standard_normal((1, 6)) + 2).astype(np.complex128)
    # Six terms for six directions leave no error; five are compared.
    found = surface.cross_validation_errors(signal, 3, direction)
    lower = surface.cross_validation_errors(signal, 3, direction, degrees=[2])
    assert_allclose(found, lower)
    assert found.min() > 1e-6


def test_noiseless_references_are_interpolated_by_their_polynomial() -> None:
    direction, pixels = grid(6, 5), np.random.default_rng(6).uniform(0, 0.1, (7, 2))

    def quartic(at: np.ndarray) -> np.ndarray:
        x, y = at.T
        return np.stack([1 + x**4 - 2j * y**3 * x, 2 + x * y])

    found = surface.noiseless(quartic(direction), 3, direction, pixels)
    assert_allclose(found, quartic(pixels), rtol=1e-9)
    low = surface.noiseless(quartic(direction), 3, direction, pixels, degrees=[0, 2])
    assert_allclose(low[0], quartic(direction)[0].mean(), rtol=1e-9)
    assert_allclose(low[1], quartic(pixels)[1], rtol=1e-9)
    factor = [
        np.exp(5 * at.sum(axis=1)) * np.ones((2, 1)) for at in (direction, pixels)
    ]
    again = surface.noiseless(
        quartic(direction) * factor[0], 3, direction, pixels,
        model=(factor[0] + 0j, factor[1] + 0j),
    )  # fmt: skip
    assert_allclose(again, quartic(pixels) * factor[1], rtol=1e-9)
    # The weights of a fit that is not exact are those of the model.
    part = surface.noiseless(
        quartic(direction), 3, direction, pixels, degrees=[0, 0],
        model=(factor[0] + 0j, factor[1] + 0j),
    )  # fmt: skip
    mean = np.sum(quartic(direction) * factor[0], axis=1) / np.sum(factor[0] ** 2, 1)
    assert_allclose(part, mean[:, None] * factor[1], rtol=1e-9)


@pytest.mark.parametrize("repeats", [2, 5])
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_planned_degrees_follow_the_expected_f_test(repeats: int, degree: int) -> None:
    direction = grid(5, 5)
    where = surface.places_of(direction).where
    bend = np.polynomial.legendre.Legendre.basis(degree + 1)(where[:, 0])
    design = monomials(where, degree)
    rest = bend - design @ np.linalg.lstsq(design, bend)[0]
    freedom = 25 - design.shape[1]
    most = f_distribution.isf(0.05, 2 * freedom, 2 * 25 * (repeats - 1))
    size = np.sqrt((most - 1) * freedom / repeats / np.sum(rest**2)) * 0.01
    for factor, chosen in ((0.999, degree + 1), (1.001, degree + 2)):
        # What the degree follows exactly is large, so that lower ones fail.
        signal = 1 + where[:, 0] ** degree + factor * size * bend + 0j
        found = surface.expected_degrees(
            signal[None], np.full((1, 25), 0.01), repeats, direction
        )
        assert found == [chosen]


def test_an_interpolation_error_is_the_distance_of_two_surfaces() -> None:
    signal = np.array([1.0, 2j, 0.0, 1.0, 1.0])
    logarithm = np.log(np.array([1.01, 1.0, 0.5, 1.04, 20.0])) + 0j
    logarithm[1] += 0.5j * np.pi
    found = surface.disagreement(signal, logarithm, 2.0 + 0j)
    exact = 2.0 * np.minimum(np.exp(logarithm.real), 10) * np.exp(1j * logarithm.imag)
    off = exact - signal
    # Three times as much beyond 2 % of the signal, and in proportion below.
    assert_allclose(found, 3 * off * [1, 0, 1, 1, 1], atol=1e-12)
    near = surface.disagreement(
        np.array([1.0 + 0j]), np.log(np.array([1.005 / 2 + 0j])), 2.0 + 0j
    )
    assert_allclose(near, 0.005 * (1 + 2 * 0.25))


def test_logarithms_need_signals_of_one_side() -> None:
    group = np.array([0, 0, 1, 1])
    shots = np.array([1.0, 3.0, 2.0 + 1j, 2.0 - 1j])
    variance = np.full(4, 0.04)
    found = surface.logarithms(shots, variance, group)
    assert found is not None
    assert_allclose(found[0], [0, 0], atol=1e-15)
    assert found[1] == pytest.approx(2.0)
    # Five errors of a mean of two: 2 > 5 sqrt(v / 2).
    limit = 2 * (2 / 5) ** 2
    assert surface.logarithms(shots, np.full(4, 0.999 * limit), group) is not None
    assert surface.logarithms(shots, np.full(4, 1.001 * limit), group) is None
    for wrong in ([1, 1, -1.2, -1.2], [1, 1, -1, -1], [0, 0, 0, 0], [1, 1, 1j, 3j]):
        values = np.array(wrong, dtype=complex)
        nothing = np.zeros(4)
        undefined = surface.logarithms(values, nothing, group) is None
        assert undefined == (wrong != [1, 1, 1j, 3j])


def test_a_fluctuation_moves_a_signal_along_and_across_itself() -> None:
    relative = np.array([[0.04, 0.01], [0.01, 0.02]])
    level = np.array([1.0, 2j, 1 - 1j])
    found = matrices(surface.fluctuation(relative, level))
    assert_allclose(found, turns(level) @ relative @ turns(level).transpose(0, 2, 1))
    assert_array_equal(
        matrices(surface.fluctuation(0 * relative, level)), np.zeros((3, 2, 2))
    )
