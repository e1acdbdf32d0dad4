"""The last way to the receiver without a scattering, in compiled loops.

From a point of a forward path a point is drawn on that part of the receiver's face
from which the point lies within the acceptance (a local estimate). On a segment, the
point is drawn from the part that the receiver can see at all.
"""

from __future__ import annotations

import math

from numba import njit

from amulor.transport._kernels.angle import cell_of, disc_point, height_between
from amulor.transport._kernels.mesh import blocked
from amulor.transport._kernels.polarization import (
    connected,
    received,
    reflected,
    returning_frame,
)
from amulor.transport._kernels.random import uniform
from amulor.transport._kernels.record import add_point, cone_window, transmission_depth
from amulor.transport._kernels.trace import (
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
    SLOPE_X,
    SLOPE_Y,
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
from amulor.transport._kernels.types import Array, Packed, States, Vector


@njit(cache=True, error_model="numpy")
def face_and_acceptance(
    state: States, radius: float, acceptance: float, gaussian: bool
) -> tuple[float, float]:
    """Return radius and acceptance of a sharp receiver that stands for this one.

    A Gaussian exp(-s^2 / w^2) is the mean of discs of radius w sqrt(-ln u) over u
    from 0 to 1; so a Gaussian receiver is a sharp one of random size.
    """
    if not gaussian:
        return radius, acceptance
    face = radius * math.sqrt(-math.log(1.0 - uniform(state)))
    angle = acceptance * math.sqrt(-math.log(1.0 - uniform(state)))
    return face, min(angle, 0.5 * math.pi)


@njit(cache=True, error_model="numpy")
def face_point(
    state: States, x: float, y: float, z: float, face: float, slope: float
) -> Vector:
    """Draw a point of the face that sees (x, y, z), and return its share of the face.

    Returns the point relative to the centre and the area it stands for, 0 if it does
    not see the point.
    """
    visible = slope * z
    if visible < face:
        dx, dy = disc_point(state, visible)
        if (x + dx) ** 2 + (y + dy) ** 2 > face * face:
            return 0.0, 0.0, 0.0
        return x + dx, y + dy, math.pi * visible * visible
    px, py = disc_point(state, face)
    if (px - x) ** 2 + (py - y) ** 2 > visible * visible:
        return 0.0, 0.0, 0.0
    return px, py, math.pi * face * face


@njit(cache=True, error_model="numpy")
def direct_from_segments(
    state: States,
    forward: Array,
    light: Array,
    forwards: int,
    receiver: Packed,
    scale: float,
    water: Packed,
    target: Packed,
    polarized: bool,
    balanced: bool,
    record: Packed,
    scratch: Array,
    seen: Array,
) -> float:
    """Add the light scattered once more on each segment, straight to the receiver."""
    radius, acceptance, gaussian = receiver
    edge, attenuation, albedo, table, _, value, element = water
    mesh = target[5]
    has_mesh = mesh[0].shape[0] > 0
    mass, _, beyond, wavenumber, spacing, orders = record
    total = 0.0
    for i in range(forwards):
        layer = int(forward[i, LAYER])
        if forward[i, Z_HIGH] <= 0.0 or albedo[layer] == 0.0:
            continue
        face, angle = face_and_acceptance(state, radius, acceptance, gaussian)
        slope = math.tan(angle)
        z_low, z_high = cone_window(
            forward[i, X],
            forward[i, Y],
            forward[i, SLOPE_X],
            forward[i, SLOPE_Y],
            face,
            slope,
            forward[i, Z_LOW],
            forward[i, Z_HIGH],
        )
        if z_low >= z_high:
            continue
        z = z_low + (z_high - z_low) * uniform(state)
        x, y = (
            forward[i, X] + z * forward[i, SLOPE_X],
            forward[i, Y] + z * forward[i, SLOPE_Y],
        )
        px, py, area = face_point(state, x, y, z, face, slope)
        if area == 0.0:
            continue
        distance = math.sqrt((px - x) ** 2 + (py - y) ** 2 + z * z)
        mx, my, mz = (px - x) / distance, (py - y) / distance, -z / distance
        at = table[layer]
        cosine = forward[i, NX] * mx + forward[i, NY] * my + forward[i, NZ] * mz
        cell = cell_of(height_between(cosine))
        kernel = attenuation[layer] * albedo[layer] * value[at, cell]
        if kernel <= 0.0:
            continue
        if has_mesh and blocked(x, y, z, px, py, 0.0, -1.0, mesh):
            continue
        own = abs(forward[i, NZ] * mz) / kernel
        part_of_it = 1.0 / (forward[i, ORDER] + 1.0)
        if balanced:
            part_of_it = own / (forward[i, PARTITION] + own)
        depth = transmission_depth(z, 0.0, distance, edge, attenuation)
        factor = (
            scale
            * part_of_it
            * kernel
            * (z_high - z_low)
            * abs(forward[i, PER_Z])
            * area
            * -mz
            / (distance * distance)
            * math.exp(-depth)
        )
        if polarized:
            seen[0], seen[1], seen[2] = returning_frame(mx, my, mz)
            connected(
                forward[i, NX],
                forward[i, NY],
                forward[i, NZ],
                light[i],
                mx,
                my,
                mz,
                seen,
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
        add_point(
            mass,
            beyond,
            wavenumber,
            spacing,
            min(int(forward[i, ORDER]), orders - 1),
            forward[i, LENGTH] + z * forward[i, PER_Z] + distance,
            scratch,
        )
    return total


@njit(cache=True, error_model="numpy")
def direct_from_touches(
    state: States,
    touch: Array,
    touch_light: Array,
    touches: int,
    receiver: Packed,
    scale: float,
    water: Packed,
    target: Packed,
    polarized: bool,
    record: Packed,
    scratch: Array,
    seen: Array,
) -> float:
    """Add the light that goes from each touch straight to the receiver."""
    radius, acceptance, gaussian = receiver
    edge, attenuation = water[0], water[1]
    _, _, _, reflectance, mueller, mesh = target
    has_mesh = mesh[0].shape[0] > 0
    mass, _, beyond, wavenumber, spacing, orders = record
    total = 0.0
    for i in range(touches):
        x, y, z = touch[i, TOUCH_X], touch[i, TOUCH_Y], touch[i, TOUCH_Z]
        if z <= 0.0:
            continue
        face, angle = face_and_acceptance(state, radius, acceptance, gaussian)
        px, py, area = face_point(state, x, y, z, face, math.tan(angle))
        if area == 0.0:
            continue
        distance = math.sqrt((px - x) ** 2 + (py - y) ** 2 + z * z)
        mx, my, mz = (px - x) / distance, (py - y) / distance, -z / distance
        leaving = (
            touch[i, NORMAL_X] * mx + touch[i, NORMAL_Y] * my + touch[i, NORMAL_Z] * mz
        )
        if leaving <= 0.0:
            continue
        if has_mesh and blocked(x, y, z, px, py, 0.0, touch[i, TRIANGLE], mesh):
            continue
        depth = transmission_depth(z, 0.0, distance, edge, attenuation)
        factor = (
            scale
            * reflectance
            / math.pi
            * leaving
            * area
            * -mz
            / (distance * distance)
            * math.exp(-depth)
        )
        if polarized:
            seen[0], seen[1], seen[2] = returning_frame(mx, my, mz)
            i_out, q_out, u_out, v_out = reflected(
                touch[i, TOUCH_NX],
                touch[i, TOUCH_NY],
                touch[i, TOUCH_NZ],
                touch_light[i],
                mueller,
                mx,
                my,
                mz,
                seen,
            )
            received(seen, i_out, q_out, u_out, v_out, scratch)
            for k in range(4):
                scratch[k] *= factor
        else:
            scratch[0] = factor
        total += scratch[0]
        direct = touch[i, TOUCH_ORDER] == 0 and touch[i, TOUCHES] == 0
        add_point(
            mass,
            beyond,
            wavenumber,
            spacing,
            orders if direct else orders + 1,
            touch[i, TOUCH_LENGTH] + distance,
            scratch,
        )
    return total
