"""Photons of a design: ratios to the model, and the range that late light shifts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.constants import speed_of_light

from amulor.design.confirm import follow_photons
from amulor.errors import SurveyError
from amulor.simulation import simulate
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


def test_the_bound_is_that_of_the_noise_of_a_sample(survey: Survey) -> None:
    clear = survey.with_(
        {
            "water": {
                "absorption": 0.1, "scattering": 1e-7, "asymmetry": 0.9,
                "refractive_index": 1.34, "group_index": 1.34,
            },
            "instrument.emitter.beam_radius": 0.0,
        }
    )  # fmt: skip
    found = follow_photons(clear, histories=100_000)
    samples = simulate(
        clear.with_({"scan.columns": 1, "scan.rows": 1, "scan.azimuth_span": 0.0,
                     "scan.elevation_span": 0.0}), rng=0,
    )  # fmt: skip
    # Of a phase alone: the reflectance takes the amplitude.
    truth = samples.amulor.truth
    light = [truth[f"target_{part}"].values for part in ("in_phase", "quadrature")]
    real, imaginary = (part[0, :, 0, 0] for part in light)
    sigma = [samples[f"{n}_uncertainty"].values for n in ("in_phase", "quadrature")]
    across = imaginary**2 * sigma[0][0, :, 0, 0] ** 2
    across += real**2 * sigma[1][0, :, 0, 0] ** 2
    both = samples["in_phase_quadrature_covariance"].values[0, :, 0, 0]
    across -= 2 * real * imaginary * both
    phase = np.sqrt(across) / (real**2 + imaginary**2)
    per_radian = speed_of_light / 1.34 / (4 * np.pi * 39e6)
    assert found.range_bound == pytest.approx(per_radian * phase.min(), rel=0.02)
    assert 0 < found.range_bound_error < 0.05 * found.range_bound
    # One frequency does not tell absorption and scattering apart.
    assert found.free_range_bound == np.inf


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
