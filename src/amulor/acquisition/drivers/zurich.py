"""UHFLI of Zurich Instruments through zhinst-toolkit; tested against a contract only.

No instrument and no simulator of one stood behind the tests: they check that these
nodes are set and read as the manual names them, and nothing more. An HF2LI, whose nodes
and input ranges may differ, was not looked at.
"""

from __future__ import annotations

import importlib
import math
from typing import Any

from amulor.acquisition.clock import Clock
from amulor.acquisition.protocols import Overload, Reading
from amulor.errors import InstrumentError, MissingExtraError

#: Input ranges, peak [V].
INPUT_RANGES = (0.01, 0.03, 0.1, 0.3, 1.0, 1.5)
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
    clock : Clock
        What waits go by.

    Notes
    -----
    Its demodulators count in volts rms, and their phase falls with delay.
    """

    def __init__(
        self, device: Any, *, mean_output_input: int | None, clock: Clock
    ) -> None:
        self._device = device
        self._mean_input = mean_output_input
        self._clock = clock
        self._range = len(INPUT_RANGES) - 1

    @classmethod
    def connect(
        cls, address: str, *, mean_output_input: int | None, clock: Clock
    ) -> ZurichLockIn:
        """Connect to a device behind a LabOne data server.

        Parameters
        ----------
        address : str
            "server:device", such as "localhost:dev2006".
        mean_output_input : int or None
            As for the class.
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
        server, _, serial = address.partition(":")
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
            device = toolkit.Session(server).connect_device(serial)
        except Exception as error:  # the toolkit raises many kinds
            raise InstrumentError(
                f"{serial} cannot be reached through the data server {server}: {error}"
            ) from error
        return cls(device, mean_output_input=mean_output_input, clock=clock)

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
        self._device.sigouts[0].on(1)

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
        output.outputselect(-1)
        output.offset(voltage)
        return float(output.offset())

    def reconnect(self) -> None:
        """Do nothing: the data server holds the link."""

    def make_safe(self) -> None:
        """Switch the modulation output off."""
        self._device.sigouts[0].on(0)

    def close(self) -> None:
        """Do nothing: the data server holds the link."""
