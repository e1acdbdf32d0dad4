"""Text with a unit becomes an SI float, or one clear line."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from amulor import units


@pytest.mark.parametrize(
    ("text", "quantity", "expected"),
    [
        ("39 MHz", "frequency", 39e6),
        ("39MHz", "frequency", 39e6),
        ("20 cm", "length", 0.2),
        ("405 nm", "length", 405e-9),
        ("-2.5 mm", "length", -2.5e-3),
        ("1e-2 m", "length", 0.01),
        ("125 ms", "time", 0.125),
        ("20 mW", "power", 0.02),
        ("180 deg", "angle", math.pi),
        ("80 mrad", "angle", 0.08),
        ("0.06 rad^2", "angle squared", 0.06),
        ("1 deg^2", "angle squared", (math.pi / 180) ** 2),
        ("0.001 1/sr", "solid-angle density", 0.001),
        ("0.85 1/m", "attenuation coefficient", 0.85),
        ("0.85 / m", "attenuation coefficient", 0.85),
        ("0.0085 cm^-1", "attenuation coefficient", 0.85),
        ("25 %", "fraction", 0.25),
        ("0.25", "fraction", 0.25),
        ("15 degC", "temperature", 15.0),
        ("288.15 K", "temperature", 15.0),
        ("10 mV", "voltage", 0.01),
    ],
)
def test_text_becomes_the_si_value(text: str, quantity: str, expected: float) -> None:
    assert units.parse(text, quantity) == pytest.approx(expected, rel=1e-14, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "quantity", "complaint"),
    [
        ("20", "length", "without a unit"),
        ("20 cmm", "length", "is not known"),
        ("20 deg", "length", "not one of length"),
        ("20 s", "length", "not one of length"),
        # Angles are pure numbers to most libraries; here they are not.
        ("39 deg", "frequency", "not one of frequency"),
        ("0.5 1/m", "angle", "not one of angle"),
        ("0.06 rad", "angle squared", "not one of angle squared"),
        ("0.1 sr", "solid-angle density", "not one of"),
        ("30 deg", "fraction", "not one of fraction"),
        ("1 rad/s", "frequency", "not one of frequency"),
        ("twenty cm", "length", "no number"),
        ("", "length", "no number"),
        ("nan m", "length", "no number"),
        ("1e999 m", "length", "too large"),
        ("1 __import__('os').system('true')", "length", "is not known"),
    ],
)
def test_bad_text_is_refused_in_one_line(
    text: str, quantity: str, complaint: str
) -> None:
    with pytest.raises(ValueError, match=complaint) as caught:
        units.parse(text, quantity)
    message = str(caught.value)
    assert "\n" not in message
    assert units.example(quantity) in message


@given(
    st.floats(allow_nan=False, allow_infinity=False, width=64),
    st.sampled_from(sorted(units.SI_UNITS)),
)
@example(1.8e299, "wavelength")  # beyond the largest float in nanometers
def test_what_is_written_is_read_back_exactly(value: float, quantity: str) -> None:
    assert units.parse(units.write(value, quantity), quantity) == value


def test_every_example_is_valid() -> None:
    for quantity in units.SI_UNITS:
        assert math.isfinite(units.parse(units.example(quantity), quantity))


def test_a_wavelength_is_written_as_it_was_typed() -> None:
    for text in ("450 nm", "532 nm", "405.5 nm"):
        value = units.parse(text, "wavelength")
        written = units.write(value, "wavelength")
        assert units.parse(written, "wavelength") == value
        assert len(written) <= len("4.055e-07 m")


def test_the_units_of_surveys_mean_what_they_mean_in_pint() -> None:
    surveys = units._registry(Path(units.__file__).with_name("units.txt"))
    whole = units._registry()
    names = [
        f"{prefix}{unit}"
        for prefix in surveys._prefixes
        for unit in surveys._units
        if unit.isidentifier()
        and unit != "half_turn"
        and (not prefix or surveys._units[unit].is_multiplicative)
    ]
    assert len(names) > 700
    odd = []
    for name in names:
        here, there = (
            registry.Quantity(0.7, registry.Unit(name)).to_root_units()
            for registry in (surveys, whole)
        )
        if (here.magnitude, str(here.units)) != (there.magnitude, str(there.units)):
            odd.append(name)
    assert odd == []
    # A plural: "rads" are radians here, and a dose of radiation in pint.
    assert units.parse("2 mrads", "angle") == units.parse("2 mrad", "angle")


def test_a_unit_outside_of_surveys_is_pints() -> None:
    assert units.parse("2 ft", "length") == pytest.approx(2 * 0.3048, rel=1e-12)
    assert units.write_like(0.9144, "2 ft") == "3 ft"
