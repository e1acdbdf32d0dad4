"""Compiled loops of plain_photon_loops, and the steps that they share.

Each loop runs a number of histories of one stream of random numbers and adds what they
score to its last arguments; it checks nothing.
"""

from __future__ import annotations

import numpy as np
from numba import njit

_compiled = njit(nogil=True, cache=True, error_model="numpy", fastmath=True)


# ------------------------------------------------------------------ steps of all loops


@_compiled
def _uniform(state):
    """Return the next state of a splitmix64 stream and a number in [0, 1)."""
    state = np.uint64(state + np.uint64(0x9E3779B97F4A7C15))
    z = state
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return state, (z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@_compiled
def _scattering_cosine(g, u):
    if abs(g) < 1e-6:
        return 2.0 * u - 1.0
    part = (1.0 - g * g) / (1.0 - g + 2.0 * g * u)
    return min(1.0, max(-1.0, (1.0 + g * g - part * part) / (2.0 * g)))


@_compiled
def _phase_function(g, cosine):
    below = 1.0 + g * g - 2.0 * g * cosine
    return (1.0 - g * g) / (4.0 * np.pi * below * np.sqrt(below))


@_compiled
def _turned(dx, dy, dz, cosine, azimuth):
    """Return a direction turned by a scattering angle."""
    sine = np.sqrt(1.0 - cosine * cosine)
    a, b = sine * np.cos(azimuth), sine * np.sin(azimuth)
    across = 1.0 - dz * dz
    if across < 1e-12:
        return a, b, cosine * dz
    across = np.sqrt(across)
    return (
        (a * dx * dz - b * dy) / across + dx * cosine,
        (a * dy * dz + b * dx) / across + dy * cosine,
        -a * across + dz * cosine,
    )


@_compiled
def _way(stream, x, y, z, disc, on_disc):
    """Draw a way from (x, y, z), z > 0, to the receiver: direction, length, weight.

    The weight is solid angle over the probability density, 0 if the way misses.
    """
    centre, radius, least = disc[0], disc[1], disc[2]
    # Who is further aside than the widest accepted way reaches has none.
    aside = np.sqrt((x - centre) ** 2 + y * y) - radius
    if aside > 0 and z < least * np.sqrt(aside * aside + z * z):
        return stream, 0.0, 0.0, -1.0, 0.0, 0.0
    stream, first = _uniform(stream)
    stream, second = _uniform(stream)
    azimuth = 2.0 * np.pi * second
    if on_disc:
        off = radius * np.sqrt(first)
        ex = centre + off * np.cos(azimuth) - x
        ey = off * np.sin(azimuth) - y
        length = np.sqrt(ex * ex + ey * ey + z * z)
        ex, ey, ez = ex / length, ey / length, -z / length
        if -ez < least:
            return stream, 0.0, 0.0, -1.0, 0.0, 0.0
        return stream, ex, ey, ez, length, -ez * np.pi * (radius / length) ** 2
    ez = -1.0 + first * (1.0 - least)
    sine = np.sqrt(1.0 - ez * ez)
    ex, ey = sine * np.cos(azimuth), sine * np.sin(azimuth)
    length = -z / ez
    if (x + length * ex - centre) ** 2 + (y + length * ey) ** 2 > radius * radius:
        return stream, 0.0, 0.0, -1.0, 0.0, 0.0
    return stream, ex, ey, ez, length, 2.0 * np.pi * (1.0 - least)


@_compiled
def _score(path, weight, waves, signal):
    """Add weight * exp(1j * k * path) at evenly spaced k."""
    value = weight * np.exp(1j * waves[0] * path)
    step = np.exp(1j * waves[1] * path)
    for k in range(signal.size):
        signal[k] += value
        value *= step


@_compiled
def _scattered(s, cosine, azimuth):
    """Return the Stokes vector behind a scattering, less the phase function.

    It is referred to the plane of scattering, which the parallel axis turns into by
    the azimuth; the reduced matrix is Rayleigh's.
    """
    double_cosine, double_sine = np.cos(2.0 * azimuth), np.sin(2.0 * azimuth)
    q = s[1] * double_cosine + s[2] * double_sine
    u = s[2] * double_cosine - s[1] * double_sine
    below = 1.0 + cosine * cosine
    m12 = -(1.0 - cosine * cosine) / below
    m33 = 2.0 * cosine / below
    return s[0] + m12 * q, m12 * s[0] + q, m33 * u, m33 * s[3]


@_compiled
def _score_stokes(path, weight, s, d, p, waves, received, signal):
    """Score a Stokes vector (s, direction d, parallel axis p) in receiver axes."""
    # x less its part along d, turned into by an angle whose sine goes along d x p.
    along = p[0]
    across = d[1] * p[2] - d[2] * p[1]
    size = along * along + across * across
    double_cosine = (along * along - across * across) / size
    double_sine = 2.0 * along * across / size
    q = s[1] * double_cosine + s[2] * double_sine
    u = s[2] * double_cosine - s[1] * double_sine
    value = weight * np.exp(1j * waves[0] * path)
    step = np.exp(1j * waves[1] * path)
    received[0] += weight * s[0]
    received[1] += weight * q
    received[2] += weight * u
    received[3] += weight * s[3]
    for k in range(signal.shape[0]):
        signal[k, 0] += value * s[0]
        signal[k, 1] += value * q
        signal[k, 2] += value * u
        signal[k, 3] += value * s[3]
        value *= step


# ------------------------------------------------------------------------------- loops


@_compiled
def chance_hits(water, disc, half_space, waves, each, stream, received, signal):
    attenuation, albedo, g = water[0], water[1], water[2]
    total = 0.0
    for _ in range(each):
        x, y, z, path = 0.0, 0.0, 0.0, 0.0
        dx, dy, dz = 0.0, 0.0, 1.0
        while True:
            stream, u = _uniform(stream)
            free = -np.log(1.0 - u) / attenuation
            if dz < 0 and z > 0 and z + free * dz <= 0:
                if -dz >= disc[2]:
                    way = -z / dz
                    aside = x + way * dx - disc[0]
                    if aside**2 + (y + way * dy) ** 2 <= disc[1] ** 2:
                        total += 1.0
                        _score(path + way, 1.0, waves, signal)
                if half_space:
                    break
            x, y, z = x + free * dx, y + free * dy, z + free * dz
            path += free
            stream, u = _uniform(stream)
            if u >= albedo:
                break
            stream, u = _uniform(stream)
            cosine = _scattering_cosine(g, u)
            stream, u = _uniform(stream)
            dx, dy, dz = _turned(dx, dy, dz, cosine, 2.0 * np.pi * u)
    received[0] = total


@_compiled
def local_estimate(
    water, disc, half_space, on_disc, waves, each, stream, received, signal
):
    attenuation, albedo, g = water[0], water[1], water[2]
    total = 0.0
    for _ in range(each):
        x, y, z, path = 0.0, 0.0, 0.0, 0.0
        dx, dy, dz = 0.0, 0.0, 1.0
        while True:
            stream, u = _uniform(stream)
            free = -np.log(1.0 - u) / attenuation
            x, y, z = x + free * dx, y + free * dy, z + free * dz
            path += free
            if half_space and z <= 0:
                break
            stream, u = _uniform(stream)
            if u >= albedo:
                break
            if z > 0:
                stream, ex, ey, ez, way, weight = _way(stream, x, y, z, disc, on_disc)
                if weight > 0:
                    cosine = dx * ex + dy * ey + dz * ez
                    weight *= _phase_function(g, cosine) * np.exp(-attenuation * way)
                    total += weight
                    _score(path + way, weight, waves, signal)
            stream, u = _uniform(stream)
            cosine = _scattering_cosine(g, u)
            stream, u = _uniform(stream)
            dx, dy, dz = _turned(dx, dy, dz, cosine, 2.0 * np.pi * u)
    received[0] = total


@_compiled
def _polarized_scattering(stream, g, s, d, p):
    """Draw a scattering in place: Stokes vector s of intensity 1, axes d and p."""
    stream, u = _uniform(stream)
    cosine = _scattering_cosine(g, u)
    linear = np.sqrt(s[1] * s[1] + s[2] * s[2])
    largest = 1.0 + linear * (1.0 - cosine * cosine) / (1.0 + cosine * cosine)
    while True:
        stream, u = _uniform(stream)
        azimuth = 2.0 * np.pi * u
        i, q, v, w = _scattered(s, cosine, azimuth)
        stream, u = _uniform(stream)
        if u * largest < i:
            break
    s[1], s[2], s[3] = q / i, v / i, w / i
    sine = np.sqrt(1.0 - cosine * cosine)
    a, b = np.cos(azimuth), np.sin(azimuth)
    dx, dy, dz = d[0], d[1], d[2]
    px, py, pz = p[0], p[1], p[2]
    tx = a * px + b * (dy * pz - dz * py)
    ty = a * py + b * (dz * px - dx * pz)
    tz = a * pz + b * (dx * py - dy * px)
    d[0], d[1], d[2] = (
        cosine * dx + sine * tx,
        cosine * dy + sine * ty,
        cosine * dz + sine * tz,
    )
    p[0], p[1], p[2] = (
        cosine * tx - sine * dx,
        cosine * ty - sine * dy,
        cosine * tz - sine * dz,
    )
    return stream


@_compiled
def chance_hits_stokes(
    water, disc, half_space, launched, waves, each, stream, received, signal
):
    attenuation, albedo, g = water[0], water[1], water[2]
    s, d, p = np.zeros(4), np.zeros(3), np.zeros(3)
    for _ in range(each):
        x, y, z, path = 0.0, 0.0, 0.0, 0.0
        s[:] = launched
        d[0], d[1], d[2] = 0.0, 0.0, 1.0
        p[0], p[1], p[2] = 1.0, 0.0, 0.0
        while True:
            stream, u = _uniform(stream)
            free = -np.log(1.0 - u) / attenuation
            if d[2] < 0 and z > 0 and z + free * d[2] <= 0:
                if -d[2] >= disc[2]:
                    way = -z / d[2]
                    aside = x + way * d[0] - disc[0]
                    if aside**2 + (y + way * d[1]) ** 2 <= disc[1] ** 2:
                        _score_stokes(
                            path + way, 1.0, s, d, p, waves,
                            received, signal,
                        )  # fmt: skip
                if half_space:
                    break
            x, y, z = x + free * d[0], y + free * d[1], z + free * d[2]
            path += free
            stream, u = _uniform(stream)
            if u >= albedo:
                break
            stream = _polarized_scattering(stream, g, s, d, p)


@_compiled
def local_estimate_stokes(
    water, disc, half_space, launched, on_disc, waves, each, stream, received, signal
):
    attenuation, albedo, g = water[0], water[1], water[2]
    s, d, p = np.zeros(4), np.zeros(3), np.zeros(3)
    so, do, po = np.zeros(4), np.zeros(3), np.zeros(3)
    for _ in range(each):
        x, y, z, path = 0.0, 0.0, 0.0, 0.0
        s[:] = launched
        d[0], d[1], d[2] = 0.0, 0.0, 1.0
        p[0], p[1], p[2] = 1.0, 0.0, 0.0
        while True:
            stream, u = _uniform(stream)
            free = -np.log(1.0 - u) / attenuation
            x, y, z = x + free * d[0], y + free * d[1], z + free * d[2]
            path += free
            if half_space and z <= 0:
                break
            stream, u = _uniform(stream)
            if u >= albedo:
                break
            if z > 0:
                stream, do[0], do[1], do[2], way, weight = _way(
                    stream, x, y, z, disc, on_disc
                )
                if weight > 0:
                    cosine = d[0] * do[0] + d[1] * do[1] + d[2] * do[2]
                    # Along the parallel and perpendicular axis, from sin(angle).
                    a = p[0] * do[0] + p[1] * do[1] + p[2] * do[2]
                    qx = d[1] * p[2] - d[2] * p[1]
                    qy = d[2] * p[0] - d[0] * p[2]
                    qz = d[0] * p[1] - d[1] * p[0]
                    b = qx * do[0] + qy * do[1] + qz * do[2]
                    azimuth = np.arctan2(b, a)
                    so[0], so[1], so[2], so[3] = _scattered(s, cosine, azimuth)
                    ca, sa = np.cos(azimuth), np.sin(azimuth)
                    sine = np.sqrt(max(0.0, 1.0 - cosine * cosine))
                    po[0] = cosine * (ca * p[0] + sa * qx) - sine * d[0]
                    po[1] = cosine * (ca * p[1] + sa * qy) - sine * d[1]
                    po[2] = cosine * (ca * p[2] + sa * qz) - sine * d[2]
                    weight *= _phase_function(g, cosine) * np.exp(-attenuation * way)
                    _score_stokes(
                        path + way, weight, so, do, po, waves,
                        received, signal,
                    )  # fmt: skip
            stream = _polarized_scattering(stream, g, s, d, p)


@_compiled
def slab(albedo, thickness, g, modulation, each, stream, out):
    for _ in range(each):
        z, path, dz = 0.0, 0.0, 1.0
        while True:
            stream, u = _uniform(stream)
            free = -np.log(1.0 - u)
            z += free * dz
            path += free
            if z < 0 or z > thickness:
                # The last step ended outside: go back to the face.
                face = 0.0 if z < 0 else thickness
                path -= (z - face) / dz
                side = 0 if z < 0 else 1
                for k in range(modulation.size):
                    out[side, k] += np.exp(1j * modulation[k] * path)
                break
            stream, u = _uniform(stream)
            if u >= albedo:
                break
            stream, u = _uniform(stream)
            cosine = _scattering_cosine(g, u)
            stream, u = _uniform(stream)
            # The azimuth about z is of no use in a slab.
            sine = np.sqrt((1.0 - cosine * cosine) * (1.0 - dz * dz))
            dz = dz * cosine - sine * np.cos(2.0 * np.pi * u)
