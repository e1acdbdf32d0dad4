"""The last way to the receiver without a scattering, in compiled loops.

From a point of a forward path a point is drawn on that part of the receiver's face
from which the point lies within the acceptance (a local estimate). On a segment, the
point is drawn from the part that the receiver can see at all. Theory:
docs/theory/photon-transport.md, "A path is joined where it is the least accidental".
Compiled, as there is an estimate for each segment and touch of each forward path.
"""

from __future__ import annotations

import math

from amulor.transport._kernels.angle import cell_of, disc_point, height_between
from amulor.transport._kernels.compiled import inner, kernel, step
from amulor.transport._kernels.geometry import cone_window, transmission_depth
from amulor.transport._kernels.mesh import blocked
from amulor.transport._kernels.polarization import (
    connected,
    received,
    reflected,
    returning_frame,
)
from amulor.transport._kernels.random import uniform
from amulor.transport._kernels.record import TARGET, WATER, add_point, add_to
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
    USED_SEGMENTS,
    USED_TOUCHES,
    Z_HIGH,
    Z_LOW,
    X,
    Y,
)
from amulor.transport._kernels.types import (
    Arrival,
    Face,
    Paths,
    Plan,
    Record,
    Scene,
    States,
    Vector,
)


@kernel
def face_and_acceptance(state: States, face: Face) -> tuple[float, float]:
    """Return radius and acceptance of a sharp receiver that stands for this one.

    A Gaussian exp(-s^2 / w^2) is the mean of discs of radius w sqrt(-ln u) over u
    from 0 to 1; so a Gaussian receiver is a sharp one of random size.
    """
    if not face.gaussian:
        return face.radius, face.acceptance
    radius = face.radius * math.sqrt(-math.log(1.0 - uniform(state)))
    angle = face.acceptance * math.sqrt(-math.log(1.0 - uniform(state)))
    return radius, min(angle, 0.5 * math.pi)


@kernel
def face_point(state: States, place: Vector, radius: float, slope: float) -> Vector:
    """Draw a point of the face that sees a place, and return what it stands for.

    Returns its two coordinates and the area it stands for, 0 if it does not see the
    place.
    """
    x, y, z = place
    visible = slope * z
    if visible < radius:
        dx, dy = disc_point(state, visible)
        if (x + dx) ** 2 + (y + dy) ** 2 > radius * radius:
            return 0.0, 0.0, 0.0
        return x + dx, y + dy, math.pi * visible * visible
    px, py = disc_point(state, radius)
    if (px - x) ** 2 + (py - y) ** 2 > visible * visible:
        return 0.0, 0.0, 0.0
    return px, py, math.pi * radius * radius


@step
def way_to(place: Vector, px: float, py: float) -> tuple[float, Vector]:
    """Return distance and direction of the way from a place to a point of the face."""
    x, y, z = place
    distance = math.sqrt((px - x) ** 2 + (py - y) ** 2 + z * z)
    return distance, ((px - x) / distance, (py - y) / distance, -z / distance)


@inner
def direct_from_segments(
    state: States,
    forward: Paths,
    scene: Scene,
    plan: Plan,
    record: Record,
    arrival: Arrival,
) -> None:
    """Add the light scattered once more on each segment, straight to the receiver.

    At z on a segment it is b p(theta) dz / |n_z| times the solid angle of the face,
    the transmission and the weight w_k.
    """
    segment, water, out = forward.segment, scene.water, arrival.light
    attenuation, albedo, value = water.attenuation, water.albedo, water.value
    mesh = scene.target.mesh
    has_mesh = mesh.box.shape[0] > 0
    seen = arrival.seen
    scale = 1.0 / plan.paths
    total = arrival.total
    for i in range(forward.used[USED_SEGMENTS]):
        layer = int(segment[i, LAYER])
        if segment[i, Z_HIGH] <= 0.0 or albedo[layer] == 0.0:
            continue
        radius, angle = face_and_acceptance(state, scene.face)
        slope = math.tan(angle)
        z_low, z_high = cone_window(
            segment[i, X],
            segment[i, Y],
            segment[i, SLOPE_X],
            segment[i, SLOPE_Y],
            radius,
            slope,
            segment[i, Z_LOW],
            segment[i, Z_HIGH],
        )
        if z_low >= z_high:
            continue
        z = z_low + (z_high - z_low) * uniform(state)
        place = (
            segment[i, X] + z * segment[i, SLOPE_X],
            segment[i, Y] + z * segment[i, SLOPE_Y],
            z,
        )
        px, py, area = face_point(state, place, radius, slope)
        if area == 0.0:
            continue
        distance, m = way_to(place, px, py)
        n = (segment[i, NX], segment[i, NY], segment[i, NZ])
        cosine = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
        at, cell = water.table[layer], cell_of(height_between(cosine))
        kernel = attenuation[layer] * albedo[layer] * value[at, cell]
        if kernel <= 0.0:
            continue
        if has_mesh and blocked(place, (px, py, 0.0), -1.0, mesh):
            continue
        own = abs(n[2] * m[2]) / kernel
        weight = 1.0 / (segment[i, ORDER] + 1.0)
        if plan.balanced:
            weight = own / (segment[i, PARTITION] + own)
        depth = transmission_depth(z, 0.0, distance, water.edge, attenuation)
        factor = (
            scale
            * weight
            * kernel
            * (z_high - z_low)
            * abs(segment[i, PER_Z])
            * area
            * -m[2]
            / (distance * distance)
            * math.exp(-depth)
        )
        if plan.polarized:
            seen[0], seen[1], seen[2] = returning_frame(m)
            connected(n, forward.light[i], m, seen, water.element, at, cell, out)
            for k in range(4):
                out[k] *= factor
        else:
            out[0] = factor
        add_to(total, WATER, out)
        length = segment[i, LENGTH] + z * segment[i, PER_Z] + distance
        add_point(record, min(int(segment[i, ORDER]), record.orders - 1), length, out)


@inner
def direct_from_touches(
    state: States,
    forward: Paths,
    scene: Scene,
    plan: Plan,
    record: Record,
    arrival: Arrival,
) -> None:
    """Add the light that goes from each touch straight to the receiver.

    It is (reflectance / pi) cos times the solid angle of the face and the
    transmission, the cosine that between the target's normal and the way.
    """
    touch, water, target = forward.touch, scene.water, scene.target
    out, seen, mesh = arrival.light, arrival.seen, target.mesh
    has_mesh = mesh.box.shape[0] > 0
    scale = 1.0 / plan.paths
    total = arrival.total
    for i in range(forward.used[USED_TOUCHES]):
        place = (touch[i, TOUCH_X], touch[i, TOUCH_Y], touch[i, TOUCH_Z])
        if place[2] <= 0.0:
            continue
        radius, angle = face_and_acceptance(state, scene.face)
        px, py, area = face_point(state, place, radius, math.tan(angle))
        if area == 0.0:
            continue
        distance, m = way_to(place, px, py)
        leaving = (
            touch[i, NORMAL_X] * m[0]
            + touch[i, NORMAL_Y] * m[1]
            + touch[i, NORMAL_Z] * m[2]
        )
        if leaving <= 0.0:
            continue
        if has_mesh and blocked(place, (px, py, 0.0), touch[i, TRIANGLE], mesh):
            continue
        depth = transmission_depth(
            place[2], 0.0, distance, water.edge, water.attenuation
        )
        factor = (
            scale
            * target.reflectance
            / math.pi
            * leaving
            * area
            * -m[2]
            / (distance * distance)
            * math.exp(-depth)
        )
        if plan.polarized:
            n = (touch[i, TOUCH_NX], touch[i, TOUCH_NY], touch[i, TOUCH_NZ])
            frame = returning_frame(m)
            seen[0], seen[1], seen[2] = frame
            light = forward.touch_light[i]
            vector = reflected(n, light, target.mueller, target.right, m, frame)
            received(seen, vector, out)
            for k in range(4):
                out[k] *= factor
        else:
            out[0] = factor
        add_to(total, TARGET, out)
        direct = touch[i, TOUCH_ORDER] == 0 and touch[i, TOUCHES] == 0
        length = touch[i, TOUCH_LENGTH] + distance
        add_point(record, record.orders if direct else record.orders + 1, length, out)
