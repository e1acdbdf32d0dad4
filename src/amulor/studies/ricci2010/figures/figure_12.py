"""Figure 12 of Ricci et al. 2010: crossed linear and same circular at most milk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from amulor.studies.ricci2010.checks import Check, within
from amulor.studies.ricci2010.figures import line_panels
from amulor.studies.ricci2010.figures.drawing import NARROW, mark_synthetic
from amulor.studies.ricci2010.scenes import line_checks
from amulor.studies.ricci2010.scenes import short_lines as lines
from amulor.studies.ricci2010.study import Study
from amulor.view.style import new_figure, style

TITLE = "Crossed linear against same circular polarization"
CAPTION = (
    "Advance of the phase along a line at the highest turbidity of figures 10 and 11: "
    "crossed linear (VH, filled) and same circular (RR, open) polarization. Marks are "
    "synthetic measurements: polarized Monte Carlo in Mie spheres of milk, with the "
    "phase error of the apparatus added. Black: without noise."
)


def checks(study: Study) -> list[Check]:
    """Return what the text says of figure 12.

    Parameters
    ----------
    study : Study
        Numbers.

    Returns
    -------
    list of Check
        One.
    """
    margin, error = lines.difference(study, "d", ("VH", "RR"))
    crossed, same = (abs(lines.line(study, "d", pair).drift) for pair in ("VH", "RR"))
    check = within(
        "RR drifts by less than VH, by more than the phase error",
        margin,
        line_checks.FLAT,
        np.inf,
        place="section 9, on figures 11(d) and 12",
        unit="deg",
        uncertainty=error,
    )
    kept = [
        lines.rejected_share(study, "d", pairs)
        for pairs in (("RR", "RL"), ("VH", "VV"))
    ]
    result = (
        f"{check.found} (VH {crossed:.2f}, RR {same:.2f} deg); the water passes "
        f"{kept[0] / kept[1]:.2g} times as much light of the same hand as crossed, "
        f"and less than {echo_ratio(study):.2g} times would be needed"
    )
    sure = margin - line_checks.SURE * error >= line_checks.FLAT
    return [line_checks.surely(replace(check, found=result), sure)]


def echo_ratio(study: Study) -> float:
    """Return the echo of the plate behind RR over that behind VH.

    Parameters
    ----------
    study : Study
        Numbers.

    Returns
    -------
    float
        RR drifts by less than VH if the same ratio of the water's light is lower [1].

    Notes
    -----
    In light exactly back from particles without order reciprocity makes
    m44 = 1 - 2 m22, so that the ratio of the water is 2 there, at any order of
    scattering. The ratio of the plate reaches 2 where m44 is -0.22, the upper end of
    what can exist, and is lower elsewhere.
    """
    return (1 + study["m44_target"]) / (1 - study["m22_target"])


def draw(study: Study) -> Figure:
    """Return figure 12.

    Parameters
    ----------
    study : Study
        Numbers.

    Returns
    -------
    matplotlib.figure.Figure
        One panel.
    """
    with style():
        figure = new_figure(NARROW, 3.0)
        axis = figure.subplots()
        line_panels.panel(study, axis, "d", ("VH", "RR"), subtracted=False)
        axis.set_title(line_panels.water_name(study, "d"))
        figure.legend(loc="outside upper center", ncols=1)
        mark_synthetic(figure)
    return figure
