"""Combination of channels after open water, with the subtraction given by the test."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import QualityFlag, WaterResidualCause
from amulor.rejection import ratios
from amulor.rejection.covariance import Covariance
from amulor.rejection.ratios import Ratio

Make = Callable[..., xr.Dataset]
#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.rejection.combined")
SHAPE = (2, 2, 2, 3)
RATIO = 0.3


def isotropic(values: Any) -> Covariance:
    whole = np.broadcast_to(values, SHAPE).astype(float)
    return Covariance(whole, whole.copy(), np.zeros(SHAPE))


def part(first: float, second: float) -> np.ndarray:
    """Return variances of both channels."""
    return np.array([first, second])[:, None, None]


class Case:
    """A scan of the channels VH and VV, whose subtraction is given."""

    def __init__(self, by_hand: Make, monkeypatch: pytest.MonkeyPatch) -> None:
        self.cube = by_hand(
            frequency=[20e6, 50e6], channels={"VH": (0.3, 0.1), "VV": (1.0, 1.0)},
            shape=SHAPE[2:], shots=8,
        )  # fmt: skip
        self.cube.attrs["open_water_noise_scale"] = 1.0
        rng = np.random.default_rng(1)
        echo = rng.uniform(0.5, 1, (2, 1, 2, 3)) * np.exp(2j * rng.random((2, 1, 2, 3)))
        self.echo: Any = echo[:, 0]
        # Channels in the order of the cube: crossed first.
        self.target = echo * np.array([RATIO, 1.0])[:, None, None]
        self.target = self.target + 0.01 * rng.standard_normal(SHAPE)
        self.water: Any = np.ones(SHAPE) * np.array([0.03, 0.3])[:, None, None] * 1j
        zeros = np.zeros((2, 3), dtype=bool)
        self.subtracted: Any = SimpleNamespace(
            target=self.target,
            water_signal=self.water,
            residual=None,
            counting=isotropic(part(1e-6, 4e-6)),
            independent=isotropic(part(3e-6, 5e-6)),
            reference=isotropic(part(2e-6, 1e-6)),
            of_water=isotropic(part(9.0, 6e-6)),
            column=isotropic(part(9.0, 2e-6)),
            has_target=~zeros,
            outlying=np.zeros(SHAPE, dtype=bool),
            cause=np.zeros((2, 3), dtype=np.int8),
            tests={"channel_disagreement": np.zeros(SHAPE)},
            fit="subtraction",
        )
        self.given: dict[str, Any] = {}

        def subtract(scan: Any, **options: Any) -> Any:
            self.given.update(options)
            return self.subtracted

        monkeypatch.setattr(module, "subtract_open_water", subtract)
        monkeypatch.setattr(module, "reference_attributes", lambda _: {})

    def run(self, **options: Any) -> Any:
        stated = {"target_ratio": RATIO, "target_ratio_uncertainty": 0.02}
        return module._combine(self.cube, **stated | options)


#: Covariance of both channels, VV first: samples, reference, and water of 1 and 0.1.
TOTAL = np.diag([6e-6, 5e-6]) + 6e-6 * np.outer([1, 0.1], [1, 0.1])
WEIGHTS = np.array([1.0, RATIO])
GAIN = np.linalg.solve(TOTAL, WEIGHTS) / (WEIGHTS @ np.linalg.solve(TOTAL, WEIGHTS))


def test_channels_are_combined_by_generalized_least_squares(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(by_hand, monkeypatch)
    found, fit = case.run(interval=(1.0, 2.0))
    target = GAIN[0] * case.target[:, 1] + GAIN[1] * case.target[:, 0]
    assert_allclose(found.amulor.signal.values[:, 0], target)
    water = found["water_in_phase"] + 1j * found["water_quadrature"]
    expected = case.cube.amulor.signal.values[:, 1] - target
    assert_allclose(water.values[:, 0], expected, atol=1e-9)
    of_reference = GAIN[0] ** 2 * 1e-6 + GAIN[1] ** 2 * 2e-6
    by_water = (GAIN @ [1, 0.1]) ** 2 * 6e-6
    for name, axis in (("in_phase", target.real), ("quadrature", target.imag)):
        # A wrong ratio moves the crossed channel.
        by_ratio = (GAIN[1] * 0.02 * axis) ** 2
        common = found[f"common_{name}_uncertainty"].values[:, 0] ** 2
        assert_allclose(common, of_reference + by_water + by_ratio, rtol=1e-5)
        whole = found[f"{name}_uncertainty"].values[:, 0] ** 2
        assert_allclose(whole, GAIN @ TOTAL @ GAIN + by_ratio, rtol=1e-5)
    size = np.abs(target)
    counting = GAIN[0] ** 2 * 4e-6 + GAIN[1] ** 2 * 1e-6
    column = (GAIN @ [1, 0.1]) ** 2 * 2e-6
    fluctuation = GAIN @ TOTAL @ GAIN - counting - of_reference - by_water
    for name, variance in (
        ("counting", counting), ("fluctuation", fluctuation),
        ("reference", of_reference), ("column", column),
        ("drift", by_water - column), ("polarization_optics", 0.0),
    ):  # fmt: skip
        phase = found[f"phase_uncertainty_{name}"].values[:, 0]
        assert_allclose(phase, np.sqrt(variance) / size, rtol=1e-4, atol=1e-6)
    assert "phase_uncertainty_water_model" not in found
    assert found.amulor.polarizations == ["VV"]
    assert found.attrs["target_ratio"] == RATIO
    assert found.attrs["target_ratio_uncertainty"] == 0.02
    assert found.attrs["frequencies_share_errors"] == 0
    words = "reject, combine VV and VH after open water, ratio of the target 0.3"
    assert words in found.attrs["history"]
    # Leakage of both channels, over the target that is the strongest.
    gain = np.hypot(*GAIN)
    assert_allclose(found.attrs["phase_error_gain_VV"], max(gain, 1.0), rtol=1e-6)
    assert case.given["interval"] == (1.0, 2.0)
    assert case.given["column_uncertainty"] is None
    assert case.given["fit"] is None
    assert fit.subtraction == "subtraction"
    assert fit.target_ratio is None
    assert set(fit.terms) == {
        "counting", "fluctuation", "reference", "column", "drift",
        "polarization_optics",
    }  # fmt: skip
    assert_array_equal(found["quality_flag"].values, 0)


def test_a_change_of_the_water_is_left_to_the_channels(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(by_hand, monkeypatch)
    case.subtracted.cause[0, 1] = WaterResidualCause.WATER_CHANGED
    found, _ = case.run(water_change=0.5)
    # Water of any strength leaves the difference of the channels.
    difference = (case.target[:, 0] - 0.1 * case.target[:, 1]) / (RATIO - 0.1)
    # The prior lies along the water, which is imaginary.
    values = found.amulor.signal.values[:, 0]
    assert_allclose(values.imag, difference.imag, atol=2e-4)
    real = GAIN[0] * case.target[:, 1].real + GAIN[1] * case.target[:, 0].real
    assert_allclose(values.real, real, rtol=1e-5)
    assert "phase_uncertainty_water_model" in found
    assert_array_equal(found["water_residual_cause"].values, 0)
    plain, _ = case.run()
    cause = plain["water_residual_cause"].values
    assert_array_equal(cause[:, 0, 0, 1], WaterResidualCause.WATER_CHANGED)
    assert np.count_nonzero(cause) == 2


def test_a_small_change_of_the_water_is_a_prior_along_it(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, _ = Case(by_hand, monkeypatch).run(water_change=0.01)

    def gain_of(change: float) -> Any:
        total = TOTAL + change * np.outer([1, 0.1], [1, 0.1])
        gain = np.linalg.solve(total, WEIGHTS)
        return gain / (WEIGHTS @ gain)

    # Water of 0.3 V in quadrature, whose change is that of both channels.
    change = (0.01 * 0.3) ** 2
    gain = gain_of(change)
    target = found.amulor.signal.values[:, 0]
    variance = (gain @ [1, 0.1]) ** 2 * change
    expected = np.abs(target.real) * np.sqrt(variance) / np.abs(target) ** 2
    phase = found["phase_uncertainty_water_model"].values[:, 0]
    assert_allclose(phase, expected, rtol=1e-4)
    # Leakage has a mean gain of both outputs.
    large, _ = Case(by_hand, monkeypatch).run(water_change=0.5)
    apart = gain_of((0.5 * 0.3) ** 2)
    mean = np.sqrt((GAIN @ GAIN + apart @ apart) / 2)
    assert_allclose(large.attrs["phase_error_gain_VV"], mean, rtol=1e-6)


def test_flags_are_those_of_either_channel(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(by_hand, monkeypatch)
    case.subtracted.has_target[1, 2] = False
    case.subtracted.outlying[0, 0, 0, 0] = True
    case.subtracted.outlying[1, 1, 0, 1] = True
    case.cube["saturated"].values[1, 0, 1, 0] = 1
    disagreement = case.subtracted.tests["channel_disagreement"]
    disagreement[0, 0, 0, 0], disagreement[0, 1, 0, 0] = 5.0, 7.0
    disagreement[1, 0] = np.nan
    found, _ = case.run()
    expected = np.zeros((2, 1, 2, 3), dtype=int)
    expected[:, 0, 1, 2] = QualityFlag.NO_TARGET
    expected[0, 0, 0, 0] = expected[1, 0, 0, 1] = QualityFlag.OUTLIER
    expected[1, 0, 1, 0] = QualityFlag.SATURATED
    assert_array_equal(found["quality_flag"].values, expected)
    size = found["channel_disagreement"].values
    assert size.shape == (2, 1, 2, 3)
    assert size[0, 0, 0, 0] == 7.0
    assert np.isfinite(size).all()


def test_the_residual_is_that_of_the_bright_channel(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(by_hand, monkeypatch)
    case.subtracted.residual = np.zeros(SHAPE) + part(9.0, 1e-5) * (1 + 1j)
    found, _ = case.run()
    assert_allclose(found["residual_in_phase"].values, 1e-5)
    assert_allclose(found["residual_quadrature"].values, 1e-5)


@pytest.mark.parametrize("stated", [None, 0.1])
def test_an_omitted_ratio_is_estimated_by_the_shots(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch, stated: float | None
) -> None:
    case = Case(by_hand, monkeypatch)
    estimate = Ratio(value=0.25, uncertainty=0.01, source="pixels")
    asked: list[str] = []

    def ratio_of(target: Any) -> Ratio:
        asked.append("subtracted")
        return estimate

    def target_ratio(cube: Any, *, interval: Any) -> Ratio:
        asked.append("shots alone")
        return estimate

    monkeypatch.setattr(ratios, "ratio_of", ratio_of)
    monkeypatch.setattr(ratios, "target_ratio", target_ratio)
    monkeypatch.setattr(module, "cube_of", lambda scan, subtracted: ("target",))
    found, fit = case.run(target_ratio=None, column_uncertainty=stated)
    assert asked == ["subtracted" if stated is None else "shots alone"]
    assert found.attrs["target_ratio"] == 0.25
    assert found.attrs["target_ratio_uncertainty"] == 0.01
    assert fit.target_ratio is estimate
    # Rows have the ratio, the terms and the gain of the scan.
    gain = np.array([3.0, 4.0])
    fit = module.CombinedFit(**vars(fit) | {"phase_error_gain": gain,
                                            "terms": ("counting",)})  # fmt: skip
    rows, again = case.run(target_ratio=None, column_uncertainty=stated, fit=fit)
    assert len(asked) == 1
    assert rows.attrs["target_ratio"] == 0.25
    assert_array_equal(rows.attrs["phase_error_gain_VV"], gain)
    assert again.terms == ("counting",)
    assert case.given["fit"] == "subtraction"
