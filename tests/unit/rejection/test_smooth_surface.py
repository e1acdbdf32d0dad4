"""The method smooth-surface: closed forms, invariances, coverage on fresh noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

from amulor import rejection
from amulor.cube import QualityFlag, tiles
from amulor.errors import CubeError
from amulor.rejection.smooth_surface import _with_prior, smoothing

Make = Callable[..., xr.Dataset]
FREQUENCY = np.array([10e6, 35e6, 80e6, 146e6])
#: Noise of a phase [rad], and of the range that all frequencies give, as phase at the
#: highest one [rad].
NOISE = 0.01
RANGE = NOISE / np.sqrt(((FREQUENCY / FREQUENCY[-1]) ** 2).sum())
WAVE = (FREQUENCY / FREQUENCY[-1])[:, None, None, None]


def change(phase: np.ndarray, window: int = 5) -> np.ndarray:
    """Return the change of phases of equal noise."""
    return smoothing(
        np.exp(1j * phase),
        np.full(phase.shape, NOISE**2),
        modulation_frequency=FREQUENCY,
        window=window,
    ).phase


def ranges(phase: np.ndarray) -> np.ndarray:
    """Return the ranges of all frequencies, in standard errors of a pixel."""
    return (WAVE * phase).sum(axis=(0, 1)) / (WAVE**2).sum() / RANGE


def errors(surface: np.ndarray, seed: int, window: int = 5) -> np.ndarray:
    """Return errors of ranges with the prior; all lengths in standard errors."""
    rng = np.random.default_rng(seed)
    phase = WAVE * RANGE * surface
    noisy = phase + rng.normal(0, NOISE, phase.shape)
    return ranges(noisy + change(noisy, window)) - surface


def test_a_plane_without_noise_does_not_change() -> None:
    row, column = np.mgrid[:9, :12]
    plane = WAVE * (0.02 * row + 0.03 * column + 1.0)
    assert np.abs(change(plane)).max() < 1e-8


@pytest.mark.parametrize("window", [5, 7, 9])
def test_one_pixel_off_a_plane_moves_by_the_gain_of_its_closed_form(
    window: int,
) -> None:
    # By half a standard error of its range: no residual, no departure of its own.
    places = np.zeros((15, 15))
    places[7, 7] = 0.5
    moved = ranges(change(WAVE * RANGE * places))[7, 7] if window == 5 else None
    found = ranges(change(WAVE * RANGE * places, window))[7, 7]
    count = window**2 - 1
    freedom = count - 3
    # Weights of the fit, from the distances in standard errors of both pixels.
    departure = 2.75 * 0.5 * np.sqrt(2 * freedom) / freedom
    gain = 1 / (1 + 1 / count + departure)
    assert found == pytest.approx(-0.5 * gain, rel=0.02)
    assert moved is None or moved == found


def test_a_high_step_is_an_edge() -> None:
    step = np.where(np.arange(20) < 9, 0.0, 50.0) * np.ones((12, 1))
    assert np.abs(ranges(change(WAVE * RANGE * step))).max() < 1e-6


def test_a_common_phase_a_tilt_and_a_transposition_do_not_matter() -> None:
    rng = np.random.default_rng(4)
    noise = rng.normal(0, NOISE, (4, 1, 10, 14))
    plain = change(noise)
    row, column = np.mgrid[:10, :14]
    late = np.array([0.3, -1.0, 2.0, 0.1])[:, None, None, None]
    np.testing.assert_allclose(change(noise + late), plain, atol=1e-9)
    transposed = change(noise.swapaxes(2, 3)).swapaxes(2, 3)
    np.testing.assert_allclose(transposed, plain, atol=1e-9)
    # Weights depend on distances to the pixel, so a tilt matters a little.
    tilted = change(noise + WAVE * RANGE * 0.1 * (row - column))
    assert np.std(tilted - plain) < 0.1 * np.std(plain)


@pytest.mark.parametrize(
    ("height", "least"), [(0.0, 0.95), (2.0, 0.95), (4.0, 0.93), (6.0, 0.91)]
)
def test_intervals_of_the_data_hold_beside_steps_of_the_size_of_noise(
    height: float, least: float
) -> None:
    surface = np.where(np.arange(30) < 15, 0.0, height) * np.ones((30, 1))
    found = np.array([errors(surface, seed) for seed in range(100, 110)])
    assert np.mean(np.abs(found) < 1.96) > 0.96
    assert np.mean(np.abs(found[..., 14:16]) < 1.96) > least


def test_noise_of_a_smooth_surface_falls_by_a_third() -> None:
    row, column = np.mgrid[:30, :30]
    for surface in (np.zeros((30, 30)), 2.0 * column, 0.02 * (row - 15.0) ** 2):
        assert 0.5 < errors(surface, 7).std() < 0.72


@pytest.fixture
def plate(by_hand: Make) -> xr.Dataset:
    return by_hand(
        4,
        frequency=[float(f) for f in FREQUENCY],
        channels={"VV": (1.0, 1.0)},
        shape=(12, 10),
        water=0.2,
    )


def test_errors_and_flags_are_those_of_the_base(plate: xr.Dataset) -> None:
    base = rejection.open_water(plate, interval=(0.5, 2.5))
    target = rejection.smooth_surface(plate, interval=(0.5, 2.5))
    turn = np.angle((target.amulor.signal / base.amulor.signal).values)
    assert (turn != 0).mean() > 0.95  # all but corners
    np.testing.assert_allclose(
        np.abs(target.amulor.signal), np.abs(base.amulor.signal), rtol=1e-12
    )
    for name in base.data_vars:
        if "in_phase" in name or "quadrature" in name or name == "common_covariance":
            continue
        xr.testing.assert_equal(target[name], base[name])
    total, before = (
        cube["in_phase_uncertainty"] ** 2 + cube["quadrature_uncertainty"] ** 2
        for cube in (target, base)
    )
    np.testing.assert_allclose(total, before, rtol=1e-9)


def test_flagged_samples_neither_change_nor_take_part(plate: xr.Dataset) -> None:
    empty = plate.copy(deep=True)
    for part in ("in_phase", "quadrature"):
        empty[part].values[:, :, 4, 4] = empty[f"open_water_{part}"].values.mean(axis=2)
    base = rejection.open_water(empty, interval=(0.5, 2.5))
    assert (base["quality_flag"].values[:, :, 4, 4] & QualityFlag.NO_TARGET).all()
    target = rejection.smooth_surface(empty, interval=(0.5, 2.5))
    for name in ("in_phase", "quadrature"):
        difference = (target[name] - base[name]).values
        np.testing.assert_allclose(difference[:, :, 4, 4], 0.0, atol=1e-15)
        assert np.isfinite(difference).all()


def test_rows_give_the_result_of_the_whole_scan(plate: xr.Dataset) -> None:
    method = rejection.load("smooth-surface")
    whole = method(plate, interval=(0.5, 2.5))
    of = method.fit(tiles.InMemory(plate), interval=(0.5, 2.5))
    part = of(plate.isel(row=slice(3, 6)), 3)
    for name in ("in_phase", "quadrature_uncertainty", "quality_flag"):
        np.testing.assert_array_equal(
            part[name].values, whole[name].values[:, :, 3:6], err_msg=name
        )


def test_wrong_options_are_refused(plate: xr.Dataset) -> None:
    for window in (3, 4, 6, 8, 11, 5.5):
        with pytest.raises(ValueError, match="odd number of pixels from 5 to 9"):
            rejection.smooth_surface(plate, window=window)
    for base in ("auto", "smooth-surface"):
        with pytest.raises(ValueError, match="base must be a method for single pixels"):
            rejection.smooth_surface(plate, base=base)


def test_the_expected_noise_is_the_noise() -> None:
    rng = np.random.default_rng(11)
    phase = rng.normal(0, NOISE, (4, 1, 40, 40))
    smooth = smoothing(
        np.exp(1j * phase),
        np.full(phase.shape, NOISE**2),
        modulation_frequency=FREQUENCY,
        window=5,
    )
    inside = (slice(2, -2), slice(2, -2))
    expected = np.sqrt(np.mean(1 - smooth.gain[inside]))
    # Of some 1300 pixels, of which 25 depend on each other.
    assert ranges(phase + smooth.phase)[inside].std() == pytest.approx(
        expected, rel=0.15
    )


def joint_target(surface: np.ndarray, noise: float, seed: int) -> xr.Dataset:
    """Return the ranges of a joint estimation of a surface, with a common error."""
    noisy = surface + np.random.default_rng(seed).normal(0, noise, surface.shape)
    total = np.hypot(noise, 2e-3)
    parts = {
        "": noisy,
        "_uncertainty": np.full(surface.shape, total),
        "_common_uncertainty": np.full(surface.shape, 2e-3),
        "_lower": noisy - total,
        "_upper": noisy + 1.5 * total,
    }
    return xr.Dataset(
        {
            f"joint_slant_range{part}": (("row", "column"), values)
            for part, values in parts.items()
        }
    )


def test_ranges_of_a_joint_estimation_are_smoothed_and_their_intervals_moved() -> None:
    row, column = np.mgrid[:30, :30]
    plane = 3.0 + 1e-4 * column - 2e-4 * row
    before = joint_target(plane, 1e-4, 5)
    before["joint_slant_range"].values[3, 4] = np.nan
    after = _with_prior(before, 5)
    off = after["joint_slant_range"].values - plane
    assert 0.5 < np.nanstd(off) / 1e-4 < 0.72
    assert np.isnan(off[3, 4])
    for end in ("_lower", "_upper"):
        width = [
            (part[f"joint_slant_range{end}"] - part["joint_slant_range"]).values
            for part in (before, after)
        ]
        np.testing.assert_allclose(width[1], width[0], atol=1e-12)
    name = "joint_slant_range_uncertainty"
    xr.testing.assert_equal(after[name], before[name])
    # A step of 1 cm is an edge, and rows are those of the whole scan.
    step = _with_prior(joint_target(plane + 0.01 * (row > 14), 1e-4, 5), 5)
    off = step["joint_slant_range"].values - plane - 0.01 * (row > 14)
    assert np.abs(off).max() < 5e-4
    part = _with_prior(before.isel(row=slice(4, 20)), 5)
    np.testing.assert_array_equal(
        part["joint_slant_range"].values[2:-2], after["joint_slant_range"].values[6:18]
    )


@pytest.mark.parametrize("rough", [1.0, 2.0, 4.0, 6.0])
def test_intervals_hold_on_rough_surfaces(rough: float) -> None:
    found = []
    for seed in range(200, 206):
        surface = np.random.default_rng(seed).normal(0, rough, (30, 30))
        found.append(errors(surface, seed + 50))
    # Of 5400 pixels 95 %; smoothing of rough surfaces adds no error.
    assert np.mean(np.abs(found) < 1.96) > 0.94
    assert np.std(found) < 1.03


def test_the_base_is_part_of_the_name(plate: xr.Dataset) -> None:
    method = rejection.load("smooth-surface of background without shots")
    assert method.name == "smooth-surface of background without shots"
    of_water = rejection.load("smooth-surface of open-water")
    assert of_water.needs == rejection.load("open-water").needs
    xr.testing.assert_equal(
        of_water(plate, interval=(0.5, 2.5)),
        rejection.smooth_surface(plate, interval=(0.5, 2.5)),
    )
    for wrong in ("open-water of joint", "smooth-surface of nothing"):
        with pytest.raises(CubeError, match="there is no rejection method"):
            rejection.load(wrong)
