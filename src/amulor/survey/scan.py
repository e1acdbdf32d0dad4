"""The scan: which directions, how long at each, in which order, what moves."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field

from amulor.survey.quantity import Angle, Description, Time


class OpenWater(Description):
    """Shots of the same water without the target, spread over the scan."""

    columns: Annotated[int, Field(ge=1, le=10_000)] = 9
    """Directions along a row; the first and the last are the scan's own edges [1]."""
    rows: Annotated[int, Field(ge=1, le=10_000)] = 3
    """Rows of directions [1]."""
    repeats: Annotated[int, Field(ge=1, le=100_000)] = 10
    """Samples in each direction [1]."""


class Scan(Description):
    """A rectangular grid of directions."""

    columns: Annotated[int, Field(ge=1, le=20_000)]
    """Pixels along a row [1]."""
    rows: Annotated[int, Field(ge=1, le=20_000)]
    """Rows of pixels, the first one on top [1]."""
    azimuth_span: Annotated[Angle, Field(ge=0, lt=math.pi)]
    """Angle between the first and the last column [rad]."""
    elevation_span: Annotated[Angle, Field(ge=0, lt=math.pi)]
    """Angle between the first and the last row [rad]."""
    azimuth: Annotated[Angle, Field(gt=-math.pi / 2, lt=math.pi / 2)] = 0.0
    """Direction of the middle of the scan, to the right [rad]."""
    elevation: Annotated[Angle, Field(gt=-math.pi / 2, lt=math.pi / 2)] = 0.0
    """Direction of the middle of the scan, upwards [rad]."""
    dwell: Annotated[Time, Field(gt=0)]
    """Time spent on each pixel, for each frequency and channel [s]."""
    order: Literal["raster", "serpentine"] = "raster"
    """Every row from left to right, or every second one from right to left."""
    moves: Literal["beam", "both"] = "beam"
    """What turns: the beam alone, or emitter and receiver together."""
    open_water: OpenWater | None = None
    """Reference shots without a target; left out if there are none."""
