"""Parts of the devices file: light, lock-in, analog channels, pan-tilt head."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from amulor.acquisition import plugins
from amulor.survey.quantity import Angle, Description, Time, Voltage

Address = Annotated[str, Field(min_length=1, max_length=200)]
Axis = Annotated[str, Field(pattern=r"^[A-Za-z0-9_]{1,16}$")]
Patience = Annotated[Time, Field(gt=0, le=3600)]
#: What a device of another package wants to be told.
Options = dict[str, Any] | None


def need(there: bool, what: str) -> None:
    """Raise unless something is there."""
    if not there:
        raise ValueError(f"{what} is needed; state it")


def known(part: str, *own: str) -> AfterValidator:
    """Return what refuses drivers that are neither ours nor of an installed package."""

    def check(name: str) -> str:
        if name not in own and name not in (others := plugins.names(part)):
            raise ValueError(
                f"there is no {part} {name!r}; there are {', '.join([*own, *others])}, "
                f"and others by the entry point {plugins.GROUPS[part]} of a package"
            )
        return name

    return AfterValidator(check)


class Linked(Description):
    """A part that is reached at an address."""

    address: Address | None = None
    """VISA resource name, such as "GPIB0::8::INSTR" or
    "TCPIP::10.0.0.5::50000::SOCKET"; "tcp://10.0.0.5:50000" for a socket without a VISA
    library; of Zurich Instruments "server:device", such as "localhost:dev2006"."""
    timeout: Patience = 5.0
    """How long one answer may take [s]."""
    baud_rate: Annotated[int, Field(ge=50, le=10_000_000)] | None = None
    """Bits per second of a serial port; what the VISA library takes, 9600, if left
    out [1/s]."""
    flow_control: Literal["none", "xon_xoff", "rts_cts", "dtr_dsr"] | None = None
    """Flow control of a serial port; what the VISA library takes, none, if left out."""

    lock: Literal[True] | None = None
    """true: the lock of the instrument itself is taken over VXI-11 or HiSLIP (VISA
    names such as "TCPIP::10.0.0.5::INSTR"), so that no program on any computer can
    drive it meanwhile, nor switch it off; nobody else is kept out if left out."""

    @model_validator(mode="after")
    def _only_these_links_have_locks(self) -> Self:
        address = "" if self.address is None else self.address.upper()
        if self.lock and not (
            address.startswith("TCPIP") and address.endswith("::INSTR")
        ):
            raise ValueError(
                f"lock needs VXI-11 or HiSLIP, but the address is {self.address!r}; "
                "take it out, or state a name such as TCPIP::10.0.0.5::INSTR"
            )
        return self

    @model_validator(mode="after")
    def _only_serial_ports_have_it(self) -> Self:
        stated = [
            name
            for name in ("baud_rate", "flow_control")
            if getattr(self, name) is not None
        ]
        serial = self.address is not None and self.address.upper().startswith("ASRL")
        if stated and not serial:
            raise ValueError(
                f"{stated[0]} is that of a serial port, but the address is "
                f"{self.address!r}; take it out, or state a port such as ASRL3::INSTR"
            )
        return self


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


#: Auxiliary inputs of each lock-in, counted from 1.
_INPUTS = {"simulated": 4, "sr844": 2, "sr865a": 4, "zurich": 2, "digitiser": 0}
#: Input ranges of an SR865A, peak [V].
_INPUT_RANGES = (1.0, 0.3, 0.1, 0.03, 0.01)
LockInDriver = Annotated[
    str,
    known(
        "lock_in",
        "simulated",
        "sr844",
        "sr865a",
        "zurich",
        "digitiser",
        "scpi",
        "pymeasure",
        "ophyd_async",
    ),
]
Bits = Annotated[int, Field(ge=0, lt=2**32)]


class ScpiLockInSettings(Description):
    """Commands of a lock-in; {value} is a number in SI units, {code} a place in a list.

    Questions are answered by one line each, numbers separated by commas.
    """

    prepare: tuple[str, ...] = ("*RST",)
    """Sent one after the other before a scan: reference, one-pole filter, coupling."""
    time_constant: str
    """Sets the time constant, such as "OFLT {code}" or "TC {value:.6g}"."""
    time_constants: tuple[Annotated[Time, Field(gt=0)], ...] = ()
    """Time constants by their code, if {code} is used [s]."""
    frequency: str = "FREQ {value:.10g}"
    """Sets the modulation frequency [Hz]; not sent if the reference is external."""
    frequency_read: str = "FREQ?"
    """Asked for the frequency that is detected [Hz]."""
    read: str
    """Asked for X and Y of one moment, such as "SNAP? 0,1"."""
    counts: Literal["rms", "peak"] = "rms"
    """What X and Y are in."""
    phase: Literal["falls", "rises"] = "falls"
    """How the phase goes with delay; it falls in most instruments."""
    mean: str | None = None
    """Asked for the mean output of the detector, if that is wired [V]."""
    status: str | None = None
    """Asked for a number of status bits that hold until they are asked for."""
    input_overload: Bits = 0
    """Bits of it that say that the input overloads [1]."""
    output_overload: Bits = 0
    """Bits of it that say that an output is beyond the scale [1]."""
    unlocked: Bits = 0
    """Bits of it that say that the reference is lost [1]."""
    scale: str | None = None
    """Sets the scale, such as "SCAL {code}"; the scale stays if left out."""
    scales: Annotated[tuple[Annotated[Voltage, Field(gt=0)], ...], Field(min_length=1)]
    """Full scales by their code, as the instrument counts them [V]."""
    output: str | None = None
    """Sets an auxiliary output, such as "AUXV {code},{value:.3f}", for the laser."""
    output_read: str | None = None
    """Asked for the voltage that it is set to, such as "AUXV? {code}"."""
    first_output: Annotated[int, Field(ge=0, le=1)] = 1
    """Code of the output that the panel counts as 1 [1]."""
    error: str | None = None
    """Asked after settings."""
    no_error: str = "0"
    """What the answer begins with if there is none."""

    @model_validator(mode="after")
    def _belongs_together(self) -> Self:
        need("{code}" not in self.time_constant or self.time_constants != (),
             "lock_in.scpi.time_constants")  # fmt: skip
        need((self.output is None) == (self.output_read is None),
             "both or none of lock_in.scpi.output and output_read")  # fmt: skip
        some = self.input_overload | self.output_overload | self.unlocked
        need(some == 0 or self.status is not None, "lock_in.scpi.status")
        return self


class LockInSettings(Linked):
    """The lock-in amplifier."""

    driver: LockInDriver = "simulated"
    """Which instrument it is: simulated, sr844, sr865a, zurich, digitiser (the one that
    the part `digitiser` names), scpi (commands, stated in `scpi`), pymeasure
    (attributes) and ophyd_async (parts), both stated in `options`, or the name of one
    that an installed package offers (entry point amulor.lock_ins)."""
    scpi: ScpiLockInSettings | None = None
    """Commands of a lock-in; needed by "scpi"."""
    options: Options = None
    """What a lock-in of another package wants to be told."""
    mean_output_input: Annotated[int, Field(ge=1, le=4)] | None = None
    """Auxiliary input that the mean output of the detector is wired to [1]."""
    modulation_amplitude: Annotated[Voltage, Field(gt=0, le=2)] | None = None
    """Root mean square of the modulation output, which drives the laser; needed where
    it can be set (sr865a, zurich) [V]."""
    input_range: Annotated[Voltage, Field(gt=0)] | None = None
    """Largest peak voltage at the input of an sr865a that a scan begins with, 1 V, 300,
    100, 30 or 10 mV; a wider one is taken when it overloads; 1 V if left out [V]."""
    lock_timeout: Patience = 10.0
    """How long the reference may take to lock [s]."""
    reference: Literal["external"] | None = None
    """"external": the frequency comes from the part `source`; of its own oscillator if
    left out."""

    @model_validator(mode="after")
    def _address_is_stated(self) -> Self:
        own = self.driver in ("sr844", "sr865a", "zurich", "scpi")
        need(self.address is not None or not own, "lock_in.address")
        need(self.scpi is not None or self.driver != "scpi", "lock_in.scpi")
        need(bool(self.options) or self.driver != "ophyd_async", "lock_in.options")
        return self

    @model_validator(mode="after")
    def _amplitude_is_stated(self) -> Self:
        settable = self.driver in ("sr865a", "zurich")
        stated = self.modulation_amplitude is not None
        if settable and not stated:
            raise ValueError(
                "lock_in.modulation_amplitude is needed: what the modulation input of "
                'the laser takes, such as "0.5 V"'
            )
        if stated and not settable and self.driver in _INPUTS:
            raise ValueError(
                f"the driver {self.driver!r} cannot set lock_in.modulation_amplitude; "
                "take it out"
            )
        return self

    @model_validator(mode="after")
    def _range_is_one_of_it(self) -> Self:
        if self.input_range is None:
            return self
        if self.driver != "sr865a":
            raise ValueError(
                f"the driver {self.driver!r} cannot set lock_in.input_range; take it "
                "out"
            )
        if not any(math.isclose(self.input_range, own) for own in _INPUT_RANGES):
            raise ValueError(
                f"lock_in.input_range is {self.input_range:g} V, an SR865A has 1 V, "
                "300 mV, 100 mV, 30 mV and 10 mV; state one of them"
            )
        return self

    @model_validator(mode="after")
    def _input_is_there(self) -> Self:
        last = _INPUTS.get(self.driver, 4)
        if self.mean_output_input is not None and self.mean_output_input > last == 0:
            raise ValueError(
                f"the driver {self.driver!r} has no auxiliary inputs; take "
                "lock_in.mean_output_input out"
            )
        if self.mean_output_input is not None and self.mean_output_input > last:
            raise ValueError(
                f"the driver {self.driver!r} has auxiliary inputs 1 to {last}, stated "
                f"is mean_output_input = {self.mean_output_input}; wire another one"
            )
        return self


class DigitiserSettings(Linked):
    """What records the detector directly; lock_in.driver is "digitiser" then."""

    driver: Annotated[str, known("digitiser", "none")] = "none"
    """Name of one that an installed package offers (entry point amulor.digitisers)."""
    options: Options = None
    """What it wants to be told."""


class PanTiltSettings(Description):
    """A pan-tilt head that speaks Pelco-D."""

    number: Annotated[int, Field(ge=1, le=255)] = 1
    """Number that is set in the head (its address on the line) [1]."""
    pan_counts: Literal["right", "left"] = "right"
    """Where the pan position grows to; clockwise from above, that is to the right, in
    heads that stand."""
    tilt_counts: Literal["down", "up"] = "down"
    """Where the tilt position grows to."""
    lowest_pan: Angle | None = None
    """Least azimuth that the head goes to; not checked if left out [rad]."""
    highest_pan: Angle | None = None
    """Largest azimuth that the head goes to; not checked if left out [rad]."""
    lowest_tilt: Angle | None = None
    """Least elevation that the head goes to; not checked if left out [rad]."""
    highest_tilt: Angle | None = None
    """Largest elevation that the head goes to; not checked if left out [rad]."""

    @model_validator(mode="after")
    def _ends_belong_together(self) -> Self:
        for name in ("pan", "tilt"):
            low, high = (
                getattr(self, f"{end}_{name}") for end in ("lowest", "highest")
            )
            need(
                (low is None) == (high is None),
                f"both or none of scanner.pan_tilt.lowest_{name} and highest_{name}",
            )
            if low is not None and not low < high:
                raise ValueError(f"lowest_{name} must be less than highest_{name}")
        return self
