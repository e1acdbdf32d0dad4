"""Steps of outputs: values of a grid, noise beside it, and the error that is added."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube.error import OUTPUT_STEP, OUTPUT_STEP_RATIO
from amulor.rejection import resolution
from amulor.rejection.observation import Observation
from amulor.rejection.resolution import Resolution, resolution_of, with_resolution

Make = Callable[..., xr.Dataset]


def rounded(make: Make, step: float, noise: float, *, shots: int = 8) -> xr.Dataset:
    """Return samples and shots in multiples of a step, with a stated noise."""
    cube = make(
        frequency=[20e6, 50e6], channels={"VV": (1.0, 1.0)}, shape=(6, 8), shots=shots,
        noise=0.05, water=0.4,
    )  # fmt: skip
    for name in cube.data_vars:
        if str(name).endswith(("in_phase", "quadrature")):
            cube[name].values[:] = step * np.round(cube[name].values / step)
        elif "uncertainty" in str(name):
            cube[name].values[:] = noise
    return cube


@pytest.mark.parametrize(("ratio", "coarse"), [(0.49, False), (0.51, True)])
def test_a_step_counts_from_half_of_the_noise_on(
    by_hand: Make, ratio: float, coarse: bool
) -> None:
    noise = 0.05
    cube = rounded(by_hand, ratio * noise, noise)
    found = resolution_of(Observation(cube=cube))
    assert found.is_coarse == coarse
    expected = ratio * noise if coarse else 0.0
    assert_allclose(found.scan, np.full((2, 1), expected), rtol=1e-6)
    assert found.shots is not None
    assert_allclose(found.shots, np.full((2, 1), expected), rtol=1e-6)
    bare = resolution_of(Observation(cube=rounded(by_hand, ratio * noise, noise,
                                                  shots=0)))  # fmt: skip
    assert bare.shots is None
    assert bare.is_coarse == coarse
    cube["in_phase_uncertainty"].values[:] = 0.0
    assert not np.any(resolution_of(Observation(cube=cube)).scan)


def test_a_resolution_is_coarse_if_any_step_is() -> None:
    none, some = np.zeros((2, 1)), np.array([[0.0], [0.1]])
    assert not Resolution(scan=none, shots=None).is_coarse
    assert not Resolution(scan=none, shots=none).is_coarse
    assert Resolution(scan=some, shots=None).is_coarse
    assert Resolution(scan=none, shots=some).is_coarse


def test_shots_of_few_values_have_the_step_of_the_pixels(by_hand: Make) -> None:
    cube = rounded(by_hand, 0.04, 0.05)
    # Two values of each output tell no step; one frequency lies off the grid.
    for name in ("open_water_in_phase", "open_water_quadrature"):
        cube[name].values[:] = 0.04 * (np.arange(8) % 2)
        cube[name].values[1] += 0.013
    found = resolution_of(Observation(cube=cube))
    assert found.shots is not None
    assert_allclose(found.shots, [[0.04], [0.0]], rtol=1e-6)


@pytest.mark.parametrize(
    ("values", "step"),
    [
        # Six values at least.
        ([0, 1, 2, 3, 4], 0.0),
        ([0, 1, 2, 3, 4, 5], 1.0),
        ([0.3, 1.3, 2.3, 5.3, 6.3, 9.3], 1.0),
        ([0, 0.25, 1, 1.5, 4, 5], 0.25),
        # Equal to a millionth of the largest.
        ([0, 1, 1 + 1e-7, 2, 3, 4], 0.0),
        # Off a grid by some hundredths.
        ([0, 1, 2.05, 3, 3.95, 5], 0.0),
        ([0, 1, 2.005, 3, 3.995, 5], 1.0),
    ],
)
def test_a_step_is_that_of_all_values(values: list[float], step: float) -> None:
    assert resolution.step_of(np.array(values)) == pytest.approx(step, rel=1e-3)


def test_rounding_adds_a_step_over_the_root_of_twelve(by_hand: Make) -> None:
    cube = rounded(by_hand, 0.04, 0.05)
    steps = np.array([[0.04], [0.0]])
    # Noise of the shots is below half of the step at the first frequency only.
    cube["open_water_in_phase_uncertainty"].values[0] = 0.019
    scan = Observation(cube=cube)
    found = with_resolution(scan, Resolution(scan=steps, shots=2 * steps)).cube
    error = 0.04 / np.sqrt(12)
    for name in ("in_phase_uncertainty", "quadrature_uncertainty"):
        values = found[name].values
        assert_allclose(values[0], np.hypot(0.05, error))
        assert_allclose(values[1], 0.05)
    values = found["open_water_in_phase_uncertainty"].values
    assert_allclose(values[0], np.hypot(0.019, 2 * error))
    assert_allclose(values[1], 0.05)
    for name in ("in_phase", "quadrature"):
        shared = found[f"open_water_common_{name}_uncertainty"]
        assert_allclose(shared.values, [[2 * error], [0.0]])
        assert shared.dims == ("modulation_frequency", "polarization")
        assert shared.attrs["units"] == "V"
        assert shared.attrs["long_name"] == (
            "error that all shots share, from the resolution of the outputs"
        )
    assert_array_equal(found["open_water_common_covariance"].values, 0.0)
    assert found["open_water_common_covariance"].attrs["units"] == "V2"
    assert found.attrs[OUTPUT_STEP] == pytest.approx(0.08)
    assert found.attrs[OUTPUT_STEP_RATIO] == pytest.approx(2 * error / 0.019)
    # It is added once, and to shared errors that are there before.
    again = Observation(cube=found)
    assert with_resolution(again, Resolution(scan=steps, shots=steps)) is again
    bare: Any = found.copy()
    bare.attrs.pop(OUTPUT_STEP)
    twice = with_resolution(
        Observation(cube=bare), Resolution(scan=steps, shots=2 * steps)
    ).cube
    shared = twice["open_water_common_in_phase_uncertainty"].values
    assert_allclose(shared, [[np.sqrt(2) * 2 * error], [0.0]])


def test_a_fine_resolution_changes_nothing(by_hand: Make) -> None:
    scan = Observation(cube=rounded(by_hand, 0.04, 0.05))
    none = np.zeros((2, 1))
    assert with_resolution(scan, Resolution(scan=none, shots=none)) is scan
    dithered = with_resolution(
        scan, Resolution(scan=none, shots=np.full((2, 1), 0.04))
    ).cube
    # Noise above half of the step makes the errors of repeats independent.
    shared = dithered["open_water_common_in_phase_uncertainty"].values
    assert_array_equal(shared, 0.0)
    assert_allclose(dithered["in_phase_uncertainty"].values, 0.05)
