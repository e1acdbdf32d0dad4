"""Compiled batches of photon histories: tracing, joining and recording of paths.

Theory: docs/theory/photon-transport.md. Compiled, so that a batch of thousands of
groups runs without Python, and without the lock that keeps its threads apart.
"""

from __future__ import annotations

import math

import numpy as np

from amulor.transport._kernels.contributions import (
    direct_from_segments,
    direct_from_touches,
    face_and_acceptance,
)
from amulor.transport._kernels.joins import join_group, no_cells
from amulor.transport._kernels.polarization import (
    ADJOINT_COLUMNS,
    FORWARD_COLUMNS,
    cross,
    returning_frame,
)
from amulor.transport._kernels.reflections import join_touches, keep_crossing
from amulor.transport._kernels.sampling import exponential, uniform
from amulor.transport._kernels.trace import (
    FIRST_SEGMENT,
    FIRST_TOUCH,
    SEGMENT_COLUMNS,
    TOUCH_COLUMNS,
    USED_SEGMENTS,
    USED_TOUCHES,
    follow,
)
from amulor.transport._kernels.types import (
    Array,
    Arrival,
    Beam,
    Kind,
    Paths,
    Plan,
    Ray,
    Record,
    Scene,
    States,
    allocating,
    entry,
    step,
)

#: Rows that there is room for at first.
_ROWS = 64


@step
def launch(state: States, beam: Beam) -> Ray:
    """Draw a random ray of the laser beam, with its polarization axis."""
    centre, axis, u = beam.centre, beam.axis, beam.across
    n = (axis[0], axis[1], axis[2])
    e = (u[0], u[1], u[2])
    v = cross(n, e)
    place = (centre[0], centre[1], centre[2])
    if beam.radius > 0.0:
        distance = beam.radius * math.sqrt(-math.log(1.0 - uniform(state)))
        azimuth = 2.0 * math.pi * uniform(state)
        along, side = distance * math.cos(azimuth), distance * math.sin(azimuth)
        place = (
            place[0] + (along * e[0] + side * v[0]),
            place[1] + (along * e[1] + side * v[1]),
            place[2] + (along * e[2] + side * v[2]),
        )
    if beam.divergence == 0.0:
        return Ray(place, n, e)
    # Drawn from theta exp(-theta^2 / delta^2), kept with a chance of sin theta / theta.
    angle = beam.divergence * math.sqrt(-math.log(1.0 - uniform(state)))
    while uniform(state) * angle > math.sin(angle):
        angle = beam.divergence * math.sqrt(-math.log(1.0 - uniform(state)))
    azimuth = 2.0 * math.pi * uniform(state)
    cosine, sine = math.cos(angle), math.sin(angle)
    ca, sa = math.cos(azimuth), math.sin(azimuth)
    # Axis and frame turned together, in the plane of this azimuth: r = ca u + sa v
    # goes to cosine r - sine axis, and t = axis x r stays; u = ca r - sa t.
    r = (ca * e[0] + sa * v[0], ca * e[1] + sa * v[1], ca * e[2] + sa * v[2])
    t = cross(n, r)
    direction = (
        cosine * n[0] + sine * r[0],
        cosine * n[1] + sine * r[1],
        cosine * n[2] + sine * r[2],
    )
    across = (
        ca * (cosine * r[0] - sine * n[0]) - sa * t[0],
        ca * (cosine * r[1] - sine * n[1]) - sa * t[1],
        ca * (cosine * r[2] - sine * n[2]) - sa * t[2],
    )
    return Ray(place, direction, across)


@step
def look(state: States, fraction: float, largest: float) -> Ray:
    """Draw a random ray from the receiver-face center, as start of an adjoint path.

    Directions are drawn by the cosine law, with a squared sine up to largest, of which
    fraction is the part that this one has.
    """
    sine_squared = fraction * largest
    sine, cosine = math.sqrt(sine_squared), math.sqrt(1.0 - sine_squared)
    azimuth = 2.0 * math.pi * uniform(state)
    x, y = sine * math.cos(azimuth), sine * math.sin(azimuth)
    return Ray((0.0, 0.0, 0.0), (x, y, cosine), returning_frame((-x, -y, -cosine)))


@allocating
def without_segments(light: Array, scores: int) -> Paths:
    """Allocate empty path arrays; segments use the given array for their light."""
    return Paths(
        np.empty((_ROWS, SEGMENT_COLUMNS + scores)),
        light,
        np.empty((_ROWS, TOUCH_COLUMNS + scores)),
        np.zeros((_ROWS, light.shape[1])),
        np.zeros(4, dtype=np.int64),
    )


@step
def begin_forward(
    state: States, number: int, scene: Scene, plan: Plan, now: Array
) -> tuple[float, Ray]:
    """Draw ray and first optical thickness of a forward path; set its Stokes vector.

    The optical thickness of the flight is exponential. Those of the paths of a group,
    of which this is the number-th, are spread evenly if the plan is stratified.
    """
    fraction = uniform(state)
    ray = launch(state, scene.beam)
    if plan.stratified:
        fraction = (number + fraction) / plan.paths
    for i in range(4):
        now[3 + i] = scene.beam.stokes[i]
    return -math.log(1.0 - fraction), ray


@step
def begin_adjoint(
    state: States, number: int, group: int, scene: Scene, plan: Plan, now: Array
) -> tuple[float, Ray, Kind]:
    """Draw ray, optical thickness and kind of an adjoint path; set its Mueller matrix.

    The direction is drawn by the cosine law within the acceptance gamma. The weight of
    a pair is Omega = pi sin^2 gamma over the number of pairs in the group.
    """
    fraction = uniform(state)
    radius, angle = face_and_acceptance(state, scene.face)
    largest = math.sin(angle) ** 2
    if plan.stratified:
        fraction = (number + fraction) / plan.partners
    ray = look(state, fraction, largest)
    scale = math.pi * largest / (plan.paths * plan.partners)
    for i in range(16):
        now[3 + i] = 1.0 if i % 5 == 0 else 0.0
    kind = Kind(True, plan.polarized, radius, scale, group, plan.roulette)
    return exponential(state), ray, kind


@entry
def run_batch(
    state: States, scene: Scene, plan: Plan, record: Record, weight: Array
) -> int:
    """Trace groups of photon histories; record received light in total and by group.

    weight has the shape (groups, 2, components): light from water and target. A group
    is a number of forward and of adjoint paths, all joined in the water. Reflections
    of the target are joined with the adjoint paths of a whole block of groups. Returns
    how many reflections one adjoint path may reach.
    """
    rows = _ROWS if plan.polarized else 1
    events = scene.water.score.shape[0]
    forward = without_segments(np.zeros((rows, FORWARD_COLUMNS)), events)
    adjoint = without_segments(np.zeros((rows, ADJOINT_COLUMNS)), events)
    direct = np.zeros(ADJOINT_COLUMNS)
    for k in range(4):
        direct[3 + 5 * k] = 1.0
    components = 4 if plan.polarized else 1
    arrival = Arrival(
        np.zeros(components),
        direct,
        np.zeros((2, components)),
        np.zeros((record.mass.shape[0] - record.orders - 2) // 2),
        np.zeros(components),
        np.zeros(1),
    )
    now = np.zeros(ADJOINT_COLUMNS + events)
    none = no_cells()
    densest = 1
    for start in range(0, weight.shape[0], plan.block):
        block = weight[start : start + plan.block]
        forward.used[:] = 0
        adjoint.used[:] = 0
        for g in range(block.shape[0]):
            for paths in (forward, adjoint):
                paths.used[FIRST_SEGMENT] = paths.used[USED_SEGMENTS]
                paths.used[FIRST_TOUCH] = paths.used[USED_TOUCHES]
            kind = Kind(False, plan.polarized, 0.0, 0.0, g, plan.roulette)
            for k in range(plan.paths):
                thickness, ray = begin_forward(state, k, scene, plan, now)
                forward = follow(state, thickness, ray, kind, scene, forward, now)
            for k in range(plan.partners):
                thickness, ray, back = begin_adjoint(state, k, g, scene, plan, now)
                adjoint = follow(state, thickness, ray, back, scene, adjoint, now)
            arrival.total[:] = 0.0
            arrival.score[:] = 0.0
            join_group(state, forward, adjoint, none, scene, plan, record, arrival)
            if plan.direct:
                direct_from_segments(state, forward, scene, plan, record, arrival)
                direct_from_touches(state, forward, scene, plan, record, arrival)
            # One by one: the assignment of an array takes three seconds to compile.
            for k in range(2):
                for i in range(components):
                    block[g, k, i] = arrival.total[k, i]
            # Reflections, and adjoint segments that may reach them, are kept. A mesh
            # may block any part of a path.
            forward.used[USED_SEGMENTS] = 0
            if scene.target.has_plane:
                keep_crossing(adjoint, scene.target, plan.polarized)
        if forward.used[USED_TOUCHES] > 0:
            reached = join_touches(
                state, forward, adjoint, scene, plan, record, arrival, block
            )
            densest = max(densest, reached)
    return densest
