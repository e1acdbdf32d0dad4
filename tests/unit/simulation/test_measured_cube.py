"""Cube of a simulation: true values, the fit of its model, and its readings."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import tiles
from amulor.simulation import ClosureModel, lock_in, measurement, simulate
from amulor.simulation.geometry import Setup, trace
from amulor.simulation.vehicle import VehicleMotion
from amulor.survey import Survey

MODEL = ClosureModel()


@pytest.fixture(scope="module")
def survey(plate: Survey) -> Survey:
    return plate.with_(
        {
            "instrument.modulation_frequencies": [20e6, 60e6],
            "scan.columns": 5,
            "scan.rows": 3,
            "targets.0.width": 0.06,
        }
    )


def test_true_values_are_those_of_geometry_and_light(survey: Survey) -> None:
    cube = simulate(survey, rng=1, model=MODEL)
    truth = cube.amulor.truth
    setup = Setup(survey)
    geometry = trace(setup)
    met = geometry.target >= 0
    assert 0 < met.sum() < met.size
    assert_array_equal(truth["target"], geometry.target)
    assert truth["target"].dtype == np.int32
    expected = np.where(met, geometry.slant_range, np.nan)
    assert_allclose(truth["slant_range"], expected)
    lights = {
        "target": lock_in.target_light(setup, geometry, model=MODEL),
        "water": lock_in.water_light(
            setup, geometry.view, end=geometry.depth, model=MODEL
        ),
    }
    for name, light in lights.items():
        volts = setup.volt_per_power * light.modulated
        assert_allclose(truth[f"{name}_in_phase"], volts.real, rtol=1e-6)
        assert_allclose(truth[f"{name}_quadrature"], volts.imag, rtol=1e-6, atol=1e-12)
        assert truth[f"{name}_in_phase"].attrs == {
            "long_name": f"{name} signal, in phase", "units": "V"
        }  # fmt: skip
    assert truth["slant_range"].attrs["units"] == "m"
    assert truth["target"].attrs["long_name"] == "number of the target met, -1 for none"
    assert "reading_time" not in cube
    assert cube.attrs["history"].count("simulate") == 1


def test_outputs_have_the_root_of_their_variances() -> None:
    shape = (1, 1, 2)
    samples = lock_in.Samples(
        signal=np.full(shape, 3 - 4j), in_phase_variance=np.full(shape, 4.0),
        quadrature_variance=np.full(shape, 9.0), covariance=np.full(shape, -1.0),
        saturated=np.zeros(shape, np.int8),
    )  # fmt: skip
    found = {
        name: value[0, 0, 0] for name, value in measurement._outputs(samples).items()
    }
    assert found == {
        "in_phase": 3, "quadrature": -4, "in_phase_uncertainty": 2,
        "quadrature_uncertainty": 3, "in_phase_quadrature_covariance": -1,
    }  # fmt: skip


class Fitted:
    """Forward model that can be fitted."""

    title, late_echo = "fitted", "absent"

    def echo(self, *_: Any, **__: Any) -> Any: ...

    def column(self, *_: Any, **__: Any) -> Any: ...

    def fit(self, *_: Any, **__: Any) -> Any: ...


def fit(survey: Survey, monkeypatch: pytest.MonkeyPatch, motion: Any = None) -> Any:
    """Return the options and the view of a fit."""
    asked: dict[str, Any] = {}

    def fitted(model: Any, setup: Any, view: Any, **options: Any) -> str:
        asked.update(options, view=view)
        return "fitted"

    monkeypatch.setattr(lock_in, "fitted", fitted)
    setting: Any = SimpleNamespace(
        setup=Setup(survey, motion), model=Fitted(), light_setup=Setup(survey)
    )
    assert measurement.fit(setting) == "fitted"
    return asked


def test_a_model_is_fitted_to_all_pixels_of_a_small_scan(
    survey: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tiles, "SAMPLE", 15)
    wide = survey.with_({"targets.0.width": 9.0, "targets.0.height": 9.0})
    asked = fit(wide, monkeypatch)
    assert asked["end"].shape == (3, 5)
    assert asked["farthest"] == asked["end"].max()
    assert 1.5 < asked["farthest"] < 1.51
    # Beside the plate the water ends nowhere, or where the survey says.
    assert np.isinf(fit(survey, monkeypatch)["farthest"])
    assert fit(survey.with_({"water.column_end": 1.8}), monkeypatch)["farthest"] == 1.8
    ended = wide.with_({"water.column_end": 1.8})
    assert fit(ended, monkeypatch)["farthest"] == asked["farthest"]


def test_a_model_is_fitted_to_some_pixels_of_a_large_scan(
    survey: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tiles, "SAMPLE", 14)
    wide = survey.with_({"targets.0.width": 9.0, "targets.0.height": 9.0})
    asked = fit(wide, monkeypatch)
    assert asked["end"].shape == (3, 4)
    assert np.isinf(asked["farthest"])
    ended = wide.with_({"water.column_end": 1.8})
    assert fit(ended, monkeypatch)["farthest"] == 1.8


def test_a_vehicle_may_meet_farther_targets_later(
    survey: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    course = {"kind": "hover", "start": (0.0, 0.0, 0.0)}
    moving = survey.with_(
        {"targets.0.width": 9.0, "targets.0.height": 9.0,
         "pose": {"pitch": -np.pi / 2},
         "platform": {"course": course, "mounting": {"pitch": -np.pi / 2}}}
    )  # fmt: skip
    asked = fit(moving, monkeypatch, VehicleMotion.of(moving, 1))
    assert asked["end"].max() < 1.6
    assert np.isinf(asked["farthest"])


def test_a_model_that_cannot_be_fitted_stays(survey: Survey) -> None:
    setting: Any = SimpleNamespace(setup=Setup(survey), model=MODEL, light_setup=None)
    assert measurement.fit(setting) is MODEL
