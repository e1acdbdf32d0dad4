"""Stations, outlines and targets over the plan of a site, on sheets and in reports."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from amulor.site.description import Site
from amulor.site.merging import plan
from amulor.site.merging.plan import PlacedScan
from amulor.site.registration.result import Registration, relative_covariance
from amulor.view.sheet import Annotations, Station, annotate, extent_of, relief
from amulor.view.style import COLOURS, new_figure

Floats = NDArray[np.float64]
Window = tuple[float, float, float, float]

#: Colors of visits; contours have another one.
_VISITS = tuple(colour for colour in COLOURS if colour != "#D55E00")
#: Cells across a plan in a report, and its largest error ellipse, of its size [1].
_ACROSS, _ELLIPSE = 400, 0.04


def visit_colours(site: Site) -> dict[str, str]:
    """Return the color of each visit by name."""
    names = [visit.name for visit in site.epoch]
    return {name: _VISITS[number % len(_VISITS)] for number, name in enumerate(names)}


def annotations_of(
    site: Site,
    registration: Registration,
    scans: Sequence[PlacedScan],
    *,
    largest: float,
    outlines: Mapping[str, Sequence[Floats]] | None = None,
    window: Window | None = None,
    cuts: Mapping[str, Floats] | None = None,
) -> Annotations:
    """Return stations with error ellipses, outlines, targets and section lines.

    The ellipses are enlarged by a round factor, so that the largest semi-axis is at
    most `largest` [m]. With a window, stations and targets outside of it are left out.
    """
    first = site.scan[0].name
    spreads = {
        scan.name: relative_covariance(registration, scan.name, first)[:2, :2]
        for scan in scans
    }
    widest = max(
        math.sqrt(max(float(np.linalg.eigvalsh(spread)[-1]), 0.0))
        for spread in spreads.values()
    )
    colours = visit_colours(site)
    positions = {s.name: registration.poses[s.name].position[:2] for s in scans}
    points = {name: np.asarray(p)[:2] for name, p in registration.points.items()}
    return Annotations(
        outlines=[
            (colours[scan.epoch], outlines[scan.name])
            for scan in scans
            if outlines is not None
        ],
        stations={
            scan.name: Station(
                position=positions[scan.name],
                covariance=spreads[scan.name],
                colour=colours[scan.epoch],
            )
            for scan in scans
            if _inside(positions[scan.name], window)
        },
        enlarged=_rounded_down(largest / max(widest, 1e-9)),
        targets={name: at for name, at in points.items() if _inside(at, window)},
        cuts=cuts or {},
    )


def plan_figure(
    site: Site, registration: Registration, scans: Sequence[PlacedScan]
) -> tuple[Figure, float]:
    """Return a shaded plan of the last visit with all stations, and the ellipse factor.

    Returns the figure, and the factor by which the error ellipses are enlarged.
    """
    visit = [scan for scan in scans if scan.epoch == site.epoch[-1].name]
    west, east, south, north = plan.bounds(visit)
    size = max(east - west, north - south)
    raster = plan.orthoplan(visit, cell=size / _ACROSS)
    annotations = annotations_of(site, registration, scans, largest=_ELLIPSE * size)
    figure = new_figure(7.0, 6.4)
    axis = figure.add_subplot()
    axis.imshow(relief(raster), extent=extent_of(raster))
    places = [annotations.stations[name].position for name in annotations.stations]
    axis.update_datalim([*places, *annotations.targets.values()])
    axis.autoscale_view()
    label_plan(axis)
    annotate(axis, annotations)
    for name, colour in visit_colours(site).items():
        axis.plot([], [], "+", color=colour, label=name)
    axis.legend(loc="upper right", frameon=True)
    return figure, annotations.enlarged


def label_plan(axes: Axes) -> None:
    """Label the axes of a plan, with all digits of its coordinates."""
    axes.set_aspect("equal")
    axes.set_xlabel("east [m]")
    axes.set_ylabel("north [m]")
    with_all_digits(axes)


def with_all_digits(axes: Axes) -> None:
    """Print coordinates such as 512345.2 without a common offset, and few of them."""
    axes.ticklabel_format(useOffset=False, style="plain")
    axes.locator_params(axis="x", nbins=5)


def _inside(place: Floats, window: Window | None) -> bool:
    if window is None:
        return True
    west, east, south, north = window
    return bool(west <= place[0] <= east and south <= place[1] <= north)


def _rounded_down(value: float) -> float:
    """Round down to the series 1, 2, 5, 10, ...; 1 for smaller values."""
    if value < 1:
        return 1.0
    power = 10.0 ** math.floor(math.log10(value))
    return max(step for step in (1, 2, 5) if step * power <= value) * power
