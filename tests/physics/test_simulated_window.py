"""Photon transport behind a window against a loop that bends each ray at its faces."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.constants import speed_of_light

from amulor.simulation import simulate
from amulor.simulation.transport import monte_carlo_response
from amulor.survey import Survey, water_properties

FREQUENCY = np.array([0.0, 39e6])
AIR, GLASS = 0.1, 0.02  # m
INDEX = 1.52


def tangent(sine):
    """Return the tangent of an angle by its sine."""
    return sine / np.sqrt(1 - sine**2)


def bent(height, across, water_index):
    """Return the sine in water of the ray from a point to a place on the face.

    The point lies `height` below the glass, `across` aside; by Newton's method. Also
    returned is the derivative of across to the sine.
    """
    sine = across / np.hypot(across, height + AIR + GLASS) * 0.7
    for _ in range(30):
        way = height * tangent(sine)
        slope = height * (1 - sine**2) ** -1.5
        for depth, ratio in ((GLASS, water_index / INDEX), (AIR, water_index)):
            way = way + depth * tangent(ratio * sine)
            slope = slope + depth * ratio * (1 - (ratio * sine) ** 2) ** -1.5
        sine = np.clip(sine - (way - across) / slope, 0, 0.999 / water_index)
    return sine, slope


def plain_light(absorption, scattering, asymmetry, index, group_index, eye, photons):
    """Return the light of each photon by local estimates, shape (photons, 2)."""
    rng = np.random.default_rng(1)
    c, wave = absorption + scattering, 2j * np.pi * FREQUENCY / speed_of_light
    place = np.zeros((photons, 3))  # z is the depth below the glass
    way = np.tile([0.0, 0.0, 1.0], (photons, 1))
    length, number = np.zeros(photons), np.arange(photons)
    light = np.zeros((photons, 2), dtype=complex)
    while number.size:
        step = rng.exponential(1 / c, number.size)
        place, length = place + step[:, None] * way, length + step
        going = (place[:, 2] > 0) & (rng.uniform(size=number.size) < scattering / c)
        place, way, length, number = (
            place[going], way[going], length[going], number[going]
        )  # fmt: skip
        point = rng.normal(scale=eye["radius"] / np.sqrt(2), size=(number.size, 2))
        offset = point + np.array([eye["baseline"], 0]) - place[:, :2]
        across = np.linalg.norm(offset, axis=1)
        sine, slope = bent(place[:, 2], across, index)
        up = np.sqrt(1 - sine**2)
        back = np.column_stack([offset / across[:, None] * sine[:, None], -up])
        turn = np.sum(way * back, axis=1)
        g = asymmetry
        density = (1 - g**2) / (4 * np.pi * (1 + g**2 - 2 * g * turn) ** 1.5)
        # Solid angle in water for each area of the face.
        solid = sine / (across * slope * up)
        angle = np.arcsin(index * sine)
        weight = density * solid * np.exp(-((angle / eye["acceptance"]) ** 2))
        weight = weight * np.pi * eye["radius"] ** 2 * np.exp(-c * place[:, 2] / up)
        total = group_index * (length + place[:, 2] / up)
        # Air and glass count as a lot of water, without what the straight way has.
        total = total + index * AIR * (1 / np.cos(angle) - 1)
        light[number] += weight[:, None] * np.exp(wave * total[:, None])
        drawn = rng.uniform(size=number.size)
        part = (1 - g**2) / (1 - g + 2 * g * drawn)
        cosine = (1 + g**2 - part**2) / (2 * g)
        side = np.cross(way, rng.normal(size=way.shape))
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        way = cosine[:, None] * way + np.sqrt(1 - cosine**2)[:, None] * side
    return light


@pytest.mark.slow
@pytest.mark.parametrize("acceptance", [0.16, 0.3])
def test_water_behind_a_window_is_that_of_bent_rays(acceptance):
    survey = Survey.preset("amulor-2010").with_(
        {
            "water": {
                "kind": "coefficients", "absorption": 0.3, "scattering": 0.9,
                "phase_function": {"kind": "henyey-greenstein", "asymmetry": 0.6},
                "refractive_index": 1.34, "group_index": 1.37,
            },
            "targets": [],
            "scan.azimuth": 0.0, "scan.elevation": 0.0,
            "instrument.emitter.position": (0.0, 0.0, 0.0),
            "instrument.receiver.position": (0.06, 0.0, 0.0),
            "instrument.receiver.azimuth": 0.0,
            "instrument.receiver.radius": 0.03,
            "instrument.receiver.acceptance": acceptance,
            "instrument.window": {
                "distance": AIR, "thickness": GLASS, "refractive_index": INDEX
            },
        }
    )  # fmt: skip
    water = water_properties(survey)
    tally = monte_carlo_response(survey, FREQUENCY, relative_error=0.005)
    light = plain_light(
        water.absorption, water.scattering, 0.6, water.refractive_index,
        water.group_index,
        {"radius": 0.03, "acceptance": acceptance, "baseline": 0.06}, 400_000,
    )  # fmt: skip
    mean = light.mean(axis=0)
    error = np.abs(light).std(axis=0) / np.sqrt(len(light)) / abs(mean)
    error = np.hypot(error, tally.relative_error)
    assert np.all(error < 0.03)
    # The window counts as a depth of water, which is right for small angles.
    assert np.all(np.abs(tally.signal / mean - 1) < 4 * error)


def test_the_echo_behind_a_window_is_that_of_bent_rays():
    window = {"distance": AIR, "thickness": GLASS, "refractive_index": INDEX}
    survey = Survey.preset("amulor-2010").with_(
        {
            "water": {
                "kind": "coefficients", "absorption": 0.2, "scattering": 1e-6,
                "phase_function": {"kind": "henyey-greenstein", "asymmetry": 0.6},
                "refractive_index": 1.34, "group_index": 1.37,
            },
            "targets": [
                {
                    "kind": "plate", "position": (0.0, 0.0, 1.0), "width": 1.0,
                    "height": 1.0, "reflectance": 0.3,
                }
            ],
            "scan.columns": 1, "scan.rows": 1, "scan.open_water": None,
            "scan.azimuth": 0.0, "scan.elevation": 0.0,
            "instrument.polarizations": ["none"],
            "instrument.modulation_frequencies": [20e6],
            "instrument.emitter.position": (0.0, 0.0, 0.0),
            "instrument.receiver.position": (0.06, 0.0, 0.0),
            "instrument.receiver.azimuth": 0.0,
            "instrument.receiver.acceptance": 0.08,
        }
    )  # fmt: skip
    radius = survey.instrument.receiver.radius
    echo = []
    for each in (survey, survey.with_({"instrument.window": window})):
        truth = simulate(each, rng=1).amulor.truth
        echo.append(np.hypot(truth["target_in_phase"], truth["target_quadrature"]))
    # Points of the Gaussian face, and the light of a unit of radiance.
    away = radius * np.sqrt(-np.log((np.arange(50)[:, None] + 0.5) / 50))
    turn = 2 * np.pi * (np.arange(50) + 0.5) / 50
    across = np.hypot(0.06 + away * np.cos(turn), away * np.sin(turn))
    light = []
    for height, air, bend in ((1.0, 0.0, 1.0), (1.0 - AIR - GLASS, 1.0, 1.34)):
        if air:
            sine, slope = bent(height, across, 1.34)
        else:
            sine = across / np.hypot(across, height)
            slope = height * (1 - sine**2) ** -1.5
        up = np.sqrt(1 - sine**2)
        seen = np.exp(-((np.arcsin(bend * sine) / 0.08) ** 2) - 0.2 * height / up)
        # The beam also loses light on its way out.
        seen = seen * np.exp(-0.2 * height)
        light.append((seen * sine / across / slope).mean())
    assert (echo[1] / echo[0]).item() == pytest.approx(light[1] / light[0], rel=0.01)
