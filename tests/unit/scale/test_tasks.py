"""Work items of a cluster, and the record of finished files, without a cluster."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Callable
from concurrent.futures import CancelledError
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import distributed
import numba
import pytest

from amulor.cube import digest
from amulor.cube.provenance import software_versions
from amulor.errors import FormatError
from amulor.scale import tasks


@dataclass(frozen=True, kw_only=True)
class Letters:
    """Work that writes a letter of a text into the file of each item."""

    text: str
    file: str = "letter.txt"

    def made_of(self, number: int) -> dict[str, Any]:
        return {"letter": self.text[number]}

    def write(self, number: int, path: Path) -> None:
        with path.open("a") as file:
            file.write(self.text[number])


class Now:
    """Client of a cluster that computes an item when its result is read."""

    def __init__(self, **threads: int) -> None:
        self.threads = threads
        self.submitted: list[int] = []
        self.cancelled: list[int] = []
        self.options: list[dict[str, Any]] = []
        self.result: Callable[[int, Callable[[], None]], None] = lambda _, make: make()

    def nthreads(self) -> dict[str, int]:
        return self.threads

    def submit(self, function: Any, *words: Any, **options: Any) -> Any:
        number = words[1]
        self.submitted.append(number)
        self.options.append(options)
        return SimpleNamespace(
            result=lambda: self.result(number, lambda: function(*words)),
            cancel=lambda: self.cancelled.append(number),
        )


def test_items_come_in_order_and_two_a_thread_wait(tmp_path: Path) -> None:
    client = Now(one=1, two=2)
    paths = tasks.in_order(client, tmp_path, Letters(text="abcdefghij"), 1, 10)
    assert next(paths) == tmp_path / "letter-000001" / "letter.txt"
    assert client.submitted == [1, 2, 3, 4, 5, 6]
    assert next(paths) == tmp_path / "letter-000002" / "letter.txt"
    assert client.submitted == [1, 2, 3, 4, 5, 6, 7]
    assert [path.read_text() for path in paths] == list("defghij")
    assert client.submitted == list(range(1, 10))
    assert client.options == [{"pure": False, "retries": 3}] * 9
    assert client.cancelled == []
    assert not (tmp_path / "letter-000000").exists()


def test_two_items_wait_for_the_first_worker_and_are_cancelled_at_the_end(
    tmp_path: Path,
) -> None:
    client = Now()
    paths: Any = tasks.in_order(client, tmp_path, Letters(text="abcd"), 0, 4)
    next(paths)
    assert client.submitted == [0, 1]
    paths.close()
    assert client.cancelled == [1]


def test_no_items_are_no_work(tmp_path: Path) -> None:
    client = Now(one=1)
    assert list(tasks.in_order(client, tmp_path, Letters(text=""), 3, 3)) == []
    assert client.submitted == []


def test_a_lost_cluster_names_the_piece_and_the_folder(tmp_path: Path) -> None:
    client = Now(one=1)

    def result(number: int, make: Callable[[], None]) -> None:
        if number == 1:
            raise CancelledError
        make()

    client.result = result
    paths = tasks.in_order(client, tmp_path, Letters(text="abc"), 0, 3)
    next(paths)
    with pytest.raises(FormatError) as caught:
        next(paths)
    assert str(caught.value) == (
        "the cluster was lost at piece 1; run the same again, and what is whole in "
        f"{tmp_path} is kept"
    )
    assert client.cancelled == [2]


def test_a_file_that_a_worker_made_elsewhere_is_missed(tmp_path: Path) -> None:
    client = Now(one=1)
    client.result = lambda number, make: None
    with pytest.raises(FormatError) as caught:
        next(tasks.in_order(client, tmp_path, Letters(text="ab"), 0, 2))
    assert str(caught.value) == (
        f"{tmp_path}/letter-000000/letter.txt is not what a worker has made there; "
        "workers need the disk of that folder, under the same name"
    )


def test_an_item_is_made_once_and_unfinished_files_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[str] = []
    monkeypatch.setattr(tasks, "set_up_worker", lambda: calls.append("set up"))
    packed = distributed.protocol.pickle.dumps(Letters(text="abc"))
    folder = tmp_path / "letter-000002"
    for _ in range(2):
        folder.mkdir(exist_ok=True)
        (folder / ".amulor-half").touch()
        tasks._do(packed, 2, str(tmp_path))
        assert sorted(path.name for path in folder.iterdir()) == [
            "letter.txt", "steps.json",
        ]  # fmt: skip
        # A second computation would append the letter again.
        assert (folder / "letter.txt").read_text() == "c"
    assert calls == ["set up", "set up"]
    step = json.loads((folder / "steps.json").read_text())["letter.txt"]
    assert json.loads(step["made_of"])["of"] == ""
    assert json.loads(step["made_of"])["how"] == {"letter": "c"}


@pytest.mark.parametrize(("threads", "expected"), [(3, 3), (1, 1), (0, 1)])
@pytest.mark.parametrize("profiles", [True, False])
def test_a_worker_compiles_for_its_threads_and_ends_its_profiler(
    monkeypatch: pytest.MonkeyPatch, threads: int, expected: int, profiles: bool
) -> None:
    called: list[str] = []
    stop = SimpleNamespace(stop="stop the profiler")
    worker = SimpleNamespace(
        state=SimpleNamespace(nthreads=threads),
        periodic_callbacks={"profile": stop} if profiles else {},
        loop=SimpleNamespace(add_callback=called.append),
    )
    monkeypatch.setattr(distributed, "get_worker", lambda: worker)
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 7)
    tasks.set_up_worker()
    assert expected == numba.config.NUMBA_NUM_THREADS
    assert called == (["stop the profiler"] if profiles else [])


def test_outside_of_a_worker_nothing_is_set_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 7)
    tasks.set_up_worker()
    monkeypatch.setitem(sys.modules, "distributed", None)
    tasks.set_up_worker()
    assert numba.config.NUMBA_NUM_THREADS == 7


@pytest.mark.parametrize(
    ("workers", "cores", "expected"), [(3, 8, 3), (None, 8, 8), (None, None, 1)]
)
def test_a_local_cluster_has_a_process_a_core_unless_stated(
    monkeypatch: pytest.MonkeyPatch,
    workers: int | None,
    cores: int | None,
    expected: int,
) -> None:
    options: list[dict[str, Any]] = []

    def local(**words: Any) -> Any:
        options.append(words)
        return nullcontext("cluster")

    monkeypatch.setattr(distributed, "LocalCluster", local)
    monkeypatch.setattr(
        distributed, "Client", lambda of: nullcontext(f"client of {of}")
    )
    monkeypatch.setattr(tasks.os, "cpu_count", lambda: cores)
    with tasks.cluster_client("local", workers) as client:
        assert client == "client of cluster"
    assert options == [
        {
            "n_workers": expected,
            "threads_per_worker": 1,
            "processes": True,
            "dashboard_address": None,
            "silence_logs": logging.ERROR,
        }
    ]


def test_a_client_of_a_scheduler_is_closed_after_use(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    closed: list[bool] = []

    class Client:
        def __init__(self, address: str, *, timeout: str) -> None:
            assert (address, timeout) == ("tcp://node1:8786", "5s")

        def __enter__(self) -> Client:
            return self

        def __exit__(self, *_: object) -> None:
            closed.append(True)

    monkeypatch.setattr(distributed, "Client", Client)
    with tasks.cluster_client("tcp://node1:8786", None) as client:
        assert isinstance(client, Client)
        assert not closed
    assert closed == [True]


@pytest.mark.parametrize("kind", [OSError, TimeoutError, ValueError])
def test_a_scheduler_that_is_not_there_is_named(
    monkeypatch: pytest.MonkeyPatch, kind: type[Exception]
) -> None:
    def client(address: str, timeout: str) -> Any:
        raise kind("gone")

    monkeypatch.setattr(distributed, "Client", client)
    with pytest.raises(FormatError) as caught, tasks.cluster_client("tcp://a:1", 2):
        pass
    assert str(caught.value) == (
        "no dask scheduler answers at tcp://a:1: gone; start one with `dask "
        "scheduler`, and name its address, such as tcp://node1:8786"
    )


def written(text: str) -> Callable[[Path], Any]:
    return lambda path: path.write_text(text)


def test_a_record_is_written_sorted_and_read_again(tmp_path: Path) -> None:
    record = tasks.Record(tmp_path)
    assert record.made("b.nc", of="x", how={"n": 1}, make=written("B")) == (
        tmp_path / "b.nc"
    )
    record.made("a.nc", of="y", how={}, make=written("A"))
    version = software_versions()["amulor"]
    steps = {
        name: {
            "digest": digest(text),
            "made_of": json.dumps({"amulor": version, "how": how, "of": of}),
        }
        for name, text, how, of in (
            ("a.nc", "A", {}, "y"),
            ("b.nc", "B", {"n": 1}, "x"),
        )
    }
    text = json.dumps(steps, indent=2) + "\n"
    assert (tmp_path / "steps.json").read_text() == text
    digests = {"a.nc": digest("A"), "b.nc": digest("B")}
    assert record.done("near") == tasks.Done(
        name="near", files=digests, made=("b.nc", "a.nc")
    )
    # Files of an earlier run are in the result once they are known to be whole.
    again = tasks.Record(tmp_path)
    assert again.done("near").files == {}
    path = again.made("b.nc", of="x", how={"n": 1}, make=written("new"))
    assert path.read_text() == "B"
    assert again.done("near", error="no light") == tasks.Done(
        name="near", files={"b.nc": digest("B")}, made=(), error="no light"
    )


@pytest.mark.parametrize("content", [None, "", "[1]", '{"a.nc": 1}', '"text"'])
def test_without_a_readable_record_all_is_made_again(
    tmp_path: Path, content: str | None
) -> None:
    if content is not None:
        (tmp_path / "steps.json").write_text(content)
    (tmp_path / "a.nc").write_text("old")
    record = tasks.Record(tmp_path)
    assert not record.is_made("a.nc", of="", how={})
    record.made("a.nc", of="", how={}, make=written("new"))
    assert record.done("").made == ("a.nc",)
    assert (tmp_path / "a.nc").read_text() == "new"


def test_a_recorded_file_that_is_lost_is_not_made(tmp_path: Path) -> None:
    tasks.Record(tmp_path).made("a.nc", of="", how={}, make=written("A"))
    assert tasks.Record(tmp_path).is_made("a.nc", of="", how={})
    assert not tasks.Record(tmp_path).is_made("b.nc", of="", how={})
    (tmp_path / "a.nc").unlink()
    assert not tasks.Record(tmp_path).is_made("a.nc", of="", how={})


def test_only_unfinished_files_are_tidied(tmp_path: Path) -> None:
    for name in (".amulor-1.nc", ".amulor-2", "amulor-3", "a.nc"):
        (tmp_path / name).touch()
    tasks.Record(tmp_path).tidy()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.nc", "amulor-3"]


def test_a_file_is_known_by_its_digest_if_recorded_and_by_its_size_otherwise(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "scan"
    folder.mkdir()
    record = tasks.Record(folder)
    record.made("a.nc", of="", how={}, make=written("A"))
    assert record.identity(folder / "a.nc") == digest("A")
    for path in (tmp_path / "a.nc", folder / "b.nc"):
        path.write_text("four")
        time = path.stat().st_mtime_ns
        assert record.identity(path) == f"4 B, {time} ns"


def test_a_file_that_cannot_be_read_is_named_with_the_remedy(tmp_path: Path) -> None:
    record = tasks.Record(tmp_path)
    path = tmp_path / "away.nc"
    words = (
        f"{path} cannot be read: No such file or directory; workers need the disk on "
        "which the site file is"
    )
    for call in (
        lambda: record.identity(path),
        lambda: record.is_made("a.nc", of=path, how={}),
        lambda: record.made("a.nc", of=path, how={}, make=written("A")),
        lambda: record.made("a.nc", of="", how={}, make=lambda made: path),
    ):
        with pytest.raises(FormatError) as caught:
            call()
        assert str(caught.value).replace("a.nc", "away.nc") == words
    assert str(tasks._unreadable(path, OSError("worn out"))).startswith(
        f"{path} cannot be read: worn out; workers"
    )


def test_a_task_has_the_settings_of_its_scan(tmp_path: Path) -> None:
    processing = SimpleNamespace(
        method="open-water", polarization="VV", nearest=0.5, farthest=3.0
    )
    scans = [
        SimpleNamespace(
            name="near", file=Path("near.nc"), simulated_from=Path("tank.toml"),
            seed=3, processing=processing, trajectory=None,
        ),
        SimpleNamespace(
            name="line", file=Path("line.nc"), simulated_from=None, seed=1,
            processing=None, trajectory="dive.toml",
        ),
    ]  # fmt: skip
    site: Any = SimpleNamespace(scan=scans)
    when = "2026-05-04T12:30:00+00:00"
    folder = tmp_path / "out" / ".." / "results"
    near, line = tasks.tasks_of(site, folder, started=when, tile_rows=4)
    assert near == tasks.Task(
        name="near", file="near.nc", simulated_from="tank.toml", seed=3,
        method="open-water", polarization="VV", interval=(0.5, 3.0),
        folder=str(tmp_path / "results" / "near"), started=when, tile_rows=4,
        moves=False,
    )  # fmt: skip
    assert line == tasks.Task(
        name="line", file="line.nc", simulated_from=None, seed=1,
        method=None, polarization=None, interval=None,
        folder=str(tmp_path / "results" / "line"), started=when, tile_rows=4,
        moves=True,
    )  # fmt: skip
    defaults = tasks.tasks_of(site, folder, started=when)
    assert [task.tile_rows for task in defaults] == [None, None]


def test_a_task_for_a_cube_at_rest_makes_a_cloud_by_default() -> None:
    task = tasks.Task(
        name="", file="", simulated_from=None, seed=1, method=None, polarization=None,
        interval=None, folder="", started="",
    )  # fmt: skip
    assert (task.tile_rows, task.moves) == (None, False)
