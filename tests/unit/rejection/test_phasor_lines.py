"""Phasor lines: the target's phase from reflectances alone, and refusals."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.constants import speed_of_light

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor.cube import QualityFlag, tiles
from amulor.errors import CubeError
from amulor.optics import detection
from amulor.rejection import smooth_water
from amulor.rejection.phasor_lines import _edges

FREQUENCY = np.array([20e6, 60e6])
ROWS, COLUMNS = np.mgrid[0:14, 0:16]
DISTANCE = 1.5 + 0.004 * COLUMNS - 0.002 * ROWS


def pattern(seed: int, dark: float = 0.1) -> np.ndarray:
    """Return reflectances of 0.3 and `dark`, drawn for each pixel."""
    rng = np.random.default_rng(seed)
    return np.where(rng.random(DISTANCE.shape) < 0.5, 0.3, dark)


def phasors(distance: np.ndarray = DISTANCE) -> np.ndarray:
    """Return echoes of a white target, over (frequency, row, column)."""
    wave = 4 * np.pi * FREQUENCY * 1.38 / speed_of_light
    return np.exp(1j * wave[:, None, None] * distance)


def cube_of(
    signal: np.ndarray, *, noise: float = 2e-3, seed: int = 1, excess: float = 0.0
) -> xr.Dataset:
    """Return samples of a signal without shots and without a survey."""
    rng = np.random.default_rng(seed)
    draws = rng.standard_normal((2, *signal.shape))
    measured = signal + (noise + excess) * (draws[0] + 1j * draws[1])
    stated = np.full(signal.shape, noise)[:, None]
    azimuth, elevation = 0.002 * COLUMNS, -0.002 * ROWS
    return cubes.build(
        "samples",
        {
            "in_phase": measured.real[:, None],
            "quadrature": measured.imag[:, None],
            "in_phase_uncertainty": stated,
            "quadrature_uncertainty": stated,
            "saturated": np.zeros(stated.shape, np.int8),
        },
        {
            "modulation_frequency": FREQUENCY,
            "polarization": ["none"],
            "azimuth": azimuth,
            "elevation": elevation,
        },
        geometry={
            "group_index": 1.38,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("samples", title="by hand", source="by hand"),
    )


def phase_errors(target: xr.Dataset, truth: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return errors of the phase and their stated uncertainties."""
    signal = target.amulor.signal.values
    stated = detection.phase_uncertainty(
        signal,
        in_phase_variance=target["in_phase_uncertainty"].values ** 2,
        quadrature_variance=target["quadrature_uncertainty"].values ** 2,
        covariance=target["in_phase_quadrature_covariance"].values,
    )
    return np.angle(signal / truth[:, None]), stated


@pytest.mark.parametrize("excess", [0.0, 4e-3])
def test_errors_of_the_phase_are_as_stated(excess: float) -> None:
    inside = []
    for seed in range(4):
        signal = pattern(seed) * phasors() + 0.2 - 0.1j
        target = rejection.phasor_lines(cube_of(signal, seed=seed, excess=excess))
        error, stated = phase_errors(target, phasors())
        inside.append((np.abs(error) < 1.96 * stated).mean())
        assert (target["quality_flag"].values == 0).mean() > 0.95
    # Neighbors share windows: 1,792 samples count for about 140.
    assert 0.91 < np.mean(inside) < 0.99


@settings(max_examples=8)
@given(
    terms=st.lists(
        st.complex_numbers(max_magnitude=0.2, allow_nan=False), min_size=6, max_size=6
    )
)
def test_smooth_water_does_not_move_the_phase(terms: list[complex]) -> None:
    x, y = COLUMNS / 15 - 0.5, ROWS / 13 - 0.5
    shapes = (np.ones_like(x), x, y, x**2, x * y, y**2)
    water = sum(term * shape for term, shape in zip(terms, shapes, strict=True))
    signal = pattern(3) * phasors()
    clean, moved = (
        rejection.phasor_lines(cube_of(part, noise=1e-5)).amulor.signal.values
        for part in (signal + 0.05, signal + 0.05 + water)
    )
    # Modulo half a turn: which end of a line is bright depends on the water. The phase
    # turns by up to 0.07 rad in a window, so that a quadratic water signal has a cubic
    # part across the line. Left in, this water turns phases by up to 1 rad.
    turn = np.angle((moved / clean) ** 2) / 2
    assert np.abs(turn).max() < 5e-3


def test_error_follows_the_contrast_as_the_formula_for_two_pixels() -> None:
    # sqrt(2) a1 / (a1 - a2) of the error in known water: 2.1 at 0.1, 4.2 at 0.2.
    errors = []
    for dark in (0.1, 0.2):
        cube = cube_of(pattern(5, dark) * phasors() + 0.1, noise=5e-4)
        errors.append(
            np.median(phase_errors(rejection.phasor_lines(cube), phasors())[1])
        )
    assert errors[1] / errors[0] == pytest.approx(2.0, rel=0.05)


@pytest.mark.parametrize("height", [0.01, 0.03])
def test_stairs_narrower_than_a_window_are_flagged(height: float) -> None:
    # Spots of 2 x 2 pixels and treads of four columns, so that each window has a step.
    spots = pattern(3)[::2, ::2].repeat(2, 0).repeat(2, 1)
    distance = 1.5 + height * (COLUMNS // 4)
    signal = spots * phasors(distance) + 0.2 - 0.1j
    target = rejection.phasor_lines(cube_of(signal, noise=2e-4))
    error, stated = phase_errors(target, phasors(distance))
    trusted = target["quality_flag"].values == 0
    # The same on a plane, where no window has a step.
    plane = rejection.phasor_lines(
        cube_of(spots * phasors(1.5 + 0.25 * height * COLUMNS) + 0.2 - 0.1j, noise=2e-4)
    )
    assert trusted.mean() < 0.1
    assert (plane["quality_flag"].values == 0).mean() > 0.4
    assert (np.abs(error[trusted]) < 5 * stated[trusted]).all()


def test_rows_are_those_of_the_whole_scan() -> None:
    cube = cube_of(pattern(1) * phasors() + 0.2)
    whole = rejection.phasor_lines(cube)
    of = rejection.load("phasor-lines").fit(tiles.InMemory(cube))
    for begin, end in ((0, 3), (3, 9), (9, 14)):
        part = of(cube.isel(row=slice(begin, end)), begin)
        for name in ("in_phase", "quadrature_uncertainty", "quality_flag"):
            assert_array_equal(part[name], whole[name].isel(row=slice(begin, end)))


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_a_scene_of_one_reflectance_is_refused(slope: float) -> None:
    signal = 0.3 * phasors(DISTANCE + slope * COLUMNS) + 0.2
    with pytest.raises(CubeError, match="the reflectance does not vary within 5 x 5"):
        rejection.phasor_lines(cube_of(signal))


def test_the_edge_of_an_object_alone_is_refused() -> None:
    bright = COLUMNS > 7
    signal = np.where(bright, 0.3, 0.1) * phasors(np.where(bright, 1.4, 1.5)) + 0.2
    with pytest.raises(CubeError, match="does not vary"):
        rejection.phasor_lines(cube_of(signal))


def test_pixels_without_contrast_or_line_are_flagged() -> None:
    reflectance = np.where(COLUMNS < 8, pattern(2), 0.3)
    flag = rejection.phasor_lines(cube_of(reflectance * phasors() + 0.2))
    flag = flag["quality_flag"].values[:, 0]
    assert (flag[:, :, :6] == 0).mean() > 0.95
    assert (flag[:, :, 13:] & QualityFlag.NO_TARGET).all()
    # A sponge on the plate, in a corner of the scan: all windows there contain pores.
    pores = (np.hypot(ROWS - 2, COLUMNS - 2) < 2.5) * np.random.default_rng(4).random(
        DISTANCE.shape
    )
    signal = pattern(2) * phasors(DISTANCE - 0.1 * pores) + 0.2
    flag = rejection.phasor_lines(cube_of(signal))["quality_flag"].values[:, 0]
    doubtful = (flag & (QualityFlag.WATER_RESIDUAL | QualityFlag.NO_TARGET)) != 0
    assert doubtful[:, 1:4, 1:4].mean() > 0.9
    assert doubtful[:, :, 9:].mean() < 0.1


def test_lost_samples_leave_their_neighbors() -> None:
    cube = cube_of(pattern(6) * phasors() + 0.2)
    cube["in_phase"][0, 0, 5, 5] = np.nan
    target = rejection.phasor_lines(cube)
    assert target["quality_flag"].values[0, 0, 5, 5] == QualityFlag.MISSING
    error, stated = phase_errors(target, phasors())
    assert_allclose(error[1], 0, atol=5 * stated[1].max())
    assert (target["quality_flag"].values[0, 0, 4:7, 4:7] == 0).sum() >= 7


def test_windows_are_odd_and_no_larger_than_the_scan() -> None:
    cube = cube_of(pattern(1) * phasors() + 0.2)
    for window in (3, 6, 5.5):
        with pytest.raises(ValueError, match="window must be an odd number of pixels"):
            rejection.phasor_lines(cube, window=window)
    with pytest.raises(CubeError, match=r"14 x 16 pixels, but .* 15 x 15"):
        rejection.phasor_lines(cube, window=15)


def test_errors_of_means_contain_the_shared_windows() -> None:
    region = np.zeros(DISTANCE.shape, dtype=bool)
    region[3:11, 4:12] = True
    scores = []
    for seed in range(10):
        cube = cube_of(pattern(seed) * phasors() + 0.2, seed=seed)
        target = rejection.phasor_lines(cube)
        image = imaging.range_image(target, polarization="none", interval=(1.0, 2.0))
        mean = imaging.correlation.mean_range(image, region)
        error = mean.value - DISTANCE[region & (image["quality_flag"] == 0)].mean()
        scores.append(error / mean.uncertainty)
    # Ten draws: the deviation of a standard normal to 22 %. With independent pixels it
    # would be 3 or more.
    assert 0.3 < np.sqrt(np.mean(np.square(scores))) < 1.6


def round_object(step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return distances and reflectances of a bright disc before a dark wall."""
    disc = np.hypot(ROWS - 6.5, COLUMNS - 7.5) < 4.5
    spots = np.where(np.random.default_rng(8).random(disc.shape) < 0.5, 1.0, 0.7)
    return 1.5 - step * disc, np.where(disc, 0.3, 0.1) * spots


def edge_errors(cube: xr.Dataset, distance: np.ndarray) -> np.ndarray:
    """Return errors of the trusted samples near the disc, in standard errors."""
    target = rejection.phasor_lines(cube)
    error, stated = phase_errors(target, phasors(distance))
    near = np.abs(np.hypot(ROWS - 6.5, COLUMNS - 7.5) - 4.5) < 1.5
    trusted = (target["quality_flag"].values == 0) & near
    return (error / stated)[trusted]


def test_the_round_edge_of_an_object_is_flagged_or_right() -> None:
    # The directions of the beam leave the water signal open: phases of windows.
    for step in (0.01, 0.05, 0.2):
        distance, reflectance = round_object(step)
        cube = cube_of(reflectance * phasors(distance) + 0.05 - 0.02j, noise=5e-4)
        wrong = np.abs(edge_errors(cube, distance)) > 3
        # 2 x 96 samples are near the edge; without flags 20 and more are wrong.
        assert wrong.sum() < 8


def test_lines_of_different_phases_give_the_water_of_each_pixel() -> None:
    # A fixed beam, moved sideways along an oblique wall: one water signal. Four pixels,
    # fewer than a window, are 0.2 m nearer.
    small = (np.abs(ROWS - 6.5) < 1) & (np.abs(COLUMNS - 7.5) < 1)
    distance = 1.5 + 0.05 * COLUMNS - 0.2 * small
    water = 0.05 - 0.02j
    errors = []
    for seed in range(4):
        signal = pattern(seed) * phasors(distance) + water
        cube = cube_of(signal, noise=5e-4, seed=seed)
        cube = cube.assign_coords(
            {name: cube[name].copy(data=0 * ROWS) for name in ("azimuth", "elevation")}
        )
        target = rejection.phasor_lines(cube)
        assert "phasor_line_window" not in target.attrs
        removed = target["water_in_phase"] + 1j * target["water_quadrature"]
        # A tenth of the darkest target.
        assert np.abs(removed.values - water).max() < 0.01
        error, deviation = phase_errors(target, phasors(distance))
        errors.append(error / deviation)
        assert (target["quality_flag"].values == 0).mean() > 0.95
    assert 0.92 < (np.abs(errors) < 1.96).mean() < 0.99
    # Four scans of four pixels and two frequencies.
    assert (np.abs(np.array(errors)[..., small]) < 1.96).mean() > 0.8


@pytest.mark.parametrize("window", [3, 5, 7])
def test_edges_lie_in_all_directions_of_a_square(window: int) -> None:
    edges = _edges(window)
    assert_allclose((edges**2).sum(axis=1), 1, rtol=1e-12)
    # Edges of the mirrored and the turned window are edges, too, up to their sign.
    square = edges.reshape(-1, window, window)
    whole = np.abs(edges @ edges.T)
    assert_allclose(np.diag(whole), 1, rtol=1e-12)
    for turned in (square[:, ::-1], square.swapaxes(1, 2)):
        found = np.abs(edges @ turned.reshape(len(edges), -1).T).max(axis=0)
        assert_allclose(found, 1, rtol=1e-9)


@pytest.mark.parametrize("shape", [(7, 9), (1, 12), (12, 1), (2, 2)])
def test_windows_repeat_each_other_by_the_sum_of_their_correlations(shape) -> None:
    # White noise, noise that windows share in part, and noise that is equal everywhere.
    rng = np.random.default_rng(2)
    noise = rng.normal(size=shape)
    for deviation in (noise, 0.5 + noise, np.ones(shape)):
        pairs = 0.0
        for first in np.ndindex(shape):
            for second in np.ndindex(shape):
                if all(abs(a - b) < 3 for a, b in zip(first, second, strict=True)):
                    pairs += deviation[first] * deviation[second]
        expected = np.clip(pairs / np.sum(deviation**2), 1.0, 9.0)
        assert smooth_water._repetition(deviation, 3) == pytest.approx(expected)
