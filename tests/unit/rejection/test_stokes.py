"""The method stokes: closed forms, wrong matrices, coverage of uncertain ones."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import xarray as xr

from amulor import pipeline, rejection
from amulor.cube import QualityFlag, tiles
from amulor.cube.schema import WaterResidualCause
from amulor.errors import CubeError
from amulor.optics.polarization import mueller
from amulor.simulation import simulate
from amulor.survey import Survey

Make = Callable[..., xr.Dataset]
FREQUENCY = [20e6, 80e6]
TARGET, WATER = (0.61, -0.61, -0.46), (0.81, -0.81, -0.62)


def shares(
    pairs: list[str],
    target: tuple[float, ...] = TARGET,
    water: tuple[float, ...] = WATER,
) -> dict[str, tuple[float, float]]:
    """Return parts of the launched power behind the analyzers, in units of 0.5."""
    return {
        pair: tuple(
            2 * float(mueller.detected_fraction(mueller.diagonal(*part), pair=pair))
            for part in (target, water)
        )
        for pair in pairs
    }


def turns(target: xr.Dataset) -> np.ndarray:
    """Return errors of the phases of a plate at 1.5 m [rad]."""
    phase = 4 * np.pi * np.array(FREQUENCY) * 1.38 * 1.5 / 299792458.0
    return np.angle(
        target.amulor.signal.values * np.exp(-1j * phase)[:, None, None, None]
    )


def errors_of(target: xr.Dataset) -> np.ndarray:
    """Return the stated error of the output across the echo, over its amplitude."""
    size = np.hypot(target["in_phase"], target["quadrature"]).values
    turn = np.angle(target.amulor.signal.values)
    a, b = (target[f"{name}_uncertainty"].values for name in ("in_phase", "quadrature"))
    cross = target["in_phase_quadrature_covariance"].values
    square = (b * np.cos(turn)) ** 2 + (a * np.sin(turn)) ** 2
    return np.sqrt(square - 2 * cross * np.sin(turn) * np.cos(turn)) / size


def misfits(target: xr.Dataset) -> np.ndarray:
    """Return the mask of pixels that contradict the matrices."""
    cause = target["water_residual_cause"].values & WaterResidualCause.MODEL_MISFIT
    residual = target["quality_flag"].values & QualityFlag.WATER_RESIDUAL
    return ((cause != 0) & (residual != 0)).all(axis=(0, 1))


def unmixed(cube: xr.Dataset, **options: float) -> xr.Dataset:
    """Return the target signal by the matrices of this file."""
    return rejection.unmix_stokes(
        cube, target_mueller=TARGET, water_mueller=WATER, **options
    )


@pytest.mark.parametrize(
    "pairs", [["RR", "RL", "RV"], ["VV", "VH", "RR", "RL"], ["VV", "VH", "VP", "VR"]]
)
def test_matrices_that_are_right_leave_no_water_and_few_false_alarms(
    by_hand: Make, pairs: list[str]
) -> None:
    cube = by_hand(
        3,
        frequency=FREQUENCY,
        channels=shares(pairs),
        shape=(40, 50),
        water=0.5,
        shots=0,
    )
    target = unmixed(cube, mueller_uncertainty=1e-9)
    score = turns(target) / errors_of(target)
    assert np.mean(np.abs(score) < 1.96) == pytest.approx(0.95, abs=0.015)
    assert misfits(target).mean() < 0.004  # 2,000 pixels, 1 of 1,000 by chance
    assert target.attrs["mueller_tested"] == (pairs[2] == "RR")


def test_linear_and_circular_light_contradict_another_water(by_hand: Make) -> None:
    both = shares(["VV", "VH", "RR", "RL"], water=(0.81, -0.81, -0.3))
    cube = by_hand(3, frequency=FREQUENCY, channels=both, water=0.5, shots=0)
    assert misfits(unmixed(cube)).all()
    assert not misfits(unmixed(cube, mueller_uncertainty=0.4)).any()
    # One launched state gives another mixture, and the range is wrong.
    alone = unmixed(cube, launched="R")
    assert alone.attrs["mueller_tested"] == 0
    assert not misfits(alone).any()
    assert np.abs(turns(alone).mean(axis=(2, 3))).max() > 0.02


def test_an_analyzer_that_leaks_is_noticed(by_hand: Make) -> None:
    leaking = shares(["RR", "RL", "RV"]) | {"RV": (1.4, 1.0)}
    cube = by_hand(3, frequency=FREQUENCY, channels=leaking, water=0.5, shots=0)
    assert misfits(unmixed(cube)).all()


def test_intervals_hold_for_matrices_within_their_uncertainty(by_hand: Make) -> None:
    rng = np.random.default_rng(8)
    scores = []
    for seed in range(150):
        true = [
            tuple(np.array(part) + rng.normal(0, 0.03, 3)) for part in (TARGET, WATER)
        ]
        cube = by_hand(
            seed,
            frequency=FREQUENCY,
            channels=shares(["VV", "VH", "RR", "RL"], *true),
            shape=(3, 4),
            water=0.5,
            shots=0,
        )
        target = unmixed(cube, mueller_uncertainty=0.03)
        scores.append((turns(target) / errors_of(target)).mean(axis=(1, 2, 3)))
    # The matrices are common to all pixels: one number for each scan and frequency.
    inside = np.mean(np.abs(scores) < 1.96, axis=0)
    assert (inside > 0.9).all()
    assert 0.6 < np.std(scores) < 1.15
    assert misfits(target).mean() < 0.1


def test_the_survey_states_the_matrices_and_circular_light_finds_the_range() -> None:
    survey = Survey.preset("amulor-2010").with_(
        {
            "instrument.polarizations": ["RR", "RL", "VV", "VH"],
            "instrument.modulation_frequencies": ["20 MHz", "80 MHz"],
            "scan.rows": 4,
            "scan.columns": 5,
        }
    )
    cube = simulate(survey, rng=2)
    target = rejection.reject(cube, method="stokes", interval=(0.5, 2.5))
    assert target.attrs["mueller_tested"] == 1
    assert misfits(target).mean() < 0.1
    image = pipeline.run(target, polarization="RR", interval=(0.5, 2.5))
    error = image["slant_range"] - image["truth_slant_range"]
    score = (error / image["slant_range_uncertainty"]).values
    assert np.mean(np.abs(score) < 1.96) > 0.9


def test_rows_give_the_result_of_the_whole_scan(by_hand: Make) -> None:
    cube = by_hand(
        5, frequency=FREQUENCY, channels=shares(["VV", "VH", "RR", "RL"]), shape=(8, 6)
    )
    method = rejection.load("stokes")
    options = {"target_mueller": TARGET, "water_mueller": WATER}
    whole = method(cube, **options)
    part = method.fit(tiles.InMemory(cube), **options)(cube.isel(row=slice(3, 6)), 3)
    for name in ("in_phase", "quadrature_uncertainty", "quality_flag"):
        np.testing.assert_array_equal(
            part[name].values, whole[name].values[:, :, 3:6], err_msg=name
        )


def test_missing_matrices_and_wrong_options_are_refused(by_hand: Make) -> None:
    cube = by_hand(3, frequency=FREQUENCY, channels=shares(["VV", "VH"]), shots=0)
    with pytest.raises(CubeError, match="no target with a Mueller matrix"):
        rejection.unmix_stokes(cube)
    with pytest.raises(CubeError, match="no survey with the Mueller matrix"):
        rejection.unmix_stokes(cube, target_mueller=TARGET)
    with pytest.raises(ValueError, match="must be three elements or have shape"):
        rejection.unmix_stokes(cube, target_mueller=TARGET, water_mueller=np.eye(3))
    with pytest.raises(ValueError, match="must lie from 0 to below 1"):
        unmixed(cube, mueller_uncertainty=1.0)
    with pytest.raises(CubeError, match="the channels VV; unmixing needs two or more"):
        unmixed(cube.sel(polarization=["VV"]))
