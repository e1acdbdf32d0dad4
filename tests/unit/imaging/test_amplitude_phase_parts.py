"""Test of the phases against the amplitude, on a step of known size."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import norm

from amulor.cube import QualityFlag
from amulor.imaging.amplitude_phase import (
    AmplitudePhase,
    _pairs,
    _step,
    amplitude_phase,
)
from amulor.optics.ambiguity import Path

ROWS, COLUMNS = 8, 12
SHAPE = (ROWS, COLUMNS)
#: Path per phase of two frequencies, the second twice the first [m].
PER_PHASE = np.array([2.0, 1.0])
WEIGHT = np.array([0.2, 0.8])
SIGMA = 1e-3


def _observation(**changes: Any) -> SimpleNamespace:
    """Image with bright pixels in the right half."""
    amplitude = np.where(np.arange(COLUMNS) < COLUMNS // 2, 1.0, 3.0) * np.ones(SHAPE)
    values = {
        "frequency": np.array([30e6, 60e6]),
        "lag": None,
        "usable": np.ones(SHAPE, dtype=bool),
        "flag": np.zeros(SHAPE, dtype=np.int16),
        "signal": np.stack([amplitude, 0.5 * amplitude]).astype(complex),
        "path_per_phase": PER_PHASE[:, None, None],
        "own_sigma": np.full((2, *SHAPE), SIGMA),
        "shift": np.zeros((2, *SHAPE)),
        "shared_sigma": lambda _: None,
    }
    return SimpleNamespace(**{**values, **changes})


def _path(turn: np.ndarray) -> Path:
    """Path whose phases are turned by an angle, the same at both frequencies [rad]."""
    turned = PER_PHASE[:, None, None] * turn
    residual = turned - np.tensordot(WEIGHT, turned, 1)
    return Path(
        length=np.full(SHAPE, 4.0),
        uncertainty=np.full(SHAPE, 1e-3),
        weight=WEIGHT[:, None, None] * np.ones((2, *SHAPE)),
        settled=np.ones(SHAPE, dtype=bool),
        wrong=np.zeros(SHAPE),
        residual=residual,
        strain=np.zeros(SHAPE),
        left_out=np.zeros((2, *SHAPE), dtype=bool),
    )


def _turned(step: float) -> np.ndarray:
    """Angle of the pixels: noise, and a step with the amplitude [rad]."""
    noise = 0.01 * SIGMA * np.random.default_rng(2).standard_normal(SHAPE)
    return noise + np.where(np.arange(COLUMNS) < COLUMNS // 2, 0.0, step)


def _tested(turn: np.ndarray, **changes: Any) -> AmplitudePhase | None:
    return amplitude_phase(_observation(**changes), _path(turn), weight=WEIGHT)


def _error() -> float:
    """Standard error of the step: 8 pairs across, 124 others of equal variance."""
    # One angle at both frequencies leaves 1 - (0.4 + 0.8) / (2, 1) of the phases.
    size = (0.4**2 + 0.2**2) / (2 * SIGMA**2)
    return math.sqrt(2.5 / size * (1 / _ACROSS + 1 / (_ALL - _ACROSS)))


#: Neighbors with a pixel beyond both: along rows 9 of 12, along columns 5 of 8.
_ALL = ROWS * (COLUMNS - 3) + COLUMNS * (ROWS - 3)
#: Pairs whose pixels beyond lie on both sides of the edge.
_ACROSS = 3 * ROWS


def test_a_step_with_the_amplitude_has_its_size_and_significance() -> None:
    """Of three pairs in a row with the edge between, one has the step between it."""
    for step in (0.02, -0.02):
        tested = _tested(_turned(step))
        assert tested is not None
        assert tested.is_real
        # One of the three pairs is turned by the step.
        assert tested.step == pytest.approx(step / 3, rel=0.01)
    middle = _tested(_turned(0.012))
    assert middle is not None
    # Half of the levels are dark: the limits from the median on divide the pairs alike.
    expected = 5 * 2 * norm.sf(0.012 / 3 / _error())
    assert middle.probability == pytest.approx(expected, rel=0.05)
    weak = _tested(_turned(0.003))
    assert weak is not None
    assert weak.probability == 1.0


def test_darker_pixels_come_first_in_either_direction() -> None:
    turned = np.where(np.arange(COLUMNS) < COLUMNS // 2, 0.0, 0.02) * np.ones(SHAPE)
    right = _tested(turned)
    left = _tested(turned[:, ::-1], signal=_observation().signal[:, :, ::-1])
    assert right is not None
    assert left is not None
    assert left.step == pytest.approx(right.step, rel=1e-9)


def test_a_step_of_distance_is_no_step_of_phase() -> None:
    tested = _tested(np.zeros(SHAPE) + 1e-9 * _turned(1.0))
    assert tested is not None
    assert not tested.is_real
    assert tested.probability > 0.5


@pytest.mark.parametrize(
    "changes",
    [
        {"frequency": np.array([30e6])},
        {"lag": np.zeros(2)},
        {"usable": np.zeros(SHAPE, dtype=bool)},
        {"flag": np.full(SHAPE, QualityFlag.MIXED, dtype=np.int16)},
        {"own_sigma": np.full((2, *SHAPE), np.nan)},
    ],
    ids=["one frequency", "vehicle", "no pixel", "mixed", "no error"],
)
def test_some_scans_cannot_be_tested(changes: dict[str, Any]) -> None:
    assert _tested(_turned(0.02), **changes) is None


def test_other_flags_leave_a_pixel_in_the_test() -> None:
    flag = np.full(SHAPE, QualityFlag.NO_OPEN_WATER, dtype=np.int16)
    assert _tested(_turned(0.02), flag=flag) is not None


def test_discarded_readings_and_missing_paths_are_no_neighbors() -> None:
    path = _path(_turned(0.02))
    out = path.left_out.copy()
    out[1] = True
    assert (
        amplitude_phase(_observation(), replace(path, left_out=out), weight=WEIGHT)
        is None
    )
    missing = replace(path, length=np.full(SHAPE, np.nan))
    assert amplitude_phase(_observation(), missing, weight=WEIGHT) is None


@pytest.mark.parametrize(("rows", "testable"), [(3, False), (4, True)])
def test_an_image_of_four_rows_is_large_enough(rows: int, testable: bool) -> None:
    observation, path = _observation(), _path(_turned(0.02))
    cut = {
        name: values[..., :rows, :]
        for name, values in vars(observation).items()
        if getattr(values, "shape", ())[-2:] == SHAPE
    }
    part = replace(
        path,
        **{name: values[..., :rows, :] for name, values in vars(path).items()},
    )
    tested = amplitude_phase(_observation(**cut), part, weight=WEIGHT)
    assert (tested is not None) is testable


def test_shared_errors_and_residual_water_that_grow_with_darkness_excuse_a_step() -> (
    None
):
    dark = np.where(np.arange(COLUMNS) < COLUMNS // 2, 0.02, 0.0) * np.ones((2, *SHAPE))
    plain = _tested(_turned(0.02))
    assert plain is not None
    for changes in ({"shift": -dark}, {"shared_sigma": lambda _: dark}):
        excused = _tested(_turned(0.02), **changes)
        assert excused is not None
        assert excused.step == pytest.approx(plain.step)
        assert plain.probability < 1e-6 < 1e-4 < excused.probability
        assert not excused.is_real
    unknown = np.full((2, *SHAPE), np.nan)
    assert _tested(_turned(0.02), shift=unknown) is None


def test_scatter_beyond_the_stated_errors_widens_the_error() -> None:
    rng = np.random.default_rng(7)
    noise = 30 * SIGMA * rng.standard_normal(SHAPE)
    scattered = _tested(_turned(0.02) + noise)
    plain = _tested(_turned(0.02))
    assert plain is not None
    assert scattered is not None
    assert plain.probability < 1e-6
    assert scattered.probability > 0.01


def test_a_smooth_change_of_the_phase_is_no_scatter() -> None:
    ramp = 0.05 * np.arange(COLUMNS)
    changing = _tested(_turned(0.02) + ramp)
    assert changing is not None
    assert changing.probability < 1e-6


def test_a_real_step_is_an_attribute() -> None:
    real = AmplitudePhase(step=0.02, probability=0.99e-4)
    assert real.is_real
    assert real.attributes == {
        "amplitude_phase_probability": 0.99e-4,
        "amplitude_phase_rad": 0.02,
    }
    chance = AmplitudePhase(step=0.02, probability=1e-4)
    assert not chance.is_real
    assert chance.attributes == {"amplitude_phase_probability": 1e-4}


def test_pairs_have_the_pixels_beyond_both() -> None:
    valid = np.ones((4, 5), dtype=bool)
    valid[1, 4] = False
    inner, outer = _pairs(valid)
    rows = [(1, 2, 0, 3), (2, 3, 1, 4), (6, 7, 5, 8), (11, 12, 10, 13)]
    rows += [(12, 13, 11, 14), (16, 17, 15, 18), (17, 18, 16, 19)]
    columns = [(5 + k, 10 + k, k, 15 + k) for k in range(4)]
    expected = np.array(rows + columns).T
    assert_array_equal(inner, expected[:2])
    assert_array_equal(outer, expected[2:])


def test_the_step_is_a_difference_of_weighted_means() -> None:
    across = np.arange(24) < 10
    turn = np.where(across, 0.5, 0.1)
    turn[0], turn[10] = 0.7, 0.3
    error = np.full(24, 0.1)
    error[0], error[10] = 0.05, 0.05
    systematic = np.where(across, 0.03, 0.01)
    step, significance = _step(turn, error, systematic, across)
    # Weights of 100, and of 400 for the first of each side.
    left, right = (9 * 0.5 + 4 * 0.7) / 13, (13 * 0.1 + 4 * 0.3) / 17
    assert step == pytest.approx(left - right)
    error_of_step = math.sqrt(1 / 1300 + 1 / 1700 + 0.02**2)
    assert significance == pytest.approx((left - right) / error_of_step)


@pytest.mark.parametrize("count", [9, 10, 14, 15])
def test_a_side_needs_ten_pairs(count: int) -> None:
    across = np.arange(24) < count
    found = _step(np.ones(24), np.ones(24), np.zeros(24), across)
    assert (found is not None) is (10 <= count <= 14)
    if found is not None:
        assert_allclose(found, 0.0, atol=1e-12)
