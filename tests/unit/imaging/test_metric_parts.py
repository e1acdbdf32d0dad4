"""Planes, steps and contrasts of few pixels, and statistics of an image, by hand."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light

from amulor.errors import CubeError
from amulor.imaging import metrics
from amulor.imaging.common import own_variance, phase_cosines, with_flag

module = sys.modules["amulor.imaging.range_image"]
PREFIX = "slant_range_uncertainty_"
ROWS, COLUMNS = 4, 10
LABEL = np.where(np.arange(COLUMNS) < 5, 1, 2) * np.ones((ROWS, 1), dtype=int)


def _steps(**terms: float | np.ndarray) -> xr.Dataset:
    """Two planes across the beams, 100 mm from each other, with noise of 1 mm."""
    azimuth, elevation, unit = scenes.directions(ROWS, COLUMNS)
    distance = np.where(LABEL == 1, 1.5, 1.4) / unit[..., 2]
    image = scenes.image_of(distance, azimuth, elevation, own=1e-3, shared=5e-3)
    like = image["slant_range"]
    return image.assign(
        {name: xr.zeros_like(like) + values for name, values in terms.items()}
    )


def _random() -> float:
    """Error of the step by noise: two constants and slopes by least squares."""
    unit = scenes.directions(ROWS, COLUMNS)[2]
    forward = np.where(LABEL == 1, 1.5, 1.4).ravel()
    x, y = (unit[..., k].ravel() / unit[..., 2].ravel() * forward for k in (0, 1))
    design = np.stack([LABEL.ravel() == 1, LABEL.ravel() == 2, x, y], axis=1)
    # Noise along the beam moves a point forward by the cosine.
    # The reference, which is common to all pixels, counts as their noise, too.
    root = 1 / (1e-3 * 26**0.5 * unit[..., 2].ravel())
    rows = design * root[:, None]
    inverse = np.linalg.inv(rows.T @ rows)
    return float(np.sqrt(inverse[0, 0] + inverse[1, 1] - 2 * inverse[0, 1]))


def test_a_step_has_errors_by_noise_reference_and_bias() -> None:
    (found,) = metrics.step_heights(_steps(), LABEL)
    assert found.height == pytest.approx(0.1)
    assert found.random == pytest.approx(_random(), rel=2e-3)
    expected = np.sqrt(found.random**2 + 2 * 25e-6)
    assert found.uncertainty == pytest.approx(expected)
    bias = np.where(LABEL == 1, 1e-3, 4e-3)
    (found,) = metrics.step_heights(_steps(slant_range_bias=bias), LABEL)
    expected = np.sqrt(found.random**2 + 2 * 25e-6 + 9e-6)
    assert found.uncertainty == pytest.approx(expected)


def test_terms_of_the_water_count_by_the_phase_between_both_planes() -> None:
    delay = np.where(LABEL == 1, 2e-3, 3e-3)
    drift = np.where(LABEL == 1, 2.5e-3, 1.5e-3)
    terms = {f"{PREFIX}delay": delay, f"{PREFIX}drift": drift}
    image = _steps(**terms)
    (found,) = metrics.step_heights(image, LABEL)
    means = [image["slant_range"].values[n == LABEL].mean() for n in (1, 2)]
    turn = 4 * np.pi * 39e6 * 1.38 / speed_of_light * (means[0] - means[1])
    rest = [25e-6 - 2e-3**2 - 2.5e-3**2, 25e-6 - 3e-3**2 - 1.5e-3**2]
    water = 2.5e-3**2 + 1.5e-3**2 - 2 * 2.5e-3 * 1.5e-3 * np.cos(turn)
    expected = np.sqrt(found.random**2 + sum(rest) + 1e-6 + water)
    assert found.uncertainty == pytest.approx(expected, rel=1e-6)


def test_a_step_of_unknown_errors_has_none() -> None:
    image = _steps()
    image["slant_range_uncertainty"].values[:, 7] = np.nan
    image["slant_range_uncertainty_counting"] = xr.full_like(image["slant_range"], 1e-3)
    (found,) = metrics.step_heights(image, LABEL)
    assert np.isnan(found.uncertainty)
    assert found.height == pytest.approx(0.1)
    assert np.isfinite(found.random)


def test_a_plane_needs_three_pixels_of_a_step_and_four_alone() -> None:
    image = _steps()
    label = np.where(LABEL == 1, 1, 0)
    label[0, 7], label[1, 8], label[2, 7] = 2, 2, 2
    (found,) = metrics.step_heights(image, label)
    assert found.height == pytest.approx(0.1)
    label[2, 7] = 0
    with pytest.raises(CubeError) as caught:
        metrics.step_heights(image, label)
    assert str(caught.value) == (
        "plane 2 has 2 usable pixels, needed are at least 3; enlarge its region"
    )
    region = np.zeros((ROWS, COLUMNS), dtype=bool)
    region[0, 0] = region[1, 3] = region[3, 1] = True
    with pytest.raises(CubeError) as caught:
        metrics.plane_residual(image, region)
    assert str(caught.value) == (
        "a plane needs at least 4 usable pixels, the region has 3; choose a larger one"
    )
    region[2, 2] = True
    fit = metrics.plane_residual(image, region)
    assert fit.points == 4
    assert_allclose(fit.normal, [0.0, 0.0, -1.0], atol=1e-6)
    line = np.zeros((ROWS, COLUMNS), dtype=bool)
    line[:, 4] = True
    with pytest.raises(CubeError) as caught:
        metrics.plane_residual(image, line)
    assert str(caught.value) == (
        "the points lie on a line, which leaves the lean of a plane open; take more "
        "than one row and one column"
    )


def test_the_residual_of_a_plane_is_over_its_degrees_of_freedom() -> None:
    image = _steps()
    unit = scenes.directions(ROWS, COLUMNS)[2]
    # One square of pixels, whose diagonal is nearer: no plane follows it.
    off = 1e-4 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    image["slant_range"].values[:2, :2] = (1.5 + off) / unit[:2, :2, 2]
    region = np.zeros((ROWS, COLUMNS), dtype=bool)
    region[:2, :2] = True
    fit = metrics.plane_residual(image, region)
    # Four points and three numbers: one degree of freedom.
    assert fit.residual == pytest.approx(2e-4, rel=1e-3)
    cosine = unit[:2, :2, 2]
    expected = 1e-3 * np.sqrt(26 * np.mean(cosine**2))
    assert fit.expected == pytest.approx(expected, rel=1e-3)


def test_a_contrast_has_the_error_of_two_means() -> None:
    image = _steps()
    image["intensity"].values[:] = np.where(LABEL == 1, 3.0, 1.0)
    image["intensity"].values[0] += 0.1
    image["intensity"].values[1, 0] = np.nan
    found = metrics.contrast(image, LABEL == 1, LABEL == 2)
    target = np.array([3.1] * 5 + [3.0] * 14)
    around = np.array([1.1] * 5 + [1.0] * 15)
    a, b = target.mean(), around.mean()
    assert found.value == pytest.approx((a - b) / (a + b))
    errors = [values.std(ddof=1) / np.sqrt(values.size) for values in (target, around)]
    expected = 2 / (a + b) ** 2 * np.hypot(b * errors[0], a * errors[1])
    assert found.uncertainty == pytest.approx(expected)
    one = np.zeros((ROWS, COLUMNS), dtype=bool)
    one[0, 0] = True
    with pytest.raises(CubeError) as caught:
        metrics.contrast(image, one, LABEL == 2)
    assert str(caught.value) == "the target has 1 pixels, needed are 2"
    one[0, 1] = True
    assert metrics.contrast(image, one, LABEL == 2).value > 0


def test_noise_is_the_variance_without_the_common_part() -> None:
    image = _steps()
    assert_allclose(own_variance(image), 1e-6)
    alone = image.drop_vars("slant_range_common_uncertainty")
    assert_allclose(own_variance(alone), 26e-6)
    # No less than rounding leaves of the difference.
    image["slant_range_common_uncertainty"] = image["slant_range_uncertainty"]
    rounded = 4 * np.finfo(float).eps * 26e-6
    assert_allclose(own_variance(image), rounded)


def test_noise_of_unknown_errors_is_that_of_the_terms() -> None:
    terms = {f"{PREFIX}counting": 3e-3, f"{PREFIX}fluctuation": 4e-3,
             f"{PREFIX}delay": 9e-3, f"{PREFIX}reference": 9e-3,
             f"{PREFIX}water_model": 1.2e-2}  # fmt: skip
    image = _steps(**terms)
    image["slant_range_uncertainty"].values[0, 0] = np.nan
    found = own_variance(image)
    assert found[0, 0] == pytest.approx(169e-6)
    assert_allclose(found[1:], 1e-6)
    # Joint estimations state common errors as those of the water model.
    joint = image.assign(slant_range_bound=image["slant_range"])
    assert own_variance(joint)[0, 0] == pytest.approx(25e-6)
    bare = _steps()
    bare["slant_range_uncertainty"].values[0, 0] = np.nan
    assert np.isnan(own_variance(bare)[0, 0])


def test_flags_are_added_to_those_of_selected_pixels() -> None:
    image = _steps()
    image["quality_flag"].values[0, 0] = 4
    pixels = np.zeros((ROWS, COLUMNS), dtype=bool)
    pixels[0, :2] = True
    found = with_flag(image, 64, pixels)["quality_flag"]
    assert found.dtype == np.int16
    assert found.values[0, :3].tolist() == [68, 64, 0]
    assert image["quality_flag"].values[0, 0] == 4
    everywhere = with_flag(image, 64, True)["quality_flag"]
    assert (everywhere.values & 64 == 64).all()


def test_cosines_of_phases_are_means_over_the_frequencies() -> None:
    image = _steps().assign_attrs(modulation_frequencies=np.array([20e6, 60e6]))
    found = phase_cosines(image, np.array([1.0, 1.2, 1.5]))
    turn = 4 * np.pi * 1.38 / speed_of_light * np.array([20e6, 60e6])
    expected = np.mean(np.cos(turn * 0.3))
    assert found[1, 2] == found[2, 1] == pytest.approx(expected)
    assert_allclose(np.diag(found), 1.0)
    assert found.shape == (3, 3)


def _samples(time: np.ndarray, dims: tuple[str, ...]) -> xr.Dataset:
    return xr.Dataset(
        coords={
            "reading_time": ((*dims, "row", "column"), time),
            "reading_duration": ((*dims, "row", "column"), 0.1 + 0 * time),
        }
    )


def test_readings_are_in_the_order_of_channels_and_frequencies() -> None:
    time = np.arange(24.0).reshape(2, 3, 2, 2)
    samples = _samples(time, ("modulation_frequency", "polarization"))
    weight = np.array([0.1, 0.2, 0.3, 0.2, 0.1, 0.1])
    found = module._readings(samples, weight)
    assert list(found) == ["reading_time", "reading_duration", "reading_weight"]
    expected = time.swapaxes(0, 1).reshape(6, 2, 2)
    assert_array_equal(found["reading_time"].values, expected)
    assert_array_equal(found["reading_weight"].values, weight)
    assert found["reading_time"].attrs["units"] == "s"
    assert found["reading_time"].dims == ("reading", "row", "column")
    # Readings at once are one.
    at_once = np.tile(time[:1], (2, 1, 1, 1))[:, :1]
    once = module._readings(
        _samples(at_once, ("modulation_frequency", "polarization")), weight[:2]
    )
    assert_array_equal(once["reading_time"].values, time[0, :1])
    assert_array_equal(once["reading_weight"].values, [1.0])
    assert module._readings(xr.Dataset(), weight) == {}


def test_statistics_of_pixels_are_the_nearest_to_a_flag() -> None:
    values = np.array([[[3.0, np.nan]], [[1.0, 5.0]]])
    cause = np.array([[[1, 0]], [[4, 4]]], dtype=np.int16)
    dims = ("modulation_frequency", "row", "column")
    channel = xr.Dataset(
        {
            "signal_significance": (dims, values),
            "residual_phase_ratio": (dims, values),
            "channel_disagreement": (dims, values),
            "water_residual_cause": (dims, cause),
        }
    )
    found = module._tests_of(channel)
    assert_array_equal(found["signal_significance"], [[1.0, 5.0]])
    assert_array_equal(found["residual_phase_ratio"], [[3.0, 5.0]])
    assert_array_equal(found["channel_disagreement"], [[3.0, 5.0]])
    assert_array_equal(found["water_residual_cause"], [[5, 4]])
    assert module._tests_of(xr.Dataset()) == {}


def test_the_photon_limit_is_that_of_the_echo_alone() -> None:
    frequency = np.array([30e6, 80e6])
    amplitude = np.array([[[1e-3, 4e-3]], [[2e-3, 0.0]]])
    observation: Any = SimpleNamespace(
        channel=xr.Dataset(attrs={"modulation_depth": 0.8, "photon_noise_volt": 1e-9}),
        signal=amplitude * np.exp(0.3j), frequency=frequency,
        geometry=SimpleNamespace(medium=SimpleNamespace(group_index=1.38)),
    )  # fmt: skip
    found = module._photon_limit(observation)
    # The variance of an output is half of the volts per photon times A / m; a phase
    # has it over the square of the amplitude.
    per_phase = speed_of_light / (4 * np.pi * frequency * 1.38)
    sigma = per_phase * np.sqrt(1e-9 / (0.8 * amplitude[:, 0, 0]))
    assert found[0, 0] == pytest.approx(1 / np.sqrt((1 / sigma**2).sum()), rel=1e-6)
    first = per_phase[0] * np.sqrt(1e-9 / (0.8 * 4e-3))
    assert found[0, 1] == pytest.approx(first, rel=1e-6)
