"""The terms of the error budget of a slant range: names, meaning, type."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, kw_only=True)
class Term:
    """One source of error of a slant range, in the words of the GUM."""

    name: str
    """Name in variables and reports."""
    meaning: str
    """What it is, in a few words."""
    kind: Literal["A", "B", "A, B"]
    """How its standard uncertainty is found: A from the scatter of measurements, B
    from other knowledge."""


#: All terms, in the order of reports.
TERMS = {
    term.name: term
    for term in (
        Term(name="counting", meaning="noise of the samples", kind="A"),
        Term(
            name="fluctuation",
            meaning="random change of the water signal from sample to sample",
            kind="A",
        ),
        Term(
            name="reference",
            meaning="open-water shots: their noise, fit and interpolation",
            kind="A",
        ),
        Term(
            name="drift",
            meaning="change of the water signal between shots and scan",
            kind="B",
        ),
        Term(name="column", meaning="water column behind the target", kind="B"),
        Term(
            name="water_model",
            meaning="strength and shape of the water signal's model",
            kind="A, B",
        ),
        Term(
            name="polarization_optics",
            meaning="depolarization ratios, polarizers",
            kind="B",
        ),
        Term(
            name="signal",
            meaning="errors of the target signal that are not divided into terms",
            kind="A, B",
        ),
        Term(
            name="late_echo",
            meaning="light scattered on its way, after its estimate is taken off",
            kind="B",
        ),
        Term(name="delay", meaning="delay of the instrument itself", kind="B"),
        Term(name="group_index", meaning="group index of the water", kind="B"),
        Term(
            name="geometry",
            meaning="place of the receiver, direction of the beams",
            kind="B",
        ),
    )
}
#: Terms that a rejection method may put into its target signal.
SIGNAL_TERMS = (
    "counting",
    "fluctuation",
    "reference",
    "drift",
    "column",
    "water_model",
    "polarization_optics",
)
#: Those of them that the pixels of a scan share. Water that may change, in a
#: combination of channels, is a matter of each sample.
SHARED_TERMS = ("reference", "drift", "column", "polarization_optics")
#: Terms that move all pixels of an image the same way.
ALIKE_TERMS = ("late_echo", "delay", "group_index", "geometry")
#: Terms in proportion to the water, the same part of it at all pixels.
WATER_TERMS = ("drift", "column")
#: Start of the names of variables that hold one term.
RANGE_PREFIX, PHASE_PREFIX = "slant_range_uncertainty_", "phase_uncertainty_"
