"""Part of a devices file that says how a lock-in is spoken to by commands."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from amulor.acquisition.settings_parts import need
from amulor.survey.quantity import Description, Time, Voltage

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
