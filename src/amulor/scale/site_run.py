"""Scans of a site through all steps, here or on a cluster: files with digests.

What is done stays done: each file is recorded with its digest and with what it was made
of. A run that begins again, after a worker or the scheduler has died, takes up what it
finds and makes the rest.
"""

from __future__ import annotations

import datetime
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from amulor import imaging, io
from amulor._extras import require
from amulor._progress import tell
from amulor.cube.provenance import dated, digest, software_versions
from amulor.errors import AmulorError, CubeError, FormatError
from amulor.io.files import atomic_output
from amulor.io.netcdf_rows import open_rows
from amulor.scale.files import image_file, reject_file
from amulor.scale.steps import WITH_INTERVAL
from amulor.simulation import simulate
from amulor.site import Site
from amulor.survey import Survey

__all__ = ["Done", "Task", "run_site", "tasks_of", "work"]

#: How often a scan is begun again whose worker has died.
RETRIES = 3
#: Name of the file that says what is done, in the folder of each scan.
RECORD = "steps.json"
#: Word for a cluster of processes on this machine.
LOCAL = "local"


@dataclass(frozen=True, kw_only=True)
class Task:
    """One scan, with all that a worker needs; the files are on a shared disk."""

    name: str
    """Of the scan."""
    file: str
    """Its cube; not looked at if it is simulated."""
    simulated_from: str | None
    """Survey that it is simulated from."""
    seed: int
    """Seed of that simulation."""
    method: str | None
    """Rejection method; none is needed for a range image."""
    polarization: str | None
    """Channel to take."""
    interval: tuple[float, float] | None
    """Nearest and farthest slant range [m]."""
    folder: str
    """Where its files go."""
    started: str
    """When the run began for the first time (ISO 8601): all of it is dated so."""


@dataclass(frozen=True, kw_only=True)
class Done:
    """What became of a scan."""

    name: str
    """Of the scan."""
    files: dict[str, str]
    """Digests by the names of files in its folder."""
    made: tuple[str, ...]
    """Files that were made now; the others were there."""
    error: str = ""
    """Why it stopped; empty if all is there."""


def tasks_of(site: Site, output: Path, *, started: str) -> tuple[Task, ...]:
    """Return one task for each scan of a site.

    Parameters
    ----------
    site : Site
        With whole paths.
    output : pathlib.Path
        Folder that gets one for each scan.
    started : str
        When the run began for the first time (ISO 8601).

    Returns
    -------
    tuple of Task
        In the order of the site file.
    """
    tasks = []
    for scan in site.scan:
        how = scan.processing
        interval = None
        if how is not None and how.nearest is not None and how.farthest is not None:
            interval = (how.nearest, how.farthest)
        tasks.append(
            Task(
                name=scan.name,
                file=str(scan.file),
                simulated_from=(
                    None if scan.simulated_from is None else str(scan.simulated_from)
                ),
                seed=int(scan.seed),
                method=None if how is None else how.method,
                polarization=None if how is None else how.polarization,
                interval=interval,
                folder=str((output / scan.name).resolve()),
                started=started,
            )
        )
    return tuple(tasks)


def work(task: Task) -> Done:
    """Take a scan through its steps: samples, target signal, range image, cloud.

    Parameters
    ----------
    task : Task
        One scan.

    Returns
    -------
    Done
        With the reason if a step refuses its data.
    """
    _set_up_worker()
    record = _Record(Path(task.folder))
    try:
        with dated(datetime.datetime.fromisoformat(task.started)):
            _steps(task, record)
    except (AmulorError, ValueError) as error:
        return record.done(task.name, error=str(error))
    return record.done(task.name)


def _steps(task: Task, record: _Record) -> None:
    io.make_folder(task.folder)
    options: dict[str, Any] = {"interval": task.interval}
    current = Path(task.file)
    if task.simulated_from is not None:
        survey = Path(task.simulated_from)
        current = record.made(
            "samples.nc",
            of=survey,
            how={"step": "simulate", "seed": task.seed},
            make=lambda path: io.write_cube(
                simulate(Survey.from_toml(survey), rng=task.seed), path, overwrite=True
            ),
        )
    level = _level_of(current)
    if level in ("samples", "target_signal") and task.method is None:
        raise CubeError(
            f"scan {task.name!r}: {current} holds {level}, not a range image; state "
            "[scan.processing] with a method"
        )
    if level == "samples":
        source, method = current, str(task.method)
        own = options if method in WITH_INTERVAL else {}
        current = record.made(
            "target_signal.nc",
            of=source,
            how={"step": "reject", "method": method, **own},
            make=lambda path: reject_file(source, path, method, overwrite=True, **own),
        )
    if level != "range_image":
        target = current
        options["polarization"] = task.polarization
        current = record.made(
            "range_image.nc",
            of=target,
            how={"step": "image", **options},
            make=lambda path: image_file(target, path, overwrite=True, **options),
        )
    image = current
    record.made(
        "cloud.ply",
        of=image,
        how={"step": "cloud"},
        make=lambda path: io.write_cloud(
            imaging.point_cloud(io.read_cube(image)), path, overwrite=True
        ),
    )


class _Record:
    """What is done of a scan, in a file beside its results."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._new: list[str] = []
        self._steps: dict[str, dict[str, str]] = {}
        try:
            found = json.loads((folder / RECORD).read_text("utf-8"))
            self._steps = {str(name): dict(step) for name, step in found.items()}
        except (OSError, ValueError, TypeError, AttributeError):
            # None yet, or a record that is no record: everything is made anew.
            self._steps = {}
        self._now: dict[str, str] = {}
        # What a worker that died was writing; a scan is in one worker at a time.
        for left in folder.glob(".amulor-*"):
            left.unlink(missing_ok=True)

    def made(
        self, name: str, *, of: Path, how: dict[str, Any], make: Callable[[Path], Any]
    ) -> Path:
        """Return a file, made now unless it is there, whole, and made of the same."""
        path = self._folder / name
        version = software_versions()["amulor"]
        made_of = json.dumps(
            {"of": _digest_of(of), "how": how, "amulor": version}, sort_keys=True
        )
        before = self._steps.get(name, {})
        if (
            before.get("made_of") == made_of
            and path.is_file()
            and _digest_of(path) == before.get("digest")
        ):
            self._now[name] = before["digest"]
            return path
        make(path)
        self._new.append(name)
        self._now[name] = _digest_of(path)
        self._steps[name] = {"made_of": made_of, "digest": self._now[name]}
        text = json.dumps(self._steps, indent=2, sort_keys=True) + "\n"
        with atomic_output(self._folder / RECORD, overwrite=True) as temporary:
            temporary.write_text(text, "utf-8")
        return path

    def done(self, name: str, *, error: str = "") -> Done:
        """Return what became of the scan."""
        return Done(
            name=name, files=dict(self._now), made=tuple(self._new), error=error
        )


def _digest_of(path: Path) -> str:
    try:
        return digest(path)
    except OSError as error:
        raise FormatError(
            f"{path} cannot be read: {error.strerror or error}; workers need the disk "
            "on which the site file is"
        ) from error


def _level_of(path: Path) -> str:
    with open_rows(path) as rows:
        return str(rows.head.attrs.get("level"))


def _set_up_worker() -> None:
    """Give compiled loops the threads of the worker, and end its sampling profiler."""
    try:
        import distributed

        dask: Any = distributed
        worker = dask.get_worker()
    except (ImportError, ValueError):
        return
    import numba

    config: Any = numba.config
    config.NUMBA_NUM_THREADS = max(int(worker.state.nthreads), 1)
    # It holds the frames that it looks at, and so objects of HDF5 that were about to
    # be closed: the same content then lies elsewhere in the file.
    profiler = worker.periodic_callbacks.get("profile")
    if profiler is not None:
        worker.loop.add_callback(profiler.stop)


def run_site(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    scheduler: str | None = None,
    workers: int | None = None,
) -> tuple[Done, ...]:
    """Take all scans of a site through their steps.

    Parameters
    ----------
    path : path-like
        Site file (TOML).
    output : path-like
        Folder for the results, made if it is not there; that of a run before is taken
        up. On a cluster all workers see it under this name.
    scheduler : str, optional
        Address of a dask scheduler, such as "tcp://node1:8786", or "local" for
        processes on this machine; by default one scan after the other, here.
    workers : int, optional
        Number of processes of "local"; one for each processor by default.

    Returns
    -------
    tuple of Done
        In the order of the site file.

    Raises
    ------
    SurveyError
        If the site file is wrong.
    MissingExtraError
        If dask is needed and not installed.
    FormatError
        If the folder cannot be made, or nobody answers at the address.

    Notes
    -----
    Files have the same bytes wherever they are made: all of a run is dated by its first
    start, which stands in `run.json`. A scan whose worker dies is begun again on
    another one, from its last whole file.
    """
    if scheduler is not None:
        require("scale", purpose="a cluster")
    site = Site.from_toml(Path(path))
    folder = Path(output)
    io.make_folder(folder)
    tasks = tasks_of(site, folder, started=_started(folder))
    found: dict[str, Done] = {}
    if scheduler is None:
        for number, task in enumerate(tasks):
            tell(f"scan {task.name}", number / len(tasks))
            found[task.name] = work(task)
    else:
        with _client(scheduler, workers) as client:
            for done in _spread_out(client, tasks):
                found[done.name] = done
                tell(f"scan {done.name} done", len(found) / len(tasks))
    return tuple(found[task.name] for task in tasks)


def _started(folder: Path) -> str:
    """Return when a run began for the first time."""
    path = folder / "run.json"
    try:
        stated = str(json.loads(path.read_text("utf-8"))["started"])
        datetime.datetime.fromisoformat(stated)
        return stated
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


@contextmanager
def _client(scheduler: str, workers: int | None) -> Iterator[Any]:
    """Connect to a cluster, or start one on this machine."""
    import distributed

    # Its functions have no types.
    dask: Any = distributed
    if scheduler == LOCAL:
        count = workers or os.cpu_count() or 1
        with (
            dask.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                dashboard_address=None,
            ) as cluster,
            dask.Client(cluster) as client,
        ):
            yield client
        return
    try:
        client = dask.Client(scheduler, timeout="15s")
    except (OSError, TimeoutError, ValueError) as error:
        raise FormatError(
            f"no dask scheduler answers at {scheduler}: {error}; start one with "
            "`dask scheduler`, and name its address, such as tcp://node1:8786"
        ) from error
    with client:
        yield client


def _spread_out(client: Any, tasks: tuple[Task, ...]) -> Iterator[Done]:
    """Yield what becomes of tasks, as it comes."""
    import distributed

    dask: Any = distributed
    futures = client.map(work, tasks, pure=False, retries=RETRIES)
    names = {future.key: task.name for future, task in zip(futures, tasks, strict=True)}
    for future in dask.as_completed(futures):
        error = future.exception()
        if error is None:
            yield future.result()
        else:
            # Such as a worker that died time and again.
            said = " ".join(str(error).split()) or type(error).__name__
            yield Done(name=names[future.key], files={}, made=(), error=said)
