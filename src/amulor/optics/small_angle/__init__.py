"""The small-angle form with the whole phase function: water signal of a receiver."""

from amulor.optics.small_angle.gaussian_receiver import overlap, water_response

__all__ = ["overlap", "water_response"]
