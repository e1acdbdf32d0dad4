"""Joins of target reflections with adjoint paths, over a block of groups.

Light that is scattered on its way out and back spreads over much more of the target
than the receiver's face covers, so few of the pairs meet. The reflections of a whole
block of groups are therefore sorted by place, and each adjoint segment is joined with
those in its reach. Theory: docs/theory/photon-transport.md, "Reflections are joined by
place".
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from amulor.transport._kernels.contributions import (
    TARGET,
    add_point,
    add_scores,
    add_to,
    place_scores,
    touch_scores,
)
from amulor.transport._kernels.joins import path_blocked
from amulor.transport._kernels.sampling import uniform
from amulor.transport._kernels.surfaces import leaving_light
from amulor.transport._kernels.trace import (
    FACE,
    FIRST_SEGMENT,
    FRONT,
    GROUP,
    LENGTH,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    NX,
    NY,
    NZ,
    ORDER,
    PER_Z,
    REFLECTANCE,
    SCALE,
    SEGMENT_COLUMNS,
    SLOPE_X,
    SLOPE_Y,
    TOUCH_COLUMNS,
    TOUCH_GROUP,
    TOUCH_LENGTH,
    TOUCH_NX,
    TOUCH_NY,
    TOUCH_NZ,
    TOUCH_ORDER,
    TOUCH_X,
    TOUCH_Y,
    TOUCH_Z,
    TOUCHES,
    TRIANGLE,
    USED_SEGMENTS,
    USED_TOUCHES,
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
    Paths,
    Plan,
    Record,
    Scene,
    States,
    Target,
    allocating,
    inner,
    step,
)

#: Strips that the reflections are divided into at most.
_STRIPS = 4096


class Strips(NamedTuple):
    """Target reflections, sorted by strips along y and by y inside of a strip."""

    key: Array
    """Sorted keys: number of the strip times `span`, plus y - `bottom` [m]."""
    row: Integers
    """Row of each reflection, in the order of the keys."""
    left: float
    """Least x [m]."""
    bottom: float
    """Least y [m]."""
    height: float
    """Range of y [m]."""
    near: float
    """Least z [m]."""
    far: float
    """Largest z [m]."""
    width: float
    """Width of a strip along x [m]."""
    span: float
    """Distance between the keys of one y in two neighboring strips [m]."""
    last: int
    """Number of the last strip, from 0."""
    densest: int
    """Largest number of reflections in a square as wide as the receiver's face."""


@allocating
def strips_of(touch: Array, count: int, radius: float) -> Strips:
    """Sort target reflections into strips as wide as the receiver's face."""
    low = touch[0, :3].copy()
    high = low.copy()
    for i in range(1, count):
        for k in range(3):
            low[k] = min(low[k], touch[i, k])
            high[k] = max(high[k], touch[i, k])
    width = max(2.0 * radius, (high[0] - low[0]) / _STRIPS)
    height = high[1] - low[1]
    span = 2.0 * height + 4.0 * radius + 1.0
    key = np.empty(count)
    for i in range(count):
        strip = math.floor((touch[i, TOUCH_X] - low[0]) / width)
        key[i] = strip * span + touch[i, TOUCH_Y] - low[1]
    row = np.argsort(key)
    key = key[row]
    densest, end = 0, 0
    for begin in range(count):
        while end < count and key[end] <= key[begin] + 2.0 * radius:
            end += 1
        densest = max(densest, end - begin)
    return Strips(
        key,
        row,
        low[0],
        low[1],
        height,
        low[2],
        high[2],
        width,
        span,
        math.floor((high[0] - low[0]) / width),
        densest,
    )


@step
def rank(key: Array, value: float) -> int:
    """Return the number of sorted keys below a value."""
    low, high = 0, key.size
    while low < high:
        middle = (low + high) // 2
        if key[middle] < value:
            low = middle + 1
        else:
            high = middle
    return low


@step
def rows_between(
    strips: Strips, strip: int, bottom: float, top: float
) -> tuple[int, int]:
    """Return the first and the end of a strip's reflections between two heights."""
    start = strip * strips.span
    end = rank(strips.key, np.nextafter(start + top, math.inf))
    return rank(strips.key, start + bottom), end


@step
def reach(
    adjoint: Array, j: int, target: Target, near: float, far: float
) -> tuple[float, float, float, float]:
    """Return the range of x and y of the reflections that a segment can be joined with.

    The path may be shifted over the receiver's face, and the reflections lie from near
    to far. A shift p moves the point where the segment meets a plane with the normal N
    by p + s dz, dz = -N p / (N_z + N s), with the slope s of the segment. The range is
    empty, with its low above its high end, if the segment does not meet it.
    """
    face = adjoint[j, FACE]
    x, y = adjoint[j, X], adjoint[j, Y]
    sx, sy = adjoint[j, SLOPE_X], adjoint[j, SLOPE_Y]
    z_low, z_high = max(near, adjoint[j, Z_LOW]), min(far, adjoint[j, Z_HIGH])
    if z_low > z_high:
        return 0.0, -1.0, 0.0, -1.0
    x_low = x + min(z_low * sx, z_high * sx) - face
    x_high = x + max(z_low * sx, z_high * sx) + face
    y_low = y + min(z_low * sy, z_high * sy) - face
    y_high = y + max(z_low * sy, z_high * sy) + face
    if target.has_plane:
        normal = target.normal
        rise = normal[2] + normal[0] * sx + normal[1] * sy
        if abs(rise) > 1e-9:
            z = (target.height - normal[0] * x - normal[1] * y) / rise
            depth = face * math.hypot(normal[0], normal[1]) / abs(rise)
            over, up = face + abs(sx) * depth, face + abs(sy) * depth
            x_low, x_high = (
                max(x_low, x + z * sx - over),
                min(x_high, x + z * sx + over),
            )
            y_low, y_high = max(y_low, y + z * sy - up), min(y_high, y + z * sy + up)
    return x_low, x_high, y_low, y_high


@inner
def keep_crossing(adjoint: Paths, target: Target, polarized: bool) -> None:
    """Keep those segments of a group that a shift on the face may bring to a plane."""
    segment, light, normal = adjoint.segment, adjoint.light, target.normal
    tilt = math.hypot(normal[0], normal[1])
    row = adjoint.used[FIRST_SEGMENT]
    for j in range(row, adjoint.used[USED_SEGMENTS]):
        over = normal[0] * segment[j, X] + normal[1] * segment[j, Y] - target.height
        rise = normal[0] * segment[j, SLOPE_X] + normal[1] * segment[j, SLOPE_Y]
        rise += normal[2]
        low, high = over + rise * segment[j, Z_LOW], over + rise * segment[j, Z_HIGH]
        margin = tilt * segment[j, FACE] + 1e-9
        if min(low, high) > margin or max(low, high) < -margin:
            continue
        for column in range(segment.shape[1]):
            segment[row, column] = segment[j, column]
        if polarized:
            for column in range(light.shape[1]):
                light[row, column] = light[j, column]
        row += 1
    adjoint.used[USED_SEGMENTS] = row


@step
def join_touch(
    forward: Paths,
    adjoint: Paths,
    pair: tuple[int, int],
    share: float,
    scene: Scene,
    plan: Plan,
    record: Record,
    arrival: Arrival,
) -> bool:
    """Join a reflection with an adjoint segment; return whether they meet.

    The light of a pair is Omega times the BRDF and cos / |n'_z|, the cosine that
    between the target's normal and the way to the receiver. share is its part of the
    weight SCALE. It is recorded, and left in the work array of the arrival.
    """
    i, j = pair
    touch, second, out = forward.touch, adjoint.segment, arrival.light
    target, face = scene.target, scene.face
    plane, mesh = target.normal, target.mesh
    z = touch[i, TOUCH_Z]
    if z <= second[j, Z_LOW] or z > second[j, Z_HIGH]:
        return False
    px = touch[i, TOUCH_X] - second[j, X] - z * second[j, SLOPE_X]
    py = touch[i, TOUCH_Y] - second[j, Y] - z * second[j, SLOPE_Y]
    if px * px + py * py > second[j, FACE] * second[j, FACE]:
        return False
    m = (-second[j, NX], -second[j, NY], -second[j, NZ])
    normal = (touch[i, NORMAL_X], touch[i, NORMAL_Y], touch[i, NORMAL_Z])
    leaving = normal[0] * m[0] + normal[1] * m[1] + normal[2] * m[2]
    if leaving <= 0.0:
        return False
    if (
        target.has_plane
        and second[j, ORDER] > 0
        and plane[0] * px + plane[1] * py + second[j, FRONT] < target.height
    ):
        return False
    if mesh.box.shape[0] > 0 and path_blocked(
        second, j, (px, py, z), touch[i, TRIANGLE], mesh
    ):
        return False
    factor = share * second[j, SCALE] / math.pi
    factor *= leaving / abs(m[2])
    factor *= order_weight(touch[i, TOUCH_ORDER], plan.roulette)
    factor *= order_weight(second[j, ORDER], plan.roulette)
    leaving_light(
        (touch[i, TOUCH_NX], touch[i, TOUCH_NY], touch[i, TOUCH_NZ]),
        m,
        normal,
        touch[i, REFLECTANCE],
        target,
        forward.touch_light[i if plan.polarized else 0],
        adjoint.light[j if plan.polarized else 0],
        out,
    )
    for k in range(out.size):
        out[k] *= factor
    add_to(arrival.total, TARGET, out)
    unscattered = touch[i, TOUCH_ORDER] + second[j, ORDER] == 0
    length = touch[i, TOUCH_LENGTH] + second[j, LENGTH] + z * second[j, PER_Z]
    direct = unscattered and touch[i, TOUCHES] == 0
    add_point(record, record.orders if direct else record.orders + 1, length, out)
    touch_scores(touch, i, target.reflectance, arrival)
    for k in range(touch.shape[1] - TOUCH_COLUMNS):
        arrival.score[k] += second[j, SEGMENT_COLUMNS + k]
    if face.moved:
        place_scores(px, py, face, touch.shape[1] - TOUCH_COLUMNS, arrival)
    add_scores(record, TARGET, length, length, arrival)
    return True


@allocating
def join_touches(
    state: States,
    forward: Paths,
    adjoint: Paths,
    scene: Scene,
    plan: Plan,
    record: Record,
    arrival: Arrival,
    weight: Array,
) -> int:
    """Join the target reflections of a block of groups with its adjoint segments.

    Of too many reflections in reach of a segment, a systematic sample is joined, each
    with the inverse of its chance. weight, one row a group, takes the light. A pair is
    of two groups: it is added to both, and the mean over the block is taken off. So
    the sum is right, and its variance. Returns how many reflections one adjoint path
    may reach.
    """
    strips = strips_of(forward.touch, forward.used[USED_TOUCHES], scene.face.radius)
    groups, touch = weight.shape[0], forward.touch
    second, total = adjoint.segment, arrival.total
    total[:] = 0.0
    for j in range(adjoint.used[USED_SEGMENTS]):
        if plan.direct and second[j, ORDER] == 0:
            continue
        x_low, x_high, y_low, y_high = reach(
            second, j, scene.target, strips.near, strips.far
        )
        bottom = max(y_low - strips.bottom, 0.0)
        top = min(y_high - strips.bottom, strips.height)
        first = max(math.floor((x_low - strips.left) / strips.width), 0)
        last = min(math.floor((x_high - strips.left) / strips.width), strips.last)
        if bottom > top or first > last:
            continue
        count = 0
        for strip in range(first, last + 1):
            begin, end = rows_between(strips, strip, bottom, top)
            count += end - begin
        if count == 0:
            continue
        stride, chosen = 1.0, 0.0
        if count > plan.reflections:
            stride = count / plan.reflections
            chosen = stride * uniform(state)
        passed = 0
        for strip in range(first, last + 1):
            begin, end = rows_between(strips, strip, bottom, top)
            while chosen < passed + end - begin:
                i = strips.row[begin + int(chosen) - passed]
                if join_touch(
                    forward,
                    adjoint,
                    (i, j),
                    stride / groups,
                    scene,
                    plan,
                    record,
                    arrival,
                ):
                    add_to(weight[int(touch[i, TOUCH_GROUP])], TARGET, arrival.light)
                    add_to(weight[int(second[j, GROUP])], TARGET, arrival.light)
                chosen += stride
            passed += end - begin
    for g in range(groups):
        for k in range(weight.shape[2]):
            weight[g, TARGET, k] -= total[TARGET, k] / groups
    return strips.densest
