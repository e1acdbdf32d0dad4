"""Ranges of one row at once: phases to distances, without errors and corrections."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.imaging.geometry import beams_of, medium_of, receivers_of
from amulor.optics import ambiguity, rays

#: The same for all frequencies, so that the highest count most [rad].
_PHASE_ERROR = 0.02


def quick_layers(
    one: xr.Dataset, signal: NDArray[np.complex128], ending: str
) -> dict[str, NDArray[np.float64]]:
    """Return range and amplitude of a row that has just been measured.

    Parameters
    ----------
    one : xarray.Dataset
        Beams of the row, with its coordinates `modulation_frequency` and `geometry`.
    signal : ndarray, shape (frequencies, column)
        Signals [V].
    ending : str
        Put behind the names of the maps.

    Returns
    -------
    dict
        `range` [m] and `amplitude` [V], each of shape (column,).

    Notes
    -----
    Phases to paths to slant ranges as `amulor.imaging.range_image`, but all frequencies
    with one phase error, and without late light: within what that takes off, the same.
    """
    frequency = np.atleast_1d(one["modulation_frequency"].values)
    beam, receiver, medium = beams_of(one), receivers_of(one), medium_of(one)
    shortest, longest = rays.path_limits(
        None, beam, receiver, medium=medium, modulation_frequency=frequency
    )
    there = np.isfinite(signal).all(axis=0)
    filled = np.where(there, signal, 1.0)[:, None]
    path = ambiguity.optical_path(
        np.angle(filled),
        np.full(filled.shape, _PHASE_ERROR),
        modulation_frequency=frequency,
        shortest=shortest,
        longest=longest,
        doubt=1.0,
    )
    ranges = rays.slant_range_of_path(path.length, beam, receiver, medium=medium)[0]
    amplitude = np.abs(filled[0, 0])
    return {
        f"range{ending}": np.where(there, ranges, np.nan),
        f"amplitude{ending}": np.where(there, amplitude, np.nan),
    }
