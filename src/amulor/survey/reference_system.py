"""Reference systems of frames: a projected system of EPSG in metres, or a name."""

from __future__ import annotations

import contextlib
import re
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from amulor.errors import MissingExtraError

_NEEDED = 'state a projected system in metres, such as "EPSG:32632", or a name'


def epsg_code(text: str) -> int | None:
    """Return the number that a text states, or None where it is a name."""
    if not re.match(r"\s*(epsg\b|\d+\s*$)", text, flags=re.IGNORECASE):
        return None
    found = re.fullmatch(r"\s*epsg:(\d{4,5})\s*", text, flags=re.IGNORECASE)
    if not found:
        raise ValueError(
            f'"{text}" is no number of EPSG: write "EPSG:" and its four or five '
            'digits, such as "EPSG:32632"'
        )
    return int(found[1])


def projected_code(text: str) -> int | None:
    """Return the number of a projected system in metres; None for a name.

    Raises
    ------
    ValueError
        If EPSG has no such system, or the system has degrees, feet or heights.
    MissingExtraError
        If there is a number to check, and pyproj is not installed.
    """
    code = epsg_code(text)
    if code is None:
        return None
    pyproj = _pyproj()
    try:
        system = pyproj.CRS.from_epsg(code)
    except pyproj.exceptions.CRSError:
        raise ValueError(f"EPSG has no system {code}; {_NEEDED}") from None
    described = f"EPSG:{code} ({system.name})"
    if system.is_compound:
        flat = system.sub_crs_list[0].to_epsg()
        raise ValueError(
            f"{described} is a system with heights; state its horizontal part"
            + (f', "EPSG:{flat}"' if flat else "")
        )
    units = {axis.unit_name for axis in system.axis_info}
    if units != {"metre"}:
        raise ValueError(f"{described} is in units of {', '.join(units)}; {_NEEDED}")
    if not system.is_projected:
        raise ValueError(f"{described} is no projected system; {_NEEDED}")
    if "Pseudo Mercator" in system.coordinate_operation.method_name:
        raise ValueError(
            f"{described} stretches lengths, by 41 % at 45 degrees of latitude; "
            + _NEEDED
        )
    return code


def _checked(text: str) -> str:
    """Return the text if it is right, as far as can be told without pyproj."""
    # What writes coordinates in the system asks for pyproj.
    with contextlib.suppress(MissingExtraError):
        projected_code(text)
    return text


def _pyproj() -> Any:
    try:
        import pyproj
    except ImportError:
        raise MissingExtraError(
            "pyproj", extra="export", purpose="a reference system of EPSG"
        ) from None
    return pyproj


#: Text of a survey or a site file.
ReferenceSystem = Annotated[str, Field(max_length=200), AfterValidator(_checked)]
