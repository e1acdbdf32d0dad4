r"""Case-1 water: open ocean with optical properties fixed by its chlorophyll.

References
----------
.. [1] A. Bricaud, A. Morel, M. Babin, K. Allali and H. Claustre, J. Geophys. Res. 103,
   31033 (1998), :doi:`10.1029/98JC02712`.
.. [2] A. Morel and S. Maritorena, J. Geophys. Res. 106, 7163 (2001),
   :doi:`10.1029/2000JC000319`.
.. [3] H. Loisel and A. Morel, Limnol. Oceanogr. 43, 847 (1998),
   :doi:`10.4319/lo.1998.43.5.0847`.
.. [4] A. Morel and L. Prieur, Limnol. Oceanogr. 22, 709 (1977); A. Bricaud, A. Morel
   and L. Prieur, Limnol. Oceanogr. 26, 43 (1981) for the slope.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics import _tables
from amulor.optics._bounds import broadcast, not_negative, within

__all__ = [
    "CDOM_FRACTION",
    "CDOM_SLOPE",
    "cdom_absorption",
    "particle_absorption",
    "particle_backscattering",
    "particle_scattering",
    "phytoplankton_absorption",
]

_Array = NDArray[np.float64]

CDOM_FRACTION = 0.2
"""Ratio of dissolved-matter to particle absorption at 440 nm, ref. [2] [1]."""

CDOM_SLOPE = 0.014e9
"""Spectral slope S of dissolved-matter absorption, ref. [4]: 0.014 per nm [1/m]."""

#: Chlorophyll of the data that the laws were fitted to [mg/m^3].
_LOWEST, _HIGHEST = 0.02, 30.0
_REFERENCE = 440e-9
_GREEN = 550e-9


def phytoplankton_absorption(
    wavelength: ArrayLike, *, chlorophyll: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the absorption coefficient of living phytoplankton [1/m].

    Parameters
    ----------
    wavelength : array_like
        Wavelength in vacuum, 400e-9 to 700e-9 [m].
    chlorophyll : array_like
        Concentration of chlorophyll a, 0.02 to 30 [mg/m^3].

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
    :math:`a_{ph} = A(\lambda) \, \mathrm{Chl}^{E(\lambda)}`, ref. [1] of this module,
    2 nm steps, linear in between. At 440 nm the data scatter by a factor of about 2.

    Examples
    --------
    >>> print(f"{phytoplankton_absorption(440e-9, chlorophyll=1.0):.4f} 1/m")
    0.0378 1/m
    """
    return _power_law(wavelength, chlorophyll, column=3)


def particle_absorption(
    wavelength: ArrayLike, *, chlorophyll: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the absorption coefficient of phytoplankton and detritus together [1/m].

    Parameters
    ----------
    wavelength : array_like
        Wavelength in vacuum, 400e-9 to 700e-9 [m].
    chlorophyll : array_like
        Concentration of chlorophyll a, 0.02 to 30 [mg/m^3].

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
    :math:`a_p = A(\lambda) \, \mathrm{Chl}^{E(\lambda)}`, ref. [1] of this module.

    Examples
    --------
    >>> print(f"{particle_absorption(440e-9, chlorophyll=1.0):.4f} 1/m")
    0.0520 1/m
    """
    return _power_law(wavelength, chlorophyll, column=1)


def cdom_absorption(
    wavelength: ArrayLike,
    *,
    absorption_at_440: ArrayLike,
    cdom_slope: ArrayLike = CDOM_SLOPE,
) -> NDArray[np.float64]:
    r"""Return the absorption coefficient of colored dissolved organic matter [1/m].

    Parameters
    ----------
    wavelength : array_like
        Wavelength in vacuum, 350e-9 to 700e-9 [m].
    absorption_at_440 : array_like
        Absorption coefficient at 440 nm, not negative [1/m].
    cdom_slope : array_like
        Spectral slope S, not negative [1/m].

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
    :math:`a(440) \, e^{-S (\lambda - 440 \mathrm{nm})}`, ref. [4] of this module.

    Examples
    --------
    >>> print(f"{cdom_absorption(490e-9, absorption_at_440=0.01):.5f} 1/m")
    0.00497 1/m
    """
    vacuum = within(wavelength, 350e-9, 700e-9, name="wavelength", unit="m")
    at_440 = not_negative(absorption_at_440, name="absorption_at_440", unit="1/m")
    steep = not_negative(cdom_slope, name="cdom_slope", unit="1/m")
    broadcast(wavelength=vacuum, absorption_at_440=at_440, cdom_slope=steep)
    return np.asarray(at_440 * np.exp(-steep * (vacuum - _REFERENCE)))


def particle_scattering(
    wavelength: ArrayLike, *, chlorophyll: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the scattering coefficient of particles in case-1 water [1/m].

    Parameters
    ----------
    wavelength : array_like
        Wavelength in vacuum, 400e-9 to 700e-9 [m].
    chlorophyll : array_like
        Concentration of chlorophyll a, 0.02 to 30 [mg/m^3].

    Returns
    -------
    ndarray
        Scattering coefficient, of the broadcast shape [1/m].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    :math:`b_p = 0.416 \, \mathrm{Chl}^{0.766} \, (550 \mathrm{nm} / \lambda)`, refs.
    [2] and [3] of this module: 0.347 1/m at 660 nm for 1 mg/m^3.

    Examples
    --------
    >>> print(f"{particle_scattering(660e-9, chlorophyll=1.0):.3f} 1/m")
    0.347 1/m
    """
    vacuum, pigment = _checked(wavelength, chlorophyll)
    return np.asarray(0.416 * pigment**0.766 * _GREEN / vacuum)


def particle_backscattering(
    wavelength: ArrayLike, *, chlorophyll: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the backscattering coefficient of particles in case-1 water [1/m].

    Parameters
    ----------
    wavelength : array_like
        Wavelength in vacuum, 400e-9 to 700e-9 [m].
    chlorophyll : array_like
        Concentration of chlorophyll a, 0.02 to 30 [mg/m^3].

    Returns
    -------
    ndarray
        Backscattering coefficient, of the broadcast shape [1/m].

    Raises
    ------
    ValueError
        If an argument is outside of its range.

    Notes
    -----
    Ref. [2] of this module,

    .. math::

       b_{bp} = \left[0.002 + 0.01 \left(0.5 - 0.25 \log_{10} \mathrm{Chl}\right)
           \left(\frac{\lambda}{550 \mathrm{nm}}\right)^v\right]
           0.416 \, \mathrm{Chl}^{0.766},

    :math:`v = (\log_{10} \mathrm{Chl} - 0.3) / 2` up to 2 mg/m^3, 0 beyond.

    Examples
    --------
    >>> print(f"{particle_backscattering(550e-9, chlorophyll=1.0):.5f} 1/m")
    0.00291 1/m
    """
    vacuum, pigment = _checked(wavelength, chlorophyll)
    decades = np.log10(pigment)
    power = np.where(pigment <= 2, (decades - 0.3) / 2, 0.0)
    tilt = (vacuum / _GREEN) ** power
    fraction = 0.002 + 0.01 * (0.5 - 0.25 * decades) * tilt
    return np.asarray(fraction * 0.416 * pigment**0.766)


def _power_law(wavelength: ArrayLike, chlorophyll: ArrayLike, *, column: int) -> _Array:
    """Return the absorption A Chl^E, with A and E from two table columns [1/m]."""
    vacuum, pigment = _checked(wavelength, chlorophyll)
    table = _tables.numbers("bricaud_1998.csv")
    grid = table[:, 0] * 1e-9
    factor = np.interp(vacuum, grid, table[:, column])
    power = np.interp(vacuum, grid, table[:, column + 1])
    return np.asarray(factor * pigment**power)


def _checked(wavelength: ArrayLike, chlorophyll: ArrayLike) -> tuple[_Array, _Array]:
    vacuum = within(wavelength, 400e-9, 700e-9, name="wavelength", unit="m")
    pigment = within(chlorophyll, _LOWEST, _HIGHEST, name="chlorophyll", unit="mg/m^3")
    broadcast(wavelength=vacuum, chlorophyll=pigment)
    return vacuum, pigment
