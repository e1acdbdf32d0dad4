"""Parts of a devices file that say what measures, and how it is spoken to."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from amulor.acquisition.settings.parts import Linked, Options, Patience, known, need
from amulor.survey.quantity import Description, Time, Voltage

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
