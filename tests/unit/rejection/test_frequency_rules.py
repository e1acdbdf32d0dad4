"""Choice of one frequency: both sides of its limits, and the words of its reasons."""

from __future__ import annotations

import importlib
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.rejection import expected_errors

#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.rejection.frequency")

FREQUENCY = np.array([10e6, 20e6, 40e6])
INTERVALS = 299792458.0 / (2 * 1.38 * FREQUENCY)


def warnings(
    best: int = 1, *, noise: float = 1e-3, shift: float = 1e-3,
    span: float | None = 1.0, eligible: tuple[bool, ...] = (True, True, True),
    clear: tuple[bool, ...] = (True, True, True),
) -> str:  # fmt: skip
    curves = {"noise": np.full(3, noise), "shift": np.full(3, shift)}
    return "; ".join(
        module._warnings(
            FREQUENCY, best, curves, INTERVALS, span, np.array(eligible),
            np.array(clear),
        )
    )  # fmt: skip


def test_a_good_frequency_has_no_warning() -> None:
    assert warnings() == ""


def test_warnings_have_their_limits() -> None:
    assert warnings(span=None) == (
        f"this frequency alone repeats after {INTERVALS[1]:.3g} m; state the interval "
        "that is possible if targets may be farther"
    )
    assert "repeats after 5.43 m and the interval spans 7 m" in warnings(
        span=7.0, clear=(True, False, True)
    )
    # A phase of 0.3 rad is 4.8 % of an interval.
    limit = 0.3 / (2 * np.pi) * INTERVALS[1]
    assert warnings(noise=0.999 * limit) == ""
    assert warnings(noise=1.001 * limit) == (
        f"useless for noise: {1.001 * limit:.3g} m is 5% of the ambiguity interval; "
        "raise power or dwell"
    )
    large = 0.02 * INTERVALS[1]
    assert warnings(shift=0.999 * large) == ""
    assert warnings(shift=1.001 * large) == (
        f"the water still shifts the range by {large * 1.001e3:.3g} mm; subtract open "
        "water instead"
    )
    end = "the best frequency stands at the end of the sweep; a wider sweep may hold"
    assert warnings(best=0).startswith(end)
    assert warnings(best=2).startswith(end)
    # The interval blocks the next one: a wider sweep is of no use.
    assert warnings(best=0, eligible=(True, False, True)) == ""


def test_a_sweep_of_one_has_nothing_to_choose() -> None:
    one = np.ones(1)
    said = module._warnings(
        FREQUENCY[:1], 0, {"noise": 1e-3 * one, "shift": 1e-3 * one}, INTERVALS[:1],
        1.0, one > 0, one > 0,
    )  # fmt: skip
    assert said == ("the cube has one frequency, so there was nothing to choose",)


def reason(
    error: list[float], *, best: int = 1, cut_off: float | None = 30e6,
    eligible: tuple[bool, ...] = (True, True, True), span: float | None = 4.0,
) -> str:  # fmt: skip
    sizes = {"ratio": 1.0, "shift": 1e-3, "noise": 1e-4}
    curves = {name: np.array([1.0, 2.5, 3.0]) * size for name, size in sizes.items()}
    return str(
        module._reason(
            FREQUENCY, best, curves, cut_off, np.array(eligible), np.array(error), span
        )
    )


def test_a_reason_states_signal_shift_and_noise() -> None:
    start = (
        "20 MHz, below the cut-off of the water signal at 30 MHz: the signal is 2.5 "
        "times that of the water, which shifts the range by 2.5 mm; noise 0.25 mm"
    )
    worst = "; 9 mm at 40 MHz, the worst of the sweep"
    assert reason([5e-3, 1e-3, 9e-3]) == start + worst
    assert "above the cut-off" in reason([5e-3, 1e-3, 9e-3], cut_off=19e6)
    none = reason([5e-3, 1e-3, 9e-3], cut_off=None)
    assert "20 MHz, the sweep shows no cut-off of the water signal: the" in none
    blocked = (True, True, False)
    assert reason([5e-3, 2e-3, 1e-3], eligible=blocked) == (
        start
        + "; frequencies from 40 MHz on would err less, but repeat within the 4 m "
        "of the interval"
    )
    # Without an interval, or if they are worse, they are no alternative.
    assert reason([5e-3, 2e-3, 1e-3], eligible=blocked, span=None) == (
        start + "; 5 mm at 10 MHz, the worst of the sweep"
    )
    assert reason([5e-3, 2e-3, 3e-3], eligible=blocked).endswith("worst of the sweep")
    assert reason([np.nan, 1e-3, np.inf]) == start


def test_the_channel_of_least_error_is_taken() -> None:
    error = np.array([[2.0, np.nan, 3.0], [1.5, 1.0, np.inf]])
    figures: Any = SimpleNamespace(error=error)
    names = ["VV", "VH", "HH"]
    assert module._channel(names, figures, None) == 1
    assert module._channel(names, figures, "HH") == 2


def shots_with(monkeypatch: pytest.MonkeyPatch, cut_off: float, sweep: Any) -> Any:
    frequency = np.array(sweep)
    level = 0.5 / (1 - 1j * frequency / cut_off)
    signal = level[:, None, None] * np.ones((1, 2, 5))
    signal[0, 0, 0] = np.nan
    monkeypatch.setattr(module, "shots_of", lambda scan: SimpleNamespace(signal=signal))
    return module._fitted_cut_off(SimpleNamespace(frequency=frequency), 0)


def test_a_cut_off_lies_inside_of_the_sweep(monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = [10e6, 20e6, 40e6, 80e6]
    assert shots_with(monkeypatch, 30e6, sweep) == pytest.approx(30e6, rel=1e-4)
    assert shots_with(monkeypatch, 10.1e6, sweep) == pytest.approx(10.1e6, rel=1e-3)
    assert shots_with(monkeypatch, 9.9e6, sweep) is None
    assert shots_with(monkeypatch, 81e6, sweep) is None
    assert shots_with(monkeypatch, 30e6, [20e6]) is None


def test_maxima_need_three_frequencies() -> None:
    frequency = np.linspace(1e6, 100e6, 41)
    values = 2 + np.cos(2 * np.pi * (frequency - 40e6) / 80e6)
    (found,) = module._maxima(frequency, values)
    assert found == pytest.approx(40e6, rel=0.02)
    values[3:] = np.nan
    assert module._maxima(frequency, values).size == 0
    values[:3] = [1.0, 2.0, np.nan]
    assert module._maxima(frequency, values).size == 0


@pytest.mark.parametrize(
    ("frequencies", "smallest"),
    [([20e6], 20e6), ([20e6, 50e6], 20e6), ([20e6, 35e6], 15e6),
     ([40e6, 50e6, 90e6], 10e6)],
)  # fmt: skip
def test_paths_repeat_at_the_smallest_frequency_or_difference(
    frequencies: list[float], smallest: float
) -> None:
    found = expected_errors.repeated_path(np.array(frequencies))
    assert found == pytest.approx(299792458.0 / smallest)


def test_the_error_of_an_instrument_has_the_weights_of_the_phases(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    phase = np.array([0.01, 0.02, 0.04])
    monkeypatch.setattr(expected_errors, "instrument_phase", lambda *_: phase)
    target: Any = xr.Dataset(
        {"geometry": ((), 0, {"group_index": 1.38})},
        {"modulation_frequency": FREQUENCY},
    )
    per_phase = 299792458.0 / (4 * np.pi * 1.38 * FREQUENCY)
    weight = FREQUENCY**2 / np.sum(FREQUENCY**2)
    expected = math.sqrt(float(np.sum((weight * per_phase * phase) ** 2)))
    assert expected_errors.instrument_error(target) == pytest.approx(expected)


def joint_target(frequencies: int) -> xr.Dataset:
    values = {
        "": [2.0, 3.0, np.nan], "_uncertainty": [5e-3, 1e-3, np.nan],
        "_common_uncertainty": [4e-3, 2e-3, np.nan],
    }  # fmt: skip
    return xr.Dataset(
        {f"joint_slant_range{name}": ("pixel", part) for name, part in values.items()},
        {"modulation_frequency": FREQUENCY[:frequencies]},
        {
            "joint_instrument_uncertainty_m": 3e-3,
            "joint_late_echo_uncertainty": 0.5,
            "joint_late_echo_spread_rad2_per_m": 0.01,
        },
    )


@pytest.mark.parametrize("frequencies", [2, 3])
def test_errors_of_a_joint_estimation_are_those_that_it_states(
    monkeypatch: pytest.MonkeyPatch, frequencies: int
) -> None:
    monkeypatch.setattr(expected_errors, "SHAPE_KNOWN", 3)
    monkeypatch.setattr(
        expected_errors, "_joint_path", lambda target: np.array([5.0, 7.0, np.nan])
    )
    usable = np.array([True, True, True])
    found = expected_errors._errors_of_joint(joint_target(frequencies), usable)
    # Instrument errors are in no other method; late light is left in an image of few
    # frequencies: half of a quarter of the spread times the squared distance.
    late = 0.5 * 0.25 * 0.01 * np.array([4.0, 9.0]) * (frequencies < 3)
    assert_allclose(found.noise[:2], np.sqrt([16e-6, 0.0] + late**2))
    assert_allclose(found.own_noise[:2], [3e-3, 0.0])
    assert found.agree.tolist() == [True, True, False]
    assert_allclose(found.bias, 0)
    assert_allclose(found.path[:2], [5, 7])
    assert not found.mixed.any()
    assert not found.in_corner.any()
