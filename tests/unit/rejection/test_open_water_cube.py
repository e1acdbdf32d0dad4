"""Cube and attributes of an open-water subtraction that is given by the test."""

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
from amulor.rejection import quality
from amulor.rejection.covariance import Covariance
from amulor.rejection.observation import Observation
from amulor.rejection.reference.before_target import ScanPhases, Strength
from amulor.rejection.reference.shots import Drift

Make = Callable[..., xr.Dataset]
#: The package has functions of the same names.
module: Any = importlib.import_module("amulor.rejection.open_water")
background: Any = importlib.import_module("amulor.rejection.background")
SHAPE = (2, 2, 2, 3)


def errors(size: float) -> Covariance:
    return Covariance(
        np.full(SHAPE, size**2), np.full(SHAPE, 2 * size**2), np.full(SHAPE, 0.0)
    )


def pair(limit: float) -> quality.Disagreement:
    one = np.ones((2, 1, 1))
    return quality.Disagreement(usual=one, scatter=one, limit=limit, rare=one > 0)


def subtracted(**changed: Any) -> Any:
    """Return a subtraction of two frequencies and channels."""
    channel = quality.ChannelPhase(
        phase=np.array([0.1, 0.2]), significance=np.ones(2), probability=1e-6
    )
    fit = SimpleNamespace(
        strength=Strength(change=0.1, uncertainty=0.02),
        channel_phase=channel,
        disagreement=(pair(3.5),),
        phase_error_gain=np.array([[1.0, 2.0], [3.0, 4.0]]),
    )
    shots = [
        SimpleNamespace(degree=k, drift=Drift(0.1j * k, 0.3 + 0.4j, 0.5))
        for k in range(4)
    ]
    counting, fluctuation, reference, column, change = (
        errors(size) for size in (1e-3, 2e-3, 3e-3, 4e-3, 5e-3)
    )
    values: dict[str, Any] = {
        "target": np.full(SHAPE, 0.6 + 0.8j),
        "water_signal": np.full(SHAPE, 0.1j),
        "residual": None,
        "put_back": False,
        "counting": counting,
        "fluctuation": fluctuation,
        "reference": reference,
        "column": column,
        "change": change,
        "independent": counting + fluctuation,
        "of_water": column + change,
        "shared": reference + column + change,
        "has_target": np.ones((2, 3), dtype=bool),
        "outlying": np.zeros(SHAPE, dtype=bool),
        "cause": np.zeros((2, 3), dtype=np.int8),
        "tests": {"no_target_probability": np.full((2, 3), 0.5)},
        "water": SimpleNamespace(fits=shots, turbidity=None),
        "fit": fit,
    }
    return SimpleNamespace(**values | changed)


@pytest.fixture
def scan(by_hand: Make) -> Observation:
    cube = by_hand(
        frequency=[20e6, 50e6], channels={"VV": (1.0, 1.0), "VH": (0.3, 0.1)},
        shape=SHAPE[2:],
    )  # fmt: skip
    return Observation(cube=cube)


def test_a_subtraction_becomes_a_cube_with_all_of_its_errors(scan: Observation) -> None:
    found, terms = module.cube_of(scan, subtracted())
    assert_allclose(found.amulor.signal.values, 0.6 + 0.8j)
    assert_allclose(found["water_quadrature"].values, 0.1)
    sizes = 1e-3 * np.arange(1, 6)
    total, shared = np.linalg.norm(sizes), np.linalg.norm(sizes[2:])
    for name, factor in (("in_phase", 1.0), ("quadrature", np.sqrt(2))):
        assert_allclose(found[f"{name}_uncertainty"].values, factor * total)
        assert_allclose(found[f"common_{name}_uncertainty"].values, factor * shared)
    names = ("counting", "fluctuation", "reference", "column", "drift")
    assert terms == names
    for name, size in zip(names, sizes, strict=True):
        # Across a signal of one volt.
        expected = size * np.sqrt(0.64 + 2 * 0.36)
        assert_allclose(found[f"phase_uncertainty_{name}"].values, expected, rtol=1e-5)
    assert_allclose(found["no_target_probability"].values, 0.5)
    assert found.attrs["frequencies_share_errors"] == 0
    assert_array_equal(found.attrs["phase_error_gain_VV"], [1.0, 3.0])
    assert_array_equal(found.attrs["phase_error_gain_VH"], [2.0, 4.0])
    assert "reject, open water" in found.attrs["history"]
    assert "put back" not in found.attrs["history"]
    assert "residual_in_phase" not in found
    some, chosen = module.cube_of(
        scan, subtracted(put_back=True, residual=np.zeros(SHAPE, complex)),
        terms=("column",),
    )  # fmt: skip
    assert chosen == ("column",)
    assert "phase_uncertainty_counting" not in some
    words = "reject, open water, column behind the target put back"
    assert words in some.attrs["history"]
    assert_array_equal(some["residual_in_phase"].values, 0.0)


def test_errors_of_the_water_make_no_target_out_of_nothing(scan: Observation) -> None:
    # Five errors of the samples, beside water that is ten times as unsure.
    weak = {"target": np.full(SHAPE, 0.03 + 0j), "column": errors(0.0),
            "change": errors(0.05), "of_water": errors(0.05),
            "shared": errors(np.hypot(3e-3, 0.05))}  # fmt: skip
    found, _ = module.cube_of(scan, subtracted(**weak))
    assert (found["signal_significance"].values > 5).all()


def test_flags_of_pixels_and_of_samples(scan: Observation) -> None:
    part = subtracted()
    part.has_target[0, 2] = False
    part.outlying[1, 0, 1, 1] = True
    part.cause[1, 0] = WaterResidualCause.STRONG_COLUMN
    found, _ = module.cube_of(scan, part)
    expected = np.zeros(SHAPE, dtype=int)
    expected[..., 0, 2] = QualityFlag.NO_TARGET
    expected[1, 0, 1, 1] = QualityFlag.OUTLIER
    expected[..., 1, 0] = QualityFlag.WATER_RESIDUAL
    assert_array_equal(found["quality_flag"].values, expected)
    cause = found["water_residual_cause"].values
    assert_array_equal(cause[..., 1, 0], WaterResidualCause.STRONG_COLUMN)
    assert np.count_nonzero(cause) == 4


def test_attributes_state_references_and_changes() -> None:
    found = module.reference_attributes(subtracted())
    assert_array_equal(found["open_water_degree"], [0, 1, 2, 3])
    assert found["open_water_degree"].dtype == np.int32
    assert_allclose(found["open_water_drift"], [0.0, 0.1, 0.2, 0.3])
    assert_allclose(found["open_water_drift_uncertainty"], 0.5)
    assert found["open_water_change"] == 0.1
    assert found["open_water_change_uncertainty"] == 0.02
    assert found["channel_phase_probability"] == 1e-6
    assert_array_equal(found["channel_phase_rad"], [0.1, 0.2])
    assert found["channel_disagreement_limit"] == 3.5
    assert not [name for name in found if "turbidity" in name or "misfit" in name]
    assert not [name for name in found if "frequency" in name]
    part = subtracted()
    part.water.turbidity = SimpleNamespace(factor=1.5, uncertainty=0.1, misfit=0.03)
    part.fit.disagreement = (pair(3.0), pair(4.0))
    part.fit.strength = Strength(
        change=0.0, uncertainty=0.02,
        phases=ScanPhases(phase=np.array([0.01, -0.02]), probability=1e-5,
                          of_change=0.2),
    )  # fmt: skip
    part.fit.channel_phase = None
    found = module.reference_attributes(part)
    assert found["open_water_turbidity"] == 1.5
    assert found["open_water_turbidity_uncertainty"] == pytest.approx(0.15)
    assert found["open_water_misfit"] == 0.03
    assert_array_equal(found["channel_disagreement_limit"], [3.0, 4.0])
    assert found[module.FREQUENCY_PROBABILITY] == 1e-5
    assert_array_equal(found[module.FREQUENCY_PHASES], [0.01, -0.02])
    assert "channel_phase_probability" not in found
    part.fit.disagreement = ()
    assert "channel_disagreement_limit" not in module.reference_attributes(part)


@pytest.mark.parametrize(("chance", "real"), [(0.9e-4, True), (1.1e-4, False)])
def test_a_phase_between_channels_is_stated_if_it_is_real(
    chance: float, real: bool
) -> None:
    phase = quality.ChannelPhase(
        phase=np.array([0.3]), significance=np.ones(1), probability=chance
    )
    found = module.channel_phase_attributes(phase)
    assert found["channel_phase_probability"] == chance
    assert ("channel_phase_rad" in found) == real


def test_a_background_is_subtracted_as_open_water(
    scan: Observation, monkeypatch: pytest.MonkeyPatch
) -> None:
    cube = scan.cube
    pixels = np.array([[True, False, True], [False, False, True]])
    given: list[Any] = []

    def find(observed: Observation, interval: Any) -> Any:
        # Shots of the cube are left out.
        assert observed.shots is None
        given.append(interval)
        return pixels

    def subtract(part: xr.Dataset, **options: Any) -> Any:
        given.append((part.amulor.open_water.sizes["shot"], options))
        return part, "of open water"

    monkeypatch.setattr(background, "find_background", find)
    monkeypatch.setattr(background, "subtract", subtract)
    found, fit = background._subtract(cube, interval=(1.0, 2.0), span="span")
    expected = {"fit": None, "span": "span", "interval": (1.0, 2.0)}
    assert given == [(1.0, 2.0), (3, expected)]
    assert found.attrs["background_pixels"] == 3
    assert found.attrs["background_pixels"].dtype == np.int32
    assert "reference from pixels without a target" in found.attrs["history"]
    assert fit.open_water == "of open water"
    assert fit.shots.sizes["shot"] == 3
    rows = cube.isel(row=[1])
    _, again = background._subtract(rows, fit=fit, interval=(1.0, 2.0))
    assert len(given) == 3
    assert given[2][1]["fit"] == "of open water"
    assert again.shots is fit.shots
