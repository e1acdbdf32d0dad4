"""Signal chains with stated errors, of two frequencies."""

from __future__ import annotations

from typing import Any

import numpy as np

from amulor.simulation.geometry import Setup
from amulor.simulation.instrument_errors import Chain
from amulor.survey import Survey

FREQUENCIES = np.array([20e6, 60e6])


def chain(survey: Survey, seed: int = 7, **errors: Any) -> Chain:
    """Return the chain of a survey whose instrument has given errors."""
    stated = {name: dict(each) for name, each in errors.items()}
    found = Chain.of(Setup(survey.with_({"instrument.errors": stated})), seed)
    assert found is not None
    return found
