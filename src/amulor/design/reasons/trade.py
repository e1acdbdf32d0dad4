"""What time and frequency buy: the recommended instrument with others of both."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from amulor.design.candidates import (
    Parameters,
    box_values,
    frequency_grid,
    laser_of,
    scan_time,
)
from amulor.design.goal import Goal
from amulor.design.scores import Judge, grid_of

__all__ = ["Trade", "trade"]

Floats = NDArray[np.float64]

#: Dwells that are tried, and how far beyond what the goal allows they go.
_DWELLS, _BEYOND = 13, 4.0


@dataclass(frozen=True, kw_only=True)
class Trade:
    """The same instrument with other dwells and frequencies, over (candidate,)."""

    error: Floats
    """Total error at the worst asked distance, as the asked share of draws reaches it;
    infinite where intervals go wrong too often or the detector is overloaded [m]."""
    scan_time: Floats
    """Time of all pixels [s]."""
    top_frequency: Floats
    """Highest modulation frequency [Hz]."""
    best: int
    """Number of the recommended one."""


def trade(goal: Goal, chosen: Parameters, *, draws: int = 24) -> Trade:
    """Return the errors of an instrument with other dwells and frequencies.

    Parameters
    ----------
    goal : Goal
        Distances, ranges and limits; time and budget do not count here.
    chosen : Parameters
        The instrument; all but dwell and frequencies stays.
    draws : int
        Waters and targets that it is judged in.

    Returns
    -------
    Trade
        Its set of frequencies, and those that the goal states; without these, each
        frequency alone, pairs of neighbours, and each above the lowest one of its set.
        Each with dwells up to four times as short and as long as the goal allows.
    """
    box = box_values(goal.components.dwell)
    dwells = np.geomspace(box[0] / _BEYOND, box[-1] * _BEYOND, _DWELLS)
    dwells = np.unique(np.append(dwells, chosen.dwell))
    top = laser_of(goal, chosen.laser).top_frequency or np.inf
    stated = goal.components.modulation
    tones = [tone for tone in frequency_grid(goal) if tone <= top]
    if stated.sets:
        sets = {one for one in stated.sets if one[-1] <= top}
    else:
        sets = {(tone,) for tone in tones}
        if stated.most > 1:
            # Pairs of neighbours keep long intervals up to high frequencies.
            sets |= set(itertools.pairwise(tones))
            low = chosen.frequencies[0]
            if len(chosen.frequencies) > 1:
                sets |= {(low, tone) for tone in tones if tone > low}
    sets.add(chosen.frequencies)
    listed = sorted(sets, key=lambda one: (one[-1], len(one), one))
    grid = replace(grid_of(chosen), dwell=tuple(map(float, dwells)), sets=tuple(listed))
    judge = Judge(goal, chosen.laser, draws=draws)
    score = judge.score(grid, scheme=chosen.polarization, method=chosen.method)
    usable = (score.output <= 1) & (score.validity <= 1)
    usable &= score.wrong.max(axis=1) <= goal.accuracy.wrong_interval
    return Trade(
        error=np.where(usable, score.error.max(axis=1), np.inf),
        scan_time=np.array(
            [
                scan_time(goal, replace(chosen, dwell=dwell, frequencies=one))
                for dwell in grid.dwell
                for one in listed
            ]
        ),
        top_frequency=np.tile([one[-1] for one in listed], len(grid.dwell)),
        best=grid.dwell.index(chosen.dwell) * len(listed)
        + listed.index(chosen.frequencies),
    )
