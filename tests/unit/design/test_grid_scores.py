"""Scores of a grid of instruments are those of each instrument alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.design import Goal, scores
from amulor.design.candidates import depth_of, first_choice
from amulor.design.scores import Grid, Judge

GRID = Grid(
    baseline=(0.06, 0.2), radius=(0.01, 0.03), field_of_view=(0.03, 0.06),
    power=(0.01,), dwell=(0.03, 0.12), sets=((15e6, 52e6), (34e6,)),
)  # fmt: skip


def on_vehicle(text: str) -> str:
    """Return a goal on a vehicle, with rows made by its motion."""
    text = text.replace("rows = 30\n", "").replace('elevation_span = "3 deg"\n', "")
    return text.replace(
        "[components]\n",
        '[vehicle]\nslowest = "1 cm/s"\nfastest = "1 m/s"\nlength = "6 m"\n'
        'width = "50 cm"\nrow_spacing = "5 cm"\n[components]\n',
        1,
    )


@pytest.mark.parametrize("readings", ["in-turn", "at-once"])
def test_a_grid_is_scored_as_each_of_its_instruments(
    goal_text: str, monkeypatch: pytest.MonkeyPatch, readings: Any
) -> None:
    goal = Goal.from_text(on_vehicle(goal_text))
    judge = Judge(goal, "green", draws=2)
    start = first_choice(goal)
    like = start.__class__(**{**vars(start), "readings": readings})
    whole = judge.score(GRID, like)
    assert whole.error.shape == whole.wrong.shape == (32, 2)
    # In parts of one field of view, which is no other result.
    monkeypatch.setattr(scores, "_AT_ONCE", 1)
    parts = judge.score(GRID, like)
    for name, values in vars(parts).items():
        assert_allclose(values, getattr(whole, name), err_msg=name)
    for number in (0, 7, 18, 31):
        alone = judge.of(GRID.parameters(number, like))
        for name, values in vars(alone).items():
            assert_allclose(
                getattr(whole, name)[number], values[0], rtol=5e-3, atol=1e-9,
                err_msg=name,
            )  # fmt: skip
    assert np.unique(whole.error[:, 0].round(9)).size > 20
    laser = goal.components.lasers[0]
    assert depth_of(laser, 2, "at-once") == 0.4
    assert depth_of(laser, 2, "in-turn") == 0.8
