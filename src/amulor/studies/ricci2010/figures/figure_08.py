"""Figure 8 of Ricci et al. 2010: signal over water signal against frequency."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from amulor.studies.ricci2010.figures import panels
from amulor.studies.ricci2010.results import Check, holds, within
from amulor.studies.ricci2010.scenes import interference_sweeps as shared
from amulor.studies.ricci2010.study import Study

TITLE = "Signal-to-optical-noise ratio against modulation frequency"
CAPTION = (
    "Signal over water signal, SNR (filled, synthetic measurement), and echo over "
    "water signal, SNR_t (open, after open-water subtraction), of the sweeps of "
    "figure 7: (a) to (c) experiments 1 to 3. Below the line at 1 the water alone "
    "would be brighter. It is not certain which of figures 8 and 9 shows the ratio "
    "and which the contrast."
)


def checks(study: Study) -> list[Check]:
    """Return what the text says of the figure, and what was found."""
    sweeps = study.once(shared.sweeps)
    return [
        *[
            panels.same_extrema(
                sweep, np.log(sweep.ratio), "signal-to-optical-noise ratio"
            )
            for sweep in sweeps[1:]
        ],
        panels.almost_monotonic(
            sweeps[0], np.log(sweeps[0].ratio), "logarithm of the ratio"
        ),
        *[
            panels.grows(sweep, sweep.ratio, "signal-to-optical-noise ratio")
            for sweep in sweeps
        ],
        _goes_together(sweeps),
        within(
            "the echo is weaker than the water signal somewhere (least SNR_t)",
            min(float(sweep.corrected_ratio.min()) for sweep in sweeps),
            -np.inf,
            1.0,
            place="section 8, after figure 9",
        ),
        within(
            "correction takes the oscillation out of the ratio: turns left in SNR_t of "
            "experiments 2 and 3 that are 10 % deep",
            float(
                sum(
                    panels.turns(s, np.log(s.corrected_ratio), depth=0.1)
                    for s in sweeps[1:]
                )
            ),
            -np.inf,
            0,
            place=panels.RATIO_PLACE,
        ),
    ]


def draw(study: Study) -> Figure:
    """Draw the three panels."""
    return panels.draw_ratios(
        study.once(shared.sweeps),
        raw=lambda sweep: sweep.ratio,
        corrected=lambda sweep: sweep.corrected_ratio,
        label="SNR, SNR$_t$ [1]",
        names=("SNR", "SNR$_t$"),
        level=1.0,
        logarithmic=True,
    )


def _goes_together(sweeps: tuple[shared.Sweep, ...]) -> Check:
    below = [int((sweep.ratio < 1).sum()) for sweep in sweeps]
    same = all(
        bool(np.array_equal(sweep.ratio < 1, sweep.contrast < 0)) for sweep in sweeps
    )
    return holds(
        "ratio below 1 goes with contrast below 0: at some frequencies of experiments "
        "2 and 3, at none of experiment 1",
        same and below[0] == 0 and below[1] > 0 and below[2] > 0,
        found=f"{below[0]}, {below[1]}, {below[2]} of {len(sweeps[0].frequency)}"
        + (" frequencies" if same else " frequencies, not the same ones"),
        place="section 8, after figure 9",
        wanted="0, some, some; the same ones",
    )
