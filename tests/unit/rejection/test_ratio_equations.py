"""Depolarization ratios and their errors by written-out sums, with their limits."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import rejection
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.rejection.ratios import (
    Ratio,
    _line,
    _weighted_mean,
    possible,
    ratio_of,
    stated_uncertainty,
)

Make = Callable[..., xr.Dataset]
FREQUENCIES = [20e6, 60e6]
PAIR = {"VV": (1.0, 1.0), "VH": (0.25, 0.1)}


def left(
    make: Make,
    light: np.ndarray,
    noise: np.ndarray,
    common: np.ndarray,
    flag: np.ndarray | None = None,
) -> xr.Dataset:
    """Return a target signal with light, noise and common errors that are given.

    Over (pair, frequency, row, column).
    """
    cube = rejection.open_water(make(1, frequency=FREQUENCIES, channels=PAIR))
    order = [cube.amulor.polarizations.index(name) for name in ("VV", "VH")]

    def filled(values: np.ndarray) -> xr.DataArray:
        result = cube["in_phase"].copy(deep=True)
        for pair, place in enumerate(order):
            result.values[:, place] = values[pair]
        return result

    total = np.hypot(noise, common)
    zero = 0.0 * cube["in_phase"]
    return cube.assign(
        in_phase=filled(light.real),
        quadrature=filled(light.imag),
        in_phase_uncertainty=filled(1.2 * total),
        quadrature_uncertainty=filled(0.8 * total),
        in_phase_quadrature_covariance=zero,
        common_in_phase_uncertainty=filled(1.2 * common),
        common_quadrature_uncertainty=filled(0.8 * common),
        common_covariance=zero,
        quality_flag=cube["quality_flag"].copy(
            data=np.zeros(zero.shape, np.int16) if flag is None else flag
        ),
    )


SHAPE = 2, 2, 6, 8


def drawn(seed: int, *, askew: float = 0.0, spread: float = 0.0) -> tuple[Any, ...]:
    """Return light of both channels with noise, its deviation and common errors."""
    rng = np.random.default_rng(seed)
    noise = rng.uniform(0.01, 0.03, SHAPE)
    common = np.full(SHAPE, 0.001) * [[[[1.0]]], [[[0.5]]]]
    first = rng.uniform(0.7, 1.3, SHAPE[1:]) * np.exp(
        1j * rng.uniform(-3, 3, SHAPE[1:])
    )
    ratio = 0.25 + spread * rng.choice([-1, 1], SHAPE[1:]) + 1j * askew
    draws = rng.standard_normal((2, *SHAPE))
    size = noise * np.sqrt(1.04)
    light = np.stack([first, ratio * first]) + size * (draws[0] + 1j * draws[1])
    return light, noise, common


@pytest.mark.parametrize(
    ("askew", "spread"), [(0.0, 0.0), (0.05, 0.0), (0.0, 0.1), (0.07, 0.06)]
)
def test_the_ratio_of_targets_is_that_of_written_out_sums(
    by_hand: Make, askew: float, spread: float
) -> None:
    light, noise, common = drawn(3, askew=askew, spread=spread)
    found = ratio_of(left(by_hand, light, noise, common))
    a, b = (part.ravel() for part in light)
    # Of one output: the mean of 1.44 and 0.64.
    va, vb = (1.04 * part.ravel() ** 2 for part in noise)
    value = 0.0
    for _ in range(3):
        weight = 1 / (vb + value**2 * va)
        power = np.sum(weight * (np.abs(a) ** 2 - 2 * va))
        value = float(np.sum(weight * (a.conj() * b).real) / power)
    assert found.value == pytest.approx(value, rel=1e-9)
    off = (a.conj() * (b - value * a)).real
    random = np.sqrt(np.sum((weight * off) ** 2)) / power
    share = weight * np.abs(a) ** 2 / np.sum(weight * np.abs(a) ** 2)
    expected = (vb + value**2 * va) / np.abs(a) ** 2
    excess = np.sum(share * ((off / np.abs(a) ** 2) ** 2 - expected))
    # Twice what chance makes of it.
    chance = np.sum(share**2 * 2 * expected**2) ** 0.25
    scatter = np.sqrt(max(excess, 0)) if excess > 4 * chance**2 else 0.0
    assert (scatter > 0) == (spread > 0)
    ca, cb = (np.sqrt(1.04) * part.ravel() / np.abs(a) for part in common)
    shared = np.hypot(np.sum(share * cb), value * np.sum(share * ca))
    across = abs(np.sum(weight * (a.conj() * b).imag)) / power
    across = across if across > 4 * np.hypot(random, shared) else 0.0
    assert (across > 0) == (askew > 0)
    total = np.sqrt(random**2 + scatter**2 + shared**2 + across**2)
    assert found.uncertainty == pytest.approx(total, rel=1e-9)
    assert found.source == "48 pixels that show a target"
    # The part across at each frequency, where it is more than chance.
    assert found.across is not None
    for k in range(2):
        part = slice(48 * k, 48 * k + 48)
        w, x, y = weight[part], a[part], b[part]
        bottom = np.sum(w * (np.abs(x) ** 2 - 2 * va[part]))
        turned = np.sum(w * (x.conj() * y).imag) / bottom
        error = np.sqrt(np.sum((w * (x.conj() * y).imag) ** 2)) / bottom
        sure = abs(turned) > 4 * np.hypot(error, shared)
        assert found.across[k] == pytest.approx(turned if sure else 0.0, rel=1e-9)


def test_flagged_samples_do_not_count(by_hand: Make) -> None:
    light, noise, common = drawn(4)
    flag = np.zeros((2, 2, 6, 8), dtype=np.int16)
    # In one channel only; the frequencies differ in their pixels.
    flag[0, 1, 0] = rejection_flag("NO_TARGET")
    flag[1, 0, :, 0] = rejection_flag("SATURATED")
    found = ratio_of(left(by_hand, light, noise, common, flag))
    spoiled = light.copy()
    spoiled[1, 0, 0], spoiled[0, 1, :, 0] = 7.0, 7j
    assert ratio_of(left(by_hand, spoiled, noise, common, flag)) is not found
    again = ratio_of(left(by_hand, spoiled, noise, common, flag))
    assert again.value == found.value
    # A pixel that shows a target at one frequency is one: all but their corner.
    assert found.source == "47 pixels that show a target"


def rejection_flag(name: str) -> int:
    return int(QualityFlag[name])


@pytest.mark.parametrize(("count", "refused"), [(4, True), (5, False)])
def test_five_samples_with_a_target_are_needed(
    by_hand: Make, count: int, refused: bool
) -> None:
    light, noise, common = drawn(5)
    flag = np.full((2, 2, 6, 8), rejection_flag("NO_TARGET"), dtype=np.int16)
    flag.transpose(1, 0, 2, 3).reshape(2, -1)[:, :count] = 0
    flag[:, :, 0, :count] = rejection_flag("NO_TARGET")
    flag[0, :, 0, :count] = 0
    cube = left(by_hand, light, noise, common, flag)
    if not refused:
        assert ratio_of(cube).source == "5 pixels that show a target"
        return
    with pytest.raises(CubeError, match="4 samples show a target in both VV and VH"):
        ratio_of(cube)


@pytest.mark.parametrize(
    ("value", "expected"),
    [(0.3, 0.3), (-0.0399, 0.0), (1.0399, 1.0), (-0.0401, None), (1.0401, None),
     (np.nan, None)],
)  # fmt: skip
def test_ratios_beyond_four_standard_uncertainties_are_not_possible(
    value: float, expected: float | None
) -> None:
    ratio = Ratio(value, 0.01, "shots")
    if expected is not None:
        assert possible(ratio, name="water_ratio") == expected
        return
    with pytest.raises(CubeError, match="--water-ratio"):
        possible(ratio, name="water_ratio")


def test_a_channel_in_quadrature_is_leakage_beyond_four_errors() -> None:
    rng = np.random.default_rng(6)
    first = np.full(16, 2.0) * np.exp(0.7j)
    noise = 0.01 * rng.standard_normal(16)
    noise -= noise.mean()
    error = noise.std(ddof=1) / 4 / 2
    for factor in (3.99, -4.01, 4.01):
        second = (0.5 + noise + 2j * factor * error) * np.exp(0.7j)
        value, uncertainty, across = _line(first, second)
        sure = abs(factor) > 4
        assert value == pytest.approx(0.25)
        assert across == pytest.approx(factor * error if sure else 0.0)
        expected = error * np.hypot(1, factor if sure else 0)
        assert uncertainty == pytest.approx(expected)


def test_a_mean_without_errors_has_equal_weights() -> None:
    value, error = _weighted_mean(np.array([1.0, 2.0, 6.0]), np.array([0.1, 0.0, 0.3]))
    assert value == pytest.approx(3.0)
    assert error == 0.3
    # One value has its own error.
    value, error = _weighted_mean(np.array([2.0]), np.array([0.1]))
    assert value == pytest.approx(2.0)
    assert error == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("attributes", "phase", "crosstalk", "gain"),
    [
        ({}, None, 0.01, 0.03),
        ({}, 1e-3, 0.0, 0.0),
        ({"channel_crosstalk_uncertainty": 2e-3,
          "channel_gain_uncertainty": [1e-3, 4e-3]}, None, 2e-3, 4e-3),
    ],
)  # fmt: skip
def test_stated_ratios_have_the_errors_of_their_channels(
    attributes: dict[str, Any], phase: float | None, crosstalk: float, gain: float
) -> None:
    instrument = SimpleNamespace(phase_uncertainty=phase)
    survey = SimpleNamespace(instrument=instrument)
    cube: Any = SimpleNamespace(attrs=attributes, amulor=SimpleNamespace(survey=survey))
    found = stated_uncertainty(cube, 0.4, 0.02)
    # (r + x) / (1 + y r) by x and by y.
    expected = [0.02, crosstalk, crosstalk * 0.4**2, 0.4 * gain]
    assert found == pytest.approx(np.linalg.norm(expected))
    bare: Any = SimpleNamespace(attrs={}, amulor=SimpleNamespace(survey=None))
    assert stated_uncertainty(bare, 0.4, 0.02) == pytest.approx(0.02)


def test_a_phase_between_channels_turns_the_difference(by_hand: Make) -> None:
    cube = by_hand(frequency=FREQUENCIES, channels=PAIR, noise=1e-4)
    words: dict[str, Any] = {"water_fluctuation": 0.0}
    module: Any = importlib.import_module("amulor.rejection.polarization")
    plain = rejection.polarization(cube, **words)
    ratio = rejection.water_ratio(cube)
    across = np.array([0.01, -0.02])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            module.ratios, "water_ratio", lambda cube: Ratio(
                ratio.value, ratio.uncertainty, ratio.source, across
            )
        )  # fmt: skip
        turned = rejection.polarization(cube, **words)
    water = turned["water_in_phase"].values + 1j * turned["water_quadrature"].values
    contrast = turned.attrs["target_ratio"] - turned.attrs["water_ratio"]
    move = 1j * across[:, None, None, None] * water / contrast
    for part, values in (("in_phase", move.real), ("quadrature", move.imag)):
        name = f"common_{part}_uncertainty"
        added = turned[name].values ** 2 - plain[name].values ** 2
        assert_allclose(added, values**2, rtol=1e-3, atol=1e-9)
