"""Batches of histories, added up in order with flat memory."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.transport.tally import MOST_BATCHES, PathRecord, Tally

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class Batch:
    """What one batch of histories has found, as means per history."""

    number: int
    histories: int
    signal: Complex
    weight: Array
    mass: Array | None
    edge: Array | None
    spacing: float


class Accumulator:
    """Batches in the order of their numbers; pairs are merged when there are many.

    What is kept depends on the batches alone, so a run that was resumed has the same
    numbers as one that was not.
    """

    def __init__(self, frame: Tally, resume: Tally | None) -> None:
        self._frame = frame
        self._values: list[Complex] = []
        self._counts: list[int] = []
        self._full = frame.batch_size
        self._contribution = np.zeros(3)
        self._groups = 0
        self._seconds = 0.0
        self._record: tuple[Array, Array] | None = None
        self._spacing = 0.0
        self.next_batch = 0
        if resume is not None:
            self._take(resume)

    def _take(self, resume: Tally) -> None:
        """Start from a run that is to go on."""
        frame = self._frame
        if resume.problem != frame.problem or resume.parts != frame.parts:
            raise ValueError("resume must be a run of the same problem")
        if not np.array_equal(resume.modulation_frequency, frame.modulation_frequency):
            raise ValueError("resume must be a run at the same frequencies")
        if resume.seed != frame.seed:
            raise ValueError(
                f"resume must be a run with the seed {frame.seed}, got {resume.seed}; "
                "runs with different seeds are merged with Tally.merged"
            )
        if resume.next_batch < 0:
            raise ValueError("a merged run cannot go on; resume one of its parts")
        if resume.record is not None:
            raise ValueError("a run with a record of path lengths cannot go on")
        self._values = list(resume.batches)
        self._counts = [int(count) for count in resume.histories_of]
        self._full = max([frame.batch_size, *self._counts])
        self._contribution = np.array(resume.contribution)
        self._groups = resume.groups
        self._seconds = resume.seconds
        self.next_batch = resume.next_batch

    @property
    def histories(self) -> int:
        """Histories so far."""
        return sum(self._counts)

    def add(self, batch: Batch) -> None:
        """Add the next batch."""
        if self._counts and self._counts[-1] < self._full:
            self._values[-1] = self._merge(
                self._values[-1], self._counts[-1], batch.signal, batch.histories
            )
            self._counts[-1] += batch.histories
        else:
            self._values.append(batch.signal)
            self._counts.append(batch.histories)
        if len(self._counts) == MOST_BATCHES and self._counts[-1] == self._full:
            pairs = range(0, MOST_BATCHES, 2)
            self._values = [
                0.5 * (self._values[k] + self._values[k + 1]) for k in pairs
            ]
            self._full *= 2
            self._counts = [self._full] * len(self._values)
        weight = batch.weight
        self._contribution[0] += weight.sum()
        self._contribution[1] += (weight**2).sum()
        self._contribution[2] = max(self._contribution[2], weight.max(initial=0.0))
        self._groups += weight.size
        if batch.mass is not None and batch.edge is not None:
            old = self._record or (np.zeros(()), np.zeros(()))
            self._record = (old[0] + batch.mass, old[1] + batch.edge)
            self._spacing = batch.spacing
        self.next_batch = batch.number + 1

    @staticmethod
    def _merge(old: Complex, count: int, new: Complex, more: int) -> Complex:
        """Return the mean of two means."""
        return (old * count + new * more) / (count + more)

    def relative_error(self) -> float:
        """Return the relative error at the first frequency."""
        if len(self._counts) < 8:  # too few to tell
            return math.inf
        counts = np.array(self._counts)
        value = np.array([v[:, 0, 0].sum() for v in self._values])
        share = counts / counts.sum()
        mean = share @ value
        spread = (share**2 * np.abs(value - mean) ** 2).sum()
        error = math.sqrt(spread * counts.size / (counts.size - 1))
        return error / abs(mean) if mean != 0 else math.inf

    def tally(self, seconds: float, interrupted: bool) -> Tally:
        """Return what was found."""
        tally = replace(
            self._frame,
            batches=np.array(self._values),
            histories_of=np.array(self._counts, dtype=np.int64),
            groups=self._groups,
            contribution=(
                float(self._contribution[0]),
                float(self._contribution[1]),
                float(self._contribution[2]),
            ),
            next_batch=self.next_batch,
            seconds=self._seconds + seconds,
            interrupted=interrupted,
        )
        if self._record is None:
            return tally
        return replace(tally, record=self._path_record(tally))

    def _path_record(self, tally: Tally) -> PathRecord:
        """Return the mean record, both kinds of deposits in one."""
        assert self._record is not None
        mass, edge = (part / self.next_batch for part in self._record)
        # Light spread over a bin, and half of what lies at each of its two nodes.
        spread = np.cumsum(edge, axis=-1)[..., :-1] * self._spacing
        at_nodes = 0.5 * (mass[..., :-1] + mass[..., 1:])
        at_nodes[..., 0] += 0.5 * mass[..., 0]
        light = spread + at_nodes
        target = np.array([name.startswith("target") for name in tally.parts])
        total = tally._select("all")[:, 0, 0].mean().real
        inside = float(light[:, 0].sum())
        return PathRecord(
            length=self._spacing * (np.arange(light.shape[-1], dtype=np.float64) + 0.5),
            water=light[~target].sum(axis=0).T,
            target=light[target].sum(axis=0).T,
            beyond=max(0.0, 1 - inside / total) if total > 0 else 0.0,
        )
