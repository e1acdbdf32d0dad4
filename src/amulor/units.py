"""Conversion of text with a unit to an SI number, and back."""

from __future__ import annotations

import functools
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pint

_NUMBER_AND_UNIT = re.compile(
    r"\s*(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(?P<unit>\D.*)?\s*"
)

#: The units of amulor's own numbers, by what they measure, as pint reads them.
SI_UNITS = {
    "length": "m",
    "wavelength": "m",
    "angle": "rad",
    "frequency": "Hz",
    "time": "s",
    "speed": "m/s",
    "power": "W",
    "temperature": "degC",
    "attenuation coefficient": "1/m",
    "solid-angle density": "1/sr",
    "angle squared": "rad**2",
    "voltage": "V",
    "fraction": "1",
    "mass concentration": "mg/m**3",
    "spectral radiance": "W/(m**2*sr*m)",
}

_EXAMPLES = {
    "length": "20 cm",
    "wavelength": "405 nm",
    "angle": "4.6 deg",
    "frequency": "39 MHz",
    "time": "125 ms",
    "speed": "0.2 m/s",
    "power": "20 mW",
    "temperature": "15 degC",
    "attenuation coefficient": "0.06 1/m",
    "solid-angle density": "0.001 1/sr",
    "angle squared": "0.06 rad^2",
    "voltage": "10 mV",
    "fraction": "25 %",
    "mass concentration": "0.5 mg/m^3",
    "spectral radiance": "0.01 W/m^2/sr/nm",
}


def example(quantity: str) -> str:
    """Return an example text of a quantity, for messages and schemas.

    Parameters
    ----------
    quantity : str
        Physical quantity, a key of `SI_UNITS`.

    Returns
    -------
    str
        Example with number and unit.

    Examples
    --------
    >>> example("frequency")
    '39 MHz'
    """
    return _EXAMPLES[quantity]


def parse(text: str, quantity: str) -> float:
    """Convert text with a number and a unit to an SI float.

    Parameters
    ----------
    text : str
        Number and unit, with or without a space.
    quantity : str
        Physical quantity, a key of `SI_UNITS`.

    Returns
    -------
    float
        Value in the unit of `SI_UNITS`; temperatures in degrees Celsius.

    Raises
    ------
    ValueError
        If the number or the unit is missing, or the unit is unknown or of another
        quantity.

    Examples
    --------
    >>> print(parse("39 MHz", "frequency"), parse("20cm", "length"))
    39000000.0 0.2
    >>> print(round(parse("77 degF", "temperature"), 9))
    25.0
    """
    advice = f'needed is the {quantity} as text such as "{_EXAMPLES[quantity]}"'
    match = _NUMBER_AND_UNIT.fullmatch(text)
    if match is None:
        raise ValueError(f"found {text!r}, which is no number with a unit; {advice}")
    number = float(match["number"])
    if not math.isfinite(number):
        raise ValueError(f"found {text!r}, which is too large a number; {advice}")
    unit_text = (match["unit"] or "").strip()
    if unit_text.startswith("/"):
        unit_text = f"1{unit_text}"
    if not unit_text and quantity != "fraction":
        raise ValueError(f"found {text!r}, a number without a unit; {advice}")
    return _convert(number, unit_text, quantity, text=text, advice=advice)


def parse_frequencies(text: str) -> list[float]:
    """Convert a list or a range of frequencies in text to floats [Hz].

    Parameters
    ----------
    text : str
        List such as "50 MHz, 100 MHz", or first, last and number such as
        "0.5MHz:138MHz:200".

    Returns
    -------
    list of float
        Frequencies in the given order, or evenly spaced from first to last [Hz].

    Raises
    ------
    ValueError
        If a frequency is invalid, or a range does not have three parts.

    Examples
    --------
    >>> parse_frequencies("50MHz, 0.1 GHz")
    [50000000.0, 100000000.0]
    >>> parse_frequencies("10MHz:30MHz:3")
    [10000000.0, 20000000.0, 30000000.0]
    """
    if ":" not in text:
        return [parse(part, "frequency") for part in text.split(",")]
    parts = text.split(":")
    count = parts[2].strip() if len(parts) == 3 else ""
    if not count.isdigit() or not 2 <= int(count) <= _MOST_FREQUENCIES:
        raise ValueError(
            f"found {text!r}; a range of frequencies is first, last and how many (2 to "
            f'{_MOST_FREQUENCIES}), such as "0.5MHz:138MHz:200"'
        )
    first, last = parse(parts[0], "frequency"), parse(parts[1], "frequency")
    steps = int(count) - 1
    return [first + (last - first) * i / steps for i in range(steps + 1)]


_MOST_FREQUENCIES = 100_000


def _convert(
    number: float, unit_text: str, quantity: str, *, text: str, advice: str
) -> float:
    import pint

    try:
        registry = _registry_for(unit_text)
        unit = registry.Unit(unit_text)
    # The parser of unit expressions raises errors of many kinds on odd text.
    except Exception:
        raise ValueError(
            f"found {text!r}, whose unit {unit_text!r} is not known; {advice}"
        ) from None
    # Radian and steradian are pure numbers to the registry; here they are not,
    # so that "39 deg" is no frequency and "0.1 1/m" no angle.
    try:
        converted = registry.Quantity(number, unit).to(SI_UNITS[quantity])
    except (pint.DimensionalityError, pint.OffsetUnitCalculusError):
        raise ValueError(
            f"found {text!r}, whose unit {unit_text!r} is not one of {quantity}; "
            f"{advice}"
        ) from None
    if (
        quantity in _ANGULAR_POWERS
        and _angular_power(unit) != _ANGULAR_POWERS[quantity]
    ):
        raise ValueError(
            f"found {text!r}, whose unit {unit_text!r} is not one of {quantity}; "
            f"{advice}"
        )
    return float(converted.magnitude)


_ANGULAR_POWERS = {
    "angle": 1,
    "angle squared": 2,
    "solid-angle density": -2,
    "fraction": 0,
    "frequency": 0,
    "spectral radiance": -2,
}
_ANGULAR_UNITS = {
    "radian": 1,
    "milliradian": 1,
    "microradian": 1,
    "degree": 1,
    "arcminute": 1,
    "arcsecond": 1,
    "turn": 1,
    "steradian": 2,
}


def _angular_power(unit: pint.Unit) -> float:
    """Return the exponent of angle in a unit: 1 for deg, 2 for sr, 0 for Hz."""
    parts = dict(unit._units)
    return sum(
        _ANGULAR_UNITS.get(str(name), 0) * float(str(power))
        for name, power in parts.items()
    )


def _registry_for(unit: str) -> pint.UnitRegistry[float]:
    """Return the unit registry of surveys, or pint's full one for other units."""
    import pint

    registry = _registry(Path(__file__).with_name("units.txt"))
    try:
        registry.Unit(unit)
    except pint.UndefinedUnitError:
        return _registry()
    return registry


@functools.cache
def _registry(definitions: Path | str = "") -> pint.UnitRegistry[float]:
    """Return pint's unit registry for a definitions file, by default its full one."""
    import pint

    registry: pint.UnitRegistry[float] = pint.UnitRegistry(
        definitions, cache_folder=None
    )
    return registry


def write(value: float, quantity: str) -> str:
    """Write an SI number as text with its unit, such that `parse` reads it back.

    Parameters
    ----------
    value : float
        Value in the unit of `SI_UNITS`.
    quantity : str
        Physical quantity, a key of `SI_UNITS`.

    Returns
    -------
    str
        Number and unit; `parse` returns the same float.

    Examples
    --------
    >>> write(0.07, "length")
    '0.07 m'
    >>> write(parse("450 nm", "wavelength"), "wavelength")
    '450 nm'
    """
    unit = SI_UNITS[quantity]
    if quantity == "wavelength" and math.isfinite(value * 1e9):
        # 450 nm is 4.5000000000000003e-07 m.
        short = f"{value * 1e9:.12g} nm"
        if parse(short, quantity) == value:
            return short
    return repr(float(value)) if unit == "1" else f"{float(value)!r} {unit}"


def write_like(value: float, text: str) -> str:
    """Write an SI number in the unit that another text uses, for messages.

    Parameters
    ----------
    value : float
        Value in the unit of `SI_UNITS`.
    text : str
        Number and unit that `parse` accepts.

    Returns
    -------
    str
        Number with the same unit; the number alone if the text has no unit.

    Examples
    --------
    >>> write_like(7e-07, "405 um")
    '0.7 um'
    >>> write_like(1.0, "150 %")
    '100 %'
    """
    match = _NUMBER_AND_UNIT.fullmatch(text)
    unit = (match["unit"] or "").strip() if match else ""
    for quantity, target in SI_UNITS.items():
        try:
            parse(text, quantity)
        except ValueError:
            continue
        unit_text = f"1{unit}" if unit.startswith("/") else unit
        number = _registry_for(unit_text).Quantity(value, target).to(unit_text)
        return f"{float(number.magnitude):.6g} {unit}".strip()
    return f"{value:g}"
