"""Places that changed, taken together: area, volume, and their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from amulor.site.change.distances import Change

Floats = NDArray[np.float64]

#: Fewer points than these together are no region [1].
_FEWEST = 4
#: Points of one region are no farther apart than so many spacings [1].
_TOGETHER = 3.0


@dataclass(frozen=True, kw_only=True)
class Region:
    """A place that changed."""

    members: NDArray[np.intp]
    """Numbers of its points."""
    centre: Floats
    """Middle, shape (3,) [m]."""
    reach: float
    """Largest distance of a point from the middle [m]."""
    area: float
    """Surface [m^2]."""
    mean: float
    """Mean change along the normals, by area [m]."""
    mean_uncertainty: float
    """Its standard uncertainty [m]."""
    largest: float
    """Change of the largest size [m]."""
    volume: float
    """What came, less what went [m^3]."""
    volume_uncertainty: float
    """Its standard uncertainty [m^3]."""


def regions(change: Change) -> tuple[Region, ...]:
    """Return the places of a comparison that changed, the largest area first.

    Parameters
    ----------
    change : Change
        With its significant points.

    Returns
    -------
    tuple of Region
        Points that stand together. A few single ones are what chance leaves.
    """
    at = np.flatnonzero(change.significant)
    if len(at) < _FEWEST:
        return ()
    tree = cKDTree(change.position[at])
    links = tree.query_pairs(_TOGETHER * change.spacing, output_type="ndarray")
    ones = np.ones(len(links))
    graph = coo_matrix((ones, (links[:, 0], links[:, 1])), shape=(len(at), len(at)))
    _, label = connected_components(graph, directed=False)
    found = [
        region_of(change, at[label == number])
        for number in range(label.max() + 1)
        if int((label == number).sum()) >= _FEWEST
    ]
    return tuple(sorted(found, key=lambda one: -one.area))


def region_of(change: Change, members: NDArray[np.intp]) -> Region:
    """Return area, change and volume of some points of a comparison.

    Parameters
    ----------
    change : Change
        The comparison.
    members : ndarray of int
        Numbers of its points; those without a change are left out.

    Returns
    -------
    Region
        With the errors that they share, and with noise that cylinders of neighbours
        share, as many as overlap.
    """
    members = members[np.isfinite(change.value[members])]
    place, area = change.position[members], change.area[members]
    value = change.value[members]
    total = float(area.sum())
    centre = (area[:, None] * place).sum(axis=0) / total
    # Cylinders closer than their width hold the same points.
    near = cKDTree(place).query_pairs(change.radius, output_type="ndarray")
    own = area * change.own[members]
    variance = float((own**2).sum())
    if len(near):
        apart = np.linalg.norm(place[near[:, 0]] - place[near[:, 1]], axis=1)
        common = np.clip(1 - apart / (2 * change.radius), 0, 1)
        variance += float(2 * (own[near[:, 0]] * own[near[:, 1]] * common).sum())
    shared = (area[:, None] * change.shared[members]).sum(axis=0)
    sigma = float(np.sqrt(variance + (shared**2).sum()))
    volume = float((area * value).sum())
    return Region(
        members=members,
        centre=centre,
        reach=float(np.linalg.norm(place - centre, axis=1).max()),
        area=total,
        mean=volume / total,
        mean_uncertainty=sigma / total,
        largest=float(value[np.argmax(np.abs(value))]),
        volume=volume,
        volume_uncertainty=sigma,
    )
