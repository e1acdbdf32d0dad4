"""Arguments of the small-angle models, refused outside of their range."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

__all__ = ["checked"]

# Lower limit, whether it is itself allowed, and unit of each argument.
_RANGE = {
    "depth": (0.0, True, " m"),
    "modulation_frequency": (0.0, True, " Hz"),
    "absorption": (0.0, True, " 1/m"),
    "scattering": (0.0, True, " 1/m"),
    "forward_scattering": (0.0, True, " 1/m"),
    "diffuse_scattering": (0.0, True, " 1/m"),
    "second_moment": (0.0, True, " rad^2"),
    "backscatter_vsf": (0.0, True, " 1/(m sr)"),
    "group_index": (1.0, True, ""),
    "baseline": (0.0, True, " m"),
    "receiver_radius": (0.0, False, " m"),
    "acceptance_angle": (0.0, False, " rad"),
    "beam_radius": (0.0, True, " m"),
    "beam_divergence": (0.0, True, " rad"),
    "tilt": (-np.inf, False, " rad"),
    "cross_tilt": (-np.inf, False, " rad"),
    "standoff": (0.0, True, " m"),
    "start": (0.0, True, " m"),
    "end": (0.0, True, " m"),
}


def checked(**arguments: ArrayLike) -> list[Any]:
    """Return scalars as floats and the rest as float arrays, all within range."""
    columns: list[Any] = []
    for name, value in arguments.items():
        array: Any = value
        if not isinstance(value, float):
            array = np.asarray(value, dtype=float)
        if isinstance(array, float) or array.ndim == 0:
            array = low = high = float(array)
        elif array.size:
            low, high = float(array.min()), float(array.max())
        else:
            low, high = 1.0, 1.0
        limit, closed, unit = _RANGE[name]
        finite = high < np.inf or name in ("start", "end")
        if not (finite and (low > limit or (closed and low == limit))):
            needed = "" if name in ("start", "end") else "finite"
            if limit > -np.inf:
                needed += " and " if needed else ""
                needed += f"{'at least' if closed else 'above'} {limit:g}{unit}"
            found = f"values from {low:g} to {high:g}" if low < high else f"{low:g}"
            name = "end" if name == "start" else name
            raise ValueError(f"{name} must be {needed}, got {found}{unit}")
        columns.append(array)
    return columns
