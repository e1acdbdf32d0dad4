"""Figure 13 of Ricci et al. 2010: forty profiles of the ladder over each other."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.figure import Figure

from amulor.studies.ricci2010.checks import Check, Role, holds, within
from amulor.studies.ricci2010.figures.drawing import (
    SYNTHETIC,
    WIDE,
    letter,
    mark_synthetic,
    styled,
)
from amulor.studies.ricci2010.figures.surfaces import Relief, relief
from amulor.studies.ricci2010.scenes.ladder_checks import phase_step, steps_agree
from amulor.studies.ricci2010.scenes.ladder_scans import PANELS, Steps
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS, new_figure

TITLE = "Forty profiles of the ladder"
CAPTION = (
    "All lines of four synthetic scans of the ladder over each other, open water "
    "subtracted: (a) crossed and (b) parallel in clear water, (c) crossed and (d) "
    "parallel in milk. Dashed: the mean of the same lines with the water signal left "
    "in, which bends the profile in milk. Black: the ladder. Heights are counted from "
    "the farthest tread of each profile. Gaps: no range, hidden from the receiver by a "
    "step. The size of the noise was chosen from the published range "
    "errors; its order and the steps were not."
)
#: What the text says of the range error in each panel [mm].
_WANTED = ((0.5 / 1.5, 0.5 * 1.5), (0.5, 2.0), (2 / 1.5, 2 * 1.5), (10 / 1.5, 10 * 1.5))
#: The scatter was deduced from the published errors, that of clear water with
#: parallel polarizers was not.
_ROLES: tuple[Role, ...] = ("set", "test", "set", "set")

#: Heights that are drawn [mm].
_LIMITS = (-25.0, 115.0)
#: Fraction of the lines that must see a column, for its mean to be drawn [1].
_SEEN = 0.9


def checks(study: Study) -> list[Check]:
    """Return what the paper says of the figure, beside what was found.

    Parameters
    ----------
    study : Study
        Its numbers.

    Returns
    -------
    list of Check
        Steps and range errors.
    """
    result: list[Check] = []
    noises: list[float] = []
    panels = zip("abcd", PANELS, _WANTED, _ROLES, strict=True)
    for letter_of, (title, scan_of, channel), wanted, role in panels:
        scan = study.once(scan_of)
        panel = f"({letter_of}) {title}"
        steps = scan.steps(scan.subtracted[channel])
        if scan_of is PANELS[0][1]:
            result += _phases(
                study, panel, steps, place=f"section 9, on figure 13({letter_of})"
            )
        else:
            left = scan.steps(scan.raw[channel])
            result += [
                steps_agree(
                    study,
                    f"{panel}: steps, open water subtracted",
                    steps,
                    place="",
                ),
                steps_agree(
                    study,
                    f"{panel}: steps, the polarizers alone",
                    left,
                    place=f"section 9, on figure 13({letter_of})",
                ),
            ]
        noises.append(steps.noise * 1e3)
        result.append(
            within(
                f"{panel}: range error of a pixel",
                noises[-1],
                *wanted,
                place=f"section 9, on figure 13({letter_of})",
                unit="mm",
                uncertainty=noises[-1] / math.sqrt(2 * max(steps.pixels, 1)),
                role=role,
            )
        )
    result.append(
        holds(
            "the range error grows from (a) to (d)",
            noises[0] <= noises[1] < noises[2] < noises[3],
            found=", ".join(f"{noise:.2g}" for noise in noises) + " mm",
            wanted="a ≤ b < c < d",
            place="section 9, on figure 13",
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
    """Draw the figure.

    Parameters
    ----------
    study : Study
        Its numbers.

    Returns
    -------
    matplotlib.figure.Figure
        Four panels.
    """
    figure = new_figure(WIDE, 4.3)
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    for axis, (_, scan_of, channel) in zip(axes.flat, PANELS, strict=True):
        scan = study.once(scan_of)
        surfaces: dict[str, Relief] = {}
        for name, images in (("taken", scan.subtracted), ("left", scan.raw)):
            image = images[channel]
            surfaces[name] = relief(image, origin=scan.farthest(image))
        closest = surfaces["taken"].near
        shown = (closest > _LIMITS[0]) & (closest < _LIMITS[1])
        lines = axis.plot(
            surfaces["taken"].right.T,
            np.where(shown, closest, np.nan).T,
            color=COLOURS[0],
            lw=0.5,
            alpha=0.35,
            zorder=2,
        )
        lines[0].set_label(f"{SYNTHETIC}, {len(lines)} lines, water subtracted")
        # A pixel without a range after subtraction shows nothing but water before.
        seen = shown.mean(axis=0) > _SEEN
        raw = np.where(seen, np.mean(surfaces["left"].near, axis=0), np.nan)
        axis.plot(
            np.mean(surfaces["left"].right, axis=0),
            raw,
            color=COLOURS[1],
            lw=1.2,
            ls=(0, (3, 1.5)),
            label="their mean with the water left in",
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
