"""One frequency of a scan and its figures of merit, with the water given."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.rejection import merit as merits
from amulor.rejection.covariance import Covariance
from amulor.rejection.observation import Observation

Make = Callable[..., xr.Dataset]
#: The package has a function of the same name.
module: Any = importlib.import_module("amulor.rejection.frequency")
FREQUENCY = [20e6, 50e6, 80e6]
SHAPE = (3, 1, 2, 3)
NOISE = 2e-3


@pytest.fixture
def cube(by_hand: Make) -> xr.Dataset:
    return by_hand(
        frequency=FREQUENCY, channels={"VV": (1.0, 1.0)}, shape=SHAPE[2:], noise=NOISE
    )


class Given:
    """Water before the targets, and targets, as a test states them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, where: Any) -> None:
        self.options: list[Any] = []
        self.hidden: Any = np.full(SHAPE, 0.2 + 0j)
        self.hidden[..., 1, 2] = np.nan
        self.signal: Any = np.full(SHAPE, 1e-5 + 2e-5j)
        self.has_target = np.ones((2, 3), dtype=bool)
        self.has_target[0, 1] = False
        self.water: Any = SimpleNamespace(
            signal=self.signal,
            hidden_fraction=self.hidden,
            fluctuation=Covariance(*(np.full(SHAPE, v) for v in (1e-6, 2e-6, 0.0))),
            common=Covariance(*(np.full(SHAPE, v) for v in (3e-6, 5e-6, 0.0))),
            fit="water",
        )

        def before(scan: Any, **options: Any) -> Any:
            self.options.append(options)
            return self.water

        def shows(scan: Any, water: Any, **options: Any) -> Any:
            self.options.append(options)
            return self.has_target, "cut", np.full((2, 3), 0.25)

        monkeypatch.setattr(where, "water_before_target", before)
        monkeypatch.setattr(where, "shows_target", shows)


def test_one_frequency_is_kept_with_its_water(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = Given(monkeypatch, module)
    found, fit = module._keep(cube, modulation_frequency=50e6, interval=(1.0, 2.0))
    assert_array_equal(found["modulation_frequency"].values, [50e6])
    assert_array_equal(found.amulor.signal.values, cube.amulor.signal.values[1:2])
    assert_array_equal(found["water_in_phase"].values, 0.0)
    assert_array_equal(found["water_quadrature"].values, 0.0)
    # All of the water is left, unknown where the distance is.
    left = found["residual_in_phase"] + 1j * found["residual_quadrature"]
    known = np.isfinite(given.hidden[1:2])
    assert_allclose(left.values[known], 1e-5 + 2e-5j)
    assert np.isnan(left.values[~known]).all()
    total = found["in_phase_uncertainty"].values ** 2
    assert_allclose(total, NOISE**2 + 1e-6 + 3e-6)
    total = found["quadrature_uncertainty"].values ** 2
    assert_allclose(total, NOISE**2 + 2e-6 + 5e-6)
    assert_allclose(found["common_quadrature_uncertainty"].values, np.sqrt(5e-6))
    terms = ("counting", "fluctuation", "reference")
    assert fit.terms == terms
    assert all(f"phase_uncertainty_{name}" in found for name in terms)
    assert_allclose(found["no_target_probability"].values, 0.25)
    assert found.attrs["frequency_choice"] == "chosen by the user"
    assert found.attrs["frequency_warnings"] == ""
    assert found.attrs["frequencies_share_errors"] == 0
    assert "reject, keep 50 MHz alone" in found.attrs["history"]
    flag = found["quality_flag"].values[0, 0]
    assert_array_equal((flag & QualityFlag.NO_TARGET) != 0, ~given.has_target)
    assert (fit.choice, fit.water, fit.cut) == (None, "water", "cut")
    assert given.options == [
        {"interval": (1.0, 2.0), "fit": None, "span": None},
        {"interval": (1.0, 2.0), "fit": None},
    ]
    # Rows take what was found for the scan.
    module._keep(cube, modulation_frequency=50e6, fit=fit, span="span")
    assert given.options[2:] == [
        {"interval": None, "fit": "water", "span": "span"},
        {"interval": None, "fit": "cut"},
    ]


def test_the_best_frequency_is_kept_by_default(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = Given(monkeypatch, module)
    given.water.hidden_fraction = None
    choice = SimpleNamespace(
        modulation_frequency=80e6, reason="best of three", warnings=("a", "b")
    )
    asked: list[Any] = []

    def choose(cube: Any, *, interval: Any) -> Any:
        asked.append(interval)
        return choice

    monkeypatch.setattr(module, "choose_frequency", choose)
    found, fit = module._keep(cube, interval=(0.5, 1.0))
    assert_array_equal(found["modulation_frequency"].values, [80e6])
    assert found.attrs["frequency_choice"] == "best of three"
    assert found.attrs["frequency_warnings"] == "a; b"
    assert_allclose(found["residual_in_phase"].values, 1e-5)
    assert fit.choice is choice
    rows, _ = module._keep(cube, interval=(0.5, 1.0), fit=fit)
    assert asked == [(0.5, 1.0)]
    assert rows.attrs["frequency_choice"] == "best of three"


def test_a_frequency_that_was_not_recorded_is_named(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    Given(monkeypatch, module)
    module._keep(cube, modulation_frequency=50e6 * (1 + 0.9e-9))
    with pytest.raises(CubeError) as refusal:
        module._keep(cube, modulation_frequency=50e6 * (1 + 1e-6))
    assert str(refusal.value) == (
        "the cube has no sample at 50 MHz, but at 20, 50, 80 MHz; choose one of these"
    )


def test_figures_of_merit_are_medians_of_the_pixels_with_a_target(
    cube: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = Given(monkeypatch, merits)
    rng = np.random.default_rng(1)
    echo = rng.uniform(0.5, 1, SHAPE) * np.exp(1j * rng.uniform(-1, 1, SHAPE))
    water: Any = 0.1 * np.exp(1j * rng.uniform(-3, 3, SHAPE))
    given.water.signal = water
    cube["in_phase"].values[:] = (echo + water).real
    cube["quadrature"].values[:] = (echo + water).imag
    cube["in_phase"].values[1, 0, 1, 0] = np.nan
    found = merits.merit(Observation(cube=cube), interval=None)
    signal = echo + water
    per_range = 4 * np.pi * 1.38 * np.array(FREQUENCY) / 299792458.0
    for k in range(3):
        use = given.has_target.copy()
        use[1, 0] &= k != 1
        s, w, t = (values[k, 0][use] for values in (signal, water, echo))
        assert found.amplitude[k, 0] == pytest.approx(np.median(np.abs(s)))
        assert found.water_amplitude[k, 0] == pytest.approx(0.1)
        assert found.ratio[k, 0] == pytest.approx(np.median(np.abs(s) / 0.1))
        # Errors across the signal, of samples and of the fluctuation.
        side = s / np.abs(s) ** 2
        variance = side.imag**2 * (NOISE**2 + 1e-6) + side.real**2 * (NOISE**2 + 2e-6)
        noise = np.median(np.sqrt(variance)) / per_range[k]
        assert found.noise[k, 0] == pytest.approx(noise, rel=1e-6)
        turned = np.angle((t + w) / t)
        shift = np.sqrt(np.mean(turned**2)) / per_range[k]
        assert found.shift[k, 0] == pytest.approx(shift, rel=1e-6)
        assert found.usable[k, 0] == pytest.approx(use.sum() / 6)
    assert_allclose(found.error, np.hypot(found.noise, found.shift))
    # Without a target there is no figure.
    given.has_target[:] = False
    none = merits.merit(Observation(cube=cube), interval=None)
    for name in ("amplitude", "ratio", "contrast", "noise", "shift"):
        assert np.isnan(getattr(none, name)).all()
    assert_array_equal(none.usable, 0.0)


def test_a_mean_over_one_pixel_is_its_value_and_over_none_unknown() -> None:
    values = np.array([3.0, 4, 5, 7]).reshape(1, 1, 2, 2)
    for used, expected in (
        ([False, True, False, False], 4.0),
        ([True, False, False, True], 5.0),
        ([False, False, False, False], np.nan),
    ):
        usable = np.reshape(used, values.shape)
        assert_allclose(merits._mean(values, usable), [[expected]])
        assert_allclose(merits._median(values, usable), [[expected]])
