"""Claims about the named waters: types, stations, milk and Maalox."""

from __future__ import annotations

import csv
import dataclasses
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from amulor.optics.water import pure_water
from amulor.optics.water import types as water_types

REFERENCE = Path(__file__).parents[3] / "reference"
SOLONENKO, WILLIAMSON = water_types.JERLOV_SOURCES
MEASURED_TYPES = ["IB", "II", "III", "1C", "3C", "5C"]


def rows(name: str) -> list[list[str]]:
    lines = (REFERENCE / name).read_text(encoding="utf-8").splitlines()
    return list(csv.reader(line for line in lines if not line.startswith("#")))


@pytest.mark.parametrize("row", rows("jerlov_types.csv"), ids=lambda row: "-".join(row))
def test_jerlov_types_match_the_published_tables(row):
    source = (SOLONENKO, WILLIAMSON)[int(row[0])]
    water = water_types.jerlov(row[1], float(row[2]) * 1e-9, source=source)
    # Nodes of the tables, up to rounding of the wavelength.
    assert_allclose(water.absorption, float(row[3]), rtol=1e-9)
    assert_allclose(water.scattering, float(row[4]), rtol=1e-9)


def test_measured_types_carry_the_deviation_of_the_campaigns():
    water = water_types.jerlov("III", [412e-9, 532e-9], source=WILLIAMSON)
    # Williamson and Hollins (2022), standard deviations of 76 and 32 campaigns.
    assert_allclose(water.absorption_deviation, [0.031278, 0.0123531], rtol=1e-9)
    assert_allclose(water.scattering_deviation, [0.12043, 0.0942684], rtol=1e-9)
    # The curve passes the averages within the spread of the campaigns.
    averages = np.array([[0.127845, 0.0914363], [0.320384, 0.257939]])
    assert np.all(abs(water.absorption - averages[0]) < water.absorption_deviation)
    assert np.all(abs(water.scattering - averages[1]) < water.scattering_deviation)


@pytest.mark.parametrize(
    ("water_type", "last_nm"), [("IB", 555), ("II", 676), ("III", 715), ("5C", 715)]
)
def test_only_wavelengths_between_measured_averages_are_called_measured(
    water_type, last_nm
):
    nm = np.array([405, 411, 412, 500, last_nm, last_nm + 1])
    water = water_types.jerlov(water_type, nm * 1e-9, source=WILLIAMSON)
    expected = ["model", "model", "measured", "measured", "measured", "model"]
    assert_array_equal(water.status, expected)
    model = water.status == "model"
    assert_array_equal(np.isnan(water.absorption_deviation), model)
    assert_array_equal(np.isnan(water.scattering_deviation), model)


def test_what_was_fitted_to_diffuse_attenuation_is_called_a_model():
    water = water_types.jerlov("IB", [[300e-9, 450e-9, 700e-9]], source=SOLONENKO)
    assert_array_equal(water.status, [["model"] * 3])
    assert np.isnan(water.scattering_deviation).all()


def test_the_two_sources_differ_by_a_factor_of_several():
    one = water_types.jerlov("III", 400e-9, source=SOLONENKO)
    other = water_types.jerlov("III", 400e-9, source=WILLIAMSON)
    # 1.69 and 0.324 1/m are printed.
    assert_allclose(one.scattering / other.scattering, 1.69 / 0.324, rtol=1e-9)


@pytest.mark.parametrize("source", water_types.JERLOV_SOURCES)
def test_a_type_of_higher_number_is_more_turbid(source):
    types = ["IB", "II", "III"], ["1C", "3C", "5C"]
    for group in types:
        attenuation = []
        for water_type in group:
            water = water_types.jerlov(water_type, 450e-9, source=source)
            attenuation.append(float(water.absorption + water.scattering))
        assert attenuation == sorted(attenuation)


@settings(deadline=None)
@given(
    st.sampled_from(["I", "IA", "IB", "II", "III", "1C", "7C", "9C"]),
    st.integers(0, 11),
    st.floats(0.0, 1.0),
)
def test_types_are_linear_between_printed_wavelengths(water_type, step, share):
    start, width = 400e-9 + step * 25e-9, 25e-9
    nodes = water_types.jerlov(water_type, [start, start + width], source=SOLONENKO)
    water = water_types.jerlov(water_type, start + share * width, source=SOLONENKO)
    for found, ends in (
        (water.absorption, nodes.absorption),
        (water.scattering, nodes.scattering),
    ):
        # Rounding of the wavelength, 1e-16 of 1e-6 m over 25e-9 m, times the ends.
        expected = (1 - share) * ends[0] + share * ends[1]
        assert_allclose(found, expected, rtol=1e-11)


@settings(deadline=None)
@given(st.sampled_from(MEASURED_TYPES), st.floats(412e-9, 555e-9))
def test_no_water_absorbs_less_than_pure_water(water_type, wavelength):
    pure = pure_water.mason_absorption(wavelength, temperature=20, salinity=0)
    water = water_types.jerlov(water_type, wavelength, source=WILLIAMSON)
    assert water.absorption > pure


def test_a_jerlov_source_has_to_be_chosen():
    with pytest.raises(TypeError, match="source"):
        water_types.jerlov("III", 405e-9)
    with pytest.raises(ValueError, match="one has to be chosen"):
        water_types.jerlov("III", 405e-9, source="jerlov")


@pytest.mark.parametrize(
    ("water_type", "wavelength", "source", "text"),
    [
        ("IV", 405e-9, SOLONENKO, "water_type must be one of I, IA, IB"),
        ("I", 405e-9, WILLIAMSON, "water_type must be one of IB, II, III"),
        ("III", 701e-9, SOLONENKO, "wavelength must be from 3e-07 to 7e-07"),
        ("3C", 675e-9, SOLONENKO, "wavelength must be from 3e-07 to 6.5e-07"),
        ("5C", 600e-9, SOLONENKO, "wavelength must be from 3e-07 to 5.75e-07"),
        ("III", 405.0, WILLIAMSON, "wavelength must be from 3e-07 to 8e-07"),
        ("III", np.nan, WILLIAMSON, "wavelength must be from"),
    ],
)
def test_types_and_wavelengths_that_a_source_lacks_are_refused(
    water_type, wavelength, source, text
):
    with pytest.raises(ValueError, match=text):
        water_types.jerlov(water_type, wavelength, source=source)


@pytest.mark.parametrize("row", rows("petzold_1972_coefficients.csv"))
def test_petzold_stations_match_the_report(row):
    station = water_types.petzold_station(row[0])
    found = (
        station.attenuation,
        station.scattering,
        station.absorption,
        station.backscatter_fraction,
    )
    assert found == tuple(map(float, row[1:]))
    # Absorption is attenuation less scattering, in the three decimals printed.
    assert_allclose(found[0] - found[1], found[2], rtol=0, atol=1e-9)
    assert (station.wavelength, station.status) == (530e-9, "measured")


def test_every_petzold_station_has_its_name():
    names = tuple(row[0] for row in rows("petzold_1972_coefficients.csv"))
    assert names == water_types.PETZOLD_STATIONS
    with pytest.raises(ValueError, match="name must be one of AUTEC 7, AUTEC 8"):
        water_types.petzold_station("AUTEC 6")


def test_petzold_median_angles_are_in_radians():
    # 2.152 to 6.252 degrees in the report.
    angles = [
        water_types.petzold_station(name).median_angle
        for name in water_types.PETZOLD_STATIONS
    ]
    assert_allclose(np.degrees([min(angles), max(angles)]), [2.152, 6.252], rtol=1e-12)


@pytest.mark.parametrize(
    ("fat", "per_millimetre", "asymmetry"),
    [(0.001, 3.4, 0.25), (0.015, 12.5, 0.63), (0.035, 37, 0.80)],
)
def test_milk_has_the_scattering_of_the_particle_model(fat, per_millimetre, asymmetry):
    undiluted = water_types.milk(1, fat=fat)
    assert_allclose(undiluted.scattering, per_millimetre * 1e3, rtol=1e-12)
    assert undiluted.asymmetry == asymmetry
    assert undiluted.uncertainty_factor == 1.5
    assert (undiluted.wavelength, undiluted.status) == (405e-9, "model")


def test_milk_lies_near_what_was_measured_of_undiluted_milk():
    # Reduced scattering in the blue band of a camera, some 450 nm: 1.9 per mm for skim
    # milk and 3.77 for whole milk (Jensen et al. 2001), 7.136 for regular milk
    # (Narasimhan et al. 2006). At 405 nm it is larger, by (450/405)^3 = 1.37 if all
    # particles were small; a factor of 1.5 is stated beside the number.
    skim, whole = (water_types.milk(1, fat=fat) for fat in (0.001, 0.035))
    reduced = [(1 - milk.asymmetry) * milk.scattering for milk in (skim, whole)]
    assert 1900 / 1.5 < reduced[0] < 1900 * 1.37 * 1.5
    assert 3770 / 1.5 < reduced[1] < 7136 * 1.37 * 1.5


def test_no_milk_adds_no_scattering():
    assert water_types.milk(0, fat=0.015).scattering == 0


@settings(deadline=None)
@given(st.floats(0.0, 0.5), st.sampled_from([0.001, 0.015, 0.035]))
def test_milk_scatters_in_proportion_to_its_volume(share, fat):
    once, twice = water_types.milk([share, 2 * share], fat=fat).scattering
    assert_allclose(twice, 2 * once, rtol=1e-15)


@pytest.mark.parametrize(
    ("share", "fat", "text"),
    [
        (-1e-3, 0.015, "volume_fraction must be from 0 to 1"),
        (1.5, 0.015, "volume_fraction must be from 0 to 1"),
        (1e-3, 1.5, r"fat must be one of 0\.001, 0\.015, 0\.035"),
        (1e-3, 0.02, r"fat must be one of 0\.001, 0\.015, 0\.035"),
    ],
)
def test_milk_that_is_not_known_is_refused(share, fat, text):
    with pytest.raises(ValueError, match=text):
        water_types.milk(share, fat=fat)


def test_of_maalox_the_dose_is_known_and_nothing_else():
    # 0.1 ml in 27 litre is 3.7e-6 (Ricci et al. 2010), two digits.
    assert_allclose(water_types.MAALOX_VOLUME_FRACTION, 3.7e-6, rtol=0.01)
    named = [name for name in water_types.__all__ if "maalox" in name.lower()]
    assert named == ["MAALOX_VOLUME_FRACTION"]


def test_results_cannot_be_changed():
    for result in (
        water_types.petzold_station("AUTEC 8"),
        water_types.milk(1e-3, fat=0.015),
        water_types.jerlov("III", 405e-9, source=WILLIAMSON),
    ):
        with pytest.raises(dataclasses.FrozenInstanceError):
            result.scattering = 1.0


def test_licence_and_notice_travel_with_the_tables():
    folder = resources.files("amulor.optics").joinpath("data")
    notice = folder.joinpath("NOTICE-jerlov.txt").read_text(encoding="utf-8")
    assert "Crown copyright (2022), Dstl" in notice
    licence = folder.joinpath("LICENSE-jerlov.txt").read_text(encoding="utf-8")
    assert "Apache License" in licence
    for name in water_types.JERLOV_SOURCES.values():
        head = folder.joinpath(name).read_text(encoding="utf-8").splitlines()[:6]
        assert any("NOTICE-jerlov.txt" in line for line in head)
