"""Measurements and products that the page may ask for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np
import xarray as xr

from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.imaging import measure
from amulor.imaging.edges import STEP_MARGIN
from amulor.view.page.pictures import Picture
from amulor.view.page.recording import Recording


@dataclass(frozen=True, kw_only=True)
class Made:
    """A product as it goes to the browser, which keeps it."""

    name: str
    """Name of the file."""
    content: bytes
    """The file."""
    said: str
    """What it is, in a few words and numbers."""


class Products(Protocol):
    """Makes products of range images."""

    def offered(self) -> list[dict[str, Any]]:
        """Return products with their labels, endings and options, for the page."""

    def make(self, image: xr.Dataset, wanted: dict[str, Any], *, stem: str) -> Made:
        """Make a product."""


#: Pixels with one of these are no part of a surface.
_OFF_SURFACE = QualityFlag.MIXED | QualityFlag.OUTLIER
_MOST_PICKS = 200
_LARGEST_REACH = 20

_FITS: dict[str, Callable[..., measure.Fit]] = {
    "plane": measure.plane,
    "circle": measure.circle,
    "sphere": measure.sphere,
    "cylinder": measure.cylinder,
}
#: Kind of a measurement and how many pixels it needs.
_FIGURES = {"distance": 2, "height": 2, "angle": 3}


def measured(recording: Recording, request: dict[str, Any]) -> dict[str, Any]:
    """Measure what a page asks for."""
    kind = str(request.get("kind", ""))
    channel = str(request.get("channel", recording.channels[0]))
    picture = recording.channel(channel).shown
    if kind in _FITS and "region" in request:
        found = _fit(picture, kind, _region(picture, request["region"]))
    elif kind in (*_FIGURES, *_FITS, "area"):
        pixels = _pixels(picture, request.get("pixels"))
        if kind in _FITS:
            found = _fit(picture, kind, pixels)
        else:
            found = _figure(picture, kind, pixels, request)
    else:
        raise CubeError(
            f"{kind[:40]!r} cannot be measured, only "
            f"{', '.join([*_FIGURES, 'area', *_FITS])}"
        )
    return {
        "kind": kind,
        "channel": channel,
        "group_index": float(picture.geometry["group_index"]),
        "error_unknown": picture.error_unknown,
        "unknown": str(picture.attributes.get("uncertainty_unknown", "")),
        **found,
    }


def _figure(
    picture: Picture, kind: str, pixels: list[tuple[int, int]], request: dict[str, Any]
) -> dict[str, Any]:
    wanted = _FIGURES.get(kind)
    if wanted is not None and len(pixels) != wanted:
        raise CubeError(f"{kind} needs {wanted} points, got {len(pixels)}")
    reach = _whole(request.get("reach", 0), "reach", 0, _LARGEST_REACH)
    # Which neighbors count depends on the steps around them.
    wide = reach + STEP_MARGIN if reach else 0
    image = picture.around(
        _near([row for row, _ in pixels], wide, picture.shape[0]),
        _near([column for _, column in pixels], wide, picture.shape[1]),
    )
    at = [picture.place(*pixel) for pixel in pixels]
    if kind == "distance":
        found = measure.distance(image, at[0], at[1], reach=reach)
    elif kind == "height":
        axis = _axis(request.get("axis", (0.0, -1.0, 0.0)))
        found = measure.height(image, at[0], at[1], axis=axis, reach=reach)
    elif kind == "angle":
        found = measure.angle(image, at[0], at[1], at[2], reach=reach)
    else:
        found = measure.area(image, at, reach=reach)
    numbers = asdict(found)
    line = {name: _known(numbers[name]) for name in ("value", "uncertainty", "unit")}
    return {
        "lines": [{"label": kind, **line}],
        "random": found.random,
        "pixels": found.pixels,
    }


def _fit(picture: Picture, kind: str, pixels: list[tuple[int, int]]) -> dict[str, Any]:
    image = picture.around(
        sorted({row for row, _ in pixels}), sorted({column for _, column in pixels})
    )
    region = np.zeros(image["slant_range"].shape, dtype=bool)
    for pixel in pixels:
        region[picture.place(*pixel)] = True
    region &= (image["quality_flag"].values & _OFF_SURFACE) == 0
    fit = _FITS[kind](image, region)
    units = {"tilt": "rad", **dict.fromkeys(("offset", "radius"), "m")}
    lines = [
        {
            "label": name.replace("_", " "),
            "value": value,
            "uncertainty": _known(fit.uncertainties[name]),
            "unit": units.get(
                name, "m" if name.startswith(("centre", "point")) else "1"
            ),
        }
        for name, value in fit.values.items()
    ]
    if kind == "plane":  # people state how much it leans before where it is
        lines.sort(key=lambda line: line["label"] != "tilt")
    else:  # and diameters
        radius = lines[0] if lines[0]["label"] == "radius" else None
        if radius is not None:
            double = {
                "label": "diameter",
                "value": 2 * float(str(radius["value"])),
                "uncertainty": _known(2 * fit.uncertainties["radius"]),
                "unit": "m",
            }
            lines.insert(0, double)
    return {
        "lines": [] if fit.doubt else lines,
        "doubt": fit.doubt,
        "residual": fit.residual,
        "misfit": fit.misfit if math.isfinite(fit.misfit) else None,
        "pixels": fit.pixels,
    }


def _known(value: Any) -> Any:
    """Return a value, None for a number that is not known."""
    return None if isinstance(value, float) and math.isnan(value) else value


def _region(picture: Picture, corners: Any) -> list[tuple[int, int]]:
    """Return pixels of a rectangle, evenly thinned where they are many."""
    if not isinstance(corners, list) or len(corners) != 4:
        raise CubeError(
            "a region has a first row and column, and a last row and column"
        )
    ends = [
        _whole(value, "a corner of the region", 0, picture.shape[at % 2] - 1)
        for at, value in enumerate(corners)
    ]
    rows = np.arange(min(ends[0], ends[2]), max(ends[0], ends[2]) + 1)
    columns = np.arange(min(ends[1], ends[3]), max(ends[1], ends[3]) + 1)
    step = max(1, math.ceil(math.sqrt(rows.size * columns.size / 1500)))
    return [(int(r), int(c)) for r in rows[::step] for c in columns[::step]]


def _pixels(picture: Picture, given: Any) -> list[tuple[int, int]]:
    if not isinstance(given, list) or not 1 <= len(given) <= _MOST_PICKS:
        raise CubeError(f"pick 1 to {_MOST_PICKS} pixels")
    found = []
    for pixel in given:
        if not isinstance(pixel, list) or len(pixel) != 2:
            raise CubeError("a pixel is a row and a column")
        row = _whole(pixel[0], "row", 0, picture.shape[0] - 1)
        column = _whole(pixel[1], "column", 0, picture.shape[1] - 1)
        found.append((row, column))
    return found


def _whole(value: Any, name: str, least: int, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise CubeError(f"{name} must be a whole number")
    if not least <= value <= most:
        raise CubeError(f"{name} must be from {least} to {most}, got {value}")
    return value


def _axis(given: Any) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in given)
    except (TypeError, ValueError):
        raise CubeError("an axis is three numbers: right, down, forward") from None
    if not 0 < x * x + y * y + z * z < math.inf:
        raise CubeError("an axis needs a length")
    return x, y, z


def _near(places: list[int], reach: int, size: int) -> list[int]:
    """Return rows or columns within reach of some."""
    return sorted(
        {
            near
            for place in places
            for near in range(max(place - reach, 0), min(place + reach + 1, size))
        }
    )
