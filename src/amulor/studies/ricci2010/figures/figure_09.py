"""Figure 9 of Ricci et al. 2010: contrast against the water signal."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from amulor.studies.ricci2010.figures import panels
from amulor.studies.ricci2010.results import Check, holds
from amulor.studies.ricci2010.scenes import interference_sweeps as shared
from amulor.studies.ricci2010.study import Study

TITLE = "Contrast against modulation frequency"
CAPTION = (
    "Contrast C of signal and water signal (filled, synthetic measurement), and C_t "
    "of echo and water signal (open, after open-water subtraction). The sweeps are "
    "those of figure 7: (a) to (c) experiments 1 to 3. Below 0 the water alone is "
    "brighter."
)


def checks(study: Study) -> list[Check]:
    """Return what the text says of the figure, and what was found."""
    sweeps = study.once(shared.sweeps)
    lowest = [float(sweep.contrast.min()) for sweep in sweeps]
    return [
        *[panels.same_extrema(s, s.contrast, "contrast") for s in sweeps[1:]],
        panels.almost_monotonic(sweeps[0], sweeps[0].contrast, "contrast"),
        *[panels.grows(s, s.contrast, "contrast") for s in sweeps],
        holds(
            "contrast is negative at some frequencies of experiments 2 and 3 only "
            "(least contrast)",
            lowest[0] > 0 > max(lowest[1:]),
            found=", ".join(f"{value:+.2f}" for value in lowest),
            place="section 8, after figure 9",
            wanted="above 0, below 0, below 0",
        ),
        holds(
            "the corrected contrast of the highest frequencies is near 1 (mean of the "
            "last tenth)",
            all(_last(sweep) > 0.5 for sweep in sweeps),
            found=", ".join(f"{_last(sweep):.2f}" for sweep in sweeps),
            place="",
            wanted="above 0.5 in all",
        ),
    ]


def draw(study: Study) -> Figure:
    """Draw the three panels."""
    return panels.draw_ratios(
        study.once(shared.sweeps),
        raw=lambda sweep: sweep.contrast,
        corrected=lambda sweep: sweep.corrected_contrast,
        label="$C$, $C_t$ [1]",
        names=("$C$", "$C_t$"),
        level=0.0,
        logarithmic=False,
    )


def _last(sweep: shared.Sweep) -> float:
    return float(np.mean(sweep.corrected_contrast[-len(sweep.frequency) // 10 :]))
