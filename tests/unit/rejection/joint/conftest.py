"""A small scan of a plate with a sweep of frequencies, for the joint estimation."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

from amulor import simulate
from amulor.survey import Survey

FREQUENCIES = np.array([12e6, 31e6, 57e6, 83e6, 104e6, 139e6])


@pytest.fixture(scope="session")
def sweep(plate_text: str) -> Callable[..., Survey]:
    """Return a function: the plate survey with a sweep and one channel."""

    def survey(**replaced: str) -> Survey:
        listed = ", ".join(f'"{f / 1e6:g} MHz"' for f in FREQUENCIES)
        text = plate_text.replace('["39 MHz"]', f"[{listed}]")
        text = text.replace('["VV", "VH"]', '["VV"]')
        for old, new in replaced.items():
            assert old in text
            text = text.replace(old, new)
        return Survey.from_text(text)

    return survey


@pytest.fixture(scope="session")
def samples(sweep: Callable[..., Survey]) -> xr.Dataset:
    """Return samples of that survey."""
    return simulate(sweep(), rng=4)
