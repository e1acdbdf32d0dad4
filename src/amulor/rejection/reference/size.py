"""How large the water before a target is, where unmixing found too little of it."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor._decisions import decided
from amulor.rejection.reference.before_target import water_before_target

Complex = NDArray[np.complex128]


def not_smaller_than_shots_say(cube: xr.Dataset, water: Complex) -> Complex:
    """Return water that unmixing left, as large as the open-water shots have it.

    Parameters
    ----------
    cube : xarray.Dataset
        Level `samples`, with open-water shots.
    water : ndarray of complex, shape (modulation_frequency, polarization, row, column)
        Samples of these channels less the target [V].

    Returns
    -------
    ndarray of complex
        Its phases, and the larger of both amplitudes [V].

    Raises
    ------
    CubeError
        As `water_before_target`.

    Notes
    -----
    To know how much the water fluctuates. What is left of it has the error of the
    target with the other sign: where a fluctuation made the target too large, it makes
    the water too small, and with it the error that is in proportion to it. In milk, a
    range that was 25 mm off had 0.9 mm stated. The phase stays: in a shadow the water
    is all there is, and no error may be left across it.
    """
    return _at_least(water, np.abs(water_before_target(cube, interval=None).signal))


def not_smaller_than_usual(water: Complex) -> Complex:
    """Return water that unmixing left, as large as in half of the pixels.

    Parameters
    ----------
    water : ndarray of complex, shape (modulation_frequency, polarization, row, column)
        Samples of these channels less the target [V].

    Returns
    -------
    ndarray of complex
        Its phases, and amplitudes not below their median over the scan [V].

    Notes
    -----
    As `not_smaller_than_shots_say`, for cubes without shots.
    """

    def usual() -> NDArray[np.float64]:
        found = np.abs(water)
        whole = np.where(np.isfinite(found), found, 0.0)
        return np.asarray(np.median(whole, axis=(2, 3), keepdims=True))

    return _at_least(water, decided("usual size of the water", usual))


def _at_least(water: Complex, size: NDArray[np.float64]) -> Complex:
    found = np.abs(water)
    longer = np.divide(size, found, out=np.ones(found.shape), where=found > 0)
    return np.asarray(water * np.maximum(longer, 1.0))
