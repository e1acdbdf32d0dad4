"""What the figures of the study share: lettered panels, the mark of synthetic data."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import wraps

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from amulor.studies.ricci2010.study import Study
from amulor.view.style import style

#: Put where a paper would say "measured".
SYNTHETIC = "synthetic measurement"
#: Width of a figure over both columns, and over one [inch].
WIDE, NARROW = 7.2, 3.6


def styled(draw: Callable[[Study], Figure]) -> Callable[[Study], Figure]:
    """Return a function that draws with the settings of amulor."""

    @wraps(draw)
    def drawn(study: Study) -> Figure:
        with style():
            return draw(study)

    return drawn


def letter(axes: Iterable[Axes], titles: Iterable[str]) -> None:
    """Name panels (a), (b), ... as in the paper, with a short title each."""
    for number, (axis, title) in enumerate(zip(axes, titles, strict=True)):
        axis.set_title(f"({chr(ord('a') + number)}) {title}")


def mark_synthetic(figure: Figure) -> None:
    """Say at the foot of a figure that its measurements are simulated."""
    figure.supxlabel(
        "Measured series are synthetic: simulated, with the noise that the study says.",
        fontsize=6,
        color="#555555",
        x=0.995,
        ha="right",
    )
