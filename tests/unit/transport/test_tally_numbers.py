"""Flags, derivatives and bounds of a tally, from batches with known numbers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.transport import PathRecord, Tally
from amulor.transport.tally import (
    ANALYSERS,
    LIGHT,
    MOST_BATCHES,
    analyser_vector,
    outweighs,
    paired,
    sums_of,
    together,
    variance_weight,
)

PARTS = ("water, order 1", "target", "target, scattered")


def tally(batches, **others):
    """Return a tally of batches (batches, parts, components, frequencies)."""
    batches = np.asarray(batches, dtype=complex)
    usual = {
        "modulation_frequency": np.arange(batches.shape[3]) * 1e7,
        "parts": PARTS[: batches.shape[1]],
        "batches": batches,
        "histories_of": np.full(len(batches), 10),
        "groups": 40,
        "contribution": (40.0, 50.0, 2.0),
        "seed": 1,
        "next_batch": len(batches),
        "batch_size": 10,
        "problem": "water",
        "seconds": 1.0,
    }
    return Tally(**(usual | others))


def flag(*contributions, groups=None, unseen=0.0):
    """Return whether a group of some outweighs the error; others have no light."""
    x = np.array(contributions, dtype=float)
    sums = np.array([x.sum(), (x**2).sum(), x.max()])
    return outweighs(sums, groups=groups or x.size, unseen=unseen)


def test_one_group_cannot_outweigh_others():
    assert not flag(5.0)
    assert flag(5.0, 0.0)
    assert not flag(5.0, 5.0)


@pytest.mark.parametrize(("count", "few"), [(29, True), (31, False)])
def test_fewer_than_thirty_groups_with_light_are_few(count, few):
    assert flag(*[1.0] * count, groups=10**9) is few


@pytest.mark.parametrize(("largest", "heavy"), [(10.9, False), (11.05, True)])
def test_a_group_outweighs_the_scatter_of_all_others(largest, heavy):
    # Of 398 others with 0.5 or 1.5: a mean of 1, and sqrt(398 / 4) = 9.975.
    others = [0.5, 1.5] * 199
    assert flag(largest, *others) is heavy


def test_equal_groups_may_differ_by_rounding():
    # Two groups scatter by nothing but the difference: a millionth of the light.
    assert not flag(1.0, 1 + 2.0**-20)
    assert flag(1.0, 1 + 9 * 2.0**-23)


@pytest.mark.parametrize(("unseen", "heavy"), [(5.4, False), (5.6, True)])
def test_light_that_was_not_met_yet_counts_above_the_error(unseen, heavy):
    # 60 of 120 groups with 1: a variance of 60 - 30.
    assert flag(*[1.0] * 60, *[0.0] * 60, unseen=unseen) is heavy
    # Without any scatter, all that was not met counts.
    assert flag(*[1.0] * 60, unseen=1e-3)
    assert not flag(*[1.0] * 60)


def test_flags_belong_to_a_kind_of_light_and_an_analyzer():
    weight = np.zeros((60, 2, 4))
    weight[:, 0, 0] = 1.0
    weight[:30, 1, 0] = weight[:30, 1, 1] = 0.01
    sums = sums_of(weight)
    assert sums.shape == (3, 7, 3)
    found = tally(np.ones((2, 3, 4, 1)), groups=60, contributions=sums, unseen=0.04)
    # 0.01 sqrt(15) = 0.039 is the error of the target's light, of H the same, of P
    # half of that; V has no light at all, and the water none that was not met.
    assert found.heavy_tail_of("target")
    assert found.heavy_tail_of("all")
    assert not found.heavy_tail_of("water")
    less = replace(found, unseen=0.038)
    assert not less.heavy_tail_of("target")
    assert not less.heavy_tail_of("target", analyser="H")
    assert less.heavy_tail_of("target", analyser="P")
    assert less.heavy_tail_of("target", analyser="V")
    assert not less.heavy_tailed
    assert found.heavy_tailed
    for light in ("water, order 1", "sky"):
        message = f"light must be one of 'all', 'water', 'target'; got '{light}'"
        with pytest.raises(ValueError, match=message):
            found.heavy_tail_of(light)
    scalar = replace(found, contributions=sums[:, :1])
    assert scalar.heavy_tail_of("target")
    with pytest.raises(ValueError, match=r"analyser must be one of none; got 'H'"):
        scalar.heavy_tail_of(analyser="H")
    single = tally(np.ones((1, 3, 4, 1)), contributions=sums)
    assert single.heavy_tail_of("water")


def test_an_older_run_has_a_flag_of_all_light_only():
    found = tally(np.ones((2, 3, 1, 1)), groups=40, contribution=(40.0, 45.0, 2.0))
    assert not found.heavy_tail_of()
    assert replace(found, contribution=(40.0, 130.0, 2.0)).heavy_tail_of()
    for light, analyser in (("target", "none"), ("all", "H")):
        with pytest.raises(ValueError, match="contributions by light and analyser"):
            found.heavy_tail_of(light, analyser=analyser)
    assert found.effective_contributions == 40**2 / 45
    assert found.largest_fraction == 0.05


def test_sums_add_and_largest_contributions_do_not():
    one = np.arange(18.0).reshape(3, 2, 3)
    other = one[::-1]
    found = together(one, other)
    assert found[0, 0].tolist() == [12, 14, 14]
    assert found[1, 1].tolist() == [18, 20, 11]
    assert one[0, 0].tolist() == [0, 1, 2]
    assert sums_of(np.zeros((0, 2, 1))).tolist() == [[[0, 0, 0]]] * 3


def test_an_analyzer_passes_half_of_the_light_without_polarization():
    assert analyser_vector("none").tolist() == [1, 0, 0, 0]
    assert analyser_vector("H").tolist() == [0.5, 0.5, 0, 0]
    assert analyser_vector("L").tolist() == [0.5, 0, 0, -0.5]
    assert len(ANALYSERS) == 7
    assert LIGHT == ("all", "water", "target")


def test_a_record_takes_only_more_absorption():
    record = PathRecord(
        length=np.array([2.0]), water=np.array([[0.5]]), target=np.array([[0.25]]),
        beyond=0.0,
    )  # fmt: skip
    assert record.stokes([0.0], group_index=1.3).tolist() == [[0.75]]
    assert record.stokes(0.0, group_index=1.3, more_absorption=0.0)[0, 0] == 0.75
    with pytest.raises(ValueError, match=r"^more_absorption must be at least 0 1/m"):
        record.stokes([0.0], group_index=1.3, more_absorption=-1e-9)


def test_light_behind_an_analyzer_is_that_of_each_kind():
    rng = np.random.default_rng(4)
    batches = rng.normal(size=(5, 3, 4, 2)) + 1j * rng.normal(size=(5, 3, 4, 2))
    found = tally(batches)
    for light, rows in (
        ("all", [0, 1, 2]), ("water", [0]), ("target", [1, 2]),
        ("target, scattered", [2]),
    ):  # fmt: skip
        stokes = batches[:, rows].sum(axis=1)
        assert_allclose(found.passed(light), stokes[:, 0])
        passed = found.passed(light, analyser="M")
        assert_allclose(passed, 0.5 * (stokes[:, 0] - stokes[:, 2]))
    values, covariance = found.detected("M")
    assert_allclose(values, found.passed(analyser="M").mean(axis=0))
    assert_allclose(covariance, found.covariance_of(found.passed(analyser="M")))
    assert found.polarized
    assert not tally(batches[:, :, :1]).polarized
    assert list(found.by_part) == list(PARTS)
    assert_allclose(found.by_part["target"], batches[:, 1, 0].mean(axis=0))


def test_a_batch_of_more_histories_weighs_more():
    sizes = np.array([10, 30])
    values = np.array([1.0, 5.0]).reshape(2, 1, 1, 1)
    found = tally(values, histories_of=sizes)
    assert found.signal[0] == 4
    assert found.frequency_covariance[0, 0] == pytest.approx(found.covariance[0, 0, 0])
    # Fractions of 1/4 and 3/4: f^2 / (1 - f).
    assert_allclose(variance_weight(sizes), [1 / 12, 9 / 4])
    assert found.covariance[0, 0, 0] == pytest.approx(9 / 12 + 9 / 4)


def sloped(count=4, frequencies=2, components=4, **others):
    """Return a tally with drawn derivatives to three parameters."""
    rng = np.random.default_rng(9)
    shape = (count, 6, components, frequencies)
    slopes = rng.normal(size=shape) + 1j * rng.normal(size=shape)
    names = {"derivatives": ("a", "b", "c"), "derivative_batches": slopes}
    batches = np.ones((count, 3, components, frequencies))
    return tally(batches, **(names | others)), slopes


def test_a_derivative_is_that_of_its_parameter_light_and_analyzer():
    found, slopes = sloped()
    for light, rows in (("all", [2, 3]), ("water", [2]), ("target", [3])):
        stokes = slopes[:, rows].sum(axis=1)
        for analyser, passed in (
            ("none", stokes[:, 0]),
            ("R", 0.5 * (stokes[:, 0] + stokes[:, 3])),
        ):
            value, covariance = found.derivative("b", light, analyser=analyser)
            assert_allclose(value, passed.mean(axis=0))
            assert_allclose(covariance, found.covariance_of(passed))
    assert_allclose(found.derivative("c")[0], slopes[:, 4:, 0].sum(axis=1).mean(axis=0))
    with pytest.raises(ValueError, match=r"the derivatives are 'a', 'b', 'c'; got 'd'"):
        found.derivative("d")
    with pytest.raises(ValueError, match=r"the derivatives are none; got 'a'"):
        tally(np.ones((2, 3, 1, 1))).derivative("a")
    with pytest.raises(ValueError, match="light must be one of"):
        found.derivative("a", "sky")
    assert found.rows.shape == (4, 9, 4, 2)
    again = found.with_rows(2 * found.rows)
    assert_allclose(again.derivative_batches, 2 * slopes)
    assert_allclose(again.batches, 2 * found.batches)
    plain = tally(np.ones((2, 3, 1, 1)))
    assert plain.rows is plain.batches
    assert plain.with_rows(plain.rows).derivative_batches is None


def test_bounds_of_a_run_without_scatter_are_those_of_its_slopes():
    # Slopes of a: 3 at the first, 4i at the second frequency; of b: 1 and 0.
    slope = np.zeros((6, 1, 2), dtype=complex)
    slope[0, 0, 0], slope[1, 0, 0], slope[1, 0, 1] = 1, 2, 4j
    slope[2, 0, 0] = 1
    slope[4, 0, 1] = 7
    sizes = np.array([10] * 15 + [40, 30])
    found, _ = sloped(
        17, components=1, histories_of=sizes,
        derivative_batches=np.tile(slope, (17, 1, 1, 1)),
    )  # fmt: skip
    noise = np.stack([0.04 * np.eye(2), 0.25 * np.eye(2)])
    # Information: 9 / 0.04 + 16 / 0.25, 3 / 0.04 between them, and 1 / 0.04.
    aa, ab, bb = 225 + 64, 75, 25
    bound, error = found.bounds(noise, ("a",))
    assert_allclose(bound, [aa**-0.5], rtol=1e-12)
    assert_allclose(error, 0, atol=1e-12)
    determinant = aa * bb - ab**2
    expected = [math.sqrt(bb / determinant), math.sqrt(aa / determinant)]
    assert_allclose(found.bounds(noise, ("a", "b"))[0], expected, rtol=1e-10)
    assert_allclose(found.bounds(noise, ("b", "a"))[0], expected[::-1], rtol=1e-10)
    # The third acts on the other part of the second frequency alone.
    whole = found.bounds(noise)[0]
    assert_allclose(whole, [*expected, 0.5 / 7], rtol=1e-10)


def scattered(scale, count=32):
    """Return slopes to one parameter, and bound and error by the jackknife over 16."""
    rng = np.random.default_rng(2)
    values = 1 + scale * rng.normal(size=count)
    parts = values.reshape(-1, 16).mean(axis=0)
    bound = 1 / abs(values.mean())
    without = np.array([1 / abs(np.delete(parts, k).mean()) for k in range(16)])
    error = math.sqrt(15 / 16 * np.sum((without - without.mean()) ** 2))
    return values, bound + 15 * (bound - without.mean()), error


def bounds_of(values):
    slopes = np.zeros((len(values), 2, 1, 1))
    slopes[:, 0, 0, 0] = values
    found = tally(
        np.ones((len(values), 3, 1, 1)), derivatives=("a",), derivative_batches=slopes
    )
    return found.bounds(np.eye(2)[np.newaxis])


@pytest.mark.parametrize("count", [16, 48])
def test_a_bound_has_the_error_of_the_jackknife(count):
    values, expected, error = scattered(0.3, count)
    bound, found = bounds_of(values)
    assert bound[0] == pytest.approx(expected, rel=1e-10)
    assert found[0] == pytest.approx(error, rel=1e-10)


def test_a_bound_is_known_if_it_is_twice_its_error():
    ratios = {}
    for scale in np.linspace(1.0, 4.0, 40):
        _, bound, error = scattered(scale)
        ratios[scale] = bound / error
    surely = [scale for scale, ratio in ratios.items() if 2.05 < ratio < 2.9]
    hardly = [scale for scale, ratio in ratios.items() if 1.0 < ratio < 1.95]
    assert surely
    assert hardly
    assert bounds_of(scattered(surely[0])[0])[0] > 0
    with pytest.raises(ValueError, match="does not determine the parameters"):
        bounds_of(scattered(hardly[0])[0])


def test_bounds_need_slopes_and_sixteen_batches():
    with pytest.raises(ValueError, match="at least 16 batches, got 15"):
        bounds_of(np.ones(15))
    assert bounds_of(np.ones(16))[0] == pytest.approx(1)
    with pytest.raises(ValueError, match="does not determine the parameters"):
        bounds_of(np.zeros(16))
    noise = np.eye(2)[np.newaxis]
    with pytest.raises(ValueError, match=r"the derivatives are none; got none"):
        tally(np.ones((16, 3, 1, 1))).bounds(noise)
    found, _ = sloped(16, frequencies=1, components=1)
    with pytest.raises(ValueError, match=r"the derivatives are a, b, c; got b, d"):
        found.bounds(noise, ("b", "d"))


@pytest.mark.parametrize(("batches", "kept"), [(128, 256), (129, 129)])
def test_merged_batches_are_paired_above_256(batches, kept):
    assert MOST_BATCHES == 256
    one = tally(np.ones((128, 1, 1, 1)))
    other = tally(np.full((batches, 1, 1, 1), 3.0), seed=2)
    both = one.merged(other)
    assert both.histories_of.size == kept
    assert both.histories == 10 * (128 + batches)


def test_a_merged_run_has_the_numbers_of_both():
    sums = np.ones((3, 1, 3))
    record = PathRecord(
        length=np.ones(1), water=np.ones((1, 1)), target=np.ones((1, 1)), beyond=0.0
    )
    one = tally(np.ones((2, 1, 1, 1)), contributions=sums, record=record, unseen=0.5)
    other = tally(
        np.ones((3, 1, 1, 1)), contributions=2 * sums, seed=7, merged_seeds=(8, 9),
        unseen=0.25, groups=5, contribution=(1.0, 2.0, 3.0), seconds=4.0,
    )  # fmt: skip
    for both in (one.merged(other), other.merged(one)):
        assert both.contributions[0, 0].tolist() == [3, 3, 2]
        assert both.contribution == (41, 52, 3)
        assert (both.groups, both.seconds, both.unseen) == (45, 5, 0.5)
        assert both.record is None
        assert both.next_batch == -1
        assert not both.interrupted
    assert one.merged(other).merged_seeds == (7, 8, 9)
    assert other.merged(one).merged_seeds == (8, 9, 1)
    for a, b in ((one, replace(other, contributions=None)),
                 (replace(one, contributions=None), other)):  # fmt: skip
        assert a.merged(b).contributions is None
    assert replace(one, interrupted=True).merged(other).interrupted
    with pytest.raises(ValueError, match="both runs have the seed 9, so they"):
        other.merged(replace(one, seed=9))
    with pytest.raises(ValueError, match="only runs of the same problem"):
        one.merged(replace(other, parts=("milk",)))


def test_a_delayed_run_has_another_problem_and_no_record():
    record = PathRecord(
        length=np.ones(1), water=np.ones((1, 1)), target=np.ones((1, 1)), beyond=0.0
    )
    found = tally(np.ones((2, 1, 1, 2)), record=record).delayed(-2.0, group_index=1.5)
    assert found.problem == "water delayed by -2.0 m of index 1.5"
    assert found.record is None
    assert found.next_batch == -1
    assert np.angle(found.signal[1]) == pytest.approx(
        -2 * math.pi * 1e7 * 1.5 * 2 / 299792458
    )


def test_pairs_of_batches_are_means_by_their_histories():
    values, counts = paired(np.array([1.0, 5.0, 7.0]), np.array([10, 30, 20]))
    assert counts.tolist() == [40, 20]
    assert values.tolist() == [4, 7]


def test_errors_of_modulus_and_phase_lie_along_and_across_the_signal():
    # Scatter of the real part alone, of a signal along 3 + 4i: 0.6 and 0.8 of it.
    found = tally((np.array([1.0, 5.0]) + 4j).reshape(2, 1, 1, 1))
    assert found.signal[0] == 3 + 4j
    assert found.amplitude_uncertainty[0] == pytest.approx(0.6 * 2)
    assert found.phase_uncertainty[0] == pytest.approx(0.8 * 2 / 5)
    assert found.relative_error[0] == pytest.approx(2 / 5)
    assert found.relative_error_of("water")[0] == pytest.approx(2 / 5)
    assert np.isinf(found.relative_error_of("target")[0])
