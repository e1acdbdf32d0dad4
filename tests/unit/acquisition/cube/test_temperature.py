"""A temperature run shows the phase per degree, which leaves later scans."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor import imaging, rejection
from amulor.acquisition import Calibration, calibrated, from_plates, from_temperatures
from amulor.errors import CubeError
from amulor.simulation import simulate
from amulor.survey import Survey

FREQUENCIES = np.array([20e6, 50e6])
#: Change of the delay and of the phase per degree.
DELAY, PHASE = 5e-12, 0.5e-3


@pytest.fixture(scope="module")
def clear(plate: Survey) -> Survey:
    return plate.with_(
        {
            "water.absorption": "0.02 1/m",
            "water.scattering": "0.001 1/m",
            "water.signal_fluctuation": 0.0,
            "instrument.modulation_frequencies": ["20 MHz", "50 MHz"],
            "instrument.phase_uncertainty": "0 deg",
            "scan.rows": 8,
            "scan.columns": 8,
            "calibration": {
                "delay_uncertainty": "0.1 ps",
                "group_index_uncertainty": 1e-6,
                "receiver_position_uncertainty": "0.001 mm",
                "direction_uncertainty": "0.0001 deg",
            },
        }
    )


def scan_at(
    survey: Survey, true: float, seed: int, *, recorded: float | None = None
) -> object:
    """Return samples at a true temperature; it is recorded with its error [degC]."""
    return simulate(
        survey.with_(
            {
                "instrument.errors": {
                    "temperature": {
                        "temperature": true,
                        "delay_per_degree": DELAY,
                        "phase_per_degree": PHASE,
                    }
                },
                "scan.instrument_temperature": recorded,
            }
        ),
        rng=seed,
    )


def run(survey: Survey, seed: int) -> Calibration:
    plates = [
        rejection.keep_water(scan_at(survey, value, seed + k, recorded=value))
        for k, value in enumerate((25.0, 10.0, 20.0, 15.0))
    ]
    return from_temperatures(plates)


def test_the_line_has_the_slope_of_the_instrument(clear: Survey) -> None:
    pulls, sizes = [], []
    for seed in range(0, 80, 10):
        calibration = run(clear, seed)
        assert calibration.reference_temperature == 17.5
        for entry, frequency in zip(calibration.temperature, FREQUENCIES, strict=True):
            expected = 2 * math.pi * frequency * DELAY + PHASE
            pulls.append((entry.phase_per_degree - expected) / entry.uncertainty)
            sizes.append(entry.uncertainty / expected)
    assert np.median(sizes) < 0.1
    # 16 pulls of an error that the scatter of four points may enlarge.
    assert np.max(np.abs(pulls)) < 3.5
    assert 0.4 < np.std(pulls) < 1.4


def range_errors(cube: object) -> tuple[np.ndarray, np.ndarray]:
    image = imaging.range_image(rejection.open_water(cube), polarization="VV")
    assert (image["quality_flag"] == 0).mean() > 0.95
    off = (image["slant_range"] - cube["truth_slant_range"]).values
    return off, image["slant_range_uncertainty"].values


def test_a_recorded_temperature_corrects_a_warm_scan(
    clear: Survey, plate: Survey
) -> None:
    turbid = clear.with_(
        {"water": plate.water, "scan.open_water": plate.scan.open_water}
    )
    calibration = run(clear, 1)
    before, after, size = [], [], []
    rng = np.random.default_rng(8)
    for seed in range(8):
        true = float(rng.uniform(10, 25))
        recorded = true + 0.5 * rng.standard_normal()
        cube = scan_at(turbid, true, 300 + seed, recorded=recorded)
        plain = scan_at(turbid, 17.5, 300 + seed, recorded=17.5)
        # The delay at the reference temperature belongs to the phase of the plate.
        zero = np.median(range_errors(plain)[0])
        raw, stated = range_errors(cube)
        before.append(np.mean(np.abs(raw - zero) < 1.96 * stated))
        off, stated = range_errors(calibrated(cube, calibration))
        after.append(np.mean(np.abs(off - zero) < 1.96 * stated))
        size.append(np.median(stated))
    # Eight common errors: 95 % within two standard errors of 8 %.
    assert np.mean(before) < 0.6
    assert np.mean(after) > 0.79
    # 0.5 degC of 5 ps and 0.5 mrad: 0.3 to 0.6 mm, and the noise of a pixel.
    assert max(size) < 1.5e-3


def test_an_unknown_temperature_states_the_whole_run(clear: Survey) -> None:
    calibration = run(clear, 1)
    cube = scan_at(clear, 25.0, 7)
    result = calibrated(cube, calibration)
    assert_allclose(result["in_phase"], cube["in_phase"], rtol=1e-12)
    assert result.attrs["temperature_recorded"] == 0
    stated = result.attrs["temperature_delay_uncertainty_s"]
    # An even distribution over 7.5 degrees on both sides.
    expected = (DELAY + PHASE / (2 * np.pi * FREQUENCIES)) * 7.5 / math.sqrt(3)
    assert_allclose(stated, expected, rtol=0.1)


def test_plates_keep_the_temperature_for_later_scans(clear: Survey) -> None:
    calibration = run(clear, 1)
    plate = rejection.keep_water(
        calibrated(scan_at(clear, 21.0, 3, recorded=21.0), calibration)
    )
    phases = from_plates([plate], distance=1.5)
    assert phases.temperature == calibration.temperature
    assert phases.reference_temperature == 17.5
    assert Calibration.from_text(phases.to_toml()) == phases
    # The zero of the phase is that at 17.5 degrees, not at 21.
    expected = -2.5 * (2 * np.pi * FREQUENCIES * DELAY + PHASE)
    found = [entry.phases[0] for entry in phases.frequencies]
    # Five errors of a mean of 16 pixels, and of the slope times 3.5 degrees.
    for off, entry in zip(found - expected, phases.frequencies, strict=True):
        assert abs(off) < 5 * math.hypot(entry.phase_uncertainties[0], 3.5 * 3e-5)


def test_a_poor_run_is_refused(clear: Survey) -> None:
    plates = [
        rejection.keep_water(scan_at(clear, value, 1, recorded=value))
        for value in (20.0, 20.5, 21.0)
    ]
    with pytest.raises(CubeError, match="2 cubes; at least 3"):
        from_temperatures(plates[:2])
    with pytest.raises(CubeError, match=r"differ by 1 degC; at least 2 degC"):
        from_temperatures(plates)
    silent = rejection.keep_water(scan_at(clear, 25.0, 1))
    with pytest.raises(CubeError, match="cube 3 states no temperature"):
        from_temperatures([*plates[:2], silent])
