"""Sobol indices of the error say what plain statistics say of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import paper_goal
import pytest
import xarray as xr

from amulor.design import evaluate
from amulor.design import sensitivity as module
from amulor.design.candidates import survey_of
from amulor.design.sensitivity import sensitivity, uncertain


def test_what_is_stated_as_a_range_and_what_is_assumed() -> None:
    found = uncertain(paper_goal.choice().goal, paper_goal.choice().best.parameters)
    stated = {one.axis: (one.low, one.high) for one in found if one.stated}
    assert stated == {"attenuation": (0.75, 0.95), "reflectance": (0.08, 0.12)}
    assumed = {one.axis: one.high / one.low for one in found if not one.stated}
    # Open-water shots rest on the water staying as it is, not on depolarization.
    assert set(assumed) == {
        "power", "phase_floor", "dark_rate", "water_change", "column_uncertainty"
    }  # fmt: skip
    assert all(factor == pytest.approx(4) for factor in assumed.values())


@pytest.mark.slow
def test_shares_are_those_of_conditional_means() -> None:
    goal, chosen = paper_goal.choice().goal, paper_goal.choice().best.parameters
    found = sensitivity(goal, chosen, samples=256)
    share = dict(zip([one.axis for one in found.numbers], found.total, strict=True))
    error = dict(
        zip([one.axis for one in found.numbers], found.total_error, strict=True)
    )
    # By hand: on a grid of both ranges, the variance of the mean of the logarithm over
    # the other number; both act alone here, and nothing else matters by a per cent.
    survey = survey_of(goal, chosen)
    middle = (np.arange(24) + 0.5) / 24
    grid = evaluate(
        survey,
        distance=np.array(goal.asked),
        attenuation=0.75 + 0.2 * middle,
        reflectance=0.08 + 0.04 * middle,
        method=chosen.method,
        interval=goal.limits,
        **goal.assumptions.model_dump(),
    )["total_error"]
    logarithm = np.log(grid.max("distance"))
    for axis, other in (("attenuation", "reflectance"), ("reflectance", "attenuation")):
        expected = float(logarithm.mean(other).var() / logarithm.var())
        assert share[axis] == pytest.approx(expected, abs=4 * error[axis] + 0.02)
    rest = [value for axis, value in share.items() if axis not in logarithm.dims]
    assert max(rest) < 0.05
    assert found.spread == pytest.approx(float(logarithm.std()), rel=0.1)
    assert found.largest.axis in logarithm.dims
    table = found.to_dict()["numbers"]
    assert [one["total"] for one in table] == sorted(share.values(), reverse=True)


def test_the_same_each_time() -> None:
    goal, chosen = paper_goal.choice().goal, paper_goal.choice().best.parameters
    first, second = (sensitivity(goal, chosen, samples=16) for _ in range(2))
    np.testing.assert_array_equal(first.total, second.total)
    np.testing.assert_array_equal(first.total_error, second.total_error)


def test_water_of_another_laser_is_drawn_in_proportion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn = []

    def evaluated(survey: Any, **named: Any) -> dict[str, xr.DataArray]:
        drawn.append(named["attenuation"].values)
        # The error is the attenuation.
        return {"total_error": named["attenuation"].expand_dims(distance=2)}

    monkeypatch.setattr(module, "evaluate", evaluated)
    monkeypatch.setattr(module, "water_scale", lambda *_: {"attenuation": 2.0})
    goal, chosen = paper_goal.choice().goal, paper_goal.choice().best.parameters
    found = sensitivity(goal, chosen, samples=64)
    values = np.concatenate(drawn)
    # 0.75 1/m to 0.95 1/m for the first laser.
    assert 1.5 < values.min() < 1.51
    assert 1.89 < values.max() < 1.9
    assert found.largest.axis == "attenuation"


def test_a_goal_without_a_range_has_no_sensitivity(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "uncertain", lambda *_: ())
    unknown: Any = None
    with pytest.raises(ValueError, match="nothing is uncertain: the goal states no"):
        sensitivity(unknown, unknown)
