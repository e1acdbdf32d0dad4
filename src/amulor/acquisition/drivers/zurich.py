"""UHFLI of Zurich Instruments through zhinst-toolkit; tested against a contract only.

No instrument and no simulator of one stood behind the tests: they check that these
nodes are set and read as the manual names them, and nothing more. An HF2LI has a data
server of its own, another mixer channel and amplitudes that are fractions of the output
range; that is in here, its input ranges are not.
"""

from __future__ import annotations

import importlib
import math
from typing import Any

from amulor.acquisition.clock import Clock, Deadline
from amulor.acquisition.protocols import Overload, Reading
from amulor.errors import InstrumentError, MissingExtraError

#: Input ranges, peak [V].
INPUT_RANGES = (0.01, 0.03, 0.1, 0.3, 1.0, 1.5)
#: Output ranges, peak [V].
_OUTPUT_RANGES = {"UHF": (0.15, 1.5), "HF2": (0.01, 0.1, 1.0, 10.0)}
#: Channel of the output mixer that the first oscillator drives, without the option MF;
#: with it, it is the first one (as `zhinst.utils.default_output_mixer_channel` says).
_MIXER_CHANNEL = {"UHF": 3, "HF2": 6}
#: What an address of a device behind the data server of HF2 instruments begins with.
_HF2 = "hf2:"
#: How long what an auxiliary output puts out may take to be reported, in steps [s], and
#: how near it must come [V].
_FOLLOWS, _POLL, _NEAR = 1.0, 0.01, 0.05
#: Readings per time constant that the instrument is asked to make.
_RATE = 10.0
_FINER_BELOW = 0.2
#: Fraction of the input range that counts as an overload.
_FULL = 0.99


class ZurichLockIn:
    """The first input, oscillator, demodulator and output of a UHFLI.

    Parameters
    ----------
    device : object
        A connected device of zhinst-toolkit.
    mean_output_input : int or None
        Auxiliary input, counted from 1, that the mean output of the detector is wired
        to.
    modulation_amplitude : float
        Root mean square of the modulation output, into 50 ohm [V].
    clock : Clock
        What waits go by.

    Notes
    -----
    Its demodulators count in volts rms, and their phase falls with delay.
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

    @classmethod
    def connect(
        cls,
        address: str,
        *,
        mean_output_input: int | None,
        modulation_amplitude: float,
        clock: Clock,
    ) -> ZurichLockIn:
        """Connect to a device behind a LabOne data server.

        Parameters
        ----------
        address : str
            "server:device", such as "localhost:dev2006"; of an HF2LI
            "hf2:server:device".
        mean_output_input : int or None
            As for the class.
        modulation_amplitude : float
            As for the class [V].
        clock : Clock
            As for the class.

        Returns
        -------
        ZurichLockIn
            Connected.

        Raises
        ------
        MissingExtraError
            If zhinst-toolkit is not installed.
        InstrumentError
            If the device cannot be reached.
        """
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

    def identity(self) -> str:
        """Return maker, kind and serial number."""
        return f"Zurich Instruments,{self._device.device_type},{self._device.serial}"

    def prepare(self, *, time_constant: float) -> None:
        """Set internal reference, one-pole output filter and time constant [s]."""
        self._range = len(INPUT_RANGES) - 1
        demodulator = self._device.demods[0]
        demodulator.adcselect(0)
        demodulator.oscselect(0)
        demodulator.harmonic(1)
        demodulator.phaseshift(0.0)
        demodulator.order(1)
        demodulator.sinc(0)
        demodulator.timeconstant(time_constant)
        demodulator.rate(_RATE / time_constant)
        demodulator.enable(1)
        self._device.sigins[0].range(INPUT_RANGES[self._range])
        self._drive()

    def _drive(self) -> None:
        """Let the modulation out: one oscillator at the stated level, nothing else."""
        output = self._device.sigouts[0]
        family = str(self._device.device_type)[:3]
        peak = math.sqrt(2) * self._amplitude
        ranges = _OUTPUT_RANGES.get(family, _OUTPUT_RANGES["UHF"])
        wide = [value for value in ranges if value >= peak]
        if not wide:
            raise InstrumentError(
                f"the modulation output ends at {ranges[-1]:g} V peak, stated is "
                f"{peak:.3g} V (lock_in.modulation_amplitude is its root mean square)"
            )
        multiple = "MF" in str(self._device.features.options()).split()
        channel = 0 if multiple else _MIXER_CHANNEL.get(family, 0)
        output.on(0)
        if family != "HF2":
            output.imp50(1)
        output.offset(0.0)
        output.range(wide[0])
        if multiple:
            for other in range(1, 8):
                output.enables[other](0)
        level = peak / wide[0] if family == "HF2" else peak
        output.amplitudes[channel](level)
        output.enables[channel](1)
        output.on(1)

    def set_frequency(self, frequency: float, *, timeout: float) -> float:
        """Set the modulation frequency [Hz] and return what is set [Hz].

        The oscillator is the reference itself: there is nothing to lock to.
        """
        self._device.oscs[0].freq(frequency)
        return float(self._device.oscs[0].freq())

    def read(self) -> Reading:
        """Return the outputs and the state of this instant."""
        sample = self._device.demods[0].sample()
        signal = complex(float(sample["x"][0]), -float(sample["y"][0]))
        reached = max(
            abs(float(self._device.sigins[0].max())),
            abs(float(self._device.sigins[0].min())),
        )
        mean = math.nan
        if self._mean_input is not None:
            mean = float(sample[f"auxin{self._mean_input - 1}"][0])
        return Reading(
            signal=math.sqrt(2) * signal,
            mean=mean,
            modulation_frequency=float(sample["frequency"][0]),
            overload=Overload.INPUT if reached >= _FULL else Overload.NONE,
        )

    def relieve(self, overload: Overload) -> bool:
        """Take the next larger input range, if there is one."""
        if self._range == len(INPUT_RANGES) - 1:
            return False
        self._range += 1
        self._device.sigins[0].range(INPUT_RANGES[self._range])
        return True

    def sharpen(self, amplitude: float) -> bool:
        """Take the next smaller input range if this peak amplitude [V] leaves room."""
        if self._range == 0 or amplitude > _FINER_BELOW * self.full_scale():
            return False
        self._range -= 1
        self._device.sigins[0].range(INPUT_RANGES[self._range])
        return True

    def full_scale(self) -> float:
        """Return the largest peak amplitude of the present setting [V]."""
        return INPUT_RANGES[self._range]

    def set_output(self, number: int, voltage: float) -> float:
        """Set an auxiliary output, counted from 1 [V]; return what is read back [V]."""
        output = self._device.auxouts[number - 1]
        # The value first: manual mode must not put out what stood there before.
        output.offset(voltage)
        output.outputselect(-1)
        end = Deadline(self._clock, _FOLLOWS)
        while abs(float(output.value()) - voltage) > _NEAR and not end.passed():
            self._clock.sleep(_POLL)
        return float(output.value())

    def reconnect(self) -> None:
        """Do nothing: the data server holds the link."""

    def make_safe(self) -> None:
        """Switch the modulation output off."""
        self._device.sigouts[0].on(0)

    def close(self) -> None:
        """Do nothing: the data server holds the link."""
