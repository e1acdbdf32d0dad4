"""Phase drifts of figures 10(d) and 12 for several kinds of milk, tank and plate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from amulor.studies.ricci2010.parameters import varied
from amulor.studies.ricci2010.scenes.milk import LineLight
from amulor.studies.ricci2010.scenes.short_lines import (
    LIGHT,
    advance_along,
    rise_weight,
    standard_error,
)
from amulor.studies.ricci2010.study import Study

#: Drift of VV that the reflectance of the plate is set to: that of figure 10(d) [deg].
PARALLEL = 7.0
#: Reflectances that are tried, over that of the study [1].
_BRIGHTER = (0.01, 100.0)


@dataclass(frozen=True)
class SetUp:
    """Variant of the experiment: kind of milk, tank or plate."""

    group: str
    """Varied quantity."""
    label: str
    """Value of the varied quantity, as text."""
    numbers: Mapping[str, float]
    """Changed input numbers, in the units of `amulor.units`."""


@dataclass(frozen=True, kw_only=True)
class Drifts:
    """Phase drifts of a set-up in the most turbid water, for a given VV drift."""

    set_up: SetUp
    """Variant of the experiment: kind of milk, tank or plate."""
    crossed: float
    """Phase drift of VH [degrees]."""
    crossed_error: float
    """Standard error of the VH drift, from Monte Carlo [degrees]."""
    same: float
    """Phase drift of RR [degrees]."""
    same_error: float
    """Standard error of the RR drift [degrees]."""
    reflectance: float
    """Plate reflectance needed for the VV drift; impossible above 1 [1]."""


#: All that are compared, at the turbidity of figure 10(d).
SET_UPS = (
    *(
        SetUp("spheres of one diameter", f"{d:g} µm", {"milk_diameter": d * 1e-6})
        for d in (0.15, 0.25, 0.4, 0.6, 1.0, 2.0, 3.0)
    ),
    *(
        SetUp(
            "fat of 0.6 µm and casein",
            f"{share:.0%} casein",
            {
                "milk_diameter": 0.6e-6,
                "milk_index": 1.475,
                "casein_share": share,
            },
        )
        for share in (0.25, 0.5, 0.75)
    ),
    *(
        SetUp(
            "walls, spheres of 0.25 µm",
            f"walls {share:.0%}",
            {"wall_reflectance": share},
        )
        for share in (0.05, 0.1, 0.2, 0.4)
    ),
)


def drifts(study: Study) -> tuple[Drifts, ...]:
    """Return the phase drifts of all set-ups; in a quick study, of every third."""
    return tuple(
        drifts_of(study, set_up)
        for set_up in (SET_UPS[::3] if study.quick else SET_UPS)
    )


def drifts_of(study: Study, set_up: SetUp) -> Drifts:
    """Return the VH and RR phase drifts of one set-up, for the given VV drift."""
    numbers = dict(study.parameters)
    for name, value in set_up.numbers.items():
        numbers = varied(numbers, name, value)
    changed = study.with_parameters(numbers)
    light = changed.once(LIGHT["d"])

    def excess(logarithm: float) -> float:
        return _drift(light["VV"], float(np.exp(logarithm)))[0] - PARALLEL

    scale = float(np.exp(brentq(excess, *np.log(_BRIGHTER), xtol=1e-6)))
    (crossed, crossed_error), (circular, circular_error) = (
        _drift(light[pair], scale) for pair in ("VH", "RR")
    )
    return Drifts(
        set_up=set_up,
        crossed=crossed,
        crossed_error=crossed_error,
        same=circular,
        same_error=circular_error,
        reflectance=scale * changed["plate_reflectance"],
    )


def _drift(light: LineLight, brighter: float) -> tuple[float, float]:
    """Return the phase drift with scaled plate light, and its error [degrees]."""
    signal = light.water + brighter * light.target
    rise = rise_weight()
    return (
        float(rise @ advance_along(signal)),
        standard_error((light.batches / signal).imag @ rise),
    )
