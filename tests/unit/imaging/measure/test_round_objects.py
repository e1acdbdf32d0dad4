"""Axes and profiles of exact shapes lie within their stated errors."""

from __future__ import annotations

from types import SimpleNamespace

import exact_shapes as shapes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.errors import CubeError
from amulor.imaging import measure
from amulor.imaging.measure import round_objects

#: A cone with its tip above the scan, leaning to the right and away from the viewer.
TIP = np.array([-0.06, -0.5, 1.55])
DOWN = np.array([0.10, 1.0, 0.08]) / np.linalg.norm([0.10, 1.0, 0.08])
TANGENT = 0.2


def to_cone(scan: shapes.Beams) -> np.ndarray:
    """Return where beams first meet the cone."""
    square = 1 / (1 + TANGENT**2)
    along, tip = scan.unit @ DOWN, TIP @ DOWN
    a = along**2 - square
    b = square * (scan.unit @ TIP) - along * tip
    c = tip**2 - square * (TIP @ TIP)
    inside = b**2 - a * c
    root = np.sqrt(np.where(inside > 0, inside, np.nan))
    both = np.stack([(-b - root) / a, (-b + root) / a])
    below = both * along - tip > 0
    return np.min(np.where(below & (both > 0), both, np.nan), axis=0)


def every(image: xr.Dataset) -> np.ndarray:
    return np.isfinite(image["slant_range"].values)


def radius_of_cone(found: measure.Revolution) -> np.ndarray:
    """Return the radius of the cone at the heights of a fit."""
    point = np.array([found.fit.values[f"point_{name}"] for name in "xyz"])
    return TANGENT * ((point - TIP) @ DOWN - found.height)


@pytest.fixture(scope="module")
def scan() -> shapes.Beams:
    return shapes.beams(rows=24, columns=24, half=0.07)


def test_a_cone_without_error_is_found_exactly(scan) -> None:
    cone = shapes.image(scan, to_cone(scan))
    found = measure.revolution(cone, every(cone))
    axis = [found.fit.values[f"axis_{name}"] for name in "xyz"]
    assert_allclose(axis, -DOWN, atol=1e-6)
    assert_allclose(found.radius, radius_of_cone(found), atol=1e-7)
    assert found.fit.doubt == ""
    assert found.left_out == 0


def test_handles_do_not_move_the_axis(scan) -> None:
    ranges = to_cone(scan)
    there = np.flatnonzero(np.isfinite(ranges).any(axis=0))
    handle = np.zeros(ranges.shape, dtype=bool)
    handle[9:15, there[-3:]] = True
    handle &= np.isfinite(ranges)
    ranges[handle] -= 0.04
    image = shapes.image(scan, ranges)
    found = measure.revolution(image, every(image))
    assert found.left_out == handle.sum()
    assert_allclose(found.radius, radius_of_cone(found), atol=1e-6)


@pytest.mark.slow
def test_a_cone_is_covered(scan) -> None:
    exact = to_cone(scan)
    rng = np.random.default_rng(20261126)
    scores, draws = [], 120
    for _ in range(draws):
        image = shapes.image(scan, exact + shapes.errors(exact, rng))
        found = measure.revolution(image, every(image))
        values, errors = found.fit.values, found.fit.uncertainties
        inner = slice(10, -10, 20)
        scores.append(
            [
                (values["axis_x"] + DOWN[0]) / errors["axis_x"],
                (values["axis_z"] + DOWN[2]) / errors["axis_z"],
                *((found.radius - radius_of_cone(found)) / found.uncertainty)[inner],
            ]
        )
    inside = np.mean(np.abs(scores) < 1.96, axis=0)
    # Four standard errors of a share of 95 % in 120 draws.
    assert (inside > 0.95 - 4 * np.sqrt(0.95 * 0.05 / draws)).all(), inside
    spread = np.sqrt(np.mean(np.square(scores), axis=0))
    assert (spread > 0.75).all(), spread


@pytest.mark.parametrize("name", ["ball", "board"])
def test_shapes_without_an_axis_are_refused(name) -> None:
    scan = shapes.beams(rows=20, columns=26, half=0.1)
    centre, forward = np.array([0.02, -0.01, 1.6]), np.array([0.0, 0.0, 1.0])
    exact = {
        "ball": shapes.to_sphere(scan, centre, 0.12),
        "board": shapes.to_plane(scan, forward, 1.5),
    }[name]
    rng = np.random.default_rng(4)
    image = shapes.image(scan, exact + shapes.errors(exact, rng))
    with pytest.raises(CubeError, match=r"do not settle|no surface of revolution"):
        measure.revolution(image, every(image))


def test_the_fewest_pixels_of_a_cone_are_enough(scan, monkeypatch) -> None:
    cone = shapes.image(scan, to_cone(scan))
    monkeypatch.setattr(round_objects, "_FEWEST", int(every(cone).sum()))
    assert measure.revolution(cone, every(cone)).left_out == 0


def test_few_pixels_are_refused(scan) -> None:
    cone = shapes.image(scan, to_cone(scan))
    region = np.zeros(cone["slant_range"].shape, dtype=bool)
    region[10:14, 8:14] = True
    with pytest.raises(CubeError, match="at least 60 usable pixels"):
        measure.revolution(cone, region)


@pytest.mark.parametrize(
    ("residual", "misfit", "error", "behind", "reason"),
    [
        (1.9e-3, 9.0, 1e-3, 0.049, ""),
        (1.9e-3, 9.0, 1e-3, 0.051, "not round: 5% of the pixels lie behind the axis"),
        (2.1e-3, 1.6, 1e-3, 0.0, "not round: pixels lie 2.1 mm off (rms)"),
        # Noise explains as much.
        (2.1e-3, 1.4, 1e-3, 0.0, ""),
        (0.0, 1.0, 24e-3, 0.0, ""),
        (0.0, 1.0, 26e-3, 0.0, "radius not constrained by these pixels; take a larger"),
    ],
)
def test_a_profile_is_doubted_for_its_worst_fault(
    residual, misfit, error, behind, reason
) -> None:
    # A radius of 10 cm: 2 % are 2 mm, and a quarter of it is 25 mm.
    fit = SimpleNamespace(residual=residual, misfit=misfit)
    radius, errors = np.array([0.02, 0.1, 0.05]), np.array([1.0, error, 1.0])
    found = round_objects._doubt(fit, radius, errors, behind)
    assert found.startswith(reason)
    assert bool(found) == bool(reason)
