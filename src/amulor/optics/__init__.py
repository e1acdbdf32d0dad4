"""Formulas of underwater imaging with modulated laser light, on arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING

from amulor import _lazy

if TYPE_CHECKING:
    from amulor.optics import (
        ambiguity,
        arrivals,
        daylight,
        detection,
        extrema,
        interference,
        late_echo,
        low_pass,
        modulated_light,
        phase_functions,
        polarization,
        range_profile,
        ranging,
        rays,
        reflection,
        small_angle,
        small_angle_closure,
        small_angle_diffusion,
        target_echo,
        water,
    )

__all__ = [
    "ambiguity",
    "arrivals",
    "daylight",
    "detection",
    "extrema",
    "interference",
    "late_echo",
    "low_pass",
    "modulated_light",
    "phase_functions",
    "polarization",
    "range_profile",
    "ranging",
    "rays",
    "reflection",
    "small_angle",
    "small_angle_closure",
    "small_angle_diffusion",
    "target_echo",
    "water",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = _lazy.attach(__name__, __all__)
