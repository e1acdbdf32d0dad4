"""Limits and goals of a transport run, its running sums, and its progress."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.transport import ErrorGoal, Tally
from amulor.transport import _runs as runs
from amulor.transport._runs import (
    CHECKS,
    Accumulator,
    Batch,
    Limits,
    conduct,
    frequencies,
)


def tally_of(values, **others):
    """Return a tally of one part at two frequencies, of batches of equal size."""
    values = np.asarray(values, dtype=complex)
    usual = {
        "modulation_frequency": np.array([0.0, 1e7]),
        "parts": ("water",),
        "batches": np.stack([values, 2 * values[::-1] + 1], axis=-1)[:, None, None],
        "histories_of": np.full(len(values), 10),
        "groups": 3,
        "contribution": (1.0, 1.0, 1.0),
        "seed": 1,
        "next_batch": len(values),
        "batch_size": 10,
        "problem": "water",
        "seconds": 1.5,
    }
    return Tally(**(usual | others))


def test_an_error_is_known_from_eight_batches():
    goal = ErrorGoal(relative_error=0.1)
    assert goal.of(tally_of([1, 2, 3] + [1] * 4)) == math.inf
    values = np.array([1, 2, 3] + [1] * 5)
    expected = values.std(ddof=1) / np.sqrt(8) / values.mean()
    assert goal.of(tally_of(values)) == pytest.approx(expected)
    second = ErrorGoal(relative_error=0.1, frequency=1)
    other = 2 * values + 1
    assert second.of(tally_of(values)) == pytest.approx(
        other.std(ddof=1) / np.sqrt(8) / other.mean()
    )
    assert (goal.light, goal.analyser, goal.frequency) == ("all", "none", 0)


def test_a_goal_is_met_by_the_error_and_its_own_error_at_a_few_batches():
    # 16 batches of 0.9 and 1.1: an error of 0.1 / sqrt 15, known to 1 / sqrt 30.
    values = np.tile([0.9, 1.1], 8)
    error = 0.1 / math.sqrt(15) * (1 + 1 / math.sqrt(30))
    for factor, met in ((1.01, True), (0.99, False)):
        goal = ErrorGoal(relative_error=factor * error)
        assert goal.reached(tally_of(values)) is met
        assert not goal.reached(tally_of(values, next_batch=17))
    assert sorted(CHECKS)[:8] == [16, 23, 32, 45, 64, 91, 128, 181]
    assert max(CHECKS) > 1e15


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ErrorGoal(relative_error=0.0), "relative_error must be above 0"),
        (
            lambda: ErrorGoal(relative_error=1, frequency=-1),
            "frequency must be a whole number of at least 0, got -1",
        ),
        (lambda: ErrorGoal(relative_error=1, frequency=0.5), "at least 0, got 0.5"),
        (lambda: Limits(histories=0.5), "histories .* at least 1, got 0.5"),
        (lambda: Limits(histories=8, threads=1.5), "threads .* at least 1, got 1.5"),
        (lambda: Limits(histories=8, longest_time=-1), "above 0 s, got -1"),
        (lambda: frequencies([[1.0, 2.0]]), r"got the shape \(1, 2\)"),
        (lambda: frequencies([1.0, -3.0, -2.0]), "not below 0 Hz, got -3 Hz"),
        (lambda: runs.checked_seed(-1), "seed .* at least 0, got -1"),
    ],
)
def test_limits_of_a_run_are_refused_with_their_number(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_the_least_limits_of_a_run_are_accepted():
    limits = Limits(histories=1, threads=1, longest_time=1e-9)
    assert (limits.histories, limits.threads, limits.error) == (1, 1, None)
    assert frequencies([0.0, 2.0]).tolist() == [0, 2]
    assert runs.checked_seed(0) == 0
    assert runs.checked_seed(5.0) == 5


def batch_of(number, unseen=0.0, histories=10):
    """Return a batch of three groups."""
    return Batch(
        number=number, histories=histories, unseen=unseen, mass=None, edge=None,
        signal=np.full((1, 1, 2), number + 1.0 + 2j),
        weight=np.array([[[1.0], [0.5]], [[0.0], [3.0]], [[2.0], [0.0]]]),
        spacing=0.25,
    )  # fmt: skip


def start(resume=None):
    return Accumulator.start(tally_of([], next_batch=0), resume)


def test_running_sums_begin_at_nothing():
    first = start().with_batch(batch_of(0))
    tally = first.tally(2.5, interrupted=True)
    assert (tally.seconds, tally.interrupted, tally.next_batch) == (2.5, True, 1)
    assert (tally.groups, tally.unseen, tally.histories) == (3, 0, 10)
    assert tally.contribution == (6.5, 1.5**2 + 9 + 4, 3)
    assert tally.record is None
    assert start().contribution == (0, 0, 0)
    second = first.with_batch(batch_of(1, unseen=0.5)).with_batch(
        batch_of(2, unseen=0.25)
    )
    assert second.unseen == 0.5
    assert second.tally(0.0, interrupted=False).signal[0] == 2 + 2j


def test_a_resumed_run_goes_on_from_all_of_its_numbers():
    done = start().with_batch(batch_of(0, unseen=0.5)).tally(2.0, interrupted=True)
    more = start(done).with_batch(batch_of(1)).tally(1.0, interrupted=False)
    assert more.seconds == 3
    assert not more.interrupted
    assert (more.groups, more.unseen, more.next_batch) == (6, 0.5, 2)
    assert more.contribution == (13, 2 * (1.5**2 + 13), 3)
    assert more.signal[0] == 1.5 + 2j
    # A resumed batch that is not full is filled before the next one.
    part = replace(done, histories_of=np.array([4]))
    filled_up = start(part).with_batch(batch_of(1, histories=6))
    assert filled_up.counts == (10,)
    assert filled_up.values[0][0, 0, 0] == 0.4 * (1 + 2j) + 0.6 * (2 + 2j)
    with pytest.raises(ValueError, match="which older versions did not keep"):
        start(replace(done, contributions=None))
    slabs = replace(done, contributions=None, groups=0)
    assert start(slabs).groups == 0
    for change, message in (
        ({"problem": "milk"}, "same problem"),
        ({"parts": ("milk",)}, "same problem"),
        ({"seed": 2}, "seed 1, got 2"),
        ({"next_batch": -1}, "a merged run cannot go on"),
        ({"modulation_frequency": np.array([0.0, 2e7])}, "same frequencies"),
    ):
        with pytest.raises(ValueError, match=message):
            start(replace(done, **change))
    assert start(replace(done, next_batch=0)).next_batch == 0


def test_a_run_has_the_workers_that_it_is_given(monkeypatch):
    chosen = []

    def in_order(function, first, end, **options):
        chosen.append(options)
        return map(function, range(first, end))

    monkeypatch.setattr(runs, "_in_order", in_order)
    for threads, processors in ((3, 4), (None, 4), (None, None)):
        monkeypatch.setattr(runs.os, "cpu_count", lambda count=processors: count)
        conduct(
            batch_of, tally_of([], next_batch=0), Limits(histories=20, threads=threads)
        )
    assert chosen == [{"workers": 3}, {"workers": 4}, {"workers": 1}]


def test_progress_counts_histories_up_to_the_last_full_batch():
    steps = []
    limits = Limits(histories=95, threads=1, progress=steps.append)
    tally = conduct(batch_of, tally_of([], next_batch=0), limits)
    assert [step.histories for step in steps] == list(range(10, 101, 10))
    assert {step.goal for step in steps} == {100}
    assert math.isinf(steps[6].relative_error)
    assert steps[-1].relative_error == pytest.approx(tally.relative_error[0])
    assert 0 <= steps[-1].seconds <= tally.seconds < 60
    assert not tally.interrupted


def test_own_spread_gets_the_batches_that_are_left():
    asked = []

    def spread(function, first, end):
        asked.append((first, end))
        return map(function, range(first, end))

    limits = Limits(histories=30, spread=spread)
    frame = tally_of([], next_batch=0)
    first = conduct(batch_of, frame, limits)
    conduct(batch_of, frame, replace(limits, histories=50), first)
    assert asked == [(0, 3), (3, 5)]


def test_light_of_a_record_is_spread_over_its_bins():
    batch = replace(
        batch_of(0),
        mass=np.array([[[4.0, 2.0, 0.0, 8.0]]]),
        edge=np.array([[[0.0, 4.0, 0.0, -4.0]]]),
        spacing=0.5,
        weight=np.full((2, 2, 1), 8.0),
    )
    record = start().with_batch(batch).tally(0.0, interrupted=False).record
    # Of a node half goes to each side, of the first all; light of 4 per m from 0.5 m.
    assert record.length.tolist() == [0.25, 0.75, 1.25]
    assert record.water[:, 0].tolist() == [5, 1 + 2, 4 + 2]
    assert record.target[:, 0].tolist() == [0, 0, 0]
    assert record.beyond == pytest.approx(1 - 14 / 16)
    again = start().with_batch(batch).with_batch(replace(batch, number=1))
    both = again.tally(0.0, interrupted=False).record
    assert_allclose(both.water, record.water)
    assert both.beyond == pytest.approx(record.beyond)
    none = replace(batch, weight=np.zeros((2, 2, 1)))
    assert start().with_batch(none).tally(0.0, interrupted=False).record.beyond == 0
