"""Shared parameters of a joint estimation, to be tried without a scan."""

from __future__ import annotations

from typing import Any

import numpy as np

from amulor.rejection.joint.overlap import Shape
from amulor.rejection.joint.priors import NONE, Shared


def shared_state(channels: int = 2, frequencies: int = 3, **changed: Any) -> Shared:
    """Return shared parameters of steady water, without departures or a table."""
    values: dict[str, Any] = {
        "shape": Shape(0.3, 0.05, 0.7, np.zeros(0), np.zeros(0)),
        "table": None,
        "strength": np.array([0.5, 0.2])[:channels],
        "departure": np.zeros((channels, frequencies), dtype=complex),
        "echo": np.zeros(frequencies, dtype=complex),
        "shot_change": 0.0,
        "shot_departure": np.zeros((0, frequencies), dtype=complex),
        "trend": np.zeros(0),
        "fluctuation": 0.0,
        "noise_scale": 1.0,
        "judged": np.ones((channels, frequencies), dtype=bool),
        "turn_width": 0.0,
        "covariance": np.zeros((0, 0)),
        "parametric": np.zeros((0, 0)),
        "widths": NONE,
        "evidence": 0.0,
        "misfit": 1.0,
    }
    return Shared(**values | changed)
