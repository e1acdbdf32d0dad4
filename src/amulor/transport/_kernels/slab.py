"""Photons through a slab in a compiled loop: chance exits, and fixed directions.

The slab is the same all over its planes, so only the depth of a photon is known.
Equations: docs/theory/photon-transport.md.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from amulor.transport._kernels.angle import cell_of, draw_height, height_between
from amulor.transport._kernels.polarization import (
    between_frames,
    connected,
    projected_frame,
    scattered,
    turned_frame,
    turned_stokes,
)
from amulor.transport._kernels.random import exponential, uniform
from amulor.transport._kernels.record import add_at, add_beyond, add_point
from amulor.transport._kernels.trace import any_frame
from amulor.transport._kernels.types import Array, Packed, States, Vector

#: Parts of the record: reflected, transmitted, and then the fixed directions.
REFLECTED, TRANSMITTED, FIRST_DIRECTION = 0, 1, 2


@njit(cache=True, error_model="numpy")
def way_out(
    z: float, mz: float, edge: Array, attenuation: Array
) -> tuple[float, float]:
    """Return optical thickness and length of the straight way out of the slab."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def run_slab(
    state: States,
    histories: int,
    incidence: Array,
    stokes: Array,
    water: Packed,
    polarized: bool,
    outward: Array,
    record: Packed,
) -> None:
    """Add histories to the record.

    incidence is the direction of the light that falls in, outward the directions of
    the radiant intensities asked for and their parallel axes, shape (m, 6).
    """
    edge, attenuation, albedo, table, urn, value, element = water
    mass, _, beyond, wavenumber, spacing, _ = record
    components = 4 if polarized else 1
    scratch = np.zeros(components)
    now = np.zeros(7)
    seen = np.zeros(19)
    for k in range(4):
        seen[3 + 5 * k] = 1.0
    start = edge[0]
    first_x, first_y, first_z = projected_frame(
        incidence[0], incidence[1], incidence[2]
    )
    # Without Stokes vectors and fixed directions only the cosine to z counts.
    depth_only = not polarized and outward.shape[0] == 0
    for _ in range(histories):
        z = start
        nx, ny, nz = incidence[0], incidence[1], incidence[2]
        ex, ey, ez = first_x, first_y, first_z
        if polarized:
            for k in range(4):
                now[3 + k] = stokes[k]
        length = 0.0
        layer = 0
        thickness = exponential(state)
        while True:
            while 0 <= layer < attenuation.size:
                step = math.inf
                if nz > 0.0:
                    step = (edge[layer + 1] - z) / nz
                elif nz < 0.0:
                    step = (edge[layer] - z) / nz
                if thickness < attenuation[layer] * step:
                    step = thickness / attenuation[layer]
                    z += nz * step
                    length += step
                    break
                thickness -= attenuation[layer] * step
                length += step
                z = edge[layer + 1] if nz > 0.0 else edge[layer]
                layer += 1 if nz > 0.0 else -1
            if layer < 0 or layer >= attenuation.size:
                part = REFLECTED if layer < 0 else TRANSMITTED
                scratch[0] = 1.0
                if polarized:
                    tx, ty, tz = meridian(nx, ny, nz)
                    cosine, sine = between_frames(nx, ny, nz, ex, ey, ez, tx, ty, tz)
                    scratch[0], scratch[3] = now[3], now[6]
                    scratch[1], scratch[2] = turned_stokes(now[4], now[5], cosine, sine)
                # Written out: a call with these arrays takes ten times as long.
                scaled = length / spacing
                if scaled < mass.shape[2] - 3:
                    for k in range(components):
                        add_at(mass, part, scaled, k, scratch[k])
                else:
                    add_beyond(beyond, wavenumber, part, length, length, scratch)
                break
            if uniform(state) >= albedo[layer]:
                break
            at = table[layer]
            for m in range(outward.shape[0]):
                mx, my, mz = outward[m, 0], outward[m, 1], outward[m, 2]
                cosine = nx * mx + ny * my + nz * mz
                cell = cell_of(height_between(cosine))
                depth, rest = way_out(z, mz, edge, attenuation)
                factor = value[at, cell] * math.exp(-depth)
                scratch[0] = factor
                if polarized:
                    now[0], now[1], now[2] = ex, ey, ez
                    for k in range(3):
                        seen[k] = outward[m, 3 + k]
                    connected(
                        nx, ny, nz, now, mx, my, mz, seen, element, at, cell, scratch
                    )
                    for k in range(4):
                        scratch[k] *= factor
                add_point(
                    mass,
                    beyond,
                    wavenumber,
                    spacing,
                    FIRST_DIRECTION + m,
                    length + rest,
                    scratch,
                )
            drawn, cell = draw_height(state, urn, at)
            cosine = 1.0 - 2.0 * drawn
            sine = 2.0 * math.sqrt(drawn * (1.0 - drawn))
            azimuth = 2.0 * math.pi * uniform(state)
            thickness = exponential(state)
            if depth_only:
                level = math.sqrt(max(1.0 - nz * nz, 0.0))
                nz = cosine * nz + sine * level * math.cos(azimuth)
                nz = min(max(nz, -1.0), 1.0)
                continue
            cos_azimuth, sin_azimuth = math.cos(azimuth), math.sin(azimuth)
            if not polarized:
                ex, ey, ez = any_frame(nx, ny, nz)
            fx, fy, fz = turned_frame(cos_azimuth, sin_azimuth, nx, ny, nz, ex, ey, ez)
            mx = cosine * nx + sine * fx
            my = cosine * ny + sine * fy
            mz = cosine * nz + sine * fz
            norm = 1.0 / math.sqrt(mx * mx + my * my + mz * mz)
            if polarized:
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
                ex = cosine * fx - sine * nx
                ey = cosine * fy - sine * ny
                ez = cosine * fz - sine * nz
            nx, ny, nz = mx * norm, my * norm, mz * norm


@njit(cache=True, error_model="numpy")
def meridian(nx: float, ny: float, nz: float) -> Vector:
    """Return the parallel axis in the plane of n and z, which points to larger angles.

    The angle is counted from +z. Along z it is taken at an azimuth of zero.
    """
    across = math.sqrt(nx * nx + ny * ny)
    if across < 1e-12:
        return math.copysign(1.0, nz), 0.0, 0.0
    return nz * nx / across, nz * ny / across, -across
