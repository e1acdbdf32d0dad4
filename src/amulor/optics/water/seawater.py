r"""Phase and group index of fresh water and sea water, relative to air and vacuum.

The phase index determines the refraction of rays, the group index the speed of the
modulation. All wavelengths are those in vacuum. Absorption
(`amulor.optics.water.pure_water`) and molecular scattering
(`amulor.optics.water.molecular_scattering`) of the same water are available from this
module, too.

References
----------
.. [1] X. Quan and E. S. Fry, Appl. Opt. 34, 3477 (1995), :doi:`10.1364/AO.34.003477`.
.. [2] IAPWS R9-97, Release on the Refractive Index of Ordinary Water Substance as a
   Function of Wavelength, Temperature and Pressure (1997).
.. [3] P. E. Ciddor, Appl. Opt. 35, 1566 (1996), :doi:`10.1364/AO.35.001566`.
.. [4] X. Zhang, L. Hu and M.-X. He, Opt. Express 17, 5698 (2009),
   :doi:`10.1364/OE.17.005698`.
.. [5] X. Zhang and L. Hu, J. Remote Sens. 2021, 9753625,
   :doi:`10.34133/2021/9753625`.
.. [6] R. C. Millard and G. Seaver, Deep-Sea Res. 37, 1909 (1990),
   :doi:`10.1016/0198-0149(90)90086-B`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import broadcast, within
from amulor.optics.water import _quan_fry
from amulor.optics.water.molecular_scattering import (
    molecular_backscattering,
    molecular_phase_function,
    molecular_scattering,
    molecular_vsf,
    morel_scattering,
)
from amulor.optics.water.pure_water import (
    mason_absorption,
    mason_absorption_uncertainty,
    pope_fry_absorption,
)

__all__ = [
    "AIR_REFRACTIVE_INDEX",
    "group_index",
    "iapws_group_index",
    "iapws_refractive_index",
    "mason_absorption",
    "mason_absorption_uncertainty",
    "molecular_backscattering",
    "molecular_phase_function",
    "molecular_scattering",
    "molecular_vsf",
    "morel_scattering",
    "pope_fry_absorption",
    "refractive_index",
    "refractive_index_vacuum",
]

AIR_REFRACTIVE_INDEX = 1.000283
"""Refractive index of standard air (15 degC, 101325 Pa) at 0.40 um, ref. [3] [1]."""


def refractive_index(
    wavelength: ArrayLike, *, temperature: ArrayLike, salinity: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the phase index of sea water relative to air.

    Parameters
    ----------
    wavelength : array_like
        Wavelength in vacuum, 400e-9 to 700e-9 [m].
    temperature : array_like
        Water temperature, 0 to 30 [degC].
    salinity : array_like
        Salinity, 0 (fresh water) to 43, practical or in parts per thousand [1].

    Returns
    -------
    ndarray
        Index relative to air at atmospheric pressure, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    The ten-parameter fit of Quan and Fry, ref. [1] of this module, to the tables of
    Austin and Halikas (1976), from whose corners it departs by up to 5.3e-5:

    .. math::

       n = n_0 + (n_1 + n_2 T + n_3 T^2) S + n_4 T^2
           + \frac{n_5 + n_6 S + n_7 T}{\lambda} + \frac{n_8}{\lambda^2}
           + \frac{n_9}{\lambda^3}.

    The fit was made for salinities up to 35 and is extrapolated to 43 here, which
    covers the Mediterranean and the Red Sea. It is linear in salinity; ref. [4] uses it
    at 38.4 and ref. [5] tests it up to 121 g/kg. From the form of Millard and Seaver,
    ref. [6], made for 0 to 40 and 500 to 700 nm, it departs by at most 4.2e-5 at
    salinity 35, 4.7e-5 at 40 and 5.0e-5 at 43. The effect of depth is neglected: some
    1.5e-4 per 100 m.

    Examples
    --------
    >>> index = refractive_index(405e-9, temperature=20, salinity=35)
    >>> print(f"{index:.6f}")
    1.349455
    """
    t, s = _quan_fry.state(temperature, salinity)
    vacuum = within(wavelength, 400e-9, 700e-9, name="wavelength", unit="m")
    broadcast(wavelength=vacuum, temperature=t, salinity=s)
    return _quan_fry.index(vacuum, temperature=t, salinity=s)


def refractive_index_vacuum(
    wavelength: ArrayLike, *, temperature: ArrayLike, salinity: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the phase index of sea water relative to vacuum.

    Parameters
    ----------
    wavelength : array_like
        Wavelength in vacuum, 400e-9 to 700e-9 [m].
    temperature : array_like
        Water temperature, 0 to 30 [degC].
    salinity : array_like
        Salinity, 0 (fresh water) to 43, practical or in parts per thousand [1].

    Returns
    -------
    ndarray
        Index relative to vacuum, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    `refractive_index` times 1.000283, the index of standard air (15 degC,
    101325 Pa, dry) at 0.40 um by the dispersion equation of Ciddor, ref. [3] of
    this module. It falls to 1.000276 at 0.70 um, which is less than the error of
    the fit. For fresh water the product agrees with `iapws_refractive_index` within
    5e-5.

    Examples
    --------
    >>> index = refractive_index_vacuum(405e-9, temperature=20, salinity=0)
    >>> print(f"{index:.6f}")
    1.343122
    """
    return AIR_REFRACTIVE_INDEX * refractive_index(
        wavelength, temperature=temperature, salinity=salinity
    )


def group_index(
    wavelength: ArrayLike, *, temperature: ArrayLike, salinity: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the group index of sea water, for the speed of the modulation.

    Parameters
    ----------
    wavelength : array_like
        Wavelength in vacuum, 400e-9 to 700e-9 [m].
    temperature : array_like
        Water temperature, 0 to 30 [degC].
    salinity : array_like
        Salinity, 0 (fresh water) to 43, practical or in parts per thousand [1].

    Returns
    -------
    ndarray
        Speed of light in vacuum over group velocity, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    :math:`n_g = n - \lambda \, dn / d\lambda` of `refractive_index_vacuum`. A term
    :math:`\lambda^{-p}` of the index counts :math:`1 + p` times in it. A slope is less
    certain than a value: for fresh water the result lies within 6e-4 of
    `iapws_group_index`, 3.4e-4 above it at 405 nm and 20 degC. The neglected dispersion
    of the air would add 3e-5 at 405 nm.

    Examples
    --------
    >>> index = group_index(405e-9, temperature=20, salinity=0)
    >>> print(f"{index:.4f}")
    1.3804
    """
    t, s = _quan_fry.state(temperature, salinity)
    vacuum = within(wavelength, 400e-9, 700e-9, name="wavelength", unit="m")
    broadcast(wavelength=vacuum, temperature=t, salinity=s)
    return AIR_REFRACTIVE_INDEX * _quan_fry.group_index(
        vacuum, temperature=t, salinity=s
    )


def iapws_refractive_index(
    wavelength: ArrayLike, *, temperature: ArrayLike, density: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the phase index of fresh water relative to vacuum.

    Parameters
    ----------
    wavelength : array_like
        Wavelength in vacuum, 200e-9 to 1100e-9 [m].
    temperature : array_like
        Water temperature, -12 to 500 [degC].
    density : array_like
        Density of the water or steam, above 0 and at most 1060 [kg/m^3]; 998.2
        at 20 degC and atmospheric pressure.

    Returns
    -------
    ndarray
        Index relative to vacuum, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    IAPWS R9-97, ref. [2] of this module: the Lorentz-Lorenz ratio
    :math:`(n^2 - 1) / (n^2 + 2)` is the reduced density times a polynomial in
    reduced density, temperature and wavelength with an ultraviolet and an infrared
    resonance.

    Examples
    --------
    >>> index = iapws_refractive_index(405e-9, temperature=20, density=998.207)
    >>> print(f"{index:.6f}")
    1.343094
    """
    ratio, _ = _lorentz_lorenz(wavelength, temperature, density)
    return np.sqrt((1 + 2 * ratio) / (1 - ratio))


def iapws_group_index(
    wavelength: ArrayLike, *, temperature: ArrayLike, density: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the group index of fresh water, for the speed of the modulation.

    Parameters
    ----------
    wavelength : array_like
        Wavelength in vacuum, 200e-9 to 1100e-9 [m].
    temperature : array_like
        Water temperature, -12 to 500 [degC].
    density : array_like
        Density of the water or steam, above 0 and at most 1060 [kg/m^3]; 998.2
        at 20 degC and atmospheric pressure.

    Returns
    -------
    ndarray
        Speed of light in vacuum over group velocity, of the broadcast shape [1].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    :math:`n_g = n - \lambda \, dn / d\lambda` of `iapws_refractive_index`, with
    :math:`dn / dR = 3 / (2 n (1 - R)^2)` for the Lorentz-Lorenz ratio R.

    Examples
    --------
    >>> index = iapws_group_index(405e-9, temperature=20, density=998.207)
    >>> print(f"{index:.4f}")
    1.3801
    """
    ratio, logarithmic_derivative = _lorentz_lorenz(wavelength, temperature, density)
    index = np.sqrt((1 + 2 * ratio) / (1 - ratio))
    return index - 1.5 * logarithmic_derivative / (index * (1 - ratio) ** 2)


def _lorentz_lorenz(
    wavelength: ArrayLike, temperature: ArrayLike, density: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (n^2 - 1)/(n^2 + 2) by IAPWS, and its derivative times wavelength."""
    vacuum = within(wavelength, 200e-9, 1100e-9, name="wavelength", unit="m")
    degrees = within(temperature, -12, 500, name="temperature", unit="degC")
    mass = within(density, 0, 1060, name="density", unit="kg/m^3", above=True)
    broadcast(wavelength=vacuum, temperature=degrees, density=mass)
    d = mass / 1000.0
    t = (degrees + 273.15) / 273.15
    square = (vacuum / 589e-9) ** 2
    ultraviolet = square - 0.229202**2
    infrared = square - 5.432937**2
    polynomial = (
        0.244257733
        + 9.74634476e-3 * d
        - 3.73234996e-3 * t
        + 2.68678472e-4 * square * t
        + 1.58920570e-3 / square
        + 2.45934259e-3 / ultraviolet
        + 0.900704920 / infrared
        - 1.66626219e-2 * d**2
    )
    # L d/dL of a function of L^2 is twice L^2 times its derivative.
    slope = (
        2
        * square
        * (
            2.68678472e-4 * t
            - 1.58920570e-3 / square**2
            - 2.45934259e-3 / ultraviolet**2
            - 0.900704920 / infrared**2
        )
    )
    return d * polynomial, d * slope
