"""Plans of open-water shots are judged by what rejection makes of such shots."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from amulor.rejection.observation import Observation
from amulor.rejection.reference import grid
from amulor.rejection.reference.shots import fit_shots
from amulor.simulation import simulate
from amulor.studies.trust.surveys import scaled, survey
from amulor.survey import Survey


def _missed(made: Survey, options: dict[str, Any], water: Any) -> float:
    """Return what rejection misses of another water, of its largest signal."""
    cube = simulate(survey(1, water=water, **options), rng=2)
    truth = cube["truth_water_in_phase"] + 1j * cube["truth_water_quadrature"]
    cube = cube.assign_attrs(survey=made.to_toml())
    fits, _ = fit_shots(Observation(cube=cube))
    return max(
        float(np.abs(found.signal - true).max() / np.abs(true).max())
        for found, true in zip(fits, truth.values.reshape(len(fits), -1), strict=True)
    )


@pytest.mark.parametrize(
    ("columns", "rows", "wide", "tall", "holds"),
    [
        pytest.param(3, 3, 9, 19, True, marks=pytest.mark.slow),
        pytest.param(3, 3, 19, 4, False, marks=pytest.mark.slow),
        (3, 3, 6, 6, True),
        pytest.param(9, 3, 4, 8, True, marks=pytest.mark.slow),
        pytest.param(9, 3, 19, 4, True, marks=pytest.mark.slow),
        pytest.param(5, 3, 30, 10, False, marks=pytest.mark.slow),
    ],
)
def test_a_plan_is_refused_where_rejection_misses_much_and_only_there(
    monkeypatch: pytest.MonkeyPatch,
    columns: int, rows: int, wide: float, tall: float, *, holds: bool,
) -> None:  # fmt: skip
    # Shots that fluctuate by 0.5 %: what is missed is interpolation, not noise.
    options: dict[str, Any] = {
        "wide": wide, "tall": tall, "shot_columns": columns, "shot_rows": rows,
        "fluctuation": 0.5, "columns": 20, "rows": 20,
    }  # fmt: skip
    made = survey(1, **options)
    # Which plan would do is another question.
    monkeypatch.setattr(grid, "_NUMBERS", (rows,))
    plan = grid.judge_plan(made)
    assert plan is not None
    assert plan.holds == holds
    # Waters that the judge does not try, with all that noise does to the choice.
    waters = ["tank", scaled("tank", 0.75), scaled("tank", 1.6), "harbour"]
    waters = waters if columns > 3 else waters[1:3]
    off = max(_missed(made, options, water) for water in waters)
    assert (off < 0.012) == holds, (plan.error, off)


@pytest.mark.slow
def test_a_plan_that_is_too_sparse_is_told_which_one_would_do() -> None:
    made = survey(1, wide=9, tall=19, shot_columns=3, shot_rows=1)
    plan = grid.judge_plan(made)
    assert plan is not None
    assert not plan.holds
    assert "edges of the scan from top to bottom" in plan.refused
    assert plan.enough is not None
    assert plan.enough[1] >= 3
    columns, rows = plan.enough
    enough = survey(1, wide=9, tall=19, shot_columns=columns, shot_rows=rows)
    better = grid.judge_plan(enough)
    assert better is not None
    assert better.holds
    assert better.error < plan.error


def test_where_the_receiver_turns_with_the_beam_any_plan_will_do() -> None:
    made = survey(1, wide=19, tall=19, shot_columns=1, shot_rows=1)
    turning = made.model_copy(
        update={"scan": made.scan.model_copy(update={"moves": "both"})}
    )
    assert grid.judge_plan(turning) == grid.Plan(error=0.0, refused="", enough=(1, 1))


def test_a_survey_without_shots_has_no_plan() -> None:
    made = survey(1)
    scan = made.scan.model_copy(update={"open_water": None})
    assert grid.judge_plan(made.model_copy(update={"scan": scan})) is None
