"""Candidate instruments for a goal: components, surveys, randomly drawn waters."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, qmc

from amulor.design import geometry
from amulor.design.axes import LOCK_IN_SHARE, PREDICTED
from amulor.design.goal import Box, FractionSpread, Goal, Laser, Spread
from amulor.design.vehicle import Lines, Readings
from amulor.errors import SurveyError
from amulor.rejection.channels import PARTNERS
from amulor.survey import (
    Instrument,
    LineCourse,
    Mounting,
    Plate,
    Platform,
    Pose,
    Receiver,
    Scan,
    Survey,
    water_properties,
)
from amulor.survey.instrument import Emitter
from amulor.survey.mueller import matrix

__all__ = [
    "Parameters",
    "aim_of_goal",
    "box_values",
    "cost_of",
    "depth_of",
    "drawn",
    "first_choice",
    "fits",
    "frequency_grid",
    "lines_of",
    "longest_dwell",
    "middle",
    "readings_of",
    "scan_time",
    "spreads_of",
    "survey_of",
    "values_at",
    "water_scale",
]


#: Rows of a survey, at most.
_MOST_ROWS = 20_000


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """Parameters of one candidate instrument.

    Examples
    --------
    >>> chosen = recommend(goal).best.parameters  # doctest: +SKIP
    >>> survey = survey_of(goal, chosen)  # doctest: +SKIP
    """

    laser: str
    """Name of the laser."""
    power: float
    """Mean launched laser power [W]."""
    frequencies: tuple[float, ...]
    """Modulation frequencies, increasing [Hz]."""
    baseline: float
    """Distance between emitter and receiver [m]."""
    radius: float
    """1/e half-width of the receiver aperture [m]."""
    field_of_view: float
    """1/e half-width of the receiver's field of view [rad]."""
    dwell: float
    """Dwell time per pixel, frequency and channel [s]."""
    polarization: str
    """Polarization channels joined by a plus sign, such as "VV+VH"."""
    method: str
    """Rejection method."""
    readings: Readings = "in-turn"
    """Readings of a pixel at its frequencies and channels: one after another, or all at
    once."""

    @property
    def in_turn(self) -> int:
        """Number of readings of a pixel that follow one another [1]."""
        if self.readings == "at-once":
            return 1
        return len(self.frequencies) * len(self.polarization.split("+"))

    def to_dict(self) -> dict[str, Any]:
        """Return the parameters by name, in SI units."""
        return {**asdict(self), "frequencies": list(self.frequencies)}


def laser_of(goal: Goal, name: str) -> Laser:
    """Laser of a goal, by its name."""
    for laser in goal.components.lasers:
        if laser.name == name:
            return laser
    raise SurveyError(f"no laser of the goal is called {name!r}")


def middle(spread: Spread) -> float:
    """Median of a parameter's distribution over its range."""
    if spread.distribution.startswith("log"):
        return math.sqrt(spread.low * spread.high)
    return (spread.low + spread.high) / 2


def box_values(box: Box) -> tuple[float, ...]:
    """Return the listed values of a component, or grid values of its range."""
    if box.values:
        return box.values
    assert box.low is not None
    assert box.high is not None
    return tuple(map(float, np.geomspace(box.low, box.high, box.count)))


def frequency_grid(goal: Goal) -> tuple[float, ...]:
    """Modulation frequencies available in a goal, increasing [Hz]."""
    modulation = goal.components.modulation
    if modulation.sets:
        return tuple(sorted({f for members in modulation.sets for f in members}))
    if modulation.frequencies:
        return modulation.frequencies
    assert modulation.lowest is not None
    assert modulation.highest is not None
    return tuple(
        map(
            float, np.geomspace(modulation.lowest, modulation.highest, modulation.count)
        )
    )


def aim_of_goal(goal: Goal) -> float:
    """Distance at which a candidate's receiver axis meets the beam [m]."""
    if goal.aim is not None:
        return goal.aim
    near, far = goal.asked[0], goal.asked[-1]
    return 2 * near * far / (near + far)


def first_choice(goal: Goal) -> Parameters:
    """Candidate with the first listed value of each component."""
    parts = goal.components
    modulation = parts.modulation
    first = modulation.sets[0] if modulation.sets else frequency_grid(goal)[:1]
    polarization, method = next(fits(goal))
    return Parameters(
        laser=parts.lasers[0].name,
        power=parts.lasers[0].powers[0],
        frequencies=tuple(first),
        baseline=box_values(parts.baseline)[0],
        radius=box_values(parts.radius)[0],
        field_of_view=box_values(parts.field_of_view)[0],
        dwell=box_values(parts.dwell)[0],
        polarization=polarization,
        method=method,
        readings=readings_of(goal)[0],
    )


def readings_of(goal: Goal) -> tuple[Readings, ...]:
    """Possible orders of the readings of a pixel."""
    return ("in-turn",) if goal.vehicle is None else goal.vehicle.readings


def depth_of(laser: Laser, frequencies: int, readings: Readings) -> float:
    """Modulation depth of each frequency; those at once share that of the laser [1]."""
    return laser.modulation_depth / (frequencies if readings == "at-once" else 1)


def fits(goal: Goal) -> Iterator[tuple[str, str]]:
    """Yield compatible pairs of polarization scheme and rejection method."""
    parts = goal.components
    any_fit = False
    for scheme, method in itertools.product(parts.polarizations, parts.methods):
        pairs = {part.strip() for part in scheme.split("+")}
        paired = any({co, cross} <= pairs for co, cross in PARTNERS.items())
        if PREDICTED[method].channel_pair and not paired:
            continue
        any_fit = True
        yield "+".join(part.strip() for part in scheme.split("+")), method
    if not any_fit:
        raise SurveyError(
            "components: no polarization scheme fits a method; polarization and "
            'combined need a pair such as "VV+VH"'
        )


def cost_of(goal: Goal, chosen: Parameters) -> float:
    """Total price of a candidate [currency]."""
    parts = goal.components
    laser = laser_of(goal, chosen.laser)
    channels = len(chosen.polarization.split("+"))
    total = laser.price + laser.price_per_watt * chosen.power
    total += parts.modulation.price_each * (len(chosen.frequencies) - 1)
    total += parts.price_per_channel * (channels - 1)
    for name in ("baseline", "radius", "field_of_view", "dwell"):
        box: Box = getattr(parts, name)
        if box.prices:
            total += float(np.interp(getattr(chosen, name), box.values, box.prices))
    return total


def lines_of(goal: Goal, chosen: Parameters) -> Lines | None:
    """Survey lines of a vehicle with an instrument; None without a vehicle."""
    if goal.vehicle is None:
        return None
    laser, farthest = laser_of(goal, chosen.laser), goal.asked[-1]
    widening = (laser.beam_divergence or 0.0) * farthest
    return goal.vehicle.plan(
        columns=goal.scan.columns,
        span=goal.scan.azimuth_span,
        nearest=goal.asked[0],
        farthest=farthest,
        pixel_time=chosen.in_turn * chosen.dwell,
        spot=2 * math.hypot(laser.beam_radius or 0.0, widening),
    )


def scan_time(goal: Goal, chosen: Parameters) -> float:
    """Time for all pixels, or for all survey lines of a vehicle [s]."""
    lines = lines_of(goal, chosen)
    if lines is not None:
        return lines.time
    assert goal.scan.rows is not None
    return goal.scan.rows * goal.scan.columns * chosen.in_turn * chosen.dwell


def longest_dwell(goal: Goal, chosen: Parameters) -> float:
    """Dwell with which an instrument just meets scan time and density of rows [s]."""
    scan = goal.scan
    if goal.vehicle is not None:
        pixel = goal.vehicle.longest_pixel(
            columns=scan.columns,
            span=scan.azimuth_span,
            nearest=goal.asked[0],
            longest=scan.longest,
        )
    else:
        assert scan.rows is not None
        pixel = scan.longest / (scan.rows * scan.columns)
    return pixel / chosen.in_turn


def depolarizing(mueller: Any, m22: float) -> tuple[tuple[float, ...], ...]:
    """Mueller matrix scaled to an element m22, with element m11 equal to 1."""
    base = matrix(mueller)
    if base[1, 1] == 0:
        base = np.diag([1.0, 1.0, -1.0, -1.0])
    scaled = base * (m22 / base[1, 1])
    scaled[0, 0] = 1.0
    return tuple(tuple(map(float, row)) for row in scaled)


def water_scale(goal: Goal, chosen: Parameters) -> dict[str, float]:
    """Water coefficients at a laser's wavelength, relative to the first laser's [1]."""
    first = goal.components.lasers[0].name
    if chosen.laser == first:
        return {}
    properties = water_properties(survey_of(goal, chosen))
    base = water_properties(survey_of(goal, replace(chosen, laser=first)))
    return {
        name: getattr(properties, name) / getattr(base, name)
        for name in ("attenuation", "absorption", "scattering")
        if getattr(base, name) > 0 and math.isfinite(getattr(properties, name))
    }


def survey_of(goal: Goal, chosen: Parameters) -> Survey:
    """Survey of a candidate, with a plate at the receiver's aiming distance."""
    laser = laser_of(goal, chosen.laser)
    detector = goal.detector
    if laser.quantum_efficiency is not None:
        detector = detector.model_copy(
            update={"quantum_efficiency": laser.quantum_efficiency}
        )
    constant = min(goal.lock_in.time_constant, LOCK_IN_SHARE * chosen.dwell)
    water = laser.water or goal.waters.base
    changes: dict[str, Any] = {}
    if goal.waters.fluctuation is not None:
        changes["signal_fluctuation"] = middle(goal.waters.fluctuation)
    if goal.waters.m22 is not None:
        changes["backscatter_mueller"] = depolarizing(
            water.backscatter_mueller or "smooth-metal", middle(goal.waters.m22)
        )
    water = water.model_copy(update=changes)
    surface: Any = goal.targets.mueller
    if goal.targets.m22 is not None:
        surface = depolarizing(surface, middle(goal.targets.m22))
    distance = aim_of_goal(goal)
    scan, lines = goal.scan, lines_of(goal, chosen)
    width = 2.2 * distance * math.tan(scan.azimuth_span / 2) + 0.1
    if lines is None:
        assert scan.rows is not None
        rows, length = scan.rows, 0.0
    else:
        rows = min(math.ceil(lines.length / lines.between_rows - 1e-9), _MOST_ROWS)
        length = rows * lines.between_rows
    elevation_span = scan.elevation_span or 0.0
    height = length + 2.2 * distance * math.tan(elevation_span / 2) + 0.1
    bare = Survey(
        name=goal.name,
        water=water,
        targets=(
            Plate(
                kind="plate",
                position=(0.0, 0.0, distance),
                width=width,
                height=height,
                reflectance=middle(goal.targets.reflectance),
                mueller=surface,
            ),
        ),
        instrument=Instrument(
            wavelength=laser.wavelength,
            power=chosen.power,
            modulation_depth=depth_of(laser, len(chosen.frequencies), chosen.readings),
            modulation_frequencies=chosen.frequencies,
            polarizations=tuple(chosen.polarization.split("+")),
            emitter=Emitter(
                beam_radius=laser.beam_radius, beam_divergence=laser.beam_divergence
            ),
            receiver=Receiver(
                position=(chosen.baseline, 0.0, 0.0),
                radius=chosen.radius,
                acceptance=chosen.field_of_view,
            ),
            detector=detector,
            lock_in=goal.lock_in.model_copy(update={"time_constant": constant}),
            window=goal.window,
        ),
        scan=Scan(
            columns=scan.columns,
            rows=rows,
            azimuth_span=scan.azimuth_span,
            elevation_span=elevation_span,
            dwell=chosen.dwell,
            moves=scan.moves,
            open_water=scan.open_water,
        ),
        calibration=goal.calibration,
        daylight=goal.daylight,
        **_carried(goal, chosen, lines, length),
    )
    return geometry.with_receiver(bare, baseline=chosen.baseline, aim=distance)


def _carried(
    goal: Goal, chosen: Parameters, lines: Lines | None, length: float
) -> dict[str, Any]:
    """Pose and vehicle of a survey, above the middle of a line that leads north."""
    if goal.vehicle is None or lines is None:
        return {}
    down = {"pitch": -math.pi / 2}
    return {
        "pose": Pose(**down),
        "platform": Platform(
            course=LineCourse(
                kind="line", start=(0.0, -length / 2, 0.0), speed=lines.speed
            ),
            readings=chosen.readings,
            disturbance=goal.vehicle.disturbance,
            mounting=Mounting(**down),
        ),
    }


Floats = NDArray[np.float64]

#: Half-widths of the central 95 % of a normal distribution, and of its truncation
#: [standard deviations].
_NINETY_FIVE, _CUT = 1.959964, 2 * 1.959964


def spreads_of(goal: Goal) -> dict[str, Spread]:
    """Stated ranges of the water and target properties of a goal, by name."""
    waters, targets = goal.waters, goal.targets
    ranges = {
        "attenuation": waters.attenuation,
        "absorption": waters.absorption,
        "scattering": waters.scattering,
        "fluctuation": waters.fluctuation,
        "water_m22": waters.m22,
        "reflectance": targets.reflectance,
        "target_m22": targets.m22,
        "slope": targets.slope,
        "texture": targets.texture,
    }
    return {name: spread for name, spread in ranges.items() if spread is not None}


def drawn(goal: Goal, count: int | None = None) -> dict[str, Floats]:
    """Random values of water and target properties from a goal's ranges.

    The values are a scrambled Sobol' sequence with a fixed seed, mapped by the inverse
    distributions: equal for equal ranges, and evenly distributed.
    """
    spreads = spreads_of(goal)
    most = goal.effort.draws
    power = int(np.ceil(np.log2(most)))
    sampler = qmc.Sobol(len(spreads), scramble=True, seed=20)
    share = sampler.random_base2(power)[: most if count is None else min(count, most)]
    return {
        name: values_at(spread, share[:, k])
        for k, (name, spread) in enumerate(spreads.items())
    }


def values_at(spread: Spread, share: Floats) -> Floats:
    """Quantiles of a parameter's distribution at cumulative probabilities."""
    low, high = spread.low, spread.high
    logarithm = spread.distribution.startswith("log")
    if logarithm:
        low, high = float(np.log(low)), float(np.log(high))
    place = np.asarray(share, dtype=float)
    if spread.distribution.endswith("normal"):
        cut = norm.cdf(-_CUT)
        deviation = norm.ppf(cut + (1 - 2 * cut) * place) / _NINETY_FIVE
        place = 0.5 + deviation / 2
    values = low + (high - low) * place
    if logarithm:
        return np.asarray(np.exp(values))
    # A normal distribution may exceed the physical limits of the quantity.
    floor = 1e-6 if spread.low > 0 else 0.0
    most = 1.0 if isinstance(spread, FractionSpread) else np.inf
    return np.asarray(np.clip(values, floor, most))
