"""Figure 14 of Ricci et al. 2010: surfaces of the ladder, crossed and parallel."""

from __future__ import annotations

from matplotlib.figure import Figure

from amulor.studies.ricci2010.checks import Check, holds
from amulor.studies.ricci2010.figures.drawing import (
    WIDE,
    letter,
    mark_synthetic,
    styled,
)
from amulor.studies.ricci2010.figures.surfaces import LADDER_SHADES, canvas, relief
from amulor.studies.ricci2010.figures.surfaces import draw as draw_surface
from amulor.studies.ricci2010.scenes.ladder_scans import PANELS
from amulor.studies.ricci2010.study import Study

TITLE = "Surfaces of the ladder, crossed and parallel"
CAPTION = (
    "The synthetic scans of figure 13 as surfaces, true to scale, heights counted from "
    "the farthest tread, open water subtracted: (a) crossed and (b) parallel in clear "
    "water, (c) crossed and (d) parallel in milk. Gaps: no range, hidden from the "
    "receiver by a step, or beyond the limits of the panel."
)
#: Heights that are drawn [mm].
_LIMITS = (-19.0, 93.0)


def checks(study: Study) -> list[Check]:
    """Return what the paper says of the figure, beside what was found.

    Parameters
    ----------
    study : Study
        Its numbers.

    Returns
    -------
    list of Check
        Order of the surface errors.
    """
    result = []
    for stage, place in (
        ("open water subtracted", ""),
        ("the polarizers alone", "section 9, on figure 14"),
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
    figure, cells = canvas(WIDE, 5.8, rows=2, columns=2)
    axes = []
    for cell, (_, scan_of, channel) in zip(cells, PANELS, strict=True):
        scan = study.once(scan_of)
        image = scan.subtracted[channel]
        surface = relief(image, origin=scan.farthest(image))
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
    letter(axes, [title for title, *_ in PANELS])
    mark_synthetic(figure)
    return figure
