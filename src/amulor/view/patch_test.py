"""Figure of a patch test: distances between lines, uncertainties of the mounting."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from amulor.imaging.patch_test import QUANTITIES, PatchTest
from amulor.io.files import atomic_output
from amulor.view.style import COLOURS, ERROR_MAP, new_figure, style


def write_patch_test(path: Path, result: PatchTest, *, overwrite: bool = False) -> None:
    """Write the figure of a patch test as PNG."""
    with style(), atomic_output(path, overwrite=overwrite) as temporary:
        draw(result).savefig(temporary, format="png", dpi=160)


def draw(result: PatchTest) -> Figure:
    """Draw the distances between lines before and after, and the uncertainties."""
    with style():
        figure = new_figure(7.4, 2.8)
        grid = figure.add_gridspec(1, 3, width_ratios=(1, 1, 0.9))
        first = figure.add_subplot(grid[0])
        axes = [first, figure.add_subplot(grid[1], sharex=first, sharey=first)]
        parts = {"Before": result.before, "After": result.after}
        for axis, (name, (place, apart)) in zip(axes, parts.items(), strict=True):
            _draw_map(figure, axis, f"{name}: median {1e3 * np.median(apart):.2g} mm",
                      place, 1e3 * apart)  # fmt: skip
        axes[0].set_ylabel("north [m]")
        _draw_uncertainties(figure.add_subplot(grid[2]), result)
    return figure


def _draw_map(
    figure: Figure, axis: Axes, title: str, place: np.ndarray, apart: np.ndarray
) -> None:
    """Draw the rms distance of the lines at each patch, in plan."""
    points = axis.scatter(
        place[:, 0], place[:, 1], c=apart, s=7, cmap=ERROR_MAP, marker="s",
        vmin=0, vmax=float(np.quantile(apart, 0.95)), linewidths=0,
    )  # fmt: skip
    axis.set_title(title)
    axis.set_aspect("equal")
    axis.set_xlabel("east [m]")
    figure.colorbar(
        points, ax=axis, label="rms distance of lines [mm]", location="bottom",
        extend="max",
    )  # fmt: skip


def _draw_uncertainties(axis: Axes, result: PatchTest) -> None:
    """Draw the uncertainties as shares of those before the test."""
    used = result.start_uncertainty > 0
    share = 100 * result.uncertainty[used] / result.start_uncertainty[used]
    names = [name for name, on in zip(QUANTITIES, used, strict=True) if on]
    loose = {entry.quantity for entry in result.undetermined}
    colors = [COLOURS[1] if name in loose else COLOURS[0] for name in names]
    place = np.arange(len(names))[::-1]
    axis.barh(place, share, color=colors, height=0.6)
    axis.set_yticks(place, [name.replace("boresight about", "about") for name in names])
    axis.axvline(50, color=COLOURS[6], lw=0.8, ls="--")
    axis.set_xscale("log")
    axis.set_xlim(min(1.0, 0.7 * share.min()), 120)
    axis.set_xlabel("uncertainty / before [%]")
    axis.set_title("Mounting")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.set_axisbelow(True)
    axis.grid(True, axis="x")
