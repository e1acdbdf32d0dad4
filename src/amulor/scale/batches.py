"""Batches of photons on a cluster: each a file with its digest, in order."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from amulor import io
from amulor._extras import require
from amulor.errors import FormatError
from amulor.io.files import atomic_output
from amulor.scale.cluster import RETRIES, cluster_client, set_up_worker
from amulor.scale.tasks import Record
from amulor.transport._run.batches import Batch
from amulor.transport.monte_carlo import Spread

__all__ = ["spread_batches"]

#: Name of the file of a batch, in a folder of its own.
FILE = "batch.npz"


class Run(Protocol):
    """What makes batches of their numbers."""

    @property
    def stated(self) -> dict[str, Any]:
        """All that its batches follow from, as plain numbers and text."""

    def __call__(self, number: int) -> Batch:
        """Return a batch."""


@contextmanager
def spread_batches(
    folder: str | os.PathLike[str],
    *,
    scheduler: str,
    workers: int | None = None,
) -> Iterator[Spread]:
    """Have the batches of a photon transport run worked on by a cluster.

    Parameters
    ----------
    folder : path-like
        Folder for the batches, made if it is not there, which all workers see under
        this name. Batches in it that are whole, and of the same run, are kept.
    scheduler : str
        Address of a dask scheduler, such as "tcp://node1:8786", or "local" for
        processes on this machine.
    workers : int, optional
        Number of processes of "local"; one for each processor by default.

    Yields
    ------
    callable
        For the argument `spread` of `amulor.transport.simulate`.

    Raises
    ------
    MissingExtraError
        If dask is not installed.
    FormatError
        If the folder cannot be made, nobody answers at the address, or the cluster is
        lost.

    Notes
    -----
    The numbers of histories and the random numbers of a batch follow from the run and
    the number of the batch, and batches are added up in order. So the result has the
    same bytes with any number of workers and without a cluster.

    Examples
    --------
    >>> from amulor.scale.batches import spread_batches
    >>> with spread_batches("run", scheduler="local") as spread:  # doctest: +SKIP
    ...     tally = simulate(
    ...         water, source, disc, [0.0], histories=10**7, seed=1, spread=spread
    ...     )
    """
    require("scale", purpose="a cluster")
    path = Path(folder).resolve()
    io.make_folder(path)
    with cluster_client(scheduler, workers) as client:
        yield partial(_in_order, client, path)


def _in_order(
    client: Any, folder: Path, run: Run, first: int, end: int
) -> Iterator[Batch]:
    """Yield batches in the order of their numbers, some at work at once."""
    from concurrent.futures import CancelledError

    import distributed.protocol

    dask: Any = distributed
    packed, stated = dask.protocol.pickle.dumps(run), run.stated
    waiting: deque[tuple[int, Any]] = deque()
    following = first
    try:
        while waiting or following < end:
            most = max(2 * sum(client.nthreads().values()), 2)
            while following < end and len(waiting) < most:
                future = client.submit(
                    _work_on, packed, following, str(folder), pure=False,
                    retries=RETRIES,
                )  # fmt: skip
                waiting.append((following, future))
                following += 1
            number, future = waiting.popleft()
            try:
                future.result()
            except CancelledError as error:
                raise FormatError(
                    f"the cluster was lost at batch {number}; run the same again, "
                    f"and the batches in {folder} are kept"
                ) from error
            yield _kept(folder, number, stated)
    finally:
        for _, future in waiting:
            future.cancel()


def _work_on(packed: bytes, number: int, folder: str) -> None:
    """Make the file of a batch, unless it is there."""
    set_up_worker()
    run, own = _unpacked(packed), _own(Path(folder), number)
    io.make_folder(own)
    record = Record(own)
    record.tidy()
    record.made(
        FILE,
        **_made_of(run.stated, number),
        make=lambda path: _write(run(number), path),
    )


@lru_cache(maxsize=2)
def _unpacked(packed: bytes) -> Run:
    """Return a run; its tables serve all batches of a worker."""
    import distributed.protocol

    dask: Any = distributed
    run: Run = dask.protocol.pickle.loads(packed)
    return run


def _kept(folder: Path, number: int, stated: dict[str, Any]) -> Batch:
    """Return a batch from its file, which a worker has made."""
    own = _own(folder, number)
    if not Record(own).is_made(FILE, **_made_of(stated, number)):
        raise FormatError(
            f"{own / FILE} is not what a worker has made there; workers need the disk "
            "of that folder, under the same name"
        )
    with np.load(own / FILE, allow_pickle=False) as found:
        return Batch(
            number=number,
            histories=int(found["histories"]),
            signal=found["signal"],
            weight=found["weight"],
            mass=found.get("mass"),
            edge=found.get("edge"),
            spacing=float(found["spacing"]),
        )


def _own(folder: Path, number: int) -> Path:
    """Return the folder of a batch."""
    return folder / f"batch-{number:06d}"


def _made_of(stated: dict[str, Any], number: int) -> dict[str, Any]:
    """Return what a batch is made of, for its record."""
    return {"of": stated["problem"], "how": {**stated, "batch": number}}


def _write(batch: Batch, path: Path) -> None:
    """Write a batch; the same one always has the same bytes."""
    arrays: dict[str, Any] = {
        "histories": np.int64(batch.histories),
        "signal": batch.signal,
        "weight": batch.weight,
        "spacing": np.float64(batch.spacing),
    }
    if batch.mass is not None and batch.edge is not None:
        arrays |= {"mass": batch.mass, "edge": batch.edge}
    with (
        atomic_output(path, overwrite=True) as temporary,
        temporary.open("wb") as file,
    ):
        np.savez(file, **arrays)
