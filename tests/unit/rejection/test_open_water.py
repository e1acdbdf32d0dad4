"""Open water: drift, a reference of other water, the column that is put back."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor import imaging, rejection
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.rejection.observation import Observation
from amulor.rejection.subtraction import subtract_open_water
from amulor.simulation import simulate
from amulor.survey import Survey

ONE = {"VV": (1.0, 1.0)}
Make = Callable[..., xr.Dataset]


def test_a_drift_is_measured_and_counts_as_an_error(by_hand: Make) -> None:
    steady = rejection.open_water(by_hand(frequency=[39e6], channels=ONE))
    moving = rejection.open_water(by_hand(frequency=[39e6], channels=ONE, drift=0.1))
    found = moving.attrs["open_water_drift"].item()
    stated = moving.attrs["open_water_drift_uncertainty"].item()
    assert abs(found - 0.1) < 4 * stated
    assert stated < 0.03
    names = ("common_in_phase_uncertainty", "common_quadrature_uncertainty")
    size = [
        np.sqrt(sum(np.mean(cube[name].values ** 2) for name in names))
        for cube in (steady, moving)
    ]
    # Spread evenly over 10 % of the water signal, 0.2 / sqrt(1 + 1.3^2); one sample
    # cannot tell whether the water departs from its shots, by 2 % as is expected.
    water = 0.2 / np.hypot(1, 39 / 30)
    assert size[0] == pytest.approx(0.02 * water, rel=0.05)
    expected = np.hypot(size[0], 0.1 / np.sqrt(12) * water)
    assert size[1] == pytest.approx(expected, rel=0.2)


def test_a_drift_is_stated_as_an_error_and_is_no_reason_for_a_flag(
    by_hand: Make,
) -> None:
    cube = by_hand(frequency=[39e6], channels=ONE, drift=0.15, water=0.6)
    found = rejection.open_water(cube)
    assert not found["quality_flag"].values.any()
    # Wherever the water stood between the shots, 1.74 standard errors reach there.
    stated = np.hypot(
        found["common_in_phase_uncertainty"], found["common_quadrature_uncertainty"]
    )
    half = 0.15 / 2 * 0.6 / np.hypot(1, 39 / 30)
    assert (1.74 * stated > half).all()


def test_water_that_changed_too_much_is_refused_with_the_remedy(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels=ONE, drift=0.5)
    with pytest.raises(CubeError, match=r"changed by 5\d% .* record the reference"):
        rejection.open_water(cube)


def test_a_change_beyond_that_of_water_is_called_leakage(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels=ONE, drift=3.0)
    with pytest.raises(CubeError, match="leakage that drifts"):
        rejection.open_water(cube)


def test_steady_water_is_not_taken_for_a_drift(by_hand: Make) -> None:
    # 40 scans at a chance of 1 in 1000 each: two alarms would be 1 in 1300.
    alarms = 0
    for seed in range(40):
        cube = by_hand(seed, frequency=[39e6], channels=ONE, shape=(1, 2))
        common = rejection.open_water(cube)["common_quadrature_uncertainty"].values
        # What is expected without any drift is 2 % of 0.2 / sqrt(1 + 1.3^2).
        alarms += bool(common.max() > 2.6e-3)
    assert alarms <= 1


def test_a_shot_without_a_number_is_left_out(by_hand: Make) -> None:
    cube = by_hand(frequency=[39e6], channels=ONE)
    missing = cube.copy(deep=True)
    for name in ("in_phase", "quadrature"):
        missing[f"open_water_{name}"].values[..., 1] = np.nan
    others = [shot for shot in range(cube.sizes["shot"]) if shot != 1]
    found, expected = map(rejection.open_water, (missing, cube.isel(shot=others)))
    for name in ("in_phase", "quadrature", "in_phase_uncertainty"):
        assert_allclose(found[name], expected[name], rtol=1e-12)


def test_a_reference_of_other_water_is_seen_where_there_is_no_target(
    by_hand: Make,
) -> None:
    cube = by_hand(
        frequency=[10e6, 39e6, 90e6], channels=ONE, target=0.0, reference_water=0.15
    )
    flag = rejection.open_water(cube)["quality_flag"].values
    assert ((flag & QualityFlag.WATER_RESIDUAL) != 0)[0].all()
    same = by_hand(frequency=[10e6, 39e6, 90e6], channels=ONE, target=0.0)
    flag = rejection.open_water(same)["quality_flag"].values
    assert ((flag & QualityFlag.NO_TARGET) != 0).mean() > 0.99
    assert not (flag & QualityFlag.WATER_RESIDUAL).any()


@settings(max_examples=20)
@given(distance=st.floats(0.5, 3.0))
def test_a_target_is_not_taken_for_other_water(by_hand: Make, distance: float) -> None:
    cube = by_hand(frequency=[10e6, 39e6, 90e6], channels=ONE, distance=distance)
    flag = rejection.open_water(cube)["quality_flag"].values
    assert not (flag & QualityFlag.WATER_RESIDUAL).any()


def test_the_column_behind_the_target_is_put_back(plate_text: str) -> None:
    # Near target, still water, hardly any noise: what is left is the column.
    text = plate_text.replace('signal_fluctuation = "5 %"', "")
    text = text.replace('"0.06 deg"', '"0 deg"').replace('"20 mW"', '"2e4 W"')
    text = text.replace('"10 %"', '"10 %"\nsaturation = "1e20 V"')
    text = text.replace('"1.5 m"', '"1 m"')
    cube = simulate(Survey.from_text(text), rng=1)
    error, bias = {}, {}
    for name, options in {
        "stated": {"put_back": False},
        "from the shots": {},
        "from the survey": {"column_uncertainty": 0.2},
    }.items():
        target = rejection.open_water(cube, **options)
        assert ("put back" in target.attrs["history"]) == (name != "stated")
        image = imaging.range_image(target, polarization="VV")
        found = abs(image["slant_range"] - image["truth_slant_range"])
        error[name], bias[name] = float(found.mean()), image["slant_range_bias"]
    # The share follows from a distance that the column itself has moved by a percent.
    assert error["stated"] > 1e-3
    for name in ("from the shots", "from the survey"):
        assert error[name] < error["stated"] / 30
        assert float(abs(bias[name]).max()) < 1e-12
    off = float(abs(bias["stated"]).mean()) - error["stated"]
    assert abs(off) < 0.05 * error["stated"]


@pytest.mark.parametrize(
    "believed",
    [
        pytest.param(0.5, marks=pytest.mark.slow),
        pytest.param(1.0, marks=pytest.mark.slow),
        2.0,
    ],
)
def test_the_shots_correct_a_survey_of_other_water(
    plate_text: str, believed: float
) -> None:
    cube = simulate(Survey.from_text(plate_text), rng=2)
    text = plate_text.replace('"0.255 1/m"', f'"{0.255 * believed} 1/m"')
    text = text.replace('"0.595 1/m"', f'"{0.595 * believed} 1/m"')
    wrong = cube.assign_attrs(survey=Survey.from_text(text).to_toml())
    found = rejection.open_water(wrong)
    factor = found.attrs["open_water_turbidity"]
    sigma = found.attrs["open_water_turbidity_uncertainty"]
    # One frequency: the phase of the water says how deep its light comes from.
    assert abs(factor * believed - 1) < 4 * sigma * believed
    assert sigma * believed < 0.2


@pytest.mark.slow
def test_what_is_put_back_keeps_its_share_as_an_error(plate: Survey) -> None:
    cube = simulate(plate, rng=3)
    stated = rejection.open_water(cube, column_uncertainty=0.0, put_back=False)
    left = stated["residual_in_phase"].values + 1j * stated["residual_quadrature"]
    unsure = subtract_open_water(Observation(cube=cube), column_uncertainty=0.5)
    assert_allclose(unsure.column.in_phase, (0.5 * left.real) ** 2, rtol=1e-9)
    assert_allclose(unsure.column.quadrature, (0.5 * left.imag) ** 2, rtol=1e-9)
    # Put back: the water taken out is less by it, and none is left.
    taken = cube.amulor.signal.values - unsure.target
    strength = 1 + unsure.fit.strength.change
    whole = unsure.water.to_the_end + left.values
    assert_allclose(taken, strength * whole, rtol=1e-9)
    assert unsure.residual is not None
    assert (unsure.residual == 0).all()


@pytest.mark.parametrize("share", [-0.1, 1.5, np.nan])
def test_an_odd_share_is_refused(plate: Survey, share: float) -> None:
    with pytest.raises(ValueError, match="between 0 and 1"):
        rejection.open_water(simulate(plate, rng=1), column_uncertainty=share)
