"""Batches of histories, added up in order with flat memory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from amulor.transport.contributions import sums_of, together
from amulor.transport.path_record import PathRecord
from amulor.transport.tally import (
    MOST_BATCHES,
    Tally,
    paired,
)

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True, eq=False, kw_only=True)
class Batch:
    """What one batch of histories gave, as means per history."""

    number: int
    histories: int
    signal: Complex
    weight: Array
    mass: Array | None
    edge: Array | None
    spacing: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Accumulator:
    """Batches in the order of their numbers; pairs are merged when there are many.

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
    next_batch: int = 0

    @classmethod
    def start(cls, frame: Tally, resume: Tally | None) -> Self:
        """Return an accumulator without batches, or with those of a run to go on.

        Raises
        ------
        ValueError
            If the run cannot go on, or is one of something else.
        """
        if resume is None:
            return cls(frame=frame, full=frame.batch_size)
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
            values=tuple(resume.batches),
            counts=counts,
            full=max([frame.batch_size, *counts]),
            contributions=resume.contributions,
            groups=resume.groups,
            seconds=resume.seconds,
            next_batch=resume.next_batch,
        )

    @property
    def histories(self) -> int:
        """Histories so far."""
        return sum(self.counts)

    def with_batch(self, batch: Batch) -> Self:
        """Return the same with the next batch.

        Raises
        ------
        ValueError
            If it brings a record of path lengths and batches before it did not.
        """
        values, counts, full = [*self.values], [*self.counts], self.full
        if counts and counts[-1] < full:
            old, count = values[-1], counts[-1]
            counts[-1] = count + batch.histories
            values[-1] = (old * count + batch.signal * batch.histories) / counts[-1]
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
            next_batch=batch.number + 1,
        )

    def _with_record(self, batch: Batch) -> tuple[Array, Array] | None:
        """Return the record with that of the next batch."""
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
        """Return the result."""
        return replace(
            self.frame,
            batches=np.array(self.values),
            histories_of=np.array(self.counts, dtype=np.int64),
            groups=self.groups,
            contribution=self.contribution,
            contributions=self.contributions if self.groups else None,
            next_batch=self.next_batch,
            seconds=self.seconds + seconds,
            interrupted=interrupted,
            record=None if self.record is None else self._path_record(*self.record),
        )

    @property
    def contribution(self) -> tuple[float, float, float]:
        """Sum, sum of squares and largest of the contributions of all light."""
        if self.contributions is None:
            return (0.0, 0.0, 0.0)
        total, square, largest = (float(value) for value in self.contributions[0, 0])
        return total, square, largest

    def _path_record(self, masses: Array, edges: Array) -> PathRecord:
        """Return the mean record, both kinds of deposits in one."""
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
