"""Cube of the joint estimation: both sides of limits, errors by closed forms."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from joint_states import shared_state
from numpy.testing import assert_allclose
from scipy.stats import chi2

from amulor.cube import QualityFlag, WaterResidualCause
from amulor.rejection.covariance import Covariance
from amulor.rejection.joint import cube as joint_cube
from amulor.rejection.joint.cube import Scan, cube_of, echo_departs, typical_of
from amulor.rejection.joint.overlap import Frame, frame_of
from amulor.rejection.joint.priors import Instrument, Shared, layout_of, range_variance
from amulor.rejection.joint.search import Estimates
from amulor.rejection.joint.solve import Result
from amulor.rejection.observation import Observation

EXACT = Instrument(
    delay=0.0, group_index=0.0, position=0.0, direction=0.0, late_echo=0.0
)
#: Widths of a right model, of an echo that departs, and of water that departs.
RIGHT = (1e-3, 1e-6, 1e-6, 1e-6, 1e-6)
ECHO = (1e-3, 1e-6, 0.01, 1e-6, 1e-6)
WATER = (0.1, 1e-6, 0.01, 1e-6, 1e-6)


@pytest.fixture(scope="module")
def observed(samples: xr.Dataset) -> tuple[Observation, Frame]:
    """Return a part of the samples, and the frame of the scan."""
    rows = Observation(cube=samples.isel(row=slice(0, 3), column=slice(0, 4)))
    frame = frame_of(rows, rows.azimuth.ravel(), rows.elevation.ravel())
    return rows, frame


def shared_of(**changed: Any) -> Shared:
    """Return shared parameters of one channel and six frequencies."""
    values: dict[str, Any] = {
        "shot_change": np.log(1.1),
        "fluctuation": 0.02,
        "covariance": np.diag(np.linspace(0.01, 0.3, 28) ** 2),
        "parametric": np.zeros((4, 4)),
        "widths": RIGHT,
        "misfit": 1.25,
    }
    return shared_state(1, 6, **values | changed)


def result_of(count: int = 12, **changed: Any) -> Result:
    """Return good pixels at one path, with errors that differ."""
    rng = np.random.default_rng(1)
    common = rng.uniform(1e-6, 4e-6, (2, count, 1, 6))
    estimates = Estimates(
        path=np.linspace(5.0, 6.0, count),
        amplitude=np.ones((count, 1)),
        cost=np.full(count, 10.0),
        empty_cost=np.full(count, 500.0),
        explained=np.full(count, 490.0),
        information=np.full(count, 1e6),
        lower=np.full(count, 1.1e-3),
        upper=np.full(count, 0.9e-3),
        wrong=np.zeros(count),
        outlying=np.zeros(count),
        next_outlying=np.zeros(count),
        used=np.full(count, 12),
        which=np.zeros(count, dtype=int),
        influence=np.zeros((0, 0, 0), dtype=complex),
        rate=np.zeros(count),
    )
    values: dict[str, Any] = {
        "estimates": estimates,
        "left_out": np.zeros((count, 1, 6), dtype=bool),
        "unsettled": np.zeros(count, dtype=bool),
        "near": np.full(count, np.nan),
        "far": np.full(count, np.nan),
        "enough": np.ones(count, dtype=bool),
        "detected": np.ones(count, dtype=bool),
        "depth": np.linspace(1.7, 2.0, count),
        "water_signal": 0.01 * rng.standard_normal((count, 1, 6)) + 0.02j,
        "common": Covariance(common[0], common[1], 0.2 * common[0]),
        "deviation": None,
        "shared_variance": np.full(count, 4e-6),
        "bound": np.full(count, 2e-6),
        "departure": np.zeros(count),
    }
    return Result(**values | changed)


def scan_of(frame: Frame, shared: Shared, **changed: Any) -> Scan:
    values: dict[str, Any] = {
        "frame": frame,
        "shared": shared,
        "instrument": EXACT,
        "span": 0.0,
        "late_spread": 0.01,
        "instrument_uncertainty": 3e-4,
        "echo_is_doubted": False,
    }
    return Scan(**values | changed)


Observed = tuple[Observation, Frame]


def flag_of(found: xr.Dataset) -> np.ndarray:
    """Return the flags that all samples of a pixel share, and those of any."""
    return found["quality_flag"].values[:, 0].reshape(6, -1)


def test_flags_have_their_limits(observed: Observed) -> None:
    rows, frame = observed
    result = result_of()
    estimates = result.estimates
    # A wrong interval with a chance of 3 in 10,000.
    estimates.wrong[:3] = 2.99e-4, 3.01e-4, 3.01e-4
    # Chi-square that chance makes in one of 10,000, with and without a target.
    detected = np.ones(12, dtype=bool)
    detected[2], detected[5], detected[6], detected[9] = False, False, False, False
    limits = chi2.isf(1e-4, [10, 10, 12, 12])
    estimates.cost[3:5] = np.array([0.999, 1.001]) * limits[:2]
    estimates.empty_cost[:] = 12.0
    estimates.empty_cost[5:7] = np.array([0.999, 1.001]) * limits[2:]
    near, far = np.full(12, np.nan), np.full(12, np.nan)
    near[7], far[7] = 5.2, 5.6
    estimates.cost[7] = 1e3
    enough = np.ones(12, dtype=bool)
    enough[8] = False
    unsettled = np.zeros(12, dtype=bool)
    unsettled[10] = True
    left_out = np.zeros((12, 1, 6), dtype=bool)
    left_out[11, 0, 2] = True
    result = replace(
        result, detected=detected, near=near, far=far, enough=enough,
        unsettled=unsettled, left_out=left_out,
    )  # fmt: skip
    found = cube_of(rows, scan_of(frame, shared_of()), result)
    flag = flag_of(found)
    ambiguous, none = int(QualityFlag.AMBIGUOUS), int(QualityFlag.NO_TARGET)
    residual = int(QualityFlag.WATER_RESIDUAL)
    mixed, outlier = int(QualityFlag.MIXED), int(QualityFlag.OUTLIER)
    expected = [0, ambiguous, none, 0, residual, none, none | residual]
    expected += [mixed, none, none, outlier]
    for n, value in enumerate(expected):
        assert (flag[:, n] == value).all(), n
    assert flag[:, 11].tolist() == [0, 0, int(QualityFlag.OUTLIER), 0, 0, 0]
    cause = found["water_residual_cause"].values[:, 0].reshape(6, -1)
    misfit = int(WaterResidualCause.MODEL_MISFIT)
    assert (cause == np.where(np.isin(np.arange(12), [4, 6]), misfit, 0)).all()
    # Two surfaces have their slant ranges.
    geometry = frame.geometry(rows.azimuth.ravel(), rows.elevation.ravel())
    for name, path in (("nearer", near), ("farther", far)):
        place = found[f"joint_{name}_surface"].values.ravel()
        assert_allclose(place, geometry.slant_range(path))
        assert np.isfinite(place).sum() == 1
    # Chi-square over its freedom, with its probability.
    freedom = np.where(detected, 10, 12)
    cost = np.where(detected, estimates.cost, estimates.empty_cost)
    assert_allclose(found["joint_misfit"].values.ravel(), cost / freedom)
    chance = found["joint_misfit_probability"].values.ravel()
    assert_allclose(chance, chi2.sf(cost, freedom), rtol=1e-9)
    assert_allclose(found["joint_detection"].values.ravel(), 490.0)


def test_pixels_without_freedom_are_not_contradicted(observed: Observed) -> None:
    rows, frame = observed
    result = result_of()
    result.estimates.used[:3] = 2, 3, 0
    result.estimates.cost[:3] = 50.0
    found = cube_of(rows, scan_of(frame, shared_of()), result)
    chance = found["joint_misfit_probability"].values.ravel()
    assert chance[[0, 2]].tolist() == [1, 1]
    assert chance[1] == pytest.approx(chi2.sf(50.0, 1))
    assert_allclose(found["joint_misfit"].values.ravel()[:3], 50.0)


def test_ranges_have_all_errors_together(observed: Observed) -> None:
    rows, frame = observed
    instrument = replace(EXACT, delay=1e-11, late_echo=0.5)
    result = result_of()
    result.detected[4] = False
    found = cube_of(rows, scan_of(frame, shared_of(), instrument=instrument), result)
    geometry = frame.geometry(rows.azimuth.ravel(), rows.elevation.ravel())
    path = result.estimates.path
    step = 1e-5
    place = geometry.slant_range(path)
    slope = (geometry.slant_range(path + step) - place) / step
    # The late echo, a quarter of the spread times the squared depth.
    late = 0.5 * 0.25 * 0.01 * result.depth**2
    own = range_variance(instrument, path, geometry) + late**2
    common = np.sqrt(slope**2 * 4e-6 + own)
    expected = {
        "slant_range": place,
        "slant_range_common_uncertainty": common,
        "slant_range_uncertainty": np.hypot(slope * 1e-3, common),
        "slant_range_bound": slope * np.sqrt(2e-6),
        "slant_range_lower": place - np.hypot(slope * 1.1e-3, common),
        "slant_range_upper": place + np.hypot(slope * 0.9e-3, common),
        "wrong_interval_probability": np.zeros(12),
    }
    for name, values in expected.items():
        given = found[f"joint_{name}"].values.ravel()
        assert np.isnan(given[4])
        assert_allclose(np.delete(given, 4), np.delete(values, 4), rtol=1e-5)
    assert found.attrs["joint_instrument_uncertainty_m"] == 3e-4
    assert found.attrs["joint_late_echo_spread_rad2_per_m"] == 0.01


def test_errors_of_samples_add_up(observed: Observed) -> None:
    rows, frame = observed
    rng = np.random.default_rng(2)
    parts = 1e-3 * rng.standard_normal((2, 12, 1, 6))
    result = result_of(deviation=parts[0] + 1j * parts[1])
    found = cube_of(rows, scan_of(frame, shared_of(noise_scale=1.5)), result)

    def over_samples(values: np.ndarray) -> Any:
        return values.transpose(2, 1, 0).reshape(6, 1, 3, 4)

    stated = rows.covariance
    common = result.common
    xx = 2.25 * stated.in_phase + over_samples(common.in_phase + parts[0] ** 2)
    yy = 2.25 * stated.quadrature + over_samples(common.quadrature + parts[1] ** 2)
    xy = 2.25 * stated.cross + over_samples(common.cross + parts[0] * parts[1])
    assert_allclose(found["in_phase_uncertainty"].values ** 2, xx, rtol=1e-6)
    assert_allclose(found["quadrature_uncertainty"].values ** 2, yy, rtol=1e-6)
    assert_allclose(found["in_phase_quadrature_covariance"].values, xy, atol=1e-12)
    water = over_samples(result.water_signal)
    assert_allclose(found.amulor.signal.values, rows.signal - water, rtol=1e-6)
    shared = found["common_in_phase_uncertainty"].values ** 2
    assert_allclose(shared, over_samples(result.common.in_phase), rtol=1e-6)


@pytest.mark.parametrize(
    ("widths", "doubted", "evidence", "limit"),
    [
        # Water that departs by ten times the other uncertainty; an echo by 0.3 of it.
        (WATER, False, 10.1, 10.0),
        (WATER, True, 10.1, 0.3),
        (ECHO, False, 10.1, 0.3),
        (WATER, False, 9.9, np.inf),
    ],
)
def test_departures_matter_beyond_their_limit(
    observed: Observed, widths: Any, doubted: bool, evidence: float, limit: float
) -> None:
    rows, frame = observed
    # Of a path with 1 mm of noise and 2 mm of shared errors.
    sigma = np.sqrt(1e-6 + 4e-6)
    shift = np.full(12, min(limit, 20.0) * sigma)
    shift[0] *= 0.999
    shift[1] *= 1.001
    result = result_of(departure=shift)
    shared = shared_of(widths=widths, evidence=evidence)
    found = cube_of(rows, scan_of(frame, shared, echo_is_doubted=doubted), result)
    cause = found["water_residual_cause"].values[0, 0].ravel()
    departs = int(WaterResidualCause.MODEL_DEPARTURE)
    assert cause[0] == 0
    assert cause[1] == (departs if np.isfinite(limit) else 0)
    ratio = (found["joint_departure"] / found["joint_departure_limit"]).values.ravel()
    if np.isfinite(limit):
        assert_allclose(ratio[:2], [0.999, 1.001], rtol=1e-6)
    else:
        assert_allclose(ratio, 0)


@pytest.mark.parametrize(
    ("share", "changed", "departs"),
    [
        (7, {}, True),
        (6, {}, False),
        (12, {"evidence": 9.99}, False),
        (12, {"widths": WATER}, False),
        (12, {"widths": RIGHT}, False),
    ],
)
def test_an_echo_departs_where_most_pixels_would_be_flagged(
    observed: Observed, share: int, changed: dict[str, Any], departs: bool
) -> None:
    rows, frame = observed
    geometry = frame.geometry(rows.azimuth.ravel(), rows.elevation.ravel())
    limit = 0.3 * np.sqrt(5e-6)
    shift = np.where(np.arange(12) < share, 1.01, 0.99) * limit
    shared = shared_of(**{"widths": ECHO, "evidence": 10.01} | changed)
    result = result_of(departure=shift)
    assert echo_departs(geometry, result, shared, EXACT) == departs
    nothing = replace(result, detected=np.zeros(12, dtype=bool))
    assert not echo_departs(geometry, nothing, shared, EXACT)
    # Only the pixels with a target count.
    few = replace(result, detected=np.arange(12) >= 5)
    assert echo_departs(geometry, few, shared, EXACT) == (share == 12 and departs)


def test_a_scan_has_the_median_of_its_instrument_errors(observed: Observed) -> None:
    rows, frame = observed
    geometry = frame.geometry(rows.azimuth.ravel(), rows.elevation.ravel())
    result = result_of()
    result.detected[:3] = False
    asked: list[Any] = []

    def late_spread(depth: float, spread: float, error: float) -> float:
        asked.append((depth, spread, error))
        return 0.03

    given: Any = SimpleNamespace(late_spread=late_spread)
    covariance = np.zeros((28, 28))
    covariance[2, 2] = 0.2**2
    shared = shared_of(covariance=covariance)
    instrument = replace(EXACT, delay=1e-11, late_echo=0.5)
    spread, error = typical_of(given, geometry, result, shared, instrument)
    assert spread == 0.03
    # At the median depth, with the error of the logarithm of the spread.
    assert asked == [(pytest.approx(np.median(result.depth[3:])), 0.05,
                      pytest.approx(0.2))]  # fmt: skip
    late = 0.5 * 0.25 * 0.03 * result.depth**2
    own = range_variance(instrument, result.estimates.path, geometry) + late**2
    assert error == pytest.approx(np.sqrt(np.median(own[3:])))
    # Without an uncertainty the spread is that of the fit; without targets, nothing.
    assert typical_of(given, geometry, result, shared, EXACT) == (0.05, 0.0)
    none = replace(result, detected=np.zeros(12, dtype=bool))
    assert typical_of(given, geometry, none, shared, instrument) == (0.03, 0.0)
    assert asked[-1][0] == 0.0


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_a_departure_of_the_echo_can_hide_an_interval(factor: float) -> None:
    # Of 60 and 62 MHz, 30 periods of the difference repeat; one is nearly one turn.
    rate = 2 * np.pi * np.array([60e6, 62e6]) / 299792458.0
    period = 2 * np.pi / rate.max()
    shift = period * np.arange(0.5, 5.0, 1 / 48)
    apart = np.min(np.sum(np.abs(np.exp(1j * np.outer(shift, rate)) - 1) ** 2, axis=1))
    width = factor * np.sqrt(apart / (-2 * np.log(3e-4)))
    widths: Any = (*RIGHT[:2], width, *RIGHT[3:])

    def alike(span: float, evidence: float = 10.1) -> bool:
        shared = shared_of(widths=widths, evidence=evidence)
        return joint_cube._intervals_look_alike(shared, rate, span)

    assert alike(4 * period) == (factor > 1)
    assert not alike(4 * period, evidence=9.9)
    assert not alike(0.0)


def test_a_short_interval_is_compared_over_two_periods() -> None:
    # The second interval looks like the first, within a width of 0.7 for each part.
    rate = np.array([1.0, 0.5])
    turn = 2 * np.pi
    shifts = turn * np.arange(0.5, 2.0, 1 / 48)
    least = np.min(np.sum(np.abs(np.exp(1j * np.outer(shifts, rate)) - 1) ** 2, axis=1))
    width = 1.05 * np.sqrt(least / (-2 * np.log(3e-4)))
    widths: Any = (*RIGHT[:2], width, *RIGHT[3:])
    shared = shared_of(widths=widths, evidence=11.0)
    assert joint_cube._intervals_look_alike(shared, rate, 1e-3)


def test_the_attributes_state_all_shared_parameters(observed: Observed) -> None:
    rows, frame = observed
    trend = np.array([0.02, 0.0, 0.01])
    covariance = np.diag(np.linspace(0.01, 0.3, 31) ** 2)
    shared = shared_of(
        trend=trend, covariance=covariance, widths=(*RIGHT[:4], 0.01), noise_scale=1.2
    )
    assert layout_of(shared).trend == slice(4, 7)
    instrument = Instrument(
        delay=1e-12, group_index=1e-4, position=2e-3, direction=0.02, late_echo=0.4
    )
    found = cube_of(rows, scan_of(frame, shared, instrument=instrument), result_of())
    error = np.linspace(0.01, 0.3, 31)
    expected = {
        "water_strength_volt": [0.5],
        "water_strength_uncertainty_volt": [error[0]],
        "reduced_attenuation_per_m": 0.3,
        "reduced_attenuation_uncertainty_per_m": 0.3 * error[1],
        "spread_rad2_per_m": 0.05,
        "spread_uncertainty_rad2_per_m": 0.05 * error[2],
        "forward_scattering_per_m": 0.7,
        "forward_scattering_uncertainty_per_m": 0.7 * error[3],
        "fluctuation": 0.02,
        "shot_strength": 1.1,
        "noise_scale": 1.2,
        # The odd polynomials of -1 and 1, twice the sum of their coefficients.
        "water_drift": 2 * (0.02 + 0.01),
        "water_drift_uncertainty": 2 * np.hypot(error[4], error[6]),
        "late_echo_uncertainty": 0.4,
        "delay_uncertainty_s": 1e-12,
        "group_index_uncertainty": 1e-4,
        "receiver_position_uncertainty_m": 2e-3,
        "receiver_direction_uncertainty_rad": 0.02,
        "departure_widths": [*RIGHT[:4], 0.01],
        "departure_evidence": 0.0,
        "misfit": 1.25,
    }
    for name, value in expected.items():
        assert_allclose(found.attrs[f"joint_{name}"], value, rtol=1e-9, err_msg=name)
    assert found.attrs["joint_receiver_turn_rad"].shape == (0,)
