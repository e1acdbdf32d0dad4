"""Range profiles of a scan: what each beam is given, and what comes of it."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor import rejection
from amulor.cube import QualityFlag, WaterResidualCause

Make = Callable[..., xr.Dataset]
#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.rejection.range_profile")
FREQUENCY = [20e6, 40e6, 60e6, 80e6]
SHAPE = (4, 2, 2, 3)


@pytest.fixture
def cube(by_hand: Make) -> xr.Dataset:
    found = by_hand(
        frequency=FREQUENCY, channels={"VV": (1.0, 1.0), "VH": (0.3, 0.1)},
        shape=SHAPE[2:],
    )  # fmt: skip
    found["in_phase_uncertainty"].values[:] = 3e-3
    found["quadrature_uncertainty"].values[:] = 4e-3
    return found


def beams(monkeypatch: pytest.MonkeyPatch, give: Any) -> list[Any]:
    """Let each beam have a given result; return what the beams were given."""
    given: list[Any] = []

    def separated(
        signal: Any, error: Any, late: Any, water: Any, **options: Any
    ) -> Any:
        given.append((signal, error, late, water, options))
        return give(len(given) - 1, signal)

    monkeypatch.setattr(module, "_separated", separated)
    return given


def test_each_beam_is_given_its_samples_and_errors(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    def give(number: int, signal: Any) -> Any:
        place = None if number == 4 else 1.5
        return module._Beam(0.5 * signal, np.full(4, 1e-6), place, number == 5)

    given = beams(monkeypatch, give)
    common = 1e-3 * np.arange(8).reshape(4, 2)
    monkeypatch.setattr(
        module, "_open_water",
        lambda scan: (
            np.full((4, 2), 0.1j), np.full((4, 2), 9e-6),
            module.Covariance(common**2, 4 * common**2, 0 * common),
        ),
    )  # fmt: skip
    cube["in_phase"].values[2, 1, 0, 1] = np.nan
    found = rejection.range_profile(
        cube, interval=(0.5, 2.5), most=2, model_error=0.02, surface="nearest"
    )
    assert len(given) == 11
    signal = cube.amulor.signal.values
    places = [at for at in np.ndindex(2, 2, 3) if at != (1, 0, 1)]
    for (values, error, late, water, options), at in zip(given, places, strict=True):
        index = (slice(None), *at)
        assert_array_equal(values, signal[index])
        # The larger error of both outputs, of the water and of the model.
        expected = 16e-6 + 9e-6 + (0.02 * np.abs(signal[index])) ** 2
        assert_allclose(error, np.sqrt(expected))
        assert late is None
        assert_array_equal(water, np.full(4, 0.1j))
        assert_array_equal(options.pop("frequency"), FREQUENCY)
        assert options == {
            "group_index": 1.38, "interval": (0.5, 2.5), "most": 2,
            "surface": "nearest",
        }  # fmt: skip
    target = found.amulor.signal.values
    lost = np.zeros(SHAPE, dtype=bool)
    lost[:, 1, 0, 1] = True
    assert_allclose(target[~lost], 0.5 * signal[~lost])
    assert np.isnan(target[lost]).all()
    water = found["water_in_phase"] + 1j * found["water_quadrature"]
    assert_allclose(water.values[~lost], 0.5 * signal[~lost])
    for name, factor in (("in_phase", 1.0), ("quadrature", 2.0)):
        shared = (factor * common)[:, :, None, None] * np.ones(SHAPE)
        assert_allclose(found[f"common_{name}_uncertainty"].values, shared)
        total = np.sqrt(1e-6 + shared**2)
        assert_allclose(found[f"{name}_uncertainty"].values[~lost], total[~lost])
    flag = found["quality_flag"].values
    assert (flag[lost] & QualityFlag.MISSING).all()
    assert (flag[:, 0, 1, 1] & QualityFlag.NO_TARGET).all()
    cause = found["water_residual_cause"].values
    expected = np.zeros(SHAPE, dtype=np.int8)
    expected[:, 0, 1, 2] = WaterResidualCause.MODEL_MISFIT
    assert_array_equal(cause, expected)
    words = "reject, range profile with up to 2 surfaces, the nearest one"
    assert words in found.attrs["history"]
    assert found.attrs["frequencies_share_errors"] == 0


def test_a_scan_without_shots_shares_no_error(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    bare = by_hand(
        frequency=FREQUENCY, channels={"VV": (1.0, 1.0)}, shape=(1, 2), shots=0
    )
    given = beams(
        monkeypatch, lambda number, signal: module._Beam(signal, 0 * signal.real + 1e-6,
                                                         1.0, False),
    )  # fmt: skip
    found = rejection.range_profile(bare, interval=(0.5, 2.5), most=1)
    assert [water for _, _, _, water, _ in given] == [None, None]
    assert not [name for name in found.data_vars if str(name).startswith("common_")]
    assert_allclose(found["in_phase_uncertainty"].values, 1e-3)
    assert_array_equal(found["quality_flag"].values, 0)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"most": 0}, "most must be 1 or more and model_error above 0, got 0 and 0.01"),
        (
            {"model_error": 0.0},
            "most must be 1 or more and model_error above 0, got 3 and 0",
        ),
        (
            {"surface": "second"},
            "surface must be strongest, nearest or farthest, got 'second'",
        ),
    ],
)
def test_arguments_beyond_their_limits_are_refused(
    cube: xr.Dataset, options: dict[str, Any], words: str
) -> None:
    with pytest.raises(ValueError) as refusal:  # noqa: PT011
        rejection.range_profile(cube, **options)
    assert str(refusal.value) == words
