"""Claims about milk at any wavelength: spheres against what was measured."""

from __future__ import annotations

import pytest
from numpy.testing import assert_allclose

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
