"""Figure 14 of Ricci et al. 2010: surfaces of the ladder, crossed and parallel."""

from __future__ import annotations

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
from amulor.studies.ricci2010.results import Check, holds
from amulor.studies.ricci2010.scenes.ladder_scans import PANELS
from amulor.studies.ricci2010.study import Study

TITLE = "Surfaces of the ladder, crossed and parallel"
CAPTION = (
    "The synthetic scans of figure 13 as surfaces behind polarizers alone, true to "
    "scale, heights counted from the farthest tread. (a) Crossed and (b) parallel in "
    "clear water, (c) crossed and (d) parallel in milk. Each point is the median of "
    "five by five pixels; the titles state the scatter of a pixel about it. Gaps: no "
    "range, because a step hides the surface from the receiver."
)
#: Heights that are drawn [mm].
_LIMITS = (-25.0, 122.0)


def checks(study: Study) -> list[Check]:
    """Return what the paper says of the figure, beside what was found."""
    milk = study.once(PANELS[2][1])
    crossed, parallel = (
        float(milk.steps(milk.raw[name]).heights.sum()) * 1e3 for name in ("VH", "VV")
    )
    true = (study["first_step"] + 3 * study["other_steps"]) * 1e3
    result = [
        holds(
            "the ladder is smoothed more in (d) than in (c): height of its last tread "
            "over the first",
            parallel < crossed <= true,
            found=f"{crossed:.1f} and {parallel:.1f} of {true:.0f} mm",
            wanted="(d) lower than (c)",
            place="section 9, on figure 14",
        )
    ]
    for stage, place in (
        ("the polarizers alone", "section 9, on figure 14"),
        ("open water subtracted", ""),
    ):
        errors = []
        for _, scan_of, channel in PANELS:
            scan = study.once(scan_of)
            images = scan.raw if stage == "the polarizers alone" else scan.subtracted
            errors.append(scan.steps(images[channel]).error * 1e3)
        result.append(
            holds(
                f"the surface error (rms) grows from (a) to (d), {stage}",
                errors[0] <= errors[1] < errors[2] < errors[3],
                found=", ".join(f"{error:.2g}" for error in errors) + " mm",
                wanted="a ≤ b < c < d",
                place=place,
            )
        )
    return result


@styled
def draw(study: Study) -> Figure:
    """Draw the figure."""
    figure, cells = canvas(WIDE, 5.8, rows=2, columns=2)
    axes, titles = [], []
    for cell, (title, scan_of, channel) in zip(cells, PANELS, strict=True):
        scan = study.once(scan_of)
        image = scan.raw[channel]
        surface, scatter = median(relief(image, origin=scan.farthest(image)))
        titles.append(f"{title}: a pixel ± {scatter:.1f} mm")
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
    letter(axes, titles)
    mark_synthetic(figure)
    return figure
