"""How large the water before a target is, where unmixing found too little of it."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube.tiles import Span
from amulor.rejection.reference.before_target import WaterFit, water_before_target

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def not_smaller_than_shots_say(
    cube: xr.Dataset,
    water: Complex,
    *,
    fit: WaterFit | None = None,
    span: Span | None = None,
) -> tuple[Complex, WaterFit]:
    """Return water that unmixing left, as large as the open-water shots have it.

    Its phases, and the larger of both amplitudes [V], to know how much the water
    fluctuates. What is left of it has the error of the target with the other sign:
    where a fluctuation made the target too large, it makes the water too small, and
    with it the error that is in proportion to it. In milk, a range that was 25 mm off
    had 0.9 mm stated. The phase stays: in a shadow the water is all there is, and no
    error may be left across it.
    """
    before = water_before_target(cube, interval=None, fit=fit, span=span)
    return _at_least(water, np.abs(before.signal)), before.fit


def not_smaller_than_usual(
    water: Complex, usual: Floats | None = None
) -> tuple[Complex, Floats]:
    """Return water that unmixing left, as large as in half of the pixels.

    As `not_smaller_than_shots_say`, for cubes without shots. Also return the median
    amplitude of each frequency and channel, `usual` if it is stated [V].
    """
    if usual is None:
        found = np.abs(water)
        whole = np.where(np.isfinite(found), found, 0.0)
        usual = np.asarray(np.median(whole, axis=(2, 3), keepdims=True))
    return _at_least(water, usual), usual


def _at_least(water: Complex, size: Floats) -> Complex:
    found = np.abs(water)
    longer = np.divide(size, found, out=np.ones(found.shape), where=found > 0)
    return np.asarray(water * np.maximum(longer, 1.0))
