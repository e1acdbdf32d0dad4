"""Simulated devices of a scan that share one simulated instrument, the bench."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence

import numpy as np

from amulor.acquisition.protocols import (
    SIMULATOR,
    Overload,
    Reading,
    Recorded,
    Waveform,
)
from amulor.acquisition.simulated.bench import (
    MOUNT_SPEED,
    SCAN_SPEED,
    TARGET_SPEED,
    Bench,
)
from amulor.acquisition.simulated.scene import Vehicle
from amulor.errors import InstrumentError

#: Full scales of the lock-in, as peak amplitudes [V].
FULL_SCALES = tuple(10.0**exponent for exponent in range(-7, 1))
#: Fraction of the full scale below which a finer scale is selected.
_FINER_BELOW = 0.05


class _Simulated:
    _kind = "device"

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.log: list[str] = []

    def identity(self) -> str:
        """Return the identity of a simulated device."""
        return f"amulor,{self._kind},0,{SIMULATOR}"

    def make_safe(self) -> None:
        """Log that the device was made safe."""
        self.log.append("safe")

    def close(self) -> None:
        """Log that the device was closed."""
        self.log.append("close")


class SimulatedLockIn(_Simulated):
    """Simulated lock-in amplifier on a simulated bench."""

    _kind = "lock-in"

    def __init__(self, bench: Bench) -> None:
        super().__init__(bench)
        self._scale = len(FULL_SCALES) - 1

    def prepare(self, *, time_constant: float) -> None:
        """Set the time constant of the output filter [s]."""
        self.bench.set_time_constant(time_constant)
        self._constant = time_constant

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Set the modulation frequency, wait for lock, return the actual one [Hz]."""
        return self.set_frequencies([frequency], timeout=timeout)[0]

    def set_frequencies(
        self, frequencies: Sequence[float], *, timeout: float
    ) -> list[float]:
        """Modulate at several frequencies [Hz], wait for lock, return them [Hz]."""
        self.bench.set_frequencies(frequencies)
        end = self.bench.clock.now() + timeout
        while not self.bench.locked():
            if self.bench.clock.now() > end:
                raise InstrumentError(
                    f"the simulated lock-in has not locked within {timeout:g} s"
                )
            self.bench.clock.sleep(0.01)
        return [*frequencies]

    def read(self) -> Reading:
        """Return the present outputs, overload bits and lock state."""
        return self.read_all()[0]

    def read_all(self) -> list[Reading]:
        """Return the outputs of every frequency, overload bits and lock state."""
        signals, mean = self.bench.outputs()
        number = self.bench.readings
        faults = self.bench.faults
        if faults.active("lost-link", number):
            raise InstrumentError("the simulated lock-in: the link is lost")
        if faults.active("timeout", number):
            raise InstrumentError("the simulated lock-in does not answer in time")
        overload = Overload.NONE
        scale = self.full_scale()
        if max(map(abs, signals)) > scale:
            overload |= Overload.OUTPUT
            signals = [
                signal * min(1.0, scale / max(abs(signal), 1e-300))
                for signal in signals
            ]
        if faults.active("overload", number):
            overload |= Overload.INPUT
        unlocked = faults.active("unlock", number) or not self.bench.locked()
        return [
            Reading(
                signal=signal,
                mean=mean,
                modulation_frequency=frequency,
                overload=overload,
                unlocked=unlocked,
            )
            for signal, frequency in zip(signals, self.bench.frequencies, strict=True)
        ]

    def record(self, duration: float) -> Recorded:
        """Record the outputs of every frequency for a time [s]."""
        bench, interval = self.bench, self._constant / 10
        count = 1 + round(duration / interval)
        bench.start_trace(interval, most=count)
        bench.clock.sleep((count - 1) * interval)
        while len(bench.trace()) < count:  # the last one may lie beyond rounding
            bench.clock.sleep(interval / 100)
        rows = np.array(bench.trace())
        last = self.read_all()
        scale = self.full_scale()
        overload = last[0].overload
        if np.abs(rows).max() > scale:
            overload |= Overload.OUTPUT
        return Recorded(
            times=np.asarray(np.arange(count) * interval, dtype=float),
            signals=rows,
            mean=last[0].mean,
            modulation_frequencies=tuple(
                reading.modulation_frequency for reading in last
            ),
            overload=overload,
            unlocked=last[0].unlocked,
        )

    def begin_stream(self, duration: float) -> None:
        """Start to record, for at least a time [s]."""
        interval = self._constant / 10
        self.bench.start_trace(interval, most=2 + math.ceil(duration / interval))
        self._fetched = 0

    def fetch(self) -> Recorded:
        """Return the outputs of every frequency since the last call."""
        last, start = self.read_all(), self.bench.trace_start
        rows = self.bench.trace()[self._fetched :]
        numbers = self._fetched + np.arange(len(rows))
        self._fetched += len(rows)
        overload = last[0].overload
        signals = np.array(rows).reshape(len(rows), len(last))
        if np.abs(signals).max(initial=0.0) > self.full_scale():
            overload |= Overload.OUTPUT
        return Recorded(
            times=np.asarray(start + self._constant / 10 * numbers, dtype=float),
            signals=signals,
            mean=last[0].mean,
            modulation_frequencies=tuple(
                reading.modulation_frequency for reading in last
            ),
            overload=overload,
            unlocked=last[0].unlocked,
        )

    def relieve(self, overload: Overload) -> bool:
        """Select the next coarser scale; False if there is none."""
        if self._scale == len(FULL_SCALES) - 1:
            return False
        self._scale += 1
        return True

    def sharpen(self, amplitude: float) -> bool:
        """Select the next finer scale if the amplitude [V] allows it; else False."""
        finer = max(self._scale - 1, 0)
        if finer == self._scale or amplitude > _FINER_BELOW * self.full_scale():
            return False
        self._scale = finer
        return True

    def full_scale(self) -> float:
        """Return the full scale of the present setting, as a peak amplitude [V]."""
        return FULL_SCALES[self._scale]


class SimulatedScanner(_Simulated):
    """Simulated scanner on a simulated bench."""

    _kind = "scanner"

    def move(
        self, azimuth: float, elevation: float, *, timeout: float
    ) -> tuple[float, float]:
        """Turn to a direction [rad]; return the read-back [rad]."""
        self.log.append("move")
        goals = {"azimuth": azimuth, "elevation": elevation}
        self.bench.send(goals, speed=SCAN_SPEED)
        wait_for(self.bench, "azimuth", device="the simulated scanner", timeout=timeout)
        return self.where()

    def begin_sweep(self, azimuth: float, elevation: float, *, duration: float) -> None:
        """Start a motion that reaches a direction [rad] after a time [s]."""
        self.log.append("sweep")
        away = abs(azimuth - self.bench.place("azimuth"))
        away = max(away, abs(elevation - self.bench.place("elevation")))
        goals = {"azimuth": azimuth, "elevation": elevation}
        self.bench.send(goals, speed=away / duration)

    def where(self) -> tuple[float, float]:
        """Return the present direction [rad]."""
        return self.bench.place("azimuth"), self.bench.place("elevation")

    def make_safe(self) -> None:
        """Stop the scanner."""
        self.bench.stop()
        super().make_safe()


class SimulatedMount(_Simulated):
    """Simulated rotation mount on a simulated bench."""

    _kind = "rotation mount"

    def __init__(self, bench: Bench, name: str) -> None:
        super().__init__(bench)
        self._name = name

    def rotate(self, angle: float, *, timeout: float) -> float:
        """Turn to an angle [rad]; return the read-back [rad]."""
        self.bench.send({self._name: angle}, speed=MOUNT_SPEED)
        wait_for(self.bench, self._name, device="the simulated mount", timeout=timeout)
        return self.bench.place(self._name)


class SimulatedLaser(_Simulated):
    """Simulated laser on a simulated bench."""

    _kind = "laser"

    def on(self) -> None:
        """Switch the laser on."""
        self.log.append("on")
        self.bench.set_laser(True)

    def check(self) -> None:
        """Raise if the laser interlock is open."""
        if not self.bench.interlock_is_closed:
            raise InstrumentError(
                "the interlock of the simulated laser is open; see who opened it, and "
                "close it"
            )

    def off(self) -> None:
        """Switch the laser off."""
        self.log.append("off")
        self.bench.set_laser(False)

    def make_safe(self) -> None:
        """Switch the laser off."""
        self.off()


class SimulatedShutter(_Simulated):
    """Simulated shutter on a simulated bench."""

    _kind = "shutter"

    def shut(self) -> None:
        """Close the shutter."""
        self.log.append("shut")
        self.bench.set_shutter(closed=True)

    def open(self) -> None:
        """Open the shutter."""
        self.log.append("open")
        self.bench.set_shutter(closed=False)

    def make_safe(self) -> None:
        """Close the shutter."""
        self.bench.set_shutter(closed=True)
        super().make_safe()


class SimulatedTargetStage(_Simulated):
    """Simulated target stage on a simulated bench."""

    _kind = "target stage"

    def bring_in(self, *, timeout: float) -> float:
        """Put the target into the beam; return its position [m]."""
        return self._go(0.0, timeout=timeout)

    def take_out(self, *, timeout: float) -> float:
        """Take the target out of the beam; return its position [m]."""
        return self._go(0.2, timeout=timeout)

    def _go(self, place: float, *, timeout: float) -> float:
        self.bench.send({"target": place}, speed=TARGET_SPEED)
        wait_for(self.bench, "target", device="the simulated target", timeout=timeout)
        return self.bench.place("target")


def wait_for(bench: Bench, name: str, *, device: str, timeout: float) -> None:
    """Wait until an axis of a bench arrives; raise after the timeout [s]."""
    start = bench.clock.now()
    bench.clock.sleep(min(bench.arrival(name) - start, timeout))
    while not bench.arrived(name):
        if bench.clock.now() - start > timeout:
            raise InstrumentError(
                f"{device} has not come to where it was sent within {timeout:g} s; see "
                "what holds it"
            )
        bench.clock.sleep(timeout / 100)


#: Amplitude of each tone at the reference input, and its noise [V].
_REFERENCE, _REFERENCE_NOISE = 0.1, 1e-4


class SimulatedDigitiser:
    """Simulated digitizer of the detector signal and the modulation of a bench."""

    ranges: tuple[float, ...] = (0.01, 0.1, 1.0, 10.0)
    shows_mean = True

    def __init__(
        self,
        bench: Bench,
        *,
        sample_rate: float = 125e6,
        memory: int = 16_384,
        bits: int = 14,
        clock_offset: float = 0.0,
        seed: int = 1,
    ) -> None:
        self.bench = bench
        self._rate, self._memory, self._bits = sample_rate, memory, bits
        self._offset = clock_offset
        self._rng = np.random.default_rng(seed)
        self._range = len(self.ranges) - 1
        self.puts_out = False

    def identity(self) -> str:
        """Return the identity of a simulated device."""
        return f"amulor,digitiser,0,{SIMULATOR}"

    def prepare(self) -> None:
        """Switch the modulation off until frequencies are set."""
        self.puts_out = False

    def set_range(self, number: int) -> None:
        """Select an input range by its index in `ranges`."""
        self._range = number

    def set_frequencies(
        self, frequencies: Sequence[float], *, timeout: float
    ) -> list[float]:
        """Modulate at several frequencies at once [Hz]."""
        self.bench.set_frequencies(frequencies)
        self.puts_out = True
        return [*frequencies]

    def acquire(self, duration: float) -> Waveform:
        """Return a record of a duration [s], shorter if the memory is full."""
        faults, number = self.bench.faults, self.bench.readings + 1
        if faults.active("timeout", number) or faults.active("lost-link", number):
            self.bench.readings += 1
            raise InstrumentError("the simulated digitizer does not answer in time")
        count = int(min(max(round(duration * self._rate), 1024), self._memory))
        tones, mean = self.bench.instant()
        spread = self.bench.noise * math.sqrt(self.bench.time_constant * self._rate)
        # The generator counts true time; this clock is too fast.
        times = self._rng.uniform(0, 1e-3) + np.arange(count) / (
            self._rate * (1 + self._offset)
        )
        signal = mean + spread * self._rng.standard_normal(count)
        reference = _REFERENCE_NOISE * self._rng.standard_normal(count)
        unlocked = faults.active("unlock", number) or not self.puts_out
        for frequency, tone in zip(self.bench.frequencies, tones, strict=True):
            turn = np.exp(-2j * np.pi * (frequency * times % 1.0))
            signal += (tone * turn).real
            reference += _REFERENCE * turn.real * (not unlocked)
        if faults.active("overload", number):
            signal *= 100 * self.ranges[-1] / max(np.max(np.abs(signal)), 1e-12)
        limit = self.ranges[self._range]
        step = limit / 2 ** (self._bits - 1)
        digits = np.clip(np.round(signal / step) * step, -limit, limit - step)
        self.bench.clock.sleep(count / self._rate)
        return Waveform(
            signal=digits,
            reference=reference,
            sample_rate=self._rate,
            clipped=bool(np.any((digits >= limit - step) | (digits <= -limit))),
            shows_mean=True,
        )

    def make_safe(self) -> None:
        """Switch the modulation off."""
        self.puts_out = False

    def close(self) -> None:
        """Do nothing."""


#: Current [A] and temperature [degC] after *RST.
_CURRENT, _TEMPERATURE = 0.08, 25.0
#: Rise of the diode temperature with light [K], and its time [s].
_WARMER, _WARMING = 0.5, 10.0


class SimulatedLaserDriver:
    """Simulated laser diode driver, with temperature control and an interlock."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.lines: list[str] = []
        self._errors: list[str] = []
        self._set = _CURRENT
        self._on, self._since = False, 0.0
        self._answers: dict[str, Callable[[], str]] = {
            "*IDN?": lambda: f"amulor,laser diode driver,0,{SIMULATOR}",
            "OUTP?": lambda: str(int(self._lit())),
            "SOUR:CURR?": lambda: f"{self._set:.6e}",
            "MEAS:CURR?": lambda: f"{self._set * self._lit():.6e}",
            "MEAS:TEMP?": lambda: f"{self._temperature():.3f}",
            "INP:ILOCK?": lambda: str(int(self.bench.interlock_is_closed)),
            "SYST:ERR?": lambda: (
                self._errors.pop(0) if self._errors else '0,"No error"'
            ),
        }

    def answer(self, line: str) -> list[str]:
        """Return the answers to one command line."""
        self.lines.append(line)
        if line in self._answers:
            return [self._answers[line]()]
        if line == "OUTP ON" and not self.bench.interlock_is_closed:
            self._errors.append('-221,"Settings conflict; interlock open"')
        elif line in ("OUTP ON", "OUTP OFF"):
            self._on, self._since = line == "OUTP ON", self.bench.clock.now()
            self.bench.set_laser(self._on)
        elif match := re.fullmatch(r"SOUR:CURR ([0-9.eE+-]+)", line):
            self._set = float(match[1])
        else:
            self._errors.append('-113,"Undefined header"')
        return []

    def _lit(self) -> bool:
        if self._on and not self.bench.interlock_is_closed:
            self._on = False
            self.bench.set_laser(False)
        return self._on

    def _temperature(self) -> float:
        passed = self.bench.clock.now() - self._since
        return _TEMPERATURE + _WARMER * min(passed / _WARMING, 1.0) * self._lit()


class SimulatedNavigation(_Simulated):
    """Simulated navigation of the vehicle of a bench; messages arrive without delay."""

    _kind = "navigation"

    def __init__(self, bench: Bench, vehicle: Vehicle, elapsed: float) -> None:
        super().__init__(bench)
        self._vehicle, self._elapsed = vehicle, elapsed

    def begin(self) -> None:
        """Start to receive messages, and the time of the scan."""
        self.bench.scan_start = self.bench.clock.now() - self._elapsed

    def messages(self) -> list[tuple[float, str]]:
        """Return arrival by the clock [s] and text of the messages since the last."""
        start = self.bench.scan_start
        now = self.bench.clock.now() - start
        new = self._vehicle.messages(self._elapsed, now)
        self._elapsed = now
        return [(start + arrival, line) for arrival, line in new]
