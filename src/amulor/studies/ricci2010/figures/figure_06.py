"""Figure 6 of Ricci et al. 2010: the ladder in turbid water, by frequency alone."""

from __future__ import annotations

from matplotlib.figure import Figure

from amulor.studies.ricci2010.checks import Check, holds, within
from amulor.studies.ricci2010.figures.drawing import (
    WIDE,
    letter,
    mark_synthetic,
    styled,
)
from amulor.studies.ricci2010.figures.surfaces import LADDER_SHADES, canvas, relief
from amulor.studies.ricci2010.figures.surfaces import draw as draw_surface
from amulor.studies.ricci2010.scenes.ladder_checks import cut_off, steps_agree
from amulor.studies.ricci2010.scenes.ladder_scans import (
    unpolarized_clear,
    unpolarized_turbid,
)
from amulor.studies.ricci2010.study import Study

TITLE = "The ladder in turbid water"
CAPTION = (
    "The ladder in the turbid water of the long tank, from the phase of the modulation "
    "at a frequency just above the cut-off of the water signal; synthetic scan, true "
    "to scale, heights counted from the farthest tread. (a) Nothing subtracted, as in "
    "the paper's section on the choice of frequency: a ladder is seen, but its steps "
    "are far too low, since the water signal exceeds that of the ladder. (b) The same "
    "samples after subtraction of open water: noisier, with the right steps."
)
#: Where the paper speaks of it.
_PLACE = "section 7, on figures 5 and 6"
#: Heights that are drawn [mm].
_LIMITS = (-29.0, 99.0)


def checks(study: Study) -> list[Check]:
    """Return what the paper says of the figure, beside what was found.

    Parameters
    ----------
    study : Study
        Its numbers.

    Returns
    -------
    list of Check
        Cut-off, steps and errors.
    """
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
        steps_agree(
            study,
            "the frequency alone, nothing subtracted, gives the steps",
            left,
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
    """Draw the figure.

    Parameters
    ----------
    study : Study
        Its numbers.

    Returns
    -------
    matplotlib.figure.Figure
        Two panels.
    """
    scan = study.once(unpolarized_turbid)
    figure, cells = canvas(WIDE, 3.3, rows=1, columns=2)
    axes = []
    images = (scan.raw["none"], scan.subtracted["none"])
    for cell, image in zip(cells, images, strict=True):
        # Each has its own zero: the water left in moves the whole ladder.
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
    letter(axes, ("frequency alone", "open water subtracted"))
    mark_synthetic(figure)
    return figure
