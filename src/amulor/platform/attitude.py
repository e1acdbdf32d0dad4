"""Attitudes: heading, pitch and roll as rotations, and rotations as vectors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]

#: Pairs of different coordinates.
PAIRS = ((0, 1), (0, 2), (1, 2))


def turn_between(first: Rotation, second: Rotation) -> Floats:
    """Return the rotation vectors, in site axes, from first to second attitudes."""
    return np.asarray((second * first.inv()).as_rotvec())


def cross_matrix(vectors: Floats) -> Floats:
    """Return the skew-symmetric cross-product matrices of vectors, (..., 3, 3)."""
    zero = np.zeros(vectors.shape[:-1])
    x, y, z = np.moveaxis(vectors, -1, 0)
    return np.stack(
        [
            np.stack([zero, -z, y], -1),
            np.stack([z, zero, -x], -1),
            np.stack([-y, x, zero], -1),
        ],
        -2,
    )


def covariance_of(
    turns: Floats, position: ArrayLike, heading: ArrayLike, level: ArrayLike
) -> Floats:
    """Return pose covariances from uncertainties of position, heading and level.

    `turns` are rotations to (east, north, up), shape (n, 3, 3). The uncertainties are
    numbers or have one value per pose; that of the position may have three.
    """
    count = len(turns)
    covariance = np.zeros((count, 6, 6))
    places = np.asarray(position, dtype=float)
    if places.shape == (count,):
        places = places[:, None]
    covariance[:, :3, :3] = np.broadcast_to(places, (count, 3))[:, :, None] ** 2
    covariance[:, :3, :3] *= np.eye(3)
    up = np.broadcast_to([0.0, 0.0, 1.0], (count, 3))
    axes = np.stack([up, turns[:, :, 0], turns[:, :, 2]], axis=-1)
    sigma = [np.broadcast_to(np.asarray(value, dtype=float), (count,)) for value in (
        heading, level, level)]  # fmt: skip
    spread = axes * np.stack(sigma, axis=-1)[:, None, :]
    covariance[:, 3:, 3:] = spread @ np.swapaxes(spread, 1, 2)
    return covariance
