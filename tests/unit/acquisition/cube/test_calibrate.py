"""Leakage, phases and group index of a bench come out as they were put in."""

from __future__ import annotations

import math

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import rejection
from amulor.acquisition import Calibration, calibrated, from_plates, from_shutter
from amulor.acquisition.cube import calibrate
from amulor.acquisition.cube.filters import measured_filters
from amulor.errors import CubeError, FormatError
from amulor.simulation import simulate
from amulor.survey import Survey

FREQUENCIES = np.array([20e6, 50e6, 110e6])
#: Phase delay of the bench at each frequency: 1 ns and a cable's ripple [rad].
ZERO = 2 * np.pi * FREQUENCIES * 1e-9 + np.array([0.004, -0.003, 0.002])
LEAK = np.array([[2e-6 + 1e-6j, 1e-6j], [-3e-6j, 2e-6 + 0j], [4e-6 + 0j, -1e-6 + 0j]])


@pytest.fixture(scope="module")
def clear(plate: Survey) -> Survey:
    """Return clear calm water, where a plate at 1.5 m is all there is."""
    return plate.with_(
        {
            "water.absorption": "0.02 1/m",
            "water.scattering": "0.001 1/m",
            "water.signal_fluctuation": 0.0,
            "instrument.modulation_frequencies": ["20 MHz", "50 MHz", "110 MHz"],
            "scan.rows": 6,
            "scan.columns": 6,
            "scan.open_water": None,
        }
    )


def turned(cube: xr.Dataset, factor: np.ndarray, added: np.ndarray) -> xr.Dataset:
    """Return samples times a factor plus a constant, shape (frequency, channel)."""
    axes = (slice(None), slice(None), None, None)
    signal = cube["in_phase"].values + 1j * cube["quadrature"].values
    signal = signal * factor[axes] + added[axes]
    return cube.assign(
        in_phase=cube["in_phase"].copy(data=signal.real),
        quadrature=cube["quadrature"].copy(data=signal.imag),
    )


def plate_at(
    clear: Survey, distance: float, *, power: float = 1.0, index: float | None = None,
    walk: float = 0.0, leak: float = 0.0, seed: int = 1,
) -> xr.Dataset:  # fmt: skip
    """Return the target signal of a plate, recorded by the bench.

    The survey of the cube keeps its group index while the light has another.
    """
    changes: dict[str, object] = {"targets.0.position.2": distance}
    truth = clear.with_(changes)
    if index is not None:
        truth = truth.with_({"water.group_index": index})
    samples = simulate(truth, rng=seed)
    phase = ZERO + walk * math.log10(power)
    turn = np.repeat((power * np.exp(1j * phase))[:, None], 2, axis=1)
    samples = turned(samples, turn, leak * LEAK)
    believed = clear.with_(changes)
    samples = samples.assign_attrs(survey=believed.to_toml())
    stated = float(simulate(believed, rng=1)["geometry"].attrs["group_index"])
    geometry = samples["geometry"].assign_attrs(group_index=stated)
    return rejection.keep_water(samples.assign_coords(geometry=geometry))


def closed(clear: Survey, *leaks: np.ndarray, sigma: float = 1e-8) -> list[xr.Dataset]:
    """Return cubes of a closed shutter with given leakage and noise [V]."""
    cube = simulate(clear, rng=1).assign_attrs(shutter="closed")
    rng = np.random.default_rng(4)
    result = []
    for leak in leaks:
        dark = turned(cube, np.zeros((3, 2)), leak)
        noise = sigma * rng.standard_normal((2, *dark["in_phase"].shape))
        error = np.full(dark["in_phase"].shape, sigma)
        result.append(
            dark.assign(
                in_phase=dark["in_phase"] + noise[0],
                quadrature=dark["quadrature"] + noise[1],
                in_phase_uncertainty=dark["in_phase"].copy(data=error),
                quadrature_uncertainty=dark["in_phase"].copy(data=error),
            ).drop_vars("in_phase_quadrature_covariance", errors="ignore")
        )
    return result


def test_leakage_behind_a_shutter_has_its_value_and_error(clear) -> None:
    calibration = from_shutter(closed(clear, LEAK))
    assert [leak.polarization for leak in calibration.leakage] == ["VV", "VH"] * 3
    found = np.array([complex(*leak.scan) for leak in calibration.leakage])
    # The mean of 36 samples of 10 nV; five standard errors.
    assert_allclose(found.reshape(3, 2), LEAK, atol=5 * 1e-8 / 6)
    errors = [leak.scan_uncertainty for leak in calibration.leakage]
    # From the scatter of 72 values: 12 % each, and never below what is stated.
    assert_allclose(errors, 1e-8 / 6, rtol=0.5)
    assert min(errors) >= 1e-8 / 6 * (1 - 1e-9)
    assert all(leak.change is None for leak in calibration.leakage)


def test_leakage_that_changes_has_an_error_of_its_change(clear) -> None:
    before, after = LEAK, LEAK + 1.2e-6
    calibration = from_shutter(closed(clear, before, after))
    leak = calibration.leakage[0]
    assert_allclose(complex(*leak.scan), LEAK[0, 0] + 0.6e-6, atol=1e-8)
    assert_allclose(leak.change, 1.2e-6, atol=2e-8)
    # An even distribution of this width.
    assert_allclose(leak.scan_uncertainty, 1.2e-6 / math.sqrt(12), rtol=0.02)


def test_a_cube_with_light_is_no_leakage(clear) -> None:
    (dark,) = closed(clear, LEAK)
    with pytest.raises(CubeError, match="--shutter-closed"):
        from_shutter([dark.assign_attrs(shutter="open")])
    with pytest.raises(CubeError, match="differ in frequencies"):
        from_shutter([dark, dark.isel(modulation_frequency=[0, 1])])
    with pytest.raises(CubeError, match="no cube"):
        from_shutter([])
    with pytest.raises(CubeError, match="has a calibration already"):
        from_shutter([calibrated(dark, from_shutter([dark]))])


def test_leakage_is_subtracted_and_states_its_error(clear) -> None:
    perfect = simulate(clear, rng=3)
    leaking = turned(perfect, np.ones((3, 2)), LEAK)
    calibration = from_shutter(closed(clear, LEAK, LEAK + 1.2e-6))
    result = calibrated(leaking, calibration)
    # Half of the change is left, of one sign in the in-phase output.
    assert_allclose(result["in_phase"], perfect["in_phase"] - 0.6e-6, atol=2e-8)
    assert_allclose(result["quadrature"], perfect["quadrature"], atol=2e-8)
    assert_allclose(
        result.attrs["leakage_uncertainty_volt"], 1.2e-6 / math.sqrt(12), rtol=0.02
    )
    assert Calibration.from_text(result.attrs["calibration"]) == calibration
    with pytest.raises(CubeError, match="has a calibration already"):
        calibrated(result, calibration)


def test_an_unmeasured_channel_is_refused(clear) -> None:
    calibration = from_shutter(closed(clear, LEAK))
    some = Calibration(leakage=calibration.leakage[:-1])
    with pytest.raises(FormatError, match="no leakage at 110 MHz in VH"):
        calibrated(simulate(clear, rng=3), some)


def test_one_plate_states_the_zero_and_its_error(clear) -> None:
    calibration = from_plates(
        [plate_at(clear, 1.5)], distance=1.5, distance_uncertainty=1e-3
    )
    phases = [entry.phases[0] for entry in calibration.frequencies]
    errors = [entry.phase_uncertainties[0] for entry in calibration.frequencies]
    # 4.5 standard errors; the noise of one sample is some milliradian.
    assert np.all(np.abs(np.array(phases) - ZERO) < 4.5 * np.array(errors))
    assert max(errors) < 2e-3
    # 1 mm there and back at the index of the survey, and that index.
    index = float(simulate(clear, rng=1)["geometry"].attrs["group_index"])
    assert calibration.delay_uncertainty >= 2 * index * 1e-3 / 299792458
    assert calibration.group_index is None


def test_wrong_distances_average_and_show_in_the_group_index(clear) -> None:
    true = [1.2, 1.6, 2.0, 2.4]
    # The light is slower by 0.01 than the survey says.
    index = float(simulate(clear, rng=1)["geometry"].attrs["group_index"])
    plates = [
        plate_at(clear, distance, index=index + 0.01, seed=seed)
        for seed, distance in enumerate(true)
    ]
    calibration = from_plates(plates, distance=true, distance_uncertainty=1e-3)
    assert_allclose(calibration.group_index, index + 0.01, atol=1e-3)
    # n s / sqrt(sum of squares about the mean): 1.38 x 1 mm / 0.894 m.
    expected = index * 1e-3 / math.sqrt(0.36 + 0.04 + 0.04 + 0.36)
    assert expected <= calibration.group_index_uncertainty < 1.5 * expected
    # The mean of the delays by 0.01 of the index over 1.2 to 2.4 m.
    late = 2 * np.mean(true) * 0.01 / 299792458
    phases = np.array([entry.phases[0] for entry in calibration.frequencies])
    assert_allclose(phases, ZERO + 2 * np.pi * FREQUENCIES * late, atol=3e-3)


def test_distances_show_the_error_by_frequency(clear) -> None:
    true = [1.2, 1.6, 2.0]
    plates = [plate_at(clear, distance, seed=7) for distance in true]
    steady = from_plates(plates, distance=true)
    # A wave that one distance reflects and the others do not: 20 mrad at one frequency.
    wave = np.repeat(np.exp(1j * np.array([0, 0.02, 0]))[:, None], 2, axis=1)
    plates[2] = turned(plates[2], wave, np.zeros((3, 2)))
    shaken = from_plates(plates, distance=true)
    errors = [entry.phase_uncertainties[0] for entry in shaken.frequencies]
    # 20 mrad of one in nine phases, by 4 degrees of freedom and 3 distances:
    # 20 x sqrt(2/3 (1 - 0.165) / 4 / 3) = 4.3 mrad.
    assert_allclose(errors, 4.3e-3, rtol=0.25)
    before = [entry.phase_uncertainties[0] for entry in steady.frequencies]
    assert max(before) < 1.5e-3


@pytest.mark.parametrize("leak", [0.0, 1.0, 300.0])
def test_filters_tell_leakage_from_walk(clear, leak) -> None:
    densities = [0.0, 0.5, 1.0, 1.5]
    plates = [
        plate_at(clear, 1.5, power=10**-density, walk=0.05, leak=leak, seed=seed)
        for seed, density in enumerate(densities)
    ]
    calibration = from_plates(plates, distance=1.5, densities=densities)
    found = np.zeros((3, 2), dtype=complex)
    errors = np.zeros((3, 2))
    for number, entry in enumerate(calibration.leakage):
        found.flat[number] = complex(*entry.scan)
        errors.flat[number] = entry.scan_uncertainty
    assert np.all(np.abs(found - leak * LEAK) < 4.5 * errors)
    for entry, zero in zip(calibration.frequencies, ZERO, strict=True):
        slope = np.polyfit(np.log10(entry.amplitudes), entry.phases, 1)[0]
        error = np.hypot(*np.array(entry.phase_uncertainties)[[0, -1]]) / 1.5
        assert abs(slope - 0.05) < 4.5 * error
        assert abs(entry.phases[-1] - zero) < 4.5 * entry.phase_uncertainties[-1]


def test_plates_of_equal_strength_share_one_entry(clear) -> None:
    plate = plate_at(clear, 1.5)
    once = from_plates([plate], distance=1.5)
    assert from_plates([plate, plate], distance=1.5).frequencies == once.frequencies
    densities = [0.0, 0.5, 0.5, 1.0]
    plates = [
        plate_at(clear, 1.5, power=10**-density, seed=seed)
        for seed, density in enumerate(densities)
    ]
    for entry in from_plates(plates, distance=1.5, densities=densities).frequencies:
        assert_allclose(
            np.log10(np.divide(entry.amplitudes[1:], entry.amplitudes[:-1])), 0.5
        )
        assert len(entry.phases) == len(entry.phase_uncertainties) == 3


def test_leakage_by_filters_is_subtracted_from_further_distances(clear) -> None:
    densities, distances = [0.0, 0.5, 1.0, 0.0, 0.0], [1.2, 1.2, 1.2, 1.6, 2.0]

    def errors(leak: float) -> list[float]:
        """Return the phase errors by frequency of plates with the same noise."""
        plates = [
            plate_at(clear, distance, power=10**-density, leak=leak, seed=7)
            for density, distance in zip(densities, distances, strict=True)
        ]
        table = from_plates(plates, distance=distances, densities=densities)
        return [entry.phase_uncertainties[-1] for entry in table.frequencies]

    # Left in, or subtracted with the wrong sign, the leakage turns the phases of the
    # further distances differently at each frequency.
    assert_allclose(errors(30.0), errors(0.0), rtol=0.05)


def test_filters_have_their_transmissions(clear) -> None:
    stated = [0.0, 0.5, 1.0, 1.5]
    true = [0.0, 0.52, 0.97, 1.52]
    plates = [
        plate_at(clear, 1.5, power=10**-density, walk=0.05, seed=seed)
        for seed, density in enumerate(true)
    ]
    calibration = from_plates(plates, distance=1.5, densities=stated)
    assert [each.density for each in calibration.filters] == stated
    assert calibration.filters[0].transmission == 1.0
    for each, density in zip(calibration.filters[1:], true[1:], strict=True):
        off = each.transmission - 10**-density
        # The leakage is fitted with stated transmissions of 5 %: that of the darkest
        # filter, 0.03, leaves 0.0015 of the brightest signal.
        assert abs(off) < 3 * each.uncertainty
        assert each.uncertainty < 3e-3
    assert Calibration.from_text(calibration.to_toml()) == calibration


def test_signals_of_different_strength_show_the_gain() -> None:
    """Six signals behind five filters, whose gain falls by 4 % at 50 mV."""
    rng = np.random.default_rng(2)
    density = np.array([0.0, 0.5, 1.0, 1.5, 2.0])
    true = np.array([1.0, 0.33, 0.098, 0.033, 0.0105])
    pulls = []
    for _ in range(50):
        light = true[:, None] * np.array([50, 49, 51, 12, 13, 12]) * 1e-3
        error = np.full(light.shape, 5e-6)
        amplitude = light * (1 - 0.04 * light / 0.05)
        amplitude = amplitude + error * rng.standard_normal(light.shape)
        filters, gain = measured_filters(density, amplitude, error)
        assert gain is not None
        # The change at the largest output, 0.051 x 0.96: 0.04 x 0.051 / 0.05, and the
        # square of it between amplitudes of light and of output.
        pulls.append((gain[0] + 0.0408) / gain[1])
        ratios = [each.transmission / value for each, value in zip(
            filters, true, strict=True,
        )]  # fmt: skip
        errors = [each.uncertainty / each.transmission for each in filters]
        assert np.all(np.abs(np.array(ratios) - 1) < 4.5 * np.array(errors) + 2e-3)
        # 5 uV of 0.5 mV in the best of three bright signals behind the last filter.
        assert errors[-1] < 0.01
    # The model is linear in the output; 4 % squared is 0.16 %.
    assert abs(np.mean(pulls)) * gain[1] < 2e-3
    assert 0.6 < np.std(pulls) < 1.4
    # A dark or missing signal counts for nothing.
    for dark in (0.0, np.nan):
        with_dark = np.column_stack([amplitude, np.full(5, dark)])
        result = measured_filters(density, with_dark, np.full(with_dark.shape, 5e-6))
        assert result == (filters, gain)
    # One signal, or signals of one strength, cannot tell gain from transmission.
    assert measured_filters(density, amplitude[:, :1], error[:, :1])[1] is None
    assert measured_filters(density, amplitude[:, :3], error[:, :3])[1] is None


def test_samples_are_corrected_for_the_gain_of_the_filters(clear) -> None:
    cube = simulate(clear, rng=3)
    light = cube.amulor.signal
    size = np.abs(light)
    largest = float(size.max())
    # The logarithm of the gain falls with the output, by 5 % at an output of 0.95.
    output = size.copy()
    for _ in range(30):
        output = size * 0.95 ** (output / largest)
    turned = output / size * light
    bent = cube.assign(in_phase=turned.real, quadrature=turned.imag)
    calibration = Calibration(
        leakage=from_shutter(closed(clear, np.zeros((3, 2)), sigma=1e-12)).leakage,
        gain_change=-0.05,
        gain_change_uncertainty=0.01,
        gain_amplitude=largest,
    )
    without = calibrated(bent, calibration.model_copy(update={"gain_amplitude": None}))
    result = calibrated(bent, calibration)
    off = np.abs(np.abs(result.amulor.signal) / size - 1)
    assert float(off.max()) < 1e-3
    assert float(np.abs(np.abs(without.amulor.signal) / size - 1).max()) > 0.04
    # 1 % of an amplitude at the end of the filters, along the signal.
    more = (
        result["in_phase_uncertainty"] ** 2
        + result["quadrature_uncertainty"] ** 2
        - without["in_phase_uncertainty"] ** 2
        - without["quadrature_uncertainty"] ** 2
    )
    at = int(np.argmax(size.values))
    relative = np.sqrt(more.values.ravel()[at]) / largest
    assert relative == pytest.approx(0.0095, rel=0.05)


def test_numbers_that_do_not_fit_are_refused(clear) -> None:
    plate = plate_at(clear, 1.5)
    with pytest.raises(ValueError, match="2 distances for 1 cubes"):
        from_plates([plate], distance=[1.5, 2.0])
    with pytest.raises(ValueError, match="2 densities for 1 cubes"):
        from_plates([plate], distance=1.5, densities=[0.0, 1.0])
    with pytest.raises(ValueError, match="at least 3 filters"):
        from_plates([plate, plate], distance=1.5, densities=[0.0, 1.0])
    with pytest.raises(ValueError, match="above 0 m"):
        from_plates([plate, plate], distance=[1.5, 0.0])
    with pytest.raises(CubeError, match="no cube"):
        from_plates([], distance=1.5)


def test_the_error_of_the_dark_output_is_in_that_of_the_leakage(clear) -> None:
    (dark,) = closed(clear, LEAK)
    shared = 1e-9 * np.arange(1, 7)
    calibration = from_shutter([dark.assign_attrs(dark_uncertainty=shared)])
    alone = from_shutter([dark])
    for one, other, error in zip(
        calibration.leakage, alone.leakage, shared, strict=True
    ):
        expected = math.hypot(other.scan_uncertainty, error)
        assert_allclose(one.scan_uncertainty, expected)
        assert_allclose(one.open_water_uncertainty, expected)


def test_readings_have_their_mean_and_the_larger_of_two_errors() -> None:
    some = np.array([1 + 1j, 3 + 1j, complex(np.nan, 0), 2 - 2j])
    one = np.array([2 - 1j, *[complex(np.nan, np.nan)] * 3])
    variance = np.array([0.5, 0.5, 9.0, 2.0])
    mean, error = calibrate._mean_of(np.array([some, one]), np.array([variance] * 2))
    assert_allclose(mean, [2, 2 - 1j])
    # Squares of the distances are 2, 2 and 4: 8 / 2 outputs / 2 degrees of freedom,
    # above the mean of the stated 0.5, 0.5 and 2. A single reading has the stated one.
    assert_allclose(error, [math.sqrt(2 / 3), math.sqrt(0.5)])
    assert_allclose(calibrate._mean_of(some, 9 * variance)[1], math.sqrt(9 / 3))
