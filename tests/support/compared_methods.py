"""Methods with given results, and rows of their comparison."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import xarray as xr

from amulor.rejection import Row
from amulor.rejection.methods import Method


def method_of(name: str, function: Any, **declared: Any) -> Method:
    """Return a method that a comparison may run."""
    return Method(name=name, function=function, **declared)


def returning(target: xr.Dataset) -> Callable[..., xr.Dataset]:
    """Return a function that gives a target signal for any cube."""

    def run(cube: xr.Dataset, *, interval: Any = None) -> xr.Dataset:
        return target

    return run


def row(method: str = "first", **changed: Any) -> Row:
    """Return a row of 5 mm of error, all of whose pixels are trusted."""
    values: dict[str, Any] = {
        "method": method, "polarization": "VV", "bias": 3e-3, "noise": 4e-3,
        "usable": 1.0, "flagged": 0.0, "trusted": 1.0,
    }  # fmt: skip
    return Row(**values | changed)
