"""Angles at which a surface is lit and seen, and the rows of a traced scan."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from amulor.errors import SurveyError
from amulor.optics import rays
from amulor.simulation import geometry
from amulor.simulation.geometry import Setup, trace
from amulor.simulation.scene import Hits
from amulor.survey import Survey

TARGETS = [
    {"kind": "plate", "position": (0, 0, far), "width": 1, "height": 1,
     "reflectance": reflectance, **more}
    for far, reflectance, more in (
        (2, 0.1, {}), (3, 0.4, {"surface": {"kind": "oren-nayar", "roughness": 0.3}})
    )
]  # fmt: skip


def test_a_surface_is_lit_and_seen_under_its_own_angles(
    plate: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, Any] = {}

    def brightness(surface: Any, **angles: Any) -> np.ndarray:
        asked.update(angles, surface=surface)
        return np.array([5.0, 6.0, 7.0])

    monkeypatch.setattr(geometry.surface, "brightness", brightness)
    incidence, leaving = np.array([0.3, 0.8, 0.6]), np.array([0.5, 1.1, 0.4])
    azimuth = np.array([2.0, 0.7, 3.0])
    turns = Rotation.random(3, rng=4)

    def side(angle: np.ndarray, about: np.ndarray) -> np.ndarray:
        local = [np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about),
                 np.cos(angle)]  # fmt: skip
        return turns.apply(np.stack(local, axis=1))

    receiver = np.array([0.2, -0.1, 0.3])
    normal = turns.apply(np.tile([0.0, 0, 1], (3, 1)))
    point = receiver - np.array([[2.0], [3.0], [0.5]]) * side(leaving, azimuth)
    way = -side(incidence, np.zeros(3))
    hits = Hits(
        target=np.array([1, 0, 1, -1, 1]), distance=np.ones(5),
        point=np.insert(point, [1, 2], 9.0, axis=0),
        normal=np.insert(normal, [1, 2], 9.0, axis=0), triangle=np.zeros(5, int),
    )  # fmt: skip
    beam: Any = SimpleNamespace(direction=np.insert(way, [1, 2], 9.0, axis=0)[None])
    texture = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    survey = plate.with_({"targets": TARGETS})
    found = geometry._brightness(survey, texture, hits, beam, receiver)
    assert found.tolist() == [5, 0.2, 6, 0.4, 7]
    assert texture.tolist() == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert asked["reflectance"] == 0.4
    assert asked["texture"].tolist() == [0.1, 0.3, 0.5]
    assert_allclose(asked["incidence"], incidence, atol=1e-7)
    assert_allclose(asked["leaving"], leaving)
    assert_allclose(asked["azimuth"], azimuth, atol=1e-7)


def test_light_from_behind_comes_in_at_a_right_angle_at_most(
    plate: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, Any] = {}

    def brightness(surface: Any, **angles: Any) -> np.ndarray:
        asked.update(angles)
        return np.zeros(1)

    monkeypatch.setattr(geometry.surface, "brightness", brightness)
    hits = Hits(
        target=np.array([1]), distance=np.ones(1), point=np.array([[0.0, 0, 2]]),
        normal=np.array([[0.0, 0, -1]]), triangle=np.zeros(1, int),
    )  # fmt: skip
    beam: Any = SimpleNamespace(direction=np.array([[0.0, 0, 1]]))
    survey = plate.with_({"targets": TARGETS})
    geometry._brightness(survey, np.ones(1), hits, beam, np.array([1.0, 0, 3.0]))
    assert asked["leaving"][0] == pytest.approx(np.pi / 2)
    assert asked["azimuth"][0] == 0


def test_a_scan_is_traced_to_ranges_paths_and_cosines(plate: Survey) -> None:
    survey = plate.with_(
        {
            "scan.columns": 5, "scan.rows": 2, "targets.0.width": 0.06,
            "targets.0.height": 9.0,
            "instrument.window": {"distance": 0.2, "thickness": 0.03,
                                  "refractive_index": 1.5, "group_index": 1.52},
        }
    )  # fmt: skip
    found = trace(Setup(survey))
    met = found.target >= 0
    assert met.tolist() == [[False, True, True, True, False]] * 2
    beam = rays.enter_water(
        (0.0, 0, 0), rays.direction(found.azimuth, found.elevation),
        medium=Setup(survey).medium,
    )  # fmt: skip
    depth = (1.5 - beam.entry[..., 2]) / beam.direction[..., 2]
    assert_allclose(found.depth[met], depth[met])
    assert np.isinf(found.depth[~met]).all()
    assert_allclose(found.slant_range[met], (depth + beam.length_before)[met])
    point = beam.entry + depth[..., None] * beam.direction
    assert_allclose(found.point[met], point[met])
    assert np.isnan(found.point[~met]).all()
    receiver = np.array([0.07, 0, 0])
    way = receiver - point
    cosine = -way[..., 2] / np.linalg.norm(way, axis=-1)
    assert_allclose(found.cosine[met], cosine[met])
    assert not found.cosine[~met].any()
    # There in water, then back through water, glass and air.
    optical = beam.optical_length_before + 1.38 * depth
    assert np.all(found.optical_path[met] > (optical + 1.38 * 1.2)[met])
    assert np.all(found.optical_path[met] < (optical + 1.38 * 1.6)[met])
    assert not found.optical_path[~met].any()
    assert np.isinf(found.return_path[~met]).all()
    assert np.all(np.abs(found.return_path[met] - depth[met]) < 0.01)
    assert_array_equal(found.brightness, np.ones((2, 5)))
    assert found.surroundings is found.twice is None


def test_targets_behind_the_end_of_the_water_are_refused(plate: Survey) -> None:
    assert trace(Setup(plate.with_({"water.column_end": 1.51}))).target.max() == 0
    with pytest.raises(SurveyError, match=r"^targets\.0: a beam meets it after 1\.5"):
        trace(Setup(plate.with_({"water.column_end": 1.49})))
    assert trace(Setup(plate)).target.max() == 0


def test_a_full_return_gives_the_volts_of_the_launched_light(plate: Survey) -> None:
    setup = Setup(plate)
    instrument = plate.instrument
    energy = 6.62607015e-34 * 299792458.0 / 405e-9
    rate = 0.02 / energy * instrument.detector.quantum_efficiency * 0.1
    assert setup.full_rate == pytest.approx(rate, rel=1e-6)
    volt = 0.8 * instrument.detector.volt_per_photoelectron_rate * rate
    assert setup.volt_per_power == pytest.approx(volt, rel=1e-6)
