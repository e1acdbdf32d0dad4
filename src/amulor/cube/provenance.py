"""Construction of cubes from arrays, with units, names and global attributes."""

from __future__ import annotations

import datetime
import functools
import hashlib
import importlib.metadata
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from amulor.cube import schema


def build(
    level: str,
    variables: Mapping[str, ArrayLike],
    coordinates: Mapping[str, ArrayLike],
    *,
    geometry: Mapping[str, Any],
    attributes: Mapping[str, Any],
) -> xr.Dataset:
    """Build a cube of one level from arrays.

    Parameters
    ----------
    level : str
        Processing level, a key of `schema.LEVELS`.
    variables, coordinates : mapping of str to array_like
        Values under the names of the schema, in its order of dimensions.
    geometry : mapping
        Attributes of the coordinate `geometry`, see `schema.GEOMETRY_ATTRIBUTES`.
    attributes : mapping
        Global attributes, see `provenance.attributes`.

    Returns
    -------
    xarray.Dataset
        Cube; use `check.check` to test whether it is complete.

    Raises
    ------
    ValueError
        If a name is not in the schema of the level.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import cube as cubes
    >>> points = {name: np.zeros(5) for name in cubes.LEVELS["point_cloud"].variables}
    >>> cloud = cubes.build(
    ...     "point_cloud", points, {}, geometry={}, attributes={"level": "point_cloud"}
    ... )
    >>> cloud.sizes["point"]
    5
    """
    expected = schema.LEVELS[level]
    data = {
        name: _variable(name, values, expected.variables)
        for name, values in variables.items()
    }
    places = {
        name: _variable(name, values, expected.coordinates)
        for name, values in coordinates.items()
    }
    spec = expected.coordinates["geometry"]
    places["geometry"] = xr.Variable(
        (),
        np.int32(0),
        {"long_name": spec.long_name, "units": spec.units, **geometry},
    )
    return xr.Dataset(data, places, dict(attributes))


def open_water(variables: Mapping[str, ArrayLike]) -> xr.Dataset:
    """Build the group of open-water references for `accessor.attach`.

    Parameters
    ----------
    variables : mapping of str to array_like
        Values under the names of `schema.OPEN_WATER_VARIABLES`.

    Returns
    -------
    xarray.Dataset
        Dimensions (modulation_frequency, polarization, shot).

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import cube as cubes, samples
    >>> shots = cubes.group(samples.cube("ladder"), "open_water")
    >>> again = cubes.open_water({name: shots[name].values for name in shots})
    >>> again["in_phase"].dims
    ('modulation_frequency', 'polarization', 'shot')
    """
    return xr.Dataset(
        {
            name: _variable(name, values, schema.OPEN_WATER_VARIABLES)
            for name, values in variables.items()
        }
    )


def _variable(
    name: str, values: ArrayLike, expected: Mapping[str, schema.Variable]
) -> xr.Variable:
    if name not in expected:
        raise ValueError(f"{name!r} is not one of {', '.join(expected)}")
    spec = expected[name]
    if name == "quality_flag":
        attributes = schema.flag_attributes()
    elif name == "water_residual_cause":
        attributes = schema.cause_attributes()
    else:
        attributes = {"long_name": spec.long_name, "units": spec.units}
    array = np.asarray(values)
    if name == "polarization":
        array = array.astype(object)
    return xr.Variable(spec.dimensions, array, attributes)


@functools.cache
def software_versions() -> dict[str, str]:
    """Return the versions of amulor and of its numerical packages."""
    packages = ("amulor", "numpy", "scipy", "numba", "xarray", "h5netcdf")
    return {package: importlib.metadata.version(package) for package in packages}


def digest(content: bytes | str | Path) -> str:
    """Return the SHA-256 digest of a text, of bytes, or of the content of a file.

    Parameters
    ----------
    content : bytes, str or pathlib.Path
        Content to digest. A `Path` is read; a `str` is encoded as UTF-8.

    Returns
    -------
    str
        Text "sha256:" and 64 hexadecimal digits.

    Examples
    --------
    The first digits of the SHA-256 of "abc" (FIPS 180-4):

    >>> from amulor.cube import digest
    >>> digest("abc")[:23]
    'sha256:ba7816bf8f01cfea'
    """
    if isinstance(content, Path):
        with content.open("rb") as file:
            return f"sha256:{hashlib.file_digest(file, 'sha256').hexdigest()}"
    if isinstance(content, str):
        content = content.encode()
    return f"sha256:{hashlib.sha256(content).hexdigest()}"


def attributes(level: str, *, title: str, source: str, **others: Any) -> dict[str, Any]:
    """Return the global attributes of a new cube.

    Parameters
    ----------
    level : str
        Processing level, a key of `schema.LEVELS`.
    title, source : str
        Content of the data, and their origin (CF attributes).
    **others
        Further attributes; those that are None are omitted.

    Returns
    -------
    dict
        CF and amulor attributes.

    Examples
    --------
    >>> from amulor import cube as cubes
    >>> found = cubes.attributes("samples", title="Tank", source="tank", history=None)
    >>> found["level"], found["title"], "history" in found
    ('samples', 'Tank', False)
    """
    entries = {
        "Conventions": schema.CONVENTIONS,
        "title": title,
        "source": source,
        "level": level,
        "amulor_schema_version": schema.SCHEMA_VERSION,
        "software_versions": json.dumps(software_versions()),
        **others,
    }
    return {key: value for key, value in entries.items() if value is not None}


_time: ContextVar[datetime.datetime | None] = ContextVar("_time", default=None)


@contextmanager
def dated(time: datetime.datetime) -> Iterator[None]:
    """Use one time for all history lines within the block, for reproducible files."""
    token = _time.set(time)
    try:
        yield
    finally:
        _time.reset(token)


def note(cube: xr.Dataset, step: str) -> xr.Dataset:
    """Return a cube with one more line at the end of its CF `history`.

    Parameters
    ----------
    cube : xarray.Dataset
        Any cube.
    step : str
        Processing step, in words with which a user could repeat it.

    Returns
    -------
    xarray.Dataset
        Cube with the same data and the extended history.

    Examples
    --------
    >>> from amulor import cube as cubes, samples
    >>> cube = cubes.note(samples.cube("ladder"), "looked at by hand")
    >>> cube.attrs["history"].splitlines()[-1][-17:]
    'looked at by hand'
    """
    time = _time.get() or datetime.datetime.now(datetime.UTC)
    now = time.strftime("%Y-%m-%dT%H:%M:%SZ")
    version = software_versions()["amulor"]
    line = f"{now} amulor {version}: {step}"
    earlier = cube.attrs.get("history")
    return cube.assign_attrs(history=f"{earlier}\n{line}" if earlier else line)
