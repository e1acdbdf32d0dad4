"""Rejection methods of the trust study, from samples to the range image."""

from __future__ import annotations

from dataclasses import dataclass

import xarray as xr

from amulor import pipeline, rejection
from amulor.errors import AmulorError
from amulor.studies.trust.case import Case

#: Method and options of each row of the table that is not the plain method.
VARIANTS: dict[str, tuple[str, dict[str, float]]] = {
    "open-water 20 %": ("open-water", {"column_uncertainty": 0.2}),
    "joint, no shots": ("joint without shots", {}),
}
#: Rows of the table, in its order.
METHODS = (
    "open-water",
    "open-water 20 %",
    "frequency",
    "polarization",
    "combined",
    "joint",
    "joint, no shots",
    "auto",
)


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Result of a method on a test case: target signal and range image, or refusal."""

    target: xr.Dataset | None
    """Target signal."""
    image: xr.Dataset | None
    """Range image of its first channel."""
    note: str
    """Method chosen by `auto`, or the reason for a missing image."""


def outcome(method: str, case: Case) -> Outcome:
    """Reject the water of a test case by a method, and compute the range image."""
    try:
        name, options = VARIANTS.get(method, (method, {}))
        target = rejection.reject(
            case.samples, method=name, interval=case.interval, **options
        )
        image = pipeline.run(
            target,
            polarization=str(target["polarization"].values[0]),
            interval=case.interval,
        )
    except (AmulorError, ValueError) as error:
        note = f"refused: {' '.join(str(error).split())}"
        return Outcome(target=None, image=None, note=note)
    except (ArithmeticError, SystemError) as error:
        return Outcome(target=None, image=None, note=f"CRASH: {error!r}")
    note = str(target.attrs.get("rejection_method", "")) if method == "auto" else ""
    return Outcome(target=target, image=image, note=note)
