r"""Stokes vectors: named states, degrees of polarization, polarization ellipse.

Convention. The last axis of every vector is (I, Q, U, V). The field has components
along a parallel and a perpendicular axis, and parallel x perpendicular is the
direction of travel; complex amplitudes go with :math:`e^{-i \omega t}`. Then

.. math::

   I = \langle |E_\parallel|^2 + |E_\perp|^2 \rangle, \quad
   Q = \langle |E_\parallel|^2 - |E_\perp|^2 \rangle, \quad
   U = 2 \operatorname{Re} \langle E_\parallel E_\perp^* \rangle, \quad
   V = 2 \operatorname{Im} \langle E_\parallel E_\perp^* \rangle,

eq. (59) of R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
doi:10.1155/2010/958360, as rederived, where the sign of V is left open. Here

* Q is parallel (H, horizontal) less perpendicular (V, vertical);
* U is light passing at +45 degrees (P) less light passing at -45 degrees (M), positive
  angles turning from the parallel to the perpendicular axis, anticlockwise for an
  observer who faces the light;
* V is right (R) less left (L) circular; in right circular light the field turns
  clockwise for that observer. R is (1, 0, 0, 1).

A reflection reverses the direction of travel and with it the perpendicular axis, so a
mirror swaps P and M, and R and L, but keeps H and V.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import above_zero, broadcast, last_axes

__all__ = [
    "degree_of_circular_polarization",
    "degree_of_linear_polarization",
    "degree_of_polarization",
    "ellipticity_angle",
    "from_field",
    "pair_states",
    "polarization_angle",
    "state",
]

#: A pair of launched and analysed state, or no polarizers, as a regular expression.
PAIR_PATTERN = "none|[HVPMRL][HVPMRL]"

_STATES = {
    "H": (1.0, 1.0, 0.0, 0.0),
    "V": (1.0, -1.0, 0.0, 0.0),
    "P": (1.0, 0.0, 1.0, 0.0),
    "M": (1.0, 0.0, -1.0, 0.0),
    "R": (1.0, 0.0, 0.0, 1.0),
    "L": (1.0, 0.0, 0.0, -1.0),
    "none": (1.0, 0.0, 0.0, 0.0),
}


def state(name: str) -> NDArray[np.float64]:
    """Return the unit-intensity Stokes vector of a named polarization state.

    Parameters
    ----------
    name : str
        "H", "V" (linear, parallel and perpendicular), "P", "M" (linear at +45 and
        -45 degrees), "R", "L" (right and left circular), or "none" (unpolarized).

    Returns
    -------
    ndarray
        Stokes vector, shape (4,) [1].

    Raises
    ------
    ValueError
        If there is no state of this name.

    Notes
    -----
    Eq. (59) of Ricci et al. 2010, as rederived, with the convention of this module.

    Examples
    --------
    >>> print(state("R"))
    [1. 0. 0. 1.]
    """
    if name not in _STATES:
        names = ", ".join(repr(names) for names in _STATES)
        raise ValueError(f"the polarization state must be one of {names}, got {name!r}")
    return np.array(_STATES[name])


def pair_states(pair: str) -> tuple[str, str]:
    """Return the launched and the analyzed state of a pair, such as VH.

    Parameters
    ----------
    pair : str
        Two letters, launched first, such as "VH", or "none" for no polarizers.

    Returns
    -------
    tuple of two str
        Names of the launched and the analysed state as in `state`; both "none" for
        "none".

    Raises
    ------
    ValueError
        If the pair is unknown.

    Examples
    --------
    >>> pair_states("VH")
    ('V', 'H')
    """
    if pair == "none":
        return "none", "none"
    if not re.fullmatch(PAIR_PATTERN, pair):
        raise ValueError(
            "pair must be 'none' or two letters out of H, V, P, M, R, L, launched "
            f"first and analysed second, such as 'VH'; got {pair!r}"
        )
    return pair[0], pair[1]


def from_field(parallel: ArrayLike, perpendicular: ArrayLike) -> NDArray[np.float64]:
    r"""Return the Stokes vector of light with two complex field amplitudes.

    Parameters
    ----------
    parallel : array_like
        Complex amplitude along the parallel axis, with exp(-i omega t), any unit.
    perpendicular : array_like
        Complex amplitude along the perpendicular axis, same unit.

    Returns
    -------
    ndarray
        Stokes vector, broadcast shape with a last axis (4,) [unit^2].

    Notes
    -----
    Eq. (59) of Ricci et al. 2010, as rederived, without the average: the light is
    fully polarized.

    Examples
    --------
    >>> print(from_field(3.0, 1.0 - 2.0j))
    [14.  4.  6. 12.]
    """
    along = np.asarray(parallel, dtype=np.complex128)
    across = np.asarray(perpendicular, dtype=np.complex128)
    broadcast(parallel=along, perpendicular=across)
    along, across = np.broadcast_arrays(along, across)
    product = along * across.conj()
    first, second = np.abs(along) ** 2, np.abs(across) ** 2
    return np.stack(
        [first + second, first - second, 2 * product.real, 2 * product.imag], axis=-1
    )


def degree_of_polarization(stokes: ArrayLike) -> NDArray[np.float64]:
    r"""Return the degree of polarization, from 0 to 1.

    Parameters
    ----------
    stokes : array_like
        Stokes vectors, last axis (4,), any unit.

    Returns
    -------
    ndarray
        :math:`\sqrt{Q^2 + U^2 + V^2} / I`, shape of `stokes` without the last axis [1].
        With noise, measured vectors may exceed 1.

    Raises
    ------
    ValueError
        If the last axis is not 4 long or an intensity is not above zero.

    Notes
    -----
    From eq. (59) of Ricci et al. 2010, as rederived.

    Examples
    --------
    >>> print(f"{degree_of_polarization([1.0, 0.61, 0.0, 0.0]):.2f}")
    0.61
    """
    vector = _stokes(stokes)
    polarized: NDArray[np.float64] = np.linalg.norm(vector[..., 1:], axis=-1)
    return polarized / vector[..., 0]


def degree_of_linear_polarization(stokes: ArrayLike) -> NDArray[np.float64]:
    r"""Return the degree of linear polarization, from 0 to 1.

    Parameters
    ----------
    stokes : array_like
        Stokes vectors, last axis (4,), any unit.

    Returns
    -------
    ndarray
        :math:`\sqrt{Q^2 + U^2} / I`, shape of `stokes` without the last axis [1].

    Raises
    ------
    ValueError
        If the last axis is not 4 long or an intensity is not above zero.

    Notes
    -----
    From eq. (59) of Ricci et al. 2010, as rederived; the 61 % of eq. (68).

    Examples
    --------
    >>> print(f"{degree_of_linear_polarization([2.0, 0.6, 0.8, 1.0]):.2f}")
    0.50
    """
    vector = _stokes(stokes)
    return np.hypot(vector[..., 1], vector[..., 2]) / vector[..., 0]


def degree_of_circular_polarization(stokes: ArrayLike) -> NDArray[np.float64]:
    r"""Return the signed degree of circular polarization, from -1 to 1.

    Parameters
    ----------
    stokes : array_like
        Stokes vectors, last axis (4,), any unit.

    Returns
    -------
    ndarray
        :math:`V / I`, positive for right circular, shape of `stokes` without the
        last axis [1].

    Raises
    ------
    ValueError
        If the last axis is not 4 long or an intensity is not above zero.

    Notes
    -----
    From eq. (59) of Ricci et al. 2010, as rederived; the sign is that of this module's
    convention.

    Examples
    --------
    >>> print(f"{degree_of_circular_polarization([2.0, 0.6, 0.8, -1.0]):.2f}")
    -0.50
    """
    vector = _stokes(stokes)
    return vector[..., 3] / vector[..., 0]


def polarization_angle(stokes: ArrayLike) -> NDArray[np.float64]:
    r"""Return the orientation angle of the polarization ellipse [rad].

    Parameters
    ----------
    stokes : array_like
        Stokes vectors, last axis (4,), any unit.

    Returns
    -------
    ndarray
        :math:`\tfrac12 \operatorname{atan2}(U, Q)` from the parallel axis, -pi/2 to
        pi/2, shape of `stokes` without the last axis [rad]. Without a linear part
        it has no meaning.

    Raises
    ------
    ValueError
        If the last axis is not 4 long or an intensity is not above zero.

    Notes
    -----
    From eq. (59) of Ricci et al. 2010, as rederived.

    Examples
    --------
    >>> print(f"{np.degrees(polarization_angle(state('M'))):.0f} degrees")
    -45 degrees
    """
    vector = _stokes(stokes)
    return np.arctan2(vector[..., 2], vector[..., 1]) / 2


def ellipticity_angle(stokes: ArrayLike) -> NDArray[np.float64]:
    r"""Return the ellipticity angle of the polarization ellipse [rad].

    Parameters
    ----------
    stokes : array_like
        Stokes vectors, last axis (4,), any unit.

    Returns
    -------
    ndarray
        :math:`\tfrac12 \operatorname{atan2}(V, \sqrt{Q^2 + U^2})`, whose tangent is
        the ratio of the axes; pi/4 for right and -pi/4 for left circular, shape of
        `stokes` without the last axis [rad].

    Raises
    ------
    ValueError
        If the last axis is not 4 long or an intensity is not above zero.

    Notes
    -----
    From eq. (59) of Ricci et al. 2010, as rederived; the sign is that of this module's
    convention.

    Examples
    --------
    >>> print(f"{np.degrees(ellipticity_angle(state('R'))):.0f} degrees")
    45 degrees
    """
    vector = _stokes(stokes)
    return np.arctan2(vector[..., 3], np.hypot(vector[..., 1], vector[..., 2])) / 2


def _stokes(stokes: ArrayLike) -> NDArray[np.float64]:
    """Return Stokes vectors as an array; ValueError unless intensities are above 0."""
    vector = last_axes(stokes, (4,), name="stokes", meaning="(I, Q, U, V)")
    above_zero(vector[..., 0], name="the intensity I of stokes")
    return vector
