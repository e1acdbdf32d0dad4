"""Unmixing states errors by a water that its own error does not make small."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from amulor import cube as cubes
from amulor import imaging, rejection, samples
from amulor.rejection.reference.before_target import raised_to_median_amplitude
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
