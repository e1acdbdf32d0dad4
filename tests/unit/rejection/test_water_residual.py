"""Cause of WATER_RESIDUAL: stored for each test, with the number that it compared."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import imaging, io, rejection, samples
from amulor.cube import QualityFlag, WaterResidualCause
from amulor.errors import CubeError
from amulor.rejection.reference import before_target
from amulor.scale import image_file, reject_file
from amulor.studies.trust.methods import outcome
from amulor.studies.trust.scenes import instrument
from amulor.studies.trust.scenes import samples as trust_samples
from amulor.studies.trust.table import score
from amulor.survey import Survey

ONE = {"VV": (1.0, 1.0)}
NOISE, CUT_OFF = 2e-3, 30e6
Make = Callable[..., xr.Dataset]


def cause_of(cube: xr.Dataset) -> np.ndarray:
    """Return the causes, which are there where the flag is and nowhere else."""
    cause = cube["water_residual_cause"].values
    flagged = (cube["quality_flag"].values & QualityFlag.WATER_RESIDUAL) != 0
    np.testing.assert_array_equal(cause != 0, flagged)
    return cause


def test_a_residual_that_turns_the_phase_is_compared_with_its_error(
    by_hand: Make,
) -> None:
    cube = by_hand(frequency=[20e6, 39e6], channels=ONE, water=0.1, shots=400)
    found = rejection.frequency(cube, modulation_frequency=20e6)
    assert (cause_of(found) == WaterResidualCause.PHASE_SHIFT).all()
    signal = cube.amulor.signal.values[:1]
    turn = np.angle(signal / (signal - 0.1 / (1 - 1j * 20e6 / CUT_OFF)))
    expected = np.abs(turn) / (NOISE / np.abs(signal))
    # The error of 400 shots and their scatter are in the error, too.
    assert_allclose(found["residual_phase_ratio"], expected, rtol=0.15)
    image = imaging.range_image(found, interval=(0.5, 3))
    assert (cause_of(image) == WaterResidualCause.PHASE_SHIFT).all()
    assert_allclose(image["residual_phase_ratio"], expected[0, 0], rtol=0.15)


def test_a_column_too_strong_for_one_frequency_is_compared_with_the_target() -> None:
    cube = samples.cube("ladder").isel(row=slice(0, 12), shot=slice(0, None, 4))
    found = rejection.open_water(cube)
    cause = cause_of(found)
    strong = (cause & WaterResidualCause.STRONG_COLUMN) != 0
    assert 0 < strong.mean() < 0.5
    # The column, and what is left with it in, from subtraction that leaves it in.
    left_in = rejection.open_water(cube, put_back=False)
    column = np.nan_to_num(
        left_in["residual_in_phase"].values + 1j * left_in["residual_quadrature"].values
    )
    usual = np.array(
        [[[[np.median(each[each > 0])]] for each in np.abs(column)[0]]],
    )
    target = np.abs(left_in.amulor.signal.values - column)
    expected = (np.maximum(np.abs(column), usual) / target).max(axis=(0, 1))
    # Water that the phases find stronger than the shots is taken out after.
    assert_allclose(found["column_over_target"], expected, rtol=0.03)
    assert (expected[strong.any(axis=(0, 1))] > 0.29).all()
    good = (found["quality_flag"].values == 0).all(axis=(0, 1))
    assert (expected[good] <= 0.31).all()


def test_a_remainder_of_the_shape_of_the_water_is_compared_with_its_error(
    by_hand: Make,
) -> None:
    frequency = [10e6, 39e6, 90e6]
    cube = by_hand(
        frequency=frequency, channels=ONE, target=0.0, reference_water=0.15, shots=400
    )
    found = rejection.open_water(cube)
    flagged = cause_of(found)[0, 0] != 0
    assert (cause_of(found)[:, :, flagged] == WaterResidualCause.WATER_SHAPE).all()
    rest = 0.05 * np.sqrt(sum(1 / (1 + (f / CUT_OFF) ** 2) for f in frequency))
    significance = found["water_shape_significance"].values
    # Noise moves each by one.
    assert np.median(significance[flagged]) == pytest.approx(rest / NOISE, rel=0.1)
    assert np.isnan(significance[~flagged]).all()
    chance = found["water_shape_probability"].values[flagged]
    # The rest is noise: its probability is even from 0 to 1.
    assert chance.min() > 1e-3
    assert np.mean(chance) == pytest.approx(0.5, abs=4 * 0.29 / np.sqrt(chance.size))


def test_where_open_water_explains_the_samples_its_probability_is_kept(
    by_hand: Make,
) -> None:
    from scipy.stats import chi2

    cube = by_hand(frequency=[10e6, 39e6], channels=ONE, target=0.0, shots=2000)
    found = rejection.open_water(cube)
    chance = found["no_target_probability"].values
    f = np.array([10e6, 39e6])[:, None, None]
    water = 0.2 / (1 - 1j * f / CUT_OFF)
    off = np.abs(cube.amulor.signal.values[:, 0] - water) ** 2 / NOISE**2
    expected = chi2.sf(off.sum(axis=0), 4)
    # A common factor of the water may explain a part; the shots have errors of theirs.
    assert np.corrcoef(chance.ravel(), expected.ravel())[0, 1] > 0.8
    assert (found["quality_flag"].values & QualityFlag.NO_TARGET).all()
    seen = rejection.open_water(by_hand(frequency=[10e6, 39e6], channels=ONE))
    assert np.isnan(seen["no_target_probability"].values).all()
    size = np.abs(seen.amulor.signal.values)
    assert_allclose(seen["signal_significance"], size / NOISE, rtol=0.2)


def test_causes_and_numbers_pass_through_files_rows_and_images(tmp_path) -> None:
    # Twelve rows have pixels with and without a cause, and seven do not divide them.
    cube = samples.cube("ladder").isel(row=slice(0, 12), shot=slice(0, None, 4))
    io.write_cube(cube, tmp_path / "samples.nc")
    reject_file(tmp_path / "samples.nc", tmp_path / "target.nc", "open-water", rows=7)
    target = io.read_cube(tmp_path / "target.nc")
    cause = cause_of(target)
    assert 0 < np.mean(cause[0, 1] != 0) < 1
    image_file(tmp_path / "target.nc", tmp_path / "image.nc", rows=7, polarization="VH")
    image = io.read_cube(tmp_path / "image.nc")
    np.testing.assert_array_equal(cause_of(image), cause[0, 1])
    for name in ("no_target_probability", "column_over_target"):
        np.testing.assert_array_equal(image[name], target[name])
    meanings = image["water_residual_cause"].attrs["flag_meanings"].split()
    masks = image["water_residual_cause"].attrs["flag_masks"]
    assert dict(zip(meanings, masks.tolist(), strict=True)) == {
        "phase_shift": 1,
        "strong_column": 2,
        "water_shape": 4,
        "model_misfit": 8,
        "model_departure": 16,
        "water_changed": 32,
        "instrument": 64,
    }


@pytest.mark.parametrize(
    ("change", "uncertainty", "misfit", "expected"),
    [
        (0.0, 0.02, 0.05, 0),
        (0.25, 0.01, 0.05, 0),
        (0.6, 0.2, 0.05, 0),  # not surely beyond 0.3
        (0.6, 0.02, 0.05, WaterResidualCause.WATER_CHANGED),
        (-0.6, 0.02, 0.05, WaterResidualCause.WATER_CHANGED),
        (-1.2, 0.15, 0.05, WaterResidualCause.INSTRUMENT),
        (-3.8, 0.13, 0.05, WaterResidualCause.INSTRUMENT),
        (0.0, 0.02, 0.5, WaterResidualCause.INSTRUMENT),
    ],
)
def test_a_change_beyond_that_of_water_and_shots_unlike_water_have_a_cause(
    change: float, uncertainty: float, misfit: float, expected: int
) -> None:
    strength = before_target.Strength(change=change, uncertainty=uncertainty)
    survey = Survey.preset("amulor-2010")
    turbidity = before_target.Turbidity(
        survey=survey, factor=1.0, uncertainty=0.1, steeper=survey, misfit=misfit,
        shown=misfit,
    )  # fmt: skip
    assert before_target.contradiction(strength, turbidity) == expected
    known = 0 if misfit > before_target.LARGEST_MISFIT else expected
    assert before_target.contradiction(strength, None) == known


@pytest.mark.parametrize("shown", [0.01, 0.1])
def test_shots_that_no_turbidity_explains_have_a_cause(shown: float) -> None:
    survey = Survey.preset("amulor-2010")
    turbidity = before_target.Turbidity(
        survey=survey, factor=4.0, uncertainty=0.7, steeper=survey, misfit=0.1,
        shown=shown, is_extreme=True,
    )  # fmt: skip
    steady = before_target.Strength(change=0.0, uncertainty=0.02)
    expected = WaterResidualCause.INSTRUMENT if shown > 0.05 else 0
    assert before_target.contradiction(steady, turbidity) == expected


def test_half_of_an_untested_change_is_subtracted_with_its_whole_as_error() -> None:
    tested = before_target.Strength(change=0.4, uncertainty=0.03)
    assert (tested.subtracted, tested.error) == (0.4, 0.03)
    untested = before_target.Strength(change=0.4, uncertainty=0.03, is_untested=True)
    assert untested.subtracted == 0.2
    assert untested.error == pytest.approx(np.hypot(0.4, 0.03))


@pytest.mark.parametrize(
    "effect", [instrument.leakage(0.005), instrument.walk(1.0)], ids=["leakage", "walk"]
)
def test_a_change_that_only_one_frequency_shows_widens_the_error(
    effect: instrument.Effect,
) -> None:
    # A surprise, and no water of negative strength.
    case = instrument.with_effect(1, 1, effect=effect, phase_uncertainty=2e-3)
    result = score(case, outcome("open-water", case))
    assert result.trusted == 1
    assert result.inside_95 > 0.95
    # The stated calibration alone has 1.3 mm.
    assert result.uncertainty > 2.5e-3


def test_leakage_in_the_scan_alone_flags_all() -> None:
    case = instrument.with_effect(1, 1, effect=instrument.leakage(0.03))
    found = rejection.open_water(case.samples, interval=case.interval)
    assert found.attrs["open_water_change"] < -3
    assert (cause_of(found) & WaterResidualCause.INSTRUMENT).all()


@pytest.mark.slow
def test_auto_says_that_no_water_explains_a_leakage() -> None:
    case = instrument.with_effect(1, 1, effect=instrument.leakage(0.03))
    with pytest.raises(CubeError, match="no method can be trusted: no water explains"):
        rejection.auto(case.samples, interval=case.interval)


def test_leakage_with_a_delay_makes_shots_unlike_water() -> None:
    effect = instrument.leakage(0.03, delay=2e-9)
    case = instrument.with_effect(1, 1, effect=effect)
    found = rejection.combined(case.samples, interval=case.interval)
    assert found.attrs["open_water_misfit"] > 0.5
    assert (cause_of(found) & WaterResidualCause.INSTRUMENT).all()


def test_water_half_as_strong_again_is_another_water() -> None:
    case = trust_samples.changed_water(4, 1, change=0.5)
    found = rejection.open_water(case.samples, interval=case.interval)
    assert found.attrs["open_water_change"] == pytest.approx(0.5, abs=0.05)
    assert (cause_of(found) & WaterResidualCause.WATER_CHANGED).all()
