"""Joins of forward with adjoint segments by a scattering in the water.

Of many segments few pairs meet. Both kinds then lie in cells of a grid, and only the
segments of one cell are compared. Theory: docs/theory/photon-transport.md, "Forward and
adjoint paths are joined".
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from amulor.transport._kernels.contributions import (
    WATER,
    add_range,
    add_scores,
    add_to,
    place_scores,
)
from amulor.transport._kernels.mesh import blocked
from amulor.transport._kernels.polarization import connected
from amulor.transport._kernels.sampling import cell_of, height_between, uniform
from amulor.transport._kernels.trace import (
    FACE,
    FIRST_SEGMENT,
    FRONT,
    LAYER,
    LENGTH,
    NX,
    NY,
    NZ,
    ORDER,
    PARTITION,
    PER_Z,
    SCALE,
    SEGMENT_COLUMNS,
    SLOPE_X,
    SLOPE_Y,
    START,
    USED_SEGMENTS,
    Z_HIGH,
    Z_LOW,
    X,
    Y,
    order_weight,
)
from amulor.transport._kernels.types import (
    Array,
    Arrival,
    Integers,
    Mesh,
    Paths,
    Plan,
    Record,
    Scene,
    States,
    Target,
    Vector,
    allocating,
    inner,
    step,
)

#: Pairs of a group from which the segments are sorted into cells.
_MANY_PAIRS = 20_000
#: Cells that a segment may lie in; longer ones are compared with all.
_MOST_CELLS = 64
#: Golden ratio less 1, the step of an even sequence of fractions.
_GOLDEN = 0.6180339887498949
#: Cell numbers are packed in 21 bits each.
_BITS = 21


class Cells(NamedTuple):
    """Forward segments of a group by cells of a cubic grid, in a hash table."""

    size: float
    """Length of a cell's edge [m]."""
    low: Integers
    """First cell of each segment along x, y and z, shape (segments, 3)."""
    head: Integers
    """First entry of each slot of the table, or -1."""
    after: Integers
    """Next entry of the same slot, or -1."""
    key: Integers
    """Packed cell numbers of each entry."""
    row: Integers
    """Number of the segment of each entry, from the group's first."""
    long: Integers
    """Numbers of the segments that lie in too many cells."""
    near: Integers
    """Work array for the numbers of the segments near an adjoint one."""


@step
def key_of(x: int, y: int, z: int) -> int:
    """Pack the numbers of a cell in one integer."""
    mask = (1 << _BITS) - 1
    return ((x & mask) << 2 * _BITS) | ((y & mask) << _BITS) | (z & mask)


@step
def slot_of(x: int, y: int, z: int, slots: int) -> int:
    """Return the slot of a cell in a table with a power of two of slots."""
    return (x * 73856093 ^ y * 19349663 ^ z * 83492791) & (slots - 1)


@step
def box_of(segment: Array, i: int, margin: float) -> tuple[Vector, Vector]:
    """Return the least and the largest coordinates of a segment, with a margin."""
    z_low, z_high = segment[i, Z_LOW], segment[i, Z_HIGH]
    x, y = segment[i, X], segment[i, Y]
    sx, sy = segment[i, SLOPE_X], segment[i, SLOPE_Y]
    return (
        (
            x + min(sx * z_low, sx * z_high) - margin,
            y + min(sy * z_low, sy * z_high) - margin,
            z_low,
        ),
        (
            x + max(sx * z_low, sx * z_high) + margin,
            y + max(sy * z_low, sy * z_high) + margin,
            z_high,
        ),
    )


@allocating
def cells_of(segment: Array, first: int, end: int, radius: float) -> Cells:
    """Sort the segments of a group into cells about as large as a segment."""
    count = end - first
    extent = 0.0
    for i in range(first, end):
        low, high = box_of(segment, i, 0.0)
        extent += max(high[0] - low[0], high[1] - low[1], high[2] - low[2])
    size = max(extent / count, 2.0 * radius)
    lows = np.empty((count, 3), dtype=np.int64)
    highs = np.empty((count, 3), dtype=np.int64)
    near = np.empty(count, dtype=np.int64)
    cells = np.empty(count, dtype=np.int64)
    entries, long_count = 0, 0
    for i in range(count):
        low, high = box_of(segment, first + i, 0.0)
        cells[i] = 1
        for k in range(3):
            lows[i, k] = math.floor(low[k] / size)
            highs[i, k] = math.floor(high[k] / size)
            cells[i] *= highs[i, k] - lows[i, k] + 1
        if cells[i] <= _MOST_CELLS:
            entries += cells[i]
        else:
            long_count += 1
    slots = 16
    while slots < entries:
        slots *= 2
    head = np.full(slots, -1, dtype=np.int64)
    after = np.empty(entries, dtype=np.int64)
    key = np.empty(entries, dtype=np.int64)
    row = np.empty(entries, dtype=np.int64)
    longer = np.empty(long_count, dtype=np.int64)
    entry, number = 0, 0
    for i in range(count):
        if cells[i] > _MOST_CELLS:
            longer[number] = i
            number += 1
            continue
        for x in range(lows[i, 0], highs[i, 0] + 1):
            for y in range(lows[i, 1], highs[i, 1] + 1):
                for z in range(lows[i, 2], highs[i, 2] + 1):
                    key[entry], row[entry] = key_of(x, y, z), i
                    slot = slot_of(x, y, z, slots)
                    after[entry] = head[slot]
                    head[slot] = entry
                    entry += 1
    return Cells(size, lows, head, after, key, row, longer, near)


@inner
def path_blocked(
    adjoint: Array, row: int, end: Vector, start: float, mesh: Mesh
) -> bool:
    """Return whether the mesh blocks an adjoint path after a shift over the receiver.

    end is the shift of the path over the face, and the depth z on its segment in row
    at which it ends; start is the number of the triangle that it ends on, or -1.
    """
    z = end[2]
    for k in range(row, int(adjoint[row, START]) - 1, -1):
        if k < row:
            z = adjoint[k, Z_HIGH] if adjoint[k, NZ] > 0.0 else adjoint[k, Z_LOW]
            start = -1.0
        begin = adjoint[k, Z_LOW] if adjoint[k, NZ] > 0.0 else adjoint[k, Z_HIGH]
        x, y = end[0] + adjoint[k, X], end[1] + adjoint[k, Y]
        slope_x, slope_y = adjoint[k, SLOPE_X], adjoint[k, SLOPE_Y]
        if blocked(
            (x + z * slope_x, y + z * slope_y, z),
            (x + begin * slope_x, y + begin * slope_y, begin),
            start,
            mesh,
        ):
            return True
    return False


@step
def meeting_depths(
    forward: Array, i: int, adjoint: Array, j: int, target: Target
) -> tuple[float, float]:
    """Return the depths between which a forward and an adjoint segment can join [m].

    At these both segments have a point, the shift rho(z) - rho'(z) is on the face of
    the receiver, and the shifted scatterings are in front of the target's plane. There
    are none if the second is not above the first.
    """
    z_low = max(forward[i, Z_LOW], adjoint[j, Z_LOW])
    z_high = min(forward[i, Z_HIGH], adjoint[j, Z_HIGH])
    if z_low >= z_high:
        return 0.0, 0.0
    face = adjoint[j, FACE]
    # Place of the start of the adjoint path on the face: p + d z.
    dx = forward[i, SLOPE_X] - adjoint[j, SLOPE_X]
    dy = forward[i, SLOPE_Y] - adjoint[j, SLOPE_Y]
    px = forward[i, X] - adjoint[j, X]
    py = forward[i, Y] - adjoint[j, Y]
    a = dx * dx + dy * dy
    b = px * dx + py * dy
    c = px * px + py * py - face * face
    inside = b * b - a * c
    if inside <= 0.0:
        return 0.0, 0.0
    if a < 1e-24:  # parallel: on the face for all z, as inside is above zero
        if c >= 0.0:
            return 0.0, 0.0
    else:
        root = math.sqrt(inside)
        z_low = max(z_low, (-b - root) / a)
        z_high = min(z_high, (-b + root) / a)
        if z_low >= z_high:
            return 0.0, 0.0
    if target.has_plane and adjoint[j, ORDER] > 0:
        normal = target.normal
        over = normal[0] * px + normal[1] * py + adjoint[j, FRONT] - target.height
        rise = normal[0] * dx + normal[1] * dy
        if rise > 0:
            z_low = max(z_low, -over / rise)
        elif rise < 0:
            z_high = min(z_high, -over / rise)
        elif over < 0:
            return 0.0, 0.0
    return z_low, z_high


@step
def join_pair(
    state: States,
    forward: Paths,
    adjoint: Paths,
    pair: tuple[int, int],
    scene: Scene,
    plan: Plan,
    record: Record,
    arrival: Arrival,
) -> None:
    """Join a pair of segments, if they meet, and record the light.

    The light of a pair is Omega b p(theta) dz / |n_z n'_z| times its weight w_k. FACE
    of an adjoint segment is the radius R of the face, SCALE is Omega over the number
    of pairs.
    """
    (i, j), water, target = pair, scene.water, scene.target
    first, second, out = forward.segment, adjoint.segment, arrival.light
    attenuation, albedo, table = water.attenuation, water.albedo, water.table
    value, mesh = water.value, target.mesh
    z_low, z_high = meeting_depths(first, i, second, j, target)
    if z_low >= z_high:
        return
    layer = int(first[i, LAYER])
    n = (first[i, NX], first[i, NY], first[i, NZ])
    m = (-second[j, NX], -second[j, NY], -second[j, NZ])
    cosine = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
    at, cell = table[layer], cell_of(height_between(cosine))
    kernel = attenuation[layer] * albedo[layer] * value[at, cell]
    if kernel <= 0.0:
        return
    order = int(first[i, ORDER] + second[j, ORDER])
    level = abs(n[2] * m[2])
    if plan.balanced:
        factor = second[j, SCALE] / (
            first[i, PARTITION] + second[j, PARTITION] + level / kernel
        )
    else:
        factor = second[j, SCALE] * kernel / (level * (order + 1))
    factor *= z_high - z_low
    factor *= order_weight(first[i, ORDER], plan.roulette)
    factor *= order_weight(second[j, ORDER], plan.roulette)
    if mesh.box.shape[0] > 0:
        z_low += (z_high - z_low) * uniform(state)
        z_high = z_low
        dx = first[i, SLOPE_X] - second[j, SLOPE_X]
        dy = first[i, SLOPE_Y] - second[j, SLOPE_Y]
        px = first[i, X] - second[j, X] + dx * z_low
        py = first[i, Y] - second[j, Y] + dy * z_low
        if path_blocked(second, j, (px, py, z_low), -1.0, mesh):
            return
    if plan.polarized:
        light, path_matrix = forward.light[i], adjoint.light[j]
        connected(n, light, m, path_matrix, water.element, at, cell, out)
        for k in range(4):
            out[k] *= factor
    else:
        out[0] = factor
    add_to(arrival.total, WATER, out)
    start = first[i, LENGTH] + second[j, LENGTH]
    slope = first[i, PER_Z] + second[j, PER_Z]
    near, far = start + slope * z_low, start + slope * z_high
    low, high = min(near, far), max(near, far)
    add_range(record, min(order, record.orders - 1), low, high, out)
    for k in range(water.score.shape[0]):
        column = SEGMENT_COLUMNS + k
        arrival.score[k] = first[i, column] + second[j, column]
        arrival.score[k] += water.score[k, layer, cell]
    add_scores(record, WATER, low, high, arrival)
    if scene.face.moved:
        # The place on the face changes with z, of which one value is drawn.
        fraction = arrival.fraction[0] + _GOLDEN
        arrival.fraction[0] = fraction - math.floor(fraction)
        z = z_low + (z_high - z_low) * arrival.fraction[0]
        px = first[i, X] - second[j, X] + z * (first[i, SLOPE_X] - second[j, SLOPE_X])
        py = first[i, Y] - second[j, Y] + z * (first[i, SLOPE_Y] - second[j, SLOPE_Y])
        arrival.score[:] = 0.0
        place_scores(px, py, scene.face, water.score.shape[0], arrival)
        add_scores(record, WATER, start + slope * z, start + slope * z, arrival)


@step
def segments_near(second: Array, j: int, cells: Cells) -> int:
    """Find the forward segments that share a cell with an adjoint one; return how many.

    Their numbers are written to the work array of the cells. A pair may share several
    cells. It is found in the first of them along each axis.
    """
    low, near, size = cells.low, cells.near, cells.size
    least, most = box_of(second, j, second[j, FACE])
    x_low, x_high = math.floor(least[0] / size), math.floor(most[0] / size)
    y_low, y_high = math.floor(least[1] / size), math.floor(most[1] / size)
    z_low, z_high = math.floor(least[2] / size), math.floor(most[2] / size)
    count = (x_high - x_low + 1) * (y_high - y_low + 1) * (z_high - z_low + 1)
    if count > near.size:
        for i in range(near.size):
            near[i] = i
        return int(near.size)
    found = 0
    for i in cells.long:
        near[found] = i
        found += 1
    for x in range(x_low, x_high + 1):
        for y in range(y_low, y_high + 1):
            for z in range(z_low, z_high + 1):
                key = key_of(x, y, z)
                entry = cells.head[slot_of(x, y, z, cells.head.size)]
                while entry >= 0:
                    i = cells.row[entry]
                    if (
                        cells.key[entry] == key
                        and x == max(x_low, low[i, 0])
                        and y == max(y_low, low[i, 1])
                        and z == max(z_low, low[i, 2])
                    ):
                        near[found] = i
                        found += 1
                    entry = cells.after[entry]
    return found


@inner
def join_segments(
    state: States,
    forward: Paths,
    adjoint: Paths,
    cells: Cells,
    scene: Scene,
    plan: Plan,
    record: Record,
    arrival: Arrival,
) -> None:
    """Join the segments of a group; all pairs if there are no cells."""
    begin = forward.used[FIRST_SEGMENT]
    count = forward.used[USED_SEGMENTS] - begin
    for j in range(adjoint.used[FIRST_SEGMENT], adjoint.used[USED_SEGMENTS]):
        if plan.direct and adjoint.segment[j, ORDER] == 0:
            continue
        if cells.near.size > 0:
            count = segments_near(adjoint.segment, j, cells)
        for number in range(count):
            i = begin + (cells.near[number] if cells.near.size > 0 else number)
            join_pair(state, forward, adjoint, (i, j), scene, plan, record, arrival)


@allocating
def no_cells() -> Cells:
    """Return cells without segments."""
    none = np.empty(0, dtype=np.int64)
    return Cells(
        1.0, np.empty((0, 3), dtype=np.int64), none, none, none, none, none, none
    )


@allocating
def join_group(
    state: States,
    forward: Paths,
    adjoint: Paths,
    none: Cells,
    scene: Scene,
    plan: Plan,
    record: Record,
    arrival: Arrival,
) -> None:
    """Join the segments of a group, by cells if there are many pairs."""
    begin, end = forward.used[FIRST_SEGMENT], forward.used[USED_SEGMENTS]
    partners = adjoint.used[USED_SEGMENTS] - adjoint.used[FIRST_SEGMENT]
    cells = none
    if (end - begin) * partners > _MANY_PAIRS:
        cells = cells_of(forward.segment, begin, end, scene.face.radius)
    join_segments(state, forward, adjoint, cells, scene, plan, record, arrival)
