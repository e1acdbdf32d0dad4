"""Cross-talk and unequal gain of channels, and leakage, in unmixing by polarization."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import rejection
from amulor.cube import QualityFlag, WaterResidualCause
from amulor.simulation import simulate
from amulor.survey import Survey

Make = Callable[..., xr.Dataset]
TWO = {"VV": (1.0, 1.0), "VH": (0.25, 0.1)}
FREQUENCIES = [20e6, 80e6]
#: Typical errors of channels, as in the survey file's default.
CROSSTALK, GAIN = 0.01, 0.03


def with_survey(cube: xr.Dataset, stated: str | None) -> xr.Dataset:
    survey = Survey.preset("amulor-2010").with_(
        {"instrument.phase_uncertainty": stated}
    )
    return cube.assign_attrs(survey=survey.to_toml())


def mixed(cube: xr.Dataset, crosstalk: tuple[float, float], gain: float) -> xr.Dataset:
    """Return scan and references with cross-talk of both channels, and gain."""
    result = cube.copy(deep=True)
    for prefix in ("", "open_water_"):
        for name in ("in_phase", "quadrature"):
            values = cube[f"{prefix}{name}"].values
            first, second = values[:, 0], values[:, 1]
            result[f"{prefix}{name}"].values[:, 0] = first + crosstalk[0] * second
            result[f"{prefix}{name}"].values[:, 1] = (1 + gain) * (
                second + crosstalk[1] * first
            )
    return result


def by_polarization(cube: xr.Dataset) -> xr.Dataset:
    return rejection.polarization(
        cube, target_ratio=0.25, water_ratio=0.1, water_fluctuation=0.0
    )


def by_both(cube: xr.Dataset) -> xr.Dataset:
    return rejection.combined(cube, target_ratio=0.25)


def common_error(target: xr.Dataset) -> np.ndarray:
    """Return the stated common error along the echo and across it, by frequency."""
    names = ("common_in_phase_uncertainty", "common_quadrature_uncertainty")
    return np.hypot(*(target[name].values.mean(axis=(1, 2, 3)) for name in names))


def test_stated_ratios_have_the_error_of_the_channels(by_hand: Make) -> None:
    rng = np.random.default_rng(5)
    perfect = with_survey(
        by_hand(frequency=FREQUENCIES, channels=TWO, noise=1e-6), None
    )
    before = by_polarization(perfect)
    stated = common_error(before)
    squares = []
    for _ in range(40):
        share = tuple(CROSSTALK * rng.standard_normal(2))
        cube = mixed(perfect, share, GAIN * rng.standard_normal())
        after = by_polarization(cube)
        change = (after.amulor.signal - before.amulor.signal).values
        squares.append(np.abs(change.mean(axis=(1, 2, 3))) ** 2)
    # The ratios of target and water have one error here, and two stated ones; the
    # square of forty errors scatters by a quarter.
    ratio = np.sqrt(np.mean(squares, axis=0)) / stated
    assert np.all(ratio > 0.6)
    assert np.all(ratio < 1.4)


@pytest.mark.parametrize("method", [by_polarization, by_both])
def test_a_stated_phase_error_means_equal_channels(
    by_hand: Make, method: Callable[[xr.Dataset], xr.Dataset]
) -> None:
    cube = by_hand(frequency=FREQUENCIES, channels=TWO)
    unknown, perfect = (method(with_survey(cube, stated)) for stated in (None, "0 deg"))
    assert perfect.attrs["target_ratio_uncertainty"] == 0
    # 1 % of the other channel, and 3 % of the ratio of 0.25.
    expected = np.linalg.norm([0.01, 0.01 * 0.25**2, 0.03 * 0.25])
    assert_allclose(unknown.attrs["target_ratio_uncertainty"], expected, rtol=1e-9)
    assert np.all(common_error(unknown) > common_error(perfect))


def test_calibrated_channels_have_the_error_of_their_calibration(
    by_hand: Make,
) -> None:
    cube = with_survey(by_hand(frequency=FREQUENCIES, channels=TWO), None)
    measured = cube.assign_attrs(
        channel_crosstalk_uncertainty=1e-3,
        channel_gain_uncertainty=np.array([2e-3, 1e-3]),
    )
    target = by_polarization(measured)
    expected = np.linalg.norm([1e-3, 1e-3 * 0.1**2, 2e-3 * 0.1])
    assert_allclose(target.attrs["water_ratio_uncertainty"], expected, rtol=1e-9)


def test_estimated_ratios_contain_cross_talk_and_gain(by_hand: Make) -> None:
    perfect = by_hand(frequency=FREQUENCIES, channels=TWO, noise=1e-4)
    cube = mixed(perfect, (0.02, -0.03), 0.1)
    clean, target = (
        rejection.polarization(each, water_fluctuation=0.0) for each in (perfect, cube)
    )
    expected = 1.1 * (0.25 - 0.03) / (1 + 0.02 * 0.25)
    assert_allclose(target.attrs["target_ratio"], expected, rtol=5e-3)
    turn = np.angle(
        target.amulor.signal.values * clean.amulor.signal.values.conj()
    ).mean(axis=(1, 2, 3))
    # The phase is that of the target, up to the noise of 48 pixels times 7.
    assert_allclose(turn, 0, atol=5e-4)


@pytest.fixture(scope="module")
def recorded(plate: Survey) -> xr.Dataset:
    """Return samples at two frequencies, as of a perfect instrument."""
    return simulate(
        plate.with_({"instrument.modulation_frequencies": ["20 MHz", "80 MHz"]}), rng=3
    )


def test_leakage_in_the_references_flags_unmixing(recorded: xr.Dataset) -> None:
    clean = rejection.polarization(recorded)
    causes = clean["water_residual_cause"].values
    assert not (causes & WaterResidualCause.INSTRUMENT).any()
    echo = np.abs(recorded.amulor.signal.values[:, :1]).mean(axis=(2, 3))
    # Half of the echo's size: no water is like this.
    leak = 0.5 * echo * np.exp(0.7j)
    leaking = recorded.copy(deep=True)
    for prefix, axes in (("", 2), ("open_water_", 1)):
        added = leak.reshape(2, 1, *[1] * axes)
        leaking[f"{prefix}in_phase"].values[:] += added.real
        leaking[f"{prefix}quadrature"].values[:] += added.imag
    target = rejection.polarization(leaking)
    flag, causes = (
        target[name].values for name in ("quality_flag", "water_residual_cause")
    )
    assert (causes & WaterResidualCause.INSTRUMENT).any()
    assert ((flag & (QualityFlag.WATER_RESIDUAL | QualityFlag.NO_TARGET)) != 0).all()


def test_a_delay_between_channels_is_in_the_error_of_unmixing(
    recorded: xr.Dataset,
) -> None:
    """Unmixing turns the target by more than the phase between the channels."""
    delay = 100e-12
    late = recorded.copy(deep=True)
    turn = np.exp(2j * np.pi * recorded["modulation_frequency"].values * delay)
    for prefix, axes in (("", 2), ("open_water_", 1)):
        signal = late[f"{prefix}in_phase"].values + 1j * (
            late[f"{prefix}quadrature"].values
        )
        signal[:, 1] *= turn.reshape(-1, *[1] * axes)
        late[f"{prefix}in_phase"].values[:] = signal.real
        late[f"{prefix}quadrature"].values[:] = signal.imag
    before, after = (rejection.polarization(cube) for cube in (recorded, late))
    moved = np.angle(after.amulor.signal.values / before.amulor.signal.values)
    phase = np.median(moved, axis=(1, 2, 3))
    error = common_error(after) / np.median(
        np.abs(after.amulor.signal.values), axis=(1, 2, 3)
    )
    assert (np.abs(phase) > np.angle(turn)).all()
    assert (np.abs(phase) < 1.5 * error).all()
    # In equal channels the error is much smaller.
    assert (common_error(before) < 0.5 * common_error(after)).all()
