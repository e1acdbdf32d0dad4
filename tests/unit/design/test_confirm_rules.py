"""Confirmation of an instrument: what is followed and what is simulated."""

from __future__ import annotations

import importlib
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from amulor.design import Goal
from amulor.design.candidates import first_choice
from amulor.errors import SurveyError
from amulor.survey import Survey

#: The package has a function of the same name.
confirm: Any = importlib.import_module("amulor.design.confirm")


def followed(
    survey: Survey, monkeypatch: pytest.MonkeyPatch, **options: Any
) -> tuple[Any, dict[str, Any], list[Any]]:
    """Return the result of photons of a stand-in, and what it was asked for."""
    calls: dict[str, Any] = {}
    bounds: list[Any] = []

    def run(setting: Any, place: Any, frequency: Any, **others: Any) -> Any:
        calls.update(others, setting=setting, place=place, frequency=frequency)
        return SimpleNamespace(derivatives=("range", "reflectance", "absorption"))

    def bound(tally: Any, noise: Any, names: Any) -> tuple[float, float]:
        bounds.append(names)
        return len(names) * 1e-3, 1e-5

    monkeypatch.setattr(confirm, "run", run)
    monkeypatch.setattr(confirm, "_bound", bound)
    monkeypatch.setattr(confirm, "_noise", lambda *_: "noise")
    compared = confirm.Photons(
        histories=7, frequency=np.ones(1), echo=np.ones(1), echo_error=np.ones(1),
        shift=np.ones(1), shift_error=np.ones(1), water=np.ones(1),
        water_error=np.ones(1),
    )  # fmt: skip
    monkeypatch.setattr(confirm, "_compared", lambda *_, **__: compared)
    return confirm.follow_photons(survey, **options), calls, bounds


def test_photons_follow_the_middle_beam_to_its_target(
    tank: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, calls, bounds = followed(tank, monkeypatch)
    assert calls["frequency"].tolist() == [0, 39e6]
    assert (calls["relative_error"], calls["histories"]) == (0.01, 1_000_000)
    assert (calls["seed"], calls["progress"]) == (1, None)
    assert calls["derivatives"] == ("range", "reflectance", "absorption", "scattering")
    place, setting = calls["place"], calls["setting"]
    assert (place.depth, place.reflectance) == (pytest.approx(2), 0.2)
    assert place.baseline == pytest.approx(0.1 * np.cos(0.05))
    assert place.tilt == pytest.approx(np.sin(0.05))
    assert (place.cross_tilt, place.standoff) == (pytest.approx(0), 0)
    assert (setting.absorption, setting.scattering) == (0.1, pytest.approx(0.25))
    assert bounds == [
        ("range", "reflectance"), ("range", "reflectance", "absorption")
    ]  # fmt: skip
    assert found.range_bound == 2e-3
    assert found.range_bound_error == 1e-5
    assert found.free_range_bound == 3e-3
    clear = tank.with_({"water.scattering": 0.0, "water.asymmetry": None,
                        "water.forward_fraction": 1.0, "water.second_moment": 0.0,
                        "water.phase_function_at_180": 1e-3})  # fmt: skip
    _, calls, _ = followed(clear, monkeypatch)
    assert calls["derivatives"] == ("range", "reflectance", "absorption")


def test_a_wide_beam_has_no_bound(
    tank: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    wide = tank.with_({"instrument.emitter.beam_radius": 2e-3})
    found, calls, bounds = followed(wide, monkeypatch)
    assert calls["derivatives"] == ()
    assert bounds == []
    assert math.isnan(found.range_bound)
    assert math.isnan(found.range_bound_error)
    assert math.isnan(found.free_range_bound)
    sharp = tank.with_({"instrument.receiver.edge": "sharp"})
    with pytest.raises(SurveyError, match="know Gaussian receivers only"):
        followed(sharp, monkeypatch)
    away = tank.with_({"targets.0.position": (5.0, 0.0, 2.0)})
    with pytest.raises(SurveyError, match="meets no target"):
        followed(away, monkeypatch)


def test_a_design_is_confirmed_on_few_pixels(goal: Goal) -> None:
    chosen = first_choice(goal)
    found = confirm._reduced_survey(goal, chosen, 2.5)
    scan = found.scan
    assert (scan.columns, scan.rows) == (16, 9)
    assert scan.azimuth_span == 4e-3
    assert scan.elevation_span == pytest.approx(4e-3 * 9 / 16)
    assert found.targets[0].position == (0, 0, 2.5)
    assert found.platform is None
    small = goal.model_copy(
        update={"scan": goal.scan.model_copy(update={
            "columns": 5, "rows": 3, "azimuth_span": 2e-3, "elevation_span": 1e-3})}
    )  # fmt: skip
    scan = confirm._reduced_survey(small, chosen, 2.5).scan
    assert (scan.columns, scan.rows) == (5, 3)
    assert (scan.azimuth_span, scan.elevation_span) == (2e-3, 1e-3)


def test_a_confirmation_asks_for_the_farthest_distance(
    goal: Goal, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, Any] = {}
    simulated = SimpleNamespace(holds=True)

    def scans(survey: Survey, method: str, **options: Any) -> Any:
        asked.update(options, survey=survey, method=method)
        return simulated

    def evaluate(survey: Survey, **axes: Any) -> Any:
        asked["evaluated"] = axes
        return {"late_light": 2e-4}

    def photons(survey: Survey, **options: Any) -> Any:
        asked["photons"] = options
        raise SurveyError("no such light")

    monkeypatch.setattr(confirm, "scans", scans)
    monkeypatch.setattr(confirm, "evaluate", evaluate)
    monkeypatch.setattr(confirm, "follow_photons", photons)
    found = confirm.confirm(goal, first_choice(goal))
    assert asked["survey"].targets[0].position == (0, 0, 2.5)
    assert (asked["method"], asked["interval"]) == ("open-water", (0.5, 4))
    assert (asked["repeats"], asked["seed"]) == (12, 1)
    assert asked["evaluated"] == {
        "distance": 2.5, "method": "open-water", "interval": (0.5, 4)
    }  # fmt: skip
    assert asked["photons"]["seed"] == 1
    assert found.name == "recommended"
    assert found.late == 2e-4
    assert found.photons is None
    assert found.scans is simulated
    assert found.said == ("recommended: photons were not followed: no such light",)
