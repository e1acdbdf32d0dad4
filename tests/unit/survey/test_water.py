"""Any water that a survey can name resolves to coefficients and a phase function."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from amulor import cube
from amulor.errors import SurveyError
from amulor.optics.phase_functions.models import (
    fournier_forand,
    henyey_greenstein_function,
)
from amulor.optics.polarization import mueller
from amulor.optics.water import case_1, seawater, types
from amulor.studies.ladder import survey_text
from amulor.survey import Survey, Water, water_properties
from amulor.survey import mueller as surfaces
from amulor.survey.mueller import SURFACES, keeping, matrix
from amulor.survey.properties import (
    by_coefficients,
    group_index_uncertainty,
    quadrature_phase_error,
)

TAP = 'temperature = "20 degC"\nsalinity = 0'
SEA = 'temperature = "20 degC"\nsalinity = 35'
#: Waters without extras: text of the section, wavelength.
WATERS = {
    "coefficients": (
        'absorption = "0.1 1/m"\nscattering = "0.4 1/m"\n'
        '[water.phase_function]\nkind = "two-term"\nforward_asymmetry = 0.95\n'
        "backward_asymmetry = -0.4\nforward_weight = 0.98",
        "532 nm",
    ),
    "jerlov": ('type = "III"\nsource = "williamson-hollins-2022"', "490 nm"),
    "petzold": ('station = "HAOCE 11"', "532 nm"),
    "pure": ('salinity = 35\ntemperature = "10 degC"', "450 nm"),
    "case-1": ('chlorophyll = "1 mg/m^3"', "490 nm"),
    "layers": (
        '[[water.layers]]\nthickness = "1 m"\nabsorption = "0.1 1/m"\n'
        'scattering = "0.2 1/m"\nphase_function = {kind = "rayleigh"}\n'
        '[[water.layers]]\nabsorption = "0.1 1/m"\nscattering = "0.5 1/m"\n'
        'phase_function = {kind = "henyey-greenstein", asymmetry = 0.9}',
        "405 nm",
    ),
}


@pytest.fixture(scope="module")
def with_water(plate_text: str):
    """Return a function that puts another water into the plate's survey."""
    before, _, rest = plate_text.partition("[water]")
    after = rest[rest.index("[[targets]]") :]

    def changed(text: str, wavelength: str = "405 nm", **options) -> Survey:
        whole = f"{before}[water]\n{text}\n{after}".replace("405 nm", wavelength)
        return Survey.from_text(whole, name="tank.toml", **options)

    return changed


def of_kind(kind: str) -> tuple[str, str]:
    text, wavelength = WATERS[kind]
    return f'kind = "{kind}"\n{text}', wavelength


@pytest.mark.parametrize(
    ("water", "digest"), [("clear", "eb1babe4743c5"), ("milk", "31d0009cbd4a1")]
)
def test_text_and_digest_of_shipped_surveys_are_what_they_were(water, digest):
    text = Survey.from_text(survey_text(water)).to_toml()
    assert cube.digest(text).startswith(f"sha256:{digest}")


@pytest.mark.parametrize("kind", WATERS)
def test_each_water_survives_a_round_trip_and_a_change(with_water, kind):
    survey = with_water(*of_kind(kind))
    assert Survey.from_text(survey.to_toml()) == survey
    changed = survey.with_({"water.column_end": 7.0})
    assert changed.water.column_end == 7.0
    assert type(changed.water) is type(survey.water)


@pytest.mark.parametrize("kind", WATERS)
def test_moments_are_those_of_the_phase_function(with_water, kind):
    water = water_properties(with_water(*of_kind(kind)))
    function = water.phase_function
    # By a plain sum over angles, dense in the peak, of which a head may hold part.
    angle = np.concatenate(
        [np.geomspace(1e-12, 0.1, 40_000), np.linspace(0.1, np.pi / 2, 20_000)[1:]]
    )
    density = 2 * np.pi * function(angle) * np.sin(angle)
    share = np.trapezoid(density, angle)
    moment = np.trapezoid(density * angle**2, angle) / share
    assert_allclose(water.forward_scattering, share * water.scattering, rtol=3e-3)
    assert_allclose(water.second_moment, moment, rtol=3e-3)
    assert water.backscatter_vsf == pytest.approx(function(np.pi) * water.scattering)
    whole = water.forward_scattering + water.diffuse_scattering
    assert whole == pytest.approx(water.scattering, rel=1e-12)


def test_petzolds_coast_is_that_of_the_textbooks(with_water):
    # C. D. Mobley, Light and Water (1994), table 3.10: a 0.179, b 0.219, b_b/b 0.0131.
    water = water_properties(with_water(*of_kind("petzold")))
    assert (water.absorption, water.scattering) == (0.179, 0.219)
    assert water.phase_function.backscatter_fraction == pytest.approx(0.0131, abs=8e-4)
    # A stated coefficient takes the place of the measured one, and only of that.
    text, wavelength = of_kind("petzold")
    for name, expected in (("absorption", (0.3, 0.219)), ("scattering", (0.179, 0.3))):
        other = water_properties(with_water(f'{text}\n{name} = "0.3 1/m"', wavelength))
        assert (other.absorption, other.scattering) == expected


def test_pure_sea_water_has_half_of_its_scattering_backwards(with_water):
    water = water_properties(with_water(*of_kind("pure")))
    state = {"temperature": 10.0, "salinity": 35.0}
    assert water.scattering == pytest.approx(
        float(seawater.molecular_scattering(450e-9, **state))
    )
    assert water.absorption == pytest.approx(
        float(seawater.mason_absorption(450e-9, **state))
    )
    assert water.phase_function.backscatter_fraction == pytest.approx(0.5)
    assert water.second_moment > 0.9  # rad^2: no forward peak at all


def test_jerlov_water_keeps_its_coefficients_and_adds_molecules(with_water):
    text, wavelength = of_kind("jerlov")
    text += f"\n{SEA}"
    water = water_properties(with_water(text, wavelength))
    table = types.jerlov("III", 490e-9, source="williamson-hollins-2022")
    assert water.absorption == pytest.approx(float(table.absorption))
    assert water.scattering == pytest.approx(float(table.scattering))
    molecules = seawater.molecular_scattering(490e-9, temperature=20.0, salinity=35.0)
    backwards = molecules / 2 + 0.0183 * (table.scattering - molecules)
    # The average particle of Mobley et al. 1993 has b_b / b = 0.0183, 0.0181 by table.
    found = water.phase_function.backscatter_fraction * water.scattering
    assert found == pytest.approx(float(backwards), rel=0.02)
    other = with_water(
        f'{text}\nparticles = {{kind = "henyey-greenstein", asymmetry = 0.9}}',
        wavelength,
    )
    g = water_properties(other).phase_function.asymmetry
    assert g == pytest.approx(float(0.9 * (1 - molecules / table.scattering)))


def test_case_1_water_is_the_sum_of_its_parts(with_water):
    text, wavelength = of_kind("case-1")
    text += f"\n{SEA}"
    water = water_properties(with_water(text, wavelength))
    own = {"chlorophyll": 1.0}
    state = {"temperature": 20.0, "salinity": 35.0}
    particles = case_1.particle_absorption(490e-9, **own)
    dissolved = 0.2 * case_1.particle_absorption(440e-9, **own) * np.exp(-0.014 * 50)
    pure = seawater.mason_absorption(490e-9, **state)
    assert water.absorption == pytest.approx(float(particles + dissolved + pure))
    molecules = seawater.molecular_scattering(490e-9, **state)
    back = case_1.particle_backscattering(490e-9, **own) + molecules / 2
    found = water.phase_function.backscatter_fraction * water.scattering
    assert found == pytest.approx(float(back), rel=1e-6)
    clear = with_water(f'{text}\ncdom_absorption = "0 1/m"', wavelength)
    assert water_properties(clear).absorption == pytest.approx(float(particles + pure))


@pytest.mark.parametrize("kind", WATERS)
def test_one_rule_for_the_index_of_all_waters(with_water, kind):
    text, wavelength = of_kind(kind)
    bare = "\n".join(
        line for line in text.split("\n") if not line.startswith(("salin", "temper"))
    )
    head, table, rest = bare.partition("\n[")
    found = with_water(bare, wavelength)
    length = float(wavelength.removesuffix(" nm")) * 1e-9
    assert water_properties(found).group_index == pytest.approx(
        float(seawater.group_index(length, temperature=15.0, salinity=20.0))
    )
    # Uniform over fresh water to 40 and over 0 to 30 degC: the span over root 12 each.
    ends = [
        np.ptp(seawater.group_index(length, temperature=[0, 15, 30], salinity=20.0)),
        np.ptp(seawater.group_index(length, temperature=15.0, salinity=[0, 40])),
    ]
    error = group_index_uncertainty(found)
    assert error == pytest.approx(np.hypot(*ends) / np.sqrt(12), rel=0.03)
    salty = with_water(f"{head}\nsalinity = 35{table}{rest}", wavelength)
    assert group_index_uncertainty(salty) == pytest.approx(
        np.ptp(seawater.group_index(length, temperature=[0, 15, 30], salinity=35.0))
        / np.sqrt(12),
        rel=0.1,
    )
    stated = with_water(f"{head}\n{SEA}{table}{rest}", wavelength)
    assert group_index_uncertainty(stated) is None


@pytest.mark.parametrize(
    ("kind", "m22"),
    [
        # Voss and Fry 1984, p = 0.66 at 90 degrees: 2 p / (1 + p).
        ("jerlov", 0.7952),
        ("petzold", 0.7952),
        ("case-1", 0.7952),
        # Molecules that depolarize natural light by 0.039: 1 - 0.039.
        ("pure", 0.961),
        ("coefficients", None),
        ("layers", None),
    ],
)
def test_waters_by_name_depolarize_as_measured_ones_do(with_water, kind, m22):
    water = water_properties(with_water(*of_kind(kind)))
    assert water.depolarization_known is (m22 is not None)
    found = matrix(water.backscatter_mueller)
    expected = 1.0 if m22 is None else m22
    assert np.diag(found) == pytest.approx(
        [1, expected, -expected, 1 - 2 * expected], abs=1e-4
    )
    stated = with_water(*of_kind(kind)).with_(
        {"water.backscatter_mueller": [0.9, -0.9, -0.8]}
    )
    assert water_properties(stated).depolarization_known
    assert water_properties(stated).backscatter_mueller == (0.9, -0.9, -0.8)


def test_spheres_keep_polarization_but_for_the_molecules(with_water):
    pytest.importorskip("miepython")
    clear, milky = (
        matrix(
            water_properties(
                with_water(f'kind = "milk"\nfat = "1.5 %"\nvolume_fraction = {share}')
            ).backscatter_mueller
        )[1, 1]
        for share in (1e-9, 1e-3)
    )
    assert clear == pytest.approx(0.961, abs=1e-3)
    assert milky == pytest.approx(1.0, abs=1e-3)


def test_milk_and_spheres_scatter_what_is_stirred_in(with_water):
    pytest.importorskip("miepython")
    pure = seawater.molecular_scattering(405e-9, temperature=20.0, salinity=0.0)
    half, whole = (
        water_properties(
            with_water(
                f'kind = "milk"\nfat = "1.5 %"\nvolume_fraction = {share}\n{TAP}'
            )
        )
        for share in (2.5e-5, 5e-5)
    )
    assert whole.scattering - pure == pytest.approx(2 * (half.scattering - pure))
    # 12.5 1/m for 1 ml in a litre, within a factor of 1.5, by another reading of the
    # same model (types.milk).
    assert 1 / 1.51 < (whole.scattering - pure) / (12.5 * 0.05) < 1.51
    beads = with_water(
        'kind = "spheres"\ndiameter = "1 um"\nparticle_index = 1.5979\n'
        f"volume_fraction = 5.236e-7\nrefractive_index = 1.3349\n{TAP}",
        "532 nm",
    )
    # 1e12 polystyrene spheres a cubic metre: b = 2.513 1/m and g = 0.926112 by the
    # series (docstring of mie.size_distribution).
    found = water_properties(beads)
    rest = seawater.molecular_scattering(532e-9, temperature=20.0, salinity=0.0)
    assert found.scattering - rest == pytest.approx(2.513, rel=1e-3)
    assert found.phase_function.asymmetry * found.scattering == pytest.approx(
        0.926112 * (found.scattering - rest), rel=1e-3
    )


def test_measured_milk_has_the_measured_reduced_scattering(with_water):
    pytest.importorskip("miepython")
    water = water_properties(
        with_water(
            'kind = "milk"\nfat = "3.5 %"\nvolume_fraction = 1e-4\n'
            f'scattering_source = "jensen-2001"\n{TAP}',
            "532 nm",
        )
    )
    pure = seawater.molecular_scattering(532e-9, temperature=20.0, salinity=0.0)
    reduced = water.scattering * (1 - water.phase_function.asymmetry) - pure
    assert reduced == pytest.approx(3210 * 1e-4, rel=1e-6)


@given(asymmetry=st.floats(0.5, 0.99))
def test_a_named_phase_function_is_the_asymmetry(plate, asymmetry):
    moments = dict.fromkeys(
        ("forward_fraction", "second_moment", "phase_function_at_180")
    )
    plain = plate.water.model_dump(exclude_none=True)
    stated = [
        plate.with_({"water": {**plain, **moments, **how}})
        for how in (
            {"asymmetry": asymmetry},
            {"phase_function": {"kind": "henyey-greenstein", "asymmetry": asymmetry}},
        )
    ]
    one, other = map(water_properties, stated)
    for name in ("forward_scattering", "second_moment", "backscatter_vsf"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-8)
    assert one.phase_function(0.3) == pytest.approx(other.phase_function(0.3))


def test_a_table_stands_for_the_function_that_it_was_made_of(with_water, tmp_path):
    made = fournier_forand(relative_index=1.1, slope=3.5835)
    angle = np.concatenate([np.geomspace(1e-3, 10, 300), np.linspace(10, 180, 300)[1:]])
    rows = [f"{a!r}, {float(7 * made(np.radians(a)))!r}" for a in angle.tolist()]
    (tmp_path / "mine.csv").write_text("# angle, value\n" + "\n".join(rows))
    text = 'absorption = "0.1 1/m"\nscattering = "0.4 1/m"\n'
    survey = with_water(
        f'{text}phase_function = {{kind = "tabulated", file = "mine.csv"}}',
        folder=tmp_path,
    )
    water = water_properties(survey)
    fraction, moment = made.forward_split(np.pi / 2)
    assert water.forward_scattering == pytest.approx(0.4 * fraction, rel=1e-3)
    assert water.second_moment == pytest.approx(moment, rel=1e-2)
    # The table travels with the survey: no file is needed any more.
    (tmp_path / "mine.csv").unlink()
    again = Survey.from_text(survey.to_toml())
    assert again == survey
    assert water_properties(again) == water


@given(
    factor=st.floats(0.2, 5.0),
    kind=st.sampled_from([k for k in WATERS if k != "layers"]),
)
def test_water_by_its_coefficients_is_the_same_to_models_of_moments(
    with_water, factor, kind
):
    survey = with_water(*of_kind(kind))
    one = water_properties(survey)
    other = water_properties(by_coefficients(survey, factor=factor))
    plain = by_coefficients(survey).water
    assert isinstance(plain, Water)
    assert plain.salinity == survey.water.salinity
    for name in ("absorption", "scattering", "forward_scattering", "backscatter_vsf"):
        assert getattr(other, name) == pytest.approx(factor * getattr(one, name))
    assert other.second_moment == pytest.approx(one.second_moment)
    assert (other.refractive_index, other.group_index) == (
        one.refractive_index,
        one.group_index,
    )


@pytest.mark.parametrize("kind", ["petzold", "jerlov", "case-1", "pure"])
def test_water_by_its_coefficients_keeps_the_form_of_its_phase_function(
    with_water, kind
):
    survey = with_water(*of_kind(kind))
    one = water_properties(survey).phase_function
    scaled = [by_coefficients(survey, factor=factor) for factor in (1.0, 1.7)]
    other, again = (water_properties(each).phase_function for each in scaled)
    # Its transforms are worked out once for all factors.
    assert other is again
    angle = np.concatenate([np.geomspace(1e-3, 0.1, 30), np.linspace(0.1, np.pi, 50)])
    assert_allclose(other(angle), one(angle), rtol=0.01)
    assert other.asymmetry == pytest.approx(one.asymmetry, abs=1e-3)


def test_layers_are_counted_from_the_instrument(with_water):
    water = water_properties(with_water(*of_kind("layers")))
    assert [layer.thickness for layer in water.layers] == [1.0, np.inf]
    assert [layer.scattering for layer in water.layers] == [0.2, 0.5]
    assert water.scattering == 0.2
    assert water.layers[1].phase_function(1.0) == pytest.approx(
        float(henyey_greenstein_function(asymmetry=0.9)(1.0))
    )


REFUSED = [
    ('kind = "lake"', "405 nm", "coefficients, jerlov, petzold, pure, case-1, milk"),
    (
        'kind = "jerlov"\ntype = "IV"\nsource = "solonenko-mobley-2015"',
        "405 nm",
        "'9C'",
    ),
    (
        'kind = "jerlov"\ntype = "9C"\nsource = "williamson-hollins-2022"',
        "405 nm",
        "water_type must be one of",
    ),
    ('kind = "petzold"\nstation = "AUTEC 8"', "405 nm", "530 nm, not at 405 nm"),
    ('kind = "case-1"\nchlorophyll = "1 mg"', "450 nm", r"mg/m\^3"),
    ('kind = "case-1"\nchlorophyll = "100 mg/m^3"', "450 nm", "at most 30"),
    ('kind = "pure"\nabsorption = "0.1 1/m"', "450 nm", "is no field"),
    (
        'kind = "milk"\nfat = "1.5 %"\nvolume_fraction = 1e-4\n'
        'scattering_source = "jensen-2001"',
        "450 nm",
        "skim",
    ),
    ('kind = "spheres"\ndiameter = "1 um"\nparticle_index = 1.5', "450 nm", "not both"),
    (
        'absorption = "1 1/m"\nscattering = "1 1/m"\nasymmetry = 0.9\n'
        'phase_function = {kind = "rayleigh"}',
        "450 nm",
        "stated twice",
    ),
    (
        'absorption = "1 1/m"\nscattering = "1 1/m"\nphase_function = {kind = "gauss"}',
        "450 nm",
        "henyey-greenstein, two-term, fournier-forand, petzold, rayleigh, tabulated",
    ),
    (
        'absorption = "1 1/m"\nscattering = "1 1/m"\n'
        'phase_function = {kind = "fournier-forand", slope = 3.5}',
        "450 nm",
        "relative_index and slope",
    ),
    (
        'absorption = "1 1/m"\nscattering = "1 1/m"\nphase_function = {kind = '
        '"tabulated", angles = ["1 deg", "90 deg"], values = [1.0, 0.1]}',
        "450 nm",
        "end at pi rad",
    ),
    (
        'absorption = "1 1/m"\nscattering = "1 1/m"\n'
        'phase_function = {kind = "tabulated", file = "none.csv"}',
        "450 nm",
        "water.phase_function: .*none.csv cannot be read",
    ),
    (
        'kind = "layers"\n[[water.layers]]\nabsorption = "1 1/m"\n'
        'scattering = "1 1/m"\nphase_function = {kind = "rayleigh"}\n'
        '[[water.layers]]\nabsorption = "1 1/m"\nscattering = "1 1/m"\n'
        'phase_function = {kind = "rayleigh"}',
        "450 nm",
        "every layer needs a thickness",
    ),
]


@pytest.mark.parametrize(("text", "wavelength", "words"), REFUSED)
def test_water_that_cannot_be_is_refused_in_one_line(
    with_water, tmp_path, text, wavelength, words
):
    import re

    with pytest.raises(SurveyError) as caught:
        water_properties(with_water(text, wavelength, folder=tmp_path))
    lines = str(caught.value).splitlines()
    assert any("water" in line and re.search(words, line) for line in lines), lines
    assert len(lines) == 1


@pytest.mark.parametrize(("gain", "angle"), [(0.01, 0.0), (0.0, 0.02), (0.03, 0.01)])
def test_the_error_of_a_quadrature_output_is_that_of_turned_phasors(
    gain: float, angle: float
) -> None:
    phase = np.linspace(0, 2 * np.pi, 360, endpoint=False)
    # The quadrature output is larger by the gain, and contains a part of the other.
    output = np.cos(phase) + 1j * ((1 + gain) * np.sin(phase) + angle * np.cos(phase))
    turned = np.angle(output * np.exp(-1j * phase))
    expected = np.sqrt(np.mean(turned**2))
    # The terms of second order of the gain are 3 %.
    np.testing.assert_allclose(quadrature_phase_error(gain, angle), expected, rtol=0.03)


def test_water_without_scattering_stays_so_by_its_coefficients(with_water) -> None:
    survey = with_water(
        'kind = "layers"\n'
        '[[water.layers]]\nthickness = "1 m"\nabsorption = "0.1 1/m"\n'
        'scattering = "0 1/m"\nphase_function = {kind = "rayleigh"}\n'
        '[[water.layers]]\nabsorption = "0.1 1/m"\nscattering = "0 1/m"\n'
        'phase_function = {kind = "rayleigh"}',
        "532 nm",
    )
    water = by_coefficients(survey, factor=2.0).water
    assert isinstance(water, Water)
    assert (water.absorption, water.scattering) == (0.2, 0.0)
    assert water.forward_fraction == 1.0


def test_surfaces_straight_backwards_are_those_of_their_sources() -> None:
    # A mirror keeps the light: U and V turn round, as all that it reflects does.
    mirror = np.diag(mueller.ideal_backscatter())
    assert SURFACES["smooth-metal"] == tuple(mirror[1:] / mirror[0])
    assert SURFACES["ideal-depolarizer"] == (0.0, 0.0, 0.0)
    # Ricci (2010) prints 0.61; the fourth is within -0.61 and -0.22.
    painted = SURFACES["painted-metal"]
    assert painted[:2] == (0.61, -0.61)
    assert -0.61 < painted[2] < -0.22
    # Randomly oriented particles, and the sea by the polarization at 90 degrees.
    assert keeping(0.8) == pytest.approx((0.8, -0.8, -0.6))
    assert pytest.approx((0.7952, -0.7952, -0.5904), abs=1e-4) == surfaces.SEA
