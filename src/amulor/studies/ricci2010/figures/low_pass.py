"""Figures 3 and 4 of Ricci et al. 2010: water signal over modulation frequency."""

from __future__ import annotations

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
from amulor.studies.ricci2010.results import Check, statements
from amulor.studies.ricci2010.scenes.water_sweeps import Curve, Squares, Sweep, sweep
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS, new_figure, style

_Dashes = str | tuple[float, tuple[float, ...]]

#: Interpretation of "in good accordance": departure of a ratio from 1.
ACCORDANCE = 0.15
#: Allowed departure of a fit of eq. (71) from the half-power frequency.
RECOVERY = 0.05
#: The two ways to fit (71): level and cut-off free, to amplitudes; the cut-off free, to
#: squares over the largest of them.
FREE, OF_POWER = "a free fit of (71)", "a fit of (71) to power"


def lower_checks(study: Study) -> list[Check]:
    """Compare the frequency sweep at lower turbidity with the text of the paper."""
    return sweep_checks(sweep(study, "low"))


def higher_checks(study: Study) -> list[Check]:
    """Compare the frequency sweep at higher turbidity with the text of the paper."""
    rows = statements(4)
    low, high = sweep(study, "low"), sweep(study, "high")
    ratios = []
    for first, second in zip(low.curves, high.curves, strict=True):
        ratio = second.cut_off / first.cut_off
        error = ratio * np.hypot(
            first.cut_off_error / first.cut_off, second.cut_off_error / second.cut_off
        )
        ratios.append((ratio, float(error)))
    least, error = min(ratios)
    text = ", ".join(f"{ratio:.2f}" for ratio, _ in ratios)
    moments = low.water.second_moment, high.water.second_moment
    asymmetries = [s.water.phase_function.asymmetry for s in (low, high)]
    return [
        *sweep_checks(high),
        rows.within("higher", least, uncertainty=error or None, note=f" (of {text})"),
        rows.holds(
            "moments",
            moments[1] > moments[0] and asymmetries[1] < asymmetries[0],
            f"{moments[0]:.3g} to {moments[1]:.3g} rad², "
            f"{asymmetries[0]:.4f} to {asymmetries[1]:.4f}",
        ),
    ]


def draw_lower(study: Study) -> Figure:
    """Draw amplitudes and cut-off frequencies at lower turbidity."""
    return _draw(sweep(study, "low"))


def draw_higher(study: Study) -> Figure:
    """Draw amplitudes and cut-off frequencies at higher turbidity."""
    return _draw(sweep(study, "high"))


def sweep_checks(data: Sweep) -> list[Check]:
    """Compare a frequency sweep with the text of the paper on figures 3 and 4."""
    rows = statements(3)
    simple, realistic, photons = data.simple, data.realistic, data.monte_carlo
    closed = (simple, realistic, data.small_angle)
    levels = [curve.at_cut_off * np.sqrt(2) for curve in closed]
    return [
        rows.within("start", min(float(curve.amplitude[0]) for curve in data.curves)),
        rows.within(
            "largest", max(float(curve.amplitude.max()) for curve in data.curves)
        ),
        rows.within("half_power", max(levels, key=lambda level: abs(level - 1))),
        _accordance("diffusion", realistic, simple),
        _accordance("photons", photons, simple),
        _ratio("fits", realistic.fitted, simple.fitted, ACCORDANCE, fit=FREE),
        _ratio("fits", realistic.of_power, simple.of_power, ACCORDANCE, fit=OF_POWER),
        _accordance("diffusion_photons", realistic, photons),
        _accordance("small_angle_photons", data.small_angle, photons),
        *(check for name in (FREE, OF_POWER) for check in _fits(data, name)),
    ]


def _fits(data: Sweep, name: str) -> list[Check]:
    """Check low-pass fits, eq. (71), to synthetic measurements and model curves."""
    rows = statements(3)
    squares, first_order = (
        _fit_of(measured, name) for measured in (data.squares, data.first_order)
    )
    simple, realistic = data.simple.cut_off, data.realistic.cut_off
    error, true = squares.cut_off_standard_error, data.first_order.made_with
    apart = abs(squares.cut_off - realistic) / error
    curves = [_of_curve(curve, name) for curve in data.curves]
    farthest = max(curves, key=lambda pair: abs(pair[0] - 1))
    return [
        _ratio(
            "measured_simple",
            squares.cut_off,
            simple,
            ACCORDANCE,
            error=error / simple,
            fit=name,
        ),
        rows.holds(
            "measured_realistic",
            apart <= 3,
            f"{squares.cut_off / 1e6:.2f} ± {error / 1e6:.2f} against "
            f"{realistic / 1e6:.2f} MHz: {apart:.1f} standard errors",
            fit=name,
        ),
        _ratio(
            "first_order",
            first_order.cut_off,
            true,
            RECOVERY,
            error=first_order.cut_off_standard_error / true,
            fit=name,
        ),
        rows.within(
            "curves",
            farthest[0],
            1 - RECOVERY,
            1 + RECOVERY,
            uncertainty=farthest[1] or None,
            note=f" (of {', '.join(f'{ratio:.2f}' for ratio, _ in curves)})",
            fit=name,
        ),
    ]


def _fit_of(squares: Squares, name: str) -> low_pass.LowPassFit:
    """Return the named low-pass fit to a synthetic measurement."""
    return squares.fit if name == FREE else squares.of_power


def _of_curve(curve: Curve, name: str) -> tuple[float, float]:
    """Return the ratio of fitted to half-power cut-off, and its standard error."""
    if name == FREE:
        return curve.fitted / curve.cut_off, curve.ratio_error
    return curve.of_power / curve.cut_off, curve.of_power_ratio_error


def _draw(data: Sweep) -> Figure:
    """Draw figure 3 or 4: amplitudes over frequency, and cut-off frequencies."""
    with style():
        figure = new_figure(WIDE, 3.3)
        curve_axis, cut_off_axis = figure.subplots(1, 2, width_ratios=(1.25, 1))
        _draw_curves(curve_axis, data)
        _draw_cut_offs(cut_off_axis, data)
        letter(
            (curve_axis, cut_off_axis),
            (f"water signal, attenuation {data.attenuation:.1f} m⁻¹", "cut-offs"),
        )
        mark_synthetic(figure)
    return figure


def _accordance(name: str, first: Curve, second: Curve) -> Check:
    """Check that two half-power frequencies agree within 15 %, and state the error."""
    ratio = first.cut_off / second.cut_off
    error = ratio * np.hypot(
        first.cut_off_error / first.cut_off, second.cut_off_error / second.cut_off
    )
    return _ratio(name, first.cut_off, second.cut_off, ACCORDANCE, error=float(error))


def _ratio(
    name: str,
    first: float,
    second: float,
    tolerance: float,
    *,
    error: float = 0.0,
    **words: str,
) -> Check:
    """Check that two frequencies agree within a tolerance, and state both."""
    return statements(3).within(
        name,
        first / second,
        1 - tolerance,
        1 + tolerance,
        uncertainty=error or None,
        note=f" ({first / 1e6:.2f} over {second / 1e6:.2f} MHz)",
        **words,
    )


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


def _draw_curves(axis: Axes, data: Sweep) -> None:
    """Draw amplitudes over modulation frequency."""
    frequency = data.frequency / 1e6
    axis.axhline(np.sqrt(0.5), color="#999999", lw=0.6, zorder=0)
    for curve, (colour, dashes, size) in zip(data.curves, _LOOKS, strict=True):
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
        data.squares.frequency / 1e6,
        data.squares.amplitude,
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


def _draw_cut_offs(axis: Axes, data: Sweep) -> None:
    """Draw half-power and fitted cut-off frequencies, one row per series."""
    names = ["simple,\ndiffusion", "realistic,\ndiffusion"]
    names += ["realistic,\nsmall-angle", "realistic,\nMonte Carlo"]
    names += ["synthetic\n(diffusion)", "synthetic\n(71)"]
    for row, (curve, (colour, _, _)) in enumerate(
        zip(data.curves, _LOOKS, strict=True)
    ):
        _mark(axis, row, curve.cut_off, curve.cut_off_error, colour, look="half")
        _mark(axis, row, curve.fitted, curve.fitted_error, colour, look="free")
        _mark(axis, row, curve.of_power, curve.of_power_error, colour, look="power")
    for row, squares in enumerate((data.squares, data.first_order), len(_LOOKS)):
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
        *(max(curve.cut_off, curve.of_power) for curve in data.curves),
        data.squares.of_power.cut_off,
        data.first_order.of_power.cut_off,
    )
    axis.set_xlim(0, 1.1 * largest / 1e6)
    axis.xaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    axis.set_xlabel("cut-off [MHz]")
    axis.grid(True, axis="x")
    axis.legend(loc="upper left")


def _mark(
    axis: Axes, row: int, corner: float, error: float, colour: str, *, look: str
) -> None:
    """Draw a cut-off, with its value below it for fits to power, else above it."""
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
