"""The simulated cube against closed forms, its noise against its own statement."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.constants import Planck, speed_of_light
from scipy.integrate import trapezoid

from amulor.errors import SurveyError
from amulor.optics import small_angle, small_angle_diffusion
from amulor.simulation import DiffusionModel, simulate
from amulor.survey import Survey, water_properties
from amulor.survey.counting import integration_time
from amulor.survey.view import kernel_arguments, view
from amulor.survey.waters.whole_function import whole_function_arguments

#: A survey without any noise.
QUIET = {
    "instrument.lock_in.phase_floor": 0.0,
    "water.signal_fluctuation": 0.0,
    "instrument.power": "1e9 W",
    "instrument.detector.optical_transmission": 1.0,
    "instrument.detector.saturation": "1e20 V",
}


def test_target_and_water_have_the_ratio_of_their_closed_forms(plate: Survey) -> None:
    # Receiver far wider than the baseline, tiny acceptance, no spread: F is flat, and
    # target over water is (reflectance / pi) e^(-2kd) over beta (1 - e^(-2kd)) / 2k.
    survey = plate.with_(
        {
            "water.second_moment": 0.0,
            "instrument.receiver.radius": "50 m",
            "instrument.receiver.acceptance": "0.001 rad",
            "instrument.receiver.azimuth": 0.0,
            "instrument.modulation_frequencies": ["1 Hz"],
        }
    )
    truth = simulate(survey, rng=1).amulor.truth
    target = truth["target_in_phase"].values[0, :, 3, 6]
    water = truth["water_in_phase"].values[0, :, 3, 6]
    k, d, beta = 0.255, float(truth["slant_range"][3, 6]), 0.595 * 0.001
    whole = 0.1 / np.pi * np.exp(-2 * k * d) / (beta * (1 - np.exp(-2 * k * d)) / 2 / k)
    # VV: (1 + m22) / 2 of either; VH: (1 - m22) / 2. Cosine to the receiver 0.9989.
    expected = whole * np.array([0.805 / 0.905, 0.195 / 0.095])
    assert_allclose(target / water, expected * np.cos(0.0466), rtol=1e-3)


def test_the_received_power_is_the_lidar_equation_in_volts(plate: Survey) -> None:
    truth = simulate(plate, rng=1, model=DiffusionModel()).amulor.truth
    echo = abs(
        truth["target_in_phase"].values + 1j * truth["target_quadrature"].values
    )[0, :, 3, 6]
    d = float(truth["slant_range"][3, 6])
    # The receiver stands 7 cm aside: the way back, half of the sum of both ways.
    back = np.hypot(d, 0.07)
    mean = (d + back) / 2
    s = 0.02**2 + 0.08**2 * back**2 + 2 / 3 * 0.595 * 0.06 * mean**3
    # Aimed at the plate's middle: what offset is left is that of half a pixel.
    share = np.pi * 0.02**2 * 0.08**2 / s * np.exp(-2 * 0.255 * mean) * 0.1 / np.pi
    rate = 0.02 * 0.1 * 0.25 * 405e-9 / (Planck * speed_of_light)
    expected = 0.8 * 8e-12 * rate * share * np.array([0.805, 0.195])
    assert_allclose(echo, expected * np.cos(0.0466), rtol=2e-3)


def test_the_phase_of_the_target_is_that_of_the_group_path(plate: Survey) -> None:
    cube = simulate(plate.with_(QUIET), rng=1)
    truth = cube.amulor.truth
    phase = np.arctan2(truth["target_quadrature"], truth["target_in_phase"])[0, 0]
    d = truth["slant_range"].values
    x = d * np.sin(cube["azimuth"].values) * np.cos(cube["elevation"].values)
    back = np.sqrt(d**2 + 0.07**2 - 2 * 0.07 * x)
    expected = 2 * np.pi * 39e6 * 1.38 * (d + back) / speed_of_light
    assert_allclose(np.exp(1j * phase), np.exp(1j * expected), rtol=1e-9)


def test_water_ends_at_the_target(plate: Survey) -> None:
    survey = plate.with_(QUIET)
    cube = simulate(survey, rng=1)
    truth = cube.amulor.truth
    water = truth["water_in_phase"].values + 1j * truth["water_quadrature"].values
    properties = water_properties(survey)
    where = view(
        survey,
        cube["azimuth"].values,
        cube["elevation"].values,
    )
    # Trapezoids over the column: an independent sum of (26) and (29), and of (46).
    z = np.linspace(0, 1, 2001)[:, None, None] * truth["slant_range"].values[::3, ::6]
    delay = np.exp(2j * (2 * np.pi * 39e6) * 1.38 / speed_of_light * z)
    paper = simulate(survey, rng=1, model=DiffusionModel()).amulor.truth
    other = paper["water_in_phase"].values + 1j * paper["water_quadrature"].values
    where = dataclasses.replace(
        where,
        **{
            name: getattr(where, name)[::3, ::6]
            for name in ("baseline", "tilt", "cross_tilt", "standoff")
        },
    )
    for found, overlap, arguments in (
        (water, small_angle.overlap, whole_function_arguments),
        (
            other,
            small_angle_diffusion.overlap,
            kernel_arguments,
        ),
    ):
        f = overlap(z, **arguments(survey, properties, where))
        expected = trapezoid(f * delay, z, axis=0) * properties.backscatter_vsf
        expected = expected / expected[0, 0]
        seen = found[0, 0, ::3, ::6]
        assert_allclose(seen / seen[0, 0], expected, rtol=1e-5)


def test_a_hole_in_the_scene_is_a_legal_pixel(plate: Survey) -> None:
    cube = simulate(plate.with_({"targets.0.width": "5 cm"}), rng=1)
    truth = cube.amulor.truth
    beside = truth["target"].values < 0
    assert 0 < beside.sum() < beside.size
    assert np.isfinite(cube["in_phase"].values).all()
    assert np.isnan(truth["slant_range"].values[beside]).all()
    assert (truth["target_in_phase"].values[0, 0][beside] == 0).all()
    # Without a target the column goes on: more water than before one.
    water = np.hypot(truth["water_in_phase"], truth["water_quadrature"]).values[0, 0]
    assert (water[beside] > 0).all()


def test_circular_channels_flip_in_water_and_not_in_paint(plate: Survey) -> None:
    survey = plate.with_({"instrument.polarizations": ["RR", "RL"]})
    truth = simulate(survey, rng=1).amulor.truth
    target = np.hypot(truth["target_in_phase"], truth["target_quadrature"]).values[0]
    water = np.hypot(truth["water_in_phase"], truth["water_quadrature"]).values[0]
    # Same handedness: (1 + m44) / 2; m44 = -0.46 of the paint, -0.62 of the water.
    assert_allclose(target[0] / target[1], 0.27 / 0.73, rtol=1e-9)
    assert_allclose(water[0] / water[1], 0.19 / 0.81, rtol=1e-9)


def test_without_polarizers_all_the_light_counts(plate: Survey) -> None:
    survey = plate.with_({"instrument.polarizations": ["none", "VV", "VH"]})
    truth = simulate(survey, rng=1).amulor.truth
    echo = np.hypot(truth["target_in_phase"], truth["target_quadrature"]).values[0]
    assert_allclose(echo[0], echo[1] + echo[2], rtol=1e-12)


def test_the_stated_covariance_is_that_of_the_samples(plate: Survey) -> None:
    # Weak light and a large phase floor, so that both kinds of noise show.
    survey = plate.with_(
        {
            "instrument.lock_in.phase_floor": "1 deg",
            "water.signal_fluctuation": 0.0,
            "instrument.detector.optical_transmission": "0.02 %",
            "scan.columns": 100,
            "scan.rows": 100,
        }
    )
    cube = simulate(survey, rng=7)
    truth = cube.amulor.truth
    expected = sum(
        truth[f"{part}_in_phase"].values + 1j * truth[f"{part}_quadrature"].values
        for part in ("target", "water")
    )
    error = cube.amulor.signal.values - expected
    a = error.real / cube["in_phase_uncertainty"].values
    b = error.imag / cube["quadrature_uncertainty"].values
    correlation = (
        cube.amulor.covariance
        / cube["in_phase_uncertainty"]
        / cube["quadrature_uncertainty"]
    ).values
    count = a[0, 0].size
    for channel in (0, 1):
        for z in (a[0, channel], b[0, channel]):
            # Variance of a mean square: 2 / n; five standard errors.
            assert abs(np.mean(z**2) - 1) < 5 * np.sqrt(2 / count)
            assert abs(np.mean(z)) < 5 / np.sqrt(count)
        product = np.mean(a[0, channel] * b[0, channel])
        assert abs(product - correlation[0, channel].mean()) < 5 / np.sqrt(count)
    # Both kinds matter here, or the test would not see one of them.
    assert 0.1 < abs(correlation[0, 0]).mean() < 0.95


def test_shot_noise_is_that_of_counting(plate: Survey) -> None:
    # One photoelectron rate, no phase floor: sigma_phase = sqrt(2 F / (m^2 N)).
    survey = plate.with_(
        {"instrument.lock_in.phase_floor": 0.0, "water.scattering": 0.0}
    )
    cube = simulate(survey, rng=3)
    truth = cube.amulor.truth
    amplitude = np.hypot(truth["target_in_phase"], truth["target_quadrature"]).values
    sigma = cube["in_phase_uncertainty"].values / amplitude
    # 75 ms after settling, one pole of 10 ms.
    time = 0.075 / (1 - 0.01 / 0.075 * (1 - np.exp(-7.5)))
    photoelectrons = amplitude / (0.8 * 8e-12) * time
    assert_allclose(sigma, np.sqrt(2 * 1.2 / photoelectrons) / 0.8, rtol=1e-3)


def test_the_water_strays_as_the_survey_says(plate: Survey) -> None:
    cube = simulate(plate.with_({"scan.open_water.repeats": 400}), rng=11)
    shots = cube.amulor.open_water
    amplitude = np.hypot(shots["in_phase"], shots["quadrature"]).values[0, 0]
    by_direction = amplitude.reshape(15, 400)
    relative = by_direction.std(axis=1, ddof=1) / by_direction.mean(axis=1)
    # Standard error of a standard deviation from 15 * 400 shots: 0.9 %.
    assert np.sqrt(np.mean(relative**2)) == pytest.approx(0.05, rel=0.05)


def test_the_same_seed_gives_the_same_cube(plate: Survey) -> None:
    first, again, other = (simulate(plate, rng=seed) for seed in (5, 5, 6))
    np.testing.assert_array_equal(first["in_phase"], again["in_phase"])
    assert (first["in_phase"].values != other["in_phase"].values).all()


def test_a_strong_echo_saturates_the_detector(plate: Survey) -> None:
    survey = plate.with_({"instrument.detector.saturation": "1 mV"})
    cube = simulate(survey, rng=1)
    assert (cube["saturated"].values[0, 0] == 1).all()


@pytest.mark.parametrize("moves", ["beam", "both"])
def test_when_both_move_the_water_is_the_same_everywhere(
    plate: Survey, moves: str
) -> None:
    survey = plate.with_({**QUIET, "scan.moves": moves})
    shots = simulate(survey, rng=1).amulor.open_water
    amplitude = np.hypot(shots["in_phase"], shots["quadrature"]).values[0, 0]
    spread = np.ptp(amplitude) / amplitude.mean()
    if moves == "both":
        # Turning the pair still turns the baseline against the beam: 2 % at 1.9 deg.
        assert spread < 0.05
    else:
        assert spread > 0.5


def test_serpentine_order_runs_back_on_every_second_row(plate: Survey) -> None:
    survey = plate.with_({"scan.order": "serpentine"})
    time = simulate(survey, rng=1)["time"].values
    # Two channels of 125 ms for each of twelve pixels in a row.
    assert_allclose(time[0], np.arange(12) * 0.25)
    assert_allclose(time[1], (np.arange(12)[::-1] + 12) * 0.25)


def test_a_window_shifts_the_phase_by_its_group_path(plate: Survey) -> None:
    window = {"distance": "30 cm", "thickness": "2 cm"}
    survey = plate.with_({**QUIET, "instrument.window": window})
    cube = simulate(survey, rng=1)
    truth = cube.amulor.truth
    assert_allclose(truth["slant_range"].values[2:4, 5:7], 1.5, rtol=1e-3)
    phase = np.arctan2(truth["target_quadrature"], truth["target_in_phase"])[0, 0]
    # Close to the axis: 0.3 m air, 2 cm glass of 1.50, 1.18 m water, there and back.
    straight = 2 * (0.3 + 0.02 * 1.50 + 1.18 * 1.38)
    expected = 2 * np.pi * 39e6 * straight / speed_of_light
    turn = np.angle(np.exp(1j * (phase.values[3, 6] - expected)))
    # The baseline of 7 cm lengthens the way back by 2 mm, 0.1 degrees of arc.
    assert 0 < turn < 2 * np.pi * 39e6 * 4e-3 / speed_of_light


@pytest.mark.parametrize(
    ("changes", "distance"),
    [
        ({"instrument.window": {"distance": "50 cm", "thickness": "2 cm"}}, 0.521),
        ({"instrument.emitter.position": [0.0, 0.0, 0.3]}, 0.301),
    ],
    ids=["window", "emitter ahead of the receiver"],
)
def test_a_thin_layer_of_water_has_the_phase_of_the_target_behind_it(
    plate: Survey, changes: dict[str, object], distance: float
) -> None:
    survey = plate.with_(
        {
            **QUIET,
            **changes,
            "targets.0.position": [0.0, 0.0, distance],
            "instrument.receiver.position": ["1 mm", "0 m", "0 m"],
            "instrument.receiver.azimuth": 0.0,
        }
    )
    truth = simulate(survey, rng=1).amulor.truth
    phases = [
        np.arctan2(truth[f"{part}_quadrature"], truth[f"{part}_in_phase"])[0, 0]
        for part in ("target", "water")
    ]
    # The layer is 1 mm deep: its middle lies 0.5 mm before the target.
    assert_allclose(phases[0], phases[1], rtol=0, atol=2e-3)
    # And it is far off zero: the way before the water counts.
    assert (abs(phases[1]) > 0.2).all()


def test_a_target_behind_the_end_of_the_water_is_refused(plate: Survey) -> None:
    with pytest.raises(SurveyError, match=r"targets.0.*column_end is 1 m"):
        simulate(plate.with_({"water.column_end": "1 m"}), rng=1)


def test_a_receiver_that_looks_away_is_refused(plate: Survey) -> None:
    survey = plate.with_({"instrument.receiver.azimuth": "-80 deg"})
    with pytest.raises(SurveyError, match=r"(80|82) degrees"):
        simulate(survey, rng=1)


def test_a_survey_without_open_water_stays_without(plate: Survey) -> None:
    survey = plate.with_({"scan.open_water": None})
    assert Survey.from_text(survey.to_toml()) == survey
    assert simulate(survey, rng=np.int64(3)).amulor.open_water is None
    assert simulate(survey, rng=np.int64(3)).attrs["seed"] == 3


def test_an_output_that_sees_no_light_is_uncertain_by_one_photoelectron(
    plate_text: str,
) -> None:
    # Water that keeps polarization altogether: the crossed channel sees none of it.
    survey = Survey.from_text(plate_text).with_(
        {"water.backscatter_mueller": [1, -1, -1], "instrument.detector.dark_rate": 0.0}
    )
    cube = simulate(survey, rng=1)
    shots = cube["open_water_in_phase_uncertainty"].sel(polarization="VH").values
    detector, scan = survey.instrument.detector, survey.scan
    # Five time constants settle, the rest of the dwell counts; 2 / T for an amplitude.
    time = integration_time(survey)
    assert 0 < time <= scan.dwell
    one = 2 * detector.excess_noise_factor / time * (1 / time)
    volt = detector.volt_per_photoelectron_rate
    # The phase floor adds its part, of almost nothing.
    assert_allclose(shots, volt * np.sqrt(one), rtol=1e-4)
