"""Phase along a flat plate in four waters, for figures 10 to 12."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.studies.ricci2010.results import Check, Statements
from amulor.studies.ricci2010.scenes.milk import (
    PIXELS,
    LineLight,
    line_light,
    open_water,
)
from amulor.studies.ricci2010.study import Study

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Lines = dict[str, LineLight]

#: Input number with the turbidity of each panel.
TURBIDITIES: dict[str, str] = {
    step: f"attenuation_{step}" for step in ("tap", "b", "c", "d")
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """Phase advance along a line of pixels behind one polarizer pair.

    Light of the water comes back before that of the plate, and the phase that the paper
    draws grows with its share: what it counts is an advance, not a delay.
    """

    phase: Array
    """Phase without noise, zero at the first pixel, shape (80,) [degrees]."""
    measured: Array
    """Simulated phase with noise, zero at the first pixel, shape (80,) [degrees]."""
    drift: float
    """Linear phase drift from first to last pixel, fitted to `phase` [degrees]."""
    error: float
    """Standard error of `drift`, from Monte Carlo [degrees]."""
    fitted: float
    """Linear phase drift fitted to `measured` [degrees]."""
    fitted_error: float
    """Standard error of `fitted`, from the noise [degrees]."""
    bend: float
    """Largest deviation of `phase` from linearity, relative to the drift [1]."""
    bend_error: float
    """Standard error of `bend`, from Monte Carlo [1]."""


def _light_of(step: str) -> Callable[[Study], Lines]:
    """Return a function that computes the light over the plate in a given water."""

    def light(study: Study) -> Lines:
        return line_light(study, study[TURBIDITIES[step]])

    return light


def _open_water_of(step: str) -> Callable[[Study], dict[str, Complex]]:
    """Return a function that computes the light in a given water without the plate."""

    def light(study: Study) -> dict[str, Complex]:
        return open_water(study, study[TURBIDITIES[step]])

    return light


#: Light of each water; a study computes each of these once.
LIGHT = {step: _light_of(step) for step in TURBIDITIES}
OPEN_WATER = {step: _open_water_of(step) for step in TURBIDITIES}


def line(study: Study, step: str, pair: str) -> Line:
    """Return the phase along a line of pixels over the plate."""
    light = study.once(LIGHT[step])[pair]
    phase = advance_along(light.signal)
    sigma = float(np.degrees(study["phase_noise"]))
    noise = study.rng(f"line {step} {pair}").normal(0.0, sigma, PIXELS)
    measured = phase + noise
    rise = rise_weight()
    # What a phase departs from the straight line through it.
    straight = np.linspace(-0.5, 0.5, PIXELS)
    bent = np.eye(PIXELS) - 1 / PIXELS - np.outer(straight, rise)
    drift = float(rise @ phase)
    departure = bent @ phase
    furthest = int(np.argmax(np.abs(departure)))
    return Line(
        phase=phase,
        measured=measured - measured[0],
        drift=drift,
        error=standard_error(light.phase_batches @ rise),
        fitted=float(rise @ measured),
        fitted_error=float(sigma * np.linalg.norm(rise)),
        bend=float(np.abs(departure[furthest] / drift)),
        bend_error=standard_error(light.phase_batches @ bent[furthest]) / abs(drift),
    )


def standard_error(batches: Array) -> float:
    """Convert batch values [rad] to the standard error of their mean [degrees]."""
    return float(np.degrees(np.std(batches) / np.sqrt(batches.size - 1)))


def difference(study: Study, step: str, pairs: tuple[str, str]) -> tuple[float, float]:
    """Return the difference of drift sizes of two polarizer pairs, with error [deg]."""
    first, second = (line(study, step, pair).drift for pair in pairs)
    light, dark = (study.once(LIGHT[step])[pair].phase_batches for pair in pairs)
    sign = np.sign(first * second)
    return abs(first) - abs(second), standard_error(
        (light - sign * dark) @ rise_weight()
    )


def corrected(study: Study, step: str, pair: str) -> Array:
    """Return the phase after subtraction of the open-water signal [degrees]."""
    light = study.once(LIGHT[step])[pair]
    water = study.once(OPEN_WATER[step])[pair]
    return advance_along(light.signal - water)


def rejected_share(study: Study, step: str, pairs: tuple[str, str]) -> float:
    """Return the share of the first of two polarizer pairs in the water's light [1]."""
    light = study.once(LIGHT[step])
    crossed, parallel = (np.abs(light[pair].water) for pair in pairs)
    return float(np.mean(crossed / (crossed + parallel)))


def water_over_plate(study: Study, step: str, pair: str) -> Array:
    """Return the ratio of water light to plate light at each pixel."""
    light = study.once(LIGHT[step])[pair]
    ratio: Array = np.abs(light.water) / np.abs(light.target)
    return ratio


def advance_along(signal: Complex) -> Array:
    """Return the phase advance along a line, relative to its first pixel [degrees]."""
    delay: Array = np.degrees(np.unwrap(np.angle(signal)))
    advance: Array = delay[0] - delay
    return advance


def rise_weight() -> Array:
    """Return pixel weights that give the phase drift of a linear fit."""
    pixel = np.arange(PIXELS) - 0.5 * (PIXELS - 1)
    weight: Array = pixel / (pixel @ pixel) * (PIXELS - 1)
    return weight


#: Drift that the phase error of the apparatus hides [degrees].
FLAT = 0.25
#: Departure of a straight drift, over the drift [1].
STRAIGHT = 0.15
#: Standard errors of the Monte Carlo by which a limit must be passed to count.
SURE = 2.0


def drift_check(study: Study, rows: Statements, name: str) -> Check:
    """Check the phase drift along a line: within limits, absent, or present."""
    result = line(study, *name.split("_"))
    kind = rows.checks[name]["kind"]
    check = rows.within(
        name,
        result.drift,
        {"flat": -FLAT, "moves": FLAT}.get(kind, -np.inf),
        FLAT if kind == "flat" else np.inf,
        uncertainty=result.error,
        note=f" (fit to the synthetic line: {result.fitted:.2f} ± "
        f"{result.fitted_error:.2f} deg)",
    )
    if kind == "flat":
        return allowing(check, abs(result.drift) - SURE * result.error <= FLAT)
    if kind == "moves":
        return surely(check, result.drift - SURE * result.error >= FLAT)
    return check


def straight_check(study: Study, rows: Statements, step: str, pair: str) -> Check:
    """Check that the phase is nearly linear along a line of pixels."""
    result = line(study, step, pair)
    check = rows.within(
        f"{step}_straight", result.bend, high=STRAIGHT, uncertainty=result.bend_error
    )
    return allowing(check, result.bend - SURE * result.bend_error <= STRAIGHT)


def surely(check: Check, passed: bool) -> Check:
    """Set the outcome of a check, requiring a margin of two standard errors."""
    requirement = f"{check.wanted}, by {SURE:g} standard errors"
    return replace(check, passed=bool(passed), wanted=requirement)


def allowing(check: Check, passed: bool) -> Check:
    """Set the outcome of a check, allowing a tolerance of two standard errors."""
    requirement = f"{check.wanted}, within {SURE:g} standard errors"
    return replace(check, passed=bool(passed), wanted=requirement)
