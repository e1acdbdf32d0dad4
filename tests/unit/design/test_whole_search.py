"""Whole searches among instruments whose errors are a formula, and their results."""

from __future__ import annotations

import importlib
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from goal_parts import with_parts

from amulor.design import Goal, search
from amulor.design.candidates import Parameters, cost_of, first_choice
from amulor.design.goal import LengthBox, Modulation
from amulor.design.scores import Grid, Score
from amulor.design.search import Candidate, SearchResult

#: The package has a function of the same name.
recommend: Any = importlib.import_module("amulor.design.recommend")


class Formula:
    """Judge whose errors have a closed form; a single high frequency is ambiguous."""

    made: list[tuple[Any, ...]]
    joint: list[bool]
    count: int

    def __init__(
        self, goal: Goal, laser: str, *, draws: int | None = None, distances: Any = None
    ) -> None:
        self.goal = goal
        self.made.append((laser, draws, distances))
        self.start = replace(first_choice(goal), laser=laser)

    @staticmethod
    def error(chosen: Parameters) -> float:
        """Return the error of an instrument [mm]."""
        high, low = chosen.frequencies[-1], chosen.frequencies[0]
        away = abs(math.log(high / 75e6)) + 0.01 * math.log(low / 34e6) ** 2
        away += 0.1 * (len(chosen.frequencies) - 1) + 0.02 / chosen.radius**0.1
        away *= 0.9 if chosen.laser == "blue" else 1.0
        return away * (0.12 / chosen.dwell) ** 0.5 * (0.03 / chosen.power) ** 0.2

    def lit(self, grid: Grid, *, joint: bool) -> None:
        self.joint.append(joint)

    def score(self, grid: Grid, like: Parameters, *, lighting: Any = None) -> Score:
        type(self).count += math.prod(grid.shape)
        return self._score(
            [grid.parameters(k, like) for k in range(math.prod(grid.shape))]
        )

    def of(self, chosen: Parameters) -> Score:
        return self._score([chosen])

    def _score(self, chosen: list[Parameters]) -> Score:
        single = [len(c.frequencies) == 1 and c.frequencies[0] > 20e6 for c in chosen]
        nothing = np.zeros(len(chosen))
        return Score(
            error=1e-3 * np.array([[self.error(c)] for c in chosen]),
            wrong=np.where(single, 0.5, 0.0)[:, None],
            cost=np.array([cost_of(self.goal, c) for c in chosen]),
            output=nothing, validity=nothing, time=nothing, rows=nothing, smear=nothing,
        )  # fmt: skip


@pytest.fixture
def formula(monkeypatch: pytest.MonkeyPatch) -> type[Formula]:
    monkeypatch.setattr(Formula, "made", [], raising=False)
    monkeypatch.setattr(Formula, "joint", [], raising=False)
    monkeypatch.setattr(Formula, "count", 0, raising=False)
    monkeypatch.setattr(search, "Judge", Formula)
    return Formula


@pytest.fixture
def goal(goal_text: str) -> Goal:
    """Return a goal with two lasers and five distances."""
    goal = Goal.from_text(goal_text)
    laser = goal.components.lasers[0]
    blue = laser.model_copy(update={"name": "blue", "top_frequency": 80e6})
    return with_parts(goal, lasers=(laser, blue)).model_copy(
        update={"distances": (1.0, 1.5, 2.0, 2.5, 3.0)}
    )


def test_a_search_finds_the_best_of_all_pairs(goal: Goal, formula: Any) -> None:
    found = search.search(goal)
    best = found.best[0].parameters
    assert (best.laser, best.frequencies) == ("blue", (34e6, 75e6))
    assert (best.power, best.dwell, best.radius) == (0.03, 0.12, 0.02)
    assert found.count == formula.count
    merits = [candidate.merit for candidate in found.best]
    assert merits == sorted(merits)
    assert len({candidate.parameters for candidate in found.best}) == len(found.best)
    # The grid is judged by eight draws at three distances, the best by all.
    assert formula.made == [
        ("green", None, None), ("blue", None, None), ("green", 8, [1.0, 2.0, 3.0]),
        ("blue", 8, [1.0, 2.0, 3.0]),
    ]  # fmt: skip
    assert not any(formula.joint)
    kinds = {(c.parameters.laser, c.parameters.polarization) for c in found.best}
    assert len(kinds) == 4


def test_light_of_a_joint_estimation_is_computed_with_derivatives(
    goal: Goal, formula: Any
) -> None:
    search.search(with_parts(goal, methods=("open-water", "joint")))
    # Once for each laser's grid, and for the exchanges of its own candidates.
    assert formula.joint[0]
    assert not all(formula.joint)


def test_two_distances_are_both_judged(goal: Goal, formula: Any) -> None:
    search.search(goal.model_copy(update={"distances": (1.0, 2.0)}))
    assert formula.made[2] == ("green", 8, [1.0, 2.0])


def test_a_search_of_sets_keeps_them(goal: Goal, formula: Any) -> None:
    sets = Modulation(sets=((15e6, 52e6), (34e6, 75e6), (52e6, 120e6)))
    found = search.search(with_parts(goal, modulation=sets))
    assert found.best[0].parameters.frequencies == (34e6, 75e6)
    assert {c.parameters.frequencies for c in found.best} <= set(sets.sets)
    # 2 x 2 x 2 x 2 x 3 values of each laser, with two or three sets, in two channels.
    assert found.count == formula.count == 2 * 48 * (3 + 2)


def test_with_prices_the_cheapest_that_does_is_the_best(
    goal: Goal, formula: Any
) -> None:
    box = LengthBox(values=(0.01, 0.02), prices=(1.0, 100.0))
    lasers = tuple(
        laser.model_copy(update={"price": price})
        for laser, price in zip(goal.components.lasers, (10.0, 50.0), strict=True)
    )
    priced = with_parts(goal, radius=box, lasers=lasers)
    found = search.search(priced)
    best = found.best[0]
    assert best.merit <= 0
    assert cost_of(priced, best.parameters) == 11
    assert (best.parameters.laser, best.parameters.radius) == ("green", 0.01)
    assert found.count == formula.count


def test_ranges_are_refined_in_the_best_candidates_only(
    goal: Goal, formula: Any
) -> None:
    ranged = with_parts(goal, radius=LengthBox(low=0.01, high=0.03, count=2))
    found = search.search(ranged)
    refined = [c for c in found.best if c.parameters.radius not in (0.01, 0.03)]
    assert found.best[0].parameters.radius == pytest.approx(0.03, rel=1e-3)
    assert len(refined) <= 2
    # Two candidates are refined, each judged by 24 draws.
    assert [draws for _, draws, _ in formula.made].count(24) == 2
    assert found.count > formula.count


@pytest.mark.parametrize(("merit", "possible"), [(0.0, True), (1e-3, False)])
def test_what_just_meets_a_goal_lacks_nothing(
    goal: Goal, monkeypatch: pytest.MonkeyPatch, merit: float, possible: bool
) -> None:
    score = Score(
        error=np.array([[1e-3]]), wrong=np.zeros((1, 1)),
        **{name: np.zeros(1) for name in
           ("output", "validity", "time", "rows", "smear", "cost")},
    )  # fmt: skip
    made = Candidate(parameters=first_choice(goal), score=score, merit=merit)
    result = SearchResult(best=(made,), count=17)
    monkeypatch.setattr(recommend, "search", lambda _: result)
    monkeypatch.setattr(recommend, "_choice", lambda _, candidate: candidate)
    monkeypatch.setattr(recommend.requirements, "shortfalls", lambda *_: ("more",))
    steps: list[tuple[str, float]] = []
    found = recommend.recommend(goal, progress=lambda *step: steps.append(step))
    assert found.impossible == (() if possible else ("more",))
    assert found.best is made
    assert found.runner_up is None
    assert found.looked_at == 17
    assert found.goal is goal
    assert found.candidates.sizes["candidate"] == 1
    assert steps == [("reasons", 0.98)]
