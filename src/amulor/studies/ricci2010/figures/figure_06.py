"""Figure 6 of Ricci et al. 2010: the ladder in turbid water, by frequency alone."""

from __future__ import annotations

import math

from matplotlib.figure import Figure

from amulor.studies.ricci2010.figures.panels import (
    LADDER_SHADES,
    WIDE,
    canvas,
    draw_surface,
    letter,
    mark_synthetic,
    median,
    relief,
    styled,
)
from amulor.studies.ricci2010.results import Check, holds, within
from amulor.studies.ricci2010.scenes.ladder_scans import (
    cut_off,
    steps_agree,
    steps_are_faithful,
    unpolarized_clear,
    unpolarized_turbid,
)
from amulor.studies.ricci2010.study import Study

TITLE = "The ladder in turbid water"
CAPTION = (
    "The ladder at 3.7 m in water that is turbid but optically thin, as the paper "
    "says of both its ladders. Synthetic scan, from the phase of the modulation, true "
    "to scale, heights counted from the farthest tread. (a) Nothing subtracted, as in "
    "the paper. The water signal moves the whole ladder nearer by some centimeters, "
    "by the same amount on all treads, and the steps are right. (b) The same samples "
    "after subtraction of open water. Each point is the median of five by five "
    "pixels; the titles state the scatter of a pixel about it. In water so thin 39 "
    "MHz is twice the cut-off, not just above it."
)
#: Where the paper speaks of it.
_PLACE = "section 7, on figures 5 and 6"
#: Heights that are drawn [mm].
_LIMITS = (-15.0, 85.0)


def checks(study: Study) -> list[Check]:
    """Return what the paper says of the figure, beside what was found."""
    scan, clear = study.once(unpolarized_turbid), study.once(unpolarized_clear)
    above = study["frequency"] / cut_off(scan.survey)
    left, taken = scan.steps(scan.raw["none"]), scan.steps(scan.subtracted["none"])
    clear_left, clear_taken = (
        clear.steps(clear.raw["none"]),
        clear.steps(clear.subtracted["none"]),
    )
    return [
        within(
            "the modulation frequency is just above the cut-off: their quotient",
            above,
            1.0,
            1.5,
            place=_PLACE,
        ),
        steps_are_faithful(
            study,
            "the frequency alone, nothing subtracted, reproduces the ladder",
            left,
            place=_PLACE,
        ),
        within(
            "the water is optically thin, up to the ladder",
            study["ladder_attenuation"] * study["turbid_distance"],
            0.0,
            1.0,
            place=_PLACE,
            role="set",
        ),
        within(
            "the surface is rougher than in clear water (scatter of a pixel over it)",
            left.noise / clear_left.noise,
            1.0,
            math.inf,
            place=_PLACE,
        ),
        steps_agree(
            study, "subtraction of open water gives the steps", taken, place=""
        ),
        *[
            holds(
                f"range error (rms) larger than in clear water, {stage}",
                turbid.error > other.error,
                found=f"{turbid.error * 1e3:.3g} against {other.error * 1e3:.3g} mm",
                wanted="larger",
                place=place,
            )
            for stage, turbid, other, place in (
                ("nothing subtracted", left, clear_left, _PLACE),
                ("open water subtracted", taken, clear_taken, ""),
            )
        ],
    ]


@styled
def draw(study: Study) -> Figure:
    """Draw the figure."""
    scan = study.once(unpolarized_turbid)
    figure, cells = canvas(WIDE, 3.3, rows=1, columns=2)
    axes, scatters = [], []
    images = (scan.raw["none"], scan.subtracted["none"])
    for cell, image in zip(cells, images, strict=True):
        # Each has its own zero: the water left in moves the whole ladder.
        surface, scatter = median(relief(image, origin=scan.farthest(image)))
        scatters.append(scatter)
        axes.append(
            draw_surface(
                figure,
                cell,
                surface,
                limits=_LIMITS,
                shades=LADDER_SHADES,
                azimuth=-115,
                zoom=1.15,
            )
        )
    stages = ("frequency alone", "open water subtracted")
    letter(
        axes,
        [
            f"{stage}: a pixel ± {scatter:.1f} mm"
            for stage, scatter in zip(stages, scatters, strict=True)
        ],
    )
    mark_synthetic(figure)
    return figure
