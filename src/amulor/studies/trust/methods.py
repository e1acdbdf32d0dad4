"""The rejection methods as a user calls them, up to the range image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import xarray as xr

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor.errors import AmulorError
from amulor.studies.trust.case import Case

Run = Callable[[Case], xr.Dataset]


#: From a case to a target signal.
METHODS: dict[str, Run] = {
    "open-water": lambda case: rejection.open_water(
        case.samples, interval=case.interval
    ),
    "open-water 20 %": lambda case: rejection.open_water(
        case.samples, interval=case.interval, column_uncertainty=0.2
    ),
    "frequency": lambda case: rejection.frequency(case.samples, interval=case.interval),
    "polarization": lambda case: rejection.unmix(case.samples),
    "combined": lambda case: rejection.combined(case.samples, interval=case.interval),
    "joint": lambda case: rejection.joint(case.samples, interval=case.interval),
    "joint, no shots": lambda case: rejection.joint(
        cubes.without_groups(case.samples, "open_water"), interval=case.interval
    ),
    "auto": lambda case: rejection.auto(case.samples, interval=case.interval),
}


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a method made of a case: the two files that a user has, or a refusal."""

    target: xr.Dataset | None
    """Target signal."""
    image: xr.Dataset | None
    """Range image of its first channel."""
    note: str
    """Method that `auto` took, or why there is no image."""


def outcome(method: str, case: Case) -> Outcome:
    """Run a method and make the range image.

    Parameters
    ----------
    method : str
        Of `METHODS`.
    case : Case
        What is measured.

    Returns
    -------
    Outcome
        A refusal is an outcome; a crash is one as well, and says so.
    """
    try:
        target = METHODS[method](case)
        image = imaging.range_image(
            target,
            polarization=str(target["polarization"].values[0]),
            interval=case.interval,
        )
        image = imaging.flag_outliers(imaging.flag_mixed(image))
    except (AmulorError, ValueError) as error:
        return Outcome(target=None, image=None, note=f"refused: {error}")
    except (ArithmeticError, SystemError) as error:
        return Outcome(target=None, image=None, note=f"CRASH: {error!r}")
    note = str(target.attrs.get("rejection_method", "")) if method == "auto" else ""
    return Outcome(target=target, image=image, note=note)
