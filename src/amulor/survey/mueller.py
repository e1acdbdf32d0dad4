"""Mueller matrices in surveys: three diagonal numbers, all sixteen, or a name."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator

from amulor.optics.polarization import depolarization

Row = tuple[float, float, float, float]
Named = Literal["painted-metal", "smooth-metal", "ideal-depolarizer"]
_Stated = tuple[float, float, float] | tuple[Row, Row, Row, Row] | Named

#: (m22, m33, m44) of surfaces straight backwards, each with its source.
SURFACES: dict[str, tuple[float, float, float]] = {
    # R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360: m22 is printed, m33
    # follows from symmetry, m44 is assumed within its bounds, -0.61 to -0.22.
    "painted-metal": (0.61, -0.61, -0.46),
    # Fresnel's equations at right angles, whatever the index: what a mirror keeps.
    # Metal that was not polished depolarizes; no published number is at hand.
    "smooth-metal": (1.0, -1.0, -1.0),
    # By definition; white reflectance standards are similar.
    "ideal-depolarizer": (0.0, 0.0, 0.0),
}


def keeping(m22: float) -> tuple[float, float, float]:
    """Return (m22, m33, m44) for backscattering by randomly oriented particles."""
    return m22, -m22, 1.0 - 2.0 * m22


#: Sea water straight backwards. K. J. Voss and E. S. Fry, Appl. Opt. 23, 4427 (1984)
#: measured 10 to 160 degrees in the Atlantic, the Pacific and the Gulf of Mexico: the
#: form of depolarizing molecules, alike within 10 % everywhere, with a polarization at
#: 90 degrees of p = 0.66 (A. A. Kokhanovsky, J. Geophys. Res. 108, 3175 (2003)). In
#: this form m22 = p (1 + cos^2) / (1 + p cos^2), which is carried on to 180 degrees.
SEA = keeping(2 * 0.66 / (1 + 0.66))


def matrix(description: Any) -> NDArray[np.float64]:
    """Return the reduced Mueller matrix that a survey states."""
    if isinstance(description, str):
        description = SURFACES[description]
    values = np.asarray(description, dtype=float)
    if values.shape == (3,):
        return np.diag([1.0, *values])
    return values


def _named(description: Any) -> Any:
    """Return the description of a Mueller matrix; ValueError for an unknown name."""
    if isinstance(description, str) and description not in SURFACES:
        raise ValueError(
            f"found {description!r}, for which no published Mueller matrix is known "
            f"here; the names are {', '.join(SURFACES)}; of other surfaces state m22, "
            "m33 and m44 as you measured them"
        )
    return description


def _check(description: _Stated) -> _Stated:
    values = matrix(description)
    if not np.all(np.isfinite(values)):
        raise ValueError("a Mueller matrix must hold finite numbers")
    if values[0, 0] != 1:
        raise ValueError(
            f"a reduced Mueller matrix starts with 1, found {values[0, 0]:g}; divide "
            "all elements by the first one"
        )
    defect = float(depolarization.realizability_defect(values))
    # A matrix printed with three digits may miss the limit by its last one.
    if defect > 1e-3:
        raise ValueError(
            f"no surface or particle can have this Mueller matrix: the smallest "
            f"eigenvalue of its coherency matrix is {-defect:.3g}, below 0"
        )
    return description


ReducedMueller = Annotated[_Stated, BeforeValidator(_named), AfterValidator(_check)]
