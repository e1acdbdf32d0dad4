"""Units of angles, lists of frequencies, and numbers written in other units."""

from __future__ import annotations

import math

import pytest

from amulor import units


@pytest.mark.parametrize(
    ("text", "radians"),
    [
        ("1 rad", 1), ("2 mrad", 2e-3), ("3 urad", 3e-6), ("90 deg", math.pi / 2),
        ("30 arcmin", math.pi / 360), ("36 arcsec", math.pi / 18000),
        ("0.5 turn", math.pi), ("0.25 revolution", math.pi / 2),
        ("1 cycle", 2 * math.pi),
    ],
)  # fmt: skip
def test_angles_have_one_angle_and_their_squares_two(text: str, radians: float) -> None:
    assert units.parse(text, "angle") == pytest.approx(radians, rel=1e-12)
    number, unit = text.split()
    squared = units.parse(f"{number} {unit}^2", "angle squared")
    assert squared == pytest.approx(radians**2 / float(number), rel=1e-12)
    for quantity in ("fraction", "angle squared", "solid-angle density"):
        with pytest.raises(ValueError, match=f"{unit!r} is not one of {quantity};"):
            units.parse(text, quantity)
    with pytest.raises(ValueError, match="is not one of angle;"):
        units.parse(f"1 {unit}^2", "angle")


@pytest.mark.parametrize(
    ("text", "quantity", "value"),
    [
        ("2 1/sr", "solid-angle density", 2.0),
        ("2 1/rad^2", "solid-angle density", 2.0),
        ("3 W/m^2/sr/nm", "spectral radiance", 3e9),
        ("1 mg/l", "mass concentration", 1e3),
        ("36 km/h", "speed", 10.0),
        ("/m", "attenuation coefficient", None),
        ("2/m", "attenuation coefficient", 2.0),
        ("50 %", "fraction", 0.5),
        (" -0.5 ", "fraction", -0.5),
        ("+.5e1 m", "length", 5.0),
        ("5. m", "length", 5.0),
    ],
)
def test_quantities_have_their_units(
    text: str, quantity: str, value: float | None
) -> None:
    if value is None:
        with pytest.raises(ValueError, match="no number with a unit"):
            units.parse(text, quantity)
        return
    assert units.parse(text, quantity) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "quantity"),
    [
        ("2 W/m^2/nm", "spectral radiance"),
        ("2 1/rad", "solid-angle density"),
        ("2 1/sr^2", "solid-angle density"),
        ("2 sr/s", "frequency"),
        ("2", "angle"),
        ("2 %", "length"),
        ("2 degC/s", "temperature"),
    ],
)
def test_units_of_other_quantities_are_refused(text: str, quantity: str) -> None:
    with pytest.raises(ValueError, match=r"needed is the ") as caught:
        units.parse(text, quantity)
    advice = f'needed is the {quantity} as text such as "{units.example(quantity)}"'
    assert str(caught.value).startswith(f"found {text!r}, ")
    assert str(caught.value).endswith(f"; {advice}")


def test_a_range_has_both_of_its_ends() -> None:
    assert units.parse_frequencies("1 MHz:2MHz:2") == [1e6, 2e6]
    assert units.parse_frequencies("3MHz:1MHz: 5 ") == [3e6, 2.5e6, 2e6, 1.5e6, 1e6]
    assert units.parse_frequencies("1 MHz") == [1e6]
    assert len(units.parse_frequencies("1MHz:2MHz:100000")) == 100_000


@pytest.mark.parametrize(
    "text",
    ["1MHz:2MHz", "1MHz:2MHz:1", "1MHz:2MHz:0", "1MHz:2MHz:-3", "1MHz:2MHz:100001",
     "1MHz:2MHz:3:4", "1MHz:2MHz:2.5", "1MHz:2MHz:"],
)  # fmt: skip
def test_a_range_of_frequencies_has_two_ends_and_a_number(text: str) -> None:
    with pytest.raises(ValueError, match=r".") as caught:
        units.parse_frequencies(text)
    assert str(caught.value) == (
        f"found {text!r}; a range of frequencies is first, last and how many (2 to "
        '100000), such as "0.5MHz:138MHz:200"'
    )


@pytest.mark.parametrize(
    ("value", "quantity", "text"),
    [
        (450 * 1e-9, "wavelength", "450 nm"),
        (4.5e-7, "wavelength", "4.5e-07 m"),
        (405.123456789 * 1e-9, "wavelength", "405.123456789 nm"),
        (4.05123456789012e-7, "wavelength", "4.05123456789012e-07 m"),
        (0.25, "fraction", "0.25"),
        (2, "length", "2.0 m"),
        (-3.5, "temperature", "-3.5 degC"),
        (0.1, "solid-angle density", "0.1 1/sr"),
    ],
)
def test_numbers_are_written_with_their_units(
    value: float, quantity: str, text: str
) -> None:
    assert units.write(value, quantity) == text


@pytest.mark.parametrize(
    ("value", "like", "text"),
    [
        (0.0123456789, "2 cm", "1.23457 cm"),
        (2.0, "0.5 /m", "2 /m"),
        (2.0, "0.5/cm", "0.02 /cm"),
        (0.5, "20%", "50 %"),
        (0.25, "0.5", "0.25"),
        (20.0, "59 degF", "68 degF"),
        (math.pi, "2 deg", "180 deg"),
        (2.5, "no number", "2.5"),
        (2.5, "3 furlongs of rope", "2.5"),
    ],
)
def test_numbers_are_written_in_the_unit_of_another_text(
    value: float, like: str, text: str
) -> None:
    assert units.write_like(value, like) == text
