"""Batches at work: in order, on several threads, with limits and interruptions."""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.transport._run.batches import Accumulator, Batch
from amulor.transport.tally import Tally


@dataclass(frozen=True, kw_only=True)
class Progress:
    """How far a run has come."""

    histories: int
    """Histories done."""
    goal: int
    """Histories asked for."""
    relative_error: float
    """Relative error at the first frequency; infinite before eight batches [1]."""
    seconds: float
    """Time since the start [s]."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """When a run ends.

    Raises
    ------
    ValueError
        If a number is out of its range.
    """

    histories: int
    relative_error: float | None = None
    longest_time: float | None = None
    threads: int | None = None
    progress: Callable[[Progress], None] | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        _refuse_fractions(self.histories, least=1, name="histories")
        if self.relative_error is not None and not self.relative_error > 0:
            raise ValueError(
                f"relative_error must be above 0, got {self.relative_error}"
            )
        if self.longest_time is not None and not self.longest_time > 0:
            raise ValueError(f"longest_time must be above 0 s, got {self.longest_time}")
        if self.threads is not None:
            _refuse_fractions(self.threads, least=1, name="threads")


def frequencies(modulation_frequency: ArrayLike) -> NDArray[np.float64]:
    """Return modulation frequencies, checked."""
    frequency = np.array(modulation_frequency, dtype=np.float64)
    if frequency.ndim != 1 or frequency.size == 0:
        raise ValueError(
            "modulation_frequency must be a list of at least one frequency [Hz], got "
            f"the shape {frequency.shape}"
        )
    wrong = frequency[~(np.isfinite(frequency) & (frequency >= 0))]
    if wrong.size > 0:
        raise ValueError(
            "modulation_frequency must be finite and not below 0 Hz, got "
            f"{wrong[0]:g} Hz"
        )
    return frequency


def checked_seed(seed: int) -> int:
    """Return a seed that a random number generator takes."""
    _refuse_fractions(seed, least=0, name="seed")
    return int(seed)


def _refuse_fractions(value: float, *, least: int, name: str) -> None:
    """Refuse a number that is not whole or too small."""
    if not (value >= least and value % 1 == 0):
        raise ValueError(
            f"{name} must be a whole number of at least {least}, got {value}"
        )


def conduct(
    batch_of: Callable[[int], Batch],
    frame: Tally,
    limits: Limits,
    resume: Tally | None = None,
) -> Tally:
    """Return the tally of all batches up to the first limit that is met."""
    started = time.monotonic()
    done = Accumulator.start(frame, resume)
    size = frame.batch_size
    goal = max(1, math.ceil(limits.histories / size))
    workers = limits.threads or os.cpu_count() or 1
    interrupted, error = False, math.inf
    try:
        for batch in _in_order(batch_of, done.next_batch, goal, workers):
            done = done.with_batch(batch)
            seconds = time.monotonic() - started
            if limits.progress is not None or limits.relative_error is not None:
                error = done.relative_error()
            if limits.progress is not None:
                limits.progress(
                    Progress(
                        histories=done.histories,
                        goal=goal * size,
                        relative_error=error,
                        seconds=seconds,
                    )
                )
            if limits.relative_error is not None and error <= limits.relative_error:
                break
            if limits.longest_time is not None and seconds > limits.longest_time:
                break
    except KeyboardInterrupt:
        if done.next_batch < 2:
            raise
        interrupted = True
    return done.tally(time.monotonic() - started, interrupted)


def _in_order(
    batch_of: Callable[[int], Batch], first: int, end: int, workers: int
) -> Iterator[Batch]:
    """Yield batches in the order of their numbers, some at work at once."""
    waiting: deque[Future[Batch]] = deque()
    with ThreadPoolExecutor(workers) as pool:
        try:
            following = first
            while waiting or following < end:
                while following < end and len(waiting) < 2 * workers:
                    waiting.append(pool.submit(batch_of, following))
                    following += 1
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()
