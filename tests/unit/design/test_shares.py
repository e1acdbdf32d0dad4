"""Shares of the dwell between frequencies."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from amulor.design import Goal
from amulor.design.candidates import first_choice
from amulor.design.recommend import _error, dwell_shares
from amulor.design.scores import Judge


@pytest.fixture(scope="module")
def goal(goal_text: str) -> Goal:
    # Counting noise alone: time is what there is to share.
    text = goal_text.replace('phase_floor = "0.03 deg"', "").replace(
        'fluctuation = {low = "1 %", high = "5 %"}', ""
    )
    return Goal.from_text(text.replace("draws = 8", "draws = 16"))


def test_even_shares_err_as_the_compiled_loop_says(goal: Goal) -> None:
    chosen = replace(
        first_choice(goal),
        frequencies=(34e6, 120e6),
        power=0.01,
        dwell=0.12,
        polarization="VH",
    )
    found = dwell_shares(goal, chosen)
    assert found is not None
    judged = float(Judge(goal, "green").of(chosen).error.max())
    # Biases of one sign are an upper limit, a little above the signed sum.
    assert judged * 0.999 < found.even < 1.1 * judged
    assert sum(found.share) == pytest.approx(1)
    # The low frequency settles the interval and needs little time for that: of
    # counting noise the error falls with the frequency.
    assert found.share[1] > 0.6
    assert found.error < found.even


def test_one_frequency_has_nothing_to_share(goal: Goal) -> None:
    chosen = first_choice(goal)
    assert dwell_shares(goal, replace(chosen, frequencies=(34e6,))) is None
    joint = replace(chosen, frequencies=(34e6, 75e6), method="joint")
    assert dwell_shares(goal, joint) is None


@pytest.mark.parametrize(
    ("share", "rank"), [(0.9, 9), (0.91, 10), (0.05, 1), (1.0, 10)]
)
def test_the_required_share_of_the_draws_is_not_above_the_error(
    goal: Goal, share: float, rank: int
) -> None:
    accuracy = goal.accuracy.model_copy(update={"share": share})
    asked = goal.model_copy(update={"accuracy": accuracy})
    chosen: Any = SimpleNamespace(frequencies=(15e6,))
    # Ten draws of 1 to 10 mm, in another order at each distance.
    sigma = 1e-3 * np.array([np.arange(1.0, 11.0), np.arange(10.0, 0.0, -1.0)])
    variance = sigma[None, None] ** 2
    found = _error(asked, chosen, 1.38, variance, np.zeros(variance.shape), (0,))
    assert found == pytest.approx(1e-3 * rank)
