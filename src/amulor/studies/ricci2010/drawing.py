"""What the figures of the study share: lettered panels, the mark of synthetic data."""

from __future__ import annotations

from collections.abc import Iterable

from matplotlib.axes import Axes
from matplotlib.figure import Figure

#: Put where a paper would say "measured".
SYNTHETIC = "synthetic measurement"
#: Width of a figure over both columns, and over one [inch].
WIDE, NARROW = 7.2, 3.6


def letter(axes: Iterable[Axes], titles: Iterable[str]) -> None:
    """Name panels (a), (b), ... as in the paper, with a short title each.

    Parameters
    ----------
    axes : iterable of matplotlib.axes.Axes
        Panels in order.
    titles : iterable of str
        What each shows.
    """
    for number, (axis, title) in enumerate(zip(axes, titles, strict=True)):
        axis.set_title(f"({chr(ord('a') + number)}) {title}")


def mark_synthetic(figure: Figure) -> None:
    """Say at the foot of a figure that its measurements are simulated.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Figure with a constrained layout.
    """
    figure.supxlabel(
        "Measured series are synthetic: simulated, with the noise that the study says.",
        fontsize=6,
        color="#555555",
        x=0.995,
        ha="right",
    )
