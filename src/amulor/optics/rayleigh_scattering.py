r"""The Rayleigh phase function of molecules for unpolarized light, closed form.

The matrix that goes with it is `amulor.optics.mueller.rayleigh`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics.phase_function_integrals import checked_angle

__all__ = ["rayleigh_phase_cumulative", "rayleigh_phase_value"]


def rayleigh_phase_value(
    angle: ArrayLike, *, depolarization: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the phase function of molecules for unpolarized light.

    Parameters
    ----------
    angle : array_like
        Scattering angle, 0 to pi [rad].
    depolarization : array_like
        Depolarization ratio of unpolarized light at 90 degrees, 0 to 1; 0.039 for
        pure water [1].

    Returns
    -------
    ndarray
        Phase function, of the broadcast shape [1/sr].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    With the depolarization ratio :math:`\delta` (A. Bucholtz, Appl. Opt. 34, 2765
    (1995), with :math:`\gamma = \delta / (2 - \delta)`),

    .. math::

       p = \frac{3}{8\pi} \frac{(1 + \delta) + (1 - \delta) \cos^2\theta}
                                {2 + \delta}.

    Examples
    --------
    >>> p = rayleigh_phase_value([np.pi / 2, np.pi], depolarization=0.0)
    >>> print(np.round(p, 4))
    [0.0597 0.1194]
    """
    theta = checked_angle(angle, name="angle")
    delta = _depolarization(depolarization)
    shape = (1 + delta) + (1 - delta) * np.cos(theta) ** 2
    value: NDArray[np.float64] = 3 / (8 * np.pi) * shape / (2 + delta)
    return value


def rayleigh_phase_cumulative(
    angle: ArrayLike, *, depolarization: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the share of molecular scattering below an angle.

    Parameters
    ----------
    angle : array_like
        Scattering angle, 0 to pi [rad].
    depolarization : array_like
        Depolarization ratio of unpolarized light at 90 degrees, 0 to 1 [1].

    Returns
    -------
    ndarray
        Share between 0 and 1, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    The integral of `rayleigh_phase_value`, with :math:`h = 2 \sin^2(\theta/2)`,

    .. math::

       F = \frac{3 h}{4 (2 + \delta)} \left[ 1 + \delta
           + \tfrac13 (1 - \delta) (1 + \cos\theta + \cos^2\theta) \right].

    Examples
    --------
    >>> print(f"{rayleigh_phase_cumulative(np.pi / 2, depolarization=0.039):.3f}")
    0.500
    """
    theta = checked_angle(angle, name="angle")
    delta = _depolarization(depolarization)
    cosine = np.cos(theta)
    height = 2 * np.sin(theta / 2) ** 2
    bracket = (1 + delta) + (1 - delta) * (1 + cosine + cosine**2) / 3
    share: NDArray[np.float64] = 3 * height / (4 * (2 + delta)) * bracket
    return share


def _depolarization(value: ArrayLike) -> NDArray[np.float64]:
    """Return a depolarization ratio as an array, refused outside of 0..1."""
    delta = np.asarray(value, dtype=np.float64)
    if not np.all((delta >= 0) & (delta <= 1)):
        raise ValueError(
            "depolarization must be from 0 to 1, got values from "
            f"{np.min(delta):g} to {np.max(delta):g}"
        )
    return delta
