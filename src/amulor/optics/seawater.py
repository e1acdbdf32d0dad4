r"""Optical constants of pure fresh and sea water: indices and absorption.

Rays bend by the phase index, the modulation travels by the group index. Every
wavelength is the one in vacuum.

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
.. [6] R. M. Pope and E. S. Fry, Appl. Opt. 36, 8710 (1997),
   :doi:`10.1364/AO.36.008710`.
.. [7] J. D. Mason, M. T. Cone and E. S. Fry, Appl. Opt. 55, 7163 (2016),
   :doi:`10.1364/AO.55.007163`.
.. [8] R. Roettgers, D. McKee and C. Utschig, Opt. Express 22, 25093 (2014),
   :doi:`10.1364/OE.22.025093`.
.. [9] R. C. Millard and G. Seaver, Deep-Sea Res. 37, 1909 (1990),
   :doi:`10.1016/0198-0149(90)90086-B`.
"""

from __future__ import annotations

from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = [
    "group_index",
    "iapws_group_index",
    "iapws_refractive_index",
    "mason_absorption",
    "pope_fry_absorption",
    "refractive_index",
    "refractive_index_vacuum",
]

AIR_REFRACTIVE_INDEX = 1.000283
"""Index of standard air (15 degC, 101325 Pa) at 0.40 um, by ref. [3] above [1]."""


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

    The fit was made for salinities up to 35 and is carried on to 43 here, which
    covers the Mediterranean and the Red Sea. It is linear in salinity; ref. [4]
    uses it at 38.4 and ref. [5] tests it up to 121 g/kg. From the form of Millard
    and Seaver, ref. [9], made for 0 to 40 and 500 to 700 nm, it departs by at most
    4.2e-5 at salinity 35, 4.7e-5 at 40 and 5.0e-5 at 43. The effect of depth is
    left out: some 1.5e-4 per 100 m.

    Examples
    --------
    >>> index = refractive_index(405e-9, temperature=20, salinity=35)
    >>> print(f"{index:.6f}")
    1.349455
    """
    offset, slope, salt = _quan_fry_terms(temperature, salinity)
    inverse = 1e-9 / _within(wavelength, 400e-9, 700e-9, name="wavelength", unit="m")
    curvature = -4382.0 * inverse**2 + 1.1455e6 * inverse**3
    return offset + salt + slope * inverse + curvature


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
    r"""Return the index by which the modulation envelope travels in sea water.

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
    :math:`\lambda^{-p}` of the index counts :math:`1 + p` times in it. A slope is
    less certain than a value: for fresh water the result lies within 6e-4 of
    `iapws_group_index`, 3.4e-4 above it at 405 nm and 20 degC. The dispersion of
    the air, left out, would add 3e-5 at 405 nm.

    Examples
    --------
    >>> index = group_index(405e-9, temperature=20, salinity=0)
    >>> print(f"{index:.4f}")
    1.3804
    """
    offset, slope, salt = _quan_fry_terms(temperature, salinity)
    inverse = 1e-9 / _within(wavelength, 400e-9, 700e-9, name="wavelength", unit="m")
    curvature = -3 * 4382.0 * inverse**2 + 4 * 1.1455e6 * inverse**3
    return AIR_REFRACTIVE_INDEX * (offset + salt + 2 * slope * inverse + curvature)


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
    r"""Return the index by which the modulation envelope travels in fresh water.

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


def pope_fry_absorption(wavelength: ArrayLike) -> NDArray[np.float64]:
    """Return the absorption of pure water as measured by Pope and Fry.

    Parameters
    ----------
    wavelength : array_like
        Wavelength in vacuum, 380e-9 to 727.5e-9 [m].

    Returns
    -------
    ndarray
        Absorption coefficient at 22 degC, of the shape of `wavelength` [1/m].

    Raises
    ------
    ValueError
        If a wavelength is outside of the table.

    Notes
    -----
    Table of ref. [6] of this module, 2.5 nm steps, linear in between. Below 450 nm
    it lies above later work: at 405 nm it is twice `mason_absorption`. Say which of
    the two is used.

    Examples
    --------
    >>> print(f"{pope_fry_absorption(440e-9):.5f} 1/m")
    0.00635 1/m
    """
    table = _table("pope_fry_1997.csv")
    grid = table[:, 0] * 1e-9
    inside = _within(wavelength, grid[0], grid[-1], name="wavelength", unit="m")
    return np.interp(inside, grid, table[:, 1])


def mason_absorption(
    wavelength: ArrayLike, *, temperature: ArrayLike, salinity: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the absorption of pure sea water, after Mason et al. below 510 nm.

    Parameters
    ----------
    wavelength : array_like
        Wavelength in vacuum, 300e-9 to 900e-9 [m].
    temperature : array_like
        Water temperature, 0 to 30 [degC].
    salinity : array_like
        Salinity, 0 (fresh water) to 43, practical or in parts per thousand [1].

    Returns
    -------
    ndarray
        Absorption coefficient, of the broadcast shape [1/m].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    Table of the Water Optical Properties Processor, version 3 (2016): ref. [7] of
    this module from 300 to 510 nm, ref. [6] and others above; derivatives of
    ref. [8]:

    .. math::

       a(T, S) = a_{20, 0}
           + (T - 20) \frac{\partial a}{\partial T} + S \frac{\partial a}{\partial S},

    2 nm steps, linear in between. The table gives no salinity derivative below
    448 nm. Its standard uncertainty at 405 nm is 0.0003 1/m.

    Examples
    --------
    >>> absorption = mason_absorption(410e-9, temperature=20, salinity=0)
    >>> print(f"{absorption:.5f} 1/m")
    0.00266 1/m
    """
    table = _table("wopp_v3_mason_2016.csv")
    grid = table[:, 0] * 1e-9
    inside = _within(wavelength, grid[0], grid[-1], name="wavelength", unit="m")
    degrees = _within(temperature, 0, 30, name="temperature", unit="degC")
    salt = _within(salinity, 0, 43, name="salinity", unit="permille")
    reference, per_salinity, per_degree = (
        np.interp(inside, grid, table[:, column]) for column in (1, 2, 3)
    )
    return reference + (degrees - 20) * per_degree + salt * per_salinity


def _quan_fry_terms(
    temperature: ArrayLike, salinity: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the terms in T alone, in 1/L [nm] and in S alone of Quan and Fry."""
    t = _within(temperature, 0, 30, name="temperature", unit="degC")
    s = _within(salinity, 0, 43, name="salinity", unit="permille")
    offset = 1.31405 - 2.02e-6 * t**2
    slope = 15.868 + 0.01155 * s - 0.00423 * t
    salt = (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t**2) * s
    return offset, slope, salt


def _lorentz_lorenz(
    wavelength: ArrayLike, temperature: ArrayLike, density: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the ratio (n^2 - 1)/(n^2 + 2) of IAPWS R9-97 and L times its slope."""
    vacuum = _within(wavelength, 200e-9, 1100e-9, name="wavelength", unit="m")
    degrees = _within(temperature, -12, 500, name="temperature", unit="degC")
    mass = np.asarray(density, dtype=np.float64)
    if not np.all((mass > 0) & (mass <= 1060)):
        raise ValueError(
            "density must be above 0 and at most 1060 kg/m^3, got values from "
            f"{np.min(mass):g} to {np.max(mass):g} kg/m^3"
        )
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


def _within(
    value: ArrayLike, low: float, high: float, *, name: str, unit: str
) -> NDArray[np.float64]:
    """Return the value as an array, refused outside of low..high."""
    array = np.asarray(value, dtype=np.float64)
    rounding = 1e-12 * high  # 700 * 1e-9 is above 700e-9
    if not np.all((array >= low - rounding) & (array <= high + rounding)):
        raise ValueError(
            f"{name} must be from {low:g} to {high:g} {unit}, got values from "
            f"{np.min(array):g} to {np.max(array):g} {unit}"
        )
    return array


@cache
def _table(name: str) -> NDArray[np.float64]:
    """Return a table of this package, read once and not writable."""
    source = resources.files("amulor.optics").joinpath("data", name)
    with source.open(encoding="utf-8") as lines:
        table = np.loadtxt(lines, delimiter=",")
    table.flags.writeable = False
    return table
