"""How far a scan has come, from the samples of its journal."""

from __future__ import annotations

import math
import tomllib
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.acquisition import plan
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import Key
from amulor.acquisition.sampler import SPOILED, SampleFlag
from amulor.acquisition.settings import Procedure
from amulor.survey import Survey
from amulor.view.page.advice import Going, advice
from amulor.view.page.drift import Drift, drift_of

#: Frequency, channel, row and column of shots in one direction.
Series = tuple[float, str, int, int]
#: The rate is that of the last samples, by the wall clock [1].
_RECENT = 400


class Progress:
    """Counts what comes, and keeps the signals of the scan.

    Parameters
    ----------
    survey : Survey
        What is measured.
    meta : mapping
        Of the journal.
    clock : callable
        Time [s].
    """

    def __init__(
        self, survey: Survey, meta: Mapping[str, str], *, clock: Callable[[], float]
    ) -> None:
        self._survey, self._clock = survey, clock
        content = tomllib.loads(meta["devices"]).get("procedure", {})
        procedure = Procedure.model_validate(content, context={"from_text": True})
        self.total = plan.count(survey, procedure)
        water = survey.scan.open_water
        #: Samples of the plan have smaller repeat numbers.
        self._planned = {
            plan.SCAN: 1,
            plan.OPEN_WATER: 0 if water is None else water.repeats,
            plan.DARK: procedure.references * procedure.dark_readings,
        }
        instrument = survey.instrument
        self._frequency = {
            value: at for at, value in enumerate(instrument.modulation_frequencies)
        }
        self._channel = {name: at for at, name in enumerate(instrument.polarizations)}
        shape = (
            len(self._frequency),
            len(self._channel),
            survey.scan.rows,
            survey.scan.columns,
        )
        self._signal = np.full(shape, complex(np.nan, np.nan))
        self._dark: dict[tuple[float, str], list[complex]] = {}
        #: Signal and time of each shot, by frequency, channel and direction.
        self._shots: dict[Series, dict[int, tuple[complex, float]]] = {}
        self._spoiled: set[Series] = set()
        self._rounds: Counter[int] = Counter()
        directions = len(plan.open_water_grid(survey))
        self._round_size = directions * len(plan.channels(survey))
        self._drift: tuple[tuple[int, ...], Drift] = ((), Drift())
        self._counts: Counter[str] = Counter()
        self._flags: Counter[str] = Counter()
        self._recent: deque[tuple[float, int]] = deque(maxlen=_RECENT)
        self._kind = ""
        self._filled: Counter[tuple[str, int]] = Counter()
        self._row: int | None = None
        self._last_at = clock()
        self._running = False
        self._elapsed = 0.0
        self.seen = 0

    @property
    def scanned(self) -> int:
        """Samples of the scan itself [1]."""
        return self._counts[plan.SCAN]

    def take(self, key: Key, record: Record) -> tuple[str, int] | None:
        """Take over a sample; returns channel and row of one that is of the scan."""
        self.seen += 1
        self._counts[key.kind] += 1
        # References after a break, and retakes.
        self.total += key.repeat >= self._planned[key.kind]
        self._kind = key.kind
        self._last_at = self._clock()
        self._elapsed = max(self._elapsed, record.elapsed)
        for flag in SampleFlag:
            if flag and record.flags & flag:
                self._flags[str(flag.name).lower().replace("_", " ")] += 1
        signal = complex(record.in_phase, record.quadrature)
        channel = (key.frequency, key.polarization)
        if key.kind == plan.DARK:
            self._dark.setdefault(channel, []).append(signal)
        elif key.kind == plan.OPEN_WATER:
            place = (*channel, key.row, key.column)
            self._shots.setdefault(place, {})[key.repeat] = (signal, record.elapsed)
            self._rounds[key.repeat] += 1
            if record.flags & SPOILED:
                self._spoiled.add(place)
        else:
            at = self._frequency[key.frequency], self._channel[key.polarization]
            self._signal[(*at, key.row, key.column)] = signal
            where = key.polarization, key.row
            self._filled[where] += key.repeat == 0
            if self._filled[where] == self._signal[:, 0, 0].size:
                self._row = key.row
            return where
        return None

    def whole(self, channel: str, row: int) -> bool:
        """Return whether all of a row has been measured."""
        part = self._signal[:, self._channel[channel], row]
        return bool(np.isfinite(part).all())

    def row_signal(self, channel: str, row: int) -> NDArray[np.complex128]:
        """Return the signals of a row, dark output taken off, (frequency, column)."""
        part = self._signal[:, self._channel[channel], row].copy()
        for frequency, at in self._frequency.items():
            dark = self._dark.get((frequency, channel))
            if dark:
                part[at] -= np.mean(dark)
        return part

    def drift(self) -> Drift:
        """Return the change of the open water over its complete rounds of shots."""
        rounds = [r for r, taken in self._rounds.items() if taken >= self._round_size]
        series = [one for one in self._shots if one not in self._spoiled]
        if not (rounds and series):
            return Drift()
        known = len(rounds), len(series), self._counts[plan.DARK]
        if self._drift[0] != known:
            shots = np.array([[self._shots[one][r] for r in rounds] for one in series])
            dark = [np.mean(self._dark.get(one[:2], [0.0])) for one in series]
            elapsed = shots[..., 1].real.mean(axis=0)
            order = np.argsort(elapsed)
            found = drift_of(
                (shots[..., 0] - np.array(dark)[:, np.newaxis])[:, order],
                cluster=[f"{name} {row} {column}" for _, name, row, column in series],
                elapsed=elapsed[order],
                rounds=self._planned[plan.OPEN_WATER],
            )
            self._drift = known, found
        return self._drift[1]

    def status(
        self, segments: list[dict[str, Any]], *, resume: str | None
    ) -> dict[str, Any]:
        """Return how the scan goes, for the page.

        Parameters
        ----------
        segments : list of dict
            Parts of the scan, as the journal has them.
        resume : str, optional
            Command that goes on with the scan, if no program writes to its journal.

        Returns
        -------
        dict
            Numbers and words that JSON can hold.
        """
        now = self._clock()
        last = segments[-1] if segments else {"ended": "", "reason": "not begun"}
        # Devices that are not safe may follow the word.
        finished = str(last["reason"]).startswith("finished")
        running = last["ended"] is None and resume is None
        if finished:
            resume = None
        if not (running and self._running):
            # Time without a writer counts neither for the rate nor as silence.
            self._recent.clear()
            self._last_at = now
        self._running = running
        if not self._recent or self._recent[-1][1] != self.seen:
            self._recent.append((now, self.seen))
        rate = self._rate(now)
        total = self.seen if finished else self.total
        drift = self.drift()
        silent = now - self._last_at
        going = Going(
            running=running,
            done=self.seen,
            scanned=self.scanned,
            open_water=self._counts[plan.OPEN_WATER],
            dark=self._counts[plan.DARK],
            flagged=dict(self._flags),
            rate=rate,
            silent=silent,
            drift=drift,
            total=total,
            resume=resume,
            reason=last["reason"] or "without notice",
        )
        state = "stopped" if resume is not None else str(last["reason"])
        if running:
            state = "running"
        left = (total - self.seen) / rate if running and rate > 0 else None
        return {
            "state": state,
            "resume": resume,
            "kind": self._kind.replace("_", " "),
            "row": self._row,
            "done": self.seen,
            "total": total,
            "rate": rate if running and rate > 0 else None,
            "left": None if left is None else round(left),
            "elapsed": self._elapsed,
            "flagged": dict(self._flags),
            "drift": _plain(asdict(drift)),
            "advice": advice(going),
        }

    def _rate(self, now: float) -> float:
        """Return samples a second over the last minute."""
        recent = [(at, seen) for at, seen in self._recent if now - at < 60]
        if len(recent) < 2:
            return float("nan")
        span = now - recent[0][0]
        return (self.seen - recent[0][1]) / span if span > 0 else float("nan")


def _plain(value: Any) -> Any:
    """Return the same with None for numbers that JSON does not have."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return value if math.isfinite(value) else None
