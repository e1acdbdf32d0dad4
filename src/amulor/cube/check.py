"""Checks of a dataset against the schema of its level."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from amulor.cube import accessor, schema
from amulor.cube.values import (
    check_errors,
    check_limits,
    check_pairs,
    check_values,
    restore_dimensions,
)
from amulor.errors import CubeError
from amulor.optics.polarization import stokes

# Prefix of variables that a caller may add to a cube.
_FREE_PREFIX = "user_"


def checked(
    cube: xr.Dataset, level: str | None = None, *, name: str = "the cube"
) -> xr.Dataset:
    """Return a cube with restored dimensions; raise unless it conforms to its schema.

    Every processing step calls it first.

    Parameters
    ----------
    cube : xarray.Dataset
        Cube as for `check`. Dimensions that the selection of a single value removed,
        such as `cube.sel(polarization="VV")`, may be missing.
    level : str, optional
        Required level.
    name : str
        Name of the cube in messages.

    Returns
    -------
    xarray.Dataset
        Cube with all its dimensions; see `restore_dimensions`.

    Raises
    ------
    CubeError
        As `check`.

    Examples
    --------
    >>> from amulor import cube as cubes, samples
    >>> crossed = samples.cube("ladder").sel(polarization="VH")
    >>> cubes.checked(crossed, "samples").sizes["polarization"]
    1
    """
    restored = restore_dimensions(cube)
    check(restored, level, name=name)
    return restored


def check(
    cube: xr.Dataset, level: str | None = None, *, name: str = "the cube"
) -> None:
    """Raise unless a dataset conforms to the schema of its level.

    Parameters
    ----------
    cube : xarray.Dataset
        Dataset to check; its attribute `level` states the level.
    level : str, optional
        Required level; by default any level.
    name : str
        Name of the cube in messages, such as its file.

    Raises
    ------
    CubeError
        If a variable, coordinate or attribute is missing, has the wrong shape or unit,
        or is not finite. The message names the first one, and a remedy.

    Examples
    --------
    >>> from amulor import cube as cubes, samples
    >>> from amulor.errors import CubeError
    >>> cube = samples.cube("ladder")
    >>> cubes.check(cube, "samples")  # nothing is wrong
    >>> try:
    ...     cubes.check(cube.drop_vars("in_phase"), "samples")
    ... except CubeError as error:
    ...     print(str(error)[:40])
    the cube: variable 'in_phase' is missing
    """
    actual = cube.attrs.get("level")
    if actual not in schema.LEVELS:
        raise CubeError(
            f"{name}: attribute 'level' is {actual!r}, but must be one of "
            f"{', '.join(schema.LEVELS)}; is this a file of amulor?"
        )
    if level is not None and actual != level:
        raise CubeError(
            f"{name}: is of level {actual}, but level {level} is needed here; "
            f"{_how_to_reach(actual, level)}"
        )
    version = str(cube.attrs.get("amulor_schema_version"))
    if version != schema.SCHEMA_VERSION:
        raise CubeError(
            f"{name}: attribute 'amulor_schema_version' is {version!r}, this amulor "
            f"reads {schema.SCHEMA_VERSION!r}; use the amulor that wrote the file"
        )
    expected = schema.LEVELS[actual]
    _check_names(cube, expected, name=name)
    for coordinate, spec in expected.coordinates.items():
        _check_variable(cube.coords, coordinate, spec, name=name, kind="coordinate")
    for variable, spec in expected.variables.items():
        _check_variable(cube.data_vars, variable, spec, name=name, kind="variable")
    _check_coordinates(cube, name=name)
    variables = {
        variable: cube[variable]
        for variable in map(str, cube.data_vars)
        if variable in expected.variables
    }
    check_values(variables, name=name)
    if actual == "samples":
        check_errors(variables, name=name)
    check_limits(cube, name=name)
    _check_open_water(cube, name=name)


_STEPS = ["samples", "target_signal", "range_image", "point_cloud"]
_COMMANDS = {
    "target_signal": "amulor reject",
    "range_image": "amulor image",
    "point_cloud": "amulor export",
}


def _how_to_reach(actual: str, level: str) -> str:
    first, last = _STEPS.index(actual), _STEPS.index(level)
    if first > last:
        return f"take the {level} file that it was made from"
    commands = [_COMMANDS[step] for step in _STEPS[first + 1 : last + 1]]
    return f"make it with: {', then '.join(commands)}"


def _check_names(cube: xr.Dataset, expected: schema.Level, *, name: str) -> None:
    prefixes = (*(f"{group}_" for group in schema.GROUPS), _FREE_PREFIX)
    for variable in map(str, cube.data_vars):
        if variable not in expected.variables and not variable.startswith(prefixes):
            raise CubeError(
                f"{name}: variable '{variable}' has no place in a {expected.name}; "
                f"drop it, or rename it to '{_FREE_PREFIX}{variable}'"
            )


def _check_variable(
    container: Mapping[Any, xr.DataArray],
    variable: str,
    spec: schema.Variable,
    *,
    name: str,
    kind: str,
) -> None:
    if variable not in container:
        if spec.required:
            raise CubeError(
                f"{name}: {kind} '{variable}' is missing; needed is "
                f"{spec.long_name} [{spec.units}] over ({', '.join(spec.dimensions)})"
            )
        return
    values = container[variable]
    if values.dims != spec.dimensions:
        raise CubeError(
            f"{name}: {kind} '{variable}' has dimensions {_listed(values.dims)}, "
            f"needed are {_listed(spec.dimensions)}; transpose or rebuild it"
        )
    if values.attrs.get("units") != spec.units:
        raise CubeError(
            f"{name}: {kind} '{variable}' has units {values.attrs.get('units')!r}, "
            f"needed is {spec.units!r}; convert the values and set the attribute"
        )
    if not values.attrs.get("long_name"):
        raise CubeError(
            f"{name}: {kind} '{variable}' lacks the attribute 'long_name'; "
            f"write what it is, for example {spec.long_name!r}"
        )
    if variable != "polarization" and values.dtype.kind not in "fiub":
        raise CubeError(
            f"{name}: {kind} '{variable}' holds {values.dtype}, needed are numbers"
        )


def _listed(names: tuple[Any, ...]) -> str:
    return "(" + ", ".join(map(str, names)) + ")"


def _check_coordinates(cube: xr.Dataset, *, name: str) -> None:
    if "modulation_frequency" in cube.coords:
        frequency = cube["modulation_frequency"].values
        if frequency.size == 0:
            raise CubeError(
                f"{name}: coordinate 'modulation_frequency' is empty; select at least "
                "one frequency"
            )
        if not (np.all(np.isfinite(frequency)) and np.all(frequency > 0)):
            raise CubeError(
                f"{name}: coordinate 'modulation_frequency' must be finite and above "
                f"0 Hz, found {np.min(frequency):g} Hz"
            )
        if np.any(np.diff(frequency) <= 0):
            raise CubeError(
                f"{name}: coordinate 'modulation_frequency' must increase; sort the "
                "cube by it and drop what stands there twice"
            )
    for pair in cube.coords.get("polarization", []):
        if not _PAIR.fullmatch(str(pair.item())):
            raise CubeError(
                f"{name}: coordinate 'polarization' holds {pair.item()!r}; needed is "
                '"none" or two of the letters V, H, P, M, R, L'
            )
    for coordinate in ("azimuth", "elevation"):
        if coordinate in cube.coords and not np.all(np.isfinite(cube[coordinate])):
            raise CubeError(
                f"{name}: coordinate '{coordinate}' holds values that are not finite; "
                "every pixel needs a direction, measured or not"
            )
    geometry = cube["geometry"].attrs
    needed = list(schema.GEOMETRY_ATTRIBUTES)
    if any(key in geometry for key in schema.WINDOW_ATTRIBUTES):
        needed += list(schema.WINDOW_ATTRIBUTES)
    for key in needed:
        size = 3 if key.endswith("_position") else 1
        if not _is_finite(geometry.get(key), size=size):
            meaning = {**schema.GEOMETRY_ATTRIBUTES, **schema.WINDOW_ATTRIBUTES}[key]
            raise CubeError(
                f"{name}: coordinate 'geometry' lacks the attribute '{key}' or holds "
                f"something else than {size} finite numbers in it: {meaning}"
            )


_PAIR = re.compile(stokes.PAIR_PATTERN)


def _is_finite(value: Any, *, size: int) -> bool:
    array = np.asarray(value)
    return array.dtype.kind in "fiu" and array.size == size and np.isfinite(array).all()


def _check_open_water(cube: xr.Dataset, *, name: str) -> None:
    shots = accessor.group(cube, "open_water")
    if shots is None:
        return
    for variable, spec in schema.OPEN_WATER_VARIABLES.items():
        _check_variable(
            shots.data_vars, variable, spec, name=name, kind="open_water variable"
        )
    check_values(shots.data_vars, name=f"{name}, open_water")
    check_pairs(shots.data_vars, name=f"{name}, open_water")
    check_errors(shots.data_vars, name=f"{name}, open_water")
    for direction in ("azimuth", "elevation"):
        if direction in shots and not np.all(np.isfinite(shots[direction])):
            raise CubeError(
                f"{name}: open_water {direction} holds values that are not finite; "
                "drop the shots whose direction is not known"
            )
