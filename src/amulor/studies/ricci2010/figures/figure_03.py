"""Figure 3 of Ricci et al. 2010: water signal against frequency, lower turbidity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from amulor.optics import low_pass
from amulor.studies.ricci2010.figures.panels import (
    SYNTHETIC,
    WIDE,
    letter,
    mark_synthetic,
)
from amulor.studies.ricci2010.results import Check, Role, holds, within
from amulor.studies.ricci2010.scenes.water_sweeps import Curve, Squares, Sweep, sweep
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS, new_figure, style

TITLE = "The water as a low-pass, lower turbidity"
CAPTION = (
    "Water signal of the long tank at the lower turbidity. (a) Amplitude divided by "
    "that at 0 MHz against modulation frequency. Dashed: simple water, in which all "
    "attenuation is diffuse scattering. Solid: realistic water with absorption and "
    "forward scattering, in the diffusion form (46). The same realistic water is "
    "computed by the small-angle form (29) and by Monte Carlo with all orders of "
    "scattering (band: two standard errors). Both use the Henyey-Greenstein phase "
    "function of the same second moment. Squares: SYNTHETIC measurement, the "
    "realistic diffusion form with noise. Dots mark half power. (b) Cut-off of each "
    "curve, with standard errors where they are visible. Filled: half power. Open "
    "circles: free fit of the first-order low-pass (71) to amplitudes. Diamonds: fit "
    "of (71) to their squares, divided by the largest. The paper fits measured data, "
    "normalized to their maximum. It is not preserved which of the two fits it made. "
    "The lowest row is a synthetic measurement made with (71) itself. Attenuation, "
    "absorption, second moment, acceptance and noise are deduced or assumed."
)
_Dashes = str | tuple[float, tuple[float, ...]]

#: What "in good accordance" is taken to mean: departure of a ratio from 1.
ACCORDANCE = 0.15
#: How near a fit of (71) has to come to the half-power frequency.
RECOVERY = 0.05
#: The two ways to fit (71): level and cut-off free, to amplitudes; the cut-off free, to
#: squares over the largest of them.
FREE, OF_POWER = "a free fit of (71)", "a fit of (71) to power"
#: Where the paper compares the fit of (71) with the cut-offs of both models.
FITTED = "section 7, at (71), on figures 3 and 4"


def checks(study: Study) -> list[Check]:
    """Compare with what the text says of the figure."""
    return sweep_checks(sweep(study, "low"))


def draw(study: Study) -> Figure:
    """Draw curves and cut-offs."""
    return sweep_figure(sweep(study, "low"))


def sweep_checks(found: Sweep) -> list[Check]:
    """Compare a sweep with what the text says of figures 3 and 4."""
    closed = (found.simple, found.realistic, found.small_angle)
    simple, realistic, photons = found.simple, found.realistic, found.monte_carlo
    starts = [float(curve.amplitude[0]) for curve in found.curves]
    levels = [curve.at_cut_off * np.sqrt(2) for curve in closed]
    return [
        within(
            "all curves begin at 1: lowest amplitude at the first frequency",
            min(starts),
            0.995,
            1.005,
            place="",
            digits=4,
        ),
        within(
            "no curve exceeds 1: largest amplitude",
            max(float(curve.amplitude.max()) for curve in found.curves),
            0.0,
            1.0,
            place="section 3, after (49)",
            digits=4,
        ),
        within(
            "closed forms are at half power at the cut-off that is reported, to "
            "10 kHz: amplitude times √2, the one farthest off",
            max(levels, key=lambda level: abs(level - 1)),
            0.999,
            1.001,
            place="",
            digits=5,
        ),
        # The share of absorption was chosen so that these two agree.
        _accordance(
            "cut-offs of simple and realistic water agree, both by the diffusion form",
            realistic,
            simple,
            place=FITTED,
            role="set",
        ),
        _accordance(
            "cut-offs of simple and realistic water agree where the realistic one is "
            "followed by photons",
            photons,
            simple,
        ),
        *(
            _ratio(
                "cut-offs of simple and realistic water agree, both by the diffusion "
                f"form and by {fit}",
                second,
                first,
                ACCORDANCE,
            )
            for fit, first, second in (
                (FREE, simple.fitted, realistic.fitted),
                (OF_POWER, simple.of_power, realistic.of_power),
            )
        ),
        _accordance(
            "the realistic diffusion form agrees with transport of all orders within "
            "15 %",
            realistic,
            photons,
        ),
        _accordance(
            "the small-angle form agrees with transport of all orders within 15 %",
            found.small_angle,
            photons,
        ),
        *(check for name in (FREE, OF_POWER) for check in _fits(found, name)),
    ]


def _fits(found: Sweep, name: str) -> list[Check]:
    """Return what one way to fit (71) finds: in measurements, then in the curves."""
    squares, own = (
        _fit_of(sweep, name) for sweep in (found.squares, found.first_order)
    )
    simple, realistic = found.simple.cut_off, found.realistic.cut_off
    apart = abs(squares.cut_off - realistic) / squares.cut_off_standard_error
    shown = (
        f"{squares.cut_off / 1e6:.2f} ± {squares.cut_off_standard_error / 1e6:.2f} "
        f"against {realistic / 1e6:.2f} MHz: {apart:.1f} standard errors"
    )
    curves = [_of_curve(curve, name) for curve in found.curves]
    farthest = max(curves, key=lambda pair: abs(pair[0] - 1))
    every = ", ".join(f"{ratio:.2f}" for ratio, _ in curves)
    check = within(
        f"curves: {name} finds the half-power frequency; quotient of the one farthest "
        "off",
        farthest[0],
        1 - RECOVERY,
        1 + RECOVERY,
        place="",
        uncertainty=farthest[1] or None,
    )
    return [
        _ratio(
            f"measurement: {name} is in accordance with the cut-off of simple water",
            squares.cut_off,
            simple,
            ACCORDANCE,
            error=squares.cut_off_standard_error / simple,
            place=FITTED,
        ),
        holds(
            f"measurement: {name} coincides with the cut-off of realistic water within "
            "its error",
            apart <= 3,
            found=shown,
            wanted="within 3 standard errors",
            place=FITTED,
        ),
        _ratio(
            f"measurement made with (71): {name} finds what it was made with",
            own.cut_off,
            found.first_order.made_with,
            RECOVERY,
            error=own.cut_off_standard_error / found.first_order.made_with,
        ),
        replace(check, found=f"{check.found} (of {every})"),
    ]


def _fit_of(squares: Squares, name: str) -> low_pass.LowPassFit:
    """Return the fit of that name to a synthetic measurement."""
    return squares.fit if name == FREE else squares.of_power


def _of_curve(curve: Curve, name: str) -> tuple[float, float]:
    """Return fitted over half-power cut-off of a curve, and its standard error."""
    if name == FREE:
        return curve.fitted / curve.cut_off, curve.ratio_error
    return curve.of_power / curve.cut_off, curve.of_power_ratio_error


def sweep_figure(found: Sweep) -> Figure:
    """Draw figure 3 or 4."""
    with style():
        figure = new_figure(WIDE, 3.3)
        left, right = figure.subplots(1, 2, width_ratios=(1.25, 1))
        _draw_curves(left, found)
        _draw_cut_offs(right, found)
        letter(
            (left, right),
            (f"water signal, attenuation {found.attenuation:.1f} m⁻¹", "cut-offs"),
        )
        mark_synthetic(figure)
    return figure


def _accordance(
    statement: str,
    first: Curve,
    second: Curve,
    *,
    place: str = "",
    role: Role | None = None,
) -> Check:
    """Return whether two half-power frequencies agree."""
    ratio = first.cut_off / second.cut_off
    error = ratio * np.hypot(
        first.cut_off_error / first.cut_off, second.cut_off_error / second.cut_off
    )
    check = _ratio(
        statement,
        first.cut_off,
        second.cut_off,
        ACCORDANCE,
        error=float(error),
        place=place,
    )
    return replace(check, role=role or check.role)


def _ratio(
    statement: str,
    first: float,
    second: float,
    tolerance: float,
    *,
    error: float = 0.0,
    place: str = "",
) -> Check:
    """Return whether the ratio of two frequencies is 1, and show both."""
    check = within(
        statement,
        first / second,
        1 - tolerance,
        1 + tolerance,
        place=place,
        uncertainty=error or None,
    )
    shown = f"{check.found} ({first / 1e6:.2f} over {second / 1e6:.2f} MHz)"
    return replace(check, found=shown)


#: Colour, dashes and size of the dot of each curve, in their order; neighbours lie on
#: each other, so the second one's dot is smaller.
_LOOKS: tuple[tuple[str, _Dashes, float], ...] = (
    (COLOURS[6], (0, (5, 2)), 5.5),
    (COLOURS[0], "-", 3.5),
    (COLOURS[2], "-", 5.5),
    (COLOURS[1], (0, (1, 1.2)), 3.5),
)


#: Marker of each kind of cut-off, and whether it is filled.
_MARKS = {"half": ("o", True), "free": ("o", False), "power": ("D", False)}


def _draw_curves(axis: Axes, found: Sweep) -> None:
    """Draw amplitudes against frequency."""
    frequency = found.frequency / 1e6
    axis.axhline(np.sqrt(0.5), color="#999999", lw=0.6, zorder=0)
    for curve, (colour, dashes, size) in zip(found.curves, _LOOKS, strict=True):
        if curve.band is not None:
            axis.fill_between(
                frequency,
                curve.amplitude - 2 * curve.band,
                curve.amplitude + 2 * curve.band,
                color=colour,
                alpha=0.3,
                lw=0,
            )
        axis.plot(frequency, curve.amplitude, label=curve.name, color=colour, ls=dashes)
        axis.plot(curve.cut_off / 1e6, np.sqrt(0.5), "o", ms=size, color=colour)
    axis.plot(
        found.squares.frequency / 1e6,
        found.squares.amplitude,
        "s",
        ms=3,
        mfc="none",
        mec="#777777",
        mew=0.6,
        zorder=1.5,
        label=f"{SYNTHETIC} (diffusion form)",
    )
    axis.set_xlim(0, 1.015 * frequency[-1])
    axis.set_ylim(0, 1.04)
    axis.set_xlabel("modulation frequency [MHz]")
    axis.set_ylabel("amplitude over that at 0 MHz")
    axis.legend()
    axis.grid(True)


def _draw_cut_offs(axis: Axes, found: Sweep) -> None:
    """Draw half-power and fitted cut-offs, a row for each series."""
    names = ["simple,\ndiffusion", "realistic,\ndiffusion"]
    names += ["realistic,\nsmall-angle", "realistic,\nMonte Carlo"]
    names += ["synthetic\n(diffusion)", "synthetic\n(71)"]
    for row, (curve, (colour, _, _)) in enumerate(
        zip(found.curves, _LOOKS, strict=True)
    ):
        _mark(axis, row, curve.cut_off, curve.cut_off_error, colour, look="half")
        _mark(axis, row, curve.fitted, curve.fitted_error, colour, look="free")
        _mark(axis, row, curve.of_power, curve.of_power_error, colour, look="power")
    for row, squares in enumerate((found.squares, found.first_order), len(_LOOKS)):
        for look, fit in (("free", squares.fit), ("power", squares.of_power)):
            error = fit.cut_off_standard_error
            _mark(axis, row, fit.cut_off, error, "#777777", look=look)
    for look, label in (
        ("half", "half power"),
        ("free", "free fit of (71)"),
        ("power", "fit of (71) to power"),
    ):
        marker, filled = _MARKS[look]
        face = "#777777" if filled else "white"
        axis.plot([], [], marker, color="#777777", ms=5, mfc=face, label=label)
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(len(names) - 0.4, -0.6)
    largest = max(
        *(max(curve.cut_off, curve.of_power) for curve in found.curves),
        found.squares.of_power.cut_off,
        found.first_order.of_power.cut_off,
    )
    axis.set_xlim(0, 1.1 * largest / 1e6)
    axis.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    axis.set_xlabel("cut-off [MHz]")
    axis.grid(True, axis="x")
    axis.legend(loc="upper left")


def _mark(
    axis: Axes, row: int, corner: float, error: float, colour: str, *, look: str
) -> None:
    """Draw one cut-off with its value; that of the power below its mark."""
    marker, filled = _MARKS[look]
    axis.errorbar(
        corner / 1e6,
        row,
        xerr=error / 1e6 if error else None,
        fmt=marker,
        ms=5,
        color=colour,
        mfc=colour if filled else "white",
        capsize=2,
    )
    axis.annotate(
        f"{corner / 1e6:.1f}",
        (corner / 1e6, row),
        xytext=(0, -10 if look == "power" else 5),
        textcoords="offset points",
        ha="center",
        fontsize=6,
    )
