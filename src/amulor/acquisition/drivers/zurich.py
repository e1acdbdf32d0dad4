"""Driver of Zurich Instruments lock-in amplifiers, through their data server."""

from __future__ import annotations

import functools
import importlib
import math
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from amulor.acquisition.clock import Clock, Deadline
from amulor.acquisition.protocols import Overload, Reading, Recorded
from amulor.errors import AmulorError, InstrumentError, MissingExtraError

#: Longest wait of one poll beyond the recorded time, and of all polls [s].
_ANSWER, _LATE = 0.5, 2.0


def streamed(
    device: Any,
    nodes: Sequence[Any],
    *,
    duration: float,
    interval: float,
    clock: Clock,
) -> list[dict[str, NDArray[Any]]]:
    """Return the samples that nodes stream during a time [s] from this call on.

    Data arrive late. The clock of the instrument, queried first, and the timestamps of
    the samples select the time.
    """
    clockbase = float(device.clockbase())
    begin = _ticks(device, clockbase)
    end = begin + math.ceil(duration * clockbase)
    streams = _polled(device, nodes, end, duration, interval, clock)
    starts = [int(np.searchsorted(part["timestamp"], begin)) for part in streams]
    counts = [
        int(np.searchsorted(part["timestamp"], end, side="right")) - start
        for part, start in zip(streams, starts, strict=True)
    ]
    count = max(min(counts), 1)
    parts = [
        {name: values[start : start + count] for name, values in part.items()}
        for part, start in zip(streams, starts, strict=True)
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
    """Return the present time of the instrument clock in ticks.

    A UHFLI answers in ticks, an HF2LI in seconds (the maker's list of its nodes).
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
    """Return the samples that nodes stream until a time of the instrument clock."""
    parts: list[list[dict[str, Any]]] = [[] for _ in nodes]
    limit = Deadline(clock, duration + _LATE + 20 * interval)
    wait = duration + 2 * interval
    while True:
        data = device.session.poll(recording_time=wait, timeout=_ANSWER)
        for node, chunks in zip(nodes, parts, strict=True):
            if node in data:
                chunks.append(data[node])
        if all(chunks and chunks[-1]["timestamp"][-1] >= end for chunks in parts):
            break
        if limit.passed():
            raise InstrumentError(
                f"{device.serial} has streamed no data for {_LATE:g} s; check that its "
                "demodulators are enabled and the data server runs"
            )
        wait = interval
    return [
        {
            name: np.concatenate([np.asarray(chunk[name]) for chunk in chunks])
            for name in chunks[0]
        }
        for chunks in parts
    ]


#: Input ranges, peak [V].
INPUT_RANGES = (0.01, 0.03, 0.1, 0.3, 1.0, 1.5)
#: Output ranges, peak [V].
_OUTPUT_RANGES = {"UHF": (0.15, 1.5), "HF2": (0.01, 0.1, 1.0, 10.0)}
#: Channel of the output mixer that the first oscillator drives without the option MF;
#: with it, it is the first channel (see `zhinst.utils.default_output_mixer_channel`).
_MIXER_CHANNEL = {"UHF": 3, "HF2": 6}
#: Oscillators, and as many demodulators and mixer channels, with the option MF.
_OSCILLATORS = {"UHF": 8, "HF2": 6}
#: Prefix of the address of a device behind the data server of HF2 instruments.
_HF2 = "hf2:"
#: Longest wait for the read-back of an auxiliary output, time between queries [s], and
#: its tolerance [V].
_FOLLOWS, _POLL, _NEAR = 1.0, 0.01, 0.05
#: Sample rate of the demodulators in 1 / time constant [1].
_RATE = 10.0
_FINER_BELOW = 0.2
#: Fraction of the input range that counts as an overload, and a full converter.
_FULL, _CONVERTER = 0.99, 127
#: Largest relative difference of the read-back time constant [1].
_SAME_CONSTANT = 0.01

_Method = TypeVar("_Method", bound=Callable[..., Any])


def _explained(method: _Method) -> _Method:
    """Convert exceptions of the Zurich Instruments toolkit to InstrumentError."""

    @functools.wraps(method)
    def called(self: ZurichLockIn, *args: Any, **options: Any) -> Any:
        try:
            return method(self, *args, **options)
        except AmulorError:
            raise
        except Exception as error:  # the toolkit raises many kinds
            raise InstrumentError(
                f"{self.identity()} has failed to {method.__name__.replace('_', ' ')}: "
                f"{type(error).__name__}: {error}; check the data server and the cable"
            ) from error

    return cast(_Method, called)


class ZurichLockIn:
    """Lock-in UHFLI or HF2LI: first input and output, and one or more oscillators.

    Its demodulators output volts rms, with a phase that falls with delay. Several
    frequencies at once need the option MF: oscillator, demodulator and mixer channel n
    belong together. A record comes from the stream of the data server. It begins at
    the time of the instrument's clock at the request, however late the data arrive.
    """

    def __init__(
        self,
        device: Any,
        *,
        mean_output_input: int | None,
        modulation_amplitude: float,
        clock: Clock,
    ) -> None:
        self._device = device
        self._amplitude = modulation_amplitude
        self._mean_input = mean_output_input
        self._clock = clock
        self._range = len(INPUT_RANGES) - 1
        self._frequencies: tuple[float, ...] = ()
        self._full_scale = INPUT_RANGES[-1]

    @classmethod
    def connect(
        cls,
        address: str,
        *,
        mean_output_input: int | None,
        modulation_amplitude: float,
        clock: Clock,
    ) -> ZurichLockIn:
        """Connect to a device behind a LabOne data server."""
        hf2 = address.lower().startswith(_HF2)
        server, _, serial = address[len(_HF2) if hf2 else 0 :].partition(":")
        if not serial:
            raise InstrumentError(
                f"lock_in.address is {address!r}; needed is server:device, such as "
                "localhost:dev2006"
            )
        try:
            toolkit = importlib.import_module("zhinst.toolkit")
        except ImportError:
            raise MissingExtraError(
                "zhinst-toolkit", extra="zi", purpose="a lock-in of Zurich Instruments"
            ) from None
        try:
            # HF2 instruments have a data server of their own.
            session = (
                toolkit.Session(server, hf2=True) if hf2 else (toolkit.Session(server))
            )
            device = session.connect_device(serial)
        except Exception as error:  # the toolkit raises many kinds
            raise InstrumentError(
                f"{serial} cannot be reached through the data server {server}: {error}"
            ) from error
        return cls(
            device,
            mean_output_input=mean_output_input,
            modulation_amplitude=modulation_amplitude,
            clock=clock,
        )

    @property
    def _family(self) -> str:
        return str(self._device.device_type)[:3]

    def identity(self) -> str:
        """Return maker, model and serial number."""
        return f"Zurich Instruments,{self._device.device_type},{self._device.serial}"

    @_explained
    def prepare(self, *, time_constant: float) -> None:
        """Set internal reference, one-pole output filter and time constant [s]."""
        self._constant = time_constant
        self._subscribed = False
        self._set_range(len(INPUT_RANGES) - 1)
        self._demodulate(0)
        set_to = float(self._device.demods[0].timeconstant())
        if not abs(set_to / time_constant - 1) <= _SAME_CONSTANT:
            raise InstrumentError(
                f"{self.identity()} makes {set_to:g} s of a time constant of "
                f"{time_constant:g} s; state that in the survey"
            )
        self._drive(1)
        self._frequencies = (math.nan,)

    def _demodulate(self, place: int) -> None:
        """Configure a demodulator to use the oscillator of the same number."""
        demodulator = self._device.demods[place]
        demodulator.adcselect(0)
        demodulator.oscselect(place)
        demodulator.harmonic(1)
        demodulator.phaseshift(0.0)
        demodulator.order(1)
        demodulator.sinc(0)
        demodulator.timeconstant(self._constant)
        demodulator.rate(_RATE / self._constant)
        demodulator.enable(1)

    def _multiple(self) -> bool:
        return "MF" in str(self._device.features.options()).split()

    def _drive(self, count: int) -> None:
        """Output the first `count` oscillators, and switch the others off."""
        output, family = self._device.sigouts[0], self._family
        peak = math.sqrt(2) * self._amplitude
        ranges = _OUTPUT_RANGES.get(family, _OUTPUT_RANGES["UHF"])
        wide = [value for value in ranges if value >= count * peak]
        if not wide:
            raise InstrumentError(
                f"the modulation output ends at {ranges[-1]:g} V peak, stated is "
                f"{count * peak:.3g} V (lock_in.modulation_amplitude is the root mean "
                f"square of each of {count} frequencies)"
            )
        multiple = self._multiple()
        channel = 0 if multiple else _MIXER_CHANNEL.get(family, 0)
        output.on(0)
        if family != "HF2":
            output.imp50(1)
        output.offset(0.0)
        output.range(wide[0])
        level = peak / wide[0] if family == "HF2" else peak
        if multiple:
            for unused in range(count, _OSCILLATORS.get(family, 8)):
                output.enables[unused](0)
        for place in range(count):
            output.amplitudes[channel + place](level)
            output.enables[channel + place](1)
        output.on(1)

    @_explained
    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Set the modulation frequency [Hz]; return the actual one [Hz].

        The oscillator is the reference itself, so that there is no lock to wait for.
        """
        return self.set_frequencies([frequency], timeout=timeout)[0]

    @_explained
    def set_frequencies(
        self, frequencies: Sequence[float], *, timeout: float
    ) -> list[float]:
        """Modulate at several frequencies at once [Hz]; return the actual ones [Hz]."""
        count = len(frequencies)
        available = _OSCILLATORS.get(self._family, 8) if self._multiple() else 1
        if count > available:
            raise InstrumentError(
                f"{self.identity()} modulates by {available} frequencies at once, "
                f"asked for are {count}; lower procedure.frequencies_at_once"
                + ("" if available > 1 else ", or have the option MF installed")
            )
        if count != len(self._frequencies):
            for place in range(count):
                self._demodulate(place)
            for place in range(count, available):
                self._device.demods[place].enable(0)
            self._drive(count)
            self._subscribed = False  # further demodulators are in use now
        for place, frequency in enumerate(frequencies):
            self._device.oscs[place].freq(frequency)
        set_to = [float(self._device.oscs[place].freq()) for place in range(count)]
        self._frequencies = tuple(set_to)
        return set_to

    def read(self) -> Reading:
        """Return the present outputs, overload bits and lock state."""
        return self.read_all()[0]

    @_explained
    def read_all(self) -> list[Reading]:
        """Return the outputs of every frequency, overload bits and lock state."""
        overload = self._overload()
        readings = []
        for place in range(max(len(self._frequencies), 1)):
            sample = self._device.demods[place].sample()
            signal = complex(float(sample["x"][0]), -float(sample["y"][0]))
            mean = math.nan
            if self._mean_input is not None:
                mean = float(sample[f"auxin{self._mean_input - 1}"][0])
            reading = Reading(
                signal=math.sqrt(2) * signal,
                mean=mean,
                modulation_frequency=float(sample["frequency"][0]),
                overload=overload,
            )
            readings.append(reading)
        return readings

    @_explained
    def record(self, duration: float) -> Recorded:
        """Record the outputs for a time [s] from this call on."""
        nodes = [
            self._device.demods[place].sample for place in range(len(self._frequencies))
        ]
        if not self._subscribed:
            for node in nodes:
                node.subscribe()
            self._subscribed = True
        parts = streamed(
            self._device,
            nodes,
            duration=duration,
            interval=self._constant / _RATE,
            clock=self._clock,
        )
        mean = math.nan
        if self._mean_input is not None:
            mean = float(parts[0][f"auxin{self._mean_input - 1}"].mean())
        return Recorded(
            times=parts[0]["time"],
            signals=np.stack(
                [math.sqrt(2) * (part["x"] - 1j * part["y"]) for part in parts], axis=1
            ),
            mean=mean,
            modulation_frequencies=tuple(
                float(part["frequency"][-1]) for part in parts
            ),
            overload=self._overload(),
        )

    def _overload(self) -> Overload:
        if self._family == "HF2":
            status = self._device.status
            largest = max(abs(float(status.adc0max())), abs(float(status.adc0min())))
            reached = largest / _CONVERTER
        else:
            node = self._device.sigins[0]
            reached = max(abs(float(node.max())), abs(float(node.min())))
        return Overload.INPUT if reached >= _FULL else Overload.NONE

    def _set_range(self, number: int) -> None:
        self._range = number
        self._device.sigins[0].range(INPUT_RANGES[number])
        # The instrument selects an available range, which is read back.
        self._full_scale = float(self._device.sigins[0].range())

    @_explained
    def relieve(self, overload: Overload) -> bool:
        """Select the next larger input range; False if there is none."""
        if self._range == len(INPUT_RANGES) - 1:
            return False
        self._set_range(self._range + 1)
        return True

    @_explained
    def sharpen(self, amplitude: float) -> bool:
        """Select the next smaller range if the amplitude [V] allows it; else False."""
        if self._range == 0 or amplitude > _FINER_BELOW * self.full_scale():
            return False
        self._set_range(self._range - 1)
        return True

    def full_scale(self) -> float:
        """Return the full scale of the present setting, as a peak amplitude [V]."""
        return self._full_scale

    @_explained
    def set_output(self, number: int, voltage: float) -> float:
        """Set the voltage of auxiliary output 1, 2, ...; return its read-back [V]."""
        output = self._device.auxouts[number - 1]
        # The value first: manual mode must not output the previous one.
        output.offset(voltage)
        output.outputselect(-1)
        end = Deadline(self._clock, _FOLLOWS)
        while abs(float(output.value()) - voltage) > _NEAR and not end.passed():
            self._clock.sleep(_POLL)
        return float(output.value())

    def reconnect(self) -> None:
        """Do nothing: the link belongs to the data server."""

    @_explained
    def make_safe(self) -> None:
        """Switch the modulation output off."""
        self._device.sigouts[0].on(0)

    def close(self) -> None:
        """Do nothing: the link belongs to the data server."""
