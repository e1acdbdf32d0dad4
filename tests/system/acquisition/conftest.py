"""Surveys of several sizes, a folder without a slow disk, and a terminal to type on."""

from __future__ import annotations

import os
import select
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from patient_links import links_are_patient  # noqa: F401  it is used by itself

from amulor import imaging, rejection
from amulor.acquisition.settings import Settings
from amulor.cube import UNUSABLE
from amulor.survey import Survey


@pytest.fixture
def few() -> Settings:
    """Return simulated devices with few dark readings."""
    return Settings.model_validate({"procedure": {"dark_readings": 2}})


@pytest.fixture
def folder() -> Iterator[Path]:
    """Return a folder in memory where there is one: disks differ, promises do not."""
    memory = Path("/dev/shm")
    place = tempfile.mkdtemp(dir=memory if memory.is_dir() else None)
    yield Path(place)
    shutil.rmtree(place)


@pytest.fixture
def sized(plate: Survey) -> Callable[..., Survey]:
    """Return what makes the plate's survey of a size, with one reading a sample."""

    def make(*, columns: int, rows: int, shots: int = 2) -> Survey:
        return plate.with_(
            {
                "scan.columns": columns,
                "scan.rows": rows,
                "scan.dwell": "50 ms",
                "scan.open_water.repeats": shots,
            }
        )

    return make


@pytest.fixture
def survey(sized: Callable[..., Survey]) -> Survey:
    """Return a survey of 8 x 4 pixels in two polarizations."""
    return sized(columns=8, rows=4)


@pytest.fixture
def tiny(sized: Callable[..., Survey]) -> Survey:
    """Return a survey of 4 x 2 pixels."""
    return sized(columns=4, rows=2, shots=1)


@pytest.fixture
def ranges() -> Callable[[xr.Dataset], np.ndarray]:
    """Return what makes slant ranges of a cube, as the commands do."""

    def make(cube: xr.Dataset) -> np.ndarray:
        image = imaging.range_image(rejection.open_water(cube).sel(polarization=["VH"]))
        assert not (image["quality_flag"].values & UNUSABLE).any()
        return image["slant_range"].values

    return make


class Terminal:
    """The far side of a terminal that a command runs on."""

    def __init__(self) -> None:
        import pty

        self._master, self.near = pty.openpty()
        self.text = b""

    def begun(self) -> None:
        """Let the command alone have the near side."""
        os.close(self.near)

    def wait_for(self, words: bytes) -> None:
        """Wait until some words are shown after those that were waited for before."""
        deadline = time.monotonic() + 240
        start = len(self.text)
        while words not in self.text[start:]:
            assert time.monotonic() < deadline, self.text[-500:]
            if select.select([self._master], [], [], 1.0)[0]:
                try:
                    self.text += os.read(self._master, 65536)
                except OSError:  # the other end is gone
                    break
        assert words in self.text[start:], self.text[-500:]

    def read_until(self, reached: Callable[[], bool]) -> None:
        """Read what is shown, so that nothing waits for it, until something holds."""
        deadline = time.monotonic() + 240
        while not reached():
            assert time.monotonic() < deadline, self.text[-500:]
            if select.select([self._master], [], [], 0.05)[0]:
                self.text += os.read(self._master, 65536)

    def type(self, words: bytes) -> None:
        """Type something."""
        os.write(self._master, words)

    def close(self) -> None:
        """Let go of the far side."""
        os.close(self._master)


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    """Return a terminal."""
    pytest.importorskip("pty", reason="terminals are of another kind here")
    found = Terminal()
    yield found
    found.close()
