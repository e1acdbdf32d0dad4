"""Sections of the devices file: light, lock-in, analog channels, pan-tilt head."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from amulor.acquisition import plugins
from amulor.survey.quantity import Angle, Description, Position, Time, Voltage

Address = Annotated[str, Field(min_length=1, max_length=200)]
Axis = Annotated[str, Field(pattern=r"^[A-Za-z0-9_]{1,16}$")]
Patience = Annotated[Time, Field(gt=0, le=3600)]
#: Options of a device of another package.
Options = dict[str, Any] | None


def need(condition: bool, setting: str) -> None:
    """Raise if a required setting is missing."""
    if not condition:
        raise ValueError(f"{setting} is needed; state it")


def driver_check(part: str, *builtin: str) -> AfterValidator:
    """Return a validator of driver names, built-in or from installed packages."""

    def check(name: str) -> str:
        if name not in builtin and name not in (installed := plugins.names(part)):
            raise ValueError(
                f"there is no {part} {name!r}; there are "
                f"{', '.join([*builtin, *installed])}, and others by the "
                f"entry point {plugins.GROUPS[part]} of a package"
            )
        return name

    return AfterValidator(check)


class Linked(Description):
    """Base class of the sections of the devices file with an address."""

    address: Address | None = None
    """VISA resource name, such as "GPIB0::8::INSTR" or
    "TCPIP::10.0.0.5::50000::SOCKET"; "tcp://10.0.0.5:50000" for a socket without a VISA
    library; of Zurich Instruments "server:device", such as "localhost:dev2006"."""
    timeout: Patience = 5.0
    """Longest wait for one answer of the device [s]."""
    baud_rate: Annotated[int, Field(ge=50, le=10_000_000)] | None = None
    """Bits per second of a serial port; 9600 by default, as in VISA [1/s]."""
    flow_control: Literal["none", "xon_xoff", "rts_cts", "dtr_dsr"] | None = None
    """Flow control of a serial port; none by default, as in VISA."""

    lock: Literal[True] | None = None
    """Whether the scan locks the instrument over VXI-11 or HiSLIP; no lock by default.
    A locked instrument, with a VISA name such as "TCPIP::10.0.0.5::INSTR", accepts no
    commands from other programs on any computer."""

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
        serial_settings = [
            name
            for name in ("baud_rate", "flow_control")
            if getattr(self, name) is not None
        ]
        serial = self.address is not None and self.address.upper().startswith("ASRL")
        if serial_settings and not serial:
            raise ValueError(
                f"{serial_settings[0]} is that of a serial port, but the address is "
                f"{self.address!r}; take it out, or state a port such as ASRL3::INSTR"
            )
        return self


Volts = Annotated[Voltage, Field(ge=-100, le=100)]


class MirrorSettings(Description):
    """Scanner mirror: analog output, and beam angles measured at several voltages."""

    output: Annotated[str, Field(min_length=1, max_length=100)]
    """Name of the output: number of an auxiliary output of the lock-in, counted from 1;
    "Dev1/ao0" for nidaqmx; "DAC0" for labjack."""
    volts: Annotated[tuple[Volts, ...], Field(min_length=3)]
    """Voltages of the measured angles in ascending order; the scan stays within their
    range [V]."""
    angles: tuple[Angle, ...]
    """Angle of the beam at each voltage [rad]."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        need(len(self.volts) == len(self.angles), "an angle for each voltage")
        if any(b <= a for a, b in pairwise(self.volts)):
            raise ValueError("volts must rise")
        return self


class AnalogSettings(Description):
    """Two scanner mirrors on analog outputs."""

    outputs: Literal["lock_in", "nidaqmx", "labjack"]
    """Device of the outputs: the lock-in, a National Instruments card, or a LabJack T4
    or T7 (ljm)."""
    azimuth: MirrorSettings
    """Mirror that turns the beam to the right."""
    elevation: MirrorSettings
    """Mirror that turns the beam upwards."""
    settling: Annotated[Time, Field(gt=0, le=10)]
    """Settling time of a mirror [s]."""


LaserDriver = Annotated[
    str, driver_check("laser", "simulated", "lock_in_output", "scpi", "ophyd_async")
]
SourceDriver = Annotated[str, driver_check("source", "none", "scpi")]


NavigationDriver = Annotated[str, driver_check("navigation", "nmea")]


class PoseFrame(Description):
    """Reference system and clock of poses."""

    crs: str = ""
    """Coordinate reference system of the positions, such as "EPSG:32632"; needed by
    nmea, whose positions are projected."""
    crs_offset: Position = (0.0, 0.0, 0.0)
    """Offset of the local frame in the reference system (east, north, up) [m]."""
    clock: Literal["unix", "relative"] = "unix"
    """Origin of the time stamps: 1970-01-01 UTC, or unknown."""


class NavigationSettings(Linked, PoseFrame):
    """Source of the poses of the vehicle that carries the instrument."""

    driver: NavigationDriver = "nmea"
    """Driver: nmea (sentences of NMEA 0183), or a source of an installed package (entry
    point amulor.navigation)."""
    options: Options = None
    """Options of a source of another package."""

    @model_validator(mode="after")
    def _nmea_is_described(self) -> Self:
        if self.driver == "nmea":
            need(self.address is not None, "navigation.address")
            need(bool(self.crs), "navigation.crs")
            need(self.clock == "unix", 'navigation.clock = "unix"')
        return self


class ScpiLaserSettings(Description):
    """Commands of a laser driver, sent unchanged."""

    on: tuple[str, ...] = ("OUTP ON",)
    """Commands that switch the laser on."""
    off: tuple[str, ...] = ("OUTP OFF",)
    """Commands that switch the laser off."""
    state: str = "OUTP?"
    """Query of the state of the laser."""
    is_off: str = "0"
    """Answer to the query `state` when the laser is off."""
    interlock: str | None = None
    """Query of the interlock, sent before light and at every sample; optional."""
    interlock_closed: str = "1"
    """Answer to the query `interlock` when the interlock is closed."""
    current: str | None = None
    """Query of the diode current at every sample; no query by default [A]."""
    temperature: str | None = None
    """Query of the diode temperature at every sample; no query by default [degC]."""
    prepare: tuple[str, ...] | None = None
    """Commands before the laser is switched on, such as "SOUR:CURR 0.08"."""
    error: str | None = None
    """Query of errors after the laser was switched on; no query by default."""
    no_error: str | None = None
    """Start of the answer to the query `error` when there is no error; "0" by
    default."""
    lock: str | None = None
    """Query that locks the instrument, sent first, such as "SYST:LOCK:REQ?"; no lock by
    default."""
    lock_granted: str | None = None
    """Answer if the lock is granted; "1" by default."""
    unlock: str | None = None
    """Command that releases the lock, such as "SYST:LOCK:REL"."""


class ScpiSourceSettings(Description):
    """Commands of a signal generator; `{value}` is the number in SI units."""

    prepare: tuple[str, ...] = ()
    """Commands at the start, such as "FUNC SIN"."""
    amplitude: str = "VOLT {value:.6g}"
    """Command that sets the root mean square of the output [V]."""
    frequency: str = "FREQ {value:.10g}"
    """Command that sets the frequency [Hz]."""
    frequency_read: str = "FREQ?"
    """Query of the output frequency [Hz]."""
    on: tuple[str, ...] = ("OUTP ON",)
    """Commands that switch the output on."""
    off: tuple[str, ...] = ("OUTP OFF",)
    """Commands that switch the output off."""
    error: str | None = "SYST:ERR?"
    """Query of errors after settings; no query by default."""
    no_error: str = "+0"
    """Start of the answer to the query `error` when there is no error."""
    lock: str | None = None
    """Query that locks the instrument, sent first, such as "SYST:LOCK:REQ?"; no lock by
    default."""
    lock_granted: str | None = None
    """Answer if the lock is granted; "1" by default."""
    unlock: str | None = None
    """Command that releases the lock, such as "SYST:LOCK:REL"."""


class SourceSettings(Linked):
    """Modulation source that replaces the oscillator of the lock-in."""

    driver: SourceDriver = "none"
    """Driver: none (the lock-in modulates), scpi (commands in `scpi`), or a source of
    an installed package (entry point amulor.sources)."""
    options: Options = None
    """Options of a source of another package."""
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
    """Settings of the laser, or of the shutter in front of it."""

    driver: LaserDriver = "simulated"
    """Driver: simulated, lock_in_output (an auxiliary output of the lock-in is wired to
    the enable input of the laser), scpi (commands in `scpi`), ophyd_async (parts in
    `options`), or a laser of an installed package (entry point amulor.lasers)."""
    options: Options = None
    """Options of a laser of another package."""
    scpi: ScpiLaserSettings | None = None
    """Commands of a laser driver; needed by "scpi"."""
    output: Annotated[int, Field(ge=1, le=4)] = 1
    """Number of the auxiliary output, counted from 1 [1]."""
    on_voltage: Annotated[Voltage, Field(gt=0, le=10)] = 5.0
    """Voltage that switches the laser on; 0 V switches it off [V]."""
    interlock_input: Annotated[int, Field(ge=1, le=4)] | None = None
    """Auxiliary input of an SR844 or SR865A that the interlock monitor is wired to; no
    monitor by default [1]. It is read in every sample with light."""
    interlock_voltage: Annotated[Voltage, Field(gt=0, le=10)] = 2.0
    """Least voltage at `interlock_input` while the interlock is closed [V]."""
    warm_up: Annotated[Time, Field(ge=0, le=3600)] = 0.0
    """Wait after the laser was switched on [s]."""

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
    driver_check(
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
    """Commands of a lock-in; {value} is a number in SI units, {code} a list index.

    Each query has one line as its answer, with numbers separated by commas.
    """

    prepare: tuple[str, ...] = ("*RST",)
    """Commands before a scan: reference, one-pole filter, coupling."""
    time_constant: str
    """Command of the time constant, such as "OFLT {code}" or "TC {value:.6g}"."""
    time_constants: tuple[Annotated[Time, Field(gt=0)], ...] = ()
    """Time constants in the order of their codes, if {code} is used [s]."""
    frequency: str = "FREQ {value:.10g}"
    """Command of the modulation frequency, not sent with an external reference [Hz]."""
    frequency_read: str = "FREQ?"
    """Query of the detected frequency [Hz]."""
    read: str
    """Query of X and Y at one moment, such as "SNAP? 0,1"."""
    counts: Literal["rms", "peak"] = "rms"
    """Whether X and Y are rms or peak values."""
    phase: Literal["falls", "rises"] = "falls"
    """Whether the measured phase falls or rises with delay; it falls in most
    instruments."""
    mean: str | None = None
    """Query of the mean output of the detector, if an input is wired to it [V]."""
    status: str | None = None
    """Query of the status bits, which latch until they are read."""
    input_overload: Bits = 0
    """Status bits that report an input overload [1]."""
    output_overload: Bits = 0
    """Status bits that report an output beyond the full scale [1]."""
    unlocked: Bits = 0
    """Status bits that report a lost reference [1]."""
    scale: str | None = None
    """Command of the scale, such as "SCAL {code}"; a fixed scale by default."""
    scales: Annotated[tuple[Annotated[Voltage, Field(gt=0)], ...], Field(min_length=1)]
    """Full scales in the order of their codes, rms or peak as set by `counts` [V]."""
    output: str | None = None
    """Command of an auxiliary output, such as "AUXV {code},{value:.3f}"."""
    output_read: str | None = None
    """Query of an auxiliary output, such as "AUXV? {code}"."""
    first_output: Annotated[int, Field(ge=0, le=1)] = 1
    """Code of the output that is labeled 1 on the panel [1]."""
    error: str | None = None
    """Query of errors after settings."""
    no_error: str = "0"
    """Start of the answer to the query `error` when there is no error."""

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
    """Settings of the lock-in amplifier: driver, address and ranges."""

    driver: LockInDriver = "simulated"
    """Driver: simulated, sr844, sr865a, zurich, digitiser (see the part `digitiser`),
    scpi (commands in `scpi`), pymeasure (attributes in `options`), ophyd_async (parts
    in `options`), or a lock-in of an installed package (entry point
    amulor.lock_ins)."""
    scpi: ScpiLockInSettings | None = None
    """Commands of a lock-in; needed by "scpi"."""
    options: Options = None
    """Options of a lock-in of another package."""
    mean_output_input: Annotated[int, Field(ge=1, le=4)] | None = None
    """Auxiliary input that the mean output of the detector is wired to [1]."""
    modulation_amplitude: Annotated[Voltage, Field(gt=0, le=2)] | None = None
    """Root mean square of the modulation output, which drives the laser; needed by
    sr865a and zurich [V]."""
    input_range: Annotated[Voltage, Field(gt=0)] | None = None
    """Initial peak input range of an sr865a: 1 V (default), 300, 100, 30 or 10 mV [V].
    It increases after an overload."""
    lock_timeout: Patience = 10.0
    """Longest wait for lock of the reference [s]."""
    reference: Literal["external"] | None = None
    """Reference of the lock-in, by default its own oscillator; "external" selects the
    section `source`."""

    @model_validator(mode="after")
    def _address_is_stated(self) -> Self:
        wired = self.driver in ("sr844", "sr865a", "zurich", "scpi")
        need(self.address is not None or not wired, "lock_in.address")
        need(self.scpi is not None or self.driver != "scpi", "lock_in.scpi")
        need(bool(self.options) or self.driver != "ophyd_async", "lock_in.options")
        return self

    @model_validator(mode="after")
    def _amplitude_is_stated(self) -> Self:
        settable = self.driver in ("sr865a", "zurich")
        has_amplitude = self.modulation_amplitude is not None
        if settable and not has_amplitude:
            raise ValueError(
                "lock_in.modulation_amplitude is needed: what the modulation input of "
                'the laser takes, such as "0.5 V"'
            )
        if has_amplitude and not settable and self.driver in _INPUTS:
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
        if not any(math.isclose(self.input_range, value) for value in _INPUT_RANGES):
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
    """Digitizer of the detector signal, for lock_in.driver = "digitiser"."""

    driver: Annotated[str, driver_check("digitiser", "none")] = "none"
    """Driver: none, or a digitizer of an installed package (entry point
    amulor.digitisers)."""
    options: Options = None
    """Options of the digitizer."""


class PanTiltSettings(Description):
    """Pan-tilt head with the Pelco-D protocol: number, directions and limits."""

    number: Annotated[int, Field(ge=1, le=255)] = 1
    """Number of the head, which is its address on the line [1]."""
    pan_counts: Literal["right", "left"] = "right"
    """Direction of increasing pan; right, clockwise from above, for an upright head."""
    tilt_counts: Literal["down", "up"] = "down"
    """Direction of increasing tilt."""
    lowest_pan: Angle | None = None
    """Least azimuth of the head; not checked by default [rad]."""
    highest_pan: Angle | None = None
    """Largest azimuth of the head; not checked by default [rad]."""
    lowest_tilt: Angle | None = None
    """Least elevation of the head; not checked by default [rad]."""
    highest_tilt: Angle | None = None
    """Largest elevation of the head; not checked by default [rad]."""

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
                raise ValueError(
                    f"lowest_{name} ({math.degrees(low):g} deg) must be less than "
                    f"highest_{name} ({math.degrees(high):g} deg)"
                )
        return self
