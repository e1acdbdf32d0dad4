"""Time stamps of navigation messages against the times of their arrival."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from amulor.survey.platform import Mounting

Floats = NDArray[np.float64]

#: Smallest step of the clock that is noticed, if all messages arrive at once [s].
LEAST_STEP = 0.02
#: Smallest noticed step in median delays of the messages [1].
_DELAYS = 5.0
#: Time after which late messages have ended and a lower level is a step [s].
_PATIENCE = 60.0
#: Time beside a step in which no message is used [s].
_BESIDE = 1.0
#: Fewest messages in that time; messages that show the usual delays.
_FEWEST = 20
#: Difference from the stated clock offset that is no error of its statement [s].
_PLAUSIBLE = 0.5


def without_steps(
    stamps: Floats, arrivals: Floats, *, origin: float, mounting: Mounting
) -> tuple[NDArray[np.bool_], list[str]]:
    """Mask of the messages on one steady clock, and a line for each irregularity.

    `arrivals` count from the start of the scan, which is the time `origin`. A message
    arrives after its stamp, so stamp minus arrival has the clock offset as its upper
    limit. A rise of this limit is a step forward. A fall is a step back if the limit
    stays lower: messages of a broken link arrive late, but not for ever. Of several
    clocks, that with the stated offset is used.
    """
    if stamps.size == 0:
        return np.zeros(0, dtype=bool), []
    early = stamps - origin - arrivals
    interval = float(np.median(np.abs(np.diff(stamps)))) if stamps.size > 1 else 1.0
    reach = int(np.clip(_PATIENCE / max(interval, 1e-3), _FEWEST, 1e5))
    near = np.maximum(*_highest(early, _FEWEST // 2)) - early
    least = max(LEAST_STEP, _DELAYS * float(np.median(near)))
    before, after = _highest(early, reach)
    forward = early > before + least
    back = np.append(False, early[:-1] > after[1:] + least)
    forward[0] = False
    begins = np.flatnonzero(forward | back)
    pieces = [*itertools.pairwise([0, *begins.tolist(), stamps.size])]
    level = np.array([early[begin:end].max() for begin, end in pieces])
    away = np.abs(level - mounting.clock_offset)
    candidates = np.flatnonzero(away <= away.min() + least)
    longest = max(candidates, key=lambda piece: pieces[piece][1] - pieces[piece][0])
    used = np.abs(level - level[longest]) <= least
    # A few messages between steps may be late ones of another clock.
    used &= [end - begin >= _FEWEST // 2 for begin, end in pieces]
    used[longest] = True
    mask = np.repeat(used, [end - begin for begin, end in pieces])
    lines = _steps(arrivals[begins], level, least)
    delay = level[longest] - early
    wrong = mask & _set_back(stamps, arrivals, delay, interval, least, arrivals[begins])
    if delay[wrong].max(initial=0.0) > least:
        first = int(np.argmax(wrong))
        lines.append(
            f"navigation: time stamps of {int(wrong.sum())} messages are up to "
            f"{delay[wrong].max():.3g} s too early, the first "
            f"{arrivals[first]:.4g} s after the start"
        )
    mask &= ~wrong
    if not mask.all():
        lines.append(
            f"navigation: {int((~mask).sum())} of {mask.size} messages left out, whose "
            "clock differs"
        )
    late = mask & (stamps < np.maximum.accumulate(np.where(mask, stamps, -np.inf)))
    if late.any():
        lines.append(
            f"navigation: {int(late.sum())} messages out of order, up to "
            f"{delay[late].max():.3g} s late"
        )
    return mask, [*lines, *_doubtful(float(level[longest]), mounting)]


def _highest(values: Floats, reach: int) -> tuple[Floats, Floats]:
    """Largest of so many values before each value, and of it and those after it."""
    reach = min(reach, values.size)
    edge = np.full(2 * reach + 2, -np.inf)
    padded = np.concatenate([edge, values, edge])
    highest = maximum_filter1d(padded, 2 * (reach // 2) + 1)
    index = edge.size + np.arange(values.size)
    return highest[index - 1 - reach // 2], highest[index + reach // 2]


def _set_back(
    stamps: Floats,
    arrivals: Floats,
    delay: Floats,
    interval: float,
    least: float,
    steps: Floats,
) -> NDArray[np.bool_]:
    """Return which messages may have another clock, though later ones have this one.

    A clock that was set back for a while gives equal delays, or stamps of other
    messages. Messages of a broken link arrive together, and fill the gap that they
    left. Late messages soon after a step may still have the clock before it.
    """
    late = delay > least
    equal = np.abs(np.diff(delay)) < min(least, interval / 2)
    same = late & np.append(False, equal) & np.append(equal, False)
    # All late messages in a row with three of the same delay.
    row = np.cumsum(~late)
    wrong = late & np.isin(row, row[same])
    order = np.sort(stamps[~late])
    if order.size > 1:
        place = np.clip(np.searchsorted(order, stamps), 1, order.size - 1)
        away = np.minimum(
            np.abs(stamps - order[place - 1]), np.abs(stamps - order[place])
        )
        wrong |= late & (away < interval / 2)
    ends = np.sort(np.append(steps, arrivals[late & np.isin(row, row[same])]))
    if ends.size:
        last = ends[np.maximum(np.searchsorted(ends, arrivals, side="right") - 1, 0)]
        since = arrivals - last
        wrong |= late & (since >= 0) & (since <= _PATIENCE)
        # Messages that arrive together with a step may belong to either clock.
        for step in steps:
            wrong |= np.abs(arrivals - step) <= _BESIDE
    return wrong


def _steps(arrivals: Floats, level: Floats, least: float) -> list[str]:
    """Describe the steps of the clock; those of one moment are one."""
    lines = []
    first = 0
    for number in range(arrivals.size):
        last = number + 1 == arrivals.size
        if not last and arrivals[number + 1] - arrivals[number] <= _BESIDE:
            continue
        change = level[number + 1] - level[first]
        when = f"{arrivals[first]:.4g} s after the start"
        first = number + 1
        if abs(change) <= least:
            lines.append(f"navigation: a wrong time stamp, {when}")
            continue
        way = "forward" if change > 0 else "back"
        lines.append(
            f"navigation: the clock steps {way} by {abs(change):.4g} s, {when}"
        )
    return lines


def _doubtful(level: float, mounting: Mounting) -> list[str]:
    """Describe a clock offset that differs from the stated one."""
    limit = max(_PLAUSIBLE, 3 * (mounting.clock_uncertainty or 0.0))
    if abs(level - mounting.clock_offset) <= limit:
        return []
    return [
        f"navigation: time stamps minus arrivals are {level:.4g} s, but the mounting "
        f"states a clock offset of {mounting.clock_offset:.4g} s; correct "
        "mounting.clock_offset before the export"
    ]
