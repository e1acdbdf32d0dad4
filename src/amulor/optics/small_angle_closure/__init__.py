"""Small-angle closure: fast model of the water signal, with Gaussian beam widening."""

from __future__ import annotations

from typing import TYPE_CHECKING

from amulor import _lazy

if TYPE_CHECKING:
    from amulor.optics.small_angle_closure import response
    from amulor.optics.small_angle_closure.response import (
        departure,
        overlap,
        water_response,
    )

__all__ = ["departure", "overlap", "response", "water_response"]

if not TYPE_CHECKING:
    __getattr__, __dir__ = _lazy.attach(
        __name__,
        __all__,
        origin={
            "departure": "amulor.optics.small_angle_closure.response",
            "overlap": "amulor.optics.small_angle_closure.response",
            "water_response": "amulor.optics.small_angle_closure.response",
        },
    )
