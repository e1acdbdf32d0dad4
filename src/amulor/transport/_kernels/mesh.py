"""Compiled intersection of rays with triangles, by a hierarchy of boxes."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from amulor.transport._kernels.types import (
    Array,
    Integers,
    Mesh,
    Vector,
    allocating_entry,
    entry,
    kernel,
)

# Columns of a box (its corners), of its link and of a triangle.
LOW_X, LOW_Y, LOW_Z, HIGH_X, HIGH_Y, HIGH_Z = range(6)
ESCAPE, FIRST_TRIANGLE, TRIANGLES = range(3)
CORNER, EDGE_ONE, EDGE_TWO, NORMAL = 0, 3, 6, 9

#: Enlargement of a triangle as a fraction of its edges, so that no ray passes between
#: two with a common edge. Rounding moves a hit by some 1e-15 of the distances.
MARGIN = 1e-9

_STEEP = 1e300  # in place of 1/0, so that 0 times it is not "not a number"


@kernel
def inverse(component: float) -> float:
    """Return the reciprocal of a direction component; a large finite number for 0."""
    if abs(component) * _STEEP > 1.0:
        return 1.0 / component
    return math.copysign(_STEEP, component)


@kernel
def triangle_at(place: Vector, way: Vector, triangle: Array, k: int) -> float:
    """Return the distance along a ray to a triangle; NaN if the ray misses it.

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
    """Return distance and index of the nearest triangle on a ray; -1 for none.

    Distances are in lengths of way. limit bounds them, and is returned with a number
    of -1 if nothing is met. The search ends at any hit nearer than enough. start is
    the number of the triangle on which the ray starts, which it cannot meet, or -1.
    """
    box, link, triangle = mesh.box, mesh.link, mesh.triangle
    x, y, z = place
    dx, dy, dz = way
    start_triangle = int(start)
    least = 0.0
    if start_triangle >= 0:
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
            if k == start_triangle:
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
    """Return the triangle normal that faces the incoming ray."""
    triangle = mesh.triangle
    k = int(number)
    nx, ny, nz = triangle[k, 9], triangle[k, 10], triangle[k, 11]
    if nx * way[0] + ny * way[1] + nz * way[2] > 0.0:
        return -nx, -ny, -nz
    return nx, ny, nz


@kernel
def blocked(place: Vector, end: Vector, start: float, mesh: Mesh) -> bool:
    """Return whether a triangle blocks the straight line between two points."""
    way = (end[0] - place[0], end[1] - place[1], end[2] - place[2])
    distance, _ = first_hit(place, way, 1.0, 1.0, start, mesh)
    return distance < 1.0


@entry
def first_triangles(start: Array, way: Array, mesh: Mesh, met: Integers) -> None:
    """Fill `met` with the index of the first triangle on each ray, -1 for none."""
    for i in range(start.shape[0]):
        place = (start[i, 0], start[i, 1], start[i, 2])
        ahead = (way[i, 0], way[i, 1], way[i, 2])
        _, number = first_hit(place, ahead, math.inf, 0.0, -1.0, mesh)
        met[i] = int(number)


@entry
def free_ways(
    start: Array,
    end: Array,
    triangle: Integers,
    mesh: Mesh,
    free: NDArray[np.bool_],
) -> None:
    """Fill `free` with whether the lines between pairs of points meet no triangle."""
    for i in range(start.shape[0]):
        place = (start[i, 0], start[i, 1], start[i, 2])
        stop = (end[i, 0], end[i, 1], end[i, 2])
        free[i] = not blocked(place, stop, float(triangle[i]), mesh)


#: Triangles in a box without boxes, at most.
LEAF = 4


@kernel
def widest(centre: Array, number: Integers, first: int, last: int) -> int:
    """Return the coordinate axis along which triangle centers are spread the most."""
    axis = 0
    most = -1.0
    for k in range(3):
        low = high = centre[number[first], k]
        for i in range(first + 1, last):
            low = min(low, centre[number[i], k])
            high = max(high, centre[number[i], k])
        if high - low > most:
            most = high - low
            axis = k
    return axis


@kernel
def part(
    centre: Array, number: Integers, axis: int, first: int, last: int, middle: int
) -> None:
    """Partition the triangles of a box at the median of their centers on an axis.

    C. A. R. Hoare's Find, Commun. ACM 4, 321 (1961), doi:10.1145/366622.366647.
    """
    low, high = first, last - 1
    while low < high:
        pivot = centre[number[middle], axis]
        i, j = low, high
        while i <= j:
            while centre[number[i], axis] < pivot:
                i += 1
            while centre[number[j], axis] > pivot:
                j -= 1
            if i <= j:
                number[i], number[j] = number[j], number[i]
                i += 1
                j -= 1
        if j < middle:
            low = i
        if i > middle:
            high = j


@allocating_entry
def split(centre: Array, number: Integers, link: Integers, sibling: Integers) -> int:
    """Build the hierarchy of triangle boxes in the link arrays; return the box count.

    A box has a lower index than the boxes in it. `sibling` contains the index of the
    second of the two boxes in each box.
    """
    # Pending boxes: first triangle, end of triangles, enclosing box. One per level.
    waiting = np.empty((128, 3), dtype=np.int64)
    parent = np.empty(len(sibling), dtype=np.int64)
    waiting[0] = 0, len(number), -1
    count, pending = 0, 1
    while pending > 0:
        pending -= 1
        first, last, above = waiting[pending]
        parent[count] = above
        link[count, FIRST_TRIANGLE] = first
        link[count, TRIANGLES] = 0
        sibling[count] = -1
        if above >= 0:
            sibling[above] = count  # the second box overwrites the first
        if last - first <= LEAF:
            link[count, TRIANGLES] = last - first
        else:
            middle = first + (last - first) // 2
            axis = widest(centre, number, first, last)
            part(centre, number, axis, first, last, middle)
            waiting[pending] = middle, last, count
            waiting[pending + 1] = first, middle, count
            pending += 2
        count += 1
    link[0, ESCAPE] = count
    for k in range(1, count):
        second = sibling[parent[k]]
        link[k, ESCAPE] = link[parent[k], ESCAPE] if k == second else second
    return count


@kernel
def enclose(
    low: Array,
    high: Array,
    gap: float,
    link: Integers,
    sibling: Integers,
    box: Array,
) -> None:
    """Fill `box` with the corners of boxes around triangles, with a safety gap."""
    for k in range(len(box) - 1, -1, -1):
        for axis in range(3):
            if sibling[k] < 0:
                first = link[k, FIRST_TRIANGLE]
                lower, upper = low[first, axis], high[first, axis]
                for i in range(first + 1, first + link[k, TRIANGLES]):
                    lower, upper = min(lower, low[i, axis]), max(upper, high[i, axis])
                box[k, axis], box[k, 3 + axis] = lower - gap, upper + gap
            else:
                first, second = k + 1, sibling[k]
                box[k, axis] = min(box[first, axis], box[second, axis])
                box[k, 3 + axis] = max(box[first, 3 + axis], box[second, 3 + axis])


@kernel
def transmission_depth(
    z_start: float, z_end: float, length: float, edge: Array, attenuation: Array
) -> float:
    """Return the optical thickness along a straight path between two depths [1]."""
    low, high = min(z_start, z_end), max(z_start, z_end)
    if high - low < 1e-9 * length or attenuation.size == 1:
        for k in range(attenuation.size):
            if low < edge[k + 1] or k == attenuation.size - 1:
                return float(attenuation[k] * length)
    total = 0.0
    for k in range(attenuation.size):
        within = min(high, edge[k + 1]) - max(low, edge[k])
        if within > 0.0:
            total += attenuation[k] * within
    return total * length / (high - low)


@kernel
def cone_window(
    x: float,
    y: float,
    slope_x: float,
    slope_y: float,
    radius: float,
    slope: float,
    z_low: float,
    z_high: float,
) -> tuple[float, float]:
    """Return the depths between which a line lies inside a cone that opens along z.

    The line is (x + slope_x z, y + slope_y z), the cone has the radius radius +
    slope z. The part is empty if the second number is not above the first.
    """
    low, high = max(z_low, 0.0), z_high
    a = slope_x * slope_x + slope_y * slope_y - slope * slope
    b = x * slope_x + y * slope_y - radius * slope
    c = x * x + y * y - radius * radius
    inside = b * b - a * c
    if abs(a) < 1e-14:
        if abs(b) < 1e-300:
            return (low, high) if c < 0 else (1.0, 0.0)
        root = -0.5 * c / b
        return (low, min(high, root)) if b > 0 else (max(low, root), high)
    if inside <= 0.0:
        return (1.0, 0.0) if a > 0 else (low, high)
    # Roots without cancellation.
    q = -(b + math.copysign(math.sqrt(inside), b))
    first, second = q / a, c / q if q != 0.0 else q / a
    smaller, larger = min(first, second), max(first, second)
    if a > 0:
        return max(low, smaller), min(high, larger)
    return max(low, larger), high
