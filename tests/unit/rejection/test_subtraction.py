"""Subtraction of open water, with water and targets given by the test."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import WaterResidualCause
from amulor.rejection import subtraction as module
from amulor.rejection.covariance import Covariance, along
from amulor.rejection.observation import Observation
from amulor.rejection.reference.before_target import Strength
from amulor.rejection.subtraction import SubtractionFit, subtract_open_water

Make = Callable[..., xr.Dataset]
CHANNELS = {"VV": (1.0, 1.0), "VH": (0.3, 0.1)}


def covariance(shape: tuple[int, ...], size: float) -> Covariance:
    return Covariance(
        np.full(shape, size**2), np.full(shape, 2 * size**2), np.full(shape, 0.0)
    )


class Case:
    """A scan with water and targets by hand, and the subtraction of it."""

    def __init__(
        self,
        by_hand: Make,
        monkeypatch: pytest.MonkeyPatch,
        *,
        frequencies: int = 2,
        hidden: complex | None = 0.2 + 0.1j,
        survey_error: bool = False,
        strength: Strength | None = None,
    ) -> None:
        cube = by_hand(
            frequency=[20e6, 50e6][:frequencies], channels=CHANNELS, shape=(2, 3)
        )
        self.scan = Observation(cube=cube)
        shape = self.scan.signal.shape
        rng = np.random.default_rng(1)
        turned = rng.uniform(0.2, 0.4, shape) * np.exp(1j * rng.uniform(0, 1, shape))
        self.open_water: Any = turned
        self.hidden: Any = None
        if hidden is not None:
            self.hidden = np.full(shape, hidden)
            self.hidden[..., 1, 2] = np.nan
        self.before = (1 - np.nan_to_num(0 if hidden is None else self.hidden)) * turned
        self.drift = np.array([0.02, 0.03j])[:frequencies].reshape(-1, 1, 1, 1)
        self.strength = strength or Strength(change=0.1, uncertainty=0.03)
        self.has_target = np.array([[True, True, False], [True, True, True]])
        self.error = covariance(shape, 3e-3)
        water: Any = SimpleNamespace(
            difference=self.scan.signal - turned,
            to_the_end=turned,
            hidden_fraction=self.hidden,
            hidden_error=self.error if survey_error else None,
            signal=self.before,
            drift=self.drift * np.ones((1, shape[1], 1, 1)),
            fluctuation=covariance(shape, 1e-3),
            common=covariance(shape, 2e-3),
            path=np.full((2, 3), 4.0),
            turbidity=None,
            fit="water",
        )
        self.given: dict[str, Any] = {}

        def before_target(scan: Any, **options: Any) -> Any:
            self.given.update(options)
            return water

        def shows(scan: Any, water: Any, **options: Any) -> Any:
            return self.has_target, "cut", np.full((2, 3), 0.5)

        monkeypatch.setattr(module, "water_before_target", before_target)
        monkeypatch.setattr(module, "shows_target", shows)
        monkeypatch.setattr(module, "late_phase", lambda *_: None)
        monkeypatch.setattr(module, "strength_of", self._strength_of)
        self.asked: list[Any] = []

    def _strength_of(self, *arrays: Any, **options: Any) -> Strength:
        self.asked.append((arrays, options))
        return self.strength

    def run(self, **options: Any) -> Any:
        return subtract_open_water(self.scan, **options)


def same(found: Covariance, expected: Covariance) -> None:
    for a, b in zip(vars(found).values(), vars(expected).values(), strict=True):
        assert_allclose(a, b, rtol=1e-9, atol=1e-15)


def test_the_column_behind_a_target_is_added_back(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(by_hand, monkeypatch)
    found = case.run(interval=(1.0, 2.0), column_uncertainty=0.2)
    column = np.nan_to_num(case.hidden) * case.open_water
    after = case.scan.signal - case.open_water + column
    # A tenth more water than the shots is subtracted, of that before the target.
    assert_allclose(found.target, after - 0.1 * case.before)
    assert_allclose(found.water_signal, case.open_water - column + 0.1 * case.before)
    # Nothing is left where the distance is known.
    known = np.isfinite(case.hidden)
    assert_array_equal(found.residual[known], 0.0)
    assert np.isnan(found.residual[~known]).all()
    assert found.put_back
    same(found.column, along(column, 0.2))
    change = along(case.drift * case.before, 12**-0.5) + along(case.before, 0.03)
    same(found.change, change)
    same(found.counting, case.scan.covariance)
    same(found.fluctuation, covariance(column.shape, 1e-3))
    same(found.reference, covariance(column.shape, 2e-3))
    same(found.independent, found.counting + found.fluctuation)
    same(found.of_water, found.column + found.change)
    same(found.shared, found.reference + found.column + found.change)
    # A stated error of the column says that the survey is right.
    assert case.given["survey_is_right"] is True
    assert case.given["interval"] == (1.0, 2.0)
    assert_array_equal(found.has_target, case.has_target)
    assert_array_equal(found.tests["no_target_probability"], 0.5)
    assert "channel_disagreement" in found.tests
    assert found.fit.water == "water"
    assert found.fit.cut == "cut"
    assert found.fit.strength is case.strength
    # The strength is that of the samples with the column, and of its errors.
    ((target, water, independent, common), options) = case.asked[0]
    assert_allclose(target, after)
    assert water is case.before
    same(independent, found.counting + found.fluctuation)
    drift = along(case.drift * case.before, 12**-0.5)
    same(common, found.reference + found.column + drift)
    assert_array_equal(options["modulation_frequency"], [20e6, 50e6])


def test_a_survey_that_is_corrected_has_its_own_error(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(by_hand, monkeypatch, survey_error=True)
    same(case.run().column, case.error)
    assert case.given["survey_is_right"] is False


def test_a_column_that_stays_out_is_the_residual(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(by_hand, monkeypatch)
    found = case.run(put_back=False)
    difference = case.scan.signal - case.open_water
    assert_allclose(found.target, difference - 0.1 * case.before)
    assert_allclose(found.water_signal, case.open_water + 0.1 * case.before)
    assert_allclose(found.residual, -case.hidden * case.open_water)
    assert not found.put_back
    same(found.column, covariance(difference.shape, 0.0))
    # Its part is no change of the water.
    column = np.nan_to_num(case.hidden) * case.open_water
    assert_allclose(case.asked[0][0][0], difference + column)


def test_without_a_survey_no_column_is_known(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(by_hand, monkeypatch, hidden=None)
    for put_back in (True, False):
        found = case.run(put_back=put_back)
        difference = case.scan.signal - case.open_water
        assert_allclose(found.target, difference - 0.1 * case.before)
        assert found.residual is None
        assert not found.put_back
        assert "column_over_target" not in found.tests


def test_half_of_an_untested_change_is_subtracted(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    untested = Strength(change=0.3, uncertainty=0.04, is_untested=True)
    case = Case(by_hand, monkeypatch, hidden=None, strength=untested)
    found = case.run()
    difference = case.scan.signal - case.open_water
    assert_allclose(found.target, difference - 0.15 * case.before)
    change = along(case.drift * case.before, 12**-0.5)
    same(found.change, change + along(case.before, np.hypot(0.04, 0.3)))


def test_a_strong_column_is_doubted_with_one_frequency(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(by_hand, monkeypatch, frequencies=1)
    found = case.run()
    column = np.nan_to_num(case.hidden) * case.open_water
    # At least the median of the scan, in the weakest channel.
    usual = np.array([np.median(np.abs(part)[np.abs(part) > 0]) for part in column[0]])
    target = case.scan.signal - case.open_water + column
    size = np.maximum(np.abs(column), usual[None, :, None, None])
    ratio = (size / np.abs(target)).max(axis=(0, 1))
    assert_allclose(found.tests["column_over_target"], ratio)
    assert_allclose(found.fit.usual_column, usual[None])
    strong = (found.cause & WaterResidualCause.STRONG_COLUMN) != 0
    assert_array_equal(strong, ratio > 0.3)
    assert strong.any()
    # Rows of the scan have its median.
    fit = SubtractionFit(**vars(found.fit) | {"usual_column": 100 * usual[None]})
    rows = case.run(fit=fit)
    assert ((rows.cause & WaterResidualCause.STRONG_COLUMN) != 0).all()
    assert len(case.asked) == 1
    several = Case(by_hand, monkeypatch).run()
    assert "column_over_target" not in several.tests
    assert several.fit.usual_column is None


def test_rows_take_what_was_fitted_to_the_scan(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(by_hand, monkeypatch)
    whole = case.run()
    gain = 7.0 * np.ones_like(whole.fit.phase_error_gain)
    fit = SubtractionFit(**vars(whole.fit) | {"phase_error_gain": gain})
    rows = case.run(fit=fit)
    assert len(case.asked) == 1
    assert rows.fit.phase_error_gain is gain
    assert rows.fit.strength is whole.fit.strength
    assert rows.fit.disagreement == whole.fit.disagreement
    assert rows.fit.channel_phase is whole.fit.channel_phase
    assert case.given["fit"] == "water"
    assert_allclose(rows.target, whole.target)


def test_readings_in_turn_tell_no_change_of_the_water(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = Case(by_hand, monkeypatch)
    still = case.run()
    assert still.fit.channel_phase is not None
    monkeypatch.setattr(Observation, "reads_in_turn", True)
    moving = case.run()
    assert len(case.asked) == 1
    # The water may depart by two percent unseen.
    assert moving.fit.strength == Strength(change=0.0, uncertainty=0.02)
    assert moving.fit.channel_phase is None
    rows = case.run(fit=still.fit)
    assert rows.fit.strength is case.strength
    assert rows.fit.channel_phase is still.fit.channel_phase


@pytest.mark.parametrize("value", [-0.01, 1.01])
def test_a_fraction_of_the_column_lies_between_0_and_1(
    by_hand: Make, monkeypatch: pytest.MonkeyPatch, value: float
) -> None:
    case = Case(by_hand, monkeypatch)
    with pytest.raises(ValueError) as refusal:  # noqa: PT011
        case.run(column_uncertainty=value)
    assert str(refusal.value) == (
        "column_uncertainty must lie between 0 and 1 (a fraction of the water behind "
        f"the target), got {value:g}"
    )
    for limit in (0.0, 1.0):
        case.run(column_uncertainty=limit)


def test_the_usual_column_is_the_median_of_those_that_are_not_zero() -> None:
    column = np.zeros((1, 2, 2, 3), dtype=complex)
    column[0, 0, 0] = [3j, 0.0, -1.0]
    column[0, 0, 1] = [0.0, 4.0, 0.0]
    assert_allclose(module._usual_size(column), [[3.0, 0.0]])
