"""Steps of the search for an instrument: sets, grids, starts, order and limits."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from goal_parts import with_laser, with_parts
from numpy.testing import assert_allclose

from amulor.design import Goal, search
from amulor.design.candidates import (
    Parameters,
    box_values,
    cost_of,
    first_choice,
    longest_dwell,
    scan_time,
)
from amulor.design.goal import LengthBox, Modulation, TimeBox
from amulor.design.scores import Grid, Score, grid_of, merits
from amulor.design.search import Candidate

F = (15e6, 34e6, 52e6, 75e6, 120e6)


def scores(
    error: list[float], cost: list[float] | None = None, **changed: Any
) -> Score:
    """Return scores of candidates that meet all but for their error [mm]."""
    count = len(error)
    values: dict[str, Any] = {
        "error": 1e-3 * np.array(error)[:, None], "wrong": np.zeros((count, 1)),
        "output": np.zeros(count), "validity": np.zeros(count),
        "time": np.zeros(count), "rows": np.zeros(count), "smear": np.zeros(count),
        "cost": np.array(cost or [0.0] * count),
    }  # fmt: skip
    return Score(**values | changed)


def candidate(goal: Goal, error: float, cost: float = 0.0, **changes: Any) -> Candidate:
    """Return a candidate with an error [mm] of 3 mm that are asked for."""
    return Candidate(
        parameters=replace(first_choice(goal), **changes),
        score=scores([error], [cost]),
        merit=math.log(error / 3),
    )


def test_frequencies_stay_below_those_of_the_laser() -> None:
    sets = ((1.0, 5.0), (2.0,), (3.0, 4.0))
    assert search.allowed(sets, None) == sets
    assert search.allowed(sets, 4.0) == ((2.0,), (3.0, 4.0))
    # None is left: that of the lowest highest frequency.
    assert search.allowed(sets, 1.5) == ((2.0,),)
    assert search.allowed(((1.0, 5.0), (3.0, 4.0)), 1.5) == ((3.0, 4.0),)


def test_neighbors_add_exchange_or_leave_out_one_frequency() -> None:
    found = search._neighbours((2.0,), (1.0, 2.0, 3.0), 2)
    assert found == ((2.0,), (1.0, 2.0), (1.0,), (2.0, 3.0), (3.0,))
    assert search._neighbours((2.0,), (1.0, 2.0), 1) == ((2.0,), (1.0,))
    both = search._neighbours((1.0, 3.0), (1.0, 2.0, 3.0), 2)
    assert both == ((1.0, 3.0), (2.0, 3.0), (1.0, 2.0), (3.0,), (1.0,))
    three = search._neighbours((1.0, 3.0), (2.0,), 3)
    assert three[1] == (1.0, 2.0, 3.0)


def test_dwell_times_are_those_listed_and_the_present_one(goal: Goal) -> None:
    like = replace(first_choice(goal), dwell=0.045)
    assert search._dwells(goal, like, ((15e6,),)) == (0.03, 0.045, 0.06, 0.12)


def test_dwell_times_of_a_range_may_use_all_of_the_time(goal: Goal) -> None:
    ranged = with_parts(goal, dwell=TimeBox(low=0.03, high=0.15, count=2))
    like = replace(first_choice(ranged), dwell=0.05)
    # 1,200 pixels in 240 s: 200 ms for one frequency, 100 ms each for two.
    sets = ((15e6,), (15e6, 52e6), (34e6, 52e6))
    found = search._dwells(ranged, like, sets)
    assert_allclose(found, [0.03, 0.05, 0.1, 0.15])
    assert longest_dwell(ranged, replace(like, frequencies=(1.0,))) == pytest.approx(
        0.2
    )
    wide = with_parts(goal, dwell=TimeBox(low=0.1, high=0.2, count=2))
    assert_allclose(search._dwells(wide, like, sets), [0.05, 0.1, 0.2])
    narrow = with_parts(goal, dwell=TimeBox(low=0.11, high=0.19, count=2))
    assert_allclose(search._dwells(narrow, like, sets), [0.05, 0.11, 0.19])


def test_a_grid_has_all_values_of_a_laser(goal: Goal) -> None:
    found = search._grid(
        with_laser(goal, powers=(0.03, 0.01), top_frequency=60e6), "green"
    )
    assert found.power == (0.01, 0.03)
    assert found.baseline == (0.06, 0.2)
    assert found.radius == (0.01, 0.02)
    assert_allclose(found.field_of_view, np.radians([2, 4]))
    assert found.dwell == (0.03, 0.06, 0.12)
    assert found.sets == ((15e6,), (34e6,), (52e6,))
    sets = Modulation(sets=((15e6, 52e6), (34e6, 75e6)))
    assert search._grid(with_parts(goal, modulation=sets), "green").sets == sets.sets


GRID = Grid(
    baseline=(0.1,), radius=(0.01,), field_of_view=(0.03,), power=(0.01,),
    dwell=(0.03, 0.06, 0.12, 0.2, 0.3), sets=((15e6,),),
)  # fmt: skip


def starts(goal: Goal, score: Score) -> list[float]:
    """Return the dwell times of the chosen starts [s]."""
    found = search._starts(goal, GRID, score, first_choice(goal))
    return [each.dwell for each in found]


def test_a_search_starts_from_the_two_best(goal: Goal) -> None:
    sets = with_parts(goal, modulation=Modulation(sets=((15e6,),)))
    assert starts(sets, scores([5, 2, 4, 1, 3])) == [0.2, 0.06]
    # Single frequencies may be combined: those are best also without intervals.
    wrong = np.array([0.0, 0.0, 0.0, 0.5, 0.5])[:, None]
    found = starts(goal, scores([5, 2, 4, 1, 3], wrong=wrong))
    assert found == [0.06, 0.12, 0.2]
    one = with_parts(goal, modulation=Modulation(frequencies=F, most=1))
    assert starts(one, scores([5, 2, 4, 1, 3], wrong=wrong)) == [0.06, 0.12]


def test_a_search_starts_also_from_the_cheapest_that_do(goal: Goal) -> None:
    priced = with_laser(
        with_parts(goal, modulation=Modulation(sets=((15e6,),))), price=1.0
    )
    # 3 mm are asked for: the last but one is cheap and does not do.
    cost = [30.0, 20.0, 10.0, 1.0, 10.0]
    assert starts(priced, scores([1, 2, 2.5, 4, 2.4], cost)) == [0.03, 0.06, 0.3, 0.12]
    assert starts(priced, scores([4, 5, 6, 7, 8], cost)) == [0.03, 0.06]


def test_any_price_makes_a_goal_priced(goal: Goal) -> None:
    assert not search._priced(goal)
    box = LengthBox(values=(0.06, 0.2), prices=(0.0, 3.0))
    for changed in (
        with_parts(goal, price_per_channel=1.0),
        with_parts(goal, modulation=Modulation(frequencies=F, price_each=1.0)),
        with_laser(goal, price=1.0),
        with_laser(goal, price_per_watt=1.0),
        with_parts(goal, baseline=box),
        with_parts(goal, radius=box),
    ):
        assert search._priced(changed)


def test_candidates_are_ordered_by_price_if_they_do(goal: Goal) -> None:
    rows = [(2.0, 50.0), (4.0, 1.0), (1.0, 90.0), (5.0, 0.0), (3.0, 50.0)]
    made = [candidate(goal, error, cost) for error, cost in rows]
    plain = search._ordered(goal, made)
    assert [each.score.error[0, 0] * 1e3 for each in plain] == pytest.approx(
        [1, 2, 3, 4, 5]
    )
    priced = search._ordered(with_laser(goal, price=1.0), made)
    assert [each.score.error[0, 0] * 1e3 for each in priced] == pytest.approx(
        [2, 3, 1, 4, 5]
    )


def test_candidates_are_listed_once_and_have_their_worst_distance(goal: Goal) -> None:
    one, again = candidate(goal, 1.0), candidate(goal, 2.0)
    other = candidate(goal, 3.0, dwell=0.5)
    found = search._unique([one, other, again])
    assert [each.parameters.dwell for each in found] == [0.03, 0.5]
    score = scores([1.0])
    score = replace(
        score, error=np.array([[1.0, 3.0, 2.0]]), wrong=np.array([[0.2, 0.1, 0.0]])
    )
    worst = search._worst(score)
    assert worst.error.tolist() == [[3]]
    assert worst.wrong.tolist() == [[0.2]]
    result = search.SearchResult(best=(one, other), count=2)
    assert result.all_scores().error.tolist() == [[1e-3], [3e-3]]


def test_ranges_are_those_of_boxes_and_of_frequencies(goal: Goal) -> None:
    chosen = replace(first_choice(goal), frequencies=(20e6, 40e6))
    assert search._ranges(goal, chosen)[0] == []
    ranged = with_parts(
        goal, radius=LengthBox(low=0.01, high=0.03), dwell=TimeBox(low=0.1, high=0.2),
        modulation=Modulation(lowest=10e6, highest=100e6),
    )  # fmt: skip
    names, low, high = search._ranges(ranged, chosen)
    assert names == ["radius", "dwell", "frequencies.0", "frequencies.1"]
    assert low.tolist() == [0.01, 0.1, 10e6, 10e6]
    assert high.tolist() == [0.03, 0.2, 100e6, 100e6]
    slow = with_laser(ranged, top_frequency=60e6)
    assert search._ranges(slow, chosen)[2].tolist()[2:] == [60e6, 60e6]
    slower = with_laser(ranged, top_frequency=30e6)
    assert search._ranges(slower, chosen)[2].tolist()[2:] == [40e6, 40e6]
    fast = with_laser(ranged, top_frequency=200e6)
    assert search._ranges(fast, chosen)[2].tolist()[2:] == [100e6, 100e6]


def test_values_are_read_and_replaced_by_name(goal: Goal) -> None:
    chosen = replace(first_choice(goal), frequencies=(20e6, 40e6), radius=0.02)
    assert search._value(chosen, "radius") == 0.02
    assert search._value(chosen, "frequencies.1") == 40e6
    names = ["frequencies.0", "dwell", "frequencies.1"]
    changed = search._with(chosen, names, (50e6, 0.5, 30e6))
    assert changed == replace(chosen, dwell=0.5, frequencies=(30e6, 50e6))


class Bowl:
    """Judge of instruments with the least error at one radius and one frequency."""

    def __init__(self, goal: Goal, *_: Any, **__: Any) -> None:
        self.goal = goal

    def of(self, chosen: Parameters) -> Score:
        away = math.log(chosen.radius / 0.017) ** 2
        for frequency, best in zip(chosen.frequencies, (20e6, 60e6), strict=False):
            away += math.log(frequency / best) ** 2
        return scores([math.exp(away)])


@pytest.mark.parametrize("frequencies", [(15e6,), (15e6, 90e6)])
def test_refinement_finds_the_least_error_within_its_ranges(
    goal: Goal, monkeypatch: pytest.MonkeyPatch, frequencies: tuple[float, ...]
) -> None:
    ranged = with_parts(
        goal, radius=LengthBox(low=0.01, high=0.03),
        modulation=Modulation(lowest=10e6, highest=100e6),
    )  # fmt: skip
    monkeypatch.setattr(search, "Judge", Bowl)
    judge: Any = Bowl(ranged)
    start = search.candidate_of(
        judge, replace(first_choice(ranged), radius=0.012, frequencies=frequencies)
    )
    better, tried = search._refined(ranged, judge, start)
    assert 10 < tried <= 71
    assert better.merit < start.merit
    assert better.parameters.radius == pytest.approx(0.017, rel=0.05)
    assert better.parameters.frequencies[0] == pytest.approx(20e6, rel=0.1)
    assert better.merit == pytest.approx(math.log(1 / 3), abs=0.02)
    # A start at the best place stays, and without ranges nothing is tried.
    best = search.candidate_of(
        judge, replace(start.parameters, radius=0.017, frequencies=(20e6,))
    )
    assert search._refined(ranged, judge, best)[0].merit <= best.merit
    assert search._refined(goal, judge, start) == (start, 0)


def test_refinement_ends_at_the_edge_of_a_range(
    goal: Goal, monkeypatch: pytest.MonkeyPatch
) -> None:
    ranged = with_parts(goal, radius=LengthBox(low=0.02, high=0.03))
    monkeypatch.setattr(search, "Judge", Bowl)
    judge: Any = Bowl(ranged)
    start = search.candidate_of(
        judge, replace(first_choice(ranged), radius=0.028, frequencies=(20e6,))
    )
    better, _ = search._refined(ranged, judge, start)
    assert better.parameters.radius == pytest.approx(0.02, rel=2e-3)
    assert better.parameters.radius >= 0.02


@pytest.mark.parametrize("edge", [0.01, 0.03])
def test_refinement_leaves_the_edge_where_it_starts(
    goal: Goal, monkeypatch: pytest.MonkeyPatch, edge: float
) -> None:
    ranged = with_parts(goal, radius=LengthBox(low=0.01, high=0.03))
    monkeypatch.setattr(search, "Judge", Bowl)
    judge: Any = Bowl(ranged)
    start = search.candidate_of(
        judge, replace(first_choice(ranged), radius=edge, frequencies=(20e6,))
    )
    better, _ = search._refined(ranged, judge, start)
    assert better.parameters.radius == pytest.approx(0.017, rel=0.01)


class Table:
    """Judge with an error for each frequency set, and a price for each part."""

    def __init__(self, goal: Goal, errors: dict[tuple[float, ...], float]) -> None:
        self.goal, self.errors = goal, errors
        self.asked: list[Grid] = []

    def lit(self, grid: Grid, *, joint: bool) -> str:
        self.lighting = grid, joint
        return "lit"

    def score(self, grid: Grid, like: Parameters, *, lighting: Any = None) -> Score:
        self.asked.append(grid)
        chosen = [grid.parameters(k, like) for k in range(math.prod(grid.shape))]
        return scores(
            [self.errors.get(each.frequencies, 9.0) * (0.03 / each.dwell) ** 0.1
             * (1 + 0.1 * each.field_of_view) for each in chosen],
            [cost_of(self.goal, each) for each in chosen],
        )  # fmt: skip


def test_frequencies_are_exchanged_as_long_as_the_merit_improves(goal: Goal) -> None:
    errors = {(15e6,): 5.0, (15e6, 52e6): 4.0, (52e6, 75e6): 3.5, (34e6, 75e6): 3.0}
    judge: Any = Table(goal, errors)
    start = candidate(goal, 5.0)
    assert start.parameters.frequencies == (15e6,)
    found, tried = search.exchanged(goal, judge, start)
    assert found.parameters.frequencies == (34e6, 75e6)
    assert found.parameters.dwell == 0.12
    expected = 3.0 * 0.25**0.1 * (1 + 0.1 * math.radians(2))
    assert found.merit == pytest.approx(math.log(expected / 3))
    assert found.score.error.shape == (1, 1)
    # Sets of 9, 12, 12 and 12 neighbors, each with three dwell times.
    counts = [len(grid.sets) * len(grid.dwell) for grid in judge.asked]
    assert tried == sum(counts)
    assert len(counts) == 4
    assert judge.lighting[0].sets == tuple((f,) for f in F)
    assert judge.lighting[1] is False
    sets = with_parts(goal, modulation=Modulation(sets=((15e6,),)))
    assert search.exchanged(sets, judge, start) == (start, 0)
    joint = candidate(goal, 5.0, method="joint")
    search.exchanged(goal, judge, joint)
    assert judge.lighting[1] is True


def test_exchange_ends_after_twelve_steps(goal: Goal) -> None:
    tones = tuple(float(k) for k in range(1, 41))
    many = with_parts(goal, modulation=Modulation(frequencies=tones, most=1))

    class Downhill(Table):
        def score(self, grid: Grid, like: Parameters, **_: Any) -> Score:
            self.asked.append(grid)
            now = like.frequencies[0]
            return scores([
                100 - f if f <= now + 1 else 100.0
                for *_, (f,) in [(grid.parameters(k, like).frequencies,)
                                 for k in range(math.prod(grid.shape))]
            ])  # fmt: skip

    judge: Any = Downhill(many, {})
    start = candidate(many, 99.0, frequencies=(1.0,))
    found, _ = search.exchanged(many, judge, start)
    assert len(judge.asked) == 12
    assert found.parameters.frequencies == (13.0,)


def priced(goal: Goal) -> Goal:
    """Return a goal with prices of power, radius and frequencies."""
    bought = with_laser(goal, price_per_watt=1000.0)
    return with_parts(
        bought, radius=LengthBox(values=(0.01, 0.02), prices=(5.0, 50.0)),
        modulation=Modulation(frequencies=F, most=3, price_each=20.0),
    )  # fmt: skip


def test_cheaper_grids_change_one_part_to_a_lower_price(goal: Goal) -> None:
    bought = priced(goal)
    chosen = replace(
        first_choice(bought), power=0.03, radius=0.02, frequencies=(15e6, 52e6)
    )
    # 30 for the power, 50 for the radius, 20 for a second frequency.
    assert cost_of(bought, chosen) == pytest.approx(100)
    grids = list(search._cheaper_grids(bought, chosen))
    assert [(g.power, g.radius) for g in grids] == [
        ((0.01,), (0.02,)), ((0.03,), (0.01,)), ((0.03,), (0.02,))
    ]  # fmt: skip
    # The first two keep two frequencies, the last has one of them.
    for grid in grids[:2]:
        assert {len(members) for members in grid.sets} == {2}
        assert grid.sets[0] == (15e6, 52e6)
        assert len(grid.sets) == 7
    assert grids[2].sets == tuple((f,) for f in F)
    for grid in grids:
        assert grid.dwell == (0.03, 0.06, 0.12)
        assert_allclose(grid.field_of_view, np.radians([2, 4]))
    cheapest = replace(chosen, power=0.01, radius=0.01, frequencies=(15e6,))
    assert list(search._cheaper_grids(bought, cheapest)) == []


def test_of_three_frequencies_two_of_them_are_cheaper(goal: Goal) -> None:
    bought = priced(goal)
    chosen = replace(
        first_choice(bought), power=0.01, radius=0.01, frequencies=(15e6, 52e6, 75e6)
    )
    (grid,) = search._cheaper_grids(bought, chosen)
    assert grid.sets == ((15e6, 52e6), (15e6, 75e6), (52e6, 75e6))
    sets = Modulation(sets=((15e6, 52e6),), price_each=20.0)
    fixed = with_parts(bought, modulation=sets)
    dear = replace(chosen, radius=0.02, frequencies=(15e6, 52e6))
    (grid,) = search._cheaper_grids(fixed, dear)
    assert grid.sets == ((15e6, 52e6),)


def test_fields_of_view_with_prices_are_not_varied(goal: Goal) -> None:
    chosen = replace(first_choice(goal), field_of_view=0.05)
    around = search._around(goal, chosen, ((15e6,), (34e6,)))
    assert around.sets == ((15e6,), (34e6,))
    assert_allclose(around.field_of_view, [*np.radians([2]), 0.05, *np.radians([4])])
    box = goal.components.field_of_view.model_copy(update={"prices": (1.0, 2.0)})
    bought = with_parts(goal, field_of_view=box)
    assert search._around(bought, chosen, ((15e6,),)).field_of_view == (0.05,)
    assert around.baseline == grid_of(chosen).baseline


def test_the_cheapest_that_does_is_found_step_by_step(goal: Goal) -> None:
    bought = priced(goal)
    errors = {(15e6,): 2.9, (34e6,): 2.8, (15e6, 52e6): 1.0}
    judge: Any = Table(bought, errors)
    dear = Candidate(
        parameters=replace(
            first_choice(bought), power=0.03, radius=0.02, frequencies=(15e6, 52e6)
        ),
        score=scores([1.0], [100.0]),
        merit=math.log(1 / 3),
    )
    found, tried = search.cheaper(bought, judge, dear)
    # 10 for the power, 5 for the radius, and of two frequencies the better.
    assert found.score.cost[0] == pytest.approx(15)
    assert found.parameters.frequencies == (34e6,)
    assert found.parameters.dwell == 0.12
    assert tried == sum(math.prod(grid.shape) for grid in judge.asked)
    strict: Any = Table(bought, {name: 2 * error for name, error in errors.items()})
    kept, _ = search.cheaper(bought, strict, dear)
    assert kept.parameters.frequencies == (15e6, 52e6)
    assert kept.score.cost[0] == pytest.approx(35)


def test_of_equal_prices_the_better_is_taken(
    goal: Goal, monkeypatch: pytest.MonkeyPatch
) -> None:
    bought = priced(goal)
    monkeypatch.setattr(search, "_EXCHANGES", 1)
    judge: Any = Table(bought, {(15e6, 52e6): 1.0, (34e6, 52e6): 0.9})
    dear = Candidate(
        parameters=replace(
            first_choice(bought), power=0.03, radius=0.02, frequencies=(15e6, 52e6)
        ),
        score=scores([1.0], [100.0]),
        merit=math.log(1 / 3),
    )
    found, _ = search.cheaper(bought, judge, dear)
    # The small radius saves most; of its candidates the one with the least error.
    chosen = found.parameters
    assert (chosen.power, chosen.radius) == (0.03, 0.01)
    assert (chosen.frequencies, chosen.dwell) == ((34e6, 52e6), 0.12)
    assert chosen.field_of_view == pytest.approx(math.radians(2))
    assert found.merit == float(merits(bought, found.score)[0])


def test_single_frequencies_are_those_of_the_laser(goal: Goal) -> None:
    slow = with_laser(goal, top_frequency=60e6)
    assert search._single_frequencies(slow, first_choice(slow)) == F[:3]


def test_a_scan_takes_its_pixels_channels_and_frequencies(goal: Goal) -> None:
    chosen = replace(
        first_choice(goal), dwell=0.05, frequencies=F[:3], polarization="VV+VH"
    )
    assert scan_time(goal, chosen) == pytest.approx(1200 * 6 * 0.05)
    assert chosen.in_turn == 6
    assert replace(chosen, readings="at-once").in_turn == 1
    assert box_values(goal.components.dwell) == (0.03, 0.06, 0.12)
