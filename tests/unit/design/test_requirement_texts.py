"""Quantities of a design as people read them: units, factors, and lines of text."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from amulor.design import Goal
from amulor.design.candidates import first_choice
from amulor.design.requirements import (
    _shortfall,
    lines_texts,
    parameters_text,
    quantity_text,
    written,
)
from amulor.design.vehicle import Lines


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("power", 0.0123456, "12.35 mW"),
        ("baseline", 0.25, "25 cm"),
        ("radius", 0.0125, "12.5 mm"),
        ("field_of_view", math.radians(2.5), "2.5 deg"),
        ("dwell", 0.0305, "30.5 ms"),
        ("lowest frequency", 15.25e6, "15.25 MHz"),
        ("highest frequency", 120e6, "120 MHz"),
        ("total error", 0.00325, "3.25 mm"),
        ("wrong interval", 0.0015, "0.15 %"),
        ("wrong interval", 1e-8, "1e-06 %"),
        ("wrong interval", 0.9e-8, "below 1e-06 %"),
        ("wrong interval", 0.0, "0 %"),
        ("scan time", 90.0, "1.5 min"),
        ("row spacing", 0.006, "6 mm"),
        ("smear", 0.0005, "0.5 mm"),
        ("budget", 1234.0, "1234"),
        ("detector output", 0.25, "25 %"),
        ("validity of the model", 1.5, "150 %"),
    ],
)
def test_a_quantity_has_its_unit(name: str, value: float, text: str) -> None:
    assert written(name, value) == text
    assert quantity_text(f"{name} at 2 m", value) == text
    assert quantity_text(name, value) == text


def test_a_shortfall_states_its_limit_and_the_one_that_would_do(goal_text: str) -> None:
    goal = Goal.from_text(goal_text)
    found = _shortfall(goal, "total error", 1.5, alone=True)
    assert found.text == (
        "total error: 4.5 mm in place of 3 mm (1.5 times) would do alone"
    )
    assert (found.value, found.limit, found.factor) == (
        pytest.approx(4.5e-3),
        3e-3,
        1.5,
    )
    assert (found.unit, found.alone, found.requirement) == ("m", True, "total error")
    both = _shortfall(goal, "scan time", 2.0, alone=False)
    assert both.text == (
        "scan time: 8 min in place of 4 min (2 times) is missed, and others with it"
    )
    assert both.unit == "s"
    assert _shortfall(goal, "detector output", 2.0, alone=False).unit == "1"


def test_an_instrument_is_one_line(goal_text: str) -> None:
    chosen = replace(
        first_choice(Goal.from_text(goal_text)), frequencies=(15e6, 52.5e6), dwell=0.06
    )
    assert parameters_text(chosen) == (
        "green, 10 mW; 15, 52.5 MHz; baseline 6 cm, aperture 10 mm, field 2 deg; VH by "
        "open-water; dwell 60 ms"
    )


LINES = Lines(
    speed=0.25, time=600.0, count=3, length=20.0, spacing=0.44, swath=0.5,
    between_rows=0.006, between_columns=0.0135, along_readings=0.0004, spot=0.012,
)  # fmt: skip


def test_survey_lines_are_told_in_millimeters(goal_text: str) -> None:
    chosen = replace(first_choice(Goal.from_text(goal_text)), readings="at-once")
    assert lines_texts(LINES, chosen) == {
        "speed": "0.25 m/s",
        "readings": "at once",
        "survey lines": "3 of 20 m, 0.44 m apart",
        "between rows": "6 mm",
        "between points of a row": "13.5 mm",
        "way during a pixel": "0.4 mm",
        "laser spot": "12 mm",
    }
    single = lines_texts(replace(LINES, count=1, spot=0.0), chosen)
    assert single["survey lines"] == "1 of 20 m"
    assert "laser spot" not in single
    assert lines_texts(replace(LINES, count=2), chosen)["survey lines"].endswith(
        "apart"
    )
