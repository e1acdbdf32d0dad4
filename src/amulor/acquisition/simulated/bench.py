"""Simulated bench: laser, water, target, detector and lock-in filter, with faults."""

from __future__ import annotations

import cmath
import importlib
import math
import threading
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from amulor.acquisition.clock import Clock
from amulor.acquisition.settings import SimulationSettings
from amulor.acquisition.simulated.scene import (
    LightByDirection,
    Places,
    Scene,
    Tone,
    mount_angles,
)
from amulor.acquisition.uncertainty import reading_variance
from amulor.survey import Survey
from amulor.survey.counting import background_rate


@dataclass(frozen=True)
class Fault:
    """Fault of a simulated device for a number of readings."""

    kind: str
    """Kind: overload, saturation, unlock, lost-link, timeout, stuck, darkness (blocked
    light) or interlock (open)."""
    first: int
    """Number of the first reading, counted from 1 [1]."""
    count: int
    """Number of readings [1]."""


@dataclass(frozen=True)
class Faults:
    """Faults of a simulated instrument."""

    planned: tuple[Fault, ...] = ()
    """Faults in any order."""

    @classmethod
    def parse(cls, texts: Iterable[str]) -> Faults:
        """Parse faults from texts such as "unlock@500x3".

        Examples
        --------
        >>> Faults.parse(["unlock@500x3"]).active("unlock", 502)
        True
        """
        result = []
        for text in texts:
            kind, _, when = text.partition("@")
            first, _, count = when.partition("x")
            result.append(Fault(kind, int(first), int(count or 1)))
        return cls(tuple(result))

    def active(self, kind: str, reading: int) -> bool:
        """Return whether a fault of a kind is active at a reading."""
        return any(
            fault.kind == kind and fault.first <= reading < fault.first + fault.count
            for fault in self.planned
        )


def in_steps(
    tones: Sequence[Tone],
    *,
    start: float,
    interval: float,
    count: int,
    time_constant: float,
    spread: float,
    settings: SimulationSettings,
    rng: np.random.Generator,
) -> list[list[complex]]:
    """Advance output filters of all tones by equal time steps; return outputs [V]."""
    from scipy.signal import lfilter

    keep = math.exp(-interval / time_constant)
    fresh = math.sqrt(max(1 - keep**2, 0.0)) * spread
    moments = start + interval * np.arange(1, count + 1)
    turn = np.exp(1j * settings.phase_drift * moments)
    columns = []
    for tone in tones:
        aim = tone.input * turn + settings.pickup
        drawn = rng.standard_normal((2, count))
        for name, enters in (
            ("level", (1 - keep) * aim),
            ("noise", fresh * (drawn[0] + 1j * drawn[1])),
        ):
            state = [keep * getattr(tone, name)]
            filtered, _ = lfilter([1.0], [1.0, -keep], enters, zi=state)
            setattr(tone, name, complex(filtered[-1]))
            columns.append(filtered)
    shown = np.stack(columns[::2], axis=1) + np.stack(columns[1::2], axis=1)
    rows: list[list[complex]] = shown.tolist()
    return rows


#: Speed of the beam [rad/s].
SCAN_SPEED = 5.0
#: Speed of mounts [rad/s].
MOUNT_SPEED = 10.0
#: Speed of the target [m/s].
TARGET_SPEED = 0.2
#: Time to lock to a new frequency [s].
LOCK_TIME = 0.05
#: Cached frequencies beside those of the survey.
_MOST_OTHERS = 16
#: Axes of the beam, and the target position beyond which it is out [m].
_BEAM, _OUT = ("azimuth", "elevation"), 0.05
#: Largest angle between a beam and the standing reference that it meets [rad].
_ON_REFERENCE = 3e-4
#: Arrival time of an axis at rest.
_AT_REST = -math.inf


def _or_never(arrival: float) -> float:
    return math.inf if arrival == _AT_REST else arrival


class Bench:
    """Simulated optical bench: laser, water, target, detector and lock-in filter.

    Simulated devices set its inputs and read its output. A direction between pixels has
    the light of the nearest pixel or shot. The filter integrates the light along the
    whole path of a moving beam. Several threads may use a bench.
    """

    def __init__(
        self,
        survey: Survey,
        settings: SimulationSettings,
        *,
        scene: Scene,
        clock: Clock,
        launch: Mapping[str, float],
        analyser: Mapping[str, float],
        course: tuple[int, float] = (0, 0.0),
    ) -> None:
        self.survey = survey
        self.clock = clock
        self.faults = Faults.parse(settings.faults)
        self.readings = 0
        self.laser_on = False
        self.shutter_closed = False
        self._blocked = False
        self._settings = settings
        self._rng = np.random.default_rng(settings.seed)
        self._lock = threading.RLock()
        self._scene = scene
        # Light of all frequencies of the survey, and of others that were set.
        light = scene(survey)
        self._planned = (Places(light.with_target), Places(light.open_water))
        # Vehicle that carries the instrument, and the clock at the start of the scan.
        self.vehicle = None if light.vehicle is None else light.vehicle(*course)
        self.scan_start = clock.now()
        self._drawn: dict[int, float] = {}
        self._others: dict[float, tuple[Places, Places]] = {}
        self._tones = [self._tone(survey.instrument.modulation_frequencies[0])]
        self._pairs = mount_angles(survey, launch, analyser)
        self._daylight = background_rate(survey)
        self._locked_at = -math.inf
        self._filter(survey.instrument.lock_in.time_constant)
        # Position, goal and arrival time of each axis.
        self._place = {"azimuth": 0.0, "elevation": 0.0, "target": 0.0}
        self._place |= {"launch": 0.0, "analyser": 0.0}
        self._goal = dict(self._place)
        self._arrival = dict.fromkeys(self._place, _AT_REST)
        self._next_arrival = math.inf
        # Start and start time of moving axes; times and places on the path of the beam;
        # the present place while it moves.
        self._start: dict[str, tuple[float, float]] = {}
        self._ahead: deque[tuple[float, int]] = deque()
        self._beam_place: int | None = None
        self._time = self._begun = clock.now()
        self._spread = 0.0
        self._mean = 0.0
        # Trace of outputs, with its start, interval and number.
        self._trace: list[list[complex]] = []
        self._trace_start, self._trace_interval, self._trace_most = 0.0, 1.0, 0
        self._renew()

    # -- inputs --------------------------------------------------------------------

    def set_laser(self, on: bool) -> None:
        """Switch the laser on or off."""
        with self._lock:
            self._advance()
            self.laser_on = on
            self._renew()

    def set_shutter(self, *, closed: bool) -> None:
        """Close or open the shutter in front of the detector."""
        with self._lock:
            self._advance()
            self.shutter_closed = closed
            self._renew()

    def set_time_constant(self, time_constant: float) -> None:
        """Set the time constant of the output filter [s]."""
        with self._lock:
            self._advance()
            self._filter(time_constant)
            self._renew()

    def set_frequency(self, frequency: float) -> None:
        """Set the modulation frequency [Hz]; the reference unlocks for a moment."""
        self.set_frequencies([frequency])

    def set_frequencies(self, frequencies: Sequence[float]) -> None:
        """Modulate at several frequencies [Hz], each with the depth of the survey.

        The filters keep their outputs, in order.
        """
        with self._lock:
            self._advance()
            before = self._tones
            self._tones = [self._tone(frequency) for frequency in frequencies]
            for tone, old in zip(self._tones, before, strict=False):
                tone.level, tone.noise = old.level, old.noise
            self._locked_at = self.clock.now() + LOCK_TIME
            self._renew()

    def send(self, goals: Mapping[str, float], *, speed: float) -> None:
        """Start to move axes to positions such that all arrive at the same time.

        The names are azimuth, elevation, launch, analyser and target.
        """
        with self._lock:
            now = self._arrive()
            stuck = self.faults.active("stuck", self.readings)
            for name in goals:
                self._place[name] = self._position_at(name, now)
            distance = max(
                abs(goal - self._place[name]) for name, goal in goals.items()
            )
            arrival = math.inf if stuck else now + distance / speed
            for name, goal in goals.items():
                self._goal[name] = goal
                self._start[name] = (self._place[name], now)
                self._arrival[name] = arrival
            if "azimuth" in goals or "elevation" in goals:
                self._look_ahead(now)
            self._next_arrival = min(self._arrival.values(), key=_or_never)
            self._arrive()

    def stop(self, names: Iterable[str] | None = None) -> None:
        """Stop axes at their present positions; by default all axes."""
        with self._lock:
            self._advance()
            now = self._time
            stopped = [*self._place] if names is None else [*names]
            for name in stopped:
                self._place[name] = self._position_at(name, now)
            for name in stopped:
                self._goal[name] = self._place[name]
                self._arrival[name] = _AT_REST
            self._look_ahead(now)
            self._next_arrival = min(self._arrival.values(), key=_or_never)
            if self._next_arrival == _AT_REST:
                self._next_arrival = math.inf

    # -- outputs -------------------------------------------------------------------

    def arrived(self, name: str) -> bool:
        """Return whether an axis has arrived at its goal."""
        with self._lock:
            return self._arrival[name] <= self._arrive()

    def arrival(self, name: str) -> float:
        """Return the arrival time of an axis by the clock [s]."""
        with self._lock:
            return self._arrival[name]

    def place(self, name: str) -> float:
        """Return the present position of an axis, even during its motion."""
        with self._lock:
            return self._position_at(name, self._arrive())

    def goal(self, name: str) -> float:
        """Return the goal of an axis."""
        with self._lock:
            return self._goal[name]

    @property
    def frequency(self) -> float:
        """First modulation frequency [Hz]."""
        return self._tones[0].frequency

    @property
    def frequencies(self) -> list[float]:
        """All modulation frequencies [Hz]."""
        return [tone.frequency for tone in self._tones]

    @property
    def interlock_is_closed(self) -> bool:
        """Whether the interlock is closed."""
        return not self.faults.active("interlock", max(self.readings, 1))

    @property
    def noise(self) -> float:
        """Noise standard deviation per quadrature, as a peak amplitude [V]."""
        return self._spread

    def locked(self) -> bool:
        """Return whether the reference is locked."""
        with self._lock:
            return self.clock.now() >= self._locked_at

    def output(self) -> tuple[complex, float]:
        """Return the filtered peak signal and the mean output of the detector [V].

        Each call counts as a reading; faults begin at given readings.
        """
        signals, mean = self.outputs()
        return signals[0], mean

    def outputs(self) -> tuple[list[complex], float]:
        """Return the filtered peak signal of each frequency and the mean output [V]."""
        with self._lock:
            self.readings += 1
            self._advance()
            dark = self.faults.active("darkness", self.readings)
            if (dark or not self.interlock_is_closed) != self._blocked:
                self._blocked = not self._blocked
                self._renew()
            output = [tone.level + tone.noise for tone in self._tones]
            if self.faults.active("saturation", self.readings):
                return output, 2 * self.survey.instrument.detector.saturation
            return output, self._mean

    # -- internals ----------------------------------------------------------------

    def _advance(self) -> None:
        """Advance motion and output filter to the present time."""
        self._relax(self._arrive())

    def _arrive(self) -> float:
        """Update all positions to the present time; return this time [s]."""
        now = self.clock.now()
        while min(self._next_arrival, self._next_border) <= now:
            if self._next_border <= self._next_arrival:
                moment, self._beam_place = self._ahead.popleft()
                self._relax(moment)
                self._renew()
                continue
            moment = self._next_arrival
            self._relax(moment)
            for name in [*self._arrival]:
                if self._arrival[name] == moment:
                    self._place[name] = self._goal[name] + self._missed_by(name)
                    self._arrival[name] = _AT_REST
                    if name in ("azimuth", "elevation", "target"):
                        self._beam_place = None
            self._next_arrival = min(self._arrival.values(), key=_or_never)
            if self._next_arrival == _AT_REST:
                self._next_arrival = math.inf
            self._renew()
        return now

    @property
    def _next_border(self) -> float:
        return self._ahead[0][0] if self._ahead else math.inf

    def _position_at(self, name: str, now: float) -> float:
        """Return the position of an axis at a time during its motion."""
        arrival = self._arrival[name]
        if not math.isfinite(arrival):
            return self._place[name]
        if now >= arrival:
            return self._goal[name]
        begin, since = self._start[name]
        part = max((now - since) / (arrival - since), 0.0)
        return begin + part * (self._goal[name] - begin)

    def _look_ahead(self, now: float) -> None:
        """Compute the times at which the moving beam passes scene directions."""
        self._ahead.clear()
        arrival = max(self._arrival["azimuth"], self._arrival["elevation"])
        start = complex(*(self._position_at(name, now) for name in _BEAM))
        end = complex(*(self._goal[name] for name in _BEAM))
        if not now < arrival < math.inf or start == end:
            return
        out = abs(self._place["target"]) > _OUT
        places = self._tones[0].open_water if out else self._tones[0].scan
        way = arrival - now
        self._ahead.extend(
            (now + part * way, number) for part, number in places.passed(start, end)
        )

    def _missed_by(self, name: str) -> float:
        if name not in ("azimuth", "elevation"):
            return 0.0
        return self._settings.position_error * float(self._rng.standard_normal())

    @property
    def time_constant(self) -> float:
        """Time constant of the output filter [s]."""
        return self._time_constant

    def instant(self) -> tuple[list[complex], float]:
        """Return the present filter inputs and the mean output [V].

        It counts as a reading.
        """
        _, mean = self.outputs()
        with self._lock:
            turn = cmath.exp(1j * self._settings.phase_drift * self._time)
            pickup = self._settings.pickup
            return [tone.input * turn + pickup for tone in self._tones], mean

    def start_trace(
        self, interval: float, *, most: int, start: float | None = None
    ) -> None:
        """Start to record outputs at an interval [s], now or at a start time."""
        # Imported before the clock is read.
        importlib.import_module("scipy.signal")
        with self._lock:
            self._advance()
            self._trace = []
            self._trace_start = self._time if start is None else start
            self._trace_interval, self._trace_most = interval, most

    @property
    def trace_start(self) -> float:
        """Start time of the recorded outputs [s]."""
        return self._trace_start

    def trace(self) -> list[list[complex]]:
        """Return the recorded outputs so far, a row per time [V]."""
        with self._lock:
            self._advance()
            return self._trace

    def _relax(self, until: float) -> None:
        """Advance the output filter to a time [s], and record the trace."""
        while len(self._trace) < self._trace_most:
            moment = self._trace_start + len(self._trace) * self._trace_interval
            if moment > until:
                break
            self._settle(moment)
            self._trace.append([tone.level + tone.noise for tone in self._tones])
            if self.vehicle is not None:
                continue
            more = int((until - moment) / self._trace_interval * (1 - 1e-12))
            if (more := min(more, self._trace_most - len(self._trace))) > 0:
                self._trace += in_steps(
                    self._tones,
                    start=self._time,
                    interval=self._trace_interval,
                    count=more,
                    time_constant=self._time_constant,
                    spread=self._spread,
                    settings=self._settings,
                    rng=self._rng,
                )
                self._time += more * self._trace_interval
        self._settle(until)

    def _settle(self, until: float) -> None:
        """Advance the one-pole filter and its noise to a time [s]."""
        passed = until - self._time
        if passed <= 0:
            return
        # The exponent is limited: the filter has forgotten its past by then.
        keep = math.exp(-min(passed / self._time_constant, 700.0))
        turn = cmath.exp(1j * self._settings.phase_drift * until)
        before = [tone.input for tone in self._tones]
        if self.vehicle is not None:
            self._time = until
            self._renew(again=False)
        lag = self._time_constant / passed * (1 - keep)
        fresh = math.sqrt(max(1 - keep**2, 0.0)) * self._spread
        for tone, old in zip(self._tones, before, strict=True):
            # The light of a moving scene changes linearly; the filter lags behind.
            start = old * turn + self._settings.pickup
            aim = tone.input * turn + self._settings.pickup
            tone.level = aim + (tone.level - start) * keep - (aim - start) * lag
            tone.noise = keep * tone.noise + fresh * complex(
                self._rng.standard_normal(), self._rng.standard_normal()
            )
        self._time = until

    def _tone(self, frequency: float) -> Tone:
        planned = self.survey.instrument.modulation_frequencies
        if frequency in planned:
            return Tone(frequency, *self._planned, planned.index(frequency))
        return Tone(frequency, *self._light_at(frequency), 0)

    def _light_at(self, frequency: float) -> tuple[Places, Places]:
        """Return target and open-water signals at a frequency not in the survey."""
        if frequency not in self._others:
            path = "instrument.modulation_frequencies"
            light = self._scene(self.survey.with_({path: [frequency]}))
            # A sweep over many frequencies must not fill the memory.
            while len(self._others) >= _MOST_OTHERS:
                del self._others[next(iter(self._others))]
            self._others[frequency] = (
                Places(light.with_target),
                Places(light.open_water),
            )
        return self._others[frequency]

    def _renew(self, *, again: bool = True) -> None:
        """Compute filter inputs, mean output and noise for the present direction.

        `again` draws new random errors of water and phases.
        """
        rate = 0.0
        if again:
            self._drawn = {}
        bright = self.laser_on and not self._blocked
        moving: LightByDirection | None = None
        lit = bright and not self.shutter_closed
        if lit:
            out = abs(self._place["target"]) > _OUT
            pair = self._polarization()
            where = (self._place["azimuth"], self._place["elevation"])
            drift = self._settings.water_drift * (self.clock.now() - self._begun)
            # The water fluctuates equally at all frequencies.
            fluctuation = self.survey.water.signal_fluctuation
            change = max(1 + drift, 0.0) * (1 + fluctuation * self._normal(0))
        for number, tone in enumerate(self._tones):
            leakage = complex(self._settings.leakage if bright else 0.0)
            tone.input = leakage
            if not lit:
                continue
            places = tone.open_water if out else tone.scan
            place = (
                places.nearest(*where) if self._beam_place is None else self._beam_place
            )
            light, index = places.light, (tone.channel, pair, place)
            if self.vehicle is not None and not out:
                if moving is None:
                    moving = self.vehicle.light(self._time - self.scan_start, place)
                light, index = moving, (tone.channel, pair, 0)
            level = complex(light.target[index] + change * light.water[index])
            if self._reference is not None:
                level = complex(self._reference)
            phase = self._phase_error(abs(level), tone.frequency, number)
            tone.input = level * cmath.exp(1j * phase) + leakage
            if number == 0 and self._reference is not None:
                depth = self.survey.instrument.modulation_depth
                volt = self.survey.instrument.detector.volt_per_photoelectron_rate
                rate = self._reference / (depth * volt)
            elif number == 0:  # mean light of all frequencies
                rate = float(
                    light.target_rate[index]
                    + max(change, 0.0) * light.water_rate[index]
                )
        if not self.shutter_closed:
            rate += float(self._daylight[self._polarization()])
        detector = self.survey.instrument.detector
        volt = detector.volt_per_photoelectron_rate
        self._mean = volt * (rate + detector.dark_rate)
        # A single reading of a settled one-pole filter counts for two time constants.
        self._spread = math.sqrt(self._dark_variance + rate * self._variance_per_rate)

    @property
    def _reference(self) -> float | None:
        """Amplitude of the standing reference [V]; None if the beam is elsewhere."""
        reference = self.survey.scan.reference
        if reference is None or self._beam_place is not None or self._ahead:
            return None
        off = max(abs(self._goal[name] - getattr(reference, name)) for name in _BEAM)
        return reference.amplitude if off < _ON_REFERENCE else None

    def _filter(self, time_constant: float) -> None:
        self._time_constant = time_constant
        dark, light = reading_variance(
            self.survey, rate=np.array([0.0, 1.0]), time_constant=time_constant
        )
        self._dark_variance = float(dark)
        self._variance_per_rate = float(light - dark)

    def _polarization(self) -> int:
        """Return the index of the polarization pair closest to the mount angles."""
        now = complex(self._place["launch"], self._place["analyser"])
        return min(
            range(len(self._pairs)), key=lambda pair: abs(self._pairs[pair] - now)
        )

    def _normal(self, number: int) -> float:
        """Return a random number of the present stay, drawn on first use."""
        if number not in self._drawn:
            self._drawn[number] = float(self._rng.standard_normal())
        return self._drawn[number]

    def _phase_error(self, amplitude: float, frequency: float, tone: int) -> float:
        settings = self._settings
        walk = 0.0
        if settings.phase_walk and amplitude > 0:
            walk = settings.phase_walk * math.log10(amplitude)
        floor = self.survey.instrument.lock_in.phase_floor
        return (
            2 * math.pi * frequency * settings.cable_delay
            + walk
            + floor * self._normal(1 + tone)
        )
