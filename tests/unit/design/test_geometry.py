"""A receiver that is moved looks at the place that it is told to."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.design.geometry import with_receiver
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
