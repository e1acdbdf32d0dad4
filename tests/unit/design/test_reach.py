"""How far instruments reach: less in more turbid water, less for more accuracy."""

from __future__ import annotations

import json

import numpy as np
import pytest

from amulor.cli import main
from amulor.design import evaluate
from amulor.design.evaluate import WATERS, reach
from amulor.survey import Survey


@pytest.fixture(scope="module")
def survey() -> Survey:
    return Survey.preset("amulor-2010")


@pytest.mark.slow
def test_reach_falls_with_the_attenuation_and_with_the_accuracy(survey: Survey) -> None:
    order = ["pure", "IB", "II", "III", "1C", "3C", "5C"]
    assert list(WATERS) == order
    ends = {}
    for accuracy in (1e-3, 3e-3):
        found = [reach(survey, accuracy=accuracy, water=name) for name in order]
        assert np.all(np.diff([one.attenuation for one in found]) > 0)
        ends[accuracy] = [one.farthest for one in found]
        assert np.all(np.diff(ends[accuracy]) < 0)
    assert np.all(np.array(ends[3e-3]) > ends[1e-3])


def test_beyond_the_reach_the_accuracy_is_lost(survey: Survey) -> None:
    found = reach(survey, accuracy=3e-3, water="III")
    there = survey.with_({"water": WATERS["III"][1]})
    inside, outside = evaluate(
        there, distance=[found.farthest * 0.999, found.farthest * 1.15]
    )["total_error"].values
    # Late light is interpolated between a few distances, within some per cent.
    assert inside <= 3e-3 * 1.05
    assert outside > 3e-3


def test_an_accuracy_that_is_nowhere_met_is_said(survey: Survey) -> None:
    # The phase floor alone is 0.06 degrees: 0.48 mm at 39 MHz. A white target: before a
    # dark one the water of the sea, which depolarizes, counts more in either channel.
    found = reach(survey, accuracy=0.1e-3, water="II", reflectance=1.0)
    assert (found.nearest, found.farthest) == (None, None)
    assert found.binding == "phase floor"


@pytest.mark.slow
def test_the_command_prints_one_row_for_each_water(capsys) -> None:
    assert main(["survey", "presets", "--where", "--accuracy", "3 mm", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {
        "amulor-2010", "amulor-2010-long", "bartolini-2005", "green-2021"
    }  # fmt: skip
    # Light of 532 nm is lost less at a coast than 405 nm, and more in pure water.
    green, blue = (
        {one["water"]: one["attenuation"] for one in found[name]}
        for name in ("green-2021", "amulor-2010")
    )
    assert green["Jerlov 3C, coast"] < blue["Jerlov 3C, coast"]
    assert green["pure sea water"] > blue["pure sea water"]
    assert main(["survey", "presets", "--where"]) == 0
    assert "Jerlov II, open ocean" in capsys.readouterr().out
    assert main(["survey", "presets"]) == 0
    assert "10.7498/aps.70.20201612" in capsys.readouterr().out
