"""Goal file of a design: required performance and available components."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from amulor.design.axes import Method
from amulor.design.vehicle import Vehicle
from amulor.errors import SurveyError
from amulor.optics.polarization import stokes
from amulor.survey import (
    Calibration,
    Daylight,
    Detector,
    LockIn,
    OpenWater,
    Window,
    toml_file,
)
from amulor.survey.mueller import ReducedMueller
from amulor.survey.quantity import (
    Angle,
    Count,
    Description,
    Fraction,
    Frequency,
    Length,
    PerMetre,
    Power,
    Time,
    Wavelength,
)
from amulor.survey.target import PAINTED_METAL
from amulor.survey.waters.named import WaterStated

__all__ = ["Goal", "json_schema"]


Distribution = Literal["uniform", "log-uniform", "normal", "log-normal"]


class _Spread(Description):
    distribution: Distribution = "uniform"
    """Distribution of the values between low and high. A normal distribution
    has 95 % of its values in between, and is truncated at twice the distance from the
    middle.
    """

    @model_validator(mode="after")
    def _rises(self) -> Self:
        low: float = getattr(self, "low")  # noqa: B009
        high: float = getattr(self, "high")  # noqa: B009
        if low > high:
            raise ValueError(f"low ({low:g}) must not exceed high ({high:g})")
        if self.distribution.startswith("log") and low <= 0:
            raise ValueError(
                f"a {self.distribution} distribution needs low above 0, found {low:g}"
            )
        return self


class CoefficientSpread(_Spread):
    """Range of an attenuation, absorption or scattering coefficient [1/m]."""

    low: Annotated[PerMetre, Field(ge=0)]
    """Lower end of the range [1/m]."""
    high: Annotated[PerMetre, Field(gt=0)]
    """Upper end of the range [1/m]."""


class FractionSpread(_Spread):
    """Range of a fraction, such as a reflectance [1]."""

    low: Annotated[Fraction, Field(ge=0, le=1)]
    """Lower end of the range [1]."""
    high: Annotated[Fraction, Field(ge=0, le=1)]
    """Upper end of the range [1]."""


class AngleSpread(_Spread):
    """Range of an angle [rad]."""

    low: Annotated[Angle, Field(ge=0, le=1)]
    """Lower end of the range [rad]."""
    high: Annotated[Angle, Field(ge=0, le=1)]
    """Upper end of the range [rad]."""


#: Any of them.
Spread = CoefficientSpread | FractionSpread | AngleSpread


_Money = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Distance = Annotated[Length, Field(gt=0, le=100)]
_Tone = Annotated[Frequency, Field(gt=0, le=10e9)]
#: Channels joined by a plus sign.
Scheme = Annotated[
    str,
    Field(pattern=rf"^({stokes.PAIR_PATTERN})( ?\+ ?({stokes.PAIR_PATTERN}))*$"),
]


class _Ascending(Description):
    """Base class of distance limits, with nearest below farthest."""

    nearest: float
    farthest: float

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if self.farthest <= self.nearest:
            raise ValueError(
                f"farthest ({self.farthest:g} m) must lie beyond nearest "
                f"({self.nearest:g} m)"
            )
        return self


class DistanceRange(_Ascending):
    """Evenly spaced target distances."""

    nearest: _Distance
    """Nearest distance [m]."""
    farthest: _Distance
    """Farthest distance [m]."""
    count: Annotated[Count, Field(ge=2, le=20)] = 5
    """Number of distances [1]."""


class Interval(_Ascending):
    """Prior limits of the slant range."""

    nearest: Annotated[Length, Field(ge=0)]
    """Nearest possible slant range [m]."""
    farthest: Annotated[Length, Field(gt=0)]
    """Farthest possible slant range [m]."""


class Accuracy(Description):
    """Required range accuracy."""

    total_error: Annotated[Length, Field(gt=0)]
    """Largest total error of one pixel: root sum of squares of standard uncertainty and
    residual bias [m].
    """
    share: Annotated[Fraction, Field(gt=0, le=1)] = 0.9
    """Fraction of random waters and targets with the total error to be met [1]."""
    wrong_interval: Annotated[Fraction, Field(gt=0, lt=0.5)] = 0.001
    """Largest allowed probability of a wrong ambiguity interval [1]."""


class Waters(Description):
    """Water of the design, with ranges of its properties."""

    base: WaterStated
    """Base water, described as in a survey."""
    attenuation: CoefficientSpread | None = None
    """Range of a + b at the first laser's wavelength; as in the base by default [1/m].

    Absorption and scattering stay in the proportion of the base.
    """
    absorption: CoefficientSpread | None = None
    """Range of the absorption a, instead of the attenuation [1/m]."""
    scattering: CoefficientSpread | None = None
    """Range of the scattering b, instead of the attenuation [1/m]."""
    fluctuation: FractionSpread | None = None
    """Range of the relative water-signal fluctuation from sample to sample [1]."""
    m22: FractionSpread | None = None
    """Range of the water's Mueller element m22; 1 for no depolarization [1]."""

    @model_validator(mode="after")
    def _is_stated_once(self) -> Self:
        if self.attenuation is not None and (self.absorption or self.scattering):
            raise ValueError(
                "attenuation is the sum of absorption and scattering; state its range "
                "alone, or those of the other two"
            )
        return self


class Targets(Description):
    """Target surfaces of the goal, with ranges of their properties."""

    reflectance: FractionSpread
    """Range of the reflectance [1]."""
    mueller: ReducedMueller = PAINTED_METAL
    """Reduced Mueller matrix of backscattering, as in a survey [1]."""
    m22: FractionSpread | None = None
    """Range of the Mueller element m22; 0 for complete depolarization [1]."""
    slope: AngleSpread | None = None
    """Range of the surface's inclination; normal incidence by default [rad]."""
    texture: FractionSpread | None = None
    """Range of the relative reflectance change over the half-width of the beam; none by
    default [1].
    """


class ScanGoal(Description):
    """Required scan pattern, and the time available for it."""

    columns: Annotated[Count, Field(ge=1, le=20_000)]
    """Number of pixels per row [1]."""
    rows: Annotated[Count, Field(ge=1, le=20_000)] | None = None
    """Number of pixel rows; left out with a vehicle, which moves from row to row
    [1]."""
    azimuth_span: Annotated[Angle, Field(ge=0, lt=math.pi)]
    """Angle between the first and the last column [rad]."""
    elevation_span: Annotated[Angle, Field(ge=0, lt=math.pi)] | None = None
    """Angle between the first and the last row; left out with a vehicle [rad]."""
    longest: Annotated[Time, Field(gt=0)]
    """Longest allowed time for all pixels, or for all survey lines of a vehicle [s]."""
    moves: Literal["beam", "both"] = "both"
    """Scanned part: the beam alone, or emitter and receiver together."""
    open_water: OpenWater = OpenWater(columns=9, rows=3, repeats=20)
    """Open-water reference measurements of the scan."""


class Laser(Description):
    """Available laser, with properties at its wavelength."""

    name: Annotated[str, Field(min_length=1, max_length=80)]
    """Name of the laser."""
    wavelength: Annotated[Wavelength, Field(ge=400e-9, le=700e-9)]
    """Wavelength in vacuum [m]."""
    powers: Annotated[
        tuple[Annotated[Power, Field(gt=0)], ...], Field(min_length=1, max_length=20)
    ]
    """Available mean launched powers [W]."""
    modulation_depth: Annotated[Fraction, Field(gt=0, le=1)] = 0.8
    """Modulation depth of the intensity [1]."""
    top_frequency: _Tone | None = None
    """Highest modulation frequency; no limit by default [Hz]."""
    beam_radius: Annotated[Length, Field(ge=0, le=0.5)] | None = None
    """1/e radius of the beam at the emitter [m]."""
    beam_divergence: Annotated[Angle, Field(ge=0, le=0.2)] | None = None
    """1/e half-angle of the beam [rad]."""
    quantum_efficiency: Annotated[Fraction, Field(gt=0, le=1)] | None = None
    """Quantum efficiency at the laser wavelength; the detector's by default [1]."""
    water: WaterStated | None = None
    """Base water at the laser wavelength; derived from the common base by default."""
    price: _Money = 0.0
    """Price of the laser [currency]."""
    price_per_watt: _Money = 0.0
    """Additional price per watt of mean power [currency/W]."""


class Modulation(Description):
    """Available modulation frequencies."""

    lowest: _Tone | None = None
    """Lowest modulation frequency of a grid [Hz]."""
    highest: _Tone | None = None
    """Highest modulation frequency of a grid [Hz]."""
    count: Annotated[Count, Field(ge=2, le=200)] = 25
    """Number of grid frequencies, evenly spaced in the logarithm [1]."""
    frequencies: tuple[_Tone, ...] = ()
    """List of frequencies instead of a grid, increasing [Hz]."""
    sets: tuple[Annotated[tuple[_Tone, ...], Field(min_length=1)], ...] = ()
    """Complete frequency sets instead of single frequencies to combine [Hz]."""
    most: Annotated[Count, Field(ge=1, le=6)] = 2
    """Largest number of frequencies per pixel [1]."""
    price_each: _Money = 0.0
    """Price of each additional frequency [currency]."""

    @model_validator(mode="after")
    def _is_stated_once(self) -> Self:
        grid = self.lowest is not None or self.highest is not None
        if grid + bool(self.frequencies) + bool(self.sets) != 1:
            raise ValueError(
                "state lowest and highest, or frequencies, or sets: one of these"
            )
        if grid and (self.lowest is None or self.highest is None):
            raise ValueError("a grid of frequencies needs lowest and highest")
        if grid and not (self.lowest or 0) < (self.highest or 0):
            raise ValueError(
                f"highest ({self.highest:g} Hz) must lie above lowest "
                f"({self.lowest:g} Hz)"
            )
        for members in (self.frequencies, *self.sets):
            if any(b <= a for a, b in pairwise(members)):
                raise ValueError(
                    "frequencies must increase and hold each one once; found "
                    + ", ".join(f"{value / 1e6:g} MHz" for value in members)
                )
        return self


class _Box(Description):
    count: Annotated[Count, Field(ge=2, le=50)] = 4
    """Grid values between low and high, evenly spaced in the logarithm [1]."""
    prices: tuple[_Money, ...] = ()
    """Price of each value [currency]."""

    @model_validator(mode="after")
    def _is_stated_once(self) -> Self:
        values: tuple[float, ...] = getattr(self, "values")  # noqa: B009
        low: float | None = getattr(self, "low")  # noqa: B009
        high: float | None = getattr(self, "high")  # noqa: B009
        box = low is not None or high is not None
        if box == bool(values):
            raise ValueError("state values to choose from, or low and high")
        if box and (low is None or high is None or not low < high):
            raise ValueError(f"low and high are needed, low first; found {low}, {high}")
        if any(b <= a for a, b in pairwise(values)):
            raise ValueError(
                "values must increase; found "
                + ", ".join(f"{value:g}" for value in values)
            )
        if self.prices and len(self.prices) != len(values):
            raise ValueError(
                f"{len(values)} values need as many prices, found {len(self.prices)}"
            )
        return self


class LengthBox(_Box):
    """Available lengths: a list, or a range."""

    values: tuple[Annotated[Length, Field(gt=0)], ...] = ()
    """List of available lengths [m]."""
    low: Annotated[Length, Field(gt=0)] | None = None
    """Lower end of the range [m]."""
    high: Annotated[Length, Field(gt=0)] | None = None
    """Upper end of the range [m]."""


class AngleBox(_Box):
    """Available angles: a list, or a range."""

    values: tuple[Annotated[Angle, Field(gt=0, le=0.5)], ...] = ()
    """List of available angles [rad]."""
    low: Annotated[Angle, Field(gt=0)] | None = None
    """Lower end of the range [rad]."""
    high: Annotated[Angle, Field(gt=0, le=0.5)] | None = None
    """Upper end of the range [rad]."""


class TimeBox(_Box):
    """Available times: a list, or a range."""

    values: tuple[Annotated[Time, Field(gt=0)], ...] = ()
    """List of available times [s]."""
    low: Annotated[Time, Field(gt=0)] | None = None
    """Lower end of the range [s]."""
    high: Annotated[Time, Field(gt=0)] | None = None
    """Upper end of the range [s]."""


#: Any of them.
Box = LengthBox | AngleBox | TimeBox


class Components(Description):
    """Available components of the instrument."""

    lasers: Annotated[tuple[Laser, ...], Field(min_length=1)]
    """Available lasers."""
    modulation: Modulation
    """Available modulation frequencies."""
    baseline: LengthBox
    """Distance between emitter and receiver [m]."""
    radius: LengthBox
    """1/e half-width of the receiver aperture [m]."""
    field_of_view: AngleBox
    """1/e half-width of the receiver's field of view [rad]."""
    dwell: TimeBox
    """Dwell time per pixel, frequency and channel [s]."""
    polarizations: Annotated[tuple[Scheme, ...], Field(min_length=1)]
    """Available polarization schemes, such as "VH" or "VV+VH"."""
    methods: Annotated[tuple[Method, ...], Field(min_length=1)] = ("open-water",)
    """Available rejection methods, named as in `amulor reject`."""
    price_per_channel: _Money = 0.0
    """Price of each additional polarization channel [currency]."""
    budget: _Money | None = None
    """Largest total price; no limit by default [currency]."""

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [laser.name for laser in self.lasers]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ValueError(f"two lasers are called {twice[0]!r}")
        return self


class Assumptions(Description):
    """Assumed knowledge of the water when the scan is processed."""

    water_change: Annotated[Fraction, Field(ge=0, le=1)] = 0.01
    """Relative change of the water signal between open-water shots and scan [1]."""
    column_uncertainty: Annotated[Fraction, Field(ge=0, le=1)] = 0.1
    """Relative uncertainty of the water signal from behind the target [1]."""
    ratio_uncertainty: Annotated[Fraction, Field(ge=0, le=1)] = 0.01
    """Uncertainty of the water's depolarization ratio [1]."""
    departure: Annotated[Fraction, Field(ge=0, le=1)] = 0.003
    """Relative deviation of the water signal from the model of joint estimation [1]."""


class Effort(Description):
    """Computing effort of the search for an instrument."""

    draws: Annotated[Count, Field(ge=4, le=4096)] = 64
    """Number of randomly drawn waters and targets [1]."""
    refined: Annotated[Count, Field(ge=1, le=50)] = 4
    """Number of best grid candidates that are refined [1]."""


class Goal(Description):
    """Required performance, waters, targets and available components of a design.

    Examples
    --------
    >>> goal = Goal.from_toml("examples/goals/harbour_wall.toml")  # doctest: +SKIP
    >>> goal.accuracy.total_error  # doctest: +SKIP
    """

    name: Annotated[str, Field(min_length=1, max_length=200)]
    """Title of the design."""
    distances: (
        Annotated[
            tuple[Annotated[Length, Field(gt=0, le=100)], ...],
            Field(min_length=1, max_length=20),
        ]
        | DistanceRange
    )
    """Slant ranges with required accuracy: a list, or nearest and farthest [m]."""
    interval: Interval | None = None
    """Prior limits of the slant range; from 0 to 1.1 times the farthest distance by
    default.
    """
    accuracy: Accuracy
    """Required accuracy of the range."""
    waters: Waters
    """Waters, with ranges of their properties."""
    targets: Targets
    """Target surfaces, with ranges of their properties."""
    scan: ScanGoal
    """Scan pattern and available time."""
    vehicle: Vehicle | None = None
    """Vehicle that carries the instrument, and the area to survey; none by default."""
    components: Components
    """Available components."""
    aim: Annotated[Length, Field(gt=0)] | None = None
    """Distance where the receiver's axis meets the beam; by default the harmonic mean
    of nearest and farthest distance [m]."""
    detector: Detector = Detector()
    """Photomultiplier, as in a survey."""
    lock_in: LockIn = LockIn()
    """Lock-in amplifier; its time constant is limited to a tenth of the dwell time."""
    window: Window | None = None
    """Window, as in a survey."""
    daylight: Daylight | None = None
    """Daylight, as in a survey."""
    calibration: Calibration | None = None
    """Calibration, as in a survey."""
    assumptions: Assumptions = Assumptions()
    """Assumed uncertainties of the water."""
    effort: Effort = Effort()
    """Computing effort of the search."""

    @model_validator(mode="after")
    def _distances_lie_in_the_interval(self) -> Self:
        interval = self.interval
        if interval is None:
            return self
        outside = [
            d for d in self.asked if not interval.nearest <= d < interval.farthest
        ]
        if outside:
            raise ValueError(
                f"distances holds {outside[0]:g} m, which is not within the interval "
                f"from {interval.nearest:g} to {interval.farthest:g} m"
            )
        return self

    @model_validator(mode="after")
    def _rows_are_of_scan_or_vehicle(self) -> Self:
        scan = self.scan
        stated = [
            name for name in ("rows", "elevation_span")
            if getattr(scan, name) is not None
        ]  # fmt: skip
        if self.vehicle is None and len(stated) < 2:
            raise ValueError(
                "scan needs rows and elevation_span; only a [vehicle] makes the rows "
                "by its motion"
            )
        if self.vehicle is not None and stated:
            raise ValueError(
                f"scan.{stated[0]} and [vehicle] are both stated; the vehicle moves "
                "from row to row, so leave out rows and elevation_span"
            )
        if self.vehicle is not None and scan.azimuth_span == 0:
            raise ValueError(
                "scan.azimuth_span is 0, so that survey lines have no width; state the "
                "angle of a row across the course"
            )
        return self

    @property
    def asked(self) -> tuple[float, ...]:
        """Slant ranges at which the accuracy is required, increasing [m]."""
        distances = self.distances
        if isinstance(distances, DistanceRange):
            steps = np.linspace(distances.nearest, distances.farthest, distances.count)
            return tuple(map(float, steps))
        return tuple(sorted(distances))

    @property
    def limits(self) -> tuple[float, float]:
        """Nearest and farthest possible slant range [m]."""
        if self.interval is not None:
            return self.interval.nearest, self.interval.farthest
        return 0.0, 1.1 * self.asked[-1]

    @property
    def assumed(self) -> dict[str, Any]:
        """Assumed parameter values for `evaluate`."""
        return {"texture": 0.0, **self.assumptions.model_dump()}

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a goal from a TOML file.

        Parameters
        ----------
        path : str or pathlib.Path
            Goal file (TOML).

        Returns
        -------
        Goal
            Goal in SI units.

        Raises
        ------
        SurveyError
            If the file is invalid. The message has one line per error: file, field,
            value found and values allowed.
        """
        text = toml_file.text_of(path, error=SurveyError)
        return cls.from_text(text, name=str(path))

    @classmethod
    def from_text(cls, text: str, *, name: str = "goal") -> Self:
        """Read a goal from TOML text.

        Parameters
        ----------
        text : str
            Content of a goal file (TOML).
        name : str
            Name of the goal in messages.

        Returns
        -------
        Goal
            Goal in SI units.

        Raises
        ------
        SurveyError
            As `from_toml`.
        """
        return toml_file.described(
            text, cls, name=name, what="a goal", error=SurveyError
        )


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of goal files, for checks in an editor.

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
