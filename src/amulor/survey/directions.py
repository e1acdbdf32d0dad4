"""Directions of a scan: where each pixel and each open-water shot is, and when."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulor.errors import SurveyError
from amulor.survey.survey import Survey

Floats = NDArray[np.float64]


def scan_directions(survey: Survey) -> tuple[Floats, Floats, Floats]:
    """Return azimuth, elevation [rad] and start time [s] of every pixel.

    Parameters
    ----------
    survey : Survey
        Its scan counts.

    Returns
    -------
    tuple of three ndarrays, shape (rows, columns)
        The first row is the upper one, the first column the left one.
    """
    scan = survey.scan
    azimuth, elevation = _grid(survey, scan.rows, scan.columns)
    number = np.arange(scan.rows * scan.columns).reshape(scan.rows, scan.columns)
    if scan.order == "serpentine":
        number[1::2] = number[1::2, ::-1].copy()
    channels = len(survey.instrument.modulation_frequencies) * len(
        survey.instrument.polarizations
    )
    return azimuth, elevation, (number * scan.dwell * channels).astype(float)


def open_water_directions(survey: Survey) -> tuple[Floats, Floats]:
    """Return azimuth and elevation [rad] of every open-water shot.

    Parameters
    ----------
    survey : Survey
        Its open-water plan must be there.

    Returns
    -------
    tuple of two ndarrays, shape (shots,)
        Directions, each as often as it is repeated.

    Raises
    ------
    SurveyError
        If the survey plans no open-water shots.
    """
    plan = survey.scan.open_water
    if plan is None:
        raise SurveyError(
            "scan.open_water: is missing; state columns, rows and repeats of the "
            "open-water shots"
        )
    azimuth, elevation = _grid(survey, plan.rows, plan.columns)
    return (
        np.repeat(azimuth.ravel(), plan.repeats),
        np.repeat(elevation.ravel(), plan.repeats),
    )


def _grid(survey: Survey, rows: int, columns: int) -> tuple[Floats, Floats]:
    scan = survey.scan
    # One row or column alone stands in the middle.
    across = np.linspace(-0.5, 0.5, columns) if columns > 1 else np.zeros(1)
    down = np.linspace(0.5, -0.5, rows) if rows > 1 else np.zeros(1)
    azimuth, elevation = np.meshgrid(
        scan.azimuth + across * scan.azimuth_span,
        scan.elevation + down * scan.elevation_span,
    )
    return azimuth, elevation
