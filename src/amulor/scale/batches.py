"""Batches of photons computed on a cluster, each saved with its inputs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from amulor import io
from amulor._extras import require
from amulor.io.files import atomic_output
from amulor.scale.tasks import cluster_client, in_order
from amulor.transport._runs import Batch
from amulor.transport.monte_carlo import Spread

__all__ = ["spread_batches"]


class Run(Protocol):
    """Photon transport run that computes batches of photons by number."""

    @property
    def stated(self) -> dict[str, Any]:
        """Inputs of the run, as numbers and text."""

    def __call__(self, number: int) -> Batch:
        """Compute a batch of photons by its number."""


@contextmanager
def spread_batches(
    folder: str | os.PathLike[str],
    *,
    scheduler: str,
    workers: int | None = None,
) -> Iterator[Spread]:
    """Compute the batches of a photon transport run on a cluster.

    Notes
    -----
    Size and random numbers of a batch follow from the run and the number of the batch,
    and batches are added in order. The result has equal bytes with any number of
    workers and without a cluster.

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
        yield partial(_batches, client, path)


def _batches(
    client: Any, folder: Path, run: Run, first: int, end: int
) -> Iterator[Batch]:
    """Yield the computed batches in the order of their numbers."""
    paths = in_order(client, folder, _Batches(run=run), first, end)
    for number, path in enumerate(paths, start=first):
        with np.load(path, allow_pickle=False) as arrays:
            yield Batch(
                number=number,
                histories=int(arrays["histories"]),
                signal=arrays["signal"],
                weight=arrays["weight"],
                mass=arrays.get("mass"),
                edge=arrays.get("edge"),
                spacing=float(arrays["spacing"]),
                unseen=float(arrays["unseen"]),
            )


@dataclass(frozen=True, kw_only=True)
class _Batches:
    """Batches of photons as work items for a cluster, each with an output file."""

    run: Run
    file: str = "batch.npz"

    def made_of(self, number: int) -> dict[str, Any]:
        """Return the inputs from which a batch is computed."""
        return {**self.run.stated, "batch": number}

    def write(self, number: int, path: Path) -> None:
        """Compute a batch and write it to a file."""
        _write(self.run(number), path)


def _write(batch: Batch, path: Path) -> None:
    """Write a batch to a file, with equal bytes for equal batches."""
    arrays: dict[str, Any] = {
        "histories": np.int64(batch.histories),
        "signal": batch.signal,
        "weight": batch.weight,
        "spacing": np.float64(batch.spacing),
        "unseen": np.float64(batch.unseen),
    }
    if batch.mass is not None and batch.edge is not None:
        arrays |= {"mass": batch.mass, "edge": batch.edge}
    with (
        atomic_output(path, overwrite=True) as temporary,
        temporary.open("wb") as file,
    ):
        np.savez(file, **arrays)
