r"""Daylight in the sea, by depth, as a source of shot noise.

References
----------
.. [1] C. D. Mobley, Light and Water, Academic Press (1994), sections 1.4 and 3.5.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import broadcast, not_negative, positive, within
from amulor.optics.detection import photoelectron_rate

__all__ = ["daylight_radiance", "daylight_rate"]


def daylight_radiance(
    radiance: ArrayLike, *, depth: ArrayLike, diffuse_attenuation: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the spectral radiance of daylight at a depth [W/(m^2 sr m)].

    Parameters
    ----------
    radiance : array_like
        Spectral radiance just below the surface, along the receiver's line of sight,
        not negative [W/(m^2 sr m)].
    depth : array_like
        Depth of the instrument below the surface, not negative [m].
    diffuse_attenuation : array_like
        Diffuse attenuation coefficient K_d at this wavelength, not negative [1/m].

    Returns
    -------
    ndarray
        Spectral radiance, of the broadcast shape [W/(m^2 sr m)].

    Raises
    ------
    ValueError
        If an argument is negative or not finite.

    Notes
    -----
    :math:`L_d(z) = L_d(0) \, e^{-K_d z}`, ref. [1] of this module, for uniform water
    below the first few meters.

    Examples
    --------
    >>> print(f"{daylight_radiance(1e7, depth=10.0, diffuse_attenuation=0.1):.3g}")
    3.68e+06
    """
    surface = not_negative(radiance, name="radiance", unit="W/(m^2 sr m)")
    below = not_negative(depth, name="depth", unit="m")
    fading = not_negative(diffuse_attenuation, name="diffuse_attenuation", unit="1/m")
    broadcast(radiance=surface, depth=below, diffuse_attenuation=fading)
    return np.asarray(surface * np.exp(-fading * below))


def daylight_rate(
    radiance: ArrayLike,
    *,
    wavelength: ArrayLike,
    bandwidth: ArrayLike,
    receiver_area: ArrayLike,
    solid_angle: ArrayLike,
    transmission: ArrayLike,
    quantum_efficiency: ArrayLike,
) -> NDArray[np.float64]:
    r"""Return the photoelectron rate due to daylight in a receiver [1/s].

    Parameters
    ----------
    radiance : array_like
        Spectral radiance along the receiver's line of sight, not negative
        [W/(m^2 sr m)].
    wavelength : array_like
        Wavelength in vacuum, above zero [m].
    bandwidth : array_like
        Width of the optical filter, not negative [m].
    receiver_area : array_like
        Area of the aperture, not negative [m^2].
    solid_angle : array_like
        Solid angle of the field of view, in the medium of the radiance, not negative
        [sr].
    transmission : array_like
        Transmission of the optics before the photocathode, 0 to 1 [1].
    quantum_efficiency : array_like
        Photoelectrons per photon, above 0 to 1 [1].

    Returns
    -------
    ndarray
        Mean rate, of the broadcast shape [1/s]. It is not modulated and only adds to
        the shot noise (`amulor.optics.detection.quadrature_variance`).

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    :math:`r_b = \frac{\eta\lambda}{hc} T L_d \Delta\lambda \Sigma_r \Omega_r`. Area
    times solid angle times the square of the index is the same before and behind a
    window, so a radiance in water belongs with the solid angle in water.

    Examples
    --------
    >>> rate = daylight_rate(
    ...     1e7, wavelength=532e-9, bandwidth=1e-9, receiver_area=1.26e-3,
    ...     solid_angle=0.02, transmission=0.1, quantum_efficiency=0.2,
    ... )
    >>> print(f"{rate:.2g} photoelectrons/s")
    1.3e+10 photoelectrons/s
    """
    bright = not_negative(radiance, name="radiance", unit="W/(m^2 sr m)")
    vacuum = positive(wavelength, name="wavelength", unit="m")
    width = not_negative(bandwidth, name="bandwidth", unit="m")
    area = not_negative(receiver_area, name="receiver_area", unit="m^2")
    cone = not_negative(solid_angle, name="solid_angle", unit="sr")
    passed = within(transmission, 0, 1, name="transmission")
    broadcast(
        radiance=bright,
        wavelength=vacuum,
        bandwidth=width,
        receiver_area=area,
        solid_angle=cone,
        transmission=passed,
        quantum_efficiency=quantum_efficiency,
    )
    return photoelectron_rate(
        bright * width * area * cone * passed,
        wavelength=vacuum,
        quantum_efficiency=quantum_efficiency,
    )
