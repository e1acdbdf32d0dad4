"""Commands that are killed leave what was there, or the whole result, never a part.

Afterwards the same command makes the same bytes as one that was left alone. Scans and
their journals are killed in `acquisition/test_loss.py`.
"""

from __future__ import annotations

import datetime
import json
import os
import random
import shutil
import signal
import time
from pathlib import Path

import exact_scenes as scenes
import ezdxf
import numpy as np
import pytest
import site_scenes
from project_files import project_text
from shared_light import scene_light
from trials import keep

from amulor import acquisition, io
from amulor.cli import main
from amulor.cube.provenance import dated
from amulor.simulation import simulate
from amulor.survey import Survey

pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="SIGKILL and fork are needed"),
    pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning"),
]

ENDS = "--nearest 0.8m --farthest 3m"
#: Ways from files to files: the words of the command, and its output.
WAYS = {
    "journal": ("recover scan -o", "cube.nc"),
    "copied journal": ("recover copied -o", "cube.nc"),
    "simulate": ("simulate plate.toml --seed 3 -o", "samples.nc"),
    "reject": ("reject samples.nc --method open-water -o", "target.nc"),
    "tiles": ("reject samples.nc --method open-water --tile-rows 2 -o", "target.nc"),
    "image": (f"image target.nc --polarization VV {ENDS} -o", "range.nc"),
    "laz": ("export ladder.nc -o", "cloud.laz"),
    "e57": ("export ladder.nc -o", "cloud.e57"),
    "ply": ("export ladder.nc -o", "cloud.ply"),
    "dxf": ("export ladder.nc --contours 10mm -o", "contours.dxf"),
    "pdf": ("export ladder.nc -o", "sheet.pdf"),
    "report": ("report ladder.nc -o", "report.html"),
    "archive": ("archive project.toml -o", "Ladder"),
    "site": ("run site.toml -o", "run"),
    "merge": ("site merge wreck/site.toml --poses wreck/poses.json -o", "merged"),
}
#: When all files are made, so that equal ones have equal bytes.
DAY = datetime.datetime(2026, 5, 1, tzinfo=datetime.UTC)
#: Those that go on with a folder, so that a part of it is kept.
RESUMED = ("site",)
SITE = """name = "Plate"
[[epoch]]
name = "first"
[[scan]]
name = "near"
file = "near.nc"
epoch = "first"
simulated_from = "plate.toml"
seed = 1
[scan.processing]
method = "open-water"
polarization = "VV"
nearest = "0.8 m"
farthest = "3 m"
"""


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory, plate_text: str) -> Path:
    """Return a folder with the files that the commands read."""
    folder = tmp_path_factory.mktemp("killed")
    plate = Survey.from_text(plate_text)
    (folder / "plate.toml").write_text(plate_text)
    (folder / "site.toml").write_text(SITE)
    small = plate.with_(
        {"scan.columns": 4, "scan.rows": 3, "scan.dwell": "50 ms",
         "scan.open_water": {"columns": 2, "rows": 2, "repeats": 2}}
    )  # fmt: skip
    acquisition.acquire(small, folder / "scan", scene=scene_light)
    (folder / "scan" / "cube.nc").unlink(missing_ok=True)
    shutil.copytree(folder / "scan", folder / "copied")
    io.write_cube(simulate(plate, rng=3), folder / "samples.nc")
    ladder = scenes.drawn(
        scenes.ladder(rows=8, columns=30, own=2e-4), np.random.default_rng(1), 2e-4
    )
    io.write_cube(
        ladder.assign_attrs(
            survey=plate_text, history="2026-05-01T10:00:00Z amulor: acquire"
        ),
        folder / "ladder.nc",
    )
    (folder / "project.toml").write_text(
        project_text(
            {"scan1": ("ladder.nc", '["samples.nc"]', 'heading = "90 deg"')},
            rms_error="1.5 mm",
        )
    )
    return folder


def started(words: list[str]) -> int:
    """Run a command in a process of its own; return its number."""
    child = os.fork()
    if child == 0:
        code = 99
        try:
            os.dup2(os.open(os.devnull, os.O_RDWR), 1)
            # A drawing has its time and a random number.
            ezdxf.options.write_fixed_meta_data_for_testing = True
            with dated(DAY):
                code = main(words)
        finally:
            os._exit(code)
    return child


def content(path: Path) -> dict[str, bytes]:
    """Return the files of an output by name, one or a folder; none where there is none.

    What a killed command has begun has a name with a point in front.
    """
    if path.is_file():
        return {"": path.read_bytes()}
    return {
        str(file.relative_to(path)): file.read_bytes()
        for file in sorted(path.rglob("*"))
        if file.is_file() and not file.relative_to(path).as_posix().startswith(".")
        and not file.name.startswith(".amulor-")
    }  # fmt: skip


def removed(path: Path) -> None:
    """Remove a file or a folder, if it is there."""
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)


def made_of(left: bytes, whole: bytes | None) -> bool:
    """Return whether a file is whole, or a record of steps has some of all steps."""
    if left == whole or whole is None or not left.startswith(b"{"):
        return left == whole
    return bool(json.loads(left).items() <= json.loads(whole).items())


def kills(way: str, source: Path, count: int) -> dict[str, int]:
    """Kill a command so many times, and check what it leaves each time."""
    rng = random.Random(way)
    start, name = WAYS[way]
    place = source / f"out {way}"
    place.mkdir(exist_ok=True)
    target = place / name
    words = [*start.split(), str(target)]

    def made(*more: str) -> float:
        begun = time.monotonic()
        _, status = os.waitpid(started([*words, *more]), 0)
        assert status == 0, way
        return time.monotonic() - begun

    made()  # compiles
    removed(target)
    longest = made()
    whole = content(target)
    assert whole
    removed(target)
    found = {"kills": 0, "none": 0, "old": 0, "whole": 0, "part": 0}
    while found["kills"] < count:
        old, more = {}, []
        if target.is_file() or (found["kills"] % 2 and name.count(".")):
            # A file that is replaced is the old one or the new one.
            target.write_bytes(b"old")
            old, more = {"": b"old"}, ["--overwrite"]
        child = started([*words, *more])
        time.sleep(rng.uniform(0, 1.1 * longest))
        os.kill(child, signal.SIGKILL)
        _, status = os.waitpid(child, 0)
        found["kills"] += os.WIFSIGNALED(status)
        left = content(target)
        if way in RESUMED:
            # Each file is whole; the rest is made by the next run.
            assert all(made_of(left[file], whole.get(file)) for file in left), (
                left.keys()
            )
            found["whole" if left == whole else "part" if left else "none"] += 1
            if left == whole:
                removed(target)
        else:
            assert left in (old, whole), (way, sorted(left))
            found["whole" if left == whole else "old" if old else "none"] += 1
            removed(target)
    made()
    assert content(target) == whole, way
    shutil.rmtree(place)
    return found


@pytest.fixture(autouse=True)
def there(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Date all files by one time, as builds that can be repeated are."""
    monkeypatch.chdir(source)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")


@pytest.mark.slow
def test_a_killed_command_leaves_nothing_by_half(source: Path) -> None:
    assert kills("copied journal", source, 4)["kills"] == 4


@pytest.mark.study
@pytest.mark.parametrize("way", list(WAYS))
def test_many_killed_commands_leave_nothing_by_half(source: Path, way: str) -> None:
    count = int(os.environ.get("AMULOR_COMMAND_KILLS", "25"))
    if way == "image":
        words = ["reject", "samples.nc", "--method", "open-water", "-o", "target.nc"]
        assert os.waitpid(started([*words, "--overwrite"]), 0)[1] == 0
    if way == "merge":
        site_scenes.make_site.make(source / "wreck", rows=30)
        words = [
            "site",
            "register",
            "wreck/site.toml",
            "-o",
            "wreck/poses.json",
            "--overwrite",
        ]
        assert os.waitpid(started(words), 0)[1] == 0
    found = kills(way, source, count)
    print(way, found)
    keep(
        "kills", what="command", way=way, kills=found["kills"], acknowledged="",
        lost=0, twice=0, parts=0,
    )  # fmt: skip
