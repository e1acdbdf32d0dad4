"""A standing reference takes the drift out of scans, and says what is left of it."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from shared_light import scene_light

from amulor import acquisition, imaging, rejection
from amulor.acquisition import (
    Calibration,
    calibrated,
    from_plates,
    from_reference,
    plan,
)
from amulor.acquisition.journal.journal import Journal
from amulor.errors import CubeError, FormatError
from amulor.simulation import simulate
from amulor.simulation.by_rows import SimulatedRows
from amulor.survey import Survey

REFERENCE = {"azimuth": "20 deg", "elevation": "0 deg", "amplitude": "20 mV"}
PERFECT = {
    "instrument.phase_uncertainty": "0 deg",
    "calibration": {
        "delay_uncertainty": "0.1 ps",
        "delay_growth": "10 ps",
        "date": "2026-05-01",
        "group_index_uncertainty": 1e-6,
        "receiver_position_uncertainty": "0.001 mm",
        "direction_uncertainty": "0.0001 deg",
    },
}


@pytest.fixture(scope="module")
def steady(plate: Survey) -> Survey:
    return plate.with_(
        {
            **PERFECT,
            "instrument.modulation_frequencies": ["20 MHz", "80 MHz"],
            "water.signal_fluctuation": 0.0,
            "scan.rows": 16,
            "scan.columns": 16,
            "scan.reference": REFERENCE,
        }
    )


def drifting(survey: Survey, **drift: object) -> Survey:
    return survey.with_({"instrument.errors": {"drift": drift}})


def deviations(cube: xr.Dataset) -> tuple[np.ndarray, float]:
    """Return range errors over their uncertainties, and the mean error [m]."""
    target = rejection.open_water(cube)
    image = imaging.range_image(target, polarization="VV")
    trusted = image["quality_flag"].values == 0
    assert trusted.mean() > 0.95
    off = (image["slant_range"] - cube["truth_slant_range"]).values[trusted]
    return off / image["slant_range_uncertainty"].values[trusted], float(off.mean())


@pytest.mark.parametrize(
    "drift",
    [
        {"delay": "30 ps"},
        {"phase": "1 deg"},
        {"delay": "-100 ps", "settling_time": "1 min"},
    ],
)
def test_a_calibrated_reference_takes_a_drift_out(steady: Survey, drift: dict) -> None:
    # The instrument was calibrated before it drifted.
    calibration = from_reference(simulate(steady, rng=1))
    cube = simulate(drifting(steady, **drift), rng=2)
    without = simulate(drifting(steady.with_({"scan.reference": None}), **drift), rng=2)
    after, mean = deviations(calibrated(cube, calibration))
    assert np.mean(np.abs(after) < 1.96) > 0.92
    assert abs(mean) < 0.1e-3
    # The open-water references alone leave rows that are wrong by half of the drift.
    target = rejection.open_water(without)
    image = imaging.range_image(target, polarization="VV")
    off = image["slant_range"] - without["truth_slant_range"]
    assert np.ptp(off.median("column").values) > 1e-3
    common = float(np.nanmedian(image["slant_range_common_uncertainty"]))
    assert common > 0.7e-3


def test_an_uncalibrated_reference_states_the_whole_drift(steady: Survey) -> None:
    cube = simulate(drifting(steady, delay="30 ps"), rng=2)
    remaining = cube.attrs["instrument_drift_uncertainty_s"]
    assert_allclose(remaining, 30e-12 / np.sqrt(12), rtol=0.05)
    off, _ = deviations(cube)
    # Half of the drift is sqrt(3) of these.
    assert np.all(np.abs(off) < 3)


def test_a_steady_instrument_keeps_its_errors(steady: Survey) -> None:
    off, mean = deviations(simulate(steady, rng=3))
    assert np.mean(np.abs(off) < 1.96) > 0.92
    assert abs(mean) < 0.2e-3


def test_rows_are_those_of_the_whole_scan(steady: Survey) -> None:
    survey = drifting(steady, delay="30 ps")
    whole, rows = simulate(survey, rng=5), SimulatedRows(survey, rng=5)
    part = rows.tile(4, 9)
    assert_allclose(part["in_phase"], whole["in_phase"][:, :, 4:9], rtol=1e-12)
    for name in ("reference_phase_rad", "reference_phase_uncertainty_rad"):
        assert_allclose(part.attrs[name], whole.attrs[name], rtol=0)


def test_a_file_keeps_the_phases_and_refuses_scans_without_reference(
    steady: Survey,
) -> None:
    cube = simulate(steady, rng=1)
    calibration = from_reference(cube)
    assert Calibration.from_text(calibration.to_toml()) == calibration
    plain = simulate(steady.with_({"scan.reference": None}), rng=1)
    with pytest.raises(CubeError, match="no readings of a standing reference"):
        from_reference(plain)
    with pytest.raises(FormatError, match="but the scan has none"):
        calibrated(plain, calibration)
    one = calibration.model_copy(update={"reference": calibration.reference[:1]})
    with pytest.raises(FormatError, match=r"no phase of the .* at 20 MHz in VH"):
        calibrated(cube, one)


def test_plates_keep_the_reference_and_must_share_it(steady: Survey) -> None:
    cube = simulate(steady.with_({"scan.open_water": None}), rng=1)
    reference = from_reference(cube)
    plates = [
        rejection.keep_water(calibrated(simulated, reference))
        for simulated in (cube, simulate(steady, rng=2))
    ]
    calibration = from_plates(plates, distance=1.5)
    assert calibration.reference == reference.reference
    mixed = [plates[0], rejection.keep_water(simulate(steady, rng=3))]
    with pytest.raises(CubeError, match="different phases of the standing reference"):
        from_plates(mixed, distance=1.5)


def test_age_no_longer_counts_with_a_calibrated_reference(steady: Survey) -> None:
    cube = simulate(steady, rng=1).assign_attrs(
        time_coverage_start="2026-06-10T12:00:00Z"
    )
    common = []
    for scan in (cube, calibrated(cube, from_reference(cube))):
        image = imaging.range_image(rejection.open_water(scan), polarization="VV")
        common.append(float(image["slant_range_common_uncertainty"].median()))
    # 40 days of 10 ps: 400 ps, 43 mm.
    assert common[0] > 40e-3
    assert common[1] < 2e-3


@pytest.fixture(scope="module")
def referenced(small: Survey) -> Survey:
    return small.with_(
        {
            "scan.rows": 8,
            "scan.reference": {**REFERENCE, "readings": 2},
            "instrument.detector.dark_rate": "1e6 1/s",
        }
    )


def test_a_scan_reads_the_reference_before_each_row_and_round(
    referenced, settings, folder
) -> None:
    outcome = acquisition.acquire(
        referenced, folder, settings=settings, scene=scene_light
    )
    assert outcome.total == plan.count(referenced, settings.procedure)
    with Journal.read(folder) as journal:
        entries = [
            (record.elapsed, kind, key)
            for kind in (plan.REFERENCE, plan.OPEN_WATER, plan.SCAN)
            for key, record in journal.samples(kind)
        ]
    entries.sort(key=lambda entry: entry[0])
    following = {
        (first[2].row, first[2].column, second[1], second[2].row)
        for first, second in pairwise(entries)
        if first[1] == plan.REFERENCE and second[1] != plan.REFERENCE
    }
    rows = {(row, plan.BEFORE_ROW, plan.SCAN, row) for row in range(8)}
    # Each round of shots begins with row 0 of the open-water grid.
    rounds = {(number, plan.BEFORE_SHOTS, plan.OPEN_WATER, 0) for number in range(2)}
    assert following == rows | rounds
    # Two channels, two readings, eight rows and two rounds.
    assert sum(kind == plan.REFERENCE for _, kind, _ in entries) == 2 * 2 * 10


def test_a_drift_of_the_bench_leaves_the_samples(
    referenced, settings, made, folder, cube_of
) -> None:
    rates = {"a": 0.0, "b": 1e-2}
    cubes = {}
    for name, rate in rates.items():
        own = made(settings, simulation={"phase_drift": rate})
        acquisition.acquire(referenced, folder / name, settings=own, scene=scene_light)
        cubes[name] = cube_of(folder / name)
    calibration = from_reference(cubes["a"])
    phases = {}
    for name, cube in cubes.items():
        signal = calibrated(cube, calibration).amulor.signal.values[0, 0]
        phases[name] = np.angle(signal)
    duration = float(cubes["b"]["time"].max())
    # More than 60 mrad of drift, far above the noise of the samples.
    assert 1e-2 * duration > 60e-3
    raw = np.angle(cubes["b"].amulor.signal.values[0, 0]) - phases["a"]
    left = np.unwrap(phases["b"] - phases["a"], axis=0)
    # One of several milliradian remains of the noise of two scans.
    assert np.abs(left).mean() < 6e-3
    assert np.abs(left.mean()) < 2e-3
    assert np.abs(raw.mean()) > 3 * np.abs(left.mean())


def test_a_closed_shutter_has_no_reference(referenced, settings, folder) -> None:
    acquisition.acquire(
        referenced, folder, settings=settings, scene=scene_light, shutter_closed=True
    )
    with Journal.read(folder) as journal:
        cube = acquisition.build(journal)
    assert "reference_phase_rad" not in cube.attrs
