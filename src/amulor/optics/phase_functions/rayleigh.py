r"""Scattering by small particles: Rayleigh phase function and size parameter.

The corresponding Mueller matrix is `amulor.optics.polarization.mueller.rayleigh`;
spheres of any size are in `amulor.optics.phase_functions.mie`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import (
    at_least,
    broadcast,
    checked_angle,
    positive,
    within,
)

__all__ = [
    "rayleigh_phase_cumulative",
    "rayleigh_phase_value",
    "scattering_regime",
    "size_parameter",
]


def rayleigh_phase_value(
    angle: ArrayLike, *, depolarization: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the Rayleigh phase function for unpolarized light at angles [1/sr].

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
    delta = within(depolarization, 0, 1, name="depolarization")
    broadcast(angle=theta, depolarization=delta)
    shape = (1 + delta) + (1 - delta) * np.cos(theta) ** 2
    value: NDArray[np.float64] = 3 / (8 * np.pi) * shape / (2 + delta)
    return value


def rayleigh_phase_cumulative(
    angle: ArrayLike, *, depolarization: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the fraction of Rayleigh scattering below an angle.

    Parameters
    ----------
    angle : array_like
        Scattering angle, 0 to pi [rad].
    depolarization : array_like
        Depolarization ratio of unpolarized light at 90 degrees, 0 to 1 [1].

    Returns
    -------
    ndarray
        Fraction between 0 and 1, of the broadcast shape [1].

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
    delta = within(depolarization, 0, 1, name="depolarization")
    broadcast(angle=theta, depolarization=delta)
    cosine = np.cos(theta)
    height = 2 * np.sin(theta / 2) ** 2
    bracket = (1 + delta) + (1 - delta) * (1 + cosine + cosine**2) / 3
    fraction: NDArray[np.float64] = 3 * height / (4 * (2 + delta)) * bracket
    return fraction


def size_parameter(
    radius: ArrayLike, *, wavelength: ArrayLike, refractive_index: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the size parameter of a particle: circumference over wavelength.

    Parameters
    ----------
    radius : array_like
        Radius of the particle, above zero [m].
    wavelength : array_like
        Wavelength in vacuum, above zero [m].
    refractive_index : array_like
        Phase index of the medium around the particle, at least 1 [1].

    Returns
    -------
    ndarray
        Size parameter x, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If a length is not above zero or an index is below 1.

    Notes
    -----
    Eq. (62) of R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
    doi:10.1155/2010/958360, as rederived, :math:`x = 2 \pi n a / \lambda`. The index is
    that of the medium, not of the particle.

    Examples
    --------
    >>> x = size_parameter(
    ...     [0.075e-6, 0.15e-6], wavelength=405e-9, refractive_index=1.34
    ... )
    >>> print(np.round(x, 1))
    [1.6 3.1]
    """
    a = positive(radius, name="radius", unit="m")
    vacuum = positive(wavelength, name="wavelength", unit="m")
    index = at_least(refractive_index, 1, name="refractive_index")
    broadcast(radius=a, wavelength=vacuum, refractive_index=index)
    ratio: NDArray[np.float64] = 2 * np.pi * index * a / vacuum
    return ratio


def scattering_regime(
    size_parameter: ArrayLike, *, rayleigh_below: float = 0.1, mie_above: float = 10.0
) -> NDArray[np.str_]:
    r"""Return the scattering regime of particles: `rayleigh`, `intermediate` or `mie`.

    Parameters
    ----------
    size_parameter : array_like
        Size parameter x, above zero [1].
    rayleigh_below : float
        Below it a particle is a dipole; 0.1 by default, where the next term of the
        series, of order x^2, is some 1 % [1].
    mie_above : float
        Above it the forward peak is narrow; 10 by default, a convention [1].

    Returns
    -------
    ndarray of str
        `rayleigh`, `intermediate` or `mie`, shape of `size_parameter`.

    Raises
    ------
    ValueError
        If a size parameter is not above zero or the limits are not in order.

    Notes
    -----
    Eq. (62) of R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
    doi:10.1155/2010/958360, as rederived, with the regimes :math:`x \ll 1`,
    :math:`x \sim 1` and :math:`x \gg 1`; their boundaries are conventions, so the
    limits are arguments.

    Examples
    --------
    >>> print(scattering_regime([0.01, 2.0, 50.0]))
    ['rayleigh' 'intermediate' 'mie']
    """
    x = positive(size_parameter, name="size_parameter", unit="")
    positive(mie_above, name="mie_above")
    hint = "it must not be above mie_above"
    within(rayleigh_below, 0, mie_above, name="rayleigh_below", above=True, hint=hint)
    return np.where(
        x < rayleigh_below, "rayleigh", np.where(x > mie_above, "mie", "intermediate")
    )
