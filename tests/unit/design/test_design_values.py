"""Daylight and assumptions of a design by closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.design import Goal, trade
from amulor.design.candidates import first_choice
from amulor.design.light import case_of
from amulor.design.numbers import _sky
from amulor.errors import SurveyError
from amulor.survey import Daylight, Survey, counting, water_properties


def test_daylight_grows_with_the_etendue_of_the_receiver(tank: Survey) -> None:
    stated = {"radiance": "0.02 W/m^2/sr/nm", "bandwidth": "3 nm"}
    survey = tank.with_({"daylight": stated, "instrument.polarizations": ["none"]})
    assert survey.daylight is not None
    radiance = survey.daylight.radiance
    case = case_of(survey, water_properties(survey))
    values = {"radiance": np.array([radiance, 2 * radiance, radiance, radiance]),
              "radius": np.array([0.02, 0.02, 0.04, 0.02]),
              "field_of_view": np.array([0.06, 0.06, 0.06, 0.02])}  # fmt: skip
    found = _sky(case, values)
    # The rate of the survey itself, and in proportion to both squares.
    rate = counting.background_rate(survey)[0]
    assert_allclose(found, rate * np.array([1, 2, 4, 1 / 9]))
    dark = case_of(tank, water_properties(tank))
    assert _sky(dark, {"radiance": np.array(0.0)}) == 0.0
    with pytest.raises(SurveyError, match="daylight needs the bandwidth of the filter"):
        _sky(dark, {"radiance": np.array([0.0, 1.0])})


def test_every_assumption_has_its_value_unit_and_limit(goal_text: str) -> None:
    goal = Goal.from_text(goal_text)
    detector = goal.detector.model_copy(update={"dark_rate": 500.0})
    daylight = Daylight(radiance=2e6, bandwidth=3e-9)
    goal = goal.model_copy(update={"detector": detector, "daylight": daylight})
    chosen = tuple(
        replace(first_choice(goal), method=method) for method in ("combined", "joint")
    )
    rows: dict[str, Any] = {
        label: row for label, *row in trade._assumptions(goal, chosen)
    }
    expected = {
        "attenuation of the water": (math.sqrt(0.12), "1/m", math.inf),
        "fluctuation of the water signal": (0.03, "1", 1 / 0.05),
        "reflectance of the target": (0.2, "1", 1 / 0.3),
        "light that passes the optics": (0.3, "1", 1 / 0.3),
        "phase floor": (np.radians(0.03), "rad", 1 / np.radians(0.03)),
        "dark counts": (500.0, "1/s", math.inf),
        "daylight": (2e6, "W/(m2 sr m)", math.inf),
        "change of the water since the shots": (0.01, "1", 100),
        "water behind the target": (0.1, "1", 10),
        "depolarization ratio of the water": (0.01, "1", 100),
        "departure of the water from its model": (0.003, "1", 1 / 0.003),
        "accuracy that is asked for": (3e-3, "m", math.inf),
    }
    texture = rows.pop("texture of the target", None)
    assert texture is None or texture[1] == "1"
    assert rows.keys() == expected.keys()
    for label, (value, unit, most) in expected.items():
        found, found_unit, scaled = rows[label]
        assert found == pytest.approx(value), label
        assert found_unit == unit
        if math.isinf(most):
            assert scaled(1e3) is not None
        else:
            assert scaled(0.999 * most) is not None, label
            assert scaled(1.001 * most) is None, label
    # What a method does not use is none of its assumptions.
    plain = replace(chosen[0], method="none")
    labels = {label for label, *_ in trade._assumptions(goal, (plain,))}
    assert "change of the water since the shots" not in labels
