"""Light and shares of a design by closed forms: late light, depths, Sobol indices."""

from __future__ import annotations

import importlib
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.design import Goal, geometry, light
from amulor.design.candidates import first_choice
from amulor.design.light import Looks, case_of, late_uncertainty, values_on_axes
from amulor.optics import rays
from amulor.survey import Survey, water_properties
from amulor.survey.view import line_of_sight, medium_of

#: The package has a function of the same name.
sensitivity: Any = importlib.import_module("amulor.design.sensitivity")
NOTHING: Any = None


def looks_of(**changed: np.ndarray) -> Looks:
    values: dict[str, Any] = {
        "absorption": np.array([0.1, 0.3]), "scattering": np.array([0.25, 0.5]),
        "baseline": np.array([0.1, 0.1]), "tilt": np.array([0.05, 0.04]),
        "cross_tilt": np.zeros(2), "standoff": np.zeros(2),
        "radius": np.full(2, 0.02), "acceptance": np.full(2, 0.06),
        "back": np.ones((2, 3)),
    }  # fmt: skip
    return Looks(**values | changed)


def survey_with(column_end: float | None = None, error: float | None = None) -> Any:
    calibration = None
    if error is not None:
        calibration = SimpleNamespace(scattering_uncertainty=error)
    return SimpleNamespace(
        water=SimpleNamespace(column_end=column_end), calibration=calibration
    )


@pytest.mark.parametrize(
    ("absorption", "scattering", "end", "deepest", "farthest"),
    [
        # Seven attenuation lengths each way, with a tenth of the scattering.
        (0.1, 0.25, None, 2.0, 14 / (2 * 0.125)),
        (0.0, 0.0, None, 2.0, 150.0),
        (1e-3, 0.0, None, 2.0, 150.0),
        # Half as far again as the deepest target.
        (1.0, 0.0, None, 20.0, 30.0),
        (0.1, 0.25, 5.0, 2.0, 5.0),
        (0.1, 0.25, 5.0, 9.0, 9.0),
        (1.0, 0.0, 50.0, 2.0, 7.0),
    ],
)
def test_the_water_is_summed_until_it_has_faded(
    absorption: float, scattering: float, end: float | None, deepest: float,
    farthest: float,
) -> None:  # fmt: skip
    looks = looks_of(
        absorption=np.array([absorption, absorption + 1]),
        scattering=np.array([scattering, scattering + 1]),
    )
    found = light._farthest(survey_with(end), looks, np.array([1.0, 1.5, deepest]))
    assert found == pytest.approx(farthest)


WATER: Any = SimpleNamespace(
    scattering=0.25, forward_scattering=0.25, second_moment=0.06, group_index=1.38
)
PLACES: Any = [SimpleNamespace(depth=np.array([0.5]))]


def late(
    monkeypatch: pytest.MonkeyPatch, distance: np.ndarray, *, asymmetry: float = 0.95,
    error: float | None = None, water: Any = WATER,
) -> tuple[np.ndarray, list[Any]]:  # fmt: skip
    """Return the uncertainty of late light of 1 mm at 1 m, in proportion to depth."""
    asked: list[Any] = []

    def late_echo(frequency: float, *, depth: np.ndarray, **words: Any) -> np.ndarray:
        asked.append((frequency, depth, words))
        # A power of the depth: over its square the logarithms are on a line.
        even = 1e-3 * words["scattering"] / 0.25
        return np.asarray(even * depth**2 * (1 + np.log(depth)))

    monkeypatch.setattr(light, "late_echo", late_echo)
    monkeypatch.setattr(
        light,
        "whole_phase_function",
        lambda water: SimpleNamespace(asymmetry=asymmetry),
    )
    found = late_uncertainty(
        survey_with(error=error), water, looks_of(), PLACES, distance
    )
    return found, asked


@pytest.mark.parametrize("error", [None, 0.2])
def test_late_light_has_the_error_of_half_of_it_and_of_its_model(
    monkeypatch: pytest.MonkeyPatch, error: float | None
) -> None:
    # Half a meter of air is in front of the water.
    distance = np.array([2.0, 2.5, 3.0])
    found, asked = late(monkeypatch, distance, error=error)
    depth = distance - 1.5
    delay = 1e-3 * np.array([[1.0], [2.0]]) * depth**2 * (1 + np.log(depth))
    # Half the delay as a rectangle, and 5 % of three quarters of it.
    relative = np.hypot(0.05, error or 0.0) * 0.75
    expected = np.hypot(relative, 0.5 / np.sqrt(12)) * np.abs(delay)
    assert_allclose(found, expected, rtol=1e-9)
    assert asked[0][0] == 50e6
    assert asked[0][2]["split_angle"] == pytest.approx(math.pi / 2)


def test_many_distances_have_three_in_each_octave(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    distance = 1.5 + np.geomspace(0.5, 16.0, 200) - 0.5
    distance = distance - distance[0] + 1.5
    found, asked = late(monkeypatch, distance)
    depth = distance - 1.0
    # Five octaves and the ends.
    assert asked[0][1].size == 2 + 15
    assert_allclose(asked[0][1][[0, -1]], depth[[0, -1]])
    # On lines between them in the logarithm of the depth.
    delay = 1e-3 * depth**2 * (1 + np.log(depth))
    factor = np.hypot(0.05 * 0.75, 0.5 / np.sqrt(12))
    assert_allclose(found[0], factor * np.abs(delay), rtol=1e-6, atol=1e-9)
    one, _ = late(monkeypatch, np.array([2.5]))
    assert one.shape == (2, 1)


def test_water_without_small_angles_has_no_late_light(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    distance = np.array([2.0, 3.0])
    for asymmetry, has_late in ((0.601, True), (0.599, False)):
        found, _ = late(monkeypatch, distance, asymmetry=asymmetry)
        assert found.any() == has_late
    for changed in ({"scattering": 0.0}, {"second_moment": 0.0}):
        water = SimpleNamespace(**vars(WATER) | changed)
        assert not late(monkeypatch, distance, water=water)[0].any()


def test_an_attenuation_is_shared_as_in_the_water(tank: Survey) -> None:
    case = case_of(tank, water_properties(tank))
    found = values_on_axes(case, {"attenuation": np.array([0.7, 1.4])})
    # Of 0.35 / m 0.25 are scattering.
    assert_allclose(found["scattering"], np.array([0.7, 1.4]) * 0.25 / 0.35)
    assert_allclose(found["absorption"], np.array([0.7, 1.4]) * 0.1 / 0.35)
    plain = values_on_axes(case, {"power": np.array(0.5)})
    assert plain["power"] == 0.5
    assert plain["scattering"] == 0.25


def test_a_case_has_the_values_of_its_survey(tank: Survey) -> None:
    found = case_of(tank, water_properties(tank)).survey_values
    expected = {
        "reflectance": 0.2, "slope": 0.0, "texture": 0.1, "water_change": 0.01,
        "column_uncertainty": 0.1, "ratio_uncertainty": 0.01, "departure": 0.003,
        "absorption": 0.1, "scattering": 0.25, "power": 0.02,
        "modulation_depth": 0.8, "baseline": 0.1, "radius": 0.02,
        "field_of_view": 0.06, "dwell": 0.02, "phase_floor": np.radians(0.02),
        "dark_rate": 1e3, "fluctuation": 0.0, "radiance": 0.0, "speed": 0.0,
        # 10 cm aside, looking 50 mrad inwards.
        "aim": 0.1 / math.tan(0.05),
    }  # fmt: skip
    assert found.keys() >= expected.keys()
    for name, value in found.items():
        # What a plate in a tank does not have, such as a speed, is zero.
        assert value == pytest.approx(expected.get(name, 0.0), rel=1e-2), name
    bare = tank.with_({"targets": []})
    assert case_of(bare, water_properties(bare)).survey_values["reflectance"] == 0.1


def test_a_receiver_without_a_tilt_meets_the_beam_nowhere(tank: Survey) -> None:
    straight = tank.with_({"instrument.receiver.azimuth": "0 rad"})
    assert geometry.aim_of(straight) == math.inf
    beside = tank.with_({"instrument.receiver.position": ["0 m", "0 m", "0 m"]})
    assert geometry.aim_of(beside) == math.inf
    moved = geometry.with_receiver(straight, baseline=0.2, aim=math.inf)
    receiver = moved.instrument.receiver
    assert receiver.position == pytest.approx((0.2, 0.0, 0.0))
    assert receiver.azimuth == pytest.approx(tank.scan.azimuth)
    # A receiver at the emitter is moved to the right.
    aside = geometry.with_receiver(beside, baseline=0.3, aim=2.0)
    assert aside.instrument.receiver.position == pytest.approx((0.3, 0.0, 0.0))
    assert aside.instrument.receiver.azimuth == pytest.approx(
        -math.atan(0.15), rel=1e-6
    )


def test_shares_of_a_product_of_powers_are_its_squares(
    monkeypatch: pytest.MonkeyPatch, goal_text: str
) -> None:
    goal = Goal.from_text(goal_text)
    chosen = first_choice(goal)
    numbers = sensitivity.uncertain(goal, chosen)
    powers = {one.axis: 0.3 * (k + 1) for k, one in enumerate(numbers)}
    asked: list[Any] = []

    def evaluate(survey: Survey, **axes: Any) -> xr.Dataset:
        asked.append(axes)
        logarithm = sum(
            powers[one.axis] * np.log(axes[one.axis] / np.sqrt(one.low * one.high))
            for one in numbers
        )
        error = 1e-3 * np.exp(logarithm)
        # The farther distance is the worse one.
        far = xr.DataArray([0.5, 1.0], dims="distance")
        return xr.Dataset({"total_error": far * error})

    monkeypatch.setattr(sensitivity, "evaluate", evaluate)
    found = sensitivity.sensitivity(goal, chosen, samples=1024)
    variances = []
    for one in numbers:
        values = np.log(np.concatenate([asked[k][one.axis] for k in (0, 1)]))
        variances.append((powers[one.axis] * np.std(values)) ** 2)
        if not one.stated:
            # Evenly in the logarithm, from half to twice: (ln 4)^2 / 12.
            low, high = np.log(one.low), np.log(one.high)
            assert np.var(values) == pytest.approx((high - low) ** 2 / 12, rel=0.02)
        assert values.min() >= np.log(one.low) - 1e-9 or one.axis == "attenuation"
    shares = np.array(variances) / np.sum(variances)
    assert_allclose(found.total, shares, atol=0.05)
    assert_allclose(found.first, shares, atol=0.05)
    assert found.spread == pytest.approx(np.sqrt(np.sum(variances)), rel=0.03)
    assert found.largest == numbers[int(np.argmax(shares))]
    assert (found.total_error > 0).all()
    assert found.total_error.max() < 0.1
    # One run for each number beside two; all of the goal's assumptions.
    assert len(asked) == len(numbers) + 2
    assert_allclose(asked[0]["distance"], goal.asked)
    assert asked[0]["interval"] == goal.limits


def test_ranges_of_assumptions_end_at_one(goal_text: str) -> None:
    goal = Goal.from_text(goal_text)
    assumptions = goal.assumptions.model_copy(update={"water_change": 0.7})
    goal = goal.model_copy(update={"assumptions": assumptions})
    found = {one.axis: one for one in sensitivity.uncertain(goal, first_choice(goal))}
    assert (found["water_change"].low, found["water_change"].high) == (0.35, 1.0)
    power = first_choice(goal).power
    assert (found["power"].low, found["power"].high) == (power / 2, power * 2)
    assert found["reflectance"].stated
    assert not found["power"].stated
    # No dark counts are nothing that could be more.
    none = goal.detector.model_copy(update={"dark_rate": 0.0})
    dark = goal.model_copy(update={"detector": none})
    axes = {one.axis for one in sensitivity.uncertain(dark, first_choice(dark))}
    assert "dark_rate" not in axes


def test_a_receiver_moves_away_from_its_emitter(tank: Survey) -> None:
    aside = tank.with_(
        {
            "instrument.emitter.position": [0.1, -0.2, 0.05],
            "instrument.receiver.position": [0.4, 0.2, 0.05],
        }
    )
    found = geometry.with_receiver(aside, baseline=1.0, aim=2.0)
    receiver = found.instrument.receiver
    # Along the same direction, 0.6 to the right and 0.8 down.
    assert receiver.position == pytest.approx((0.7, 0.6, 0.05))
    # Its axis meets the beam, which goes straight ahead, two meters on.
    way = np.array([0.1, -0.2, 2.05]) - receiver.position
    assert receiver.azimuth == pytest.approx(math.atan2(way[0], way[2]))
    elevation = -math.asin(way[1] / np.linalg.norm(way))
    assert receiver.elevation == pytest.approx(elevation)
    assert geometry.aim_of(found) == pytest.approx(2.0, rel=0.15)


def test_behind_a_window_the_axis_meets_the_beam_where_it_is_aimed(
    tank: Survey,
) -> None:
    window = {"distance": "20 cm", "thickness": "1 cm"}
    behind = tank.with_({"instrument.window": window})
    for aim in (1.0, 3.0):
        found = geometry.with_receiver(behind, baseline=0.15, aim=aim)
        seen = geometry.place_of(found, np.array([aim]))
        # Of the receiver's own ray, in the water: both meet at the aim.
        sight = line_of_sight(found, np.zeros(()), np.zeros(()))
        beam = rays.enter_water(
            found.instrument.emitter.position,
            rays.direction(np.zeros(()), np.zeros(())),
            medium=medium_of(found),
        )
        point = beam.entry + seen.depth[0] * beam.direction
        way = point - sight.entry
        off = way - (way @ sight.direction) * sight.direction
        assert np.linalg.norm(off) < 1e-5
