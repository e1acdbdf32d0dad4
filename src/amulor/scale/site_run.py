"""Processing of all scans of a site, on this computer or on a cluster.

What is done stays done: each file is recorded with its digest and with what it was made
of. A run that begins again, after a worker or the scheduler has died, takes up what it
finds and makes the rest.
"""

from __future__ import annotations

import datetime
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from amulor import io
from amulor._extras import require
from amulor._progress import tell
from amulor.cube.provenance import dated
from amulor.errors import AmulorError
from amulor.io.files import atomic_output
from amulor.scale.parts import (
    chain,
    forget_parts,
    make_part,
    parts_of,
    splits,
    whole,
)
from amulor.scale.tasks import (
    RETRIES,
    Done,
    Record,
    Task,
    cluster_client,
    set_up_worker,
    tasks_of,
)
from amulor.site import Site

__all__ = ["Done", "Task", "is_made", "run_site", "work", "work_on_rows"]


def work(task: Task, until: str | None = None) -> Done:
    """Compute all files of a scan, up to the point cloud, or only the file `until`."""
    set_up_worker()
    record = Record(Path(task.folder))
    record.tidy()
    try:
        with dated(datetime.datetime.fromisoformat(task.started)):
            _steps(task, record, *([] if until is None else [until]))
    except (AmulorError, ValueError) as error:
        return record.done(task.name, error=str(error))
    return record.done(task.name)


def is_made(task: Task, name: str) -> bool:
    """Return whether a scan's file is complete and was made from the present inputs."""
    try:
        (step,) = (step for step in chain(task) if step.name == name)
        return Record(Path(task.folder)).is_made(name, of=step.of, how=step.how)
    except AmulorError:
        return False


def work_on_rows(task: Task, name: str, begin: int, end: int) -> str:
    """Compute some rows of a file; return the error message, empty if none."""
    set_up_worker()
    try:
        with dated(datetime.datetime.fromisoformat(task.started)):
            make_part(task, name, begin, end)
    except (AmulorError, ValueError) as error:
        return str(error)
    return ""


def _steps(task: Task, record: Record, until: str | None = None) -> None:
    io.make_folder(task.folder)
    for step in chain(task):
        # The input files exist, because the task is started only after them.
        if until in (None, step.name):
            record.made(step.name, of=step.of, how=step.how, make=partial(whole, step))
            forget_parts(step)


def run_site(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    scheduler: str | None = None,
    workers: int | None = None,
    tile_rows: int | None = None,
) -> tuple[Done, ...]:
    """Process all scans of a site.

    Files have equal bytes wherever they are made, because all dates are those of the
    first start of the run, which is stored in `run.json`. If a worker dies, another one
    continues its scan from the last complete file.
    """
    if scheduler is not None:
        require("scale", purpose="a cluster")
    site = Site.from_toml(Path(path))
    folder = Path(output)
    io.make_folder(folder)
    tasks = tasks_of(site, folder, started=_started(folder), tile_rows=tile_rows)
    results: dict[str, Done] = {}
    if scheduler is None:
        for number, task in enumerate(tasks):
            tell(f"scan {task.name}", number / len(tasks))
            results[task.name] = work(task)
    else:
        with cluster_client(scheduler, workers) as client:
            for result in _on_cluster(client, tasks):
                results[result.name] = result
                tell(f"scan {result.name} done", len(results) / len(tasks))
    return tuple(results[task.name] for task in tasks)


def _started(folder: Path) -> str:
    """Return the time at which the run in a folder was first started."""
    path = folder / "run.json"
    try:
        started = str(json.loads(path.read_text("utf-8"))["started"])
        datetime.datetime.fromisoformat(started)
        return started
    except (OSError, ValueError, KeyError, TypeError):
        pass
    # The convention of reproducible builds.
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    now = datetime.datetime.now(datetime.UTC).replace(microsecond=0)
    if epoch.isdigit():
        now = datetime.datetime.fromtimestamp(int(epoch), datetime.UTC)
    with atomic_output(path, overwrite=True) as temporary:
        temporary.write_text(json.dumps({"started": now.isoformat()}) + "\n", "utf-8")
    return now.isoformat()


def _on_cluster(client: Any, tasks: tuple[Task, ...]) -> Iterator[Done]:
    """Run tasks on a cluster; yield their results in order of completion."""
    import distributed

    dask: Any = distributed
    spread = _Spread(client, dask.as_completed())
    for task in tasks:
        spread.begin(task, list(splits(task)))
    for future in spread.futures:
        error = future.exception()
        # For example, a worker that died repeatedly.
        message = ""
        if error is not None:
            message = " ".join(str(error).split()) or type(error).__name__
        result = spread.after(future, message)
        if result is not None:
            yield result


@dataclass(kw_only=True)
class _Underway:
    """Scan in progress on a cluster, with its remaining files and tasks."""

    task: Task
    stages: list[str]
    """Files with separate tasks for their rows, in order."""
    left: int = 0
    """Number of unfinished tasks."""
    made: list[str] = field(default_factory=list)
    error: str = ""


class _Spread:
    """Distributor of tasks on a cluster, which divides large scans by file and rows."""

    def __init__(self, client: Any, futures: Any) -> None:
        self._client, self.futures = client, futures
        self._known: dict[str, tuple[_Underway, str]] = {}

    def begin(self, task: Task, stages: list[str]) -> None:
        """Start the tasks of a scan."""
        self._next(_Underway(task=task, stages=stages))

    def _next(self, scan: _Underway) -> None:
        """Submit the check of a scan's next file, or its remaining work without one."""
        if scan.stages:
            self._submit("asked", scan, is_made, scan.stages[0])
        else:
            self._submit("rest", scan, work)

    def _submit(self, kind: str, scan: _Underway, function: Any, *words: Any) -> None:
        future = self._client.submit(
            function, scan.task, *words, pure=False, retries=RETRIES
        )
        self._known[future.key] = scan, kind
        self.futures.add(future)

    def after(self, future: Any, error: str) -> Done | None:
        """Continue a scan after a finished task; return the result after the last."""
        scan, kind = self._known.pop(future.key)
        answer = None if error else future.result()
        name = scan.stages[0] if scan.stages else ""
        if kind == "asked" and answer:
            scan.stages.pop(0)
            self._next(scan)
        elif kind == "asked" and not error:
            try:
                parts = parts_of(scan.task, name)
            except (AmulorError, ValueError):
                # A worker says why; it need not be so there.
                scan.stages = []
                self._next(scan)
                return None
            scan.left = len(parts)
            for begin, end in parts:
                self._submit("rows", scan, work_on_rows, name, begin, end)
        elif kind == "rows":
            scan.error = scan.error or error or str(answer)
            scan.left -= 1
            if scan.left:
                return None
            if scan.error:
                return self._stopped(scan, scan.error)
            self._submit("joined", scan, work, name)
        elif error:
            return self._stopped(scan, error)
        else:
            assert isinstance(answer, Done)
            scan.made += answer.made
            if answer.error or kind == "rest":
                return replace(answer, made=tuple(scan.made))
            scan.stages.pop(0)
            self._next(scan)
        return None

    def _stopped(self, scan: _Underway, error: str) -> Done:
        made = tuple(scan.made)
        return Done(name=scan.task.name, files={}, made=made, error=error)
