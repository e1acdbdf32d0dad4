"""What the figures share: lettered panels, lines, ratios and surfaces."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import wraps
from itertools import pairwise
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.ticker import FixedLocator, MultipleLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from amulor.imaging import point_cloud
from amulor.optics import extrema
from amulor.studies.ricci2010.results import Check, holds
from amulor.studies.ricci2010.scenes.interference_sweeps import (
    TITLES,
    Sweep,
    shown,
    smoothed,
)
from amulor.studies.ricci2010.scenes.milk import PIXELS
from amulor.studies.ricci2010.scenes.short_lines import TURBIDITIES, corrected, line
from amulor.studies.ricci2010.study import Study
from amulor.view.style import COLOURS, new_figure, style

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


#: Colour of each pair.
COLOUR = {"VV": COLOURS[0], "VH": COLOURS[1], "RL": COLOURS[2], "RR": COLOURS[3]}


def panel(
    study: Study, axis: Axes, step: str, pairs: tuple[str, str], *, subtracted: bool
) -> None:
    """Draw two lines of one water."""
    pixel = np.arange(1, PIXELS + 1)
    for pair, filled in zip(pairs, (True, False), strict=True):
        result = line(study, step, pair)
        axis.plot(
            pixel,
            result.measured,
            "o" if filled else "s",
            color=COLOUR[pair],
            markersize=2.4,
            markerfacecolor=COLOUR[pair] if filled else "white",
            markeredgewidth=0.5,
            label=f"{pair}, {SYNTHETIC}",
            zorder=2,
        )
        axis.plot(
            pixel, result.phase, color="black", linewidth=0.8, zorder=3,
            label=None if filled else "model, without noise",
        )  # fmt: skip
    if subtracted:
        axis.plot(
            pixel,
            corrected(study, step, pairs[0]),
            "--",
            color="#555555",
            linewidth=0.8,
            label=f"{pairs[0]} less open water",
            zorder=3,
        )
    axis.set(xlim=(0, PIXELS + 1), xlabel="pixel", ylabel="phase advance [degree]")
    axis.xaxis.set_major_locator(FixedLocator([1, 20, 40, 60, 80]))
    axis.grid(axis="y")


def water_name(study: Study, step: str) -> str:
    """Return what a panel says of its water."""
    attenuation = study[TURBIDITIES[step]]
    thickness = attenuation * study["short_distance"]
    name = "tap water" if step == "tap" else "with milk"
    return f"{name}, {attenuation:.2f} 1/m (optical thickness {thickness:.2g})"


Floats = NDArray[np.float64]
Curve = Callable[[Sweep], Floats]
#: Where the paper speaks of both figures.
RATIO_PLACE = "section 8, on figures 8 and 9"


def same_extrema(sweep: Sweep, value: Floats, name: str) -> Check:
    """Return the check that a quantity turns where the amplitude does."""
    limit = max(1.0, sweep.period / 1e7)
    of_value, of_amplitude = (
        extrema.find(sweep.frequency, smoothed(curve))
        for curve in (value, np.abs(sweep.signal))
    )
    # Next to the ends of the sweep noise and smoothing make extrema of their own.
    first, last = sweep.frequency[[0, -1]] + np.array([1, -1]) * sweep.period / 8
    shifts = [
        np.abs(there - place).min(initial=np.inf) / 1e6
        for here, there in (
            (of_value.maxima, of_amplitude.maxima),
            (of_value.minima, of_amplitude.minima),
        )
        for place in here[(here > first) & (here < last)]
    ]
    median = float(np.median(shifts)) if shifts else np.nan
    return holds(
        f"experiment {sweep.number}: extrema of {name} and of amplitude coincide",
        median <= limit,
        found=f"{len(shifts)} extrema, median shift {median:.1f} MHz, largest "
        f"{max(shifts, default=np.nan):.1f} MHz",
        place=RATIO_PLACE,
        wanted=f"median at most {limit:.1f} MHz, a tenth of the period",
    )


def almost_monotonic(sweep: Sweep, value: Floats, name: str) -> Check:
    """Return the check that a quantity rises without turning back by much."""
    count = turns(sweep, value, depth=0.1 * float(np.ptp(smoothed(value))))
    return holds(
        f"experiment {sweep.number}: {name} rises almost monotonically (turns back by "
        "more than a tenth of its rise)",
        count == 0,
        found=str(count),
        wanted="0",
        place=RATIO_PLACE,
    )


def turns(sweep: Sweep, value: Floats, *, depth: float) -> int:
    """Return how many maxima stand above both minima beside them."""
    even = smoothed(value)
    result = extrema.find(sweep.frequency, even)
    level = np.interp(result.maxima, sweep.frequency, even)
    count = 0
    for place, top in zip(result.maxima, level, strict=True):
        left = result.minima[result.minima < place][-1:]
        right = result.minima[result.minima > place][:1]
        beside = np.interp([*left, *right], sweep.frequency, even)
        count += bool(len(beside) == 2 and np.all(top - beside > depth))
    return count


def grows(sweep: Sweep, value: Floats, name: str) -> Check:
    """Return the check that a quantity grows with frequency, period by period."""
    span = sweep.frequency[-1] - sweep.frequency[0]
    count = max(2, int(span / sweep.period))
    edges = sweep.frequency[-1] - sweep.period * np.arange(count, -1, -1.0)
    means = [
        float(value[(sweep.frequency > low) & (sweep.frequency <= high)].mean())
        for low, high in pairwise(edges)
    ]
    return holds(
        f"experiment {sweep.number}: {name} grows with frequency (means over periods "
        "of the interference)",
        bool(np.all(np.diff(means) > 0)),
        found=", ".join(f"{mean:.3g}" for mean in means),
        place=RATIO_PLACE,
        wanted="each above the one before",
    )


def draw_ratios(
    sweeps: tuple[Sweep, ...],
    *,
    raw: Curve,
    corrected: Curve,
    label: str,
    names: tuple[str, str],
    level: float,
    logarithmic: bool,
) -> Figure:
    """Draw a quantity of all experiments, before and after correction."""
    with style():
        figure = new_figure(WIDE, 2.5)
        axes = figure.subplots(1, 3, sharey=True)
        for axis, sweep in zip(axes, sweeps, strict=True):
            every = shown(sweep)
            f = sweep.frequency[every] / 1e6
            axis.axhline(level, color="#888888", lw=0.8)
            axis.plot(
                f,
                raw(sweep)[every],
                "o",
                ms=2.6,
                color=COLOURS[0],
                label=f"{names[0]}, {SYNTHETIC}",
            )
            axis.plot(
                f,
                corrected(sweep)[every],
                "o",
                ms=2.6,
                mfc="white",
                mew=0.7,
                color=COLOURS[1],
                label=f"{names[1]}, open water subtracted",
            )
            if logarithmic:
                axis.set_yscale("log")
            axis.set_xlim(0, 150)
            axis.set_xlabel("modulation frequency [MHz]")
            axis.grid(True)
        axes[0].set_ylabel(label)
        letter(axes, TITLES)
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=2)
        mark_synthetic(figure)
    return figure


#: From the far to the near, ever lighter, as in copper.
COPPER = LinearSegmentedColormap.from_list(
    "amulor copper", ["#3f4a50", "#7a584c", "#bd7a4e", "#e3b184", "#fbeede"]
)
#: Heights of the darkest and the lightest colour of the ladder [mm].
LADDER_SHADES = (-12.0, 82.0)
#: Light from above and from the left of a viewer, and how much comes from everywhere.
_LIGHT = np.array([-0.45, 0.35, 0.82])
_AMBIENT = 0.45
#: Below this elevation an axis towards the viewer has no room for ticks [degree].
_EDGE_ON = 30.0
#: Meshes higher than this are drawn in strips [mm].
_STRIP = 4.0


@dataclass(frozen=True)
class Relief:
    """A range image as a surface over the plane of the target."""

    right: Floats
    """Places to the right, shape (row, column) [mm]."""
    up: Floats
    """Places upwards [mm]."""
    near: Floats
    """Heights towards the instrument, not numbers without a range [mm]."""


def relief(image: xr.Dataset, *, origin: float) -> Relief:
    """Return the points of a range image as a surface."""
    cloud = point_cloud(image)
    place = (cloud["row"].values, cloud["column"].values)
    right = origin * np.tan(image["azimuth"].values)
    up = origin * np.tan(image["elevation"].values)
    closest = np.full(right.shape, np.nan)
    right[place], up[place] = cloud["x"].values, -cloud["y"].values
    closest[place] = origin - cloud["z"].values
    return Relief(right * 1e3, up * 1e3, closest * 1e3)


def masked(surface: Relief, keep: NDArray[np.bool_]) -> Relief:
    """Return a surface of some pixels only."""
    return replace(surface, near=np.where(keep, surface.near, np.nan))


def median(surface: Relief, *, size: int = 5) -> tuple[Relief, float]:
    """Medians of a surface over small squares, and the scatter about them."""
    half = size // 2
    padded = np.pad(surface.near, half, constant_values=np.nan)
    windows = sliding_window_view(padded, (size, size))
    known = np.isfinite(surface.near)
    middle = np.full(surface.near.shape, np.nan)
    middle[known] = np.nanmedian(windows[known], axis=(1, 2))
    off = np.abs(surface.near - middle)[known]
    scatter = 1.4826 * float(np.median(off)) if off.size else np.nan
    places = []
    spike = known & (np.abs(surface.near - middle) > 5 * scatter)
    for place in (surface.right, surface.up):
        # A spike stands beside its neighbours, too.
        around = sliding_window_view(
            np.pad(np.where(spike, np.nan, place), half, constant_values=np.nan),
            (size, size),
        )
        moved = place.copy()
        moved[spike] = np.nanmean(around[spike], axis=(1, 2))
        places.append(moved)
    return Relief(places[0], places[1], middle), scatter


def canvas(
    width: float, height: float, *, rows: int, columns: int
) -> tuple[Figure, list[SubplotSpec]]:
    """Return an empty figure with room for the labels of panels in space."""
    figure = new_figure(width, height)
    engine: Any = figure.get_layout_engine()
    engine.set(h_pad=0.13, w_pad=0.08)
    grid = figure.add_gridspec(rows, columns)
    return figure, [grid[place] for place in range(rows * columns)]


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
    """Draw a surface with the same scale along all three axes."""
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
    for each in (axis.xaxis, axis.yaxis, axis.zaxis):
        each.set_major_locator(MultipleLocator(spacing))
        each.set_pane_color((1.0, 1.0, 1.0, 0.0))
        each.line.set_linewidth(0.5)
        each._axinfo["grid"].update(linewidth=0.3, color="#d5dbde")
    axis.tick_params(pad=-3, labelsize=6, length=2)
    # Seen from low, the ticks of the front edge lie close above its label.
    pad = -7 if elevation > _EDGE_ON - 5 or azimuth % 180 == 90 else -4
    axis.set_xlabel("right [mm]", labelpad=pad, fontsize=7)
    axis.set_ylabel("up [mm]", labelpad=-7, fontsize=7)
    axis.set_zlabel("nearer [mm]", labelpad=-7, fontsize=7)
    if azimuth % 180 == 90 and elevation < _EDGE_ON:
        # The axis points at the viewer: its ticks would stand on each other.
        axis.set_yticks([])
        axis.set_ylabel("")
    return axis


def _quads(grid: Floats) -> Floats:
    """Return the four corners of each mesh of a grid, shape (mesh, 4, ...)."""
    around = (grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1])
    return np.stack(around, axis=2).reshape(-1, 4, grid.shape[-1])


def _in_strips(quads: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Return meshes, high ones cut into strips, and which mesh each strip is of.

    A drawing in space puts nearer meshes over farther ones by their middles, which
    fails for one as high as a step.
    """
    height = np.ptp(quads[..., 2], axis=1)
    count = np.ceil(np.nan_to_num(height) / _STRIP).astype(int).clip(1, None)
    mesh = np.repeat(np.arange(len(quads)), count)
    number = np.arange(mesh.size) - np.repeat(np.cumsum(count) - count, count)
    start = (number / count[mesh])[:, None, None]
    end = ((number + 1) / count[mesh])[:, None, None]
    left, right = quads[mesh][:, [0, 3]], quads[mesh][:, [1, 2]]
    low, high = left + start * (right - left), left + end * (right - left)
    return np.stack([low[:, 0], high[:, 0], high[:, 1], low[:, 1]], axis=1), mesh


def _brightness(corners: Floats) -> Floats:
    """Return the light on each corner: a diffuse surface under a lamp and a sky."""
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
    """Return heights, gaps in a row joined by straight lines, which cast no shade."""
    filled = np.zeros_like(heights)
    column = np.arange(heights.shape[1])
    for row, profile in enumerate(heights):
        known = np.isfinite(profile)
        if known.any():
            filled[row] = np.interp(column, column[known], profile[known])
    return filled
