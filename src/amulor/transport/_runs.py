"""Batches of a transport run: schedule, running sums, and path-length record."""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

from amulor.transport._derivatives import Derivatives
from amulor.transport._kernels import contributions as _record_kernels
from amulor.transport._kernels.types import Record as Deposits
from amulor.transport.tally import (
    MOST_BATCHES,
    PathRecord,
    Tally,
    paired,
    sums_of,
    together,
)

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False, kw_only=True)
class Batch:
    """Result of a batch of photon histories, as means per history."""

    number: int
    histories: int
    signal: Complex
    weight: Array
    mass: Array | None
    edge: Array | None
    spacing: float
    unseen: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Accumulator:
    """Batch results accumulated in a run; neighboring batches are merged if many.

    What is kept depends on the batches alone, so a run that was resumed has the same
    numbers as one that was not. A batch makes a new accumulator, so an interruption at
    any moment leaves one that is whole.
    """

    frame: Tally
    values: tuple[Complex, ...] = ()
    counts: tuple[int, ...] = ()
    full: int = 0
    contributions: Array | None = None
    groups: int = 0
    seconds: float = 0.0
    record: tuple[Array, Array] | None = None
    spacing: float = 0.0
    unseen: float = 0.0
    next_batch: int = 0

    @classmethod
    def start(cls, frame: Tally, resume: Tally | None) -> Self:
        """Return an accumulator without batches, or with those of a resumed run."""
        if resume is None:
            return cls(frame=frame, full=frame.batch_size)
        if resume.problem != frame.problem or resume.parts != frame.parts:
            raise ValueError(
                "resume must be a run of the same problem, with the same derivatives"
            )
        if not np.array_equal(resume.modulation_frequency, frame.modulation_frequency):
            raise ValueError("resume must be a run at the same frequencies")
        if resume.seed != frame.seed:
            raise ValueError(
                f"resume must be a run with the seed {frame.seed}, got {resume.seed}; "
                "runs with different seeds are merged with Tally.merged"
            )
        if resume.next_batch < 0:
            raise ValueError("a merged run cannot go on; resume one of its parts")
        if resume.contributions is None and resume.groups:
            raise ValueError(
                "resume must be a run with contributions by kind of light, which older "
                "versions did not keep; start it again"
            )
        if resume.record is not None:
            raise ValueError("a run with a record of path lengths cannot go on")
        counts = tuple(int(count) for count in resume.histories_of)
        return cls(
            frame=frame,
            values=tuple(resume.rows),
            counts=counts,
            full=max([frame.batch_size, *counts]),
            contributions=resume.contributions,
            groups=resume.groups,
            seconds=resume.seconds,
            unseen=resume.unseen,
            next_batch=resume.next_batch,
        )

    @property
    def histories(self) -> int:
        """Number of photon histories in the accumulated batches."""
        return sum(self.counts)

    def with_batch(self, batch: Batch) -> Self:
        """Return a new accumulator that includes one more batch."""
        values, counts, full = [*self.values], [*self.counts], self.full
        if counts and counts[-1] < full:
            mean, count = values[-1], counts[-1]
            counts[-1] = count + batch.histories
            values[-1] = (mean * count + batch.signal * batch.histories) / counts[-1]
        else:
            values.append(batch.signal)
            counts.append(batch.histories)
        if len(counts) == MOST_BATCHES and counts[-1] == full:
            pairs, _ = paired(np.array(values), np.array(counts))
            full *= 2
            values, counts = list(pairs), [full] * len(pairs)
        sums = sums_of(batch.weight)
        if self.contributions is not None:
            sums = together(self.contributions, sums)
        return replace(
            self,
            values=tuple(values),
            counts=tuple(counts),
            full=full,
            contributions=sums,
            groups=self.groups + len(batch.weight),
            record=self._with_record(batch),
            spacing=batch.spacing,
            unseen=max(self.unseen, batch.unseen),
            next_batch=batch.number + 1,
        )

    def _with_record(self, batch: Batch) -> tuple[Array, Array] | None:
        """Return the sum of path-length records, one more batch included."""
        if batch.mass is None or batch.edge is None:
            return None
        if self.record is not None:
            return self.record[0] + batch.mass, self.record[1] + batch.edge
        if self.counts:
            raise ValueError(
                "a record of path lengths has to be kept from the start; the run to "
                f"go on with has {self.histories} histories without one"
            )
        return batch.mass, batch.edge

    def tally(self, seconds: float, interrupted: bool) -> Tally:
        """Return the tally of the batches accumulated so far."""
        return replace(
            self.frame.with_rows(np.array(self.values)),
            histories_of=np.array(self.counts, dtype=np.int64),
            groups=self.groups,
            contribution=self.contribution,
            contributions=self.contributions if self.groups else None,
            next_batch=self.next_batch,
            unseen=self.unseen,
            seconds=self.seconds + seconds,
            interrupted=interrupted,
            record=None if self.record is None else self._path_record(*self.record),
        )

    @property
    def contribution(self) -> tuple[float, float, float]:
        """Sum, sum of squares and maximum of the group contributions [1]."""
        if self.contributions is None:
            return (0.0, 0.0, 0.0)
        total, square, largest = (float(value) for value in self.contributions[0, 0])
        return total, square, largest

    def _path_record(self, masses: Array, edges: Array) -> PathRecord:
        """Convert summed path-length records to a `PathRecord` per history."""
        mass, edge = masses / self.next_batch, edges / self.next_batch
        # Light spread over a bin, and half of what lies at each of its two nodes.
        spread = np.cumsum(edge, axis=-1)[..., :-1] * self.spacing
        at_nodes = 0.5 * (mass[..., :-1] + mass[..., 1:])
        at_nodes[..., 0] += 0.5 * mass[..., 0]
        light = spread + at_nodes
        target = np.array([name.startswith("target") for name in self.frame.parts])
        total = self.contribution[0] / self.groups
        inside = float(light[:, 0].sum())
        return PathRecord(
            length=self.spacing * (np.arange(light.shape[-1], dtype=np.float64) + 0.5),
            water=light[~target].sum(axis=0).T,
            target=light[target].sum(axis=0).T,
            beyond=max(0.0, 1 - inside / total) if total > 0 else 0.0,
        )


@dataclass(frozen=True, kw_only=True)
class Progress:
    """Progress of a transport run: histories, relative error, time.

    Examples
    --------
    >>> from amulor.transport import Progress
    >>> now = Progress(histories=25_000, goal=100_000, relative_error=0.04, seconds=1.0)
    >>> print(f"{now.histories / now.goal:.0%}")
    25%
    """

    histories: int
    """Number of histories so far."""
    goal: int
    """Requested number of histories."""
    relative_error: float
    """Relative standard error so far; infinite before eight batches [1].

    It is that of the error goal, else that of all light at the first frequency.
    """
    seconds: float
    """Time since the start [s]."""


@dataclass(frozen=True, kw_only=True)
class ErrorGoal:
    """Relative standard error at which a transport run stops.

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
    """Required ratio of standard error to signal modulus [1]."""
    light: str = "all"
    """Kind of light: "all", "water", "target", or the name of a part."""
    analyser: str = "none"
    """Analyzer at the receiver, as for `Tally.detected`."""
    frequency: int = 0
    """Index of the modulation frequency, from 0."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an invalid error or frequency index."""
        if not self.relative_error > 0:
            raise ValueError(
                f"relative_error must be above 0, got {self.relative_error}"
            )
        _refuse_fractions(self.frequency, least=0, name="frequency")

    def of(self, tally: Tally) -> float:
        """Return a tally's relative standard error; infinite below 8 batches [1]."""
        if tally.histories_of.size < 8:  # too few batches
            return math.inf
        errors = tally.relative_error_of(self.light, analyser=self.analyser)
        return float(errors[self.frequency])

    def reached(self, tally: Tally) -> bool:
        """Return whether a tally's standard error meets the goal.

        A run checks its goal after 16 batches, then each time after sqrt(2) times as
        many. With so few checks a run seldom stops early by chance. The goal must be
        met by the error plus its own standard error, which is 1 / sqrt(2 (n - 1)) of it
        for n batches.
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
    """Limits of a transport run (histories, time, error), and number of workers."""

    histories: int
    error: ErrorGoal | None = None
    longest_time: float | None = None
    threads: int | None = None
    progress: Callable[[Progress], None] | None = None
    spread: Spread | None = None

    def __post_init__(self) -> None:
        """Raise a ValueError for an invalid number of histories or threads, or time."""
        _refuse_fractions(self.histories, least=1, name="histories")
        if self.longest_time is not None and not self.longest_time > 0:
            raise ValueError(f"longest_time must be above 0 s, got {self.longest_time}")
        if self.threads is not None:
            _refuse_fractions(self.threads, least=1, name="threads")


def frequencies(modulation_frequency: ArrayLike) -> NDArray[np.float64]:
    """Return modulation frequencies as an array; ValueError unless finite and >= 0."""
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
    """Return a random seed; ValueError unless a whole number of at least 0."""
    _refuse_fractions(seed, least=0, name="seed")
    return int(seed)


def _refuse_fractions(value: float, *, least: int, name: str) -> None:
    """Raise a ValueError unless a number is whole and at least a minimum."""
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
    """Run batches until a limit of histories, time or error; return their tally."""
    started = time.monotonic()
    done = Accumulator.start(frame, resume)
    size = frame.batch_size
    goal = math.ceil(limits.histories / size)
    local = partial(_in_order, workers=limits.threads or os.cpu_count() or 1)
    batches = (limits.spread or local)(batch_of, done.next_batch, goal)
    interrupted = False
    error_goal = limits.error or ErrorGoal(relative_error=1.0)
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
                        relative_error=error_goal.of(state),
                        seconds=seconds,
                    )
                )
            checked = limits.error is not None and done.next_batch in CHECKS
            if checked and error_goal.reached(state):
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
    """Yield batches in the order of their numbers, computed by parallel threads."""
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


#: Most nodes of a record.
_MOST_NODES = 16384
#: Step of the record at the highest frequency [rad], and in attenuation lengths.
_STEP = 0.05


def random_state(seed: int, number: int) -> NDArray[np.uint64]:
    """Return the initial state of the random generator for one batch."""
    sequence = np.random.SeedSequence(seed, spawn_key=(number,))
    return sequence.generate_state(4, np.uint64).astype(np.uint64)


@dataclass(frozen=True, eq=False, kw_only=True)
class Record:
    """Arrays for the light received in a batch, by part and path length."""

    mass: Array
    edge: Array
    beyond: Complex
    wavenumber: Complex
    spacing: float
    parts: int

    @classmethod
    def empty(
        cls,
        attenuation: Array,
        group_index: float,
        frequency: Array,
        frame: Tally,
        *,
        scores: int = 0,
        lengths: bool = False,
    ) -> Self:
        """Return an empty record, with a row for each part of a tally's light.

        Two rows follow for each score, and two of `beyond` for light times path length.
        """
        wavenumber = 2j * np.pi * frequency * group_index / speed_of_light
        steepest = max(float(np.abs(wavenumber).max()), float(attenuation.max()))
        spacing = _STEP / steepest
        node_count = 30 / float(attenuation[attenuation > 0].min()) / spacing
        nodes = int(min(node_count, _MOST_NODES))
        rows, components = len(frame.parts) + 2 * scores, frame.batches.shape[2]
        return cls(
            mass=np.zeros((rows, components, nodes)),
            edge=np.zeros((rows, components, nodes)),
            beyond=np.zeros(
                (rows + 2 * lengths, components, frequency.size), dtype=np.complex128
            ),
            wavenumber=wavenumber,
            spacing=spacing,
            parts=len(frame.parts),
        )

    def arrays(self, orders: int) -> Deposits:
        """Return the arrays as an argument of the compiled loops."""
        return Deposits(
            mass=self.mass,
            edge=self.edge,
            beyond=self.beyond,
            wavenumber=self.wavenumber,
            spacing=self.spacing,
            orders=orders,
        )

    def batch(
        self,
        number: int,
        histories: int,
        units: int,
        weight: Array,
        *,
        keep: bool,
        unseen: float = 0.0,
        derivatives: Derivatives | None = None,
    ) -> Batch:
        """Return the result of the batch, as means per history."""
        rows, parts = self.mass.shape[0], self.parts
        _record_kernels.transform(
            self.mass, self.edge, self.wavenumber, self.spacing, self.beyond[:rows]
        )
        signal = self.beyond[:parts]
        if derivatives is not None:
            length = (
                self._lengths()
                if derivatives.lengths
                else np.zeros_like(self.beyond[:2])
            )
            scored = derivatives.rows(self.beyond[parts:rows], length, self.wavenumber)
            signal = np.concatenate([signal, scored])
        return Batch(
            number=number,
            histories=histories,
            signal=signal / units,
            weight=weight,
            mass=self.mass[:parts] / units if keep else None,
            edge=self.edge[:parts] / units if keep else None,
            spacing=self.spacing,
            unseen=unseen,
        )

    def _lengths(self) -> Complex:
        """Return light times path length of water and target, by frequency [m].

        Light m exp(q L) of a node gives L m exp(q L), the derivative to q. A step e of
        light per length has e R, R = (1 - exp(q L)) / q, of which the derivative is
        e (L R - (L + R) / q), and -e L^2 / 2 at q = 0.
        """
        starts = (0, self.parts - 2)  # the last two parts are those of the target
        mass, edge = (
            np.add.reduceat(array[: self.parts], starts, axis=0)
            for array in (self.mass, self.edge)
        )
        length = self.spacing * np.arange(mass.shape[-1], dtype=np.float64)
        result = self.beyond[len(self.mass) :].copy()
        ramp = np.zeros_like(result)
        q = self.wavenumber
        for light, step, out in (
            (mass * length, edge * length, result),
            (np.zeros_like(mass), edge, ramp),
        ):
            _record_kernels.transform(light, step, q, self.spacing, out)
        moment = (edge @ length)[..., np.newaxis]
        square = (edge @ length**2)[..., np.newaxis]
        still = q == 0
        lag = np.divide(moment + ramp, q, out=np.zeros_like(ramp), where=~still)
        total: Complex = result - lag + np.where(still, 0.5 * square, 0.0)
        return total
