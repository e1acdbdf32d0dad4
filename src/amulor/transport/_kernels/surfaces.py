"""Compiled reflection of light by targets: Lambert's law, and facets that mirror.

Theory: docs/theory/photon-transport.md, "Surfaces of targets". Compiled, since paths
are reflected, and joined with reflections, some millions of times in a run.
"""

from __future__ import annotations

import math

from amulor.transport._kernels.interfaces import lambda_of, seen_facet
from amulor.transport._kernels.polarization import (
    any_frame,
    between_frames,
    cross,
    received,
    reflected,
    turned_stokes,
)
from amulor.transport._kernels.sampling import uniform
from amulor.transport._kernels.types import (
    Array,
    Kind,
    Ray,
    States,
    Stokes,
    Target,
    Vector,
    inner,
    kernel,
    step,
)


@kernel
def shadowing(cosine: float, slope: float) -> float:
    """Return Smith's Lambda of a direction at an angle to the normal of the surface."""
    sine = math.sqrt(max(1.0 - cosine * cosine, 1e-300))
    return lambda_of(cosine / sine / slope)


@kernel
def mirror_brightness(n: Vector, m: Vector, normal: Vector, slope: float) -> float:
    """Return pi times the BRDF of facets that mirror all light, from n to m [1]."""
    arriving = -(n[0] * normal[0] + n[1] * normal[1] + n[2] * normal[2])
    leaving = m[0] * normal[0] + m[1] * normal[1] + m[2] * normal[2]
    if arriving <= 0.0 or leaving <= 0.0:
        return 0.0
    x, y, z = m[0] - n[0], m[1] - n[1], m[2] - n[2]
    upright = (arriving + leaving) / math.sqrt(x * x + y * y + z * z)
    square = upright * upright
    exponent = (1.0 / square - 1.0) / (2.0 * slope * slope)
    density = math.exp(-exponent) / (2.0 * slope * slope * square * square)
    shadow = 1.0 + shadowing(arriving, slope) + shadowing(leaving, slope)
    return density / (4.0 * arriving * leaving * shadow)


@kernel
def mirrored(n: Vector, light: Array, m: Vector, frame: Vector) -> Stokes:
    """Return the Stokes vector of light that a facet mirrors from n to m."""
    x, y, z = cross(m, n)
    norm = math.sqrt(x * x + y * y + z * z)
    if norm < 1e-12:
        x, y, z = cross(n, any_frame(n))
        norm = 1.0
    across = (x / norm, y / norm, z / norm)
    turn = between_frames(n, (light[0], light[1], light[2]), cross(across, n))
    q, u = turned_stokes(light[4], light[5], turn)
    turn = between_frames(m, cross(across, m), frame)
    q, u = turned_stokes(q, -u, turn)
    return light[3], q, u, -light[6]


@inner
def mirror_direction(
    state: States, n: Vector, normal: Vector, slope: float
) -> tuple[bool, Vector]:
    """Draw the direction of light that facets mirror; False if they hide it.

    The facet is drawn as the light sees them. Light that meets a second facet ends.
    """
    a = any_frame(normal)
    b = cross(normal, a)
    local = (
        n[0] * a[0] + n[1] * a[1] + n[2] * a[2],
        n[0] * b[0] + n[1] * b[1] + n[2] * b[2],
        n[0] * normal[0] + n[1] * normal[1] + n[2] * normal[2],
    )
    facet = seen_facet(state, local, 1.0, slope)
    twice = 2.0 * (local[0] * facet[0] + local[1] * facet[1] + local[2] * facet[2])
    x, y, z = (
        local[0] - twice * facet[0],
        local[1] - twice * facet[1],
        local[2] - twice * facet[2],
    )
    if z <= 0.0:
        return False, n
    seen = 1.0 + shadowing(-local[2], slope)
    if uniform(state) * (seen + shadowing(z, slope)) >= seen:
        return False, n
    return True, (
        x * a[0] + y * b[0] + z * normal[0],
        x * a[1] + y * b[1] + z * normal[1],
        x * a[2] + y * b[2] + z * normal[2],
    )


@kernel
def diffuse_direction(state: States, normal: Vector) -> Vector:
    """Draw a direction by Lambert's law."""
    a = any_frame(normal)
    b = cross(normal, a)
    squared = uniform(state)
    up, out = math.sqrt(1.0 - squared), math.sqrt(squared)
    azimuth = 2.0 * math.pi * uniform(state)
    along, across = out * math.cos(azimuth), out * math.sin(azimuth)
    return (
        up * normal[0] + along * a[0] + across * b[0],
        up * normal[1] + along * a[1] + across * b[1],
        up * normal[2] + along * a[2] + across * b[2],
    )


@step
def reflect(
    state: States,
    ray: Ray,
    normal: Vector,
    reflectance: float,
    target: Target,
    kind: Kind,
    now: Array,
) -> tuple[bool, Ray]:
    """Draw a reflected ray; return whether the light is reflected, and the ray.

    The frame and Stokes vector in now become those of the light that goes on.
    """
    drawn = uniform(state)
    if drawn >= reflectance + target.gloss:
        return False, ray
    diffuse = drawn < reflectance
    if diffuse:
        m = diffuse_direction(state, normal)
    else:
        goes, m = mirror_direction(state, ray.direction, normal, target.slope)
        if not goes:
            return False, ray
    axis = ray.axis
    if kind.polarized:
        axis = any_frame(m)
        if diffuse:
            vector = reflected(
                ray.direction, now, target.mueller, target.right, m, axis
            )
        else:
            vector = mirrored(ray.direction, now, m, axis)
        now[3], now[4], now[5], now[6] = vector
        now[0], now[1], now[2] = axis
    return True, Ray(ray.place, m, axis)


@inner
def leaving_light(
    n: Vector,
    m: Vector,
    normal: Vector,
    reflectance: float,
    target: Target,
    light: Array,
    path_matrix: Array,
    out: Array,
) -> None:
    """Fill `out` with pi times the BRDF from n to m, or the received Stokes vector.

    light holds frame and Stokes vector of the light along n, path_matrix frame and
    Mueller matrix from the light along m to the receiver.
    """
    mirror = 0.0
    if target.gloss > 0.0:
        mirror = target.gloss * mirror_brightness(n, m, normal, target.slope)
    if out.size == 1:
        out[0] = reflectance + mirror
        return
    frame = (path_matrix[0], path_matrix[1], path_matrix[2])
    i, q, u, v = reflected(n, light, target.mueller, target.right, m, frame)
    i, q, u, v = reflectance * i, reflectance * q, reflectance * u, reflectance * v
    if mirror > 0.0:
        vector = mirrored(n, light, m, frame)
        i, q = i + mirror * vector[0], q + mirror * vector[1]
        u, v = u + mirror * vector[2], v + mirror * vector[3]
    received(path_matrix, (i, q, u, v), out)
