"""Dimensions and values of a cube: lost dimensions restored, values checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from amulor.cube import schema
from amulor.errors import CubeError

__all__ = ["check_errors", "check_limits", "check_pairs", "check_values"]


def restore_dimensions(cube: xr.Dataset) -> xr.Dataset:
    """Return a cube with all dimensions of its level; restored ones have length 1.

    Parameters
    ----------
    cube : xarray.Dataset
        Cube of any level, from which `sel` or `isel` with a single value may have
        removed dimensions, as in `cube.sel(polarization="VV")` or `cube.isel(row=3)`.

    Returns
    -------
    xarray.Dataset
        Cube as from a selection by a list with one value,
        `cube.sel(polarization=["VV"])`; the same object if no dimension is missing.
        Dimensions are not restored if their coordinate was dropped (`drop=True`), nor
        for variables of the user or variables that do not conform to the schema.

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
    missing = {
        dimension
        for spec in present
        for dimension in spec.dimensions
        # Rows, columns, points and shots have no coordinate that could be missing.
        if dimension not in cube.dims
        and (dimension in cube.coords or dimension not in level.coordinates)
    }
    if not missing:
        return cube
    restored = {
        name: _restored(variable, expected.get(str(name)), missing)
        for name, variable in cube.variables.items()
    }
    return xr.Dataset(
        {name: restored[name] for name in cube.data_vars},
        {name: restored[name] for name in cube.coords},
        cube.attrs,
    )


def _restored(
    variable: xr.Variable, spec: schema.Variable | None, missing: set[str]
) -> xr.Variable:
    """Return a variable with missing dimensions added, if it lacks only these."""
    if spec is None:
        return variable
    remaining = tuple(name for name in spec.dimensions if name not in missing)
    if variable.dims != remaining or remaining == spec.dimensions:
        return variable
    expanded: xr.Variable = variable.set_dims(spec.dimensions)  # type: ignore[no-untyped-call]
    # A single text may have a length, a coordinate of texts may not.
    return expanded.astype(object) if expanded.dtype.kind == "U" else expanded


#: Largest plausible signal; a larger one is damage, or has another unit [V].
_LARGEST_SIGNAL = 1e15
#: Errors that all samples share: all of them are present, or none.
_COMMON = (
    "common_in_phase_uncertainty",
    "common_quadrature_uncertainty",
    "common_covariance",
)


#: Lowest and highest possible value of variables, and these limits in words.
_LIMITS = {
    "saturated": (0.0, 1.0, "0 or 1"),
    "time": (0.0, 1e11, "seconds since the start of the scan, from 0 to 1e11"),
    "reading_time": (0.0, 1e11, "seconds since the start of the scan, from 0 to 1e11"),
    "reading_duration": (0.0, 1e6, "seconds, from 0 to 1e6"),
}


def check_values(variables: Mapping[Any, xr.DataArray], *, name: str) -> None:
    """Raise if signals or their uncertainties have impossible values.

    NaN marks a missing sample. An uncertainty of zero is not valid, because later steps
    divide by it.
    """
    common = [part for part in _COMMON if part in variables]
    if common and len(common) < len(_COMMON):
        missing = ", ".join(part for part in _COMMON if part not in variables)
        raise CubeError(
            f"{name}: has {', '.join(common)}, but {missing} is missing; errors that "
            "are shared need all three, or drop what there is of them"
        )
    for variable in map(str, variables):
        values = variables[variable]
        if "modulation_frequency" not in values.dims or values.dtype.kind != "f":
            continue
        if variable.endswith("_uncertainty") and not variable.startswith("phase_"):
            _check_uncertainty(values, variable, name=name)
        elif values.attrs.get("units") == "V":
            _check_signal(values, variable, name=name)
    if set(_ERRORS) <= set(map(str, variables)):
        _check_covariance(variables, name=name)


#: Errors of a sample.
_ERRORS = (
    "in_phase_uncertainty",
    "quadrature_uncertainty",
    "in_phase_quadrature_covariance",
)


def check_pairs(variables: Mapping[Any, xr.DataArray], *, name: str) -> None:
    """Raise if one component of a sample is missing and the other is not."""
    first, second = variables["in_phase"], variables["quadrature"]
    single = np.isnan(first.values) != np.isnan(second.values)
    if single.any():
        raise CubeError(
            f"{name}: one of in_phase and quadrature is NaN "
            f"{_place(first.copy(data=single), True)}; state both, or make both NaN if "
            "the sample is missing"
        )


def check_errors(variables: Mapping[Any, xr.DataArray], *, name: str) -> None:
    """Raise if a sample has no error, in a cube whose other samples have one."""
    signal = variables["in_phase"].values + variables["quadrature"].values
    for error in _ERRORS:
        if error not in variables or variables[error].shape != signal.shape:
            continue
        missing = np.isnan(variables[error].values)
        unknown = missing & ~np.isnan(signal)
        if unknown.any() and not missing.all():
            place = _place(variables[error].copy(data=unknown), True)
            raise CubeError(
                f"{name}: {error} is NaN {place}, where the sample is a number; state "
                "its error, or make the sample NaN"
            )


def _check_covariance(variables: Mapping[Any, xr.DataArray], *, name: str) -> None:
    """Raise if a covariance is larger than the errors of its components allow."""
    first, second, covariance = (variables[part] for part in _ERRORS)
    if not first.dims == second.dims == covariance.dims:
        return
    excess = np.abs(covariance.values) > first.values * second.values * (1 + 1e-6)
    if excess.any():
        raise CubeError(
            f"{name}: {covariance.name} is above the product of the two uncertainties "
            f"{_place(covariance.copy(data=excess), True)}; state the covariance of "
            "the errors [V^2]"
        )


def check_limits(cube: xr.Dataset, *, name: str) -> None:
    """Raise if overload flags or times of pixels are outside their limits."""
    for variable, (lowest, highest, words) in _LIMITS.items():
        if variable not in cube.variables or cube[variable].size == 0:
            continue
        values = cube[variable]
        for extreme in _extremes(values):
            if extreme < lowest or extreme > highest:
                raise CubeError(
                    f"{name}: {variable} is {extreme:g} {_place(values, extreme)}, but "
                    f"must be {words}; correct it, or drop the variable"
                )


def _check_uncertainty(array: xr.DataArray, variable: str, *, name: str) -> None:
    if array.size == 0:
        return
    shared = variable.startswith("common_")
    lowest, highest = _extremes(array)
    if lowest < 0 or (lowest == 0 and not shared):
        raise CubeError(
            f"{name}: {variable} is {lowest:g} V {_place(array, lowest)}, but must be "
            "above 0 V; state the error of the samples, or make them NaN"
        )
    if highest > _LARGEST_SIGNAL:
        raise CubeError(
            f"{name}: {variable} is {highest:g} V {_place(array, highest)}; make the "
            "samples NaN that nothing is known of"
        )


def _check_signal(array: xr.DataArray, variable: str, *, name: str) -> None:
    if array.size == 0:
        return
    for extreme in _extremes(array):
        if abs(extreme) > _LARGEST_SIGNAL:
            raise CubeError(
                f"{name}: {variable} is {extreme:g} V {_place(array, extreme)}, more "
                f"than any instrument gives ({_LARGEST_SIGNAL:g} V); the file is "
                "damaged, or its unit is not the volt"
            )


def _extremes(array: xr.DataArray) -> tuple[Any, Any]:
    """Return the lowest and the highest value, NaN only if all values are NaN."""
    values = array.values
    return np.fmin.reduce(values, axis=None), np.fmax.reduce(values, axis=None)


def _place(values: xr.DataArray, value: float) -> str:
    """Return the indices of the first sample with a value, as text."""
    at = np.unravel_index(int(np.argmax(values.values == value)), values.shape)
    words = [f"{axis} {index}" for axis, index in zip(values.dims, at, strict=True)]
    return f"at {', '.join(words)}"
