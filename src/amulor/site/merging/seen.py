"""Which points other scans confirm, and which they see through: fish, divers, weed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from amulor.site.registration.pair import on_grid
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.surface import ScanSurface

Floats = NDArray[np.float64]
Counts = NDArray[np.int16]

#: A scan sees through a point if it stands so many standard errors before its surface,
#: and confirms it if it stands within fewer [1].
_THROUGH, _CONFIRMED = 6.0, 4.0
#: Beams that graze a surface tell little of what stands before it [1].
_GRAZING = 0.15


def seen_by_others(
    name: str,
    surfaces: Mapping[str, ScanSurface],
    poses: Mapping[str, ScanPose],
    point: Floats,
    sigma: Floats,
) -> tuple[Counts, Counts]:
    """Return how many other scans confirm points of a scan, and see through them.

    Parameters
    ----------
    name : str
        The scan that the points are of.
    surfaces : mapping of str to ScanSurface
        Scans of one epoch.
    poses : mapping of str to ScanPose
        Their poses.
    point : ndarray, shape (n, 3)
        Points in the site [m].
    sigma : ndarray, shape (n,)
        Largest standard uncertainty of each, poses included [m].

    Returns
    -------
    confirmed, through : ndarray of int, shape (n,)
        Numbers of scans. Only beams that meet a smooth patch count, so that nothing is
        said at edges; one that ends before the point is hidden from it.
    """
    confirmed = np.zeros(len(point), dtype=np.int16)
    through = np.zeros(len(point), dtype=np.int16)
    for other, surface in surfaces.items():
        if other == name or not len(point):
            continue
        local = poses[other].back(point)
        middle = surface.origin[surface.usable].mean(axis=0)
        away = local - middle
        distance = np.linalg.norm(away, axis=1)
        pixels = np.flatnonzero(surface.usable)
        tree = cKDTree(surface.direction.reshape(-1, 3)[pixels])
        near, number = tree.query(
            away / np.maximum(distance, 1e-9)[:, None],
            distance_upper_bound=6 * surface.spacing / np.nanmedian(surface.distance),
        )
        met = np.flatnonzero(np.isfinite(near))
        if not len(met):
            continue
        at = on_grid(surface, local[met], pixels[number[met]])
        normal = surface.normal.reshape(-1, 3)[at.pixel]
        facing = -np.einsum("ij,ij->i", np.nan_to_num(normal), at.direction)
        good = at.inside & (facing > _GRAZING)
        error = np.hypot(
            sigma[met] / np.maximum(facing, _GRAZING), surface.own.ravel()[at.pixel]
        )
        score = at.distance / error
        confirmed[met] += good & (np.abs(score) < _CONFIRMED)
        # Before the surface by more than the relief of a patch as well.
        before = at.distance < -3 * surface.spacing
        through[met] += good & (score < -_THROUGH) & before
    return confirmed, through
