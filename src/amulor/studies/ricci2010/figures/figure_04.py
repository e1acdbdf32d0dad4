"""Figure 4 of Ricci et al. 2010: water signal against frequency, higher turbidity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.figure import Figure

from amulor.studies.ricci2010.figures.figure_03 import sweep_checks, sweep_figure
from amulor.studies.ricci2010.results import Check, holds, within
from amulor.studies.ricci2010.scenes.water_sweeps import sweep
from amulor.studies.ricci2010.study import Study

TITLE = "The water as a low-pass, higher turbidity"
CAPTION = (
    "As figure 3, at the higher turbidity. The water signal comes from shorter "
    "distances, so every cut-off is higher. Scattering also turns the light by larger "
    "angles. Squares are a SYNTHETIC measurement."
)


def checks(study: Study) -> list[Check]:
    """Compare with what the text says of the figure."""
    low, high = sweep(study, "low"), sweep(study, "high")
    ratios = []
    for one, other in zip(low.curves, high.curves, strict=True):
        ratio = other.cut_off / one.cut_off
        error = ratio * np.hypot(
            one.cut_off_error / one.cut_off, other.cut_off_error / other.cut_off
        )
        ratios.append((ratio, float(error)))
    least, error = min(ratios)
    higher = within(
        "the cut-off is higher than in figure 3, in every model: least ratio",
        least,
        1.0,
        np.inf,
        place="section 7, on figures 4 and 6",
        uncertainty=error or None,
    )
    shown = ", ".join(f"{ratio:.2f}" for ratio, _ in ratios)
    moments = low.water.second_moment, high.water.second_moment
    asymmetries = [s.water.phase_function.asymmetry for s in (low, high)]
    return [
        *sweep_checks(high),
        replace(higher, found=f"{higher.found} (of {shown})"),
        # Both numbers were chosen so.
        holds(
            "second moment larger and asymmetry smaller than in figure 3",
            moments[1] > moments[0] and asymmetries[1] < asymmetries[0],
            found=f"{moments[0]:.3g} to {moments[1]:.3g} rad², "
            f"{asymmetries[0]:.4f} to {asymmetries[1]:.4f}",
            wanted="larger, smaller",
            place="section 7, on figure 4",
            role="set",
        ),
    ]


def draw(study: Study) -> Figure:
    """Draw curves and cut-offs."""
    return sweep_figure(sweep(study, "high"))
