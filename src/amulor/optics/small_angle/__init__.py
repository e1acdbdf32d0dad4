"""Small-angle model of the water signal, valid for any phase function."""

from __future__ import annotations

from typing import TYPE_CHECKING

from amulor import _lazy

if TYPE_CHECKING:
    from amulor.optics.small_angle import (
        backscatter_direction,
        gaussian_receiver,
        sharp_receiver,
        transforms,
    )
    from amulor.optics.small_angle.gaussian_receiver import (
        overlap,
        water_response,
    )

__all__ = [
    "backscatter_direction",
    "gaussian_receiver",
    "overlap",
    "sharp_receiver",
    "transforms",
    "water_response",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = _lazy.attach(
        __name__,
        __all__,
        origin={
            "overlap": "amulor.optics.small_angle.gaussian_receiver",
            "water_response": "amulor.optics.small_angle.gaussian_receiver",
        },
    )
