"""Goal files: read strictly, drawn evenly, and turned into surveys that hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from amulor.design import Goal, json_schema
from amulor.design.candidates import (
    drawn,
    first_choice,
    scan_time,
    survey_of,
    values_at,
)
from amulor.design.goal import CoefficientSpread, FractionSpread
from amulor.errors import SurveyError
from amulor.survey import Survey

EXAMPLES = Path(__file__).parents[3] / "examples" / "goals"


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.toml")), ids=lambda f: f.name)
def test_the_examples_are_goals_whose_surveys_are_read_back(file: Path) -> None:
    goal = Goal.from_toml(file)
    chosen = first_choice(goal)
    survey = survey_of(goal, chosen)
    assert Survey.from_text(survey.to_toml()) == survey
    assert scan_time(goal, chosen) > 0
    assert goal.limits[0] <= goal.asked[0] <= goal.asked[-1] < goal.limits[1]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("most = 2", "most = 2\nleast = 1", "modulation.least: is no field of a goal"),
        ('"3 mm"', "3", "a number without a unit"),
        ('longest = "4 min"', "", "scan.longest: is missing"),
        ('"VV"]', '"XY"]', "components.polarizations"),
        ('low = "0.2 1/m"', 'low = "2 1/m"', "must not exceed high"),
        ('farthest = "4 m"', 'farthest = "2 m"', "distances holds 2.5 m"),
        ('values = ["6 cm", "20 cm"]', 'low = "6 cm"', "low and high are needed"),
        ('values = ["1 cm", "2 cm"]', 'values = ["2 cm", "1 cm"]', "must increase"),
        ("most = 2", 'lowest = "1 MHz"', "one of these"),
        ('"open-water"]', '"subtraction"]', "it must be 'none'"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(old, new, said, goal_text: str) -> None:
    assert old in goal_text
    with pytest.raises(SurveyError, match=said) as raised:
        Goal.from_text(goal_text.replace(old, new, 1), name="tank.toml")
    message = str(raised.value)
    assert message.startswith("tank.toml: ")
    assert len(message.splitlines()) == 1


def test_the_schema_names_every_part() -> None:
    schema = json_schema()
    assert ">>>" not in str(schema)
    assert schema["title"] == "amulor design goal"
    assert set(Goal.model_fields) == set(schema["properties"])


def test_draws_follow_their_distributions_and_are_the_same_each_time(
    goal_text: str,
) -> None:
    goal = Goal.from_text(goal_text.replace("draws = 8", "draws = 256"))
    first, again = drawn(goal), drawn(goal)
    assert set(first) == {"attenuation", "fluctuation", "reflectance"}
    for name, values in first.items():
        np.testing.assert_array_equal(values, again[name])
    # Even spreads of 256 points have a Kolmogorov distance far below chance's 0.085.
    logs = np.log(first["attenuation"] / 0.2) / np.log(3)
    assert stats.kstest(logs, "uniform").statistic < 0.02
    assert len(drawn(goal, 8)["reflectance"]) == 8


def test_low_and_high_hold_95_percent_of_a_normal_distribution() -> None:
    spread = CoefficientSpread(distribution="normal", low=1.0, high=2.0)
    share = np.array([0.025, 0.5, 0.975, 0.0, 1.0])
    # Cut off at twice as far out, which moves the quantiles by less than a thousandth.
    expected = [1.0, 1.5, 2.0, 0.5, 2.5]
    np.testing.assert_allclose(values_at(spread, share), expected, atol=2e-3)
    fraction = FractionSpread(distribution="normal", low=0.8, high=1.0)
    assert values_at(fraction, np.array([1.0])) == 1.0
