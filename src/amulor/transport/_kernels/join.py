"""Joining forward and adjoint paths in compiled loops.

Water that is the same all over a plane across z lets an adjoint path be shifted over
the face of the receiver until it meets a forward path. For each pair of segments the
depths z at which that shift stays on the face are an interval, and the light over it
is spread evenly over path lengths. A target may hide parts of that interval: a plane
one end of it, and with a mesh it is tried at one depth drawn from the interval.
Theory: docs/theory, "Photon transport".
"""

from __future__ import annotations

import math

from numba import njit

from amulor.transport._kernels.angle import cell_of, height_between
from amulor.transport._kernels.mesh import blocked
from amulor.transport._kernels.polarization import connected, received, reflected
from amulor.transport._kernels.random import uniform
from amulor.transport._kernels.record import add_point, add_range
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
    Z_HIGH,
    Z_LOW,
    X,
    Y,
)
from amulor.transport._kernels.types import Array, Packed, States


@njit(cache=True, error_model="numpy")
def path_blocked(
    adjoint: Array,
    row: int,
    px: float,
    py: float,
    z: float,
    start: float,
    mesh: Packed,
) -> bool:
    """Return whether the mesh is in the way of a shifted adjoint path.

    The path starts at (px, py) on the face and ends at z on its segment in row; start
    is the number of the triangle it ends on, or -1.
    """
    end = z
    for k in range(row, int(adjoint[row, START]) - 1, -1):
        if k < row:
            end = adjoint[k, Z_HIGH] if adjoint[k, NZ] > 0.0 else adjoint[k, Z_LOW]
            start = -1.0
        begin = adjoint[k, Z_LOW] if adjoint[k, NZ] > 0.0 else adjoint[k, Z_HIGH]
        x, y = px + adjoint[k, X], py + adjoint[k, Y]
        if blocked(
            x + end * adjoint[k, SLOPE_X],
            y + end * adjoint[k, SLOPE_Y],
            end,
            x + begin * adjoint[k, SLOPE_X],
            y + begin * adjoint[k, SLOPE_Y],
            begin,
            start,
            mesh,
        ):
            return True
    return False


@njit(cache=True, error_model="numpy")
def join_segments(
    state: States,
    forward: Array,
    light: Array,
    forwards: int,
    adjoint: Array,
    seen: Array,
    adjoints: int,
    water: Packed,
    target: Packed,
    polarized: bool,
    balanced: bool,
    skip_direct: bool,
    record: Packed,
    scratch: Array,
) -> float:
    """Join each forward with each adjoint segment, and return the light added.

    FACE of an adjoint segment is the radius of the face, SCALE what a pair counts.
    """
    _, attenuation, albedo, table, _, value, element = water
    has_plane, normal, height, _, _, mesh = target
    has_mesh = mesh[0].shape[0] > 0
    mass, slope_record, beyond, wavenumber, spacing, orders = record
    total = 0.0
    for j in range(adjoints):
        if skip_direct and adjoint[j, ORDER] == 0:
            continue
        face = adjoint[j, FACE]
        lowest, highest = adjoint[j, Z_LOW], adjoint[j, Z_HIGH]
        for i in range(forwards):
            z_low = max(forward[i, Z_LOW], lowest)
            z_high = min(forward[i, Z_HIGH], highest)
            if z_low >= z_high:
                continue
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
                continue
            if a < 1e-24:  # parallel: on the face for all z, as inside is above zero
                if c >= 0.0:
                    continue
            else:
                root = math.sqrt(inside)
                z_low = max(z_low, (-b - root) / a)
                z_high = min(z_high, (-b + root) / a)
                if z_low >= z_high:
                    continue
            if has_plane and adjoint[j, ORDER] > 0:
                # All vertices of the shifted path have to be in front of the plane.
                over = normal[0] * px + normal[1] * py + adjoint[j, FRONT] - height
                rise = normal[0] * dx + normal[1] * dy
                if rise > 0:
                    z_low = max(z_low, -over / rise)
                elif rise < 0:
                    z_high = min(z_high, -over / rise)
                elif over < 0:
                    continue
                if z_low >= z_high:
                    continue
            layer = int(forward[i, LAYER])
            at = table[layer]
            cosine = -(
                forward[i, NX] * adjoint[j, NX]
                + forward[i, NY] * adjoint[j, NY]
                + forward[i, NZ] * adjoint[j, NZ]
            )
            cell = cell_of(height_between(cosine))
            level = abs(forward[i, NZ] * adjoint[j, NZ])
            kernel = attenuation[layer] * albedo[layer] * value[at, cell]
            if kernel <= 0.0:
                continue
            order = int(forward[i, ORDER] + adjoint[j, ORDER])
            if balanced:
                factor = adjoint[j, SCALE] / (
                    forward[i, PARTITION] + adjoint[j, PARTITION] + level / kernel
                )
            else:
                factor = adjoint[j, SCALE] * kernel / (level * (order + 1))
            factor *= z_high - z_low
            if has_mesh:
                z_low += (z_high - z_low) * uniform(state)
                z_high = z_low
                if path_blocked(
                    adjoint, j, px + dx * z_low, py + dy * z_low, z_low, -1.0, mesh
                ):
                    continue
            part = min(order, orders - 1)
            start = forward[i, LENGTH] + adjoint[j, LENGTH]
            slope = forward[i, PER_Z] + adjoint[j, PER_Z]
            first, last = start + slope * z_low, start + slope * z_high
            if polarized:
                connected(
                    forward[i, NX],
                    forward[i, NY],
                    forward[i, NZ],
                    light[i],
                    -adjoint[j, NX],
                    -adjoint[j, NY],
                    -adjoint[j, NZ],
                    seen[j],
                    element,
                    at,
                    cell,
                    scratch,
                )
                for k in range(4):
                    scratch[k] *= factor
            else:
                scratch[0] = factor
            total += scratch[0]
            add_range(
                mass,
                slope_record,
                beyond,
                wavenumber,
                spacing,
                part,
                min(first, last),
                max(first, last),
                scratch,
            )
    return total


@njit(cache=True, error_model="numpy")
def join_touches(
    touch: Array,
    touch_light: Array,
    touches: int,
    adjoint: Array,
    seen: Array,
    adjoints: int,
    target: Packed,
    polarized: bool,
    skip_direct: bool,
    record: Packed,
    scratch: Array,
) -> float:
    """Join each touch of the target with each adjoint segment that meets it."""
    has_plane, normal, height, reflectance, mueller, mesh = target
    has_mesh = mesh[0].shape[0] > 0
    mass, _, beyond, wavenumber, spacing, orders = record
    total = 0.0
    for i in range(touches):
        z = touch[i, TOUCH_Z]
        for j in range(adjoints):
            if (
                (skip_direct and adjoint[j, ORDER] == 0)
                or z <= adjoint[j, Z_LOW]
                or z > adjoint[j, Z_HIGH]
            ):
                continue
            px = touch[i, TOUCH_X] - adjoint[j, X] - z * adjoint[j, SLOPE_X]
            py = touch[i, TOUCH_Y] - adjoint[j, Y] - z * adjoint[j, SLOPE_Y]
            if px * px + py * py > adjoint[j, FACE] * adjoint[j, FACE]:
                continue
            leaving = -(
                touch[i, NORMAL_X] * adjoint[j, NX]
                + touch[i, NORMAL_Y] * adjoint[j, NY]
                + touch[i, NORMAL_Z] * adjoint[j, NZ]
            )
            if leaving <= 0.0:
                continue
            if (
                has_plane
                and adjoint[j, ORDER] > 0
                and normal[0] * px + normal[1] * py + adjoint[j, FRONT] < height
            ):
                continue
            if has_mesh and path_blocked(
                adjoint, j, px, py, z, touch[i, TRIANGLE], mesh
            ):
                continue
            factor = (
                adjoint[j, SCALE]
                * reflectance
                / math.pi
                * leaving
                / abs(adjoint[j, NZ])
            )
            if polarized:
                i_out, q_out, u_out, v_out = reflected(
                    touch[i, TOUCH_NX],
                    touch[i, TOUCH_NY],
                    touch[i, TOUCH_NZ],
                    touch_light[i],
                    mueller,
                    -adjoint[j, NX],
                    -adjoint[j, NY],
                    -adjoint[j, NZ],
                    seen[j],
                )
                received(seen[j], i_out, q_out, u_out, v_out, scratch)
                for k in range(4):
                    scratch[k] *= factor
            else:
                scratch[0] = factor
            total += scratch[0]
            direct = (
                touch[i, TOUCH_ORDER] + adjoint[j, ORDER] == 0
                and touch[i, TOUCHES] == 0
            )
            add_point(
                mass,
                beyond,
                wavenumber,
                spacing,
                orders if direct else orders + 1,
                touch[i, TOUCH_LENGTH] + adjoint[j, LENGTH] + z * adjoint[j, PER_Z],
                scratch,
            )
    return total
