"""Figures 7 to 9 of Ricci et al. 2010: interference of target and water signal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from amulor.optics import extrema
from amulor.studies.ricci2010.figures.panels import (
    SYNTHETIC,
    WIDE,
    letter,
    mark_synthetic,
    styled,
)
from amulor.studies.ricci2010.results import Check, statements
from amulor.studies.ricci2010.scenes import interference_sweeps as shared
from amulor.studies.ricci2010.scenes import white_plate
from amulor.studies.ricci2010.scenes.interference_sweeps import Sweep, smoothed
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS, new_figure

Floats = NDArray[np.float64]
Curve = Callable[[Sweep], Floats]
#: Limits of the distances of successive maxima, and minima, by experiment, with
#: 2 MHz for reading them [MHz].
_APART = {2: (33.5 - 2.0, 43.4 + 2.0), 3: (25.0 - 2.0, 25.0 + 2.0)}


def amplitude_checks(study: Study) -> list[Check]:
    """Compare the amplitudes over frequency with the text of the paper."""
    rows = statements(7)
    sweeps = study.once(shared.sweeps)
    first, second, third = sweeps
    gap = np.abs(np.abs(first.signal) / np.abs(first.subtracted) - 1).max()
    near, far = (_separations(sweep) for sweep in (second, third))
    raw, subtracted, joint = (
        [extrema.ripple(np.abs(getattr(sweep, name))) for sweep in sweeps]
        for name in ("signal", "subtracted", "joint")
    )
    low, high = _APART[2]
    return [
        rows.within("agree", float(100 * gap)),
        rows.holds(
            "apart_2",
            len(near) >= 3 and bool(np.all((near > low) & (near < high))),
            _spread(near),
            low=low,
            high=high,
        ),
        rows.within("apart_3", float(np.mean(far)) if len(far) else np.nan, *_APART[3]),
        rows.within("ripple_2", subtracted[1] / raw[1]),
        rows.within("ripple_3", subtracted[2] / raw[2]),
        rows.within("joint", max(joint), high=0.2 * min(raw[1:])),
        *[_range(sweep) for sweep in sweeps],
        *[rows.within("white", s.reflectance, number=s.number) for s in sweeps],
        *_white_in_milk(study),
        _backscatter_needed(study),
        *_in_better_water(study),
    ]


@styled
def draw_amplitude(study: Study) -> Figure:
    """Draw the amplitude over frequency, before and after water subtraction."""
    figure = new_figure(WIDE, 2.7)
    axes = figure.subplots(1, 3)
    small_angle = study.once(shared.small_angle_sweeps)
    for axis, sweep, other in zip(
        axes, study.once(shared.sweeps), small_angle, strict=True
    ):
        # Relative to the mean echo, since the original voltages are unknown.
        unit = np.abs(sweep.truth).mean()
        f, shown = sweep.frequency / 1e6, shared.shown(sweep)
        axis.plot(
            f,
            np.abs(sweep.truth) / unit,
            "-",
            color="black",
            lw=0.8,
            label="echo without water or noise",
        )
        axis.plot(
            f,
            np.abs(other.signal) / np.abs(other.truth).mean(),
            "-",
            color="#999999",
            lw=0.8,
            label="$A$, small-angle form (29)",
        )
        _plot_both(
            axis,
            f[shown],
            np.abs(sweep.signal[shown]) / unit,
            np.abs(sweep.subtracted[shown]) / unit,
            names=("$A$", "$A_t$"),
        )
        axis.plot(
            sweep.joint_frequency / 1e6,
            np.abs(sweep.joint) / unit,
            "x",
            ms=3.5,
            mew=0.9,
            color=COLOURS[2],
            label="$A_t$, joint estimate",
        )
        axis.set_ylim(0, None)
    _finish(figure, axes, "amplitude over mean echo [1]", columns=3)
    return figure


def _plot_both(
    axis: Axes,
    frequency: Floats,
    raw: Floats,
    corrected: Floats,
    *,
    names: tuple[str, str],
) -> None:
    """Plot a quantity before and after the subtraction of open water."""
    axis.plot(
        frequency, raw, "o", ms=2.6, color=COLOURS[0], label=f"{names[0]}, {SYNTHETIC}"
    )
    axis.plot(
        frequency,
        corrected,
        "o",
        ms=2.6,
        mfc="white",
        mew=0.7,
        color=COLOURS[1],
        label=f"{names[1]}, open water subtracted",
    )


def _finish(figure: Figure, axes: Any, label: str, *, columns: int) -> None:
    """Set axis limits, labels and legend for the three experiments."""
    for axis in axes:
        axis.set_xlim(0, 150)
        axis.set_xlabel("modulation frequency [MHz]")
        axis.grid(True)
    axes[0].set_ylabel(label)
    letter(axes, shared.TITLES)
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=columns)
    mark_synthetic(figure)


def _separations(sweep: Sweep) -> Floats:
    """Return the spacing of successive maxima and minima of the amplitude [MHz]."""
    amplitude = smoothed(np.abs(sweep.signal))
    return extrema.find(sweep.frequency, amplitude).separations / 1e6


def _spread(apart: Floats) -> str:
    if len(apart) == 0:
        return "none"
    return (
        f"{len(apart)}, {apart.min():.1f} to {apart.max():.1f}, mean "
        f"{apart.mean():.1f} MHz"
    )


def _in_better_water(study: Study) -> list[Check]:
    """Check experiments 2 and 3 with the small-angle water signal, eq. (29)."""
    rows = statements(7)
    checks = []
    for sweep in study.once(shared.small_angle_sweeps)[1:]:
        number, panel = sweep.number, "abc"[sweep.number - 1]
        low, high = _APART[number]
        apart = _separations(sweep)
        ripple, raw = (
            extrema.ripple(np.abs(a)) for a in (sweep.subtracted, sweep.signal)
        )
        checks += [
            rows.holds(
                "apart_29",
                len(apart) >= 3 and low < float(np.mean(apart)) < high,
                _spread(apart),
                number=number,
                panel=panel,
                low=low,
                high=high,
            ),
            rows.within(
                "ripple_29",
                ripple / raw,
                high=0.2 if number == 2 else 0.1,
                number=number,
                panel=panel,
            ),
            _range(sweep, " by the small-angle form (29)"),
        ]
    return checks


def _range(sweep: Sweep, form: str = "") -> Check:
    result, sigma, true = sweep.joint_range
    return statements(7).holds(
        "range",
        abs(result - true) < 3 * sigma and sweep.joint_flags == 0,
        f"{1e3 * (result - true):+.2f} ± {1e3 * sigma:.2f} mm"
        + (", flagged" if sweep.joint_flags else ""),
        number=sweep.number,
        form=form,
    )


def _white_in_milk(study: Study) -> list[Check]:
    rows = statements(7)
    result = []
    for needed in white_plate.reflectances(study):
        number, value, error = needed.number, needed.value, needed.error
        row = rows.row("white_in_milk", number=number)
        check = rows.within("white_in_milk", value, uncertainty=error, number=number)
        near = row["low"] - 2 * error <= value <= row["high"] + 2 * error
        requirement = f"{check.wanted}, within 2 standard errors"
        result.append(replace(check, passed=near, wanted=requirement))
    return result


def _backscatter_needed(study: Study) -> Check:
    """Check that both models need equal phase functions at 180 degrees, within 25 %."""
    forms = [
        [sweep.needed_backscatter for sweep in study.once(sweeps)]
        for sweeps in (shared.sweeps, shared.small_angle_sweeps)
    ]
    diffusion, small_angle = (
        f"{min(values[1:]):.3f} to {max(values[1:]):.3f}" for values in forms
    )
    quotient = np.array(forms[1][1:]) / np.array(forms[0][1:])
    return statements(7).holds(
        "backscatter",
        bool(np.all(np.abs(quotient - 1) < 0.25)),
        f"{diffusion} 1/sr by the diffusion form, {small_angle} by (29)",
        white=shared.WHITE,
    )


def ratio_checks(study: Study) -> list[Check]:
    """Compare the signal-to-water-signal ratio with the text of the paper."""
    rows = statements(8)
    sweeps = study.once(shared.sweeps)
    name = "signal-to-optical-noise ratio"
    below = [int((sweep.ratio < 1).sum()) for sweep in sweeps]
    alike = all(np.array_equal(s.ratio < 1, s.contrast < 0) for s in sweeps)
    left = [turns(s, np.log(s.corrected_ratio), depth=0.1) for s in sweeps[1:]]
    return [
        *[same_extrema(sweep, np.log(sweep.ratio), name) for sweep in sweeps[1:]],
        almost_monotonic(sweeps[0], np.log(sweeps[0].ratio), "logarithm of the ratio"),
        *[grows(sweep, sweep.ratio, name) for sweep in sweeps],
        rows.holds(
            "together",
            alike and below[0] == 0 and below[1] > 0 and below[2] > 0,
            f"{below[0]}, {below[1]}, {below[2]} of {len(sweeps[0].frequency)}"
            + (" frequencies" if alike else " frequencies, not the same ones"),
        ),
        rows.within("weaker", min(float(s.corrected_ratio.min()) for s in sweeps)),
        rows.within("turns", float(sum(left))),
    ]


def contrast_checks(study: Study) -> list[Check]:
    """Compare the contrast with the text of the paper."""
    rows = statements(9)
    sweeps = study.once(shared.sweeps)
    lowest = [float(sweep.contrast.min()) for sweep in sweeps]
    last = [
        float(np.mean(s.corrected_contrast[-len(s.frequency) // 10 :])) for s in sweeps
    ]
    return [
        *[same_extrema(s, s.contrast, "contrast") for s in sweeps[1:]],
        almost_monotonic(sweeps[0], sweeps[0].contrast, "contrast"),
        *[grows(s, s.contrast, "contrast") for s in sweeps],
        rows.holds(
            "negative",
            lowest[0] > 0 > max(lowest[1:]),
            ", ".join(f"{value:+.2f}" for value in lowest),
        ),
        rows.holds(
            "highest",
            all(value > 0.5 for value in last),
            ", ".join(f"{value:.2f}" for value in last),
        ),
    ]


def same_extrema(sweep: Sweep, value: Floats, name: str) -> Check:
    """Check that extrema of a quantity coincide with the amplitude's extrema."""
    limit = max(1.0, sweep.period / 1e7)
    of_value, of_amplitude = (
        extrema.find(sweep.frequency, smoothed(curve))
        for curve in (value, np.abs(sweep.signal))
    )
    # Next to the ends of the sweep noise and smoothing make extrema of their own.
    first, last = sweep.frequency[[0, -1]] + np.array([1, -1]) * sweep.period / 8
    shifts = [
        np.abs(turning - place).min(initial=np.inf) / 1e6
        for places, turning in (
            (of_value.maxima, of_amplitude.maxima),
            (of_value.minima, of_amplitude.minima),
        )
        for place in places[(places > first) & (places < last)]
    ]
    median = float(np.median(shifts)) if shifts else np.nan
    return statements(8).holds(
        "extrema",
        median <= limit,
        f"{len(shifts)} extrema, median shift {median:.1f} MHz, largest "
        f"{max(shifts, default=np.nan):.1f} MHz",
        number=sweep.number,
        quantity=name,
        limit=limit,
    )


def almost_monotonic(sweep: Sweep, value: Floats, name: str) -> Check:
    """Check that a quantity rises almost monotonically with frequency."""
    count = turns(sweep, value, depth=0.1 * float(np.ptp(smoothed(value))))
    return statements(8).holds(
        "monotonic", count == 0, str(count), number=sweep.number, quantity=name
    )


def turns(sweep: Sweep, value: Floats, *, depth: float) -> int:
    """Count the maxima that exceed both neighboring minima by a given amount."""
    even = smoothed(value)
    result = extrema.find(sweep.frequency, even)
    level = np.interp(result.maxima, sweep.frequency, even)
    count = 0
    for place, top in zip(result.maxima, level, strict=True):
        before = result.minima[result.minima < place][-1:]
        after = result.minima[result.minima > place][:1]
        beside = np.interp([*before, *after], sweep.frequency, even)
        count += bool(len(beside) == 2 and np.all(top - beside > depth))
    return count


def grows(sweep: Sweep, value: Floats, name: str) -> Check:
    """Check that the mean of a quantity rises from period to period of interference."""
    span = sweep.frequency[-1] - sweep.frequency[0]
    count = max(2, int(span / sweep.period))
    edges = sweep.frequency[-1] - sweep.period * np.arange(count, -1, -1.0)
    means = [
        float(value[(sweep.frequency > low) & (sweep.frequency <= high)].mean())
        for low, high in pairwise(edges)
    ]
    return statements(8).holds(
        "grows",
        bool(np.all(np.diff(means) > 0)),
        ", ".join(f"{mean:.3g}" for mean in means),
        number=sweep.number,
        quantity=name,
    )


def draw_ratio(study: Study) -> Figure:
    """Draw the ratio of signal to water signal over frequency."""
    return _draw_both(
        study,
        lambda sweep: sweep.ratio,
        lambda sweep: sweep.corrected_ratio,
        label="SNR, SNR$_t$ [1]",
        names=("SNR", "SNR$_t$"),
        level=1.0,
        scale="log",
    )


def draw_contrast(study: Study) -> Figure:
    """Draw the contrast between signal and water signal over frequency."""
    return _draw_both(
        study,
        lambda sweep: sweep.contrast,
        lambda sweep: sweep.corrected_contrast,
        label="$C$, $C_t$ [1]",
        names=("$C$", "$C_t$"),
        level=0.0,
        scale="linear",
    )


@styled
def _draw_both(
    study: Study,
    raw: Curve,
    corrected: Curve,
    *,
    label: str,
    names: tuple[str, str],
    level: float,
    scale: str,
) -> Figure:
    """Draw a quantity over frequency, before and after water subtraction."""
    figure = new_figure(WIDE, 2.5)
    axes = figure.subplots(1, 3, sharey=True)
    for axis, sweep in zip(axes, study.once(shared.sweeps), strict=True):
        shown = shared.shown(sweep)
        axis.axhline(level, color="#888888", lw=0.8)
        _plot_both(
            axis,
            sweep.frequency[shown] / 1e6,
            raw(sweep)[shown],
            corrected(sweep)[shown],
            names=names,
        )
        axis.set_yscale(scale)
    _finish(figure, axes, label, columns=2)
    return figure
