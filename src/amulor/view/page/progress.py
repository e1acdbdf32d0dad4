"""State of a running scan: progress, drift of the open-water signal, and advice."""

from __future__ import annotations

import math
import tomllib
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.acquisition import plan
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import Key
from amulor.acquisition.sampler import SPOILED, SampleFlag
from amulor.acquisition.settings import Procedure
from amulor.survey import Survey

#: With fewer directions their scatter is not reliable [1].
_FEWEST = 3
#: Contrasts that are tested at each round: a straight line, the newest round [1].
_CONTRASTS = 2


@dataclass(frozen=True, kw_only=True)
class Change:
    """Relative change of the open-water signal, with its significance."""

    size: float = 0.0
    """Change of the signal divided by the water signal [1]."""
    error: float = math.inf
    """Standard uncertainty of the change [1]."""
    chance: float = 1.0
    """Upper bound of the probability of such a change in steady water [1]."""


@dataclass(frozen=True, kw_only=True)
class Drift:
    """Drift of the open-water signal between rounds of reference measurements."""

    elapsed: Sequence[float] = ()
    """Time of each round since the start of the scan [s]."""
    change: Sequence[float] = ()
    """Deviation of each round from the mean of all rounds, relative to the water signal
    [1]."""
    error: Sequence[float] = ()
    """Standard uncertainty of each change [1]."""
    total: Change = field(default_factory=Change)
    """Change from the first to the last round, by a straight-line fit."""
    newest: Change = field(default_factory=Change)
    """Change of the newest round from the mean of the earlier ones."""


def drift_of(
    signal: ArrayLike, *, cluster: ArrayLike, elapsed: ArrayLike, rounds: int
) -> Drift:
    """Drift of the open-water signal between complete rounds of references.

    Each series is relative to the mean of all its rounds, so that no single round is
    the reference. The relative change of a round is assumed equal in all series (least
    squares). Its error follows from the scatter between directions: of all rounds
    together, or of the contrast itself if that is larger, as with a single outlier.
    Probabilities are those of Student's t, times the number of tests of the scan
    (Bonferroni).
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
    residual = scores - weight[:, np.newaxis] * change
    # Fluctuations are in proportion to the level; so much of them is left in the rest.
    square = float(share @ share)
    effective = 1 - 2 * float(np.sum(share**3)) / square + square
    freedom = (count - 1) * (square**2 / float(np.sum(share**4)) - 1)
    variance = float(np.sum(residual**2)) / ((count - 1) * effective) / power**2

    def tested(contrast: NDArray[np.float64]) -> Change:
        estimate = float(contrast @ change)
        weighted = float(np.sum((residual @ contrast) ** 2)) / effective / power**2
        error = math.sqrt(max(float(contrast @ contrast) * variance, weighted))
        tests = _CONTRASTS * (max(rounds, count) - 1)
        return Change(
            size=estimate,
            error=error,
            chance=min(1.0, tests * _two_sided(estimate, error, freedom)),
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
    """Two-sided probability of a deviation at least this large by chance [1]."""
    from scipy.special import stdtr

    if value == 0:
        return 1.0
    if error == 0:
        return 0.0
    return 2 * float(stdtr(freedom, -abs(value) / error))


#: Relative change of the water that is worth a new reference, if significant [1].
WORTH_A_REFERENCE = 0.02
#: Significance level: fraction of scans in steady water with such a change [1].
CHANCE = 1e-3
#: Fraction of flagged samples above which the page gives advice [1].
WORTH_A_WORD = 0.01
#: Without a sample for this many times the usual interval, something may be wrong.
_PATIENCE = 20.0
_SHORTEST = 15.0


@dataclass(frozen=True, kw_only=True)
class Going:
    """State of a scan: samples, sampling rate, drift, and reason of the last stop."""

    running: bool
    """Whether a part of the scan is running."""
    done: int
    """Samples in the journal [1]."""
    scanned: int
    """Samples of the scan itself [1]."""
    open_water: int
    """Samples of open water [1]."""
    dark: int
    """Samples without light [1]."""
    flagged: dict[str, int] = field(default_factory=dict)
    """Number of samples by flag [1]."""
    rate: float = math.nan
    """Sampling rate [1/s]."""
    silent: float = 0.0
    """Time since the last sample [s]."""
    drift: Drift = field(default_factory=Drift)
    """Drift of the open-water signal."""
    total: int = 0
    """Samples of the finished scan [1]."""
    resume: str | None = None
    """Command that resumes a scan without a running program."""
    reason: str = ""
    """Reason for the end of the last part."""


_FLAGS = {
    "overload": "overload the lock-in or the detector: less power, or a larger scale",
    "off position": "stand off the commanded direction: check the scanner",
    "off frequency": "are detected at another frequency than commanded",
    "no light": "are without light: check laser and shutter",
    "repeated": "lost the reference and were taken again: check its cable",
}


def advice(going: Going) -> list[str]:
    """Advice to the operator, the most important first."""
    lines = []
    if going.resume is not None:
        lines.append(
            f"stopped ({going.reason}) at {going.done:,} of {going.total:,} samples; "
            f"resume with: {going.resume}"
        )
    patience = _SHORTEST
    if going.rate > 0:
        patience = max(_SHORTEST, _PATIENCE / going.rate)
    if going.running and going.silent > patience:
        lines.append(
            f"no sample for {going.silent:.0f} s: see whether the instrument still runs"
        )
    for change, words in (
        (going.drift.total, "open water drifted"),
        (going.drift.newest, "the newest shots of open water jumped"),
    ):
        if abs(change.size) >= WORTH_A_REFERENCE and change.chance < CHANCE:
            lines.append(
                f"{words} {change.size * 100:+.1f} % (± {change.error * 100:.2g} %): "
                "take a reference"
            )
            break
    for name, words in _FLAGS.items():
        share = going.flagged.get(name, 0) / max(going.done, 1)
        if share >= WORTH_A_WORD:
            lines.append(f"{share:.0%} of the samples {words}")
    if going.scanned and not going.open_water:
        lines.append("no open-water shots so far: the water cannot be removed yet")
    if going.scanned and not going.dark:
        lines.append("no dark readings: offsets of the instrument stay in the samples")
    return lines


#: Frequency, channel, row and column of shots in one direction.
Series = tuple[float, str, int, int]
#: Number of last samples that determine the rate, by the wall clock [1].
_RECENT = 400


class Progress:
    """Counter and store of the samples of a running scan."""

    def __init__(
        self, survey: Survey, meta: Mapping[str, str], *, clock: Callable[[], float]
    ) -> None:
        self._survey, self._clock = survey, clock
        content = tomllib.loads(meta["devices"]).get("procedure", {})
        procedure = Procedure.model_validate(content, context={"from_text": True})
        self.total = plan.count(survey, procedure)
        water = survey.scan.open_water
        #: Repeat number from which samples are additional to the plan.
        self._planned = {
            plan.SCAN: 1,
            plan.OPEN_WATER: 0 if water is None else water.repeats,
            plan.DARK: procedure.references * procedure.dark_readings,
            plan.SHUTTER: procedure.references * (procedure.shutter_readings or 0),
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
        """Number of samples of the scan, without dark and open-water references [1]."""
        return self._counts[plan.SCAN]

    def take(self, key: Key, record: Record) -> tuple[str, int] | None:
        """Add a sample; return channel and row if it is a pixel of the scan."""
        self.seen += 1
        self._counts[key.kind] += 1
        # References after a break, and retakes.
        self.total += self._is_additional(key)
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
        elif key.kind in (plan.SHUTTER, plan.REFERENCE):
            pass  # counted above
        elif key.kind == plan.OPEN_WATER:
            place = (*channel, key.row, key.column)
            self._shots.setdefault(place, {})[key.repeat] = (signal, record.elapsed)
            self._rounds[key.repeat] += 1
            if record.flags & SPOILED:
                self._spoiled.add(place)
        else:
            at = self._frequency[key.frequency], self._channel[key.polarization]
            self._signal[(*at, key.row, key.column)] = signal
            row = key.polarization, key.row
            self._filled[row] += key.repeat == 0
            if self._filled[row] == self._signal[:, 0, 0].size:
                self._row = key.row
            return row
        return None

    def _is_additional(self, key: Key) -> bool:
        """Whether a sample is a retake or belongs to a reference after a break."""
        if key.kind != plan.REFERENCE:
            return key.repeat >= self._planned[key.kind]
        rounds = self._planned[plan.OPEN_WATER]
        return key.column == plan.BEFORE_SHOTS and key.row >= rounds

    def is_complete(self, channel: str, row: int) -> bool:
        """Whether all pixels of a row were measured in a channel."""
        part = self._signal[:, self._channel[channel], row]
        return bool(np.isfinite(part).all())

    def row_signal(self, channel: str, row: int) -> NDArray[np.complex128]:
        """Signals of a row without the dark signal, shape (frequency, column) [V]."""
        part = self._signal[:, self._channel[channel], row].copy()
        for frequency, at in self._frequency.items():
            dark = self._dark.get((frequency, channel))
            if dark:
                part[at] -= np.mean(dark)
        return part

    def drift(self) -> Drift:
        """Drift of the open-water signal over its complete rounds of references."""
        rounds = [r for r, count in self._rounds.items() if count >= self._round_size]
        series = [key for key in self._shots if key not in self._spoiled]
        if not (rounds and series):
            return Drift()
        state = len(rounds), len(series), self._counts[plan.DARK]
        if self._drift[0] != state:
            shots = np.array([[self._shots[key][r] for r in rounds] for key in series])
            dark = [np.mean(self._dark.get(key[:2], [0.0])) for key in series]
            elapsed = shots[..., 1].real.mean(axis=0)
            order = np.argsort(elapsed)
            change = drift_of(
                (shots[..., 0] - np.array(dark)[:, np.newaxis])[:, order],
                cluster=[f"{name} {row} {column}" for _, name, row, column in series],
                elapsed=elapsed[order],
                rounds=self._planned[plan.OPEN_WATER],
            )
            self._drift = state, change
        return self._drift[1]

    def status(
        self, segments: list[dict[str, Any]], *, resume: str | None
    ) -> dict[str, Any]:
        """State of the scan, as the browser page needs it."""
        now = self._clock()
        last = segments[-1] if segments else {"ended": "", "reason": "not begun"}
        # The word may be followed by the devices that are not safe.
        finished = str(last["reason"]).startswith("finished")
        running = last["ended"] is None and resume is None
        if finished:
            resume = None
        if not (running and self._running):
            # Time without a writer counts neither in the rate nor as silence.
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
        remaining = (total - self.seen) / rate if running and rate > 0 else None
        return {
            "state": state,
            "resume": resume,
            "kind": self._kind.replace("_", " "),
            "row": self._row,
            "done": self.seen,
            "total": total,
            "rate": rate if running and rate > 0 else None,
            "left": None if remaining is None else round(remaining),
            "elapsed": self._elapsed,
            "flagged": dict(self._flags),
            "drift": _plain(asdict(drift)),
            "advice": advice(going),
        }

    def _rate(self, now: float) -> float:
        """Return the sampling rate during the last minute; NaN at the start [1/s]."""
        recent = [(at, count) for at, count in self._recent if now - at < 60]
        if len(recent) < 2:
            return float("nan")
        span = now - recent[0][0]
        return (self.seen - recent[0][1]) / span if span > 0 else float("nan")


def _plain(value: Any) -> Any:
    """Copy of a value for JSON, with None for NaN and infinity."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    return value if math.isfinite(value) else None
