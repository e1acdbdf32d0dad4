"""Steps by row tiles: what all pixels share is decided once, then tile follows tile."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor._decisions import Decisions, deciding, told
from amulor._progress import tell
from amulor.cube import tiles
from amulor.errors import CubeError
from amulor.rejection.compare import JOINT_WITHOUT_SHOTS
from amulor.rejection.joint.estimate import prepared
from amulor.rejection.joint.tile import of_rows

__all__ = [
    "METHODS",
    "WITH_INTERVAL",
    "TiledStep",
    "auto_step",
    "compared",
    "image_step",
    "reject_step",
    "run_step",
]

#: Rows above and below a tile that marks of edges and outliers look at: seven, and one
#: more for a line that ends at the rim.
HALO = 8

Step = Callable[[xr.Dataset], xr.Dataset]
#: From a tile with its halo, and the row of the scan at which it begins.
OfRows = Callable[[xr.Dataset, int], xr.Dataset]


@dataclass(frozen=True, kw_only=True)
class TiledStep:
    """A step that works on any rows of a scan once it knows what all of them share."""

    prepare: Callable[[tiles.Source], OfRows]
    """From the scan to what treats rows of it."""
    halo: int = 0
    """Rows above and below a tile that its pixels look at."""


def run_step(
    step: TiledStep, source: tiles.Source, *, rows: int | None = None
) -> Iterator[tuple[int, xr.Dataset]]:
    """Run a step tile by tile.

    Parameters
    ----------
    step : TiledStep
        What is done.
    source : Source
        Where the rows come from.
    rows : int, optional
        Rows of a tile; by default as many as `amulor.cube.tiles.bands` takes.

    Yields
    ------
    tuple of int and xarray.Dataset
        The first row of a tile, and the tile; the same rows for whatever tiles.

    Raises
    ------
    AmulorError, ValueError
        As the step.
    """
    if rows is not None and rows < 1:
        raise ValueError(f"a tile has 1 row at least, got {rows}")
    tell("what all pixels share", 0.0)
    of = step.prepare(source)
    for begin, end in tiles.bands(source, rows):
        tell(f"row {begin:,} of {source.rows:,}", begin / source.rows)
        first = max(begin - step.halo, 0)
        wide = source.tile(first, min(end + step.halo, source.rows))
        made = of(wide, first)
        yield begin, made.isel(row=slice(begin - first, end - first))


def decided_once(function: Step) -> TiledStep:
    """Return a step whose looks at all pixels are looks at a sample of the scan.

    Parameters
    ----------
    function : callable
        From a cube to another one; what it decides from all pixels it asks
        `amulor._decisions.decided` for.

    Returns
    -------
    TiledStep
        The same for whatever rows come together.
    """

    def prepare(source: tiles.Source) -> OfRows:
        decisions = Decisions(**_spans(source))
        with deciding(decisions):
            function(cubes.without_groups(tiles.sample_of(source), "truth"))

        def of(tile: xr.Dataset, first: int) -> xr.Dataset:
            with told(decisions):
                return function(tile)

        return of

    return TiledStep(prepare=prepare)


def _spans(source: tiles.Source) -> dict[str, tuple[float, float]]:
    """Return the ends of the directions of a scan, under the names of decisions."""
    ends: dict[str, list[float]] = {"azimuth": [], "elevation": []}
    for begin, end in tiles.bands(source):
        tile = source.tile(begin, end)
        for name, values in ends.items():
            angle = tile[name].values
            values += [float(np.min(angle)), float(np.max(angle))]
    return {f"span_of_{name}": (min(v), max(v)) for name, v in ends.items()}


def _joint_step(**options: Any) -> TiledStep:
    def prepare(source: tiles.Source) -> OfRows:
        common = prepared(source, **options)
        return lambda tile, first: of_rows(tile, common, first)

    return TiledStep(prepare=prepare)


#: Methods of rejection that work in tiles, by their names on the command line.
METHODS: dict[str, Callable[..., xr.Dataset]] = {
    "open-water": rejection.open_water,
    "frequency": rejection.frequency,
    "combined": rejection.combined,
    "polarization": rejection.unmix,
    "unmix": rejection.unmix,
    "cross-polarized": rejection.cross_polarized,
    "co-polarized": rejection.co_polarized,
    "none": rejection.keep_water,
}


#: Those that are told which slant ranges are possible.
WITH_INTERVAL = ("open-water", "frequency", "combined", "joint")


def reject_step(method: str, **options: Any) -> TiledStep:
    """Return a method of rejection that works in tiles.

    Parameters
    ----------
    method : str
        A key of `METHODS`, or "joint".
    **options
        Arguments of the method.

    Returns
    -------
    TiledStep
        From samples to the target signal.

    Raises
    ------
    CubeError
        If the method needs the whole scan.
    """
    if method == "joint":
        return _joint_step(**options)
    if method not in METHODS:
        known = ", ".join([*METHODS, "joint"])
        raise CubeError(
            f"the method {method} needs the whole scan in memory; by rows work {known}"
        )
    return decided_once(partial(METHODS[method], **options))


def compared(
    source: tiles.Source, *, interval: tuple[float, float] | None = None
) -> rejection.Comparison:
    """Compare all methods of rejection on a sample of a scan.

    Parameters
    ----------
    source : Source
        Samples.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    Comparison
        As `amulor.rejection.compare`, of the whole scan if it has up to
        `amulor.cube.tiles.SAMPLE` pixels.

    Raises
    ------
    CubeError
        If no method can use a single pixel.
    """
    sample = cubes.without_groups(tiles.sample_of(source), "truth")
    return rejection.compare(sample, interval=interval)


def auto_step(
    comparison: rejection.Comparison, *, interval: tuple[float, float] | None = None
) -> TiledStep:
    """Return the method that a comparison recommends, with its best channel.

    Parameters
    ----------
    comparison : Comparison
        From `compared`.
    interval : tuple of float, optional
        The same as there [m].

    Returns
    -------
    TiledStep
        As `amulor.rejection.auto` does it.
    """
    bare = comparison.method == JOINT_WITHOUT_SHOTS
    method = "joint" if bare else comparison.method
    step = reject_step(
        method, **({"interval": interval} if method in WITH_INTERVAL else {})
    )

    def seen(cube: xr.Dataset) -> xr.Dataset:
        return cubes.without_groups(cube, "open_water") if bare else cube

    def prepare(source: tiles.Source) -> OfRows:
        of = step.prepare(tiles.Changed(source, seen) if bare else source)

        def chosen(tile: xr.Dataset, first: int) -> xr.Dataset:
            made = of(seen(tile), first)
            made = made.sel(polarization=[comparison.polarization])
            return made.assign_attrs(
                rejection_method=comparison.method, rejection_reason=comparison.reason
            )

        return chosen

    return TiledStep(prepare=prepare)


def image_step(**options: Any) -> TiledStep:
    """Return the step to a range image, with its edges and outliers marked.

    Parameters
    ----------
    **options
        Arguments of `amulor.imaging.range_image`.

    Returns
    -------
    TiledStep
        From the target signal to the range image.
    """

    def image(cube: xr.Dataset) -> xr.Dataset:
        found = imaging.range_image(cube, **options)
        return imaging.flag_outliers(imaging.flag_mixed(found))

    return TiledStep(prepare=decided_once(image).prepare, halo=HALO)
