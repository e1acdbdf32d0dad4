"""Directions of a scan between which the water signal is interpolated."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amulor.errors import CubeError

Floats = NDArray[np.float64]

#: What the interpolation over the scan may miss, of the largest overlap [1].
_MISSED = 1e-4
#: Steps of the degree over one angle, and the largest number of nodes.
_FIRST, _STEP, MOST = 2, 2, 400
#: Where between the ends of an angle it is tried [1].
_TRIED = np.array([-0.83, -0.31, 0.12, 0.57, 0.94])
#: Angles that differ by less are one [rad].
_ONE = 1e-9


@dataclass(frozen=True)
class Directions:
    """Chebyshev nodes over azimuth and elevation."""

    azimuth: Floats
    """Nodes of azimuth [rad]."""
    elevation: Floats
    """Nodes of elevation [rad]."""
    middle: tuple[float, float]
    """Middle of the scan [rad]."""

    @property
    def mesh(self) -> tuple[Floats, Floats]:
        """Azimuth and elevation of all nodes, flat [rad]."""
        both = np.meshgrid(self.azimuth, self.elevation, indexing="ij")
        return both[0].ravel(), both[1].ravel()

    def interpolation(self, azimuth: Floats, elevation: Floats) -> Floats:
        """Return how the nodes make up given directions.

        Parameters
        ----------
        azimuth, elevation : ndarray, shape (n,)
            Directions [rad].

        Returns
        -------
        ndarray, shape (n, nodes)
            Lagrange polynomials over azimuth and elevation [1].
        """
        parts = [
            _lagrange(node, place)
            for node, place in ((self.azimuth, azimuth), (self.elevation, elevation))
        ]
        product: Floats = np.einsum("ni,nj->nij", *parts).reshape(len(azimuth), -1)
        return product

    @property
    def centre(self) -> Floats:
        """How the nodes make up the middle of the scan, (nodes,) [1]."""
        place = (np.array([angle]) for angle in self.middle)
        nodes: Floats = self.interpolation(*place)[0]
        return nodes


def directions_of(
    azimuth: Floats, elevation: Floats, overlap: Callable[[Floats, Floats], Floats]
) -> Directions:
    """Return the fewest nodes over a scan that follow the overlap.

    Parameters
    ----------
    azimuth, elevation : ndarray
        Directions that will be asked for, of any shape [rad].
    overlap : callable
        From directions, (n,), to what is interpolated, (n, depths).

    Returns
    -------
    Directions
        The degree over each angle by itself: that one is raised which helps more.

    Raises
    ------
    CubeError
        If that would take far too many.
    """
    box = [
        (float(np.min(values)), float(np.max(values)))
        for values in (azimuth, elevation)
    ]
    middle = (0.5 * sum(box[0]), 0.5 * sum(box[1]))
    at = np.stack(np.meshgrid(_TRIED, _TRIED), axis=-1).reshape(-1, 2)
    tried = [
        middle[axis] + 0.5 * (high - low) * at[:, axis]
        for axis, (low, high) in enumerate(box)
    ]
    exact = overlap(tried[0], tried[1])

    def missed(degrees: tuple[int, int]) -> tuple[float, Directions]:
        axes = [
            _chebyshev(*ends, degree) for ends, degree in zip(box, degrees, strict=True)
        ]
        found = Directions(axes[0], axes[1], middle)
        error = found.interpolation(tried[0], tried[1]) @ overlap(*found.mesh) - exact
        largest, level = float(np.max(np.abs(error))), float(np.max(exact))
        if largest == 0:
            return 0.0, found
        return (largest / level if level > 0 else np.inf), found

    degrees = (_FIRST, _FIRST)
    error, found = missed(degrees)
    while error > _MISSED:
        ways = [
            (degrees[0] + _STEP, degrees[1]),
            (degrees[0], degrees[1] + _STEP),
        ]
        results = [(*missed(way), way) for way in ways]
        error, found, degrees = min(results, key=lambda result: result[0])
        if found.azimuth.size * found.elevation.size > MOST:
            raise CubeError(
                "the water signal changes too quickly over the scan to be tabulated "
                f"({error:.1g} of it is missed between {MOST} directions); split the "
                "scan into smaller ones"
            )
    return found


def _chebyshev(low: float, high: float, degree: int) -> Floats:
    """Return the nodes of a degree over an angle; one where it does not change."""
    count = degree + 1 if high - low > _ONE else 1
    node = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    nodes: Floats = 0.5 * (low + high) + 0.5 * (high - low) * node
    return nodes


def _lagrange(node: Floats, place: Floats) -> Floats:
    """Return Lagrange's polynomials at some places, (place, node)."""
    part = np.ones((len(place), len(node)))
    for j in range(len(node)):
        for k in range(len(node)):
            if k != j:
                part[:, j] *= (place - node[k]) / (node[j] - node[k])
    return part
