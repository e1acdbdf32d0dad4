"""Rules of a recommendation: bounds, tables, the runner-up, and its figures."""

from __future__ import annotations

import importlib
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from goal_parts import scores, with_laser, with_parts
from numpy.testing import assert_allclose

from amulor.design import Goal
from amulor.design.candidates import first_choice, scan_time
from amulor.design.evaluate import TERMS
from amulor.design.goal import LengthBox, Modulation
from amulor.design.requirements import Requirement, table
from amulor.design.search import Candidate, SearchResult
from amulor.design.sensitivity import Sensitivity, Uncertain
from amulor.survey import Survey

#: The package has a function of the same name.
recommend: Any = importlib.import_module("amulor.design.recommend")


def sides(goal: Goal, **changes: Any) -> set[tuple[str, str]]:
    """Return the parameters of an instrument at an edge, and the sides."""
    inside = {
        "power": 0.02, "baseline": 0.1, "radius": 0.015, "field_of_view": 0.05,
        "dwell": 0.05, "frequencies": (34e6, 75e6),
    }  # fmt: skip
    chosen = replace(first_choice(goal), **(inside | changes))
    return {(b.parameter, b.side) for b in recommend._bounds(goal, chosen)}


def test_an_instrument_within_all_ranges_is_at_no_bound(goal: Goal) -> None:
    assert sides(goal) == set()


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("power", 0.01, 0.03), ("baseline", 0.06, 0.2), ("radius", 0.01, 0.02),
        ("dwell", 0.03, 0.12),
    ],
)  # fmt: skip
def test_a_parameter_within_a_five_hundredth_of_an_edge_is_at_it(
    goal: Goal, name: str, low: float, high: float
) -> None:
    for edge, side in ((low, "low"), (high, "high")):
        for off in (-0.0019, 0.0019):
            assert sides(goal, **{name: edge * (1 + off)}) == {(name, side)}
        for off in (-0.0021, 0.0021):
            assert sides(goal, **{name: edge * (1 + off)}) == set()


def test_a_bound_is_told_with_its_value(goal: Goal) -> None:
    chosen = replace(first_choice(goal), power=0.03, baseline=0.1, radius=0.015,
                     field_of_view=0.05, dwell=0.03, frequencies=(34e6,))  # fmt: skip
    power, dwell = recommend._bounds(goal, chosen)
    assert power.text == (
        "power is the highest that the goal allows (30 mW): a bound, not a "
        "recommendation; the best value may lie beyond"
    )
    assert power.value == 0.03
    assert dwell.text.startswith("dwell is the lowest that the goal allows (30 ms)")


def test_frequencies_are_bound_by_grid_and_laser(goal: Goal) -> None:
    lowest, highest = ("lowest frequency", "low"), ("highest frequency", "high")
    assert sides(goal, frequencies=(15e6, 75e6)) == {lowest}
    assert sides(goal, frequencies=(34e6, 120e6)) == {highest}
    alone = sides(goal, frequencies=(120e6,))
    assert alone == {highest, ("lowest frequency", "high")}
    assert sides(goal, frequencies=(120e6, 120.1e6)) == {highest}
    both_low = sides(goal, frequencies=(15e6,))
    assert both_low == {lowest, ("highest frequency", "low")}
    slow = with_laser(goal, top_frequency=80e6)
    assert sides(slow, frequencies=(34e6, 80e6)) == {highest}
    assert sides(slow, frequencies=(34e6, 75e6)) == set()
    sets = with_parts(goal, modulation=Modulation(sets=((15e6, 120e6),)))
    assert sides(sets, frequencies=(15e6, 120e6)) == set()
    # One value is no range.
    single = with_parts(goal, baseline=LengthBox(values=(0.1,)))
    assert sides(single) == set()


def candidates(goal: Goal, *changes: dict[str, Any]) -> list[Candidate]:
    return [
        Candidate(
            parameters=replace(first_choice(goal), **change),
            score=scores(error=np.array([[1e-3 * (k + 1), 5e-3]]),
                         wrong=np.array([[0.1 * k, 0.05]]),
                         time=np.array([60.0 + k]), cost=np.array([10.0 * k])),
            merit=float(k),
        )
        for k, change in enumerate(changes)
    ]  # fmt: skip


def test_candidates_are_a_table_with_units(goal: Goal) -> None:
    made = candidates(
        goal, {"frequencies": (15e6, 34e6)}, {"frequencies": (52e6,), "radius": 0.02}
    )
    found = recommend._table(goal, SearchResult(best=tuple(made), count=9))
    assert dict(found.sizes) == {"candidate": 2, "frequency_number": 2}
    assert_allclose(found["modulation_frequency"], [[15e6, 34e6], [52e6, np.nan]])
    assert found["radius"].values.tolist() == [0.01, 0.02]
    assert found["laser"].values.tolist() == ["green", "green"]
    assert found["error"].values.tolist() == [5e-3, 5e-3]
    assert found["wrong_interval"].values.tolist() == [0.05, 0.1]
    assert found["scan_time"].values.tolist() == [60, 61]
    assert found["cost"].values.tolist() == [0, 10]
    assert found["merit"].values.tolist() == [0, 1]
    units = {name: found[name].attrs["units"] for name in found if found[name].attrs}
    assert units == {
        "power": "W", "baseline": "m", "radius": "m", "field_of_view": "rad",
        "dwell": "s", "error": "m", "wrong_interval": "1", "scan_time": "s",
        "cost": "1", "merit": "1", "modulation_frequency": "Hz",
    }  # fmt: skip
    assert found.attrs == {"title": "Tank"}
    row = recommend._plain_row(found.isel(candidate=1))
    assert row["frequencies"] == [52e6]
    assert row["cost"] == 10
    many = candidates(goal, *[{"dwell": 0.1 * k} for k in range(1, 61)])
    long = recommend._table(goal, SearchResult(best=tuple(many), count=9))
    assert long.sizes["candidate"] == 50


def test_the_runner_up_is_of_another_kind(goal: Goal) -> None:
    best = {"frequencies": (15e6, 34e6)}
    for change in (
        {"laser": "blue"}, {"polarization": "VV"}, {"method": "joint"},
        {"frequencies": (15e6,)}, {"readings": "at-once"},
    ):  # fmt: skip
        made = candidates(goal, best, best | {"dwell": 0.5}, best | change)
        found = recommend._runner_up(SearchResult(best=tuple(made), count=3))
        assert found is made[2]
    made = candidates(goal, best, best | {"dwell": 0.5}, best | {"dwell": 0.6})
    assert recommend._runner_up(SearchResult(best=tuple(made), count=3)) is made[1]
    assert recommend._runner_up(SearchResult(best=tuple(made[:1]), count=1)) is None


def test_infinite_numbers_are_none_in_plain_values() -> None:
    found = recommend.finite(
        {"a": math.inf, "b": [1.0, math.nan, (2, "x")], "c": {"d": -math.inf, "e": 3}}
    )
    assert found == {"a": None, "b": [1.0, None, [2, "x"]], "c": {"d": None, "e": 3}}


def test_the_error_between_distances_is_that_of_the_required_share(goal: Goal) -> None:
    values = np.array([[1.0, 2, 3, 4], [1, 1, 1, 9], [2, 4, 6, 8]])
    errors = xr.DataArray(
        values, dims=("distance", "draw"), coords={"distance": [1.0, 2.0, 3.0]}
    )
    accuracy = goal.accuracy.model_copy(update={"share": 0.75})
    found = recommend._between(goal.model_copy(update={"accuracy": accuracy}), errors)
    assert (found.distance, found.error) == (3, 6)
    every = goal.accuracy.model_copy(update={"share": 1.0})
    found = recommend._between(goal.model_copy(update={"accuracy": every}), errors)
    assert (found.distance, found.error) == (2, 9)


def test_errors_are_asked_for_at_and_between_the_distances(
    goal: Goal, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, Any] = {}

    def evaluate(survey: Any, **axes: Any) -> xr.Dataset:
        asked.update(axes, survey=survey)
        return xr.Dataset({"total_error": ("distance", axes["distance"])})

    monkeypatch.setattr(recommend, "evaluate", evaluate)
    three = goal.model_copy(update={"distances": (1.5, 1.9, 2.5)})
    found = recommend._errors(three, first_choice(goal), "survey")
    assert found.sizes["draw"] == 1
    assert_allclose(asked["distance"], [*np.linspace(1.5, 2.5, 41)])
    odd = goal.model_copy(update={"distances": (1.5, 1.901, 2.5)})
    recommend._errors(odd, first_choice(goal), "survey")
    assert asked["distance"].size == 42
    assert asked["interval"] == (0.5, 4)
    assert asked["wrong_interval"] == 0.001
    assert asked["method"] == "open-water"
    assert (asked["texture"], asked["water_change"]) == (0, 0.01)
    assert asked["attenuation"].sizes == {"draw": 8}


def chosen_errors(distances: tuple[float, ...]) -> xr.Dataset:
    """Return errors of four draws, of which one misses and one is flagged."""
    names = [name for name in TERMS if name != "saturation"]
    shape = (len(distances), 4)
    base = np.arange(1.0, 5.0) * np.ones(shape)
    variables = {
        name: (("distance", "draw"), 1e-4 * (k + 1) * base)
        for k, name in enumerate(names)
    }
    total = np.full(shape, 2e-3)
    total[1, 0] = 4e-3
    flags = {name: np.zeros(shape, int) for name in
             ("ambiguous", "saturated", "model_not_valid")}  # fmt: skip
    flags["saturated"][0, 2] = 1
    codes = np.zeros(shape, int)
    codes[1] = [3, 2, 3, 1]
    variables |= {name: (("distance", "draw"), value) for name, value in flags.items()}
    variables["total_error"] = (("distance", "draw"), total)
    variables["binding_term"] = (("distance", "draw"), codes)
    return xr.Dataset(variables, coords={"distance": list(distances)})


def test_a_choice_has_the_figures_of_its_worst_distance(
    goal: Goal, monkeypatch: pytest.MonkeyPatch
) -> None:
    errors = chosen_errors((1.5, 2.5))
    monkeypatch.setattr(recommend, "_errors", lambda *_: errors)
    monkeypatch.setattr(recommend, "dwell_shares", lambda *_: None)
    score = scores(error=np.array([[1e-3, 2.5e-3]]))
    made = Candidate(parameters=first_choice(goal), score=score, merit=0.0)
    found = recommend._choice(goal, made)
    assert (found.error, found.worst_distance) == (2.5e-3, 2.5)
    assert found.binding == TERMS[3]
    assert found.share == 0.5
    names = [name for name in TERMS if name != "saturation"]
    assert list(found.terms) == names
    assert_allclose(
        list(found.terms.values()), [2.5e-4 * (k + 1) for k in range(len(names))]
    )
    assert found.scan_time == scan_time(goal, first_choice(goal))
    assert (found.cost, found.lines, found.shares) == (0, None, None)
    assert found.between.error == pytest.approx(4e-3)
    assert Survey.from_text(found.survey).name == "Tank"
    assert found.met
    missed = replace(
        found,
        requirements=(*found.requirements, replace(found.requirements[0], met=False)),
    )
    assert not missed.met
    assert missed.to_dict()["met"] is False


def test_divided_dwells_are_judged_by_their_phase_errors(
    goal: Goal, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[Any, ...]] = []
    chances = iter([0.0, 9e-4, 1.0, 0.0, 1.1e-3, 1.0])

    def astray(*arguments: Any) -> tuple[float, float]:
        asked.append(arguments)
        return next(chances), 0.0

    monkeypatch.setattr(recommend, "astray", astray)
    accuracy = goal.accuracy.model_copy(update={"share": 0.6})
    most = goal.model_copy(update={"accuracy": accuracy})
    chosen = replace(first_choice(goal), frequencies=(15e6, 52e6))
    rng = np.random.default_rng(1)
    variance, bias = rng.uniform(1e-7, 2e-7, (2, 2, 3, 2, 3))
    found = recommend._error(most, chosen, 1.36, variance, bias, (2, 0))
    # Two of three draws count: 0.9 of a thousandth is allowed, 1.1 at 2.5 m is not.
    assert math.isinf(found)
    assert len(asked) == 6
    to_range, phase, extra, distance, near, far = asked[1]
    per_phase = 299792458.0 / (4 * np.pi * 1.36 * np.array([15e6, 52e6]))
    assert_allclose(to_range, per_phase)
    expected = [variance[0, 2, 0, 1] + bias[0, 2, 0, 1] ** 2,
                variance[1, 0, 0, 1] + bias[1, 0, 0, 1] ** 2]  # fmt: skip
    assert_allclose(phase, expected / per_phase**2)
    assert (extra, distance, near, far) == (0, 1.5, 0.5, 4)
    assert [call[3] for call in asked] == [1.5] * 3 + [2.5] * 3


def test_requirements_are_a_table_over_the_distances(goal: Goal) -> None:
    score = scores(
        error=np.array([[1e-3, 3.1e-3]]), wrong=np.array([[0.0, 5e-4]]),
        output=np.array([0.25]), validity=np.array([0.5]), time=np.array([240.0]),
    )  # fmt: skip
    made = Candidate(parameters=first_choice(goal), score=score, merit=0.0)
    rows = table(goal, made, chosen_errors((1.5, 2.5)))
    assert rows == (
        Requirement(name="total error at 1.5 m", met=True, value=1e-3, limit=3e-3,
                    margin=3e-3 / 1e-3, unit="m", binding=TERMS[0]),
        Requirement(name="wrong interval at 1.5 m", met=True, value=0.0, limit=1e-3,
                    margin=np.inf, unit="1", binding="ambiguity"),
        Requirement(name="total error at 2.5 m", met=False, value=3.1e-3, limit=3e-3,
                    margin=3e-3 / 3.1e-3, unit="m", binding=TERMS[3]),
        Requirement(name="wrong interval at 2.5 m", met=True, value=5e-4, limit=1e-3,
                    margin=1e-3 / 5e-4, unit="1", binding="ambiguity"),
        Requirement(name="detector output", met=True, value=0.25, limit=1.0,
                    margin=4.0, unit="1", binding="saturation"),
        Requirement(name="validity of the model", met=True, value=0.5, limit=1.0,
                    margin=2.0, unit="1", binding=""),
        Requirement(name="scan time", met=True, value=240.0, limit=240.0, margin=1.0,
                    unit="s", binding=""),
    )  # fmt: skip


def test_the_largest_share_is_listed_first() -> None:
    numbers = tuple(
        Uncertain(axis=name, label=name, low=0, high=1, stated=True) for name in "abc"
    )
    found = Sensitivity(
        numbers=numbers, total=np.array([0.2, 0.7, 0.1]), spread=0.4,
        total_error=np.array([0.01, 0.02, 0.03]), first=np.array([0.1, 0.6, 0.05]),
        first_error=np.array([0.04, 0.05, 0.06]),
    )  # fmt: skip
    assert found.largest.axis == "b"
    plain = found.to_dict()
    assert plain["spread_of_logarithm"] == 0.4
    assert [row["axis"] for row in plain["numbers"]] == ["b", "a", "c"]
    assert plain["numbers"][0] == {
        "axis": "b", "label": "b", "low": 0, "high": 1, "stated": True, "total": 0.7,
        "total_error": 0.02, "first": 0.6, "first_error": 0.05,
    }  # fmt: skip
