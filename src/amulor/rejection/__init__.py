"""From samples to the signal of the target: one method a file."""

from amulor.rejection.open_water import open_water
from amulor.rejection.polarization import (
    co_polarized,
    cross_polarized,
    keep_water,
    unmix,
)

__all__ = ["co_polarized", "cross_polarized", "keep_water", "open_water", "unmix"]
