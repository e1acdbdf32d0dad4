"""Figures of cubes and range images; each returns a figure and draws nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from amulor.cube import UNUSABLE
from amulor.imaging import point_cloud
from amulor.view.style import (
    BRIGHTNESS_MAP,
    DIFFERENCE_MAP,
    DISTANCE_MAP,
    MISSING_COLOUR,
    new_figure,
    style,
)

Floats = NDArray[np.float64]


def signal_images(cube: xr.Dataset, *, frequency: int = 0) -> Figure:
    """Draw amplitude and phase of every channel of a cube.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples` or `target_signal`.
    frequency : int
        Which of the modulation frequencies, counted from 0.

    Returns
    -------
    matplotlib.figure.Figure
        One row for each channel.
    """
    channels = [str(value) for value in cube["polarization"].values]
    amplitude = cube.amulor.amplitude.values[frequency]
    phase = cube.amulor.phase.values[frequency]
    with style():
        figure = new_figure(7.2, 0.35 + 1.5 * len(channels))
        axes = figure.subplots(len(channels), 2, squeeze=False)
        for number, channel in enumerate(channels):
            # Around the mean direction, so that no wrap cuts through the picture.
            mean = np.angle(np.nansum(np.exp(1j * phase[number])))
            turned = np.angle(np.exp(1j * (phase[number] - mean)))
            _image(
                axes[number, 0],
                cube,
                amplitude[number] * 1e3,
                title=f"{channel}: amplitude",
                label="mV",
                colours=BRIGHTNESS_MAP,
                limits=(0.0, float(np.nanmax(amplitude[number])) * 1e3),
            )
            _image(
                axes[number, 1],
                cube,
                np.degrees(turned),
                title=f"{channel}: phase about its mean, {np.degrees(mean):.1f}°",
                label="degrees",
                colours=DISTANCE_MAP,
            )
    return figure


def range_images(before: xr.Dataset, after: xr.Dataset) -> Figure:
    """Draw slant range before and after rejection, its uncertainty and its flags.

    Parameters
    ----------
    before, after : xarray.Dataset
        Level `range_image`, of the same scan.

    Returns
    -------
    matplotlib.figure.Figure
        Four panels; both ranges in the same colours.
    """
    with style():
        figure = new_figure(7.2, 3.2)
        axes = figure.subplots(2, 2)
        ranges = [image["slant_range"].values * 1e3 for image in (before, after)]
        limits = _limits(np.concatenate([values.ravel() for values in ranges]), 0.05)
        for axis, image, values, name in zip(
            axes[0], (before, after), ranges, ("before", "after"), strict=True
        ):
            _image(
                axis,
                image,
                values,
                title=f"slant range {name} rejection",
                label="mm",
                colours=DISTANCE_MAP,
                limits=limits,
            )
        _image(
            axes[1, 0],
            after,
            after["slant_range_uncertainty"].values * 1e3,
            title="uncertainty after rejection",
            label="mm",
            colours="magma",
        )
        _image(
            axes[1, 1],
            after,
            (ranges[0] - ranges[1]),
            title="moved by rejection (before - after)",
            label="mm",
            colours=DIFFERENCE_MAP,
            limits=_even(ranges[0] - ranges[1]),
        )
    return figure


def image_overview(image: xr.Dataset) -> Figure:
    """Draw range, uncertainty, brightness and flags of one range image.

    Parameters
    ----------
    image : xarray.Dataset
        Level `range_image`.

    Returns
    -------
    matplotlib.figure.Figure
        Four panels.
    """
    with style():
        figure = new_figure(7.2, 3.2)
        axes = figure.subplots(2, 2)
        panels = (
            ("slant range", image["slant_range"].values * 1e3, "mm", DISTANCE_MAP),
            (
                "uncertainty",
                image["slant_range_uncertainty"].values * 1e3,
                "mm",
                "magma",
            ),
            ("brightness", image["intensity"].values * 1e3, "mV", BRIGHTNESS_MAP),
        )
        for axis, (title, values, label, colours) in zip(
            axes.ravel(), panels, strict=False
        ):
            _image(axis, image, values, title=title, label=label, colours=colours)
        _quality(axes[1, 1], image)
    return figure


def profiles(images: Mapping[str, Mapping[str, xr.Dataset]]) -> Figure:
    """Draw all rows of range images over each other, as line profiles.

    Parameters
    ----------
    images : mapping
        Case to ("before", "after") to a `range_image`.

    Returns
    -------
    matplotlib.figure.Figure
        One column for each case, one row for each stage.
    """
    stages = list(next(iter(images.values())))
    with style():
        figure = new_figure(max(1.85 * len(images), 3.6), 1.75 * len(stages))
        axes = figure.subplots(
            len(stages), len(images), squeeze=False, sharex=True, sharey=True
        )
        for row, stage in enumerate(stages):
            for column, (case, by_stage) in enumerate(images.items()):
                axis = axes[row, column]
                letter = chr(ord("a") + row * len(images) + column)
                across, height = _heights(by_stage[stage])
                axis.plot(
                    across.T, height.T, color=_stage_colour(row), lw=0.4, alpha=0.35
                )
                name = f"{case}, {stage}" if len(stages) > 1 else case
                axis.set_title(f"({letter}) {name}" if len(images) > 1 else name)
                axis.grid(lw=0.3, color="#dddddd")
        for axis in axes[-1]:
            axis.set_xlabel("right [mm]")
        for axis in axes[:, 0]:
            axis.set_ylabel("nearer [mm]")
        bounds = [_heights(by[stages[-1]])[1] for by in images.values()]
        axes[0, 0].set_ylim(_limits(np.concatenate([b.ravel() for b in bounds]), 0.5))
    return figure


def surfaces(images: Mapping[str, xr.Dataset]) -> Figure:
    """Draw range images as shaded surfaces in space.

    Parameters
    ----------
    images : mapping
        Title to `range_image`.

    Returns
    -------
    matplotlib.figure.Figure
        One panel for each, all with the same axes; near is up.
    """
    columns = 2 if len(images) > 1 else 1
    rows = -(-len(images) // columns)
    with style():
        figure = new_figure(3.6 * columns, 2.75 * rows)
        heights = [_grid(image)[2] for image in images.values()]
        low, high = _limits(np.concatenate([h.ravel() for h in heights]), 0.25)
        for number, (title, image) in enumerate(images.items()):
            axis: Any = figure.add_subplot(rows, columns, number + 1, projection="3d")
            x, y, z = _grid(image)
            z = np.where((z < low) | (z > high), np.nan, z)
            axis.plot_surface(
                x,
                -y,
                z,
                facecolors=_shaded(z, low, high),
                rstride=1,
                cstride=1,
                linewidth=0,
                antialiased=False,
                shade=False,
            )
            axis.set_title(f"({chr(ord('a') + number)}) {title}")
            axis.set_xlabel("right [mm]", labelpad=-1)
            axis.set_ylabel("up [mm]", labelpad=-1)
            axis.set_zlabel("nearer [mm]", labelpad=-3)
            axis.set_zlim(low, high)
            axis.set_ylim(float(np.nanmin(-y)), float(np.nanmax(-y)))
            axis.yaxis.set_major_locator(MaxNLocator(3))
            axis.zaxis.set_major_locator(MaxNLocator(5))
            axis.tick_params(pad=-2, labelsize=6)
            axis.view_init(elev=30, azim=-72)
            spans = [np.ptp(x), max(np.ptp(y), 0.4 * np.ptp(x)), 0.6 * np.ptp(x)]
            axis.set_box_aspect(spans, zoom=1.02)
    return figure


def _image(
    axis: Axes,
    cube: xr.Dataset,
    values: Floats,
    *,
    title: str,
    label: str,
    colours: str,
    limits: tuple[float, float] | None = None,
) -> None:
    low, high = limits or _limits(values)
    palette = colormaps[colours].with_extremes(bad=MISSING_COLOUR)
    azimuth = np.degrees(cube["azimuth"].values)
    elevation = np.degrees(cube["elevation"].values)
    flat = np.ptp(azimuth) == 0 or np.ptp(elevation) == 0
    extent = (
        None
        if flat
        else (azimuth[0, 0], azimuth[0, -1], elevation[-1, 0], elevation[0, 0])
    )
    drawn = axis.imshow(
        values, cmap=palette, vmin=low, vmax=high, extent=extent, interpolation="none"
    )
    axis.set_title(title)
    axis.set_xlabel("column" if flat else "azimuth [°]")
    axis.set_ylabel("row" if flat else "elevation [°]")
    assert axis.figure is not None
    bar = axis.figure.colorbar(drawn, ax=axis, shrink=0.9, pad=0.02)
    bar.set_label(label)
    bar.outline.set_linewidth(0.4)


def _quality(axis: Axes, image: xr.Dataset) -> None:
    """Draw which pixels are good, doubtful or unusable."""
    flag = image["quality_flag"].values
    state = np.where(flag == 0, 0, np.where((flag & UNUSABLE) == 0, 1, 2))
    axis.imshow(
        state,
        cmap=ListedColormap(list(_QUALITY.values())),
        vmin=0,
        vmax=2,
        interpolation="none",
    )
    axis.set_title("quality")
    axis.set_xlabel("column")
    axis.set_ylabel("row")
    patches = [
        Patch(facecolor=colour, edgecolor="#999999", linewidth=0.4, label=name)
        for name, colour in _QUALITY.items()
    ]
    axis.legend(
        handles=patches, loc="upper center", bbox_to_anchor=(0.5, -0.45), ncols=3
    )


_QUALITY = {"good": "#ffffff", "doubtful": "#E69F00", "no range": "#5d6f79"}

#: Fraction of the pixels on either side that limits may leave out [%].
_STRAY = 3.5


def _limits(values: Floats, margin: float = 0.0) -> tuple[float, float]:
    """Return limits that a few stray pixels do not stretch."""
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    low, high = np.percentile(finite, [_STRAY, 100 - _STRAY])
    room = max(high - low, 1e-9)
    return float(low - margin * room), float(high + margin * room)


def _even(values: Floats) -> tuple[float, float]:
    low, high = _limits(values)
    size = max(abs(low), abs(high), 1e-9)
    return -size, size


def _grid(image: xr.Dataset) -> tuple[Floats, Floats, Floats]:
    """Return x, y and height above the farthest plane over (row, column) [mm]."""
    cloud = point_cloud(image)
    shape = image["quality_flag"].shape
    place = (cloud["row"].values, cloud["column"].values)
    axes = []
    for name in "xyz":
        values = np.full(shape, np.nan)
        values[place] = cloud[name].values * 1e3
        axes.append(values)
    x, y, z = axes
    # Where there is no range the direction alone places the pixel, at mean distance.
    far = float(np.nanmedian(z)) if np.isfinite(z).any() else 0.0
    azimuth, elevation = image["azimuth"].values, image["elevation"].values
    x = np.where(np.isfinite(x), x, far * np.tan(azimuth))
    y = np.where(np.isfinite(y), y, -far * np.tan(elevation))
    deepest = np.nanpercentile(z, 98) if np.isfinite(z).any() else 0.0
    return x, y, deepest - z


def _heights(image: xr.Dataset) -> tuple[Floats, Floats]:
    x, _, height = _grid(image)
    return x, height


def _stage_colour(row: int) -> str:
    from amulor.view.style import COLOURS

    return COLOURS[(1, 0)[row % 2]]


def _shaded(height: Floats, low: float, high: float) -> NDArray[np.float64]:
    from matplotlib.colors import LightSource

    filled = np.where(np.isfinite(height), height, low)
    source = LightSource(azdeg=315, altdeg=50)
    scaled = np.clip((filled - low) / (high - low), 0, 1)
    colours = colormaps["viridis"](0.1 + 0.85 * scaled)
    light = source.hillshade(filled, vert_exag=0.06)
    shaded = colours.copy()
    shaded[..., :3] *= (0.55 + 0.45 * light)[..., None]
    shaded[~np.isfinite(height), 3] = 0.0
    return np.asarray(shaded, dtype=float)
