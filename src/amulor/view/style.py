"""Common style of all figures: fonts, and colors for color-blind readers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
from cycler import cycler
from matplotlib.figure import Figure

#: Okabe and Ito's colors, in the order in which lines take them.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
#: One color map per quantity, in every figure, sheet and page: distances, brightness,
#: signed differences, and uncertainties.
DISTANCE_MAP, BRIGHTNESS_MAP, DIFFERENCE_MAP = "viridis", "gray", "RdBu_r"
ERROR_MAP = "cividis"
#: Pixels without a value.
MISSING_COLOUR = "#d9d9d9"

SETTINGS: Any = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans"],
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.prop_cycle": cycler(color=COLOURS),
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 7,
    "lines.linewidth": 1.0,
    "grid.color": "#dfe5e8",
    "grid.linewidth": 0.5,
    **{f"axes3d.{axis}axis.panecolor": (0.97, 0.98, 0.98, 1.0) for axis in "xyz"},
    "svg.hashsalt": "amulor",
    "svg.fonttype": "none",
    # TrueType, which printers and editors keep as letters.
    "pdf.fonttype": 42,
}


@contextmanager
def style() -> Iterator[None]:
    """Apply amulor's figure style inside a `with` block, and only there."""
    with matplotlib.rc_context(rc=SETTINGS):
        yield


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure that does not open a window."""
    return Figure(figsize=(width, height), layout="constrained")
