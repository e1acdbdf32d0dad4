"""Residuals of a site: distances of each scan pair, and histograms of test values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import norm

from amulor.site.registration.pair import compared
from amulor.site.registration.reliability import Reliability
from amulor.site.registration.result import Registration
from amulor.site.registration.surface import ScanSurface
from amulor.view.style import COLOURS, DIFFERENCE_MAP, MISSING_COLOUR, new_figure

Floats = NDArray[np.float64]

#: Cells of a map along its longer side [1].
_CELLS = 32
#: Largest number of maps in the figure, and maps in a row [1].
MOST_MAPS, _IN_ROW = 12, 4
#: Largest amount of a standardized residual in a histogram [1].
_LIMIT = 5.0


@dataclass(frozen=True, kw_only=True)
class PairResiduals:
    """Distances of the points of one scan from the surface of another."""

    source: str
    """Scan whose points are compared."""
    target: str
    """Scan whose surface the points are compared with."""
    shape: tuple[int, int]
    """Rows and columns of the source."""
    pixel: NDArray[np.intp]
    """Numbers of the pixels of the compared points, row by row, shape (n,)."""
    distance: Floats
    """Distances along the beams of the target, shape (n,) [m]."""
    score: Floats
    """Distances over their stated noise, shape (n,) [1]."""

    @property
    def scatter(self) -> float:
        """Root mean square of the distances over their stated noise [1]."""
        return float(np.sqrt(np.mean(self.score**2)))


def pair_residuals(
    registration: Registration, surfaces: Mapping[str, ScanSurface]
) -> tuple[PairResiduals, ...]:
    """Compute the residuals of all scan pairs at final poses, largest scatter first.

    Points on moved objects and other surfaces are left out.
    """
    residuals = []
    for names in registration.pairs:
        source, target = names["source"], names["target"]
        if source not in surfaces or target not in surfaces:
            continue
        pair = compared(
            surfaces[source],
            surfaces[target],
            (registration.poses[source], registration.poses[target]),
            gate=None,
            errors=registration.errors,
        )
        if pair is None:
            continue
        used = pair.weight > 0
        noise = [np.nan_to_num(surfaces[name].own.ravel()) for name in (source, target)]
        variance = (pair.along * noise[0][pair.source_pixel]) ** 2
        variance += pair.window.power(2) @ noise[1] ** 2
        residuals.append(
            PairResiduals(
                source=source,
                target=target,
                shape=surfaces[source].own.shape,
                pixel=pair.source_pixel[used],
                distance=pair.distance[used],
                score=pair.distance[used] / np.sqrt(variance[used]),
            )
        )
    return tuple(sorted(residuals, key=lambda pair: -pair.scatter))


def cell_means(pair: PairResiduals) -> tuple[Floats, int]:
    """Return mean distances over square cells of pixels [m], and the side of a cell."""
    side = max(-(-max(pair.shape) // _CELLS), 1)
    rows, columns = (-(-length // side) for length in pair.shape)
    row, column = np.divmod(pair.pixel, pair.shape[1])
    cell = row // side * columns + column // side
    count = np.bincount(cell, minlength=rows * columns)
    total = np.bincount(cell, weights=pair.distance, minlength=rows * columns)
    with np.errstate(invalid="ignore"):
        return (total / count).reshape(rows, columns), side


def residual_maps(residuals: Sequence[PairResiduals]) -> Figure:
    """Draw maps of the mean distances of scan pairs over the pixels of the source."""
    some = residuals[:MOST_MAPS]
    means = [cell_means(pair) for pair in some]
    limit = 1e3 * float(
        np.nanquantile(np.abs(np.concatenate([values.ravel() for values, _ in means])),
                       0.98)
    )  # fmt: skip
    lines = -(-len(some) // _IN_ROW)
    # Each panel is 1.35 in wide, beside the color bar.
    high = max(float(np.clip(pair.shape[0] / pair.shape[1], 0.3, 2.0)) for pair in some)
    figure = new_figure(7.0, (1.35 * high + 0.4) * lines + 0.2)
    panels = figure.subplots(lines, _IN_ROW, squeeze=False)
    for axes in panels.flat[len(some) :]:
        axes.set_visible(False)
    for axes, pair, (values, side) in zip(panels.flat, some, means, strict=False):
        rows, columns = values.shape
        image = axes.imshow(
            values * 1e3, cmap=DIFFERENCE_MAP, vmin=-limit, vmax=limit,
            interpolation="nearest",
            extent=(-0.5, columns * side - 0.5, rows * side - 0.5, -0.5),
        )  # fmt: skip
        axes.set_facecolor(MISSING_COLOUR)
        axes.set_title(f"{pair.source} on {pair.target}: {pair.scatter:.2f}")
        axes.set_xlim(-0.5, pair.shape[1] - 0.5)
        axes.set_ylim(pair.shape[0] - 0.5, -0.5)
    for axes in panels[:, 0]:
        axes.set_ylabel("row")
    for axes in panels.flat[max(len(some) - _IN_ROW, 0) : len(some)]:
        axes.set_xlabel("column")
    figure.colorbar(
        image,
        ax=panels,
        label="mean distance [mm]",
        extend="both",
        aspect=25,
        pad=0.02,
    )
    return figure


def residual_histograms(
    residuals: Sequence[PairResiduals], reliability: Sequence[Reliability]
) -> Figure:
    """Draw histograms of the standardized residuals of points and of stated values."""
    figure = new_figure(7.0, 2.7)
    points, values = figure.subplots(1, 2)
    scores = [pair.score for pair in residuals]
    _histogram(points, np.concatenate(scores) if scores else np.zeros(0), bins=50)
    points.set_xlabel("distance over its stated noise")
    points.set_ylabel("points of all pairs")
    checked = [line.score for line in reliability if line.detectable is not None]
    _histogram(values, np.array(checked), bins=20)
    values.set_xlabel("standardized residual w")
    values.set_ylabel("stated values")
    return figure


def _histogram(axes: Axes, scores: Floats, *, bins: int) -> None:
    """Draw the histogram of standardized residuals, and their normal distribution."""
    edges = np.linspace(-_LIMIT, _LIMIT, bins + 1)
    axes.hist(
        np.clip(scores, -_LIMIT, _LIMIT), bins=list(edges), color=COLOURS[5],
        label=f"{len(scores):,} residuals",
    )  # fmt: skip
    step = np.linspace(-_LIMIT, _LIMIT, 201)
    width = edges[1] - edges[0]
    axes.plot(
        step, len(scores) * width * norm.pdf(step), color=COLOURS[6],
        label="normal distribution",
    )  # fmt: skip
    axes.set_xlim(-_LIMIT, _LIMIT)
    axes.set_ylim(top=1.35 * axes.get_ylim()[1])
    axes.legend(loc="upper right")
