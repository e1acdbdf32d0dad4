"""Effects of instruments in the trust study: each in its closed form."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.studies.trust.scenes import instrument
from amulor.studies.trust.scenes.instrument import Recorded
from amulor.survey import Survey


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    return Recorded(2, 1)


def test_leakage_is_one_phasor_a_frequency_in_the_scan_alone(
    recorded: Recorded,
) -> None:
    scan, shots = instrument.leakage(0.03)(recorded)
    added = scan - recorded.scan
    assert_allclose(added, added[:, :1, :1, :1] * np.ones_like(added), rtol=1e-9)
    assert_allclose(np.abs(added[:, 0, 0, 0]), 0.03 * recorded.echo[:, 0])
    assert_allclose(np.angle(added[:, 0, 0, 0]), 2 * np.pi * 0.13)
    assert shots is recorded.shots


def test_leakage_with_a_delay_turns_with_frequency_and_is_in_the_shots(
    recorded: Recorded,
) -> None:
    scan, shots = instrument.leakage(0.03, delay=2e-9)(recorded)
    added = (scan - recorded.scan)[:, 1, 3, 5]
    # 20 and 80 MHz times 2 ns: 0.04 and 0.16 of a turn.
    assert_allclose(np.angle(added) / (2 * np.pi), [0.04, 0.16], rtol=1e-9)
    assert_allclose((shots - recorded.shots)[:, 0, 7], added, rtol=1e-9)


def test_walk_turns_ten_times_the_echo_by_its_degrees(recorded: Recorded) -> None:
    scan, _ = instrument.walk(2.0)(recorded)
    decades = np.log10(np.abs(recorded.scan) / recorded.echo[:, :, None, None])
    turn = np.degrees(np.angle(scan / recorded.scan))
    assert_allclose(turn, 2 * decades, atol=1e-9)
    assert_allclose(np.abs(scan), np.abs(recorded.scan))


def test_the_layer_adds_the_water_of_its_thickness(recorded: Recorded) -> None:
    thin, shots = instrument.turbid_layer(0.1)(recorded)
    thick, _ = instrument.turbid_layer(0.4)(recorded)
    least = np.abs(thin - recorded.scan)
    most = np.abs(thick - recorded.scan)
    assert np.all(least[:, 0] > 0)
    assert np.all(most[:, 0] > 3 * least[:, 0])
    twice, _ = instrument.turbid_layer(0.4, factor=3.0)(recorded)
    assert_allclose(twice - recorded.scan, 2 * (thick - recorded.scan), rtol=1e-9)
    assert shots is recorded.shots


def test_water_with_a_gradient_adds_light_of_its_distance(recorded: Recorded) -> None:
    scan, shots = instrument.gradient(0.1)(recorded)
    water = recorded.truth("water")
    more = (scan - recorded.scan) / water
    # Most light comes from the first meter, and the light that is added from beyond.
    assert 0.01 < np.abs(more).mean() < 0.2
    assert np.angle(more[0]).mean() > 0
    assert np.all(np.abs(shots).mean(axis=-1) > np.abs(recorded.shots).mean(axis=-1))
    twice, _ = instrument.gradient(0.2)(recorded)
    assert_allclose(twice - recorded.scan, 2 * (scan - recorded.scan), rtol=1e-9)


def test_drift_ends_in_the_second_half_of_the_shots(recorded: Recorded) -> None:
    scan, shots = instrument.drift(delay=30e-12)(recorded)
    turn = np.angle(scan / recorded.scan)[:, 0]
    frequency = np.array([20e6, 80e6])
    assert_allclose(turn[:, 0, 0], 0, atol=1e-12)
    assert_allclose(turn[:, -1, -1], 2 * np.pi * frequency * 30e-12, rtol=1e-9)
    late = np.angle(shots / recorded.shots)[1, 0]
    half = len(late) // 2
    assert_allclose(late[:half], 0, atol=1e-12)
    assert_allclose(late[half:], 2 * np.pi * 80e6 * 30e-12, rtol=1e-9)


def test_the_aliased_harmonic_has_the_size_of_the_light_at_three_times_the_frequency(
    recorded: Recorded,
) -> None:
    scan, shots = instrument.aliased_harmonic(0.01)(recorded)
    size = np.abs(scan - recorded.scan) / np.abs(recorded.truth("target"))
    # Water damps three times the frequency more than the frequency itself.
    assert 0.001 < np.median(size[:, 0]) < 0.02
    fraction = np.abs(shots - recorded.shots) / np.abs(recorded.shots)
    assert np.all(fraction < 0.01)


def test_compression_and_scale_change_depend_on_the_amplitude(
    recorded: Recorded,
) -> None:
    scan, _ = instrument.compression(0.05)(recorded)
    lost = 1 - np.abs(scan / recorded.scan)
    size = np.abs(recorded.scan) / recorded.echo[:, :, None, None]
    assert_allclose(lost, 0.05 * size, rtol=1e-9)
    scan, _ = instrument.scale_change(0.5)(recorded)
    turn = np.degrees(np.angle(scan / recorded.scan))
    assert_allclose((turn > 0.25).mean(axis=(2, 3)), 0.5, atol=0.01)
    assert turn.max() == pytest.approx(0.5)


def test_a_reflection_turns_and_a_window_reaches_one_channel(
    recorded: Recorded,
) -> None:
    scan, shots = instrument.reflection(0.02, delay=10e-9)(recorded)
    # 20 and 80 MHz times 10 ns: 0.2 and 0.8 of a turn.
    expected = 1 + 0.02 * np.exp(2j * np.pi * np.array([0.2, 0.8]))
    assert_allclose((scan / recorded.scan)[:, 1, 4, 4], expected, rtol=1e-9)
    assert_allclose((shots / recorded.shots)[:, 0, 3], expected, rtol=1e-9)
    scan, shots = instrument.window(0.02)(recorded)
    added = (scan - recorded.scan)[:, 0, 2, 2]
    assert_allclose(np.angle(added) / (2 * np.pi), [0.01, 0.04], rtol=1e-9)
    assert_allclose(np.abs(added), 0.02 * recorded.echo[:, 0])
    assert_array_equal(scan[:, 1], recorded.scan[:, 1])
    assert_array_equal(shots[:, 1], recorded.shots[:, 1])


def test_leakage_grows_from_the_first_sample_to_the_late_shots(
    recorded: Recorded,
) -> None:
    scan, shots = instrument.growing_leakage(0.01)(recorded)
    size = np.abs(scan - recorded.scan)[:, 0] / recorded.echo[:, :, None]
    assert_allclose(size[:, 0, 0], 0, atol=1e-12)
    assert_allclose(size[:, -1, -1], 0.01)
    late = np.abs(shots - recorded.shots)[:, 0] / recorded.echo
    half = late.shape[1] // 2
    assert_allclose(late[:, :half], 0, atol=1e-12)
    assert_allclose(late[:, half:], 0.01)


def test_a_demodulator_makes_an_ellipse_of_a_circle(recorded: Recorded) -> None:
    scan, _ = instrument.quadrature(gain=0.02)(recorded)
    assert_allclose(scan.real, recorded.scan.real)
    assert_allclose(scan.imag, 1.02 * recorded.scan.imag)
    scan, _ = instrument.quadrature(degrees=90.0)(recorded)
    assert_allclose(scan.imag, recorded.scan.real)
    step = 0.1 * recorded.echo[:, 0]
    scan, _ = instrument.resolution(0.1)(recorded)
    multiple = scan.imag[:, 0] / step[:, None, None]
    assert_allclose(multiple, np.round(multiple), atol=1e-9)


def test_noise_has_the_size_that_it_states(recorded: Recorded) -> None:
    scan, shots = instrument.excess_noise(3.0)(recorded)
    sigma = recorded.cube["in_phase_uncertainty"].values
    added = (scan - recorded.scan).real / sigma
    # 1,536 values: their standard deviation is known to 1.8 %.
    assert np.std(added) == pytest.approx(3.0, rel=0.08)
    assert not np.array_equal(shots, recorded.shots)


def test_a_calibration_states_the_phase_error_that_the_echo_has(
    recorded: Recorded,
) -> None:
    turned = instrument.phase_ripple(np.degrees(0.01))
    # 0.01 rad times 1.0 and -1.2, in water as in air.
    error = instrument.phase_error(recorded, turned)
    assert error == pytest.approx(0.01 * math.sqrt(1.22), rel=0.02)
    # A leakage of 1 % turns a plate by its part across the echo, whatever the
    # references contain; pixels differ by a few percent in amplitude.
    leaking = instrument.leakage(0.01, delay=2e-9)
    error = instrument.phase_error(recorded, leaking)
    assert error == pytest.approx(0.01 / math.sqrt(2), rel=0.1)
    known = instrument.case("harmonic", 3.0, 1, "calibrated", 1)
    third = instrument.case("harmonic", 3.0, 1, "wrong", 1)
    stated, wrong = (
        case.samples.amulor.survey.instrument.phase_uncertainty
        for case in (known, third)
    )
    # A third of it, and 0.05 degrees at least.
    assert stated is not None
    assert wrong is not None
    least = np.radians(0.05)
    assert stated**2 - least**2 == pytest.approx(9 * (wrong**2 - least**2), rel=1e-6)
    corrected = instrument.case("phase ripple", 3.0, 2, "calibrated", 1)
    stated = corrected.samples.amulor.survey.instrument.phase_uncertainty
    # A tenth of 0.9 degrees times 1.0 and -1.2: rms 0.0994 degrees.
    assert np.degrees(stated) == pytest.approx(np.hypot(0.0994, 0.05), rel=0.05)


def test_the_survey_names_an_analog_demodulator_only_if_it_has_one() -> None:
    kinds = {
        kind: instrument.case(
            kind, 1.0, 1, "uncalibrated", 1
        ).samples.amulor.survey.instrument.lock_in.demodulator
        for kind in ("quadrature gain", "quadrature angle", "walk")
    }
    assert kinds == {
        "quadrature gain": "analog",
        "quadrature angle": "analog",
        "walk": None,
    }


def test_a_case_keeps_its_truth_apart_and_states_its_calibration() -> None:
    stated = instrument.case("harmonic", 1.0, 1, "calibrated", 1)
    without = instrument.case("harmonic", 1.0, 1, "uncalibrated", 1)
    assert not [name for name in stated.samples if str(name).startswith("truth")]
    known = Survey.from_text(stated.samples.attrs["survey"]).calibration
    assert known is not None
    assert known.delay_uncertainty == pytest.approx(1e-11)
    unknown = Survey.from_text(without.samples.attrs["survey"])
    assert unknown.calibration is None
    assert unknown.instrument.phase_uncertainty is None
    assert_array_equal(stated.samples["in_phase"], without.samples["in_phase"])


def test_a_calibration_leaves_a_tenth_of_a_leakage_and_a_wrong_one_more() -> None:
    perfect = instrument.case("perfect", 1.0, 1, "calibrated", 1).samples
    added = []
    for state in instrument.STATES:
        samples = instrument.case("offset", 1.0, 1, state, 1).samples
        added.append((samples["in_phase"] - perfect["in_phase"]).values[0, 0, 3, 4])
    assert_allclose(np.divide(added, added[0]), [1.0, 0.1, 0.3], rtol=1e-6)


def test_each_kind_changes_the_samples_but_the_perfect_one(
    recorded: Recorded,
) -> None:
    for name, kind in instrument.KINDS.items():
        scan, _ = kind.of_size(1.0)(recorded)
        assert np.array_equal(scan, recorded.scan) == (name == "perfect"), name
    assert len(instrument.KINDS) > 15
