"""What a line drawing holds, whichever format it is written in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.errors import FormatError

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Line:
    """One polyline of a drawing."""

    points: Floats
    """Right and up, shape (n, 2) [m]."""
    layer: str
    """What it belongs to, such as "contours"."""
    label: str = ""
    """What it is, such as its height."""
    elevation: float = 0.0
    """Height above the drawing plane [m]."""
    band: Floats | None = None
    """Standard uncertainty across the line at its points, drawn as a band twice as
    wide to either side; none if left out, shape (n,) [m]."""


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """Polylines with what is to be said of them."""

    title: str
    """What is drawn."""
    lines: tuple[Line, ...]
    """At least one."""
    axes: tuple[str, str]
    """What right and up are called."""
    statements: tuple[str, ...] = ()
    """Frame, errors and provenance, one statement each."""

    @property
    def limits(self) -> tuple[float, float, float, float]:
        """Left, right, lower and upper end of all lines [m]."""
        points = np.concatenate([line.points for line in self.lines])
        (left, low), (right, high) = points.min(axis=0), points.max(axis=0)
        return float(left), float(right), float(low), float(high)

    @property
    def layers(self) -> tuple[str, ...]:
        """Names of the layers, in order."""
        return tuple(dict.fromkeys(line.layer for line in self.lines))


def checked(drawing: Drawing, *, name: str) -> Drawing:
    """Return a drawing that has lines with finite points, or raise.

    Parameters
    ----------
    drawing : Drawing
        What is to be written.
    name : str
        How a message calls it.

    Returns
    -------
    Drawing
        The same.

    Raises
    ------
    FormatError
        If it has no line, or a point that is not finite.
    """
    if not drawing.lines:
        raise FormatError(f"{name}: there is no line to draw")
    for line in drawing.lines:
        if not np.isfinite(line.points).all():
            raise FormatError(f"{name}: a line of layer {line.layer} is not finite")
    return drawing


def sides(line: Line) -> Floats | None:
    """Return the outline of the band of a line, two standard uncertainties wide.

    Parameters
    ----------
    line : Line
        With or without a band.

    Returns
    -------
    ndarray, shape (2 n, 2), or None
        Along one side and back along the other [m].
    """
    if line.band is None or len(line.points) < 2:
        return None
    step = np.gradient(line.points, axis=0)
    length = np.linalg.norm(step, axis=1, keepdims=True)
    unit = step / np.where(length > 0, length, 1.0)
    across = np.stack([-unit[:, 1], unit[:, 0]], axis=1) * 2 * line.band[:, None]
    return np.concatenate([line.points + across, (line.points - across)[::-1]])
