"""From a choice of components to the survey that stands for it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from amulor.design import geometry
from amulor.design.goal import Goal
from amulor.design.goal.parts import Box, Laser
from amulor.design.goal.spread import Spread
from amulor.design.methods import PREDICTED
from amulor.errors import SurveyError
from amulor.rejection.channels import PARTNERS
from amulor.survey import Instrument, Plate, Receiver, Scan, Survey, water_properties
from amulor.survey.instrument import Emitter
from amulor.survey.mueller import matrix

__all__ = [
    "Parameters",
    "aim_of_goal",
    "box_values",
    "cost_of",
    "first_choice",
    "fits",
    "frequency_grid",
    "middle",
    "scan_time",
    "survey_of",
    "water_scale",
]

#: Share of the dwell that the lock-in's time constant may have [1].
_LOCK_IN = 0.1


@dataclass(frozen=True, kw_only=True)
class Parameters:
    """One instrument: what a goal leaves to be chosen.

    Examples
    --------
    >>> chosen = recommend(goal).best.parameters  # doctest: +SKIP
    >>> survey = survey_of(goal, chosen)  # doctest: +SKIP
    """

    laser: str
    """Name of the laser."""
    power: float
    """Mean launched power [W]."""
    frequencies: tuple[float, ...]
    """Modulation frequencies, increasing [Hz]."""
    baseline: float
    """Distance of emitter and receiver [m]."""
    radius: float
    """1/e half-width of the aperture [m]."""
    field_of_view: float
    """1/e half-width of the field of view [rad]."""
    dwell: float
    """Time on each pixel, frequency and channel [s]."""
    polarization: str
    """Channels joined by a plus sign."""
    method: str
    """How the water is taken out."""

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers by name, in SI units."""
        return {**asdict(self), "frequencies": list(self.frequencies)}


def laser_of(goal: Goal, name: str) -> Laser:
    """Return the laser of a name."""
    for laser in goal.components.lasers:
        if laser.name == name:
            return laser
    raise SurveyError(f"no laser of the goal is called {name!r}")


def middle(spread: Spread) -> float:
    """Return the median of a range."""
    if spread.distribution.startswith("log"):
        return math.sqrt(spread.low * spread.high)
    return (spread.low + spread.high) / 2


def box_values(box: Box) -> tuple[float, ...]:
    """Return the values of a box that are looked at first, increasing."""
    if box.values:
        return box.values
    assert box.low is not None
    assert box.high is not None
    return tuple(map(float, np.geomspace(box.low, box.high, box.count)))


def frequency_grid(goal: Goal) -> tuple[float, ...]:
    """Return the single frequencies to choose from, increasing [Hz]."""
    stated = goal.components.modulation
    if stated.sets:
        return tuple(sorted({f for one in stated.sets for f in one}))
    if stated.frequencies:
        return stated.frequencies
    assert stated.lowest is not None
    assert stated.highest is not None
    return tuple(map(float, np.geomspace(stated.lowest, stated.highest, stated.count)))


def aim_of_goal(goal: Goal) -> float:
    """Return the distance at which receivers are aimed [m]."""
    if goal.aim is not None:
        return goal.aim
    near, far = goal.asked[0], goal.asked[-1]
    return 2 * near * far / (near + far)


def first_choice(goal: Goal) -> Parameters:
    """Return the first of each choice."""
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
    )


def fits(goal: Goal) -> Iterator[tuple[str, str]]:
    """Yield the schemes and methods that go together."""
    parts = goal.components
    found = False
    for scheme, method in itertools.product(parts.polarizations, parts.methods):
        pairs = {part.strip() for part in scheme.split("+")}
        paired = any({co, cross} <= pairs for co, cross in PARTNERS.items())
        if PREDICTED[method].channel_pair and not paired:
            continue
        found = True
        yield "+".join(part.strip() for part in scheme.split("+")), method
    if not found:
        raise SurveyError(
            "components: no polarization scheme fits a method; polarization and "
            'combined need a pair such as "VV+VH"'
        )


def cost_of(goal: Goal, chosen: Parameters) -> float:
    """Return the sum of the prices of a choice [currency]."""
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


def scan_time(goal: Goal, chosen: Parameters) -> float:
    """Return how long all pixels take [s]."""
    samples = len(chosen.frequencies) * len(chosen.polarization.split("+"))
    return goal.scan.rows * goal.scan.columns * samples * chosen.dwell


def depolarizing(stated: Any, m22: float) -> tuple[tuple[float, ...], ...]:
    """Return a Mueller matrix that keeps more or less of the polarization."""
    known = matrix(stated)
    if known[1, 1] == 0:
        known = np.diag([1.0, 1.0, -1.0, -1.0])
    scaled = known * (m22 / known[1, 1])
    scaled[0, 0] = 1.0
    return tuple(tuple(map(float, row)) for row in scaled)


def water_scale(goal: Goal, chosen: Parameters) -> dict[str, float]:
    """Return water at the wavelength of an instrument over that of the ranges."""
    first = goal.components.lasers[0].name
    if chosen.laser == first:
        return {}
    own = water_properties(survey_of(goal, chosen))
    base = water_properties(survey_of(goal, replace(chosen, laser=first)))
    return {
        name: getattr(own, name) / getattr(base, name)
        for name in ("attenuation", "absorption", "scattering")
        if getattr(base, name) > 0 and math.isfinite(getattr(own, name))
    }


def survey_of(goal: Goal, chosen: Parameters) -> Survey:
    """Return the survey of a choice, with a plate at the middle distance."""
    laser = laser_of(goal, chosen.laser)
    detector = goal.detector
    if laser.quantum_efficiency is not None:
        detector = detector.model_copy(
            update={"quantum_efficiency": laser.quantum_efficiency}
        )
    constant = min(goal.lock_in.time_constant, _LOCK_IN * chosen.dwell)
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
    scan = goal.scan
    width = 2.2 * distance * math.tan(scan.azimuth_span / 2) + 0.1
    height = 2.2 * distance * math.tan(scan.elevation_span / 2) + 0.1
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
            modulation_depth=laser.modulation_depth,
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
            rows=scan.rows,
            azimuth_span=scan.azimuth_span,
            elevation_span=scan.elevation_span,
            dwell=chosen.dwell,
            moves=scan.moves,
            open_water=scan.open_water,
        ),
        calibration=goal.calibration,
        daylight=goal.daylight,
    )
    return geometry.with_receiver(bare, baseline=chosen.baseline, aim=distance)
