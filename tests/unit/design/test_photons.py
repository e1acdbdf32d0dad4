"""Photons of a design: ratios to the model, and the range that late light shifts."""

from __future__ import annotations

import numpy as np
import pytest

from amulor.design.confirm import follow_photons
from amulor.errors import SurveyError
from amulor.survey import Survey


@pytest.fixture(scope="module")
def survey() -> Survey:
    return Survey.preset("amulor-2010")


def test_in_water_that_scatters_nothing_photons_are_the_model(survey: Survey) -> None:
    water = {
        "absorption": 0.1, "scattering": 1e-7, "asymmetry": 0.9,
        "refractive_index": 1.34, "group_index": 1.34,
    }  # fmt: skip
    found = follow_photons(survey.with_({"water": water}), histories=100_000)
    # One way out and back. The model takes the way to the middle of the aperture; over
    # an aperture of 1/e radius R the mean way is R^2 / 2 L longer, the range half that.
    np.testing.assert_allclose(found.echo, 1.0, atol=5 * found.echo_error[0] + 2e-3)
    assert found.shift[0] == pytest.approx(0.02**2 / (4 * 1.5), rel=0.1)


@pytest.mark.slow
def test_scattered_light_is_late_by_more_than_chance(survey: Survey) -> None:
    milk = survey.with_({"water.scattering": 0.6, "water.absorption": 0.25})
    found = follow_photons(milk, histories=400_000, relative_error=0.01)
    assert found.shift[0] > 5 * found.shift_error[0] > 0
    # A mean square angle of 0.05 at 0.6 /m over 1.5 m: L b <t^2> L / 12 out, once more
    # back for what is seen of the blur, is 2 mm; a narrow view sees part of it.
    assert 0.3e-3 < found.shift[0] < 6e-3
    assert found.echo[0] == pytest.approx(1.0, abs=0.1)
    other = follow_photons(milk, histories=400_000, relative_error=0.01, seed=2)
    both = np.hypot(found.shift_error, other.shift_error)
    assert abs(found.shift - other.shift)[0] < 5 * both[0]


def test_a_beam_that_meets_nothing_is_said(survey: Survey) -> None:
    aside = survey.with_({"targets.0.position": [5.0, 0.0, 1.5]})
    with pytest.raises(SurveyError, match="meets no target"):
        follow_photons(aside)
