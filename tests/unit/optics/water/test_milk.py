"""Claims about milk at any wavelength: spheres against what was measured."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from amulor.optics.phase_functions.models import henyey_greenstein_function
from amulor.optics.water import milk

pytest.importorskip("miepython")


def suspension(wavelength=550e-9, *, fat, volume_fraction=1e-3, medium_index=1.337):
    return milk.milk_suspension(
        wavelength, volume_fraction=volume_fraction, fat=fat, medium_index=medium_index
    )


@pytest.mark.parametrize(
    ("fat", "lowest", "highest"), [(0.001, 1220 / 1.1, 1514), (0.035, 3210, 5829)]
)
def test_spheres_scatter_as_much_as_two_measurements_say(fat, lowest, highest):
    # Reduced scattering of undiluted milk in green light [1/m]: Jensen et al. 2001 and
    # Narasimhan et al. 2006, skim or low-fat, and whole or regular milk.
    added = suspension(fat=fat)
    reduced = added.scattering * (1 - added.phase_function.asymmetry)
    assert lowest < reduced / 1e-3 < highest


def test_twice_the_milk_scatters_twice_and_alike():
    one, two = (suspension(fat=0.015, volume_fraction=v) for v in (1e-4, 2e-4))
    assert_allclose(two.scattering, 2 * one.scattering, rtol=1e-12)
    assert_allclose(two.absorption, 2 * one.absorption, rtol=1e-9)
    assert two.phase_function.asymmetry == pytest.approx(one.phase_function.asymmetry)


def test_casein_alone_scatters_almost_as_molecules_and_fat_forwards():
    # Casein is far below the wavelength: blue over green goes as its fourth power.
    lean, fatty = suspension(fat=0.001), suspension(fat=0.05)
    assert lean.phase_function.asymmetry < 0.3 < 0.8 < fatty.phase_function.asymmetry
    blue = suspension(405e-9, fat=0.001).scattering
    assert 2.5 < blue / lean.scattering < (550 / 405) ** 4


@pytest.mark.parametrize(
    ("wavelength", "kind", "published"),
    [(620e-9, "skim", 700.0), (532e-9, "whole", 3210.0), (405e-9, "whole", 3770.0)],
)
def test_measured_milk_is_that_of_jensen_2001(wavelength, kind, published):
    assert milk.measured_milk(wavelength, kind=kind).reduced_scattering == published


def test_milk_that_nobody_measured_is_refused():
    with pytest.raises(ValueError, match="skim"):
        milk.measured_milk(532e-9, kind="goat")
    with pytest.raises(ValueError, match="fat"):
        suspension(fat=0.5)
    for index in (1.19, 1.51):
        with pytest.raises(ValueError, match="medium_index"):
            suspension(fat=0.035, medium_index=index)
    # The ends count.
    for index in (1.2, 1.5):
        assert suspension(fat=0.035, medium_index=index).scattering > 0


@pytest.mark.parametrize("width", [0.23, 0.6])
def test_sizes_are_log_normal_about_their_mean_of_volume_over_surface(width):
    radius, number = milk._log_normal(2e-7, width=width)
    assert radius.shape == number.shape == (48,)
    mean = np.sum(number * radius**3) / np.sum(number * radius**2)
    assert_allclose(mean, 2e-7, rtol=3e-3)
    # The relative width is the standard deviation over the mean of the radii.
    spread = np.sqrt(np.log(1 + width**2))
    assert_allclose(np.log(radius[-1] / radius[0]), (6 + 6 * spread) * spread)
    middle = np.log(2e-7) - 2.5 * spread**2
    assert_allclose(np.log(radius[0]), middle - 3 * spread)
    expected = np.exp(-(((np.log(radius) - middle) / spread) ** 2) / 2)
    assert_allclose(number, expected, rtol=1e-9)


def test_casein_has_a_largest_radius():
    radius, number = milk._casein_sizes()
    assert np.all(np.diff(radius) > 0)
    assert radius[-1] < 150e-9
    ratio = radius / (150e-9 - radius)
    mean = np.sum(number * ratio**3) / np.sum(number * ratio**2)
    assert_allclose(mean, 43 / 107, rtol=3e-3)


@pytest.mark.parametrize("number", [[1.0], [50.0]])
def test_small_spheres_of_a_volume_scatter_as_rayleigh_says(number):
    radius, volume, index, medium = 4e-9, 2e-4, 1.5, 1.33
    found = milk._spheres(
        np.array([radius]), np.array(number), volume=volume, index=index + 0j,
        light=(550e-9, medium),
    )  # fmt: skip
    size = 2 * np.pi * medium * radius / 550e-9
    m = index / medium
    section = 8 / 3 * np.pi * radius**2 * size**4 * ((m**2 - 1) / (m**2 + 2)) ** 2
    expected = volume / (4 / 3 * np.pi * radius**3) * section
    assert_allclose(found.scattering, expected, rtol=0.01)


def test_milk_is_so_much_fat_and_casein(monkeypatch):
    asked, means = [], []
    water = henyey_greenstein_function(asymmetry=0.5)

    def spheres(radius, number, **options):
        asked.append(options)
        share = len(asked)
        return SimpleNamespace(
            scattering=0.2 * share, extinction=0.25 * share, phase_function=water
        )

    def log_normal(mean, *, width):
        means.append((mean, width))
        return np.ones(2), np.ones(2)

    monkeypatch.setattr(milk, "_spheres", spheres)
    monkeypatch.setattr(milk, "_log_normal", log_normal)
    found = suspension(456.25e-9, fat=0.035, volume_fraction=2e-3)
    assert_allclose([found.scattering, found.absorption], [0.6, 0.15])
    assert found.phase_function.name == "Mie spheres of fat and casein, 3.5 % fat"
    fat, casein = asked
    # Masses of a litre of milk of 1030 g, over the densities.
    assert_allclose(fat["volume"], 2e-3 * 0.035 * 1.03 / 0.915)
    assert_allclose(casein["volume"], 2e-3 * 0.034 * 0.76 * 1.03 / 1.11)
    assert fat["light"] == casein["light"] == (456.25e-9, 1.337)
    assert casein["index"] == 1.503
    # A quarter of the way from 450 to 475 nm.
    assert_allclose([fat["index"].real, fat["index"].imag], [1.4695, 1.13e-5])
    # Radius in micrometers, for percents of fat.
    radius = 7.481403922e-4 * 3.5**2 + 3.203991829e-2 * 3.5 + 0.1162155667
    assert_allclose(means[0], (1e-6 * radius / 1.36, 0.6), rtol=1e-12)


@pytest.mark.parametrize(
    ("wavelength", "band"),
    [(400e-9, 3770.0), (499e-9, 3770.0), (500e-9, 3210.0), (599e-9, 3210.0)],
)
def test_bands_of_the_camera_begin_at_hundreds_of_nanometres(wavelength, band):
    assert milk.measured_milk(wavelength, kind="whole").reduced_scattering == band
