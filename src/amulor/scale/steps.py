"""Rejection and imaging as steps over the rows of a scan."""

from __future__ import annotations

from functools import partial
from typing import Any

import xarray as xr

from amulor import imaging, rejection
from amulor.cube.tiles import fit_on_sample
from amulor.imaging.outliers import fitted_outliers
from amulor.imaging.range_image import fitted_range_image
from amulor.scale.tiled import TiledStep

__all__ = ["image_step", "reject_step"]

#: Rows above and below a tile that marks of edges and outliers look at: seven, and one
#: more for a line that ends at the rim.
HALO = 8


def reject_step(method: str, **options: Any) -> TiledStep:
    """Return a method of rejection as a step over rows."""
    return TiledStep(prepare=partial(rejection.load(method).fit, **options))


def image_step(**options: Any) -> TiledStep:
    """Return the step to a range image, with its edges and outliers marked."""
    ranges = partial(fit_on_sample, fitted_range_image, **options)
    flags = partial(fit_on_sample, _flagged, needs_span=False)
    return TiledStep(prepare=flags, of=TiledStep(prepare=ranges), halo=HALO)


def _flagged(
    image: xr.Dataset, *, fit: tuple[float, ...] | None = None
) -> tuple[xr.Dataset, tuple[float, ...]]:
    """Range image with edges and outliers flagged, and the limits of chance used."""
    return fitted_outliers(imaging.flag_mixed(image), fit=fit)
