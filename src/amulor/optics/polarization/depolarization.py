r"""Depolarization measures of Mueller matrices, and physical realizability.

Conventions are those of `amulor.optics.polarization.mueller`. Equation numbers are
those of R. Ricci et al., EURASIP J. Adv. Signal Process. 2010, 958360,
doi:10.1155/2010/958360, as rederived.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import above_zero, not_negative
from amulor.optics.polarization.mueller import as_matrices

__all__ = [
    "coherency_matrix",
    "depolarization_effect",
    "depolarization_index",
    "is_realizable",
    "realizability_defect",
]


def depolarization_index(mueller: ArrayLike) -> NDArray[np.float64]:
    r"""Return the depolarization index of a Mueller matrix (Gil and Bernabeu).

    Parameters
    ----------
    mueller : array_like
        Mueller matrices, last axes (4, 4), m11 above zero [1].

    Returns
    -------
    ndarray
        0 for an ideal depolarizer, 1 for no depolarization, shape of `mueller`
        without the last two axes [1].

    Raises
    ------
    ValueError
        If the last axes are not (4, 4) or an m11 is not above zero.

    Notes
    -----
    Eq. (61), :math:`[(\sum_{ij} m_{ij}^2 - 1) / 3]^{1/2}` of the matrix over its
    first element (J. J. Gil and E. Bernabeu, Opt. Acta 33, 185 (1986)).

    Examples
    --------
    >>> from amulor.optics.polarization import mueller
    >>> print(f"{depolarization_index(mueller.painted_metal()):.4f}")
    0.5644
    """
    reduced = _reduced(mueller).reshape(*np.shape(mueller)[:-2], 16)
    index: NDArray[np.float64] = np.linalg.norm(reduced[..., 1:], axis=-1) / np.sqrt(3)
    return index


def depolarization_effect(mueller: ArrayLike) -> NDArray[np.float64]:
    r"""Return the mean modulus of the reduced Mueller elements m22, m33 and m44.

    Parameters
    ----------
    mueller : array_like
        Mueller matrices, last axes (4, 4), m11 above zero [1].

    Returns
    -------
    ndarray
        0 for an ideal depolarizer, 1 for no depolarization of a diagonal matrix,
        shape of `mueller` without the last two axes [1].

    Raises
    ------
    ValueError
        If the last axes are not (4, 4) or an m11 is not above zero.

    Notes
    -----
    :math:`\tfrac13 (|m_{22}| + |m_{33}| + |m_{44}|)` of the matrix over its first
    element, an interpretation of eq. (61) that meets both limits. For a diagonal matrix
    it is 1 less the depolarization power of S.-Y. Lu and R. A. Chipman, J. Opt. Soc.
    Am. A 13, 1106 (1996).

    Examples
    --------
    >>> from amulor.optics.polarization import mueller
    >>> print(f"{depolarization_effect(mueller.painted_metal()):.2f}")
    0.56
    """
    reduced = np.diagonal(_reduced(mueller), axis1=-2, axis2=-1)
    mean: NDArray[np.float64] = np.abs(reduced[..., 1:]).mean(axis=-1)
    return mean


def coherency_matrix(mueller: ArrayLike) -> NDArray[np.complex128]:
    r"""Return the coherency matrix of a Mueller matrix.

    Parameters
    ----------
    mueller : array_like
        Mueller matrices, last axes (4, 4) [1].

    Returns
    -------
    ndarray
        Hermitian matrix with the trace m11, shape of `mueller` [1].

    Raises
    ------
    ValueError
        If the last axes are not (4, 4).

    Notes
    -----
    :math:`\tfrac14 \sum_{ij} m_{ij} \, \sigma_i \otimes \sigma_j^*` with the unit and
    Pauli matrices in the order of (I, Q, U, V) (S. R. Cloude, Optik 75, 26 (1986)). A
    Mueller matrix is a mixture of non-depolarizing matrices exactly if its coherency
    matrix has no negative eigenvalue.

    Examples
    --------
    >>> values = np.linalg.eigvalsh(coherency_matrix(np.eye(4)))
    >>> print(np.round(np.abs(values), 12))
    [0. 0. 0. 1.]
    """
    matrix = as_matrices(mueller)
    coherency: NDArray[np.complex128] = (
        np.einsum("...ij,ijkl->...kl", matrix, _PAULI_PRODUCTS) / 4
    )
    return coherency


def realizability_defect(mueller: ArrayLike) -> NDArray[np.float64]:
    """Return the modulus of the most negative coherency eigenvalue, 0 if realizable.

    Parameters
    ----------
    mueller : array_like
        Mueller matrices, last axes (4, 4), m11 above zero [1].

    Returns
    -------
    ndarray
        Size of the most negative eigenvalue of the coherency matrix over its trace,
        0 if there is none, shape of `mueller` without the last two axes [1].

    Raises
    ------
    ValueError
        If the last axes are not (4, 4) or an m11 is not above zero.

    Notes
    -----
    Condition of Cloude, see `coherency_matrix`. Rounding leaves defects of about
    1e-16.

    Examples
    --------
    >>> from amulor.optics.polarization import mueller
    >>> print(f"{realizability_defect(mueller.diagonal(0.61, -0.61, -0.10)):.2f}")
    0.03
    """
    values = np.linalg.eigvalsh(coherency_matrix(_reduced(mueller)))
    defect: NDArray[np.float64] = np.maximum(-values[..., 0], 0.0)
    return defect


def is_realizable(mueller: ArrayLike, *, tolerance: float = 1e-9) -> NDArray[np.bool_]:
    """Return whether a Mueller matrix is physically realizable.

    Parameters
    ----------
    mueller : array_like
        Mueller matrices, last axes (4, 4), m11 above zero [1].
    tolerance : float
        Largest `realizability_defect` that passes, not negative [1].

    Returns
    -------
    ndarray
        Shape of `mueller` without the last two axes.

    Raises
    ------
    ValueError
        If the last axes are not (4, 4), an m11 is not above zero, or the tolerance
        is negative.

    Notes
    -----
    Condition of Cloude, see `coherency_matrix`. Measured matrices need a tolerance
    of the size of their noise.

    Examples
    --------
    >>> from amulor.optics.polarization import mueller
    >>> print(is_realizable(mueller.painted_metal()))
    True
    >>> print(is_realizable(mueller.diagonal(1, 1, -1)))
    False
    """
    not_negative(tolerance, name="tolerance")
    return np.asarray(realizability_defect(mueller) <= tolerance)


def _pauli_products() -> NDArray[np.complex128]:
    """Return Kronecker products of Pauli matrices with conjugate Pauli matrices."""
    pauli = np.array(
        [
            [[1, 0], [0, 1]],
            [[1, 0], [0, -1]],
            [[0, 1], [1, 0]],
            [[0, -1j], [1j, 0]],
        ]
    )
    product: NDArray[np.complex128] = np.einsum("iab,jcd->ijacbd", pauli, pauli.conj())
    return product.reshape(4, 4, 4, 4)


_PAULI_PRODUCTS = _pauli_products()


def _reduced(mueller: ArrayLike) -> NDArray[np.float64]:
    """Return Mueller matrices divided by m11; ValueError if m11 is not above 0."""
    matrix = as_matrices(mueller)
    first = matrix[..., :1, :1]
    above_zero(first[..., 0, 0], name="m11 of mueller", hint="there is no light else")
    return matrix / first
