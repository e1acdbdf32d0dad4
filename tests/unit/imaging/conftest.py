"""Range images written by hand, for all tests of imaging."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

from amulor import cube as cubes


@pytest.fixture(scope="session")
def written() -> Callable[..., xr.Dataset]:
    """Return a maker of range images with given ranges and one error everywhere."""

    def make(distance: np.ndarray, *, common: float = 0.0) -> xr.Dataset:
        shape = distance.shape
        return cubes.build(
            "range_image",
            {
                "slant_range": distance,
                "slant_range_uncertainty": np.full(shape, np.hypot(1e-3, common)),
                "slant_range_common_uncertainty": np.full(shape, common),
                "intensity": np.ones(shape),
                "quality_flag": np.where(np.isfinite(distance), 0, 4).astype(np.int16),
            },
            {"azimuth": np.zeros(shape), "elevation": np.zeros(shape)},
            geometry={
                "group_index": 1.38,
                "refractive_index": 1.34,
                "emitter_position": np.zeros(3),
                "receiver_position": np.zeros(3),
            },
            attributes=cubes.attributes("range_image", title="wall", source="by hand"),
        )

    return make
