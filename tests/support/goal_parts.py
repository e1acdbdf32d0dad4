"""Goals with other components, and scores of candidates that meet all."""

from __future__ import annotations

from typing import Any

import numpy as np

from amulor.design import Goal
from amulor.design.scores import Score


def with_parts(goal: Goal, **changes: Any) -> Goal:
    """Return a goal with other components."""
    parts = goal.components.model_copy(update=changes)
    return goal.model_copy(update={"components": parts})


def with_laser(goal: Goal, **changes: Any) -> Goal:
    """Return a goal whose only laser has other values."""
    laser = goal.components.lasers[0].model_copy(update=changes)
    return with_parts(goal, lasers=(laser,))


def scores(count: int = 1, **changed: Any) -> Score:
    """Return scores of candidates at two distances."""
    values: dict[str, Any] = {
        "error": np.full((count, 2), 1e-3), "wrong": np.zeros((count, 2)),
        **{name: np.zeros(count) for name in
           ("output", "validity", "time", "rows", "smear", "cost")},
    }  # fmt: skip
    return Score(**values | changed)
