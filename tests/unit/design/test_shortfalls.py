"""Requirements that no candidate meets, and light that analyzers pass."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.design import Goal, trade
from amulor.design.candidates import first_choice
from amulor.design.light import case_of
from amulor.design.numbers import _fractions
from amulor.design.recommend import _error
from amulor.design.requirements import shortfalls
from amulor.design.scores import Judge, Score
from amulor.design.search import Candidate
from amulor.optics.polarization import mueller
from amulor.survey import Survey, water_properties


@pytest.fixture(scope="module")
def plain(goal: Goal) -> Score:
    """Return the score of one candidate."""
    chosen = first_choice(goal)
    return Judge(goal, chosen.laser, draws=2).of(chosen)


def made(goal: Goal, plain: Score, rows: list[dict[str, float]]) -> Score:
    """Scores that meet all, but for the stated ratios to what is asked."""
    ask: dict[str, float] = {
        "error": goal.accuracy.total_error, "wrong": goal.accuracy.wrong_interval,
        "output": 1.0, "validity": 1.0, "time": goal.scan.longest,
    }  # fmt: skip
    scores = []
    for row in rows:
        changed = {
            name: np.full_like(getattr(plain, name), 0.5 * limit)
            for name, limit in ask.items()
        }
        for name, ratio in row.items():
            # At one distance only, where there are several.
            changed[name][..., -1] = ratio * ask[name]
        scores.append(replace(plain, **changed))
    return Score.joined(scores)


def best_of(goal: Goal, score: Score) -> Candidate:
    first = score.part(np.array([0]))
    return Candidate(parameters=first_choice(goal), score=first, merit=1.0)


def test_what_suffices_alone_is_listed_from_the_least(goal: Goal, plain: Score) -> None:
    score = made(
        goal,
        plain,
        [
            {"error": 2.0},
            {"wrong": 3.0},
            {"error": 1.7},
            {"time": 1.5, "error": 1.2},
            {"output": math.inf},
        ],
    )
    found = shortfalls(goal, best_of(goal, score), score)
    total, interval = found
    assert (total.requirement, interval.requirement) == (
        "total error", "wrong interval",
    )  # fmt: skip
    assert (total.alone, interval.alone) == (True, True)
    assert total.factor == pytest.approx(1.7)
    assert interval.factor == pytest.approx(3.0)
    assert total.limit == goal.accuracy.total_error
    assert total.value == pytest.approx(1.7 * goal.accuracy.total_error)
    assert interval.value == pytest.approx(3 * goal.accuracy.wrong_interval)
    assert (total.unit, interval.unit) == ("m", "1")
    allowed = f"{1e3 * goal.accuracy.total_error:.3g} mm"
    relaxed = f"{1.7e3 * goal.accuracy.total_error:.3g} mm"
    assert total.text == (
        f"total error: {relaxed} in place of {allowed} (1.7 times) would do alone"
    )


def test_without_a_single_remedy_the_best_tells_all_it_misses(
    goal: Goal, plain: Score
) -> None:
    rows = [
        {"time": 1.5, "error": 1.2, "wrong": 1.0},
        {"validity": 4.0, "output": 2.0},
    ]
    score = made(goal, plain, rows)
    found = shortfalls(goal, best_of(goal, score), score)
    listed = {each.requirement: each for each in found}
    assert listed.keys() == {"total error", "scan time"}
    assert not any(each.alone for each in found)
    time = listed["scan time"]
    assert time.unit == "s"
    assert time.factor == pytest.approx(1.5)
    assert time.value == pytest.approx(1.5 * goal.scan.longest)
    assert time.text.endswith("(1.5 times) is missed, and others with it")


@pytest.mark.parametrize("surface", ["target", "water"])
@pytest.mark.parametrize("kept", [0.0, 0.35, 1.0])
@pytest.mark.parametrize("stated", [(0.7, -0.7, -0.4), (0.0, 0.0, 0.0)])
def test_analyzers_pass_what_a_scaled_surface_sends(
    tank: Survey, surface: str, kept: float, stated: Any
) -> None:
    path = "targets.0.mueller" if surface == "target" else "water.backscatter_mueller"
    survey = tank.with_({path: list(stated)})
    case = case_of(survey, water_properties(survey))
    pairs = ("VV", "VH", "RR", "RL", "none")
    # All other elements in proportion; a surface that keeps nothing, as a mirror.
    shape = np.array(stated) / stated[0] if stated[0] else np.array([1.0, -1.0, -1.0])
    scaled = np.diag([1.0, *(kept * shape)])
    expected = [float(mueller.detected_fraction(scaled, pair=pair)) for pair in pairs]
    by_axis = {f"{surface}_m22": np.array([kept, kept])}
    found = _fractions(case, by_axis, pairs, surface, lambda value: value + np.zeros(2))
    assert_allclose(found, [expected, expected], atol=1e-12)
    # As the survey states it where the share is no axis.
    bare = _fractions(case, {}, pairs, surface, lambda value: value + np.zeros(2))
    own = np.diag([1.0, *stated])
    expected = [float(mueller.detected_fraction(own, pair=pair)) for pair in pairs]
    assert_allclose(bare, [expected, expected], atol=1e-12)


def test_the_error_of_divided_dwell_is_that_of_a_weighted_mean(goal: Goal) -> None:
    chosen = replace(first_choice(goal), frequencies=(15e6, 52e6))
    rng = np.random.default_rng(4)
    places, draws, divisions = len(goal.asked), 7, 3
    shape = (2, divisions, places, draws)
    variance = rng.uniform(0.5e-6, 2e-6, shape)
    bias = rng.normal(0.0, 1e-3, shape)
    dwell = (2, 0)
    index = 1.36
    found = _error(goal, chosen, index, variance, bias, dwell)
    # The mean of both ranges by their variances; biases of one sign add up.
    errors = np.empty((places, draws))
    for place, draw in np.ndindex(places, draws):
        var = np.array([variance[k, dwell[k], place, draw] for k in range(2)])
        off = np.array([bias[k, dwell[k], place, draw] for k in range(2)])
        weight = (1 / var) / (1 / var).sum()
        errors[place, draw] = math.hypot(
            math.sqrt((weight**2 * var).sum()), (weight * off).sum()
        )
    # The smallest error that the asked share of waters keeps, at the worst place.
    count = next(n for n in range(1, 8) if n / draws >= goal.accuracy.share - 1e-9)
    expected = max(sorted(row)[count - 1] for row in errors)
    assert found == pytest.approx(expected, rel=1e-9)
    # With errors of a metre an interval is wrong too often.
    assert _error(goal, chosen, index, 1e6 * variance, bias, dwell) == math.inf


def test_what_is_absent_is_no_assumption(goal: Goal) -> None:
    detector = goal.detector.model_copy(update={"dark_rate": 0.0})
    dark = goal.model_copy(update={"detector": detector, "daylight": None})
    labels = {label for label, *_ in trade._assumptions(dark, (first_choice(goal),))}
    assert "light that passes the optics" in labels
    assert labels.isdisjoint({"dark counts", "daylight"})
