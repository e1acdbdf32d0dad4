"""Permissible exposure and hazard distance against published limits and examples."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from amulor.acquisition.laser_safety import (
    APERTURE,
    hazard,
    permissible_irradiance,
    pupil_irradiance,
)

PUPIL = math.pi / 4 * APERTURE**2


@pytest.mark.parametrize(
    ("wavelength", "exposure", "power", "about"),
    [
        # Accessible emission limits of IEC 60825-1:2014, tables 3 and 5, as powers
        # through 7 mm; each is the permissible exposure over that pupil, rounded.
        (633e-9, 0.25, 1e-3, "class 2, any visible wavelength"),
        (450e-9, 0.25, 1e-3, "class 2, any visible wavelength"),
        (633e-9, 3e4, 3.9e-4, "class 1, by heat"),
        (405e-9, 3e4, 3.9e-5, "class 1, by photochemistry, C3 = 1"),
        (500e-9, 3e4, 3.9e-4, "class 1, C3 = 10: both limits meet"),
        (440e-9, 10.0, 3.9e-4, "class 1, 3.9 mJ in 10 s"),
        (440e-9, 100.0, 3.9e-5, "class 1, 3.9 mJ in 100 s"),
    ],
)
def test_limits_are_those_that_classes_are_made_from(
    wavelength, exposure, power, about
) -> None:
    found = permissible_irradiance(wavelength, exposure=exposure) * PUPIL
    # The standard prints two digits.
    assert found == pytest.approx(power, rel=0.03), about


def test_the_exposure_of_one_second_in_the_table_of_the_standard() -> None:
    # 18 t^0.75 J/m2 in 1 s is 18 W/m2 for every visible wavelength.
    for wavelength in (400e-9, 555e-9, 700e-9):
        assert permissible_irradiance(wavelength, exposure=1.0) == pytest.approx(18.0)


@given(
    wavelength=st.floats(400e-9, 700e-9),
    first=st.floats(18e-6, 3e4),
    second=st.floats(18e-6, 3e4),
)
def test_longer_exposures_allow_less(wavelength, first, second) -> None:
    short, long = sorted((first, second))
    # The standard's own step at 10 s: 18 * 10^-0.25 is 10.1, printed as 10.
    assert permissible_irradiance(wavelength, exposure=long) <= 1.001 * (
        permissible_irradiance(wavelength, exposure=short)
    )


def test_a_narrow_beam_goes_through_the_pupil_as_a_whole() -> None:
    assert pupil_irradiance(1e-3, diameter=1e-4) == pytest.approx(1e-3 / PUPIL)
    # A wide one has its largest irradiance there: 4 P / pi d^2 at 1/e.
    assert pupil_irradiance(1.0, diameter=1.0) == pytest.approx(4 / math.pi, rel=1e-4)


@pytest.mark.parametrize(("power", "metres"), [("1 W", 225), ("5 W", 500)])
def test_hazard_distances_far_away_are_those_that_others_publish(
    plate, power, metres
) -> None:
    # For visible light of 1 mrad (laserpointersafety.com and others), rounded there.
    survey = plate.with_({"instrument.power": power})
    found = hazard(survey, beam_diameter=1e-3, divergence=1e-3, laser_class="4")
    assert found.distance_in_air == pytest.approx(metres, rel=0.015)


def test_the_page_prints_what_it_says(tmp_path, monkeypatch, capsys) -> None:
    docs = Path(__file__).parents[3] / "docs"
    page = (docs / "how-to" / "laser-safety.md").read_text("utf-8")
    (program,) = re.findall(r"```python\n(.*?)```", page, flags=re.DOTALL)
    (survey,) = re.findall(
        r"```toml\n(.*?)```", (docs / "tutorial.md").read_text("utf-8"), flags=re.DOTALL
    )
    monkeypatch.chdir(tmp_path)
    Path("tank.toml").write_text(survey)
    exec(compile(program, "laser-safety.md", "exec"), {})
    printed = capsys.readouterr().out
    assert "permissible: 25.5 W/m2" in printed
    assert "520 W/m2" in printed
    for words in ("29.8 m in air", "9.3 m in this water"):
        assert words in printed
        assert words in page


def test_the_hazard_distance_of_a_pointer_of_5_milliwatts_is_16_metres(plate) -> None:
    # Published for 5 mW and 1 mrad at 0.25 s: 52 feet (laserpointersafety.com), from
    # a formula that takes the irradiance in the middle, so it is a little larger.
    survey = plate.with_(
        {"instrument.power": "5 mW", "instrument.wavelength": "532 nm"}
    )
    found = hazard(survey, beam_diameter=1e-5, divergence=1e-3, laser_class="3R")
    middle = math.sqrt(4 * 5e-3 / (math.pi * 25.456)) / 1e-3
    assert middle == pytest.approx(52 * 0.3048, rel=0.01)
    assert 0.93 * middle < found.distance_in_air < middle
    assert not found.exceeds_class
    # At the end of it the eye gets just what is permissible.
    diameter = 1e-5 + 1e-3 * found.distance_in_air
    assert pupil_irradiance(5e-3, diameter=diameter) == pytest.approx(
        found.permissible_irradiance, rel=1e-3
    )


def test_water_shortens_it_by_absorption_and_lengthens_it_by_refraction(plate) -> None:
    def distances(**water: str) -> tuple[float, float]:
        survey = plate.with_({f"water.{key}": value for key, value in water.items()})
        found = hazard(survey, beam_diameter=2e-3, divergence=1e-3, laser_class="3B")
        return found.distance_in_air, found.distance_in_water

    clear = distances(absorption="0 1/m")
    # The same diameter, farther away by the refractive index.
    assert clear[1] == pytest.approx(1.34 * clear[0], rel=1e-3)
    assert distances(absorption="0.5 1/m")[1] < clear[1]
    # Scattering is no protection.
    assert distances(absorption="0 1/m", scattering="5 1/m") == clear


def test_the_demonstration_is_a_laser_of_class_3b(plate) -> None:
    kinds = {
        kind: hazard(plate, beam_diameter=2e-3, divergence=1e-3, laser_class=kind)
        for kind in ("1", "2", "3R", "3B", "4")
    }
    assert [one.exceeds_class for one in kinds.values()] == [True] * 3 + [False] * 2
    # 405 nm for a working day: 39 uW.
    assert kinds["1"].class_power == pytest.approx(3.9e-5, rel=0.03)
    # A beam that does not spread is never harmless in air; water absorbs it.
    still = hazard(plate, beam_diameter=2e-3, divergence=0.0, laser_class="3B")
    assert still.distance_in_air == math.inf
    assert 1 < still.distance_in_water < 20
    weak = plate.with_({"instrument.power": "1 uW"})
    found = hazard(weak, beam_diameter=2e-3, divergence=1e-3, laser_class="1")
    assert found.distance_in_air == found.distance_in_water == 0


@pytest.mark.parametrize(
    ("change", "arguments", "message"),
    [
        ({"instrument.modulation_frequencies": ["50 kHz"]}, {}, "so slow"),
        ({}, {"exposure": 1e-6}, "between 18 us and 30000 s"),
        ({}, {"beam_diameter": 0.0}, "beam_diameter must be above 0"),
        ({}, {"divergence": -1.0}, "divergence not negative"),
    ],
)
def test_what_the_limits_do_not_hold_for_is_refused(
    plate, change, arguments, message
) -> None:
    given_ = {"beam_diameter": 1e-3, "divergence": 1e-3, **arguments}
    with pytest.raises(ValueError, match=message):
        hazard(plate.with_(change), laser_class="3B", **given_)
    with pytest.raises(ValueError, match="between 400 nm and 700 nm"):
        permissible_irradiance(1064e-9, exposure=1.0)
    with pytest.raises(ValueError, match="power must not be negative"):
        pupil_irradiance(-1.0, diameter=1.0)
