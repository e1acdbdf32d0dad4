"""Joint estimation: what it must refuse, what must not change it, what it must find."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.optics import small_angle_diffusion
from amulor.rejection.joint import pixels as joint_pixels
from amulor.rejection.joint import search as joint_search
from amulor.rejection.joint._kernels import common as common_kernels
from amulor.rejection.joint._kernels import model as kernels
from amulor.rejection.joint._kernels import normal as normal_kernels
from amulor.rejection.joint.estimate import joint
from amulor.rejection.joint.frame import Table, frame_of
from amulor.rejection.joint.pixels import Pixels
from amulor.rejection.joint.shape import Shape
from amulor.rejection.reference.fit import Covariance
from amulor.simulation import simulate
from amulor.survey import Survey

FREQUENCIES = np.array([12e6, 31e6, 57e6, 83e6, 104e6, 139e6])
INTERVAL = (0.8, 4.0)


def sweep(plate_text: str, **replaced: str) -> Survey:
    """Return the plate survey with a sweep of frequencies and one channel."""
    listed = ", ".join(f'"{f / 1e6:g} MHz"' for f in FREQUENCIES)
    text = plate_text.replace('["39 MHz"]', f"[{listed}]")
    text = text.replace('["VV", "VH"]', '["VV"]')
    for old, new in replaced.items():
        text = text.replace(old, new)
    return Survey.from_text(text)


@pytest.fixture(scope="module")
def samples(plate_text: str) -> xr.Dataset:
    return simulate(sweep(plate_text), rng=4)


@pytest.fixture(scope="module")
def found(samples: xr.Dataset) -> xr.Dataset:
    return joint(samples, interval=INTERVAL)


def test_the_result_is_a_target_signal_cube(found: xr.Dataset) -> None:
    cubes.check(found, "target_signal")
    assert found["user_joint_slant_range"].dims == ("row", "column")
    assert found.attrs["joint_fluctuation"] == pytest.approx(0.05, rel=0.15)


def test_the_slant_range_is_that_of_the_scene(found: xr.Dataset) -> None:
    truth = found.amulor.truth["slant_range"].values
    error = found["user_joint_slant_range"].values - truth
    z = error / found["user_joint_uncertainty"].values
    assert (found["quality_flag"].values == 0).mean() > 0.95
    # 72 pixels: four standard errors of their mean square.
    assert abs(np.mean(z**2) - 1) < 4 * np.sqrt(2 / z.size)


def test_what_is_taken_out_is_the_water_up_to_the_target(found: xr.Dataset) -> None:
    truth = found.amulor.truth
    water = truth["water_in_phase"].values + 1j * truth["water_quadrature"].values
    # The truth holds the mean water signal, which the shots settle to 1 %.
    size = np.abs(water).max(axis=(1, 2, 3), keepdims=True)
    assert_allclose(found.amulor.water_signal.values / size, water / size, atol=0.02)


def test_it_does_without_open_water(samples: xr.Dataset) -> None:
    bare = samples.drop_vars(
        [name for name in samples.data_vars if str(name).startswith("open_water_")]
    )
    found = joint(bare, interval=INTERVAL)
    truth = found.amulor.truth["slant_range"].values
    error = found["user_joint_slant_range"].values - truth
    z = error / found["user_joint_uncertainty"].values
    assert np.sqrt(np.mean(z**2)) < 1.5


def test_truth_and_the_stated_water_are_not_read(
    samples: xr.Dataset, found: xr.Dataset
) -> None:
    other = samples.drop_vars(
        [name for name in samples.data_vars if str(name).startswith("truth_")]
    )
    text = other.attrs["survey"]
    for old, new in (("0.255", "0.9"), ("0.595", "0.1"), ("0.001", "0.5")):
        assert old in text
        text = text.replace(old, new)
    again = joint(other.assign_attrs(survey=text), interval=INTERVAL)
    np.testing.assert_array_equal(
        again["user_joint_slant_range"], found["user_joint_slant_range"]
    )


def test_scale_of_the_signal_changes_nothing_else(
    samples: xr.Dataset, found: xr.Dataset
) -> None:
    factor = 8.0
    scaled = samples.copy(deep=True)
    for name in scaled.data_vars:
        units = scaled[name].attrs.get("units")
        if not str(name).startswith("truth_") and units in ("V", "V2"):
            scaled[name] = scaled[name] * factor ** (2 if units == "V2" else 1)
            scaled[name].attrs["units"] = units
            scaled[name].attrs["long_name"] = samples[name].attrs["long_name"]
    again = joint(scaled, interval=INTERVAL)
    for name in ("slant_range", "uncertainty"):
        assert_allclose(
            again[f"user_joint_{name}"], found[f"user_joint_{name}"], rtol=1e-6
        )
    assert_allclose(again["in_phase"], factor * found["in_phase"], rtol=1e-4, atol=1e-9)


def test_open_water_pixels_are_told_from_targets(plate_text: str) -> None:
    survey = sweep(plate_text, **{'width = "30 cm"': 'width = "5 cm"'})
    cube = simulate(survey, rng=6)
    hit = cube.amulor.truth["target"].values >= 0
    assert 0.1 < hit.mean() < 0.9
    flag = joint(cube, interval=INTERVAL)["quality_flag"].values[0, 0]
    seen = (flag & QualityFlag.NO_TARGET) == 0
    np.testing.assert_array_equal(seen, hit)


def test_lost_and_saturated_samples_are_flagged_and_left_out(
    samples: xr.Dataset, found: xr.Dataset
) -> None:
    broken = samples.copy(deep=True)
    broken["in_phase"][2, 0, 1, 1] = np.nan
    broken["saturated"][3, 0, 2, 2] = 1
    broken["in_phase"][3, 0, 2, 2] = 1e3
    again = joint(broken, interval=INTERVAL)
    flag = again["quality_flag"].values
    assert flag[2, 0, 1, 1] == QualityFlag.MISSING
    assert flag[3, 0, 2, 2] & QualityFlag.SATURATED
    moved = abs(again["user_joint_slant_range"] - found["user_joint_slant_range"])
    assert float((moved / found["user_joint_uncertainty"]).max()) < 3


def test_two_surfaces_in_one_pixel_are_flagged(samples: xr.Dataset) -> None:
    mixed = samples.copy(deep=True)
    frequency = samples["modulation_frequency"].values
    echo = 0.5 * np.abs(samples.amulor.signal.values[0, 0, 3, 5])
    delay = 4 * np.pi * frequency * 1.38 * 2.4 / speed_of_light
    mixed["in_phase"][:, 0, 3, 5] += echo * np.cos(delay)
    mixed["quadrature"][:, 0, 3, 5] += echo * np.sin(delay)
    flag = joint(mixed, interval=INTERVAL)["quality_flag"].values[0, 0]
    assert flag[3, 5] & QualityFlag.WATER_RESIDUAL
    assert (flag != 0).sum() <= 3


def test_frequencies_close_together_leave_the_interval_open(plate_text: str) -> None:
    listed = ", ".join(f'"{f / 1e6:g} MHz"' for f in FREQUENCIES)
    text = plate_text.replace('["39 MHz"]', '["100 MHz", "100.2 MHz"]')
    text = text.replace('["VV", "VH"]', '["VV"]').replace(listed, "")
    text = text.replace('"0.06 deg"', '"1 deg"')
    found = joint(simulate(Survey.from_text(text), rng=1), interval=INTERVAL)
    wrong = found["user_joint_wrong_interval"].values
    flag = found["quality_flag"].values[0, 0]
    # 0.2 MHz apart the phases of neighbouring intervals differ by 0.7 degrees only.
    assert np.nanmedian(wrong) > 0.1
    assert ((flag & QualityFlag.AMBIGUOUS) != 0).mean() > 0.9


def test_what_cannot_be_estimated_is_refused(samples: xr.Dataset) -> None:
    with pytest.raises(CubeError, match="one modulation frequency, 12 MHz"):
        joint(samples.isel(modulation_frequency=[0]))
    bare = samples.copy()
    del bare.attrs["survey"]
    with pytest.raises(CubeError, match="no attribute 'survey'"):
        joint(bare)
    silent = samples.copy(deep=True)
    silent["in_phase_uncertainty"][:] = 0
    silent["in_phase_quadrature_covariance"][:] = 0
    with pytest.raises(CubeError, match="must be above 0 V"):
        joint(silent)
    text = samples.attrs["survey"]
    keyhole = text.replace('acceptance = "0.08 rad"', 'acceptance = "1e-4 rad"')
    far = text.replace('"0.07 m",', '"5000 m",')
    assert text not in (keyhole, far)
    with pytest.raises(CubeError, match="split the scan"):
        joint(samples.assign_attrs(survey=keyhole))
    with pytest.raises(CubeError, match="does not see the beam"):
        joint(samples.assign_attrs(survey=far))
    with pytest.raises(ValueError, match="each of the 6 modulation frequencies"):
        joint(samples, echo_transfer=np.ones(3))
    with pytest.raises(ValueError, match="interval must run"):
        joint(samples, interval=(3.0, 1.0))


def test_the_table_is_the_water_signal_of_the_diffusion_model(
    samples: xr.Dataset, plate_text: str
) -> None:
    azimuth, elevation = samples["azimuth"].values, samples["elevation"].values
    frame = frame_of(samples, azimuth.ravel(), elevation.ravel())
    # So much scattering that no light goes straight.
    shape = Shape(0.255, 0.0357, 1e4, np.zeros(0), np.zeros(0))
    table = frame.table(shape, longest=3.0)
    pixels = _pixels(frame.weights(azimuth.ravel(), elevation.ravel()))
    depth = np.linspace(0.3, 2.9, len(pixels))
    out = np.empty((len(pixels), 2, FREQUENCIES.size))
    kernels.water_at(
        depth, np.zeros(len(depth)), np.full(len(depth), 4.0),
        4.0 * np.linspace(0, 1, 33)[None, :] ** 2 * np.ones((len(depth), 1)),
        table.step, joint_pixels.shares(pixels, table),
        joint_pixels.parts(table.value), joint_pixels.parts(table.slope),
        np.zeros(len(depth)), frame.wavenumber, np.empty(len(depth)), out,
        np.empty_like(out),
    )  # fmt: skip
    arguments = frame._arguments(azimuth.ravel(), elevation.ravel())
    exact = small_angle_diffusion.water_response(
        FREQUENCIES[:, None],
        absorption=0.255,
        forward_scattering=0.0357,
        diffuse_scattering=0.0,
        second_moment=1.0,
        backscatter_vsf=1.0,
        group_index=1.38,
        end=depth,
        **arguments,
    ).T
    got = (out[:, 0] + 1j * out[:, 1]) * table.strength
    # The interpolation over the scan is good to 1e-4 of the largest overlap.
    assert_allclose(got / abs(exact).max(), exact / abs(exact).max(), atol=3e-4)


# ---------------------------------------------------------------- the solver alone


def _pixels(weights: np.ndarray) -> Pixels:
    count = len(weights)
    nothing = np.zeros((count, 1, FREQUENCIES.size))
    return Pixels(
        nothing.astype(complex),
        Covariance(nothing + 1.0, nothing + 1.0, nothing),
        nothing == 0,
        weights,
        np.zeros(count),
        np.zeros(count),
        np.full(count, 8.0),
        np.zeros((count, 33)),
    )


def _solve(
    signal: np.ndarray,
    sigma: np.ndarray,
    water: np.ndarray,
    frequency: np.ndarray,
    *,
    shortest: float = 2.0,
    longest: float = 8.0,
) -> joint_search.Estimates:
    """Return the estimate behind a water signal that does not depend on its end."""
    variance = np.broadcast_to(sigma**2, signal.shape).copy()
    count = len(signal)
    pixels = Pixels(
        signal,
        Covariance(variance, variance, np.zeros_like(variance)),
        np.ones(signal.shape, dtype=bool),
        np.ones((count, 1)),
        np.zeros(count),
        np.full(count, shortest),
        np.full(count, longest),
        np.broadcast_to(np.linspace(1, 3, 33), (count, 33)).copy(),
    )
    value = np.broadcast_to(water, (1, 4, frequency.size)).astype(complex)
    table = Table(
        1.0,
        np.ascontiguousarray(value),
        np.zeros_like(value),
        np.zeros((0, *value.shape), dtype=complex),
        np.ones((1, 1)),
        np.ones(1),
        1.0,
    )
    return joint_search.estimate(
        pixels,
        joint_pixels.weight(pixels),
        table,
        gain=np.ones((1, frequency.size), dtype=complex),
        transfer=np.ones(frequency.size, dtype=complex),
        wavenumber=2 * np.pi * frequency / speed_of_light,
    )


paths = st.floats(3.0, 7.0)
amplitudes = st.floats(0.1, 10.0)
seeds = st.integers(0, 2**32 - 1)


def _draw(path: float, amplitude: float, seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    wavenumber = 2 * np.pi * FREQUENCIES / speed_of_light
    water = rng.standard_normal(6) + 1j * rng.standard_normal(6)
    noise = rng.standard_normal((1, 1, 6)) + 1j * rng.standard_normal((1, 1, 6))
    sigma = np.array(0.01 * amplitude)
    signal = amplitude * np.exp(1j * wavenumber * path) + water + sigma * noise
    return signal, sigma, water


@settings(max_examples=40)
@given(paths, amplitudes, seeds)
def test_the_path_is_found_within_its_error(
    path: float, amplitude: float, seed: int
) -> None:
    found = _solve(*_draw(path, amplitude, seed), FREQUENCIES)
    wavenumber = 2 * np.pi * FREQUENCIES / speed_of_light
    # Six phases, each known to a hundredth: the textbook bound.
    bound = 0.01 / np.sqrt(np.sum(wavenumber**2))
    assert_allclose(found.information**-0.5, bound, rtol=0.1)
    assert abs(found.path[0] - path) < 6 * bound


@settings(max_examples=40)
@given(paths, amplitudes, seeds, st.floats(0.05, 20.0))
def test_amplitude_scale_moves_no_path(
    path: float, amplitude: float, seed: int, factor: float
) -> None:
    signal, sigma, water = _draw(path, amplitude, seed)
    one = _solve(signal, sigma, water, FREQUENCIES)
    two = _solve(factor * signal, factor * sigma, factor * water, FREQUENCIES)
    # The search stops at a thousandth of the standard error.
    assert_allclose(two.path, one.path, atol=2e-3 * one.information[0] ** -0.5)
    assert_allclose(two.amplitude, factor * one.amplitude, rtol=1e-4)
    assert_allclose(two.cost, one.cost, rtol=1e-4)


@settings(max_examples=40)
@given(paths, amplitudes, seeds, st.permutations(range(6)))
def test_the_order_of_the_frequencies_does_not_matter(
    path: float, amplitude: float, seed: int, order: list[int]
) -> None:
    signal, sigma, water = _draw(path, amplitude, seed)
    one = _solve(signal, sigma, water, FREQUENCIES)
    two = _solve(signal[..., order], sigma, water[order], FREQUENCIES[order])
    assert_allclose(two.path, one.path, atol=2e-3 * one.information[0] ** -0.5)
    assert_allclose(two.cost, one.cost, rtol=1e-4)


@settings(max_examples=40)
@given(paths, amplitudes, seeds, st.floats(-1.5, 20.0))
def test_a_common_delay_moves_the_path_by_itself(
    path: float, amplitude: float, seed: int, delay: float
) -> None:
    signal, sigma, water = _draw(path, amplitude, seed)
    turn = np.exp(2j * np.pi * FREQUENCIES / speed_of_light * delay)
    one = _solve(signal, sigma, water, FREQUENCIES)
    two = _solve(
        signal * turn,
        sigma,
        water * turn,
        FREQUENCIES,
        shortest=2.0 + delay,
        longest=8.0 + delay,
    )
    assert_allclose(two.path - delay, one.path, atol=2e-3 * one.information[0] ** -0.5)
    assert_allclose(two.cost, one.cost, rtol=1e-4)


@settings(max_examples=30)
@given(paths, seeds, st.floats(0.02, 0.35))
def test_the_interval_ends_where_the_misfit_has_risen_by_one(
    path: float, seed: int, noise: float
) -> None:
    signal, _, water = _draw(path, 1.0, seed)
    rng = np.random.default_rng(seed)
    stray = rng.standard_normal((2, 6))
    wavenumber = 2 * np.pi * FREQUENCIES / speed_of_light
    clean = np.exp(1j * wavenumber * path)
    signal = (clean + water + noise * (stray[0] + 1j * stray[1]))[None, None]
    found = _solve(signal, np.array(noise), water, FREQUENCIES)

    def rise(length: float) -> float:
        # The best amplitude in closed form.
        along = np.mean((signal[0, 0] - water) * np.exp(-1j * wavenumber * length)).real
        square = np.sum(np.abs(signal[0, 0] - water) ** 2)
        return float((square - 6 * max(along, 0.0) ** 2) / noise**2 - found.cost[0])

    sigma = float(found.information[0] ** -0.5)
    for end in (found.path - found.lower, found.path + found.upper):
        # A side that is a parabola to a tenth is taken as one, to a twentieth in width.
        assert rise(float(end[0])) == pytest.approx(1.0, abs=0.11)
    near = float(found.path[0])
    assert rise(near) == pytest.approx(0.0, abs=1e-4)
    assert rise(near + 0.3 * sigma) > 0
    assert rise(near - 0.3 * sigma) > 0


def test_the_uncompiled_loop_gives_the_same_sums() -> None:
    rng = np.random.default_rng(3)
    signal, gain = rng.standard_normal((2, 2, 5)), rng.standard_normal((2, 2, 5))
    weight = np.abs(rng.standard_normal((2, 3, 5))) + [[[1.0]], [[0.1]], [[1.0]]][0]
    water, phasor = rng.standard_normal((2, 5)), rng.standard_normal((2, 5))
    one, two = np.empty(2), np.empty(2)
    plain = kernels.misfit.py_func(signal, weight, gain, water, phasor, one)
    fast = kernels.misfit(signal, weight, gain, water, phasor, two)
    assert fast == pytest.approx(plain, rel=1e-12)
    assert_allclose(two, one, rtol=1e-12)


def test_normal_equations_are_those_of_the_written_out_least_squares() -> None:
    rng = np.random.default_rng(8)
    count, channels, frequencies, parameters = 3, 2, 4, 2

    def draw(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    left, base = draw(count, channels, frequencies), draw(count, channels, frequencies)
    changes, near = draw(count, parameters, frequencies), draw(count, frequencies)
    echo, slope = draw(count, frequencies), draw(count, frequencies)
    factor, wavenumber = draw(frequencies), rng.uniform(1, 3, frequencies)
    strength = rng.uniform(1, 2, channels)
    amplitude = rng.uniform(1, 2, (count, channels))
    is_target = np.array([True, False, True])
    weight = rng.uniform(1, 2, (count, channels, 3, frequencies))
    weight[:, :, 1] -= 1.5
    first_departure = channels + parameters
    first_echo = first_departure + 2 * channels * frequencies
    used = first_echo + 2 * frequencies
    matrix, vector = np.zeros((2, used, used)), np.zeros((2, used))
    square = np.zeros(2)
    normal_kernels.accumulate(
        left, weight, base, changes, near, strength, echo, factor, amplitude, slope,
        wavenumber, is_target, first_departure, first_echo, True, matrix, vector,
        square,
    )  # fmt: skip
    expected = np.zeros((used, used)), np.zeros(used), 0.0
    for n in range(count):
        rows, own, rest = [], [], []
        for c in range(channels):
            for f in range(frequencies):
                row = np.zeros(used, dtype=complex)
                row[c] = base[n, c, f]
                row[channels : channels + parameters] = strength[c] * changes[n, :, f]
                at = first_departure + c * frequencies + f
                row[at] = strength[c] * near[n, f]
                row[at + channels * frequencies] = 1j * strength[c] * near[n, f]
                row[first_echo + f] = amplitude[n, c] * echo[n, f]
                row[first_echo + frequencies + f] = 1j * amplitude[n, c] * echo[n, f]
                full = echo[n, f] * factor[f]
                mine = np.zeros(channels + 1, dtype=complex)
                mine[c] = full
                way = 1j * wavenumber[f] * amplitude[n, c] * full
                mine[channels] = way + strength[c] * slope[n, f]
                xx, xy, yy = weight[n, c, :, f]
                root = np.linalg.cholesky(np.array([[xx, xy], [xy, yy]])).T
                rows.append(root @ np.stack([row.real, row.imag]))
                own.append(root @ np.stack([mine.real, mine.imag]))
                rest.append(root @ [left[n, c, f].real, left[n, c, f].imag])
        jacobian, mine, residual = (np.concatenate(x) for x in (rows, own, rest))
        if is_target[n]:
            project = np.eye(len(residual)) - mine @ np.linalg.pinv(mine)
            jacobian, residual = project @ jacobian, project @ residual
        expected[0][...] += jacobian.T @ jacobian
        expected[1][...] += jacobian.T @ residual
        expected = (*expected[:2], expected[2] + residual @ residual)
    assert_allclose(matrix.sum(axis=0), expected[0], atol=1e-10)
    assert_allclose(vector.sum(axis=0), expected[1], atol=1e-10)
    assert square.sum() == pytest.approx(expected[2], rel=1e-12)


def test_the_common_covariance_is_that_of_dense_algebra() -> None:
    rng = np.random.default_rng(3)
    pixels, channels, frequencies, shapes = 4, 2, 3, 2

    def drawn(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    strength = rng.random(channels)
    gain, departure = drawn(channels, frequencies), drawn(channels, frequencies)
    near, water = drawn(pixels, frequencies), drawn(pixels, frequencies)
    changes = drawn(pixels, shapes, frequencies)
    root = rng.standard_normal((channels, frequencies, shapes + 3, shapes + 3))
    matrix = root @ np.swapaxes(root, -1, -2)
    found = [np.empty((pixels, channels, frequencies)) for _ in range(3)]
    common_kernels.common(
        strength, gain, departure, near, water, changes, matrix, *found
    )
    for n, c, f in np.ndindex(pixels, channels, frequencies):
        # Derivatives of s W + s d N by strength, shape, real and imaginary d.
        slope = np.array(
            [
                water[n, f] + departure[c, f] * near[n, f],
                *(gain[c, f] * changes[n, :, f]),
                strength[c] * near[n, f],
                1j * strength[c] * near[n, f],
            ]
        )
        columns = np.stack([slope.real, slope.imag])
        dense = columns @ matrix[c, f] @ columns.T
        xx, yy, xy = (values[n, c, f] for values in found)
        assert_allclose(
            [[xx, xy], [xy, yy]], dense, rtol=1e-12, atol=1e-12 * abs(dense).max()
        )
