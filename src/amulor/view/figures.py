"""Figures of measurement cubes, range images, and water response curves."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from amulor.cube import error_unknown
from amulor.errors import FormatError
from amulor.imaging import point_cloud
from amulor.io.files import atomic_output
from amulor.view.maps import Map, draw_maps, quality_map, usual_limits
from amulor.view.style import (
    BRIGHTNESS_MAP,
    DIFFERENCE_MAP,
    DISTANCE_MAP,
    ERROR_MAP,
    new_figure,
    style,
)

Floats = NDArray[np.float64]


def signal_images(cube: xr.Dataset, *, frequency: int = 0) -> Figure:
    """Draw amplitude and phase of every channel at one modulation frequency.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples` or `target_signal`.
    frequency : int
        Index of the modulation frequency, from 0.

    Returns
    -------
    matplotlib.figure.Figure
        Two maps for each channel.

    Examples
    --------
    >>> from amulor import samples
    >>> from amulor.view import figures
    >>> drawn = figures.signal_images(samples.cube("ladder"))
    >>> len(drawn.axes)  # color bars included
    8
    """
    channels = [str(value) for value in cube["polarization"].values]
    amplitude = cube.amulor.amplitude.values[frequency]
    phase = cube.amulor.phase.values[frequency]
    maps = []
    for number, channel in enumerate(channels):
        # Around the mean direction, so that no wrap cuts through the picture.
        mean = np.angle(np.nansum(np.exp(1j * phase[number])))
        turned = np.angle(np.exp(1j * (phase[number] - mean)))
        maps += [
            Map(
                title=f"{channel}: amplitude",
                values=amplitude[number] * 1e3,
                label="mV",
                colours=BRIGHTNESS_MAP,
                limits=(0.0, float(np.nanmax(amplitude[number])) * 1e3),
            ),
            Map(
                title=f"{channel}: phase about its mean, {np.degrees(mean):.1f}°",
                values=np.degrees(turned),
                label="degrees",
                colours=DISTANCE_MAP,
            ),
        ]
    with style():
        return draw_maps([(cube, panel) for panel in maps])


def range_images(before: xr.Dataset, after: xr.Dataset) -> Figure:
    """Draw slant range before and after rejection, its change, and its uncertainty.

    Parameters
    ----------
    before, after : xarray.Dataset
        Range images (level `range_image`) of one scan.

    Returns
    -------
    matplotlib.figure.Figure
        Four panels; both ranges in the same colors.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> from amulor.view import figures
    >>> raw = rejection.keep_water(samples.cube("ladder"))
    >>> before = imaging.range_image(raw, polarization="VH")
    >>> drawn = figures.range_images(before, image)
    >>> len(drawn.axes)  # color bars included
    8
    """
    ranges = [image["slant_range"].values * 1e3 for image in (before, after)]
    limits = usual_limits(np.concatenate([values.ravel() for values in ranges]), 0.05)
    moved = ranges[0] - ranges[1]
    maps = [
        *(
            Map(
                title=f"slant range {name} rejection",
                values=values,
                label="mm",
                colours=DISTANCE_MAP,
                limits=limits,
            )
            for values, name in zip(ranges, ("before", "after"), strict=True)
        ),
        Map(
            title="uncertainty after rejection",
            values=after["slant_range_uncertainty"].values * 1e3,
            label="mm",
            colours=ERROR_MAP,
        ),
        Map(
            title="moved by rejection (before - after)",
            values=moved,
            label="mm",
            colours=DIFFERENCE_MAP,
            limits=_even(moved),
        ),
    ]
    with style():
        return draw_maps([(after, panel) for panel in maps])


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

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> from amulor.view import figures
    >>> drawn = figures.image_overview(image)
    >>> len(drawn.axes)  # color bars included
    8
    """
    panels = (
        ("slant range", "slant_range", "mm", DISTANCE_MAP),
        ("uncertainty", "slant_range_uncertainty", "mm", ERROR_MAP),
        ("brightness", "intensity", "mV", BRIGHTNESS_MAP),
    )
    titles = {"uncertainty": "uncertainty: not known"} if error_unknown(image) else {}
    maps = [
        Map(
            title=titles.get(title, title),
            values=image[name].values * 1e3,
            label=label,
            colours=colours,
        )
        for title, name, label, colours in panels
    ]
    with style():
        return draw_maps([(image, panel) for panel in (*maps, quality_map(image))])


def profiles(images: Mapping[str, Mapping[str, xr.Dataset]]) -> Figure:
    """Draw all rows of range images as superimposed line profiles.

    If there are too many rows to distinguish, the median and the bands with 68 % and
    95 % of the rows are drawn.

    Parameters
    ----------
    images : mapping
        Range images by case and stage, the stages "before" and "after".

    Returns
    -------
    matplotlib.figure.Figure
        One column for each case, one row for each stage.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> from amulor.view import figures
    >>> drawn = figures.profiles({"milk": {"before": image, "after": image}})
    >>> len(drawn.axes)
    2
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
                _rows_of(axis, across, height, _stage_colour(row))
                name = f"{case}, {stage}" if len(stages) > 1 else case
                axis.set_title(f"({letter}) {name}" if len(images) > 1 else name)
                axis.grid(lw=0.3, color="#dddddd")
        for axis in axes[-1]:
            axis.set_xlabel("right [mm]")
        for axis in axes[:, 0]:
            axis.set_ylabel("nearer [mm]")
        bounds = [_heights(by[stages[-1]])[1] for by in images.values()]
        axes[0, 0].set_ylim(
            usual_limits(np.concatenate([b.ravel() for b in bounds]), 0.5)
        )
    return figure


def surfaces(images: Mapping[str, xr.Dataset]) -> Figure:
    """Draw range images as shaded surfaces in three dimensions.

    Parameters
    ----------
    images : mapping
        Range images by title.

    Returns
    -------
    matplotlib.figure.Figure
        One panel per image, all with equal axes; near points are on top.

    Examples
    --------
    >>> from amulor import imaging, rejection, samples
    >>> target = rejection.cross_polarized(samples.cube("ladder"))
    >>> image = imaging.range_image(target)
    >>> from amulor.view import figures
    >>> drawn = figures.surfaces({"after": image})
    >>> [axis.get_title() for axis in drawn.axes if axis.get_title()]
    ['(a) after']
    """
    columns = 2 if len(images) > 1 else 1
    rows = -(-len(images) // columns)
    with style():
        figure = new_figure(3.6 * columns, 2.75 * rows)
        heights = [_grid(image)[2] for image in images.values()]
        low, high = usual_limits(np.concatenate([h.ravel() for h in heights]), 0.25)
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
            axis.tick_params(pad=-2, labelsize=7)
            axis.view_init(elev=30, azim=-72)
            spans = [np.ptp(x), max(np.ptp(y), 0.4 * np.ptp(x)), 0.6 * np.ptp(x)]
            axis.set_box_aspect(spans, zoom=0.92)
            # As many tick labels as fit on an axis of this length.
            for span, ruler in zip(
                spans, (axis.xaxis, axis.yaxis, axis.zaxis), strict=True
            ):
                room = int(7 * span / max(spans))
                ruler.set_major_locator(MaxNLocator(max(1, room)))
    return figure


#: More rows than these are drawn as a band [1].
_MOST_LINES = 60


def _even(values: Floats) -> tuple[float, float]:
    low, high = usual_limits(values)
    size = max(abs(low), abs(high), 1e-9)
    return -size, size


def _grid(image: xr.Dataset) -> tuple[Floats, Floats, Floats]:
    """Coordinates x, y and height above the far side (98 % quantile of z) [mm]."""
    cloud = point_cloud(image)
    shape = image["quality_flag"].shape
    place = (cloud["row"].values, cloud["column"].values)
    axes = []
    for name in "xyz":
        values = np.full(shape, np.nan)
        values[place] = cloud[name].values * 1e3
        axes.append(values)
    x, y, z = axes
    # A pixel without a range is placed by its direction, at the mean distance.
    far = float(np.nanmedian(z)) if np.isfinite(z).any() else 0.0
    azimuth, elevation = image["azimuth"].values, image["elevation"].values
    x = np.where(np.isfinite(x), x, far * np.tan(azimuth))
    y = np.where(np.isfinite(y), y, -far * np.tan(elevation))
    deepest = np.nanpercentile(z, 98) if np.isfinite(z).any() else 0.0
    return x, y, deepest - z


def _rows_of(axis: Axes, across: Floats, height: Floats, colour: str) -> None:
    """Draw the rows of a range image as lines; if there are many, as a band."""
    if len(height) <= _MOST_LINES:
        axis.plot(across.T, height.T, color=colour, lw=0.4, alpha=0.35)
        return
    covered = np.isfinite(height).sum(axis=0) > 0.02 * len(height)
    if not covered.any():
        return
    right = np.median(across[:, covered], axis=0)
    low, under, middle, over, high = np.nanquantile(
        height[:, covered], [0.025, 0.16, 0.5, 0.84, 0.975], axis=0
    )
    gap = np.flatnonzero(np.diff(np.flatnonzero(covered)) > 1) + 1
    right, low, under, middle, over, high = (
        np.insert(values, gap, np.nan)
        for values in (right, low, under, middle, over, high)
    )
    axis.fill_between(right, low, high, color=colour, alpha=0.18, lw=0)
    axis.fill_between(right, under, over, color=colour, alpha=0.35, lw=0)
    axis.plot(right, middle, color=colour, lw=0.8)


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


def response_curves(
    modulation_frequency: NDArray[np.float64],
    responses: Mapping[str, NDArray[np.complex128]],
    *,
    cut_off: float | None = None,
    errors: Mapping[str, NDArray[np.float64]] | None = None,
    title: str = "",
) -> Figure:
    """Draw relative amplitude and phase of the water signal against frequency.

    Parameters
    ----------
    modulation_frequency : ndarray
        Modulation frequencies, ascending [Hz].
    responses : mapping of str to ndarray
        Water signal at these frequencies divided by that at 0 Hz, by model [1].
    cut_off : float, optional
        Cut-off frequency, drawn as a point at half power [Hz].
    errors : mapping of str to ndarray, optional
        Half-width of the band of an amplitude, by model [1].
    title : str
        Text above the figure.

    Returns
    -------
    matplotlib.figure.Figure
        Amplitude above phase.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor.view import figures
    >>> frequency = np.linspace(0, 100e6, 5)
    >>> low_pass = 1 / (1 + 1j * frequency / 40e6)
    >>> drawn = figures.response_curves(frequency, {"low-pass": low_pass}, cut_off=40e6)
    >>> [axis.get_ylabel() for axis in drawn.axes]
    ['amplitude over that at 0 MHz', 'phase delay [degrees]']
    """
    with style():
        canvas = new_figure(4.8, 4.4)
        top, bottom = canvas.subplots(2, 1, sharex=True)
        for name, response in responses.items():
            (line,) = top.plot(modulation_frequency / 1e6, np.abs(response), label=name)
            if errors is not None and name in errors:
                top.fill_between(
                    modulation_frequency / 1e6,
                    np.abs(response) - errors[name],
                    np.abs(response) + errors[name],
                    color=line.get_color(),
                    alpha=0.3,
                    lw=0,
                )
            phase = np.degrees(np.unwrap(np.angle(response)))
            bottom.plot(modulation_frequency / 1e6, phase, label=name)
        if cut_off is not None:
            top.axhline(np.sqrt(0.5), color="#999999", lw=0.6, ls="--")
            top.plot(
                cut_off / 1e6,
                np.sqrt(0.5),
                "o",
                color="black",
                ms=4,
                label=f"cut-off {cut_off / 1e6:.1f} MHz",
            )
        top.set_ylim(0, 1.02)
        top.set_ylabel("amplitude over that at 0 MHz")
        top.legend()
        top.set_title(title)
        bottom.set_ylabel("phase delay [degrees]")
        bottom.set_xlabel("modulation frequency [MHz]")
        for axis in (top, bottom):
            axis.grid(True)
    return canvas


def write_response_curves(
    path: Path,
    modulation_frequency: NDArray[np.float64],
    responses: Mapping[str, NDArray[np.complex128]],
    *,
    overwrite: bool = False,
    **options: Any,
) -> None:
    """Write the figure made by `response_curves` as PNG or SVG.

    Parameters
    ----------
    path : pathlib.Path
        File to write, ending in .png or .svg.
    modulation_frequency : ndarray
        Modulation frequencies, ascending [Hz].
    responses : mapping of str to ndarray
        Water signal at these frequencies divided by that at 0 Hz, by model [1].
    overwrite : bool
        Whether an existing file is replaced.
    **options
        Further arguments of `response_curves`.

    Raises
    ------
    FormatError
        If the file has another suffix, or exists.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("png", "svg"):
        raise FormatError(f"{path}: pictures are written as .png or .svg; rename it")
    canvas = response_curves(modulation_frequency, responses, **options)
    with atomic_output(path, overwrite=overwrite) as temporary, style():
        canvas.savefig(temporary, format=kind, dpi=160)
