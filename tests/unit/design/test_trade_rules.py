"""Trade-offs of an instrument: what is evaluated, what wins, and what turns it."""

from __future__ import annotations

import importlib
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from goal_parts import scores, with_laser, with_parts
from numpy.testing import assert_allclose

from amulor.design import Goal
from amulor.design.candidates import Parameters, first_choice
from amulor.design.goal import Modulation
from amulor.design.scores import Grid, Score

#: The package has a function of the same name.
trade: Any = importlib.import_module("amulor.design.trade")


class Recorded:
    """Judge that keeps its grid, with the number of each candidate as its error."""

    grids: list[Grid]

    def __init__(self, goal: Goal, laser: str, *, draws: int) -> None:
        assert (laser, draws) == ("green", 24)

    def score(self, grid: Grid, like: Parameters) -> Score:
        self.grids.append(grid)
        count = math.prod(grid.shape)
        number = np.arange(float(count))
        usable = {"output": 0.5 + (number == 1), "validity": 0.5 + (number == 2)}
        wrong = np.zeros((count, 2))
        wrong[3] = [0.0, 2e-3]
        return scores(
            count, error=np.stack([number, number + 1], 1), wrong=wrong, **usable
        )


def traded(
    goal: Goal, monkeypatch: pytest.MonkeyPatch, **changes: Any
) -> tuple[Any, Grid]:
    monkeypatch.setattr(Recorded, "grids", [], raising=False)
    monkeypatch.setattr(trade, "Judge", Recorded)
    found = trade.trade(goal, replace(first_choice(goal), **changes))
    return found, Recorded.grids[0]


def test_a_trade_has_dwell_times_from_a_quarter_to_four_times(
    goal: Goal, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, grid = traded(goal, monkeypatch, frequencies=(34e6, 75e6), dwell=0.07)
    dwells = np.sort([*np.geomspace(0.0075, 0.48, 13), 0.07])
    assert_allclose(grid.dwell, dwells)
    # Single frequencies, neighbors, and pairs with the lowest of the instrument.
    assert grid.sets == (
        (15e6,), (34e6,), (15e6, 34e6), (52e6,), (34e6, 52e6), (75e6,), (34e6, 75e6),
        (52e6, 75e6), (120e6,), (34e6, 120e6), (75e6, 120e6),
    )  # fmt: skip
    assert found.best == list(grid.dwell).index(0.07) * 11 + 6
    assert found.error.shape == found.scan_time.shape == found.top_frequency.shape
    assert found.error[:5].tolist() == [1, np.inf, np.inf, np.inf, 5]
    assert found.top_frequency[:12].tolist() == [
        15e6, 34e6, 34e6, 52e6, 52e6, 75e6, 75e6, 75e6, 120e6, 120e6, 120e6, 15e6
    ]  # fmt: skip
    # 1,200 pixels of one channel.
    assert found.scan_time[0] == pytest.approx(1200 * 0.0075)
    assert found.scan_time[2] == pytest.approx(2400 * 0.0075)


@pytest.mark.parametrize(
    ("change", "frequencies", "sets"),
    [
        ({"modulation": Modulation(frequencies=(15e6, 34e6), most=1)}, (34e6,),
         ((15e6,), (34e6,))),
        ({"modulation": Modulation(frequencies=(15e6, 34e6, 52e6))}, (34e6,),
         ((15e6,), (34e6,), (15e6, 34e6), (52e6,), (34e6, 52e6))),
        ({"modulation": Modulation(sets=((15e6,), (15e6, 90e6), (20e6, 80e6)))},
         (15e6,), ((15e6,), (20e6, 80e6))),
    ],
)  # fmt: skip
def test_a_trade_has_the_sets_that_the_goal_and_the_laser_allow(
    goal: Goal,
    monkeypatch: pytest.MonkeyPatch,
    change: dict[str, Any],
    frequencies: tuple[float, ...],
    sets: Any,
) -> None:
    slow = with_laser(with_parts(goal, **change), top_frequency=80e6)
    _, grid = traded(slow, monkeypatch, frequencies=frequencies)
    assert grid.sets == sets


def test_the_better_of_two_meets_the_goal_or_costs_or_errs_less(
    goal: Goal, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Fixed:
        def __init__(self, goal: Goal, laser: str, *, draws: int) -> None:
            assert draws == 5

        def of(self, chosen: Parameters) -> Score:
            return scores(error=np.full((1, 2), chosen.dwell))

    monkeypatch.setattr(trade, "Judge", Fixed)
    start = first_choice(goal)
    good, fair, bad = (replace(start, dwell=1e-3 * k) for k in (1, 2, 4))

    def wins(goal: Goal, best: Parameters, other: Parameters) -> bool:
        return bool(trade._wins(goal, best, other, 5))

    assert wins(goal, fair, good)
    assert not wins(goal, good, fair)
    assert wins(goal, bad, fair)
    assert not wins(goal, good, good)
    priced = with_laser(goal, price_per_watt=1000.0)
    dear = replace(good, power=0.03)
    assert wins(priced, dear, fair)
    assert not wins(priced, fair, dear)
    assert wins(priced, bad, dear)
    assert wins(with_laser(goal, price=5.0), fair, good)


def test_what_turns_the_order_soonest_comes_first(
    goal: Goal, monkeypatch: pytest.MonkeyPatch
) -> None:
    factors = iter([4.0, None, 0.5, 1.0])
    rows = [(f"part {k}", 10.0 * k, "m", None) for k in range(1, 5)]
    monkeypatch.setattr(trade, "_assumptions", lambda *_: rows)
    monkeypatch.setattr(trade, "_crossing", lambda *_: next(factors))
    found = trade.what_if(goal, first_choice(goal), first_choice(goal))
    assert [(t.label, t.value, t.unit, t.turns_at, t.factor) for t in found] == [
        ("part 4", 40, "m", 40, 1), ("part 3", 30, "m", 15, 0.5),
        ("part 1", 10, "m", 40, 4), ("part 2", 20, "m", None, None),
    ]  # fmt: skip


def test_assumptions_are_scaled_up_to_what_is_possible(goal: Goal) -> None:
    chosen = first_choice(goal)
    rows = {label: rest for label, *rest in trade._assumptions(goal, (chosen,))}
    assert list(rows) == [
        "attenuation of the water", "fluctuation of the water signal",
        "reflectance of the target", "light that passes the optics", "phase floor",
        "change of the water since the shots", "water behind the target",
        "accuracy that is asked for",
    ]  # fmt: skip
    value, unit, scaled = rows["attenuation of the water"]
    assert (value, unit) == (pytest.approx(math.sqrt(0.12)), "1/m")
    spread = scaled(100.0).waters.attenuation
    assert (spread.low, spread.high) == (20, pytest.approx(60))
    value, unit, scaled = rows["reflectance of the target"]
    assert (value, unit) == (pytest.approx(0.2), "1")
    assert scaled(3.3).targets.reflectance.high == pytest.approx(0.99)
    assert scaled(3.4) is None
    value, unit, scaled = rows["light that passes the optics"]
    assert (value, unit) == (0.3, "1")
    assert scaled(3.3).detector.optical_transmission == pytest.approx(0.99)
    assert scaled(3.4) is None
    value, unit, scaled = rows["phase floor"]
    assert (value, unit) == (pytest.approx(np.radians(0.03)), "rad")
    assert scaled(2.0).lock_in.phase_floor == pytest.approx(np.radians(0.06))
    value, unit, scaled = rows["accuracy that is asked for"]
    assert (value, unit) == (3e-3, "m")
    assert scaled(1e4).accuracy.total_error == pytest.approx(30)
    joint = replace(chosen, method="joint")
    both = [row[0] for row in trade._assumptions(goal, (chosen, joint))]
    assert "departure of the water from its model" in both
    assert "depolarization ratio of the water" not in both
