"""Compiled photon paths in a slab; light recorded at exit or at fixed directions.

The slab is the same all over its planes, so only the depth of a photon is known.
Theory: docs/theory/photon-transport.md, "What it is checked against". Compiled, as the
benchmarks follow many millions of photons one by one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from amulor.transport._kernels.contributions import add_at, add_beyond, add_point
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
    """Fixed exit directions and their polarization axes, shape (m, 6)."""
    index_ratio: float
    """Refractive index of the layers, relative to the index outside [1]."""
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
def inner_reflectance(cosine: float, index: float) -> float:
    """Fresnel reflectance of unpolarized light that meets a face from inside.

    The cosine is that to the normal of the face, the index is relative to the outside.
    """
    sine_outside = (1.0 - cosine * cosine) * index * index
    if sine_outside >= 1.0:
        return 1.0
    outside = math.sqrt(1.0 - sine_outside)
    across = (index * cosine - outside) / (index * cosine + outside)
    along = (cosine - index * outside) / (cosine + index * outside)
    return 0.5 * (across * across + along * along)


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


@step
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

    A local estimate: p(theta) times exp(-tau) on the straight way out. The collision
    is given by its depth, layer and path length.
    """
    z, layer, length = collision
    outward, out, path_matrix = light.outward, arrival.light, arrival.path_matrix
    at = water.table[layer]
    for k in range(outward.shape[0]):
        m = (outward[k, 0], outward[k, 1], outward[k, 2])
        cosine = n[0] * m[0] + n[1] * m[1] + n[2] * m[2]
        cell = cell_of(height_between(cosine))
        depth, remaining = way_out(z, m[2], water.edge, water.attenuation)
        factor = water.value[at, cell] * math.exp(-depth)
        out[0] = factor
        if light.polarized:
            for i in range(3):
                path_matrix[i] = outward[k, 3 + i]
            connected(n, now, m, path_matrix, water.element, at, cell, out)
            for i in range(4):
                out[i] *= factor
        add_point(record, FIRST_DIRECTION + k, length + remaining, out)


@step
def follow_depth(
    state: States, nz: float, index_ratio: float, water: Water
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
            if index_ratio != 1.0 and uniform(state) < inner_reflectance(
                abs(nz), index_ratio
            ):
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
            if light.index_ratio != 1.0 and uniform(state) < inner_reflectance(
                abs(n[2]), light.index_ratio
            ):
                n = (n[0], n[1], -n[2])
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
    mirrored = 0.0
    if light.index_ratio != 1.0:
        # Snell's law; a face reflects alike from both sides.
        x, y = n[0] / light.index_ratio, n[1] / light.index_ratio
        n = (x, y, math.sqrt(1.0 - x * x - y * y))
        mirrored = inner_reflectance(n[2], light.index_ratio)
    # Without Stokes vectors, fixed directions and discs only the cosine to z counts.
    depth_only = not light.polarized
    depth_only = depth_only and light.outward.shape[0] + light.radius.size == 0
    for _ in range(histories):
        now[0], now[1], now[2] = axis
        for k in range(4):
            now[3 + k] = light.stokes[k]
        if mirrored > 0.0 and uniform(state) < mirrored:
            add_exit(n, now, REFLECTED, 0.0, record, arrival.light)
            continue
        if depth_only:
            part, nz, length = follow_depth(state, n[2], light.index_ratio, water)
            if part >= 0:
                add_exit((n[0], n[1], nz), now, part, length, record, arrival.light)
            continue
        follow_photon(state, n, now, light, water, record, arrival)


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
