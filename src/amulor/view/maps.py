"""Maps of a scan side by side, arranged to suit the shape of the scan."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from amulor.cube import UNUSABLE
from amulor.view.style import MISSING_COLOUR

Floats = NDArray[np.float64]

#: Good, doubtful and missing pixels; pixels without a range are gray in every map.
QUALITY = {"good": "#ffffff", "doubtful": "#E69F00", "no range": MISSING_COLOUR}

# Sizes [inch]: the whole figure, and what stands beside a map.
_WIDE, _TALLEST = 7.2, 7.6
_LEFT, _RIGHT, _ABOVE, _BELOW = 0.54, 0.72, 0.34, 0.40
#: Largest ratio of the sides of a map; more slender maps are drawn wider [1].
_SLENDER = 8.0
#: Fraction of the pixels on either side that limits may leave out [%].
_STRAY = 3.5


@dataclass(frozen=True, kw_only=True)
class Map:
    """Map of a scan, with title, colors and limits."""

    title: str
    """Title of the map."""
    values: Floats
    """Values, shape (row, column)."""
    label: str
    """Unit, for the color bar."""
    colours: str
    """Name of the color scale; "quality" for flags."""
    limits: tuple[float, float] | None = None
    """Limits of the color scale; by default insensitive to outliers."""


def draw_maps(maps: Sequence[tuple[xr.Dataset, Map]]) -> Figure:
    """Draw maps of scans side by side, as large as one page allows."""
    ratio = max(_ratio(cube) for cube, _ in maps)
    rows, columns, width, height = _layout(len(maps), ratio)
    total = rows * (height + _ABOVE + _BELOW) + 0.04
    figure = Figure(figsize=(_WIDE, total))
    room = _WIDE / columns
    for number, (cube, panel) in enumerate(maps):
        row, column = divmod(number, columns)
        left = column * room + _LEFT + (room - _LEFT - _RIGHT - width) / 2
        low = total - (row + 1) * (height + _ABOVE + _BELOW) + _BELOW
        box = (left / _WIDE, low / total, width / _WIDE, height / total)
        axis = figure.add_axes(box)
        bar = figure.add_axes(
            ((left + width + 0.06) / _WIDE, box[1], 0.08 / _WIDE, box[3])
        )
        _draw(axis, bar, cube, panel, (width, height))
        title = textwrap.wrap(panel.title, max(10, int((room - 0.2) * 12)))
        axis.set_title("\n".join(title[:2]))
    return figure


def quality_map(image: xr.Dataset) -> Map:
    """Map of good, doubtful and missing pixels."""
    flag = image["quality_flag"].values
    state = np.where(flag == 0, 0.0, np.where((flag & UNUSABLE) == 0, 1.0, 2.0))
    return Map(title="quality", values=state, label="", colours="quality")


def usual_limits(values: Floats, margin: float = 0.0) -> tuple[float, float]:
    """Limits of a color scale, insensitive to a few outliers."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = np.percentile(finite, [_STRAY, 100 - _STRAY])
    room = max(high - low, 1e-9)
    return float(low - margin * room), float(high + margin * room)


def _ratio(cube: xr.Dataset) -> float:
    """Height-to-width ratio of a scan [1], in angles if known, else in pixels."""
    azimuth, elevation = cube["azimuth"].values, cube["elevation"].values
    wide, high = float(np.ptp(azimuth)), float(np.ptp(elevation))
    if _flat(cube):
        high, wide = (float(n) for n in azimuth.shape)
    return float(np.clip(high / wide, 1 / _SLENDER, _SLENDER))


def _flat(cube: xr.Dataset) -> bool:
    azimuth, elevation = cube["azimuth"].values, cube["elevation"].values
    return bool(np.ptp(azimuth) == 0 or np.ptp(elevation) == 0)


def _layout(count: int, ratio: float) -> tuple[int, int, float, float]:
    """Rows and columns of maps on a page, and the largest width and height of a map."""
    best = (0.0, (1, 1, 1.0, 1.0))
    for columns in range(1, min(count, 4) + 1):
        rows = -(-count // columns)
        width = _WIDE / columns - _LEFT - _RIGHT
        height = min(width * ratio, _TALLEST / rows - _ABOVE - _BELOW)
        width = min(width, height / ratio)
        if rows > 1 and columns == 1 and ratio > 0.35:
            continue  # a page for each map is too much
        size = width * height * (1 if rows * columns == count else 0.7)
        best = max(best, (size, (rows, columns, width, height)))
    return best[1]


def _draw(
    axis: Axes, bar: Axes, cube: xr.Dataset, panel: Map, size: tuple[float, float]
) -> None:
    azimuth = np.degrees(cube["azimuth"].values)
    elevation = np.degrees(cube["elevation"].values)
    flat = _flat(cube)
    extent = (
        None
        if flat
        else (azimuth[0, 0], azimuth[0, -1], elevation[-1, 0], elevation[0, 0])
    )
    options: dict[str, Any] = {"extent": extent, "interpolation": "none"}
    if panel.colours == "quality":
        options["cmap"] = ListedColormap(list(QUALITY.values()))
        options["norm"] = BoundaryNorm([-0.5, 0.5, 1.5, 2.5], 3)
    else:
        low, high = panel.limits or usual_limits(panel.values)
        options["cmap"] = colormaps[panel.colours].with_extremes(bad=MISSING_COLOUR)
        options |= {"vmin": low, "vmax": high}
    picture = axis.imshow(panel.values, aspect="auto", **options)
    axis.set_xlabel("column" if flat else "azimuth [°]", labelpad=1)
    axis.set_ylabel("row" if flat else "elevation [°]", labelpad=1)
    axis.xaxis.set_major_locator(MaxNLocator(max(1, int(size[0] / 0.42)), integer=flat))
    axis.yaxis.set_major_locator(MaxNLocator(max(2, int(size[1] / 0.4)), integer=flat))
    assert axis.figure is not None
    colours = axis.figure.colorbar(picture, cax=bar)
    colours.outline.set_linewidth(0.4)
    if panel.colours == "quality":
        colours.set_ticks([0, 1, 2], labels=list(QUALITY))
        bar.tick_params(length=0)
        colours.minorticks_off()
    else:
        colours.set_label(panel.label, labelpad=1)
        colours.locator = MaxNLocator(max(2, int(size[1] / 0.4)))
        colours.update_ticks()
