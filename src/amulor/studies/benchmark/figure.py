"""Figure of the benchmark: error of each method in each scene."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from amulor.studies.benchmark.summary import best, by_scene, tallies
from amulor.studies.benchmark.table import Row
from amulor.view.style import ERROR_MAP, MISSING_COLOUR, new_figure, style

#: Largest error ratio of the color scale [1].
_LARGEST = 10.0


def figure(rows: Sequence[Row]) -> Figure:
    """Draw the errors relative to the best method of each scene."""
    table = by_scene(rows)
    methods = [tally.method for tally in tallies(rows)]
    ratio = np.full((len(table), len(methods)), np.nan)
    with style():
        drawn = new_figure(1.6 + 0.42 * len(methods) + 2.2, 1.6 + 0.17 * len(table))
        axes = drawn.subplots()
        for height, results in enumerate(table.values()):
            winner = best(results)
            for place, method in enumerate(methods):
                row = results.get(method)
                if row is None:
                    axes.plot(place, height, "s", color=MISSING_COLOUR, markersize=4)
                elif not row.holds:
                    axes.plot(place, height, "x", color="#D55E00", markersize=5)
                elif row.compared and winner is not None:
                    ratio[height, place] = row.error / results[winner].error
        mesh = axes.imshow(
            ratio,
            cmap=ERROR_MAP,
            norm=LogNorm(1.0, _LARGEST, clip=True),
            aspect="auto",
        )
        for height, place in zip(*np.nonzero(np.isfinite(ratio)), strict=True):
            value = ratio[height, place]
            axes.text(
                place,
                height,
                f"{value:.0f}" if value >= _LARGEST else f"{value:.1f}",
                ha="center",
                va="center",
                fontsize=5.5,
                color="white" if value < 3 else "black",
            )
        axes.set_xticks(range(len(methods)), methods, rotation=60, ha="right")
        axes.set_yticks(range(len(table)), list(table))
        axes.tick_params(length=0)
        bar = drawn.colorbar(mesh, label="error / smallest error", aspect=40)
        bar.set_ticks([1, 2, 5, 10], labels=["1", "2", "5", "10"])
        bar.minorticks_off()
    return drawn
