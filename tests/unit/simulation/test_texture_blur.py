"""Textures through scattering water: closed limits, and traced photons."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.testing import assert_allclose
from scipy.integrate import quad

from amulor.optics._spot import Spot
from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.simulation import ClosureModel, DiffusionModel, simulate
from amulor.simulation.geometry import Geometry, Setup, trace
from amulor.survey import Survey
from amulor.transport import (
    GaussianReceiver,
    Medium,
    MeshTarget,
    PlaneTarget,
    Source,
)
from amulor.transport import simulate as follow

PEAKED = henyey_greenstein_function(asymmetry=0.95)
DISTANCE = 2.0
WATER: dict[str, Any] = {
    "water.second_moment": None,
    "water.forward_fraction": None,
    "water.phase_function_at_180": None,
    "water.asymmetry": 0.95,
    "water.absorption": 0.2,
    "water.scattering": 0.8,
}
FREQUENCY = [50e6, 200e6]


def spot(**fields: Any) -> Spot:
    depth = np.array([DISTANCE])
    common: dict[str, Any] = {
        "phase_function": PEAKED, "split_angle": np.pi / 2, "scattering": 0.8,
        "depth": depth, "way": depth, "radius": 0.0, "semi_angle": 0.0,
    }  # fmt: skip
    return Spot(**common | fields)


def faces(edges: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return corners and faces of strips between edges, on the plane z = 0."""
    corners = np.array([(x, y, 0.0) for x in edges for y in (-3, 3)])
    pairs = [
        [2 * k + j, 2 * k + 1 + j, 2 * k + 2 + j]
        for k in range(len(edges) - 1)
        for j in (0, 1)
    ]
    return corners, np.array(pairs)


def striped(plate: Survey, folder: Path, colors: list[int], **fields: Any) -> Survey:
    """Return a survey of strips of given brightness, with edges at 6 cm."""
    corners, strips = faces([-3.0, -0.06, 0.06, 3.0])
    each = np.repeat(colors, 6)[:, None] * np.array([1, 1, 1, 0]) + [0, 0, 0, 255]
    trimesh.Trimesh(
        corners[strips].reshape(-1, 3),
        np.arange(strips.size).reshape(-1, 3),
        vertex_colors=each.astype(np.uint8),
        process=False,
    ).export(folder / "strips.ply")
    target = {
        "kind": "mesh",
        "file": str(folder / "strips.ply"),
        "position": (0.0, 0.0, DISTANCE),
        "reflectance": 0.4,
        "texture": "vertex-colours",
    }
    target |= {"position": fields.pop("position", target["position"])}
    return plate.with_(
        WATER
        | {
            "targets": [target],
            "instrument.modulation_frequencies": FREQUENCY,
            "instrument.receiver.azimuth": 0.0,
            "scan.open_water": None,
            "scan.columns": 1,
            "scan.rows": 1,
        }
        | fields
    )


def texture(survey: Survey) -> np.ndarray:
    """Return the texture with its surroundings, (frequency, row, column)."""
    found: Geometry = trace(Setup(survey))
    assert found.surroundings is not None
    return found.brightness + found.surroundings


def test_light_scattered_once_falls_on_the_plane_as_its_angles_say():
    thin, distance = 1e-6, np.array([[0.01, 0.1, 0.5]])
    found = spot(scattering=thin).scattered(distance, -1e-9 + 0j)[0].real / thin

    def from_depth(x: float, r: float) -> float:
        angle = np.arctan(r / x)
        return float(PEAKED(np.array([angle]))[0] * np.cos(angle) ** 3 / x**2)

    expected = [
        quad(from_depth, 1e-9, DISTANCE, args=(r,), points=[r / 10, r], limit=400)[0]
        for r in distance[0]
    ]
    # Averaged over 10 % of the distance.
    assert_allclose(found, expected, rtol=0.03)


def test_a_gaussian_start_widens_the_unscattered_light():
    power, square = spot(radius=0.01, semi_angle=0.02).unscattered(0j)
    fraction, _ = PEAKED.forward_split(np.pi / 2)
    assert_allclose(power.real, np.exp(-0.8 * fraction * DISTANCE))
    assert_allclose(square.real, 0.01**2 + (0.02 * DISTANCE) ** 2)


def test_a_uniform_texture_and_clear_water_change_nothing(plate, tmp_path):
    grey = striped(plate, tmp_path, [200, 200, 200])
    assert_allclose(texture(grey), 200 / 255, rtol=1e-12)
    stripe = striped(plate, tmp_path, [255, 51, 255])
    clear = stripe.with_({"water.scattering": 0.0})
    assert_allclose(texture(clear), 0.2, rtol=1e-12)
    assert trace(Setup(plate)).surroundings is None


@pytest.mark.parametrize("edge", ["gaussian", "sharp"])
def test_a_wide_beam_on_an_edge_sees_half_of_each_side(plate, tmp_path, edge):
    survey = striped(
        plate,
        tmp_path,
        [255, 51, 51],
        **{
            "water.scattering": 0.0,
            "instrument.emitter.beam_radius": 0.03,
            "instrument.receiver.edge": edge,
            "instrument.receiver.position": (0.0, 0.0, 0.0),
            "position": (0.06, 0.0, DISTANCE),
        },
    )
    assert_allclose(texture(survey).real, (1 + 0.2) / 2, atol=0.03)


def test_all_models_have_the_blurred_texture(plate, tmp_path):
    stripe = striped(plate, tmp_path, [255, 51, 255])
    bright = stripe.with_({"targets.0.texture": None})
    moments = {
        "water.asymmetry": None,
        "water.second_moment": 0.06,
        "water.forward_fraction": 1.0,
        "water.phase_function_at_180": 0.001,
    }
    for model, water in ((ClosureModel(), {}), (DiffusionModel(), moments)):
        ratio = []
        for survey in (stripe.with_(water), bright.with_(water)):
            truth = simulate(survey, rng=1, model=model).amulor.truth
            signal = truth["target_in_phase"] + 1j * truth["target_quadrature"]
            ratio.append(signal.values[:, 0, 0, 0])
        expected = texture(stripe.with_(water))[1:, 0, 0]
        assert_allclose(ratio[0] / ratio[1], expected, rtol=1e-9)
        assert 0.25 < abs(expected[0]) < 0.6


def test_a_vehicle_that_stands_still_sees_the_same_blur(plate, tmp_path):
    stripe = striped(plate, tmp_path, [255, 51, 255])
    setup = Setup(stripe)
    here = trace(setup)
    lines = np.zeros(3), np.eye(3)
    moved = trace(
        Setup(stripe, _Still(*lines)),  # type: ignore[arg-type]
        directions=(here.azimuth, here.elevation, here.time),
    )
    assert_allclose(moved.surroundings, here.surroundings, rtol=1e-9)


class _Still:
    def __init__(self, position: np.ndarray, rotation: np.ndarray) -> None:
        self.place = position[None], rotation[None]

    def in_scene(self, time: np.ndarray) -> tuple[np.ndarray, ...]:
        return tuple(np.repeat(part, time.size, axis=0) for part in self.place)


@pytest.mark.slow
def test_a_stripe_fades_as_traced_photons_say(plate, tmp_path):
    stripe = striped(plate, tmp_path, [255, 51, 255])
    survey = stripe.with_({"water.group_index": 1.38})
    found = texture(survey)[:, 0, 0]
    water = Medium.homogeneous(
        absorption=0.2, scattering=0.8, phase_function=PEAKED, group_index=1.38
    )
    receiver = survey.instrument.receiver
    eye = GaussianReceiver(
        radius=receiver.radius,
        acceptance_angle=receiver.acceptance,
        position=receiver.position,
    )
    corners, strips = faces([-3.0, -0.06, 0.06, 3.0])
    place = np.array([0.0, 0.0, DISTANCE])
    runs = [
        follow(
            water, Source(), eye, [0.0, *FREQUENCY], histories=100_000, seed=seed,
            target=target,
        )
        for seed, target in enumerate(
            (
                MeshTarget(
                    vertices=corners + place, faces=strips, reflectance=0.4,
                    texture=np.repeat([1.0, 0.2, 1.0], 2),
                ),
                PlaneTarget(position=place, reflectance=0.4),
            )
        )
    ]  # fmt: skip
    ratio = runs[0].target_signal / runs[1].target_signal
    error = np.hypot(*(run.relative_error_of("target") for run in runs))
    # 4 % of the light that the stripe does not return, and a fifth of the delay.
    assert np.all(abs(abs(found) / abs(ratio) - 1) < 4 * error + 0.04)
    assert_allclose(np.angle(found), np.angle(ratio), rtol=0.2, atol=2e-3)
    assert np.angle(ratio[2]) > 0.02
