"""The goal file: reads TOML, and says what is wrong in one line each."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from amulor.design.goal.parts import (
    Accuracy,
    Assumptions,
    Components,
    DistanceRange,
    Effort,
    Interval,
    ScanGoal,
    Targets,
    Waters,
)
from amulor.errors import SurveyError
from amulor.survey import Calibration, Daylight, Detector, LockIn, Window, toml_file
from amulor.survey.quantity import Description, Length


class Goal(Description):
    """What an instrument must do, in which waters, and what it may be made of.

    Examples
    --------
    >>> goal = Goal.from_toml("examples/goals/harbour_wall.toml")  # doctest: +SKIP
    >>> goal.accuracy.total_error  # doctest: +SKIP
    """

    name: Annotated[str, Field(min_length=1, max_length=200)]
    """What is to be built; the title of all that comes of it."""
    distances: (
        Annotated[
            tuple[Annotated[Length, Field(gt=0, le=100)], ...],
            Field(min_length=1, max_length=20),
        ]
        | DistanceRange
    )
    """Slant ranges at which the accuracy is asked for: a list, or nearest and farthest
    [m]."""
    interval: Interval | None = None
    """Limits of the range that are known beforehand; from 0 to a tenth beyond the
    farthest distance if left out."""
    accuracy: Accuracy
    """How good the range must be."""
    waters: Waters
    """Waters."""
    targets: Targets
    """Surfaces."""
    scan: ScanGoal
    """Picture and time."""
    components: Components
    """What the instrument may be made of."""
    aim: Annotated[Length, Field(gt=0)] | None = None
    """Distance at which the receiver's axis meets the beam; the harmonic mean of the
    nearest and the farthest distance if left out [m]."""
    detector: Detector = Detector()
    """The photomultiplier, as in a survey."""
    lock_in: LockIn = LockIn()
    """The lock-in amplifier; its time constant is at most a tenth of the dwell."""
    window: Window | None = None
    """Window, as in a survey."""
    daylight: Daylight | None = None
    """Daylight, as in a survey."""
    calibration: Calibration | None = None
    """Calibration, as in a survey."""
    assumptions: Assumptions = Assumptions()
    """What will be known of the water."""
    effort: Effort = Effort()
    """How long the search may be."""

    @model_validator(mode="after")
    def _distances_lie_in_the_interval(self) -> Self:
        known = self.interval
        if known is None:
            return self
        outside = [d for d in self.asked if not known.nearest <= d < known.farthest]
        if outside:
            raise ValueError(
                f"distances holds {outside[0]:g} m, which is not within the interval "
                f"from {known.nearest:g} to {known.farthest:g} m"
            )
        return self

    @property
    def asked(self) -> tuple[float, ...]:
        """Slant ranges at which the accuracy is asked for, increasing [m]."""
        stated = self.distances
        if isinstance(stated, DistanceRange):
            steps = np.linspace(stated.nearest, stated.farthest, stated.count)
            return tuple(map(float, steps))
        return tuple(sorted(stated))

    @property
    def limits(self) -> tuple[float, float]:
        """Nearest and farthest slant range that are possible [m]."""
        if self.interval is not None:
            return self.interval.nearest, self.interval.farthest
        return 0.0, 1.1 * self.asked[-1]

    @property
    def assumed(self) -> dict[str, Any]:
        """Axes of `amulor.design.evaluate` that the goal assumes; draws go before."""
        return {"texture": 0.0, **self.assumptions.model_dump()}

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a goal file.

        Parameters
        ----------
        path : str or pathlib.Path
            TOML file.

        Returns
        -------
        Goal
            In SI units.

        Raises
        ------
        SurveyError
            With one line for each thing that is wrong: file, field, what was found,
            what is allowed.
        """
        text = toml_file.text_of(path, error=SurveyError)
        return cls.from_text(text, name=str(path))

    @classmethod
    def from_text(cls, text: str, *, name: str = "goal") -> Self:
        """Read a goal from the text of its file.

        Parameters
        ----------
        text : str
            TOML.
        name : str
            What messages call it.

        Returns
        -------
        Goal
            In SI units.

        Raises
        ------
        SurveyError
            As `from_toml`.
        """
        return toml_file.described(
            text, cls, name=name, what="a goal", error=SurveyError
        )


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of goal files, for editors that check while typing.

    Returns
    -------
    dict
        JSON Schema, draft 2020-12.

    Examples
    --------
    >>> from amulor.design import json_schema
    >>> json_schema()["required"][:3]
    ['name', 'distances', 'accuracy']
    """
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Goal.model_json_schema(),
        "title": "amulor design goal",
    }
