"""Drawing sheets at scale: picture, grid, scale bar, title block."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LightSource, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from scipy import ndimage

from amulor.errors import CubeError, FormatError
from amulor.imaging.products import Contour, Raster
from amulor.view.style import (
    BRIGHTNESS_MAP,
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
# Border of the sheet, room for numbers beside the picture, and below it [mm].
_BORDER, _TICKS, _BLOCK = 10.0, 16.0, 52.0
_INCH = 25.4
# Color of a surface without a value to show.
_GREY = (226, 226, 226, 255)
#: Part of the cells that limits of colors may leave out on either side [%].
_STRAY = 1.0
_COLOURS = {
    "amplitude": BRIGHTNESS_MAP,
    "height": DISTANCE_MAP,
    "relief": BRIGHTNESS_MAP,
    "uncertainty": ERROR_MAP,
    "deviation": DIFFERENCE_MAP,
}


@dataclass(frozen=True, kw_only=True)
class Sheet:
    """Title, scale, statements and contour lines of a drawing sheet."""

    title: str
    """Title."""
    scale: float
    """Scale denominator; 20 for 1:20 [1]."""
    statements: Sequence[str]
    """Statements about frame, errors and provenance."""
    contours: Sequence[Contour] = ()
    """Contour lines drawn over the picture."""


def colours_of(
    raster: Raster, show: Shown, *, values: Floats | None = None
) -> tuple[NDArray[np.uint8], tuple[float, float], str]:
    """Pixel colors of a raster, with the limits and the unit of the color scale."""
    if show == "relief":
        return _relief(raster), (0.0, 1.0), ""
    unit = "mV" if show == "amplitude" else "mm"
    values_shown = {
        "amplitude": raster.amplitude,
        "height": raster.height,
        "uncertainty": raster.uncertainty,
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


def sheet(
    raster: Raster, content: Sheet, *, show: Shown, values: Floats | None = None
) -> Figure:
    """Draw a raster on the smallest ISO sheet that fits it at its scale."""
    rows, columns = raster.height.shape
    wide = columns * raster.cell / content.scale * 1e3
    high = rows * raster.cell / content.scale * 1e3
    name, width, height = _paper(wide, high, content.scale)
    pixels, limits, unit = colours_of(raster, show, values=values)
    with style():
        figure = Figure(figsize=(width / _INCH, height / _INCH))
        room = height - 2 * _BORDER - _BLOCK - _TICKS
        left = _TICKS + _BORDER + (width - 2 * _BORDER - _TICKS - wide) / 2
        low = _BORDER + _BLOCK + _TICKS + (room - high) / 2
        axis = figure.add_axes(
            (left / width, low / height, wide / width, high / height)
        )
        extent = (
            raster.left,
            raster.left + columns * raster.cell,
            raster.top - rows * raster.cell,
            raster.top,
        )
        axis.imshow(pixels, extent=extent, interpolation="none", aspect="auto")
        for line in content.contours:
            axis.plot(*line.points.T, color="#D55E00", lw=0.35)
        axis.set_xlim(extent[:2])
        axis.set_ylim(extent[2:])
        _grid(axis, content.scale, raster.plane.names)
        _block(figure, (width, height), content, name, raster)
        if unit:
            _colour_bar(figure, (width, height), show, limits, unit)
    return figure


def _paper(wide: float, high: float, scale: float) -> tuple[str, float, float]:
    """Name, width and height of the smallest ISO sheet that fits a picture [mm]."""
    needed = wide + 2 * _BORDER + _TICKS, high + 2 * _BORDER + _TICKS + _BLOCK
    for name, (short, long) in _SHEETS.items():
        for width, height in ((long, short), (short, long)):
            if needed[0] <= width and needed[1] <= height:
                return name, float(width), float(height)
    raise FormatError(
        f"at 1:{scale:g} the drawing needs {needed[0]:.0f} x {needed[1]:.0f} mm, more "
        "than an A0 sheet; take a smaller scale, such as "
        f"1:{_rounded(scale * max(needed[0] / 1189, needed[1] / 841) * 1.05):g}"
    )


def _rounded(value: float) -> float:
    """Smallest number of the series 1, 2, 5, 10, 20, ... not below a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(s * power for s in (1, 2, 5, 10) if s * power >= value * 0.999))


def _grid(axis: Axes, scale: float, names: tuple[str, str, str]) -> None:
    """Draw grid lines with coordinates, 20 to 50 mm apart on paper."""
    step = _rounded(0.02 * scale)
    if max(np.ptp(axis.get_xlim()), np.ptp(axis.get_ylim())) < 4 * step:
        step = _rounded(0.008 * scale)
    digits = max(0, int(np.ceil(-np.log10(step))))
    for which, (low, high) in (("x", axis.get_xlim()), ("y", axis.get_ylim())):
        places = step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step) + 1)
        labels = [f"{place + 0.0:.{digits}f}" for place in np.round(places, 9)]
        getattr(axis, f"set_{which}ticks")(places, labels)
    axis.grid(color="#56B4E9", lw=0.25, alpha=0.8)
    axis.tick_params(labelsize=6, length=2, width=0.3)
    axis.tick_params(axis="y", rotation=90)
    for label in axis.get_yticklabels():
        label.set_verticalalignment("center")
    axis.set_xlabel(f"{names[0]} [m]", fontsize=7)
    axis.set_ylabel(f"{names[1]} [m]", fontsize=7)
    for spine in axis.spines.values():
        spine.set_visible(True)
        spine.set_linewidth(0.3)


def _block(
    figure: Figure,
    size: tuple[float, float],
    content: Sheet,
    paper: str,
    raster: Raster,
) -> None:
    """Draw the title block, with the scale bar, below the picture."""
    width, height = size
    frame = figure.add_axes((0, 0, 1, _BLOCK / height + _BORDER / height))
    frame.set_xlim(0, width)
    frame.set_ylim(0, _BLOCK + _BORDER)
    frame.axis("off")
    frame.add_patch(
        Rectangle(
            (_BORDER, _BORDER), width - 2 * _BORDER, _BLOCK - 4, fill=False, lw=0.5
        )
    )
    top = _BORDER + _BLOCK - 4
    words = textwrap.shorten(content.title, 90, placeholder=" ...")
    frame.text(_BORDER + 4, top - 6, words, fontsize=10, weight="bold", va="center")
    frame.text(
        width - _BORDER - 4,
        top - 6,
        f"1:{content.scale:g} on {paper}",
        fontsize=10,
        weight="bold",
        va="center",
        ha="right",
    )
    _scale_bar(frame, content.scale, (_BORDER + 6, top - 16))
    room = width - 2 * _BORDER - 8
    letters = int(room / 1.16)
    lines = [
        line
        for statement in content.statements
        for line in textwrap.wrap(statement, letters, subsequent_indent="   ")
    ]
    size_of_text = 6.0 if len(lines) <= 9 else 6.0 * 9 / len(lines)
    frame.text(_BORDER + 4, top - 23, "\n".join(lines), fontsize=size_of_text, va="top")


def _scale_bar(frame: Axes, scale: float, at: tuple[float, float]) -> None:
    """Draw a scale bar in four parts, true to scale on paper."""
    length = _rounded(0.03 * scale)
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
            )
        )
    unit, factor = ("mm", 1e3) if length < 1 else ("m", 1.0)
    for part in (0, 2, 4):
        text = f"{length * factor * part / 4:g}" + (f" {unit}" if part == 4 else "")
        frame.text(
            at[0] + part * size / 4, at[1] - 1, text, fontsize=6, va="top", ha="center"
        )


def _colour_bar(
    figure: Figure,
    size: tuple[float, float],
    show: Shown,
    limits: tuple[float, float],
    unit: str,
) -> None:
    """Draw the color scale to the right of the title block."""
    width, height = size
    long = 50.0
    axis: Any = figure.add_axes(
        (
            (width - _BORDER - 8 - long) / width,
            (_BORDER + _BLOCK - 4 - 16.5) / height,
            long / width,
            2.4 / height,
        )
    )
    ramp = np.linspace(0, 1, 256)[None]
    axis.imshow(
        ramp, aspect="auto", cmap=_COLOURS[show], extent=(limits[0], limits[1], 0, 1)
    )
    axis.set_yticks([])
    axis.locator_params(axis="x", nbins=4)
    axis.tick_params(labelsize=6, length=1.5, width=0.3, pad=1)
    axis.set_title(f"{show} [{unit}]", fontsize=6, loc="right", pad=2, weight="normal")


def _relief(raster: Raster) -> NDArray[np.uint8]:
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
