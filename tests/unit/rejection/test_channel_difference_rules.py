"""Rules of the difference of two channels: stated ratios, priors, result by hand."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import WaterResidualCause
from amulor.errors import CubeError
from amulor.rejection import channel_ratios
from amulor.rejection.channel_ratios import RatioFit, TargetRatio
from amulor.rejection.observation import Observation
from amulor.rejection.polarization_difference import (
    _separated,
    _target_ratio,
    _water_prior,
)

Make = Callable[..., xr.Dataset]
FREQUENCY = [20e6, 80e6]
CHANNELS = {"VV": (1.0, 1.0), "VH": (0.3, 0.1)}


@pytest.fixture(scope="module")
def spotted(by_hand: Make) -> xr.Dataset:
    """Return a plate with spots of 40 % of its reflectance."""
    cube = by_hand(2, frequency=FREQUENCY, channels=CHANNELS, shape=(9, 12), water=0.5)
    bare = by_hand(
        3, frequency=FREQUENCY, channels=CHANNELS, shape=(9, 12), water=0.0, noise=1e-9
    )
    dark = 0.6 * np.random.default_rng(0).integers(0, 2, (9, 12))
    for name in ("in_phase", "quadrature"):
        cube[name].values -= dark * bare[name].values
    return cube


def channels(cube: xr.Dataset) -> tuple[Observation, Observation]:
    first, second = (
        Observation(cube=cube.sel(polarization=[name])) for name in ("VV", "VH")
    )
    return first, second


def ratio(cube: xr.Dataset, stated: float | None, uncertainty: float) -> TargetRatio:
    return _target_ratio(*channels(cube), stated, uncertainty, 0.0, None)


def test_a_stated_ratio_has_the_delay_of_a_late_echo(spotted: xr.Dataset) -> None:
    found = ratio(spotted, 0.31, 0.02)
    # 0.02 ns at the highest frequency.
    late = 2 * np.pi * 80e6 * 0.02e-9 * 0.31
    assert (found.real, found.imaginary) == (0.31, 0.0)
    assert found.uncertainty == (0.02, pytest.approx(late))
    assert found.tested
    assert not found.contradicted
    # Nothing tests it where neighbors do not differ.
    flat = spotted.isel(row=slice(0, 2), column=slice(0, 2))
    alone = ratio(flat, 0.31, 0.02)
    assert alone.uncertainty == found.uncertainty
    assert not alone.tested
    assert not alone.contradicted
    with pytest.raises(CubeError, match="neighboring target pixels of one distance"):
        ratio(flat, None, 0.0)


def test_a_ratio_of_neighbors_contradicts_beyond_four_errors(
    spotted: xr.Dataset,
) -> None:
    estimate = channel_ratios.target_ratio_of_neighbors(*channels(spotted))
    assert estimate is not None
    assert ratio(spotted, None, 0.5) == estimate
    away = 4 * np.hypot(0.003, estimate.uncertainty[0])
    for factor, contradicted in ((0.99, False), (1.01, True)):
        for sign in (-1, 1):
            stated = estimate.real + sign * factor * away
            assert ratio(spotted, stated, 0.003).contradicted is contradicted


def test_the_expected_ratio_of_water_is_stated_of_open_water_or_free(
    spotted: xr.Dataset,
) -> None:
    def prior(cube: xr.Dataset, *values: Any) -> Any:
        return _water_prior(*channels(cube), *values, spread=0.05, gain=0.01)

    first, second = channels(spotted)
    assert first.shots is not None
    assert second.shots is not None
    measured, scatter = channel_ratios.of_open_water(first.shots, second.shots)
    assert measured == pytest.approx(0.1, abs=0.01)
    of_shots = prior(spotted, None, 0.0, None)
    assert_allclose(of_shots.water, [measured, measured])
    assert of_shots.uncertainty == pytest.approx(0.05 * measured)
    assert of_shots.fluctuation == scatter
    assert (of_shots.spread, of_shots.gain) == (0.05, 0.01)
    stated = prior(spotted, 0.2, 0.03, 0.004)
    assert_array_equal(stated.water, [0.2, 0.2])
    assert (stated.uncertainty, stated.fluctuation) == (0.03, 0.004)
    bare = spotted.drop_vars([n for n in spotted.variables if "open_water" in str(n)])
    free = prior(bare, None, 0.03, None)
    assert free.water is None
    assert (free.uncertainty, free.fluctuation) == (1.0, 0.0)
    assert prior(bare, 0.2, 0.03, None).uncertainty == 0.03


def test_a_difference_has_the_values_and_errors_of_its_equation(
    spotted: xr.Dataset,
) -> None:
    water = np.array([0.1, 0.12 + 0.02j])
    fit = RatioFit(
        water=water,
        covariance=np.zeros((6, 6)),
        gain=np.ones(2, dtype=complex),
        unsteady=np.zeros(2),
        fluctuation=0.03,
        scale=2.0,
        target=TargetRatio(
            real=0.3, imaginary=0.01, uncertainty=(0.0, 0.0), tested=True
        ),
    )
    result, same = _separated(spotted, fit=fit, interval=(0.5, 2.5))
    signal = spotted.amulor.signal.values
    contrast = (np.array([0.3 + 0.0025j, 0.3 + 0.01j]) - water)[:, None, None]
    weight = water[:, None, None]
    target = (signal[:, 1] - weight * signal[:, 0]) / contrast
    assert_allclose(result.amulor.signal.values[:, 0], target)
    haze = signal[:, 0] - target
    assert_allclose(result["water_in_phase"].values[:, 0], haze.real, atol=1e-12)
    assert_allclose(result["water_quadrature"].values[:, 0], haze.imag, atol=1e-12)
    # Equal, independent errors of both outputs, and the fluctuation of two readings.
    error = spotted["in_phase_uncertainty"].values[0, 0, 0, 0]
    own = 2.0 * error**2 * (1 + np.abs(weight) ** 2) / np.abs(contrast) ** 2
    moved = np.sqrt(2) * 0.03 * haze * weight / contrast
    for name, part in (("in_phase", moved.real), ("quadrature", moved.imag)):
        found = result[f"{name}_uncertainty"].values[:, 0]
        assert_allclose(found, np.sqrt(own + 2.0 * part**2), rtol=1e-6)
        assert_allclose(result[f"common_{name}_uncertainty"].values, 0.0)
    crossed = result["in_phase_quadrature_covariance"].values[:, 0]
    assert_allclose(crossed, 2.0 * moved.real * moved.imag, atol=1e-12)
    turned = np.imag(moved / target) * np.sqrt(2.0)
    found = result["phase_uncertainty_fluctuation"].values[:, 0]
    assert_allclose(found, np.abs(turned), rtol=1e-3, atol=1e-6)
    counted = result["phase_uncertainty_counting"].values[:, 0]
    expected = np.sqrt(own * np.ones(target.shape)) / np.abs(target)
    assert_allclose(counted, expected, rtol=1e-5)
    assert "phase_uncertainty_polarization_optics" not in result
    assert result.attrs["target_ratio"] == 0.3
    assert result.attrs["target_ratio_uncertainty"] == 0.0
    assert result.attrs["target_ratio_tested"] == 1
    assert result.attrs["frequencies_share_errors"] == 0
    assert_allclose(result.attrs["water_ratio"], np.abs(water))
    assert_allclose(result.attrs["water_ratio_phase"], np.angle(water))
    assert_allclose(result.attrs["water_ratio_uncertainty"], 0.0)
    assert (
        "reject, difference of VH and VV, ratios of target 0.3, of water 0.1"
        in result.attrs["history"]
    )
    assert set(same.terms) == {"counting", "fluctuation"}


def test_a_contradicted_ratio_flags_every_sample(spotted: xr.Dataset) -> None:
    fit = RatioFit(
        water=np.full(2, 0.1 + 0j),
        covariance=np.diag([1e-4, 4e-4, 0, 0, 0, 0]),
        gain=np.ones(2, dtype=complex),
        unsteady=np.zeros(2),
        fluctuation=0.0,
        scale=20.0,
        target=TargetRatio(real=0.3, uncertainty=(0.01, 0.0), tested=False),
    )
    causes = []
    for target in (
        fit.target,
        TargetRatio(real=0.3, uncertainty=(0.01, 0.0), tested=True, contradicted=True),
    ):
        changed: Any = SimpleNamespace(**vars(fit) | {"target": target})
        changed = RatioFit(**vars(changed))
        result, _ = _separated(spotted, fit=changed)
        causes.append(result["water_residual_cause"].values)
        assert_allclose(result.attrs["water_ratio_uncertainty"], [0.01, 0.02])
        assert result.attrs["target_ratio_uncertainty"] == 0.01
    assert_array_equal(causes[0], 0)
    assert_array_equal(causes[1], WaterResidualCause.MODEL_MISFIT)


@pytest.mark.parametrize(("pixels", "enough"), [(11, False), (12, True)])
def test_twelve_pixels_are_needed_to_estimate_a_ratio(
    spotted: xr.Dataset, pixels: int, enough: bool
) -> None:
    cube = spotted.copy(deep=True)
    lost = np.arange(9 * 12).reshape(9, 12) >= pixels
    # A pixel counts only with numbers of both channels at all frequencies.
    cube["in_phase"].values[1, 1][lost] = np.nan
    options: Any = {"target_ratio": 0.3, "target_ratio_uncertainty": 0.02}
    if enough:
        found, fit = _separated(cube, **options)
        assert found.attrs["target_ratio_tested"] == int(fit.target.tested)
        return
    words = (
        "11 pixels have numbers in VV and VH at all frequencies, needed are 12 to "
        "estimate the ratio of the water"
    )
    with pytest.raises(CubeError, match=f"^{words}$"):
        _separated(cube, **options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"target_ratio": -0.1}, "target_ratio must lie between 0 and 1, got -0.1"),
        ({"water_ratio": 1.01}, "water_ratio must lie between 0 and 1, got 1.01"),
        (
            {"ratio_spread": 0.0},
            "ratio_spread and model_error must be above 0, got 0 and 0.01",
        ),
        (
            {"model_error": -1.0},
            "ratio_spread and model_error must be above 0, got 0.05 and -1",
        ),
    ],
)
def test_ratios_outside_of_their_limits_are_refused(
    spotted: xr.Dataset, options: Any, words: str
) -> None:
    with pytest.raises(ValueError, match=f"^{words}$"):
        _separated(spotted, **options)


def test_ratios_at_their_limits_are_accepted(spotted: xr.Dataset) -> None:
    # They are refused as ratios that do not differ.
    for value in (0.0, 1.0):
        with pytest.raises(CubeError, match="differ by 0 with an uncertainty of 0; "):
            _separated(spotted, water_ratio=value, target_ratio=value)


def test_ratios_that_differ_by_less_than_their_errors_are_refused(
    spotted: xr.Dataset,
) -> None:
    # The error of the target alone is more than half of the contrast of 0.2.
    with pytest.raises(CubeError, match="cannot separate them"):
        _separated(
            spotted, target_ratio=0.3, target_ratio_uncertainty=0.2, model_error=1e-4
        )
