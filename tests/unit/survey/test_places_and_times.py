"""Directions, times, courses and boxes of a survey by closed forms."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.errors import SurveyError
from amulor.survey import Survey, course, directions, reach, water_properties
from amulor.survey.platform import (
    HoverCourse,
    LawnMowerCourse,
    LineCourse,
    Mounting,
    OrbitCourse,
)
from amulor.survey.view import medium_of, view


def survey_of(**scan: Any) -> Any:
    """Return a survey of 3 frequencies and 2 channels; only its scan is read."""
    values: dict[str, Any] = {
        "rows": 3, "columns": 4, "dwell": 0.1, "azimuth": 0.2, "elevation": -0.1,
        "azimuth_span": 0.6, "elevation_span": 0.4, "order": "rows",
        "open_water": None, "moves": "both",
    }  # fmt: skip
    instrument = SimpleNamespace(
        modulation_frequencies=(1.0, 2.0, 3.0), polarizations=("VV", "VH"),
        lock_in=SimpleNamespace(time_constant=0.01),
    )  # fmt: skip
    return SimpleNamespace(
        scan=SimpleNamespace(**values | scan), instrument=instrument, platform=None
    )


def test_pixels_follow_each_other_row_by_row() -> None:
    azimuth, elevation, time = directions.scan_directions(survey_of())
    assert_allclose(azimuth[0], [-0.1, 0.1, 0.3, 0.5])
    assert_allclose(elevation[:, 0], [0.1, -0.1, -0.3])
    # Six readings of 0.1 s each.
    assert_allclose(time, 0.6 * np.arange(12).reshape(3, 4))
    back = directions.scan_directions(survey_of(order="serpentine"))[2]
    assert_allclose(back[1], 0.6 * np.array([7, 6, 5, 4]))
    assert_allclose(back[2], time[2])
    part = directions.scan_directions(
        survey_of(order="serpentine"), rows=np.array([1]), columns=np.array([0, 3])
    )
    assert_allclose(part[2], 0.6 * np.array([[7, 4]]))
    assert_allclose(part[0], [[-0.1, 0.5]])
    one = directions.scan_directions(survey_of(rows=1, columns=1))
    assert_allclose(np.ravel(one), [0.2, -0.1, 0.0])


def test_a_scan_beyond_the_memory_is_refused_as_a_whole() -> None:
    # Six samples of each pixel; ten million are the most.
    fits = survey_of(rows=1000, columns=1666)
    assert directions.samples_of(fits) == 9_996_000
    directions.refuse_scans_beyond_memory(fits)
    large = survey_of(rows=1000, columns=1667)
    said = r"has 1e\+07 samples \(1667 x 1000 pixels, 6 samples each\), at most 1e\+07"
    with pytest.raises(SurveyError, match=said):
        directions.refuse_scans_beyond_memory(large)
    with pytest.raises(SurveyError, match="fit into memory here"):
        directions.scan_directions(large)
    # Its rows are read one after the other.
    assert directions.scan_directions(large, rows=slice(0, 2))[0].shape == (2, 1667)


def test_readings_are_means_before_the_end_of_their_dwell() -> None:
    middle, length = directions.reading_windows(survey_of())
    # After five time constants, over about one.
    assert length == pytest.approx(0.1 - 4 * 0.01)
    number = np.array([[1, 4], [2, 5], [3, 6]])
    assert_allclose(middle, 0.1 * number - length / 2)
    at_once = survey_of()
    at_once.platform = SimpleNamespace(readings="at-once")
    assert directions.readings_in_turn(at_once) == 1
    assert_allclose(directions.reading_windows(at_once)[0], 0.1 - length / 2)
    at_once.platform.readings = "in-turn"
    assert directions.readings_in_turn(at_once) == 6


def test_shots_repeat_each_direction() -> None:
    plan = SimpleNamespace(columns=2, rows=1, repeats=3)
    azimuth, elevation = directions.open_water_directions(survey_of(open_water=plan))
    assert_allclose(azimuth, [-0.1] * 3 + [0.5] * 3)
    assert_allclose(elevation, -0.1)
    with pytest.raises(SurveyError, match=r"scan\.open_water: is missing"):
        directions.open_water_directions(survey_of())


TIME = np.array([-1.0, 0.0, 3.0, 8.0, 20.0])


def test_a_line_and_a_place_are_where_they_are() -> None:
    line = LineCourse(kind="line", start=(1.0, 2.0, -3.0), heading=0.3, speed=0.5)
    position, heading = course.planned(line, TIME)
    # East is the sine of a heading, north its cosine.
    assert_allclose(position[:, 0], 1 + 0.5 * TIME * np.sin(0.3))
    assert_allclose(position[:, 1], 2 + 0.5 * TIME * np.cos(0.3))
    assert_allclose(position[:, 2], -3)
    assert_allclose(heading, 0.3)
    hover = HoverCourse(kind="hover", start=(1.0, 2.0, -3.0), heading=0.3)
    position, heading = course.planned(hover, TIME)
    assert_allclose(position, np.tile([1.0, 2.0, -3.0], (5, 1)))
    assert_allclose(heading, 0.3)


def test_an_orbit_looks_at_its_center() -> None:
    orbit = OrbitCourse(
        kind="orbit", center=(1.0, 2.0, -3.0), radius=4.0, bearing=0.2, speed=0.8
    )
    position, heading = course.planned(orbit, TIME)
    bearing = 0.2 + 0.8 * TIME / 4
    assert_allclose(position[:, 0], 1 + 4 * np.sin(bearing))
    assert_allclose(position[:, 1], 2 + 4 * np.cos(bearing))
    assert_allclose(np.sin(heading), -np.sin(bearing), atol=1e-12)
    assert_allclose(np.cos(heading), -np.cos(bearing), atol=1e-12)


def test_a_lawn_mower_turns_in_half_circles() -> None:
    mower = LawnMowerCourse(
        kind="lawn-mower", start=(0.0, 0.0, 0.0), heading=0.0, speed=1.0,
        line_length=10.0, line_spacing=2.0,
    )  # fmt: skip
    half = np.pi
    ahead = np.array([-1.0, 0.0, 7.0, 10.0, 10.0, 10.0, 15.0, 20.0, 20.0, 20.0, 23.0])
    way = ahead + half * np.array([0, 0, 0, 0, 0.5, 1, 1, 1, 1.5, 2, 2])
    position, heading = course.planned(mower, way)
    # To the right by the spacing after each line, and one meter beyond its end.
    east = [0, 0, 0, 0, 1, 2, 2, 2, 3, 4, 4]
    north = [-1, 0, 7, 10, 11, 10, 5, 0, -1, 0, 3]
    assert_allclose(position[:, 0], east, atol=1e-12)
    assert_allclose(position[:, 1], north, atol=1e-12)
    assert_allclose(heading, 0.0)
    turned = LawnMowerCourse(**mower.model_dump() | {"heading": np.pi / 2})
    position, _ = course.planned(turned, way)
    assert_allclose(position[:, 0], north, atol=1e-12)
    assert_allclose(position[:, 1], -np.array(east), atol=1e-12)


def platform_of(kind: Any, **wave: Any) -> Any:
    values: dict[str, Any] = {
        "current": (0.03, 0.04, 0.0), "period": 5.0, "position": 0.02,
        "heading": 0.01, "pitch": 0.02, "roll": 0.02,
    }  # fmt: skip
    return SimpleNamespace(course=kind, disturbance=SimpleNamespace(**values | wave))


LINE = LineCourse(kind="line", start=(0.0, 0.0, 0.0), heading=0.0, speed=0.5)
HOVER = HoverCourse(kind="hover", start=(0.0, 0.0, 0.0), heading=0.0)


@pytest.mark.parametrize(("kind", "speed"), [(LINE, 0.5), (HOVER, 0.0)])
def test_speeds_and_rates_contain_current_and_swell(kind: Any, speed: float) -> None:
    frequency = 2 * np.pi / 5
    found = course.planned_speed(platform_of(kind))
    assert found == pytest.approx(speed + 0.05 + frequency * 0.02)
    rate, bend = course.range_rate(platform_of(kind))
    # Any of three directions; a turn of a beam one meter long on a slope.
    swell = np.hypot(0.02, 0.03)
    steady = (speed + 0.05) / np.sqrt(3)
    assert rate == pytest.approx(np.hypot(steady, 1.16 * frequency * swell))
    assert bend == pytest.approx(1.69 * frequency**2 * swell)


def test_instruments_stand_on_their_lever_arm() -> None:
    mounting = Mounting(lever_arm=(0.3, -0.2, 1.0), pitch=-0.4)
    survey: Any = SimpleNamespace(
        platform=SimpleNamespace(course=LINE, mounting=mounting), pose=None
    )
    origin, rotation = course.planned_instrument(survey, np.array([0.0, 2.0]))
    # Heading north: right is east, forward is north, down is down.
    position = np.array([[0.3, 1.0, 0.2], [0.3, 2.0, 0.2]])
    place, axes = course.scene_axes(survey)
    assert_allclose(place, 0)
    assert_allclose(origin @ axes.T, position, atol=1e-12)
    forward = (axes @ rotation)[:, :, 2]
    assert_allclose(forward, [[0, np.cos(0.4), -np.sin(0.4)]] * 2, atol=1e-12)


def test_a_box_is_crossed_where_a_line_is_inside() -> None:
    rng = np.random.default_rng(1)
    turn = reach._rotation((0.3, -0.5, 0.8))
    assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    position, low, high = np.array([0.2, 0.1, 2.0]), -np.array([0.5, 0.4, 0.3]), 0.4
    way = rng.standard_normal((400, 3)) * [0.3, 0.3, 0.1] + [0, 0, 1]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    beam: Any = SimpleNamespace(entry=np.array([0.05, 0.0, 0.0]), direction=way)
    found = reach._crossing(beam, turn, position, low, np.full(3, high))
    along = np.linspace(0, 6, 6001)
    for k, direction in enumerate(way):
        points = (beam.entry + along[:, None] * direction - position) @ turn
        inside = np.all((points >= low) & (points <= high), axis=1)
        if np.isnan(found[k, 0]):
            assert inside.sum() <= 1
            continue
        assert along[inside][[0, -1]] == pytest.approx(found[k], abs=2e-3)
    assert 50 < np.isfinite(found[:, 0]).sum() < 350


def test_beams_along_a_face_and_from_inside_of_a_box() -> None:
    low, high = -np.ones(3), np.ones(3)
    ahead = np.array([0.0, 0.0, 1.0])

    def crossing(*start: float) -> Any:
        beam: Any = SimpleNamespace(entry=np.array(start), direction=ahead)
        return reach._crossing(beam, np.eye(3), np.zeros(3), low, high)

    assert_allclose(crossing(0.0, 0.0, -3.0), [2.0, 4.0])
    assert_allclose(crossing(1.0, -1.0, -3.0), [2.0, 4.0])
    assert np.isnan(crossing(1.001, 0.0, -3.0)).all()
    # From inside, and with the box behind the beam.
    assert_allclose(crossing(0.0, 0.0, 0.5), [0.0, 0.5])
    assert np.isnan(crossing(0.0, 0.0, 1.5)).all()
    # A face that the beam lies in is met.
    flat = reach._crossing(
        SimpleNamespace(entry=np.array([0.0, 0.0, -1.0]), direction=ahead),  # type: ignore[arg-type]
        np.eye(3), np.zeros(3), np.array([-1.0, -1.0, 0.0]), np.array([1.0, 1.0, 0.0]),
    )  # fmt: skip
    assert_allclose(flat, [1.0, 1.0])


@pytest.mark.parametrize(
    ("frequencies", "smallest"),
    [(20e6, 20e6), ([20e6, 50e6], 20e6), ([20e6, 35e6], 15e6)],
)
def test_ranges_repeat_at_the_smallest_frequency_or_difference(
    frequencies: Any, smallest: float
) -> None:
    found = reach.repetition(frequencies, group_index=1.4)
    assert found == pytest.approx(299792458.0 / (2 * 1.4 * smallest))


def test_beams_of_a_scan_include_its_edges(plate: Survey) -> None:
    wide = plate.with_({"scan.columns": 200, "scan.rows": 3})
    beam = reach._beams(wide)
    # At most 65 across.
    assert beam.direction.shape == (3, 65, 3)
    azimuth = np.arctan2(beam.direction[..., 0], beam.direction[..., 2])
    span, middle = wide.scan.azimuth_span, wide.scan.azimuth
    assert_allclose(
        azimuth[1, [0, 32, -1]], middle + np.array([-0.5, 0, 0.5]) * span, atol=1e-9
    )
    elevation = -np.arcsin(beam.direction[..., 1])
    half = wide.scan.elevation_span / 2
    assert_allclose(
        elevation[:, 32], wide.scan.elevation + np.array([half, 0, -half]), atol=1e-9
    )
    lone = reach._beams(plate.with_({"scan.columns": 1, "scan.rows": 1}))
    assert lone.direction.shape == (1, 1, 3)


def test_the_uneven_window_has_its_optical_offset(plate: Survey) -> None:
    # Straight ahead, with the receiver behind the emitter: the way back is longer.
    back = plate.with_(
        {
            "instrument.emitter.position": [0.0, 0.0, 0.0],
            "instrument.receiver.position": [0.0, 0.0, -0.3],
            "instrument.receiver.azimuth": 0.0,
            "instrument.receiver.elevation": 0.0,
            "scan.moves": "beam",
        }
    )
    seen = view(back, np.zeros(1), np.zeros(1))
    index = water_properties(back).group_index
    assert seen.optical_offset == pytest.approx(0.3 * index)
    assert seen.baseline == pytest.approx(0.0)


@pytest.mark.parametrize("depth", [0.0, 0.5, 4.0])
@pytest.mark.parametrize("turned", [-0.2, 0.05])
def test_beam_and_axis_part_behind_glass_as_two_refracted_lines(
    plate: Survey, turned: float, depth: float
) -> None:
    aside, looks, ahead, thickness = 0.25, -0.12, 0.3, 0.02
    behind = plate.with_(
        {
            "instrument.window": {"distance": ahead, "thickness": thickness},
            "instrument.emitter.position": [0.0, 0.0, 0.0],
            "instrument.receiver.position": [aside, 0.0, 0.0],
            "instrument.receiver.azimuth": looks,
            "instrument.receiver.elevation": 0.0,
            "scan.moves": "beam",
        }
    )
    assert behind.instrument.window is not None
    glass = behind.instrument.window.refractive_index
    index = medium_of(behind).refractive_index

    def in_water(start: float, angle: float) -> tuple[np.ndarray, np.ndarray]:
        """Place and direction behind the pane, by Snell's law (x, z)."""
        inside = np.arcsin(np.sin(angle) / glass)
        place = start + ahead * np.tan(angle) + thickness * np.tan(inside)
        water = np.arcsin(np.sin(angle) / index)
        return np.array([place, 0.0]), np.array([np.sin(water), np.cos(water)])

    entry, direction = in_water(0.0, turned)
    window, axis = in_water(aside, looks)
    way = entry + depth * direction - window
    expected = abs(way[0] * axis[1] - way[1] * axis[0])
    seen = view(behind, np.array(turned), np.array(0.0))
    total = seen.standoff + depth
    found = np.hypot(seen.baseline - seen.tilt * total, seen.cross_tilt * total)
    assert found == pytest.approx(expected, abs=1e-7)
