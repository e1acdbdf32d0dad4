"""Parts of a devices file that say what makes light: laser, modulation source."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, model_validator

from amulor.acquisition.settings.parts import Linked, Options, known, need
from amulor.survey.quantity import Description, Time, Voltage

LaserDriver = Annotated[
    str, known("laser", "simulated", "lock_in_output", "scpi", "ophyd_async")
]
SourceDriver = Annotated[str, known("source", "none", "scpi")]


class ScpiLaserSettings(Description):
    """Commands of a laser driver; `{}` in a question is not replaced by anything."""

    on: tuple[str, ...] = ("OUTP ON",)
    """Sent one after the other to let light out."""
    off: tuple[str, ...] = ("OUTP OFF",)
    """Sent one after the other to let none out."""
    state: str = "OUTP?"
    """Asked to read back whether light is out."""
    is_off: str = "0"
    """What the answer is when none is."""
    interlock: str | None = None
    """Asked before light is let out and at every sample; left out if there is none."""
    interlock_closed: str = "1"
    """What the answer is while the interlock is closed."""
    current: str | None = None
    """Asked in every sample for the current of the diode [A]; not if left out."""
    temperature: str | None = None
    """Asked in every sample for the temperature of the diode [degC]; or not."""
    prepare: tuple[str, ...] | None = None
    """Sent once, before light is let out, such as "SOUR:CURR 0.08"."""
    error: str | None = None
    """Asked after light was let out; left out if the driver knows no such question."""
    no_error: str | None = None
    """What the answer begins with if there is none; "0" if left out."""
    lock: str | None = None
    """Asked first, for the right to drive it, such as "SYST:LOCK:REQ?"; not if left
    out."""
    lock_granted: str | None = None
    """What the answer is if that is given; "1" if left out."""
    unlock: str | None = None
    """Sent at the end, such as "SYST:LOCK:REL"."""


class ScpiSourceSettings(Description):
    """Commands of a signal generator; `{value}` stands for the number, in SI units."""

    prepare: tuple[str, ...] = ()
    """Sent once, such as "FUNC SIN"."""
    amplitude: str = "VOLT {value:.6g}"
    """Sets the root mean square of the output [V]."""
    frequency: str = "FREQ {value:.10g}"
    """Sets the frequency [Hz]."""
    frequency_read: str = "FREQ?"
    """Asked for the frequency that is put out [Hz]."""
    on: tuple[str, ...] = ("OUTP ON",)
    """Sent one after the other to put it out."""
    off: tuple[str, ...] = ("OUTP OFF",)
    """Sent one after the other to put nothing out."""
    error: str | None = "SYST:ERR?"
    """Asked after settings; left out if the generator knows no such question."""
    no_error: str = "+0"
    """What the answer begins with if there is none."""
    lock: str | None = None
    """Asked first, for the right to drive it, such as "SYST:LOCK:REQ?"; not if left
    out."""
    lock_granted: str | None = None
    """What the answer is if that is given; "1" if left out."""
    unlock: str | None = None
    """Sent at the end, such as "SYST:LOCK:REL"."""


class SourceSettings(Linked):
    """What modulates the laser, if the lock-in does not."""

    driver: SourceDriver = "none"
    """"none": the lock-in; "scpi": commands, stated in `scpi`; or the name of one that
    an installed package offers (entry point amulor.sources)."""
    options: Options = None
    """What a source of another package wants to be told."""
    amplitude: Annotated[Voltage, Field(gt=0, le=10)] | None = None
    """Root mean square of the output; needed by "scpi" [V]."""
    scpi: ScpiSourceSettings = ScpiSourceSettings()
    """Commands of a generator."""
    settling: Annotated[Time, Field(ge=0, le=60)] = 0.0
    """Wait after a change of frequency [s]."""

    @model_validator(mode="after")
    def _all_is_stated(self) -> Self:
        if self.driver == "scpi":
            need(self.address is not None, "source.address")
            need(self.amplitude is not None, "source.amplitude")
        return self


class LaserSettings(Linked):
    """What lets light out."""

    driver: LaserDriver = "simulated"
    """"lock_in_output": an auxiliary output of the lock-in is wired to the enable input
    of the laser; "scpi": commands, stated in `scpi`; "ophyd_async": parts, stated in
    `options`; or the name of one that an installed package offers (entry point
    amulor.lasers)."""
    options: Options = None
    """What a laser of another package wants to be told."""
    scpi: ScpiLaserSettings | None = None
    """Commands of a laser driver; needed by "scpi"."""
    output: Annotated[int, Field(ge=1, le=4)] = 1
    """Which auxiliary output [1]."""
    on_voltage: Annotated[Voltage, Field(gt=0, le=10)] = 5.0
    """Voltage that lets light out; 0 V lets none out [V]."""
    interlock_input: Annotated[int, Field(ge=1, le=4)] | None = None
    """Auxiliary input of an SR844 or SR865A that the interlock's monitor is wired to,
    looked at in every sample with light; none if left out [1]."""
    interlock_voltage: Annotated[Voltage, Field(gt=0, le=10)] = 2.0
    """Least voltage there while the interlock is closed [V]."""
    warm_up: Annotated[Time, Field(ge=0, le=3600)] = 0.0
    """Wait after it was switched on [s]."""

    @model_validator(mode="after")
    def _commands_are_stated(self) -> Self:
        if self.driver == "scpi":
            need(self.address is not None, "laser.address")
            need(self.scpi is not None, "laser.scpi")
        need(bool(self.options) or self.driver != "ophyd_async", "laser.options")
        return self
