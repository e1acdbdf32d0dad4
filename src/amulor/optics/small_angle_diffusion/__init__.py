"""Small-angle diffusion model: water signal and its distribution over depth."""

from __future__ import annotations

from typing import TYPE_CHECKING

from amulor import _lazy

if TYPE_CHECKING:
    from amulor.optics.small_angle_diffusion import (
        impulse_response,
        response,
    )
    from amulor.optics.small_angle_diffusion.response import (
        narrow_receiver_response,
        overlap,
        water_response,
        water_tail,
    )

__all__ = [
    "impulse_response",
    "narrow_receiver_response",
    "overlap",
    "response",
    "water_response",
    "water_tail",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = _lazy.attach(
        __name__,
        __all__,
        origin={
            "narrow_receiver_response": "amulor.optics.small_angle_diffusion.response",
            "overlap": "amulor.optics.small_angle_diffusion.response",
            "water_response": "amulor.optics.small_angle_diffusion.response",
            "water_tail": "amulor.optics.small_angle_diffusion.response",
        },
    )
