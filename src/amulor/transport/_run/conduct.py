"""Batches at work: in order, on several threads, with limits and interruptions."""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.transport._run.batches import Accumulator, Batch
from amulor.transport.tally import Tally


@dataclass(frozen=True, kw_only=True)
class Progress:
    """How far a run has come.

    Examples
    --------
    >>> from amulor.transport import Progress
    >>> now = Progress(histories=25_000, goal=100_000, relative_error=0.04, seconds=1.0)
    >>> print(f"{now.histories / now.goal:.0%}")
    25%
    """

    histories: int
    """Histories done."""
    goal: int
    """Histories asked for."""
    relative_error: float
    """Relative error asked for, or of all light at the first frequency; infinite before
    eight batches [1]."""
    seconds: float
    """Time since the start [s]."""


@dataclass(frozen=True, kw_only=True)
class ErrorGoal:
    """A relative error at which a run stops.

    Raises
    ------
    ValueError
        If the error is not above zero, or the number of the frequency below zero.

    Examples
    --------
    >>> from amulor.transport import ErrorGoal
    >>> goal = ErrorGoal(relative_error=0.01, light="target")
    >>> goal.light, goal.frequency
    ('target', 0)
    """

    relative_error: float
    """Standard error over the modulus to reach [1]."""
    light: str = "all"
    """Light that it is of: "all", "water", "target", or a part."""
    analyser: str = "none"
    """Analyser that the light passes, as for `Tally.detected`."""
    frequency: int = 0
    """Number of the frequency, from 0."""

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        if not self.relative_error > 0:
            raise ValueError(
                f"relative_error must be above 0, got {self.relative_error}"
            )
        _refuse_fractions(self.frequency, least=0, name="frequency")

    def of(self, tally: Tally) -> float:
        """Return the relative error of a run; infinite for fewer than 8 batches."""
        if tally.histories_of.size < 8:  # too few to tell
            return math.inf
        errors = tally.relative_error_of(self.light, analyser=self.analyser)
        return float(errors[self.frequency])

    def reached(self, tally: Tally) -> bool:
        """Return whether a run may stop now.

        It is asked after 16 batches and then after sqrt(2) times as many each time, so
        that a run that looks good by chance is seldom caught at it; and the error has
        to be as small with one standard error of its own added, 1 / sqrt(2 (n - 1)) of
        it for n batches.
        """
        if tally.next_batch not in CHECKS:
            return False
        doubt = 1 / math.sqrt(2 * (tally.histories_of.size - 1))
        return self.of(tally) * (1 + doubt) <= self.relative_error


#: Numbers of batches after which a run may stop at its error.
CHECKS = frozenset(round(16 * 2 ** (k / 2)) for k in range(96))


#: Yields what a function makes of the numbers from one up to another, in their order.
Spread = Callable[[Callable[[int], Batch], int, int], Iterator[Batch]]


@dataclass(frozen=True, kw_only=True)
class Limits:
    """When a run ends, and where its batches are worked on.

    Raises
    ------
    ValueError
        If a number is out of its range.
    """

    histories: int
    error: ErrorGoal | None = None
    longest_time: float | None = None
    threads: int | None = None
    progress: Callable[[Progress], None] | None = None
    spread: Spread | None = None

    def __post_init__(self) -> None:
        """Refuse what cannot be."""
        _refuse_fractions(self.histories, least=1, name="histories")
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
    here = partial(_in_order, workers=limits.threads or os.cpu_count() or 1)
    batches = (limits.spread or here)(batch_of, done.next_batch, goal)
    interrupted = False
    wanted = limits.error or ErrorGoal(relative_error=1.0)
    try:
        for batch in batches:
            done = done.with_batch(batch)
            seconds = time.monotonic() - started
            if limits.progress is not None or done.next_batch in CHECKS:
                state = done.tally(seconds, interrupted)
            if limits.progress is not None:
                limits.progress(
                    Progress(
                        histories=done.histories,
                        goal=goal * size,
                        relative_error=wanted.of(state),
                        seconds=seconds,
                    )
                )
            checked = limits.error is not None and done.next_batch in CHECKS
            if checked and wanted.reached(state):
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
