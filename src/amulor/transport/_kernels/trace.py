"""Compiled photon paths: straight flights between scattering or reflection events.

A path is traced forward from the source, or against the light from the receiver (an
adjoint path). The axis z is that of the receiver, which looks along +z from z = 0.
Layers lie across z. Absorption ends a path by chance. Long paths also end by roulette;
their weight follows from the number of scatterings. Theory:
docs/theory/photon-transport.md, "Forward and adjoint paths are joined", and
"Polarization" for the light of a path. Compiled, as a run follows millions of paths of
several corners each.
"""

from __future__ import annotations

import math

import numpy as np

from amulor.transport._kernels.mesh import facing_normal, first_hit
from amulor.transport._kernels.polarization import (
    ADJOINT_COLUMNS,
    any_frame,
    deflected,
    scattered,
    see_through,
)
from amulor.transport._kernels.sampling import draw_height, exponential, uniform
from amulor.transport._kernels.surfaces import reflect
from amulor.transport._kernels.types import (
    Array,
    Face,
    Kind,
    Past,
    Paths,
    Ray,
    Scene,
    States,
    Target,
    Vector,
    Walk,
    Water,
    allocating,
    kernel,
    step,
)

# Columns of a segment. X, Y and LENGTH are those at z = 0 on its straight line.
Z_LOW, Z_HIGH, X, Y, SLOPE_X, SLOPE_Y, PER_Z, LENGTH = range(8)
NX, NY, NZ, PARTITION, ORDER, LAYER, FRONT, FACE, SCALE, START = range(8, 18)
GROUP = 18  # START is the row of the first segment of the path
SEGMENT_COLUMNS = 19  # followed by the path's sum of each score

# Columns of a touch of the target: place, path length, order, direction of the light,
# normal on its side, number of the triangle (-1 for a plane), number of the group and
# diffuse reflectance.
TOUCH_X, TOUCH_Y, TOUCH_Z, TOUCH_LENGTH, TOUCH_ORDER, TOUCHES = range(6)
TOUCH_NX, TOUCH_NY, TOUCH_NZ = range(6, 9)
NORMAL_X, NORMAL_Y, NORMAL_Z, TRIANGLE, TOUCH_GROUP, REFLECTANCE = range(9, 15)
TOUCH_COLUMNS = 15  # followed by the path's sum of each score

#: Positions of the numbers of used rows, and of the first rows of the current group.
USED_SEGMENTS, USED_TOUCHES, FIRST_SEGMENT, FIRST_TOUCH = range(4)

#: How a flight ends: out of the water, at the target, or at a collision.
FLYING, OUT, HIT, COLLISION = range(4)

_LEVEL = 1e-9  # segments with less of a slope have no z to be joined at


@step
def has_room(paths: Paths, water: Water) -> bool:
    """Return whether the path arrays have enough free rows for another flight."""
    return bool(
        paths.used[USED_SEGMENTS] + water.attenuation.size < paths.segment.shape[0]
        and paths.used[USED_TOUCHES] < paths.touch.shape[0]
    )


@allocating
def more_rows(array: Array, layers: int) -> Array:
    """Copy an array into one with more than twice as many rows."""
    rows = array.shape[0]
    longer = np.empty((2 * (rows + layers), array.shape[1]))
    for row in range(rows):
        for column in range(array.shape[1]):
            longer[row, column] = array[row, column]
    return longer


@allocating
def longer(paths: Paths, layers: int, polarized: bool) -> Paths:
    """Copy path arrays into longer ones; light arrays only for polarized paths."""
    light, touch_light = paths.light, paths.touch_light
    if polarized:
        light, touch_light = more_rows(light, layers), more_rows(touch_light, layers)
    return Paths(
        more_rows(paths.segment, layers),
        light,
        more_rows(paths.touch, layers),
        touch_light,
        paths.used,
    )


@kernel
def order_weight(order: float, roulette: int) -> float:
    """Return the weight of a path that has survived its roulette.

    Beyond N scatterings a path goes on from n to n + 1 with the probability
    n / (n + 1). It has survived with N / n, so its light counts n / N.
    """
    return max(order / roulette, 1.0)


@kernel
def layer_of(z: float, edge: Array) -> int:
    """Return the layer index at z; -1 before the first, layer count beyond the last."""
    k = 0
    while k < edge.size and z >= edge[k]:
        k += 1
    return k - 1


@step
def surface_ahead(
    ray: Ray, thickness: float, start: float, water: Water, target: Target
) -> tuple[float, Vector, float]:
    """Return distance, surface normal and triangle index where a ray meets the target.

    The distance is infinite if no part of the target is within the optical thickness
    of the flight in the clearest water. start is the triangle that the ray starts on,
    or -1; so is the triangle if there is none.
    """
    x, y, z = ray.place
    nx, ny, nz = ray.direction
    normal = (target.normal[0], target.normal[1], target.normal[2])
    if target.has_plane:
        fall = normal[0] * nx + normal[1] * ny + normal[2] * nz
        if fall < 0:
            over = normal[0] * x + normal[1] * y + normal[2] * z - target.height
            return max(over, 0.0) / -fall, normal, -1.0
    elif target.mesh.box.shape[0] > 0:
        clearest = math.inf
        for k in range(water.attenuation.size):
            clearest = min(clearest, water.attenuation[k])
        limit = thickness / clearest
        distance, triangle = first_hit(
            ray.place, ray.direction, limit, 0.0, start, target.mesh
        )
        if triangle >= 0.0:
            normal = facing_normal(triangle, ray.direction, target.mesh)
            return distance, normal, triangle
    return math.inf, normal, -1.0


@step
def fly(
    ray: Ray,
    thickness: float,
    to_target: float,
    past: Past,
    kind: Kind,
    water: Water,
    paths: Paths,
    now: Array,
) -> tuple[int, Vector, int, float]:
    """Record a flight's segments; return how it ends, end point, layer, path length.

    The fourth number is the length of the path up to there. thickness is the optical
    one of the flight, tau = c L summed over the layers, to_target the way to the
    target. A segment ends at each plane between layers; it can be joined until the
    path touches the target, and unless it is level.
    """
    edge, attenuation = water.edge, water.attenuation
    segment, light = paths.segment, paths.light
    x, y, z = ray.place
    nx, ny, nz = ray.direction
    layer, length = past.layer, past.length
    row = paths.used[USED_SEGMENTS]
    joinable = past.touches == 0.0 and abs(nz) > _LEVEL
    end = FLYING
    while end == FLYING:
        if layer < 0 or layer >= attenuation.size:
            end = OUT
            break
        step = math.inf
        if nz > 0:
            step = (edge[layer + 1] - z) / nz
        elif nz < 0:
            step = (edge[layer] - z) / nz
        if thickness < attenuation[layer] * step:
            step = thickness / attenuation[layer]
            end = COLLISION
        if to_target < step:
            step = to_target
            end = HIT
        if step == math.inf:
            end = OUT
            break
        next_z = z + nz * step
        if end == FLYING:
            next_z = edge[layer + 1] if nz > 0 else edge[layer]
        if joinable:
            slope_x, slope_y, per_z = nx / nz, ny / nz, 1.0 / nz
            segment[row, Z_LOW], segment[row, Z_HIGH] = min(z, next_z), max(z, next_z)
            segment[row, SLOPE_X], segment[row, SLOPE_Y] = slope_x, slope_y
            segment[row, PER_Z] = per_z
            segment[row, X], segment[row, Y] = x - z * slope_x, y - z * slope_y
            segment[row, LENGTH] = length - z * per_z
            segment[row, NX], segment[row, NY], segment[row, NZ] = nx, ny, nz
            segment[row, PARTITION], segment[row, ORDER] = past.partition, past.order
            segment[row, LAYER], segment[row, FRONT] = layer, past.front
            segment[row, FACE], segment[row, SCALE] = kind.face, kind.scale
            segment[row, START], segment[row, GROUP] = past.first, kind.group
            for k in range(water.score.shape[0]):
                segment[row, SEGMENT_COLUMNS + k] = now[ADJOINT_COLUMNS + k]
            if kind.polarized:
                for k in range(light.shape[1]):
                    light[row, k] = now[k]
            row += 1
        x += nx * step
        y += ny * step
        z = next_z
        length += step
        if end == FLYING:
            to_target -= step
            thickness -= attenuation[layer] * step
            layer += 1 if nz > 0 else -1
    paths.used[USED_SEGMENTS] = row
    return end, (x, y, z), layer, length


@step
def touch_target(
    ray: Ray,
    past: Past,
    normal: Vector,
    triangle: float,
    reflectance: float,
    kind: Kind,
    paths: Paths,
    now: Array,
) -> None:
    """Record a target reflection in the path arrays."""
    touch, touch_light = paths.touch, paths.touch_light
    row = paths.used[USED_TOUCHES]
    touch[row, TOUCH_X], touch[row, TOUCH_Y], touch[row, TOUCH_Z] = ray.place
    touch[row, TOUCH_LENGTH], touch[row, TOUCH_ORDER] = past.length, past.order
    touch[row, TOUCHES], touch[row, TRIANGLE] = past.touches, triangle
    touch[row, TOUCH_GROUP], touch[row, REFLECTANCE] = kind.group, reflectance
    touch[row, TOUCH_NX], touch[row, TOUCH_NY], touch[row, TOUCH_NZ] = ray.direction
    touch[row, NORMAL_X], touch[row, NORMAL_Y], touch[row, NORMAL_Z] = normal
    for k in range(touch.shape[1] - TOUCH_COLUMNS):
        touch[row, TOUCH_COLUMNS + k] = now[ADJOINT_COLUMNS + k]
    if kind.polarized:
        for k in range(touch_light.shape[1]):
            touch_light[row, k] = now[k]
    paths.used[USED_TOUCHES] = row + 1


@step
def scatter(
    state: States, ray: Ray, layer: int, kind: Kind, water: Water, now: Array
) -> tuple[Ray, float]:
    """Draw a scattered ray; return it, and its term of the balance-heuristic weight.

    The angle is drawn from the phase function p, and |n_z m_z| / (b p) is added, the
    denominator of the weight w_k. The frame in now and the Stokes vector, or the
    Mueller matrix of an adjoint path, become those after the scattering; its scores
    are added to those of the path.
    """
    table = water.table[layer]
    drawn, cell = draw_height(state, water.urn, table)
    for k in range(water.score.shape[0]):
        now[ADJOINT_COLUMNS + k] += water.score[k, layer, cell]
    azimuth = 2.0 * math.pi * uniform(state)
    turn = (math.cos(azimuth), math.sin(azimuth))
    axis = ray.axis
    if not kind.polarized:
        axis = any_frame(ray.direction)
    sign = -1.0 if kind.adjoint else 1.0  # the light travels against an adjoint path
    m, axis = deflected(ray.direction, axis, drawn, turn, sign)
    if kind.polarized:
        element = water.element
        if kind.adjoint:
            see_through(now, turn, element, table, cell)
        else:
            vector = (now[3], now[4], now[5], now[6])
            now[3], now[4], now[5], now[6] = scattered(
                vector, turn, element, table, cell
            )
        now[0], now[1], now[2] = axis
    added = abs(ray.direction[2] * m[2]) / (
        water.attenuation[layer] * water.albedo[layer] * water.value[table, cell]
    )
    return Ray(ray.place, m, axis), added


@step
def trace(
    state: States,
    walk: Walk,
    kind: Kind,
    water: Water,
    target: Target,
    paths: Paths,
    now: Array,
) -> tuple[bool, Walk]:
    """Trace a path until it ends or its arrays are full; return whether it ended.

    Returns whether it has ended, and its position. `now` contains frame and Stokes
    vector, or Mueller matrix, of its light. Adjoint paths pass through the target;
    FRONT, the least height of their scattering events over a plane (without the start),
    states whether they are in front of it.
    """
    normal = target.normal
    ray, past, thickness, triangle = walk
    first = past.first
    while has_room(paths, water):
        distance, facing = math.inf, (0.0, 0.0, 0.0)
        if not kind.adjoint:
            distance, facing, triangle = surface_ahead(
                ray, thickness, triangle, water, target
            )
        end, place, layer, length = fly(
            ray, thickness, distance, past, kind, water, paths, now
        )
        if end == OUT:
            return True, walk
        ray = Ray(place, ray.direction, ray.axis)
        partition, front = past.partition, past.front
        order, touches = past.order, past.touches
        if end == HIT:
            past = Past(first, layer, length, partition, front, order, touches)
            reflectance = target.reflectance
            if triangle >= 0.0:
                reflectance *= target.mesh.texture[int(triangle)]
            touch_target(ray, past, facing, triangle, reflectance, kind, paths, now)
            reflects, ray = reflect(state, ray, facing, reflectance, target, kind, now)
            if not reflects:
                return True, walk
            touches += 1.0
        else:
            triangle = -1.0
            survival = water.albedo[layer]
            if order >= kind.roulette:
                survival *= order / (order + 1.0)
            if uniform(state) >= survival:
                return True, walk
            ray, added = scatter(state, ray, layer, kind, water, now)
            partition += added
            if kind.adjoint and target.has_plane:
                front = min(
                    front,
                    normal[0] * place[0] + normal[1] * place[1] + normal[2] * place[2],
                )
            order += 1.0
        past = Past(first, layer, length, partition, front, order, touches)
        thickness = exponential(state)
    return False, Walk(ray, past, thickness, triangle)


#: Scores of the receiver, the last ones: right, down, radius, tilts right and down.
RIGHT, DOWN, SIZE, TILT_RIGHT, TILT_DOWN = range(5)
RECEIVER_SCORES = 5


@step
def tilt_scores(n: Vector, face: Face) -> tuple[float, float]:
    """Return the scores of light that arrives against n, for tilts right and down.

    A tilt to the right by d changes the angle theta of the light to the axis by
    -d cos(azimuth), and exp(-theta^2 / gamma^2) by 2 theta cos(azimuth) / gamma^2.
    """
    across = math.sqrt(n[0] * n[0] + n[1] * n[1])
    if across == 0.0:
        return 0.0, 0.0
    scale = 2.0 * math.atan2(across, n[2]) / (across * face.acceptance**2)
    return scale * n[0], scale * n[1]


@allocating
def follow(
    state: States,
    thickness: float,
    ray: Ray,
    kind: Kind,
    scene: Scene,
    paths: Paths,
    now: Array,
) -> Paths:
    """Trace a path to its end, with arrays extended as needed; return the arrays.

    thickness is the optical one of the first flight; now holds the light at its start.
    """
    layer = layer_of(ray.place[2], scene.water.edge)
    first = paths.used[USED_SEGMENTS]
    past = Past(first, layer, 0.0, 0.0, math.inf, 0.0, 0.0)
    now[0], now[1], now[2] = ray.axis
    now[ADJOINT_COLUMNS:] = 0.0
    if kind.adjoint and scene.face.moved:
        right, down = tilt_scores(ray.direction, scene.face)
        now[now.size - RECEIVER_SCORES + TILT_RIGHT] = right
        now[now.size - RECEIVER_SCORES + TILT_DOWN] = down
    walk = Walk(ray, past, thickness, -1.0)
    while True:
        ended, walk = trace(state, walk, kind, scene.water, scene.target, paths, now)
        if ended:
            return paths
        paths = longer(paths, scene.water.attenuation.size, kind.polarized)
