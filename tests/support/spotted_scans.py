"""Scans of spots in two reflectances, without shots and without a survey."""

from __future__ import annotations

import numpy as np
import xarray as xr

from amulor import cube as cubes

FREQUENCY = np.array([20e6, 60e6])


def spots(shape: tuple[int, ...], seed: int = 0) -> np.ndarray:
    """Return reflectances of 1 and 0.3, drawn for each sample."""
    rng = np.random.default_rng(seed)
    return np.where(rng.random(shape) < 0.5, 1.0, 0.3)


def scan_of(
    signal: np.ndarray, *, error: float | np.ndarray = 1e-3, still: bool = False
) -> xr.Dataset:
    """Return samples over (frequency, row, column) of a scan without shots."""
    rows, columns = np.mgrid[: signal.shape[1], : signal.shape[2]]
    stated = np.broadcast_to(error, signal.shape)[:, None]
    return cubes.build(
        "samples",
        {
            "in_phase": signal.real[:, None],
            "quadrature": signal.imag[:, None],
            "in_phase_uncertainty": stated,
            "quadrature_uncertainty": stated,
            "saturated": np.zeros(stated.shape, np.int8),
        },
        {
            "modulation_frequency": FREQUENCY[: len(signal)],
            "polarization": ["none"],
            "azimuth": 0.0 * columns if still else 0.002 * columns,
            "elevation": 0.0 * rows if still else -0.002 * rows,
        },
        geometry={
            "group_index": 1.38,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("samples", title="by hand", source="by hand"),
    )
