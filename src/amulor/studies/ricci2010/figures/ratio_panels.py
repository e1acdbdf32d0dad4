"""What figures 8 and 9 share: their checks and their three panels."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from amulor.optics import extrema
from amulor.studies.ricci2010.checks import Check, holds
from amulor.studies.ricci2010.figures.drawing import (
    SYNTHETIC,
    WIDE,
    letter,
    mark_synthetic,
)
from amulor.studies.ricci2010.scenes.interference_sweeps import (
    TITLES,
    Sweep,
    shown,
    smoothed,
)
from amulor.view.style import COLOURS, new_figure, style

Floats = NDArray[np.float64]
Curve = Callable[[Sweep], Floats]
#: Where the paper speaks of both figures.
PLACE = "section 8, on figures 8 and 9"


def same_extrema(sweep: Sweep, value: Floats, name: str) -> Check:
    """Return the check that a quantity turns where the amplitude does."""
    limit = max(1.0, sweep.period / 1e7)
    of_value, of_amplitude = (
        extrema.find(sweep.frequency, smoothed(curve))
        for curve in (value, np.abs(sweep.signal))
    )
    # Next to the ends of the sweep noise and smoothing make extrema of their own.
    first, last = sweep.frequency[[0, -1]] + np.array([1, -1]) * sweep.period / 8
    shifts = [
        np.abs(there - place).min(initial=np.inf) / 1e6
        for here, there in (
            (of_value.maxima, of_amplitude.maxima),
            (of_value.minima, of_amplitude.minima),
        )
        for place in here[(here > first) & (here < last)]
    ]
    median = float(np.median(shifts)) if shifts else np.nan
    return holds(
        f"experiment {sweep.number}: extrema of {name} and of amplitude coincide",
        median <= limit,
        found=f"{len(shifts)} extrema, median shift {median:.1f} MHz, largest "
        f"{max(shifts, default=np.nan):.1f} MHz",
        place=PLACE,
        wanted=f"median at most {limit:.1f} MHz, a tenth of the period",
    )


def almost_monotonic(sweep: Sweep, value: Floats, name: str) -> Check:
    """Return the check that a quantity rises without turning back by much."""
    count = turns(sweep, value, depth=0.1 * float(np.ptp(smoothed(value))))
    return holds(
        f"experiment {sweep.number}: {name} rises almost monotonically (turns back by "
        "more than a tenth of its rise)",
        count == 0,
        found=str(count),
        wanted="0",
        place=PLACE,
    )


def turns(sweep: Sweep, value: Floats, *, depth: float) -> int:
    """Return how many maxima stand above both minima beside them."""
    even = smoothed(value)
    result = extrema.find(sweep.frequency, even)
    level = np.interp(result.maxima, sweep.frequency, even)
    count = 0
    for place, top in zip(result.maxima, level, strict=True):
        left = result.minima[result.minima < place][-1:]
        right = result.minima[result.minima > place][:1]
        beside = np.interp([*left, *right], sweep.frequency, even)
        count += bool(len(beside) == 2 and np.all(top - beside > depth))
    return count


def grows(sweep: Sweep, value: Floats, name: str) -> Check:
    """Return the check that a quantity grows with frequency, period by period."""
    span = sweep.frequency[-1] - sweep.frequency[0]
    count = max(2, int(span / sweep.period))
    edges = sweep.frequency[-1] - sweep.period * np.arange(count, -1, -1.0)
    means = [
        float(value[(sweep.frequency > low) & (sweep.frequency <= high)].mean())
        for low, high in pairwise(edges)
    ]
    return holds(
        f"experiment {sweep.number}: {name} grows with frequency (means over periods "
        "of the interference)",
        bool(np.all(np.diff(means) > 0)),
        found=", ".join(f"{mean:.3g}" for mean in means),
        place=PLACE,
        wanted="each above the one before",
    )


def draw(
    sweeps: tuple[Sweep, ...],
    *,
    raw: Curve,
    corrected: Curve,
    label: str,
    names: tuple[str, str],
    level: float,
    logarithmic: bool,
) -> Figure:
    """Draw a quantity of all experiments, before and after correction."""
    with style():
        figure = new_figure(WIDE, 2.5)
        axes = figure.subplots(1, 3, sharey=True)
        for axis, sweep in zip(axes, sweeps, strict=True):
            every = shown(sweep)
            f = sweep.frequency[every] / 1e6
            axis.axhline(level, color="#888888", lw=0.8)
            axis.plot(
                f,
                raw(sweep)[every],
                "o",
                ms=2.6,
                color=COLOURS[0],
                label=f"{names[0]}, {SYNTHETIC}",
            )
            axis.plot(
                f,
                corrected(sweep)[every],
                "o",
                ms=2.6,
                mfc="white",
                mew=0.7,
                color=COLOURS[1],
                label=f"{names[1]}, open water subtracted",
            )
            if logarithmic:
                axis.set_yscale("log")
            axis.set_xlim(0, 150)
            axis.set_xlabel("modulation frequency [MHz]")
            axis.grid(True)
        axes[0].set_ylabel(label)
        letter(axes, TITLES)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2)
        mark_synthetic(figure)
    return figure
