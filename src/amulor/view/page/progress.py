"""How far a scan has come, from the samples of its journal."""

from __future__ import annotations

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
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Procedure
from amulor.survey import Survey
from amulor.view.page.advice import Drift, Going, advice

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
        self._shots: dict[tuple[Any, ...], dict[int, tuple[complex, float]]] = {}
        self._counts: Counter[str] = Counter()
        self._flags: Counter[str] = Counter()
        self._recent: deque[tuple[float, int]] = deque(maxlen=_RECENT)
        self._kind = ""
        self._last_at = clock()
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
        else:
            at = self._frequency[key.frequency], self._channel[key.polarization]
            self._signal[(*at, key.row, key.column)] = signal
            return key.polarization, key.row
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
        """Return how the open water changed, each direction against its own first.

        All directions and channels together by least squares, so that a channel that
        hardly sees the water says little; the error comes from how they disagree.
        """
        rounds: dict[int, list[tuple[float, float, float]]] = {}
        for (frequency, name, *_), shots in self._shots.items():
            dark = np.mean(self._dark.get((frequency, name), [0.0]))
            base = min(shots.values(), key=lambda shot: shot[1])[0] - dark
            if base == 0:
                continue
            size = float(abs(base))
            for number, (signal, elapsed) in shots.items():
                more = float(((signal - dark) * np.conj(base)).real) / size - size
                rounds.setdefault(number, []).append((more, size, elapsed))
        found: list[tuple[float, float, float]] = []
        for number in sorted(rounds):
            more, size, times = np.array(rounds[number]).T
            power = np.sum(size**2)
            change = float(np.sum(more * size) / power)
            error = float("inf")
            if size.size > 2:
                apart = (more - change * size) * size
                spread = np.sum(apart**2) * size.size / (size.size - 1)
                error = float(np.sqrt(spread) / power)
            found.append((float(np.mean(times)), change, error))
        if len(found) < 2:
            return Drift()
        times, changes, errors = zip(*sorted(found), strict=True)
        return Drift(elapsed=times, change=changes, error=errors)

    def status(self, segments: list[dict[str, Any]]) -> dict[str, Any]:
        """Return how the scan goes, for the page.

        Parameters
        ----------
        segments : list of dict
            Parts of the scan, as the journal has them.

        Returns
        -------
        dict
            Numbers and words that JSON can hold.
        """
        now = self._clock()
        if not self._recent or self._recent[-1][1] != self.seen:
            self._recent.append((now, self.seen))
        running = bool(segments) and segments[-1]["ended"] is None
        finished = bool(segments) and segments[-1]["reason"] == "finished"
        rate = self._rate(now)
        total = max(self.total, self.seen) if not finished else self.seen
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
        )
        if finished:
            state = "finished"
        elif running:
            state = "running"
        else:
            state = str(segments[-1]["reason"]) if segments else "not begun"
        left = (total - self.seen) / rate if running and rate > 0 else None
        return {
            "state": state,
            "kind": self._kind.replace("_", " "),
            "done": self.seen,
            "total": total,
            "rate": rate if running and rate > 0 else None,
            "left": None if left is None else round(left),
            "elapsed": self._elapsed,
            "flagged": dict(self._flags),
            "drift": {
                name: [value if np.isfinite(value) else None for value in values]
                for name, values in asdict(drift).items()
            },
            "advice": advice(going),
        }

    def _rate(self, now: float) -> float:
        """Return samples a second over the last minute."""
        recent = [(at, seen) for at, seen in self._recent if now - at < 60]
        if len(recent) < 2:
            return float("nan")
        span = now - recent[0][0]
        return (self.seen - recent[0][1]) / span if span > 0 else float("nan")
