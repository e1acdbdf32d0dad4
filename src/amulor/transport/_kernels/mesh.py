"""Rays and triangles in compiled loops: the nearest hit, and whether a way is free.

Triangles lie in a hierarchy of boxes, in the order of a walk that takes a box before
what is in it. Each box knows where the walk goes on if the ray misses it, so there is
no stack. Möller and Trumbore, J. Graphics Tools 2, 21 (1997),
doi:10.1080/10867651.1997.10487468. Compiled, as each flight of each path is such a ray.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amulor.transport._kernels.compiled import entry, kernel
from amulor.transport._kernels.types import Array, Integers, Mesh, Vector

# Columns of a box (its corners), of its link and of a triangle.
LOW_X, LOW_Y, LOW_Z, HIGH_X, HIGH_Y, HIGH_Z = range(6)
ESCAPE, FIRST_TRIANGLE, TRIANGLES = range(3)
CORNER, EDGE_ONE, EDGE_TWO, NORMAL = 0, 3, 6, 9

#: What a triangle is larger by, as a fraction of its edges, so that no ray slips
#: between two that share an edge. Rounding moves a hit by some 1e-15 of the distances.
MARGIN = 1e-9

_STEEP = 1e300  # stands for 1/0, so that 0 times it is not "not a number"


@kernel
def inverse(component: float) -> float:
    """Return one over a component of a direction, finite for 0."""
    if abs(component) * _STEEP > 1.0:
        return 1.0 / component
    return math.copysign(_STEEP, component)


@kernel
def triangle_at(place: Vector, way: Vector, triangle: Array, k: int) -> float:
    """Return the distance at which a ray meets a triangle, NaN if it does not.

    The determinant form of Möller and Trumbore, in lengths of way.
    """
    x, y, z = place
    dx, dy, dz = way
    ax, ay, az = triangle[k, 3], triangle[k, 4], triangle[k, 5]
    bx, by, bz = triangle[k, 6], triangle[k, 7], triangle[k, 8]
    px, py, pz = dy * bz - dz * by, dz * bx - dx * bz, dx * by - dy * bx
    determinant = ax * px + ay * py + az * pz
    if determinant == 0.0:
        return math.nan
    sx, sy, sz = x - triangle[k, 0], y - triangle[k, 1], z - triangle[k, 2]
    along = (sx * px + sy * py + sz * pz) / determinant
    if along < -MARGIN or along > 1.0 + MARGIN:
        return math.nan
    qx, qy, qz = sy * az - sz * ay, sz * ax - sx * az, sx * ay - sy * ax
    across = (dx * qx + dy * qy + dz * qz) / determinant
    if across < -MARGIN or along + across > 1.0 + MARGIN:
        return math.nan
    return float((bx * qx + by * qy + bz * qz) / determinant)


@kernel
def first_hit(
    place: Vector, way: Vector, limit: float, enough: float, start: float, mesh: Mesh
) -> tuple[float, float]:
    """Return distance and number of the nearest triangle that a ray meets.

    Distances are in lengths of way. limit bounds them, and is returned with a number
    of -1 if nothing is met. The search ends at any hit nearer than enough. start is
    the number of the triangle on which the ray starts, which it cannot meet, or -1.
    """
    box, link, triangle = mesh.box, mesh.link, mesh.triangle
    x, y, z = place
    dx, dy, dz = way
    own = int(start)
    least = 0.0
    if own >= 0:
        least = mesh.least / math.sqrt(dx * dx + dy * dy + dz * dz)
    ix, iy, iz = inverse(dx), inverse(dy), inverse(dz)
    best = limit
    hit = -1
    node = 0
    while node < box.shape[0]:
        x1, x2 = (box[node, LOW_X] - x) * ix, (box[node, HIGH_X] - x) * ix
        y1, y2 = (box[node, LOW_Y] - y) * iy, (box[node, HIGH_Y] - y) * iy
        z1, z2 = (box[node, LOW_Z] - z) * iz, (box[node, HIGH_Z] - z) * iz
        enter = max(max(min(x1, x2), min(y1, y2)), min(z1, z2))
        leave = min(min(max(x1, x2), max(y1, y2)), max(z1, z2))
        if enter > leave or leave < 0.0 or enter > best:
            node = link[node, ESCAPE]
            continue
        first = link[node, FIRST_TRIANGLE]
        for k in range(first, first + link[node, TRIANGLES]):
            if k == own:
                continue
            distance = triangle_at(place, way, triangle, k)
            if least < distance < best:
                best = distance
                hit = k
        if best < enough:
            break
        node += 1
    return best, float(hit)


@kernel
def facing_normal(number: float, way: Vector, mesh: Mesh) -> Vector:
    """Return the normal of a triangle on the side from which a ray comes."""
    triangle = mesh.triangle
    k = int(number)
    nx, ny, nz = triangle[k, 9], triangle[k, 10], triangle[k, 11]
    if nx * way[0] + ny * way[1] + nz * way[2] > 0.0:
        return -nx, -ny, -nz
    return nx, ny, nz


@kernel
def blocked(place: Vector, end: Vector, start: float, mesh: Mesh) -> bool:
    """Return whether a triangle lies between two points, the first one's left out."""
    way = (end[0] - place[0], end[1] - place[1], end[2] - place[2])
    distance, _ = first_hit(place, way, 1.0, 1.0, start, mesh)
    return distance < 1.0


@entry
def first_triangles(start: Array, way: Array, mesh: Mesh, met: Integers) -> None:
    """Fill the number of the nearest triangle that each ray meets, -1 for none."""
    for i in range(start.shape[0]):
        place = (start[i, 0], start[i, 1], start[i, 2])
        ahead = (way[i, 0], way[i, 1], way[i, 2])
        _, number = first_hit(place, ahead, math.inf, 0.0, -1.0, mesh)
        met[i] = int(number)


@entry
def free_ways(
    start: Array, end: Array, own: Integers, mesh: Mesh, free: NDArray[np.bool_]
) -> None:
    """Fill whether nothing lies between points; own are the triangles at the first."""
    for i in range(start.shape[0]):
        place = (start[i, 0], start[i, 1], start[i, 2])
        other = (end[i, 0], end[i, 1], end[i, 2])
        free[i] = not blocked(place, other, float(own[i]), mesh)
