"""The cube of a journal with given records: values, errors, flags and attributes."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
import xarray as xr
from exact_samples import samples
from given_journals import journal_of, key, record
from numpy.testing import assert_allclose

from amulor import cube as cubes
from amulor.acquisition import Calibration, build, recover
from amulor.acquisition.cube import build as cube_of
from amulor.acquisition.cube.calibration import FrequencyCalibration, Leakage
from amulor.acquisition.cube.samples import Samples
from amulor.acquisition.plan import DARK, OPEN_WATER, SCAN, SHUTTER
from amulor.acquisition.protocols import SIMULATOR
from amulor.acquisition.sampler import SampleFlag
from amulor.acquisition.settings import Procedure
from amulor.errors import CubeError
from amulor.survey import Survey
from amulor.survey.directions import scan_directions

#: As in the tests of the samples: variance for each photoelectron a second.
NOISE = (8e-12) ** 2 * 2 * 1.2 / 0.02
MEAN = 8e-12 * 5e6
VARIANCE = NOISE * 5e6


def entries() -> list[tuple[Any, Any]]:
    """Return records of some places of 5 x 3 pixels and 3 x 2 shots."""
    known = {"mean": MEAN, "begin": 10.0, "duration": 0.5, "launch": 0.25}
    return [
        (key(DARK), record(0.5, mean=MEAN)),
        (key(DARK, repeat=1), record(0.5 + 1j, mean=MEAN)),
        (
            key(SCAN, 1, 2),
            record(3 + 4j, **known, elapsed=9.0, azimuth=0.3, elevation=0.1),
        ),
        (
            key(SCAN, 1, 2, "VH"),
            record(1j, **known, elapsed=8.0, azimuth=0.5, elevation=0.2, segment=2),
        ),
        (
            key(SCAN, 2, 4),
            record(1, mean=MEAN, flags=int(SampleFlag.OVERLOAD), elapsed=7.0),
        ),
        (
            key(SCAN, 2, 3),
            record(1, mean=MEAN, flags=int(SampleFlag.NO_LIGHT), elapsed=6.0),
        ),
        (key(SCAN, 0, 0, repeat=1), record(2, mean=MEAN, modulation_frequency=39.2e6)),
        (key(OPEN_WATER, 0, 1), record(5j, mean=MEAN, azimuth=0.2, elevation=0.4)),
        (key(OPEN_WATER, 0, 1, "VH"), record(6j, azimuth=0.4, elevation=0.6)),
        (
            key(OPEN_WATER, 1, 1, repeat=1),
            record(7, flags=int(SampleFlag.OVERLOAD), commanded_azimuth=0.7),
        ),
        (key(OPEN_WATER, 0, 0), record(8, flags=int(SampleFlag.NO_LIGHT))),
    ]


@pytest.fixture
def cube(small: Survey, folder) -> xr.Dataset:
    with journal_of(folder, small, entries()) as journal:
        number = journal.begin_segment()
        journal.end_segment(number, "finished")
        return build(journal)


def test_signals_are_those_of_the_records_less_the_dark_output(cube) -> None:
    signal = cube.amulor.signal.values
    assert signal.shape == (1, 2, 3, 5)
    dark = 0.5 + 0.5j
    assert signal[0, 0, 1, 2] == 3 + 4j - dark
    assert signal[0, 0, 2, 4] == 1 - dark
    assert signal[0, 0, 0, 0] == 2 - dark
    # Without dark readings of its own a channel is as it is.
    assert signal[0, 1, 1, 2] == 1j
    # What has no light, and what was not measured, is missing.
    assert np.isfinite(signal).sum() == 4
    assert cube["saturated"].dtype == np.int8
    assert np.argwhere(cube["saturated"].values).tolist() == [[0, 0, 2, 4]]
    assert cube["modulation_frequency"].values == pytest.approx(39e6)
    assert_allclose(cube.attrs["dark_in_phase"], [0.5, 0])
    assert_allclose(cube.attrs["dark_quadrature"], [0.5, 0])


def test_errors_are_counting_noise_the_dark_output_and_the_phase_floor(cube) -> None:
    # The mean of two dark readings has half of their variance.
    own, floor = VARIANCE * 1.5, math.radians(0.06)
    signal = cube.amulor.signal.values[0, 0, 1, 2]
    place = {"polarization": 0, "row": 1, "column": 2, "modulation_frequency": 0}
    here = cube.isel(place)
    assert here["in_phase_uncertainty"] ** 2 == pytest.approx(
        own + (floor * signal.imag) ** 2
    )
    assert here["quadrature_uncertainty"] ** 2 == pytest.approx(
        own + (floor * signal.real) ** 2
    )
    assert here["in_phase_quadrature_covariance"] == pytest.approx(
        -(floor**2) * signal.imag * signal.real
    )


def test_coordinates_are_those_read_back_else_those_planned(cube, small) -> None:
    azimuth, elevation, _ = scan_directions(small)
    assert cube["azimuth"][1, 2] == pytest.approx(0.4)
    assert cube["elevation"][1, 2] == pytest.approx(0.15)
    assert cube["azimuth"][0, 4] == azimuth[0, 4]
    assert cube["elevation"][0, 4] == elevation[0, 4]
    # The time of the first channel.
    assert cube["time"][1, 2] == 8
    assert cube["time"][2, 4] == 7
    assert np.isnan(cube["time"][0, 4])
    assert_allclose(cube["reading_time"][0, :, 1, 2], 10.25)
    assert_allclose(cube["reading_duration"][0, :, 1, 2], 0.5)
    assert np.isfinite(cube["reading_time"]).sum() == 2


def test_open_water_has_a_shot_for_each_place_and_repeat(cube) -> None:
    shots = cube.amulor.open_water
    signal = shots.amulor.signal.values
    assert signal.shape == (1, 2, 3)
    assert signal[0, 0, 0] == 5j - (0.5 + 0.5j)
    assert signal[0, 1, 0] == 6j
    # An overload, or a shot without light, does not measure the water.
    assert np.isfinite(signal).sum() == 2
    assert_allclose(shots["azimuth"], [0.3, 0.11, 0.11])
    assert_allclose(shots["elevation"], [0.5, -0.12, -0.12])
    assert_allclose(shots["user_commanded_azimuth"], [0.1, 0.7, 0.1])
    assert shots["user_commanded_azimuth"].dims == ("shot",)
    square = shots["quadrature_uncertainty"].values[0, 0, 0] ** 2
    floor = math.radians(0.06)
    assert square == pytest.approx(VARIANCE * 1.5 + (floor * 0.5) ** 2)


def test_records_are_variables_of_the_user(cube) -> None:
    flags = cube["user_sample_flag"]
    assert flags.dtype == np.int16
    bits = [1, 2, 4, 8, 16, 64, 128, 256, 32]
    assert flags.attrs == {
        "long_name": "problems of a sample, 0 if none",
        "units": "1",
        "flag_masks": pytest.approx(bits),
        "flag_values": pytest.approx(bits),
        "flag_meanings": "overload repeated rescaled off_position off_frequency "
        "no_light unsettled no_pose uncalibrated",
    }
    assert flags.attrs["flag_masks"].dtype == np.int16
    assert flags.values[0, 0, 2].tolist() == [0, 0, 0, 64, 1]
    takes = cube["user_takes"]
    assert takes.attrs == {
        "long_name": "how often a sample was taken; the last take stands", "units": "1"
    }  # fmt: skip
    assert takes.values.sum() == 5
    assert takes.values[0, 1, 1, 2] == 1
    assert cube["user_segment"].values[0, :, 1, 2].tolist() == [1, 2]
    assert cube["user_segment"].values[0, 0, 0, 4] == 0
    angle = cube["user_launch_angle"]
    assert angle.attrs == {
        "long_name": "angle of the mount in the launched light", "units": "rad"
    }  # fmt: skip
    assert angle.values[0, 0, 1, 2] == 0.25
    assert np.isfinite(angle).sum() == 2
    frequency = cube["user_modulation_frequency"].values
    assert frequency[0, 0, 0, 0] == 39.2e6
    assert cube["user_commanded_elevation"].dims == ("row", "column")
    assert cube["user_commanded_elevation"].attrs == {
        "long_name": "commanded direction, upwards", "units": "rad"
    }  # fmt: skip
    # What no sample has is no variable.
    names = {str(name) for name in cube.data_vars if str(name).startswith("user_")}
    assert names == {
        f"user_{name}"
        for name in (
            "sample_flag", "takes", "commanded_azimuth", "commanded_elevation",
            "mean_output", "full_scale", "modulation_frequency", "segment",
            "launch_angle",
        )
    }  # fmt: skip


def test_attributes_tell_where_a_cube_is_from(small, folder) -> None:
    identities = {"lock_in": "A,B,0,1.2", "laser": "C"}
    place = folder / "scan"
    with journal_of(
        place, small, entries(), devices="[procedure]\n", identities=identities
    ) as journal:
        assert "time_coverage_start" not in build(journal).attrs
        first = journal.begin_segment()
        open_segment = build(journal).attrs
        journal.end_segment(first, "paused")
        journal.end_segment(journal.begin_segment(), "finished")
        attributes = build(journal).attrs
        parts = journal.segments()
        digest = journal.meta()["survey_digest"]
    assert open_segment["time_coverage_end"] == parts[0]["started"]
    assert attributes["title"] == small.name
    assert attributes["source"] == "acquisition by amulor with A,B,0,1.2"
    assert attributes["simulated"] == 0
    assert attributes["survey"] == small.to_toml()
    assert attributes["devices"] == "[procedure]\n"
    assert json.loads(attributes["identities"]) == identities
    assert json.loads(attributes["segments"]) == parts
    assert attributes["time_coverage_start"] == parts[0]["started"]
    assert attributes["time_coverage_end"] == parts[1]["ended"]
    assert attributes["input_digests"] == f"survey {digest} instrument sha256:2222"
    assert attributes["modulation_depth"] == 0.8
    assert "shutter" not in attributes
    simulator = {"scanner": f"amulor,scanner,0,{SIMULATOR}"}
    with journal_of(folder / "b", small, entries(), identities=simulator) as journal:
        cube = build(journal)
    assert cube.attrs["simulated"] == 1
    assert cube.attrs["source"] == "acquisition by amulor with unknown"


def test_a_scan_without_samples_is_no_cube(small, folder) -> None:
    for name, some in (("a", []), ("b", entries()[:2])):
        with journal_of(folder / name, small, some) as journal:
            with pytest.raises(CubeError) as caught:
                build(journal)
            assert str(caught.value) == (
                f"{folder / name} holds no sample of the scan yet; go on with it by "
                "amulor acquire --resume"
            )


def closed_entries(*, mean: float = MEAN) -> list[tuple[Any, Any]]:
    values = (1.0, 3.0, 5.0, 3.0)
    found = [
        (key(SCAN, 0, column, pair), record(value * factor, mean=mean, full_scale=2.0))
        for pair, factor in (("VV", 1e-3), ("VH", 1j))
        for column, value in enumerate(values)
    ]
    return [*found, *((key(DARK, repeat=k), record(0, mean=mean)) for k in (0, 1))]


def test_behind_a_closed_shutter_the_scatter_is_the_noise(small, folder) -> None:
    procedure = "[procedure]\nreferences = 3\ndark_readings = 4"
    with journal_of(
        folder, small, closed_entries(), devices=procedure, shutter="closed"
    ) as journal:
        cube = build(journal)
    assert cube.attrs["shutter"] == "closed"
    # Squares of -2, 0, 2 and 0 are 2 on average: 1 for each of two outputs.
    scatter = np.array([1e-6, 1.0])
    # Twelve dark readings are planned; two of the first channel were taken.
    expected = np.sqrt(np.maximum(scatter / 12, [VARIANCE / 2, 0]))
    assert_allclose(cube.attrs["dark_uncertainty"], expected)
    floor = math.radians(0.06)
    signal = cube.amulor.signal.values[0, :, 0, 2]
    square = scatter + (floor * signal.real) ** 2
    assert_allclose(cube["quadrature_uncertainty"].values[0, :, 0, 2] ** 2, square)
    assert "leakage_uncertainty_volt" not in cube.attrs


def test_noise_behind_a_shutter_is_at_least_the_resolution(small) -> None:
    parts = Samples(small, 1, 3)
    parts["signal"][:] = 1.0
    parts["full_scale"][:] = [2.0, 0.5, np.nan]
    dark = np.zeros((1, 2), dtype=complex), np.full((1, 2), 1e-16)
    survey = small.with_({"instrument.lock_in.phase_floor": "0 rad"})
    for closed, expected in ((True, [2e-6, 0.5e-6, 1e-8]), (False, [1e-8] * 3)):
        found = cube_of._outputs(
            parts, dark, survey, Procedure(), shutter_closed=closed
        )
        assert_allclose(found["in_phase_uncertainty"][0, 0, 0], expected)
        assert_allclose(found["quadrature_uncertainty"][0, 1, 0], expected)


def shutter_readings() -> list[tuple[Any, Any]]:
    return [(key(SHUTTER, pair=pair), record(0.25)) for pair in ("VV", "VH")]


def test_readings_of_the_shutter_replace_the_leakage_of_a_file(small, folder) -> None:
    leak = Leakage(
        modulation_frequency=39e6, polarization="VV", scan=(9.0, 9.0),
        scan_uncertainty=1.0, open_water=(9.0, 9.0), open_water_uncertainty=1.0,
    )  # fmt: skip
    table = FrequencyCalibration(
        modulation_frequency=39e6, amplitudes=(1.0,), phases=(0.5,)
    )
    with journal_of(folder, small, [*entries(), *shutter_readings()]) as journal:
        alone = build(journal)
        both = build(
            journal, calibration=Calibration(frequencies=(table,), leakage=(leak,))
        )
    place = (0, 1, 1, 2)
    assert alone.amulor.signal.values[place] == pytest.approx(1j - 0.25)
    turned = (1j - 0.25) * np.exp(-0.5j)
    assert both.amulor.signal.values[place] == pytest.approx(turned)
    with journal_of(folder / "b", small, entries()) as journal:
        plain = build(journal)
        phased = build(journal, calibration=Calibration(frequencies=(table,)))
    assert "calibration" not in plain.attrs
    assert phased.amulor.signal.values[place] == pytest.approx(1j * np.exp(-0.5j))


def test_a_target_differs_from_open_water_by_five_standard_errors() -> None:
    scan = np.full((2, 2, 1, 3), 1 + 1j)
    cube = samples(scan, error=0.003)
    assert not cube_of.shows_no_target(cube)
    shape = (2, 2, 2)
    water = {"in_phase": np.full(shape, 1.0), "quadrature": np.full(shape, 1.0)}
    water["in_phase"][..., 1] = np.nan
    errors = {f"{name}_uncertainty": np.full(shape, 1e-3) for name in water}
    shots = cubes.open_water({**water, **errors})
    # The error of both outputs together.
    limit = 5 * math.hypot(0.003, 0.003)
    for off, shown in ((0.99 * limit, True), (1.01 * limit, False)):
        changed = scan.copy()
        changed[1, 0, 0, 2] += 1j * off
        changed[0, 0, 0, 0] = np.nan
        whole = cubes.attach(samples(changed, error=0.003), shots, "open_water")
        assert cube_of.shows_no_target(whole) is shown
    empty = cubes.attach(samples(scan * np.nan), shots, "open_water")
    assert cube_of.shows_no_target(empty)


def test_means_leave_out_what_is_missing() -> None:
    values = np.array([[[[1.0, np.nan, np.nan]], [[4.0, 6.0, np.nan]]]])
    found = cube_of._mean(values, otherwise=np.array([[7.0, 8.0, 9.0]]))
    assert_allclose(found, [[2.5, 6, 9]])
    assert_allclose(cube_of._first(values), [[1, 6, np.nan]])
    late = np.array([[[[4.0]], [[1.0]]]])
    assert cube_of._first(late).item() == 1


def test_a_cube_is_compared_with_missing_values_and_texts() -> None:
    same = cube_of._same
    assert same(np.array([1.0, np.nan]), np.array([1.0, np.nan]))
    assert not same(np.array([1.0, 2.0]), np.array([1.0, np.nan]))
    assert same(np.array(["VV"], dtype=object), np.array(["VV"], dtype=object))
    assert not same(np.array(["VV"], dtype=object), np.array(["VH"], dtype=object))
    assert same(np.array([complex(1, np.nan)]), np.array([complex(1, np.nan)]))


def test_a_recovered_cube_lies_in_the_folder_or_where_it_is_wanted(
    small, folder
) -> None:
    place = folder / "scan"
    with journal_of(place, small, entries()):
        pass
    told: list[str] = []
    assert recover(place, told=told.append) == place / "cube.nc"
    path = recover(place, output=folder / "other.nc", told=told.append)
    assert path == folder / "other.nc"
    assert path.is_file()
    assert told == []
    assert cube_of.trajectory_path(path) == folder / "other.trajectory.csv"
