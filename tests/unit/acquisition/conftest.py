"""A small fast survey, a folder without a slow disk, and what stops or asks a scan."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import xarray as xr
from logged_devices import logged_devices
from patient_links import links_are_patient  # noqa: F401  it is used by itself

from amulor import acquisition
from amulor.acquisition import run as keeper
from amulor.acquisition.clock import VirtualClock
from amulor.acquisition.devices import Devices
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.settings import Settings
from amulor.survey import Survey


@pytest.fixture(scope="session")
def small(plate: Survey) -> Survey:
    """Return a survey of 5 x 3 pixels with one reading a sample."""
    return plate.with_(
        {
            "scan.columns": 5,
            "scan.rows": 3,
            "scan.dwell": "50 ms",
            "scan.open_water": {"columns": 3, "rows": 2, "repeats": 2},
        }
    )


@pytest.fixture
def settings() -> Settings:
    """Return settings with few references."""
    return Settings.model_validate({"procedure": {"dark_readings": 2}})


@pytest.fixture
def folder() -> Iterator[Path]:
    """Return a folder in memory where there is one: a disk that syncs slowly is not
    what these tests are about."""
    memory = Path("/dev/shm")
    place = tempfile.mkdtemp(dir=memory if memory.is_dir() else None)
    yield Path(place)
    shutil.rmtree(place)


@pytest.fixture(autouse=True)
def each_commit_is_waited_for(monkeypatch) -> None:
    """On a busy machine commits would go beside the next dwell, and be told later."""
    monkeypatch.setattr(keeper, "SLOW", float("inf"))


class Script:
    """The other end of a conversation: the lines that must come, and their answers."""

    address = "a script"

    def __init__(self, *turns: tuple[str, list[str]]) -> None:
        self.turns = [*turns]
        self.closed = self.reopened = 0

    def send(self, line: str) -> None:
        assert self.ask(line, answers=0) == []

    def ask(self, line: str, *, answers: int = 1) -> list[str]:
        assert self.turns, f"nothing more was expected, but {line!r} came"
        expected, found = self.turns.pop(0)
        assert line == expected
        assert len(found) == answers
        return found

    def reopen(self) -> None:
        self.reopened += 1

    def close(self) -> None:
        self.closed += 1

    def extend(self, *turns: tuple[str, list[str]]) -> None:
        self.turns.extend(turns)


@pytest.fixture
def script() -> type[Script]:
    """Return the class of scripted conversations."""
    return Script


@pytest.fixture
def clock() -> VirtualClock:
    """Return a clock that does not wait."""
    return VirtualClock()


def _made(settings: Settings, **parts: dict) -> Settings:
    content = settings.model_dump(exclude_unset=True)
    for name, part in parts.items():
        content[name] = {**content.get(name, {}), **part}
    return Settings.model_validate(content)


@pytest.fixture(name="made")
def made_fixture() -> Callable[..., Settings]:
    """Return what changes parts of settings."""
    return _made


def _safe(devices: Devices) -> bool:
    """Return whether the last thing that each device was told was to be safe."""
    last = {name: device.log[-1] for name, device in devices.all()}
    return last.pop("laser") == "off" and {*last.values()} == {"safe"}


@pytest.fixture(name="safe")
def safe_fixture() -> Callable[[Devices], bool]:
    """Return what tells whether devices were left safe."""
    return _safe


def _cube_of(folder: Path) -> xr.Dataset:
    """Return the cube of a folder; that it is written well is tested elsewhere."""
    with Journal.read(folder) as journal:
        return acquisition.build(journal)


@pytest.fixture(name="cube_of")
def cube_of_fixture() -> Callable[[Path], xr.Dataset]:
    """Return what makes the cube of a folder in memory."""
    return _cube_of


class Stop:
    """Pauses once before a sample, and then goes on or not."""

    def __init__(self, at: int, *, go_on: bool) -> None:
        self.left, self._go_on, self.asked = at, go_on, 0

    def pause_wanted(self) -> bool:
        self.left -= 1
        return self.left == -1

    def go_on(self) -> bool:
        self.asked += 1
        return self._go_on


@pytest.fixture(name="Stop")
def stop_fixture() -> type[Stop]:
    """Return the class of controls that pause once."""
    return Stop


@pytest.fixture
def log() -> list[Any]:
    """Commands that `devices` received, in order."""
    return []


@pytest.fixture
def devices(log: list[Any]) -> Devices:
    return logged_devices(log)
