"""Opens a cube for the page: samples, target signals and range images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from amulor import cube as cubes
from amulor import rejection
from amulor.cube import without_groups
from amulor.errors import AmulorError, CubeError
from amulor.io import read_cube
from amulor.view.page.large import is_large, large_picture
from amulor.view.page.recording import Interval, Recording


def opened(
    path: Path, *, samples: Path | None = None, interval: Interval = None
) -> Recording:
    """Open a file for the page.

    Parameters
    ----------
    path : pathlib.Path
        Cube of level `samples`, `target_signal` or `range_image`.
    samples : pathlib.Path, optional
        Samples or target signal that a range image was made from; with them the page
        shows the picture before rejection, and spectra.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    Recording
        Pictures are made when they are asked for.

    Raises
    ------
    FormatError
        If a file is damaged or is none of these.
    CubeError
        If what it holds cannot be shown.
    """
    if is_large(path):
        return Recording(path.name, image=large_picture(path), interval=interval)
    cube = read_cube(path)
    if samples is None:
        return recording_of(cube, name=path.name, interval=interval)
    beside = read_cube(samples)
    return recording_of(cube, name=path.name, samples=beside, interval=interval)


def recording_of(
    cube: xr.Dataset,
    *,
    name: str = "cube",
    samples: xr.Dataset | None = None,
    interval: Interval = None,
) -> Recording:
    """Return a cube in memory as the page sees it.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, `target_signal` or `range_image`.
    name : str
        What the page calls it.
    samples : xarray.Dataset, optional
        Samples or target signal that a range image was made from.
    interval : tuple of float, optional
        Nearest and farthest slant range that are possible [m].

    Returns
    -------
    Recording
        Its pictures.

    Raises
    ------
    CubeError
        If the cube has another level, or the two are not of one scan.
    """
    level = str(cube.attrs.get("level"))
    if level == "range_image":
        found = Recording(name, image=cube, interval=interval)
        if samples is not None:
            own = ("row", "column")
            if any(samples.sizes.get(axis) != cube.sizes[axis] for axis in own):
                raise CubeError(
                    f"the samples have {dict(samples.sizes)}, {name} has "
                    f"{dict(cube.sizes)}; name the cube that the image was made from"
                )
            raw, target = _levels(samples, found.notes)
            return Recording(
                name, image=cube, target=target, samples=raw, interval=interval
            )
        return found
    if level not in ("samples", "target_signal"):
        raise CubeError(
            f"{name} is of level {level!r}; the page shows samples, target_signal and "
            "range_image"
        )
    notes: list[str] = []
    raw, target = _levels(cube, notes)
    return Recording(name, target=target, samples=raw, interval=interval, notes=notes)


def _levels(cube: xr.Dataset, notes: list[str]) -> tuple[xr.Dataset, xr.Dataset | None]:
    """Return samples with the water in them, and the target signal if there is one."""
    if cube.attrs["level"] == "target_signal":
        return _with_water(cube), cube
    if cube.amulor.open_water is None:
        notes.append(
            "No open-water shots in this file: the water is still in the ranges."
        )
        return cube, None
    try:
        return cube, _rejected(cube)
    except AmulorError as error:
        notes.append(f"The water could not be taken out: {error}.")
        return cube, None


def _rejected(cube: xr.Dataset) -> xr.Dataset:
    """Return samples less their open water, of a scan that goes on channel by channel.

    A target that one channel has not seen yet would count as none at all.
    """
    there = np.isfinite(cube["in_phase"].values).all(axis=0)
    if bool((there == there[:1]).all()):
        return rejection.open_water(cube)
    begun = [
        name
        for name, seen in zip(cube.amulor.polarizations, there, strict=True)
        if seen.any()
    ]
    parts = [rejection.open_water(cube.sel(polarization=[name])) for name in begun]
    return xr.concat(
        parts,
        dim="polarization",
        data_vars="minimal",
        coords="minimal",
        compat="override",
        join="override",
        combine_attrs="override",
    )


def _with_water(target: xr.Dataset) -> xr.Dataset:
    """Return the samples that a target signal was, water and target together."""
    names = [
        str(name)
        for name in cubes.LEVELS["samples"].variables
        if name in target and name not in ("in_phase", "quadrature")
    ]
    samples = without_groups(target)[names].assign(
        {
            name: (target[name] + target[f"water_{name}"]).assign_attrs(
                target[name].attrs
            )
            for name in ("in_phase", "quadrature")
        }
    )
    return samples.assign_attrs({**target.attrs, "level": "samples"})
