"""Smooth water signals from lines: exact terms, stated errors, outliers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.rejection.smooth_water import (
    Field,
    Offsets,
    SmoothWater,
    fit_smooth_water,
    quadratic,
)

ROWS, COLUMNS = 9, 12
AZIMUTH, ELEVATION = np.meshgrid(
    np.linspace(-0.1, 0.3, COLUMNS), np.linspace(0.0, 0.1, ROWS)
)
X, Y = (AZIMUTH - 0.1) / 0.2, (ELEVATION - 0.05) / 0.05
#: Powers of both coordinates up to degree 4.
POWERS = [(i, n - i) for n in range(5) for i in range(n + 1)]
DESIGN = np.stack([X**i * Y**j for i, j in POWERS], axis=-1)
#: Expected sizes by degree.
SIZES = np.array([(1.0, 0.5, 0.5, 0.2, 0.1)[i + j] for i, j in POWERS])


def test_a_field_is_scaled_to_one_at_its_edges() -> None:
    field = Field.of(AZIMUTH, ELEVATION)
    x, y = field.coordinates(AZIMUTH, ELEVATION)
    assert_allclose(x, X, atol=1e-12)
    assert_allclose(y, Y, atol=1e-12)
    assert_allclose(field.powers(AZIMUTH, ELEVATION), DESIGN, atol=1e-12)
    terms = np.stack([np.ones_like(X), X, Y, X**2, X * Y, Y**2], axis=-1)
    assert_allclose(field.terms(AZIMUTH, ELEVATION), terms, atol=1e-12)
    assert_allclose(quadratic(X, Y), terms)
    # A beam that stands still has one direction.
    fixed = Field.of(np.full((2, 2), 0.3), np.zeros((2, 2)))
    assert_allclose(fixed.coordinates(np.array([0.3]), np.zeros(1)), 0)


def drawn(seed: int, size: float = 1.0) -> np.ndarray:
    """Return real and imaginary terms and that of the range, of their sizes."""
    rng = np.random.default_rng(seed)
    return np.asarray(
        size * rng.standard_normal(31) * np.append(np.tile(SIZES, 2), 0.1)
    )


def water_of(terms: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Return the water signal in front of targets of some phase."""
    flat = DESIGN @ terms[:15] + 1j * (DESIGN @ terms[15:30])
    return np.asarray(flat + 1j * terms[30] * target)


def test_the_water_before_a_target_has_the_errors_of_its_terms() -> None:
    rng = np.random.default_rng(1)
    terms = np.array([[drawn(2, 0.2)], [drawn(3, 0.2)]])
    root = 0.01 * rng.standard_normal((2, 1, 31, 31))
    covariance = root @ root.swapaxes(-1, -2)
    target = np.exp(1j * rng.uniform(-3, 3, (2, 1, ROWS, COLUMNS)))
    water = np.stack([[water_of(terms[k, 0], target[k, 0])] for k in range(2)])
    smooth = SmoothWater(
        field=Field.of(AZIMUTH, ELEVATION),
        terms=terms,
        covariance=covariance,
        misfit=np.ones((2, 1)),
    )
    found, errors = smooth.before(water + 50 * target, AZIMUTH, ELEVATION)
    # The phase of the sample less the water is that of the target, to second order.
    assert_allclose(found, water, atol=1e-4)
    for k, i, j in np.ndindex(2, ROWS, COLUMNS):
        none = np.zeros(15)
        phasor = target[k, 0, i, j]
        columns = np.array(
            [
                [*DESIGN[i, j], *none, -phasor.imag],
                [*none, *DESIGN[i, j], phasor.real],
            ]
        )
        expected = columns @ covariance[k, 0] @ columns.T
        parts = (part[k, 0, i, j] for part in vars(errors).values())
        for value, (a, b) in zip(parts, ((0, 0), (1, 1), (0, 1)), strict=True):
            assert value == pytest.approx(expected[a, b], rel=1e-3, abs=1e-6)


def lines(
    seed: int, terms: np.ndarray, *, noise: float, turn: float, scale: float = 1.0
) -> Offsets:
    """Return lines in all directions through a water signal, with errors."""
    rng = np.random.default_rng(seed)
    phase = rng.uniform(0, 2 * np.pi, X.shape)
    line = np.exp(1j * phase)
    water = water_of(terms, line)
    errors = np.sqrt(scale) * rng.standard_normal((2, *X.shape))
    offset = (water * line.conj()).imag + noise * errors[0]
    # A line that is turned about the water has the other offset from the origin.
    off = turn * errors[1]
    along = (water * line.conj()).real
    return Offsets(
        phase=phase + off,
        offset=offset - off * along,
        terms=np.broadcast_to([noise**2, 0.0, turn**2], (*X.shape, 3)).copy(),
        good=np.ones(X.shape, dtype=bool),
    )


def fitted(part: Offsets, size: float = 1.0) -> SmoothWater:
    return fit_smooth_water(
        [part],
        [size],
        azimuth=AZIMUTH,
        elevation=ELEVATION,
        planes=(1, 1),
        window=1,
    )


def test_exact_lines_give_exact_terms() -> None:
    terms = drawn(4, 0.5)
    found = fitted(lines(5, terms, noise=1e-6, turn=1e-9))
    assert_allclose(found.terms[0, 0], terms, atol=1e-4)
    assert found.misfit[0, 0] == pytest.approx(1.0, abs=0.5)


def test_errors_of_the_terms_are_as_stated() -> None:
    scores, misfits = [], []
    for seed in range(40):
        terms = drawn(100 + seed)
        found = fitted(lines(seed, terms, noise=0.01, turn=0.003))
        off = found.terms[0, 0] - terms
        square = np.linalg.inv(found.covariance[0, 0])
        scores.append(off @ square @ off)
        misfits.append(found.misfit[0, 0])
    # Chi-square of 31: 40 means have a standard error of 1.2.
    assert 25 < np.mean(scores) < 37
    # The median of 108 squares, less 31 terms: below 1 on average, and never there.
    assert np.min(misfits) >= 1
    assert np.mean(misfits) < 1.15


def test_a_scatter_beyond_the_stated_errors_is_a_misfit() -> None:
    found = [fitted(lines(k, drawn(k), noise=0.01, turn=0.0, scale=9.0))
             for k in range(20)]  # fmt: skip
    # 77 of 108 degrees of freedom are left, fewer as outliers lose their weight.
    misfit = np.mean([part.misfit[0, 0] for part in found])
    assert 4.2 < misfit < 9 * 77 / 108
    plain = [fitted(lines(k, drawn(k), noise=0.01, turn=0.0)) for k in range(20)]
    ratio = [np.trace(a.covariance[0, 0]) / np.trace(b.covariance[0, 0])
             for a, b in zip(found, plain, strict=True)]  # fmt: skip
    assert 4 < np.mean(ratio) < 9


def test_lines_across_an_edge_lose_their_weight() -> None:
    terms = drawn(6)
    part = lines(7, terms, noise=0.01, turn=0.001)
    part.offset[::3, ::4] += 1.0
    found = fitted(part)
    off = found.terms[0, 0] - terms
    score = off @ np.linalg.inv(found.covariance[0, 0]) @ off
    assert score < 3 * 31
    # Left out altogether they do the same.
    part.good[::3, ::4] = False
    assert_allclose(found.terms, fitted(part).terms, atol=0.02)


def test_without_lines_the_water_is_as_unsure_as_expected() -> None:
    part = lines(8, drawn(8), noise=0.01, turn=0.001)
    part.good[:] = False
    found = fitted(part, size=3.0)
    assert_allclose(found.terms, 0)
    expected = 3 * np.append(np.tile(SIZES, 2), 0.1)
    assert_allclose(found.covariance[0, 0], np.diag(expected**2))
    assert found.misfit[0, 0] == 1.0


def test_lines_of_one_direction_tell_nothing_along_themselves() -> None:
    terms = drawn(9)
    part = lines(9, terms, noise=0.01, turn=0.001)
    part.phase[:] = 0.0
    part.offset[:] = water_of(terms, np.ones_like(X)).imag
    found = fitted(part)
    # Imaginary terms are known, real ones as well as expected.
    errors = np.sqrt(np.diag(found.covariance[0, 0]))
    assert_allclose(errors[:15], SIZES, rtol=1e-6)
    assert (errors[16:30] < 0.1 * SIZES[1:]).all()
    assert_allclose(found.terms[0, 0, :15], 0, atol=1e-12)
    # The constant is hardly told from the light at the target.
    total = found.terms[0, 0, 15] + found.terms[0, 0, 30]
    assert total == pytest.approx(terms[15] + terms[30], abs=0.02)
