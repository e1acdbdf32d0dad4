"""Figures of an instrument design: error map, Pareto fronts, sensitivity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from numpy.typing import ArrayLike, NDArray

from amulor.design.trade import front, knee
from amulor.view.style import COLOURS, ERROR_MAP, new_figure, style

Floats = NDArray[np.float64]

#: Total errors with a contour line [mm].
CONTOURS = (1.0, 3.0, 10.0)
#: Regions where a range must not be trusted: flag, label and hatch pattern.
REGIONS = (
    ("ambiguous", "ambiguous", "///"),
    ("saturated", "detector saturated", "..."),
    ("model_not_valid", "model not valid", "xxx"),
)
_LIMITS = (0.1, 100.0)


def error_map(
    found: xr.Dataset,
    *,
    asked: Sequence[tuple[float, float]] = (),
    title: str = "",
) -> Figure:
    """Draw the total range error against distance and attenuation."""
    with style():
        figure = new_figure(5.6, 3.9)
        axes = figure.add_subplot()
        mesh = _mapped(axes, found)
        bar = figure.colorbar(mesh, ax=axes, label="total error [mm]", extend="both")
        bar.ax.yaxis.set_major_formatter(FuncFormatter(_plain))
        _rings(axes, asked)
        _legend(axes, found, bool(asked))
        axes.set_xlabel("distance [m]")
        axes.set_ylabel("attenuation [1/m]")
        axes.set_title(title)
    return figure


def error_maps(
    found: Mapping[str, xr.Dataset], *, asked: Sequence[tuple[float, float]] = ()
) -> Figure:
    """Draw several error maps side by side on one color scale."""
    with style():
        figure = new_figure(1.2 + 2.5 * len(found), 3.1)
        panels = figure.subplots(1, len(found), sharey=True, squeeze=False)[0]
        for axes, (title, errors) in zip(panels, found.items(), strict=True):
            mesh = _mapped(axes, errors)
            _rings(axes, asked)
            axes.set_xlabel("distance [m]")
            axes.set_title(title)
        panels[0].set_ylabel("attenuation [1/m]")
        bar = figure.colorbar(
            mesh, ax=list(panels), label="total error [mm]", extend="both"
        )
        bar.ax.yaxis.set_major_formatter(FuncFormatter(_plain))
        handles: list[Artist] = list(panels[0].get_legend_handles_labels()[0])
        handles += _hatched(list(found.values()))
        if handles:
            figure.legend(
                handles=handles, loc="outside lower center", ncols=4,
                handlelength=2.2, handleheight=1.2,
            )  # fmt: skip
    return figure


def _rings(axes: Axes, places: Sequence[tuple[float, float]]) -> None:
    if not places:
        return
    distance, attenuation = zip(*places, strict=True)
    axes.plot(
        distance, attenuation, "o", color="white", markeredgecolor="black",
        markersize=4.5, zorder=5, label="asked for",
    )  # fmt: skip


def _hatched(maps: Sequence[xr.Dataset]) -> list[Patch]:
    """Legend entries for the hatched regions of error maps."""
    return [
        Patch(facecolor="#7c7b78", edgecolor="white", hatch=hatch, label=text)
        for name, text, hatch in REGIONS
        if any(bool(errors[name].any()) for errors in maps)
    ]


def _mapped(axes: Axes, errors: xr.Dataset) -> Any:
    errors = errors.transpose("attenuation", "distance")
    x, y = errors["distance"].values, errors["attenuation"].values
    error = errors["total_error"].values * 1e3
    clipped = np.clip(np.where(np.isfinite(error), error, np.nan), 1e-6, 1e9)
    mesh = axes.pcolormesh(
        x, y, clipped, cmap=ERROR_MAP, norm=LogNorm(*_LIMITS), shading="nearest",
        rasterized=True,
    )  # fmt: skip
    lines = [
        level for level in CONTOURS if np.nanmin(clipped) < level < np.nanmax(clipped)
    ]
    if lines:
        drawn_lines = axes.contour(x, y, np.log(clipped), np.log(lines), colors="white")
        edge: list[AbstractPathEffect] = [
            withStroke(linewidth=2.2, foreground="#0b1c26b0")
        ]
        drawn_lines.set_path_effects(edge)
        texts = axes.clabel(
            drawn_lines,
            fmt={np.log(level): f"{level:g} mm" for level in lines},
            fontsize=7,
        )
        for text in texts:
            text.set_path_effects(edge)
    for name, _, hatch in REGIONS:
        region = errors[name].values.astype(float)
        if region.any() and min(region.shape) > 1:
            axes.contourf(
                x, y, region, [0.5, 1.5], colors="none", hatches=[hatch]
            ).set_edgecolor((1, 1, 1, 0.75))
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(y[0], y[-1])
    if y[0] > 0 and y[-1] / y[0] >= 8:
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(_plain))
        axes.yaxis.set_minor_formatter(NullFormatter())
    return mesh


def _legend(axes: Axes, errors: xr.Dataset, has_places: bool) -> None:
    hatches = _hatched([errors])
    lines = axes.get_legend_handles_labels()[0] if has_places else []
    if hatches or lines:
        axes.legend(
            handles=[*lines, *hatches], loc="upper center", bbox_to_anchor=(0.5, -0.14),
            ncols=4, handlelength=2.2, handleheight=1.2,
        )  # fmt: skip


def fronts(
    error: ArrayLike,
    *,
    scan_time: ArrayLike,
    top_frequency: ArrayLike,
    best: int,
    target: float | None = None,
) -> Figure:
    """Draw the range error of candidates against scan time and highest frequency."""
    error = np.asarray(error, dtype=float)
    with style():
        figure = new_figure(7.0, 3.0)
        panels = figure.subplots(1, 2, sharey=True)
        costs = (
            ("time of a scan [min]", np.asarray(scan_time, dtype=float) / 60),
            ("highest frequency [MHz]", np.asarray(top_frequency, dtype=float) / 1e6),
        )
        for axes, (label, cost) in zip(panels, costs, strict=True):
            _front(axes, cost, error * 1e3, best)
            if target is not None:
                axes.axhline(target * 1e3, color=COLOURS[3], lw=0.8, ls="--")
                axes.annotate(
                    "asked for", (1, target * 1e3), xycoords=("axes fraction", "data"),
                    xytext=(0, 2), textcoords="offset points", ha="right", fontsize=7,
                    color=COLOURS[3],
                )  # fmt: skip
            axes.set_xlabel(label)
        panels[0].set_ylabel("total error [mm]")
        figure.legend(
            *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4
        )
    return figure


def _front(axes: Axes, cost: Floats, error: Floats, best: int) -> None:
    usable = np.isfinite(error) & (error > 0) & np.isfinite(cost)
    axes.plot(
        cost[usable], error[usable], ".", color="#b9c6cd", markersize=2.5,
        label="candidates", rasterized=True,
    )  # fmt: skip
    order = front(cost, error)
    axes.plot(
        cost[order], error[order], "-", drawstyle="steps-post", color=COLOURS[0],
        label="best that there is",
    )  # fmt: skip
    at = knee(cost[order], error[order])
    if at is not None:
        axes.plot(
            cost[order[at]], error[order[at]], "D", color=COLOURS[4], markersize=5,
            label="knee",
        )  # fmt: skip
    axes.plot(
        cost[best], error[best], "*", color=COLOURS[1], markersize=10,
        label="recommended",
    )  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    for ruler in (axes.xaxis, axes.yaxis):
        ruler.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        ruler.set_major_formatter(FuncFormatter(_plain))
        ruler.set_minor_formatter(NullFormatter())
    usable_errors = error[usable]
    if usable_errors.size:
        low = min(float(usable_errors.min()), float(error[best]))
        axes.set_ylim(low / 1.6, min(float(usable_errors.max()) * 1.6, low * 3e3))
    axes.grid(True)


def sensitivity_bars(
    names: Sequence[str], shares: ArrayLike, errors: ArrayLike
) -> Figure:
    """Draw the total Sobol indices of the range error as bars."""
    shares, errors = np.asarray(shares, dtype=float), np.asarray(errors, dtype=float)
    order = np.argsort(shares)
    with style():
        figure = new_figure(5.6, 0.7 + 0.24 * len(order))
        axes = figure.add_subplot()
        axes.barh(
            range(len(order)), shares[order], xerr=errors[order], color=COLOURS[5],
            error_kw={"elinewidth": 0.8, "capsize": 2},
        )  # fmt: skip
        axes.set_yticks(range(len(order)), [names[number] for number in order])
        axes.set_xlim(0, max(1.0, float(np.max(shares + errors)) * 1.05))
        axes.set_xlabel("share of the variance of the error, alone and with others [1]")
        axes.grid(True, axis="x")
        axes.set_axisbelow(True)
    return figure


def _plain(value: float, _: object = None) -> str:
    return f"{value:g}"
