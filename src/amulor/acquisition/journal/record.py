"""Recorded quantities of a sample, with a table of their units and ranges.

The columns of the journal, the checks of its rows, the documents of the event model and
the variables of the cube follow from the annotations of `Record`. A new quantity is one
more line there, and the driver that measures it.
"""

from __future__ import annotations

import math
from dataclasses import MISSING, dataclass, fields
from typing import Annotated, get_args, get_type_hints

import numpy as np

#: Limits of voltages [V] and of directions [rad].
_VOLT, _TURN = 1e6, 2 * math.pi


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Unit, range and cube variable of a recorded quantity."""

    text: str
    """Long name of the quantity."""
    unit: str
    """Unit; "1" for a dimensionless quantity."""
    within: tuple[float, float]
    """Smallest and largest possible value, both included."""
    cube: str | None = None
    """Name of its variable in the cube, without `user_`; None without a variable. An
    optional quantity is left out of the cube where no sample has it."""
    per_pixel: bool = False
    """Whether the cube stores the mean over the channels of a pixel."""
    kind: type[np.generic] = np.float64
    """Data type in the cube."""
    absent: float = math.nan
    """Value in the cube where there is no sample."""


def _volt(text: str, *, least: float = -_VOLT, cube: str | None = None) -> Quantity:
    return Quantity(text=text, unit="V", within=(least, _VOLT), cube=cube)


def _direction(text: str, *, cube: str | None = None) -> Quantity:
    return Quantity(
        text=text, unit="rad", within=(-_TURN, _TURN), cube=cube, per_pixel=True
    )


def _mount(text: str, *, cube: str) -> Quantity:
    return Quantity(text=text, unit="rad", within=(-1e3, 1e3), cube=cube)


@dataclass(frozen=True, kw_only=True)
class Record:
    """Quantities of one sample; None for a quantity that no device measures."""

    in_phase: Annotated[float, _volt("in-phase part, mean of the readings")]
    quadrature: Annotated[float, _volt("quadrature, mean of the readings")]
    mean: Annotated[
        float | None, _volt("mean output of the detector", cube="mean_output")
    ]
    readings: Annotated[
        int,
        Quantity(text="number of readings", unit="1", within=(1, 2**31), absent=1),
    ]
    full_scale: Annotated[
        float,
        _volt("largest peak amplitude of the setting", least=1e-15, cube="full_scale"),
    ]
    flags: Annotated[
        int,
        Quantity(
            text="sum of `SampleFlag`", unit="1", within=(0, 2**15 - 1),
            kind=np.int16, absent=0,
        ),
    ]  # fmt: skip
    commanded_azimuth: Annotated[
        float,
        _direction("commanded direction, to the right", cube="commanded_azimuth"),
    ]
    commanded_elevation: Annotated[
        float, _direction("commanded direction, upwards", cube="commanded_elevation")
    ]
    azimuth: Annotated[float, _direction("direction read back, to the right")]
    elevation: Annotated[float, _direction("direction read back, upwards")]
    modulation_frequency: Annotated[
        float,
        Quantity(
            text="frequency read back, of each sample", unit="Hz",
            within=(1e-6, 1e15), cube="modulation_frequency",
        ),
    ]  # fmt: skip
    elapsed: Annotated[
        float,
        Quantity(
            text="time since the scan began, by its clock", unit="s", within=(0, 1e10)
        ),
    ]
    segment: Annotated[
        int,
        Quantity(
            text="uninterrupted part of the scan, 0 where not measured", unit="1",
            within=(1, 2**31), cube="segment", kind=np.int32, absent=0,
        ),
    ]  # fmt: skip
    launch: Annotated[
        float | None,
        _mount("angle of the mount in the launched light", cube="launch_angle"),
    ] = None
    analyser: Annotated[
        float | None,
        _mount("angle of the mount in front of the detector", cube="analyser_angle"),
    ] = None
    target: Annotated[
        float | None,
        Quantity(
            text="where the stage of the target stood", unit="m", within=(-1e4, 1e4),
            cube="target_position",
        ),
    ] = None  # fmt: skip
    begin: Annotated[
        float | None,
        Quantity(
            text="start of the integration window, by the clock of the scan",
            unit="s", within=(0, 1e10),
        ),
    ] = None  # fmt: skip
    duration: Annotated[
        float | None,
        Quantity(text="length of the integration window", unit="s", within=(0, 1e6)),
    ] = None
    interval: Annotated[
        float | None,
        Quantity(
            text="time between readings by the clock of the lock-in", unit="s",
            within=(1e-12, 1e6),
        ),
    ] = None  # fmt: skip
    spread: Annotated[
        float | None,
        _volt("standard deviation of either output, from the record itself", least=0),
    ] = None
    edge: Annotated[
        float | None,
        _volt("standard deviation of either output by edges of the scene", least=0),
    ] = None
    laser_current: Annotated[
        float | None,
        Quantity(
            text="current of the laser diode", unit="A", within=(-1e4, 1e4),
            cube="laser_current",
        ),
    ] = None  # fmt: skip
    laser_temperature: Annotated[
        float | None,
        Quantity(
            text="temperature of the laser diode", unit="degC",
            within=(-273.15, 1e4), cube="laser_temperature",
        ),
    ] = None  # fmt: skip


_HINTS = get_type_hints(Record, include_extras=True)
#: Every recorded quantity by its name, in the order of the journal.
QUANTITIES: dict[str, Quantity] = {
    field.name: get_args(_HINTS[field.name])[1] for field in fields(Record)
}
#: Quantities that may be None.
OPTIONAL = frozenset(
    name for name in QUANTITIES if type(None) in get_args(get_args(_HINTS[name])[0])
)
#: Quantities that are whole numbers.
WHOLE = frozenset(name for name in QUANTITIES if get_args(_HINTS[name])[0] is int)
#: Quantities that not every instrument has.
EXTRA = tuple(field.name for field in fields(Record) if field.default is not MISSING)
