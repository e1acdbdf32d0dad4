"""Acquisition of samples: configure devices, read, auto-range and flag."""

from __future__ import annotations

import enum
import math
import statistics
from collections import deque
from collections.abc import Sequence
from typing import cast

from amulor.acquisition.devices import Devices
from amulor.acquisition.dwell import Dwell, DwellReader, refuse_lacking
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import DARK, OPEN_WATER, REFERENCE, SCAN, SHUTTER, Step
from amulor.acquisition.protocols import CombLockIn, Overload
from amulor.acquisition.settings import Settings
from amulor.acquisition.sweep import SweepReader, Swept
from amulor.errors import InstrumentError
from amulor.optics.polarization import stokes
from amulor.survey import Survey

#: Newest dark readings in the level of each polarization, since stray light varies.
_DARK_READINGS = 100
#: Least difference of light and dark level, in standard errors [1].
_SIGNIFICANT = 5.0


class DarkLevel:
    """Mean detector output without light, by polarization, from dark readings.

    Stray light passes the analyzer, so each polarization has a separate level.
    """

    def __init__(self) -> None:
        self._readings: dict[str, deque[float]] = {}

    def add(self, polarization: str, means: Sequence[float]) -> None:
        """Add mean detector outputs of dark readings with a polarization [V]."""
        readings = self._readings.setdefault(polarization, deque(maxlen=_DARK_READINGS))
        readings.extend(means)

    def is_dark(self, polarization: str, means: Sequence[float]) -> bool:
        r"""Return whether mean outputs with the laser on are not above the dark level.

        With n readings and m dark ones of mean d and standard deviation s, a mean is
        dark up to :math:`d + 5 s \sqrt{1 / n + 1 / m}`.
        """
        dark = self._readings.get(polarization)
        if not dark or len(means) == 0:
            return False
        spread = statistics.stdev(dark) if len(dark) > 1 else 0.0
        error = spread * math.sqrt(1 / len(means) + 1 / len(dark))
        limit = statistics.fmean(dark) + _SIGNIFICANT * error
        return statistics.fmean(means) <= limit


#: Largest difference of commanded and read-back angle of a mount [rad].
_MOUNT_OFF = math.radians(0.5)
#: Samples since the last change of scale before a finer one is selected.
_CALM = 20


#: Further wait after the light went off: of the echo, 3e-7 is left in the output after
#: these and 5 time constants [time constants].
_TO_DARKNESS = 10


class SampleFlag(enum.IntFlag):
    """Problems of a sample, as bit flags."""

    NONE = 0
    OVERLOAD = 1
    """Lock-in or detector overloaded at the coarsest setting."""
    REPEATED = 2
    """The lock-in lost its reference, and the sample was acquired again."""
    RESCALED = 4
    """The lock-in changed its range, and the sample was acquired again."""
    OFF_POSITION = 8
    """The beam is off the commanded direction by more than the tolerance."""
    OFF_FREQUENCY = 16
    """The read-back frequency differs from the commanded one."""
    # 32 is `UNCALIBRATED` of the cube.
    NO_LIGHT = 64
    """The laser was on, but the mean detector output was as low as in dark readings."""
    UNSETTLED = 128
    """Readings differed by more than their noise."""
    NO_POSE = 256
    """There is no pose of the vehicle at the time of the sample; in the cube only."""


#: Samples with one of these flags can be acquired again on request.
SPOILED = (
    SampleFlag.OVERLOAD
    | SampleFlag.OFF_POSITION
    | SampleFlag.NO_LIGHT
    | SampleFlag.UNSETTLED
)

#: Largest relative difference of commanded and read-back frequency; the oscillator of
#: an SR844 has three digits, its counter has more.
_FREQUENCY_TOLERANCE = 1e-3


class Sampler:
    """Acquisition of samples, with a memory of the present device settings."""

    def __init__(
        self,
        survey: Survey,
        settings: Settings,
        devices: Devices,
        *,
        shutter_closed: bool = False,
    ) -> None:
        #: Whether the shutter is closed in every sample.
        self._shutter_closed = shutter_closed
        self._settings = settings
        self._procedure = settings.procedure
        self._devices = devices
        self._sweeper: SweepReader | None = None
        if settings.procedure.mode == "continuous":
            self._sweeper = SweepReader(
                survey,
                settings.procedure,
                devices.lock_in,
                devices.scanner,
                devices.clock,
            )
        self._constant = survey.instrument.lock_in.time_constant
        self._saturation = survey.instrument.detector.saturation
        self._reader = DwellReader(
            survey, settings.procedure, devices.lock_in, devices.clock
        )
        self._overloaded_in_a_row = self._dark_in_a_row = 0
        self._dark_level = DarkLevel()
        self._calm = 0
        self._set_to: dict[float, float] = {}
        self.forget()

    def prepare(self) -> None:
        """Configure the lock-in for a scan."""
        self._devices.lock_in.prepare(time_constant=self._constant)
        self.forget()

    def forget(self) -> None:
        """Discard the remembered settings, because devices were made safe."""
        #: Whether more than the direction has changed since the last reading.
        self._new = True
        #: Read-back of mounts and target after their last move.
        self._positions: dict[str, float | None] = {}
        self._frequencies: tuple[float, ...] = ()
        self._polarization: str | None = None
        self._laser: bool | None = None
        self._target_is_in: bool | None = None
        self._shutter_is_closed: bool | None = None

    def take(self, step: Step, *, elapsed: float, segment: int) -> list[Record]:
        """Acquire one dwell: configure, settle, read, auto-range, flag problems."""
        start = self._devices.clock.now()
        self._arrange(step)
        azimuth, elevation = self._devices.scanner.move(
            step.azimuth, step.elevation, timeout=self._settings.scanner.move_timeout
        )
        dwell, flags = self._read()
        if step.key.kind != DARK:
            self._refuse_open_interlock()
        flags |= self._misplaced(step, azimuth, elevation)
        if not dwell.settled:
            flags |= SampleFlag.UNSETTLED
        begin = elapsed + dwell.begin - start
        records = self._records(
            step, dwell, flags, (azimuth, elevation), (elapsed, begin), segment
        )
        if step.key.kind != DARK and not records[0].flags & SampleFlag.NO_LIGHT:
            # All frequencies share the input.
            self._sharpen(sum(map(abs, dwell.signals)), flags)
        return records

    def sweep(
        self, steps: Sequence[Step], *, elapsed: float, segment: int
    ) -> list[list[Record]]:
        """Acquire neighboring pixels of a row while the beam moves along them."""
        assert self._sweeper is not None
        start = self._devices.clock.now()
        self._arrange(steps[0])
        pixels, flags = self._swept(self._sweeper, steps)
        records, brightest = [], 0.0
        for step, pixel in zip(steps, pixels, strict=True):
            pixel_flags = flags | self._misplaced(step, pixel.azimuth, pixel.elevation)
            if pixel.dwell.overload:
                pixel_flags |= SampleFlag.OVERLOAD
            if pixel.off > self._procedure.position_tolerance:
                pixel_flags |= SampleFlag.OFF_POSITION
            where = (pixel.azimuth, pixel.elevation)
            begin = elapsed + pixel.begin - start
            records.append(
                self._records(
                    step, pixel.dwell, pixel_flags, where, (begin, begin), segment
                )
            )
            brightest = max(brightest, sum(map(abs, pixel.dwell.signals)))
            self._sharpen_by(pixel_flags)
        if not any(part[0].flags & SampleFlag.NO_LIGHT for part in records):
            self._take_finer_scale(brightest)
        return records

    def _swept(
        self, sweeper: SweepReader, steps: Sequence[Step]
    ) -> tuple[list[Swept], SampleFlag]:
        """Acquire the pixels of a row; repeat it all after loss of lock or overload."""
        flags, losses = SampleFlag.NONE, 0
        timeout = self._settings.scanner.move_timeout
        while True:
            self._devices.scanner.move(
                sweeper.start_of(steps), steps[0].elevation, timeout=timeout
            )
            if self._new:
                self._devices.clock.sleep(self._procedure.settling * self._constant)
                self._new = False
            pixels = sweeper.take(
                steps, timeout=timeout, watch=self._refuse_open_interlock
            )
            overload = Overload.NONE
            for pixel in pixels:
                overload |= pixel.dwell.overload
            if any(pixel.dwell.unlocked for pixel in pixels):
                flags |= SampleFlag.REPEATED
                losses += 1
                self._refuse_lost(losses)
            elif overload and self._devices.lock_in.relieve(overload):
                flags |= SampleFlag.RESCALED
                self._new = True
            else:
                return pixels, flags

    def _records(
        self,
        step: Step,
        dwell: Dwell,
        flags: SampleFlag,
        where: tuple[float, float],
        times: tuple[float, float],
        segment: int,
    ) -> list[Record]:
        """Return the records of one dwell, one for each key of its step.

        `times` are those of the start of the dwell and of its integration window.
        """
        azimuth, elevation = where
        elapsed, begin = times
        means = dwell.means
        mean = statistics.fmean(means) if means else None
        if mean is not None and mean > self._saturation:
            flags |= SampleFlag.OVERLOAD
        if step.key.kind == DARK:
            if not flags & SampleFlag.OVERLOAD:
                self._dark_level.add(step.key.polarization, means)
        elif not self._closed_for(step) and self._dark_level.is_dark(
            step.key.polarization, means
        ):
            flags |= SampleFlag.NO_LIGHT
        self._count_overloads(flags)
        laser_readings: dict[str, float] = getattr(
            self._devices.laser, "readings", dict
        )()
        scale = self._devices.lock_in.full_scale()
        records = []
        for key in step.keys:
            place = step.frequencies.index(key.frequency)
            signal, used = dwell.signals[place], dwell.modulation_frequencies[place]
            record = Record(
                in_phase=signal.real,
                quadrature=signal.imag,
                mean=mean,
                readings=dwell.readings,
                interval=dwell.interval,
                spread=dwell.spreads[place],
                edge=None if dwell.edges is None else dwell.edges[place],
                full_scale=scale,
                flags=int(flags | _off_frequency(key.frequency, used)),
                commanded_azimuth=step.azimuth,
                commanded_elevation=step.elevation,
                azimuth=azimuth,
                elevation=elevation,
                modulation_frequency=used,
                elapsed=elapsed,
                begin=max(begin, 0.0),
                duration=dwell.duration,
                segment=segment,
                **self._positions,
                **laser_readings,
            )
            records.append(record)
        return records

    def _arrange(self, step: Step) -> None:
        """Set frequency, polarization, target, shutter and laser."""
        if step.frequencies != self._frequencies:
            self._set_frequencies(step.frequencies)
        if step.key.polarization != self._polarization:
            self._set_polarization(step.key.polarization)
        self._move_target(step.key.kind)
        if step.key.kind != DARK:
            self._move_shutter(self._closed_for(step))
        self._switch_laser(step.key.kind != DARK)

    def _set_frequencies(self, frequencies: tuple[float, ...]) -> None:
        devices, settings = self._devices, self._settings
        timeout = settings.lock_in.lock_timeout
        if len(frequencies) == 1:
            (frequency,) = frequencies
            if devices.source is not None:
                devices.source.set_frequency(frequency, timeout=settings.source.timeout)
            set_to = [devices.lock_in.set_frequency(frequency, timeout=timeout)]
        else:
            lock_in = devices.lock_in
            words = ("set_frequencies", "read_all")
            refuse_lacking(lock_in, "procedure.frequencies_at_once", *words)
            comb = cast(CombLockIn, lock_in)
            set_to = comb.set_frequencies(frequencies, timeout=timeout)
        for commanded, actual in zip(frequencies, set_to, strict=True):
            self._refuse_merged_frequencies(commanded, actual)
        self._frequencies = frequencies
        self._new = True

    def _refuse_open_interlock(self) -> None:
        """Raise if the laser interlock is open."""
        check = getattr(self._devices.laser, "check", None)
        if check is not None:
            check()

    def _refuse_merged_frequencies(self, commanded: float, set_to: float) -> None:
        """Raise if the instrument rounds two frequencies to the same one."""
        self._set_to[commanded] = set_to
        for earlier, earlier_actual in self._set_to.items():
            if earlier != commanded and earlier_actual == set_to:
                low, high = sorted((commanded, earlier))
                raise InstrumentError(
                    f"the lock-in makes {set_to / 1e6:.10g} MHz of both "
                    f"{low / 1e6:.10g} and {high / 1e6:.10g} MHz; move the modulation "
                    "frequencies of the survey apart"
                )

    def _set_polarization(self, pair: str) -> None:
        launched, analysed = stokes.pair_states(pair)
        for name, state in (("launch", launched), ("analyser", analysed)):
            mount = getattr(self._devices, name)
            mount_settings = getattr(self._settings, name)
            if mount is None or state == "none":
                continue
            if state not in mount_settings.angles:
                raise InstrumentError(
                    f"the devices file states no angle of the {name} mount for the "
                    f"state {state}; add {name}.angles.{state}"
                )
            goal = mount_settings.angles[state]
            angle = mount.rotate(goal, timeout=mount_settings.move_timeout)
            if not abs(angle - goal) <= _MOUNT_OFF:
                raise InstrumentError(
                    f"the {name} mount stands at {math.degrees(angle):.2f} degrees "
                    f"and was sent to {math.degrees(goal):.2f}; see what holds it, and "
                    "reference it"
                )
            self._positions[name] = angle
        self._polarization = pair
        self._new = True

    def _switch_laser(self, on: bool) -> None:
        if on == self._laser:
            return
        if on:
            self._devices.laser.on()
            self._devices.clock.sleep(self._settings.laser.warm_up)
        else:
            self._devices.laser.off()
            self._wait_for_darkness()
        self._laser = on
        self._new = True

    def _closed_for(self, step: Step) -> bool:
        """Return whether a dwell requires a closed shutter."""
        return self._shutter_closed or step.key.kind == SHUTTER

    def _move_shutter(self, closed: bool) -> None:
        shutter, stated = self._devices.shutter, self._settings.shutter
        if shutter is None or closed == self._shutter_is_closed:
            return
        if stated is not None and stated.driver == "operator":
            # The operator will reach into the beam.
            self._switch_laser(False)
        if closed:
            shutter.shut()
            self._wait_for_darkness()
        else:
            shutter.open()
        self._shutter_is_closed = closed
        self._new = True

    def _wait_for_darkness(self) -> None:
        """Wait, in addition to `settling`, until the filter output has decayed."""
        self._devices.clock.sleep(_TO_DARKNESS * self._constant)

    def _move_target(self, kind: str) -> None:
        target = self._devices.target
        if target is None or kind in (DARK, SHUTTER, REFERENCE):
            return
        if (kind == SCAN) == self._target_is_in:
            return
        timeout = self._settings.target.move_timeout
        if self._settings.target.driver == "operator":
            # The operator will reach into the beam.
            self._switch_laser(False)
        if kind == OPEN_WATER:
            position = target.take_out(timeout=timeout)
        else:
            position = target.bring_in(timeout=timeout)
        self._positions["target"] = position
        self._target_is_in = kind == SCAN
        self._new = True

    def _read(self) -> tuple[Dwell, SampleFlag]:
        lock_in, flags, losses, tries = self._devices.lock_in, SampleFlag.NONE, 0, 0
        while True:
            several = len(self._frequencies) > 1
            dwell = self._reader.take(several=several, changed=self._new)
            self._new = False
            overload = dwell.overload
            if not overload and not dwell.unlocked:
                return dwell, flags
            tries += 1
            if dwell.unlocked:
                flags |= SampleFlag.REPEATED
                losses += 1
                self._refuse_lost(losses)
            elif tries == 1:
                # Status bits may date from the move; read once more.
                continue
            elif lock_in.relieve(overload):
                flags |= SampleFlag.RESCALED
                self._new = True
            else:
                return dwell, flags | SampleFlag.OVERLOAD

    def _refuse_lost(self, losses: int) -> None:
        if losses > self._procedure.attempts:
            raise InstrumentError(
                f"the lock-in has lost its reference in {losses} samples in a row; "
                "check the reference and the modulation frequency"
            )

    def _misplaced(self, step: Step, azimuth: float, elevation: float) -> SampleFlag:
        error = max(abs(azimuth - step.azimuth), abs(elevation - step.elevation))
        off = error > self._procedure.position_tolerance
        return SampleFlag.OFF_POSITION if off else SampleFlag.NONE

    def _count_overloads(self, flags: SampleFlag) -> None:
        if not flags & SampleFlag.OVERLOAD:
            self._overloaded_in_a_row = 0
            return
        self._overloaded_in_a_row += 1
        if self._overloaded_in_a_row > self._procedure.patience:
            raise InstrumentError(
                f"{self._overloaded_in_a_row} samples in a row are overloaded, at the "
                "coarsest scale; take light or gain away"
            )

    def refuse_darkness(self, kind: str, flags: int) -> None:
        """Raise after too many consecutive samples without light."""
        if kind == DARK:
            return
        if not flags & SampleFlag.NO_LIGHT:
            self._dark_in_a_row = 0
            return
        self._dark_in_a_row += 1
        if self._dark_in_a_row > self._procedure.darkness_patience:
            raise InstrumentError(
                f"{self._dark_in_a_row} samples in a row show no light: with the laser "
                "switched on the mean output of the detector is that of the dark "
                "readings; see that the interlock is closed, that nothing stands in "
                "the beam and that no other program drives the laser. If the light is "
                "too weak for that input, take lock_in.mean_output_input out of the "
                "devices file"
            )

    def _sharpen(self, amplitude: float, flags: SampleFlag) -> None:
        self._sharpen_by(flags)
        self._take_finer_scale(amplitude)

    def _sharpen_by(self, flags: SampleFlag) -> None:
        """Update the count of samples since the lock-in last changed its scale."""
        self._calm = 0 if flags & SampleFlag.RESCALED else self._calm + 1

    def _take_finer_scale(self, amplitude: float) -> None:
        # Rarely, because each change of scale needs settling, and may shift the phase.
        if self._calm >= _CALM and self._devices.lock_in.sharpen(amplitude):
            self._calm = 0
            self._new = True


def _off_frequency(commanded: float, used: float) -> SampleFlag:
    off = abs(used - commanded) > _FREQUENCY_TOLERANCE * commanded
    return SampleFlag.OFF_FREQUENCY if off else SampleFlag.NONE
