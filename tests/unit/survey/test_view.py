"""How the receiver looks at the beams: what is refused, and in which words."""

from __future__ import annotations

import numpy as np
import pytest

from amulor.errors import SurveyError
from amulor.survey import Survey, water_properties
from amulor.survey.view import medium, view


def _look(plate_text: str, azimuth: float) -> None:
    """Look along the axis, with a receiver turned aside [deg]."""
    stated = 'azimuth = "-2.672 deg"'
    assert stated in plate_text
    survey = Survey.from_text(plate_text.replace(stated, f'azimuth = "{azimuth} deg"'))
    where = medium(survey, water_properties(survey))
    view(survey, np.zeros(1), np.zeros(1), medium=where)


def test_a_receiver_that_looks_past_its_beam_is_told_by_its_angle(
    plate_text: str,
) -> None:
    _look(plate_text, 59.5)
    for angle in (61, 75, 89):
        with pytest.raises(SurveyError, match=f"stands {angle} degrees off a beam"):
            _look(plate_text, angle)
