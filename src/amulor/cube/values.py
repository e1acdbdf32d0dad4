"""Numbers that no measurement gives: looked for whenever a cube is checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from amulor.errors import CubeError

__all__ = ["check_values"]

#: Detectors and lock-ins give volts; so much more is damage, or another unit [V].
_LARGEST_SIGNAL = 1e15
#: Errors that all samples share come together or not at all.
_COMMON = (
    "common_in_phase_uncertainty",
    "common_quadrature_uncertainty",
    "common_covariance",
)


def check_values(variables: Mapping[Any, xr.DataArray], *, name: str) -> None:
    """Raise if signals or their errors hold what no measurement gives.

    Parameters
    ----------
    variables : mapping of str to xarray.DataArray
        Of a level, or of one of its groups.
    name : str
        How a message names the cube.

    Raises
    ------
    CubeError
        With the first variable that is wrong, and where.

    Notes
    -----
    NaN is a sample that is missing. An uncertainty of zero is none: what follows
    divides by it.
    """
    there = [part for part in _COMMON if part in variables]
    if there and len(there) < len(_COMMON):
        missing = ", ".join(part for part in _COMMON if part not in variables)
        raise CubeError(
            f"{name}: has {', '.join(there)}, but {missing} is missing; errors that "
            "are shared need all three, or drop what there is of them"
        )
    for variable in map(str, variables):
        found = variables[variable]
        if "modulation_frequency" not in found.dims or found.dtype.kind != "f":
            continue
        if variable.endswith("_uncertainty") and not variable.startswith("phase_"):
            _check_uncertainty(found, variable, name=name)
        elif found.attrs.get("units") == "V":
            _check_signal(found, variable, name=name)


def _check_uncertainty(found: xr.DataArray, variable: str, *, name: str) -> None:
    values = found.values
    if values.size == 0:
        return
    shared = variable.startswith("common_")
    lowest = np.fmin.reduce(values, axis=None)
    highest = np.fmax.reduce(values, axis=None)
    if lowest < 0 or (lowest == 0 and not shared):
        raise CubeError(
            f"{name}: {variable} is {lowest:g} V {_place(found, lowest)}, but must be "
            "above 0 V; state the error of the samples, or make them NaN"
        )
    if highest > _LARGEST_SIGNAL:
        raise CubeError(
            f"{name}: {variable} is {highest:g} V {_place(found, highest)}; make the "
            "samples NaN that nothing is known of"
        )


def _check_signal(found: xr.DataArray, variable: str, *, name: str) -> None:
    values = found.values
    if values.size == 0:
        return
    for extreme in (
        np.fmin.reduce(values, axis=None),
        np.fmax.reduce(values, axis=None),
    ):
        if abs(extreme) > _LARGEST_SIGNAL:
            raise CubeError(
                f"{name}: {variable} is {extreme:g} V {_place(found, extreme)}, more "
                f"than any instrument gives ({_LARGEST_SIGNAL:g} V); the file is "
                "damaged, or its unit is not the volt"
            )


def _place(found: xr.DataArray, value: float) -> str:
    """Return where a value stands, in words."""
    at = np.unravel_index(int(np.argmax(found.values == value)), found.shape)
    words = [f"{axis} {index}" for axis, index in zip(found.dims, at, strict=True)]
    return f"at {', '.join(words)}"
