"""Refractive index of sea water relative to air, by the fit of Quan and Fry.

References
----------
.. [1] X. Quan and E. S. Fry, Appl. Opt. 34, 3477 (1995), :doi:`10.1364/AO.34.003477`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import within

_Array = NDArray[np.float64]


def state(temperature: ArrayLike, salinity: ArrayLike) -> tuple[_Array, _Array]:
    """Return temperature and salinity as arrays, checked against the fit's range."""
    return (
        within(temperature, 0, 30, name="temperature", unit="degC"),
        within(salinity, 0, 43, name="salinity"),
    )


def index(wavelength: _Array, *, temperature: _Array, salinity: _Array) -> _Array:
    """Return the refractive index of sea water relative to air."""
    inverse = 1e-9 / wavelength
    offset, slope = _terms(temperature, salinity)
    return offset + slope * inverse - 4382.0 * inverse**2 + 1.1455e6 * inverse**3


def group_index(wavelength: _Array, *, temperature: _Array, salinity: _Array) -> _Array:
    """Return the group index n - L dn/dL relative to air, for wavelength L."""
    inverse = 1e-9 / wavelength
    offset, slope = _terms(temperature, salinity)
    curvature = -3 * 4382.0 * inverse**2 + 4 * 1.1455e6 * inverse**3
    return offset + 2 * slope * inverse + curvature


def salinity_slope(wavelength: _Array, *, temperature: _Array) -> _Array:
    """Return the salinity derivative of the refractive index, equal at any salinity."""
    return _salt(temperature) + 0.01155 * 1e-9 / wavelength


def _terms(t: _Array, s: _Array) -> tuple[_Array, _Array]:
    """Return two fit coefficients: constant term, and factor of 1 / wavelength [nm]."""
    offset = 1.31405 - 2.02e-6 * t**2 + _salt(t) * s
    return offset, 15.868 + 0.01155 * s - 0.00423 * t


def _salt(t: _Array) -> _Array:
    return 1.779e-4 - 1.05e-6 * t + 1.6e-8 * t**2
