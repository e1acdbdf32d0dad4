"""Errors of lengths, angles and areas by differences of their ranges."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr

from amulor.errors import CubeError
from amulor.imaging import measure

#: Pixels of a wall that is turned about both axes.
CORNERS = ((1, 2), (2, 9), (7, 8), (6, 1))
Value = Callable[[xr.Dataset], measure.Measurement]
VALUES: dict[str, Value] = {
    "distance": lambda image: measure.distance(image, *CORNERS[:2]),
    "height": lambda image: measure.height(image, *CORNERS[1:3]),
    "relief": lambda image: measure.height(image, *CORNERS[:2], axis=(0.0, 0.6, -2.0)),
    "angle": lambda image: measure.angle(image, *CORNERS[:3]),
    "area": lambda image: measure.area(image, CORNERS),
}


def _wall(**errors: float) -> xr.Dataset:
    image = scenes.plane((0.4, -0.3, 1.0), 1.5, rows=9, columns=11, **errors)
    bumps = 0.01 * np.random.default_rng(3).normal(size=(9, 11))
    return image.assign(slant_range=image["slant_range"] + bumps)


@pytest.mark.parametrize("name", list(VALUES))
def test_a_length_has_the_errors_of_its_pixels(name: str) -> None:
    image = _wall(own=1e-4)
    found = VALUES[name](image)
    square = 0.0
    for pixel in CORNERS:
        ends = []
        for sign in (1, -1):
            moved = image.copy(deep=True)
            moved["slant_range"].values[pixel] += sign * 1e-6
            ends.append(VALUES[name](moved).value)
        square += ((ends[0] - ends[1]) / 2e-6 * 1e-4) ** 2
    assert found.random == pytest.approx(np.sqrt(square), rel=1e-4)
    assert found.uncertainty == pytest.approx(np.sqrt(square), rel=1e-4)
    assert found.unit == {"angle": "rad", "area": "m2"}.get(name, "m")
    assert found.pixels == {"angle": 3, "area": 4}.get(name, 2)


@pytest.mark.parametrize("name", list(VALUES))
def test_an_error_of_all_ranges_moves_a_length_as_it_states(name: str) -> None:
    # A common delay: it shifts all ranges by the same amount.
    image = _wall(own=0.0, shared=1e-4)
    delay = xr.full_like(image["slant_range"], 1e-4)
    image = image.assign(slant_range_uncertainty_delay=delay)
    found = VALUES[name](image)
    ends = [
        VALUES[name](image.assign(slant_range=image["slant_range"] + sign * 1e-5)).value
        for sign in (1, -1)
    ]
    expected = abs(ends[0] - ends[1]) / 2e-5 * 1e-4
    assert found.uncertainty == pytest.approx(expected, rel=1e-3, abs=1e-9)
    assert found.random == pytest.approx(0.0, abs=1e-8)


def test_lengths_are_those_of_points_in_space() -> None:
    image = _wall()
    unit = scenes.directions(9, 11)[2]
    place = image["slant_range"].values[..., None] * unit
    a, b, c, d = (place[pixel] for pixel in CORNERS)
    assert VALUES["distance"](image).value == pytest.approx(np.linalg.norm(a - b))
    assert VALUES["height"](image).value == pytest.approx(b[1] - c[1])
    up = np.array([0.0, 0.6, -2.0]) / np.hypot(0.6, 2.0)
    assert VALUES["relief"](image).value == pytest.approx(up @ (b - a))
    arms = (a - b) / np.linalg.norm(a - b), (c - b) / np.linalg.norm(c - b)
    assert VALUES["angle"](image).value == pytest.approx(np.arccos(arms[0] @ arms[1]))
    vector = (np.cross(a, b) + np.cross(b, c) + np.cross(c, d) + np.cross(d, a)) / 2
    assert VALUES["area"](image).value == pytest.approx(np.linalg.norm(vector))


def test_lengths_that_cannot_be_are_one_line() -> None:
    image = _wall()

    def refusal(function: Callable[..., Any], *arguments: Any, **options: Any) -> str:
        with pytest.raises((CubeError, ValueError)) as caught:
            function(image, *arguments, **options)
        return str(caught.value)

    assert refusal(measure.distance, (1, 1), (1, 1)) == (
        "both points are the same; pick two that are apart"
    )
    assert refusal(measure.angle, (1, 1), (1, 1), (3, 3)) == (
        "two of the points are the same; pick three that are apart"
    )
    assert refusal(measure.height, (1, 1), (2, 2), axis=(0.0, 0.0, 0.0)) == (
        "axis must be a vector of 3 with a length, got [0.0, 0.0, 0.0]"
    )
    assert refusal(measure.area, [(1, 1), (2, 2)]) == (
        "an area needs at least 3 corners, got 2"
    )
    assert refusal(measure.distance, (1, 1), (2, 2), reach=-1) == (
        "reach must be at least 0 pixels, got -1"
    )
    assert refusal(measure.distance, (9, 1), (2, 2), reach=1) == (
        "pixel (9, 1) is outside of the image of 9 rows and 11 columns"
    )
