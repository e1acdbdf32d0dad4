"""Limits of each number in a goal, its defaults, and what contradicts itself."""

from __future__ import annotations

import math
from typing import Any

import pytest
from numpy.testing import assert_allclose
from pydantic import BaseModel, ValidationError

from amulor.design import Goal
from amulor.design.goal import (
    Accuracy,
    AngleBox,
    AngleSpread,
    Assumptions,
    CoefficientSpread,
    Components,
    DistanceRange,
    Effort,
    FractionSpread,
    Interval,
    Laser,
    LengthBox,
    Modulation,
    ScanGoal,
    TimeBox,
    Waters,
)
from amulor.design.vehicle import Vehicle
from amulor.errors import SurveyError

LASER = {"name": "green", "wavelength": 532e-9, "powers": (0.01,)}
SCAN = {
    "columns": 4, "rows": 3, "azimuth_span": 0.1, "elevation_span": 0.1, "longest": 60.0
}  # fmt: skip
VEHICLE = {
    "slowest": 0.1, "fastest": 1.0, "length": 10.0, "width": 5.0, "row_spacing": 0.01
}  # fmt: skip
EPS = 1e-9
#: Class, other fields, field, values at or within its limits, values beyond.
LIMITS: list[tuple[type[BaseModel], dict[str, Any], str, list[Any], list[Any]]] = [
    (CoefficientSpread, {"high": 1.0}, "low", [0.0], [-EPS]),
    (CoefficientSpread, {"low": 0.0}, "high", [EPS], [0.0]),
    (FractionSpread, {"high": 1.0}, "low", [0.0, 1.0], [-EPS]),
    (FractionSpread, {"low": 0.0}, "high", [0.0, 1.0], [1 + EPS]),
    (AngleSpread, {"high": 1.0}, "low", [0.0, 1.0], [-EPS]),
    (AngleSpread, {"low": 0.0}, "high", [0.0, 1.0], [1 + EPS]),
    (DistanceRange, {"farthest": 100.0}, "nearest", [EPS], [0.0]),
    (DistanceRange, {"nearest": 1.0}, "farthest", [100.0], [100 + EPS, 1.0]),
    (DistanceRange, {"nearest": 1.0, "farthest": 2.0}, "count", [2, 20], [1, 21]),
    (Interval, {"farthest": 2.0}, "nearest", [0.0], [-EPS, 2.0]),
    (Interval, {"nearest": 0.0}, "farthest", [EPS], [0.0]),
    (Accuracy, {}, "total_error", [EPS], [0.0]),
    (Accuracy, {"total_error": 1.0}, "share", [EPS, 1.0], [0.0, 1 + EPS]),
    (Accuracy, {"total_error": 1.0}, "wrong_interval", [EPS, 0.499], [0.0, 0.5]),
    (ScanGoal, SCAN, "columns", [1, 20_000], [0, 20_001]),
    (ScanGoal, SCAN, "rows", [1, 20_000], [0, 20_001]),
    (ScanGoal, SCAN, "azimuth_span", [0.0, 3.141], [-EPS, math.pi]),
    (ScanGoal, SCAN, "elevation_span", [0.0, 3.141], [-EPS, math.pi]),
    (ScanGoal, SCAN, "longest", [EPS], [0.0]),
    (Laser, LASER, "name", ["a", "a" * 80], ["", "a" * 81]),
    (Laser, LASER, "wavelength", [400e-9, 700e-9], [399.9e-9, 700.1e-9]),
    (Laser, LASER, "powers", [(EPS,), (1.0,) * 20], [(), (0.0,), (1.0,) * 21]),
    (Laser, LASER, "modulation_depth", [EPS, 1.0], [0.0, 1 + EPS]),
    (Laser, LASER, "top_frequency", [EPS, 10e9], [0.0, 10.1e9]),
    (Laser, LASER, "beam_radius", [0.0, 0.5], [-EPS, 0.51]),
    (Laser, LASER, "beam_divergence", [0.0, 0.2], [-EPS, 0.21]),
    (Laser, LASER, "quantum_efficiency", [EPS, 1.0], [0.0, 1 + EPS]),
    (Laser, LASER, "price", [0.0], [-EPS, math.inf]),
    (Modulation, {"lowest": 1e6, "highest": 2e6}, "count", [2, 200], [1, 201]),
    (Modulation, {"highest": 2e6}, "lowest", [EPS], [0.0, 2e6]),
    (Modulation, {"lowest": 1e6}, "highest", [10e9], [10.1e9, 1e6]),
    (Modulation, {"frequencies": (1e6,)}, "most", [1, 6], [0, 7]),
    (Modulation, {}, "sets", [((1e6,),)], [((),), ((2e6, 1e6),), ((1e6, 1e6),)]),
    (Modulation, {}, "frequencies", [(1e6, 2e6)], [(2e6, 1e6), (1e6, 1e6), ()]),
    (LengthBox, {"low": 1.0, "high": 2.0}, "count", [2, 50], [1, 51]),
    (LengthBox, {}, "values", [(EPS,), (1.0, 2.0)], [(0.0,), (1.0, 1.0), ()]),
    (LengthBox, {"high": 2.0}, "low", [EPS], [0.0, 2.0]),
    (AngleBox, {}, "values", [(EPS, 0.5)], [(0.0,), (0.51,), (0.2, 0.1)]),
    (AngleBox, {"high": 0.5}, "low", [EPS], [0.0, 0.5]),
    (AngleBox, {"low": 0.1}, "high", [0.5], [0.51, 0.1]),
    (TimeBox, {}, "values", [(EPS, 1.0)], [(0.0,), (1.0, 0.5)]),
    (TimeBox, {"high": 1.0}, "low", [EPS], [0.0]),
    *[
        (Assumptions, {}, name, [0.0, 1.0], [-EPS, 1 + EPS])
        for name in Assumptions.model_fields
    ],
    (Effort, {}, "draws", [4, 4096], [3, 4097]),
    (Effort, {}, "refined", [1, 50], [0, 51]),
    (Vehicle, VEHICLE, "slowest", [EPS, 1.0], [0.0, 1.1]),
    (Vehicle, VEHICLE, "fastest", [20.0, 0.1], [20.1, 0.09]),
    (Vehicle, VEHICLE, "length", [EPS, 1e5], [0.0, 1.01e5]),
    (Vehicle, VEHICLE, "width", [EPS, 1e5], [0.0, 1.01e5]),
    (Vehicle, VEHICLE, "row_spacing", [EPS, 10.0], [0.0, 10.1]),
    (Vehicle, VEHICLE, "smear", [EPS, 10.0, None], [0.0, 10.1]),
    (Vehicle, VEHICLE, "overlap", [0.0, 0.9], [-EPS, 0.91]),
    (Vehicle, VEHICLE, "turn", [0.0, 3600.0], [-EPS, 3601.0]),
    (Vehicle, VEHICLE, "readings", [("at-once",)], [(), ("never",)]),
]


@pytest.mark.parametrize(
    ("kind", "others", "name", "good", "bad"),
    LIMITS,
    ids=[f"{kind.__name__}-{name}" for kind, _, name, _, _ in LIMITS],
)
def test_a_number_is_taken_up_to_its_limits(
    kind: type[BaseModel],
    others: dict[str, Any],
    name: str,
    good: list[Any],
    bad: list[Any],
) -> None:
    for value in good:
        assert getattr(kind(**{**others, name: value}), name) == value
    for value in bad:
        with pytest.raises(ValidationError):
            kind(**{**others, name: value})


def test_what_is_not_stated_has_its_usual_value() -> None:
    assert DistanceRange(nearest=1, farthest=2).count == 5
    accuracy = Accuracy(total_error=1)
    assert (accuracy.share, accuracy.wrong_interval) == (0.9, 0.001)
    scan = ScanGoal(**SCAN)
    assert scan.moves == "both"
    shots = scan.open_water
    assert (shots.columns, shots.rows, shots.repeats) == (9, 3, 20)
    laser = Laser(**LASER)
    assert (laser.modulation_depth, laser.price, laser.price_per_watt) == (0.8, 0, 0)
    assert laser.top_frequency is laser.beam_radius is laser.beam_divergence is None
    modulation = Modulation(lowest=1e6, highest=2e6)
    assert (modulation.count, modulation.most, modulation.price_each) == (25, 2, 0)
    box = LengthBox(low=1.0, high=2.0)
    assert (box.count, box.prices, box.values) == (4, (), ())
    assert (Effort().draws, Effort().refined) == (64, 4)
    assert Assumptions().model_dump() == {
        "water_change": 0.01, "column_uncertainty": 0.1, "ratio_uncertainty": 0.01,
        "departure": 0.003,
    }  # fmt: skip
    vehicle = Vehicle(**VEHICLE)
    assert (vehicle.overlap, vehicle.turn, vehicle.smear) == (0.2, 0, None)
    assert vehicle.readings == ("at-once", "in-turn")
    assert Components.model_fields["methods"].default == ("open-water",)
    assert FractionSpread(low=0, high=1).distribution == "uniform"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: FractionSpread(low=0.3, high=0.2),
            r"low \(0\.3\) must not exceed high \(0\.2\)",
        ),
        (
            lambda: FractionSpread(low=0, high=1, distribution="log-uniform"),
            "a log-uniform distribution needs low above 0, found 0",
        ),
        (
            lambda: DistanceRange(nearest=2, farthest=1),
            r"farthest \(1 m\) must lie beyond nearest \(2 m\)",
        ),
        (lambda: Modulation(), "one of these"),
        (lambda: Modulation(lowest=1e6), "needs lowest and highest"),
        (lambda: Modulation(frequencies=(1e6,), sets=((1e6,),)), "one of these"),
        (lambda: Modulation(lowest=1e6, highest=2e6, sets=((1e6,),)), "one of these"),
        (
            lambda: Modulation(lowest=2e6, highest=1e6),
            r"highest \(1e\+06 Hz\) must lie above lowest \(2e\+06 Hz\)",
        ),
        (
            lambda: Modulation(sets=((1e6,), (3e6, 2e6))),
            "hold each one once; found 3 MHz, 2 MHz",
        ),
        (lambda: LengthBox(), "state values to choose from, or low and high"),
        (lambda: LengthBox(values=(1.0,), low=1.0, high=2.0), "state values to choose"),
        (lambda: LengthBox(high=2.0), "low first; found None, 2"),
        (lambda: LengthBox(low=3.0, high=2.0), "low first; found 3.0, 2.0"),
        (lambda: LengthBox(values=(2.0, 1.0)), "must increase; found 2, 1"),
        (
            lambda: LengthBox(values=(1.0, 2.0), prices=(5.0,)),
            "2 values need as many prices, found 1",
        ),
        (
            lambda: Vehicle(**{**VEHICLE, "slowest": 2.0}),
            r"slowest \(2 m/s\) must not exceed fastest \(1 m/s\)",
        ),
    ],
)
def test_what_contradicts_itself_is_refused(make: Any, message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        make()


def test_prices_are_those_of_values_and_lasers_have_names_of_their_own(
    goal_text: str,
) -> None:
    assert LengthBox(values=(1.0, 2.0), prices=(5.0, 0.0)).prices == (5, 0)
    goal = Goal.from_text(goal_text)
    parts = {name: getattr(goal.components, name) for name in Components.model_fields}
    laser = parts["lasers"][0]
    other = laser.model_copy(update={"name": "blue"})
    assert len(Components(**parts | {"lasers": (laser, other)}).lasers) == 2
    with pytest.raises(ValidationError, match="two lasers are called 'green'"):
        Components(**parts | {"lasers": (other, laser, laser)})
    for scheme, good in (("VV + VH", True), ("VV+", False), ("XX", False)):
        if good:
            assert Components(**parts | {"polarizations": (scheme,)})
        else:
            with pytest.raises(ValidationError):
                Components(**parts | {"polarizations": (scheme,)})


def test_an_attenuation_is_stated_alone(goal_text: str) -> None:
    waters = Goal.from_text(goal_text).waters
    spread = CoefficientSpread(low=0.1, high=0.2)
    for name in ("absorption", "scattering"):
        with pytest.raises(ValidationError, match="attenuation is the sum"):
            Waters(base=waters.base, attenuation=spread, **{name: spread})
        assert Waters(base=waters.base, **{name: spread}).attenuation is None
    assert Waters(base=waters.base, absorption=spread, scattering=spread)


def test_distances_are_sorted_or_evenly_spaced(goal_text: str) -> None:
    goal = Goal.from_text(goal_text)
    listed = goal.model_copy(update={"distances": (3.0, 1.0, 2.0)})
    assert listed.asked == (1, 2, 3)
    spaced = DistanceRange(nearest=1.0, farthest=3.0, count=5)
    assert_allclose(
        goal.model_copy(update={"distances": spaced}).asked, [1, 1.5, 2, 2.5, 3]
    )
    assert goal.limits == (0.5, 4)
    free = goal.model_copy(update={"interval": None})
    assert free.limits == (0, pytest.approx(1.1 * 2.5))
    assert goal.assumed == {
        "texture": 0, "water_change": 0.01, "column_uncertainty": 0.1,
        "ratio_uncertainty": 0.01, "departure": 0.003,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("nearest", "farthest", "message"),
    [
        ("1.5 m", "2.6 m", None),
        ("1.6 m", "2.6 m", r"holds 1\.5 m, .* from 1\.6 to 2\.6 m"),
        ("1.4 m", "2.5 m", r"holds 2\.5 m, .* from 1\.4 to 2\.5 m"),
    ],
)
def test_distances_lie_within_their_interval(
    goal_text: str, nearest: str, farthest: str, message: str | None
) -> None:
    text = goal_text.replace('nearest = "0.5 m"', f'nearest = "{nearest}"')
    text = text.replace('farthest = "4 m"', f'farthest = "{farthest}"')
    if message is None:
        assert Goal.from_text(text).asked == (1.5, 2.5)
    else:
        with pytest.raises(SurveyError, match=message):
            Goal.from_text(text)


def test_rows_are_of_the_scan_or_of_the_vehicle(goal_text: str) -> None:
    drives = (
        '[vehicle]\nslowest = "0.1 m/s"\nfastest = "1 m/s"\nlength = "9 m"\n'
        'width = "3 m"\nrow_spacing = "1 cm"\n[components]\n'
    )
    on_vehicle = goal_text.replace("[components]\n", drives)
    bare = goal_text.replace("rows = 30\n", "").replace(
        'elevation_span = "3 deg"\n', ""
    )
    for text, message in (
        (goal_text.replace("rows = 30\n", ""), "scan needs rows and elevation_span"),
        (bare, "scan needs rows and elevation_span"),
        (on_vehicle, r"scan\.rows and \[vehicle\] are both stated"),
        (
            on_vehicle.replace("rows = 30\n", ""),
            r"scan\.elevation_span and \[vehicle\] are both stated",
        ),
        (
            bare.replace("[components]\n", drives).replace('"4 deg"', '"0 deg"', 1),
            "azimuth_span is 0, so that survey lines have no width",
        ),
    ):
        with pytest.raises(SurveyError, match=message):
            Goal.from_text(text)
    goal = Goal.from_text(bare.replace("[components]\n", drives))
    assert goal.vehicle is not None
    assert goal.scan.rows is None


def vehicle(**changes: Any) -> Vehicle:
    return Vehicle(**{**VEHICLE, "slowest": 0.01, **changes})


@pytest.mark.parametrize(
    ("changes", "speed"),
    [
        # Rows of 10 pixels of 10 ms: 1 cm in a tenth of a second.
        ({}, 0.1),
        ({"row_spacing": 0.002}, 0.02),
        ({"smear": 0.0005}, 0.05),
        ({"fastest": 0.03}, 0.03),
        ({"row_spacing": 0.0005}, 0.01),
    ],
)
def test_a_vehicle_drives_by_its_tightest_limit(
    changes: dict[str, Any], speed: float
) -> None:
    lines = vehicle(overlap=0.0, turn=7.0, **changes).plan(
        columns=10, span=2 * math.atan(0.25), nearest=2.0, farthest=3.0, pixel_time=0.01
    )
    assert lines.speed == pytest.approx(speed)
    # Strips of 1 m over 5 m.
    assert lines.swath == pytest.approx(1)
    assert (lines.count, lines.spacing, lines.length) == (5, pytest.approx(1), 10)
    assert lines.time == pytest.approx(5 * 10 / speed + 4 * 7)
    assert lines.between_rows == pytest.approx(0.1 * speed)
    assert lines.along_readings == pytest.approx(0.01 * speed)
    assert lines.between_columns == pytest.approx(3 * 2 * math.atan(0.25) / 9)
    assert lines.spot == 0


def test_strips_overlap_and_a_single_column_has_its_span() -> None:
    common = {"nearest": 2.0, "farthest": 3.0, "pixel_time": 0.01, "spot": 0.02}
    span = 2 * math.atan(0.25)
    found = vehicle(overlap=0.25, width=4.1).plan(columns=1, span=span, **common)
    # 3.1 m beyond the first strip, at most 0.75 m each: five more.
    assert found.count == 6
    assert found.spacing == pytest.approx(3.1 / 5)
    assert found.between_columns == pytest.approx(3 * span)
    assert found.spot == 0.02
    just = vehicle(overlap=0.25, width=4.0).plan(columns=1, span=span, **common)
    assert just.count == 5
    one = vehicle(width=1.0 - 1e-6).plan(columns=1, span=span, **common)
    assert (one.count, one.spacing) == (1, 0)


def test_the_longest_pixel_meets_time_density_and_smear() -> None:
    span = 2 * math.atan(0.25)
    common = {"columns": 10, "span": span, "nearest": 2.0}
    drives = vehicle(overlap=0.0, turn=5.0)
    # Five lines of 10 m and four turns of 5 s in 120 s: 0.5 m/s, and 1 mm for a pixel.
    assert drives.longest_pixel(longest=120.0, **common) == pytest.approx(0.002)
    # A minute takes more than the fastest speed, a day less than the slowest one, and
    # turns alone take 20 s.
    for longest, speed in ((60.0, 1.0), (86400.0, 0.01), (20.0, 1.0), (19.0, 1.0)):
        found = drives.longest_pixel(longest=longest, **common)
        assert found == pytest.approx(0.001 / speed)
    smeared = vehicle(overlap=0.0, turn=5.0, smear=0.0004)
    assert smeared.longest_pixel(longest=120.0, **common) == pytest.approx(0.0008)
