r"""Mueller matrices: algebra, targets, scattering particles, ideal analyzers.

Real polarizers and retarders are in `amulor.optics.polarization.components`, pairs of
states made with them in `amulor.optics.polarization.schemes`.

The last two axes are (4, 4), rows out, columns in. Stokes convention: that of
`amulor.optics.polarization.stokes`. The matrix of a scatterer or target converts from
the axes of incident light to those of outgoing light. Backscattering without
depolarization is therefore diag(1, 1, -1, -1). Equation numbers are those of R. Ricci
et al., EURASIP J. Adv. Signal Process. 2010, 958360, doi:10.1155/2010/958360, as
rederived.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import (
    broadcast,
    checked_angle,
    finite,
    last_axes,
    within,
)
from amulor.optics.polarization import stokes as _stokes

__all__ = [
    "apply",
    "as_matrices",
    "detected_fraction",
    "diagonal",
    "ideal_backscatter",
    "ideal_depolarizer",
    "painted_metal",
    "particles",
    "rayleigh",
    "rotated",
]


def diagonal(m22: ArrayLike, m33: ArrayLike, m44: ArrayLike) -> NDArray[np.float64]:
    """Return the reduced Mueller matrix diag(1, m22, m33, m44).

    Parameters
    ----------
    m22, m33, m44 : array_like
        Diagonal elements, each from -1 to 1 [1].

    Returns
    -------
    ndarray
        Mueller matrix, broadcast shape with last axes (4, 4) [1].

    Raises
    ------
    ValueError
        If an element is outside of -1 to 1.

    Notes
    -----
    The form of eqs. (65) and (67). Not every such matrix is physical: see
    `amulor.optics.polarization.depolarization.realizability_defect`.

    Examples
    --------
    >>> print(np.diag(diagonal(0.61, -0.61, -0.46)))
    [ 1.    0.61 -0.61 -0.46]
    """
    second = within(m22, -1, 1, name="m22")
    third = within(m33, -1, 1, name="m33")
    fourth = within(m44, -1, 1, name="m44")
    shape = broadcast(m22=second, m33=third, m44=fourth)
    matrix = np.zeros((*shape, 4, 4))
    matrix[..., 0, 0] = 1
    matrix[..., 1, 1] = second
    matrix[..., 2, 2] = third
    matrix[..., 3, 3] = fourth
    return matrix


def ideal_backscatter() -> NDArray[np.float64]:
    """Return the Mueller matrix of backscattering without depolarization.

    Returns
    -------
    ndarray
        The matrix diag(1, 1, -1, -1), shape (4, 4) [1]: a mirror, or Rayleigh
        scatterers and spheres at 180 degrees.

    Notes
    -----
    Eq. (65). The negative m44 means that the helicity is reversed.

    Examples
    --------
    >>> print(np.diag(ideal_backscatter()))
    [ 1.  1. -1. -1.]
    """
    return np.diag([1.0, 1.0, -1.0, -1.0])


def ideal_depolarizer() -> NDArray[np.float64]:
    """Return the Mueller matrix of a target that depolarizes light completely.

    Returns
    -------
    ndarray
        The matrix diag(1, 0, 0, 0), shape (4, 4) [1]: an ideal white Lambertian
        surface.

    Notes
    -----
    The limit of eq. (61) in which the depolarization index is zero.

    Examples
    --------
    >>> print(np.diag(ideal_depolarizer()))
    [1. 0. 0. 0.]
    """
    return np.diag([1.0, 0.0, 0.0, 0.0])


def painted_metal(*, m44: float = -0.46) -> NDArray[np.float64]:
    """Return the Mueller matrix of Ricci et al.'s painted metal target.

    Parameters
    ----------
    m44 : float
        Circular element, from -1 to -0.22, where the matrix is physical [1]. Its
        default is ASSUMED: only m22 = 0.61 was published.

    Returns
    -------
    ndarray
        The matrix diag(1, 0.61, -0.61, m44), shape (4, 4) [1].

    Raises
    ------
    ValueError
        If m44 is outside of its range.

    Notes
    -----
    Eq. (67). m33 = -m22 follows from rotational symmetry. m44 would be -0.22 by
    reciprocity at exactly 180 degrees and -0.61 for a mirror-like part with an ideal
    depolarizer; -0.46 puts circular below linear polarization by 0.15, the largest
    difference that DeBoo et al. [1]_ found on painted and similar samples.

    References
    ----------
    .. [1] B. J. DeBoo, J. M. Sasian and R. A. Chipman, Appl. Opt. 44, 5434 (2005),
       :doi:`10.1364/AO.44.005434`.

    Examples
    --------
    >>> print(np.diag(painted_metal()))
    [ 1.    0.61 -0.61 -0.46]
    """
    hint = "diag(1, 0.61, -0.61, m44) is realizable there only"
    last = within(m44, -1, -0.22, name="m44", hint=hint)
    return np.diag([1.0, 0.61, -0.61, float(last)])


def rayleigh(angle: ArrayLike) -> NDArray[np.float64]:
    r"""Return the reduced Mueller matrix of Rayleigh scattering at an angle.

    Parameters
    ----------
    angle : array_like
        Scattering angle, 0 to pi [rad].

    Returns
    -------
    ndarray
        Mueller matrix over its first element, shape of `angle` with last axes
        (4, 4) [1]. The parallel axis lies in the scattering plane.

    Raises
    ------
    ValueError
        If an angle is outside of its range.

    Notes
    -----
    Eqs. (63)-(64), without the molecular depolarization:

    .. math::

       m_{12} = m_{21} = -\frac{1 - \cos^2\theta}{1 + \cos^2\theta}, \quad
       m_{22} = 1, \quad
       m_{33} = m_{44} = \frac{2 \cos\theta}{1 + \cos^2\theta}.

    The first element itself goes as :math:`\tfrac34 (1 + \cos^2\theta) / 4\pi`.

    Examples
    --------
    >>> print(np.round(rayleigh(np.pi / 2)[0] + 0.0, 3))
    [ 1. -1.  0.  0.]
    """
    cosine = np.cos(checked_angle(angle, name="angle"))
    intensity = 1 + cosine**2
    along = 2 * cosine / intensity
    return particles(
        m12=-(1 - cosine**2) / intensity, m22=1.0, m33=along, m34=0.0, m44=along
    )


def particles(
    *, m12: ArrayLike, m22: ArrayLike, m33: ArrayLike, m34: ArrayLike, m44: ArrayLike
) -> NDArray[np.float64]:
    r"""Return the reduced Mueller matrix of randomly oriented particles.

    Parameters
    ----------
    m12 : array_like
        Element m12 = m21, from -1 to 1 [1].
    m22 : array_like
        Element m22, 1 for spheres and less for other shapes [1].
    m33 : array_like
        Element m33, from -1 to 1 [1].
    m34 : array_like
        Element m34 = -m43, from -1 to 1 [1].
    m44 : array_like
        Element m44, from -1 to 1; m33 for spheres [1].

    Returns
    -------
    ndarray
        Mueller matrix over its first element, of the broadcast shape with last axes
        (4, 4) [1]. The parallel axis lies in the scattering plane.

    Raises
    ------
    ValueError
        If an element is outside of -1 to 1.

    Notes
    -----
    Eq. (66), and with m34 = 0 eq. (63): the elements that symmetry permits for
    particles in random orientation, with as many mirror images. Not every such matrix
    is physical: see `amulor.optics.polarization.depolarization.realizability_defect`.

    Examples
    --------
    >>> milk = particles(m12=-0.1, m22=0.97, m33=-0.9, m34=0.1, m44=-0.88)
    >>> print(milk[2])
    [ 0.   0.  -0.9  0.1]
    """
    first = within(m12, -1, 1, name="m12")
    second = within(m22, -1, 1, name="m22")
    third = within(m33, -1, 1, name="m33")
    across = within(m34, -1, 1, name="m34")
    fourth = within(m44, -1, 1, name="m44")
    shape = broadcast(m12=first, m22=second, m33=third, m34=across, m44=fourth)
    matrix = np.zeros((*shape, 4, 4))
    matrix[..., 0, 0] = 1
    matrix[..., 0, 1] = matrix[..., 1, 0] = first
    matrix[..., 1, 1] = second
    matrix[..., 2, 2] = third
    matrix[..., 2, 3] = across
    matrix[..., 3, 2] = -across
    matrix[..., 3, 3] = fourth
    return matrix


def rotated(mueller: ArrayLike, *, angle: ArrayLike) -> NDArray[np.float64]:
    r"""Return the Mueller matrix of an element that is rotated about the beam.

    Parameters
    ----------
    mueller : array_like
        Mueller matrices of an element that light passes, last axes (4, 4) [1].
    angle : array_like
        Angle of rotation, from the parallel to the perpendicular axis [rad].

    Returns
    -------
    ndarray
        Mueller matrix, broadcast shape with last axes (4, 4) [1].

    Raises
    ------
    ValueError
        If the last axes are not (4, 4).

    Notes
    -----
    :math:`R(-\alpha) M R(\alpha)` with :math:`Q' = Q \cos 2\alpha + U \sin 2\alpha`,
    :math:`U' = -Q \sin 2\alpha + U \cos 2\alpha` for axes turned by :math:`\alpha`.
    Valid for elements in transmission. For a target rotated about the line of sight,
    the outgoing axes are reversed.

    Examples
    --------
    >>> polarizer = 0.5 * particles(m12=1.0, m22=1.0, m33=0.0, m34=0.0, m44=0.0)
    >>> print(np.round(rotated(polarizer, angle=np.pi / 2)[0], 12))
    [ 0.5 -0.5  0.   0. ]
    """
    turn = finite(angle, name="angle", unit="rad")
    matrix = as_matrices(mueller)
    broadcast(mueller=matrix[..., 0, 0], angle=turn)
    return _axes_turned(-turn) @ matrix @ _axes_turned(turn)


def apply(mueller: ArrayLike, stokes: ArrayLike) -> NDArray[np.float64]:
    """Return the Stokes vector of light after an optical element or a target.

    Parameters
    ----------
    mueller : array_like
        Mueller matrices, last axes (4, 4) [1].
    stokes : array_like
        Stokes vectors of the incident light, last axis (4,), any unit.

    Returns
    -------
    ndarray
        Stokes vectors, broadcast shape with a last axis (4,), same unit.

    Raises
    ------
    ValueError
        If the last axes are not (4, 4) and (4,).

    Notes
    -----
    Eq. (60) without the distance factor.

    Examples
    --------
    >>> print(apply(painted_metal(), [1.0, 1.0, 0.0, 0.0]))
    [1.   0.61 0.   0.  ]
    """
    vector = last_axes(stokes, (4,), name="stokes", meaning="(I, Q, U, V)")
    matrix = as_matrices(mueller)
    broadcast(mueller=matrix[..., 0, 0], stokes=vector[..., 0])
    out: NDArray[np.float64] = np.einsum("...ij,...j->...i", matrix, vector)
    return out


def detected_fraction(mueller: ArrayLike, *, pair: str) -> NDArray[np.float64]:
    r"""Return the detected fraction of launched light for an ideal polarizer pair [1].

    Parameters
    ----------
    mueller : array_like
        Mueller matrices of target or water, last axes (4, 4) [1].
    pair : str
        Launched state, and state that the ideal analyzer passes, such as "VV", "VH",
        "RR", "RL"; letters as in `amulor.optics.polarization.stokes.state`. "none"
        means no polarizer: unpolarized light, all of it detected.

    Returns
    -------
    ndarray
        Detected over launched power, shape of `mueller` without the last two axes
        [1].

    Raises
    ------
    ValueError
        If the last axes are not (4, 4) or the pair is unknown.

    Notes
    -----
    :math:`\tfrac12 \mathbf a \cdot M \mathbf s` with the Stokes vectors of launched
    state and analyzer, both of intensity 1; :math:`m_{11}` for "none". Eqs. (68) and
    (69). The analyzer's letter refers to the axes of the returning light: a mirror
    returns V as V, but R as L and P as M.

    Examples
    --------
    >>> for pair in ("VV", "VH", "RR", "RL"):
    ...     print(pair, f"{detected_fraction(painted_metal(), pair=pair):.3f}")
    VV 0.805
    VH 0.195
    RR 0.270
    RL 0.730
    """
    matrix = as_matrices(mueller)
    if pair == "none":
        return matrix[..., 0, 0].copy()
    first, second = _stokes.pair_states(pair)
    return apply(matrix, _stokes.state(first)) @ _stokes.state(second) / 2


def _axes_turned(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the Mueller matrix that converts a Stokes vector to rotated axes."""
    cosine, sine = np.cos(2 * angle), np.sin(2 * angle)
    matrix = np.zeros((*angle.shape, 4, 4))
    matrix[..., 0, 0] = matrix[..., 3, 3] = 1
    matrix[..., 1, 1] = matrix[..., 2, 2] = cosine
    matrix[..., 1, 2] = sine
    matrix[..., 2, 1] = -sine
    return matrix


def as_matrices(mueller: ArrayLike) -> NDArray[np.float64]:
    """Return Mueller matrices as an array, checked for last axes (4, 4).

    Parameters
    ----------
    mueller : array_like
        Mueller matrices [1].

    Returns
    -------
    ndarray
        The same as floats [1].

    Raises
    ------
    ValueError
        If the last axes are not (4, 4).

    Examples
    --------
    >>> as_matrices([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]).shape
    (4, 4)
    """
    return last_axes(mueller, (4, 4), name="mueller")
