"""Range errors before and after each calibration, and the order of calibrations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.cli import main
from amulor.imaging.calibration_plan import calibration_plan, first_calibration
from amulor.survey import Survey

#: A receiver beside the emitter: the path is twice the slant range.
COAXIAL = {"instrument.receiver.position": ["0 m", "0 m", "0 m"]}
ALL = {
    "calibration": {
        "delay_uncertainty": "1 ps",
        "receiver_position_uncertainty": "0.1 mm",
        "direction_uncertainty": "0.001 deg",
        "group_index_uncertainty": 1e-5,
    }
}


@pytest.fixture(scope="module")
def survey(plate: Survey) -> Survey:
    return plate.with_(
        {
            **COAXIAL,
            "instrument.receiver.azimuth": "0 deg",
            "instrument.phase_uncertainty": None,
            "water.group_index": 1.38,
        }
    )


def by_name(survey: Survey) -> dict:
    return {line.name: line for line in calibration_plan(survey, slant_range=1.5)}


def test_each_error_has_the_size_of_its_formula(survey: Survey) -> None:
    stated = survey.with_(
        {
            "calibration": {
                "delay_uncertainty": "0.1 ns",
                "group_index_uncertainty": 0.002,
            }
        }
    )
    lines = by_name(stated)
    # c t / 2 n for 0.1 ns, and a distance of 1 mm.
    assert_allclose(lines["delay"].now, speed_of_light * 0.1e-9 / 2 / 1.38, rtol=1e-4)
    assert_allclose(lines["delay"].calibrated, 1e-3, rtol=1e-4)
    # Six times 0.5 degrees at 39 MHz alone: c / (4 pi f n) a radian.
    per_radian = speed_of_light / (4 * math.pi * 39e6 * 1.38)
    phase = lines["leakage, walk, harmonics"]
    assert_allclose(phase.now, math.radians(3.0) * per_radian, rtol=1e-3)
    assert_allclose(phase.calibrated, math.radians(0.4) * per_radian, rtol=1e-3)
    # The range in proportion to the index.
    assert_allclose(lines["group index"].now, 1.5 * 0.002 / 1.38, rtol=1e-2)
    assert lines["geometry"].now is None
    # An even distribution of 30 ps; 1 mrad at the one frequency.
    drift = lines["drift"]
    of_drift = speed_of_light * 30e-12 / math.sqrt(12) / 2 / 1.38
    assert_allclose(drift.now, of_drift, rtol=1e-4)
    assert_allclose(drift.calibrated, 1e-3 * per_radian, rtol=1e-3)


def test_the_temperature_is_a_line_unless_another_one_contains_it(
    survey: Survey,
) -> None:
    line = by_name(survey)["temperature"]
    assert line.now is None
    # 0.5 degC of 5 ps.
    per_second = speed_of_light / 2 / 1.38
    assert_allclose(line.calibrated, per_second * 2.5e-12, rtol=1e-4)
    stated = {
        "delay_uncertainty": "10 ps",
        "delay_per_degree": "8 ps",
        "instrument_temperature_uncertainty": "5 degC",
    }
    known = survey.with_(
        {"calibration": stated, "scan.instrument_temperature_uncertainty": 0.25}
    )
    line = by_name(known)["temperature"]
    assert_allclose(line.now, per_second * 40e-12, rtol=1e-4)
    assert_allclose(line.calibrated, per_second * 2e-12, rtol=1e-4)
    # A delay uncertainty of the time of the scan contains it.
    today = survey.with_({"calibration": {"delay_uncertainty": "10 ps"}})
    assert "temperature" not in by_name(today)
    reference = {"azimuth": 0.3, "elevation": 0.0, "amplitude": "1 V"}
    assert "temperature" not in by_name(known.with_({"scan.reference": reference}))


def test_a_standing_reference_has_the_error_of_its_counts(survey: Survey) -> None:
    reference = {"azimuth": "20 deg", "elevation": 0.0, "amplitude": "20 mV"}
    quiet = {"instrument.detector.dark_rate": 0.0, "scan.reference": reference}
    line = by_name(survey.with_(quiet))["drift"]
    detector = survey.instrument.detector
    volt = survey.instrument.modulation_depth * detector.volt_per_photoelectron_rate
    # sqrt(2 F / N) / m with N counts in a dwell less five time constants, which a mean
    # of filtered outputs integrates almost as a whole.
    time = survey.scan.dwell - 5 * survey.instrument.lock_in.time_constant
    counts = 0.02 / volt * time
    phase = math.sqrt(2 * detector.excess_noise_factor / counts)
    phase /= survey.instrument.modulation_depth
    per_radian = speed_of_light / (4 * math.pi * 39e6 * 1.38)
    assert_allclose(line.now, phase * per_radian, rtol=0.2)
    assert line.calibrated == line.now
    more = {**quiet, "scan.reference": {**reference, "readings": 4}}
    four = by_name(survey.with_(more))["drift"]
    assert_allclose(four.now, line.now / 2, rtol=1e-6)


def test_a_stated_phase_error_contains_that_of_the_demodulator(survey: Survey) -> None:
    analog = survey.with_({"instrument.lock_in.demodulator": "analog"})
    line = by_name(analog)["demodulator"]
    # 1 % and 1 degree over a whole turn of the phase, by 360 of them.
    phase, angle = np.radians(np.arange(360)), math.radians(1)
    turn = 0.01 * np.sin(phase) * np.cos(phase)
    rms = math.sqrt(np.mean(turn**2) + np.mean((angle * np.cos(phase) ** 2) ** 2))
    per_radian = speed_of_light / (4 * math.pi * 39e6 * 1.38)
    # Six times the typical error at one frequency.
    assert_allclose(line.now, 6 * rms * per_radian, rtol=1e-3)
    assert_allclose(line.calibrated, rms * per_radian / 10, rtol=1e-2)
    stated = analog.with_({"instrument.phase_uncertainty": "0.2 deg"})
    for other in (survey, stated):
        assert "demodulator" not in by_name(other)


def test_two_channels_have_a_delay_between_them(survey: Survey) -> None:
    line = by_name(survey)["channels"]
    # 10 ps, and 1 mrad at 39 MHz.
    assert_allclose(line.now, speed_of_light * 10e-12 / 2 / 1.38, rtol=1e-4)
    phase = speed_of_light * 1e-3 / (4 * math.pi * 39e6 * 1.38)
    assert_allclose(line.calibrated, phase, rtol=1e-3)
    alone = survey.with_({"instrument.polarizations": ["VV"]})
    assert "channels" not in by_name(alone)


def test_frequencies_average_their_phase_errors(survey: Survey) -> None:
    two = survey.with_({"instrument.modulation_frequencies": ["39 MHz", "78 MHz"]})
    one = by_name(survey)["leakage, walk, harmonics"].now
    # Weights 1/5 and 4/5 of ranges 1 and 1/2 a radian; three times the typical error
    # in place of six times.
    expected = one / 2 * math.hypot(1 / 5, 4 / 5 / 2)
    assert_allclose(by_name(two)["leakage, walk, harmonics"].now, expected, rtol=1e-6)


def test_unknown_errors_come_first_and_then_the_largest(survey: Survey) -> None:
    assert first_calibration([*by_name(survey).values()]).name == "delay"
    known = survey.with_(
        {
            "calibration": {
                "delay_uncertainty": "0.01 ns",
                "receiver_position_uncertainty": "1 mm",
                "direction_uncertainty": "0.05 deg",
                "group_index_uncertainty": 0.03,
            }
        }
    )
    # 0.03 of 1.38 is 33 mm of 1.5 m; no other error is above 24 mm.
    assert first_calibration([*by_name(known).values()]).name == "group index"
    bright = {"azimuth": 0.3, "elevation": 0.0, "amplitude": "1 V"}
    perfect = survey.with_(
        {
            **ALL,
            "instrument.phase_uncertainty": "0 deg",
            "scan.reference": bright,
        }
    )
    lines = by_name(perfect)
    assert first_calibration([*lines.values()]) is None
    for line in lines.values():
        assert line.calibrated == line.now


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ("", "do first: amulor calibrate plate, distance to 1 mm (delay)"),
        (
            '[calibration]\ndelay_uncertainty = "1 ps"\n'
            'receiver_position_uncertainty = "0.1 mm"\n'
            'direction_uncertainty = "0.001 deg"\ngroup_index_uncertainty = 0.00001\n',
            "do first: amulor calibrate leakage, then plate (leakage, walk, harmonics)",
        ),
    ],
)
def test_survey_check_says_what_to_calibrate_first(
    plate_text: str, tmp_path, capsys, more: str, said: str
) -> None:
    text = plate_text.replace('phase_uncertainty = "0 deg"\n', "") + more
    file = tmp_path / "tank.toml"
    file.write_text(text)
    assert main(["survey", "check", str(file)]) == 0
    out = capsys.readouterr().out
    assert "errors by the instrument at 1.5 m (standard uncertainty):" in out
    assert said in out
    assert ("total: more than" in out) == (not more)
