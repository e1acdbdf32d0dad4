"""How the water fluctuates from shot to shot, in parts of its signal."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulor.rejection.covariance import Covariance

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]


def relative_fluctuation(
    shots: Complex, level: Complex, instrument: Covariance, *, freedom: int
) -> NDArray[np.float64]:
    """Return the covariance of (radial, tangential) changes per unit of water signal.

    The stated instrument error is taken off; what is left is made a covariance again
    where chance drove it below zero. No water signal has no fluctuation.
    """
    size = np.abs(level)
    power = float(np.sum(size**2))
    if freedom < 1 or power == 0:
        return np.zeros((2, 2))
    turn = np.where(size > 0, level, 1) / np.where(size > 0, size, 1)
    rest = (shots - level) / turn
    c, s = turn.real, turn.imag
    radial = c**2 * instrument.in_phase + s**2 * instrument.quadrature
    radial = radial + 2 * c * s * instrument.cross
    tangential = s**2 * instrument.in_phase + c**2 * instrument.quadrature
    tangential = tangential - 2 * c * s * instrument.cross
    crossed = c * s * (instrument.quadrature - instrument.in_phase)
    crossed = crossed + (c**2 - s**2) * instrument.cross
    parts = np.stack([rest.real, rest.imag])
    stated = np.array([[radial, crossed], [crossed, tangential]]).sum(axis=2)
    excess = (parts @ parts.T * len(shots) / freedom - stated) / power
    values, vectors = np.linalg.eigh(excess)
    kept: NDArray[np.float64] = (vectors * np.maximum(values, 0)) @ vectors.T
    return kept


def fluctuation(relative: NDArray[np.float64], level: Complex) -> Covariance:
    """Turn a relative covariance into one of the outputs at a given water signal.

    Parameters
    ----------
    relative : ndarray, shape (2, 2)
        Covariance of radial and tangential changes per squared signal [1].
    level : ndarray of complex
        Water signal [V].

    Returns
    -------
    Covariance
        Arrays of the shape of the signal.
    """
    a, b = level.real, level.imag
    radial, crossed, tangential = relative[0, 0], relative[0, 1], relative[1, 1]
    return Covariance(
        radial * a**2 + tangential * b**2 - 2 * crossed * a * b,
        radial * b**2 + tangential * a**2 + 2 * crossed * a * b,
        (radial - tangential) * a * b + crossed * (a**2 - b**2),
    )
