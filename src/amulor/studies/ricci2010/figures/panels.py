"""Shared drawing functions: figure style, lettered panels, range surfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, ParamSpec

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.ticker import MultipleLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from amulor.imaging import point_cloud
from amulor.view.style import new_figure, style

Arguments = ParamSpec("Arguments")
#: Put where a paper would say "measured".
SYNTHETIC = "synthetic measurement"
#: Width of a figure over both columns, and over one [inch].
WIDE, NARROW = 7.2, 3.6


def styled(draw: Callable[Arguments, Figure]) -> Callable[Arguments, Figure]:
    """Decorate a drawing function with amulor's figure style."""

    @wraps(draw)
    def drawn(*arguments: Arguments.args, **options: Arguments.kwargs) -> Figure:
        with style():
            return draw(*arguments, **options)

    return drawn


def letter(axes: Iterable[Axes], titles: Iterable[str]) -> None:
    """Title the panels (a), (b), ... as in the paper."""
    for number, (axis, title) in enumerate(zip(axes, titles, strict=True)):
        axis.set_title(f"({chr(ord('a') + number)}) {title}")


def mark_synthetic(figure: Figure) -> None:
    """Add a note at the foot of a figure that its measurements are simulated."""
    figure.supxlabel(
        "Measured series are synthetic: simulated, with the noise that the study says.",
        fontsize=6,
        color="#555555",
        x=0.995,
        ha="right",
    )


Floats = NDArray[np.float64]

#: From the far to the near, ever lighter, as in copper.
COPPER = LinearSegmentedColormap.from_list(
    "amulor copper", ["#3f4a50", "#7a584c", "#bd7a4e", "#e3b184", "#fbeede"]
)
#: Light from above and from the left of a viewer, and how much comes from everywhere.
_LIGHT = np.array([-0.45, 0.35, 0.82])
_AMBIENT = 0.45
#: Below this elevation an axis towards the viewer has no room for ticks [degree].
_EDGE_ON = 30.0
#: Meshes higher than this are drawn in strips [mm].
_STRIP = 4.0


@dataclass(frozen=True)
class Relief:
    """Surface of a range image: pixel heights above the plane of the target."""

    right: Floats
    """Rightward positions, shape (row, column) [mm]."""
    up: Floats
    """Upward positions [mm]."""
    near: Floats
    """Heights toward the instrument, NaN without a range [mm]."""


def relief(image: xr.Dataset, *, origin: float) -> Relief:
    """Convert a range image to heights above the plane of the target."""
    cloud = point_cloud(image)
    place = (cloud["row"].values, cloud["column"].values)
    right = origin * np.tan(image["azimuth"].values)
    up = origin * np.tan(image["elevation"].values)
    closest = np.full(right.shape, np.nan)
    right[place], up[place] = cloud["x"].values, -cloud["y"].values
    closest[place] = origin - cloud["z"].values
    return Relief(right * 1e3, up * 1e3, closest * 1e3)


def masked(surface: Relief, keep: NDArray[np.bool_]) -> Relief:
    """Return a surface reduced to selected pixels."""
    return replace(surface, near=np.where(keep, surface.near, np.nan))


def median(surface: Relief, *, size: int = 5) -> tuple[Relief, float]:
    """Smooth a surface by a median filter; return also the scatter of the pixels."""
    half = size // 2
    padded = np.pad(surface.near, half, constant_values=np.nan)
    windows = sliding_window_view(padded, (size, size))
    valid = np.isfinite(surface.near)
    middle = np.full(surface.near.shape, np.nan)
    middle[valid] = np.nanmedian(windows[valid], axis=(1, 2))
    off = np.abs(surface.near - middle)[valid]
    scatter = 1.4826 * float(np.median(off)) if off.size else np.nan
    places = []
    spike = valid & (np.abs(surface.near - middle) > 5 * scatter)
    for place in (surface.right, surface.up):
        # A spike is also displaced to the side and upward.
        around = sliding_window_view(
            np.pad(np.where(spike, np.nan, place), half, constant_values=np.nan),
            (size, size),
        )
        moved = place.copy()
        moved[spike] = np.nanmean(around[spike], axis=(1, 2))
        places.append(moved)
    return Relief(places[0], places[1], middle), scatter


@styled
def draw_surfaces(
    height: float,
    views: Sequence[tuple[str, Relief, Mapping[str, float]]],
    *,
    rows: int,
    limits: tuple[float, float],
    shades: tuple[float, float],
    zoom: float,
) -> Figure:
    """Draw several surfaces with titles, each from a given viewing direction."""
    figure = new_figure(WIDE, height)
    engine: Any = figure.get_layout_engine()
    # Room for the labels of panels in space.
    engine.set(h_pad=0.13, w_pad=0.08)
    columns = len(views) // rows
    grid = figure.add_gridspec(rows, columns)
    axes = [
        draw_surface(
            figure,
            grid[number],
            surface,
            limits=limits,
            shades=shades,
            zoom=zoom,
            **view,
        )
        for number, (_, surface, view) in enumerate(views)
    ]
    letter(axes, [title for title, _, _ in views])
    mark_synthetic(figure)
    return figure


def draw_surface(
    figure: Figure,
    where: SubplotSpec,
    surface: Relief,
    *,
    limits: tuple[float, float],
    shades: tuple[float, float] | None = None,
    elevation: float = 32.0,
    azimuth: float = -62.0,
    spacing: float = 20.0,
    zoom: float = 1.0,
) -> Any:
    """Draw a surface in 3-D (parallel projection), with equal scales of all axes."""
    axis: Any = figure.add_subplot(where, projection="3d", computed_zorder=False)
    corners = np.stack([surface.right, surface.up, surface.near], axis=-1)
    quads, strips = _in_strips(_quads(corners))
    inside = (quads[..., 2] >= limits[0]) & (quads[..., 2] <= limits[1])
    keep = np.isfinite(quads).all(axis=(1, 2)) & inside.all(axis=1)
    shade = _quads(_brightness(corners)[..., None])[..., 0].mean(axis=1)[strips]
    low, high = limits if shades is None else shades
    colours = COPPER((quads[..., 2].mean(axis=1)[keep] - low) / (high - low))
    colours[:, :3] *= shade[keep, None]
    faces = Poly3DCollection(
        quads[keep], facecolors=colours, edgecolors=colours, linewidths=0.25, zorder=2
    )
    faces.set_rasterized(True)
    axis.add_collection3d(faces, autolim=False)
    spans = []
    for name, values in zip("xy", (surface.right, surface.up), strict=True):
        ends = float(values.min()), float(values.max())
        getattr(axis, f"set_{name}lim")(*ends, auto=False, view_margin=0)
        spans.append(ends[1] - ends[0])
    axis.set_zlim(*limits, view_margin=0)
    axis.set_box_aspect([*spans, limits[1] - limits[0]], zoom=zoom)
    axis.view_init(elev=elevation, azim=azimuth)
    axis.set_proj_type("ortho")
    for dimension in (axis.xaxis, axis.yaxis, axis.zaxis):
        dimension.set_major_locator(MultipleLocator(spacing))
        dimension.set_pane_color((1.0, 1.0, 1.0, 0.0))
        dimension.line.set_linewidth(0.5)
        dimension._axinfo["grid"].update(linewidth=0.3, color="#d5dbde")
    axis.tick_params(pad=-3, labelsize=6, length=2)
    # Seen from low, the ticks of the front edge lie close above its label.
    pad = -7 if elevation > _EDGE_ON - 5 or azimuth % 180 == 90 else -4
    axis.set_xlabel("right [mm]", labelpad=pad, fontsize=7)
    axis.set_ylabel("up [mm]", labelpad=-7, fontsize=7)
    axis.set_zlabel("nearer [mm]", labelpad=-7, fontsize=7)
    if azimuth % 180 == 90 and elevation < _EDGE_ON:
        # The axis points at the viewer: its ticks would overlap.
        axis.set_yticks([])
        axis.set_ylabel("")
    return axis


def _quads(grid: Floats) -> Floats:
    """Return the corners of each grid cell, shape (cell, 4, ...)."""
    around = (grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1])
    return np.stack(around, axis=2).reshape(-1, 4, grid.shape[-1])


def _in_strips(quads: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Cut tall grid cells into strips; return the strips and their cell indices.

    A drawing in space puts nearer meshes over farther ones by their middles, which
    fails for one as high as a step.
    """
    height = np.ptp(quads[..., 2], axis=1)
    count = np.ceil(np.nan_to_num(height) / _STRIP).astype(int).clip(1, None)
    mesh = np.repeat(np.arange(len(quads)), count)
    number = np.arange(mesh.size) - np.repeat(np.cumsum(count) - count, count)
    start = (number / count[mesh])[:, None, None]
    end = ((number + 1) / count[mesh])[:, None, None]
    begin = quads[mesh][:, [0, 3]]
    side = quads[mesh][:, [1, 2]] - begin
    low, high = begin + start * side, begin + end * side
    return np.stack([low[:, 0], high[:, 0], high[:, 1], low[:, 1]], axis=1), mesh


def _brightness(corners: Floats) -> Floats:
    """Return the brightness at corners of a matte surface in lamp and sky light."""
    filled = _bridged(corners[..., 2])
    column = corners[..., 0].mean(axis=0)
    row = corners[..., 1].mean(axis=1)
    by_row, by_column = np.gradient(filled, row, column)
    normal = np.stack([-by_column, -by_row, np.ones_like(filled)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    lamp = _LIGHT / np.linalg.norm(_LIGHT)
    light = np.clip(normal @ lamp, 0.0, None) / lamp[2]
    bright: Floats = np.clip(_AMBIENT + (1 - _AMBIENT) * light, 0.0, 1.0)
    return bright


def _bridged(heights: Floats) -> Floats:
    """Return heights with missing values interpolated in each row, for shading."""
    filled = np.zeros_like(heights)
    column = np.arange(heights.shape[1])
    for row, profile in enumerate(heights):
        valid = np.isfinite(profile)
        if valid.any():
            filled[row] = np.interp(column, column[valid], profile[valid])
    return filled
