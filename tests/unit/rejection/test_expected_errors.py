"""Expected range errors of phases, by weighted means written out."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from amulor import cube as cubes
from amulor.rejection import expected_errors
from amulor.rejection.expected_errors import Errors, errors_of

FREQUENCY = np.array([20e6, 50e6, 90e6])
PER_RANGE = 4 * np.pi * 1.38 * FREQUENCY / 299792458.0
#: Slant ranges of the pixels [m].
RANGE = np.array([[1.0, 1.5, 2.0], [2.5, 3.0, 3.5]])
#: Phase errors by frequency [rad].
ERROR = np.array([2e-3, 3e-3, 5e-3])
SHAPE = (3, 1, 2, 3)


def target(
    *,
    phase: Any = 0.0,
    residual: np.ndarray | None = None,
    common: Any = None,
    survey: Any = None,
) -> xr.Dataset:
    """Return a target signal of strength 0.5 V with phase errors of `ERROR`."""
    size = 0.5
    turn = PER_RANGE[:, None, None] * RANGE + phase
    signal = (size * np.exp(1j * turn))[:, None]
    error = np.broadcast_to(size * ERROR[:, None, None, None], SHAPE)
    variables: dict[str, Any] = {
        "in_phase": signal.real,
        "quadrature": signal.imag,
        "in_phase_uncertainty": error,
        "quadrature_uncertainty": error,
        "in_phase_quadrature_covariance": np.zeros(SHAPE),
        "water_in_phase": np.zeros(SHAPE),
        "water_quadrature": np.zeros(SHAPE),
        "quality_flag": np.zeros(SHAPE, np.int16),
    }
    if residual is not None:
        left = np.broadcast_to(residual, SHAPE)
        variables |= {"residual_in_phase": left.real, "residual_quadrature": left.imag}
    if common is not None:
        shared = np.broadcast_to(size * np.reshape(common, (3, 1, 1, 1)), SHAPE)
        variables |= {
            "common_in_phase_uncertainty": shared,
            "common_quadrature_uncertainty": shared,
            "common_covariance": np.zeros(SHAPE),
        }
    return cubes.build(
        "target_signal",
        variables,
        {
            "modulation_frequency": FREQUENCY,
            "polarization": ["none"],
            "azimuth": np.zeros((2, 3)),
            "elevation": np.zeros((2, 3)),
        },
        geometry={
            "group_index": 1.38,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("target_signal", title="x", source="by hand"),
    )


USABLE = np.array([[True, True, False], [True, True, True]])


def errors(cube: xr.Dataset, excluded: np.ndarray | None = None) -> Errors:
    left_out = np.zeros((3, 2, 3), bool) if excluded is None else excluded
    return errors_of(cube, USABLE, left_out, interval=None)


SIGMA = ERROR / PER_RANGE
WEIGHT = SIGMA**-2 / np.sum(SIGMA**-2)


def test_noise_is_that_of_the_weighted_mean_of_the_frequencies() -> None:
    found = errors(target())
    expected = np.sum(SIGMA**-2) ** -0.5
    assert_allclose(found.noise, np.full(5, expected), rtol=1e-6)
    # Nothing is shared, so that all of it is a pixel's own.
    assert_allclose(found.own_noise, found.noise)
    assert_array_equal(found.bias, 0.0)
    assert_array_equal(found.agree, True)
    assert_array_equal(found.mixed, False)
    assert_array_equal(found.in_corner, False)
    assert not found.corner_light
    assert_allclose(found.path, 2 * 1.38 * RANGE[USABLE], rtol=1e-4)


def test_an_excluded_sample_does_not_count() -> None:
    excluded = np.zeros((3, 2, 3), bool)
    excluded[2, 0, 1] = True
    found = errors(target(), excluded)
    two = np.sum(SIGMA[:2] ** -2) ** -0.5
    three = np.sum(SIGMA**-2) ** -0.5
    assert_allclose(found.noise, [three, two, three, three, three], rtol=1e-6)
    assert_allclose(found.own_noise, found.noise)


def test_errors_that_pixels_share_are_not_their_own_noise() -> None:
    found = errors(target(common=[1e-3, 2e-3, 4e-3]))
    own = (ERROR**2 - np.array([1e-3, 2e-3, 4e-3]) ** 2) / PER_RANGE**2
    expected = np.sqrt(np.sum(WEIGHT**2 * own))
    assert_allclose(found.own_noise, np.full(5, expected), rtol=1e-5)
    assert_allclose(found.noise, np.sum(SIGMA**-2) ** -0.5, rtol=1e-6)
    # A shared error cannot exceed the whole; of the others the rest is left.
    found = errors(target(common=[9e-3, 2e-3, 4e-3]))
    expected = np.sqrt(np.sum((WEIGHT**2 * own)[1:]))
    assert_allclose(found.own_noise, np.full(5, expected), rtol=1e-5)
    excluded = np.zeros((3, 2, 3), bool)
    excluded[1] = True
    found = errors(target(common=[1e-3, 2e-3, 4e-3]), excluded)
    part = WEIGHT[[0, 2]] / WEIGHT[[0, 2]].sum()
    expected = np.sqrt(np.sum(part**2 * own[[0, 2]]))
    assert_allclose(found.own_noise, np.full(5, expected), rtol=1e-5)


def test_residual_water_biases_the_range_by_its_phase_shifts() -> None:
    left: Any = np.array([0.01, 0.02j, -0.01 + 0.005j]).reshape(3, 1, 1, 1)
    found = errors(target(residual=left))
    signal = target().amulor.signal.values[:, 0]
    # To first order, as tests of ranging show it.
    shift = np.imag(left[:, 0] / signal)
    expected = np.sum(WEIGHT[:, None, None] * shift / PER_RANGE[:, None, None], axis=0)
    assert_allclose(np.abs(found.bias), np.abs(expected[USABLE]), rtol=0.05, atol=2e-6)
    none = errors(target(residual=np.zeros((1, 1, 1, 1), complex)))
    assert_array_equal(none.bias, 0.0)


def test_frequencies_agree_within_a_chance_of_one_in_ten_thousand(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Two, two, one and no degrees of freedom, and one beside an excluded sample.
    free = np.array([2, 2, 1, 1, 1])
    left_out = np.zeros((3, 5), bool)
    left_out[0, 2], left_out[:2, 3] = True, True
    excluded = np.zeros((3, 2, 3), bool)
    excluded[1, 1, 2] = True
    limit = chi2.isf(1e-4, free)
    given: dict[str, Any] = {}

    def optical_path(phase: Any, uncertainty: Any, **options: Any) -> Any:
        given.update(options, phase=phase, uncertainty=uncertainty)
        strain = limit * np.array([0.999, 1.001, 0.999, 1e6, 1.001])
        return SimpleNamespace(
            strain=strain, left_out=left_out, length=np.arange(5) + 1.0
        )

    monkeypatch.setattr("amulor.optics.ambiguity.optical_path", optical_path)
    found = errors(target(), excluded)
    assert_array_equal(found.agree, [True, False, True, True, False])
    assert_array_equal(found.path, np.arange(5) + 1.0)
    expected = np.angle(np.exp(1j * PER_RANGE[:, None] * RANGE[USABLE]))
    assert_allclose(given["phase"], expected, atol=1e-9)
    expected = np.repeat(ERROR[:, None], 5, axis=1)
    expected[1, 4] = np.inf
    assert_allclose(given["uncertainty"], expected, rtol=1e-6)
    assert_array_equal(given["shortest"], np.zeros(5))
    # 20, 50 and 90 MHz repeat after the path of 20 MHz.
    assert_allclose(given["longest"], np.full(5, 0.999 * 299792458.0 / 20e6))
    assert_array_equal(given["doubt"], np.zeros((3, 5)))
    assert given["motion"] is None


def test_a_smoothed_target_has_less_noise_of_its_own() -> None:
    gain = np.array([[0.0, 0.36, 0.5], [0.75, 0.84, 1.0]])
    cube = target(common=[1e-3, 2e-3, 4e-3])
    plain = errors(cube)
    smooth = errors(cube.assign(smoothing_gain=(("row", "column"), gain)))
    rest = np.sqrt(1 - gain[USABLE])
    assert_allclose(smooth.own_noise, rest * plain.own_noise)
    assert_allclose(smooth.noise, plain.noise)


@pytest.mark.parametrize("corner", [0.0, 1e-3])
def test_light_of_corners_adds_to_the_noise(
    monkeypatch: pytest.MonkeyPatch, corner: float
) -> None:
    plain = errors(target())
    own = plain.noise[0]
    light = np.array([0.0, 0.5, 0.99, 1.01, 3.0]) * np.hypot(own, 1e-3) * (corner > 0)
    monkeypatch.setattr(expected_errors, "_corner_error", lambda *_: light)
    monkeypatch.setattr(expected_errors, "instrument_error", lambda _: 1e-3)
    found = errors(target())
    assert_allclose(found.noise, np.hypot(own, light))
    expected = np.array([False, False, False, True, True]) & (corner > 0)
    assert_array_equal(found.in_corner, expected)
    assert_allclose(found.own_noise, plain.own_noise)


def test_a_scan_without_a_survey_has_no_corners_and_no_motion() -> None:
    cube = target()
    plain = errors(cube)
    none = expected_errors._corner_error(cube, USABLE, plain, None)
    assert_array_equal(none, np.zeros(5))
    assert expected_errors._motion(cube, np.ones((3, 5)), USABLE) is None


def test_the_path_of_a_joint_estimation_needs_a_survey() -> None:
    cube = target().assign(joint_slant_range=(("row", "column"), RANGE))
    assert np.isnan(expected_errors._joint_path(cube)).all()
