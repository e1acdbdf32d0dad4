"""What the forward models make of any water, of beams and of sharp receivers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor.errors import SurveyError
from amulor.simulation import DiffusionModel, SmallAngleModel, simulate
from amulor.simulation.backscatter import small_angle_response
from amulor.simulation.transport import monte_carlo_response
from amulor.survey import Survey, water_properties
from amulor.survey.waters.whole_function import phase_function_of

FREQUENCIES = np.array([0.0, 20e6, 60e6])
HENYEY_GREENSTEIN = {"kind": "henyey-greenstein", "asymmetry": 0.95}


def in_water(plate: Survey, water: dict[str, object], **changes: object) -> Survey:
    stated = {"group_index": 1.38, "refractive_index": 1.34, **water}
    return plate.with_(
        {
            "water": stated,
            "scan.columns": 3,
            "scan.rows": 1,
            "scan.open_water": None,
            "instrument.polarizations": ["none"],
            **{name.replace("__", "."): value for name, value in changes.items()},
        }
    )


def coefficients(a: float, b: float, **how: object) -> dict[str, object]:
    return {"absorption": a, "scattering": b, **how}


def echo(survey: Survey, model=SmallAngleModel()) -> np.ndarray:  # noqa: B008
    truth = simulate(survey, rng=1, model=model).amulor.truth
    return (truth["target_in_phase"] + 1j * truth["target_quadrature"]).values


@pytest.mark.slow
def test_a_named_phase_function_gives_what_its_asymmetry_gives(plate):
    one = in_water(plate, coefficients(0.255, 0.595, asymmetry=0.95))
    other = in_water(
        plate, coefficients(0.255, 0.595, phase_function=HENYEY_GREENSTEIN)
    )
    # Where numbers are printed from closed forms or by quadrature: 1e-8.
    assert_allclose(
        small_angle_response(one, FREQUENCIES),
        small_angle_response(other, FREQUENCIES),
        rtol=1e-6,
    )
    assert_allclose(echo(one), echo(other), rtol=1e-6)


def test_photons_and_models_are_given_one_phase_function(plate):
    survey = in_water(plate, {"kind": "petzold", "station": "NUC 2040"})
    survey = survey.with_({"instrument.wavelength": 532e-9})
    water = water_properties(survey)
    assert phase_function_of(water) is water.phase_function
    assert phase_function_of(water) is phase_function_of(water_properties(survey))


LAYERED = {
    "kind": "layers",
    "layers": [
        {
            "thickness": 0.8,
            **coefficients(0.1, 0.4, phase_function=HENYEY_GREENSTEIN),
        },
        coefficients(0.1, 0.4, phase_function=HENYEY_GREENSTEIN),
    ],
}


@pytest.mark.parametrize("model", [DiffusionModel(), SmallAngleModel()])
def test_layers_are_refused_by_name_by_models_of_uniform_water(plate, model):
    with pytest.raises(SurveyError, match=r"^water\.layers: .*uniform water only") as e:
        simulate(in_water(plate, LAYERED), rng=1, model=model)
    assert "\n" not in str(e.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("emitter.beam_radius", 0.002),
        ("emitter.beam_divergence", 0.001),
        ("receiver.edge", "sharp"),
    ],
)
def test_the_diffusion_form_refuses_what_it_does_not_know(plate, name, value):
    survey = in_water(plate, coefficients(0.2, 0.4, asymmetry=0.95))
    survey = survey.with_({f"instrument.{name}": value})
    with pytest.raises(SurveyError, match=rf"instrument: .*{name}"):
        simulate(survey, rng=1, model=DiffusionModel())
    assert np.all(np.isfinite(echo(survey)))


@settings(max_examples=10)
@given(
    radius=st.floats(0.0, 0.02),
    divergence=st.floats(0.0, 0.03),
    absorption=st.floats(0.01, 0.5),
)
def test_a_wide_beam_in_clear_water_widens_as_gaussians_do(
    plate, radius, divergence, absorption
):
    survey = in_water(
        plate,
        coefficients(absorption, 1e-9, asymmetry=0.95),
        instrument__emitter__beam_radius=radius,
        instrument__emitter__beam_divergence=divergence,
        instrument__receiver__azimuth=0.0,
        scan__columns=1,
    )
    thin = survey.with_(
        {
            "instrument.emitter.beam_radius": None,
            "instrument.emitter.beam_divergence": None,
        }
    )
    # Eq. (41) without scattering: S = R^2 + gamma^2 r^2, plus that of the beam, over
    # the way back r; the spot lies off the axis by the angle whose sine is 7 cm / r.
    back = np.hypot(1.5, 0.07)
    near, far = 0.02**2 + (0.08 * back) ** 2, radius**2 + (divergence * back) ** 2
    wide = near + far
    baseline = (back * np.arcsin(0.07 / back)) ** 2
    expected = near / wide * np.exp(baseline / near - baseline / wide)
    assert_allclose(np.abs(echo(survey) / echo(thin)), expected, rtol=1e-5)


def test_a_wide_beam_is_one_in_water_without_forward_scattering(plate):
    common = {
        "forward_fraction": 0.0,
        "second_moment": 0.0,
        "phase_function_at_180": 0.01,
    }
    survey = in_water(
        plate,
        coefficients(0.1, 0.1, **common),
        instrument__emitter__beam_radius=0.05,
        instrument__receiver__azimuth=0.0,
        scan__columns=1,
    )
    thin = survey.with_({"instrument.emitter.beam_radius": None})
    back = np.hypot(1.5, 0.07)
    near = 0.02**2 + (0.08 * back) ** 2
    wide = near + 0.05**2
    offset = back * np.arcsin(0.07 / back)
    expected = near / wide * np.exp(offset**2 / near - offset**2 / wide)
    assert_allclose(np.abs(echo(survey) / echo(thin)), expected, rtol=1e-5)


def test_a_sharp_receiver_sees_a_plate_in_clear_water_as_the_lidar_equation(plate):
    survey = in_water(
        plate,
        coefficients(0.1, 1e-9, asymmetry=0.95),
        instrument__receiver__edge="sharp",
        scan__columns=1,
    )
    detector = survey.instrument.detector
    rate = (
        0.02
        * detector.optical_transmission
        * 0.25
        * 405e-9
        / (6.62607015e-34 * 299792458)
    )
    full = 0.8 * detector.volt_per_photoelectron_rate * rate
    # Reflectance over pi, aperture over the way back squared, both ways through the
    # water; the receiver stands 7 cm aside, which leaves a cosine of 0.9989.
    back = np.hypot(1.5, 0.07)
    expected = full * 0.1 * 0.02**2 / back**2 * np.exp(-0.1 * (1.5 + back))
    assert_allclose(np.abs(echo(survey)), expected * 1.5 / back, rtol=1e-3)


AHEAD = {"instrument__receiver__azimuth": 0.0}


@pytest.mark.slow
def test_water_cut_into_layers_is_the_same_water_to_photons(plate):
    one = coefficients(0.1, 0.4, phase_function=HENYEY_GREENSTEIN)
    whole, cut = (
        monte_carlo_response(
            in_water(plate, water, **AHEAD), FREQUENCIES, relative_error=0.04, seed=seed
        )
        for seed, water in enumerate((one, LAYERED), start=3)
    )
    error = 0.04 * np.abs(whole.signal[0]) * np.sqrt(2)
    assert np.all(np.abs(whole.signal - cut.signal) < 4 * error)


@pytest.mark.slow
def test_a_black_layer_behind_takes_the_light_of_its_depth(plate):
    layers = [LAYERED["layers"][0], {**LAYERED["layers"][1], **coefficients(50.0, 0.0)}]
    ended = coefficients(0.1, 0.4, phase_function=HENYEY_GREENSTEIN, column_end=0.8)
    found, expected = (
        monte_carlo_response(
            in_water(plate, water, **AHEAD),
            FREQUENCIES[:2],
            relative_error=0.05,
            seed=seed,
        )
        for seed, water in enumerate(({**LAYERED, "layers": layers}, ended), start=7)
    )
    error = 0.05 * np.abs(expected.signal[0]) * np.sqrt(2)
    assert np.all(np.abs(found.signal - expected.signal) < 4 * error)


def test_layers_seen_at_an_angle_are_refused_for_photons(plate):
    with pytest.raises(SurveyError, match=r"looks through layers of water at an angle"):
        monte_carlo_response(in_water(plate, LAYERED), FREQUENCIES)
