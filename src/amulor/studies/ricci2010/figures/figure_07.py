"""Figure 7 of Ricci et al. 2010: amplitude before and after open-water subtraction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from amulor.optics import extrema
from amulor.studies.ricci2010.figures.panels import (
    SYNTHETIC,
    WIDE,
    letter,
    mark_synthetic,
)
from amulor.studies.ricci2010.results import Check, holds, within
from amulor.studies.ricci2010.scenes import interference_sweeps as shared
from amulor.studies.ricci2010.scenes import white_plate
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS, new_figure, style

TITLE = "Amplitude against modulation frequency, raw and corrected"
CAPTION = (
    "Amplitude of the signal of a white plate in the long tank against modulation "
    "frequency: (a) experiment 1, weak water signal; (b) experiment 2, higher "
    "turbidity; (c) experiment 3, farther target. Filled circles: synthetic "
    "measurement. Open circles: after open-water subtraction. Crosses: joint estimate "
    "from some 28 of the frequencies without any open-water reference. Black line: "
    "echo without water or noise. Gray line: the same experiment with the small-angle "
    "form (29)."
)
#: Successive maxima, and minima, of experiment 2 stand 33.5 to 43.4 MHz apart, read to
#: 2 MHz; those of experiment 3 about 25 MHz [MHz].
_SECOND, _THIRD, _READING = (33.5, 43.4), 25.0, 2.0
#: Reflectance of a surface that is called white [1].
_WHITENESS = (0.6, 1.0)
#: Where the paper speaks of the plate, and of each experiment.
_WHITE = "section 8, on the set-up"
_PLACES = tuple(f"section 8, on figure 7({panel})" for panel in "abc")


def checks(study: Study) -> list[Check]:
    """Return what the text says of the figure, and what was found."""
    first, second, third = study.once(shared.sweeps)
    gap = np.abs(np.abs(first.signal) / np.abs(first.subtracted) - 1).max()
    apart = [
        extrema.find(s.frequency, shared.smoothed(np.abs(s.signal))).separations / 1e6
        for s in (second, third)
    ]
    raw, subtracted, joint = (
        [
            extrema.ripple(np.abs(getattr(sweep, name)))
            for sweep in (first, second, third)
        ]
        for name in ("signal", "subtracted", "joint")
    )
    low, high = _SECOND[0] - _READING, _SECOND[1] + _READING
    return [
        within(
            "experiment 1: raw and corrected amplitude agree (largest difference)",
            float(100 * gap),
            -np.inf,
            25,
            place=_PLACES[0],
            unit="%",
        ),
        holds(
            "experiment 2: maxima, and minima, stand 33.5 to 43.4 MHz apart",
            len(apart[0]) >= 3 and bool(np.all((apart[0] > low) & (apart[0] < high))),
            found=_spread(apart[0]),
            wanted=f"at least 3, all {low:g} to {high:g} MHz",
            place=_PLACES[1],
            role="set",
        ),
        within(
            "experiment 3: maxima, and minima, stand about 25 MHz apart (mean)",
            float(np.mean(apart[1])) if len(apart[1]) else np.nan,
            _THIRD - _READING,
            _THIRD + _READING,
            place=_PLACES[2],
            unit="MHz",
            role="set",
        ),
        within(
            "experiment 2: subtraction takes the oscillation out (ripple over raw)",
            subtracted[1] / raw[1],
            -np.inf,
            0.2,
            place=_PLACES[1],
        ),
        within(
            "experiment 3: subtraction takes the oscillation out (ripple over raw)",
            subtracted[2] / raw[2],
            -np.inf,
            0.1,
            place=_PLACES[2],
        ),
        within(
            "joint estimate without open water, all experiments (largest ripple)",
            max(joint),
            -np.inf,
            0.2 * min(raw[1:]),
            place="",
        ),
        *[_range(sweep) for sweep in (first, second, third)],
        *[_white(sweep) for sweep in (first, second, third)],
        *_white_in_milk(study),
        _backscatter_needed(study),
        *_in_better_water(study),
    ]


def draw(study: Study) -> Figure:
    """Draw the three panels."""
    with style():
        figure = new_figure(WIDE, 2.7)
        axes = figure.subplots(1, 3)
        for axis, sweep, other in zip(
            axes,
            study.once(shared.sweeps),
            study.once(shared.small_angle_sweeps),
            strict=True,
        ):
            # Over the mean echo, since the volts of the original are not known.
            unit = np.abs(sweep.truth).mean()
            f, every = sweep.frequency / 1e6, shared.shown(sweep)
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
            axis.plot(
                f[every],
                np.abs(sweep.signal[every]) / unit,
                "o",
                ms=2.6,
                color=COLOURS[0],
                label=f"$A$, {SYNTHETIC}",
            )
            axis.plot(
                f[every],
                np.abs(sweep.subtracted[every]) / unit,
                "o",
                ms=2.6,
                mfc="white",
                mew=0.7,
                color=COLOURS[1],
                label="$A_t$, open water subtracted",
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
            axis.set_xlim(0, 150)
            axis.set_xlabel("modulation frequency [MHz]")
            axis.grid(True)
        axes[0].set_ylabel("amplitude over mean echo [1]")
        letter(axes, shared.TITLES)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3)
        mark_synthetic(figure)
    return figure


def _in_better_water(study: Study) -> list[Check]:
    """Return the checks of experiments 2 and 3 with the water signal of form (29)."""
    checks = []
    for sweep, low, high in zip(
        study.once(shared.small_angle_sweeps)[1:],
        (_SECOND[0] - _READING, _THIRD - _READING),
        (_SECOND[1] + _READING, _THIRD + _READING),
        strict=True,
    ):
        name = f"experiment {sweep.number} by the small-angle form (29): "
        amplitude = np.abs(sweep.signal)
        apart = (
            extrema.find(sweep.frequency, shared.smoothed(amplitude)).separations / 1e6
        )
        checks += [
            holds(
                name + "maxima, and minima, stand as far apart (mean)",
                len(apart) >= 3 and low < float(np.mean(apart)) < high,
                found=_spread(apart),
                place=_PLACES[sweep.number - 1],
                wanted=f"mean of at least 3 from {low:g} to {high:g} MHz",
            ),
            within(
                name + "subtraction takes the oscillation out (ripple over raw)",
                extrema.ripple(np.abs(sweep.subtracted)) / extrema.ripple(amplitude),
                -np.inf,
                0.2 if sweep.number == 2 else 0.1,
                place=_PLACES[sweep.number - 1],
            ),
            _range(sweep, name),
        ]
    return checks


def _spread(apart: np.ndarray) -> str:
    if len(apart) == 0:
        return "none"
    return (
        f"{len(apart)}, {apart.min():.1f} to {apart.max():.1f}, mean "
        f"{apart.mean():.1f} MHz"
    )


def _range(sweep: shared.Sweep, name: str | None = None) -> Check:
    result, sigma, true = sweep.joint_range
    return holds(
        (name or f"experiment {sweep.number}: ")
        + "joint estimate without open water meets the slant range",
        abs(result - true) < 3 * sigma and sweep.joint_flags == 0,
        found=f"{1e3 * (result - true):+.2f} ± {1e3 * sigma:.2f} mm"
        + (", flagged" if sweep.joint_flags else ""),
        place="",
        wanted="0 mm within 3 standard errors, no flag",
    )


def _white_in_milk(study: Study) -> list[Check]:
    result = []
    for found in white_plate.reflectances(study):
        check = within(
            f"experiment {found.number}, spheres of milk in the water, by photons: the "
            "plate is white",
            found.value,
            *_WHITENESS,
            place=_WHITE,
            digits=2,
            uncertainty=found.error,
        )
        low, high = _WHITENESS
        near = low - 2 * found.error <= found.value <= high + 2 * found.error
        wanted = f"{check.wanted}, within 2 standard errors"
        result.append(replace(check, passed=near, wanted=wanted))
    return result


def _backscatter_needed(study: Study) -> Check:
    """Return whether (29) needs the phase function that the diffusion form needs."""
    forms = [
        [sweep.needed_backscatter for sweep in study.once(sweeps)]
        for sweeps in (shared.sweeps, shared.small_angle_sweeps)
    ]
    diffusion, small_angle = (
        f"{min(values[1:]):.3f} to {max(values[1:]):.3f}" for values in forms
    )
    quotient = np.array(forms[1][1:]) / np.array(forms[0][1:])
    return holds(
        "experiments 2 and 3: both forms need the same phase function at 180 degrees "
        f"over a plate of {shared.WHITE:g}",
        bool(np.all(np.abs(quotient - 1) < 0.25)),
        found=f"{diffusion} 1/sr by the diffusion form, {small_angle} by (29)",
        wanted="the same within 25 %",
        place="",
    )


def _white(sweep: shared.Sweep) -> Check:
    return within(
        f"experiment {sweep.number}: the plate is white (reflectance that gives the "
        "ratio of water signal and echo)",
        sweep.reflectance,
        *_WHITENESS,
        place=_WHITE,
        digits=2,
    )
