"""Signals over the modulation frequency: of a pixel, and of all for a saved page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

Cubes = Mapping[str, xr.Dataset | None]


def spectrum(
    cubes: Cubes, channel: str, row: int, column: int
) -> dict[str, Any] | None:
    """Return amplitude and phase of a pixel over the modulation frequency.

    Parameters
    ----------
    cubes : mapping
        `before`, level `samples`, and `after`, level `target_signal`.
    channel : str
        Polarization channel.
    row, column : int
        Pixel.

    Returns
    -------
    dict or None
        `frequency` [Hz] and, for each of `before`, `after` and `water` that is
        known, `amplitude` and `uncertainty` [V] and `phase` [rad].
    """
    parts: dict[str, Any] = {}
    frequency: NDArray[np.float64] | None = None
    for name, cube in cubes.items():
        if cube is None or channel not in cube.amulor.polarizations:
            continue
        one = cube.sel(polarization=channel).isel(row=row, column=column)
        frequency = np.atleast_1d(cube["modulation_frequency"].values)
        signal = one["in_phase"].values + 1j * one["quadrature"].values
        error = np.hypot(
            one["in_phase_uncertainty"].values,
            one["quadrature_uncertainty"].values,
        )
        parts[name] = _line(signal, error / math.sqrt(2))
        if name == "after":
            water = one["water_in_phase"].values + 1j * one["water_quadrature"].values
            parts["water"] = _line(water, None)
    if frequency is None:
        return None
    return {"frequency": frequency.tolist(), **parts}


def spectra(cubes: Cubes, channel: str, *, most: int) -> dict[str, NDArray[np.float32]]:
    """Return all spectra of a channel for a page that has no server.

    Parameters
    ----------
    cubes : mapping
        `before`, level `samples`, and `after`, level `target_signal`.
    channel : str
        Polarization channel.
    most : int
        Empty if there are more numbers than this [1].

    Returns
    -------
    dict
        `before` and `after` as far as they are known, arrays over (part,
        frequency, row, column) with in phase, quadrature and uncertainty [V].
    """
    found = {}
    for name, cube in cubes.items():
        if cube is None or channel not in cube.amulor.polarizations:
            continue
        one = cube.sel(polarization=channel)
        if 6 * one["in_phase"].size > most:
            return {}
        error = np.hypot(
            one["in_phase_uncertainty"].values,
            one["quadrature_uncertainty"].values,
        )
        parts = one["in_phase"].values, one["quadrature"].values, error / 2**0.5
        found[name] = np.stack(parts).astype("<f4")
    return found


def _line(
    signal: NDArray[np.complex128], error: NDArray[np.float64] | None
) -> dict[str, Any]:
    """Return amplitude and phase of a spectrum as lists."""
    signal = np.atleast_1d(signal)
    line = {"amplitude": np.abs(signal), "phase": np.angle(signal)}
    if error is not None:
        line["uncertainty"] = np.atleast_1d(error)
    return {name: _listed(values) for name, values in line.items()}


def _listed(values: NDArray[np.float64]) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
