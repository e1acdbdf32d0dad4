"""The error budget of a range image: all terms, their sum, and what is not known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from amulor.cube.terms import RANGE_PREFIX
from amulor.imaging.calibration import CALIBRATION_TERMS, calibration_terms
from amulor.imaging.late_light import late_light
from amulor.imaging.ranges import Ranges
from amulor.survey import Survey

Floats = NDArray[np.float64]


def completed(
    one: xr.Dataset, ranges: Ranges, *, survey: Survey | None
) -> tuple[Ranges, dict[str, Any]]:
    """Return ranges with late light taken off and all terms that are known.

    Parameters
    ----------
    one : xarray.Dataset
        Level `target_signal`, one channel.
    ranges : Ranges
        What the phases say.
    survey : Survey or None
        Its water and its calibration count.

    Returns
    -------
    ranges : Ranges
        With more terms, which all pixels share.
    attributes : dict
        What the image says of late light, of the calibration, and which terms nobody
        knows.
    """
    seen = np.where(ranges.usable, ranges.slant_range, np.nan)
    light = late_light(one, seen, survey=survey, weight=ranges.weight)
    shared = calibration_terms(one, ranges.path, ranges.slope, survey=survey)
    unknown = [name for name in CALIBRATION_TERMS if name not in shared]
    others = dict(ranges.others)
    if light.uncertainty is None:
        unknown.insert(0, "late_echo")
    elif light.note == "taken off":
        shared["late_echo"] = light.uncertainty
        others["slant_range_late_echo"] = light.late
    attributes: dict[str, Any] = {
        "late_echo_correction": light.note,
        "uncertainty_unknown": " ".join(unknown),
    }
    calibration = None if survey is None else survey.calibration
    if calibration is not None and calibration.date is not None:
        attributes["delay_calibrated"] = calibration.date.isoformat()
    common = ranges.common
    if shared:
        squares = [term**2 for term in shared.values()]
        if common is not None:
            squares.append(common**2)
        common = np.sqrt(np.sum(squares, axis=0))
    return (
        replace(
            ranges,
            slant_range=ranges.slant_range - light.late,
            terms={**ranges.terms, **shared},
            common=common,
            others=others,
        ),
        attributes,
    )


def uncertainties(ranges: Ranges) -> dict[str, Floats]:
    """Return the variables of an image that hold its uncertainty.

    Parameters
    ----------
    ranges : Ranges
        Slant ranges with all terms.

    Returns
    -------
    dict of str to ndarray
        The combined standard uncertainty, the part that pixels share, and one variable
        for each term; the squares of the terms add up to that of the combined one [m].
    """
    squares = [term**2 for term in ranges.terms.values()]
    found = {
        "slant_range_uncertainty": (
            next(iter(ranges.terms.values()))
            if len(squares) == 1
            else np.sqrt(np.sum(squares, axis=0))
        )
    }
    if ranges.common is not None:
        found["slant_range_common_uncertainty"] = ranges.common
    return found | {
        f"{RANGE_PREFIX}{name}": term for name, term in ranges.terms.items()
    }
