"""The best single frequency: found, explained, and warned about."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.studies.trust.scenes.catalogue import BY_NAME

Make = Callable[..., xr.Dataset]
ONE = {"VV": (1.0, 1.0)}
SWEEP = [float(f) * 1e6 for f in range(4, 149, 4)]


def test_the_sweep_is_that_of_the_phasors(by_hand: Make) -> None:
    cube = by_hand(frequency=SWEEP, channels=ONE, water=0.4, noise=1e-6)
    choice = rejection.choose_frequency(cube)
    f = np.array(SWEEP)
    target = np.exp(1j * 4 * np.pi * f * 1.38 * 1.5 / speed_of_light)
    water = 0.4 / (1 - 1j * f / 30e6)
    assert_allclose(choice.amplitude, abs(target + water), rtol=1e-4)
    assert_allclose(choice.ratio, abs(target + water) / abs(water), rtol=1e-4)
    assert_allclose(
        choice.contrast,
        (abs(target + water) - abs(water)) / (abs(target + water) + abs(water)),
        atol=1e-4,
    )
    shift = np.angle((target + water) / target)
    expected = abs(shift) * speed_of_light / (4 * np.pi * f * 1.38)
    assert_allclose(choice.shift, expected, rtol=2e-3, atol=1e-6)
    # The water falls like 1 / sqrt(1 + (f / 30 MHz)^2), which the fit must find.
    assert choice.cut_off == pytest.approx(30e6, rel=1e-3)
    # Interference: amplitude maxima repeat after v / 2 (d - z_w), about 72 MHz.
    assert len(choice.maxima["amplitude"]) in (1, 2)


def test_water_below_its_cut_off_pushes_the_choice_above_it(by_hand: Make) -> None:
    cube = by_hand(frequency=SWEEP, channels=ONE, water=0.4)
    choice = rejection.choose_frequency(cube)
    assert choice.above_cut_off
    assert "above the cut-off" in choice.reason
    error = np.hypot(choice.noise, choice.shift)
    best = SWEEP.index(choice.modulation_frequency)
    assert error[best] == error.min()
    # No interval was stated, so the warning names how far this frequency reaches.
    assert any(
        f"repeats after {1.0862 * 100e6 / choice.modulation_frequency:.2g}"[:14] in text
        for text in choice.warnings
    )


def test_an_interval_keeps_the_choice_where_it_is_unambiguous(by_hand: Make) -> None:
    cube = by_hand(frequency=SWEEP, channels=ONE, water=0.4)
    choice = rejection.choose_frequency(cube, interval=(0.5, 5.5))
    # 5 m need v / 2 f > 5 m, f < 21.7 MHz: below the cut-off of 30 MHz.
    assert choice.modulation_frequency <= 20e6
    assert choice.above_cut_off is False
    assert "repeat within the 5 m" in choice.reason


def test_uselessness_is_said(by_hand: Make) -> None:
    high = by_hand(frequency=[100e6, 140e6], channels=ONE)
    choice = rejection.choose_frequency(high, interval=(0.5, 4.5))
    assert any("useless without further knowledge" in w for w in choice.warnings)
    noisy = by_hand(
        frequency=[2e6], channels=ONE, noise=0.17, water=0.01, shape=(30, 30)
    )
    choice = rejection.choose_frequency(noisy)
    assert choice.cut_off is None
    assert "shows no cut-off" in choice.reason
    assert any("nothing to choose" in w for w in choice.warnings)
    near = by_hand(frequency=[10e6, 20e6], channels=ONE, water=0.5)
    choice = rejection.choose_frequency(near)
    assert any("subtract open water instead" in w for w in choice.warnings)


def test_noise_beyond_use_is_said(by_hand: Make) -> None:
    # Fluctuation is noise that no averaging of one sample removes; the target is
    # known, its phase is not.
    cube = by_hand(frequency=[39e6], channels=ONE, water=0.0, noise=0.15)
    choice = rejection.choose_frequency(cube)
    expected = 0.15 * speed_of_light / (4 * np.pi * 39e6 * 1.38)
    assert choice.noise[0] == pytest.approx(expected, rel=0.1)


def test_the_method_keeps_one_frequency_and_states_the_water(by_hand: Make) -> None:
    cube = by_hand(frequency=SWEEP, channels=ONE, water=0.02, noise=5e-3, shots=400)
    found = rejection.frequency(cube)
    cubes.check(found, "target_signal")
    one = found["modulation_frequency"].item()
    np.testing.assert_array_equal(
        found["in_phase"], cube["in_phase"].sel(modulation_frequency=[one])
    )
    left = found["residual_in_phase"].values + 1j * found["residual_quadrature"].values
    assert_allclose(left, 0.02 / (1 - 1j * one / 30e6), rtol=0, atol=2e-3)
    assert one / 1e6 == pytest.approx(
        float(found.attrs["frequency_choice"].split(" MHz")[0])
    )
    image = imaging.range_image(found, interval=(1.2, 1.8))
    score = (image["slant_range"] - image["slant_range_bias"] - 1.5) / image[
        "slant_range_uncertainty"
    ]
    # 48 pixels with a shared reference: loose.
    assert 0.6 < float(score.std()) < 1.4


def test_strong_water_is_flagged(by_hand: Make) -> None:
    cube = by_hand(frequency=[20e6, 39e6], channels=ONE, water=0.1)
    flag = rejection.frequency(cube, modulation_frequency=20e6)["quality_flag"].values
    assert (flag & QualityFlag.WATER_RESIDUAL).all()
    drowned = by_hand(frequency=[20e6, 39e6], channels=ONE, water=0.8)
    flag = rejection.frequency(drowned, modulation_frequency=20e6)[
        "quality_flag"
    ].values
    assert (flag & QualityFlag.NO_TARGET).all()


def test_what_is_not_there_is_named(by_hand: Make) -> None:
    cube = by_hand(frequency=[20e6, 39e6], channels=ONE)
    with pytest.raises(CubeError, match="no sample at 30 MHz, but at 20, 39 MHz"):
        rejection.frequency(cube, modulation_frequency=30e6)
    with pytest.raises(CubeError, match="no channel 'VH', but VV"):
        rejection.choose_frequency(cube, polarization="VH")
    with pytest.raises(CubeError, match="no open-water shots"):
        rejection.frequency(cubes.without_groups(cube))
    empty = by_hand(frequency=[20e6, 39e6], channels=ONE, target=0.0)
    with pytest.raises(CubeError, match="no pixel shows a target at any frequency"):
        rejection.choose_frequency(empty)


def test_the_end_of_the_sweep_is_told_unless_the_interval_made_it(
    by_hand: Make,
) -> None:
    end = "stands at the end of the sweep"
    # The water disturbs less and less: the highest frequency is the best one.
    rising = by_hand(frequency=SWEEP, channels=ONE, water=0.4, noise=1e-6)
    low = rising.isel(modulation_frequency=slice(0, 5))
    best = rejection.choose_frequency(low)
    assert best.modulation_frequency in (SWEEP[0], SWEEP[4])
    assert any(end in w for w in best.warnings)
    # Within 19.5 m 8 MHz and above repeat: 4 MHz is blocked by its neighbour.
    two = rising.isel(modulation_frequency=slice(0, 4))
    blocked = rejection.choose_frequency(two, interval=(0.5, 20.0))
    assert blocked.modulation_frequency == SWEEP[0]
    assert not any(end in w for w in blocked.warnings)


@pytest.mark.parametrize(
    "scene", ["empty", pytest.param("small-angle empty", marks=pytest.mark.slow)]
)
def test_one_frequency_finds_no_target_in_open_water(scene: str) -> None:
    # At 35 MHz, water that something a decimetre away cuts off passes for a target.
    case = BY_NAME[scene].make(4, 1)
    target = rejection.frequency(
        case.samples, modulation_frequency=35e6, interval=case.interval
    )
    assert np.all(target["quality_flag"].values & QualityFlag.NO_TARGET)
    with pytest.raises(CubeError, match="no pixel shows a target"):
        rejection.choose_frequency(case.samples, interval=case.interval)


@pytest.mark.slow
def test_auto_says_in_a_word_that_all_is_open_water() -> None:
    case = BY_NAME["empty"].make(4, 1)
    with pytest.raises(CubeError, match="all is open water") as found:
        rejection.auto(case.samples, interval=case.interval)
    assert len(str(found.value)) < 200
