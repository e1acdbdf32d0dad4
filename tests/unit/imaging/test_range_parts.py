"""Slant ranges of a channel and their error terms, against sums on paper."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light
from scipy.stats import chi2

from amulor.cube import QualityFlag
from amulor.imaging import ranges
from amulor.imaging.ranges import RangesFit, ranges_of_joint, ranges_of_path, weight_of
from amulor.optics import rays
from amulor.optics._geometry import Geometry
from amulor.optics.ambiguity import Path

FREQUENCY = np.array([30e6, 80e6])
PER_PHASE = speed_of_light / (2 * np.pi * FREQUENCY)
#: Range per path in water of the group index 1.38.
SLOPE = 1 / 2.76
SHAPE = (1, 4)


def _full(*values: float) -> np.ndarray:
    """One number for all pixels of each frequency."""
    return np.array(values)[:, None, None] * np.ones(SHAPE)


def _path(**changes: Any) -> Path:
    values = {
        "length": np.array([[4.0, 5.0, 6.0, 7.0]]),
        "uncertainty": np.full(SHAPE, 0.02),
        "weight": _full(0.3, 0.7),
        "settled": np.array([[True, True, False, True]]),
        "wrong": np.array([[1e-6, 1e-5, 1e-3, 1e-7]]),
        "residual": np.zeros((2, *SHAPE)),
        "strain": np.array([[1.0, 2.0, 3.0, 4.0]]),
        "left_out": np.zeros((2, *SHAPE), dtype=bool),
    }
    return Path(**{**values, **changes})


def _observation(
    channel: xr.Dataset | None = None,
    *,
    shared: np.ndarray | None = None,
    lag: np.ndarray | None = None,
    flag: np.ndarray | None = None,
    frequency: np.ndarray = FREQUENCY,
) -> SimpleNamespace:
    """Channel of one row of four pixels, the last of which has no target."""
    if flag is None:
        flag = np.array([[0, 0, 0, QualityFlag.NO_TARGET]], dtype=np.int16)
    geometry = Geometry(
        azimuth=np.zeros(SHAPE),
        elevation=np.zeros(SHAPE),
        emitter=np.zeros((*SHAPE, 3)),
        receiver=np.zeros((*SHAPE, 3)),
        medium=rays.Medium(refractive_index=1.34, group_index=1.38),
    )
    return SimpleNamespace(
        channel=xr.Dataset() if channel is None else channel,
        frequency=frequency,
        geometry=geometry,
        flag=flag,
        usable=flag == 0,
        path_per_phase=(speed_of_light / (2 * np.pi * frequency))[:, None, None],
        shared_sigma=lambda _: shared,
        sigma=_full(*[0.01, 0.02][: len(frequency)]),
        shift=_full(*[0.1, -0.3][: len(frequency)]),
        lag=lag,
    )


def test_ranges_are_paths_over_twice_the_index_with_their_errors() -> None:
    result, fit = ranges_of_path(_observation(), _path())
    assert_allclose(result.slant_range, np.array([[4.0, 5.0, 6.0, 7.0]]) * SLOPE)
    assert_allclose(result.slope, SLOPE, rtol=1e-6)
    assert_allclose(result.total, 0.02 * SLOPE, rtol=1e-6)
    assert_array_equal(result.path, [[4.0, 5.0, 6.0, 7.0]])
    assert_array_equal(
        result.flag, [[0, 0, QualityFlag.AMBIGUOUS, QualityFlag.NO_TARGET]]
    )
    assert_array_equal(result.usable, [[True, True, False, False]])
    assert result.common is None
    assert result.terms.keys() == {"signal"}
    assert_allclose(result.terms["signal"], result.total)
    assert not fit.has_rest
    assert_array_equal(result.others["slant_range_wrong_interval"], _path().wrong)
    assert "slant_range_bias" not in result.others
    assert result.tests.keys() == {
        "ambiguous_interval_probability",
        "ambiguous_misfit_probability",
    }


def test_a_path_that_is_impossible_is_ambiguous() -> None:
    path = _path(length=np.array([[4.0, np.nan, 6.0, 7.0]]))
    result, _ = ranges_of_path(_observation(), path)
    assert result.flag[0, 1] == QualityFlag.AMBIGUOUS


def test_shared_errors_of_all_frequencies_add_with_their_signs() -> None:
    shared = _full(0.01, 0.03)
    parts = np.array([0.3, 0.7]) * PER_PHASE * np.array([0.01, 0.03])
    apart, together = np.sum(parts**2), np.sum(parts) ** 2
    for stated, size in (({}, together), ({"frequencies_share_errors": 0}, apart)):
        channel = xr.Dataset(attrs=stated)
        path = _path(uncertainty=np.full(SHAPE, 0.2))
        result, _ = ranges_of_path(_observation(channel, shared=shared), path)
        assert result.common is not None
        assert result.common.shape == result.total.shape == SHAPE
        assert_allclose(result.common, SLOPE * np.sqrt(size), rtol=1e-6)
        total = SLOPE * np.sqrt(0.04 - apart + size)
        assert_allclose(result.total, total, rtol=1e-6)


def test_the_bias_by_residual_water_adds_over_the_frequencies() -> None:
    channel = xr.Dataset({"residual_in_phase": 0.0})
    result, _ = ranges_of_path(_observation(channel), _path())
    bias = SLOPE * np.sum(np.array([0.3, 0.7]) * PER_PHASE * np.array([0.1, -0.3]))
    assert_allclose(result.others["slant_range_bias"], bias, rtol=1e-6)


def test_one_frequency_has_no_test_of_its_interval() -> None:
    one = _observation(frequency=FREQUENCY[:1])
    path = _path(
        weight=_full(1.0),
        residual=np.zeros((1, *SHAPE)),
        left_out=np.zeros((1, *SHAPE), dtype=bool),
    )
    result, fit = ranges_of_path(one, path)
    assert result.others == {}
    assert result.tests == {}
    assert_array_equal(fit.weight, [1.0])


def test_ambiguous_pixels_state_their_interval_and_misfit() -> None:
    left_out = np.zeros((2, *SHAPE), dtype=bool)
    left_out[1, 0, 1] = True
    path = _path(settled=np.zeros(SHAPE, dtype=bool), left_out=left_out)
    result, _ = ranges_of_path(_observation(), path)
    interval = result.tests["ambiguous_interval_probability"]
    assert_array_equal(interval, [[1e-6, 1e-5, 1e-3, np.nan]])
    misfit = result.tests["ambiguous_misfit_probability"]
    assert_allclose(misfit, [[chi2.sf(1.0, 1), np.nan, chi2.sf(3.0, 1), np.nan]])


def test_readings_of_a_vehicle_that_contradict_each_other_have_moved() -> None:
    left_out = np.zeros((2, *SHAPE), dtype=bool)
    left_out[1, 0, 1] = True
    # Of one degree of freedom, 15.137 has the probability of 1e-4.
    path = _path(strain=np.array([[15.13, 40.0, 15.14, 99.0]]), left_out=left_out)
    result, _ = ranges_of_path(_observation(lag=np.zeros(1)), path)
    moved = (result.flag & QualityFlag.MOVED) != 0
    assert_array_equal(moved, [[False, True, True, False]])
    probability = result.tests["moved_probability"]
    assert_allclose(probability, [[np.nan, 1e-4, chi2.sf(15.14, 1), np.nan]])
    still, _ = ranges_of_path(_observation(), path)
    assert not (still.flag & QualityFlag.MOVED).any()
    assert "moved_probability" not in still.tests


def test_terms_of_phases_are_scaled_to_the_total() -> None:
    channel = xr.Dataset(
        {
            "phase_uncertainty_counting": ("f", np.array([0.01, 0.02])),
            "phase_uncertainty_fluctuation": ("f", np.array([0.02, 0.01])),
        }
    )
    channel = channel.map(lambda values: values * xr.DataArray(np.ones(SHAPE)))
    per_phase = _full(0.6, 0.4)
    terms, rest = ranges._terms(channel, per_phase, np.full(SHAPE, 0.05), None)
    first, second = 0.006**2 + 0.008**2, 0.012**2 + 0.004**2
    whole = first + second
    assert list(terms) == ["counting", "fluctuation"]
    assert_allclose(terms["counting"], 0.05 * np.sqrt(first / whole))
    assert_allclose(terms["fluctuation"], 0.05 * np.sqrt(second / whole))
    assert_array_equal(rest, np.zeros(SHAPE))


def test_shared_terms_divide_the_common_part() -> None:
    values = {"counting": 0.01, "reference": 0.02, "drift": 0.04}
    channel = xr.Dataset(
        {
            f"phase_uncertainty_{name}": (("f", "row", "column"), _full(size))
            for name, size in values.items()
        }
    )
    total, together = np.full(SHAPE, 0.05), np.full(SHAPE, 0.03**2)
    together[0, 1] = 0.06**2
    terms, rest = ranges._terms(channel, _full(1.0), total, together)
    assert list(terms) == ["counting", "reference", "drift"]
    assert_allclose(terms["counting"], [[0.04, 0.0, 0.04, 0.04]], atol=1e-15)
    shared = np.array([[0.03, 0.06, 0.03, 0.03]])
    assert_allclose(terms["reference"], shared / 5**0.5)
    assert_allclose(terms["drift"], 2 * shared / 5**0.5)
    assert_array_equal(rest, np.zeros(SHAPE))


def test_variance_without_a_term_is_that_of_the_signal() -> None:
    channel = xr.Dataset(
        {"phase_uncertainty_reference": (("f", "row", "column"), _full(0.01, 0.01))}
    )
    shared = _full(0.01, 0.03)
    observation = _observation(channel, shared=shared)
    path = _path(uncertainty=np.full(SHAPE, 0.2))
    result, fit = ranges_of_path(observation, path)
    assert fit.has_rest
    assert result.common is not None
    assert list(result.terms) == ["reference", "signal"]
    assert_allclose(result.terms["reference"], result.common, rtol=1e-6)
    rest = np.sqrt(result.total**2 - result.common**2)
    assert_allclose(result.terms["signal"], rest, rtol=1e-6)
    # A part of a scan follows the scan: no such term if the scan has none.
    none = RangesFit(weight=np.array([0.5, 0.5]), has_rest=False)
    part, same = ranges_of_path(observation, path, fit=none)
    assert same is none
    assert list(part.terms) == ["reference"]
    assert_array_equal(part.weight, [0.5, 0.5])
    counted = xr.Dataset(
        {"phase_uncertainty_counting": (("f", "row", "column"), _full(0.0, 0.0))}
    )
    _, rest_of_zero = ranges._terms(
        counted, _full(1.0, 1.0), np.full(SHAPE, 0.05), None
    )
    assert_allclose(rest_of_zero, 0.05**2)


def test_weights_are_those_of_a_typical_pixel() -> None:
    sigma = np.array([[[0.01, 0.02, 0.03, 9.0]], [[0.04, 0.08, 0.06, 9.0]]])
    usable = np.array([[True, True, True, False]])
    precision = np.array([(30 / 0.02) ** 2, (80 / 0.06) ** 2])
    weight = weight_of(FREQUENCY, sigma, usable)
    assert_allclose(weight, precision / precision.sum())
    nothing = weight_of(FREQUENCY, sigma, np.zeros(SHAPE, dtype=bool))
    assert_array_equal(nothing, [0.5, 0.5])
    exact = weight_of(FREQUENCY, np.zeros((2, *SHAPE)), usable)
    assert_allclose(exact, np.array([9, 64]) / 73)


def _joint(**changes: Any) -> xr.Dataset:
    """Results of a joint estimation in four pixels."""
    values = {
        "slant_range": [1.5, np.nan, 2.0, 1.0],
        "slant_range_uncertainty": [0.05, 0.05, 0.05, np.nan],
        "slant_range_common_uncertainty": [0.03, 0.03, 0.06, 0.03],
        "slant_range_bound": [0.01, 0.02, 0.03, 0.04],
        "wrong_interval_probability": [1e-9, 0.5, 1e-6, 0.3],
        "misfit_probability": [0.9, 0.2, 1e-6, 0.5],
    }
    return xr.Dataset(
        {
            f"joint_{name}": (("row", "column"), np.array([numbers]))
            for name, numbers in {**values, **changes}.items()
        }
    )


def test_joint_ranges_are_divided_into_noise_and_water() -> None:
    good = np.zeros(SHAPE, dtype=np.int16)
    result, fit = ranges_of_joint(_observation(_joint(), flag=good), interval=None)
    ambiguous = QualityFlag.AMBIGUOUS
    assert_array_equal(result.flag, [[0, ambiguous, 0, ambiguous]])
    assert_array_equal(result.slant_range, [[1.5, np.nan, 2.0, 1.0]])
    assert_allclose(result.path[0, [0, 2]], [1.5 * 2.76, 2.0 * 2.76])
    assert_allclose(result.path[0, 1], 2.76)
    assert_allclose(result.slope, SLOPE, rtol=1e-6)
    assert list(result.terms) == ["signal", "water_model"]
    assert_allclose(result.terms["signal"], [[0.04, 0.04, 0.0, np.nan]])
    assert_array_equal(result.terms["water_model"], [[0.03, 0.03, 0.06, 0.03]])
    assert_array_equal(result.common, [[0.03, 0.03, 0.06, 0.03]])
    assert_array_equal(result.total, [[0.05, 0.05, 0.05, np.nan]])
    bound = result.others["slant_range_bound"]
    assert_array_equal(bound, [[0.01, 0.02, 0.03, 0.04]])
    wrong = result.others["slant_range_wrong_interval"]
    assert_array_equal(wrong, [[1e-9, 0.5, 1e-6, 0.3]])
    assert_array_equal(
        result.tests["ambiguous_interval_probability"], [[np.nan, 0.5, np.nan, 0.3]]
    )
    assert "moved_probability" not in result.tests
    precision = np.array([(30 / 0.01) ** 2, (80 / 0.02) ** 2])
    assert_allclose(fit.weight, precision / precision.sum())
    assert not fit.has_rest
    given = RangesFit(weight=np.array([0.9, 0.1]))
    again, same = ranges_of_joint(_observation(_joint()), interval=None, fit=given)
    assert same is given
    assert_array_equal(again.weight, [0.9, 0.1])


@pytest.mark.parametrize(
    ("interval", "valid"),
    [
        ((1.59, 2.5), [True, False, True, False]),
        ((1.61, 2.5), [False, False, True, False]),
        ((0.5, 1.91), [True, False, True, False]),
        ((0.5, 1.89), [True, False, False, False]),
    ],
)
def test_joint_ranges_may_leave_the_interval_by_two_errors(
    interval: tuple[float, float], valid: list[bool]
) -> None:
    good = np.zeros(SHAPE, dtype=np.int16)
    result, _ = ranges_of_joint(_observation(_joint(), flag=good), interval=interval)
    assert_array_equal(result.usable, [valid])


def test_joint_readings_that_moved_state_their_misfit() -> None:
    moved = np.array([[QualityFlag.MOVED, 0, QualityFlag.MOVED, 0]], dtype=np.int16)
    observation = _observation(_joint(), flag=moved, lag=np.zeros(1))
    result, _ = ranges_of_joint(observation, interval=None)
    # Outlying readings are at most that probable.
    assert_allclose(result.tests["moved_probability"], [[1e-4, np.nan, 1e-6, np.nan]])
