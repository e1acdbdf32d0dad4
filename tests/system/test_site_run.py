"""`amulor run`: the same files here and on a cluster, whatever dies on the way."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from amulor.cli import main
from amulor.errors import FormatError
from amulor.scale import site_run
from amulor.scale.parts import splits
from amulor.scale.tasks import tasks_of
from amulor.site import Site

SITE = """
name = "Two plates"
[[epoch]]
name = "first"
[[scan]]
name = "near"
file = "near.nc"
epoch = "first"
simulated_from = "tank.toml"
seed = 1
[scan.processing]
method = "open-water"
polarization = "VV"
nearest = "0.8 m"
farthest = "3 m"
[[scan]]
name = "far"
file = "far.nc"
epoch = "first"
simulated_from = "tank.toml"
seed = 2
[scan.processing]
method = "polarization"
polarization = "VV"
nearest = "0.8 m"
farthest = "3 m"
"""

#: A cluster of two processes, one of which is killed when the first file is there.
KILL = """
import os, pathlib, signal, sys, threading, time
from distributed import Client, LocalCluster
from amulor.scale import site_run

def main():
    folder = pathlib.Path(sys.argv[2])
    size = dict(n_workers=2, threads_per_worker=1, dashboard_address=None)
    with LocalCluster(**size) as made:
        with Client(made) as client:
            killed = []

            def kill():
                while not list(folder.glob("*/samples.nc")):
                    time.sleep(0.02)
                busy = [name for name, keys in client.processing().items() if keys]
                pids = client.run(os.getpid)
                os.kill(pids[busy[0]], signal.SIGKILL)
                killed.append(busy[0])

            threading.Thread(target=kill, daemon=True).start()
            address = made.scheduler_address
            done = site_run.run_site(sys.argv[1], folder, scheduler=address)
            assert killed, "nobody was killed"
            assert not any(one.error for one in done), done

if __name__ == "__main__":
    main()
"""


#: The profiler of workers looks a thousand times a second, where it is not ended.
SAMPLED = {"DASK_DISTRIBUTED__WORKER__PROFILE__INTERVAL": "1ms"}


@pytest.fixture
def site(plate_text: str, tmp_path: Path) -> Path:
    """Return a site file with two simulated scans."""
    (tmp_path / "tank.toml").write_text(plate_text)
    path = tmp_path / "site.toml"
    path.write_text(SITE)
    return path


@pytest.fixture
def dated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Date runs by one time, as reproducible builds are."""
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")


def bytes_of(folder: Path) -> dict[str, bytes]:
    """Return the content of all files of a run."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.mark.study
@pytest.mark.usefixtures("dated")
def test_a_cluster_makes_the_same_bytes_and_survives_a_killed_worker(
    site: Path, tmp_path: Path
) -> None:
    here, cluster = tmp_path / "here", tmp_path / "cluster"
    words = [sys.executable, "-m", "amulor", "run", str(site), "-o", str(here)]
    subprocess.run(words, check=True, timeout=300)
    found = bytes_of(here)
    assert {Path(name).name for name in found} == {
        "run.json", "steps.json", "samples.nc", "target_signal.nc", "range_image.nc",
        "cloud.ply",
    }  # fmt: skip
    script = tmp_path / "kill.py"
    script.write_text(KILL)
    words = [sys.executable, str(script), str(site), str(cluster)]
    done = subprocess.run(
        words, env={**os.environ, **SAMPLED, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    made = bytes_of(cluster)
    assert made.keys() == found.keys()
    assert [name for name in found if made[name] != found[name]] == []


@pytest.mark.slow
@pytest.mark.usefixtures("dated")
def test_a_run_takes_up_what_is_whole_and_makes_the_rest(
    site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "out"
    assert main(["run", str(site), "-o", str(folder)]) == 0
    whole = bytes_of(folder)
    times = {path: path.stat().st_mtime_ns for path in folder.rglob("*.nc")}
    # A file that is damaged, one that is lost, and a scan with another seed.
    (folder / "near" / "range_image.nc").write_bytes(b"half")
    (folder / "near" / "cloud.ply").unlink()
    capsys.readouterr()
    assert main(["run", str(site), "-o", str(folder), "--json"]) == 0
    said = {one["name"]: one for one in json.loads(capsys.readouterr().out)["scans"]}
    assert said["near"]["made"] == ["range_image.nc", "cloud.ply"]
    assert said["far"]["made"] == []
    assert bytes_of(folder) == whole
    kept = folder / "far" / "target_signal.nc"
    assert kept.stat().st_mtime_ns == times[kept]
    site.write_text(site.read_text().replace("seed = 2", "seed = 3"))
    assert main(["run", str(site), "-o", str(folder)]) == 0
    assert "far: 4 files made, 0 were there" in capsys.readouterr().out
    assert bytes_of(folder)["far/samples.nc"] != whole["far/samples.nc"]


class Here:
    """A cluster of one that does what it is given when it is asked for results."""

    def __init__(self, fails: int = 0) -> None:
        self.waiting: list[Future] = []
        self.done: list[str] = []
        self.fails = fails

    def submit(self, function: Any, *words: Any, **options: Any) -> Future:
        future: Future = Future()
        future.key = str(len(self.done) + len(self.waiting))
        future.todo = function, words
        return future

    def add(self, future: Future) -> None:
        self.waiting.append(future)

    def __iter__(self) -> Iterator[Future]:
        while self.waiting:
            future = self.waiting.pop(0)
            function, words = future.todo
            self.done.append(function.__name__)
            if function is site_run.work_on_rows and self.fails:
                self.fails -= 1
                future.set_exception(OSError("the worker died"))
            else:
                # What goes to a worker is pickled.
                future.set_result(function(*pickle.loads(pickle.dumps(words))))
            yield future


def spread(site: Path, folder: Path, here: Here) -> dict[str, site_run.Done]:
    """Run a site in parts of three rows."""
    started = site_run._started(folder)
    tasks = tasks_of(Site.from_toml(site), folder, started=started, tile_rows=3)
    spreading = site_run._Spread(here, here)
    for task in tasks:
        spreading.begin(task, list(splits(task)))
    found = [spreading.after(future, str(future.exception() or "")) for future in here]
    return {one.name: one for one in found if one is not None}


@pytest.mark.study
@pytest.mark.usefixtures("dated")
def test_rows_as_tasks_make_the_same_bytes(site: Path, tmp_path: Path) -> None:
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    words = ["run", str(site), "-o", str(whole), "--tile-rows", "3"]
    assert main(words) == 0
    parts.mkdir()
    # A part that cannot be made stops its scan, and what is there stays there.
    done = spread(site, parts, Here(fails=1))
    assert done["near"].error == "the worker died"
    assert done["far"].error == ""
    left = {path.parent.name for path in (parts / "near").rglob("rows.nc")}
    assert left == {"00000003"}
    times = {p: p.stat().st_mtime_ns for p in (parts / "far").glob("*.nc")}
    here = Here()
    done = spread(site, parts, here)
    assert (done["near"].error, len(done["near"].made)) == ("", 4)
    assert done["far"].made == ()
    # Three files of six rows each in parts of three.
    assert here.done.count("work_on_rows") == 6
    assert {p: p.stat().st_mtime_ns for p in times} == times
    found, made = bytes_of(whole), bytes_of(parts)
    assert made.keys() == found.keys()
    assert [name for name in found if made[name] != found[name]] == []


@pytest.mark.study
@pytest.mark.usefixtures("dated")
def test_rows_on_a_cluster_make_the_same_bytes_though_a_worker_is_killed(
    site: Path, tmp_path: Path
) -> None:
    here, cluster = tmp_path / "here", tmp_path / "cluster"
    assert main(["run", str(site), "-o", str(here), "--tile-rows", "1"]) == 0
    script = tmp_path / "kill.py"
    text = KILL.replace("*/samples.nc", "*/parts/*/*/rows.nc")
    script.write_text(
        text.replace("scheduler=address", "scheduler=address, tile_rows=1")
    )
    words = [sys.executable, str(script), str(site), str(cluster)]
    done = subprocess.run(
        words, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    found, made = bytes_of(here), bytes_of(cluster)
    assert made.keys() == found.keys()
    assert [name for name in found if made[name] != found[name]] == []


def test_a_scan_that_cannot_be_made_says_why_and_others_go_on(
    site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    text = site.read_text().replace('method = "polarization"', 'method = "frequency"')
    site.write_text(text)
    monkeypatch.setattr(site_run, "_steps", steps_that_refuse)
    assert main(["run", str(site), "-o", str(tmp_path / "out")]) == 1
    found = capsys.readouterr()
    assert "near: 0 files made" in found.out
    assert "1 of 2 scans stopped: far: no light" in " ".join(found.err.split())


def steps_that_refuse(task: site_run.Task, record: object) -> None:
    """Stand for the steps of a scan whose data are refused."""
    if task.name == "far":
        raise FormatError("no light")


def test_workers_without_a_local_cluster_are_wrong_use(
    site: Path, tmp_path: Path, capsys
) -> None:
    words = ["run", str(site), "-o", str(tmp_path / "out"), "--workers", "2"]
    assert main(words) == 2
    assert "--scheduler local" in capsys.readouterr().err


def test_no_zarr_is_written_by_tasks(site: Path, tmp_path: Path, capsys) -> None:
    # `dask.array.store` into shards that do not align with its chunks loses values
    # without a word: workers write whole netCDF files, and no array goes through dask.
    output = tmp_path / "out.zarr"
    for words in (
        ["simulate", str(tmp_path / "tank.toml")],
        ["reject", str(tmp_path / "cube.nc"), "--method", "none"],
        ["image", str(tmp_path / "target.nc")],
        ["export", str(tmp_path / "image.nc")],
    ):
        rows = [] if words[0] == "export" else ["--tile-rows", "4"]
        assert main([*words, "-o", str(output), *rows]) != 0
        assert ".nc" in capsys.readouterr().err
        assert not output.exists()
    sources = Path(site_run.__file__).parents[1].rglob("*.py")
    named = ("import zarr", "from zarr", "dask.array", "to_zarr", "from dask")
    found = [p for p in sources if any(n in p.read_text("utf-8") for n in named)]
    assert found == []
