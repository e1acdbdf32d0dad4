"""How far a polynomial over the scan directions may be off between the shots."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complex = NDArray[np.complex128]

#: The error of the first surface over its distance from the second, where that is
#: large. Unscattered light stands as a peak on the rest, so that the logarithm is no
#: polynomial either [1].
_BEYOND = 3.0
#: Distance from which on it is large, in parts of the signal [1].
_LARGE = 0.02
#: A logarithm needs a signal that stands this many standard errors off zero.
_SURE = 5.0


def logarithms(
    shots: Complex, variance: Floats, group: NDArray[np.intp]
) -> tuple[Complex, complex] | None:
    r"""Return logarithms of the means over directions, and what they are relative to.

    Parameters
    ----------
    shots : ndarray of complex, shape (n,)
        Samples without a target [V].
    variance : ndarray, shape (n,)
        Variance of each, in phase and quadrature together [V^2].
    group : ndarray of int, shape (n,)
        Number of the direction that each shot has, from 0 on.

    Returns
    -------
    tuple of ndarray and complex, or None
        :math:`\ln (S_g / S_0)` for each direction [1], and :math:`S_0` [V]; None where
        a mean does not stand clear of its error, so that it has no logarithm, or the
        phase turns by more than a right angle over the scan.
    """
    count = np.bincount(group)
    mean = (
        np.bincount(group, shots.real) + 1j * np.bincount(group, shots.imag)
    ) / count
    error = np.sqrt(np.bincount(group, variance)) / count
    if np.any(np.abs(mean) < _SURE * error) or np.any(mean == 0):
        return None
    middle = complex(mean.sum())
    if middle == 0:
        return None
    middle *= float(np.abs(mean).max()) / abs(middle)
    ratio = mean / middle
    if np.any(ratio.real <= 0):
        return None
    return np.log(ratio), middle


def disagreement(signal: Complex, logarithm: Complex, middle: complex) -> Complex:
    r"""Return how far two smooth surfaces through the same shots lie apart.

    Parameters
    ----------
    signal : ndarray of complex
        Polynomial at the pixels [V].
    logarithm : ndarray of complex
        Polynomial of the same degree, fitted to the logarithms, at the pixels [1].
    middle : complex
        What the logarithms are relative to [V].

    Returns
    -------
    ndarray of complex
        Difference :math:`S_0 e^{q} - p`, up to three times [V].

    Notes
    -----
    What a receiver with a Gaussian field of view sees falls off as a Gaussian of the
    direction, whose logarithm is a polynomial of the second degree, and which is none
    itself. Where the shots are dense enough both surfaces agree; where three rows
    stand for nineteen degrees their difference is of the size of the error of the
    interpolation, and up to three times less where light that was not scattered makes
    a peak.
    """
    # Beyond the shots a polynomial may run away: no farther than ten times the signal.
    bounded = np.minimum(logarithm.real, np.log(10.0)) + 1j * logarithm.imag
    difference: Complex = middle * np.exp(bounded) - signal
    size, whole = np.abs(difference), np.abs(signal)
    large = np.divide(size, _LARGE * whole, out=np.ones(size.shape), where=whole > 0)
    return np.asarray(difference * (1 + (_BEYOND - 1) * np.minimum(large, 1.0)))
