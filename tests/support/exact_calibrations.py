"""Calibrations with numbers that differ in each frequency and channel."""

from __future__ import annotations

import xarray as xr
from exact_samples import samples

from amulor.acquisition import Calibration
from amulor.acquisition.cube.calibration import (
    ChannelResponse,
    DemodulatorOutputs,
    FrequencyCalibration,
    Leakage,
    ReferencePhase,
    TemperatureCoefficient,
)
from amulor.survey import Survey

PAIRS = ("VV", "VH")
FREQUENCIES = (20e6, 50e6)


def table(*phases: float, errors: tuple[float, ...] = (), frequency: float = 20e6):
    """Return phases at 1 mV, 10 mV and so on."""
    return FrequencyCalibration(
        modulation_frequency=frequency,
        amplitudes=tuple(10.0 ** (k - 3) for k in range(len(phases))),
        phases=phases,
        phase_uncertainties=errors,
    )


def each(kind, **values):
    """Return an entry of each frequency and channel from four values of a field."""
    return tuple(
        kind(
            modulation_frequency=frequency,
            polarization=pair,
            **{name: row[2 * i + j] for name, row in values.items()},
        )
        for i, frequency in enumerate(FREQUENCIES)
        for j, pair in enumerate(PAIRS)
    )


LEAKAGE = each(
    Leakage,
    scan=[(1.0, 2.0), (3.0, 4.0), (5.0, 6.0), (7.0, 8.0)],
    scan_uncertainty=[0.1, 0.2, 0.4, 0.3],
    open_water=[(-1.0, 0.0), (-2.0, 0.0), (-3.0, 0.0), (-4.0, 1.0)],
    open_water_uncertainty=[1.1, 1.2, 1.4, 1.3],
)


OUTPUTS = tuple(
    DemodulatorOutputs(
        modulation_frequency=frequency,
        offset=offset,
        offset_uncertainty=0.1 * (k + 1),
        quadrature_gain=gain,
        quadrature_gain_uncertainty=of_gain,
        quadrature_phase=angle,
        quadrature_phase_uncertainty=of_angle,
    )
    for k, (frequency, offset, gain, of_gain, angle, of_angle) in enumerate(
        [
            (20e6, (0.5, -0.25), 0.25, 0.01, 0.3, 0.02),
            (50e6, (0.0, 1.0), -0.5, None, -0.2, None),
        ]
    )
)


CHANNELS = each(
    ChannelResponse,
    gain=[(1.0, 0.0), (0.0, 2.0), (1.0, 0.0), (0.5, -0.5)],
    gain_uncertainty=[0.01, 0.03, 0.05, 0.02],
    crosstalk=[0.1, -0.2, 0.3, 0.05],
    crosstalk_uncertainty=[0.001, 0.004, 0.003, 0.002],
)


REFERENCE = each(
    ReferencePhase, phase=[0.1, 0.2, -3.0, 0.4], uncertainty=[0.01, 0.02, 0.03, 0.01]
)


TEMPERATURE = tuple(
    TemperatureCoefficient(
        modulation_frequency=frequency,
        phase_per_degree=slope,
        uncertainty=error,
        temperatures=temperatures,
        phases=(0.0, 0.1),
    )
    for frequency, slope, error, temperatures in (
        (20e6, 0.03, 0.001, (12.0, 23.0)), (50e6, -0.02, 0.004, (13.0, 21.0))
    )
)  # fmt: skip
DEGREES = Calibration(temperature=TEMPERATURE, reference_temperature=20.0)


def with_temperature(small: Survey, **scan: object) -> xr.Dataset:
    survey = small.with_({f"scan.{name}": value for name, value in scan.items()})
    return samples(0.0, survey=survey.to_toml())
