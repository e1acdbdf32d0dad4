r"""Absorption of pure fresh water and sea water, from two published sources.

At 405 nm Pope and Fry give twice the absorption of Mason, Cone and Fry. By default
amulor uses `mason_absorption`. It is the later measurement of the same laboratory, with
a cavity sensitive enough for the blue, an uncertainty, and terms for temperature and
salinity. `pope_fry_absorption` serves for comparison with older work.

References
----------
.. [1] R. M. Pope and E. S. Fry, Appl. Opt. 36, 8710 (1997),
   :doi:`10.1364/AO.36.008710`.
.. [2] J. D. Mason, M. T. Cone and E. S. Fry, Appl. Opt. 55, 7163 (2016),
   :doi:`10.1364/AO.55.007163`.
.. [3] R. Roettgers, D. McKee and C. Utschig, Opt. Express 22, 25093 (2014),
   :doi:`10.1364/OE.22.025093`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics import _tables
from amulor.optics._bounds import broadcast, within
from amulor.optics.water import _quan_fry

__all__ = ["mason_absorption", "mason_absorption_uncertainty", "pope_fry_absorption"]


def pope_fry_absorption(wavelength: ArrayLike) -> NDArray[np.float64]:
    """Return the absorption coefficient of pure water, Pope and Fry 1997 [1/m].

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
    Table of ref. [1] of this module, 2.5 nm steps, linear in between. Below 450 nm it
    lies above later work: at 405 nm it is twice `mason_absorption`. State which of the
    two is used.

    Examples
    --------
    >>> print(f"{pope_fry_absorption(440e-9):.5f} 1/m")
    0.00635 1/m
    """
    table = _tables.numbers("pope_fry_1997.csv")
    grid = table[:, 0] * 1e-9
    inside = within(wavelength, grid[0], grid[-1], name="wavelength", unit="m")
    return np.interp(inside, grid, table[:, 1])


def mason_absorption(
    wavelength: ArrayLike, *, temperature: ArrayLike, salinity: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the absorption of pure or sea water, after Mason et al. below 510 nm.

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
    Table of the Water Optical Properties Processor, version 3 (2016): ref. [2] of
    this module from 300 to 510 nm, ref. [1] and others above; derivatives of
    ref. [3]:

    .. math::

       a(T, S) = a_{20, 0}
           + (T - 20) \frac{\partial a}{\partial T} + S \frac{\partial a}{\partial S},

    2 nm steps, linear in between. The table gives no salinity derivative below 448 nm;
    `mason_absorption_uncertainty` covers the neglected effect.

    Examples
    --------
    >>> absorption = mason_absorption(410e-9, temperature=20, salinity=0)
    >>> print(f"{absorption:.5f} 1/m")
    0.00266 1/m
    """
    columns, degrees, salt = _mason(wavelength, temperature, salinity)
    reference, per_salinity, per_degree = columns[:3]
    return reference + degrees * per_degree + salt * per_salinity


def mason_absorption_uncertainty(
    wavelength: ArrayLike, *, temperature: ArrayLike, salinity: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the standard uncertainty of `mason_absorption` [1/m].

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
        Standard uncertainty, of the broadcast shape [1/m].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    The three uncertainties of the table, taken as independent,

    .. math::

       \sigma^2 = \sigma_a^2 + (T - 20)^2 \sigma_T^2 + S^2 \sigma_S^2,

    2 nm steps, linear in between. At 405 nm it is 0.0003 1/m in fresh water of 20 degC
    and 0.0008 1/m at salinity 38, a third of the absorption: the effect of salt in the
    blue is poorly known.

    Examples
    --------
    >>> sigma = mason_absorption_uncertainty(410e-9, temperature=20, salinity=0)
    >>> print(f"{sigma:.5f} 1/m")
    0.00032 1/m
    """
    columns, degrees, salt = _mason(wavelength, temperature, salinity)
    reference, per_salinity, per_degree = columns[3:]
    return np.sqrt(
        reference**2 + (degrees * per_degree) ** 2 + (salt * per_salinity) ** 2
    )


def _mason(
    wavelength: ArrayLike, temperature: ArrayLike, salinity: ArrayLike
) -> tuple[list[NDArray[np.float64]], NDArray[np.float64], NDArray[np.float64]]:
    """Return interpolated table columns, temperature minus 20 degC, and salinity."""
    table = _tables.numbers("wopp_v3_mason_2016.csv")
    grid = table[:, 0] * 1e-9
    inside = within(wavelength, grid[0], grid[-1], name="wavelength", unit="m")
    degrees, salt = _quan_fry.state(temperature, salinity)
    broadcast(wavelength=inside, temperature=degrees, salinity=salt)
    columns = [np.interp(inside, grid, column) for column in table.T[1:]]
    return columns, degrees - 20, salt
