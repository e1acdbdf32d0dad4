"""Figure 13 of Ricci et al. 2010: forty profiles of the ladder over each other."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from amulor.studies.ricci2010.figures.panels import (
    SYNTHETIC,
    WIDE,
    Relief,
    letter,
    mark_synthetic,
    relief,
    styled,
)
from amulor.studies.ricci2010.results import Check, Role, holds, within
from amulor.studies.ricci2010.scenes.ladder_scans import (
    PANELS,
    Steps,
    phase_step,
    steps_agree,
)
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS, new_figure

TITLE = "Forty profiles of the ladder"
CAPTION = (
    "All lines of four synthetic scans of the ladder, from the phase behind "
    "polarizers alone, as in the paper: (a) crossed and (b) parallel in clear water, "
    "(c) crossed and (d) parallel in milk. Dashed: the mean of the same lines after "
    "subtraction of open water, which the paper did not do here. Black: the ladder. "
    "Heights are counted from the farthest tread of each profile, because the water "
    "signal also moves the whole ladder nearer, by up to 7 cm in (d). Gaps: hidden "
    "from the receiver by a step, or no range after subtraction. The size of the "
    "noise was chosen from the published range errors; its order and the steps were "
    "not."
)
#: What the text says of the range error in each panel [mm].
_WANTED = ((0.5 / 1.5, 0.5 * 1.5), (0.5, 2.0), (2 / 1.5, 2 * 1.5), (10 / 1.5, 10 * 1.5))
#: The scatter was deduced from the published errors, that of clear water with
#: parallel polarizers was not.
_ROLES: tuple[Role, ...] = ("set", "test", "set", "set")

#: Heights that are drawn [mm].
_LIMITS = (-30.0, 130.0)
#: Fraction of the lines that must see a column, for its mean to be drawn [1].
_SEEN = 0.9


def checks(study: Study) -> list[Check]:
    """Return what the paper says of the figure, beside what was found."""
    result: list[Check] = []
    noises: list[float] = []
    panels = zip("abcd", PANELS, _WANTED, _ROLES, strict=True)
    for letter_of, (title, scan_of, channel), wanted, role in panels:
        scan = study.once(scan_of)
        panel, place = f"({letter_of}) {title}", f"section 9, on figure 13({letter_of})"
        steps = scan.steps(scan.raw[channel])
        if scan_of is PANELS[0][1]:
            result += _phases(study, panel, steps, place=place)
        noises.append(steps.noise * 1e3)
        result.append(
            within(
                f"{panel}: range error of a pixel",
                noises[-1],
                *wanted,
                place=place,
                unit="mm",
                uncertainty=noises[-1] / math.sqrt(2 * max(steps.pixels, 1)),
                role=role,
            )
        )
    return [
        *result,
        *_in_milk(study),
        holds(
            "the range error grows from (a) to (d)",
            noises[0] <= noises[1] < noises[2] < noises[3],
            found=", ".join(f"{noise:.2g}" for noise in noises) + " mm",
            wanted="a ≤ b < c < d",
            place="section 9, on figure 13",
        ),
        *_subtracted(study),
    ]


def _in_milk(study: Study) -> list[Check]:
    """Return what the text says of the steps in milk, behind polarizers alone."""
    scan = study.once(PANELS[2][1])
    crossed, parallel = (scan.off(scan.raw[name]) * 1e3 for name in ("VH", "VV"))
    steps = scan.steps(scan.raw["VH"])
    worst = float(crossed[np.argmax(np.abs(crossed))])
    return [
        within(
            "(c) VH, milk: the ladder is well distinguishable (least step over the "
            "range error of a pixel)",
            float(steps.heights.min() / steps.noise),
            2.0,
            math.inf,
            place="section 9, on figure 13(c)",
        ),
        within(
            "(c) VH, milk: steps are right to the stated 2 mm (the one farthest off)",
            worst,
            -2.0,
            2.0,
            unit="mm",
            place="section 9, on figure 13(c)",
            uncertainty=float(steps.uncertainties.max()) * 1e3,
        ),
        holds(
            "(d) VV, milk: a significant degradation: the step farthest off is farther "
            "off than in (c), by more than the stated 2 mm",
            np.abs(parallel).max() - abs(worst) > 2.0,
            found=f"{parallel[np.argmax(np.abs(parallel))]:+.1f} against "
            f"{worst:+.1f} mm",
            wanted="farther by 2 mm",
            place="section 9, on figure 13(d)",
        ),
    ]


def _subtracted(study: Study) -> list[Check]:
    """Return what subtraction of open water would have added."""
    result = []
    for letter_of, (title, scan_of, channel) in zip("abcd", PANELS, strict=True):
        scan = study.once(scan_of)
        result.append(
            steps_agree(
                study,
                f"({letter_of}) {title}: steps, open water subtracted",
                scan.steps(scan.subtracted[channel]),
                place="",
            )
        )
    return result


def _phases(study: Study, panel: str, steps: Steps, *, place: str) -> list[Check]:
    """Return the checks of the phases that the steps stand for, 5 % either way."""
    first = phase_step(study, steps.heights[0])
    other = phase_step(study, float(np.mean(steps.heights[1:])))
    # Neighbouring steps share a tread, which makes their mean better than this.
    error = math.sqrt(float(np.sum(steps.uncertainties[1:] ** 2))) / 3
    return [
        within(
            f"{panel}: phase of the first step",
            math.degrees(first),
            0.95 * 5.0,
            1.05 * 5.0,
            place=place,
            unit="deg",
            uncertainty=math.degrees(phase_step(study, steps.uncertainties[0])),
        ),
        within(
            f"{panel}: phase of a step of 1 cm, mean of three",
            math.degrees(other),
            0.95 * 1.25,
            1.05 * 1.25,
            place=place,
            unit="deg",
            uncertainty=math.degrees(phase_step(study, error)),
        ),
    ]


@styled
def draw(study: Study) -> Figure:
    """Draw the figure."""
    figure = new_figure(WIDE, 4.3)
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    for axis, (_, scan_of, channel) in zip(axes.flat, PANELS, strict=True):
        scan = study.once(scan_of)
        surfaces: dict[str, Relief] = {}
        for name, images in (("left", scan.raw), ("taken", scan.subtracted)):
            image = images[channel]
            surfaces[name] = relief(image, origin=scan.farthest(image))
        closest = surfaces["left"].near
        shown = (closest > _LIMITS[0]) & (closest < _LIMITS[1])
        lines = axis.plot(
            surfaces["left"].right.T,
            np.where(shown, closest, np.nan).T,
            color=COLOURS[0],
            lw=0.5,
            alpha=0.35,
            zorder=2,
        )
        lines[0].set_label(f"{SYNTHETIC}, {len(lines)} lines, polarizers alone")
        known = np.isfinite(surfaces["taken"].near)
        seen = known.mean(axis=0) > _SEEN
        taken = np.full(seen.size, np.nan)
        taken[seen] = np.nanmean(surfaces["taken"].near[:, seen], axis=0)
        axis.plot(
            np.mean(surfaces["taken"].right, axis=0),
            taken,
            color=COLOURS[1],
            lw=1.2,
            ls=(0, (3, 1.5)),
            label="their mean, open water subtracted",
            zorder=4,
        )
        edges, heights = _ladder(study)
        axis.stairs(
            heights,
            edges,
            baseline=None,
            color=COLOURS[6],
            lw=0.9,
            label="ladder",
            zorder=3,
        )
        axis.set_ylim(*_LIMITS)
        axis.set_xlim(edges[0], edges[-1])
        axis.grid(lw=0.3)
    letter(axes.flat, [title for title, *_ in PANELS])
    for axis in axes[-1]:
        axis.set_xlabel("right [mm]")
    for axis in axes[:, 0]:
        axis.set_ylabel("nearer [mm]")
    drawn = axes[0, 0].get_legend_handles_labels()
    legend = figure.legend(*drawn, loc="outside upper center", ncols=3)
    legend.get_lines()[0].set(alpha=1.0, linewidth=1.2)
    mark_synthetic(figure)
    return figure


def _ladder(study: Study) -> tuple[list[float], list[float]]:
    """Return the edges of the treads and their heights [mm]."""
    steps = [study["first_step"], *[study["other_steps"]] * 3]
    heights = np.concatenate([[0.0], np.cumsum(steps)]) * 1e3
    width = study["tread_width"] * 1e3
    edges = (np.arange(heights.size + 1) - heights.size / 2) * width
    return list(edges), list(heights)
