"""How the receiver looks at the beams: what is refused, and in which words."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amulor.errors import SurveyError
from amulor.survey import Survey
from amulor.survey.course import planned_spacing, planned_track
from amulor.survey.view import angle_of_view, medium_of, seen_from_water, view


def _look(plate_text: str, azimuth: float) -> None:
    """Look along the axis, with a receiver turned aside [deg]."""
    stated = 'azimuth = "-2.672 deg"'
    assert stated in plate_text
    survey = Survey.from_text(plate_text.replace(stated, f'azimuth = "{azimuth} deg"'))
    view(survey, np.zeros(1), np.zeros(1))


def test_a_receiver_that_looks_past_its_beam_is_told_by_its_angle(
    plate_text: str,
) -> None:
    _look(plate_text, 59.5)
    for angle in (61, 75, 89):
        with pytest.raises(SurveyError, match=f"stands {angle} degrees off a beam"):
            _look(plate_text, angle)


@settings(max_examples=30)
@given(
    aside=st.floats(0.05, 0.6),
    ahead=st.floats(-0.1, 0.1),
    aim=st.floats(0.8, 4.0),
    depth=st.floats(0.2, 6.0),
    azimuth=st.floats(-0.2, 0.2),
)
def test_the_beam_is_as_far_from_the_axis_as_two_lines_in_space(
    plate: Survey, aside: float, ahead: float, aim: float, depth: float, azimuth: float
) -> None:
    receiver = np.array([aside, 0.0, ahead])
    spot = np.array([0.0, 0.0, aim])
    axis = (spot - receiver) / np.linalg.norm(spot - receiver)
    survey = plate.with_(
        {
            "instrument.emitter.position": [0.0, 0.0, 0.0],
            "instrument.receiver.position": receiver.tolist(),
            "instrument.receiver.azimuth": float(np.arctan2(axis[0], axis[2])),
            "instrument.receiver.elevation": 0.0,
            "scan.moves": "beam",
        }
    )
    seen = view(survey, np.array(azimuth), np.array(0.0))
    point = depth * np.array([np.sin(azimuth), 0.0, np.cos(azimuth)])
    way = point - receiver
    expected = np.linalg.norm(way - (way @ axis) * axis)
    found = np.hypot(seen.baseline - seen.tilt * depth, seen.cross_tilt * depth)
    # The cross tilt is the root of a difference, so zero comes out as 1e-8.
    assert found == pytest.approx(expected, abs=1e-7)


def test_a_receiver_behind_glass_sees_a_narrower_cone_from_farther(
    plate: Survey,
) -> None:
    bare = seen_from_water(plate, medium_of(plate))
    assert bare == (0.0, 0.08)
    window = {"distance": 0.2, "thickness": 0.02}
    behind = plate.with_({"instrument.window": window})
    medium = medium_of(behind)
    assert medium.window_thickness == 0.02
    # Snell for small angles: air of 20 cm and glass of 2 cm are n times as deep.
    glass = behind.instrument.window.refractive_index
    expected = 1.34 * (0.2 + 0.02 / glass), 0.08 / 1.34
    assert seen_from_water(behind, medium) == pytest.approx(expected)
    # Only a receiver that turns with its beam has a field of view about the beam.
    assert angle_of_view(behind) == np.inf
    both = behind.with_({"scan.moves": "both"})
    assert angle_of_view(both) == pytest.approx(0.08 / 1.34)
    back = plate.with_(
        {"instrument.receiver.position.2": -0.05, "instrument.window": window}
    )
    moved = seen_from_water(back, medium_of(back))
    assert moved[0] == pytest.approx(1.34 * (0.25 + 0.02 / glass))


def test_points_of_a_line_are_as_far_apart_as_its_beams(plate: Survey) -> None:
    span = plate.scan.azimuth_span
    moving = plate.with_(
        {
            "scan.elevation_span": 0.0,
            "scan.columns": 5,
            "scan.rows": 10,
            "pose": {"position": [0.0, 0.0, -8.0], "pitch": -np.pi / 2},
            "platform": {
                "course": {
                    "kind": "line",
                    "start": [0.0, 0.0, -8.0],
                    "heading": 0.0,
                    "speed": 0.2,
                },
            },
        }
    )
    track, duration = planned_track(moving)
    assert track == pytest.approx(0.2 * duration, rel=1e-3)
    rows, columns = planned_spacing(moving, 2.0)
    assert rows == pytest.approx(track / 10)
    # Five beams span four steps; a single one spans none, and counts as one.
    assert columns == pytest.approx(2.0 * span / 4)
    alone = moving.with_({"scan.columns": 1})
    assert planned_spacing(alone, 2.0)[1] == pytest.approx(2.0 * span)
    two = moving.with_({"scan.columns": 2})
    assert planned_spacing(two, 2.0)[1] == pytest.approx(2.0 * span)
