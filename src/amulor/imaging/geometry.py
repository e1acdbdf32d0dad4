"""Beams and media as a cube describes them."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from amulor.optics import rays


def medium_of(cube: xr.Dataset) -> rays.Medium:
    """Return what the light of a cube crosses, from its coordinate `geometry`."""
    geometry: dict[str, Any] = cube["geometry"].attrs
    names = (
        "window_distance",
        "window_thickness",
        "window_refractive_index",
        "window_group_index",
    )
    window = {name: float(geometry[name]) for name in names if name in geometry}
    return rays.Medium(
        refractive_index=float(geometry["refractive_index"]),
        group_index=float(geometry["group_index"]),
        **window,
    )


def beams_of(cube: xr.Dataset) -> rays.Beam:
    """Return the beam of every pixel as it travels in the water."""
    position = np.asarray(cube["geometry"].attrs["emitter_position"], dtype=float)
    starts = np.broadcast_to(position, (*cube["azimuth"].shape, 3)).copy()
    for axis, name in enumerate(("origin_x", "origin_y", "origin_z")):
        if name in cube.coords:
            starts[..., axis] = cube[name].values
    return rays.enter_water(
        starts,
        rays.direction(cube["azimuth"].values, cube["elevation"].values),
        medium=medium_of(cube),
    )


def receivers_of(cube: xr.Dataset) -> np.ndarray:
    """Return where the light of every pixel is collected [m]."""
    geometry = cube["geometry"].attrs
    receiver = np.asarray(geometry["receiver_position"], dtype=float)
    emitter = np.asarray(geometry["emitter_position"], dtype=float)
    places = np.broadcast_to(receiver, (*cube["azimuth"].shape, 3)).copy()
    for axis, name in enumerate(("origin_x", "origin_y", "origin_z")):
        if name in cube.coords:
            places[..., axis] += cube[name].values - emitter[axis]
    return places
