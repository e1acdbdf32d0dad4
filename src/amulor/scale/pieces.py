"""Pieces of work on a cluster, in order: each a file with its digest, kept if whole."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

from amulor import io
from amulor.errors import FormatError
from amulor.scale.cluster import RETRIES, set_up_worker
from amulor.scale.tasks import Record

__all__ = ["Work", "in_order"]


class Work(Protocol):
    """Pieces of work by their numbers; it goes to the workers as it is."""

    @property
    def file(self) -> str:
        """Name of the file of a piece, in a folder of its own."""

    def made_of(self, number: int) -> dict[str, Any]:
        """All that a piece follows from, as plain numbers and text."""

    def write(self, number: int, path: Path) -> None:
        """Do a piece, and write its file."""


def in_order(
    client: Any, folder: Path, work: Work, first: int, end: int
) -> Iterator[Path]:
    """Yield the files of pieces in the order of their numbers.

    Parameters
    ----------
    client : distributed.Client
        Of the cluster.
    folder : pathlib.Path
        Where each piece gets a folder; there for all workers.
    work : Work
        What is to be done.
    first, end : int
        Number of the first piece, and the one behind the last.

    Yields
    ------
    pathlib.Path
        Of a file that is whole.

    Raises
    ------
    FormatError
        If the cluster is lost, or a file does not appear here.
    """
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
            own = _own(folder, work, number)
            made_of = work.made_of(number)
            if not Record(own).is_made(work.file, of="", how=made_of):
                raise FormatError(
                    f"{own / work.file} is not what a worker has made there; workers "
                    "need the disk of that folder, under the same name"
                )
            yield own / work.file
    finally:
        for _, future in waiting:
            future.cancel()


def _do(packed: bytes, number: int, folder: str) -> None:
    """Make the file of a piece, unless it is there."""
    set_up_worker()
    work = _unpacked(packed)
    own = _own(Path(folder), work, number)
    io.make_folder(own)
    record = Record(own)
    record.tidy()
    record.made(
        work.file,
        of="",
        how=work.made_of(number),
        make=lambda path: work.write(number, path),
    )


@lru_cache(maxsize=2)
def _unpacked(packed: bytes) -> Work:
    """Return work; what it remembers serves all pieces of a worker."""
    import distributed.protocol

    dask: Any = distributed
    work: Work = dask.protocol.pickle.loads(packed)
    return work


def _own(folder: Path, work: Work, number: int) -> Path:
    """Return the folder of a piece."""
    return folder / f"{Path(work.file).stem}-{number:06d}"
