"""Derivatives of received light by finite differences of a plain photon loop.

A beam leaves the origin along +z in water of one kind that fills all space, up to a
diffuse plane at `distance`. The receiver in the plane z = 0 takes the fraction
exp(-s^2 / R^2 - theta^2 / gamma^2) of the light that arrives at a distance s from its
middle under an angle theta to its axis. Each event adds the light that would arrive at
a random point of its face.

No photon ends by chance. Weights fall by b / c at a scattering and by the reflectance
at the plane, and a choice of fixed chance between plane and scattering is weighted. So
each photon's light is smooth in the parameters for given random numbers, and
differences of two loops with the same numbers have little noise.

Nothing is shared with the package.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import speed_of_light

Array = NDArray[Any]

#: Chance of the plane at each event.
HIT = 0.25


@dataclass(frozen=True)
class Case:
    """Water, plane and receiver."""

    absorption: float = 0.4  # 1 / m
    scattering: float = 0.4  # 1 / m
    asymmetry: float = 0.6
    reflectance: float = 0.5
    distance: float = 1.5  # m
    centre: float = 0.4  # of the receiver, along x, m
    radius: float = 0.1  # m
    acceptance: float = 0.4
    group_index: float = 1.33
    frequency: float = 50e6


def henyey_greenstein(cosine: Array, asymmetry: float) -> Array:
    """Return the phase function [1/sr]."""
    g = asymmetry
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cosine) ** 1.5)


def turned(direction: Array, cosine: Array, azimuth: Array) -> Array:
    """Return directions turned by a scattering angle and an azimuth."""
    # Axes that vary smoothly with the direction, up to that of -z.
    x, y, z = direction.T
    xy = -x * y / (1 + z)
    first = np.stack([1 - x * x / (1 + z), xy, -x], axis=1)
    second = np.stack([xy, 1 - y * y / (1 + z), -y], axis=1)
    sine = np.sqrt(np.maximum(1 - cosine**2, 0.0))
    return (
        cosine[:, None] * direction
        + (sine * np.cos(azimuth))[:, None] * first
        + (sine * np.sin(azimuth))[:, None] * second
    )


def light(case: Case, *, photons: int, events: int, seed: int) -> Array:
    """Return the light of water and plane by photon, shape (2, photons)."""
    random = np.random.default_rng(seed)
    attenuation = case.absorption + case.scattering
    g = case.asymmetry
    wave = 2j * np.pi * case.frequency * case.group_index / speed_of_light
    place = np.zeros((photons, 3))
    direction = np.tile([0.0, 0.0, 1.0], (photons, 1))
    weight, length = np.ones(photons), np.zeros(photons)
    touched = np.zeros(photons, dtype=int)
    received = np.zeros((2, photons), dtype=complex)
    for _ in range(events):
        u = random.random((7, photons))
        ahead = direction[:, 2] > 0
        way = np.full(photons, np.inf)
        way[ahead] = (case.distance - place[ahead, 2]) / direction[ahead, 2]
        passing = np.exp(-attenuation * way)
        hit = u[0] < HIT
        weight *= np.where(hit, passing / HIT, (1 - passing) / (1 - HIT))
        way[~ahead] = 0.0
        flight = np.where(hit, way, -np.log(1 - u[1] * (1 - passing)) / attenuation)
        place = place + flight[:, None] * direction
        length = length + flight
        weight *= np.where(hit, case.reflectance, case.scattering / attenuation)
        touched[hit] = 1
        # A random point of the face.
        across = case.radius * np.sqrt(-np.log(1 - u[2]))
        angle = 2 * np.pi * u[3]
        point = np.stack(
            [case.centre + across * np.cos(angle), across * np.sin(angle), 0 * across],
            1,
        )
        back = point - place
        distance = np.linalg.norm(back, axis=1)
        back = back / distance[:, None]
        cosine = np.sum(direction * back, axis=1)
        per_angle = np.where(hit, -back[:, 2] / np.pi, henyey_greenstein(cosine, g))
        area = np.pi * case.radius**2 * -back[:, 2] / distance**2
        off_axis = np.arccos(np.clip(-back[:, 2], -1.0, 1.0))
        area *= np.exp(-((off_axis / case.acceptance) ** 2))
        arriving = weight * per_angle * area * np.exp(-attenuation * distance)
        arriving[place[:, 2] <= 0] = 0.0
        received[touched, np.arange(photons)] += arriving * np.exp(
            wave * (length + distance)
        )
        # Lambert's law at the plane, Henyey's and Greenstein's in the water.
        drawn = (1 - g * g) / (1 - g + 2 * g * u[4])
        mu = (1 + g * g - drawn**2) / (2 * g)
        scattered = turned(direction, mu, 2 * np.pi * u[5])
        up, azimuth = np.sqrt(u[4]), 2 * np.pi * u[5]
        out = np.sqrt(1 - u[4])
        lambert = np.stack([out * np.cos(azimuth), out * np.sin(azimuth), -up], 1)
        direction = np.where(hit[:, None], lambert, scattered)
    return received


def derivative(
    case: Case, name: str, step: float, *, photons: int, events: int, seed: int
) -> tuple[Array, Array]:
    """Return the derivative of the light of water and plane, and its standard errors.

    Errors are those of real and imaginary part, as a complex number.
    """
    value = getattr(case, name)
    above, below = (
        light(
            replace(case, **{name: value + sign * step / 2}),
            photons=photons,
            events=events,
            seed=seed,
        )
        for sign in (1, -1)
    )
    slope = (above - below) / step
    error = (slope.real.std(axis=1) + 1j * slope.imag.std(axis=1)) / np.sqrt(photons)
    return slope.mean(axis=1), error
