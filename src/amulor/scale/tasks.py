"""Processing tasks of a site, one per scan, with a record of finished files."""

from __future__ import annotations

import json
import logging
import os
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

from amulor import io
from amulor.cube.provenance import digest, software_versions
from amulor.errors import FormatError
from amulor.io.files import atomic_output
from amulor.site import Site
from amulor.site.load import options_of

__all__ = ["RECORD", "Done", "Record", "Task", "Work", "in_order", "tasks_of"]


#: Name of the record file in the folder of each scan.
RECORD = "steps.json"


@dataclass(frozen=True, kw_only=True)
class Task:
    """Processing task for one scan, with paths on a shared disk."""

    name: str
    """Name of the scan."""
    file: str
    """Cube of the scan; not used for a simulated scan."""
    simulated_from: str | None
    """Survey of a simulated scan."""
    seed: int
    """Seed of the simulation."""
    method: str | None
    """Rejection method; None for a range image."""
    polarization: str | None
    """Polarization channel."""
    interval: tuple[float, float] | None
    """Nearest and farthest slant range [m]."""
    folder: str
    """Folder of the files."""
    started: str
    """First start of the run (ISO 8601), the date of all its files."""
    tile_rows: int | None = None
    """Rows of a tile; None for a quarter of a million
    samples."""
    moves: bool = False
    """Whether the instrument moved during the scan: no cloud in its own axes."""


@dataclass(frozen=True, kw_only=True)
class Done:
    """Result of the processing of a scan: files, and error if any."""

    name: str
    """Name of the scan."""
    files: dict[str, str]
    """Digests of the files, by file name."""
    made: tuple[str, ...]
    """Files made in this run; all others existed before."""
    error: str = ""
    """Error message if the scan failed; empty for a finished scan."""


def tasks_of(
    site: Site, output: Path, *, started: str, tile_rows: int | None = None
) -> tuple[Task, ...]:
    """Return the task of each scan of a site."""
    tasks = []
    for scan in site.scan:
        tasks.append(
            Task(
                name=scan.name,
                file=str(scan.file),
                simulated_from=(
                    None if scan.simulated_from is None else str(scan.simulated_from)
                ),
                seed=int(scan.seed),
                **options_of(scan.processing),
                folder=str((output / scan.name).resolve()),
                started=started,
                tile_rows=tile_rows,
                moves=scan.trajectory is not None,
            )
        )
    return tuple(tasks)


class Record:
    """Record of the finished files of a scan, stored in a file beside them."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._new: list[str] = []
        self._steps: dict[str, dict[str, str]] = {}
        try:
            content = json.loads((folder / RECORD).read_text("utf-8"))
            self._steps = {str(name): dict(step) for name, step in content.items()}
        except (OSError, ValueError, TypeError, AttributeError):
            # No record, or an unreadable record: all files are made again.
            self._steps = {}
        self._now: dict[str, str] = {}

    def tidy(self) -> None:
        """Remove the unfinished files of a worker that stopped."""
        for path in self._folder.glob(".amulor-*"):
            path.unlink(missing_ok=True)

    def made(
        self,
        name: str,
        *,
        of: Path | str,
        how: dict[str, Any],
        make: Callable[[Path], Any],
    ) -> Path:
        """Return a file's path; make the file if missing, altered or out of date."""
        path = self._folder / name
        made_of = _made_of(_identified(of), how)
        if self._is_whole(name, made_of):
            self._now[name] = self._steps[name]["digest"]
            return path
        make(path)
        self._new.append(name)
        self._now[name] = _digest_of(path)
        self._steps[name] = {"made_of": made_of, "digest": self._now[name]}
        text = json.dumps(self._steps, indent=2, sort_keys=True) + "\n"
        with atomic_output(self._folder / RECORD, overwrite=True) as temporary:
            temporary.write_text(text, "utf-8")
        return path

    def identity(self, path: Path) -> str:
        """Return a recorded file's digest; size and time of other files."""
        if path.parent == self._folder and path.name in self._steps:
            return self._steps[path.name]["digest"]
        try:
            status = path.stat()
        except OSError as error:
            raise _unreadable(path, error) from error
        return f"{status.st_size} B, {status.st_mtime_ns} ns"

    def is_made(self, name: str, *, of: Path | str, how: dict[str, Any]) -> bool:
        """Return whether a file is complete and was made from the same inputs."""
        return self._is_whole(name, _made_of(_identified(of), how))

    def _is_whole(self, name: str, made_of: str) -> bool:
        path, before = self._folder / name, self._steps.get(name, {})
        return (
            before.get("made_of") == made_of
            and path.is_file()
            and _digest_of(path) == before.get("digest")
        )

    def done(self, name: str, *, error: str = "") -> Done:
        """Return the result of a scan: its files, new files, and the error if any."""
        return Done(
            name=name, files=dict(self._now), made=tuple(self._new), error=error
        )


def _identified(of: Path | str) -> str:
    return of if isinstance(of, str) else _digest_of(of)


def _digest_of(path: Path) -> str:
    try:
        return digest(path)
    except OSError as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: OSError) -> FormatError:
    return FormatError(
        f"{path} cannot be read: {error.strerror or error}; workers need the disk on "
        "which the site file is"
    )


def _made_of(of: str, how: dict[str, Any]) -> str:
    version = software_versions()["amulor"]
    return json.dumps({"of": of, "how": how, "amulor": version}, sort_keys=True)


#: Number of times that a task is repeated if its worker dies.
RETRIES = 3
#: Word for a cluster of processes on this machine.
LOCAL = "local"


def set_up_worker() -> None:
    """Set the thread count of compiled loops in a worker, and stop its profiler."""
    try:
        import distributed

        dask: Any = distributed
        worker = dask.get_worker()
    except (ImportError, ValueError):
        return
    import numba

    config: Any = numba.config
    config.NUMBA_NUM_THREADS = max(int(worker.state.nthreads), 1)
    # The profiler keeps frames alive, with HDF5 objects that should be closed; equal
    # content then lies at other places in the file.
    profiler = worker.periodic_callbacks.get("profile")
    if profiler is not None:
        worker.loop.add_callback(profiler.stop)


@contextmanager
def cluster_client(scheduler: str, workers: int | None) -> Iterator[Any]:
    """Connect to a cluster, or start one on this computer."""
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
                # Workers still busy at the end are stopped, which needs no warning.
                silence_logs=logging.ERROR,
            ) as cluster,
            dask.Client(cluster) as client,
        ):
            yield client
        return
    try:
        client = dask.Client(scheduler, timeout="5s")
    except (OSError, TimeoutError, ValueError) as error:
        raise FormatError(
            f"no dask scheduler answers at {scheduler}: {error}; start one with "
            "`dask scheduler`, and name its address, such as tcp://node1:8786"
        ) from error
    with client:
        yield client


class Work(Protocol):
    """Computation in numbered items, for the workers of a cluster."""

    @property
    def file(self) -> str:
        """Name of the output file of an item; each item has its own folder."""

    def made_of(self, number: int) -> dict[str, Any]:
        """Return the inputs of an item, as numbers and text."""

    def write(self, number: int, path: Path) -> None:
        """Compute an item, and write its file."""


def in_order(
    client: Any, folder: Path, work: Work, first: int, end: int
) -> Iterator[Path]:
    """Yield the output files of work items in the order of their numbers."""
    from concurrent.futures import CancelledError

    import distributed.protocol

    dask: Any = distributed
    packed = dask.protocol.pickle.dumps(work)
    waiting: deque[tuple[int, Any]] = deque()
    following = first
    try:
        while waiting or following < end:
            most = max(2 * sum(client.nthreads().values()), 2)
            while following < end and len(waiting) < most:
                words = packed, following, str(folder)
                future = client.submit(_do, *words, pure=False, retries=RETRIES)
                waiting.append((following, future))
                following += 1
            number, future = waiting.popleft()
            try:
                future.result()
            except CancelledError as error:
                raise FormatError(
                    f"the cluster was lost at piece {number}; run the same again, "
                    f"and what is whole in {folder} is kept"
                ) from error
            piece_folder = _own(folder, work, number)
            made_of = work.made_of(number)
            if not Record(piece_folder).is_made(work.file, of="", how=made_of):
                raise FormatError(
                    f"{piece_folder / work.file} is not what a worker has made there; "
                    "workers need the disk of that folder, under the same name"
                )
            yield piece_folder / work.file
    finally:
        for _, future in waiting:
            future.cancel()


def _do(packed: bytes, number: int, folder: str) -> None:
    """Compute a work item and write its file, unless the file exists."""
    set_up_worker()
    work = _unpacked(packed)
    piece_folder = _own(Path(folder), work, number)
    io.make_folder(piece_folder)
    record = Record(piece_folder)
    record.tidy()
    record.made(
        work.file,
        of="",
        how=work.made_of(number),
        make=lambda path: work.write(number, path),
    )


@lru_cache(maxsize=2)
def _unpacked(packed: bytes) -> Work:
    """Return the unpickled computation; cached for all items of a worker."""
    import distributed.protocol

    dask: Any = distributed
    work: Work = dask.protocol.pickle.loads(packed)
    return work


def _own(folder: Path, work: Work, number: int) -> Path:
    """Return the folder of one item of work."""
    return folder / f"{Path(work.file).stem}-{number:06d}"
