"""Rotation matrices of attitudes stated by heading, pitch and roll."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def rotation_of(heading: ArrayLike, pitch: ArrayLike, roll: ArrayLike) -> Floats:
    r"""Return rotation matrices of attitudes stated by heading, pitch and roll.

    Parameters
    ----------
    heading : array_like
        Direction of the forward axis, clockwise from north [rad].
    pitch : array_like
        Elevation of the forward axis [rad].
    roll : array_like
        Angle of the right axis below the horizontal, about the forward axis [rad].

    Returns
    -------
    ndarray, shape (..., 3, 3)
        Rotations from (right, down, forward) to (east, north, up) [1].

    Notes
    -----
    The columns of the matrix are the right, down and forward axis. With heading h,
    pitch p and roll r, the forward axis is
    :math:`(\sin h \cos p, \cos h \cos p, \sin p)`.

    Examples
    --------
    An instrument that looks east and slightly down:

    >>> import numpy as np
    >>> from amulor import platform
    >>> turn = platform.rotation_of(np.pi / 2, np.radians(-10), 0.0)
    >>> print((turn @ [0, 0, 1]).round(3) + 0.0)  # forward: east, north, up
    [ 0.985  0.    -0.174]
    """
    heading, pitch, roll = np.broadcast_arrays(heading, pitch, roll)
    sine, cosine = np.sin(heading), np.cos(heading)
    nothing = np.zeros_like(sine)
    level = np.stack([sine, cosine, nothing], axis=-1)
    up = np.array([0.0, 0.0, 1.0])
    right = np.stack([cosine, -sine, nothing], axis=-1)

    def turned(angle: Floats, first: Floats, second: Floats) -> Floats:
        return np.cos(angle)[..., None] * first + np.sin(angle)[..., None] * second

    forward = turned(pitch, level, up)
    above = turned(pitch, np.broadcast_to(up, level.shape), -level)
    return np.stack(
        [turned(roll, right, -above), -turned(roll, above, right), forward], axis=-1
    )


def rotation_by(vector: ArrayLike) -> Floats:
    """Return the rotation matrix of a rotation vector, shape (3, 3)."""
    x, y, z = axis = np.asarray(vector, dtype=float)
    angle = float(np.linalg.norm(axis))
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # sin(a) / a and (1 - cos(a)) / a^2, finite at 0.
    first, second = np.sinc(angle / np.pi), np.sinc(angle / (2 * np.pi)) ** 2 / 2
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))
