"""Vehicle of a goal: speeds, area and density of points; survey lines over it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from amulor.survey.platform import Disturbance
from amulor.survey.quantity import Description, Fraction, Length, Speed, Time

__all__ = ["Lines", "Readings", "Vehicle"]

Readings = Literal["at-once", "in-turn"]

_Driven = Annotated[Speed, Field(gt=0, le=20)]
_Side = Annotated[Length, Field(gt=0, le=1e5)]


@dataclass(frozen=True, kw_only=True)
class Lines:
    """Survey lines of a vehicle over an area, and the distances between their points.

    Examples
    --------
    >>> lines = recommend(goal).best.lines  # doctest: +SKIP
    >>> print(f"{lines.count} lines at {lines.speed:.2g} m/s")  # doctest: +SKIP
    """

    speed: float
    """Speed of the vehicle [m/s]."""
    time: float
    """Time for all lines, and for the turns between them [s]."""
    count: int
    """Number of lines [1]."""
    length: float
    """Length of each line [m]."""
    spacing: float
    """Distance between neighboring lines; 0 for a single line [m]."""
    swath: float
    """Width of a line at the nearest distance [m]."""
    between_rows: float
    """Distance between rows of points along a line [m]."""
    between_columns: float
    """Distance between points of a row, at the farthest distance [m]."""
    along_readings: float
    """Way of the vehicle during the readings of a pixel [m]."""
    spot: float
    """Diameter (1/e) of the unscattered laser spot at the farthest distance; 0 if the
    goal does not state the beam [m]."""


class Vehicle(Description):
    """Vehicle that carries the instrument, the area to survey, and density of points.

    The instrument measures rows of pixels across the course. The vehicle moves it from
    row to row, on parallel lines over a rectangular area.

    Examples
    --------
    A survey of 20 m by 5 m with rows at most 6 mm apart. A row of 30 pixels takes
    30 ms, so that the vehicle may drive at 0.2 m/s:

    >>> from amulor.design.vehicle import Vehicle
    >>> vehicle = Vehicle(
    ...     slowest="0.05 m/s", fastest="0.4 m/s", length="20 m", width="5 m",
    ...     row_spacing="6 mm",
    ... )
    >>> lines = vehicle.plan(
    ...     columns=30, span=0.2, nearest=3.0, farthest=4.0, pixel_time=1e-3
    ... )
    >>> round(lines.speed, 6), lines.count, round(lines.spacing, 3)
    (0.2, 11, 0.44)
    """

    slowest: _Driven
    """Slowest speed at which the vehicle keeps its course [m/s]."""
    fastest: _Driven
    """Fastest speed of the vehicle [m/s]."""
    length: _Side
    """Length of the area, and of each survey line [m]."""
    width: _Side
    """Width of the area, across the survey lines [m]."""
    row_spacing: Annotated[Length, Field(gt=0, le=10)]
    """Largest allowed distance between rows along the course [m]."""
    smear: Annotated[Length, Field(gt=0, le=10)] | None = None
    """Largest allowed way of the vehicle during the readings of a pixel; no limit by
    default [m]."""
    overlap: Annotated[Fraction, Field(ge=0, le=0.9)] = 0.2
    """Share of its width that a survey line has in common with the next, at the nearest
    distance [1]."""
    turn: Annotated[Time, Field(ge=0, le=3600)] = 0.0
    """Time for the turn from one survey line to the next [s]."""
    readings: Annotated[tuple[Readings, ...], Field(min_length=1)] = (
        "at-once",
        "in-turn",
    )
    """Possible orders of the readings of a pixel at its frequencies and channels. At
    once, the frequencies share the modulation depth of the laser."""
    disturbance: Disturbance = Disturbance()
    """Motion by current and waves, as in a survey; none by default."""

    @model_validator(mode="after")
    def _speeds_rise(self) -> Self:
        if self.slowest > self.fastest:
            raise ValueError(
                f"slowest ({self.slowest:g} m/s) must not exceed fastest "
                f"({self.fastest:g} m/s)"
            )
        return self

    def plan(
        self,
        *,
        columns: int,
        span: float,
        nearest: float,
        farthest: float,
        pixel_time: float,
        spot: float = 0.0,
    ) -> Lines:
        """Return the survey lines over the area, at the highest allowed speed.

        The speed is at least the slowest of the vehicle; row spacing or smear are then
        missed. Each line images a strip of the sea bed, whose width is that at the
        nearest distance.

        Parameters
        ----------
        columns : int
            Number of pixels of a row [1].
        span : float
            Angle between the first and the last column [rad].
        nearest, farthest : float
            Smallest and largest distance from the instrument [m].
        pixel_time : float
            Time of the readings of a pixel [s].
        spot : float
            Diameter of the laser spot at the farthest distance [m].

        Returns
        -------
        Lines
            Speed, number and spacing of the lines, and distances of their points.
        """
        row_time = columns * pixel_time
        sharp = math.inf if self.smear is None else self.smear / pixel_time
        fastest = min(self.row_spacing / row_time, sharp, self.fastest)
        speed = max(fastest, self.slowest)
        swath, count, spacing = self._cover(nearest, span)
        return Lines(
            speed=speed,
            time=count * self.length / speed + (count - 1) * self.turn,
            count=count,
            length=self.length,
            spacing=spacing,
            swath=swath,
            between_rows=speed * row_time,
            between_columns=farthest * span / max(columns - 1, 1),
            along_readings=speed * pixel_time,
            spot=spot,
        )

    def longest_pixel(
        self, *, columns: int, span: float, nearest: float, longest: float
    ) -> float:
        """Return the longest time of a pixel in a survey of a given duration [s].

        Parameters
        ----------
        columns : int
            Number of pixels of a row [1].
        span : float
            Angle between the first and the last column [rad].
        nearest : float
            Smallest distance from the instrument [m].
        longest : float
            Time for all lines with their turns [s].

        Returns
        -------
        float
            Time of the readings of a pixel [s].
        """
        _, count, _ = self._cover(nearest, span)
        driven = longest - (count - 1) * self.turn
        needed = count * self.length / driven if driven > 0 else self.fastest
        speed = min(max(needed, self.slowest), self.fastest)
        return min(self.row_spacing / columns, self.smear or math.inf) / speed

    def _cover(self, nearest: float, span: float) -> tuple[float, int, float]:
        """Return width, number and spacing of the lines that cover the area [m]."""
        swath = 2 * nearest * math.tan(span / 2)
        rest = self.width - swath
        if rest <= 0:
            return swath, 1, 0.0
        gaps = math.ceil(rest / ((1 - self.overlap) * swath) - 1e-9)
        return swath, gaps + 1, rest / gaps
