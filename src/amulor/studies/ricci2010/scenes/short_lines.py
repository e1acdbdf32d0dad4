"""Lines of 80 pixels over a flat plate in four waters, for figures 10 to 12."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator
from numpy.typing import NDArray

from amulor.studies.ricci2010.checks import Check, Role, within
from amulor.studies.ricci2010.figures.drawing import SYNTHETIC
from amulor.studies.ricci2010.scenes.milk_light import LineLight, line_light, open_water
from amulor.studies.ricci2010.scenes.milk_tank import PIXELS
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]
Lines = dict[str, LineLight]

#: Parameter that holds the turbidity of each panel.
TURBIDITIES: dict[str, str] = {
    step: f"attenuation_{step}" for step in ("tap", "b", "c", "d")
}
#: Drift that the phase error of the apparatus hides [degrees].
FLAT = 0.25
#: Departure of a straight drift, over the drift [1].
STRAIGHT = 0.15
#: Standard errors of the Monte Carlo by which a limit must be passed to count.
SURE = 2.0
#: Colour of each pair.
COLOUR = {"VV": COLOURS[0], "VH": COLOURS[1], "RL": COLOURS[2], "RR": COLOURS[3]}


@dataclass(frozen=True, eq=False)
class Line:
    """Phase along a line behind one pair of polarizers."""

    phase: Array
    """Without noise, from zero at the first pixel, shape (80,) [degrees]."""
    offset: float
    """What the noise of the first pixel moves all of `measured` by [degrees]."""
    measured: Array
    """Synthetic measurement, from zero at its first pixel, shape (80,) [degrees]."""
    drift: float
    """Rise of the straight line through `phase` from first to last pixel [degrees]."""
    error: float
    """Standard error of `drift`, from the Monte Carlo [degrees]."""
    fitted: float
    """Rise of the straight line through `measured` [degrees]."""
    fitted_error: float
    """Standard error of `fitted`, from the noise [degrees]."""
    bend: float
    """Largest departure of `phase` from its straight line over the rise of that [1]."""
    bend_error: float
    """Standard error of `bend`, from the Monte Carlo [1]."""


def _light_of(step: str) -> Callable[[Study], Lines]:
    """Return what gives the light over the plate in one of the waters."""

    def light(study: Study) -> Lines:
        return line_light(study, study[TURBIDITIES[step]])

    return light


def _open_water_of(step: str) -> Callable[[Study], dict[str, Complex]]:
    """Return what gives the light of one of the waters without the plate."""

    def light(study: Study) -> dict[str, Complex]:
        return open_water(study, study[TURBIDITIES[step]])

    return light


#: Light of each water; a study computes each of these once.
LIGHT = {step: _light_of(step) for step in TURBIDITIES}
OPEN_WATER = {step: _open_water_of(step) for step in TURBIDITIES}


def line(study: Study, step: str, pair: str) -> Line:
    """Return the phase along a line.

    Parameters
    ----------
    study : Study
        Numbers.
    step : str
        Water, a key of `TURBIDITIES`.
    pair : str
        Launched and analysed state, such as "VH".

    Returns
    -------
    Line
        With its drift.
    """
    light = study.once(LIGHT[step])[pair]
    phase = phase_along(light.signal)
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
        offset=-float(noise[0]),
        measured=measured - measured[0],
        drift=drift,
        error=standard_error(light.phase_batches @ rise),
        fitted=float(rise @ measured),
        fitted_error=float(sigma * np.linalg.norm(rise)),
        bend=float(np.abs(departure[furthest] / drift)),
        bend_error=standard_error(light.phase_batches @ bent[furthest]) / abs(drift),
    )


def standard_error(batches: Array) -> float:
    """Return the standard error of a mean of batches [degrees, of radians]."""
    return float(np.degrees(np.std(batches) / np.sqrt(batches.size - 1)))


def difference(study: Study, step: str, pairs: tuple[str, str]) -> tuple[float, float]:
    """Return how much more a line drifts than another, and its standard error.

    Parameters
    ----------
    study : Study
        Numbers.
    step : str
        Water, a key of `TURBIDITIES`.
    pairs : tuple of str
        Launched and analysed state of the one and of the other.

    Returns
    -------
    drift : float
        Size of the one drift less that of the other [degrees].
    error : float
        Both come from the same paths: less than both errors together [degrees].
    """
    one, other = (line(study, step, pair).drift for pair in pairs)
    light, dark = (study.once(LIGHT[step])[pair].phase_batches for pair in pairs)
    sign = np.sign(one * other)
    return abs(one) - abs(other), standard_error((light - sign * dark) @ rise_weight())


def corrected(study: Study, step: str, pair: str) -> Array:
    """Return the phase that is left after the signal of open water is subtracted.

    Parameters
    ----------
    study : Study
        Numbers.
    step : str
        Water, a key of `TURBIDITIES`.
    pair : str
        Launched and analysed state.

    Returns
    -------
    ndarray
        Without noise, from zero at the first pixel, shape (80,) [degrees]. Not zero:
        open water goes on behind the place of the plate.
    """
    light = study.once(LIGHT[step])[pair]
    water = study.once(OPEN_WATER[step])[pair]
    return phase_along(light.signal - water)


def rejected_share(study: Study, step: str, pairs: tuple[str, str]) -> float:
    """Return the share of the water's light that an analyser lets pass nevertheless.

    Parameters
    ----------
    study : Study
        Numbers.
    step : str
        Water, a key of `TURBIDITIES`.
    pairs : tuple of str
        Launched and analysed state that is to reject the water, and that which is not.

    Returns
    -------
    float
        Mean over the line [1].
    """
    light = study.once(LIGHT[step])
    little, much = (np.abs(light[pair].water) for pair in pairs)
    return float(np.mean(little / (little + much)))


def phase_along(signal: Complex) -> Array:
    """Return the phase of a line from zero at its first pixel [degrees]."""
    phase: Array = np.degrees(np.unwrap(np.angle(signal)))
    zeroed: Array = phase - phase[0]
    return zeroed


def rise_weight() -> Array:
    """Return the weights with which a line through all pixels rises over the scan."""
    pixel = np.arange(PIXELS) - 0.5 * (PIXELS - 1)
    weight: Array = pixel / (pixel @ pixel) * (PIXELS - 1)
    return weight


def drifts(
    study: Study,
    statement: str,
    step: str,
    pair: str,
    *,
    low: float,
    high: float,
    role: Role = "test",
) -> Check:
    """Return the check of a drift.

    Parameters
    ----------
    study : Study
        Numbers.
    statement : str
        What is stated.
    step : str
        Water, a key of `TURBIDITIES`.
    pair : str
        Launched and analysed state.
    low, high : float
        What would do, at most [degrees].
    role : {"test", "set"}
        Whether a number of the study was chosen for it.

    Returns
    -------
    Check
        Of the size of the drift without noise: which way the paper scanned is not
        preserved. What the fit to the synthetic measurement gives is said beside it.
    """
    found = line(study, step, pair)
    check = within(
        statement,
        abs(found.drift),
        low,
        high,
        unit="deg",
        uncertainty=found.error,
        role=role,
    )
    return replace(
        check,
        found=f"{check.found} (fit to the synthetic line: "
        f"{abs(found.fitted):.2f} ± {found.fitted_error:.2f} deg)",
    )


def stays_flat(
    study: Study, statement: str, step: str, pair: str, *, role: Role = "test"
) -> Check:
    """Return the check that a drift stays within the phase error of the apparatus.

    Parameters
    ----------
    study : Study
        Numbers.
    statement : str
        What is stated.
    step : str
        Water, a key of `TURBIDITIES`.
    pair : str
        Launched and analysed state.
    role : {"test", "set"}
        Whether a number of the study was chosen for it.

    Returns
    -------
    Check
        Failed where the drift is above by more than twice its standard error.
    """
    found = line(study, step, pair)
    check = drifts(study, statement, step, pair, low=-np.inf, high=FLAT, role=role)
    return allowing(check, abs(found.drift) - SURE * found.error <= FLAT)


def is_straight(study: Study, step: str, pair: str) -> Check:
    """Return the check that a line drifts evenly.

    Parameters
    ----------
    study : Study
        Numbers.
    step : str
        Water, a key of `TURBIDITIES`.
    pair : str
        Launched and analysed state.

    Returns
    -------
    Check
        Of the largest departure from the straight line, over the drift.
    """
    found = line(study, step, pair)
    check = within(
        f"({step}) {pair} drifts along a straight line: departure over drift",
        found.bend,
        0.0,
        STRAIGHT,
        uncertainty=found.bend_error,
    )
    return allowing(check, found.bend - SURE * found.bend_error <= STRAIGHT)


def moves(study: Study, statement: str, step: str, pair: str) -> Check:
    """Return the check that a line drifts beyond the phase error of the apparatus.

    Parameters
    ----------
    study : Study
        Numbers.
    statement : str
        What is stated.
    step : str
        Water, a key of `TURBIDITIES`.
    pair : str
        Launched and analysed state.

    Returns
    -------
    Check
        Passed where the drift is above by more than twice its standard error.
    """
    found = line(study, step, pair)
    check = drifts(study, statement, step, pair, low=FLAT, high=np.inf)
    return surely(check, abs(found.drift) - SURE * found.error >= FLAT)


def surely(check: Check, passed: bool) -> Check:
    """Return a check that was decided with regard to the standard error."""
    wanted = f"{check.wanted}, by {SURE:g} standard errors"
    return replace(check, passed=bool(passed), wanted=wanted)


def allowing(check: Check, passed: bool) -> Check:
    """Return a check that fails only beyond the standard error."""
    wanted = f"{check.wanted}, within {SURE:g} standard errors"
    return replace(check, passed=bool(passed), wanted=wanted)


def panel(
    study: Study, axis: Axes, step: str, pairs: tuple[str, str], *, subtracted: bool
) -> None:
    """Draw two lines of one water.

    Parameters
    ----------
    study : Study
        Numbers.
    axis : matplotlib.axes.Axes
        Where to.
    step : str
        Water, a key of `TURBIDITIES`.
    pairs : tuple of str
        Launched and analysed state of the filled and of the open marks.
    subtracted : bool
        Whether to draw what is left after open-water subtraction.
    """
    pixel = np.arange(1, PIXELS + 1)
    for pair, filled in zip(pairs, (True, False), strict=True):
        found = line(study, step, pair)
        axis.plot(
            pixel,
            found.measured,
            "o" if filled else "s",
            color=COLOUR[pair],
            markersize=2.4,
            markerfacecolor=COLOUR[pair] if filled else "white",
            markeredgewidth=0.5,
            label=f"{pair}, {SYNTHETIC}",
            zorder=2,
        )
        axis.plot(
            pixel, found.phase + found.offset, color="black", linewidth=0.8, zorder=3,
            label=None if filled else "model, without noise",
        )  # fmt: skip
    if subtracted:
        axis.plot(
            pixel,
            corrected(study, step, pairs[0]),
            "--",
            color="#555555",
            linewidth=0.8,
            label=f"{pairs[0]} less open water",
            zorder=3,
        )
    axis.set(xlim=(0, PIXELS + 1), xlabel="pixel", ylabel="phase [degree]")
    axis.xaxis.set_major_locator(FixedLocator([1, 20, 40, 60, 80]))
    axis.grid(axis="y")


def water_name(study: Study, step: str) -> str:
    """Return what a panel says of its water."""
    attenuation = study[TURBIDITIES[step]]
    thickness = attenuation * study["short_distance"]
    name = "tap water" if step == "tap" else "with milk"
    return f"{name}, {attenuation:.2f} 1/m (optical thickness {thickness:.2g})"
