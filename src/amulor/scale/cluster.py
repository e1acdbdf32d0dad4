"""A dask cluster: its client, and how its workers are set up."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from amulor.errors import FormatError

#: How often a task is begun again whose worker has died.
RETRIES = 3
#: Word for a cluster of processes on this machine.
LOCAL = "local"


def set_up_worker() -> None:
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


@contextmanager
def cluster_client(scheduler: str, workers: int | None) -> Iterator[Any]:
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
                # What is at work when all is known is ended, which is no warning.
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
