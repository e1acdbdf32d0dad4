"""One batch of histories in a compiled loop: trace, join, record."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from amulor.transport._kernels.direct import (
    direct_from_segments,
    direct_from_touches,
    face_and_acceptance,
)
from amulor.transport._kernels.join import join_segments, join_touches
from amulor.transport._kernels.polarization import (
    ADJOINT_COLUMNS,
    FORWARD_COLUMNS,
    cross,
    returning_frame,
)
from amulor.transport._kernels.random import exponential, uniform
from amulor.transport._kernels.trace import SEGMENT_COLUMNS, TOUCH_COLUMNS, trace
from amulor.transport._kernels.types import Array, Packed, States


@njit(cache=True, error_model="numpy")
def launch(state: States, source: Packed, start: Array) -> None:
    """Fill start with place, direction and parallel axis of light from the source."""
    centre, axis, across, radius, divergence = source
    ux, uy, uz = across[0], across[1], across[2]
    vx, vy, vz = cross(axis[0], axis[1], axis[2], ux, uy, uz)
    for k in range(3):
        start[k], start[3 + k], start[6 + k] = centre[k], axis[k], across[k]
    if radius > 0.0:
        distance = radius * math.sqrt(-math.log(1.0 - uniform(state)))
        azimuth = 2.0 * math.pi * uniform(state)
        along, side = distance * math.cos(azimuth), distance * math.sin(azimuth)
        start[0] += along * ux + side * vx
        start[1] += along * uy + side * vy
        start[2] += along * uz + side * vz
    if divergence > 0.0:
        angle = divergence * math.sqrt(-math.log(1.0 - uniform(state)))
        azimuth = 2.0 * math.pi * uniform(state)
        cosine, sine = math.cos(angle), math.sin(angle)
        ca, sa = math.cos(azimuth), math.sin(azimuth)
        # Axis and frame turned together, in the plane of this azimuth: r = ca u + sa v
        # goes to cosine r - sine axis, and t = axis x r stays; u = ca r - sa t.
        rx, ry, rz = ca * ux + sa * vx, ca * uy + sa * vy, ca * uz + sa * vz
        start[3] = cosine * axis[0] + sine * rx
        start[4] = cosine * axis[1] + sine * ry
        start[5] = cosine * axis[2] + sine * rz
        tx, ty, tz = cross(axis[0], axis[1], axis[2], rx, ry, rz)
        start[6] = ca * (cosine * rx - sine * axis[0]) - sa * tx
        start[7] = ca * (cosine * ry - sine * axis[1]) - sa * ty
        start[8] = ca * (cosine * rz - sine * axis[2]) - sa * tz


@njit(cache=True, error_model="numpy")
def look(state: States, share: float, largest: float, start: Array) -> None:
    """Fill start with the place, direction and axis of an adjoint path.

    Directions are drawn by the cosine law, with a squared sine up to largest.
    """
    sine_squared = share * largest
    sine, cosine = math.sqrt(sine_squared), math.sqrt(1.0 - sine_squared)
    azimuth = 2.0 * math.pi * uniform(state)
    start[0], start[1], start[2] = 0.0, 0.0, 0.0
    start[3], start[4] = sine * math.cos(azimuth), sine * math.sin(azimuth)
    start[5] = cosine
    start[6], start[7], start[8] = returning_frame(-start[3], -start[4], -start[5])


@njit(cache=True, nogil=True, error_model="numpy")
def run_batch(
    state: States,
    groups: int,
    group: int,
    partners: int,
    source: Packed,
    stokes: Array,
    receiver: Packed,
    water: Packed,
    target: Packed,
    polarized: bool,
    technique: Packed,
    record: Packed,
    weight: Array,
) -> None:
    """Add groups of histories to the record, and keep the light of each in weight.

    A group is that many forward paths, each joined with all of its adjoint paths.
    """
    radius, acceptance, gaussian = receiver
    stratified, balanced, direct = technique
    rows = 64 if polarized else 1
    forward, adjoint = np.empty((64, SEGMENT_COLUMNS)), np.empty((64, SEGMENT_COLUMNS))
    light = np.zeros((rows, FORWARD_COLUMNS))
    seen = np.zeros((rows, ADJOINT_COLUMNS))
    touch = np.empty((16, TOUCH_COLUMNS))
    touch_light = np.zeros((16, FORWARD_COLUMNS))
    no_touch = np.empty((1, TOUCH_COLUMNS))
    no_light = np.empty((1, ADJOINT_COLUMNS))
    scratch = np.zeros(4 if polarized else 1)
    at_once = np.zeros(ADJOINT_COLUMNS)  # the matrix of light that arrives
    for k in range(4):
        at_once[3 + 5 * k] = 1.0
    now, after = np.zeros(ADJOINT_COLUMNS), np.zeros(ADJOINT_COLUMNS)
    start = np.zeros(9)
    count = np.zeros(3, dtype=np.int64)
    for g in range(groups):
        for k in range(3):
            count[k] = 0
        for k in range(group + partners):
            backward = k >= group
            share = uniform(state)
            if backward:
                face, angle = face_and_acceptance(state, radius, acceptance, gaussian)
                largest = math.sin(angle) ** 2
                if stratified:
                    share = (k - group + share) / partners
                look(state, share, largest, start)
                thickness = exponential(state)
                scale = math.pi * largest / (group * partners)
                for i in range(3, ADJOINT_COLUMNS):
                    now[i] = at_once[i]
                path, path_light = adjoint, seen
                hit, hit_light = no_touch, no_light
            else:
                face, scale = 0.0, 0.0
                launch(state, source, start)
                if stratified:
                    share = (k + share) / group
                thickness = -math.log(1.0 - share)
                for i in range(4):
                    now[3 + i] = stokes[i]
                path, path_light = forward, light
                hit, hit_light = touch, touch_light
            path, path_light, hit, hit_light = trace(
                state,
                thickness,
                start,
                face,
                scale,
                backward,
                polarized,
                now,
                after,
                water,
                target,
                path,
                path_light,
                hit,
                hit_light,
                count,
            )
            if backward:
                adjoint, seen = path, path_light
            else:
                forward, light = path, path_light
                touch, touch_light = hit, hit_light
        forwards, touches, adjoints = count[0], count[1], count[2]
        total = join_segments(
            state,
            forward,
            light,
            forwards,
            adjoint,
            seen,
            adjoints,
            water,
            target,
            polarized,
            balanced,
            direct,
            record,
            scratch,
        )
        if direct:
            total += direct_from_segments(
                state,
                forward,
                light,
                forwards,
                receiver,
                1.0 / group,
                water,
                target,
                polarized,
                balanced,
                record,
                scratch,
                at_once,
            )
        if touches > 0:
            total += join_touches(
                touch,
                touch_light,
                touches,
                adjoint,
                seen,
                adjoints,
                target,
                polarized,
                direct,
                record,
                scratch,
            )
            if direct:
                total += direct_from_touches(
                    state,
                    touch,
                    touch_light,
                    touches,
                    receiver,
                    1.0 / group,
                    water,
                    target,
                    polarized,
                    record,
                    scratch,
                    at_once,
                )
        weight[g] = total
