"""The small-angle diffusion form: water signal and where in the water it is made."""

from amulor.optics.small_angle_diffusion.response import (
    narrow_receiver_response,
    overlap,
    water_response,
    water_tail,
)

__all__ = ["narrow_receiver_response", "overlap", "water_response", "water_tail"]
