"""Monte Carlo of the delay of echoes by scattered light, without amulor.

Photons go from the laser to the surface, and by reciprocity from the receiver to the
surface. The echo is the sum over pairs that meet there, each with the phase and the
absorption of its whole path.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

Floats = NDArray[np.float64]

_CELLS = 251


@numba.njit(cache=True)
def _arrivals(
    rng: np.random.Generator,
    count: int,
    scattering: float,
    depth: float,
    radius: float,
    semi_angle: float,
    sharp: bool,
    aside: float,
    tilt: float,
    angle: Floats,
    cumulative: Floats,
) -> tuple[Floats, Floats, Floats]:
    """Return places on the surface, and lengths of paths, of photons that arrive."""
    x_end, y_end, length = np.zeros(count), np.zeros(count), np.full(count, -1.0)
    for i in range(count):
        draw, turn = rng.random(), rng.random()
        if sharp:
            across, lean = radius * math.sqrt(draw), semi_angle * math.sqrt(turn)
        else:
            across = radius * math.sqrt(-math.log(1 - draw))
            lean = semi_angle * math.sqrt(-math.log(1 - turn))
        azimuth = 2 * math.pi * rng.random()
        x, y = aside + across * math.cos(azimuth), across * math.sin(azimuth)
        azimuth = 2 * math.pi * rng.random()
        side, v = math.sin(lean) * math.cos(azimuth), math.sin(lean) * math.sin(azimuth)
        u = side * math.cos(tilt) - math.cos(lean) * math.sin(tilt)
        w = side * math.sin(tilt) + math.cos(lean) * math.cos(tilt)
        z, path = 0.0, 0.0
        while True:
            step = -math.log(1 - rng.random()) / scattering
            if w > 0 and z + step * w >= depth:
                step = (depth - z) / w
                x_end[i], y_end[i], length[i] = x + u * step, y + v * step, path + step
                break
            x, y, z, path = x + u * step, y + v * step, z + w * step, path + step
            if z < 0 or path > 4 * depth:
                break
            draw = rng.random()
            k = max(1, np.searchsorted(cumulative, draw))
            rise = cumulative[k] - cumulative[k - 1]
            part = (draw - cumulative[k - 1]) / rise if rise > 0 else 0.0
            bend = angle[k - 1] + part * (angle[k] - angle[k - 1])
            azimuth = 2 * math.pi * rng.random()
            along, out = math.cos(bend), math.sin(bend) * math.cos(azimuth)
            up = math.sin(bend) * math.sin(azimuth)
            flat = math.sqrt(max(0.0, 1 - w * w))
            if flat < 1e-8:
                u, v, w = out, up, along * math.copysign(1.0, w)
            else:
                u, v, w = (
                    (out * u * w - up * v) / flat + along * u,
                    (out * v * w + up * u) / flat + along * v,
                    along * w - out * flat,
                )
    there = length >= 0
    return x_end[there], y_end[there], length[there]


def late_range(
    wavenumber: Floats,
    *,
    depth: float,
    scattering: float,
    absorption: float,
    angle: Floats,
    cumulative: Floats,
    receiver_radius: float,
    acceptance_angle: float,
    aside: float = 0.0,
    sharp: bool = False,
    photons: int = 100_000,
    batches: int = 4,
    seed: int = 1,
) -> tuple[Floats, Floats]:
    """Return excess of the slant range, and standard error, per wavenumber [m].

    The receiver stands `aside` of the laser and points at the spot. `angle` and
    `cumulative` are the share of light scattered up to an angle.
    """
    tilt = math.atan2(aside, depth)
    view = math.hypot(receiver_radius, acceptance_angle * depth)
    results = np.empty((batches, len(wavenumber)))
    for batch in range(batches):
        rng = np.random.default_rng([seed, batch])
        common = (angle, cumulative)
        x, y, out = _arrivals(
            rng, photons, scattering, depth, 0.0, 0.0, False, 0.0, 0.0, *common
        )
        receiver = (receiver_radius, acceptance_angle, sharp, aside, tilt)
        x_back, y_back, back = _arrivals(
            rng, photons, scattering, depth, *receiver, *common
        )
        out, back = out - depth, back - math.hypot(depth, aside)
        if aside:
            # The scene is symmetric, so one half of the surface serves for both.
            half = 10 * view
            size = 2 * half / _CELLS
            column = np.floor((x_back + half) / size).astype(int)
            row = np.floor(np.abs(y_back) / size).astype(int)
            inside = (column >= 0) & (column < _CELLS) & (row < _CELLS // 2)
            cell = column[inside] * (_CELLS // 2) + row[inside]
            places = [(x + half) / size - 0.5, np.abs(y) / size + 0.5]
        else:
            ring = np.quantile(x_back**2 + y_back**2, np.linspace(0, 1, 301))
            ring[0] = 0
            place = np.searchsorted(ring, x_back**2 + y_back**2, side="right") - 1
            place = np.clip(place, 0, 299)
        for number, k in enumerate(wavenumber):
            light = np.exp((1j * k - absorption) * back)
            density = np.zeros(x.size, dtype=complex)
            for part, unit in ((light.real, 1.0), (light.imag, 1.0j)):
                if aside:
                    grid = np.bincount(
                        cell, part[inside], _CELLS * (_CELLS // 2)
                    ).reshape(_CELLS, -1)
                    grid = np.concatenate([grid[:, :1], grid], axis=1)
                    density += unit * map_coordinates(grid, places, order=1)
                else:
                    grid = np.bincount(place, part, 300) / np.diff(ring)
                    middle = (ring[1:] + ring[:-1]) / 2
                    density += unit * np.interp(x**2 + y**2, middle, grid, right=0.0)
            echo = np.sum(np.exp((1j * k - absorption) * out) * density)
            results[batch, number] = np.angle(echo) / k / 2
    return results.mean(axis=0), results.std(axis=0, ddof=1) / math.sqrt(batches)
