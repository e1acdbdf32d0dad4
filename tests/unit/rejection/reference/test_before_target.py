"""Unmixing states errors by a water that its own error does not make small."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor import cube as cubes
from amulor import imaging, rejection, samples
from amulor.rejection.reference.before_target import (
    _chi_square,
    _fit,
    _minimum,
    _near_minimum,
    raised_to_median_amplitude,
)
from amulor.simulation import simulate
from amulor.studies.trust.surveys import plate, survey


def test_what_is_below_the_median_is_made_as_large_and_keeps_its_phase() -> None:
    size = np.array([[0.0, 0.1, 1.0, 2.0, 5.0]])
    water = (size * np.exp(1j * np.arange(5)))[None, None]
    found, _ = raised_to_median_amplitude(water)
    assert_allclose(np.abs(found[0, 0, 0]), [0, 1, 1, 2, 5], rtol=1e-12)
    assert_allclose(np.angle(found[0, 0, 0, 1:]), np.angle(water[0, 0, 0, 1:]))


def test_errors_do_not_shrink_where_the_water_came_out_small() -> None:
    cube = samples.cube("ladder").isel(row=[18], column=slice(20, 40))
    cube = cubes.without_groups(cube, "truth", "open_water").copy(deep=True)
    known = {
        "target_ratio": 0.242,
        "water_ratio": 0.099,
        "water_fluctuation": 0.137,
    }
    plain = rejection.polarization(cube, **known)
    water = cube.amulor.signal.values[0, 0] - plain.amulor.signal.values[0, 0]
    # The co-polarized water of one pixel is 20 % less, the other 52 % more: the target
    # takes half of the water, and three tenths are left of it.
    for channel, change in ((0, -0.2), (1, (0.5 * 0.143 / 0.099 - 0.2) * 0.099)):
        for part, off in (("in_phase", water.real), ("quadrature", water.imag)):
            cube[part].values[0, channel, 0, 7] += change * off[0, 7]
    found = rejection.polarization(cube, **known)
    left = cube.amulor.signal.values[0, 0] - found.amulor.signal.values[0, 0]
    assert abs(left[0, 7]) < 0.35 * abs(water[0, 7])
    stated = [
        np.hypot(one["in_phase_uncertainty"], one["quadrature_uncertainty"]).values
        for one in (plain, found)
    ]
    # It was 0.3 of what it had been.
    assert stated[1][0, 0, 0, 7] > 0.7 * stated[0][0, 0, 0, 7]


def test_the_column_is_that_of_the_corrected_distance() -> None:
    # A dim plate in harbour water with the receiver far aside: the column behind it
    # turns the phase. With one pass the ranges are 0.4 mm off (root mean square).
    distance = 2.0
    described = survey(
        4,
        plate(distance, lean=20, reflectance=0.02),
        water="harbour",
        baseline=40,
        azimuth=-float(np.degrees(np.arctan(0.4 / distance))),
        fluctuation=0.0,
        columns=8,
        rows=4,
        shot_columns=5,
        repeats=40,
    )
    cube = simulate(described, rng=1)
    truth = cube.amulor.truth["slant_range"].values
    for part in ("in_phase", "quadrature"):
        light = cube[f"truth_target_{part}"].values + cube[f"truth_water_{part}"].values
        cube[part].values[:] = light
    interval = (distance - 0.5, distance + 0.5)
    target = rejection.open_water(
        cubes.without_groups(cube, "truth"), interval=interval
    )
    image = imaging.range_image(target, polarization="VV", interval=interval)
    off = image["slant_range"].values - image["slant_range_bias"].values - truth
    assert np.sqrt(np.mean(off**2)) < 0.15e-3


@pytest.mark.parametrize("lowest", [0.3, 7.4, 24.0, 24.6, 47.8])
def test_the_minimum_of_a_parabola_is_found_from_three_of_its_values(lowest) -> None:
    square = 3.0 * (np.arange(49.0) - lowest) ** 2 + 11.0
    place, value, curvature = _minimum(square)
    # A parabola through three values is the parabola; its second difference is 6.
    assert_allclose([place, value, curvature], [lowest, 11, 6], rtol=1e-9)


def test_a_minimum_outside_of_the_factors_is_at_their_end() -> None:
    assert_allclose(_minimum((np.arange(49.0) + 5) ** 2)[0], 0.0)
    assert _minimum(np.zeros(49)) == (0.0, 0.0, 0.0)
    # Chi-square is never below zero, however far the parabola goes.
    assert _minimum(np.array([1.0, 0.01, 0.04, 1.0]))[1] == 0.0


@pytest.mark.parametrize("lowest", [0.26, 0.9, 1.0, 3.9])
def test_few_factors_are_evaluated_and_the_lowest_has_its_neighbours(lowest) -> None:
    tried = []

    def chi_square(factor: float) -> float:
        tried.append(factor)
        return float(np.log(factor / lowest) ** 2)

    values = _near_minimum(chi_square)
    # 49 factors from a quarter to four, evenly spaced in the logarithm.
    expected = np.log(0.25 * 16 ** (np.arange(49) / 48) / lowest) ** 2
    best = int(values.argmin())
    assert best == np.argmin(expected)
    around = slice(max(best - 1, 0), best + 2)
    assert_allclose(values[around], expected[around])
    assert len(tried) == len(set(tried)) < 25


def test_the_strength_of_each_channel_is_fitted_and_not_negative() -> None:
    model = np.array([1.0, 1j])
    # The first channel is twice the model and 0.5 off in a direction that no multiple
    # has; the second one points away from the model.
    measured = np.stack([2 * model + np.array([0.5j, 0]), -model], axis=1)
    weight = np.array([[4.0, 1.0], [4.0, 3.0]])
    assert_allclose(_chi_square(model, measured, weight), 4 * 0.25 + 1 + 3)


def test_change_and_paths_are_those_of_one_least_squares_fit() -> None:
    # Dense: a column for the change, and one for the path of each of five pixels.
    rng = np.random.default_rng(8)
    shape = (3, 2, 5)
    wavenumber = rng.uniform(1, 3, (3, 1, 1))
    turn, phase = rng.standard_normal((2, *shape))
    weight = rng.uniform(0.5, 2, shape)
    design = np.zeros((30, 6))
    design[:, 0] = turn.ravel()
    for pixel in range(5):
        column = np.zeros(shape)
        column[..., pixel] = wavenumber[..., 0]
        design[:, 1 + pixel] = column.ravel()
    root = np.sqrt(weight.ravel())
    matrix = np.linalg.pinv(design * root[:, None]) * root
    expected = matrix @ phase.ravel()
    fit = _fit(phase, turn, wavenumber, weight)
    assert_allclose(fit.change, expected[0])
    assert_allclose(fit.path, expected[1:])
    assert_allclose(fit.gain.ravel(), matrix[0], atol=1e-12)
    # Turns that a path explains tell nothing of the change, and no weight nothing.
    assert _fit(phase, 0 * turn, wavenumber, weight) is None
    assert _fit(phase, turn, wavenumber, 0 * weight) is None
