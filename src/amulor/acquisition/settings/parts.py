"""What the parts of a devices file share: names of drivers, addresses, options."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from amulor.acquisition import plugins
from amulor.survey.quantity import Description, Time

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
