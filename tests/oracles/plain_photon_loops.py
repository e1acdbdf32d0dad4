"""Photon loops with no tricks, to check a faster program and to time it against.

Water of one kind fills all space, or z > 0 only, in which case light that crosses z = 0
is lost. A pencil beam leaves the origin along +z. The receiver is a disc in the plane
z = 0 that takes light within `acceptance` of the -z direction; nothing stops at it. One
history serves all frequencies: path L scores exp(+i omega L / v). Two loops, each for
the intensity and for the whole Stokes vector:

- chance hits: absorption ends histories, what crosses the disc is counted;
- local estimate: at each scattering a way to the receiver is drawn, either a direction
  evenly within the acceptance or a point evenly on the disc, and what would arrive
  along it is scored. Histories end by absorption here too.

The angle of scattering is that of Henyey-Greenstein; the reduced Mueller matrix of the
loops with Stokes vectors is Rayleigh's. Received Q and U are referred to x: the
parallel axis is x made perpendicular to the light, the perpendicular axis is about -y,
since parallel x perpendicular is the direction of travel. Launched ones are referred
to x and y.

Each batch of histories has its own stream of random numbers, so results do not depend
on the count of threads. Nothing is shared with the package.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.constants import speed_of_light

Array = NDArray[Any]

_compiled = njit(nogil=True, cache=True, error_model="numpy", fastmath=True)

FREQUENCIES = np.linspace(1e6, 200e6, 20)


@dataclass(frozen=True)
class Case:
    """What is simulated; the defaults are the narrow receiver that programs race on."""

    attenuation: float = 1.0  # 1 / m
    albedo: float = 0.8
    asymmetry: float = 0.95
    group_index: float = 1.33
    centre: float = 0.07  # of the disc, along x, m
    radius: float = 0.05  # m
    acceptance: float = np.radians(2.0)  # half angle; pi / 2: any angle
    half_space: bool = False


@dataclass(frozen=True)
class Tally:
    """Means per history of each batch, and the time they took."""

    received: Array  # batches (, 4): at zero frequency
    signal: Array  # batches, frequencies (, 4)
    seconds: float
    histories: int

    @property
    def mean(self) -> Any:
        """Return the received fraction."""
        return self.received.mean(axis=0)

    @property
    def standard_error(self) -> Any:
        """Return the standard error of the received fraction."""
        return self.received.std(axis=0, ddof=1) / np.sqrt(len(self.received))

    @property
    def response(self) -> Array:
        """Return the complex signal over that at zero frequency."""
        total = self.signal.mean(axis=0)
        return total / self.received.mean(axis=0).flat[0]

    @property
    def figure_of_merit(self) -> float:
        """Return 1 / (relative variance x seconds) of the received intensity."""
        mean, error = np.ravel(self.mean)[0], np.ravel(self.standard_error)[0]
        return float((mean / error) ** 2 / self.seconds)


def chance_hits(
    case: Case = Case(),
    *,
    histories: int,
    seed: int,
    batches: int = 100,
    frequencies: ArrayLike = FREQUENCIES,
) -> Tally:
    """Run the analogue loop for the intensity."""
    return _run(_chance_hits, case, (), histories, seed, batches, frequencies)


def local_estimate(
    case: Case = Case(),
    *,
    histories: int,
    seed: int,
    batches: int = 100,
    frequencies: ArrayLike = FREQUENCIES,
    point_on_disc: bool = False,
) -> Tally:
    """Run the loop with an estimate at each scattering for the intensity."""
    extra = (point_on_disc,)
    return _run(_local_estimate, case, extra, histories, seed, batches, frequencies)


def chance_hits_stokes(
    case: Case = Case(),
    *,
    histories: int,
    seed: int,
    launched: ArrayLike = (1.0, 1.0, 0.0, 0.0),
    batches: int = 100,
    frequencies: ArrayLike = FREQUENCIES,
) -> Tally:
    """Run the analogue loop for the whole Stokes vector."""
    extra = (_state(launched),)
    return _run(_chance_hits_stokes, case, extra, histories, seed, batches, frequencies)


def local_estimate_stokes(
    case: Case = Case(),
    *,
    histories: int,
    seed: int,
    launched: ArrayLike = (1.0, 1.0, 0.0, 0.0),
    batches: int = 100,
    frequencies: ArrayLike = FREQUENCIES,
    point_on_disc: bool = False,
) -> Tally:
    """Run the loop with an estimate at each scattering for the whole Stokes vector."""
    extra = (_state(launched), point_on_disc)
    return _run(
        _local_estimate_stokes, case, extra, histories, seed, batches, frequencies
    )


@dataclass(frozen=True)
class SlabTally:
    """Means per history of each batch of a slab: fractions of the launched light."""

    reflected: Array  # batches, modulations; complex
    transmitted: Array  # with the direct light
    seconds: float
    histories: int


def slab(
    *,
    albedo: float = 0.9,
    thickness: float = 2.0,
    asymmetry: float = 0.75,
    modulation: ArrayLike = (0.0,),
    histories: int,
    seed: int,
    batches: int = 100,
) -> SlabTally:
    """Run the analogue loop through a slab, lengths in units of 1 / attenuation.

    `modulation` is omega / (v c): path L, in these units, scores exp(+i x L).
    """
    wave = np.atleast_1d(np.asarray(modulation, dtype=float))
    out = np.zeros((batches, 2, wave.size), dtype=complex)
    each = _even_share(histories, batches)
    fixed = (albedo, thickness, asymmetry, wave, each)
    streams = _streams(seed, batches)
    seconds = _in_parallel(
        _slab, [(*fixed, *rest) for rest in zip(streams, out, strict=True)]
    )
    return SlabTally(out[:, 0] / each, out[:, 1] / each, seconds, histories)


def _run(
    kernel: Callable[..., None],
    case: Case,
    extra: tuple[Any, ...],
    histories: int,
    seed: int,
    batches: int,
    frequencies: ArrayLike,
) -> Tally:
    """Run a kernel and take the time of it."""
    frequency = np.atleast_1d(np.asarray(frequencies, dtype=float))
    wavenumber = 2 * np.pi * frequency * case.group_index / speed_of_light
    steps = np.diff(wavenumber)
    if not np.allclose(steps, steps[:1], rtol=1e-9):
        raise ValueError(f"frequencies must be evenly spaced, got {frequency} Hz")
    waves = np.array([wavenumber[0], steps[0] if steps.size else 0.0])
    each = _even_share(histories, batches)
    last = (4,) if kernel in (_chance_hits_stokes, _local_estimate_stokes) else ()
    received = np.zeros((batches, *(last or (1,))))
    signal = np.zeros((batches, frequency.size, *last), dtype=complex)
    water = np.array([case.attenuation, case.albedo, case.asymmetry])
    disc = np.array([case.centre, case.radius, np.cos(case.acceptance)])
    fixed = (water, disc, case.half_space, *extra, waves, each)
    seconds = _in_parallel(
        kernel,
        [
            (*fixed, *rest)
            for rest in zip(_streams(seed, batches), received, signal, strict=True)
        ],
    )
    received = received / each if last else received[:, 0] / each
    return Tally(received, signal / each, seconds, histories)


def _in_parallel(kernel: Callable[..., None], calls: list[tuple[Any, ...]]) -> float:
    """Run the calls on all cores and return the seconds that they took."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        start = time.perf_counter()
        list(pool.map(lambda arguments: kernel(*arguments), calls))
        return time.perf_counter() - start


def _even_share(histories: int, batches: int) -> int:
    if histories % batches or histories <= 0:
        raise ValueError(
            f"histories must be a multiple of batches, {batches}, got {histories}"
        )
    return histories // batches


def _streams(seed: int, batches: int) -> Array:
    return np.random.default_rng(seed).integers(0, 2**64, size=batches, dtype=np.uint64)


def _state(launched: ArrayLike) -> Array:
    state = np.array(launched, dtype=float)
    if state.shape != (4,) or state[0] != 1 or np.linalg.norm(state[1:]) > 1 + 1e-12:
        raise ValueError(f"launched must be a state of intensity 1, got {state}")
    return state


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
def _chance_hits(water, disc, half_space, waves, each, stream, received, signal):
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
def _local_estimate(
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
def _chance_hits_stokes(
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
def _local_estimate_stokes(
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
def _slab(albedo, thickness, g, modulation, each, stream, out):
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
