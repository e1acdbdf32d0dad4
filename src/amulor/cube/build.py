"""Makes cubes from arrays, with the units, names and attributes of the schema."""

from __future__ import annotations

from collections.abc import Mapping
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
    """Make a cube of one level from plain arrays.

    Parameters
    ----------
    level : str
        A key of `schema.LEVELS`.
    variables, coordinates : mapping of str to array_like
        Values under the names of the schema, in its order of dimensions.
    geometry : mapping
        Attributes of the coordinate `geometry`, see `schema.GEOMETRY_ATTRIBUTES`.
    attributes : mapping
        Global attributes, see `provenance.attributes`.

    Returns
    -------
    xarray.Dataset
        The cube; `check.check` tells whether it is complete.

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
    """Make the open-water part of a cube, to be attached with `accessor.attach`.

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
    attributes = (
        schema.flag_attributes()
        if name == "quality_flag"
        else {"long_name": spec.long_name, "units": spec.units}
    )
    array = np.asarray(values)
    if name == "polarization":
        array = array.astype(object)
    return xr.Variable(spec.dimensions, array, attributes)
