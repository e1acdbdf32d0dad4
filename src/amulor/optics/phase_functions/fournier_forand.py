r"""Fournier-Forand phase function, for particles with power-law sizes.

Numbers of particles fall with their size as :math:`r^{-\mu}`; the forward peak rises
as :math:`\theta^{\mu - 5}`. With :math:`\nu = (3 - \mu) / 2` and
:math:`\delta = 4 \sin^2(\theta/2) / 3 (n - 1)^2`, refs. [1]_ and [2]_.

References
----------
.. [1] G. R. Fournier and J. L. Forand, Proc. SPIE 2258, 194 (1994),
   :doi:`10.1117/12.190063`.
.. [2] G. R. Fournier and M. Jonasz, Proc. SPIE 3761, 62 (1999),
   :doi:`10.1117/12.366488`.
.. [3] C. D. Mobley, L. K. Sundman and E. Boss, Appl. Opt. 41, 1035 (2002),
   :doi:`10.1364/AO.41.001035`.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import checked_angle, require, within

__all__ = [
    "fournier_forand_backscatter_fraction",
    "fournier_forand_cumulative",
    "fournier_forand_phase",
]


def fournier_forand_phase(
    angle: ArrayLike, *, relative_index: float, slope: float
) -> NDArray[np.float64]:
    r"""Return the Fournier-Forand phase function at scattering angles [1/sr].

    Parameters
    ----------
    angle : array_like
        Scattering angle, above 0 to pi [rad]. At 0 it is infinite.
    relative_index : float
        Real index n of the particles over that of water, above 1 to 1.5 [1].
    slope : float
        Slope mu of the size distribution, above 3 and below 5 [1].

    Returns
    -------
    ndarray
        Phase function, shape of `angle` [1/sr].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    Refs. [2] and [3] of this module,

    .. math::

       p = \frac{\nu (1 - \delta) - (1 - \delta^\nu)
           + [\delta (1 - \delta^\nu) - \nu (1 - \delta)] / \sin^2(\theta/2)}
           {4 \pi (1 - \delta)^2 \delta^\nu}
         + \frac{1 - \delta_\pi^\nu}{16 \pi (\delta_\pi - 1) \delta_\pi^\nu}
           (3 \cos^2\theta - 1),

    with :math:`\delta_\pi` at 180 degrees. Near :math:`\delta = 1`, where the brackets
    lose their digits, they are computed by a series. Intended for :math:`n` up to about
    1.35 and :math:`\mu` from 3.5 to 5.

    Examples
    --------
    >>> p = fournier_forand_phase(np.pi, relative_index=1.1, slope=3.5835)
    >>> print(f"{p:.2e} 1/sr")
    2.86e-03 1/sr
    """
    theta = checked_angle(angle, name="angle")
    hint = "the Fournier-Forand function is infinite at 0"
    require(theta, theta > 0, name="angle", rule="above 0", unit="rad", hint=hint)
    nu = _checked(relative_index, slope)
    height = np.sin(theta / 2) ** 2
    log_delta = np.log(height) + _log_delta_pi(relative_index)
    first = _remainder(nu, log_delta)
    second = -_remainder(1 + nu, log_delta)
    square = _growth(1.0, log_delta) ** 2 * np.exp(nu * log_delta)
    peak = (first + second / height) / (4 * np.pi * square)
    smooth = _smooth_weight(nu, relative_index) * (3 * np.cos(theta) ** 2 - 1)
    total: NDArray[np.float64] = peak + smooth
    return total


def fournier_forand_cumulative(
    angle: ArrayLike, *, relative_index: float, slope: float
) -> NDArray[np.float64]:
    r"""Return the fraction of Fournier-Forand scattering below an angle.

    Parameters
    ----------
    angle : array_like
        Scattering angle, 0 to pi [rad].
    relative_index : float
        Real index n of the particles over that of water, above 1 to 1.5 [1].
    slope : float
        Slope mu of the size distribution, above 3 and below 5 [1].

    Returns
    -------
    ndarray
        Fraction between 0 and 1, shape of `angle` [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    The integral of `fournier_forand_phase`, ref. [1] of this module, with
    :math:`K` the factor of its last term,

    .. math::

       F = \frac{1 - \delta^{\nu+1} - \sin^2(\theta/2) (1 - \delta^\nu)}
           {(1 - \delta) \delta^\nu} + 2 \pi K \cos\theta \sin^2\theta.

    Examples
    --------
    >>> fraction = fournier_forand_cumulative(0.01, relative_index=1.1, slope=3.5835)
    >>> print(f"{fraction:.3f}")
    0.187
    """
    theta = checked_angle(angle, name="angle")
    nu = _checked(relative_index, slope)
    height = np.sin(theta / 2) ** 2
    # log(0) is minus infinity, whose fraction is 0; a tiny height replaces it.
    log_delta = np.log(np.maximum(height, 1e-300)) + _log_delta_pi(relative_index)
    numerator = _growth(nu + 1, log_delta) - height * _growth(nu, log_delta)
    peak = numerator / (_growth(1.0, log_delta) * np.exp(nu * log_delta))
    smooth = _smooth_weight(nu, relative_index) * np.cos(theta) * np.sin(theta) ** 2
    fraction = np.where(theta == 0, 0.0, peak + 2 * np.pi * smooth)
    return np.asarray(fraction)


def fournier_forand_backscatter_fraction(
    *, relative_index: float, slope: float
) -> float:
    r"""Return the fraction of Fournier-Forand scattering beyond 90 degrees.

    Parameters
    ----------
    relative_index : float
        Real index n of the particles over that of water, above 1 to 1.5 [1].
    slope : float
        Slope mu of the size distribution, above 3 and below 5 [1].

    Returns
    -------
    float
        :math:`b_b / b` [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    Ref. [3] of this module, with :math:`\delta` at 90 degrees,

    .. math::

       B = 1 - \frac{1 - \delta^{\nu+1} - (1 - \delta^\nu) / 2}
                    {(1 - \delta) \delta^\nu}.

    Examples
    --------
    >>> back = fournier_forand_backscatter_fraction(relative_index=1.1, slope=3.5835)
    >>> print(f"{back:.4f}")
    0.0183
    """
    nu = _checked(relative_index, slope)
    log_delta = np.log(0.5) + _log_delta_pi(relative_index)
    logs = np.array([log_delta])
    numerator = _growth(nu + 1, logs) - _growth(nu, logs) / 2
    forward = numerator / (_growth(1.0, logs) * np.exp(nu * logs))
    return float(1 - forward[0])


def _growth(power: float, log_delta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (delta^power - 1) / log(delta), with its limit at delta = 1."""
    safe = np.where(log_delta == 0, 1.0, log_delta)
    growth: NDArray[np.float64] = np.where(
        log_delta == 0, power, np.expm1(power * safe) / safe
    )
    return growth


def _remainder(power: float, log_delta: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (delta^power - 1 - power (delta - 1)) / log(delta)^2."""
    close = np.abs(log_delta) < 0.1
    safe = np.where(close, 1.0, log_delta)
    direct = (np.expm1(power * safe) - power * np.expm1(safe)) / safe**2
    small = np.where(close, log_delta, 0.0)
    # The eleventh term is below 0.1^11 / 13! of the first.
    series = sum(
        (power**order - power) / factorial(order) * small ** (order - 2)
        for order in range(2, 13)
    )
    remainder: NDArray[np.float64] = np.where(close, series, direct)
    return remainder


def _smooth_weight(nu: float, relative_index: float) -> float:
    """Return the weight of the term 3 cos^2(angle) - 1 in the phase function."""
    logs = np.array([_log_delta_pi(relative_index)])
    ratio = -_growth(nu, logs) / _growth(1.0, logs) / np.exp(nu * logs)
    return float(ratio[0]) / (16 * np.pi)


def _log_delta_pi(relative_index: float) -> float:
    """Return the natural logarithm of delta at a scattering angle of 180 degrees."""
    return float(np.log(4 / 3) - 2 * np.log(relative_index - 1))


def _checked(relative_index: float, slope: float) -> float:
    """Return the exponent nu; ValueError if index or slope is out of range."""
    within(
        relative_index,
        1,
        1.5,
        name="relative_index",
        above=True,
        hint="it is the index of the particles over that of water",
    )
    within(
        slope,
        3,
        5,
        name="slope",
        above=True,
        below=True,
        hint="the Fournier-Forand function has no finite forward integral elsewhere",
    )
    return (3 - slope) / 2
