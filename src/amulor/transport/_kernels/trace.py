"""Paths of photons in compiled loops: straight segments between scatterings.

A path is traced forward from the source, or against the light from the receiver (an
adjoint path). The axis z is that of the receiver, which looks along +z from z = 0.
Layers lie across z. Absorption ends a path by chance, so no weight is carried.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from amulor.transport._kernels.angle import draw_height
from amulor.transport._kernels.mesh import facing_normal, first_hit
from amulor.transport._kernels.polarization import (
    cross,
    reflected,
    scattered,
    seen_through,
    turned_frame,
)
from amulor.transport._kernels.random import exponential, uniform
from amulor.transport._kernels.types import Array, Integers, Packed, States, Vector

# Columns of a segment. X, Y and LENGTH are those at z = 0 on its straight line.
Z_LOW, Z_HIGH, X, Y, SLOPE_X, SLOPE_Y, PER_Z, LENGTH = range(8)
NX, NY, NZ, PARTITION, ORDER, LAYER, FRONT, FACE, SCALE, START = range(8, 18)
SEGMENT_COLUMNS = 18  # START is the row of the first segment of the path

# Columns of a touch of the target: place, path length, order, direction of the light,
# normal on its side, and number of the triangle (-1 for a plane).
TOUCH_X, TOUCH_Y, TOUCH_Z, TOUCH_LENGTH, TOUCH_ORDER, TOUCHES = range(6)
TOUCH_NX, TOUCH_NY, TOUCH_NZ = range(6, 9)
NORMAL_X, NORMAL_Y, NORMAL_Z, TRIANGLE = range(9, 13)
TOUCH_COLUMNS = 13

_LEVEL = 1e-9  # segments with less of a slope have no z to be joined at


@njit(cache=True, error_model="numpy")
def room(array: Array, used: int) -> Array:
    """Return the array, or one twice as long with the same rows if it is full."""
    if used < array.shape[0]:
        return array
    longer = np.empty((2 * array.shape[0], array.shape[1]))
    for row in range(used):
        for column in range(array.shape[1]):
            longer[row, column] = array[row, column]
    return longer


@njit(cache=True, error_model="numpy")
def layer_of(z: float, edge: Array) -> int:
    """Return the layer in which z lies; -1 or the number of layers outside."""
    k = 0
    while k < edge.size and z >= edge[k]:
        k += 1
    return k - 1


@njit(cache=True, error_model="numpy")
def any_frame(nx: float, ny: float, nz: float) -> Vector:
    """Return some unit vector perpendicular to n."""
    sign = 1.0 if nz >= 0 else -1.0
    factor = -1.0 / (sign + nz)
    return 1.0 + sign * nx * nx * factor, sign * nx * ny * factor, -sign * nx


@njit(cache=True, error_model="numpy")
def trace(
    state: States,
    thickness: float,
    start: Array,
    face: float,
    scale: float,
    adjoint: bool,
    polarized: bool,
    now: Array,
    after: Array,
    water: Packed,
    target: Packed,
    segment: Array,
    light: Array,
    touch: Array,
    touch_light: Array,
    count: Integers,
) -> tuple[Array, Array, Array, Array]:
    """Add the segments and touches of one path, and return the arrays.

    thickness is the optical one of the first flight. count holds the number of
    forward segments, of touches and of adjoint segments, and is moved on. water holds
    edges, attenuation, albedo, table and the tables; target whether it is a plane, the
    normal and height of that, reflectance and matrix, and the mesh, which may be empty.
    Adjoint paths go through the target; what of them is in front of a plane is told by
    FRONT, the least height of their vertices over it, the start left out.
    """
    edge, attenuation, albedo, table, urn, value, element = water
    has_plane, normal, height, reflectance, mueller, mesh = target
    has_mesh = mesh[0].shape[0] > 0
    x, y, z = start[0], start[1], start[2]
    nx, ny, nz = start[3], start[4], start[5]
    ex, ey, ez = start[6], start[7], start[8]
    layer = layer_of(z, edge)
    used = count[2] if adjoint else count[0]
    touches = count[1]
    first = used
    columns = light.shape[1]
    now[0], now[1], now[2] = ex, ey, ez
    length = 0.0
    partition = 0.0
    front = math.inf
    order = 0
    met = 0
    ux, uy, uz = normal[0], normal[1], normal[2]
    triangle = -1.0
    while True:
        to_target = math.inf
        if has_plane and not adjoint:
            fall = normal[0] * nx + normal[1] * ny + normal[2] * nz
            if fall < 0:
                over = normal[0] * x + normal[1] * y + normal[2] * z - height
                to_target = max(over, 0.0) / -fall
        if has_mesh and not adjoint:
            thinnest = math.inf
            for k in range(attenuation.size):
                thinnest = min(thinnest, attenuation[k])
            limit = thickness / thinnest
            to_target, hit = first_hit(x, y, z, nx, ny, nz, limit, 0.0, triangle, mesh)
            triangle = hit
            if hit < 0.0:
                to_target = math.inf
            else:
                ux, uy, uz = facing_normal(hit, nx, ny, nz, mesh)
        end = 0  # 1 out of the water, 2 at the target, 3 at a collision
        while end == 0:
            if layer < 0 or layer >= attenuation.size:
                end = 1
                break
            step = math.inf
            if nz > 0:
                step = (edge[layer + 1] - z) / nz
            elif nz < 0:
                step = (edge[layer] - z) / nz
            cross_edge = True
            if thickness < attenuation[layer] * step:
                step = thickness / attenuation[layer]
                cross_edge = False
                end = 3
            if to_target < step:
                step = to_target
                cross_edge = False
                end = 2
            if step == math.inf:
                end = 1
                break
            next_z = z + nz * step
            if cross_edge:
                next_z = edge[layer + 1] if nz > 0 else edge[layer]
            if met == 0 and abs(nz) > _LEVEL:
                if used == segment.shape[0]:
                    segment = room(segment, used)
                segment[used, Z_LOW], segment[used, Z_HIGH] = (
                    min(z, next_z),
                    max(z, next_z),
                )
                segment[used, SLOPE_X], segment[used, SLOPE_Y], segment[used, PER_Z] = (
                    nx / nz,
                    ny / nz,
                    1.0 / nz,
                )
                segment[used, X], segment[used, Y] = (
                    x - z * segment[used, SLOPE_X],
                    y - z * segment[used, SLOPE_Y],
                )
                segment[used, LENGTH] = length - z * segment[used, PER_Z]
                segment[used, NX], segment[used, NY], segment[used, NZ] = nx, ny, nz
                segment[used, PARTITION], segment[used, ORDER], segment[used, LAYER] = (
                    partition,
                    order,
                    layer,
                )
                segment[used, FRONT] = front
                segment[used, FACE], segment[used, SCALE] = face, scale
                segment[used, START] = first
                if polarized:
                    if used == light.shape[0]:
                        light = room(light, used)
                    for k in range(columns):
                        light[used, k] = now[k]
                used += 1
            x += nx * step
            y += ny * step
            z = next_z
            length += step
            to_target -= step
            if cross_edge:
                thickness -= attenuation[layer] * step
                layer += 1 if nz > 0 else -1
            elif end == 2:
                thickness -= attenuation[layer] * step
        if end == 1:
            break
        if end == 2:
            touch = room(touch, touches)
            (
                touch[touches, TOUCH_X],
                touch[touches, TOUCH_Y],
                touch[touches, TOUCH_Z],
            ) = x, y, z
            (
                touch[touches, TOUCH_LENGTH],
                touch[touches, TOUCH_ORDER],
                touch[touches, TOUCHES],
            ) = length, order, met
            (
                touch[touches, TOUCH_NX],
                touch[touches, TOUCH_NY],
                touch[touches, TOUCH_NZ],
            ) = nx, ny, nz
            (
                touch[touches, NORMAL_X],
                touch[touches, NORMAL_Y],
                touch[touches, NORMAL_Z],
            ) = ux, uy, uz
            touch[touches, TRIANGLE] = triangle
            if polarized:
                touch_light = room(touch_light, touches)
                for k in range(columns):
                    touch_light[touches, k] = now[k]
            touches += 1
            met += 1
            if uniform(state) >= reflectance:
                break
            # Lambert's law about the normal.
            ax, ay, az = any_frame(ux, uy, uz)
            bx, by, bz = cross(ux, uy, uz, ax, ay, az)
            share = uniform(state)
            up, out = math.sqrt(1.0 - share), math.sqrt(share)
            azimuth = 2.0 * math.pi * uniform(state)
            along, across = out * math.cos(azimuth), out * math.sin(azimuth)
            mx = up * ux + along * ax + across * bx
            my = up * uy + along * ay + across * by
            mz = up * uz + along * az + across * bz
            if polarized:
                fx, fy, fz = any_frame(mx, my, mz)
                after[0], after[1], after[2] = fx, fy, fz
                after[3], after[4], after[5], after[6] = reflected(
                    nx, ny, nz, now, mueller, mx, my, mz, after
                )
                for k in range(columns):
                    now[k] = after[k]
                ex, ey, ez = fx, fy, fz
            nx, ny, nz = mx, my, mz
            thickness = exponential(state)
            continue
        triangle = -1.0
        if uniform(state) >= albedo[layer]:
            break
        at = table[layer]
        drawn, cell = draw_height(state, urn, at)
        cosine = 1.0 - 2.0 * drawn
        sine = 2.0 * math.sqrt(drawn * (1.0 - drawn))
        azimuth = 2.0 * math.pi * uniform(state)
        cos_azimuth, sin_azimuth = math.cos(azimuth), math.sin(azimuth)
        if not polarized:
            ex, ey, ez = any_frame(nx, ny, nz)
        sign = -1.0 if adjoint else 1.0  # the light travels against an adjoint path
        fx, fy, fz = turned_frame(
            cos_azimuth, sin_azimuth, sign * nx, sign * ny, sign * nz, ex, ey, ez
        )
        mx = cosine * nx + sine * fx
        my = cosine * ny + sine * fy
        mz = cosine * nz + sine * fz
        norm = 1.0 / math.sqrt(mx * mx + my * my + mz * mz)
        mx, my, mz = mx * norm, my * norm, mz * norm
        if polarized:
            if adjoint:
                seen_through(now, 3, cos_azimuth, sin_azimuth, element, at, cell, after)
                for k in range(3, columns):
                    now[k] = after[k]
            else:
                now[3], now[4], now[5], now[6] = scattered(
                    now[4],
                    now[5],
                    now[6],
                    now[3],
                    cos_azimuth,
                    sin_azimuth,
                    element,
                    at,
                    cell,
                )
            # The parallel axis stays in the plane of scattering, for either way:
            # cos e - sin n forward, and with n = -m the same for an adjoint path.
            ex = cosine * fx - sine * nx
            ey = cosine * fy - sine * ny
            ez = cosine * fz - sine * nz
            now[0], now[1], now[2] = ex, ey, ez
        partition += abs(nz * mz) / (
            attenuation[layer] * albedo[layer] * value[at, cell]
        )
        if adjoint and has_plane:
            front = min(front, normal[0] * x + normal[1] * y + normal[2] * z)
        nx, ny, nz = mx, my, mz
        order += 1
        thickness = exponential(state)
    if adjoint:
        count[2] = used
    else:
        count[0], count[1] = used, touches
    return segment, light, touch, touch_light
