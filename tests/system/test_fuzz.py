"""Nothing that a reader is fed ends in a traceback, a hang, or a number that is wrong.

2,000 cases are a part of `make check`, 10,000 for each reader of `make study`
(AMULOR_FUZZ says how many). Where atheris is installed, it guides further cases for
10 minutes a reader (AMULOR_GUIDED_SECONDS).
"""

from __future__ import annotations

import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import fuzzed_readers
import pytest
from fuzzing import Reader, campaign
from trials import keep

from amulor.survey import Survey

pytestmark = pytest.mark.filterwarnings("ignore")

NAMES = (
    "survey", "table", "site", "devices", "calibration", "checks", "pose", "map",
    "project", "cube", "cube bytes", "transients", "transients bytes", "recording",
    "target mesh", "reference mesh", "shown", "ply", "laz", "e57",
)  # fmt: skip

#: Readers of `guided_fuzzing.py`: netCDF, shapes, histograms, TOML, journals.
GUIDED = ("cube", "ply", "laz", "e57", "transients", "survey", "journal")
#: Cases of one program: the library that reads E57 keeps memory of refused files.
RUNS = {"e57": 3_000}
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
        **{name: fuzzed_readers.shown(folder, name) for name in ("ply", "laz", "e57")},
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
    begun, before = time.monotonic(), _used()
    counts = campaign(readers[name], folder, range(10_000, 10_000 + many))
    print(name, counts)
    keep(
        "fuzzing", reader=name, way="by format", cases=many, refused=counts.refused,
        tracebacks=0, hangs=0, slowest_s=counts.slowest,
        highest_mb=counts.memory / 1e6, minutes=(time.monotonic() - begun) / 60,
        processor_minutes=(_used() - before) / 60,
    )  # fmt: skip


@pytest.mark.study
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("name", GUIDED)
def test_files_guided_by_coverage_are_refused_in_one_line(
    folder: Path, plate_text: str, name: str
) -> None:
    pytest.importorskip("atheris")
    place = folder / name
    place.mkdir()
    (place / "plate.toml").write_text(plate_text)
    seconds = float(os.environ.get("AMULOR_GUIDED_SECONDS", "600"))
    before, end = _used(), time.monotonic() + seconds
    cases, slowest, highest = 0, 0.0, 0
    while (left := end - time.monotonic()) >= 1:
        words = [str(int(left)), str(place), str(RUNS.get(name, 10**9))]
        done = subprocess.run(
            [sys.executable, str(SUPPORT / "guided_fuzzing.py"), name, *words],
            capture_output=True,
            text=True,
        )
        assert done.returncode == 0, done.stderr[-3000:]
        said = dict(re.findall(r"stat::(\w+): +(\d+)", done.stderr))
        cases += int(said["number_of_executed_units"])
        slowest = max(slowest, float(said["slowest_unit_time_sec"]))
        highest = max(highest, int(said["peak_rss_mb"]))
    keep(
        "fuzzing", reader=name, way="guided by coverage",
        cases=cases, tracebacks=0, hangs=0, slowest_s=slowest, refused="",
        highest_mb=highest, minutes=seconds / 60,
        processor_minutes=(_used() - before) / 60,
    )  # fmt: skip


def _used() -> float:
    """Return the processor time of this process and those that it started [s]."""
    parts = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return sum(sum(resource.getrusage(part)[:2]) for part in parts)
