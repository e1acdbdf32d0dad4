"""Cubes that methods return: variables, flags, causes and attributes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import QualityFlag, WaterResidualCause
from amulor.rejection import build, quality
from amulor.rejection.covariance import Covariance

Make = Callable[..., xr.Dataset]
SHAPE = (2, 2, 3, 4)


@pytest.fixture(scope="module")
def samples(by_hand: Make) -> xr.Dataset:
    return by_hand(
        frequency=[20e6, 50e6],
        channels={"VV": (1.0, 1.0), "VH": (0.3, 0.1)},
        shape=SHAPE[2:],
        shots=8,
    )


def errors_of(seed: int, size: float = 1e-3) -> Covariance:
    rng = np.random.default_rng(seed)
    variance = (size * rng.uniform(1, 2, (2, *SHAPE))) ** 2
    return Covariance(variance[0], variance[1], 0.3 * variance[0])


def signal_of(seed: int) -> Any:
    rng = np.random.default_rng(seed)
    return rng.standard_normal(SHAPE) + 1j * rng.standard_normal(SHAPE) + 3.0


def test_a_target_cube_holds_signal_errors_and_water(samples: xr.Dataset) -> None:
    signal, water, residual = signal_of(1), signal_of(2), 1e-5 * signal_of(3)
    total, common, counting = errors_of(4), errors_of(5, 1e-4), errors_of(6, 5e-4)
    cube = samples.copy(deep=True)
    cube["saturated"].values[0, 0, 0, 0] = 1
    signal[1, 1, 2, 3] = np.nan
    found = build.target_cube(
        cube,
        signal,
        total,
        water_signal=water,
        residual=residual,
        common=common,
        terms={"counting": counting},
        tests={"channel_disagreement": np.ones(SHAPE)},
        step="reject, by hand",
        target_ratio=0.25,
    )
    assert found.attrs["level"] == "target_signal"
    for name, expected in (
        ("in_phase", signal.real), ("quadrature", signal.imag),
        ("in_phase_uncertainty", np.sqrt(total.in_phase)),
        ("quadrature_uncertainty", np.sqrt(total.quadrature)),
        ("in_phase_quadrature_covariance", total.cross),
        ("water_in_phase", water.real), ("water_quadrature", water.imag),
        ("residual_in_phase", residual.real), ("residual_quadrature", residual.imag),
        ("common_in_phase_uncertainty", np.sqrt(common.in_phase)),
        ("common_quadrature_uncertainty", np.sqrt(common.quadrature)),
        ("common_covariance", common.cross),
    ):  # fmt: skip
        assert_allclose(found[name].values, expected, rtol=1e-6, err_msg=name)
    assert_array_equal(found["saturated"].values, cube["saturated"].values)
    flag = found["quality_flag"].values
    assert flag[0, 0, 0, 0] == QualityFlag.SATURATED
    assert flag[1, 1, 2, 3] == QualityFlag.MISSING
    assert (flag == 0).sum() == flag.size - 2
    assert_array_equal(found["water_residual_cause"].values, 0)
    # The imaginary part over the signal, for the errors of a phase.
    safe = np.where(np.isfinite(signal), signal, 1.0)
    side = safe / np.abs(safe) ** 2
    variance = (
        side.imag**2 * counting.in_phase
        + side.real**2 * counting.quadrature
        - 2 * side.real * side.imag * counting.cross
    )
    phase = found["phase_uncertainty_counting"].values
    finite = np.isfinite(signal)
    assert_allclose(phase[finite], np.sqrt(variance)[finite], rtol=1e-5)
    assert found["channel_disagreement"].dtype == np.float32
    assert found["signal_significance"].dtype == np.float32
    assert found.attrs["target_ratio"] == 0.25
    assert found.attrs["open_water_shots"] == 8
    assert "error_unknown" not in found.attrs
    assert "reject, by hand" in found.attrs["history"]
    assert found["geometry"].attrs["group_index"] == 1.38
    for name in ("azimuth", "elevation", "modulation_frequency", "polarization"):
        assert_array_equal(found[name].values, samples[name].values)


def test_a_target_cube_lacks_what_is_not_stated(samples: xr.Dataset) -> None:
    bare = samples.drop_vars(
        [n for n in samples.variables if "open_water" in str(n) or n == "saturated"]
    )
    found = build.target_cube(
        bare, signal_of(1), errors_of(2), water_signal=signal_of(3), step="x",
        water_is_in=True,
    )  # fmt: skip
    for name in found.data_vars:
        assert not str(name).startswith(("residual_", "common_", "phase_"))
    assert "saturated" not in found
    assert "open_water_shots" not in found.attrs
    assert_array_equal(found["quality_flag"].values, QualityFlag.NO_OPEN_WATER)
    assert "water" in found.attrs["error_unknown"]
    again = build.target_cube(
        samples, signal_of(1), errors_of(2), water_signal=signal_of(3), step="x",
        open_water_shots=np.int32(5),
    )  # fmt: skip
    assert again.attrs["open_water_shots"] == 5


def test_residual_water_flags_samples_that_it_turns_by_their_error(
    samples: xr.Dataset,
) -> None:
    signal = np.ones(SHAPE, dtype=complex)
    total = Covariance(*(np.full(SHAPE, v) for v in (1e-4, 1e-4, 0.0)))
    # An error of 0.01 rad; across the signal, along it, and below the error.
    residual = np.zeros(SHAPE, dtype=complex)
    residual[0, 0] = 0.0099j
    residual[0, 1] = 0.0102j
    residual[1, 0] = 0.05
    found = build.target_cube(
        samples, signal, total, water_signal=signal, residual=residual, step="x"
    )
    turned = found["water_residual_cause"].values
    assert_array_equal(turned[0, 1], WaterResidualCause.PHASE_SHIFT)
    turned[0, 1] = 0
    assert_array_equal(turned, 0)
    ratio = found["residual_phase_ratio"].values
    assert_allclose(ratio[0, 1], 1.02, rtol=1e-3)
    assert np.isnan(ratio[0, 0]).all()


def test_terms_are_those_above_zero_or_those_that_are_selected() -> None:
    none = Covariance(*(np.zeros(3) for _ in range(3)))
    first = Covariance(np.array([0, 0, 1.0]), np.zeros(3), np.zeros(3))
    second = Covariance(np.zeros(3), np.array([0, 1.0, 0]), np.zeros(3))
    terms = {"counting": none, "drift": first, "column": second}
    assert list(build.present_terms(terms)) == ["drift", "column"]
    found = build.present_terms(terms, ("counting", "column"))
    assert list(found) == ["counting", "column"]
    assert build.present_terms(terms, ()) == {}


def test_one_saturated_channel_spoils_the_result(samples: xr.Dataset) -> None:
    cube = samples.copy(deep=True)
    cube["saturated"].values[0, 1, 0, 1] = 2
    cube["saturated"].values[1, 0, 2, 2] = 1
    first = cube.sel(polarization=["VV"])
    found = build.saturated_in_any(first, cube)["saturated"].values
    assert found.shape == (2, 1, 3, 4)
    expected = np.zeros(found.shape, dtype=np.int8)
    expected[0, 0, 0, 1], expected[1, 0, 2, 2] = 2, 1
    assert_array_equal(found, expected)
    bare = cube.drop_vars("saturated")
    assert build.saturated_in_any(first, bare) is first


def test_flags_are_added_to_detected_samples_only(samples: xr.Dataset) -> None:
    found = build.target_cube(
        samples, np.ones(SHAPE, dtype=complex), errors_of(2),
        water_signal=signal_of(3), step="x",
    )  # fmt: skip
    flag = found["quality_flag"].values
    flag[0, 0] = QualityFlag.NO_TARGET
    flag[0, 1] = QualityFlag.MISSING
    flag[1, 0] = QualityFlag.SATURATED
    where = np.zeros(SHAPE, dtype=bool)
    where[..., 1:3] = True
    marked = quality.add(found, QualityFlag.OUTLIER, where)["quality_flag"].values
    expected = flag.copy()
    expected[1, 0, :, 1:3] = QualityFlag.SATURATED | QualityFlag.OUTLIER
    expected[1, 1, :, 1:3] = QualityFlag.OUTLIER
    assert_array_equal(marked, expected)
    assert marked.dtype == np.int16
    cause = np.where(where, WaterResidualCause.MODEL_MISFIT, 0).astype(np.int8)
    doubted = quality.add_water_residual(found, cause)
    causes = doubted["water_residual_cause"].values
    assert causes.dtype == np.int8
    expected = np.where(where, WaterResidualCause.MODEL_MISFIT, 0)
    expected[0] = 0
    assert_array_equal(causes, expected)
    expected = flag | np.where(expected, QualityFlag.WATER_RESIDUAL, 0)
    assert_array_equal(doubted["quality_flag"].values, expected)
    # The cube itself stays as it is.
    assert_array_equal(found["water_residual_cause"].values, 0)
