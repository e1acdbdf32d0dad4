"""Figure 11 of Ricci et al. 2010: lines over a flat plate, circular polarization."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from amulor.studies.ricci2010.figures import panels
from amulor.studies.ricci2010.figures.panels import WIDE, letter, mark_synthetic
from amulor.studies.ricci2010.results import Check, within
from amulor.studies.ricci2010.scenes import short_lines
from amulor.studies.ricci2010.scenes import short_lines as lines
from amulor.studies.ricci2010.study import Study
from amulor.view.style import new_figure, style

TITLE = "Phase along a line, circular polarization, four turbidities"
CAPTION = (
    "As figure 10, phase advance upwards, with right circular light launched. The "
    "analyzer passes left (RL, filled) or right (RR, open) circular light, in (a) tap "
    "water and (b) to (d) with more and more milk. Small spheres return circular "
    "light with the other handedness, so RL contains the light of the water. Marks "
    "are synthetic measurements: polarized Monte Carlo in Mie spheres of milk, with "
    "the phase error of the apparatus added. Black: without noise. Dashed: RL after "
    "subtraction of open water. Nothing was chosen for this figure."
)

#: Where the paper speaks of each panel.
_AT = {
    step: f"section 9, on figure 11({panel})"
    for step, panel in zip(lines.TURBIDITIES, "abcd", strict=True)
}


def checks(study: Study) -> list[Check]:
    """Return what the text says of figure 11."""
    apart, error = lines.difference(study, "tap", ("RL", "RR"))
    turbid = lines.line(study, "d", "RR")
    return [
        within(
            "(a) RL and RR do not differ beyond the phase error in tap water",
            apart, -short_lines.FLAT, short_lines.FLAT,
            place=_AT["tap"], unit="deg", uncertainty=error,
        ),
        *(
            short_lines.moves(study, f"({step}) RL drifts", step, "RL", place=_AT[step])
            for step in ("b", "c", "d")
        ),
        short_lines.stays_flat(study, "(b) RR does not drift", "b", "RR", place=_AT["b"]
        ),
        short_lines.stays_flat(study, "(c) RR does not drift", "c", "RR", place=_AT["c"]
        ),
        short_lines.moves(study, "(d) RR drifts", "d", "RR", place=_AT["d"]),
        within(
            "(d) RR drifts by less than 3 degrees",
            turbid.drift, -np.inf, 3.0,
            place=_AT["d"], unit="deg", uncertainty=turbid.error,
        ),
    ]  # fmt: skip


def draw(study: Study) -> Figure:
    """Return figure 11."""
    with style():
        figure = new_figure(WIDE, 4.6)
        axes = figure.subplots(2, 2, sharex=True, sharey=True)
        for axis, step in zip(axes.flat, lines.TURBIDITIES, strict=True):
            panels.panel(study, axis, step, ("RL", "RR"), subtracted=True)
            axis.label_outer()
        letter(
            axes.flat,
            [panels.water_name(study, step) for step in lines.TURBIDITIES],
        )
        handles, labels = axes[0, 0].get_legend_handles_labels()
        figure.legend(
            handles, labels, loc="outside upper center", ncols=4, columnspacing=1.2
        )
        mark_synthetic(figure)
    return figure
