"""What gives the water signal its shape, and how that departs from the model."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

#: Knots over which departures of the overlap are alike.
_CORRELATION = 2.0


@dataclass(frozen=True)
class Shape:
    """What gives the water signal its shape, shared by all pixels of a scan."""

    reduced_attenuation: float
    """Reduced attenuation coefficient k' = a + b_d [1/m]."""
    spread: float
    """Growth b_f <theta^2> of the mean square angle of the light, which stretches the
    phase function of the survey's water [rad^2/m]."""
    forward_scattering: float
    """Forward scattering b_f, above which some light is not scattered at all [1/m]."""
    correction: Floats
    """How the overlap departs from the model, in units of its prior's width [1]."""
    knots: Floats
    """Depths between which the logarithm of the departure is linear [m]."""
    turn: Floats = field(default_factory=lambda: np.zeros(0))
    """By how much the receiver looks past the direction that the survey states, in
    azimuth and elevation; empty where it is taken as exact [rad]."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        return COEFFICIENTS + len(self.turn) + len(self.knots)

    def moved(self, step: Floats) -> Shape:
        """Return the shape after a step in logarithms, turn and correction."""
        loss, spread, forward = np.exp(step[:COEFFICIENTS])
        smooth = COEFFICIENTS + len(self.turn)
        return Shape(
            float(self.reduced_attenuation * loss),
            float(self.spread * spread),
            float(self.forward_scattering * forward),
            self.correction + step[smooth:],
            self.knots,
            self.turn + step[COEFFICIENTS:smooth],
        )


#: Coefficients of a shape, whose logarithms are estimated.
COEFFICIENTS = 3


def hats(depth: Floats, knots: Floats) -> Floats:
    """Return smooth functions whose sum with normal coefficients is a smooth one.

    Between the knots they are linear; from knot to knot their sum is a normal process
    with a correlation of `_CORRELATION` knots and a variance of 1.
    """
    number = np.arange(len(knots))
    covariance = np.exp(-(((number[:, None] - number) / _CORRELATION) ** 2) / 2)
    covariance += 1e-6 * np.eye(len(knots))
    values = np.linalg.cholesky(covariance) if len(knots) else covariance
    return np.array([np.interp(depth, knots, row) for row in values.T]).reshape(
        len(knots), depth.size
    )
