"""A receiver that is moved looks at the place that it is told to."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.design.geometry import place_of, with_receiver
from amulor.optics import rays
from amulor.survey import Survey

from .conftest import SURVEY

TANK = Survey.from_text(SURVEY)


@settings(deadline=None, max_examples=25)
@given(
    side=st.tuples(st.floats(-1, 1), st.floats(0.2, 1), st.floats(-0.2, 0.2)),
    up=st.booleans(),
    baseline=st.floats(0.02, 0.5),
    aim=st.floats(0.5, 6),
    azimuth=st.floats(-0.3, 0.3),
    elevation=st.floats(-0.3, 0.3),
)
def test_its_axis_meets_the_beam_where_it_is_aimed(
    side, up, baseline, aim, azimuth, elevation
) -> None:
    away = 0.05 * np.array([side[0], side[1] * (-1 if up else 1), side[2]])
    survey = TANK.with_(
        {
            "instrument.receiver.position": [f"{part} m" for part in away],
            "scan.azimuth": f"{azimuth} rad",
            "scan.elevation": f"{elevation} rad",
        }
    )
    moved = with_receiver(survey, baseline=baseline, aim=aim)
    receiver = moved.instrument.receiver
    assert_allclose(
        receiver.position, baseline * away / np.linalg.norm(away), atol=1e-12
    )
    # Without a window both are straight lines in water, and cross.
    assert survey.instrument.window is None
    target = aim * rays.direction(azimuth, elevation) - receiver.position
    seen = rays.direction(receiver.azimuth, receiver.elevation)
    assert_allclose(seen, target / np.linalg.norm(target), atol=1e-9)
    aside = with_receiver(survey, baseline=baseline, aim=math.inf)
    assert aside.instrument.receiver.azimuth == survey.scan.azimuth
    assert aside.instrument.receiver.elevation == survey.scan.elevation


def test_distances_of_a_straight_beam_are_those_of_a_triangle() -> None:
    survey = TANK.with_(
        {
            "instrument.receiver.position": ["0.3 m", "0 m", "0 m"],
            "scan.azimuth": "0 rad",
        }
    )
    distance = np.array([0.4, 2.0, 5.0])
    place = place_of(survey, distance)
    back = np.hypot(distance, 0.3)
    assert_allclose(place.depth, distance)
    assert_allclose(place.back, back)
    assert_allclose(place.path, 1.38 * (distance + back))
    assert_allclose(place.cosine, distance / back)
    # L + sqrt(L^2 + b^2) grows by 1 + L / sqrt(L^2 + b^2).
    assert_allclose(place.slope, 1 / (1.38 * (1 + distance / back)), rtol=1e-4)


def test_a_window_takes_its_distance_and_thickness_from_the_water() -> None:
    window = {"distance": "30 cm", "thickness": "2 cm"}
    survey = TANK.with_({"instrument.window": window, "scan.azimuth": "0 rad"})
    place = place_of(survey, np.array([0.5, 2.0]))
    assert_allclose(place.depth, [0.18, 1.68])
    # An angle in air is smaller in water by the phase index.
    assert place.per_acceptance < 0.9
