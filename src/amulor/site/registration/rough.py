"""Brings a scan near to others, from a start pose that may be off by decimetres."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from amulor.errors import MissingExtraError
from amulor.site.registration.pose import ScanPose

Floats = NDArray[np.float64]

#: small_gicp stops when a step is smaller [m, rad]; its own default leaves millimetres.
_STOP, _TURN = 1e-6, 1e-7
#: Voxels are so many times coarser, and points are looked for in so large a part of
#: the reach, one step after the other [1].
_STEPS = ((3.0, 1.0), (2.0, 0.5), (1.0, 0.25), (1.0, 0.1))


def aligned(
    points: Floats,
    others: Floats,
    start: ScanPose,
    *,
    voxel: float,
    reach: float,
) -> ScanPose:
    """Return a pose that brings points onto others.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Of the scan, in the axes of its instrument [m].
    others : ndarray, shape (m, 3)
        Of scans whose poses are known, in the site [m].
    start : ScanPose
        About where the instrument stood.
    voxel : float
        Spacing of the points that are compared at last; millimetres, not what is usual
        for streets [m].
    reach : float
        How far points may be off at first [m].

    Returns
    -------
    ScanPose
        Good to a part of a voxel where the surfaces hold the scan.

    Raises
    ------
    MissingExtraError
        If small_gicp is not installed.

    Notes
    -----
    Planes to planes, from coarse voxels to fine ones. Its sum of squares
    is no information matrix (errors 40 to 85 times too small), so that nothing but the
    pose is taken from it.
    """
    try:
        import small_gicp
    except ImportError as error:
        raise MissingExtraError(
            "small-gicp", extra="site", purpose="aligning scans"
        ) from error
    # Near the origin, since the voxels are numbered from there.
    middle = others.mean(axis=0)
    matrix = start.matrix
    matrix[:3, 3] -= middle
    for coarse, near in _STEPS:
        step = coarse * voxel
        found = small_gicp.align(
            others - middle,
            points,
            init_T_target_source=matrix,
            registration_type="GICP",
            downsampling_resolution=step,
            max_correspondence_distance=max(near * reach, 2 * step),
            num_threads=1,
            max_iterations=60,
            translation_epsilon=_STOP,
            rotation_epsilon=_TURN,
        )
        matrix = np.asarray(found.T_target_source, dtype=float)
    u, _, v = np.linalg.svd(matrix[:3, :3])
    return ScanPose(u @ v, matrix[:3, 3] + middle)
