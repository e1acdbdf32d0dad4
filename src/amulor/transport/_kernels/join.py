"""Joining forward and adjoint paths in compiled loops.

Water that is the same all over a plane across z lets an adjoint path be shifted over
the face of the receiver until it meets a forward path. For each pair of segments the
depths z at which that shift stays on the face are an interval, and the light over it
is spread evenly over path lengths. A target may hide parts of that interval: a plane
one end of it, and with a mesh it is tried at one depth drawn from the interval.
Theory: docs/theory/photon-transport.md, "A path is joined where it is the least
accidental": P, Omega and w_k. Compiled, as each group of 8 x 8 paths has some thousand
pairs of segments.
"""

from __future__ import annotations

import math

from amulor.transport._kernels.angle import cell_of, height_between
from amulor.transport._kernels.compiled import inner, step
from amulor.transport._kernels.mesh import blocked
from amulor.transport._kernels.polarization import connected, received, reflected
from amulor.transport._kernels.random import uniform
from amulor.transport._kernels.record import TARGET, WATER, add_point, add_range, add_to
from amulor.transport._kernels.trace import (
    FACE,
    FRONT,
    LAYER,
    LENGTH,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    NX,
    NY,
    NZ,
    ORDER,
    PARTITION,
    PER_Z,
    SCALE,
    SLOPE_X,
    SLOPE_Y,
    START,
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
)
from amulor.transport._kernels.types import (
    Array,
    Arrival,
    Mesh,
    Paths,
    Plan,
    Record,
    States,
    Target,
    Vector,
    Water,
)


@inner
def path_blocked(
    adjoint: Array, row: int, end: Vector, start: float, mesh: Mesh
) -> bool:
    """Return whether the mesh is in the way of a shifted adjoint path.

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
    """Return the depths z from which to which two segments can meet.

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


@inner
def join_segments(
    state: States,
    forward: Paths,
    adjoint: Paths,
    water: Water,
    target: Target,
    plan: Plan,
    record: Record,
    arrival: Arrival,
) -> None:
    """Join each forward with each adjoint segment, and add the light.

    The light of a pair is Omega b p(theta) dz / |n_z n'_z| times its weight w_k. FACE
    of an adjoint segment is the radius R of the face, SCALE is Omega over the number
    of pairs.
    """
    first, second = forward.segment, adjoint.segment
    attenuation, albedo, table = water.attenuation, water.albedo, water.table
    value, mesh, out = water.value, target.mesh, arrival.light
    has_mesh = mesh.box.shape[0] > 0
    total = arrival.total
    for j in range(adjoint.used[USED_SEGMENTS]):
        if plan.direct and second[j, ORDER] == 0:
            continue
        for i in range(forward.used[USED_SEGMENTS]):
            z_low, z_high = meeting_depths(first, i, second, j, target)
            if z_low >= z_high:
                continue
            layer = int(first[i, LAYER])
            n = (first[i, NX], first[i, NY], first[i, NZ])
            m = (-second[j, NX], -second[j, NY], -second[j, NZ])
            cosine = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
            at, cell = table[layer], cell_of(height_between(cosine))
            kernel = attenuation[layer] * albedo[layer] * value[at, cell]
            if kernel <= 0.0:
                continue
            order = int(first[i, ORDER] + second[j, ORDER])
            level = abs(n[2] * m[2])
            if plan.balanced:
                factor = second[j, SCALE] / (
                    first[i, PARTITION] + second[j, PARTITION] + level / kernel
                )
            else:
                factor = second[j, SCALE] * kernel / (level * (order + 1))
            factor *= z_high - z_low
            if has_mesh:
                z_low += (z_high - z_low) * uniform(state)
                z_high = z_low
                dx = first[i, SLOPE_X] - second[j, SLOPE_X]
                dy = first[i, SLOPE_Y] - second[j, SLOPE_Y]
                px = first[i, X] - second[j, X] + dx * z_low
                py = first[i, Y] - second[j, Y] + dy * z_low
                if path_blocked(second, j, (px, py, z_low), -1.0, mesh):
                    continue
            if plan.polarized:
                light, seen = forward.light[i], adjoint.light[j]
                connected(n, light, m, seen, water.element, at, cell, out)
                for k in range(4):
                    out[k] *= factor
            else:
                out[0] = factor
            add_to(total, WATER, out)
            start = first[i, LENGTH] + second[j, LENGTH]
            slope = first[i, PER_Z] + second[j, PER_Z]
            one, other = start + slope * z_low, start + slope * z_high
            part = min(order, record.orders - 1)
            add_range(record, part, min(one, other), max(one, other), out)


@inner
def join_touches(
    forward: Paths,
    adjoint: Paths,
    target: Target,
    plan: Plan,
    record: Record,
    arrival: Arrival,
) -> None:
    """Join each touch of the target with each adjoint segment, and add the light.

    The light of a pair is Omega (reflectance / pi) cos / |n'_z|, the cosine that
    between the target's normal and the way to the receiver.
    """
    touch, second = forward.touch, adjoint.segment
    normal, mesh, out = target.normal, target.mesh, arrival.light
    has_mesh = mesh.box.shape[0] > 0
    total = arrival.total
    for i in range(forward.used[USED_TOUCHES]):
        z = touch[i, TOUCH_Z]
        for j in range(adjoint.used[USED_SEGMENTS]):
            if (
                (plan.direct and second[j, ORDER] == 0)
                or z <= second[j, Z_LOW]
                or z > second[j, Z_HIGH]
            ):
                continue
            px = touch[i, TOUCH_X] - second[j, X] - z * second[j, SLOPE_X]
            py = touch[i, TOUCH_Y] - second[j, Y] - z * second[j, SLOPE_Y]
            if px * px + py * py > second[j, FACE] * second[j, FACE]:
                continue
            m = (-second[j, NX], -second[j, NY], -second[j, NZ])
            leaving = (
                touch[i, NORMAL_X] * m[0]
                + touch[i, NORMAL_Y] * m[1]
                + touch[i, NORMAL_Z] * m[2]
            )
            if leaving <= 0.0:
                continue
            if (
                target.has_plane
                and second[j, ORDER] > 0
                and normal[0] * px + normal[1] * py + second[j, FRONT] < target.height
            ):
                continue
            if has_mesh and path_blocked(
                second, j, (px, py, z), touch[i, TRIANGLE], mesh
            ):
                continue
            factor = (
                second[j, SCALE] * target.reflectance / math.pi * leaving / abs(m[2])
            )
            if plan.polarized:
                n = (touch[i, TOUCH_NX], touch[i, TOUCH_NY], touch[i, TOUCH_NZ])
                seen = adjoint.light[j]
                frame = (seen[0], seen[1], seen[2])
                light = forward.touch_light[i]
                vector = reflected(n, light, target.mueller, target.right, m, frame)
                received(seen, vector, out)
                for k in range(4):
                    out[k] *= factor
            else:
                out[0] = factor
            add_to(total, TARGET, out)
            unscattered = touch[i, TOUCH_ORDER] + second[j, ORDER] == 0
            length = touch[i, TOUCH_LENGTH] + second[j, LENGTH] + z * second[j, PER_Z]
            direct = unscattered and touch[i, TOUCHES] == 0
            add_point(
                record, record.orders if direct else record.orders + 1, length, out
            )
