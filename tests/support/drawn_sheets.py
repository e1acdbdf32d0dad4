"""Rasters and lines of sheets for tests, and the places of axes on paper."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
from matplotlib.axes import Axes

from amulor.imaging.products import Raster
from amulor.io.drawings import Drawing, Line

#: Height of a title block without statements: title, two rows of fields, scale bar
#: [mm].
EMPTY_BLOCK = 9 + 2 * 8.5 + 16 + 3


def raster_of(height: np.ndarray, **values: object) -> Raster:
    """Raster with cells of 2 mm, whose upper left corner is at 0.1 and 0.4 m."""
    stated = {
        "uncertainty": np.full(height.shape, 1e-3), "own": np.zeros(height.shape),
        "amplitude": np.full(height.shape, 0.2), "cell": 0.002, "left": 0.1,
        "top": 0.4, "plane": SimpleNamespace(names=("right", "up", "nearer")),
        "surface": SimpleNamespace(spacing=0.002), "layers": {}, **values,
    }  # fmt: skip
    return Raster(height=height, **stated)


def step() -> Drawing:
    """One line from (0, 1) to (0.1, 1.04) m."""
    points = np.array([[0.0, 1.0], [0.02, 1.03], [0.1, 1.04]])
    return Drawing(
        title="Step", lines=(Line(points=points, layer="section"),),
        axes=("along", "up"),
    )  # fmt: skip


def on_paper(axis: Axes) -> np.ndarray:
    """Left, lower, right and upper edge of plot axes on their sheet [mm]."""
    figure = axis.get_figure(root=True)
    assert figure is not None
    return axis.get_position().extents * np.tile(figure.get_size_inches(), 2) * 25.4
