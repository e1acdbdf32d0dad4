"""Figure 5 of Ricci et al. 2010: the ladder in clear water, from several sides."""

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
from amulor.studies.ricci2010.results import Check, within
from amulor.studies.ricci2010.scenes.ladder_scans import (
    cut_off,
    steps_agree,
    steps_are_faithful,
    unpolarized_clear,
)
from amulor.studies.ricci2010.study import Study

TITLE = "The ladder in clear water"
CAPTION = (
    "The ladder in clear water at the far end of the short tank, from the phase of "
    "the modulation alone. (a) to (c) show one synthetic scan from three sides, true "
    "to scale. Nothing was subtracted. The modulation frequency is above the cut-off "
    "of the model's water, which has no end. Each point is the median of five by five "
    "pixels. Gaps: no range, because a step hides the surface from the receiver. "
    "Color: height above the farthest tread."
)
#: Where the paper speaks of it.
_PLACE = "section 7, on figures 5 and 6"
#: Heights that are drawn [mm], and the directions from which [degree].
_LIMITS = (-5.0, 75.0)
_SIDES = {
    "from the left": (30, -120),
    "from the right": (30, -60),
    "along the treads": (6, -90),
}


def checks(study: Study) -> list[Check]:
    """Return what the paper says of the figure, beside what was found."""
    scan = study.once(unpolarized_clear)
    megahertz = study["frequency"] / 1e6
    image = scan.stated["none"]
    return [
        within(
            "the modulation frequency is above the cut-off of the model's water",
            cut_off(scan.survey) / 1e6,
            0.0,
            megahertz,
            place=_PLACE,
            unit="MHz",
        ),
        within(
            "the same, for a column of water that ends with the tank",
            cut_off(scan.survey, end=study["short_length"]) / 1e6,
            0.0,
            megahertz,
            place="",
            unit="MHz",
        ),
        steps_are_faithful(
            study,
            "the frequency alone, nothing subtracted, reproduces the ladder",
            scan.steps(image),
            place=_PLACE,
        ),
        steps_agree(
            study,
            "the frequency alone, nothing subtracted, gives the steps",
            scan.steps(image),
            place="",
        ),
        steps_agree(
            study,
            "subtraction of open water gives the steps",
            scan.steps(scan.subtracted["none"]),
            place="",
        ),
    ]


@styled
def draw(study: Study) -> Figure:
    """Draw the figure."""
    scan = study.once(unpolarized_clear)
    surface, scatter = median(
        relief(scan.stated["none"], origin=study["short_distance"])
    )
    figure, cells = canvas(WIDE, 2.7, rows=1, columns=len(_SIDES))
    axes = [
        draw_surface(
            figure,
            cell,
            surface,
            limits=_LIMITS,
            shades=LADDER_SHADES,
            elevation=high,
            azimuth=around,
            zoom=1.1,
        )
        for cell, (high, around) in zip(cells, _SIDES.values(), strict=True)
    ]
    letter(axes, _SIDES)
    figure.suptitle(f"a pixel ± {scatter:.1f} mm", fontsize=7)
    mark_synthetic(figure)
    return figure
