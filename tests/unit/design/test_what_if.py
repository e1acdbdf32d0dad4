"""Where the runner-up wins: the value that is stated turns the order."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import paper_goal
import pytest

from amulor.design import Goal, Parameters, recommend
from amulor.design.candidates import box_values, scan_time
from amulor.design.scores import Judge, merits
from amulor.design.trade import _assumptions, trade, what_if


def _merit(goal: Goal, chosen: Parameters, draws: int) -> float:
    score = Judge(goal, chosen.laser, draws=draws).of(chosen)
    return float(merits(goal, score)[0])


@pytest.mark.study
def test_more_light_wins_where_the_optics_lose_it() -> None:
    start = paper_goal.goal()
    # 39 MHz turns a phase into a shorter range than 36.8 MHz; with little light the
    # shot noise of a quarter of the power weighs more than that.
    best = replace(paper_goal.choice().best.parameters, power=4e-4)
    other = replace(best, power=1.6e-3, frequencies=(36.8e6,))
    turns = {one.label: one for one in what_if(start, best, other, draws=8)}
    found = turns["light that passes the optics"]
    assert found.value == 0.1
    assert found.factor is not None
    assert found.factor < 1
    assert found.turns_at == pytest.approx(0.1 * found.factor)
    for factor, wins in ((found.factor, True), (found.factor * 1.2, False)):
        optics = start.detector.model_copy(
            update={"optical_transmission": 0.1 * factor}
        )
        scaled = start.model_copy(update={"detector": optics})
        assert (_merit(scaled, other, 8) < _merit(scaled, best, 8)) == wins


@pytest.mark.study
def test_the_accuracy_that_one_cannot_meet_turns_the_order() -> None:
    """With prices the cheaper one wins as long as it meets what is asked."""
    start = paper_goal.goal()
    laser = start.components.lasers[0]
    cheap = laser.model_copy(update={"name": "cheap", "powers": (2e-3,), "price": 10.0})
    dear = laser.model_copy(update={"name": "dear", "price": 100.0})
    parts = start.components.model_copy(update={"lasers": (cheap, dear)})
    goal = start.model_copy(update={"components": parts})
    found = recommend(goal)
    assert found.best.parameters.laser == "cheap"
    dearer = replace(found.best.parameters, laser="dear", power=20e-3)
    turns = {
        one.label: one for one in what_if(goal, found.best.parameters, dearer, draws=64)
    }
    turn = turns["accuracy that is asked for"]
    # The cheap one loses where its own error is no longer allowed.
    assert turn.turns_at == pytest.approx(found.best.error, rel=0.05)


def test_a_trade_holds_the_recommended_one() -> None:
    paper_choice = paper_goal.choice()
    goal, best = paper_choice.goal, paper_choice.best
    found = trade(goal, best.parameters, draws=64)
    assert found.error[found.best] == pytest.approx(best.error, rel=1e-5)
    assert found.scan_time[found.best] == pytest.approx(best.scan_time)
    assert found.top_frequency[found.best] == best.parameters.frequencies[-1]
    # The sets that the goal states, and no other; longer dwells are not worse.
    assert set(found.top_frequency) == {36.8e6, 39e6, 138e6}
    own = found.top_frequency == 39e6
    assert np.all(np.diff(found.error[own]) <= 1e-9)
    # Dwell times beyond those of the goal, on both sides.
    box = box_values(goal.components.dwell)
    times = [
        scan_time(goal, replace(best.parameters, dwell=dwell))
        for dwell in (0.5 * box[0], 2 * box[-1])
    ]
    assert found.scan_time[own].min() < times[0]
    assert found.scan_time[own].max() > times[1]


def test_all_that_a_goal_states_is_an_assumption(goal_text: str) -> None:
    goal = Goal.from_text(goal_text)
    rows = {label: row for label, *row in _assumptions(goal, ())}
    stated = {
        "attenuation of the water": (math.sqrt(0.2 * 0.6), "1/m"),
        "fluctuation of the water signal": (0.03, "1"),
        "reflectance of the target": (0.2, "1"),
        "light that passes the optics": (0.3, "1"),
        "accuracy that is asked for": (3e-3, "m"),
    }
    assert rows.keys() >= stated.keys()
    for label, (value, unit) in stated.items():
        found, found_unit, scaled = rows[label]
        assert found == pytest.approx(value)
        assert found_unit == unit
        changed = scaled(1.5)
        assert changed is not None
        again = {name: at for name, at, *_ in _assumptions(changed, ())}
        assert again[label] == pytest.approx(1.5 * value)
    # Reflectances above 1 do not exist; the widest of the goal is 0.3.
    assert rows["reflectance of the target"][2](3.4) is None
    assert rows["reflectance of the target"][2](3.3) is not None
