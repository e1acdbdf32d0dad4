"""Means, covariances and flags of a tally, against what is computed by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulor.optics.polarization import mueller, stokes
from amulor.transport import Tally
from amulor.transport.tally import (
    ANALYSERS,
    MOST_BATCHES,
    paired,
    sums_of,
    variance_weight,
)

PARTS = ("water, order 1", "water, order 2 and above", "target", "target, scattered")


def tally(batches, histories_of=None, **others):
    """Return a tally of batches (batches, parts, components, frequencies)."""
    batches = np.asarray(batches, dtype=complex)
    if histories_of is None:
        histories_of = np.full(len(batches), 10)
    usual = {
        "modulation_frequency": np.arange(batches.shape[3]) * 1e7,
        "parts": PARTS[: batches.shape[1]],
        "batches": batches,
        "histories_of": np.asarray(histories_of),
        "groups": 40,
        "contribution": (40.0, 50.0, 2.0),
        "seed": 1,
        "next_batch": len(batches),
        "batch_size": 10,
        "problem": "water",
        "seconds": 1.0,
    }
    return Tally(**(usual | others))


def of_signals(values, histories_of=None, **others):
    """Return a tally of one part, one component and one frequency."""
    return tally(np.reshape(values, (-1, 1, 1, 1)), histories_of, **others)


@pytest.fixture
def drawn():
    rng = np.random.default_rng(3)
    shape = (12, 4, 4, 3)
    return tally(rng.normal(size=shape) + 1j * rng.normal(size=shape) + 3)


def test_mean_and_covariance_of_two_batches_by_hand():
    found = of_signals([1, 3 + 2j])
    assert found.signal[0] == 2 + 1j
    # Deviations of -1, 1 in both parts: sum of products over 2 x (2 - 1).
    np.testing.assert_allclose(found.covariance[0], [[1, 1], [1, 1]], rtol=1e-15)
    assert found.relative_error[0] == pytest.approx(np.sqrt(2 / 5), rel=1e-14)
    # Along 2 + i the error is (2 + 1) / sqrt 5, across it (2 - 1) / sqrt 5.
    assert found.amplitude_uncertainty[0] == pytest.approx(3 / np.sqrt(5), rel=1e-14)
    assert found.phase_uncertainty[0] == pytest.approx(1 / 5, rel=1e-14)


def test_mean_and_variance_of_unlike_batches_by_hand():
    found = of_signals([0, 4], [1, 3])
    assert found.histories == 4
    assert found.signal[0] == 3
    # Variance of one history (1 x 3^2 + 3 x 1^2) / (2 - 1) = 12, of the mean 12 / 4.
    assert found.covariance[0, 0, 0] == pytest.approx(3, rel=1e-14)
    assert found.covariance[0, 1, 1] == 0


def test_equal_batches_have_the_covariance_of_numpy(drawn):
    values = drawn.batches.sum(axis=1)[:, 0]
    for k in range(3):
        expected = np.cov(values[:, k].real, values[:, k].imag) / 12
        np.testing.assert_allclose(drawn.covariance[k], expected, rtol=1e-12)
    both = np.concatenate([values.real, values.imag], axis=1)
    np.testing.assert_allclose(
        drawn.frequency_covariance, np.cov(both.T) / 12, rtol=1e-12
    )


def test_the_variance_of_batches_of_any_size_has_no_bias():
    sizes = np.array([1, 1, 3, 10, 85])
    rng = np.random.default_rng(8)
    # A batch of n histories has the variance 1 / n, their mean 1 / 100.
    values = rng.normal(size=(20_000, 5)) / np.sqrt(sizes)
    mean = values @ sizes / 100
    found = (values - mean[:, np.newaxis]) ** 2 @ variance_weight(sizes)
    assert found.mean() == pytest.approx(0.01, abs=4 * found.std() / np.sqrt(20_000))
    one = of_signals(values[0], sizes)
    assert one.covariance[0, 0, 0] == pytest.approx(found[0], rel=1e-12)


def test_kinds_of_light_are_sums_of_parts(drawn):
    mean = drawn.batches.mean(axis=0)
    np.testing.assert_allclose(drawn.water_signal, mean[:2, 0].sum(axis=0))
    np.testing.assert_allclose(drawn.target_signal, mean[2:, 0].sum(axis=0))
    np.testing.assert_allclose(drawn.signal, mean[:, 0].sum(axis=0))
    np.testing.assert_allclose(drawn.stokes, mean.sum(axis=0).T)
    assert drawn.stokes.shape == (3, 4)
    np.testing.assert_allclose(drawn.by_part["target"], mean[2, 0])
    for kind, parts in (("water", slice(2)), ("target", slice(2, 4))):
        values = drawn.batches[:, parts, 0].sum(axis=1)
        np.testing.assert_allclose(
            getattr(drawn, f"{kind}_covariance"), drawn.covariance_of(values)
        )


def test_a_part_is_found_by_its_name(drawn):
    found, covariance = drawn.part("target, scattered")
    np.testing.assert_allclose(found, drawn.batches[:, 3].mean(axis=0))
    assert covariance.shape == (4, 3, 2, 2)
    expected = drawn.batches[:, 3, 2, 1].real.var(ddof=1) / 12
    assert covariance[2, 1, 0, 0] == pytest.approx(expected, rel=1e-12)
    with pytest.raises(ValueError, match=r"'water, order 1'.*'target'.*got 'sky'"):
        drawn.part("sky")


@pytest.mark.parametrize("pair", ["VV", "VH", "HP", "RR", "RL", "PM"])
def test_what_is_detected_is_the_fraction_of_the_optics(pair):
    matrix = mueller.painted_metal()
    vector = mueller.apply(matrix, stokes.state(pair[0]))
    found = tally(np.tile(vector[:, np.newaxis], (3, 1, 1, 1)))
    signal, covariance = found.detected(pair[1])
    expected = mueller.detected_fraction(matrix, pair=pair)
    assert signal[0] == pytest.approx(complex(expected), abs=1e-15)
    np.testing.assert_allclose(covariance, 0, atol=1e-30)


def test_without_an_analyser_all_light_is_detected(drawn):
    signal, covariance = drawn.detected("none")
    np.testing.assert_allclose(signal, drawn.signal, rtol=1e-14)
    np.testing.assert_allclose(covariance, drawn.covariance, rtol=1e-12)
    halves = drawn.detected("R")[0] + drawn.detected("L")[0]
    np.testing.assert_allclose(halves, drawn.signal, rtol=1e-14)


def test_an_analyser_needs_stokes_vectors():
    with pytest.raises(ValueError, match="ScatteringMatrix"):
        of_signals([1, 2]).detected("H")


def test_one_batch_has_no_error():
    found = of_signals([1])
    assert found.signal[0] == 1
    assert found.heavy_tailed
    with pytest.raises(ValueError, match="at least two batches, got one"):
        _ = found.covariance


def test_without_light_the_relative_error_is_infinite():
    found = of_signals([0, 0])
    assert np.isinf(found.relative_error[0])
    assert np.isinf(found.phase_uncertainty[0])
    assert found.amplitude_uncertainty[0] == 0


def flagged(contributions):
    x = np.asarray(contributions, dtype=float)
    sums = (float(x.sum()), float((x**2).sum()), float(x.max()))
    found = of_signals([1, 2], groups=x.size, contribution=sums)
    assert found.largest_fraction == pytest.approx(x.max() / x.sum())
    assert found.effective_contributions == pytest.approx(x.sum() ** 2 / (x**2).sum())
    return found.heavy_tailed


def test_a_group_that_outweighs_the_error_is_flagged():
    rng = np.random.default_rng(2)
    ordinary = rng.exponential(size=1000)
    assert not flagged(ordinary)
    assert not flagged(np.full(1000, 0.37))
    # The others have a standard error of 1 / sqrt(1000) = 0.032: 32 groups' light.
    assert not flagged([*ordinary, 25.0])
    assert flagged([*ordinary, 40.0])
    # Half of all light from one group, which hides in the spread of all of them.
    assert flagged([*rng.exponential(size=1000) ** 3, 6000.0])
    assert flagged([*np.zeros(999), 1.0])
    # Ten groups with light of 1000, none of which outweighs the rest.
    assert flagged([*np.zeros(990), *rng.uniform(0.5, 1.5, size=10)])
    assert not flagged([*np.zeros(940), *rng.uniform(0.5, 1.5, size=60)])


def test_each_light_and_analyser_has_its_own_flag():
    # The water's light is even; one group brings nearly all of the target's, and of
    # that all is right circular.
    rng = np.random.default_rng(6)
    weight = np.zeros((500, 2, 4))
    weight[:, 0, 0] = 100 + rng.normal(size=500)
    weight[:, 1, 0] = rng.exponential(size=500) * 1e-3
    weight[7, 1] = [3.0, 0.0, 0.0, 3.0]
    sums = sums_of(weight)
    total = weight.sum(axis=1)[:, 0]
    np.testing.assert_allclose(
        sums[0, 0], [total.sum(), (total**2).sum(), total.max()], rtol=1e-12
    )
    right = 0.5 * (weight[:, 1, 0] + weight[:, 1, 3])
    np.testing.assert_allclose(
        sums[2, ANALYSERS.index("R")],
        [right.sum(), (right**2).sum(), right.max()],
        rtol=1e-12,
    )
    found = tally(
        np.ones((3, 4, 4, 1)), groups=500, contributions=sums,
        contribution=tuple(sums[0, 0]),
    )  # fmt: skip
    assert found.heavy_tailed
    assert not found.heavy_tail_of()
    assert not found.heavy_tail_of("water", analyser="R")
    assert found.heavy_tail_of("target")
    assert found.heavy_tail_of("target", analyser="R")
    assert not found.heavy_tail_of("target", analyser="L")
    with pytest.raises(ValueError, match="light must be one of"):
        found.heavy_tail_of("sky")
    with pytest.raises(ValueError, match="analyser must be one of"):
        found.heavy_tail_of("target", analyser="X")
    # What has not been seen yet, and would outweigh the error, is a tail as well.
    weight[7, 1] = 0
    quiet = tally(
        np.ones((3, 4, 4, 1)), groups=500, contributions=sums_of(weight),
        contribution=(1.0, 1.0, 1.0),
    )  # fmt: skip
    assert not quiet.heavy_tailed
    doubtful = replace(quiet, unseen=3.0)
    assert doubtful.heavy_tail_of("target")
    assert doubtful.heavy_tailed
    assert not doubtful.heavy_tail_of("water")
    assert not doubtful.heavy_tail_of("all")


def test_errors_of_each_light_and_analyser_by_hand(drawn):
    for light, rows in (
        ("all", slice(4)),
        ("water", slice(2)),
        ("target", slice(2, 4)),
    ):
        values = drawn.batches[:, rows].sum(axis=1)
        for analyser, row in (
            ("none", values[:, 0]),
            ("V", (values[:, 0] - values[:, 1]) / 2),
        ):
            expected = np.sqrt(row.var(axis=0, ddof=1) / 12) / np.abs(row.mean(axis=0))
            np.testing.assert_allclose(
                drawn.relative_error_of(light, analyser=analyser), expected, rtol=1e-12
            )
    with pytest.raises(ValueError, match="'target, scattered'; got 'sky'"):
        drawn.relative_error_of("sky")
    with pytest.raises(ValueError, match="ScatteringMatrix"):
        of_signals([1, 2]).relative_error_of(analyser="H")


def test_contributions_of_merged_runs_are_those_of_both():
    rng = np.random.default_rng(8)
    weights = rng.exponential(size=(2, 30, 2, 1))
    one, other = (
        of_signals([1, 2], groups=30, contributions=sums_of(w), seed=seed)
        for seed, w in enumerate(weights)
    )
    expected = sums_of(weights.reshape(60, 2, 1))
    np.testing.assert_allclose(one.merged(other).contributions, expected, rtol=1e-12)


def test_a_tally_without_contributions_is_not_flagged():
    found = of_signals([1, 2], groups=0, contribution=(0.0, 0.0, 0.0))
    assert not found.heavy_tailed
    assert found.largest_fraction == 0
    assert found.effective_contributions == 0


def test_merged_runs_are_the_mean_of_all_histories():
    rng = np.random.default_rng(4)
    one = of_signals(rng.normal(size=6) + 1j, np.full(6, 10), seed=1)
    other = of_signals(
        rng.normal(size=4) + 2j, np.full(4, 30), seed=2, seconds=2.0, groups=60,
        contribution=(30.0, 20.0, 5.0), interrupted=True,
    )  # fmt: skip
    both = one.merged(other)
    assert both.histories == 180
    expected = (60 * one.signal + 120 * other.signal) / 180
    np.testing.assert_allclose(both.signal, expected, rtol=1e-14)
    assert both.contribution == (70.0, 70.0, 5.0)
    assert both.groups == 100
    assert both.seconds == 3
    assert both.interrupted
    assert both.merged_seeds == (2,)
    # The order does not matter but for rounding.
    np.testing.assert_allclose(other.merged(one).signal, both.signal, rtol=1e-14)
    np.testing.assert_allclose(other.merged(one).covariance, both.covariance)


def test_only_independent_runs_of_the_same_problem_are_merged():
    one, other = of_signals([1, 2], seed=1), of_signals([1, 3], seed=2)
    for wrong, words in (
        (of_signals([1, 2], seed=2, problem="milk"), "same problem"),
        (of_signals([1, 2], seed=2, parts=("target",)), "same problem"),
        (
            of_signals([1, 2], seed=2, modulation_frequency=np.array([5.0])),
            "same frequencies",
        ),
        (of_signals([1, 2], seed=1), "the seed 1,"),
    ):
        with pytest.raises(ValueError, match=words):
            one.merged(wrong)
    third = of_signals([2, 3], seed=3)
    both = one.merged(other)
    for again in (other, third.merged(other), both):
        with pytest.raises(ValueError, match=r"have the seed [12],"):
            both.merged(again)
    assert both.merged(third).merged_seeds == (2, 3)


def test_many_merged_runs_stay_small():
    rng = np.random.default_rng(5)
    values = rng.normal(size=(9, 100))
    runs = [of_signals(row, seed=k) for k, row in enumerate(values)]
    total = runs[0]
    for run in runs[1:]:
        total = total.merged(run)
    assert total.histories_of.size <= MOST_BATCHES
    assert total.histories == 9000
    assert total.signal[0].real == pytest.approx(values.mean(), abs=1e-14)
    # Some 200 batches tell the variance 1 / 900 to sqrt(2 / 200) = 10 %.
    assert total.covariance[0, 0, 0] == pytest.approx(1 / 900, rel=0.4)


@given(st.lists(st.integers(1, 1000), min_size=1, max_size=20))
def test_pairs_keep_the_mean_and_the_histories(sizes):
    counts = np.array(sizes)
    values = np.random.default_rng(len(sizes)).normal(size=(len(sizes), 2, 1, 3)) + 0j
    joined, histories = paired(values, counts)
    assert histories.size == (counts.size + 1) // 2
    assert histories.sum() == counts.sum()
    np.testing.assert_allclose(
        np.tensordot(histories, joined, axes=1),
        np.tensordot(counts, values, axes=1),
        rtol=1e-12, atol=1e-9,
    )  # fmt: skip


def test_a_longer_way_turns_the_phase_and_keeps_the_amplitude(drawn):
    later = drawn.delayed(1.5, group_index=1.38)
    phase = np.angle(later.signal / drawn.signal)
    expected = 2 * np.pi * drawn.modulation_frequency * 1.5 * 1.38 / 299792458
    np.testing.assert_allclose(phase, expected, atol=1e-12)
    np.testing.assert_allclose(np.abs(later.signal), np.abs(drawn.signal), rtol=1e-14)
    assert later.next_batch == -1
    with pytest.raises(ValueError, match="same problem"):
        later.merged(drawn)
