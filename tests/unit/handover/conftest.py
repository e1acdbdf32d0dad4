"""The ladder of the demo by exact geometry, as a file and as an image."""

from __future__ import annotations

from pathlib import Path

import exact_scenes as scenes
import pytest
import xarray as xr

from amulor import io


@pytest.fixture(scope="session")
def ladder() -> xr.Dataset:
    return scenes.ladder(rows=16, columns=60, own=2e-4, shared=1e-4)


@pytest.fixture(scope="session")
def ladder_file(ladder: xr.Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("ladder") / "ladder.nc"
    io.write_cube(ladder, path)
    return path
