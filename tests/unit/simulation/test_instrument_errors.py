"""Errors of a simulated instrument: each in closed form, and against other code."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light
from signal_chains import FREQUENCIES

from amulor.errors import SurveyError
from amulor.simulation import ClosureModel, simulate
from amulor.simulation.by_rows import SimulatedRows
from amulor.studies.trust.scenes import instrument
from amulor.studies.trust.scenes.instrument import Recorded
from amulor.survey import Survey

SHOTS = "open_water_"
#: Every error at once, for what must hold whatever is stated.
ALL: dict[str, Any] = {
    "pointing": {"jitter": "1 mrad", "backlash": "2 mrad"},
    "clock": {"frequency_error": 1e-5},
    "plume": {"fraction": 0.2, "distance": "1 m", "optical_thickness": 0.02,
              "width": "2 deg"},
    "bubbles": {"number": 0.3, "fraction": 0.1, "nearest": "0.5 m",
                "farthest": "2 m"},
    "drift": {"phase": "1 deg", "delay": "30 ps", "power": -0.05,
              "modulation_depth": 0.02, "settling_time": "20 s"},
    "optical_leakage": {"fraction": 1e-9, "delay": "1 ns", "depolarization": 0.2},
    "counting": {"dead_time": "20 ns", "after_pulse_probability": 0.02,
                 "after_pulse_delay": "1 us"},
    "harmonic": {"fraction": 0.01},
    "compression": {"fraction": 0.05, "amplitude": "10 mV"},
    "walk": {"phase_per_decade": "2 deg", "amplitude": "10 mV"},
    "reflection": {"coefficient": 0.01, "delay": "10 ns"},
    "crosstalk": {"amplitude": "20 uV", "change": 0.5},
    "temperature": {"temperature": "25 degC", "delay_per_degree": "5 ps"},
    "scale_change": {"above": "5 mV", "phase": "0.5 deg", "gain": 0.01},
    "demodulator": {"in_phase_offset": "5 uV", "quadrature_gain": 0.01,
                    "quadrature_phase": "0.5 deg", "resolution": "1 uV"},
    "noise": {"white": "3 uV", "pink": "2 uV"},
}  # fmt: skip

AXES = ("azimuth", "elevation")


@pytest.fixture(scope="module")
def survey(survey: Survey) -> Survey:
    """Return the scan of this folder with four shots in each direction."""
    return survey.with_({"scan.open_water.repeats": 4})


def simulated(survey: Survey, **errors: Any) -> xr.Dataset:
    stated = {name: dict(each) for name, each in errors.items()}
    return simulate(
        survey.with_({"instrument.errors": stated}) if errors else survey,
        rng=7,
        model=ClosureModel(),
    )


def outputs(cube: xr.Dataset, prefix: str = "") -> np.ndarray:
    return np.asarray(cube[f"{prefix}in_phase"] + 1j * cube[f"{prefix}quadrature"])


def pair(cube: xr.Dataset) -> tuple[np.ndarray, np.ndarray]:
    return outputs(cube), outputs(cube, SHOTS)


@pytest.fixture(scope="module")
def perfect(survey: Survey) -> xr.Dataset:
    return simulated(survey)


def test_nothing_changes_without_errors_or_with_empty_ones(
    survey: Survey, perfect: xr.Dataset
) -> None:
    empty = simulate(
        survey.with_({"instrument.errors": {}}), rng=7, model=ClosureModel()
    )
    for name in perfect.data_vars:
        assert_array_equal(perfect[name].values, empty[name].values)


def test_errors_of_size_zero_change_nothing_but_rounding(
    survey: Survey, perfect: xr.Dataset
) -> None:
    zero = {"drift": {}, "pointing": {}, "counting": {}, "demodulator": {}, "noise": {},
            "reflection": {"coefficient": 0.0, "delay": "1 ns"},
            "crosstalk": {"amplitude": "0 V"}}  # fmt: skip
    cube = simulated(survey, **zero)
    assert_allclose(outputs(cube), outputs(perfect), rtol=1e-12)


def test_crosstalk_adds_its_phasor_to_scan_and_shots(
    survey: Survey, perfect: xr.Dataset
) -> None:
    cube = simulated(
        survey, crosstalk={"amplitude": ["20 uV", "30 uV"], "phase": "30 deg",
                           "delay": "2 ns"},
    )  # fmt: skip
    phasor = np.array([20e-6, 30e-6]) * np.exp(
        1j * (np.radians(30) + 2 * np.pi * FREQUENCIES * 2e-9)
    )
    scan, shots = (
        new - old for new, old in zip(pair(cube), pair(perfect), strict=True)
    )
    assert_allclose(scan, phasor[:, None, None, None] + 0 * scan, rtol=1e-9)
    assert_allclose(shots, phasor[:, None, None] + 0 * shots, rtol=1e-9)


def test_crosstalk_of_the_scan_alone_is_the_leakage_of_the_trust_study() -> None:
    recorded = Recorded(2, 1)
    scan, shots = instrument.leakage(0.03)(recorded)
    stray = {"amplitude": list(0.03 * recorded.echo[:, 0]), "part": "scan",
             "phase": 2 * np.pi * 0.13}  # fmt: skip
    stated = recorded.survey.with_({"instrument.errors": {"crosstalk": stray}})
    cube = simulate(stated, rng=1)
    assert_allclose(outputs(cube), scan, rtol=1e-9)
    assert_allclose(
        np.sort_complex(outputs(cube, SHOTS).ravel()), np.sort_complex(shots.ravel())
    )


@pytest.mark.parametrize(
    ("effect", "errors"),
    [
        (instrument.walk(2.0), lambda echo: {"walk": {
            "phase_per_decade": "2 deg", "amplitude": echo}}),
        (instrument.compression(0.05), lambda echo: {"compression": {
            "fraction": 0.05, "amplitude": echo}}),
        (instrument.aliased_harmonic(0.01), lambda _: {"harmonic": {
            "fraction": 0.01}}),
    ],
)  # fmt: skip
def test_effects_are_those_of_the_trust_study(effect: Any, errors: Any) -> None:
    recorded = Recorded(1, 1)
    expected, _ = effect(recorded)
    stated = errors(float(recorded.echo[0, 0]))
    cube = simulate(recorded.survey.with_({"instrument.errors": stated}), rng=1)
    off = outputs(cube) - expected
    # The table of water light has other nodes where the harmonic is computed, too.
    assert np.abs(off).max() < 1e-6 * np.abs(expected).max()
    assert np.abs(expected - recorded.scan).max() > 1e-3 * np.abs(expected).max()


def test_walk_turns_by_decades_and_keeps_the_amplitude(
    survey: Survey, perfect: xr.Dataset
) -> None:
    cube = simulated(survey, walk={"phase_per_decade": "2 deg", "amplitude": "1 mV"})
    for new, old in zip(pair(cube), pair(perfect), strict=True):
        turn = np.degrees(np.angle(new / old))
        assert_allclose(turn, 2 * np.log10(np.abs(old) / 1e-3), atol=1e-9)
        assert_allclose(np.abs(new), np.abs(old), rtol=1e-12)


def test_compression_takes_its_fraction_at_its_amplitude(
    survey: Survey, perfect: xr.Dataset
) -> None:
    cube = simulated(survey, compression={"fraction": 0.05, "amplitude": "20 mV"})
    for new, old in zip(pair(cube), pair(perfect), strict=True):
        assert_allclose(new, old * (1 - 0.05 * np.abs(old) / 20e-3), rtol=1e-12)


def test_a_reflection_ripples_over_frequency(
    survey: Survey, perfect: xr.Dataset
) -> None:
    cube = simulated(survey, reflection={"coefficient": 0.01, "delay": "12.5 ns"})
    # 20 MHz times 12.5 ns is a quarter of a turn, 60 MHz three quarters.
    ratio = outputs(cube) / outputs(perfect)
    assert_allclose(ratio[0], 1 + 0.01j, rtol=1e-9)
    assert_allclose(ratio[1], 1 - 0.01j, rtol=1e-9)


def test_drift_grows_evenly_from_the_first_shot_to_the_last(
    survey: Survey, perfect: xr.Dataset
) -> None:
    still = simulated(survey, drift={})
    cube = simulated(survey, drift={"phase": "1 deg", "delay": "30 ps"})
    whole = np.radians(1) + 2 * np.pi * FREQUENCIES * 30e-12
    # 12 shots, 24 pixels, 12 shots: 47 steps.
    number = np.array([[0, 1, 2, 3, 4, 5], [11, 10, 9, 8, 7, 6]])
    number = np.concatenate([number, number + 12]) + 12
    turn = np.angle(outputs(cube) / outputs(still))[:, 0]
    assert_allclose(turn, whole[:, None, None] * number / 47, rtol=1e-9)
    place = np.concatenate([np.arange(12), np.arange(36, 48)])
    late = np.angle(outputs(cube, SHOTS) / outputs(still, SHOTS))[:, 1]
    assert_allclose(late, whole[:, None] * place / 47, rtol=1e-9, atol=1e-15)
    # Four rounds over six directions, two of them before the scan.
    angles = np.stack([cube[f"{SHOTS}{name}"].values for name in AXES], axis=-1)
    rounds = angles.reshape(4, 6, 2)
    assert_array_equal(rounds, np.broadcast_to(rounds[0], rounds.shape))
    assert len(np.unique(rounds[0], axis=0)) == 6
    assert_array_equal(outputs(still), outputs(perfect))


def test_a_settling_drift_is_an_exponential(survey: Survey) -> None:
    step = 0.125 * 4
    still = simulated(survey, drift={})
    cube = simulated(survey, drift={"phase": "1 deg", "settling_time": f"{8 * step} s"})
    turn = np.degrees(np.angle(outputs(cube, SHOTS) / outputs(still, SHOTS)))[0, 0]
    place = np.concatenate([np.arange(12), np.arange(36, 48)])
    assert_allclose(turn, (1 - np.exp(-place / 8)) / (1 - np.exp(-47 / 8)), atol=1e-9)


def test_power_and_depth_drift_scale_the_light(survey: Survey) -> None:
    quiet = survey.with_(
        {"instrument.power": "1 W", "instrument.lock_in.phase_floor": 0,
         "water.signal_fluctuation": 0}
    )  # fmt: skip
    still = simulated(quiet, drift={})
    cube = simulated(quiet, drift={"power": -0.1, "modulation_depth": 0.05})
    ratio = np.abs(outputs(cube, SHOTS) / outputs(still, SHOTS))[0, 0]
    assert ratio[-1] == pytest.approx(0.9 * 1.05, rel=2e-3)
    assert ratio[0] == pytest.approx(1, rel=1e-9)
    # Depth leaves the mean light, and so the counting noise, alone.
    noise = [c[f"{SHOTS}in_phase_uncertainty"].values[0, 0, -1] for c in (cube, still)]
    assert noise[0] / noise[1] == pytest.approx(np.sqrt(0.9), rel=1e-3)


def test_optical_leakage_is_light_with_a_delay_behind_the_analyser(
    survey: Survey,
) -> None:
    leak = {"fraction": 1e-6, "delay": "5 ns", "depolarization": 0.4}
    quiet = survey.with_({"instrument.lock_in.phase_floor": 0})
    perfect, cube = simulated(quiet), simulated(quiet, optical_leakage=leak)
    # VV passes (1 + 0.6) / 2 of it, VH (1 - 0.6) / 2.
    added = outputs(cube) - outputs(perfect)
    one = 1e-6 * survey.instrument.modulation_depth * _volts_of_all_light(survey)
    phasor = one * np.exp(2j * np.pi * FREQUENCIES * 5e-9)
    noise = 5 * cube["in_phase_uncertainty"].values.max() / np.sqrt(added[0, 0].size)
    assert noise < 0.05 * one
    for channel, share in enumerate((0.8, 0.2)):
        found = added[:, channel].mean(axis=(1, 2))
        assert np.all(np.abs(found - share * phasor) < noise)
    assert np.all(cube["in_phase_uncertainty"] > perfect["in_phase_uncertainty"])


def _volts_of_all_light(survey: Survey) -> float:
    energy = 6.62607015e-34 * 299792458.0 / survey.instrument.wavelength
    detector = survey.instrument.detector
    rate = survey.instrument.power / energy * detector.quantum_efficiency
    rate *= detector.optical_transmission
    return float(rate * detector.volt_per_photoelectron_rate)


def test_dead_time_loses_the_square_of_the_live_time_of_the_modulation(
    survey: Survey,
) -> None:
    quiet = survey.with_({"water.signal_fluctuation": 0})
    whole, dead = simulated(quiet), simulated(quiet, counting={"dead_time": "40 ps"})
    rate = _rate(whole, quiet)
    live = 1 / (1 + rate * 40e-12)
    ratio = np.abs(outputs(dead)[:, 0] / outputs(whole)[:, 0])
    assert live.min() < 0.9
    assert_allclose(ratio, live[:, 0] ** 2, rtol=0.02)


def _rate(cube: xr.Dataset, survey: Survey) -> np.ndarray:
    truth = np.abs(
        outputs(cube, "truth_target_") + outputs(cube, "truth_water_")
    )  # lowest frequency: hardly damped
    detector = survey.instrument.detector
    mean = truth[:1] / survey.instrument.modulation_depth
    return np.asarray(
        np.broadcast_to(mean, truth.shape) / detector.volt_per_photoelectron_rate
    )


def test_after_pulses_are_late_light(survey: Survey) -> None:
    quiet = survey.with_({"instrument.power": "10 W", "water.signal_fluctuation": 0})
    late = {"after_pulse_probability": 0.05, "after_pulse_delay": "3 ns"}
    whole, after = simulated(quiet), simulated(quiet, counting=late)
    expected = 1 + 0.05 / (1 - 2j * np.pi * FREQUENCIES * 3e-9)
    ratio = (outputs(after)[:, 0] / outputs(whole)[:, 0]).mean(axis=(1, 2))
    assert_allclose(ratio, expected, rtol=1e-3)


def test_a_wrong_clock_turns_the_echo_by_its_error(survey: Survey) -> None:
    whole, off = simulated(survey), simulated(survey, clock={"frequency_error": 1e-3})
    for cube in (whole, off):
        assert_allclose(cube["modulation_frequency"], FREQUENCIES)
    phase = np.angle(outputs(off, "truth_target_") / outputs(whole, "truth_target_"))
    # About 2 x 1.5 m of optical path 1.34 to 1.4.
    path = phase[:, 0] / (2 * np.pi * FREQUENCIES[:, None, None] * 1e-3) * 299792458.0
    assert_allclose(path[0], path[1], rtol=0.01)
    assert 3.9 < path.mean() < 4.5


def test_pointing_moves_the_beams_and_not_what_is_recorded(survey: Survey) -> None:
    lag = simulated(survey, pointing={"backlash": "20 mrad"})
    whole = simulated(survey)
    assert_array_equal(lag["azimuth"], whole["azimuth"])
    azimuth = whole["azimuth"].values
    away = np.where(np.arange(4) % 2 == 1, -0.01, 0.01)[:, None]
    elevation = whole["elevation"].values
    expected = 1.5 / (np.cos(azimuth + away) * np.cos(elevation))
    change = lag["truth_slant_range"] - whole["truth_slant_range"]
    before = 1.5 / (np.cos(azimuth) * np.cos(elevation))
    assert_allclose(change, expected - before, rtol=0.05, atol=2e-5)
    assert np.abs(lag["truth_slant_range"] - whole["truth_slant_range"]).max() > 1e-4
    jitter = simulated(survey, pointing={"jitter": "5 mrad"})
    moved = jitter["truth_slant_range"].values - whole["truth_slant_range"].values
    assert np.all(moved != 0)


def test_the_demodulator_tells_offset_gain_and_angle(
    survey: Survey, perfect: xr.Dataset
) -> None:
    cube = simulated(
        survey,
        demodulator={"in_phase_offset": "5 uV", "quadrature_offset": "-7 uV",
                     "quadrature_gain": 0.02, "quadrature_phase": "3 deg"},
    )  # fmt: skip
    old, new = outputs(perfect), outputs(cube)
    assert_allclose(new.real, old.real + 5e-6, rtol=1e-9)
    turned = old.imag * np.cos(np.radians(3)) + old.real * np.sin(np.radians(3))
    assert_allclose(new.imag, 1.02 * turned - 7e-6, rtol=1e-9)


def test_scale_and_resolution_change_the_outputs_in_steps(
    survey: Survey, perfect: xr.Dataset
) -> None:
    old = outputs(perfect)
    limit = float(np.median(np.abs(old)))
    cube = simulated(
        survey, scale_change={"above": limit, "phase": "0.5 deg", "gain": 0.01}
    )
    ratio = outputs(cube) / old
    high = np.abs(old) > limit
    assert_allclose(ratio[high], 1.01 * np.exp(1j * np.radians(0.5)), rtol=1e-9)
    assert_allclose(ratio[~high], 1, rtol=1e-12)
    rounded = outputs(simulated(survey, demodulator={"resolution": "100 uV"}))
    assert_allclose(rounded.real / 1e-4, np.rint(old.real / 1e-4), atol=1e-9)
    assert_allclose(rounded.imag / 1e-4, np.rint(old.imag / 1e-4), atol=1e-9)


def test_noise_has_its_size_and_pink_noise_is_alike_from_pixel_to_pixel(
    survey: Survey,
) -> None:
    large = survey.with_({"scan.columns": 40, "scan.rows": 40})
    whole = outputs(simulated(large))
    white = outputs(simulated(large, noise={"white": "30 uV"})) - whole
    assert white.real.std() == pytest.approx(30e-6, rel=0.03)
    assert white.imag.std() == pytest.approx(30e-6, rel=0.03)
    pink = outputs(simulated(large, noise={"pink": "30 uV"})) - whole
    assert pink.real.std() == pytest.approx(30e-6, rel=0.15)
    # Even rows run to the right: neighbours of one row follow each other in time.
    row = pink.real[:, :, ::2]
    likeness = np.mean(row[..., 1:] * row[..., :-1]) / np.mean(row**2)
    assert likeness > 0.6
    row = white.real[:, :, ::2]
    assert abs(np.mean(row[..., 1:] * row[..., :-1])) < 0.05 * np.mean(row**2)


def test_a_scan_by_rows_has_the_same_errors(survey: Survey) -> None:
    stated = survey.with_({"instrument.errors": ALL})
    whole = simulate(stated, rng=7, model=ClosureModel())
    source = SimulatedRows(stated, rng=7, model=ClosureModel())
    parts = [source.tile(0, 1), source.tile(1, 4)]
    for name in ("in_phase", "quadrature", "truth_slant_range"):
        joined = xr.concat([part[name] for part in parts], dim="row")
        assert_array_equal(joined.transpose(*whole[name].dims), whole[name])
    assert_array_equal(parts[0][f"{SHOTS}in_phase"], whole[f"{SHOTS}in_phase"])


def test_a_generator_gives_other_errors_each_time(survey: Survey) -> None:
    stated = survey.with_({"instrument.errors": {"noise": {"white": "1 mV"}}})
    rng = np.random.default_rng(3)
    one, two = (simulate(stated, rng=rng, model=ClosureModel()) for _ in range(2))
    assert not np.array_equal(one["in_phase"], two["in_phase"])


def test_a_survey_with_all_errors_is_written_and_read_back(survey: Survey) -> None:
    stated = survey.with_({"instrument.errors": ALL})
    assert Survey.from_text(stated.to_toml()) == stated


def test_wrong_errors_are_refused(survey: Survey) -> None:
    with pytest.raises(SurveyError, match="has 3 values for 2 modulation frequencies"):
        survey.with_({"instrument.errors": {"crosstalk": {"amplitude": [1.0] * 3}}})
    with pytest.raises(SurveyError, match="no field of a survey"):
        survey.with_({"instrument.errors": {"gremlins": {}}})
    bubbles = {"number": 1, "fraction": 1, "nearest": "2 m", "farthest": "1 m"}
    with pytest.raises(SurveyError, match="must be below farthest"):
        survey.with_({"instrument.errors": {"bubbles": bubbles}})
    with pytest.raises(SurveyError, match="found 4"):
        survey.with_({"instrument.errors": {"harmonic": {"order": 4, "fraction": 1}}})


def test_daylight_fills_the_dead_time(survey: Survey) -> None:
    bright = {"radiance": 4e6, "bandwidth": 3e-9}
    quiet = survey.with_({"water.signal_fluctuation": 0})
    lit = quiet.with_({"daylight": bright})
    whole, dead = simulated(lit), simulated(lit, counting={"dead_time": "40 ps"})
    detector = survey.instrument.detector
    energy = 6.62607015e-34 * 299792458.0 / survey.instrument.wavelength
    cone, area = np.pi * 0.08**2, np.pi * 0.02**2
    # Behind an analyzer half of unpolarized light passes.
    daylight = 0.5 * 4e6 * 3e-9 * area * cone / energy
    daylight *= detector.quantum_efficiency * detector.optical_transmission
    live = 1 / (1 + (_rate(whole, quiet) + daylight) * 40e-12)
    assert 1 / (1 + daylight * 40e-12) < 0.9
    ratio = np.abs(outputs(dead)[:, 0] / outputs(whole)[:, 0])
    assert_allclose(ratio, live[:, 0] ** 2, rtol=0.02)


def test_a_plume_adds_light_from_its_distance_to_the_scan_alone(
    survey: Survey, perfect: xr.Dataset
) -> None:
    scan, shots = pair(perfect)
    near, far = (
        pair(simulated(survey, plume={"fraction": 2.0, "distance": distance}))
        for distance in ("0.8 m", "1.3 m")
    )
    assert_array_equal(near[1], shots)
    index = perfect.amulor.geometry["group_index"]
    turns = 2 * FREQUENCIES * index * 0.5 / speed_of_light
    expected = np.exp(2j * np.pi * turns)[:, None, None, None]
    # Shot noise of the added light.
    assert_allclose((far[0] - scan) / (near[0] - scan), expected + 0 * scan, atol=0.02)


def test_a_plume_has_a_normal_profile_and_weakens_the_echo(
    survey: Survey, perfect: xr.Dataset
) -> None:
    width = float(np.ptp(perfect["azimuth"].values)) / 2
    wide, plume = (
        outputs(simulated(survey, plume={"fraction": 2.0, "distance": "1 m", **more}))
        - outputs(perfect)
        for more in ({}, {"width": width})
    )
    profile = np.exp(-((perfect["azimuth"].values / width) ** 2) / 2)
    assert_allclose(plume / wide, profile + 0 * wide, atol=0.02)
    thick = {"fraction": 0.0, "distance": "1 m", "optical_thickness": 0.1}
    lost = outputs(perfect) - outputs(simulated(survey, plume=thick))
    echo = outputs(perfect, "truth_target_")
    assert_allclose(lost / echo, 1 - np.exp(-0.2) + 0 * echo, atol=0.01)


def test_bubbles_are_counted_by_their_light(
    survey: Survey, perfect: xr.Dataset
) -> None:
    (scan, shots), places = pair(perfect), {"nearest": "1 m", "farthest": "1.0001 m"}
    bubbles = {"number": 1.5, "fraction": 2.0, "part": "scan", **places}
    seen = pair(simulated(survey, bubbles=bubbles))
    assert_array_equal(seen[1], shots)
    # A plume without a width is the light of a single bubble in each sample.
    one = outputs(simulated(survey, plume={"fraction": 2.0, "distance": "1 m"}))
    count = (seen[0] - scan) / (one - scan)
    assert_allclose(count, np.round(count.real), atol=0.1)
    # 96 numbers of a Poisson distribution: standard error of the mean 0.125.
    assert count.real.mean() == pytest.approx(1.5, abs=0.4)
    assert count.real.var() == pytest.approx(1.5, abs=0.7)
