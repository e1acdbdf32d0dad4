"""Rejection and imaging as steps over the rows of a scan."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import xarray as xr

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor.cube import tiles
from amulor.errors import CubeError
from amulor.rejection.compare import JOINT_WITHOUT_SHOTS
from amulor.rejection.joint.estimate import prepared
from amulor.rejection.joint.tile import of_rows
from amulor.scale.tiled import OfRows, TiledStep, decided_once

__all__ = [
    "METHODS",
    "WITH_INTERVAL",
    "auto_step",
    "compared",
    "image_step",
    "reject_step",
]

#: Rows above and below a tile that marks of edges and outliers look at: seven, and one
#: more for a line that ends at the rim.
HALO = 8


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
    ranges = decided_once(partial(imaging.range_image, **options))
    flags = decided_once(
        lambda image: imaging.flag_outliers(imaging.flag_mixed(image)), spans=False
    )
    return replace(flags, of=ranges, halo=HALO)
