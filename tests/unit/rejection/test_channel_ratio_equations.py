"""Equations of the channel difference against dense algebra and numeric derivatives."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

from amulor.errors import CubeError
from amulor.rejection import channel_ratios
from amulor.rejection.channel_ratios import (
    Pair,
    Prior,
    RatioFit,
    TargetRatio,
    fitted,
    of_open_water,
    pair_of_samples,
    target_ratio_of_neighbors,
)
from amulor.rejection.covariance import Covariance
from amulor.rejection.observation import Observation
from amulor.rejection.polarization_difference import (
    _check_contrast,
    _misfits,
    _patches,
    _path,
    _shared,
)

FREQUENCY = np.array([20e6, 50e6, 80e6])
WAVE = 2 * np.pi * FREQUENCY * 1.38 / 299792458.0


def _noisy(rng: np.random.Generator, shape: tuple[int, ...], size: float) -> Any:
    return size * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))


def test_a_single_echo_is_the_best_of_all_paths() -> None:
    rng = np.random.default_rng(1)
    paths = np.array([1.3, 2.9, 4.4, 3.1])
    gain: Any = np.array([0.3, 0.2 + 0.1j, 0.25 - 0.05j])
    variance = rng.uniform(1e-4, 4e-4, (4, 3))
    difference: Any = 2 * gain * np.exp(1j * np.outer(paths, WAVE))
    difference += _noisy(rng, (4, 3), 0.01)
    # Noise of the wrong sign everywhere has no echo at all.
    found = fitted(difference, variance, WAVE, (1.0, 5.0), gain)
    for k, values in enumerate(difference):

        def chi_square(path: float, values: np.ndarray = values, k: int = k) -> float:
            turn = np.exp(1j * path * WAVE) * gain
            weight = 1 / variance[k]
            best = np.sum(weight * values * turn.conj()).real / np.sum(
                weight * np.abs(turn) ** 2
            )
            return float(np.sum(weight * np.abs(values - max(best, 0) * turn) ** 2))

        least = minimize_scalar(
            chi_square, (paths[k] - 0.1, paths[k], paths[k] + 0.1), tol=1e-12
        )
        assert found.misfit[k] == pytest.approx(least.fun, rel=1e-6)
        turn = np.exp(1j * least.x * WAVE) * gain
        assert_allclose(found.turn[k], turn, atol=1e-5)
        assert_allclose(found.model[k], found.amplitude[k] * turn, atol=1e-4)
        assert found.amplitude[k] == pytest.approx(2, abs=0.2)
    # A difference against all echoes of an interval has none.
    none = fitted(0 * difference[:1] - 1, variance[:1], WAVE, (0.0, 0.2), gain**0)
    assert none.amplitude[0] == 0
    assert none.misfit[0] == pytest.approx(np.sum(1 / variance[0]))


def test_normal_equations_leave_amplitude_and_path_out() -> None:
    rng = np.random.default_rng(2)
    count, size = 5, 3
    variance = rng.uniform(0.5, 2, (count, size))
    effects = [_noisy(rng, (count, size), 1.0) for _ in range(4)]
    shared = _noisy(rng, (count, size, 2), 1.0)
    rest = _noisy(rng, (count, size), 1.0)
    turn = _noisy(rng, (count, size), 1.0)
    patch = np.array([0, 2, 2, 0, 3])
    echo: Any = SimpleNamespace(turn=turn)
    normal, slopes = channel_ratios._normal(
        (*effects, shared), echo, rest, variance, WAVE, patch
    )

    def real(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values.real, values.imag])

    expected, sides = np.zeros((14, 14)), np.zeros((4, 14))
    for p in range(count):
        root = 1 / np.sqrt(variance[p])
        columns = [
            real(root * np.where(np.arange(size) == f, effect[p], 0))
            for effect in effects
            for f in range(size)
        ]
        columns += [real(root * shared[p, :, k]) for k in range(2)]
        jacobian = np.stack(columns, axis=1)
        own = np.stack([real(root * turn[p]), real(root * 1j * WAVE * turn[p])], axis=1)
        away = np.eye(2 * size) - own @ np.linalg.pinv(own)
        expected += jacobian.T @ away @ jacobian
        sides[patch[p]] += jacobian.T @ away @ real(root * rest[p])
    assert_allclose(normal, expected, atol=1e-9)
    assert_allclose(slopes, sides, atol=1e-9)


def test_differences_have_the_errors_of_both_channels() -> None:
    rng = np.random.default_rng(3)
    co, cross = _noisy(rng, (2, 4, 3), 1.0)
    of_co, of_cross = rng.uniform(1, 2, (2, 4, 3))
    pair = Pair(co, cross, of_co, of_cross)
    ratio = np.full(3, 0.3 - 0.4j)
    difference, variance = pair.difference(ratio, np.array([1.0, 2.0, 3.0]))
    assert_allclose(difference, cross - (0.3 - 0.4j) * co)
    assert_allclose(variance, of_cross + 0.25 * (of_co + np.array([1.0, 4.0, 9.0])))
    part = pair.part(np.array([2, 0]))
    assert_allclose(part.of_cross, of_cross[[2, 0]])
    assert_allclose(part.co, co[[2, 0]])


def test_the_ratio_of_a_target_turns_in_proportion_to_frequency() -> None:
    ratio = TargetRatio(real=0.3, imaginary=0.04, uncertainty=(0.1, 0.2), tested=True)
    assert_allclose(ratio.at(FREQUENCY), [0.3 + 0.01j, 0.3 + 0.025j, 0.3 + 0.04j])


def test_the_prior_of_the_ratio_is_looser_where_the_water_is_weak() -> None:
    prior = Prior(water=None, uncertainty=0.02, spread=0.05, gain=0.01, fluctuation=0)
    target = TargetRatio(real=0.3, uncertainty=(0.03, 0.04), tested=False)
    water = np.array([0.1, 0.1j, 0.2])
    # A fifth, and less than a tenth of the strongest signal.
    haze = np.array([5.0, 1.0, 0.01])
    found = prior.covariance(water, haze, FREQUENCY, target)
    own = np.diag([0.05 * 0.1, 0.05 * 0.1 * 5, 0.05 * 0.2 * 10]) ** 2
    late = 2 * np.pi * FREQUENCY * 0.5e-9 * np.abs(water)
    expected = np.zeros((14, 14))
    expected[:3, :3] = own + 0.02**2
    expected[3:6, 3:6] = own + np.outer(late, late)
    expected[6:12, 6:12] = 0.01**2 * np.eye(6)
    expected[12, 12], expected[13, 13] = 0.03**2, 0.04**2
    assert_allclose(found, expected, atol=1e-11)


def observation(signal: np.ndarray, error: np.ndarray | float) -> Observation:
    """Return samples of one channel, with more error in phase than in quadrature."""
    part = ("modulation_frequency", "polarization", "row", "column")[: signal.ndim]
    if signal.ndim == 3:
        part = (*part[:2], "shot")
    size = np.broadcast_to(error, signal.shape)
    return Observation(
        cube=xr.Dataset(
            {
                "in_phase": (part, signal.real),
                "quadrature": (part, signal.imag),
                "in_phase_uncertainty": (part, 1.2 * size),
                "quadrature_uncertainty": (part, 0.8 * size),
                "in_phase_quadrature_covariance": (part, 0 * size),
            },
            {"modulation_frequency": FREQUENCY},
        )
    )


def test_pairs_are_samples_with_the_mean_variance_of_both_outputs() -> None:
    rng = np.random.default_rng(4)
    signal = _noisy(rng, (2, 3, 1, 4, 5), 1.0)
    error = rng.uniform(1, 2, (3, 1, 4, 5))
    pair = pair_of_samples(
        observation(signal[0], error), observation(signal[1], 2 * error)
    )
    assert_allclose(pair.co[7], signal[0, :, 0, 1, 2])
    assert_allclose(pair.cross[7], signal[1, :, 0, 1, 2])
    assert_allclose(pair.of_co[7], (1.44 + 0.64) / 2 * error[:, 0, 1, 2] ** 2)
    assert_allclose(pair.of_cross, 4 * pair.of_co)


def _neighbors(
    seed: int,
    *,
    ratio: complex = 0.3,
    noise: float = 1e-3,
    columns: int = 40,
    second: float | None = None,
) -> tuple[Observation, Observation]:
    """Return both channels of a spotted plate before even water."""
    rng = np.random.default_rng(seed)
    spots = 1 - 0.6 * rng.integers(0, 2, (12, columns))
    phase = 4 * np.pi * FREQUENCY * 1.38 * 1.5 / 299792458.0
    echo = spots * np.exp(1j * phase)[:, None, None]
    ramp = (FREQUENCY / FREQUENCY[-1])[:, None, None]
    ratios = ratio.real + 1j * ratio.imag * ramp
    ratios = ratios * np.ones(echo.shape)
    if second is not None:
        ratios[..., columns // 2 :] = second
    water = 0.5 / (1 - 1j * FREQUENCY / 30e6)[:, None, None]
    co = (echo + water)[:, None]
    cross = (ratios * echo + 0.1 * water)[:, None]
    size = noise * np.sqrt((1.44 + 0.64) / 2)
    return (
        observation(co + _noisy(rng, co.shape, size), noise),
        observation(cross + _noisy(rng, co.shape, size), noise),
    )


def test_neighbors_give_the_ratio_of_the_target_within_their_errors() -> None:
    scores, stated, ratios = [], [], []
    for seed in range(25):
        found = target_ratio_of_neighbors(*_neighbors(seed, ratio=0.3 + 0.05j))
        assert found is not None
        assert found.tested
        scores.append(
            [
                (found.real - 0.3) / found.uncertainty[0],
                (found.imaginary - 0.05) / found.uncertainty[1],
            ]
        )
        stated.append(found.uncertainty)
        ratios.append([found.real, found.imaginary])
    # Scatter of eight groups: Student's variance of 7 / 5, for 25 squares.
    square = np.mean(np.square(scores), axis=0)
    assert_allclose(square, 1.4, atol=0.9)
    assert_allclose(np.mean(stated, axis=0), np.std(ratios, axis=0), rtol=0.4)


def test_neighbors_of_two_paints_widen_the_uncertainty() -> None:
    one, two = (
        target_ratio_of_neighbors(*_neighbors(3, second=second))
        for second in (None, 0.34)
    )
    assert one is not None
    assert two is not None
    assert two.real == pytest.approx(0.32, abs=0.003)
    # Half of the difference, on both sides of the mean, and the scatter of groups.
    assert 0.02 < two.uncertainty[0] < 0.03
    assert one.uncertainty[0] < 4e-4


def test_neighbors_without_variation_or_number_give_no_ratio() -> None:
    first, second = _neighbors(4)
    assert target_ratio_of_neighbors(first, second) is not None
    narrow = [
        Observation(cube=part.cube.isel(column=[0, 1])) for part in (first, second)
    ]
    assert target_ratio_of_neighbors(*narrow) is None
    # Three columns in twelve rows have twelve differences, for eight groups.
    three = [
        Observation(cube=part.cube.isel(column=[0, 1, 2])) for part in (first, second)
    ]
    assert target_ratio_of_neighbors(*three) is not None
    few = [Observation(cube=part.cube.isel(row=slice(0, 7))) for part in three]
    assert target_ratio_of_neighbors(*few) is None
    assert target_ratio_of_neighbors(*_neighbors(4, noise=0.3)) is None
    # A fluctuation of the water counts as noise: differences of 6 of its squares.
    steady = target_ratio_of_neighbors(first, second, fluctuation=0.02)
    assert steady is not None
    assert target_ratio_of_neighbors(first, second, fluctuation=2.0) is None
    empty = np.zeros((12, 40), dtype=bool)
    empty[:, ::3] = True
    assert target_ratio_of_neighbors(first, second, empty=empty) is None


def test_differences_across_the_echo_do_not_count() -> None:
    first, second = _neighbors(5)
    phase = 4 * np.pi * FREQUENCY * 1.38 * 1.5 / 299792458.0
    across = 0.5j * np.random.default_rng(5).integers(0, 2, (12, 40))
    across[:, :20] = 0.0
    bent = []
    for part, share in ((first, 1.0), (second, 0.9)):
        # As of another distance: a quarter of a turn off the echo, of another ratio.
        light = share * across * np.exp(1j * phase)[:, None, None, None]
        bent.append(observation(part.signal + light, 1e-3))
    found = target_ratio_of_neighbors(*bent)
    assert found is not None
    assert found.real == pytest.approx(0.3, abs=3e-3)


def test_open_water_gives_its_ratio_and_fluctuation() -> None:
    rng = np.random.default_rng(6)
    level = np.array([1.0, 0.5j, 0.2])[:, None, None]
    factor = 1 + 0.05 * rng.standard_normal((1, 1, 4000))
    noise = 0.01
    sized = noise * np.sqrt(1.04)
    shots = level * factor + _noisy(rng, (3, 1, 4000), sized)
    crossed = 0.1 * level * (1 + 0.05 * rng.standard_normal((1, 1, 4000)))
    crossed = crossed + _noisy(rng, (3, 1, 4000), sized)
    shots[0, 0, 5], crossed[1, 0, 7] = np.nan, np.nan
    ratio, fluctuation = of_open_water(
        observation(shots, noise), observation(crossed, noise)
    )
    assert ratio == pytest.approx(0.1, abs=5e-4)
    assert fluctuation == pytest.approx(0.05, rel=0.06)
    # Less scatter than is stated is no fluctuation.
    calm = level * np.ones((1, 1, 50)) + 0j
    ratio, none = of_open_water(
        observation(calm, noise), observation(0.2j * calm, noise)
    )
    assert ratio == pytest.approx(0.0)
    assert none == 0.0


def _fit(rng: np.random.Generator, covariance: np.ndarray) -> RatioFit:
    return RatioFit(
        water=np.array([0.1 + 0.01j, 0.12 + 0.02j, 0.11 + 0.03j]),
        covariance=covariance,
        gain=np.ones(3, dtype=complex),
        unsteady=np.zeros(3),
        fluctuation=0.0,
        scale=1.5,
        target=TargetRatio(
            real=0.4, imaginary=0.02, uncertainty=(0.01, 0.02), tested=True
        ),
    )


def test_errors_by_the_ratios_are_those_of_numeric_derivatives() -> None:
    rng = np.random.default_rng(7)
    root = 0.003 * rng.standard_normal((8, 8))
    covariance = root @ root.T
    covariance[6:, :] = covariance[:, 6:] = 0.0
    covariance[6, 6], covariance[7, 7] = 0.01**2, 0.02**2
    fit = _fit(rng, covariance)
    shape = 3, 1, 2, 2
    co, cross = _noisy(rng, (2, *shape), 1.0)

    def target(parameters: np.ndarray) -> Any:
        water = (parameters[:3] + 1j * parameters[3:6]).reshape(3, 1, 1, 1)
        ramp = (WAVE / WAVE.max()).reshape(3, 1, 1, 1)
        of = parameters[6] + 1j * ramp * parameters[7]
        return (cross - water * co) / (of - water)

    start = np.concatenate([fit.water.real, fit.water.imag, [0.4, 0.02]])
    best = target(start)
    step = 1e-6
    slopes = np.array(
        [
            (target(start + step * unit) - target(start - step * unit)) / (2 * step)
            for unit in np.eye(8)
        ]
    )
    independent = Covariance(*(np.full(shape, v) for v in (1e-3, 2e-3, 0.0)))
    shared = _shared(fit, co - best, best, independent, WAVE)
    # Each sample alone has the covariance by derivatives, times a factor of the pixel.
    parts = []
    for chosen in (range(6), (6, 7)):
        pick = np.array(chosen)
        block = covariance[np.ix_(pick, pick)]
        outputs = np.stack([slopes[pick].real, slopes[pick].imag])
        parts.append(np.einsum("ai...,ij,bj...->ab...", outputs, block, outputs))
    factor = shared.water.in_phase / parts[0][0, 0]
    assert_allclose(factor, np.broadcast_to(factor[:1], shape), rtol=1e-6)
    for found, expected in ((shared.water, parts[0]), (shared.target, parts[1])):
        assert_allclose(found.in_phase, factor * expected[0, 0], rtol=1e-6)
        assert_allclose(found.quadrature, factor * expected[1, 1], rtol=1e-6)
        assert_allclose(found.cross, factor * expected[0, 1], rtol=1e-5, atol=1e-12)
    # The factor is the one that gives the path of the pixel its true variance.
    total = independent.in_phase + independent.quadrature
    total = total + sum(part[0, 0] + part[1, 1] for part in parts)
    wave = WAVE.reshape(3, 1, 1, 1)
    weight = wave * np.abs(best) ** 2 / total
    turned = weight * (slopes / best).imag
    path = turned.sum(axis=1)[:, 0]
    joint = np.einsum("i...,ij,j...->...", path, covariance, path)
    alone = np.zeros(joint.shape)
    for f in range(3):
        of_sample = np.zeros((8, 8))
        block = np.ix_([f, 3 + f], [f, 3 + f])
        of_sample[block] = covariance[block]
        of_sample[6, 6], of_sample[7, 7] = covariance[6, 6], covariance[7, 7]
        own = turned[:, f, 0]
        alone += np.einsum("i...,ij,j...->...", own, of_sample, own)
    assert_allclose(factor[0, 0], joint / alone, rtol=1e-5)


def test_pixels_whose_difference_is_no_echo_are_found_by_chi_square() -> None:
    rng = np.random.default_rng(8)
    fit = _fit(rng, np.eye(8))
    count = 4000
    paths = rng.uniform(2.2, 3.8, count)
    ratio = fit.target.at(WAVE)
    echo = np.exp(1j * np.outer(paths, WAVE))
    variance = np.full((count, 3), 1e-4)
    # Errors of the cross-polarized channel, larger by the scale of the fit.
    cross = ratio * echo + _noisy(rng, (count, 3), 0.01 * np.sqrt(1.5))
    pair = Pair(echo, cross, 0 * variance, variance)
    usable = np.ones(count, dtype=bool)
    usable[:10] = False
    found = _misfits(pair, fit, WAVE, (1.0, 5.0), usable)
    assert not found[:10].any()
    # Six outputs less amplitude and path.
    difference = cross - fit.water * echo
    contrast = ratio - fit.water
    rest = fitted(difference, variance, WAVE, (1.0, 5.0), contrast).misfit
    np.testing.assert_array_equal(found[10:], rest[10:] > 1.5 * chi2.isf(1e-3, 4))
    assert 0 < found.sum() < 20


@pytest.mark.parametrize(
    ("contrast", "error", "refused"),
    [
        (1.01e-3, 1e-6, False),
        (0.99e-3, 1e-6, True),
        # Twice the uncertainty.
        (1.01e-2, 3e-3, False),
        (0.99e-2, 3e-3, True),
    ],
)
def test_ratios_that_differ_by_less_than_a_limit_are_refused(
    contrast: float, error: float, refused: bool
) -> None:
    # The least contrast of all frequencies counts.
    water = np.array([0.1, 0.2, 0.3]) + 0j
    if not refused:
        _check_contrast(0.1 - contrast, water, 5 / 3 * error)
        return
    numbers = f"differ by {contrast:.2g} with an uncertainty of {5 / 3 * error:.2g}"
    with pytest.raises(CubeError, match=f"and water, 0.1, {numbers}"):
        _check_contrast(0.1 - contrast, water, 5 / 3 * error)


def test_patches_cover_a_scan_four_by_four() -> None:
    # 8 rows and 12 columns: patches of 2 x 3 pixels.
    number = _patches(np.arange(96), (8, 12)).reshape(8, 12)
    expected = 4 * (np.arange(8) // 2)[:, None] + np.arange(12) // 3
    np.testing.assert_array_equal(number, expected)


def test_paths_are_those_of_the_interval_or_of_the_frequencies() -> None:
    geometry = xr.DataArray(
        0,
        attrs={
            "receiver_position": [0.3, 0.0, 0.1],
            "emitter_position": [0.0, 0.4, 0.1],
        },
    )
    scan: Any = SimpleNamespace(cube={"geometry": geometry})
    # The receiver is 0.5 m beside the emitter.
    assert _path(scan, WAVE, (1.0, 3.0)) == pytest.approx((2.0, 6.5))
    # From 0 to 20 MHz is the smallest of the steps.
    assert _path(scan, WAVE, None) == pytest.approx((0.0, 299792458.0 / 1.38 / 20e6))
    again = np.concatenate([WAVE, WAVE])
    assert _path(scan, again, None) == pytest.approx((0.0, 299792458.0 / 1.38 / 20e6))
