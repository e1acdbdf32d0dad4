"""Calibrations from plates with given signals: each number by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from exact_samples import GEOMETRY, TURN, plate_at, samples
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.acquisition import (
    Calibration,
    from_plates,
)
from amulor.acquisition.cube import calibrate
from amulor.acquisition.cube.calibration import FrequencyCalibration, Leakage
from amulor.errors import CubeError
from amulor.survey import Survey

FREQUENCIES = np.array([20e6, 50e6])


def test_the_middle_is_half_of_rows_and_columns() -> None:
    for rows, columns, middle in ((8, 12, (2, 6, 3, 9)), (5, 6, (1, 4, 1, 5))):
        cube = samples(np.zeros((2, 2, rows, columns)))
        number = np.arange(rows * columns).reshape(rows, columns)
        cube = cube.assign_coords(azimuth=cube["azimuth"].copy(data=number))
        part = calibrate._middle(cube)["azimuth"].values
        top, bottom, left, right = middle
        assert part.tolist() == number[top:bottom, left:right].tolist()


def test_the_way_to_a_plate_is_through_the_window_and_back() -> None:
    # Straight ahead, the receiver 0.3 m beside the beam.
    beside = {**GEOMETRY, "receiver_position": np.array([0.3, 0.0, 0.0])}
    cube = samples(0.0, geometry=beside)
    way = calibrate._optical_path(cube, 0.4)
    assert way.shape == (1, 1)
    assert way.item() == pytest.approx(1.5 * (0.4 + 0.5))
    # An oblique beam is longer, from an emitter that stands 0.1 m ahead.
    ahead = {**GEOMETRY, "emitter_position": np.array([0.0, 0.0, 0.1])}
    cube = samples(0.0, geometry=ahead)
    cube = cube.assign_coords(azimuth=cube["azimuth"].copy(data=[[math.atan2(3, 4)]]))
    x = 0.4 * 3 / 4
    way = calibrate._optical_path(cube, 0.5).item()
    assert way == pytest.approx(1.5 * (0.5 + math.hypot(0.5, x)))
    # A window of 2 cm of glass, at 10 cm in air.
    window = {
        "window_distance": 0.1,
        "window_thickness": 0.02,
        "window_refractive_index": 1.5,
        "window_group_index": 1.6,
    }
    cube = samples(0.0, geometry={**GEOMETRY, **window})
    way = calibrate._optical_path(cube, 0.5).item()
    assert way == pytest.approx(2 * (0.1 + 1.6 * 0.02 + 1.5 * 0.38))


def test_a_plate_has_the_mean_of_its_usable_pixels(monkeypatch) -> None:
    values = np.array([1 + 0.1j, 1 - 0.1j, 5j, 1 + 0j, complex(np.nan, 0)])
    signal = np.zeros((2, 2, 1, 5), dtype=complex)
    signal[:, :, 0] = values
    signal[1, 1] = np.nan
    turned = signal * np.exp(1j * TURN)[:, None, None, None]
    cube = samples(turned, level="target_signal", error=0.01)
    # Bit 4 is one that makes a pixel unusable.
    flag = cube["quality_flag"].copy()
    flag[:, :, 0, 2] = 4
    cube = cube.assign(quality_flag=flag)
    monkeypatch.setattr(calibrate, "_middle", lambda part: part)
    mean, error, factor = calibrate._plate_sums(cube, 1.0)
    assert_allclose(mean[0], 1)
    assert_allclose(mean[1, 0], 1)
    assert np.isnan(mean[1, 1])
    assert np.isnan(error[1, 1])
    # The scatter across of 0.1, -0.1 and 0 is above the stated 0.01.
    assert_allclose(error[0], math.sqrt(0.01 / 3))
    assert_allclose(factor[:, 0], np.exp(-1j * TURN))


def test_stated_errors_of_a_plate_are_own_and_common_ones() -> None:
    shape = (2, 2, 1, 4)
    cube = samples(
        np.full(shape, 2.0), level="target_signal", error=0.05, geometry=None
    )
    turn = np.exp(1j * TURN)[:, None, None, None]
    signal = 2 * turn * np.ones(shape)
    in_phase, quadrature = 0.03, 0.05
    across = np.sqrt(
        (signal.imag / 2 * in_phase) ** 2 + (signal.real / 2 * quadrature) ** 2
    )[:, :, 0, 0]
    cube = cube.assign(
        in_phase=cube["in_phase"].copy(data=signal.real),
        quadrature=cube["quadrature"].copy(data=signal.imag),
        in_phase_uncertainty=cube["in_phase"].copy(data=np.full(shape, in_phase)),
        quadrature_uncertainty=cube["in_phase"].copy(data=np.full(shape, quadrature)),
    )
    # The middle half of four columns.
    mean, error, _ = calibrate._plate_sums(cube, 1.0)
    assert_allclose(mean, 2)
    assert_allclose(error, across / math.sqrt(2))
    # A part of them is common to all pixels.
    like = cube["in_phase"]
    common = cube.assign(
        common_in_phase_uncertainty=like.copy(data=np.full(shape, 0.6 * in_phase)),
        common_quadrature_uncertainty=like.copy(data=np.full(shape, 0.6 * quadrature)),
        common_covariance=like.copy(data=np.zeros(shape)).assign_attrs(units="V2"),
    )
    _, error, _ = calibrate._plate_sums(common, 1.0)
    assert_allclose(error, across * math.sqrt(0.64 / 2 + 0.36))


def test_the_covariance_of_the_outputs_counts() -> None:
    cube = plate_at(1.0)
    like = cube["in_phase"]
    signal = cube.amulor.signal.values
    errors = {
        "in_phase_uncertainty": like.copy(data=np.full(like.shape, 0.03)),
        "quadrature_uncertainty": like.copy(data=np.full(like.shape, 0.05)),
        "in_phase_quadrature_covariance": like.copy(data=np.full(like.shape, 6e-4)),
    }
    cube = cube.assign(errors)
    found = calibrate._across(signal, signal, cube, "")
    x, y = signal.real, signal.imag
    expected = (9e-4 * y**2 + 25e-4 * x**2 - 2 * 6e-4 * x * y) / np.abs(signal) ** 2
    assert_allclose(found, expected)
    # A missing pixel has none.
    part = signal.copy()
    part[0, 0] = complex(np.nan, 1)
    part[1, 1] = 0
    found = calibrate._across(part, part, cube, "")
    assert found[0, 0].item() == found[1, 1].item() == 0
    common = {
        f"common_{name}": 2 * values
        for name, values in errors.items()
        if name.endswith("uncertainty")
    }
    common["common_covariance"] = 4 * errors["in_phase_quadrature_covariance"]
    cube = cube.assign(common)
    assert_allclose(calibrate._across(signal, signal, cube, "common_"), 4 * expected)


def test_residual_water_is_no_part_of_the_plate() -> None:
    cube = plate_at(1.0)
    like = cube["in_phase"]
    residual = np.array([0.1, np.nan])[:, None, None, None] * np.ones(like.shape)
    water = cube.assign(
        residual_in_phase=like.copy(data=residual),
        residual_quadrature=like.copy(data=2 * residual),
    )
    signal = cube.amulor.signal.values
    expected = signal - np.array([0.1 + 0.2j, 0])[:, None, None, None]
    assert_allclose(calibrate._plate_signal(water), expected)
    assert_allclose(calibrate._plate_signal(cube), signal)


def test_one_plate_has_the_phase_beyond_its_way() -> None:
    cube = plate_at(
        0.7, np.array([0.4, -1.1]), time_coverage_start="2026-05-01T23:59:59Z"
    )
    result = from_plates([cube], distance=0.7)
    assert str(result.date) == "2026-05-01"
    assert [entry.modulation_frequency for entry in result.frequencies] == [20e6, 50e6]
    assert_allclose([entry.phases for entry in result.frequencies], [[0.4], [-1.1]])
    # The strongest channel is the first one, with an error of 1 mV each output.
    for entry in result.frequencies:
        assert entry.amplitudes == pytest.approx((1.0,))
        assert entry.phase_uncertainties == pytest.approx((1e-3,))
    assert result.group_index is result.delay_uncertainty is None
    assert result.leakage == result.filters == ()
    # In the second channel if that is stronger.
    strong = plate_at(0.7, np.array([0.4, -1.1]), size=(0.5, -2.0))
    other = from_plates([strong], distance=0.7)
    assert_allclose(other.frequencies[0].amplitudes, 2)
    assert_allclose(other.frequencies[0].phases, 0.4 - math.pi)


def test_amplitudes_are_in_order_and_phases_without_a_jump() -> None:
    sizes, phases = (1.0, 0.1, 0.3), (3.1, -3.1, 3.3)
    plates = [
        plate_at(0.7, phase, size=(size, 0.01))
        for size, phase in zip(sizes, phases, strict=True)
    ]
    (first, _) = from_plates(plates, distance=0.7).frequencies
    assert_allclose(first.amplitudes, [0.1, 0.3, 1.0])
    # -3.1, 3.3 and 3.1 are a turn less, or none: they differ by 0.117 and -0.2.
    assert_allclose(np.diff(first.phases), [6.4 - 2 * math.pi, -0.2])
    assert_allclose(first.phase_uncertainties, [1e-2, 1e-3 / 0.3, 1e-3])


def test_further_distances_add_their_mean_and_show_the_group_index() -> None:
    # The light is slower than the survey says: by 0.01 of the index.
    far = [0.5, 0.7, 1.2]
    slow = 2 * np.pi * FREQUENCIES * 2 * 0.01 / speed_of_light
    plates = [plate_at(length, 0.2 + slow * length) for length in far]
    result = from_plates(plates, distance=far, distance_uncertainty=2e-3)
    assert result.group_index == pytest.approx(1.51)
    phases = [entry.phases[0] for entry in result.frequencies]
    assert_allclose(phases, 0.2 + slow * np.mean(far))
    # The change is proportional to the frequency: no error by frequency.
    for entry in result.frequencies:
        assert entry.phase_uncertainties == pytest.approx((1e-3,), rel=1e-6)
    spread = math.sqrt(sum((length - 0.8) ** 2 for length in far))
    time = 2 * spread / speed_of_light
    of_delay = math.hypot(2 * 1.5 * 2e-3 / speed_of_light, 1e-3 / (2 * np.pi * 50e6))
    assert result.group_index_uncertainty == pytest.approx(of_delay / time)
    # Without a survey the group index has no error: that of the distances is left.
    delay = 2 * 1.5 * 2e-3 / math.sqrt(3) / speed_of_light
    assert result.delay_uncertainty == pytest.approx(delay)
    unknown = from_plates(plates, distance=far)
    assert unknown.group_index == pytest.approx(1.51)
    assert unknown.group_index_uncertainty is unknown.delay_uncertainty is None


def test_phases_that_no_delay_explains_are_an_error_by_frequency() -> None:
    off = {0.5: (0.0, 0.0), 0.9: (0.03, 0.0), 1.3: (0.0, 0.0)}
    plates = [plate_at(length, np.array(phases)) for length, phases in off.items()]
    result = from_plates(plates, distance=[*off])
    omega = 2 * np.pi * FREQUENCIES
    rest = np.array([[0, 0.03, 0], [0, 0, 0.0]])
    delay = omega @ rest / (omega @ omega)
    left = rest - np.outer(omega, delay)
    left -= left.mean(axis=1, keepdims=True)
    # Two frequencies and three distances, less one each: two degrees of freedom.
    error = math.sqrt((left**2).sum() / 2 / 3)
    for entry, phase in zip(result.frequencies, (0.01, 0.0), strict=True):
        assert entry.phases == pytest.approx((phase,), abs=1e-9)
        assert entry.phase_uncertainties[0] == pytest.approx(math.hypot(1e-3, error))
    # One frequency alone cannot show it.
    single = [plate.isel(modulation_frequency=[0]) for plate in plates]
    (entry,) = from_plates(single, distance=[*off]).frequencies
    assert entry.phase_uncertainties == pytest.approx((1e-3,))


def test_a_survey_states_the_error_of_its_group_index(small: Survey) -> None:
    survey = small.with_({"calibration": {"group_index_uncertainty": 0.004}})
    cube = plate_at(0.8, survey=survey.to_toml())
    delay = from_plates([cube], distance=0.8, distance_uncertainty=1e-3)
    expected = 2 * math.hypot(1.5 * 1e-3, 0.8 * 0.004) / speed_of_light
    assert delay.delay_uncertainty == pytest.approx(expected)
    two = [
        plate_at(length, size=(size, 0.1), survey=survey.to_toml())
        for length, size in ((0.8, 1.0), (1.0, 1.0), (0.8, 0.5))
    ]
    several = from_plates(two, distance=[0.8, 1.0, 0.8], distance_uncertainty=1e-3)
    expected = 2 * math.hypot(1.5 * 1e-3 / math.sqrt(2), 0.9 * 0.004) / speed_of_light
    assert several.delay_uncertainty == pytest.approx(expected)


def test_the_calibration_before_goes_on_with_the_phases() -> None:
    before = Calibration(
        leakage=[
            Leakage(
                modulation_frequency=20e6,
                polarization="VV",
                scan=(0.0, 0.0),
                scan_uncertainty=0.0,
                open_water=(0.0, 0.0),
                open_water_uncertainty=0.0,
            )
        ]
    )
    cube = plate_at(0.7, calibration=before.to_toml())
    assert from_plates([cube], distance=0.7).leakage == before.leakage
    calibrated = before.model_copy(
        update={
            "frequencies": (
                FrequencyCalibration(
                    modulation_frequency=20e6, amplitudes=(1.0,), phases=(0.0,)
                ),
            )
        }
    )
    with pytest.raises(CubeError) as caught:
        from_plates([plate_at(0.7, calibration=calibrated.to_toml())], distance=0.7)
    assert str(caught.value) == (
        "the cube of the plate has a calibration already; make it again from its "
        "journal without one (amulor recover, without --calibration)"
    )
