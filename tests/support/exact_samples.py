"""Cubes of samples and of target signals with given values, a few pixels large."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from scipy.constants import speed_of_light

from amulor import cube as cubes

#: Water without refraction, and an instrument in one point.
GEOMETRY: dict[str, Any] = {
    "group_index": 1.5,
    "refractive_index": 1.0,
    "emitter_position": np.zeros(3),
    "receiver_position": np.zeros(3),
}


def samples(
    signal: Any,
    *,
    frequencies: tuple[float, ...] = (20e6, 50e6),
    channels: tuple[str, ...] = ("VV", "VH"),
    error: Any = 1e-3,
    level: str = "samples",
    geometry: dict[str, Any] | None = None,
    **attributes: Any,
) -> xr.Dataset:
    """Return signals with one error of both outputs [V], straight ahead.

    Shape (frequency, channel, row, column), or one that broadcasts to one pixel.
    """
    shape = np.broadcast_shapes(
        np.shape(signal), (len(frequencies), len(channels), 1, 1)
    )
    values = np.broadcast_to(np.asarray(signal, dtype=complex), shape)
    variables: dict[str, Any] = {
        "in_phase": values.real.copy(),
        "quadrature": values.imag.copy(),
        "in_phase_uncertainty": np.broadcast_to(error, shape).astype(float),
        "quadrature_uncertainty": np.broadcast_to(error, shape).astype(float),
    }
    if level == "target_signal":
        variables |= {
            "water_in_phase": np.zeros(shape),
            "water_quadrature": np.zeros(shape),
            "quality_flag": np.zeros(shape, dtype=np.int16),
        }
    return cubes.build(
        level,
        variables,
        {
            "modulation_frequency": np.array(frequencies),
            "polarization": [*channels],
            "azimuth": np.zeros(shape[2:]),
            "elevation": np.zeros(shape[2:]),
        },
        geometry=GEOMETRY if geometry is None else geometry,
        attributes=cubes.attributes(
            level, title="given values", source="a test", **attributes
        ),
    )


#: Phase of the way there and back at 20 and 50 MHz [rad/m].
TURN = 2 * np.pi * np.array([20e6, 50e6]) * 2 * GEOMETRY["group_index"] / speed_of_light


def plate_at(
    distance: float, phase: Any = 0.0, *, size: Any = (1.0, 0.5), **more: Any
) -> xr.Dataset:
    """Return a plate straight ahead whose phases are those of its way and `phase`.

    Phases by frequency, amplitudes by channel.
    """
    turn = np.exp(1j * (TURN * distance + phase))[:, None]
    values = turn * np.asarray(size)
    return samples(values[..., None, None], level="target_signal", **more)
