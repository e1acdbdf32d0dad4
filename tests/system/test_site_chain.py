"""Scans of the whole chain, from light in water to the image, are registered."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from site_scenes import scanning, shapes

import amulor
from amulor.simulation import DiffusionModel
from amulor.site import Site
from amulor.site.registration.pose import ScanPose, start_pose
from amulor.site.registration.register import register
from amulor.site.registration.result import relative_covariance

pytestmark = pytest.mark.slow

SURVEY = """
name = "Scan {name}"
[water]
absorption = "0.1 1/m"
scattering = "0.2 1/m"
forward_fraction = 0.95
second_moment = "0.05 rad^2"
phase_function_at_180 = "0.002 1/sr"
refractive_index = 1.34
group_index = 1.38
backscatter_mueller = [0.81, -0.81, -0.62]
signal_fluctuation = "1 %"
[[targets]]
kind = "mesh"
file = "{name}.ply"
position = ["0 m", "0 m", "0 m"]
reflectance = 0.3
[instrument]
wavelength = "520 nm"
power = "200 mW"
modulation_depth = 0.8
modulation_frequencies = ["20 MHz", "80 MHz"]
polarizations = ["VV"]
[instrument.receiver]
position = ["7 cm", "0 m", "0 m"]
azimuth = "-2 deg"
radius = "2 cm"
acceptance = "0.08 rad"
[instrument.detector]
optical_transmission = "10 %"
[instrument.lock_in]
time_constant = "1 ms"
phase_floor = "0.01 deg"
[calibration]
delay_uncertainty = "5 ps"
group_index_uncertainty = "0.0002"
receiver_position_uncertainty = "0.1 mm"
direction_uncertainty = "0.01 mrad"
[scan]
columns = 80
rows = 60
azimuth_span = "40 deg"
elevation_span = "30 deg"
dwell = "5 ms"
moves = "both"
[scan.open_water]
columns = 9
rows = 7
repeats = 8
"""
SCAN = """
[[scan]]
name = "{name}"
file = "{name}.nc"
epoch = "now"
[scan.start]
position = [{place}]
heading = "{heading:.4f} deg"
pitch = "{pitch:.4f} deg"
position_uncertainty = "3 cm"
heading_uncertainty = "10 mrad"
level_uncertainty = "10 mrad"
[scan.processing]
method = "open-water"
nearest = "1 m"
farthest = "4 m"
"""
PLACES = {"a": (-1.2, -1.2, 1.6), "b": (1.3, -1.0, 1.7)}


@pytest.fixture(scope="module")
def placed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Any, float]:
    """Return how far the second scan is off, its covariance, and where it began."""
    tmp_path = tmp_path_factory.mktemp("chain")
    rng = np.random.default_rng(4)
    bed = shapes.sea_bed(relief=0.15)
    text = 'name = "Humps"\n[[epoch]]\nname = "now"\n'
    true = {}
    for number, (name, place) in enumerate(PLACES.items()):
        true[name] = ScanPose(*scanning.looking(place, (0.0, 0.05, 0.1)))
        mesh = bed.copy()
        mesh.vertices = true[name].back(mesh.vertices)
        mesh.export(tmp_path / f"{name}.ply")
        (tmp_path / f"{name}.toml").write_text(SURVEY.format(name=name))
        survey = amulor.Survey.from_toml(tmp_path / f"{name}.toml")
        # Rejection and images know nothing of the form of the light.
        cube = amulor.simulate(survey, rng=number, model=DiffusionModel())
        amulor.write_cube(cube, tmp_path / f"{name}.nc")
        forward = true[name].rotation[:, 2]
        off = np.array(place) + 0.03 * rng.normal(size=3)
        text += SCAN.format(
            name=name,
            place=", ".join(f'"{value:.4f} m"' for value in off),
            heading=np.degrees(
                np.arctan2(forward[0], forward[1]) + 0.01 * rng.normal()
            ),
            pitch=np.degrees(np.arcsin(forward[2]) + 0.01 * rng.normal()),
        )
    site = Site.from_text(text, folder=tmp_path)
    found = register(site)
    assert found.settled
    assert found.pairs[0]["points"] > 150
    # Where one stands against the other, in the axes of the first.
    first, second = found.poses["a"], found.poses["b"]
    turn = true["a"].rotation @ first.rotation.T
    place = turn @ (second.position - first.position) + true["a"].position
    rotation = turn @ second.rotation @ true["b"].rotation.T
    off = np.concatenate(
        [place - true["b"].position, Rotation.from_matrix(rotation).as_rotvec()]
    )
    spread = relative_covariance(found, "b", "a")
    assert site.scan[1].start is not None
    begun = np.linalg.norm(start_pose(site.scan[1].start).position - PLACES["b"])
    return off, spread, float(begun)


def test_scans_of_the_whole_chain_are_placed_within_millimetres(
    placed: tuple[Any, Any, float],
) -> None:
    off, spread, begun = placed
    assert np.sqrt(spread.diagonal()[:3]).max() < 3e-3
    assert np.linalg.norm(off[:3]) < 3e-3
    # From start poses that are centimetres off.
    assert np.linalg.norm(off[:3]) < 0.2 * begun


@pytest.mark.xfail(
    reason="stated poses are two to five standard errors off where far, grazing pixels "
    "are noisy (chi-square 46 to 86 of 6 in five draws; 4, 6 and 17 with light of the "
    "default form, whose far pixels are flagged): their patches are too wide"
)
def test_scans_of_the_whole_chain_are_placed_within_what_is_stated(
    placed: tuple[Any, Any, float],
) -> None:
    off, spread, _ = placed
    # Chi-square of six degrees of freedom.
    assert off @ np.linalg.solve(spread, off) < 25
