"""Calibration uncertainties of instrument delay, geometry and water index."""

from __future__ import annotations

import datetime
from typing import Annotated, Self

from pydantic import Field, model_validator

from amulor.survey.quantity import (
    Angle,
    Description,
    Fraction,
    Length,
    Temperature,
    Time,
)


class Calibration(Description):
    """Standard uncertainties from a calibration; omitted values are unknown.

    Examples
    --------
    >>> from amulor.survey import Calibration
    >>> known = Calibration(date="2026-05-01", delay_uncertainty="0.02 ns")
    >>> print(known.date, f"{known.delay_uncertainty:.0e} s")
    2026-05-01 2e-11 s
    """

    date: datetime.date | None = None
    """Day on which the delay was measured, such as 2026-05-01."""
    delay_uncertainty: Annotated[Time, Field(ge=0, le=1e-6)] | None = None
    """Standard uncertainty of the instrument's delay, common to all channels and
    frequencies; 0.1 ns is 11 mm [s]. The value applies to the time of the scan. If
    delay_growth or delay_per_degree is stated, the value applies to the time of the
    calibration."""
    delay_growth: Annotated[Time, Field(ge=0, le=1e-8)] | None = None
    """Standard uncertainty of the change of the delay per day [s]. The uncertainty
    grows in proportion to the number of days. This field needs `date` and a cube with
    the time of the measurement."""
    delay_per_degree: Annotated[Time, Field(ge=0, le=1e-8)] | None = None
    """Largest change of the delay per degree of the instrument's temperature; needs
    instrument_temperature_uncertainty [s]."""
    instrument_temperature_uncertainty: (
        Annotated[Temperature, Field(ge=0, le=60)] | None
    ) = None
    """Standard uncertainty of the difference between the instrument's temperatures in
    scan and calibration [degC]."""
    receiver_position_uncertainty: Annotated[Length, Field(ge=0, le=0.5)] | None = None
    """Standard uncertainty of each coordinate of the receiver relative to the emitter
    [m]."""
    direction_uncertainty: Annotated[Angle, Field(ge=0, le=0.5)] | None = None
    """Standard uncertainty of azimuth and elevation of the beams, relative to the line
    from emitter to receiver; the error is common to all beams [rad]."""
    group_index_uncertainty: Annotated[float, Field(ge=0, le=0.1)] | None = None
    """Standard uncertainty of the group index [1]. Alternatively, state the
    uncertainties of temperature and salinity."""
    temperature_uncertainty: Annotated[Temperature, Field(ge=0, le=30)] | None = None
    """Standard uncertainty of the temperature of the water, for the group index [degC].
    Without a stated temperature, amulor uses the range of 0 to 30 degC."""
    salinity_uncertainty: Annotated[float, Field(ge=0, le=43)] | None = None
    """Standard uncertainty of the practical salinity of the water [1]. Without a stated
    salinity, amulor uses the range of 0 to 40."""
    scattering_uncertainty: Annotated[Fraction, Field(ge=0, le=2)] | None = None
    """Relative standard uncertainty of the scattering coefficient, used for the delay
    of the echo by scattering [1]."""

    @model_validator(mode="after")
    def _states_the_index_once(self) -> Self:
        indirect = (self.temperature_uncertainty, self.salinity_uncertainty)
        if self.group_index_uncertainty is not None and any(
            value is not None for value in indirect
        ):
            raise ValueError(
                "the uncertainty of the group index is stated twice; give either "
                "group_index_uncertainty, or temperature_uncertainty and "
                "salinity_uncertainty"
            )
        return self

    @model_validator(mode="after")
    def _dates_what_ages(self) -> Self:
        if self.date is not None and self.delay_uncertainty is None:
            raise ValueError(
                "date is that of the delay, but delay_uncertainty is missing; state "
                'it, such as "0.1 ns", or leave out the date'
            )
        return self

    @model_validator(mode="after")
    def _states_what_a_change_needs(self) -> Self:
        if self.delay_growth is not None and self.date is None:
            raise ValueError(
                "delay_growth counts days since the calibration, but date is missing; "
                "state it, such as 2026-05-01"
            )
        per_degree = self.delay_per_degree is not None
        if per_degree != (self.instrument_temperature_uncertainty is not None):
            raise ValueError(
                "delay_per_degree and instrument_temperature_uncertainty belong "
                'together; state both, such as "2 ps" and "5 degC", or neither'
            )
        if per_degree and self.delay_uncertainty is None:
            raise ValueError(
                "delay_per_degree adds to delay_uncertainty, which is missing; state "
                'it, such as "0.1 ns"'
            )
        return self
