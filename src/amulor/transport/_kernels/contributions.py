"""Contributions of photon paths to the received light: estimates and their record."""

from __future__ import annotations

import math

import numpy as np

from amulor.transport._kernels.mesh import blocked, cone_window, transmission_depth
from amulor.transport._kernels.polarization import connected, returning_frame
from amulor.transport._kernels.sampling import (
    cell_of,
    disc_point,
    height_between,
    uniform,
)
from amulor.transport._kernels.surfaces import leaving_light
from amulor.transport._kernels.trace import (
    DOWN,
    FIRST_SEGMENT,
    FIRST_TOUCH,
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
    RECEIVER_SCORES,
    REFLECTANCE,
    RIGHT,
    SEGMENT_COLUMNS,
    SIZE,
    SLOPE_X,
    SLOPE_Y,
    TILT_DOWN,
    TILT_RIGHT,
    TOUCH_COLUMNS,
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
    tilt_scores,
)
from amulor.transport._kernels.types import (
    Array,
    Arrival,
    Complex,
    Face,
    Paths,
    Plan,
    Record,
    Scene,
    States,
    Vector,
    entry,
    inner,
    kernel,
    step,
)


@kernel
def add_at(
    array: Array, part: int, scaled: float, component: int, light: float
) -> None:
    """Distribute light over the four nearest path-length nodes, by cubic weights."""
    node = max(int(scaled) - 1, 0)
    a = scaled - node
    b, c, d = a - 1.0, a - 2.0, a - 3.0
    inner, outer = 0.5 * light * b * c, 0.5 * light * a * d
    array[part, component, node] -= inner * d * (1.0 / 3.0)
    array[part, component, node + 1] += outer * c
    array[part, component, node + 2] -= outer * b
    array[part, component, node + 3] += inner * a * (1.0 / 3.0)


#: Rows of the sum of a group: light that met water only, and light of the target.
WATER, TARGET = range(2)


@kernel
def add_to(total: Array, kind: int, light: Array) -> None:
    """Add received light to the sum of its group, in the row of water or target."""
    for k in range(light.size):
        total[kind, k] += light[k]


@kernel
def add_beyond(
    record: Record, part: int, low: float, high: float, light: Array
) -> None:
    """Record light with path lengths beyond the last node, as Fourier integrals."""
    beyond, wavenumber = record.beyond, record.wavenumber
    parts, middle, half = record.mass.shape[0], 0.5 * (low + high), 0.5 * (high - low)
    lengths = beyond.shape[0] > parts and part < record.orders + 2
    for f in range(wavenumber.size):
        q = wavenumber[f]
        span = q * half
        mean, slope = 1.0 + 0.0j, span * half / 3.0
        if abs(span) > 1e-4:
            mean = np.sinh(span) / span
            slope = (np.cosh(span) - mean) / q
        wave = np.exp(q * middle)
        for k in range(beyond.shape[1]):
            beyond[part, k, f] += light[k] * wave * mean
            if lengths:  # the mean of L exp(q L)
                row = parts + (WATER if part < record.orders else TARGET)
                beyond[row, k, f] += light[k] * wave * (middle * mean + slope)


@kernel
def add_point(record: Record, part: int, length: float, light: Array) -> None:
    """Record received light that has a single path length."""
    mass = record.mass
    scaled = length / record.spacing
    if scaled < mass.shape[2] - 3:
        for k in range(mass.shape[1]):
            add_at(mass, part, scaled, k, light[k])
    else:
        add_beyond(record, part, length, length, light)


@kernel
def add_range(record: Record, part: int, low: float, high: float, light: Array) -> None:
    """Record received light distributed uniformly over path lengths low to high."""
    edge, spacing = record.edge, record.spacing
    if high - low < 0.05 * spacing:
        add_point(record, part, 0.5 * (low + high), light)
        return
    scaled_low, scaled_high = low / spacing, high / spacing
    if scaled_high < edge.shape[2] - 3:
        per_length = 1.0 / (high - low)
        for k in range(edge.shape[1]):
            add_at(edge, part, scaled_low, k, light[k] * per_length)
            add_at(edge, part, scaled_high, k, -light[k] * per_length)
    else:
        add_beyond(record, part, low, high, light)


@inner
def add_scores(
    record: Record, kind: int, low: float, high: float, arrival: Arrival
) -> None:
    """Record the light of a path times its scores, in the rows of water or target.

    The derivative of the light is the mean of the light times the derivative of its
    logarithm, the score, while the density of the drawn paths is fixed.
    """
    scaled = arrival.scaled
    for k in range(arrival.score.size):
        if arrival.score[k] != 0.0:
            for i in range(scaled.size):
                scaled[i] = arrival.light[i] * arrival.score[k]
            part = record.orders + 2 + 2 * k + kind
            if high > low:
                add_range(record, part, low, high, scaled)
            else:
                add_point(record, part, low, scaled)


@entry
def transform(
    mass: Array, edge: Array, wavenumber: Complex, spacing: float, out: Complex
) -> None:
    """Add the Fourier transform of the path-length record to `out`."""
    parts, components, nodes = mass.shape
    last = np.zeros((parts, components), dtype=np.int64)
    filled = 0
    for p in range(parts):
        for k in range(components):
            for n in range(nodes):
                if mass[p, k, n] != 0.0 or edge[p, k, n] != 0.0:
                    last[p, k] = n + 1
            filled = max(filled, last[p, k])
    per_node = np.exp(wavenumber * spacing)
    point = np.empty(wavenumber.size, dtype=np.complex128)
    ramp = np.empty(wavenumber.size, dtype=np.complex128)
    # Real and imaginary parts in turn: the loops over them are compiled to vectors.
    points, ramps, sums = (
        point.view(np.float64),
        ramp.view(np.float64),
        out.view(np.float64),
    )
    for n in range(filled):
        length = n * spacing
        for f in range(wavenumber.size):
            q = wavenumber[f]
            if n % 32 == 0:  # so that errors of the products do not grow
                point[f] = np.exp(q * length)
            else:
                point[f] *= per_node[f]
            # -(exp(q L) - 1) / q, for the edges of which the sum is zero.
            if abs(q.imag) * length < 1e-4:
                ramp[f] = -length * (1.0 + 0.5 * q * length)
            else:
                ramp[f] = (1.0 - point[f]) * (-1j / q.imag)
        for p in range(parts):
            for k in range(components):
                if n < last[p, k]:
                    light, step_of_light = mass[p, k, n], edge[p, k, n]
                    row = sums[p, k]
                    for x in range(points.size):
                        row[x] += light * points[x] + step_of_light * ramps[x]


@step
def place_scores(
    px: float, py: float, face: Face, events: int, arrival: Arrival
) -> None:
    """Set the scores of light at a place on the face: shift and radius.

    The sensitivity exp(-s^2 / R^2) at the distance s from the center changes by
    2 s / R^2 with a shift along s, and by 2 s^2 / R^2 with ln R.
    """
    first = events - RECEIVER_SCORES
    scale = 2.0 / (face.radius * face.radius)
    arrival.score[first + RIGHT] = scale * px
    arrival.score[first + DOWN] = scale * py
    arrival.score[first + SIZE] = scale * (px * px + py * py)


@step
def direct_scores(
    px: float, py: float, m: Vector, face: Face, events: int, arrival: Arrival
) -> None:
    """Set the scores of the receiver for light that arrives at its face along m."""
    place_scores(px, py, face, events, arrival)
    right, down = tilt_scores((-m[0], -m[1], -m[2]), face)
    first = events - RECEIVER_SCORES
    arrival.score[first + TILT_RIGHT] = right
    arrival.score[first + TILT_DOWN] = down


@kernel
def face_and_acceptance(state: States, face: Face) -> tuple[float, float]:
    """Return radius and acceptance angle of a receiver; random if it is Gaussian.

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
    """Draw a receiver-face point that sees a place; return it with represented area.

    Returns two coordinates and the represented area, 0 if the point does not see the
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
    """Return distance and direction from a place to a point on the receiver face."""
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
    """Record local estimates of light scattered from path segments to the receiver.

    At z on a segment it is b p(theta) dz / |n_z| times the solid angle of the face,
    the transmission and the weight w_k.
    """
    segment, water, out = forward.segment, scene.water, arrival.light
    attenuation, albedo, value = water.attenuation, water.albedo, water.value
    mesh = scene.target.mesh
    has_mesh = mesh.box.shape[0] > 0
    path_matrix = arrival.path_matrix
    scale = 1.0 / plan.paths
    total = arrival.total
    for i in range(forward.used[FIRST_SEGMENT], forward.used[USED_SEGMENTS]):
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
        inverse_density = abs(n[2] * m[2]) / kernel
        weight = 1.0 / (segment[i, ORDER] + 1.0)
        if plan.balanced:
            weight = inverse_density / (segment[i, PARTITION] + inverse_density)
        depth = transmission_depth(z, 0.0, distance, water.edge, attenuation)
        factor = (
            scale
            * order_weight(segment[i, ORDER], plan.roulette)
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
            path_matrix[0], path_matrix[1], path_matrix[2] = returning_frame(m)
            connected(n, forward.light[i], m, path_matrix, water.element, at, cell, out)
            for k in range(4):
                out[k] *= factor
        else:
            out[0] = factor
        add_to(total, WATER, out)
        length = segment[i, LENGTH] + z * segment[i, PER_Z] + distance
        add_point(record, min(int(segment[i, ORDER]), record.orders - 1), length, out)
        for k in range(water.score.shape[0]):
            arrival.score[k] = segment[i, SEGMENT_COLUMNS + k]
            arrival.score[k] += water.score[k, layer, cell]
        if scene.face.moved:
            events = water.score.shape[0]
            direct_scores(px, py, m, scene.face, events, arrival)
        add_scores(record, WATER, length, length, arrival)


@step
def touch_scores(touch: Array, i: int, reflectance: float, arrival: Arrival) -> None:
    """Set the scores of light that a reflection sends to the receiver.

    The last is that of the reflectance: number of reflections over reflectance.
    """
    events = touch.shape[1] - TOUCH_COLUMNS
    for k in range(arrival.score.size):
        if k < events:
            arrival.score[k] = touch[i, TOUCH_COLUMNS + k]
        else:
            arrival.score[k] = (touch[i, TOUCHES] + 1.0) / reflectance


@inner
def direct_from_touches(
    state: States,
    forward: Paths,
    scene: Scene,
    plan: Plan,
    record: Record,
    arrival: Arrival,
) -> None:
    """Record local estimates of light reflected by the target to the receiver.

    It is the BRDF times cos, the solid angle of the face and the transmission. The
    cosine is that between the target's normal and the way.
    """
    touch, water, target = forward.touch, scene.water, scene.target
    out, path_matrix, mesh = arrival.light, arrival.path_matrix, target.mesh
    has_mesh = mesh.box.shape[0] > 0
    scale = 1.0 / plan.paths
    total = arrival.total
    for i in range(forward.used[FIRST_TOUCH], forward.used[USED_TOUCHES]):
        place = (touch[i, TOUCH_X], touch[i, TOUCH_Y], touch[i, TOUCH_Z])
        if place[2] <= 0.0:
            continue
        radius, angle = face_and_acceptance(state, scene.face)
        px, py, area = face_point(state, place, radius, math.tan(angle))
        if area == 0.0:
            continue
        distance, m = way_to(place, px, py)
        normal = (touch[i, NORMAL_X], touch[i, NORMAL_Y], touch[i, NORMAL_Z])
        leaving = normal[0] * m[0] + normal[1] * m[1] + normal[2] * m[2]
        if leaving <= 0.0:
            continue
        if has_mesh and blocked(place, (px, py, 0.0), touch[i, TRIANGLE], mesh):
            continue
        depth = transmission_depth(
            place[2], 0.0, distance, water.edge, water.attenuation
        )
        factor = (
            scale
            * order_weight(touch[i, TOUCH_ORDER], plan.roulette)
            / math.pi
            * leaving
            * area
            * -m[2]
            / (distance * distance)
            * math.exp(-depth)
        )
        path_matrix[0], path_matrix[1], path_matrix[2] = returning_frame(m)
        leaving_light(
            (touch[i, TOUCH_NX], touch[i, TOUCH_NY], touch[i, TOUCH_NZ]),
            m,
            normal,
            touch[i, REFLECTANCE],
            target,
            forward.touch_light[i if plan.polarized else 0],
            path_matrix,
            out,
        )
        for k in range(out.size):
            out[k] *= factor
        add_to(total, TARGET, out)
        direct = touch[i, TOUCH_ORDER] == 0 and touch[i, TOUCHES] == 0
        length = touch[i, TOUCH_LENGTH] + distance
        add_point(record, record.orders if direct else record.orders + 1, length, out)
        touch_scores(touch, i, target.reflectance, arrival)
        if scene.face.moved:
            events = water.score.shape[0]
            direct_scores(px, py, m, scene.face, events, arrival)
        add_scores(record, TARGET, length, length, arrival)
