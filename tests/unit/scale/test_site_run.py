"""The run of a site: its scans in order, its date, and its tasks on a cluster."""

from __future__ import annotations

import datetime
import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import distributed
import pytest
import xarray as xr

from amulor import _progress
from amulor import cube as cubes
from amulor.errors import CubeError, FormatError, MissingExtraError
from amulor.scale import site_run
from amulor.scale.tasks import Done, Record, Task

WHEN = "2026-05-04T12:30:00+00:00"


def task_in(folder: Path, name: str = "near") -> Task:
    return Task(
        name=name, file="", simulated_from=None, seed=1, method=None,
        polarization=None, interval=None, folder=str(folder / name), started=WHEN,
    )  # fmt: skip


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Stand in for three steps; list what is made, and the date at which."""
    listed: list[str] = []

    def chain(task: Task) -> tuple[Any, ...]:
        listed.append(f"chain of {task.name}")
        return tuple(
            SimpleNamespace(name=name, of=f"of {name}", how={"step": name})
            for name in ("a.nc", "b.nc", "c.ply")
        )

    def whole(step: Any, path: Path) -> None:
        history = cubes.note(xr.Dataset(), "made").attrs["history"]
        listed.append(f"{step.name} at {history.split()[0]}")
        path.write_text(step.name)

    monkeypatch.setattr(site_run, "chain", chain)
    monkeypatch.setattr(site_run, "whole", whole)
    monkeypatch.setattr(
        site_run, "forget_parts", lambda step: listed.append(f"parts of {step.name}")
    )
    monkeypatch.setattr(site_run, "set_up_worker", lambda: listed.append("set up"))
    return listed


def test_all_files_of_a_scan_have_the_date_of_the_run(
    tmp_path: Path, made: list[str]
) -> None:
    task = task_in(tmp_path)
    done = site_run.work(task)
    assert made == [
        "set up", "chain of near",
        "a.nc at 2026-05-04T12:30:00Z", "parts of a.nc",
        "b.nc at 2026-05-04T12:30:00Z", "parts of b.nc",
        "c.ply at 2026-05-04T12:30:00Z", "parts of c.ply",
    ]  # fmt: skip
    assert (done.name, done.made, done.error) == ("near", ("a.nc", "b.nc", "c.ply"), "")
    assert list(done.files) == ["a.nc", "b.nc", "c.ply"]
    (Path(task.folder) / ".amulor-half").touch()
    again = site_run.work(task)
    assert (again.files, again.made) == (done.files, ())
    assert not (Path(task.folder) / ".amulor-half").exists()


def test_a_task_may_make_one_file_only(tmp_path: Path, made: list[str]) -> None:
    task = task_in(tmp_path)
    assert site_run.work(task, "b.nc").made == ("b.nc",)
    assert sorted(path.name for path in Path(task.folder).iterdir()) == [
        "b.nc", "steps.json",
    ]  # fmt: skip
    assert "parts of b.nc" in made
    assert "parts of a.nc" not in made
    assert [site_run.is_made(task, name) for name in ("a.nc", "b.nc")] == [False, True]


def test_a_file_made_from_another_input_is_not_made(
    tmp_path: Path, made: list[str]
) -> None:
    task = task_in(tmp_path)
    Path(task.folder).mkdir()
    Record(Path(task.folder)).made(
        "b.nc", of="another", how={"step": "b.nc"}, make=lambda p: p.write_text("")
    )
    assert not site_run.is_made(task, "b.nc")


@pytest.mark.parametrize("kind", [CubeError, ValueError])
def test_what_stops_a_scan_is_its_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: type[Exception]
) -> None:
    def refuse(*words: object, **named: object) -> None:
        raise kind("no light")

    task = task_in(tmp_path)
    monkeypatch.setattr(site_run, "chain", refuse)
    monkeypatch.setattr(site_run, "make_part", refuse)
    stopped = Done(name="near", files={}, made=(), error="no light")
    assert site_run.work(task) == stopped
    assert site_run.work_on_rows(task, "a.nc", 0, 2) == "no light"
    if kind is CubeError:
        assert site_run.is_made(task, "a.nc") is False


def test_rows_of_a_file_are_made_at_the_date_of_the_run(
    tmp_path: Path, made: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[object] = []

    def make_part(*words: object) -> None:
        history = cubes.note(xr.Dataset(), "made").attrs["history"]
        calls.append((*words, history.split()[0]))

    monkeypatch.setattr(site_run, "make_part", make_part)
    task = task_in(tmp_path)
    assert site_run.work_on_rows(task, "a.nc", 2, 5) == ""
    assert calls == [(task, "a.nc", 2, 5, "2026-05-04T12:30:00Z")]
    assert made == ["set up"]


@pytest.fixture
def site(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[dict[str, Any]]:
    """Stand in for a site of three scans; list how its tasks are made."""
    asked: list[dict[str, Any]] = []

    def tasks_of(site: object, folder: Path, **options: Any) -> tuple[Task, ...]:
        asked.append({"site": site, "folder": folder, **options})
        return tuple(task_in(folder, name) for name in ("a", "b", "c"))

    monkeypatch.setattr(site_run.Site, "from_toml", lambda path: f"site of {path.name}")
    monkeypatch.setattr(site_run, "tasks_of", tasks_of)
    monkeypatch.setattr(site_run, "_started", lambda folder: WHEN)
    return asked


def done(name: str, error: str = "") -> Done:
    return Done(name=name, files={}, made=(), error=error)


def test_a_run_without_a_cluster_makes_scan_after_scan(
    tmp_path: Path, site: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[str, float]] = []
    monkeypatch.setattr(site_run, "work", lambda task: done(task.name))
    monkeypatch.setattr(site_run, "require", lambda *words, **named: told.append(words))
    with _progress.listening(lambda step, share: told.append((step, share))):
        found = site_run.run_site("site.toml", tmp_path / "out", tile_rows=4)
    assert found == (done("a"), done("b"), done("c"))
    assert told == [("scan a", 0), ("scan b", 1 / 3), ("scan c", 2 / 3)]
    assert (tmp_path / "out").is_dir()
    assert site == [
        {
            "site": "site of site.toml",
            "folder": tmp_path / "out",
            "started": WHEN,
            "tile_rows": 4,
        }
    ]


def test_a_run_on_a_cluster_has_the_order_of_the_site(
    tmp_path: Path, site: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[str, float]] = []
    asked: list[object] = []

    @contextmanager
    def cluster(scheduler: str, workers: int | None) -> Iterator[str]:
        asked.append((scheduler, workers))
        yield "client"

    def on_cluster(client: object, tasks: tuple[Task, ...]) -> Iterator[Done]:
        asked.append((client, [task.name for task in tasks]))
        yield from (done("c"), done("a", "no light"), done("b"))

    monkeypatch.setattr(site_run, "cluster_client", cluster)
    monkeypatch.setattr(site_run, "_on_cluster", on_cluster)
    with _progress.listening(lambda step, share: told.append((step, share))):
        found = site_run.run_site(
            "site.toml", tmp_path / "out", scheduler="local", workers=2
        )
    assert found == (done("a", "no light"), done("b"), done("c"))
    assert asked == [("local", 2), ("client", ["a", "b", "c"])]
    assert told == [("scan c done", 1 / 3), ("scan a done", 2 / 3), ("scan b done", 1)]
    assert site[0]["tile_rows"] is None


def test_a_cluster_without_its_packages_is_refused_before_all_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def require(*extras: str, purpose: str) -> None:
        raise MissingExtraError("dask", extra=",".join(extras), purpose=purpose)

    monkeypatch.setattr(site_run, "require", require)
    with pytest.raises(MissingExtraError, match=r"a cluster needs dask.*\[scale\]"):
        site_run.run_site("none.toml", tmp_path / "out", scheduler="local")
    assert not (tmp_path / "out").exists()


def test_a_run_that_goes_on_keeps_its_first_date(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    first = "2023-11-14T22:13:20+00:00"
    assert site_run._started(tmp_path) == first
    path = tmp_path / "run.json"
    assert path.read_text() == f'{{"started": "{first}"}}\n'
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1800000000")
    assert site_run._started(tmp_path) == first
    # A date that cannot be read is stated anew.
    for text in ("", "[]", "{}", '{"started": "yesterday"}', '{"started": 5}'):
        path.write_text(text)
        assert site_run._started(tmp_path) == "2027-01-15T08:00:00+00:00"
        assert json.loads(path.read_text())["started"] == "2027-01-15T08:00:00+00:00"


@pytest.mark.parametrize("epoch", [None, "soon"])
def test_a_run_begins_now_in_whole_seconds_of_universal_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, epoch: str | None
) -> None:
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    if epoch is not None:
        monkeypatch.setenv("SOURCE_DATE_EPOCH", epoch)
    before = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    started = datetime.datetime.fromisoformat(site_run._started(tmp_path))
    assert before <= started <= datetime.datetime.now(datetime.UTC)
    assert started.microsecond == 0
    assert started.utcoffset() == datetime.timedelta(0)


class Orders:
    """Client that notes what is submitted, and the list of unfinished tasks."""

    def __init__(self) -> None:
        self.orders: list[tuple[Any, ...]] = []
        self.options: list[dict[str, Any]] = []
        self.futures: list[Any] = []

    def submit(
        self, function: Any, task: Task, *words: object, **options: Any
    ) -> object:
        self.orders.append((function.__name__, task.name, *words))
        self.options.append(options)
        return SimpleNamespace(key=f"key {len(self.orders)}")

    def add(self, future: Any) -> None:
        self.futures.append(future)

    def __iter__(self) -> Iterator[Any]:
        while self.futures:
            yield self.futures.pop(0)


@pytest.fixture
def orders() -> Orders:
    return Orders()


@pytest.fixture
def spread(orders: Orders) -> site_run._Spread:
    return site_run._Spread(orders, orders)


def after(
    spread: site_run._Spread, orders: Orders, answer: object, error: str = ""
) -> Done | None:
    """Finish the task that was submitted first, with an answer or an error."""
    future = orders.futures.pop(0)
    future.result = lambda: answer
    return spread.after(future, error)


def test_a_small_scan_is_one_task(
    tmp_path: Path, spread: site_run._Spread, orders: Orders
) -> None:
    spread.begin(task_in(tmp_path), [])
    assert orders.orders == [("work", "near")]
    assert orders.options == [{"pure": False, "retries": 3}]
    found = Done(name="near", files={"a": "b"}, made=("a",), error="")
    assert after(spread, orders, found) == found
    assert orders.futures == []


def test_files_that_are_made_are_passed_over(
    tmp_path: Path, spread: site_run._Spread, orders: Orders
) -> None:
    spread.begin(task_in(tmp_path), ["a.nc", "b.nc"])
    assert after(spread, orders, True) is None
    assert after(spread, orders, True) is None
    assert orders.orders == [
        ("is_made", "near", "a.nc"), ("is_made", "near", "b.nc"), ("work", "near"),
    ]  # fmt: skip


@pytest.mark.parametrize("kind", [CubeError, ValueError])
def test_a_file_that_cannot_be_divided_here_is_left_to_a_worker(
    tmp_path: Path,
    spread: site_run._Spread,
    orders: Orders,
    monkeypatch: pytest.MonkeyPatch,
    kind: type[Exception],
) -> None:
    def parts_of(task: Task, name: str) -> list[tuple[int, int]]:
        raise kind("unreadable here")

    monkeypatch.setattr(site_run, "parts_of", parts_of)
    spread.begin(task_in(tmp_path), ["a.nc", "b.nc"])
    assert after(spread, orders, False) is None
    assert orders.orders[1:] == [("work", "near")]
    assert after(spread, orders, done("near")) == done("near")


def test_a_worker_that_dies_stops_its_scan(
    tmp_path: Path, spread: site_run._Spread, orders: Orders
) -> None:
    for stages in ([], ["a.nc"]):
        spread.begin(task_in(tmp_path), stages)
        found = after(spread, orders, "not read", "the worker died")
        assert found == done("near", "the worker died")
        assert orders.futures == []


def test_of_several_faults_of_rows_the_first_is_reported(
    tmp_path: Path,
    spread: site_run._Spread,
    orders: Orders,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(site_run, "parts_of", lambda *_: [(0, 1), (1, 2), (2, 3)])
    spread.begin(task_in(tmp_path), ["a.nc"])
    assert after(spread, orders, False) is None
    assert orders.orders[1:] == [
        ("work_on_rows", "near", "a.nc", row, row + 1) for row in range(3)
    ]
    assert after(spread, orders, "") is None
    assert after(spread, orders, None, "the worker died") is None
    assert after(spread, orders, "the disk is full") == done("near", "the worker died")


def test_a_file_that_cannot_be_joined_stops_its_scan(
    tmp_path: Path,
    spread: site_run._Spread,
    orders: Orders,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(site_run, "parts_of", lambda *_: [(0, 1)])
    spread.begin(task_in(tmp_path), ["a.nc", "b.nc"])
    after(spread, orders, False)
    after(spread, orders, "")
    joined = Done(name="near", files={}, made=("a.nc",), error="")
    assert after(spread, orders, joined) is None
    assert orders.orders[-1] == ("is_made", "near", "b.nc")
    after(spread, orders, False)
    after(spread, orders, "")
    assert orders.orders[-1] == ("work", "near", "b.nc")
    found = after(spread, orders, done("near", "no light"))
    assert found == Done(name="near", files={}, made=("a.nc",), error="no light")
    assert orders.futures == []


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (None, ""),
        (OSError("the worker\n   died"), "the worker died"),
        (TimeoutError(), "TimeoutError"),
    ],
)
def test_results_of_a_cluster_come_as_they_are_done(
    tmp_path: Path,
    orders: Orders,
    monkeypatch: pytest.MonkeyPatch,
    error: Exception | None,
    words: str,
) -> None:
    def answered(add: Callable[[Any], None]) -> Callable[[Any], None]:
        def with_answer(future: Any) -> None:
            name = orders.orders[-1][1]
            future.exception = lambda: error
            future.result = lambda: done(name)
            add(future)

        return with_answer

    orders.add = answered(orders.add)
    monkeypatch.setattr(distributed, "as_completed", lambda: orders)
    monkeypatch.setattr(site_run, "splits", lambda task: ())
    tasks = tuple(task_in(tmp_path, name) for name in ("a", "b"))
    found = list(site_run._on_cluster(orders, tasks))
    assert found == [done("a", words), done("b", words)]


def test_a_large_scan_is_divided_on_a_cluster(
    tmp_path: Path, orders: Orders, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(distributed, "as_completed", lambda: orders)
    monkeypatch.setattr(site_run, "splits", lambda task: ("a.nc",))
    add = orders.add

    def with_error(future: Any) -> None:
        future.exception = lambda: FormatError("lost")
        add(future)

    orders.add = with_error
    found = list(site_run._on_cluster(orders, (task_in(tmp_path),)))
    assert orders.orders == [("is_made", "near", "a.nc")]
    assert found == [done("near", "lost")]
