"""Parts of a simulation by independent formulas: shapes, errors, fits and samples."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.cube import tiles
from amulor.simulation import ClosureModel, simulate
from amulor.simulation.instrument_errors import Chain
from amulor.simulation.lock_in import Light
from amulor.simulation.measurement import _spread
from amulor.simulation.photons import fitted_ratio
from amulor.simulation.scene import _plate, _staircase, solid
from amulor.simulation.vehicle import VehicleMotion
from amulor.survey import Survey
from amulor.survey.instrument_errors import Bubbles
from amulor.survey.target import Plate, Staircase


def test_triangles_of_any_size_have_an_area_unless_they_are_lines() -> None:
    small = 1e-4 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    line = np.array([[0.0, 0, 0], [1, 1, 1], [2, 2, 2]])
    point = np.ones((3, 3))
    assert solid(np.array([small, line, 1e5 * small, point])).tolist() == [
        True, False, True, False,
    ]  # fmt: skip


def area_and_box(corners: np.ndarray) -> tuple[float, list[float]]:
    """Area of triangles [m2], and the ends of all axes [m]."""
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    ends = [*corners.min(axis=(0, 1)), *corners.max(axis=(0, 1))]
    return float(np.linalg.norm(sides, axis=1).sum() / 2), ends


def test_plates_and_staircases_have_their_edges_and_areas() -> None:
    common: dict[str, Any] = {"position": (0.0, 0.0, 2.0), "reflectance": 0.1}
    plate = Plate(kind="plate", width=0.3, height=0.2, **common)
    area, ends = area_and_box(_plate(plate))
    assert area == pytest.approx(0.06)
    assert_allclose(ends, [-0.15, -0.1, 0, 0.15, 0.1, 0], atol=1e-15)
    stairs = Staircase(
        kind="staircase", tread_width=0.02, step_heights=(0.04, 0.01, 0.03),
        height=0.1, **common,
    )  # fmt: skip
    corners = _staircase(stairs)
    area, ends = area_and_box(corners)
    # Four treads about the middle, and risers of 8 cm in all, towards the instrument.
    assert area == pytest.approx(0.1 * (4 * 0.02 + 0.08))
    assert_allclose(ends, [-0.04, -0.05, -0.08, 0.04, 0.05, 0.0], atol=1e-15)
    treads = corners[np.ptp(corners[..., 2], axis=1) == 0]
    centers = {
        (round(float(np.ptp(c[:, 0])), 6), round(float(c[:, 0].min()), 6),
         round(float(c[0, 2]), 6))
        for c in treads
    }  # fmt: skip
    assert centers == {
        (0.02, -0.04, 0.0), (0.02, -0.02, -0.04), (0.02, 0.0, -0.05),
        (0.02, 0.02, -0.08),
    }  # fmt: skip


def test_bubbles_are_weaker_by_the_square_of_their_distance() -> None:
    bubbles = Bubbles(number=0.4, fraction=0.3, nearest=0.5, farthest=2.0)
    # A turn of one radian per metre tells the distance of a lone bubble.
    chain: Any = SimpleNamespace(
        errors=SimpleNamespace(bubbles=bubbles),
        entropy=5,
        _turn=lambda distance, axes: np.exp(1j * distance),
    )
    mean = np.full((2, 1, 400), 2.0)
    light = Chain._bubbles(chain, [3], Light(mean.astype(complex), mean), part="scan")
    seen = light.mean > 0
    lone = seen & np.isclose(abs(light.modulated), light.mean, rtol=1e-12)
    distance = np.angle(light.modulated[lone])
    assert lone.sum() > 150
    assert distance.min() > 0.5
    assert distance.max() < 2.0
    assert np.ptp(distance) > 1.4
    assert_allclose(light.mean[lone], 2.0 * 0.3 * (0.5 / distance) ** 2, rtol=1e-9)
    # None in exp(-0.4) of the samples.
    assert (~seen).mean() == pytest.approx(np.exp(-0.4), abs=0.07)


@pytest.mark.parametrize(
    ("rows", "columns"), [(1, 1), (3, 5), (256, 256), (1000, 1000), (4, 10**6)]
)
def test_a_sample_of_a_scan_has_its_edges_and_at_most_its_size(
    rows: int, columns: int
) -> None:
    found = _spread(rows, columns)
    assert (found["rows"][0], found["columns"][0]) == (0, 0)
    assert found["rows"][-1] == rows - 1
    assert found["columns"][-1] == columns - 1
    size = len(found["rows"]) * len(found["columns"])
    assert size <= tiles.SAMPLE
    if rows * columns <= tiles.SAMPLE:
        assert size == rows * columns
    else:
        assert size > 0.9 * tiles.SAMPLE
    for places in found.values():
        assert np.ptp(np.diff(places)) <= 1 if len(places) > 1 else True


def test_pixels_and_readings_in_turn_take_their_dwell(plate: Survey) -> None:
    course = {"kind": "line", "start": [0, 0, -8], "heading": 0.0, "speed": 0.3}
    pose = {"position": [0.0, 0.0, -8.0], "heading": 0.0, "pitch": -1.5, "roll": 0.0}
    stated = {
        "scan.rows": 3, "scan.columns": 7, "scan.dwell": 0.06, "pose": pose,
        "instrument.modulation_frequencies": [39e6, 78e6],
        "instrument.polarizations": ["VV", "VH", "RR"],
        "instrument.modulation_depth": 0.4,
    }  # fmt: skip
    for readings, each in (("at-once", 1), ("in-turn", 6)):
        platform = {"course": course, "readings": readings}
        survey = plate.with_({**stated, "platform": platform})
        motion = VehicleMotion.of(survey, 1)
        assert motion.planned_duration == pytest.approx(3 * 7 * 0.06 * each)


def test_the_dark_rate_alone_can_saturate_the_detector(plate: Survey) -> None:
    survey = plate.with_({"scan.columns": 3, "scan.rows": 2})
    detector = survey.instrument.detector
    most = detector.saturation / detector.volt_per_photoelectron_rate
    for share, expected in ((0.01, False), (1.001, True)):
        dark = survey.with_({"instrument.detector.dark_rate": share * most})
        found = simulate(dark, rng=1, model=ClosureModel())["saturated"]
        assert bool(found.all()) is expected
        assert bool(found.any()) is expected


def test_the_error_of_a_fit_is_that_of_its_residuals_and_of_a_higher_degree() -> None:
    rng = np.random.default_rng(8)
    basis = np.linalg.qr(rng.normal(size=(30, 5)))[0] * np.sqrt(30)
    fitted, beams = 3, list(range(0, 30, 2))
    ratio: Any = 0.1 * (rng.normal(size=(15, 2)) + 1j * rng.normal(size=(15, 2)))
    # The first ratio has a part of the next degree, the second has noise alone.
    ratio += 2 * basis[beams][:, :1]
    ratio[:, 0] += basis[beams] @ [0, 0, 0, 0.3, 0.2j]
    value, error = fitted_ratio(basis, fitted, beams, ratio)
    low, whole = basis[beams][:, :fitted], basis[beams]
    for k in range(2):
        data = ratio[:, k]
        small = np.linalg.lstsq(low, data, rcond=None)[0]
        large = np.linalg.lstsq(whole, data, rcond=None)[0]
        assert_allclose(value[k], basis[:, :fitted] @ small, rtol=1e-9)
        # Residuals of fits without each beam (HC3).
        normal = np.linalg.inv(low.T @ low)
        covariance = np.zeros((fitted, fitted))
        for row in range(15):
            others = np.arange(15) != row
            without = np.linalg.lstsq(low[others], data[others], rcond=None)[0]
            along = normal @ low[row]
            covariance += abs(data[row] - low[row] @ without) ** 2 * np.outer(
                along, along
            )
        plain = [f @ covariance @ f for f in basis[:, :fitted]]
        # What the next degree changes, beyond what noise of its size does.
        noise = float((abs(data - whole @ large) ** 2).sum()) / (15 - 5)
        change = np.concatenate([large[:fitted] - small, large[fitted:]])
        expected = np.trace(np.linalg.inv(whole.T @ whole)) - np.trace(normal)
        missing = max(float((abs(change) ** 2).sum()) - noise * expected, 0.0)
        assert (missing > 0.03) == (k == 0)
        assert_allclose(error[k] ** 2, np.array(plain) + missing, rtol=1e-9)
