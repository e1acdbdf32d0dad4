"""Nothing that a reader is fed ends in a traceback, a hang, or a number that is wrong.

2,000 cases are a part of `make check`, 10,000 for each reader of `make study`
(AMULOR_FUZZ says how many). Where atheris is installed, it guides further cases for
10 minutes a reader (AMULOR_GUIDED_SECONDS).
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import fuzzed_readers
import pytest
from fuzzing import Reader, campaign

from amulor.survey import Survey

pytestmark = pytest.mark.filterwarnings("ignore")

NAMES = (
    "survey", "table", "site", "devices", "calibration", "checks", "pose", "map",
    "project", "cube", "cube bytes", "transients", "transients bytes", "recording",
    "target mesh", "reference mesh", "shown",
)  # fmt: skip

#: Readers of `guided_fuzzing.py`: netCDF, all meshes and clouds, histograms, TOML,
#: journals.
GUIDED = ("cube", "shown", "transients", "survey", "journal")
SUPPORT = Path(__file__).parents[1] / "support"


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """Return a folder in memory, where there is one."""
    memory = Path("/dev/shm")
    place = Path(tempfile.mkdtemp(dir=memory if memory.is_dir() else None))
    yield place
    shutil.rmtree(place)


@pytest.fixture(scope="module")
def readers(folder: Path, plate_text: str) -> dict[str, Reader]:
    """Return all readers; journals have a campaign of their own."""
    return {
        **fuzzed_readers.texts(folder, plate_text),
        **fuzzed_readers.arrays(folder, Survey.from_text(plate_text)),
        **fuzzed_readers.shapes(folder),
    }


@pytest.mark.slow
def test_each_reader_has_its_campaign(readers: dict[str, Reader]) -> None:
    assert set(readers) == set(NAMES)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_damaged_files_are_refused_in_one_line(
    readers: dict[str, Reader], folder: Path, name: str
) -> None:
    # Writing cubes anew takes the most time.
    many = 30 if name == "cube" else 125
    counts = campaign(readers[name], folder, range(many))
    print(name, counts)
    assert counts.refused > many / 4
    # What is refused whatever it is would prove nothing.
    assert counts.accepted > 0


@pytest.mark.study
@pytest.mark.parametrize("name", NAMES)
def test_many_damaged_files_are_refused_in_one_line(
    readers: dict[str, Reader], folder: Path, name: str
) -> None:
    many = int(os.environ.get("AMULOR_FUZZ", "10000"))
    print(name, campaign(readers[name], folder, range(10_000, 10_000 + many)))


@pytest.mark.study
@pytest.mark.parametrize("name", GUIDED)
def test_files_guided_by_coverage_are_refused_in_one_line(
    folder: Path, plate_text: str, name: str
) -> None:
    pytest.importorskip("atheris")
    place = folder / name
    place.mkdir()
    (place / "plate.toml").write_text(plate_text)
    seconds = os.environ.get("AMULOR_GUIDED_SECONDS", "600")
    words = [sys.executable, str(SUPPORT / "guided_fuzzing.py"), name, seconds]
    done = subprocess.run([*words, str(place)], capture_output=True, text=True)
    print(name, done.stderr.splitlines()[-1])
    assert done.returncode == 0, done.stderr[-3000:]
