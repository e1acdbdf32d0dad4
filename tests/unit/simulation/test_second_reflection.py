"""Light that two walls reflect in simulated scans, against an independent Monte Carlo.

The edge of the inside corner is vertical, at 2.6 m. Its walls stand at 45 degrees.
"""

from __future__ import annotations

import numpy as np
import pytest
from corner_rays import double_over_single
from numpy.testing import assert_allclose
from scipy.spatial import cKDTree

from amulor import Survey, simulate
from amulor.simulation import ClosureModel, geometry, lock_in, second_reflection
from amulor.studies.trust.surveys import corner, survey

EDGE = np.array([0.0, 0.0, 2.6])
LEFT, RIGHT = np.array([-1.0, 0.0, -1.0]) / 2**0.5, np.array([1.0, 0.0, -1.0]) / 2**0.5
UP = np.array([0.0, -1.0, 0.0])
SIDE = 0.3


def _corner(
    reflectance: tuple[float, float] = (0.4, 0.4), *, twice: bool = True
) -> Survey:
    walls = [
        corner(2.6, reflectance=value)[number]
        for number, value in enumerate(reflectance)
    ]
    scan = {"azimuth": 0.0, "wide": 9, "tall": 4, "columns": 6, "rows": 2}
    return survey(2, *walls, baseline=1, **scan).with_(
        {
            "instrument.receiver.acceptance": "0.3 rad",
            "scan.second_reflection": twice,
        }
    )


@pytest.mark.parametrize("reflectance", [(0.4, 0.4), (0.2, 0.7)])
def test_the_light_is_that_of_traced_rays(reflectance: tuple[float, float]) -> None:
    stated = _corner(reflectance)
    setup = geometry.Setup(stated)
    traced = geometry.trace(setup)
    receiver = np.asarray(stated.instrument.receiver.position)
    for row, column in ((0, 0), (1, 3)):
        wall = int(traced.target[row, column])
        own, other = (LEFT, RIGHT) if wall == 0 else (RIGHT, LEFT)
        for number, frequency in enumerate(stated.instrument.modulation_frequencies):
            expected, error = double_over_single(
                traced.point[row, column],
                other,
                wall_corner=EDGE - SIDE / 2 * UP,
                wall_sides=(SIDE * other, SIDE * UP),
                reflectance=reflectance[1 - wall],
                instrument=receiver,
                modulation_frequency=frequency,
                group_index=setup.medium.group_index,
                attenuation=setup.water.reduced_attenuation,
                rays=30_000,
                rng=np.random.default_rng(column),
            )
            assert own[2] < 0
            direct = reflectance[wall] * traced.cosine[row, column]
            ratio = traced.twice[1 + number, row, column] / direct
            assert_allclose(ratio, expected, rtol=0.02, atol=4 * error)


def test_the_added_light_is_unpolarized() -> None:
    lights = []
    for twice in (False, True):
        setup = geometry.Setup(_corner(twice=twice))
        light = lock_in.target_light(setup, geometry.trace(setup), model=ClosureModel())
        lights.append(light)
    added = lights[1].modulated - lights[0].modulated
    assert np.all(np.abs(added) > 0.01 * np.abs(lights[0].modulated[:, :1]))
    assert_allclose(added[:, 0], added[:, 1], rtol=1e-9)
    assert np.all(lights[1].mean > lights[0].mean)


def test_a_single_plate_reflects_light_once() -> None:
    setup = geometry.Setup(_corner().with_({"targets": [_corner().targets[0]]}))
    assert not geometry.trace(setup).twice.any()


@pytest.mark.slow
def test_the_samples_state_whether_they_contain_such_light() -> None:
    words = [
        simulate(_corner(twice=twice), rng=1, model=ClosureModel()).attrs[
            "corner_light"
        ]
        for twice in (False, True)
    ]
    assert words == ["absent", "present"]


def test_light_at_harmonics_is_reflected_twice_too() -> None:
    harmonic = {"instrument.errors": {"harmonic": {"order": 3, "fraction": 0.1}}}
    stated = _corner().with_(harmonic)
    plain = stated.with_({"scan.second_reflection": False})
    signals = []
    for each in (stated, plain):
        truth = simulate(each, rng=1, model=ClosureModel()).amulor.truth
        signals.append(np.hypot(truth["target_in_phase"], truth["target_quadrature"]))
    assert np.all(signals[0] > signals[1])


def test_rays_of_a_diffuse_reflection_are_even_with_a_density_of_the_cosine() -> None:
    for normal in ([0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [0.0, 1.0, 0.0]):
        (rays,) = second_reflection._directions(np.array([normal]))
        height = rays @ np.array(normal)
        assert_allclose(np.linalg.norm(rays, axis=1), 1.0)
        # Means of the cosine and of its square: 2 / 3 and 1 / 2.
        assert height.mean() == pytest.approx(2 / 3, abs=1e-3)
        assert (height**2).mean() == pytest.approx(1 / 2, abs=1e-3)
        aside = rays - height[:, None] * np.array(normal)
        assert_allclose(aside.mean(axis=0), 0.0, atol=5e-3)
        # On the disc of the sines each has about the same room: none is nearer to
        # another one than three quarters of a square of pi / 512.
        near = cKDTree(aside).query(aside, k=2)[0][:, 1]
        assert near.min() > 0.75 * (np.pi / len(rays)) ** 0.5
