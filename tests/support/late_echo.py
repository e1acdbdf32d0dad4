"""Echoes that are late: of light that was scattered on its way, or a delay."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from scipy.constants import speed_of_light


def late_transfer(frequency: Any, *, length: float) -> Any:
    """Return an echo over frequency, late by a length and by half of it on average [1].

    The first is the same for all light, the second is distributed exponentially.
    """
    late = 2 * np.pi * frequency / speed_of_light * length
    return np.exp(1j * late) / (1 - 0.5j * late)


def with_echo(cube: xr.Dataset, transfer: Any) -> xr.Dataset:
    """Return samples whose echo has passed a transfer, shape (frequencies,)."""
    truth = cube.amulor.truth
    echo = truth["target_in_phase"].values + 1j * truth["target_quadrature"].values
    change = (transfer[:, None, None, None] - 1) * echo
    found = cube.copy(deep=True)
    found["in_phase"].values[...] += change.real
    found["quadrature"].values[...] += change.imag
    return found
