"""Row of a channel in a comparison: errors, shares of pixels and cautions."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from compared_methods import method_of, returning
from numpy.testing import assert_array_equal

from amulor import rejection
from amulor.cube import QualityFlag, WaterResidualCause
from amulor.rejection import Caution

Make = Callable[..., xr.Dataset]
#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.rejection.compare")


@pytest.fixture(scope="module")
def cube(by_hand: Make) -> xr.Dataset:
    return by_hand(
        frequency=[20e6, 50e6],
        channels={"VV": (1.0, 1.0), "VH": (0.3, 0.1)},
        shape=(4, 5),
    )


@pytest.fixture(scope="module")
def target(cube: xr.Dataset) -> xr.Dataset:
    return rejection.keep_water(cube)


def evaluated(
    monkeypatch: pytest.MonkeyPatch,
    target: xr.Dataset,
    interval: Any = None,
    keeps_one_frequency: bool = False,
    **errors: Any,
) -> Any:
    """Return the trial of a channel of 4 x 5 pixels with given range errors."""

    def errors_of(target: Any, usable: Any, excluded: Any, *, interval: Any) -> Any:
        count = int(usable.sum())
        values: dict[str, Any] = {
            "noise": np.full(count, 2e-3), "own_noise": np.full(count, 1e-3),
            "bias": np.full(count, 3e-3), "agree": np.ones(count, bool),
            "path": np.arange(count) + 1.0, "mixed": np.zeros(count, bool),
            "in_corner": np.zeros(count, bool), "corner_light": False,
        }  # fmt: skip
        return SimpleNamespace(**values | errors)

    monkeypatch.setattr(module, "errors_of", errors_of)
    monkeypatch.setattr(module, "instrument_error", lambda target: 5e-4)
    run = method_of("kept", returning(target), keeps_one_frequency=keeps_one_frequency)
    return module._row(run, target, interval)


@pytest.fixture
def channel(target: xr.Dataset) -> xr.Dataset:
    """Return a channel in which all samples are good."""
    part = target.sel(polarization=["VH"]).copy(deep=True)
    part["quality_flag"].values[:] = 0
    part["water_residual_cause"].values[:] = 0
    return part


def test_a_row_sums_up_the_errors_of_its_pixels(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    bias, noise = np.arange(20) * 1e-3, (np.arange(20) + 5) * 1e-3
    noise[3] = np.nan
    found = evaluated(monkeypatch, channel, bias=bias, noise=noise, own_noise=noise / 2)
    assert (found.row.method, found.row.polarization) == ("kept", "VH")
    assert found.row.bias == pytest.approx(np.sqrt(np.mean(bias**2)))
    assert found.row.noise == pytest.approx(np.nanmedian(noise))
    assert found.own_noise == pytest.approx(np.nanmedian(noise) / 2)
    assert found.row.instrument == 5e-4
    shares = found.row.usable, found.row.flagged, found.row.trusted
    assert shares == (1.0, 0.0, 1.0)
    assert (found.row.caution, found.row.note) == (Caution.NONE, "")
    assert_array_equal(found.path, np.arange(20).reshape(4, 5) + 1.0)
    # 20 and 50 MHz repeat together after the path of 20 MHz.
    assert found.repeat == pytest.approx(299792458.0 / 20e6)


def test_flagged_pixels_do_not_count_where_there_are_others(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel["quality_flag"].values[:, 0, 0] = QualityFlag.WATER_RESIDUAL
    channel["quality_flag"].values[:, 0, 1] = QualityFlag.NO_TARGET
    bias = np.full(15, 1e-3)
    bias[:5] = 1.0
    agree = np.ones(15, bool)
    agree[6] = False
    mixed, corner = np.zeros(15, bool), np.zeros(15, bool)
    mixed[7], corner[8] = True, True
    found = evaluated(
        monkeypatch, channel, bias=bias, agree=agree, mixed=mixed, in_corner=corner,
        **{name: np.full(15, 2e-3) for name in ("noise", "own_noise")},
        path=np.arange(15) + 1.0,
    )  # fmt: skip
    assert found.row.usable == 0.75
    # Five by the water, five without a target, one mixed beam and one corner.
    assert found.row.flagged == pytest.approx(12 / 20)
    # One of the eight others does not agree.
    assert found.row.trusted == pytest.approx(7 / 20)
    assert np.isfinite(found.path).sum() == 7
    assert found.row.bias == pytest.approx(1e-3)
    channel["quality_flag"].values[:, 0, 0] = 0
    flags = channel["quality_flag"].values
    flags[:] = np.where(flags == 0, QualityFlag.WATER_RESIDUAL, flags)
    found = evaluated(
        monkeypatch, channel, bias=bias,
        **{name: np.full(15, 2e-3) for name in ("noise", "own_noise")},
        agree=np.ones(15, bool), path=np.ones(15), mixed=np.zeros(15, bool),
        in_corner=np.zeros(15, bool),
    )  # fmt: skip
    assert found.row.bias == pytest.approx(np.sqrt(np.mean(bias**2)))
    assert found.row.trusted == 0.0


def test_a_row_without_usable_pixels_has_no_error(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    channel["quality_flag"].values[:] = QualityFlag.NO_TARGET
    found = evaluated(monkeypatch, channel)
    assert found.row.caution is Caution.NO_PIXEL
    assert found.row.note == "no pixel shows a target"
    assert np.isnan([found.row.bias, found.row.noise, found.own_noise]).all()
    assert np.isnan(found.path).all()
    shares = found.row.usable, found.row.flagged, found.row.trusted
    assert shares == (0.0, 1.0, 0.0)
    nothing = evaluated(
        monkeypatch,
        channel.assign(quality_flag=0 * channel["quality_flag"]),
        noise=np.full(20, np.nan),
    )
    assert np.isnan([nothing.row.noise, nothing.own_noise]).all()
    assert nothing.row.bias == pytest.approx(3e-3)


@pytest.mark.parametrize("unknown", ["flag", "bias"])
def test_water_of_unknown_amount_makes_the_bias_infinite(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch, unknown: str
) -> None:
    errors = {}
    if unknown == "flag":
        channel["quality_flag"].values[0, 0, 1, 1] = QualityFlag.NO_OPEN_WATER
    else:
        errors["bias"] = np.append(np.zeros(19), np.nan)
    found = evaluated(monkeypatch, channel, **errors)
    assert found.row.bias == np.inf
    assert found.row.caution is Caution.BIAS_UNKNOWN
    assert found.row.note == "nothing tells how much water is left in"


@pytest.mark.parametrize("corners", [False, True])
def test_a_contradiction_names_the_instrument_and_corners(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch, corners: bool
) -> None:
    channel["water_residual_cause"].values[1, 0, 2, 2] = (
        WaterResidualCause.INSTRUMENT | WaterResidualCause.PHASE_SHIFT
    )
    found = evaluated(monkeypatch, channel, corner_light=corners)
    assert found.row.caution is Caution.INSTRUMENT
    begin = "no water explains the open-water shots and the scan together, so "
    middle = "corners reflect light twice" if corners else "the instrument has an error"
    assert found.row.note.startswith(begin + middle)
    assert found.row.note.endswith("calibrate the phase against amplitude")
    plain = evaluated(
        monkeypatch, channel.drop_vars("water_residual_cause"), corner_light=corners
    )
    assert plain.row.caution is Caution.NONE


def test_one_frequency_repeats_within_a_long_interval(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = channel.isel(modulation_frequency=[0])
    repeat = 299792458.0 / (2 * 1.38 * 20e6)
    for length, caution, note in (
        (0.999 * repeat, Caution.NONE, ""),
        (1.001 * repeat, Caution.AMBIGUOUS, "repeats after 5.43 m"),
    ):
        interval = (0.5, 0.5 + length)
        found = evaluated(monkeypatch, one, interval, keeps_one_frequency=True)
        assert (found.row.caution, found.row.note) == (caution, note)
        several = evaluated(monkeypatch, one, interval)
        assert several.row.caution is Caution.NONE
    assert evaluated(
        monkeypatch, one, keeps_one_frequency=True
    ).row.caution is Caution.NONE  # fmt: skip


@pytest.mark.parametrize("by", ["usable", "sound"])
def test_pixels_without_neighbors_are_lone(
    channel: xr.Dataset, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    lone = np.zeros((4, 5), bool)
    lone[0, 0] = lone[2, 2] = lone[0, 4] = True
    flag = QualityFlag.NO_TARGET if by == "usable" else QualityFlag.WATER_RESIDUAL
    channel["quality_flag"].values[:] = np.where(lone, 0, flag)
    count = 3 if by == "usable" else 20
    found = evaluated(monkeypatch, channel, path=np.ones(count))
    assert found.row.caution is Caution.LONE_PIXELS
    assert found.row.note == "no pixel that it trusts has a neighbor"
    assert found.row.trusted == 0.0
    channel["quality_flag"].values[:, :, 0, 1] = 0
    found = evaluated(monkeypatch, channel, path=np.ones(count + (by == "usable")))
    assert found.row.caution is Caution.NONE
    assert found.row.trusted == pytest.approx(2 / 20)
