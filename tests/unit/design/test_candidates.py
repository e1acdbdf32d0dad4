"""Candidates of a goal: prices, times, quantiles and surveys by closed forms."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import truncnorm

from amulor.design import Goal, candidates
from amulor.design.candidates import (
    aim_of_goal,
    box_values,
    cost_of,
    depolarizing,
    drawn,
    first_choice,
    fits,
    frequency_grid,
    middle,
    scan_time,
    spreads_of,
    survey_of,
    values_at,
    water_scale,
)
from amulor.errors import SurveyError


@pytest.fixture
def goal(goal_text: str) -> Goal:
    return Goal.from_text(goal_text)


def changed(goal: Goal, part: str, **values: Any) -> Goal:
    return goal.model_copy(update={part: getattr(goal, part).model_copy(update=values)})


SHARE = np.array([0.0, 0.01, 0.3, 0.5, 0.9, 1.0])


@pytest.mark.parametrize("logarithmic", [False, True])
@pytest.mark.parametrize("normal", [False, True])
def test_quantiles_are_those_of_their_distribution(
    goal: Goal, logarithmic: bool, normal: bool
) -> None:
    spread = goal.targets.reflectance
    name = ("log-" if logarithmic else "") + ("normal" if normal else "uniform")
    low, high = 0.1, 0.4
    spread = spread.model_copy(update={"low": low, "high": high, "distribution": name})
    ends = np.log([low, high]) if logarithmic else np.array([low, high])
    place = SHARE
    if normal:
        # The ends hold 95 %; twice as far on each side nothing is drawn.
        place = 0.5 + truncnorm(-3.919928, 3.919928).ppf(SHARE) / (2 * 1.959964)
    expected = ends[0] + (ends[1] - ends[0]) * place
    expected = np.exp(expected) if logarithmic else np.clip(expected, 1e-6, 1.0)
    assert_allclose(values_at(spread, SHARE), expected, rtol=1e-6, atol=1e-9)
    assert middle(spread) == pytest.approx(
        math.sqrt(low * high) if logarithmic else 0.25
    )


def test_normal_values_stay_within_what_is_possible(goal: Goal) -> None:
    spread = goal.targets.reflectance.model_copy(
        update={"low": 0.1, "high": 0.95, "distribution": "normal"}
    )
    found = values_at(spread, np.array([0.0, 1.0]))
    assert found.tolist() == [1e-6, 1.0]
    assert goal.waters.fluctuation is not None
    none = goal.waters.fluctuation.model_copy(
        update={"low": 0.0, "high": 0.1, "distribution": "normal"}
    )
    assert values_at(none, np.array([0.0]))[0] == 0.0


def test_draws_are_as_many_as_the_effort(goal: Goal) -> None:
    assert set(spreads_of(goal)) == {"attenuation", "fluctuation", "reflectance"}
    whole, few = drawn(goal), drawn(goal, 3)
    for name, values in whole.items():
        assert values.shape == (8,)
        assert_allclose(few[name], values[:3])
        spread = spreads_of(goal)[name]
        assert values.min() >= spread.low
        assert values.max() <= spread.high
    assert drawn(goal, 100)["reflectance"].shape == (8,)
    odd = changed(goal, "effort", draws=5)
    assert drawn(odd)["reflectance"].shape == (5,)


def test_prices_of_the_parts_add_up(goal: Goal) -> None:
    laser = goal.components.lasers[0].model_copy(
        update={"price": 100.0, "price_per_watt": 2000.0}
    )
    box = goal.components.radius.model_copy(update={"prices": (10.0, 40.0)})
    modulation = goal.components.modulation.model_copy(update={"price_each": 7.0})
    priced = changed(
        goal, "components", lasers=(laser,), radius=box, modulation=modulation,
        price_per_channel=5.0,
    )  # fmt: skip
    chosen = replace(
        first_choice(priced), power=0.03, radius=0.0175, polarization="VV+VH+RR",
        frequencies=(15e6, 34e6, 52e6),
    )  # fmt: skip
    # Beyond the first frequency and channel; the radius between its two prices.
    expected = 100 + 2000 * 0.03 + 7 * 2 + 5 * 2 + 10 + 30 * 0.75
    assert cost_of(priced, chosen) == pytest.approx(expected)
    assert cost_of(goal, chosen) == 0.0
    # Three channels of three frequencies in 1200 pixels.
    assert scan_time(goal, chosen) == pytest.approx(1200 * 9 * chosen.dwell)


def test_mueller_matrices_are_scaled_to_their_second_element() -> None:
    found = np.array(depolarizing([0.8, -0.8, -0.6], 0.4))
    assert_allclose(found, np.diag([1.0, 0.4, -0.4, -0.3]))
    # What keeps nothing is scaled from a mirror.
    none = np.array(depolarizing("ideal-depolarizer", 0.3))
    assert_allclose(none, np.diag([1.0, 0.3, -0.3, -0.3]))


def test_components_have_listed_values_or_a_range(goal: Goal) -> None:
    assert box_values(goal.components.radius) == (0.01, 0.02)
    spread = goal.components.radius.model_copy(
        update={"values": (), "low": 0.01, "high": 0.04, "count": 3}
    )
    assert box_values(spread) == pytest.approx((0.01, 0.02, 0.04))
    assert frequency_grid(goal) == (15e6, 34e6, 52e6, 75e6, 120e6)
    sets = changed(
        goal, "components", modulation=goal.components.modulation.model_copy(
            update={"sets": ((15e6, 75e6), (34e6,), (15e6, 34e6)), "frequencies": ()}
        )
    )  # fmt: skip
    assert frequency_grid(sets) == (15e6, 34e6, 75e6)
    assert first_choice(sets).frequencies == (15e6, 75e6)
    evenly = changed(
        goal, "components", modulation=goal.components.modulation.model_copy(
            update={"frequencies": (), "lowest": 10e6, "highest": 160e6, "count": 5}
        )
    )  # fmt: skip
    assert frequency_grid(evenly) == pytest.approx((10e6, 20e6, 40e6, 80e6, 160e6))


def test_receivers_aim_at_the_harmonic_mean_of_the_distances(goal: Goal) -> None:
    assert aim_of_goal(goal) == pytest.approx(2 / (1 / 1.5 + 1 / 2.5))
    assert aim_of_goal(goal.model_copy(update={"aim": 1.7})) == 1.7


def test_methods_get_the_channels_that_they_need(goal: Goal) -> None:
    parts = changed(
        goal, "components", polarizations=("VH", "VV + VH", "RR+VV"),
        methods=("open-water", "polarization"),
    )  # fmt: skip
    assert list(fits(parts)) == [
        ("VH", "open-water"), ("VV+VH", "open-water"), ("VV+VH", "polarization"),
        ("RR+VV", "open-water"),
    ]  # fmt: skip
    three = changed(
        goal, "components", polarizations=("RR+VV+VH",), methods=("combined",)
    )
    assert list(fits(three)) == [("RR+VV+VH", "combined")]
    none = changed(goal, "components", polarizations=("VH",), methods=("combined",))
    with pytest.raises(SurveyError, match="no polarization scheme fits a method"):
        list(fits(none))


def test_the_survey_of_a_candidate_has_its_parts(goal: Goal) -> None:
    chosen = replace(
        first_choice(goal), power=0.03, radius=0.02, field_of_view=0.07, baseline=0.2,
        dwell=0.03, frequencies=(15e6, 52e6), polarization="VV+VH",
    )  # fmt: skip
    survey = survey_of(goal, chosen)
    distance = aim_of_goal(goal)
    (target,) = survey.targets
    assert target.position == pytest.approx((0.0, 0.0, distance))
    # A tenth wider than the scan, and 10 cm.
    span = goal.scan.azimuth_span, goal.scan.elevation_span
    size = [2.2 * distance * math.tan(part / 2) + 0.1 for part in span]
    assert (target.width, target.height) == pytest.approx(tuple(size))  # type: ignore[union-attr]
    assert target.reflectance == pytest.approx(0.2)
    assert survey.water.signal_fluctuation == pytest.approx(0.03)
    instrument = survey.instrument
    assert instrument.power == 0.03
    assert instrument.modulation_frequencies == (15e6, 52e6)
    assert instrument.polarizations == ("VV", "VH")
    assert instrument.receiver.radius == 0.02
    assert instrument.receiver.acceptance == 0.07
    assert instrument.receiver.position == pytest.approx((0.2, 0.0, 0.0))
    assert instrument.receiver.azimuth == pytest.approx(-math.atan(0.2 / distance))
    # A tenth of the dwell at most, of 5 ms.
    assert instrument.lock_in.time_constant == pytest.approx(3e-3)
    slow = survey_of(goal, replace(chosen, dwell=0.12))
    assert slow.instrument.lock_in.time_constant == pytest.approx(5e-3)
    assert survey.scan.dwell == 0.03


def test_water_of_another_laser_is_scaled_from_the_first(
    goal: Goal, monkeypatch: pytest.MonkeyPatch
) -> None:
    blue = goal.components.lasers[0].model_copy(
        update={"name": "blue", "wavelength": 450e-9}
    )
    both = changed(goal, "components", lasers=(goal.components.lasers[0], blue))
    chosen = first_choice(both)
    assert water_scale(both, chosen) == {}
    values = {"green": (0.4, 0.1, 0.3), "blue": (0.6, 0.2, 0.0)}

    class Coefficients:
        def __init__(self, name: str) -> None:
            self.attenuation, self.absorption, self.scattering = values[name]

    monkeypatch.setattr(candidates, "survey_of", lambda goal, chosen: chosen.laser)
    monkeypatch.setattr(candidates, "water_properties", Coefficients)
    found = water_scale(both, replace(chosen, laser="blue"))
    assert found == pytest.approx(
        {"attenuation": 1.5, "absorption": 2.0, "scattering": 0.0}
    )
    values["green"] = (0.4, 0.0, 0.3)
    found = water_scale(both, replace(chosen, laser="blue"))
    assert found.keys() == {"attenuation", "scattering"}
    with pytest.raises(SurveyError, match="no laser of the goal is called 'red'"):
        candidates.laser_of(goal, "red")


def test_parameters_are_written_in_plain_numbers(goal: Goal) -> None:
    chosen = replace(first_choice(goal), frequencies=(15e6, 52e6))
    found = chosen.to_dict()
    assert found["frequencies"] == [15e6, 52e6]
    assert found["laser"] == "green"
    assert found["power"] == 0.01
