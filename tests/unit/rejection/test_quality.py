"""Quality flags on both sides of each threshold."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from amulor.cube import QualityFlag, WaterResidualCause
from amulor.rejection import quality
from amulor.rejection.covariance import Covariance
from amulor.rejection.quality import (
    flags,
    looks_like_water,
)

NOISE = 0.1


def _covariance(in_phase: float, quadrature: float, *shape: int) -> Covariance:
    """Return one covariance without correlation for all samples [V2]."""
    return Covariance(
        np.full(shape, in_phase**2), np.full(shape, quadrature**2), np.zeros(shape)
    )


def _flag(signal: complex, *, noise: tuple[float, float] = (NOISE, NOISE), **others):
    result = flags(
        others.pop("saturated", None), np.array([signal]), _covariance(*noise, 1),
        **others,
    )  # fmt: skip
    return result


@pytest.mark.parametrize(
    ("signal", "flag"), [(4.999, QualityFlag.NO_TARGET), (5.001, QualityFlag(0))]
)
def test_a_target_is_five_standard_errors_large(signal, flag) -> None:
    for turn in (1, 1j, -1, np.exp(2j)):
        result = _flag(signal * NOISE * turn)
        assert result.flag == flag
        assert_allclose(result.tests["signal_significance"], signal)


@pytest.mark.parametrize(
    ("across", "flag"), [(0.299, QualityFlag(0)), (0.301, QualityFlag.NO_TARGET)]
)
def test_the_phase_of_a_target_is_known_to_0_3_rad(across, flag) -> None:
    # An error across the signal is one of the phase, and leaves the strength sure.
    assert _flag(1.0 + 0j, noise=(1e-3, across)).flag == flag


@pytest.mark.parametrize(
    ("water", "flag"), [(0.099, QualityFlag(0)), (0.101, QualityFlag.WATER_RESIDUAL)]
)
def test_residual_water_turns_the_phase_by_at_most_its_error(water, flag) -> None:
    # Across a signal of 1 V: by water / 1 V, for an error of 0.1 rad.
    result = _flag(1.0 + 0j, residual=np.array([1j * water]))
    assert result.flag == flag
    cause = WaterResidualCause.PHASE_SHIFT if flag else 0
    assert result.cause == cause
    ratio = result.tests["residual_phase_ratio"]
    assert_allclose(ratio, water / 0.1 if flag else np.nan, rtol=0.02)


def test_residual_water_is_an_error_of_the_strength() -> None:
    # 0.6 V over the root of 0.1^2 + 0.06^2 is 5.14, and over that with 0.07 V 4.92.
    assert _flag(0.6, residual=np.array([0.06 + 0j])).flag == 0
    assert _flag(0.6, residual=np.array([0.07 + 0j])).flag == QualityFlag.NO_TARGET


def test_flags_add_and_a_missing_sample_has_one_only() -> None:
    saturated = np.array([True])
    both = _flag(1.0 + 0j, saturated=saturated, water_is_in=True).flag
    assert both == QualityFlag.SATURATED | QualityFlag.NO_OPEN_WATER
    missing = _flag(complex(np.nan), saturated=saturated, water_is_in=True)
    assert missing.flag == QualityFlag.MISSING


def _likeness(signal: np.ndarray, water: np.ndarray, **others):
    shape = signal.shape
    return looks_like_water(
        others.get("saturated"), signal, water, _covariance(NOISE, NOISE, *shape)
    )


def test_a_multiple_of_the_water_signal_is_water() -> None:
    # Two frequencies, one channel, one pixel.
    water = np.array([1.0, 1j]).reshape(2, 1, 1)
    power = np.sqrt(2) / NOISE  # standard errors of the water signal itself
    for share, similar in ((4.99 / power, False), (5.01 / power, True)):
        result, tests = _likeness(share * water, water)
        assert result == similar
        assert_allclose(
            tests["water_shape_significance"],
            share * power if similar else np.nan,
            rtol=1e-9,
        )


def test_a_residual_that_chance_makes_in_one_of_1000_is_no_water() -> None:
    water = np.array([1.0, 1j]).reshape(2, 1, 1)
    # Off by d in the direction that no multiple of the water signal has: three degrees
    # of freedom, four components less one factor.
    limit = np.sqrt(chi2(3).isf(1e-3)) * NOISE
    across = np.array([1j, 0]).reshape(2, 1, 1)
    for off, similar in ((0.999 * limit, True), (1.001 * limit, False)):
        result, tests = _likeness(water + off * across, water)
        assert result == similar
        chance = chi2(3).sf((off / NOISE) ** 2) if similar else np.nan
        assert_allclose(tests["water_shape_probability"], chance, rtol=1e-6)


def test_a_lone_or_saturated_sample_has_no_shape() -> None:
    lone = np.ones((1, 1, 1), complex)
    assert not _likeness(lone, lone)[0]
    water = np.array([1.0, 1j]).reshape(2, 1, 1)
    saturated = np.array([False, True]).reshape(2, 1, 1)
    assert _likeness(water, water)[0]
    assert not _likeness(water, water, saturated=saturated)[0]


def test_a_phase_is_uncertain_by_the_noise_over_the_signal_where_there_is_one() -> None:
    signal = np.array([2.0 + 0j, 0.0, 0.0, 0.0 + 4.0j])
    variance = np.full(4, 0.01)
    error = quality.phase_error(
        signal,
        Covariance(variance, variance, np.zeros(4)),
        np.array([True, True, False, True]),
    )
    # 0.1 of 2 and of 4; a signal of zero counts as 1 V, no target as 1 V of 1 V.
    assert_allclose(error, [0.05, 0.1, 1.0, 0.025])
