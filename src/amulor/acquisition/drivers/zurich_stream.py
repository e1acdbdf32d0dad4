"""What a data server of Zurich Instruments streams, cut to the time that is wanted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.acquisition.clock import Clock, Deadline
from amulor.errors import InstrumentError

#: Longest that one poll waits for data beyond what is recorded, and all of them [s].
_ANSWER, _LATE = 0.5, 2.0


def streamed(
    device: Any,
    nodes: Sequence[Any],
    *,
    duration: float,
    interval: float,
    clock: Clock,
) -> list[dict[str, NDArray[Any]]]:
    """Return what nodes stream over a time that begins with this call.

    Parameters
    ----------
    device : object
        Of zhinst-toolkit.
    nodes : sequence
        Samples of demodulators that are subscribed to, all of one rate.
    duration : float
        How long; one sample at least [s].
    interval : float
        About the time between samples [s].
    clock : Clock
        What waits go by.

    Returns
    -------
    list of dict
        For each node its columns, equally long, and `time` from the first one on [s].

    Raises
    ------
    InstrumentError
        If no data come, or some are lost.

    Notes
    -----
    Data come late. What counts is the instrument's clock at the time of the call, which
    is asked for first, and the timestamps of the samples.
    """
    clockbase = float(device.clockbase())
    begin = _ticks(device, clockbase)
    end = begin + math.ceil(duration * clockbase)
    whole = _polled(device, nodes, end, duration, interval, clock)
    starts = [int(np.searchsorted(part["timestamp"], begin)) for part in whole]
    counts = [
        int(np.searchsorted(part["timestamp"], end, side="right")) - start
        for part, start in zip(whole, starts, strict=True)
    ]
    count = max(min(counts), 1)
    parts = [
        {name: values[start : start + count] for name, values in part.items()}
        for part, start in zip(whole, starts, strict=True)
    ]
    for part in parts:
        ticks = part["timestamp"]
        part["time"] = (ticks - ticks[0]) / clockbase
        steps = np.diff(part["time"])
        if steps.size and steps.max() > 1.5 * steps.min():
            raise InstrumentError(
                f"{device.serial} has lost samples on the way to the data server; take "
                "a longer time constant, or a better network"
            )
    return parts


def _ticks(device: Any, clockbase: float) -> int:
    """Return the time of the instrument in steps of its clock.

    A UHFLI tells them, an HF2LI seconds (the maker's list of its nodes). Taken for
    steps, seconds would lie before all that was ever streamed.
    """
    time = device.status.time()
    if str(device.device_type).startswith("HF2"):
        return math.floor(float(time) * clockbase)
    return int(time)


def _polled(
    device: Any,
    nodes: Sequence[Any],
    end: int,
    duration: float,
    interval: float,
    clock: Clock,
) -> list[dict[str, NDArray[Any]]]:
    """Return what was streamed of each node until a tick of the instrument."""
    parts: list[list[dict[str, Any]]] = [[] for _ in nodes]
    limit = Deadline(clock, duration + _LATE + 20 * interval)
    wait = duration + 2 * interval
    while True:
        found = device.session.poll(recording_time=wait, timeout=_ANSWER)
        for node, got in zip(nodes, parts, strict=True):
            if node in found:
                got.append(found[node])
        if all(got and got[-1]["timestamp"][-1] >= end for got in parts):
            break
        if limit.passed():
            raise InstrumentError(
                f"{device.serial} has streamed no data for {_LATE:g} s; check that its "
                "demodulators are enabled and the data server runs"
            )
        wait = interval
    return [
        {
            name: np.concatenate([np.asarray(one[name]) for one in got])
            for name in got[0]
        }
        for got in parts
    ]
