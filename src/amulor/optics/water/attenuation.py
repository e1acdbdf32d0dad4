"""Attenuation of a collimated beam in water, by the Lambert-Beer law."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import broadcast, measured, not_negative, require

__all__ = ["optical_thickness", "single_scattering_albedo", "transmission"]


def transmission(distance: ArrayLike, *, attenuation: ArrayLike) -> NDArray[np.float64]:
    r"""Return the transmitted fraction of a collimated beam over a distance [1].

    Parameters
    ----------
    distance : array_like
        Geometric path in the water, one way, not negative [m].
    attenuation : array_like
        Attenuation coefficient, absorption plus scattering, not negative [1/m].

    Returns
    -------
    ndarray
        Unscattered power over launched power, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If a distance is negative, or an attenuation coefficient is negative or
        not finite.

    Notes
    -----
    Eq. (3) of Ricci et al. 2010 [1]_, as rederived, :math:`I(z) / I_0 = e^{-kz}`
    with :math:`k = a + b`. Light that was scattered forward and still reaches
    the receiver is not counted.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> print(f"{transmission(1.5, attenuation=0.85):.4f}")
    0.2794
    """
    return np.exp(-optical_thickness(distance, attenuation=attenuation))


def optical_thickness(
    distance: ArrayLike, *, attenuation: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the optical thickness of a distance in water.

    Parameters
    ----------
    distance : array_like
        Geometric path in the water, one way, not negative [m].
    attenuation : array_like
        Attenuation coefficient, absorption plus scattering, not negative [1/m].

    Returns
    -------
    ndarray
        Optical thickness :math:`\tau = k z`, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If a distance is negative, or an attenuation coefficient is negative or
        not finite.

    Notes
    -----
    The exponent of eq. (3) of Ricci et al. 2010 [1]_, as rederived. The way back
    is not included: an echo passes twice this thickness.

    References
    ----------
    .. [1] R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
       :doi:`10.1155/2010/958360`.

    Examples
    --------
    >>> print(f"{optical_thickness(3.9, attenuation=0.5):.2f}")
    1.95
    """
    path = measured(distance, name="distance", unit="m")
    coefficient = not_negative(attenuation, name="attenuation", unit="1/m")
    broadcast(distance=path, attenuation=coefficient)
    return path * coefficient


def single_scattering_albedo(
    *, absorption: ArrayLike, scattering: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the single-scattering albedo: scattering over attenuation.

    Parameters
    ----------
    absorption : array_like
        Absorption coefficient, not negative [1/m].
    scattering : array_like
        Scattering coefficient, not negative [1/m].

    Returns
    -------
    ndarray
        :math:`b / (a + b)`, between 0 and 1, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If a coefficient is negative or not finite, or if both are zero, where the
        ratio has no meaning.

    Examples
    --------
    >>> print(f"{single_scattering_albedo(absorption=0.15, scattering=0.35):.2f}")
    0.70
    """
    absorbed = not_negative(absorption, name="absorption", unit="1/m")
    scattered = not_negative(scattering, name="scattering", unit="1/m")
    broadcast(absorption=absorbed, scattering=scattered)
    attenuation = absorbed + scattered
    require(
        attenuation,
        attenuation > 0,
        name="absorption + scattering",
        rule="above 0",
        unit="1/m",
        hint="without either there is nothing to compare",
    )
    return scattered / attenuation
