"""A small recording for the page, and its server without a network."""

from __future__ import annotations

import shutil
import tempfile
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

from amulor import rejection
from amulor.simulation import simulate
from amulor.survey import Survey
from amulor.view import page
from amulor.view.page.server import application

with warnings.catch_warnings():
    # Newer versions would rather have another name of the package that it needs.
    warnings.simplefilter("ignore")
    from starlette.testclient import TestClient

TOKEN = "a-token-for-tests"
BASE = "http://127.0.0.1:8000"


@pytest.fixture
def folder() -> Iterator[Path]:
    """Return the folder of a scan, in memory where that is possible."""
    memory = Path("/dev/shm")
    place = tempfile.mkdtemp(dir=memory if memory.is_dir() else None)
    yield Path(place) / "scan"
    shutil.rmtree(place)


@pytest.fixture(scope="session")
def target(plate: Survey) -> xr.Dataset:
    """Return a target signal of 6 x 12 pixels, two channels."""
    return rejection.open_water(simulate(plate, rng=1))


@pytest.fixture(scope="session")
def recording(target: xr.Dataset) -> page.Recording:
    """Return what the page shows of it."""
    return page.recording_of(target, name="plate.nc")


@pytest.fixture
def served() -> Callable[..., TestClient]:
    """Return what serves a recording, as the browser of this computer sees it."""

    def make(shown: Any, **options: Any) -> TestClient:
        app = application(shown, token=TOKEN, **options)
        return TestClient(app, base_url=BASE, raise_server_exceptions=True)

    return make


@pytest.fixture
def client(served: Callable[..., TestClient], recording: page.Recording) -> TestClient:
    """Return a client of the plate's page."""
    return served(recording)
