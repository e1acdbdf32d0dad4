"""Part of a devices file that says how a pan-tilt head counts."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from amulor.acquisition.settings.parts import need
from amulor.survey.quantity import Angle, Description


class PanTiltSettings(Description):
    """A pan-tilt head that speaks Pelco-D."""

    number: Annotated[int, Field(ge=1, le=255)] = 1
    """Number that is set in the head (its address on the line) [1]."""
    pan_counts: Literal["right", "left"] = "right"
    """Where the pan position grows to; clockwise from above, that is to the right, in
    heads that stand."""
    tilt_counts: Literal["down", "up"] = "down"
    """Where the tilt position grows to."""
    lowest_pan: Angle | None = None
    """Least azimuth that the head goes to; not checked if left out [rad]."""
    highest_pan: Angle | None = None
    """Largest azimuth that the head goes to; not checked if left out [rad]."""
    lowest_tilt: Angle | None = None
    """Least elevation that the head goes to; not checked if left out [rad]."""
    highest_tilt: Angle | None = None
    """Largest elevation that the head goes to; not checked if left out [rad]."""

    @model_validator(mode="after")
    def _ends_belong_together(self) -> Self:
        for name in ("pan", "tilt"):
            low, high = (
                getattr(self, f"{end}_{name}") for end in ("lowest", "highest")
            )
            need(
                (low is None) == (high is None),
                f"both or none of scanner.pan_tilt.lowest_{name} and highest_{name}",
            )
            if low is not None and not low < high:
                raise ValueError(f"lowest_{name} must be less than highest_{name}")
        return self
