"""Measurements and products that the browser page requests."""

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
from amulor.imaging.observation import geometry_of
from amulor.view.page.pictures import Picture
from amulor.view.page.recording import Recording


@dataclass(frozen=True, kw_only=True)
class Made:
    """Product file, ready to download."""

    name: str
    """File name."""
    content: bytes
    """File content."""
    said: str
    """Short description of the product, for the user."""


class Products(Protocol):
    """Interface of an object that makes product files from range images."""

    def offered(self) -> list[dict[str, Any]]:
        """Available products with labels, file endings and options."""

    def make(self, image: xr.Dataset, wanted: dict[str, Any], *, stem: str) -> Made:
        """Make a requested product of a range image as a file."""


#: Flags of pixels that belong to no surface.
_OFF_SURFACE = QualityFlag.MIXED | QualityFlag.OUTLIER
_MOST_PICKS = 200
_LARGEST_REACH = 20
#: Pixels of a round object, which are thinned evenly beyond [1].
_MOST_OF_PROFILE = 3200
#: Pixels of a volume, which are thinned evenly beyond [1].
_MOST_OF_VOLUME = 250_000

_FITS: dict[str, Callable[..., measure.Fit]] = {
    "plane": measure.plane,
    "circle": measure.circle,
    "sphere": measure.sphere,
    "cylinder": measure.cylinder,
}
#: Number of pixels that each kind of measurement needs.
_FIGURES = {"distance": 2, "height": 2, "angle": 3}


def measured(recording: Recording, request: dict[str, Any]) -> dict[str, Any]:
    """Compute the measurement that the page requests, such as a distance."""
    kind = str(request.get("kind", ""))
    channel = str(request.get("channel", recording.channels[0]))
    picture = recording.channel(channel).shown
    if kind == "volume":
        result = _volume(picture, request)
    elif kind == "profile":
        result = _half_profile(picture, request)
    elif kind in _FITS and "region" in request:
        clip = request.get("clip")
        result = _fit(picture, kind, _region(picture, request["region"]), clip=clip)
    elif kind in (*_FIGURES, *_FITS, "area"):
        pixels = _pixels(picture, request.get("pixels"))
        if kind in _FITS:
            result = _fit(picture, kind, pixels)
        else:
            result = _figure(picture, kind, pixels, request)
    else:
        raise CubeError(
            f"{kind[:40]!r} cannot be measured, only "
            f"{', '.join([*_FIGURES, 'area', *_FITS, 'volume', 'profile'])}"
        )
    return {
        "kind": kind,
        "channel": channel,
        "group_index": float(picture.geometry["group_index"]),
        "error_unknown": picture.error_unknown,
        "unknown": str(picture.attributes.get("uncertainty_unknown", "")),
        **result,
    }


def _figure(
    picture: Picture, kind: str, pixels: list[tuple[int, int]], request: dict[str, Any]
) -> dict[str, Any]:
    points_needed = _FIGURES.get(kind)
    if points_needed is not None and len(pixels) != points_needed:
        raise CubeError(f"{kind} needs {points_needed} points, got {len(pixels)}")
    reach = _integer(request.get("reach", 0), "reach", 0, _LARGEST_REACH)
    # Which neighbors count depends on the steps around them.
    wide = reach + STEP_MARGIN if reach else 0
    image = picture.around(
        _near([row for row, _ in pixels], wide, picture.shape[0]),
        _near([column for _, column in pixels], wide, picture.shape[1]),
    )
    at = [picture.place(*pixel) for pixel in pixels]
    if kind == "distance":
        figure = measure.distance(image, at[0], at[1], reach=reach)
    elif kind == "height":
        axis = _axis(request.get("axis", (0.0, -1.0, 0.0)))
        figure = measure.height(image, at[0], at[1], axis=axis, reach=reach)
    elif kind == "angle":
        figure = measure.angle(image, at[0], at[1], at[2], reach=reach)
    else:
        figure = measure.area(image, at, reach=reach)
    numbers = asdict(figure)
    line = {name: _or_none(numbers[name]) for name in ("value", "uncertainty", "unit")}
    return {
        "lines": [{"label": kind, **line}],
        "random": figure.random,
        "pixels": figure.pixels,
    }


def _volume(picture: Picture, request: dict[str, Any]) -> dict[str, Any]:
    """Volume between the surface in a rectangle and the plane fitted in another."""
    rows, columns = _lines(picture, request.get("region"), most=_MOST_OF_VOLUME)
    ground = _region(picture, request.get("base"))
    image = picture.around(
        sorted({*rows, *(row for row, _ in ground)}),
        sorted({*columns, *(column for _, column in ground)}),
    )
    # The image has rows and columns between those of a thinned surface.
    grid = (
        [picture.place(row, columns[0])[0] for row in rows],
        [picture.place(rows[0], column)[1] for column in columns],
    )
    body, base = np.zeros((2, *image["slant_range"].shape), dtype=bool)
    body[np.ix_(*grid)] = True
    base[tuple(np.transpose([picture.place(*pixel) for pixel in ground]))] = True
    body &= _inside(image, request.get("clip"))
    base &= (image["quality_flag"].values & _OFF_SURFACE) == 0
    figure = measure.volume(image, body, base=base, grid=grid)
    line = {
        "label": "volume",
        "value": figure.value,
        "uncertainty": _or_none(figure.uncertainty),
        "unit": figure.unit,
    }
    return {
        "lines": [line],
        "random": _or_none(figure.random),
        "pixels": figure.pixels,
    }


def _half_profile(picture: Picture, request: dict[str, Any]) -> dict[str, Any]:
    """Axis, diameters and half-profile of a round object in a rectangle."""
    pixels = _region(picture, request.get("region"), most=_MOST_OF_PROFILE)
    image, region = _surface_in(picture, pixels, request.get("clip"))
    turned = measure.revolution(image, region)
    fit = turned.fit
    places = {
        "rim diameter": len(turned.radius) - 1,
        "largest diameter": int(np.argmax(turned.radius)),
        "base diameter": 0,
    }
    axis, point = (
        np.array([fit.values[f"{name}_{at}"] for at in "xyz"])
        for name in ("axis", "point")
    )
    lines = [
        {
            "label": label,
            "value": 2 * float(turned.radius[at]),
            "uncertainty": _or_none(2 * float(turned.uncertainty[at])),
            "unit": "m",
        }
        for label, at in places.items()
    ]
    slope = math.hypot(fit.uncertainties["axis_x"], fit.uncertainties["axis_z"])
    lines.append(
        {
            "label": "tilt of the axis",
            "value": math.acos(min(abs(float(axis[1])), 1.0)),
            "uncertainty": _or_none(slope),
            "unit": "rad",
        }
    )
    return {
        **_described(fit, lines),
        "left_out": turned.left_out,
        "axis": [(point + height * axis).tolist() for height in turned.height[[0, -1]]],
        "profile": {
            "height": (turned.height - turned.height[0]).tolist(),
            "radius": turned.radius.tolist(),
            "uncertainty": [_or_none(float(value)) for value in turned.uncertainty],
        },
    }


def _surface_in(
    picture: Picture, pixels: list[tuple[int, int]], clip: Any
) -> tuple[xr.Dataset, np.ndarray]:
    """Image around pixels, and mask of those on a surface within the clip box."""
    image = picture.around(
        sorted({row for row, _ in pixels}), sorted({column for _, column in pixels})
    )
    region = np.zeros(image["slant_range"].shape, dtype=bool)
    for pixel in pixels:
        region[picture.place(*pixel)] = True
    region &= (image["quality_flag"].values & _OFF_SURFACE) == 0
    return image, region & _inside(image, clip)


def _inside(image: xr.Dataset, clip: Any) -> np.ndarray:
    """Whether the point of each pixel is inside the clip box of the page."""
    if clip is None:
        return np.ones(image["slant_range"].shape, dtype=bool)
    beam = geometry_of(image).beam
    ranges = image["slant_range"].values[..., np.newaxis]
    place = beam.entry + ranges * beam.direction
    low, high = (_limits(clip, side) for side in ("low", "high"))
    low = np.where(np.isnan(low), -np.inf, low)
    high = np.where(np.isnan(high), np.inf, high)
    return np.asarray(((place >= low) & (place <= high)).all(axis=-1))


def _limits(clip: Any, side: str) -> np.ndarray:
    """Three limits of a clip box [m]; NaN for a missing limit."""
    values = clip.get(side) if isinstance(clip, dict) else None
    if not isinstance(values, list) or len(values) != 3:
        raise CubeError("a clip box has three low and three high limits")
    try:
        return np.array([np.nan if value is None else value for value in values], float)
    except (TypeError, ValueError):
        raise CubeError("limits of a clip box are numbers [m] or null") from None


def _flatness(fit: measure.Fit) -> dict[str, Any]:
    """Root mean square departure of a surface from its plane, without the noise."""
    noise = fit.residual**2 / max(fit.misfit, 1e-12)
    excess = max(fit.residual**2 - noise, 0.0)
    # The variance of a mean square of normal errors.
    error = noise * math.sqrt(2 / max(fit.pixels - 3, 1))
    value = math.sqrt(excess)
    return {
        "label": "flatness",
        "value": value,
        "uncertainty": min(error / (2 * value), math.sqrt(error))
        if value > 0
        else math.sqrt(error),
        "unit": "m",
    }


def _fit(
    picture: Picture, kind: str, pixels: list[tuple[int, int]], *, clip: Any = None
) -> dict[str, Any]:
    image, region = _surface_in(picture, pixels, clip)
    fit = _FITS[kind](image, region)
    units = {"tilt": "rad", **dict.fromkeys(("offset", "radius"), "m")}
    lines = [
        {
            "label": name.replace("_", " "),
            "value": value,
            "uncertainty": _or_none(fit.uncertainties[name]),
            "unit": units.get(
                name, "m" if name.startswith(("centre", "point")) else "1"
            ),
        }
        for name, value in fit.values.items()
    ]
    if kind == "plane":  # people state how much it leans and bends before where it is
        lines.sort(key=lambda line: line["label"] != "tilt")
        lines.insert(1, _flatness(fit))
    else:  # and diameters
        radius = lines[0] if lines[0]["label"] == "radius" else None
        if radius is not None:
            double = {
                "label": "diameter",
                "value": 2 * float(str(radius["value"])),
                "uncertainty": _or_none(2 * fit.uncertainties["radius"]),
                "unit": "m",
            }
            lines.insert(0, double)
    return _described(fit, lines)


def _described(fit: measure.Fit, lines: list[dict[str, Any]]) -> dict[str, Any]:
    """Values of a fit for the page, without lines if the fit is doubtful."""
    return {
        "lines": [] if fit.doubt else lines,
        "doubt": fit.doubt,
        "residual": fit.residual,
        "misfit": fit.misfit if math.isfinite(fit.misfit) else None,
        "pixels": fit.pixels,
    }


def _or_none(value: Any) -> Any:
    """Return a number, or None if it is NaN."""
    return None if isinstance(value, float) and math.isnan(value) else value


def _region(
    picture: Picture, corners: Any, *, most: int = 1500
) -> list[tuple[int, int]]:
    """Pixels in a rectangle, evenly thinned if they are many."""
    rows, columns = _lines(picture, corners, most=most)
    return [(row, column) for row in rows for column in columns]


def _lines(picture: Picture, corners: Any, *, most: int) -> tuple[list[int], list[int]]:
    """Rows and columns of a rectangle, evenly thinned if it has many pixels."""
    if not isinstance(corners, list) or len(corners) != 4:
        raise CubeError(
            "a region has a first row and column, and a last row and column"
        )
    ends = [
        _integer(value, "a corner of the region", 0, picture.shape[at % 2] - 1)
        for at, value in enumerate(corners)
    ]
    rows = np.arange(min(ends[0], ends[2]), max(ends[0], ends[2]) + 1)
    columns = np.arange(min(ends[1], ends[3]), max(ends[1], ends[3]) + 1)
    step = max(1, math.ceil(math.sqrt(rows.size * columns.size / most)))
    return rows[::step].tolist(), columns[::step].tolist()


def _pixels(picture: Picture, request: Any) -> list[tuple[int, int]]:
    if not isinstance(request, list) or not 1 <= len(request) <= _MOST_PICKS:
        raise CubeError(f"pick 1 to {_MOST_PICKS} pixels")
    pixels = []
    for pixel in request:
        if not isinstance(pixel, list) or len(pixel) != 2:
            raise CubeError("a pixel is a row and a column")
        row = _integer(pixel[0], "row", 0, picture.shape[0] - 1)
        column = _integer(pixel[1], "column", 0, picture.shape[1] - 1)
        pixels.append((row, column))
    return pixels


def _integer(value: Any, name: str, least: int, most: int) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise CubeError(f"{name} must be a whole number")
    if not least <= value <= most:
        raise CubeError(f"{name} must be from {least} to {most}, got {value}")
    return value


def _axis(request: Any) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in request)
    except (TypeError, ValueError):
        raise CubeError("an axis is three numbers: right, down, forward") from None
    if not 0 < x * x + y * y + z * z < math.inf:
        raise CubeError(
            f"an axis of {x:g}, {y:g}, {z:g} has no direction; needed is a length "
            "above 0"
        )
    return x, y, z


def _near(places: list[int], reach: int, size: int) -> list[int]:
    """Row or column indices within `reach` of the given indices."""
    return sorted(
        {
            near
            for place in places
            for near in range(max(place - reach, 0), min(place + reach + 1, size))
        }
    )
