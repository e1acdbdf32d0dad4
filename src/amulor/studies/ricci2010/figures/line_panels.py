"""Panels of figures 10 to 12: two lines of one water, advance over the pixels."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator

from amulor.studies.ricci2010.figures.drawing import SYNTHETIC
from amulor.studies.ricci2010.scenes.milk_tank import PIXELS
from amulor.studies.ricci2010.scenes.short_lines import TURBIDITIES, corrected, line
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS

#: Colour of each pair.
COLOUR = {"VV": COLOURS[0], "VH": COLOURS[1], "RL": COLOURS[2], "RR": COLOURS[3]}


def panel(
    study: Study, axis: Axes, step: str, pairs: tuple[str, str], *, subtracted: bool
) -> None:
    """Draw two lines of one water."""
    pixel = np.arange(1, PIXELS + 1)
    for pair, filled in zip(pairs, (True, False), strict=True):
        result = line(study, step, pair)
        axis.plot(
            pixel,
            result.measured,
            "o" if filled else "s",
            color=COLOUR[pair],
            markersize=2.4,
            markerfacecolor=COLOUR[pair] if filled else "white",
            markeredgewidth=0.5,
            label=f"{pair}, {SYNTHETIC}",
            zorder=2,
        )
        axis.plot(
            pixel, result.phase, color="black", linewidth=0.8, zorder=3,
            label=None if filled else "model, without noise",
        )  # fmt: skip
    if subtracted:
        axis.plot(
            pixel,
            corrected(study, step, pairs[0]),
            "--",
            color="#555555",
            linewidth=0.8,
            label=f"{pairs[0]} less open water",
            zorder=3,
        )
    axis.set(xlim=(0, PIXELS + 1), xlabel="pixel", ylabel="phase advance [degree]")
    axis.xaxis.set_major_locator(FixedLocator([1, 20, 40, 60, 80]))
    axis.grid(axis="y")


def water_name(study: Study, step: str) -> str:
    """Return what a panel says of its water."""
    attenuation = study[TURBIDITIES[step]]
    thickness = attenuation * study["short_distance"]
    name = "tap water" if step == "tap" else "with milk"
    return f"{name}, {attenuation:.2f} 1/m (optical thickness {thickness:.2g})"
