"""What a page must know to work out by itself how errors of pixels correlate."""

from __future__ import annotations

from typing import Any

import numpy as np

from amulor.cube.terms import ALIKE_TERMS, WATER_TERMS
from amulor.imaging.measure import reference_basis
from amulor.view.page.layers import MAPS
from amulor.view.page.pictures import Picture


def sharing_of(picture: Picture) -> dict[str, Any] | None:
    """Return how errors of two pixels correlate, for the page to work it out alone.

    Parameters
    ----------
    picture : Picture
        A range image.

    Returns
    -------
    dict or None
        `alike` and `of_water`, names of the maps of terms; `scale`, means and factors
        of azimuth and elevation; `powers` of their monomials, and `matrix` that turns
        those into the basis of the reference. None if the image knows no shared part,
        or states no error.
    """
    if not picture.has("slant_range_common_uncertainty") or picture.error_unknown:
        return None
    names = {
        kind: [
            MAPS[f"slant_range_uncertainty_{term}"].name
            for term in terms
            if picture.has(f"slant_range_uncertainty_{term}")
        ]
        for kind, terms in (
            ("alike", ALIKE_TERMS),
            ("of_water", WATER_TERMS),
        )
    }
    basis: dict[str, Any] = {}
    if "open_water_degree" in picture.attributes:
        thin = max(1, int(np.sqrt(picture.shape[0] * picture.shape[1] / 250_000)))
        angles = [picture.values(name, thin) for name in ("azimuth", "elevation")]
        degree = int(np.max(picture.attributes["open_water_degree"]))
        basis = reference_basis(*angles, degree=degree)
    return {**names, **basis}
