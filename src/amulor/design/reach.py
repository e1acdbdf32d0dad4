"""How far an instrument reaches in waters that go by name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amulor.design.evaluate import TERMS, evaluate
from amulor.survey import Survey, water_properties

__all__ = ["WATERS", "Reach", "reach"]

_JERLOV = {
    "kind": "jerlov",
    "source": "williamson-hollins-2022",
    "salinity": 35.0,
}
#: Waters that go by name: what each is called, and how a survey states it.
WATERS: dict[str, tuple[str, dict[str, Any]]] = {
    "pure": ("pure sea water", {"kind": "pure", "salinity": 35.0}),
    **{
        kind: (
            f"Jerlov {kind}, {'coast' if kind.endswith('C') else 'open ocean'}",
            {**_JERLOV, "type": kind},
        )
        for kind in ("IB", "II", "III", "1C", "3C", "5C")
    },
}
#: Distances that are looked at, evenly in their logarithm [m].
_NEAREST, _FARTHEST, _STEPS = 0.3, 60.0, 160


@dataclass(frozen=True, kw_only=True)
class Reach:
    """How far an accuracy is met in one water."""

    water: str
    """What the water is called."""
    attenuation: float
    """Its attenuation coefficient at the wavelength of the instrument [1/m]."""
    nearest: float | None
    """Nearest slant range of the longest stretch over which the accuracy is met; None
    where it is met nowhere [m]."""
    farthest: float | None
    """Farthest one, infinite where it is still met at 60 m [m]."""
    binding: str
    """What ends it: the largest term there, or "model" where the model ends."""
    repetition: float
    """Slant range after which the phases repeat [m]."""


def reach(
    survey: Survey,
    *,
    accuracy: float,
    water: str,
    reflectance: float | None = None,
    method: str = "open-water",
) -> Reach:
    """Return how far an instrument meets an accuracy in a water.

    Parameters
    ----------
    survey : Survey
        The instrument; its target sends light back.
    accuracy : float
        Total error of one pixel that is allowed [m].
    water : str
        One of `WATERS`.
    reflectance : float, optional
        Reflectance of the target; that of the survey by default [1].
    method : str
        How the water is taken out, by the names of `evaluate`.

    Returns
    -------
    Reach
        From 160 distances between 0.3 and 60 m. The ambiguity interval is taken as
        known; where the phases repeat is stated beside it.
    """
    title, stated = WATERS[water]
    # A survey's own far wall is not part of another water.
    there = survey.with_({"water": stated})
    distance = np.geomspace(_NEAREST, _FARTHEST, _STEPS)
    axes: dict[str, Any] = {} if reflectance is None else {"reflectance": reflectance}
    found = evaluate(there, distance=distance, method=method, **axes)
    outside = found["model_not_valid"].values.astype(bool)
    bad = outside | found["saturated"].values.astype(bool)
    bad |= ~(found["total_error"].values <= accuracy)
    begin, end = _longest(~bad)
    if begin == end:
        binding = "model" if outside.all() else _largest(found, int(np.argmin(outside)))
    elif end == _STEPS:
        binding = ""
    else:
        binding = "model" if outside[end] else _largest(found, end)
    return Reach(
        water=title,
        attenuation=float(water_properties(there).attenuation),
        nearest=float(distance[begin]) if end > begin else None,
        farthest=None
        if begin == end
        else float("inf")
        if end == _STEPS
        else float(distance[end - 1]),
        binding=binding,
        repetition=float(found["ambiguity_interval"].values.flat[0]),
    )


def _longest(good: NDArray[np.bool_]) -> tuple[int, int]:
    """Return begin and end of the longest run, counted as equal ratios of distance."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
    if not len(edges):
        return 0, 0
    begins, ends = edges[::2], edges[1::2]
    at = int(np.argmax(ends - begins))
    return int(begins[at]), int(ends[at])


def _largest(found: Any, number: int) -> str:
    """Return the largest term at one distance, besides the interval."""
    if found["saturated"].values[number]:
        return "saturation"
    sizes = {
        name: float(found[name].values[number])
        for name in TERMS
        if name not in ("ambiguity", "saturation")
    }
    return max(sizes, key=lambda name: sizes[name]).replace("_", " ")
