"""Compiled photon paths in a slab; light recorded at exit or at fixed directions.

The slab is the same all over its planes, so only the depth of a photon is known.
Theory: docs/theory/photon-transport.md, "Plane layers with faces". Compiled, as the
benchmarks follow many millions of photons one by one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from amulor.transport._kernels.contributions import add_at, add_beyond, add_point
from amulor.transport._kernels.interfaces import (
    Interface,
    cross_interface,
    fresnel,
    passed,
)
from amulor.transport._kernels.polarization import (
    any_frame,
    between_frames,
    connected,
    deflected,
    projected_frame,
    scattered,
    turned_stokes,
)
from amulor.transport._kernels.sampling import (
    cell_of,
    draw_height,
    exponential,
    height_between,
    uniform,
)
from amulor.transport._kernels.types import (
    Array,
    Arrival,
    Record,
    States,
    Stokes,
    Vector,
    Water,
    entry,
    inner,
    kernel,
    step,
)

#: Parts of the record: reflected, transmitted, and then the fixed directions.
REFLECTED, TRANSMITTED, FIRST_DIRECTION = 0, 1, 2


class Light(NamedTuple):
    """Incident light of a slab, and fixed directions in which light is recorded."""

    incidence: Array
    """Unit vector along the propagation of the incident light."""
    stokes: Array
    """Stokes vector of the incident light."""
    polarized: bool
    """Whether Stokes vectors are computed."""
    outward: Array
    """Fixed exit directions inside of the layers, their polarization axes, and their
    solid angle over that outside, shape (m, 7)."""
    near: Interface
    """Face on which the light falls."""
    far: Interface
    """Face behind the layers."""
    radius: Array
    """Radii of discs on the far face around the incident beam [m]."""


@kernel
def way_out(
    z: float, mz: float, edge: Array, attenuation: Array
) -> tuple[float, float]:
    """Return optical thickness [1] and length [m] of the straight way out of a slab."""
    depth, length = 0.0, 0.0
    for k in range(attenuation.size):
        low, high = edge[k], edge[k + 1]
        if mz > 0.0:
            low = max(low, z)
        else:
            high = min(high, z)
        if high > low:
            depth += attenuation[k] * (high - low) / abs(mz)
            length += (high - low) / abs(mz)
    return depth, length


@kernel
def meridian(n: Vector) -> Vector:
    """Return the polarization axis for direction n that lies in the plane of n and z.

    The angle is counted from +z. Along z it is taken at an azimuth of zero.
    """
    across = math.sqrt(n[0] * n[0] + n[1] * n[1])
    if across < 1e-12:
        return math.copysign(1.0, n[2]), 0.0, 0.0
    return n[2] * n[0] / across, n[2] * n[1] / across, -across


@step
def cross_layers(
    state: States, z: float, nz: float, layer: int, length: float, water: Water
) -> tuple[float, int, float]:
    """Return depth, layer and path length of the next collision, or of the exit.

    The optical thickness of the flight is exponential; a layer of -1 or the number of
    layers is outside.
    """
    edge, attenuation = water.edge, water.attenuation
    thickness = exponential(state)
    while 0 <= layer < attenuation.size:
        face = edge[layer + 1] if nz > 0.0 else edge[layer]
        # Compared without a division, which most flights do not need.
        if thickness * abs(nz) < attenuation[layer] * abs(face - z):
            step = thickness / attenuation[layer]
            return z + nz * step, layer, length + step
        step = (face - z) / nz
        thickness -= attenuation[layer] * step
        length += step
        z = face
        layer += 1 if nz > 0.0 else -1
    return z, layer, length


@step
def add_exit(
    n: Vector, now: Array, part: int, length: float, record: Record, out: Array
) -> None:
    """Record a photon that leaves the slab along n, with its Stokes vector."""
    out[0] = 1.0
    if out.size == 4:
        turn = between_frames(n, (now[0], now[1], now[2]), meridian(n))
        out[0], out[3] = now[3], now[6]
        out[1], out[2] = turned_stokes(now[4], now[5], turn)
    mass = record.mass
    scaled = length / record.spacing
    if scaled < mass.shape[2] - 3:
        for k in range(out.size):
            add_at(mass, part, scaled, k, out[k])
    else:
        add_beyond(record, part, length, length, out)


@step
def add_discs(
    n: Vector,
    offset: tuple[float, float],
    length: float,
    light: Light,
    now: Array,
    record: Record,
    arrival: Arrival,
) -> None:
    """Record a photon that leaves the far face in each disc that contains its exit."""
    first = FIRST_DIRECTION + light.outward.shape[0]
    distance = math.hypot(offset[0], offset[1])
    for k in range(light.radius.size):
        if distance < light.radius[k]:
            add_exit(n, now, first + k, length, record, arrival.light)


#: Local estimates of light that the faces reflected more often are left out below this
#: fraction of the light.
_FAINTEST = 1e-9


@step
def fill_block(element: Stokes, factor: float, path_matrix: Array) -> None:
    """Fill a path's Mueller matrix with the elements m11, m12, m33 and m34."""
    for row in range(2):
        for column in range(2):
            path_matrix[3 + 4 * row + column] = factor * element[abs(row - column)]
            path_matrix[13 + 4 * row + column] = factor * element[2 + abs(row - column)]
    path_matrix[17] = -path_matrix[14]


@kernel
def product(a: Stokes, b: Stokes) -> Stokes:
    """Return elements m11, m12, m33 and m34 of the product of two such matrices."""
    return (
        a[0] * b[0] + a[1] * b[1],
        a[0] * b[1] + a[1] * b[0],
        a[2] * b[2] - a[3] * b[3],
        a[2] * b[3] + a[3] * b[2],
    )


@inner
def add_directions(
    collision: tuple[float, int, float],
    n: Vector,
    now: Array,
    light: Light,
    water: Water,
    record: Record,
    arrival: Arrival,
) -> None:
    """Record local estimates of scattered light in the fixed directions.

    A local estimate: p(theta) times exp(-tau) on the straight way out, and on the ways
    that the faces reflect. The collision is given by its depth, layer and path length.
    """
    z, layer, length = collision
    outward, out, path_matrix = light.outward, arrival.light, arrival.path_matrix
    at, edge, attenuation = water.table[layer], water.edge, water.attenuation
    for k in range(outward.shape[0]):
        mx, my, mz = outward[k, 0], outward[k, 1], outward[k, 2]
        exit_face = light.far if mz > 0.0 else light.near
        other = light.near if mz > 0.0 else light.far
        element = passed(fresnel(abs(mz), exit_face.ratio))
        crossed, further = 0.0, 0.0  # optical thickness and length of the echoes
        while True:
            cosine = n[0] * mx + n[1] * my + n[2] * mz
            cell = cell_of(height_between(cosine))
            depth, remaining = way_out(z, mz, edge, attenuation)
            factor = outward[k, 6] * math.exp(-depth - crossed)
            factor *= water.value[at, cell]
            out[0] = factor * element[0]
            if light.polarized:
                # The meridian axis of m; that of an echo has its sides exchanged.
                side = math.copysign(1.0, mz * outward[k, 2])
                path_matrix[0] = side * outward[k, 3]
                path_matrix[1] = side * outward[k, 4]
                path_matrix[2] = outward[k, 5]
                fill_block(element, factor, path_matrix)
                connected(
                    n, now, (mx, my, mz), path_matrix, water.element, at, cell, out
                )
            add_point(record, FIRST_DIRECTION + k, length + remaining + further, out)
            if other.ratio == 1.0:
                break
            # The light starts towards the other side, and is reflected there first.
            mz = -mz
            whole, across = way_out(edge[0], abs(mz), edge, attenuation)
            crossed, further = crossed + whole, further + across
            element = product(element, fresnel(abs(mz), other.ratio))
            exit_face, other = other, exit_face
            if not (element[0] * math.exp(-crossed) > _FAINTEST):
                break


@step
def follow_depth(
    state: States, nz: float, light: Light, water: Water
) -> tuple[int, float, float]:
    """Trace a photon of which only the depth counts; return part, cosine and length.

    The part is -1 if it is absorbed. The chance at which it is absorbed is drawn once.
    """
    layers = water.attenuation.size
    z, length, layer = water.edge[0], 0.0, 0
    survival, death = 1.0, uniform(state)
    while True:
        z, layer, length = cross_layers(state, z, nz, layer, length, water)
        if layer < 0 or layer >= layers:
            index = light.near.ratio if layer < 0 else light.far.ratio
            if index != 1.0 and uniform(state) < fresnel(abs(nz), index)[0]:
                nz = -nz
                layer = 0 if layer < 0 else layers - 1
                continue
            return REFLECTED if layer < 0 else TRANSMITTED, nz, length
        survival *= water.albedo[layer]
        if survival <= death:
            return -1, nz, length
        drawn, _ = draw_height(state, water.urn, water.table[layer])
        azimuth = math.pi * uniform(state)
        level = math.sqrt(max(1.0 - nz * nz, 0.0))
        cosine = 1.0 - 2.0 * drawn
        sine = 2.0 * math.sqrt(drawn * (1.0 - drawn))
        nz = cosine * nz + sine * level * math.cos(azimuth)
        nz = min(max(nz, -1.0), 1.0)


@step
def follow_photon(
    state: States,
    n: Vector,
    now: Array,
    light: Light,
    water: Water,
    record: Record,
    arrival: Arrival,
) -> None:
    """Trace a photon from the slab's entrance to its absorption or recorded exit.

    now holds the frame and Stokes vector of its light, which counts instead of 1.
    """
    albedo, table, layers = water.albedo, water.table, water.attenuation.size
    polarized, directions = light.polarized, light.outward.shape[0]
    discs = light.radius.size
    z, length, layer, x, y = water.edge[0], 0.0, 0, 0.0, 0.0
    while True:
        before = length
        z, layer, length = cross_layers(state, z, n[2], layer, length, water)
        if discs > 0:
            x += n[0] * (length - before)
            y += n[1] * (length - before)
        if layer < 0 or layer >= layers:
            face = light.near if layer < 0 else light.far
            if face.ratio != 1.0:
                stays, n = cross_interface(state, n, now, polarized, True, face)
                if stays:
                    layer = 0 if layer < 0 else layers - 1
                    continue
            part = REFLECTED if layer < 0 else TRANSMITTED
            add_exit(n, now, part, length, record, arrival.light)
            if part == TRANSMITTED:
                add_discs(n, (x, y), length, light, now, record, arrival)
            return
        if uniform(state) >= albedo[layer]:
            return
        if directions > 0:
            collision = (z, layer, length)
            add_directions(collision, n, now, light, water, record, arrival)
        at = table[layer]
        drawn, cell = draw_height(state, water.urn, at)
        azimuth = 2.0 * math.pi * uniform(state)
        turn = (math.cos(azimuth), math.sin(azimuth))
        e = (now[0], now[1], now[2])
        if not polarized:
            e = any_frame(n)
        n, e = deflected(n, e, drawn, turn, 1.0)
        if polarized:
            vector = (now[3], now[4], now[5], now[6])
            now[3], now[4], now[5], now[6] = scattered(
                vector, turn, water.element, at, cell
            )
            now[0], now[1], now[2] = e


@inner
def follow_photons(
    state: States,
    histories: int,
    light: Light,
    water: Water,
    record: Record,
    arrival: Arrival,
    now: Array,
) -> None:
    """Trace incident photons through a slab, one by one, and record them."""
    n = (light.incidence[0], light.incidence[1], light.incidence[2])
    axis = projected_frame(n, (1.0, 0.0, 0.0))
    # Without Stokes vectors, fixed directions, discs and rough faces only the cosine to
    # z counts.
    depth_only = not light.polarized and light.near.slope + light.far.slope == 0.0
    depth_only = depth_only and light.outward.shape[0] + light.radius.size == 0
    m = n
    for _ in range(histories):
        now[0], now[1], now[2] = axis
        for k in range(4):
            now[3 + k] = light.stokes[k]
        if light.near.ratio != 1.0:
            enters, m = cross_interface(
                state, n, now, light.polarized, False, light.near
            )
            if not enters:
                add_exit(m, now, REFLECTED, 0.0, record, arrival.light)
                continue
        if depth_only:
            part, nz, length = follow_depth(state, m[2], light, water)
            if part >= 0:
                add_exit((m[0], m[1], nz), now, part, length, record, arrival.light)
            continue
        follow_photon(state, m, now, light, water, record, arrival)


@entry
def run_slab(
    state: States, histories: int, light: Light, water: Water, record: Record
) -> None:
    """Trace photon histories through a slab, and add exiting light to the record."""
    path_matrix = np.zeros(19)
    for k in range(4):
        path_matrix[3 + 5 * k] = 1.0
    components = 4 if light.polarized else 1
    none = np.zeros(0)
    arrival = Arrival(
        np.zeros(components), path_matrix, np.zeros((2, components)), none, none, none
    )
    now = np.zeros(7)
    follow_photons(state, histories, light, water, record, arrival, now)
