"""Directions of pixels and open-water references; refusal of scans beyond memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.survey.survey import Survey

__all__ = ["MOST_SAMPLES", "refuse_scans_beyond_memory", "samples_of"]


#: Samples of one cube: 6 GB at the widest step of processing.
MOST_SAMPLES = 10_000_000


def samples_of(survey: Survey) -> int:
    """Return the number of samples of a scan [1]."""
    instrument = survey.instrument
    channels = len(instrument.modulation_frequencies) * len(instrument.polarizations)
    return survey.scan.rows * survey.scan.columns * channels


def refuse_scans_beyond_memory(survey: Survey) -> None:
    """Raise if a scan is too large for the memory."""
    samples = samples_of(survey)
    if samples > MOST_SAMPLES:
        scan = survey.scan
        raise SurveyError(
            f"the scan has {samples:.3g} samples ({scan.columns} x {scan.rows} pixels, "
            f"{samples // (scan.columns * scan.rows)} samples each), at most "
            f"{MOST_SAMPLES:.0e} fit into memory here (600 bytes each); `amulor "
            "simulate` works by rows; elsewhere split it into several surveys"
        )


Floats = NDArray[np.float64]
#: Which rows or columns of a scan.
Which = slice | NDArray[np.intp]


def scan_directions(
    survey: Survey, *, rows: Which = slice(None), columns: Which = slice(None)
) -> tuple[Floats, Floats, Floats]:
    """Return azimuth, elevation [rad] and start time [s] of every pixel."""
    scan = survey.scan
    if isinstance(rows, slice) and rows == columns == slice(None):
        refuse_scans_beyond_memory(survey)
    across, down = _lines(survey, scan.rows, scan.columns)
    azimuth, elevation = np.meshgrid(across[columns], down[rows])
    row = np.arange(scan.rows)[rows][:, None]
    place = np.arange(scan.columns)[columns]
    if scan.order == "serpentine":
        place = np.where(row % 2 == 1, scan.columns - 1 - place, place)
    time = (row * scan.columns + place) * scan.dwell * readings_in_turn(survey)
    return azimuth, elevation, time.astype(float)


def readings_in_turn(survey: Survey) -> int:
    """Return the number of readings of a pixel that follow one another [1]."""
    if survey.platform is not None and survey.platform.readings == "at-once":
        return 1
    instrument = survey.instrument
    return len(instrument.modulation_frequencies) * len(instrument.polarizations)


def reading_windows(survey: Survey) -> tuple[Floats, float]:
    """Return middle and length of the integration windows of a pixel's readings [s].

    Middles count from the start of the pixel, shape (frequency, polarization). The
    frequencies of a channel follow one another, then those of the next channel.
    """
    instrument, dwell = survey.instrument, survey.scan.dwell
    # Outputs after five time constants, each a mean over about one before it.
    length = dwell - 4 * instrument.lock_in.time_constant
    shape = len(instrument.polarizations), len(instrument.modulation_frequencies)
    number = np.arange(shape[0] * shape[1], dtype=float).reshape(shape).T
    if readings_in_turn(survey) == 1:
        number = np.zeros_like(number)
    return (number + 1) * dwell - length / 2, length


def open_water_directions(survey: Survey) -> tuple[Floats, Floats]:
    """Return azimuth and elevation [rad] of every open-water reference."""
    plan = survey.scan.open_water
    if plan is None:
        raise SurveyError(
            "scan.open_water: is missing; state columns, rows and repeats of the "
            "open-water shots"
        )
    azimuth, elevation = np.meshgrid(*_lines(survey, plan.rows, plan.columns))
    return (
        np.repeat(azimuth.ravel(), plan.repeats),
        np.repeat(elevation.ravel(), plan.repeats),
    )


def _lines(survey: Survey, rows: int, columns: int) -> tuple[Floats, Floats]:
    """Return the azimuth of each column and the elevation of each row [rad]."""
    scan = survey.scan
    # One row or column alone stands in the middle.
    across = np.linspace(-0.5, 0.5, columns) if columns > 1 else np.zeros(1)
    down = np.linspace(0.5, -0.5, rows) if rows > 1 else np.zeros(1)
    return (
        scan.azimuth + across * scan.azimuth_span,
        scan.elevation + down * scan.elevation_span,
    )
