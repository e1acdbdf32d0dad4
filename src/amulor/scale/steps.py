"""Rejection and imaging as steps over the rows of a scan."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from amulor import imaging, rejection
from amulor.scale.tiled import TiledStep, decided_once

__all__ = ["image_step", "reject_step"]

#: Rows above and below a tile that marks of edges and outliers look at: seven, and one
#: more for a line that ends at the rim.
HALO = 8


def reject_step(method: str, **options: Any) -> TiledStep:
    """Return a method of rejection as a step over rows."""
    return TiledStep(prepare=partial(rejection.load(method).fit, **options))


def image_step(**options: Any) -> TiledStep:
    """Return the step to a range image, with its edges and outliers marked."""
    ranges = decided_once(partial(imaging.range_image, **options))
    flags = decided_once(
        lambda image: imaging.flag_outliers(imaging.flag_mixed(image)), spans=False
    )
    return replace(flags, of=ranges, halo=HALO)
