"""Drawing sheets of rasters and lines, to scale, on ISO 216 paper."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LightSource, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Patch, Rectangle
from matplotlib.text import Annotation
from matplotlib.transforms import Bbox
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from amulor.errors import CubeError, FormatError
from amulor.imaging.products import Contour, Raster
from amulor.io.drawings import (
    FIELDS,
    Drawing,
    TitleBlock,
    grid_step,
    places_between,
    rounded_up,
    sides,
)
from amulor.view.style import (
    BRIGHTNESS_MAP,
    COLOURS,
    DIFFERENCE_MAP,
    DISTANCE_MAP,
    ERROR_MAP,
    style,
)

Floats = NDArray[np.float64]
Shown = Literal["amplitude", "height", "relief", "uncertainty", "deviation"]

#: ISO 216 sheets, short and long side [mm].
_SHEETS = {
    "A4": (210, 297),
    "A3": (297, 420),
    "A2": (420, 594),
    "A1": (594, 841),
    "A0": (841, 1189),
}
# Border of the sheet, and room for numbers beside the picture [mm].
_BORDER, _TICKS = 10.0, 16.0
# Rows of the title block: title, one row of fields, scale bars, or a key plan [mm].
_TITLE, _FIELD, _BARS, _KEY = 9.0, 8.5, 16.0, 30.0
#: Size of small letters [pt], their mean width, and the distance of two lines [mm].
_LETTERS, _LETTER, _LINE = 7.0, 1.34, 3.1
_INCH = 25.4
#: Room around a drawing inside its frame, on paper [m].
_ROOM = 3e-3
#: Least distance of coordinates that are written upwards, on paper [m].
_UPRIGHT = 8e-3
# Color of a surface without a value to show: #e2e2e2.
_GREY = (226, 226, 226, 255)
#: Part of the cells that limits of colors may leave out on either side [%].
_STRAY = 1.0
#: Least distance of two heights of contours, and least size of their lines, on paper
#: [m].
_APART = 9e-3
#: Contours, and other lines over a picture.
_OVER = "#D55E00"
_COLOURS = {
    "amplitude": BRIGHTNESS_MAP,
    "height": DISTANCE_MAP,
    "relief": BRIGHTNESS_MAP,
    "uncertainty": ERROR_MAP,
    "deviation": DIFFERENCE_MAP,
}


@dataclass(frozen=True, kw_only=True)
class Station:
    """Position of an instrument with its error ellipse."""

    position: Floats
    """Right and up in the drawing, shape (2,) [m]."""
    covariance: Floats
    """Covariance of the position, shape (2, 2) [m^2]."""
    colour: str
    """Color of visit or scan."""


@dataclass(frozen=True, kw_only=True)
class Annotations:
    """Outlines, stations, targets and section lines over a plan."""

    outlines: Sequence[tuple[str, Sequence[Floats]]] = ()
    """Color, and polygons of the area of a scan, of shape (n, 2) [m]."""
    stations: Mapping[str, Station] = field(default_factory=dict)
    """Instruments by name of the scan."""
    enlarged: float = 1.0
    """Factor by which the error ellipses are enlarged [1]."""
    targets: Mapping[str, Floats] = field(default_factory=dict)
    """Targets by name, shape (2,) [m]."""
    cuts: Mapping[str, Floats] = field(default_factory=dict)
    """Ends of section lines by letter, shape (2, 2) [m]."""
    details: Mapping[str, tuple[float, float, float, float]] = field(
        default_factory=dict
    )
    """West, east, south and north bound of detail sheets by number [m]."""


def error_ellipse(
    position: ArrayLike, covariance: Floats, *, factor: float, colour: str
) -> Ellipse:
    """Return the ellipse of one standard uncertainty, enlarged by a factor."""
    x, y = np.asarray(position, dtype=float)
    values, vectors = np.linalg.eigh(covariance)
    wide, high = 2 * factor * np.sqrt(np.maximum(values[::-1], 0))
    angle = float(np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1])))
    return Ellipse((x, y), wide, high, angle=angle, fill=False, edgecolor=colour)


def fitting_scale(wide: float, high: float, *, paper: str = "A4") -> float:
    """Return the largest usual scale at which an object fits a sheet of paper.

    Parameters
    ----------
    wide, high : float
        Size of the object in the drawing [m].
    paper : str
        ISO 216 size, "A4" to "A0"; the sheet is upright or lying.

    Returns
    -------
    float
        Scale denominator of the series 1, 2, 5, 10, 20, ... [1].

    Examples
    --------
    >>> fitting_scale(0.3, 0.25)
    2.0
    >>> fitting_scale(4.8, 5.5, paper="A4"), fitting_scale(4.8, 5.5, paper="A3")
    (50.0, 20.0)
    """
    short, long = _SHEETS[paper]
    # Border, coordinates, and a title block of usual size.
    beside, below = 42.0, 132.0
    room = ((short - beside, long - below), (long - beside, short - below))
    needed = min(max(wide * 1e3 / w, high * 1e3 / h) for w, h in room)
    return rounded_up(max(needed, 1.0))


def largest_on_a3() -> tuple[float, float]:
    """Largest width and height of a raster as printed on landscape A3 [m]."""
    high, wide = _SHEETS["A3"]
    # A title block of fifteen lines.
    below = _block_height(15, _BARS) + 2 * _BORDER + _TICKS
    room = 2e3 * _ROOM
    return (wide - 2 * _BORDER - _TICKS - room) / 1e3, (high - below - room) / 1e3


def colours_of(
    raster: Raster, show: Shown, *, values: Floats | None = None
) -> tuple[NDArray[np.uint8], tuple[float, float], str]:
    """Pixel colors of a raster, with the limits and the unit of the color scale."""
    if show == "relief":
        return relief(raster), (0.0, 1.0), ""
    unit = "mV" if show == "amplitude" else "mm"
    values_shown = {
        "amplitude": raster.amplitude,
        "height": raster.height,
        "uncertainty": _of_pixels(raster),
        "deviation": values,
    }[show]
    if values_shown is None:
        raise ValueError("deviations are needed to be shown")
    values_shown = values_shown * 1e3
    finite = values_shown[np.isfinite(values_shown)]
    if not finite.size:
        raise CubeError(
            f"the {show} of no cell is known; show another quantity, or look at the "
            "flags of the range image with amulor info"
        )
    low, high = (float(v) for v in np.percentile(finite, [_STRAY, 100 - _STRAY]))
    if show == "deviation":
        high = max(abs(low), abs(high))
        low = -high
    if not high > low:
        low, high = low - 0.5, low + 0.5
    pixels = colormaps[_COLOURS[show]](
        Normalize(low, high, clip=True)(values_shown), bytes=True
    )
    pixels = np.array(pixels, dtype=np.uint8)
    pixels[~np.isfinite(values_shown)] = 0
    if show == "deviation":
        pixels[np.isfinite(raster.height) & ~np.isfinite(values_shown)] = _GREY
    return pixels, (low, high), unit


def _of_pixels(raster: Raster) -> Floats:
    """Largest height uncertainty [m] around each cell, within one scan pixel.

    Between pixels a cell is their mean, whose noise is smaller. Without the maximum,
    the map would show the grid of pixels instead of the uncertainty.
    """
    size = 2 * math.ceil(raster.surface.spacing / raster.cell / 2) + 1
    known = np.isfinite(raster.uncertainty)
    largest = ndimage.maximum_filter(np.where(known, raster.uncertainty, 0.0), size)
    return np.where(known, largest, np.nan)


def sheet(
    raster: Raster,
    content: TitleBlock,
    *,
    scale: float,
    show: Shown,
    values: Floats | None = None,
    contours: Sequence[Contour] = (),
    annotations: Annotations | None = None,
    legend: Sequence[tuple[str, str, str]] = (),
) -> Figure:
    """Draw a raster to scale, on the smallest ISO sheet that fits it."""
    pixels, limits, unit = colours_of(raster, show, values=values)
    extent = extent_of(raster)
    room = _ROOM * scale
    around = _around(extent, annotations, room)
    with style():
        paper = _Paper(around, content, scale=scale)
        axis = paper.axis
        axis.imshow(pixels, extent=extent, interpolation="none", aspect="auto")
        axis.set_xlim(around[:2])
        axis.set_ylim(around[2:])
        _contour_lines(axis, contours, scale)
        doubtful = raster.layers.get("doubtful")
        hatched = doubtful is not None and bool((np.nan_to_num(doubtful) > 0).any())
        if doubtful is not None and hatched:
            axis.contourf(
                raster.columns, raster.rows, np.nan_to_num(doubtful),
                levels=[1e-9, 2.0], colors="none", hatches=["////"],
            )  # fmt: skip
        paper.grid(raster.plane.names[:2])
        if annotations is not None:
            annotate(axis, annotations)
        entries = [("#ffffff", "", "no surface measured")]
        if hatched:
            entries.append(("#ffffff", "//////", "doubtful pixels"))
        if show == "deviation":
            entries.append(("#e2e2e2", "", "not significant, or not compared"))
        paper.block([*entries, *legend], arrow=raster.plane.names[1])
        if unit:
            paper.colour_bar(show, limits, unit)
    return paper.figure


def _around(
    extent: tuple[float, float, float, float],
    annotations: Annotations | None,
    room: float,
) -> tuple[float, float, float, float]:
    """Extent with room for stations and for the letters of section lines [m]."""
    corners = [np.array([extent[0], extent[2]]), np.array([extent[1], extent[3]])]
    if annotations is not None:
        corners += [station.position for station in annotations.stations.values()]
        # Letters stand beyond the ends.
        for ends in annotations.cuts.values():
            beyond = room * (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            corners += [ends[0] - beyond, ends[1] + beyond]
    low, high = np.min(corners, axis=0) - room, np.max(corners, axis=0) + room
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def extent_of(raster: Raster) -> tuple[float, float, float, float]:
    """Left, right, lower and upper edge of a raster in its drawing plane [m]."""
    rows, columns = raster.height.shape
    right = raster.left + columns * raster.cell
    return raster.left, right, raster.top - rows * raster.cell, raster.top


def line_sheet(
    drawing: Drawing,
    *,
    scale: float,
    heights: float = 1.0,
    key: tuple[Raster, Floats] | None = None,
    picture: Raster | None = None,
    colours: Mapping[str, str] | None = None,
) -> Figure:
    """Draw polylines to scale, on the smallest ISO sheet that fits them.

    Parameters
    ----------
    drawing : Drawing
        Polylines with layers, labels and uncertainty bands, and title block.
    scale : float
        Scale denominator; 20 for 1:20 [1].
    heights : float
        Exaggeration of the upward axis [1].
    key : tuple of Raster and array_like, optional
        View for a key plan, and the ends of the section line in it, shape (2, 2) [m].
    picture : Raster, optional
        Shaded relief drawn at the right of the upward axis, under the lines.
    colours : mapping of str to str, optional
        Colors of the layers, which the legend then names.

    Returns
    -------
    matplotlib.figure.Figure
        Sheet in the size of its paper.
    """
    left, right, low, high = drawing.limits
    room = _ROOM * scale
    extent = (left, right, low - room / heights, high + room / heights)
    with style():
        bars = _BARS if key is None else _KEY
        paper = _Paper(extent, drawing, scale=scale, heights=heights, bars=bars)
        axis = paper.axis
        if picture is not None:
            pixels = relief(picture)
            pixels[:, picture.columns < 0] = 0
            axis.imshow(pixels, extent=extent_of(picture), aspect="auto")
            axis.set_xlim(extent[:2])
            axis.set_ylim(extent[2:])
        bands = [
            outline for line in drawing.lines if (outline := sides(line)) is not None
        ]
        if bands:
            axis.add_collection(
                PolyCollection(
                    bands, facecolors="#56B4E9", alpha=0.45, gid="uncertainty", lw=0
                )
            )
        palette = ("#000000", *COLOURS)
        chosen = {
            layer: palette[number % 8] for number, layer in enumerate(drawing.layers)
        } | dict(colours or {})
        for layer in drawing.layers:
            lines = [line for line in drawing.lines if line.layer == layer]
            axis.add_collection(
                LineCollection(
                    [line.points for line in lines],
                    colors=chosen[layer],
                    linewidths=0.7,
                    gid=layer,
                )
            )
            for line in lines:
                if line.label:
                    _label(axis, line.points, line.label)
        paper.grid(drawing.axes)
        for place, name in drawing.marks:
            axis.annotate(
                name, (place, 1.0), xycoords=("data", "axes fraction"), xytext=(0, 3),
                textcoords="offset points", ha="center", fontsize=10, weight="bold",
            )  # fmt: skip
        legend = [("#56B4E9", "", "± 2 standard uncertainties")] if bands else []
        if colours is not None:
            legend += [(chosen[layer], "", layer) for layer in drawing.layers]
        paper.block(legend, arrow=drawing.axes[1])
        if key is not None:
            name = drawing.marks[0][1] if drawing.marks else "A"
            paper.key_plan(*key, letter=name)
    return paper.figure


class _Paper:
    """Figure of an ISO sheet, with plot axes to scale above a title block."""

    def __init__(
        self,
        extent: tuple[float, float, float, float],
        content: TitleBlock,
        *,
        scale: float,
        heights: float = 1.0,
        bars: float = _BARS,
    ) -> None:
        left, right, low, high = extent
        self.content, self.scale = content, scale
        wide = (right - left) / scale * 1e3
        tall = (high - low) * heights / scale * 1e3
        self.name, self.width, self.height, self.lines = _paper(
            wide, tall, content.statements, scale, bars
        )
        self.bars = bars
        self.figure = Figure(figsize=(self.width / _INCH, self.height / _INCH))
        self.below = _BORDER + _block_height(len(self.lines), bars)
        room = self.height - _BORDER - self.below - _TICKS
        x = _TICKS + _BORDER + (self.width - 2 * _BORDER - _TICKS - wide) / 2
        y = self.below + _TICKS + (room - tall) / 2
        self.axis = self._axes(x, y, wide, tall)
        self.axis.set_xlim(left, right)
        self.axis.set_ylim(low, high)
        self.heights = heights

    def _axes(self, x: float, y: float, wide: float, high: float) -> Axes:
        """Add plot axes at a position on the sheet [mm]."""
        w, h = self.width, self.height
        return self.figure.add_axes((x / w, y / h, wide / w, high / h))

    def grid(self, names: Sequence[str]) -> None:
        """Draw grid lines with coordinates, 20 to 50 mm apart on paper."""
        axis, scale = self.axis, self.scale
        for which, factor in (("x", 1.0), ("y", self.heights)):
            low, high = getattr(axis, f"get_{which}lim")()
            step = grid_step(low, high, scale / factor)
            if which == "y":
                # Letters along a small step would meet.
                wide = step * factor / scale > _UPRIGHT
                axis.tick_params(axis="y", rotation=90 if wide else 0)
            digits = max(0, int(np.ceil(-np.log10(step))))
            places = places_between(low, high, step)
            getattr(axis, f"set_{which}ticks")(
                places, [f"{place + 0.0:.{digits}f}" for place in places]
            )
        axis.grid(color="#56B4E9", lw=0.25, alpha=0.8)
        axis.set_axisbelow(False)
        axis.tick_params(labelsize=_LETTERS, length=2, width=0.3)
        for label in axis.get_yticklabels():
            label.set_verticalalignment("center")
        axis.set_xlabel(f"{names[0]} [m]", fontsize=_LETTERS)
        axis.set_ylabel(f"{names[1]} [m]", fontsize=_LETTERS)
        for spine in axis.spines.values():
            spine.set_visible(True)
            spine.set_linewidth(0.3)

    def block(self, legend: Sequence[tuple[str, str, str]], *, arrow: str) -> None:
        """Draw the title block: title, fields, scale bar, legend and statements."""
        content, width = self.content, self.width
        frame = self._axes(0, 0, width, self.below)
        frame.set_xlim(0, width)
        frame.set_ylim(0, self.below)
        frame.axis("off")
        top, right = self.below, width - _BORDER
        frame.add_patch(
            Rectangle(
                (_BORDER, _BORDER), right - _BORDER, top - _BORDER, fill=False, lw=0.5
            )
        )
        words = textwrap.shorten(content.title, int(width / 3), placeholder=" ...")
        bold: Any = {"fontsize": 10, "weight": "bold", "va": "center"}
        frame.text(_BORDER + 3, top - _TITLE / 2, words, **bold)
        exaggerated = f", heights x {self.heights:g}" if self.heights != 1 else ""
        frame.text(
            right - 3,
            top - _TITLE / 2,
            f"1:{self.scale:g} on {self.name}{exaggerated}",
            ha="right",
            **bold,
        )
        self._fields(frame, top - _TITLE)
        y = top - _TITLE - 2 * _FIELD
        frame.plot([_BORDER, right], [y, y], color="#000000", lw=0.3)
        _scale_bar(frame, self.scale, (_BORDER + 6, y - 7))
        x = _BORDER + 66.0
        frame.annotate(
            "", (x, y - 2.5), (x, y - 11), arrowprops={"arrowstyle": "-|>", "lw": 0.8}
        )
        frame.text(x, y - 11.8, arrow, fontsize=_LETTERS, ha="center", va="top")
        for number, (colour, hatch, text) in enumerate(legend):
            at = x + 10 + 46 * (number // 3), y - 4.8 - 4.5 * (number % 3)
            frame.add_patch(
                Rectangle(
                    at,
                    4,
                    2.6,
                    facecolor=colour,
                    hatch=hatch,
                    edgecolor="#000000",
                    lw=0.3,
                )
            )
            frame.text(at[0] + 5.5, at[1] + 1.3, text, fontsize=_LETTERS, va="center")
        frame.text(
            _BORDER + 3,
            y - self.bars,
            "\n".join(self.lines),
            fontsize=_LETTERS,
            va="top",
            linespacing=_LINE / (_LETTERS * _INCH / 72),
        )

    def _fields(self, frame: Axes, top: float) -> None:
        """Draw the fields of the title block in two rows of four cells."""
        cell = (self.width - 2 * _BORDER) / 4
        for number, name in enumerate(FIELDS):
            row, column = divmod(number, 4)
            x, y = _BORDER + column * cell, top - row * _FIELD
            frame.add_patch(
                Rectangle((x, y - _FIELD), cell, _FIELD, fill=False, lw=0.3)
            )
            frame.text(
                x + 1.5, y - 1, name, fontsize=_LETTERS, va="top", color="#555555"
            )
            text = textwrap.shorten(
                self.content.fields.get(name, ""),
                int(cell / _LETTER) - 2,
                placeholder=" ...",
            )
            frame.text(x + 1.5, y - _FIELD + 1.2, text, fontsize=_LETTERS)

    def colour_bar(self, show: Shown, limits: tuple[float, float], unit: str) -> None:
        """Draw the color scale at the right of the title block."""
        long = 50.0
        y = self.below - _TITLE - 2 * _FIELD - 8.5
        axis: Any = self._axes(self.width - _BORDER - 6 - long, y, long, 2.4)
        axis.imshow(
            np.linspace(0, 1, 256)[None],
            aspect="auto",
            cmap=_COLOURS[show],
            extent=(limits[0], limits[1], 0, 1),
        )
        axis.set_yticks([])
        axis.locator_params(axis="x", nbins=4)
        axis.tick_params(labelsize=_LETTERS, length=1.5, width=0.3, pad=1)
        axis.set_title(
            f"{show} [{unit}]", fontsize=_LETTERS, loc="right", pad=2, weight="normal"
        )

    def key_plan(self, raster: Raster, cut: Floats, *, letter: str) -> None:
        """Draw a small view with the section line at the right of the title block."""
        rows, columns = raster.height.shape
        size = min((_KEY - 12) / rows, 45.0 / columns)
        wide, high = columns * size, rows * size
        x = self.width - _BORDER - wide - 10
        y = self.below - _TITLE - 2 * _FIELD - high - 8
        axis = self._axes(x, y, wide, high)
        axis.imshow(relief(raster), extent=extent_of(raster), aspect="auto")
        axis.plot(*cut.T, color=_OVER, lw=1.0, clip_on=False)
        onward = 6 * (cut[1] - cut[0]) / np.linalg.norm(cut[1] - cut[0])
        names = letter, f"{letter}'"
        for place, name, shift in zip(cut, names, (-onward, onward), strict=True):
            axis.annotate(
                name, (float(place[0]), float(place[1])), xytext=tuple(shift),
                textcoords="offset points", ha="center", va="center",
                fontsize=_LETTERS, annotation_clip=False,
            )  # fmt: skip
        axis.set_xticks([])
        axis.set_yticks([])
        axis.spines[["top", "right"]].set_visible(True)
        axis.set_title("section line", fontsize=_LETTERS, weight="normal", pad=10)


def _paper(
    wide: float, high: float, statements: Sequence[str], scale: float, bars: float
) -> tuple[str, float, float, list[str]]:
    """Name, width, height and lines of text of the smallest sheet that fits [mm]."""
    for name, (short, long) in _SHEETS.items():
        for width, height in ((long, short), (short, long)):
            lines = _wrapped(statements, width)
            below = _block_height(len(lines), bars) + 2 * _BORDER + _TICKS
            if wide + 2 * _BORDER + _TICKS <= width and high + below <= height:
                return name, float(width), float(height), lines
    needed = wide + 2 * _BORDER + _TICKS, high + below
    raise FormatError(
        f"at 1:{scale:g} the drawing needs {needed[0]:.0f} x {needed[1]:.0f} mm, more "
        "than an A0 sheet; take a smaller scale, such as "
        f"1:{rounded_up(scale * max(needed[0] / 1189, needed[1] / 841) * 1.05):g}"
    )


def _wrapped(statements: Sequence[str], width: float) -> list[str]:
    """Statements wrapped into lines that fit a title block of the given width [mm]."""
    letters = int((width - 2 * _BORDER - 6) / _LETTER)
    return [
        line
        for statement in statements
        for line in textwrap.wrap(statement, letters, subsequent_indent="   ")
    ]


def _block_height(lines: int, bars: float) -> float:
    """Height of the title block for a number of lines of statements [mm]."""
    return _TITLE + 2 * _FIELD + bars + lines * _LINE + 3


def _contour_lines(axis: Axes, contours: Sequence[Contour], scale: float) -> None:
    """Draw contour lines, with the height at the longest line of each level.

    A height that would cover another one, or a line shorter than its number, has none.
    """
    longest: dict[float, Contour] = {}
    for line in contours:
        axis.plot(*line.points.T, color=_OVER, lw=0.35)
        if len(line.points) > len(longest.get(line.level, line).points) - 1:
            longest[line.level] = line
    places: list[Floats] = []
    for level, line in longest.items():
        middle = line.points[len(line.points) // 2]
        near = any(np.linalg.norm(middle - p) < _APART * scale for p in places)
        if not near and np.ptp(line.points, axis=0).max() > _APART * scale:
            places.append(middle)
            _label(axis, line.points, f"{level:.4g}")


def separate(axis: Axes, labels: Sequence[Annotation], marks: Sequence[Patch]) -> None:
    """Move labels of points apart, beside the ellipses; distant ones have a line.

    The labels must be centered at offsets in typographic points. Limits of the axis
    are final.
    """
    figure = axis.get_figure(root=True)
    if figure is None:
        return
    figure.draw_without_rendering()
    point = figure.dpi / 72
    ellipses = [mark.get_window_extent() for mark in marks]
    centers = axis.transData.transform([label.xy for label in labels])
    taken = [Bbox.from_extents(*(at - 3 * point), *(at + 3 * point)) for at in centers]
    inside = axis.get_window_extent()
    for label, at in zip(labels, centers, strict=True):
        half = np.array(label.get_window_extent().size) / 2
        best = None
        for away in (4, 8, 13, 19, 26, 34):
            for angle in (45, 135, -45, -135, 0, 180, 90, -90):
                unit = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
                place = at + unit * (half + away * point)
                box = Bbox.from_extents(*(place - half), *(place + half))
                cost = (
                    away
                    + 90 * sum(_common(box, other) ** 0.5 for other in taken)
                    + 40 * sum(_common(box, other) ** 0.5 for other in ellipses)
                    + 50 * (1 - _common(box, inside))
                )
                if best is None or cost < best[0]:
                    best = (cost, place, box, away)
        if best is not None:
            _, place, box, away = best
            label.set_position(tuple((place - at) / point))
            taken.append(box)
            if away > 13:
                ends = axis.transData.inverted().transform([at, place])
                axis.plot(*ends.T, color="#777777", lw=0.4, zorder=1.5)


def _common(box: Bbox, other: Bbox) -> float:
    """Return the fraction of a box that another one covers."""
    both = Bbox.intersection(box, other)
    return 0.0 if both is None else both.width * both.height / (box.width * box.height)


def annotate(axis: Axes, annotations: Annotations) -> None:
    """Draw outlines, stations with error ellipses, targets and section lines."""
    labels, ellipses = [], []
    centered: Any = {"ha": "center", "va": "center"}
    box = {"facecolor": "#ffffff", "alpha": 0.75, "lw": 0, "pad": 0.4}
    offset: Any = {"textcoords": "offset points", "fontsize": _LETTERS, "bbox": box}
    for colour, polygons in annotations.outlines:
        for number, polygon in enumerate(polygons):
            gid = "footprint" if number == 0 else None
            axis.plot(*polygon.T, color=colour, lw=0.8, ls=(0, (6, 2)), gid=gid)
    for name, station in annotations.stations.items():
        axis.plot(*station.position, "+", color=station.colour, ms=7, mew=1.2)
        ellipse = error_ellipse(
            station.position,
            station.covariance,
            factor=annotations.enlarged,
            colour=station.colour,
        )
        ellipse.set_gid("error-ellipse")
        axis.add_patch(ellipse)
        x, y = station.position
        ellipses.append(ellipse)
        labels.append(
            axis.annotate(
                name, (x, y), xytext=(9, 8), color=station.colour, **centered, **offset
            )
        )
    for name, point in annotations.targets.items():
        axis.plot(*point, "o", color="#000000", ms=4, mfc="none", mew=0.8)
        at = (point[0], point[1])
        labels.append(axis.annotate(name, at, xytext=(9, -8), **centered, **offset))
    for detail, (west, east, south, north) in annotations.details.items():
        axis.add_patch(
            Rectangle(
                (west, south), east - west, north - south,
                fill=False, edgecolor="#555555", lw=0.4, gid="detail",
            )
        )  # fmt: skip
        axis.annotate(detail, (west, north), xytext=(3, -9), color="#555555", **offset)
    for letter, ends in annotations.cuts.items():
        axis.plot(*ends.T, color="#000000", lw=0.8, ls=(0, (8, 2, 1, 2)))
        onward = 7 * (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
        for mark, end, shift in (
            (letter, ends[0], -onward),
            (f"{letter}'", ends[1], onward),
        ):
            axis.annotate(
                mark, (end[0], end[1]), xytext=tuple(shift), weight="bold",
                **centered, **offset,
            )  # fmt: skip
    separate(axis, labels, ellipses)


def _label(axis: Axes, points: Floats, text: str) -> None:
    """Write a text at the middle of a line, where it reads from left to right."""
    middle = len(points) // 2
    before, after = points[max(middle - 3, 0)], points[min(middle + 3, len(points) - 1)]
    angle = float(np.degrees(np.arctan2(*(after - before)[::-1])))
    axis.text(
        float(points[middle, 0]),
        float(points[middle, 1]),
        text,
        fontsize=_LETTERS,
        ha="center",
        va="center",
        rotation=(angle + 90) % 180 - 90,
        rotation_mode="anchor",
        clip_on=True,
        bbox={"facecolor": "#ffffff", "alpha": 0.75, "lw": 0, "pad": 0.4},
    )


def _scale_bar(frame: Axes, scale: float, at: tuple[float, float]) -> None:
    """Draw a scale bar in four parts, true to scale on paper."""
    length = rounded_up(0.03 * scale)
    size = length / scale * 1e3
    for part in range(4):
        frame.add_patch(
            Rectangle(
                (at[0] + part * size / 4, at[1]),
                size / 4,
                1.6,
                facecolor="#000000" if part % 2 == 0 else "#ffffff",
                edgecolor="#000000",
                lw=0.3,
                gid="scale-bar",
            )
        )
    unit, factor = ("mm", 1e3) if length < 1 else ("m", 1.0)
    for part in (0, 2, 4):
        text = f"{length * factor * part / 4:g}" + (f" {unit}" if part == 4 else "")
        frame.text(
            at[0] + part * size / 4,
            at[1] - 1,
            text,
            fontsize=_LETTERS,
            va="top",
            ha="center",
        )


def relief(raster: Raster) -> NDArray[np.uint8]:
    """Shaded relief of a raster, lit from the upper left, averaged over 3 x 3 cells."""
    covered = np.isfinite(raster.height)
    filled = np.where(covered, raster.height, 0.0)
    weight = ndimage.uniform_filter(covered.astype(float), 3)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = ndimage.uniform_filter(filled, 3) / weight
    mean = np.where(covered, mean, np.nanmean(raster.height))
    light = LightSource(azdeg=315, altdeg=40).hillshade(
        mean, dx=raster.cell, dy=raster.cell
    )
    grey = (255 * np.clip(light, 0, 1)).astype(np.uint8)
    opacity = np.where(covered, 255, 0).astype(np.uint8)
    return np.stack([grey, grey, grey, opacity], axis=-1)
