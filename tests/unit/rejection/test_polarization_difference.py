"""The method polarization-difference: closed forms, light of photon transport."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from amulor import cube as cubes
from amulor import imaging, rejection
from amulor.cube import QualityFlag, tiles
from amulor.cube.schema import WaterResidualCause
from amulor.errors import CubeError
from amulor.studies.benchmark import scenes, table

Make = Callable[..., xr.Dataset]
FREQUENCY = [10e6, 35e6, 80e6, 146e6]
TARGET, WATER = 0.3, 0.1
CHANNELS = {"VV": (1.0, 1.0), "VH": (TARGET, WATER)}
#: Written by tests/oracles/polarized_light.py.
TABLE = Path(__file__).parents[2] / "reference" / "polarized_light.csv"


def echo(distance: float, channels: dict[str, tuple[float, float]]) -> np.ndarray:
    """Return an echo of amplitude 1, shape (frequency, channel, 1, 1)."""
    phase = 4 * np.pi * np.array(FREQUENCY) * 1.38 * distance / 299792458.0
    shares = [share for share, _ in channels.values()]
    return (np.exp(1j * phase)[:, None] * shares)[:, :, None, None]


def changed(cube: xr.Dataset, light: np.ndarray) -> xr.Dataset:
    """Return samples with added light."""
    cube = cube.copy(deep=True)
    shape = cube["in_phase"].shape
    cube["in_phase"].values += np.broadcast_to(light.real, shape)
    cube["quadrature"].values += np.broadcast_to(light.imag, shape)
    return cube


def spotted(cube: xr.Dataset, seed: int = 0, distance: float = 1.5) -> xr.Dataset:
    """Return samples of a plate with random spots of a third of the reflectance."""
    rng = np.random.default_rng(seed)
    dark = rng.integers(0, 2, cube["azimuth"].shape) * (2 / 3)
    return changed(cube, -dark * echo(distance, CHANNELS))


@pytest.fixture
def plate(by_hand: Make) -> xr.Dataset:
    return by_hand(
        4, frequency=FREQUENCY, channels=CHANNELS, shape=(8, 12), shots=0, water=0.5
    )


def flagged(target: xr.Dataset) -> np.ndarray:
    """Return the pixels whose samples depart from the model."""
    cause = target["water_residual_cause"].values & WaterResidualCause.MODEL_MISFIT
    residual = target["quality_flag"].values & QualityFlag.WATER_RESIDUAL
    return ((cause != 0) & (residual != 0)).all(axis=(0, 1))


def test_water_of_one_ratio_is_removed_without_knowing_the_ratio(
    plate: xr.Dataset,
) -> None:
    cube = spotted(plate)
    target = rejection.polarization_difference(cube, interval=(0.5, 2.5))
    # Water of a first-order low-pass of 30 MHz, half as strong as the echo.
    off = np.angle(target.amulor.signal.values / echo(1.5, {"VV": (1.0, 0)}))
    before = np.angle(cube.amulor.signal.values[:, :1] / echo(1.5, {"VV": (1.0, 0)}))
    assert np.abs(before[0]).mean() > 0.05
    error = target["in_phase_uncertainty"].values / np.abs(target.amulor.signal.values)
    assert np.abs(off.mean(axis=(2, 3))).max() < 3 * np.median(error)
    assert 0.9 < np.mean(np.abs(off) < 1.96 * error) <= 1
    water, target_ratio = target.attrs["water_ratio"], target.attrs["target_ratio"]
    assert np.abs(water[0] - WATER) < 3 * target.attrs["water_ratio_uncertainty"][0]
    assert abs(target_ratio - TARGET) < 4 * target.attrs["target_ratio_uncertainty"]
    assert target.attrs["target_ratio_tested"] == 1
    assert flagged(target).mean() < 0.05


def test_two_frequencies_are_enough_and_one_is_not(plate: xr.Dataset) -> None:
    stated = {"target_ratio": TARGET, "target_ratio_uncertainty": 0.02}
    cube = spotted(plate)
    two = cube.isel(modulation_frequency=[0, 3])
    target = rejection.polarization_difference(two, interval=(0.5, 2.5), **stated)
    assert np.isfinite(target["in_phase"].values).any()
    with pytest.raises(CubeError, match="one modulation frequency"):
        rejection.polarization_difference(cube.isel(modulation_frequency=[0]), **stated)


def test_a_stated_ratio_that_neighbors_contradict_flags_all_pixels(
    plate: xr.Dataset,
) -> None:
    cube = spotted(plate)
    wrong = {"target_ratio": 1.0, "target_ratio_uncertainty": 0.05}
    assert flagged(rejection.polarization_difference(cube, **wrong)).all()
    right = {"target_ratio": 0.28, "target_ratio_uncertainty": 0.05}
    assert not flagged(rejection.polarization_difference(cube, **right)).all()


def test_a_plate_of_one_reflectance_needs_a_stated_ratio(plate: xr.Dataset) -> None:
    with pytest.raises(CubeError, match="so the depolarization ratio of the target"):
        rejection.polarization_difference(plate)
    target = rejection.polarization_difference(
        plate, target_ratio=TARGET, target_ratio_uncertainty=0.02, interval=(0.5, 2.5)
    )
    assert target.attrs["target_ratio_tested"] == 0
    off = np.angle(target.amulor.signal.values / echo(1.5, {"VV": (1.0, 0)}))
    error = target["in_phase_uncertainty"].values / np.abs(target.amulor.signal.values)
    assert np.mean(np.abs(off) < 1.96 * error) > 0.9


def test_two_surfaces_in_a_beam_are_no_single_echo(plate: xr.Dataset) -> None:
    cube = spotted(plate)
    second = np.zeros((1, 1, 8, 12))
    second[..., 2:4, 3:5] = 0.5
    cube = changed(cube, second * echo(1.0, CHANNELS))
    target = rejection.polarization_difference(cube, interval=(0.5, 2.5))
    both = second[0, 0] > 0
    assert flagged(target)[both].all()
    assert flagged(target)[~both].mean() < 0.05


def test_shots_give_the_fluctuation_of_the_water(by_hand: Make) -> None:
    cube = spotted(
        by_hand(5, frequency=FREQUENCY, channels=CHANNELS, shape=(8, 12), water=0.5)
    )
    steady = rejection.polarization_difference(cube, interval=(0.5, 2.5))
    rng = np.random.default_rng(3)
    for name in ("open_water_in_phase", "open_water_quadrature"):
        cube[name].values *= 1 + 0.2 * rng.standard_normal(cube[name].shape)
    unsteady = rejection.polarization_difference(cube, interval=(0.5, 2.5))
    name = "phase_uncertainty_fluctuation"
    # Two channels with 20 % of a ratio of 0.1 over the contrast of 0.2, of water that
    # is half the echo at 10 MHz.
    assert name in unsteady
    size = np.median(unsteady[name].values[0])
    turn = np.abs(np.sin(np.angle(1 / (1 - 1j / 3) / echo(1.5, CHANNELS)[0, 0, 0, 0])))
    expected = np.sqrt(2) * 0.2 * 0.5 * 0.5 * np.abs(1 / (1 - 1j / 3)) * turn
    assert 0.5 < size / expected < 3.5  # dark spots have three times the effect
    if name in steady:
        assert np.median(steady[name].values[0]) < size / 3


def test_rows_give_the_result_of_the_whole_scan(plate: xr.Dataset) -> None:
    cube = spotted(plate)
    method = rejection.load("polarization-difference")
    whole = method(cube, interval=(0.5, 2.5))
    of = method.fit(tiles.InMemory(cube), interval=(0.5, 2.5))
    part = of(cube.isel(row=slice(3, 6)), 3)
    for name in ("in_phase", "quadrature_uncertainty", "quality_flag"):
        np.testing.assert_array_equal(
            part[name].values, whole[name].values[:, :, 3:6], err_msg=name
        )


def test_scans_that_polarization_cannot_separate_are_refused(
    by_hand: Make, plate: xr.Dataset
) -> None:
    cube = spotted(plate)
    with pytest.raises(CubeError, match="the cube has one modulation frequency"):
        rejection.polarization_difference(cube.isel(modulation_frequency=[2]))
    with pytest.raises(CubeError, match="needed are 12 to estimate the ratio"):
        rejection.polarization_difference(cube.isel(row=[0], column=slice(0, 8)))
    with pytest.raises(CubeError, match="polarization cannot separate them"):
        rejection.polarization_difference(
            cube, water_ratio=0.3, water_ratio_uncertainty=0.01
        )
    with pytest.raises(ValueError, match="water_ratio must lie between 0 and 1"):
        rejection.polarization_difference(cube, water_ratio=1.2)
    with pytest.raises(ValueError, match="ratio_spread and model_error must be above"):
        rejection.polarization_difference(cube, model_error=0.0)
    shots = by_hand(6, frequency=FREQUENCY, channels=CHANNELS, shape=(8, 12))
    for name in ("open_water_in_phase", "open_water_quadrature"):
        shots[name].values[:] = np.nan
    with pytest.raises(CubeError, match="shots have no number in both channels"):
        rejection.polarization_difference(spotted(shots))


# Light of photon transport, with polarization of all orders of scattering -----------


def light(water: str, distance: float, kind: str) -> np.ndarray:
    """Return light behind both analyzers, shape (frequency, channel)."""
    with TABLE.open(encoding="utf-8") as file:
        rows = [
            complex(float(row["real"]), float(row["imaginary"]))
            for row in csv.DictReader(file)
            if row["water"] == water
            and float(row["distance_m"]) == distance
            and row["light"] == kind
        ]
    return np.array(rows).reshape(2, 4).T


def scene(
    water: str, distance: float, seed: int, noise: float, paint: float
) -> xr.Dataset:
    """Return samples of a spotted plate; noise relative to the bright echo."""
    rng = np.random.default_rng(seed)
    shape = (12, 20)
    spots = rng.integers(0, 2, (6, 10)).repeat(2, 0).repeat(2, 1)
    echoes, haze = (
        light(water, distance, kind)[:, :, None, None] for kind in ("target", "water")
    )
    bright = echoes * np.where(spots, 1 / 3, 1.0)
    bright[:, 1, :, 10:] *= paint
    clean = (bright + haze) / abs(echoes[0, 0, 0, 0])
    error = rng.normal(0, noise, (2, *clean.shape))
    stated = np.full(clean.shape, noise)
    return cubes.build(
        "samples",
        {
            "in_phase": clean.real + error[0],
            "quadrature": clean.imag + error[1],
            "in_phase_uncertainty": stated,
            "quadrature_uncertainty": stated,
            "saturated": np.zeros(clean.shape, np.int8),
        },
        {
            "modulation_frequency": np.array(FREQUENCY),
            "polarization": ["VV", "VH"],
            "azimuth": np.zeros(shape),
            "elevation": np.zeros(shape),
        },
        geometry={
            "group_index": 1.38,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.array([0.2, 0, 0]),
        },
        attributes=cubes.attributes(
            "samples", title="plate", source="photon transport", late_echo="absent"
        ),
    )


def scores(
    water: str, distance: float, seed: int, noise: float = 3e-3, paint: float = 1.0
) -> np.ndarray:
    """Return range errors of the pixels without a flag, in standard uncertainties.

    The truth is the range of the co-polarized echo without water signal. Half of the
    plate has another paint, whose ratio is larger by a factor.
    """
    interval = (distance - 0.5, distance + 0.6)
    cube = scene(water, distance, seed, noise, paint)
    image = imaging.range_image(
        rejection.polarization_difference(cube, interval=interval), interval=interval
    )
    echoes = light(water, distance, "target")[:, :1, None, None]
    pure = cube.isel(polarization=[0], row=[0], column=[0]).copy(deep=True)
    pure["in_phase"].values = echoes.real / abs(echoes[0])
    pure["quadrature"].values = echoes.imag / abs(echoes[0])
    true = imaging.range_image(rejection.keep_water(pure), interval=interval)
    error = image["slant_range"].values - true["slant_range"].values
    score = error / image["slant_range_uncertainty"].values
    good = (image["quality_flag"].values & QualityFlag.WATER_RESIDUAL) == 0
    assert good.mean() > 0.9
    return score[good & np.isfinite(score)]


def test_crossed_light_of_water_comes_later() -> None:
    # The delay grows with the orders of scattering: 0.04 ns in coastal water and 0.4 ns
    # in harbor water. Without it a real ratio would be right.
    delay = {
        water: np.angle(np.divide(*light(water, distance, "water")[0, ::-1]))
        / (2 * np.pi * FREQUENCY[0])
        for water, distance in (("coastal", 2.5), ("harbor", 1.37))
    }
    assert 0 < delay["coastal"] < 0.1e-9 < 0.3e-9 < delay["harbor"] < 0.6e-9


def range_of(signal: np.ndarray, distance: float) -> float:
    """Return the range of the best echo of equal amplitude, without noise."""
    wave = 2 * np.pi * np.array(FREQUENCY) * 1.38 / 299792458.0
    grid = np.arange(2 * distance - 1, 2 * distance + 1, 1e-4)
    match = (signal @ np.exp(-1j * np.outer(wave, grid))).real
    return float(grid[match.argmax()] / 2)


def test_simpler_differences_leave_the_bias_of_the_page() -> None:
    # The row of harbor water at 1.37 m in docs/theory/rejection.md.
    target, water, open_water = (
        light("harbor", distance, kind)
        for distance, kind in ((1.37, "target"), (1.37, "water"), (0.0, "water"))
    )
    parallel, crossed = (target + water).T
    ratio = (open_water[0, 1] / open_water[0, 0]).real
    signals = (parallel, crossed, parallel - crossed, crossed - ratio * parallel)
    true = range_of(target[:, 0], 1.37)
    biases = [1e3 * (range_of(signal, 1.37) - true) for signal in signals]
    np.testing.assert_allclose(biases, [-11.8, -2.6, -14.8, 1.0], atol=0.15)


@pytest.mark.parametrize(
    ("water", "distance"), [("harbor", 1.37), ("coastal", 2.5), ("milk", 1.5)]
)
def test_light_of_photon_transport_is_inside_the_intervals(
    water: str, distance: float
) -> None:
    found = scores(water, distance, 11)
    # One scan: all pixels share the error of the ratios.
    assert np.mean(np.abs(found) < 1.96) > 0.85
    assert np.abs(found).max() < 5


@pytest.mark.parametrize("paint", [0.7, 2.0])
def test_a_second_paint_widens_the_intervals(paint: float) -> None:
    found = np.concatenate(
        [scores("harbor", 1.37, seed, paint=paint) for seed in (1, 2)]
    )
    assert np.mean(np.abs(found) < 1.96) > 0.9
    assert np.abs(found).max() < 5


@pytest.mark.study
@pytest.mark.parametrize(
    ("water", "distance", "least"),
    [
        ("coastal", 2.5, 0.93),
        ("harbor", 0.91, 0.93),
        ("harbor", 1.37, 0.93),
        # The prior of the ratios is wider than their true differences.
        ("harbor", 2.28, 0.95),
        ("milk", 1.5, 0.93),
        ("strong milk", 1.5, 0.93),
    ],
)
def test_intervals_contain_the_truth_in_many_scans(
    water: str, distance: float, least: float
) -> None:
    found = np.concatenate([scores(water, distance, seed) for seed in range(30)])
    inside = float(np.mean(np.abs(found) < 1.96))
    print(f"{water} {distance} m: {inside:.3f}")
    assert least < inside < least + 0.05


@pytest.mark.slow
@pytest.mark.parametrize("water", ["harbour-object-3-lengths", "coastal-object"])
def test_intervals_hold_where_neighbors_are_open_water(water: str) -> None:
    # An object with spots, and one without, of which nothing shows the ratio.
    scene = next(scene for scene in scenes.read() if scene.name == water)
    spots = scene.model_copy(update={"texture": True, "seed": 202})
    row = table.row_of(spots, "polarization-difference", spots.case())
    assert row.trusted > 0.9
    assert row.phantoms == 0
    # 60 pixels that share errors of the ratios.
    assert row.inside_95 > 0.95
    assert row.worst < 3
    plain = table.row_of(scene, "polarization-difference", scene.case())
    assert plain.trusted == 0
    assert "neighboring target pixels of one distance do not differ" in plain.note
