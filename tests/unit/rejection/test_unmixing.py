"""Unmixing by stated ratios and Mueller matrices: values and errors by hand."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import WaterResidualCause
from amulor.errors import CubeError
from amulor.rejection import ratios
from amulor.rejection.covariance import Covariance, phase_uncertainties
from amulor.rejection.polarization import _unmix
from amulor.rejection.ratios import Ratio
from amulor.rejection.stokes import _unmix as by_matrices

Make = Callable[..., xr.Dataset]
FREQUENCY = [20e6, 50e6]
NOISE = 2e-3


@pytest.fixture(scope="module")
def cube(by_hand: Make) -> xr.Dataset:
    return by_hand(
        7,
        frequency=FREQUENCY,
        channels={"VV": (1.0, 1.0), "VH": (0.3, 0.1)},
        shape=(3, 4),
        shots=0,
        water=0.4,
        noise=NOISE,
    )


STATED: dict[str, Any] = {
    "target_ratio": 0.3,
    "water_ratio": 0.1,
    "target_ratio_uncertainty": 0.02,
    "water_ratio_uncertainty": 0.01,
    "water_fluctuation": 0.05,
}


def test_stated_ratios_separate_target_and_water(cube: xr.Dataset) -> None:
    found, fit = _unmix(cube, **STATED)
    a, b = np.moveaxis(cube.amulor.signal.values, 1, 0)
    target = (b - 0.1 * a) / 0.2
    water = a - target
    assert_allclose(found.amulor.signal.values[:, 0], target)
    assert_allclose(found["water_in_phase"].values[:, 0], water.real, atol=1e-12)
    assert_allclose(found["water_quadrature"].values[:, 0], water.imag, atol=1e-12)
    # Both ratios are errors of all pixels, of the samples along target and water.
    for name, part in (("in_phase", "real"), ("quadrature", "imag")):
        of_target = 0.02 / 0.2 * getattr(target, part)
        of_water = 0.01 / 0.2 * getattr(water, part)
        common = of_target**2 + of_water**2
        shared = found[f"common_{name}_uncertainty"].values[:, 0]
        assert_allclose(shared, np.sqrt(common), rtol=1e-5)
        # Noise of both channels, and the fluctuation of water of at least its median.
        size = np.abs(water)
        usual = np.median(size, axis=(1, 2), keepdims=True)
        raised = water * np.maximum(usual / size, 1.0)
        moved = (0.1 / 0.2 * 0.05) ** 2 * 2 * getattr(raised, part) ** 2
        counting = NOISE**2 * (1 + 0.1**2) / 0.2**2
        total = found[f"{name}_uncertainty"].values[:, 0] ** 2
        assert_allclose(total, counting + moved + common, rtol=1e-5)
    counted = found["phase_uncertainty_counting"].values[:, 0]
    expected = np.sqrt(NOISE**2 * 1.01) / 0.2 / np.abs(target)
    assert_allclose(counted, expected, rtol=1e-5)
    # An error along the target does not turn it; that along the water does.
    turn = 0.01 / 0.2 * np.abs(np.imag(water / target))
    by_optics = found["phase_uncertainty_polarization_optics"].values[:, 0]
    assert_allclose(by_optics, turn, rtol=1e-3, atol=1e-6)
    assert set(fit.terms) == {"counting", "fluctuation", "polarization_optics"}
    for name, value in STATED.items():
        if name != "water_fluctuation":
            assert found.attrs[name] == value
    gain = found.attrs["phase_error_gain_VV"]
    assert gain == pytest.approx(np.sqrt(1.01) / 0.2)
    words = "reject, unmix VV and VH, ratios of target 0.3, of water 0.1"
    assert words in found.attrs["history"]
    assert_array_equal(found["water_residual_cause"].values, 0)
    assert found.amulor.polarizations == ["VV"]
    assert fit.target_ratio is None
    assert fit.water_ratio is None
    # Rows have the terms and the median of the scan.
    rows, _ = _unmix(cube.isel(row=[1]), **STATED, fit=fit)
    assert_allclose(
        rows["in_phase_uncertainty"].values,
        found["in_phase_uncertainty"].values[:, :, [1]],
        rtol=1e-6,
    )


def test_a_target_darker_in_the_crossed_channel_than_water_is_separated(
    cube: xr.Dataset,
) -> None:
    found, _ = _unmix(cube, **STATED | {"target_ratio": 0.1, "water_ratio": 0.3})
    a, b = np.moveaxis(cube.amulor.signal.values, 1, 0)
    assert_allclose(found.amulor.signal.values[:, 0], (b - 0.3 * a) / -0.2)
    gain = found.attrs["phase_error_gain_VV"]
    assert gain == pytest.approx(np.sqrt(1.09) / 0.2)


def test_estimated_ratios_bring_their_errors_and_phases(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    across = np.array([0.003, -0.004])
    estimate = Ratio(value=0.1, uncertainty=0.01, source="shots", across=across)
    monkeypatch.setattr(ratios, "water_ratio", lambda *_, **__: estimate)
    options = {k: v for k, v in STATED.items() if not k.startswith("water_ratio")}
    found, fit = _unmix(cube, **options)
    plain, _ = _unmix(cube, **STATED)
    assert found.attrs["water_ratio"] == 0.1
    assert found.attrs["water_ratio_uncertainty"] == 0.01
    assert fit.water_ratio is estimate
    water = cube.amulor.signal.values[:, 0] - found.amulor.signal.values[:, 0]
    turned = 1j * across[:, None, None] * water / 0.2
    before, after = (
        part["common_quadrature_uncertainty"].values[:, 0] ** 2
        for part in (plain, found)
    )
    assert_allclose(after - before, turned.imag**2, rtol=1e-4, atol=1e-12)


def test_both_channels_fluctuate_by_themselves(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    module: Any = importlib.import_module("amulor.rejection.polarization")
    shape = (2, 1, 3, 4)
    both = [
        Covariance(*(np.full(shape, v) for v in (size, 2 * size, 0.0)))
        for size in (1e-5, 4e-5)
    ]
    fit = module.FluctuationFit()
    monkeypatch.setattr(module, "_fluctuations", lambda *_, **__: (both, fit))
    found, _ = _unmix(cube, **STATED)
    # The factor of the water's ratio over the contrast, for each of them.
    expected = (0.1 / 0.2) ** 2 * 5e-5
    for name, factor in (("in_phase", 1), ("quadrature", 2)):
        total = found[f"{name}_uncertainty"].values ** 2
        common = found[f"common_{name}_uncertainty"].values ** 2
        noise = NOISE**2 * 1.01 / 0.04
        assert_allclose(total - common - noise, factor * expected, rtol=1e-4)
    target = found.amulor.signal.values
    variance = expected * (target.imag**2 + 2 * target.real**2) / np.abs(target) ** 4
    phase = found["phase_uncertainty_fluctuation"].values
    assert_allclose(phase, np.sqrt(variance), rtol=1e-5)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"target_ratio": 1.01}, "target_ratio must lie between 0 and 1, got 1.01"),
        ({"water_ratio": -0.01}, "water_ratio must lie between 0 and 1, got -0.01"),
        (
            {"target_ratio": 0.10099},
            "target_ratio (0.10099) and water_ratio (0.1) are closer than 0.001; "
            "polarization cannot tell them apart",
        ),
        (
            {"target_ratio": 0.09901},
            "target_ratio (0.09901) and water_ratio (0.1) are closer than 0.001; "
            "polarization cannot tell them apart",
        ),
    ],
)
def test_ratios_that_cannot_separate_are_refused(
    cube: xr.Dataset, changed: dict[str, float], words: str
) -> None:
    with pytest.raises(ValueError) as refusal:  # noqa: PT011
        _unmix(cube, **STATED | changed)
    assert str(refusal.value) == words


@pytest.mark.parametrize("ratio", [0.0, 0.1011, 0.0989, 1.0])
def test_ratios_up_to_their_limits_are_accepted(cube: xr.Dataset, ratio: float) -> None:
    _unmix(cube, **STATED | {"target_ratio": ratio})


# -- by Mueller matrices ---------------------------------------------------------------

TARGET, WATER = [0.4, -0.4, -0.2], [0.8, -0.8, -0.6]


def matrices(**changed: Any) -> dict[str, Any]:
    values: dict[str, Any] = {"target_mueller": TARGET, "water_mueller": WATER}
    return values | changed


def test_two_analyzers_unmix_by_their_matrices(cube: xr.Dataset) -> None:
    found, fit = by_matrices(cube, **matrices(mueller_uncertainty=0.0))
    # Ratios (1 - m22) / (1 + m22) of 3 / 7 and 1 / 9.
    a, b = np.moveaxis(cube.amulor.signal.values, 1, 0)
    contrast = 3 / 7 - 1 / 9
    target = (b - a / 9) / contrast
    assert_allclose(found.amulor.signal.values[:, 0], target, rtol=1e-6)
    water = found["water_in_phase"] + 1j * found["water_quadrature"]
    assert_allclose(water.values[:, 0], a - target, atol=1e-8)
    variance = NOISE**2 * (1 + 1 / 81) / contrast**2
    assert_allclose(found["in_phase_uncertainty"].values, np.sqrt(variance), rtol=1e-5)
    assert_allclose(found["common_in_phase_uncertainty"].values, 0.0, atol=1e-12)
    assert found.attrs["mueller_tested"] == 0
    assert found.attrs["frequencies_share_errors"] == 0
    words = "reject, unmix VV, VH by Mueller matrices"
    assert words in found.attrs["history"]
    assert fit.terms == ("counting",)
    assert (fit.water, fit.shots) == (None, None)
    counted = found["phase_uncertainty_counting"].values
    expected = phase_uncertainties(
        target, {"": Covariance(*(np.full(target.shape, v)
                                  for v in (variance, variance, 0.0)))}
    )[""]  # fmt: skip
    assert_allclose(counted[:, 0], expected, rtol=1e-4)


def test_uncertain_elements_are_errors_that_all_pixels_share(cube: xr.Dataset) -> None:
    size = 0.02
    found, fit = by_matrices(cube, **matrices(mueller_uncertainty=size))
    a, b = np.moveaxis(cube.amulor.signal.values, 1, 0)

    def unmixed(of_target: float, of_water: float) -> Any:
        first, second = ((1 - m) / (1 + m) for m in (of_target, of_water))
        # Relative to the light that the first analyzer has with the stated matrix.
        return (b - second * a) / (first - second)

    plain = unmixed(0.4, 0.8)
    # Elements become smaller in size.
    off = [unmixed(0.4 - size, 0.8) - plain, unmixed(0.4, 0.8 - size) - plain]
    common = sum(part.real**2 for part in off)
    shared = found["common_in_phase_uncertainty"].values[:, 0]
    assert_allclose(shared, np.sqrt(common), rtol=1e-4)
    assert set(fit.terms) == {"counting", "polarization_optics"}


@pytest.mark.parametrize("value", [-0.01, 1.0])
def test_an_uncertainty_of_elements_is_below_one(
    cube: xr.Dataset, value: float
) -> None:
    with pytest.raises(ValueError) as refusal:  # noqa: PT011
        by_matrices(cube, **matrices(mueller_uncertainty=value))
    assert str(refusal.value) == (
        f"mueller_uncertainty must lie from 0 to below 1, got {value:g}"
    )


def test_one_analyzer_unmixes_nothing(cube: xr.Dataset) -> None:
    with pytest.raises(CubeError) as refusal:
        by_matrices(cube.sel(polarization=["VV"]), **matrices())
    words = "the cube has the channels VV; unmixing needs two or more"
    assert str(refusal.value) == words
    with pytest.raises(CubeError, match=r"with V launched$"):
        by_matrices(cube.sel(polarization=["VV"]), **matrices(launched="V"))


def test_a_third_analyzer_tests_the_matrices(by_hand: Make) -> None:
    # Ratios of a diagonal matrix: 1, (1 - m22) / (1 + m22), and circular light.
    shares = {
        "VV": (0.7, 0.9), "VH": (0.3, 0.1), "RR": (0.4, 0.2), "RL": (0.6, 0.8),
    }  # fmt: skip
    right = by_hand(
        3, frequency=FREQUENCY, channels=shares, shape=(3, 4), shots=0, noise=NOISE
    )
    found, _ = by_matrices(right, **matrices(mueller_uncertainty=1e-4))
    assert found.attrs["mueller_tested"] == 1
    cause = found["water_residual_cause"].values
    assert_array_equal(cause, 0)
    wrong = right.copy(deep=True)
    wrong["in_phase"].values[:, 2, 1, 1] += 0.1
    found, _ = by_matrices(wrong, **matrices(mueller_uncertainty=1e-4))
    expected = np.zeros((2, 1, 3, 4), dtype=np.int8)
    expected[:, 0, 1, 1] = WaterResidualCause.MODEL_MISFIT
    assert_array_equal(found["water_residual_cause"].values, expected)
