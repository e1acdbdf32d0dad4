"""The parts of a goal: distances, accuracy, waters, targets, scan, components."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from amulor.design.goal.spread import AngleSpread, CoefficientSpread, FractionSpread
from amulor.design.methods import Method
from amulor.optics.polarization import stokes
from amulor.survey import OpenWater
from amulor.survey.mueller import ReducedMueller
from amulor.survey.quantity import (
    Angle,
    Count,
    Description,
    Fraction,
    Frequency,
    Length,
    Power,
    Time,
    Wavelength,
)
from amulor.survey.target import PAINTED_METAL
from amulor.survey.waters.named import WaterStated

_Money = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Distance = Annotated[Length, Field(gt=0, le=100)]
_Tone = Annotated[Frequency, Field(gt=0, le=10e9)]
#: Channels joined by a plus sign.
Scheme = Annotated[
    str,
    Field(pattern=rf"^({stokes.PAIR_PATTERN})( ?\+ ?({stokes.PAIR_PATTERN}))*$"),
]


class DistanceRange(Description):
    """Distances from one to another."""

    nearest: _Distance
    """The first one [m]."""
    farthest: _Distance
    """The last one [m]."""
    count: Annotated[Count, Field(ge=2, le=20)] = 5
    """How many, evenly apart [1]."""

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if self.farthest <= self.nearest:
            raise ValueError(
                f"farthest ({self.farthest:g} m) must lie beyond nearest "
                f"({self.nearest:g} m)"
            )
        return self


class Interval(Description):
    """Limits of the range that are known before anything is measured."""

    nearest: Annotated[Length, Field(ge=0)]
    """Nearest slant range that is possible [m]."""
    farthest: Annotated[Length, Field(gt=0)]
    """Farthest one [m]."""

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if self.farthest <= self.nearest:
            raise ValueError(
                f"farthest ({self.farthest:g} m) must lie beyond nearest "
                f"({self.nearest:g} m)"
            )
        return self


class Accuracy(Description):
    """How good the range must be."""

    total_error: Annotated[Length, Field(gt=0)]
    """Largest root of squared standard uncertainty and residual bias of one pixel
    [m]."""
    share: Annotated[Fraction, Field(gt=0, le=1)] = 0.9
    """Share of the waters and targets in which that must hold [1]."""
    wrong_interval: Annotated[Fraction, Field(gt=0, lt=0.5)] = 0.001
    """Largest probability of a wrong ambiguity interval [1]."""


class Waters(Description):
    """The water, and how it may differ from what is stated."""

    base: WaterStated
    """The water, as in a survey."""
    attenuation: CoefficientSpread | None = None
    """Range of a + b at the wavelength of the first laser, in the proportion of the
    base; as the base if left out [1/m]."""
    absorption: CoefficientSpread | None = None
    """Range of a, in place of the attenuation [1/m]."""
    scattering: CoefficientSpread | None = None
    """Range of b, in place of the attenuation [1/m]."""
    fluctuation: FractionSpread | None = None
    """Range of the random change of the water signal from sample to sample [1]."""
    m22: FractionSpread | None = None
    """Range of the water's Mueller element m22, 1 for what keeps the polarization
    [1]."""

    @model_validator(mode="after")
    def _is_stated_once(self) -> Self:
        if self.attenuation is not None and (self.absorption or self.scattering):
            raise ValueError(
                "attenuation is the sum of absorption and scattering; state its range "
                "alone, or those of the other two"
            )
        return self


class Targets(Description):
    """What the surfaces are like."""

    reflectance: FractionSpread
    """Range of the reflectance [1]."""
    mueller: ReducedMueller = PAINTED_METAL
    """Reduced Mueller matrix straight backwards, as in a survey [1]."""
    m22: FractionSpread | None = None
    """Range of its element m22, 0 for what loses the polarization [1]."""
    slope: AngleSpread | None = None
    """Range of the inclination of the surface; it faces the beam if left out [rad]."""
    texture: FractionSpread | None = None
    """Range of the relative change of the reflectance over the half-width of the beam;
    none if left out [1]."""


class ScanGoal(Description):
    """The picture that is wanted, and how long it may take."""

    columns: Annotated[Count, Field(ge=1, le=20_000)]
    """Pixels along a row [1]."""
    rows: Annotated[Count, Field(ge=1, le=20_000)]
    """Rows of pixels [1]."""
    azimuth_span: Annotated[Angle, Field(ge=0, lt=math.pi)]
    """Angle between the first and the last column [rad]."""
    elevation_span: Annotated[Angle, Field(ge=0, lt=math.pi)]
    """Angle between the first and the last row [rad]."""
    longest: Annotated[Time, Field(gt=0)]
    """Longest time for all pixels [s]."""
    moves: Literal["beam", "both"] = "both"
    """What turns: the beam alone, or emitter and receiver together."""
    open_water: OpenWater = OpenWater(columns=9, rows=3, repeats=20)
    """Shots without a target."""


class Laser(Description):
    """A laser, and what goes with its wavelength."""

    name: Annotated[str, Field(min_length=1, max_length=80)]
    """What it is called."""
    wavelength: Annotated[Wavelength, Field(ge=400e-9, le=700e-9)]
    """Wavelength in vacuum [m]."""
    powers: Annotated[
        tuple[Annotated[Power, Field(gt=0)], ...], Field(min_length=1, max_length=20)
    ]
    """Mean powers to choose from [W]."""
    modulation_depth: Annotated[Fraction, Field(gt=0, le=1)] = 0.8
    """Depth of the intensity modulation [1]."""
    top_frequency: _Tone | None = None
    """Highest modulation frequency; any if left out [Hz]."""
    beam_radius: Annotated[Length, Field(ge=0, le=0.5)] | None = None
    """1/e half-width of the beam at its start [m]."""
    beam_divergence: Annotated[Angle, Field(ge=0, le=0.2)] | None = None
    """1/e semi-angle of the beam [rad]."""
    quantum_efficiency: Annotated[Fraction, Field(gt=0, le=1)] | None = None
    """Photoelectrons per photon at this wavelength; that of the detector if left out
    [1]."""
    water: WaterStated | None = None
    """The base water at this wavelength, where its coefficients do not follow from
    what is stated."""
    price: _Money = 0.0
    """Price of the laser [currency]."""
    price_per_watt: _Money = 0.0
    """Price of each watt of mean power in addition [currency/W]."""


class Modulation(Description):
    """Modulation frequencies to choose from."""

    lowest: _Tone | None = None
    """Lowest frequency of a grid [Hz]."""
    highest: _Tone | None = None
    """Highest frequency of a grid [Hz]."""
    count: Annotated[Count, Field(ge=2, le=200)] = 25
    """Frequencies of the grid, evenly apart in the logarithm [1]."""
    frequencies: tuple[_Tone, ...] = ()
    """Frequencies in place of a grid, increasing [Hz]."""
    sets: tuple[Annotated[tuple[_Tone, ...], Field(min_length=1)], ...] = ()
    """Whole sets in place of frequencies to combine [Hz]."""
    most: Annotated[Count, Field(ge=1, le=6)] = 2
    """Frequencies that are measured at every pixel, at most [1]."""
    price_each: _Money = 0.0
    """Price of each frequency after the first [currency]."""

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
        for one in (self.frequencies, *self.sets):
            if any(b <= a for a, b in pairwise(one)):
                raise ValueError("frequencies must increase and hold each one once")
        return self


class _Box(Description):
    count: Annotated[Count, Field(ge=2, le=50)] = 4
    """Values between low and high that are looked at first, evenly apart in the
    logarithm [1]."""
    prices: tuple[_Money, ...] = ()
    """Price of each of the values [currency]."""

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
            raise ValueError("values must increase")
        if self.prices and len(self.prices) != len(values):
            raise ValueError(
                f"{len(values)} values need as many prices, found {len(self.prices)}"
            )
        return self


class LengthBox(_Box):
    """Lengths to choose from, or the ends of a range."""

    values: tuple[Annotated[Length, Field(gt=0)], ...] = ()
    """Values to choose from [m]."""
    low: Annotated[Length, Field(gt=0)] | None = None
    """Lower end of what may be chosen [m]."""
    high: Annotated[Length, Field(gt=0)] | None = None
    """Upper end [m]."""


class AngleBox(_Box):
    """Angles to choose from, or the ends of a range."""

    values: tuple[Annotated[Angle, Field(gt=0, le=0.5)], ...] = ()
    """Values to choose from [rad]."""
    low: Annotated[Angle, Field(gt=0)] | None = None
    """Lower end of what may be chosen [rad]."""
    high: Annotated[Angle, Field(gt=0, le=0.5)] | None = None
    """Upper end [rad]."""


class TimeBox(_Box):
    """Times to choose from, or the ends of a range."""

    values: tuple[Annotated[Time, Field(gt=0)], ...] = ()
    """Values to choose from [s]."""
    low: Annotated[Time, Field(gt=0)] | None = None
    """Lower end of what may be chosen [s]."""
    high: Annotated[Time, Field(gt=0)] | None = None
    """Upper end [s]."""


#: Any of them.
Box = LengthBox | AngleBox | TimeBox


class Components(Description):
    """What the instrument may be made of."""

    lasers: Annotated[tuple[Laser, ...], Field(min_length=1)]
    """Lasers to choose from."""
    modulation: Modulation
    """Modulation frequencies to choose from."""
    baseline: LengthBox
    """Distance of emitter and receiver [m]."""
    radius: LengthBox
    """1/e half-width of the receiver's aperture [m]."""
    field_of_view: AngleBox
    """1/e half-width of the receiver's field of view [rad]."""
    dwell: TimeBox
    """Time on each pixel, frequency and channel [s]."""
    polarizations: Annotated[tuple[Scheme, ...], Field(min_length=1)]
    """Schemes to choose from: channels joined by a plus sign, such as "VH", "VV+VH"."""
    methods: Annotated[tuple[Method, ...], Field(min_length=1)] = ("open-water",)
    """Ways to take the water out, by the names of `amulor reject`."""
    price_per_channel: _Money = 0.0
    """Price of each polarization channel after the first [currency]."""
    budget: _Money | None = None
    """Largest sum of all prices; any if left out [currency]."""

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [laser.name for laser in self.lasers]
        twice = [name for name in names if names.count(name) > 1]
        if twice:
            raise ValueError(f"two lasers are called {twice[0]!r}")
        return self


class Assumptions(Description):
    """How well the water will be known when the scan is worked on."""

    water_change: Annotated[Fraction, Field(ge=0, le=1)] = 0.01
    """Relative change of the water signal between the shots and the scan [1]."""
    column_uncertainty: Annotated[Fraction, Field(ge=0, le=1)] = 0.1
    """Relative uncertainty of the water behind the target [1]."""
    ratio_uncertainty: Annotated[Fraction, Field(ge=0, le=1)] = 0.01
    """Uncertainty of the water's depolarization ratio [1]."""
    departure: Annotated[Fraction, Field(ge=0, le=1)] = 0.003
    """Relative departure of the water signal from the model of the joint estimation
    [1]."""


class Effort(Description):
    """How long the search may be."""

    draws: Annotated[Count, Field(ge=4, le=4096)] = 64
    """Waters and targets that are drawn from their ranges [1]."""
    refined: Annotated[Count, Field(ge=1, le=50)] = 4
    """Candidates of the grid that are refined [1]."""
