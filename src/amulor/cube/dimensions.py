"""Puts back the dimensions that selecting a single value took from a cube."""

from __future__ import annotations

import xarray as xr

from amulor.cube import schema


def restore_dimensions(cube: xr.Dataset) -> xr.Dataset:
    """Return a cube with all dimensions of its level, those of length 1 put back.

    Parameters
    ----------
    cube : xarray.Dataset
        A cube of any level, from which `sel` or `isel` with a single value may have
        taken dimensions, as in `cube.sel(polarization="VV")` or `cube.isel(row=3)`.

    Returns
    -------
    xarray.Dataset
        The cube that a list of one value selects, `cube.sel(polarization=["VV"])`;
        the same object if no dimension is missing. What is not known stays as it is:
        a dimension whose coordinate was dropped too (`drop=True`), variables of the
        user, and variables whose dimensions are not those of the schema.

    Examples
    --------
    >>> import numpy as np
    >>> from amulor import cube as cubes
    >>> points = {name: np.zeros(1) for name in cubes.LEVELS["point_cloud"].variables}
    >>> cloud = cubes.build(
    ...     "point_cloud", points, {}, geometry={}, attributes={"level": "point_cloud"}
    ... )
    >>> restore_dimensions(cloud.isel(point=0)).sizes["point"]
    1
    """
    level = schema.LEVELS.get(str(cube.attrs.get("level")))
    if level is None:
        return cube
    expected = {**level.coordinates, **level.variables}
    for group, variables in schema.GROUP_VARIABLES.items():
        expected |= {f"{group}_{name}": spec for name, spec in variables.items()}
    present = [spec for name, spec in expected.items() if name in cube.variables]
    lost = {
        dimension
        for spec in present
        for dimension in spec.dimensions
        # Rows, columns, points and shots have no coordinate that could be missing.
        if dimension not in cube.dims
        and (dimension in cube.coords or dimension not in level.coordinates)
    }
    if not lost:
        return cube
    restored = {
        name: _restored(variable, expected.get(str(name)), lost)
        for name, variable in cube.variables.items()
    }
    return xr.Dataset(
        {name: restored[name] for name in cube.data_vars},
        {name: restored[name] for name in cube.coords},
        cube.attrs,
    )


def _restored(
    variable: xr.Variable, spec: schema.Variable | None, lost: set[str]
) -> xr.Variable:
    """Return a variable with lost dimensions, if it lacks nothing else."""
    if spec is None:
        return variable
    left = tuple(name for name in spec.dimensions if name not in lost)
    if variable.dims != left or left == spec.dimensions:
        return variable
    whole: xr.Variable = variable.set_dims(spec.dimensions)  # type: ignore[no-untyped-call]
    # A single text has a length, a coordinate of texts must not.
    return whole.astype(object) if whole.dtype.kind == "U" else whole
