"""Phases between channels, and gains of their errors, by closed forms and limits."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm

from amulor.cube import WaterResidualCause
from amulor.rejection.covariance import Covariance
from amulor.rejection.quality import (
    ChannelPhase,
    Disagreement,
    channel_phase,
    channels_disagree,
    flags,
    phase_error_gain,
    phase_shift_ratio,
)


def errors(variance: float, shape: tuple[int, ...]) -> Covariance:
    return Covariance(
        np.full(shape, variance), np.full(shape, variance), np.zeros(shape)
    )


@pytest.mark.parametrize(
    ("phase", "probability", "real", "cause"),
    [
        # A phase of 50 mrad, and a chance of one in ten thousand.
        (0.0501, 0.99e-4, True, WaterResidualCause.INSTRUMENT),
        (0.0499, 0.99e-4, True, WaterResidualCause(0)),
        (0.2, 1.01e-4, False, WaterResidualCause(0)),
    ],
)
def test_a_large_and_real_phase_between_channels_has_a_cause(
    phase: float, probability: float, real: bool, cause: WaterResidualCause
) -> None:
    found = ChannelPhase(
        phase=np.array([0.01, phase]),
        significance=np.array([1.0, 5.0]),
        probability=probability,
    )
    assert found.is_real == real
    assert found.cause == cause


def test_the_phase_between_channels_has_the_error_of_a_median() -> None:
    rng = np.random.default_rng(1)
    shape = 2, 3, 200
    turn = np.array([[0.0, 0.01, 0.04], [0.0, 0.0, 0.002]])
    signal = 2 * np.exp(1j * (turn[..., None] + 0.01 * rng.standard_normal(shape)))
    column = np.zeros(shape, dtype=complex)
    # The column turns the first channel of the first frequency by 10 mrad.
    column[0, 0] = signal[0, 0] * (1 - np.exp(-0.01j))
    signal[0, 1, :9] = np.nan
    shown = np.ones(200, dtype=bool)
    shown[100:110] = False
    found = channel_phase(
        signal,
        errors((2 * 0.01) ** 2, shape),
        errors((2 * 0.003) ** 2, shape),
        column=column,
        shown=shown,
    )
    assert found is not None
    phases, scores = np.zeros(2), np.zeros(2)
    for f, (b, a) in itertools.product(range(2), itertools.combinations(range(3), 2)):
        use = shown & np.isfinite(signal[f, [a, b]]).all(axis=0)
        one, two = signal[f, a][use], signal[f, b][use]
        phase = abs(np.median(np.angle(one / two)))
        first, second = (signal - column)[f][[a, b]][:, use]
        by_column = np.angle(one / two * second / first)
        bound = abs(np.median(by_column))
        # Of a median of normal errors, of two channels each.
        error = np.sqrt(2) * np.hypot(0.003, 1.2533 * 0.01 / np.sqrt(use.sum()))
        phases[f] = max(phases[f], phase)
        scores[f] = max(scores[f], max(phase - bound, 0) / error)
    assert_allclose(found.phase, phases, rtol=1e-9)
    assert_allclose(found.significance, scores, rtol=1e-4)
    # Six tests of both sides.
    chance = min(1.0, 12 * norm.sf(scores.max()))
    assert found.probability == pytest.approx(chance, rel=1e-3)


@pytest.mark.parametrize(("known", "tested"), [(49, False), (50, True)])
def test_half_of_the_targets_must_have_a_phase(known: int, tested: bool) -> None:
    shape = 1, 2, 100
    signal = np.ones(shape, dtype=complex)
    signal[0, 1, known:] = 0.0
    found = channel_phase(
        signal, errors(1e-4, shape), errors(0.0, shape),
        column=0 * signal, shown=np.ones(100, dtype=bool),
    )  # fmt: skip
    assert (found is not None) == tested
    # Errors of both kinds together, of a phase up to 0.3 rad.
    whole = np.ones(shape, dtype=complex)
    for size, sure in ((0.999, True), (1.001, False)):
        found = channel_phase(
            whole,
            errors((0.6 * 0.3 * size) ** 2, shape),
            errors((0.8 * 0.3 * size) ** 2, shape),
            column=0 * whole,
            shown=np.ones(100, dtype=bool),
        )
        assert (found is not None) == sure


def test_two_pixels_of_a_scan_are_the_fewest() -> None:
    for count in (1, 2):
        shape = 1, 2, count
        found = channel_phase(
            np.ones(shape, dtype=complex), errors(1e-4, shape), errors(0.0, shape),
            column=np.zeros(shape, dtype=complex), shown=np.ones(count, dtype=bool),
        )  # fmt: skip
        assert (found is not None) == (count == 2)


def test_a_gain_is_the_median_of_the_shares_over_the_signal() -> None:
    target = np.array([[2.0, 1.0, 4.0, 8.0], [100.0, 100.0, 100.0, 100.0]])
    strongest = np.array([[3.0, 3.0, 3j, 3.0], [1.0, 1.0, 1.0, 1.0]])
    shown = np.array([[True, True, True, False]] * 2)
    gain = phase_error_gain(target + 0j, [3.0, 4.0], strongest=strongest, shown=shown)
    # 5 times 3 over the median of three signals; never below that of one channel.
    assert_allclose(gain, [15 / 2, 1.0])
    none = phase_error_gain(
        0 * target + 0j, [1.0], strongest=strongest, shown=~shown & False
    )
    assert_allclose(none, 1.0)


def test_limits_of_disagreement_follow_scatter_and_number() -> None:
    rng = np.random.default_rng(2)
    away = np.stack([3 + 2 * rng.standard_normal((40, 50)),
                     0.1 * rng.standard_normal((40, 50))])  # fmt: skip
    away[0, 0, 0] = np.nan
    found = Disagreement.of(away)
    finite = away[0][np.isfinite(away[0])]
    assert found.usual[0] == pytest.approx(np.median(finite))
    spread = np.median(np.abs(finite - np.median(finite))) / norm.ppf(0.75)
    assert found.scatter[0] == pytest.approx(spread, rel=1e-4)
    # Scatter below the stated errors does not narrow the limit.
    assert found.scatter[1] == 1.0
    assert found.limit == 4.0
    assert found.rare.all()


@pytest.mark.parametrize(("many", "rare"), [(150, True), (151, False)])
def test_what_many_samples_have_in_common_is_no_outlier(many: int, rare: bool) -> None:
    away = np.zeros((1, 1, 1000))
    away[0, 0, :many] = 4.0
    found = Disagreement.of(away)
    # More than chance makes, beyond 2.5 of them a tenth: a lower limit.
    assert 2.5 <= found.limit <= 4.0
    assert found.rare.item() == rare
    assert found.where(away).sum() == (many if rare else 0)


def test_many_deviations_lower_the_limit_to_two_and_a_half_at_least() -> None:
    away = np.zeros((1, 1, 1000))
    away[0, 0, :40] = 3.1
    away[0, 0, 0] = 3.0
    found = Disagreement.of(away)
    # Of 1000 normal deviates 2.7 lie beyond 3: fewer than a tenth of 40.
    assert found.limit == pytest.approx(3.0)
    assert found.where(away)[0, 0, 1:].sum() == 39
    away[0, 0, :40] = 2.4
    assert Disagreement.of(away).limit == 4.0
    away[0, 0, :40] = 0.0
    away[0, 0, :20] = 3.0
    # 2.7 of 20 are more than a tenth.
    assert Disagreement.of(away).limit == 4.0


def test_channels_that_disagree_are_marked_in_pairs() -> None:
    shape = 1, 3, 1, 400
    rng = np.random.default_rng(3)
    parts = rng.standard_normal((2, *shape))
    signal = 1 + 0.01 * (parts[0] + 1j * parts[1])
    signal[0, 2, 0, 7] *= np.exp(0.3j)
    signal[0, 2, 0, 8] *= np.exp(0.3j)
    shown = np.ones((1, 400), dtype=bool)
    shown[0, 8] = False
    marked, limits, size = channels_disagree(signal, errors(1e-4, shape), shown=shown)
    # Nothing tells which of two is wrong; two pairs hold the third channel.
    assert marked[0, :, 0, 7].all()
    assert not marked[0, :, 0, 8].any()
    assert marked.sum() == 3
    assert len(limits) == 3
    assert size[0, 2, 0, 7] == pytest.approx(0.3 / 0.01 / np.sqrt(2), rel=0.1)
    assert np.isnan(size[0, :, 0, 8]).all()
    again, _, _ = channels_disagree(
        signal[..., 5:9], errors(1e-4, (1, 3, 1, 4)), shown=shown[:, 5:9], fit=limits
    )
    assert again.sum() == 3


def test_a_residual_of_zero_turns_no_phase() -> None:
    signal = np.array([1.0 + 0j, 1.0, np.nan])
    residual = np.array([0.0, 0.02j, 0.02j])
    ratio = phase_shift_ratio(signal, residual, errors(1e-4, (3,)))
    assert ratio[0] == 0.0
    # T less the residual is the target: an angle of 0.02 rad, 2 standard errors.
    assert ratio[1] == pytest.approx(2.0, rel=1e-3)
    found = flags(None, signal, errors(1e-4, (3,)), residual=residual)
    assert found.cause.tolist() == [0, int(WaterResidualCause.PHASE_SHIFT), 0]
    # What is proportional to the target is no error of its presence.
    along = errors(0.09, (3,))
    near = flags(None, signal, along, proportional=errors(0.08, (3,)))
    assert near.tests["signal_significance"][0] == pytest.approx(10.0)
