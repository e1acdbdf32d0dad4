"""Instruments on a vehicle: survey lines, order of readings, and what both cost."""

from __future__ import annotations

import itertools
import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor import imaging, rejection
from amulor.cli.design import _print_choice
from amulor.design import Goal, Recommendation, evaluate, recommend
from amulor.design._kernels import astray
from amulor.design.candidates import first_choice, lines_of, scan_time, survey_of
from amulor.design.requirements import lines_texts
from amulor.design.scores import Judge, grid_of
from amulor.design.vehicle import Vehicle
from amulor.errors import SurveyError
from amulor.simulation import simulate
from amulor.survey import Survey
from amulor.survey.course import planned_spacing, planned_track
from amulor.view.design.report import _components

VEHICLE = """
[vehicle]
slowest = "0.05 m/s"
fastest = "0.4 m/s"
length = "6 m"
width = "50 cm"
row_spacing = "1 cm"
turn = "10 s"
[components]
"""


def vehicle(**changed: Any) -> Vehicle:
    values = {
        "slowest": 0.05, "fastest": 0.4, "length": 20.0, "width": 5.0,
        "row_spacing": 0.006,
    }  # fmt: skip
    return Vehicle(**{**values, **changed})


@pytest.fixture(scope="module")
def text(goal_text: str) -> str:
    """Return the goal of the tank, on a vehicle."""
    rows = 'rows = 30\nazimuth_span = "4 deg"\nelevation_span = "3 deg"\n'
    assert rows in goal_text
    changed = goal_text.replace(rows, 'azimuth_span = "4 deg"\n')
    changed = changed.replace('values = ["30 ms", "60 ms", "120 ms"]', DWELL)
    changed = changed.replace('time_constant = "5 ms"', 'time_constant = "100 us"')
    return changed.replace("[components]\n", VEHICLE)


DWELL = 'low = "0.2 ms"\nhigh = "5 ms"'

lengths = st.floats(0.5, 100.0)


@given(
    width=lengths, length=lengths, nearest=st.floats(0.5, 10.0),
    span=st.floats(0.01, 1.5), overlap=st.floats(0.0, 0.9), turn=st.floats(0.0, 60.0),
)  # fmt: skip
def test_lines_cover_the_area_with_the_overlap_and_none_is_too_many(
    width, length, nearest, span, overlap, turn
) -> None:
    one = vehicle(width=width, length=length, overlap=overlap, turn=turn)
    lines = one.plan(
        columns=50, span=span, nearest=nearest, farthest=nearest, pixel_time=1e-3
    )
    # Both edges of a strip are seen under half of the angle.
    strip = 2 * math.tan(span / 2) * nearest
    assert lines.swath == pytest.approx(strip)
    gaps = lines.count - 1
    assert gaps * lines.spacing + strip >= width * (1 - 1e-9)
    assert lines.spacing <= (1 - overlap) * strip * (1 + 1e-6)
    fewer = gaps - 1
    assert gaps == 0 or fewer * (1 - overlap) * strip + strip < width * (1 + 1e-6)
    assert lines.time == pytest.approx(lines.count * length / lines.speed + gaps * turn)


@pytest.mark.parametrize(
    ("pixel_ms", "smear_mm", "speed", "rows_mm", "along_mm"),
    [
        # 30 pixels of 1 ms on 6 mm: 0.2 m/s.
        (1.0, None, 0.2, 6.0, 0.2),
        # The vehicle is no faster than 0.4 m/s, so that rows lie closer.
        (0.1, None, 0.4, 1.2, 0.04),
        # 6 mm would need 0.02 m/s; at 0.05 m/s they are 15 mm apart.
        (10.0, None, 0.05, 15.0, 0.5),
        # 0.1 mm in 1 ms: 0.1 m/s, and rows lie closer than they must.
        (1.0, 0.1, 0.1, 3.0, 0.1),
        (1.0, 0.3, 0.2, 6.0, 0.2),
    ],
)
def test_a_vehicle_drives_as_fast_as_density_and_smear_allow(
    pixel_ms, smear_mm, speed, rows_mm, along_mm
) -> None:
    one = vehicle(smear=None if smear_mm is None else 1e-3 * smear_mm)
    lines = one.plan(
        columns=30, span=0.2, nearest=3.0, farthest=4.0, pixel_time=1e-3 * pixel_ms
    )
    assert lines.speed == pytest.approx(speed)
    assert lines.between_rows == pytest.approx(1e-3 * rows_mm)
    assert lines.along_readings == pytest.approx(1e-3 * along_mm)
    assert lines.between_columns == pytest.approx(4.0 * 0.2 / 29)
    assert lines.length == 20.0


@given(
    longest=st.floats(600.0, 1e5), smear=st.none() | st.floats(1e-5, 1e-2),
    columns=st.integers(1, 300), turn=st.floats(0.0, 20.0),
)  # fmt: skip
def test_the_longest_pixel_just_meets_time_density_and_smear(
    longest, smear, columns, turn
) -> None:
    one = vehicle(smear=smear, turn=turn)
    span, nearest = 0.3, 3.0
    pixel = one.longest_pixel(
        columns=columns, span=span, nearest=nearest, longest=longest
    )

    def missed(factor: float) -> bool:
        lines = one.plan(
            columns=columns, span=span, nearest=nearest, farthest=4.0,
            pixel_time=factor * pixel,
        )  # fmt: skip
        return (
            lines.time > longest * (1 + 1e-9)
            or lines.between_rows > one.row_spacing * (1 + 1e-9)
            or lines.along_readings > (smear or np.inf) * (1 + 1e-9)
        )

    assert missed(1.01)
    fastest = one.plan(
        columns=columns, span=span, nearest=nearest, farthest=4.0, pixel_time=1e-9
    )
    assert missed(1.0) == (fastest.time > longest)


def test_a_single_line_covers_a_narrow_area() -> None:
    lines = vehicle(width=0.5, turn=100.0).plan(
        columns=1, span=0.3, nearest=3.0, farthest=3.0, pixel_time=1e-3
    )
    assert (lines.count, lines.spacing, lines.time) == (1, 0.0, 20.0 / 0.4)
    assert lines.between_columns == pytest.approx(0.9)


def test_readings_in_turn_lose_intervals_to_an_unknown_rate() -> None:
    """Draw rates and phases, and choose intervals by generalized least squares."""
    frequency, sigma, motion = np.array([100e6, 118e6, 130e6]), 0.05, 0.12
    distance, far = 2.0, 4.99
    to_range = speed_of_light / (4 * np.pi * frequency)
    order = np.arange(3)
    covariance = np.diag((sigma * to_range) ** 2) + motion**2 * np.outer(order, order)
    weight = np.linalg.inv(covariance)
    # Ranges that agree with the phases of a target, turned by whole intervals.
    interval = 2 * np.pi * to_range
    steps = [
        np.arange(-np.floor(distance / one), np.floor((far - distance) / one) + 1)
        for one in interval
    ]
    shifts = np.array(list(itertools.product(*steps))) * interval
    rng = np.random.default_rng(11)
    count = 4000
    error = rng.multivariate_normal(np.zeros(3), covariance, count)
    rest = error[:, None] + shifts
    unit = np.ones(3)
    mean = rest @ weight @ unit / (unit @ weight @ unit)
    rest = rest - mean[..., None]
    square = np.einsum("nci,ij,ncj->nc", rest, weight, rest)
    share = np.mean(np.argmin(square, axis=1) != np.argmin(abs(shifts).sum(axis=1)))
    chance = math.sqrt(share * (1 - share) / count)
    variance = np.full(3, sigma**2)
    predicted, _ = astray(to_range, variance, motion, distance, 0.0, far)
    assert 0.02 < share < 0.5
    # The sum over wrong intervals is an upper limit.
    assert share - 3 * chance < predicted < 1.6 * share + 3 * chance
    at_rest, _ = astray(to_range, variance, 0.0, distance, 0.0, far)
    assert at_rest < 0.01 * share


def test_frequencies_at_once_share_the_light_and_save_time(text: str) -> None:
    goal = Goal.from_text(text)
    once = replace(
        first_choice(goal), frequencies=(15e6, 52e6), dwell=2e-3, readings="at-once"
    )
    turn = replace(once, dwell=1e-3, readings="in-turn")
    assert scan_time(goal, once) == scan_time(goal, turn)
    for chosen, depth in ((once, 0.4), (turn, 0.8)):
        survey = survey_of(goal, chosen)
        assert survey.instrument.modulation_depth == depth
        assert survey.platform is not None
        assert survey.platform.readings == chosen.readings
    # Shot noise alone: half of the depth counts 4, twice the time 1/2.
    bare = {"instrument.lock_in.time_constant": 1e-9}
    shot = [
        float(
            evaluate(survey_of(goal, chosen).with_(bare), distance=2.0, method="none")[
                "shot"
            ]
        )
        for chosen in (once, turn)
    ]
    assert shot[0] / shot[1] == pytest.approx(math.sqrt(2), rel=1e-5)


@pytest.mark.parametrize("readings", ["at-once", "in-turn"])
def test_a_judge_has_the_errors_of_the_survey(text: str, readings: Any) -> None:
    goal = Goal.from_text(text)
    chosen = replace(
        first_choice(goal), frequencies=(34e6, 52e6), dwell=1e-3, readings=readings
    )
    grid = replace(
        grid_of(chosen), sets=((15e6,), chosen.frequencies), dwell=(5e-4, 1e-3)
    )
    judge = Judge(goal, chosen.laser, draws=1)
    score = judge.score(grid, chosen)
    found = evaluate(
        survey_of(goal, chosen), distance=np.array(goal.asked), method=chosen.method,
        interval=goal.limits,
        **goal.assumed, **{n: v.item() for n, v in judge._draws.items()},
    )  # fmt: skip
    assert_allclose(score.error[3], found["total_error"], rtol=1e-9)
    assert_allclose(score.wrong[3], found["wrong_interval_probability"], rtol=1e-6)
    lines = goal.vehicle.plan(  # type: ignore[union-attr]
        columns=40, span=goal.scan.azimuth_span, nearest=1.5, farthest=2.5,
        pixel_time=chosen.in_turn * 1e-3,
    )  # fmt: skip
    assert score.rows[3] == lines.between_rows
    assert score.smear[3] == lines.along_readings
    assert score.time[3] == lines.time


def test_twice_the_speed_on_twice_the_ground_is_the_same_design(text: str) -> None:
    goal = Goal.from_text(text)
    doubled = goal.model_copy(
        update={
            "vehicle": vehicle(
                slowest=0.1, fastest=0.8, length=12.0, width=0.5, row_spacing=0.02,
                turn=10.0, readings=("at-once",),
            ),
        }
    )  # fmt: skip
    chosen = replace(first_choice(goal), readings="at-once", dwell=1e-3)
    one, two = (Judge(g, chosen.laser, draws=4).of(chosen) for g in (goal, doubled))
    assert_allclose(two.error, one.error)
    assert_allclose(two.time, one.time)
    assert_allclose(two.rows, 2 * one.rows)


@pytest.fixture(scope="module")
def calm(text: str) -> Recommendation:
    return recommend(Goal.from_text(text))


def test_the_survey_of_a_recommendation_drives_its_lines(calm: Recommendation) -> None:
    assert not calm.impossible
    best = calm.best
    lines, survey = best.lines, Survey.from_text(best.survey)
    assert lines is not None
    assert survey.platform is not None
    distance = calm.goal.asked[-1]
    rows, columns = planned_spacing(survey, distance)
    assert rows == pytest.approx(lines.between_rows)
    assert columns == pytest.approx(lines.between_columns)
    track, duration = planned_track(survey)
    assert track == pytest.approx(lines.length, abs=lines.between_rows)
    assert track / duration == pytest.approx(lines.speed)
    # The plate lies under the whole line.
    assert survey.targets[0].height > lines.length  # type: ignore[union-attr]
    by_name = {row.name: row for row in best.requirements}
    assert by_name["row spacing"].value == lines.between_rows
    assert by_name["scan time"].value == best.scan_time == lines.time
    plain = json.loads(json.dumps(calm.to_dict()))
    assert plain["best"]["lines"]["count"] == lines.count
    assert plain["best"]["parameters"]["readings"] == best.parameters.readings


def test_lines_are_printed(calm: Recommendation, capsys) -> None:
    _print_choice("best", calm.best, calm.goal.accuracy.total_error)
    out = " ".join(capsys.readouterr().out.split())
    lines = calm.best.lines
    assert lines is not None
    assert f"vehicle: speed {lines.speed:.3g} m/s; readings in turn; " in out
    assert f"survey lines {lines.count} of 6 m, {lines.spacing:.3g} m apart" in out
    assert f"between rows {1e3 * lines.between_rows:.3g} mm; between points" in out
    assert f"; way during a pixel {1e3 * lines.along_readings:.3g} mm met:" in out
    assert "met: row spacing" in out
    assert "spot" not in out


def test_the_laser_spot_widens_with_the_distance(text: str, capsys) -> None:
    beam = 'name = "green"\nbeam_radius = "3 mm"\nbeam_divergence = "1.6 mrad"'
    goal = Goal.from_text(text.replace('name = "green"', beam))
    chosen = first_choice(goal)
    lines = lines_of(goal, chosen)
    assert lines is not None
    # 3 mm and 2.5 m times 1.6 mrad at right angles: 5 mm.
    assert lines.spot == pytest.approx(0.01)
    assert lines_texts(lines, chosen)["laser spot"] == "10 mm"


def test_waves_call_for_readings_at_once(text: str, calm: Recommendation) -> None:
    """Between close frequencies in turn, waves do what a wrong interval does."""
    goal = Goal.from_text(
        text.replace(
            'turn = "10 s"',
            'turn = "10 s"\n[vehicle.disturbance]\nposition = "60 cm"\nperiod = "1 s"',
        ).replace(
            'frequencies = ["15 MHz", "34 MHz", "52 MHz", "75 MHz", "120 MHz"]\n'
            "most = 2",
            'sets = [["119 MHz", "120 MHz"]]',
        )
    )
    rough = recommend(goal)
    assert rough.best.parameters.readings == "at-once"
    turned = replace(rough.best.parameters, readings="in-turn")
    found = Judge(goal, turned.laser).of(turned)
    assert found.wrong.max() > goal.accuracy.wrong_interval
    assert calm.best.parameters.readings == "in-turn"


def test_rows_too_far_apart_are_the_requirement_to_relax(text: str) -> None:
    slow = text.replace('low = "0.2 ms"', 'low = "40 ms"').replace('"5 ms"', '"50 ms"')
    slow = slow.replace('longest = "4 min"', 'longest = "4 h"')
    found = recommend(Goal.from_text(slow))
    (line,) = [one for one in found.impossible if one.requirement == "row spacing"]
    # 40 pixels of at least 40 ms at 0.05 m/s.
    assert line.value == pytest.approx(0.08)
    assert line.alone
    assert "row spacing: 80 mm in place of 10 mm (8 times) would do alone" in line.text


@pytest.mark.parametrize("readings", ["at-once", "in-turn"])
def test_ranges_from_a_moving_vehicle_scatter_as_predicted(
    text: str, readings: Any
) -> None:
    goal = Goal.from_text(
        text.replace(
            'turn = "10 s"',
            'turn = "10 s"\n[vehicle.disturbance]\nroll = "1 deg"\nperiod = "3 s"',
        )
    )
    chosen = replace(
        first_choice(goal), power=0.03, radius=0.02, frequencies=(34e6, 75e6),
        dwell=1e-3, readings=readings,
    )  # fmt: skip
    survey = survey_of(goal, chosen).with_({"scan.rows": 40})
    image = imaging.range_image(
        rejection.open_water(simulate(survey, rng=5), interval=goal.limits),
        interval=goal.limits,
    )
    error = (image["slant_range"] - image["truth_slant_range"]).values
    assert np.isfinite(error).mean() > 0.99
    predicted = evaluate(
        survey, distance=survey.targets[0].position[2], interval=goal.limits,
        late_light=False,
    )  # fmt: skip
    ratio = np.nanstd(error) / float(predicted["standard_uncertainty"])
    # 1,600 ranges: 1.8 %.
    assert ratio == pytest.approx(1.0, abs=0.1)
    assert float(predicted["wrong_interval_probability"]) < 1e-3


def test_the_speed_of_a_vehicle_is_an_axis(text: str, tank: Survey) -> None:
    goal = Goal.from_text(text)
    chosen = replace(first_choice(goal), frequencies=(113e6, 120e6), dwell=0.02)
    options: dict[str, Any] = {"distance": 2.0, "interval": goal.limits}
    turned = survey_of(goal, replace(chosen, readings="in-turn"))
    found = evaluate(turned, speed=np.array([0.05, 0.5, 5.0]), **options)
    assert found["wrong_interval_probability"].diff("speed").min() > 0
    assert isinstance(found, xr.Dataset)
    once = survey_of(goal, replace(chosen, readings="at-once"))
    found = evaluate(once, speed=np.array([0.05, 5.0]), **options)
    assert np.ptp(found["wrong_interval_probability"].values) == 0
    assert float(evaluate(tank, speed=0.0, distance=2.0)["total_error"]) > 0
    with pytest.raises(SurveyError, match=r"speed: the survey states no vehicle"):
        evaluate(tank, speed=0.1, distance=2.0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('slowest = "0.05 m/s"', 'slowest = "0.5 m/s"', "must not exceed fastest"),
        ("columns = 40", "columns = 40\nrows = 30", r"scan.rows and \[vehicle\] are"),
        ('span = "4 deg"', 'span = "0 deg"', "survey lines have no width"),
    ],
)
def test_goals_of_vehicles_that_contradict_themselves_are_refused(
    text: str, old: str, new: str, said: str
) -> None:
    assert old in text
    with pytest.raises(SurveyError, match=said):
        Goal.from_text(text.replace(old, new))


def test_a_goal_without_a_vehicle_needs_its_rows(goal_text: str) -> None:
    with pytest.raises(SurveyError, match="scan needs rows and elevation_span"):
        Goal.from_text(goal_text.replace("rows = 30\n", ""))


def test_the_report_lists_speed_and_lines(calm: Recommendation) -> None:
    lines = calm.best.lines
    assert lines is not None
    cells = {row[0]: row[1] for row in _components(calm).rows}
    assert cells["speed"] == f"{lines.speed:.3g} m/s"
    assert cells["between rows"] == f"{1e3 * lines.between_rows:.3g} mm"
