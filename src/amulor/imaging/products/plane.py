"""The plane that a drawing is projected on: an elevation or a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from amulor.imaging.frame import Frame

Floats = NDArray[np.float64]
Side = Literal["front", "top"]


@dataclass(frozen=True, kw_only=True)
class Plane:
    """Axes of a drawing in a frame."""

    side: Side
    """From where it is seen."""
    axes: Floats
    """Right, up and towards the viewer, one a row, shape (3, 3) [1]."""
    names: tuple[str, str, str]
    """What the three coordinates of a drawing are called."""


def plane_of(frame: Frame, side: Side = "front") -> Plane:
    """Return the plane of an elevation or a plan.

    Parameters
    ----------
    frame : Frame
        Frame of the points.
    side : str
        "front": the elevation that the instrument sees; with a pose, level and towards
        its heading. "top": the plan, from above.

    Returns
    -------
    Plane
        Its axes; heights are counted towards the viewer from the frame's origin.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> surface = imaging.products.surface(image)
    >>> imaging.products.plane_of(surface.frame).names
    ('right', 'up', 'nearer')
    """
    if side == "top":
        if frame.name == "instrument":
            rows = [(1, 0, 0), (0, 0, 1), (0, -1, 0)]
            return _plane(side, rows, ("right", "forward", "up"))
        rows = [(1, 0, 0), (0, 1, 0), (0, 0, 1)]
        names = ("east", "north", "up") if frame.name == "pose" else ("x", "y", "z")
        return _plane(side, rows, names)
    names = ("right", "up", "nearer")
    if frame.name == "instrument":
        return _plane(side, [(1, 0, 0), (0, -1, 0), (0, 0, -1)], names)
    heading = 0.0 if frame.pose is None else frame.pose.heading
    right = (np.cos(heading), -np.sin(heading), 0.0)
    nearer = (-np.sin(heading), -np.cos(heading), 0.0)
    return _plane(side, [right, (0, 0, 1), nearer], names)


def _plane(
    side: Side, rows: Sequence[tuple[float, float, float]], names: tuple[str, str, str]
) -> Plane:
    return Plane(side=side, axes=np.array(rows, dtype=float), names=names)
