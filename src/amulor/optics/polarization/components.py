r"""Mueller matrices of real polarizers, retarders and quarter-wave plates.

Conventions are those of `amulor.optics.polarization.stokes` and
`amulor.optics.polarization.mueller`; light passes the elements from the right of a
product to its left. None of these elements depolarizes, and none may transmit more
light than it receives.

References
----------
.. [1] S.-Y. Lu and R. A. Chipman, J. Opt. Soc. Am. A 13, 1106 (1996),
   :doi:`10.1364/JOSAA.13.001106`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amulor.optics._bounds import broadcast, finite, require, within
from amulor.optics.polarization.mueller import as_matrices, rotated

__all__ = ["largest_transmission", "linear_polarizer", "retarder"]


def linear_polarizer(
    angle: ArrayLike,
    *,
    extinction_ratio: ArrayLike = 0.0,
    transmission: ArrayLike = 1.0,
) -> NDArray[np.float64]:
    r"""Return the Mueller matrix of a real linear polarizer.

    Parameters
    ----------
    angle : array_like
        Transmitted direction, from the parallel to the perpendicular axis [rad].
    extinction_ratio : array_like
        Power that passes crossed over power that passes aligned, 0 (ideal) to 1
        (clear glass) [1]. A data sheet's 10 000:1 is 1e-4.
    transmission : array_like
        Fraction of aligned light that passes, 0 to 1 [1].

    Returns
    -------
    ndarray
        Mueller matrix, broadcast shape with last axes (4, 4) [1].

    Raises
    ------
    ValueError
        If an extinction ratio or a transmission is outside of its range.

    Notes
    -----
    Amplitudes :math:`\sqrt T` and :math:`\sqrt{T e}` along the two directions,
    without delay: :math:`m_{11} = m_{22} = T (1 + e)/2`,
    :math:`m_{12} = m_{21} = T (1 - e)/2` and :math:`m_{33} = m_{44} = T \sqrt e` at
    an angle of zero; the diattenuator of ref. [1] of this module with the
    diattenuation :math:`(1 - e) / (1 + e)`.

    Examples
    --------
    >>> from amulor.optics.polarization import mueller, stokes
    >>> polarizer = linear_polarizer(0.0, extinction_ratio=1e-3)
    >>> print(f"{mueller.apply(polarizer, stokes.state('V'))[0]:.4f}")
    0.0010
    """
    leak = within(
        extinction_ratio,
        0,
        1,
        name="extinction_ratio",
        hint="it is that of crossed over aligned",
    )
    peak = within(transmission, 0, 1, name="transmission")
    turn = finite(angle, name="angle", unit="rad")
    broadcast(extinction_ratio=leak, transmission=peak, angle=turn)
    leak, peak = np.broadcast_arrays(leak, peak)
    matrix = np.zeros((*leak.shape, 4, 4))
    matrix[..., 0, 0] = matrix[..., 1, 1] = peak * (1 + leak) / 2
    matrix[..., 0, 1] = matrix[..., 1, 0] = peak * (1 - leak) / 2
    matrix[..., 2, 2] = matrix[..., 3, 3] = peak * np.sqrt(leak)
    return rotated(matrix, angle=turn)


def retarder(
    retardance: ArrayLike,
    *,
    angle: ArrayLike,
    diattenuation: ArrayLike = 0.0,
    transmission: ArrayLike = 1.0,
) -> NDArray[np.float64]:
    r"""Return the Mueller matrix of a real linear retarder.

    Parameters
    ----------
    retardance : array_like
        Phase by which the slow component falls behind the fast one; pi/2 is a
        quarter-wave plate [rad].
    angle : array_like
        Direction of the FAST axis, from the parallel to the perpendicular axis
        [rad].
    diattenuation : array_like
        (Power along the fast axis - power along the slow one) over their sum, -1 to
        1 [1]. Reflection at the faces of a crystal plate and the two absorptions of a
        polymer give some 0.001 to 0.01.
    transmission : array_like
        Fraction of unpolarized light that passes, 0 to 1 [1].

    Returns
    -------
    ndarray
        Mueller matrix, broadcast shape with last axes (4, 4) [1].

    Raises
    ------
    ValueError
        If a diattenuation or a transmission is outside of its range, or if more than
        the incident light would pass along one axis.

    Notes
    -----
    With the fast axis along the parallel one and :math:`K = \sqrt{1 - D^2}`,
    :math:`m_{11} = m_{22} = T`, :math:`m_{12} = m_{21} = T D`,
    :math:`m_{33} = m_{44} = T K \cos\delta` and
    :math:`m_{34} = -m_{43} = T K \sin\delta`: a retarder and a diattenuator of ref. [1]
    of this module with common axes. A quarter-wave plate with its fast axis vertical
    turns +45 degrees into right circular.

    Examples
    --------
    >>> from amulor.optics.polarization import mueller
    >>> plate = retarder(np.pi / 2, angle=np.pi / 2)
    >>> print(f"V = {mueller.apply(plate, [1.0, 0.0, 1.0, 0.0])[3]:.6f}")
    V = 1.000000
    """
    delta = finite(retardance, name="retardance", unit="rad")
    contrast = within(diattenuation, -1, 1, name="diattenuation")
    mean = within(transmission, 0, 1, name="transmission")
    turn = finite(angle, name="angle", unit="rad")
    broadcast(retardance=delta, diattenuation=contrast, transmission=mean, angle=turn)
    delta, contrast, mean = np.broadcast_arrays(delta, contrast, mean)
    strongest = mean * (1 + np.abs(contrast))
    require(
        strongest,
        strongest <= 1,
        name="transmission * (1 + |diattenuation|)",
        rule="at most 1",
        hint="it is what passes along the better axis",
    )
    matrix = np.zeros((*delta.shape, 4, 4))
    coherent = mean * np.sqrt(1 - contrast**2)
    matrix[..., 0, 0] = matrix[..., 1, 1] = mean
    matrix[..., 0, 1] = matrix[..., 1, 0] = mean * contrast
    matrix[..., 2, 2] = matrix[..., 3, 3] = coherent * np.cos(delta)
    matrix[..., 2, 3] = coherent * np.sin(delta)
    matrix[..., 3, 2] = -coherent * np.sin(delta)
    return rotated(matrix, angle=turn)


def largest_transmission(mueller: ArrayLike) -> NDArray[np.float64]:
    r"""Return an element's largest transmission over all input polarization states.

    Parameters
    ----------
    mueller : array_like
        Mueller matrices of elements, last axes (4, 4) [1].

    Returns
    -------
    ndarray
        Largest output over input, shape of `mueller` without the last two axes [1]. A
        passive element cannot exceed 1.

    Raises
    ------
    ValueError
        If the last axes are not (4, 4).

    Notes
    -----
    :math:`m_{11} + \sqrt{m_{12}^2 + m_{13}^2 + m_{14}^2}`, for light in the state of
    the first row; with a minus, the smallest (ref. [1] of this module).

    Examples
    --------
    >>> print(largest_transmission(linear_polarizer(0.3, transmission=0.8)).round(12))
    0.8
    """
    row = as_matrices(mueller)[..., 0, :]
    best: NDArray[np.float64] = row[..., 0] + np.linalg.norm(row[..., 1:], axis=-1)
    return best
