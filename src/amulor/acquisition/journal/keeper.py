"""Commits a sample while the next one is taken, where a disk takes its time."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import Key, Step

#: Commits that take longer, on the average of late, are not waited for at once [s].
SLOW = 0.3e-3
#: Weight of the newest commit in that average [1].
_WEIGHT = 0.1


class Keeper:
    """Keeps samples in the order in which they were taken, one commit at a time.

    Parameters
    ----------
    journal : Journal
        What they are written to.
    told : callable
        Called with a step, and how many samples it has brought, once they survive a
        loss of power; in the thread that keeps and settles.
    at_once : bool
        Whether each commit is waited for.
    """

    def __init__(
        self, journal: Journal, told: Callable[[Step, int], None], *, at_once: bool
    ) -> None:
        self._journal, self._told, self._at_once = journal, told, at_once
        self._thread: ThreadPoolExecutor | None = None
        self._pending: tuple[Future[None], Step, int] | None = None
        self._took = 0.0

    def __enter__(self) -> Keeper:
        """Return it."""
        return self

    def __exit__(self, *_: object) -> None:
        """Wait for what is written now."""
        if self._thread is not None:
            self._thread.shutdown()

    def keep(self, step: Step, records: Sequence[Record]) -> None:
        """Write the samples of a dwell, after all that were kept before.

        Parameters
        ----------
        step : Step
            Which they are.
        records : sequence of Record
            In the order of its keys.

        Raises
        ------
        FormatError
            If samples that were kept before, or these, could not be written.
        """
        samples = [*zip(step.keys, records, strict=True)]
        self.settle()
        if self._at_once or self._took < SLOW:
            self._commit(samples)
            self._told(step, len(samples))
            return
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, "journal")
        future = self._thread.submit(self._commit, samples)
        self._pending = (future, step, len(samples))

    def settle(self) -> None:
        """Wait until all that was kept is written, and tell it.

        Raises
        ------
        FormatError
            If it could not be written.
        """
        if self._pending is None:
            return
        future, step, count = self._pending
        try:
            future.result()
        finally:
            # An interrupted wait is not over; it goes on with the next call.
            if future.done():
                self._pending = None
        self._told(step, count)

    def _commit(self, samples: list[tuple[Key, Record]]) -> None:
        start = time.perf_counter()
        self._journal.commit_together(samples)
        passed = time.perf_counter() - start
        self._took += _WEIGHT * (passed - self._took)
