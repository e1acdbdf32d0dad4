"""Change of the open water between rounds of shots, and whether chance explains it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

#: With fewer directions their scatter says too little [1].
_FEWEST = 3
#: Contrasts that are tested at each round: a straight line, the newest round [1].
_CONTRASTS = 2


@dataclass(frozen=True, kw_only=True)
class Change:
    """Relative change of the open water."""

    size: float = 0.0
    """Per unit of the water signal [1]."""
    error: float = math.inf
    """Standard error [1]."""
    chance: float = 1.0
    """Largest probability that a scan in steady water ever shows such a change [1]."""


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Change of the open water over the complete rounds of shots."""

    elapsed: Sequence[float] = ()
    """Time of each round, of the scan's clock [s]."""
    change: Sequence[float] = ()
    """Of each round from the mean of all rounds, per unit of the water signal [1]."""
    error: Sequence[float] = ()
    """Standard error of each [1]."""
    total: Change = field(default_factory=Change)
    """From the first to the last round, along a straight line over time."""
    newest: Change = field(default_factory=Change)
    """Of the newest round from the mean of all before it."""


def drift_of(
    signal: ArrayLike, *, cluster: ArrayLike, elapsed: ArrayLike, rounds: int
) -> Drift:
    """Return the change of the open water between rounds of shots.

    Parameters
    ----------
    signal : array_like, shape (series, rounds)
        Shots of one frequency, channel and direction in each row [V].
    cluster : array_like, shape (series,)
        Equal where series were measured in the same direction and channel: the water
        fluctuates for all their frequencies together.
    elapsed : array_like, shape (rounds,)
        Time of each round, ascending [s].
    rounds : int
        Number of rounds of the whole scan: each of them but the first is tested [1].

    Returns
    -------
    Drift
        Empty with fewer than two rounds or three directions.

    Notes
    -----
    Each series has a level of its own, the mean of all its rounds, so that no round is
    the one that all others are compared with. Changes of a round are the same in all
    series per unit of their level (least squares). The error follows from the scatter
    of the directions: of all rounds together, or of the contrast itself if that is
    larger, as with a single shot that is far off. Chances are those of Student's t,
    times the number of tests of the scan (Bonferroni).
    """
    shots = np.asarray(signal, dtype=complex)
    times = np.asarray(elapsed, dtype=float)
    _, members = np.unique(np.asarray(cluster), return_inverse=True)
    count = shots.shape[1]
    level = shots.mean(axis=1)
    size = np.abs(level)
    weight = np.bincount(members, size**2)
    power = float(weight.sum())
    share = weight / power if power > 0 else weight
    if count < 2 or np.count_nonzero(share) < _FEWEST:
        return Drift()
    # Projected on the level, times its size: the score of each shot.
    score = (shots * level.conj()[:, np.newaxis]).real - (size**2)[:, np.newaxis]
    scores = np.zeros((weight.size, count))
    np.add.at(scores, members, score)
    change = scores.sum(axis=0) / power
    rest = scores - weight[:, np.newaxis] * change
    # Fluctuations are in proportion to the level; so much of them is left in the rest.
    square = float(share @ share)
    left = 1 - 2 * float(np.sum(share**3)) / square + square
    freedom = (count - 1) * (square**2 / float(np.sum(share**4)) - 1)
    variance = float(np.sum(rest**2)) / ((count - 1) * left) / power**2

    def tested(contrast: NDArray[np.float64]) -> Change:
        found = float(contrast @ change)
        own = float(np.sum((rest @ contrast) ** 2)) / left / power**2
        error = math.sqrt(max(float(contrast @ contrast) * variance, own))
        tests = _CONTRASTS * (max(rounds, count) - 1)
        return Change(
            size=found,
            error=error,
            chance=min(1.0, tests * _two_sided(found, error, freedom)),
        )

    line = times - times.mean()
    if not line @ line > 0:
        line = np.arange(count) - (count - 1) / 2
    newest = np.full(count, -1 / (count - 1))
    newest[-1] = 1.0
    return Drift(
        elapsed=[float(time) for time in times],
        change=[float(value) for value in change],
        error=[math.sqrt(variance * (1 - 1 / count))] * count,
        total=tested(line * (line[-1] - line[0]) / (line @ line)),
        newest=tested(newest),
    )


def _two_sided(value: float, error: float, freedom: float) -> float:
    """Return how probable chance makes a value at least as far from zero."""
    from scipy.special import stdtr

    if value == 0:
        return 1.0
    if error == 0:
        return 0.0
    return 2 * float(stdtr(freedom, -abs(value) / error))
