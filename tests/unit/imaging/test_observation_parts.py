"""Input of ranging: phases and their errors, channels, beams, scaled noise."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor import rejection
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.imaging import observation as module
from amulor.imaging.observation import (
    channel_of,
    geometry_of,
    observe,
    with_noise_scaled,
)
from amulor.optics.ambiguity import Path

FREQUENCY = np.array([20e6, 50e6, 90e6])
ROWS, COLUMNS = 2, 3
SHAPE = (3, ROWS, COLUMNS)
RNG = np.random.default_rng(4)
SIGNAL = (1 + RNG.random(SHAPE)) * np.exp(1j * RNG.uniform(-3, 3, SHAPE))
IN_PHASE, QUADRATURE = (1e-3 * (1 + RNG.random(SHAPE)) for _ in range(2))
CROSS = 0.3 * IN_PHASE * QUADRATURE


def _target(polarizations: tuple[str, ...] = ("VV",)) -> xr.Dataset:
    """Target signal with noise that differs from sample to sample."""
    count = len(polarizations)

    def each(values: np.ndarray) -> np.ndarray:
        return np.repeat(values[:, None], count, axis=1)

    cube = cubes.build(
        "samples",
        {
            "in_phase": each(SIGNAL.real),
            "quadrature": each(SIGNAL.imag),
            "in_phase_uncertainty": each(IN_PHASE),
            "quadrature_uncertainty": each(QUADRATURE),
            "in_phase_quadrature_covariance": each(CROSS),
            "saturated": np.zeros((3, count, ROWS, COLUMNS), np.int8),
        },
        {
            "modulation_frequency": FREQUENCY,
            "polarization": list(polarizations),
            "azimuth": 0.01 * np.arange(6.0).reshape(ROWS, COLUMNS),
            "elevation": -0.02 * np.arange(6.0).reshape(ROWS, COLUMNS),
        },
        geometry={
            "group_index": 1.38,
            "refractive_index": 1.34,
            "emitter_position": np.array([0.1, 0.2, 0.3]),
            "receiver_position": np.array([0.4, 0.2, 0.3]),
        },
        attributes=cubes.attributes("samples", title="by hand", source="by hand"),
    )
    return rejection.keep_water(cube)


def _channel() -> xr.Dataset:
    return _target().isel(polarization=0)


def _phase_error(one: np.ndarray, other: np.ndarray, cross: np.ndarray) -> np.ndarray:
    """Error of the phase by errors of both outputs, across the phasor."""
    turn = np.angle(SIGNAL)
    square = (np.sin(turn) * one) ** 2 + (np.cos(turn) * other) ** 2
    return np.sqrt(square - 2 * np.sin(turn) * np.cos(turn) * cross) / np.abs(SIGNAL)


def test_phases_have_the_error_across_their_phasor() -> None:
    found = observe(_channel())
    assert_allclose(found.signal, SIGNAL)
    assert_allclose(found.phase, np.angle(SIGNAL))
    assert_allclose(found.sigma, _phase_error(IN_PHASE, QUADRATURE, CROSS))
    assert_array_equal(found.own_sigma, found.sigma)
    assert found.shared_sigma(found.usable) is None
    assert_array_equal(found.frequency, FREQUENCY)
    per_phase = speed_of_light / (2 * np.pi * FREQUENCY)
    assert_allclose(found.path_per_phase, per_phase[:, None, None])
    assert found.lag is None
    assert found.motion(np.ones(3) / 3) is None
    assert found.survey is None


def test_errors_that_pixels_share_leave_the_rest_to_the_pixel() -> None:
    channel = _channel()
    for name, part in (("in_phase", IN_PHASE), ("quadrature", QUADRATURE)):
        values = 0.6 * part
        values[0, 0, 0] = 2 * part[0, 0, 0]
        channel[f"common_{name}_uncertainty"] = channel["in_phase"].copy(data=values)
    channel["common_covariance"] = channel["in_phase"].copy(data=0.36 * CROSS)
    found = observe(channel)
    shared = found.shared_sigma(found.usable)
    assert shared is not None
    whole = _phase_error(IN_PHASE, QUADRATURE, CROSS)
    assert_allclose(shared[:, 0, 1:], 0.6 * whole[:, 0, 1:])
    assert_allclose(found.own_sigma[:, 0, 1:], 0.8 * whole[:, 0, 1:])
    assert found.own_sigma[0, 0, 0] == 0


def test_unusable_pixels_and_outlying_samples_have_no_phase() -> None:
    channel = _channel()
    flag = channel["quality_flag"].values
    flag[:] = 0
    flag[:, 0, 0] = QualityFlag.MISSING
    flag[1, 0, 1] = QualityFlag.OUTLIER
    flag[2, 1, 2] = QualityFlag.NO_TARGET
    channel["in_phase"].values[0, 0, 0] = np.nan
    found = observe(channel)
    assert_array_equal(found.usable, [[False, True, True], [True, True, True]])
    assert_array_equal(found.phase[:, 0, 0], np.zeros(3))
    assert np.isfinite(found.sigma[0, 0, 0])
    assert np.isinf(found.sigma[1, 0, 1])
    assert np.isinf(found.sigma[2, 1, 2])
    assert np.isfinite(found.sigma).sum() == 18 - 2
    strict = observe(channel, most_outliers=0.3)
    assert not strict.usable[0, 1] or strict.flag[0, 1] & QualityFlag.OUTLIER


def test_residual_water_shifts_the_phase() -> None:
    channel = _channel()
    # Nothing was subtracted, so the shift is unknown; where it was, it is zero.
    assert np.isnan(observe(channel).shift).all()
    channel["quality_flag"].values[:, 1] = 0
    shift = observe(channel).shift
    assert np.isnan(shift[:, 0]).all()
    assert_array_equal(shift[:, 1], np.zeros((3, COLUMNS)))
    residual = 1e-4 * (1 + 2j)
    for name, part in (("in_phase", 1e-4), ("quadrature", 2e-4)):
        channel[f"residual_{name}"] = xr.full_like(channel["in_phase"], part)
    found = observe(channel).shift
    assert_allclose(
        np.abs(found), np.abs((residual / SIGNAL).imag), rtol=1e-3, atol=1e-7
    )


def test_values_of_a_joint_estimation_are_complete_or_none() -> None:
    channel = _channel().assign_attrs(joint_first=2, joint_second=3.5)
    assert observe(channel).joint_values("first", "second") is None
    channel["joint_slant_range"] = channel["azimuth"]
    joint = observe(channel)
    assert joint.joint_values("first", "second") == (2.0, 3.5)
    assert joint.joint_values("first", "third") is None


def test_beams_begin_where_the_image_says() -> None:
    channel = _channel()
    plain = geometry_of(channel)
    assert_allclose(plain.emitter, np.tile([0.1, 0.2, 0.3], (ROWS, COLUMNS, 1)))
    assert_allclose(plain.receiver, np.tile([0.4, 0.2, 0.3], (ROWS, COLUMNS, 1)))
    assert plain.medium.refractive_index == 1.34
    assert plain.medium.group_index == 1.38
    place = 0.5 + np.arange(6.0).reshape(ROWS, COLUMNS)
    moved = channel.assign_coords(origin_y=(("row", "column"), place))
    found = geometry_of(moved)
    assert_allclose(found.emitter[..., 1], place)
    assert_allclose(found.emitter[..., [0, 2]], np.tile([0.1, 0.3], (ROWS, COLUMNS, 1)))
    # The receiver keeps its distance from the emitter.
    assert_allclose(found.receiver[..., 1], place)
    assert_allclose(found.receiver[..., 0], 0.4)


def test_channels_are_chosen_by_name() -> None:
    cube = _target(("VV", "VH"))
    assert str(channel_of(cube, "VH")["polarization"].item()) == "VH"
    with pytest.raises(CubeError) as caught:
        channel_of(cube, None)
    assert str(caught.value) == (
        "the cube has the channels VV, VH; choose one with polarization (command line: "
        "--polarization)"
    )
    with pytest.raises(CubeError) as caught:
        channel_of(cube, "HH")
    assert str(caught.value) == ("the cube has no channel 'HH', but VV, VH; choose one")
    assert str(channel_of(_target(), None)["polarization"].item()) == "VV"


def test_scaled_noise_keeps_what_samples_share() -> None:
    target = _channel()
    target["common_in_phase_uncertainty"] = 0.6 * target["in_phase_uncertainty"]
    target["common_covariance"] = 0.25 * target["in_phase_quadrature_covariance"]
    target["phase_uncertainty_counting"] = 0.1 * target["in_phase_uncertainty"]
    target["phase_uncertainty_reference"] = 0.2 * target["in_phase_uncertainty"]
    found = with_noise_scaled(target, 2.0)
    assert_allclose(found["in_phase_uncertainty"], np.sqrt(1 + 3 * 0.64) * IN_PHASE)
    assert_allclose(found["quadrature_uncertainty"], 2 * QUADRATURE)
    cross = found["in_phase_quadrature_covariance"]
    assert_allclose(cross, (1 + 3 * 0.75) * CROSS)
    assert_allclose(found["phase_uncertainty_counting"], 0.2 * IN_PHASE)
    assert_allclose(found["phase_uncertainty_reference"], 0.2 * IN_PHASE)
    assert found.attrs["noise_scale"] == 2.0
    assert (
        found["quadrature_uncertainty"].attrs == target["quadrature_uncertainty"].attrs
    )
    assert with_noise_scaled(target, 1.0) is target
    scaled = observe(target).with_noise(2.0)
    assert_allclose(scaled.channel["quadrature_uncertainty"], 2 * QUADRATURE)
    turned = observe(target).with_frequency_phase(np.array([0.1, 0.2, 0.3]))
    assert_array_equal(turned.frequency_phase, [0.1, 0.2, 0.3])


def test_neighbors_are_pairs_along_an_axis() -> None:
    values = np.arange(12).reshape(3, 4)
    first, second = module._pairs(0)
    assert_array_equal(values[second] - values[first], np.full((2, 4), 4))
    first, second = module._pairs(1)
    assert_array_equal(values[second] - values[first], np.ones((3, 3)))


def _path(**changes: Any) -> Path:
    fields: dict[str, Any] = {
        "length": np.full((8, 9), 4.0), "uncertainty": np.full((8, 9), 1e-3),
        "weight": np.array([0.2, 0.8])[:, None, None] * np.ones((2, 8, 9)),
        "settled": np.ones((8, 9), dtype=bool), "wrong": np.zeros((8, 9)),
        "residual": np.zeros((2, 8, 9)), "strain": np.zeros((8, 9)),
        "left_out": np.zeros((2, 8, 9), dtype=bool),
    }  # fmt: skip
    return Path(**{**fields, **changes})


def test_residuals_about_a_weighted_mean_have_less_than_their_variance() -> None:
    error = np.array([3e-3, 1e-3])[:, None, None] * np.ones((2, 8, 9))
    found = module._expected(_path(), error, None)
    mean = (0.2 * 3e-3) ** 2 + (0.8 * 1e-3) ** 2
    assert_allclose(found[0], (1 - 0.4) * 9e-6 + mean)
    assert_allclose(found[1], (1 - 1.6) * 1e-6 + mean)
    # One frequency left out has no error in the mean.
    error[1] = np.inf
    weight = np.array([1.0, 0.0])[:, None, None] * np.ones((2, 8, 9))
    with np.errstate(invalid="ignore"):
        alone = module._expected(_path(weight=weight), error, None)
    assert_allclose(alone[0], 0.0, atol=1e-18)


@pytest.mark.parametrize("rows", [3, 4])
def test_thirty_pairs_tell_the_noise(rows: int) -> None:
    """Residuals of a checkerboard, whose pairs differ by twice their size."""
    size = 2e-3
    board = size * (-1.0) ** np.add.outer(np.arange(8), np.arange(9))
    error = np.full((2, 8, 9), 1e-3)
    length = np.full((8, 9), np.nan)
    length[:rows, :6] = 4.0
    path = _path(residual=np.stack([board, -board]), length=length,
                 weight=np.full((2, 8, 9), 0.5))  # fmt: skip
    factor, chance = module._factor(path, error, None)
    pairs = rows * 5 + (rows - 1) * 6
    if pairs < 30:
        assert (factor, chance) == (1.0, 0.0)
        return
    # Of equal weights, a residual has half of the variance.
    square = (2 * size) ** 2 / 1e-6 / 0.45494
    assert factor == pytest.approx(np.sqrt(square))
    assert chance == pytest.approx(2.326 * np.sqrt(2 / pairs))


def test_one_frequency_and_two_of_a_vehicle_tell_no_noise() -> None:
    error = np.full((2, 8, 9), 1e-3)
    one = _path(residual=np.zeros((1, 8, 9)), weight=np.ones((1, 8, 9)))
    assert module._factor(one, error[:1], None) == (1.0, 0.0)
    motion = np.zeros((2, 8, 9))
    assert module._factor(_path(), error, motion) == (1.0, 0.0)
