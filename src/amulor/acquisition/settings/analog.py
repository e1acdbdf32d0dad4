"""Part of a devices file that says how mirrors are turned by voltages."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from amulor.acquisition.settings.parts import need
from amulor.survey.quantity import Angle, Description, Time, Voltage

Volts = Annotated[Voltage, Field(ge=-100, le=100)]


class MirrorSettings(Description):
    """One mirror: its output, and angles of the beam that were measured."""

    output: Annotated[str, Field(min_length=1, max_length=100)]
    """Number of an auxiliary output of the lock-in, counted from 1; "Dev1/ao0" of
    nidaqmx; "DAC0" of labjack."""
    volts: Annotated[tuple[Volts, ...], Field(min_length=3)]
    """Voltages that the angle was measured at, rising; the scan stays between them
    [V]."""
    angles: tuple[Angle, ...]
    """Angle of the beam at each of them [rad]."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        need(len(self.volts) == len(self.angles), "an angle for each voltage")
        if any(b <= a for a, b in pairwise(self.volts)):
            raise ValueError("volts must rise")
        return self


class AnalogSettings(Description):
    """Two mirrors on analog outputs."""

    outputs: Literal["lock_in", "nidaqmx", "labjack"]
    """Whose outputs: the lock-in's own, a card of National Instruments, a LabJack T4 or
    T7 (ljm)."""
    azimuth: MirrorSettings
    """The one that turns the beam to the right."""
    elevation: MirrorSettings
    """The one that turns it upwards."""
    settling: Annotated[Time, Field(gt=0, le=10)]
    """How long a mirror takes to come to rest [s]."""
