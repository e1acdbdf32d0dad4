"""Triangle meshes as targets of photon transport."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from amulor.transport.receiver import reflection_matrix

__all__ = ["MeshTarget"]

Array = NDArray[np.float64]

#: Least area of a triangle over the square of its longest edge.
_FLATTEST = 1e-9
# Rays that tell whether a point is inside: no simple ratio of their components.
_PROBES = np.array(
    [[0.5377, 0.6131, 0.5787], [-0.7127, 0.3571, 0.6037], [0.2213, -0.8419, -0.4921]]
)


@dataclass(frozen=True, eq=False, kw_only=True)
class MeshTarget:
    """Target made of triangles, Lambertian or glossy, which reflect on both sides.

    The surface is opaque. Both sides of a triangle reflect, so the order of its corners
    does not matter. Light may be reflected any number of times.

    Raises
    ------
    ValueError
        If there is no triangle, a face refers to a missing vertex or has no area, two
        faces are identical, a reflectance, the texture or the gloss is out of range, or
        the matrix is not physical.

    Examples
    --------
    >>> plate = MeshTarget(
    ...     vertices=[[-1, -1, 3], [1, -1, 3], [1, 1, 3], [-1, 1, 3]],
    ...     faces=[[0, 1, 2], [0, 2, 3]],
    ...     reflectance=0.5,
    ... )
    >>> plate.corners.shape
    (2, 3, 3)
    """

    vertices: ArrayLike
    """Vertex positions: right, down, forward, shape (vertices, 3) [m]."""
    faces: ArrayLike
    """Vertex indices of each triangle, shape (faces, 3)."""
    reflectance: float
    """Diffuse reflectance [1]."""
    mueller: ArrayLike | None = None
    """Matrix of diffuse light over its first element, an ideal depolarizer if not
    given. It leads from the part of the scene's axis to the right that is perpendicular
    to the light before the reflection to that after it, wherever the receiver looks."""
    texture: ArrayLike | None = None
    """Diffuse reflectance of each triangle over `reflectance`, from 0 to 1, shape
    (faces,); 1 if not given [1]."""
    gloss: float = 0.0
    """Fraction of the light that falls on facets which mirror it, up to 1 less the
    reflectance [1]."""
    rms_slope: float = 0.0
    """Root mean square slope of these facets along one axis, 0.02 to 0.5 [1]."""
    corners: Array = field(init=False, repr=False)
    """Corner positions of each triangle, shape (faces, 3, 3) [m]."""
    matrix: Array = field(init=False, repr=False)
    """Reduced Mueller matrix, shape (4, 4)."""

    def __post_init__(self) -> None:
        """Raise a ValueError for an invalid mesh, reflectance or matrix."""
        object.__setattr__(self, "corners", _corners(self.vertices, self.faces))
        matrix = reflection_matrix(
            self.reflectance, self.mueller, self.gloss, self.rms_slope
        )
        object.__setattr__(self, "matrix", matrix)
        if self.texture is not None:
            factor = np.array(self.texture, dtype=np.float64)
            if factor.shape != (len(self.corners),):
                raise ValueError(
                    f"texture must have one number for each of the {len(self.corners)} "
                    f"faces, got the shape {factor.shape}"
                )
            if not np.all((factor >= 0) & (factor <= 1)):
                wrong = factor[~((factor >= 0) & (factor <= 1))][0]
                raise ValueError(f"texture must be from 0 to 1, got {wrong:g}")

    def depth_inside(self, point: Array) -> float:
        """Return a point's depth in a closed part of the mesh; 0 if outside [m].

        A part is a set of triangles that share edges; it is closed if each of its
        edges has two triangles.
        """
        inside = 0.0
        for part in self._closed_parts:
            # A ray that meets the part an odd number of times starts inside of it;
            # the third one decides where the ray of one runs along an edge.
            odd = [_crossings(part, point, probe) % 2 for probe in _PROBES]
            if sum(odd) >= 2:
                inside = max(inside, distance_to_triangles(point, part))
        return inside

    def reach_into(self, centre: Array, axis: Array, radius: float) -> float:
        """Depth of a mesh inside the rim of a disc; 0 for a mesh outside the disc [m].

        Parameters
        ----------
        centre, axis : ndarray
            Centre of the disc [m], and unit vector perpendicular to it.
        radius : float
            Radius of the disc [m].
        """
        height = (self.corners - centre) @ axis
        inplane = self.corners - centre - height[..., np.newaxis] * axis
        nearest = np.inf
        for first, second, third in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            # Of a corner alone on its side two edges go through the plane of the disc.
            side = height[:, first]
            alone = (side * height[:, second] <= 0) & (side * height[:, third] <= 0)
            through = np.flatnonzero(alone & (side != 0))
            if through.size == 0:
                continue
            ends = []
            for corner in (second, third):
                fraction = side[through] / (side[through] - height[through, corner])
                start, end = inplane[through, first], inplane[through, corner]
                ends.append(start + fraction[:, np.newaxis] * (end - start))
            nearest = min(nearest, float(_to_segments(np.zeros(3), *ends).min()))
        level = np.all(height == 0, axis=1)
        if np.any(level):
            nearest = min(nearest, distance_to_triangles(centre, self.corners[level]))
        return max(0.0, radius - nearest)

    @cached_property
    def _closed_parts(self) -> list[Array]:
        """Triangle corners of each closed part of the mesh [m]."""
        shape = self.corners.shape
        _, number = np.unique(self.corners.reshape(-1, 3), axis=0, return_inverse=True)
        vertex = number.reshape(shape[0], 3)
        pairs = np.sort(
            np.concatenate([vertex[:, [0, 1]], vertex[:, [1, 2]], vertex[:, [2, 0]]]),
            axis=1,
        )
        _, edge, shared = np.unique(
            pairs, axis=0, return_inverse=True, return_counts=True
        )
        edge = edge.reshape(-1)
        triangle = np.tile(np.arange(shape[0]), 3)
        incidence = coo_array(
            (np.ones(edge.size), (triangle, edge)), shape=(shape[0], len(shared))
        ).tocsr()
        count, part = connected_components(incidence @ incidence.T, directed=False)
        closed = np.ones(count, dtype=bool)
        closed[part[triangle[shared[edge] != 2]]] = False
        return [self.corners[part == k] for k in np.flatnonzero(closed)]


def _corners(vertices: ArrayLike, faces: ArrayLike) -> Array:
    """Return the corner positions of triangles; ValueError for an invalid mesh."""
    place = np.array(vertices, dtype=np.float64)
    if place.ndim != 2 or place.shape[1] != 3:
        raise ValueError(
            "vertices must have the shape (vertices, 3), right, down, forward, got "
            f"{place.shape}"
        )
    if not np.all(np.isfinite(place)):
        wrong = int(np.flatnonzero(~np.isfinite(place).all(axis=1))[0])
        raise ValueError(f"vertices must be finite, got {place[wrong]} at {wrong}")
    indices = np.array(faces)
    if indices.size == 0:
        raise ValueError("faces must hold at least one triangle, got none")
    if indices.ndim != 2 or indices.shape[1] != 3:
        raise ValueError(f"faces must have the shape (faces, 3), got {indices.shape}")
    if not np.issubdtype(indices.dtype, np.integer):
        raise ValueError(
            f"faces must be whole numbers of vertices, got numbers of {indices.dtype}"
        )
    number = indices.astype(np.int64)
    beyond = np.flatnonzero(((number < 0) | (number >= len(place))).any(axis=1))
    if beyond.size > 0:
        row = number[beyond[0]]
        raise ValueError(
            f"faces must name vertices from 0 to {len(place) - 1}, got "
            f"{row.tolist()} in face {beyond[0]} ({beyond.size} such faces)"
        )
    corner: Array = place[number]
    sides = corner[:, [1, 2, 0]] - corner
    longest = np.linalg.norm(sides, axis=2).max(axis=1)
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    flat = np.flatnonzero(~(area > _FLATTEST * longest**2))
    if flat.size > 0:
        worst = int(flat[0])
        raise ValueError(
            f"faces must have an area above {_FLATTEST:g} of their longest edge "
            f"squared, got {area[worst]:.3g} m2 with an edge of {longest[worst]:.3g} m "
            f"in face {worst} ({flat.size} such faces); leave them out"
        )
    _refuse_twins(corner)
    return corner


def _refuse_twins(corner: Array) -> None:
    """Raise a ValueError if two triangles coincide."""
    _, number = np.unique(corner.reshape(-1, 3), axis=0, return_inverse=True)
    _, first, face_of = np.unique(
        np.sort(number.reshape(-1, 3), axis=1),
        axis=0,
        return_index=True,
        return_inverse=True,
    )
    twins = np.flatnonzero(first[face_of.reshape(-1)] != np.arange(len(corner)))
    if twins.size > 0:
        twin = int(twins[0])
        original = int(first[face_of.reshape(-1)[twin]])
        raise ValueError(
            f"faces {original} and {twin} are the same triangle ({twins.size} such "
            "pairs); leave one of them out, as both of its sides reflect"
        )


def _crossings(corner: Array, point: Array, direction: Array) -> int:
    """Return the number of triangles that a ray crosses."""
    first_edge, second_edge = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    p = np.cross(direction, second_edge)
    determinant = np.einsum("ij,ij->i", first_edge, p)
    s = point - corner[:, 0]
    q = np.cross(s, first_edge)
    usable = determinant != 0
    scale = np.divide(1.0, determinant, out=np.zeros_like(determinant), where=usable)
    u = np.einsum("ij,ij->i", s, p) * scale
    v = q @ direction * scale
    t = np.einsum("ij,ij->i", second_edge, q) * scale
    return int(np.sum(usable & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)))


def _to_segments(point: Array, start: Array, end: Array) -> Array:
    """Return the distances of a point from line segments [m]."""
    way = end - start
    square = np.einsum("ij,ij->i", way, way)
    along = np.einsum("ij,ij->i", point - start, way)
    fraction = np.divide(along, square, out=np.zeros_like(along), where=square > 0)
    nearest = start + np.clip(fraction, 0, 1)[:, np.newaxis] * way
    distance: Array = np.linalg.norm(nearest - point, axis=1)
    return distance


def distance_to_triangles(point: Array, corner: Array) -> float:
    """Return the distance of a point from the nearest triangle [m]."""
    first_edge, second_edge = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    normal = np.cross(first_edge, second_edge)
    square = np.einsum("ij,ij->i", normal, normal)
    offset = point - corner[:, 0]
    v = np.einsum("ij,ij->i", np.cross(first_edge, offset), normal) / square
    u = np.einsum("ij,ij->i", np.cross(offset, second_edge), normal) / square
    over = (u >= 0) & (v >= 0) & (u + v <= 1)
    height = np.abs(np.einsum("ij,ij->i", offset, normal)) / np.sqrt(square)
    rim = np.min(
        [_to_segments(point, corner[:, k], corner[:, (k + 1) % 3]) for k in range(3)],
        axis=0,
    )
    return float(np.min(np.where(over, height, rim)))
