"""Equations of phasor lines against dense algebra, window by window."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.special import digamma, polygamma
from scipy.stats import chi2

from amulor.rejection.covariance import Covariance
from amulor.rejection.observation import Observation
from amulor.rejection.phasor_lines import (
    _brightness_steps,
    _coherence,
    _contrast,
    _directions,
    _Lines,
    _noise_scale,
    _normal,
    _residuals,
    _surface,
)

WINDOW = 5
LINE = np.linspace(-1, 1, WINDOW)
Y, X = (part.ravel() for part in np.meshgrid(LINE, LINE, indexing="ij"))
SURFACE = np.stack([np.ones(25), X, Y, X**2, X * Y, Y**2], axis=1)


def windows(seed: int, count: int = 6) -> tuple[np.ndarray, Covariance, np.ndarray]:
    """Return samples of windows with errors that differ and are correlated."""
    rng = np.random.default_rng(seed)
    shape = count, 25
    phase = 0.4 + 0.1 * X - 0.05 * Y * X
    bright = rng.uniform(0.2, 1.0, shape)
    signal = bright * np.exp(1j * phase) + 0.3 - 0.2j * X
    variance = rng.uniform(1e-4, 4e-4, (2, *shape))
    cross = 0.5 * np.sqrt(variance.prod(axis=0))
    errors = Covariance(variance[0], variance[1], cross)
    noise = np.sqrt(variance) * rng.standard_normal((2, *shape))
    usable = rng.random(shape) > 0.1
    return signal + noise[0] + 1j * noise[1], errors, usable


def turned(errors: Covariance, factor: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the three elements of the covariance after a turn, as matrices say."""
    a, b = factor.real, factor.imag
    turn = np.array([[a, -b], [b, a]])
    square = np.array(
        [[errors.in_phase, errors.cross], [errors.cross, errors.quadrature]]
    )
    result = np.einsum("ik...,kl...,jl...->ij...", turn, square, turn)
    return result[0, 0], result[1, 1], result[0, 1]


def test_terms_of_a_window_are_a_quadratic_surface() -> None:
    assert_allclose(_surface(WINDOW), SURFACE, atol=1e-15)


def test_a_step_is_that_of_least_squares_with_errors_in_both_outputs() -> None:
    signal, errors, usable = windows(1)
    phase = np.tile([0.37, 0.08, 0.01, 0.0, -0.02, 0.01], (len(signal), 1))
    found = _normal(signal, errors, usable, phase, SURFACE)
    factor = np.exp(-1j * (phase @ SURFACE.T))
    in_phase, quadrature, cross = turned(errors, factor)
    for k, values in enumerate(signal * factor):
        inverse = np.diag(usable[k] / quadrature[k])
        solve = np.linalg.inv(SURFACE.T @ inverse @ SURFACE) @ SURFACE.T @ inverse
        away = np.eye(25) - SURFACE @ solve
        mean = np.sum(np.diag(inverse) * values.real) / np.trace(inverse)
        columns = away @ ((values.real - mean)[:, None] * SURFACE)
        rest = away @ values.imag
        share = np.diag(inverse) * np.diag(away)
        of_noise = (SURFACE * (share * in_phase[k])[:, None]).T @ SURFACE
        information = columns.T @ inverse @ columns
        slope = columns.T @ inverse @ rest - SURFACE.T @ (share * cross[k])
        free = np.linalg.inv(information - of_noise)
        covariance = free @ information @ free
        assert_allclose(found.change[k], free @ slope, rtol=1e-6, atol=1e-12)
        assert_allclose(found.covariance[k], covariance, rtol=1e-6, atol=1e-12)
        assert found.misfit[k] == pytest.approx(rest @ inverse @ rest)
        assert found.offset[k] == pytest.approx(solve[0] @ values.imag)
        # The offset turns with the phase, by the signal less the water along the line.
        lever = (solve[0] * values.real) @ SURFACE
        terms = [
            solve[0] ** 2 @ quadrature[k] + lever @ covariance @ lever,
            -2 * (covariance @ lever)[0],
            covariance[0, 0],
        ]
        assert_allclose(found.offset_terms[k], terms, rtol=1e-6)


def test_a_window_of_one_reflectance_has_no_phase() -> None:
    signal, _, usable = windows(2)
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((2, *signal.shape)) * 1e-3
    for contrast, has_phase in ((0.01, False), (0.2, True)):
        reflectance = 1 + contrast * rng.choice([-1, 1], signal.shape)
        flat = reflectance + noise[0] + 1j * noise[1]
        small = Covariance(*(np.full(signal.shape, v) for v in (1e-6, 1e-6, 0.0)))
        found = _normal(flat, small, usable, np.zeros((6, 6)), SURFACE)
        # The reflectance must vary by 5 % of the signal beyond its smooth part.
        assert (np.isfinite(found.covariance[:, 0, 0]) == has_phase).all()
        assert (np.any(found.change != 0, axis=1) == has_phase).all()


@pytest.mark.parametrize("scale", [1e-3, 1e4, 1e8])
def test_a_phase_is_known_however_uncertain_the_samples_across_the_line(
    scale: float,
) -> None:
    signal, _, usable = windows(2)
    reflectance = 1 + 0.2 * np.random.default_rng(0).choice([-1, 1], signal.shape)
    found = []
    for factor in (1.0, scale):
        errors = (np.full(signal.shape, v) for v in (1e-6, 1e-6 * factor, 0.0))
        line = _normal(
            reflectance * np.exp(0.01j),
            Covariance(*errors),
            usable,
            np.zeros((6, 6)),
            SURFACE,
        )
        found.append((line.change, line.covariance / factor))
    assert_allclose(found[1][0], found[0][0], rtol=1e-6, atol=1e-12)
    assert_allclose(found[1][1], found[0][1], rtol=1e-6, atol=1e-15)


def test_contrasts_and_residuals_are_orthogonal_to_what_is_smooth() -> None:
    signal, errors, usable = windows(3)
    contrast = _contrast(signal, errors, usable, SURFACE)
    weight = usable / np.sqrt(errors.in_phase + errors.quadrature)
    phase = np.tile([0.4, 0.1, 0.0, 0.0, -0.05, 0.0], (len(signal), 1))
    factor = np.exp(-1j * (phase @ SURFACE.T))
    rest = _residuals(signal, errors, usable, phase, WINDOW)
    root = np.sqrt(usable / turned(errors, factor)[1])
    for k in range(len(signal)):
        design = weight[k][:, None] * SURFACE
        right = weight[k] * signal[k]
        smooth = design @ np.linalg.lstsq(design, right, rcond=None)[0]
        assert_allclose(contrast[k], right - smooth, atol=1e-9)
        values = signal[k] * factor[k]
        mean = np.average(values.real, weights=root[k] ** 2)
        design = root[k][:, None] * np.concatenate(
            [SURFACE, (values.real - mean)[:, None] * SURFACE], axis=1
        )
        right = root[k] * values.imag
        smooth = design @ np.linalg.lstsq(design, right, rcond=None)[0]
        assert_allclose(rest[k], right - smooth, atol=1e-8)


def test_coherence_is_the_sum_of_the_correlations_of_all_pairs() -> None:
    rng = np.random.default_rng(4)
    rest = rng.standard_normal((4, 7, 25))
    rest[0, 0], rest[:2, 1], rest[1:, 2], rest[:, 3] = 0.0, 0.0, 0.0, 0.0
    freedom = np.array([13.0, 13.0, 13.0, 13.0, 0.0, 6.0, 9.0])
    found = _coherence(rest, freedom)
    for k, free in enumerate(freedom):
        pairs = list(itertools.combinations(rest[:, k], 2))
        total = sum(a @ b for a, b in pairs)
        # Of independent residuals the products have this variance.
        variance = sum((a @ a) * (b @ b) for a, b in pairs) / max(free, 1)
        few = np.count_nonzero(np.any(rest[:, k] != 0, axis=1)) < 3
        expected = np.inf if few else total / np.sqrt(variance)
        assert found[k] == pytest.approx(expected)
    # One frequency of one channel has no pairs, and no test.
    assert _coherence(rest[:1, 4:5], freedom[4:5]) == [0.0]
    assert _coherence(rest[:2, 4:5], freedom[4:5])[0] < np.inf


def _lines(rng: np.random.Generator, shape: tuple[int, ...]) -> _Lines:
    """Return lines of windows with any numbers."""
    root = 0.02 * rng.standard_normal((*shape, 6, 6))
    return _Lines(
        phase=rng.standard_normal((*shape, 6)),
        covariance=root @ root.swapaxes(-1, -2),
        misfit=rng.uniform(5, 16, shape),
        freedom=np.full(shape, 13.0),
        edge=rng.uniform(0, 0.6, shape),
        offset=rng.standard_normal(shape),
        offset_terms=rng.uniform(0, 1, (*shape, 3)),
        coherence=np.broadcast_to(rng.uniform(-1, 2.4, shape[2:]), shape).copy(),
    )


def test_a_pixel_takes_the_phase_of_the_window_that_knows_it_best() -> None:
    rng = np.random.default_rng(5)
    frequency = np.array([20e6, 60e6])
    fit = _lines(rng, (2, 2, 4, 3))
    # Windows that contradict a line, are rare by chance, or lack a line.
    fit.misfit[:, :, 0, 0] = 80.0
    fit.misfit[:, :, 1, 1] = float(chi2.isf(0.01, 52)) / 4
    fit.coherence[:, :, 2, 2] = 2.6
    fit.covariance[1, 0, 3, 1] = np.inf
    fit.covariance[:, :, 3, 0] = np.inf
    found = _directions(fit, frequency, WINDOW)
    known = np.isfinite(fit.covariance[..., 0, 0])
    for row, column in np.ndindex(8, 7):
        best = (-np.inf, False)
        for i, j in np.ndindex(4, 3):
            y, x = row - i, column - j
            if not (0 <= y < 5 and 0 <= x < 5):
                continue
            place = SURFACE[5 * y + x]
            here = known[:, :, i, j]
            square = np.sum(fit.misfit[:, :, i, j][here])
            free = 13.0 * here.sum()
            chance = chi2.sf(square, max(free, 1.0))
            agrees = chance > 1e-3 and fit.coherence[0, 0, i, j] < 2.5
            with np.errstate(invalid="ignore"):
                error = place @ fit.covariance[:, :, i, j] @ place
            error = np.where(here, error, np.inf)
            # Scatter of a chance below 5 % enlarges the errors.
            error = error * (square / max(free, 1.0) if chance < 0.05 else 1.0)
            weight = frequency[:, None] ** 2 * (1 - fit.edge[:, :, i, j]) ** 4
            score = np.sum(weight / error), agrees
            # One that contradicts a line is used where there is no other.
            if (score[1], score[0]) > (best[1], best[0]):
                best = score
                phase, variance = fit.phase[:, :, i, j] @ place, error
        if best[0] <= 0:
            assert np.isinf(found.variance[:, :, row, column]).all()
            continue
        assert_allclose(found.variance[:, :, row, column], variance, rtol=1e-9)
        assert_allclose(found.phase[:, :, row, column], phase, rtol=1e-9)
        assert found.doubtful[row, column] == (not best[1])


def test_the_noise_is_that_of_the_misfits_of_the_windows() -> None:
    rng = np.random.default_rng(6)
    shape = 2, 1, 30, 32
    azimuth, elevation = np.meshgrid(np.linspace(0, 0.3, 32), np.linspace(-1, 0, 30))
    # A factor that grows with the azimuth, over misfits of chi-square.
    factor = np.exp(0.8 + 0.5 * (azimuth - 0.15) / 0.15)
    fit = _lines(rng, shape)
    fit.misfit[:] = rng.chisquare(13, shape) * factor
    fit.misfit[0, 0, :5, :5] *= 100
    fit.misfit[1, 0, 9, 9] = 0.0
    fit.coherence[:, :, 7, :] = 3.0
    fit.misfit[:, :, 7, :] *= 100
    found = _noise_scale(fit, azimuth, elevation, WINDOW)
    # 960 misfits of a logarithm of deviation 0.41, for six terms.
    deviation = np.sqrt(polygamma(1, 6.5))
    error = 5 * deviation * np.sqrt(6 / 960)
    assert_allclose(np.log(found.at(azimuth, elevation)), np.log(factor)[None, None]
                    * np.ones((2, 1, 1, 1)), atol=2 * error)  # fmt: skip
    # The mean of a logarithm of chi-square lies below that of its mean.
    chosen = np.log(rng.chisquare(13, 10_000) / 2)
    assert np.mean(chosen) == pytest.approx(digamma(6.5), abs=0.02)
    # Errors are never made smaller.
    assert (found.at(azimuth - 3, elevation) >= 1).all()


@pytest.mark.parametrize(("columns", "terms"), [(24, 1), (25, 3), (74, 3), (75, 6)])
def test_terms_of_the_noise_follow_the_number_of_independent_windows(
    columns: int, terms: int
) -> None:
    # In four rows; 4 and 12 times the 25 pixels of a window.
    rng = np.random.default_rng(7)
    shape = 1, 1, 4, columns
    azimuth, elevation = np.meshgrid(np.arange(columns) / 9, np.arange(4) / 9)
    fit = _lines(rng, shape)
    fit.coherence[:] = 0.0
    fit.misfit[:] = rng.uniform(10, 16, shape)
    found = _noise_scale(fit, azimuth, elevation, WINDOW).terms[0, 0]
    assert np.count_nonzero(found) == terms


def scan_of(signal: np.ndarray) -> Observation:
    part = ("modulation_frequency", "polarization", "row", "column")
    error = np.full(signal.shape, 1e-3)
    return Observation(
        cube=xr.Dataset(
            {
                "in_phase": (part, signal.real),
                "quadrature": (part, signal.imag),
                "in_phase_uncertainty": (part, error),
                "quadrature_uncertainty": (part, error),
                "in_phase_quadrature_covariance": (part, 0 * error),
            }
        )
    )


def test_a_step_of_the_brightness_is_one_of_five_standard_errors() -> None:
    rng = np.random.default_rng(8)
    column = np.arange(12)
    steps = 0.12 * (column > 5)
    signal = 1 + steps + 0.05 * rng.standard_normal((2, 1, 10, 12)) + 0j
    signal[1] = signal[1].swapaxes(1, 2)[:, :10, :10].repeat(2, axis=2)[:, :, :12]
    signal[0, 0, 3, 3] = np.nan
    scan = scan_of(signal)
    bright = np.where(np.isfinite(signal), np.abs(signal), 0.0)
    use = np.isfinite(signal)
    expected = np.zeros(signal.shape, dtype=bool)
    for plane in range(2):
        steep = np.zeros((6, 8), dtype=bool)
        for i, j in np.ndindex(6, 8):
            part = bright[plane, 0, i : i + 5, j : j + 5].ravel()
            good = use[plane, 0, i : i + 5, j : j + 5].ravel()
            for across in (X, Y, X + Y, X - Y):
                one, two = (part[good & (side > 1e-9)] for side in (across, -across))
                # Student's test of two means, with one variance.
                free = len(one) + len(two) - 2
                variance = (one.var() * len(one) + two.var() * len(two)) / free
                variance *= 1 / len(one) + 1 / len(two)
                steep[i, j] |= abs(one.mean() - two.mean()) > 5 * np.sqrt(variance)
        # A pixel is near a step where one of the nine windows next to it has one.
        for i, j in np.ndindex(10, 12):
            rows = np.clip(np.arange(i - 3, i), 0, 5)
            columns = np.clip(np.arange(j - 3, j), 0, 7)
            expected[plane, 0, i, j] = steep[np.ix_(rows, columns)].any()
    found = _brightness_steps(scan, WINDOW)
    assert_array_equal(found, expected)
    assert 0.05 < expected.mean() < 0.95
