"""Parts of the fits of shapes, against formulas of exact spheres and cylinders."""

from __future__ import annotations

import math
from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from amulor.errors import CubeError
from amulor.imaging.measure import fits, round_objects
from amulor.imaging.measure.fits import Fit, fitted, points_in, tangent_plane
from amulor.imaging.measure.points import Points, points_of, reference_basis


def _points(
    position: np.ndarray, *, noise: float = 1e-3, shared: float = 0.0
) -> Points:
    """Points seen straight ahead, with noise and a common error of their ranges."""
    count = len(position)
    return Points(
        position=np.asarray(position, dtype=float),
        direction=np.tile([0.0, 0.0, 1.0], (count, 1)),
        covariance=noise**2 * np.eye(count) + shared**2,
        noise=np.full(count, noise**2),
    )


def _grid(step: float = 0.02, side: int = 5) -> tuple[np.ndarray, np.ndarray]:
    axis = step * (np.arange(side) - (side - 1) / 2)
    x, y = np.meshgrid(axis, axis)
    return x.ravel(), y.ravel()


def test_a_tangent_plane_has_the_slopes_of_its_points() -> None:
    x, y = _grid()
    place = np.stack([x, y, 1.5 + 0.2 * x - 0.3 * y], axis=1)
    middle, back, across, slopes = tangent_plane(_points(place))
    assert_allclose(middle, [0.0, 0.0, 1.5], atol=1e-12)
    assert_allclose(back, [0.0, 0.0, -1.0])
    assert_allclose(across @ across.T, np.eye(2), atol=1e-12)
    assert_allclose(across @ back, 0.0, atol=1e-12)
    # The height towards the receiver falls where the range grows.
    assert_allclose(slopes @ across, [-0.2, 0.3, 0.0], atol=1e-12)
    line = np.stack([x, 2 * x, 1.5 + x], axis=1)
    with pytest.raises(CubeError) as caught:
        tangent_plane(_points(line))
    assert str(caught.value) == (
        "the pixels lie on a line, through which many planes go"
    )


#: A ball of 0.1 m at this place, with the receiver at the origin.
CENTER, RADIUS = np.array([0.01, -0.02, 1.4]), 0.1


def _ball() -> np.ndarray:
    x, y = _grid()
    height = np.sqrt(RADIUS**2 - (x - CENTER[0]) ** 2 - (y - CENTER[1]) ** 2)
    return np.stack([x, y, CENTER[2] - height], axis=1)


def _sphere_values(bent: fits._Bent) -> np.ndarray:
    """Parameters of the ball: the normal of its surface below the middle."""
    normal = (bent.middle - CENTER) / np.linalg.norm(bent.middle - CENTER)
    vector = normal / (normal @ bent.back)
    slopes = -(bent.across @ (vector - bent.back))
    offset = RADIUS - np.linalg.norm(bent.middle - CENTER)
    return np.array([*slopes, offset, 1 / RADIUS])


def test_distances_from_a_ball_are_those_from_its_center_less_the_radius() -> None:
    bent = fits._Bent(_points(_ball()))
    values = _sphere_values(bent)
    at, normal = bent.placed(values)
    assert_allclose(at - RADIUS * normal, CENTER, atol=1e-12)
    place = _ball() + np.array([0.001, 0.002, -0.01])
    expected = np.linalg.norm(place - CENTER, axis=1) - RADIUS
    assert_allclose(bent.apart(values, place)[0], expected, atol=1e-12)
    # Along the beams, as if the cosine had a least value of 0.2.
    unit = (place - CENTER) / np.linalg.norm(place - CENTER, axis=1)[:, None]
    facing = -unit[:, 2]
    cosine = (facing + np.sqrt(facing**2 + 0.4**2)) / 2
    assert_allclose(bent.ranges(values, place)[0], expected / cosine, atol=1e-12)


def test_distances_from_a_cylinder_are_those_from_its_axis() -> None:
    x, y = _grid()
    turn = np.radians(25)
    along = np.array([math.cos(turn), math.sin(turn), 0.0])
    across = x * -along[1] + y * along[0]
    place = np.stack([x, y, 1.4 - np.sqrt(RADIUS**2 - across**2)], axis=1)
    bent = fits._Bent(_points(place))
    middle = bent.middle[2] - (1.4 - RADIUS)
    values = np.array([0.0, 0.0, middle, 1 / RADIUS, 0.0])
    _, normal = bent.placed(values)
    flat = bent.axis(values, normal)
    angle = math.atan2(np.cross(flat, along) @ normal, flat @ along)
    values[4] = angle
    axis = bent.axis(values, normal)
    assert abs(axis @ along) == pytest.approx(1.0)
    away = place + np.array([0.003, 0.001, -0.02]) - np.array([0.0, 0.0, 1.4])
    distance = np.linalg.norm(away - np.outer(away @ along, along), axis=1)
    found = bent.apart(values, place + np.array([0.003, 0.001, -0.02]))
    assert_allclose(found[0], distance - RADIUS, atol=1e-12)
    start = bent.start(values[4])
    assert start[4] == values[4]
    assert start[3] == pytest.approx(1 / RADIUS, rel=0.1)


def test_the_start_of_a_ball_is_near_its_curvature() -> None:
    bent = fits._Bent(_points(_ball()))
    start = bent.start()
    assert len(start) == 4
    assert start[3] == pytest.approx(1 / RADIUS, rel=0.15)
    assert start[2] == pytest.approx(_sphere_values(bent)[2], abs=1e-3)
    flat = fits._Bent(_points(np.stack([*_grid(), 1.4 + 0 * _grid()[0]], axis=1)))
    assert_allclose(flat.start()[2:], 0.0, atol=1e-12)


def test_a_circle_by_least_squares_is_that_of_its_points() -> None:
    angle = np.array([0.1, 1.0, 2.5, 4.0])
    place = np.stack([2 + 3 * np.cos(angle), -1 + 3 * np.sin(angle)], axis=1)
    assert_allclose(fits._round(place), [2.0, -1.0, 3.0])
    with pytest.raises(CubeError) as caught:
        fits._round(np.stack([angle, 2 * angle], axis=1))
    assert str(caught.value) == (
        "the pixels lie too straight for a round shape; take more"
    )


def test_principal_axes_are_right_handed_with_the_shortest_last() -> None:
    rng = np.random.default_rng(3)
    axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    place = rng.normal(size=(40, 3)) * [3.0, 1.0, 0.01] @ axes
    found = fits._principal(place - place.mean(axis=0))
    assert abs(found[2] @ axes[2]) > 0.999
    assert abs(found[0] @ axes[0]) > 0.95
    assert np.linalg.det(found) == pytest.approx(1.0)


def _constant(points: Points, *, kind: str = "plane") -> Fit:
    """Fit of a height to points: the mean, with weights by their noise."""
    return fitted(
        kind, points,
        lambda values, position: (position[:, 2] - values[0])[None],
        [np.zeros(1)],
        lambda values: {"height": float(values[0]), "double": float(2 * values[0])},
    )  # fmt: skip


def test_a_fit_is_the_weighted_mean_with_its_error() -> None:
    heights = np.array([1.0, 1.002, 0.999, 1.001])
    place = np.stack([0 * heights, 0 * heights, heights], axis=1)
    noise = np.array([1.0, 2.0, 1.0, 2.0]) * 1e-6
    points = Points(
        position=place, direction=np.tile([0.0, 0.0, 1.0], (4, 1)),
        covariance=np.diag(noise) + 4e-6, noise=noise,
    )  # fmt: skip
    found = _constant(points)
    weight = 1 / noise
    mean = heights @ weight / weight.sum()
    assert found.values["height"] == pytest.approx(mean)
    assert found.values["double"] == pytest.approx(2 * mean)
    sigma = math.sqrt(1 / weight.sum() + 4e-6)
    assert found.uncertainties["height"] == pytest.approx(sigma, rel=1e-6)
    assert found.uncertainties["double"] == pytest.approx(2 * sigma, rel=1e-6)
    # The shared error cancels in the residuals: three degrees of freedom.
    square = weight @ (heights - mean) ** 2 / 3
    assert found.misfit == pytest.approx(square, rel=1e-5)
    assert found.residual == pytest.approx(math.sqrt(np.mean((heights - mean) ** 2)))
    assert found.pixels == 4
    assert found.kind == "plane"
    assert found.doubt == ""


def test_scatter_beyond_chance_enlarges_the_noise() -> None:
    rng = np.random.default_rng(4)
    heights = rng.standard_normal(200)
    heights = (heights - heights.mean()) / heights.std()
    for factor, enlarged in ((1.15, False), (1.25, True)):
        place = np.stack(
            [0 * heights, 0 * heights, 1 + 1e-3 * factor * heights], axis=1
        )
        found = _constant(_points(place))
        square = factor**2 * 200 / 199
        assert found.misfit == pytest.approx(square, rel=1e-6)
        # Chance explains 1 + 4 sqrt(2 / 199) = 1.40.
        noise = 1e-3 * math.sqrt((square if enlarged else 1.0) / 200)
        assert found.uncertainties["height"] == pytest.approx(noise, rel=1e-6)
    # Picked points of a rim are not doubted.
    wide = np.stack([0 * heights, 0 * heights, 1 + 1e-2 * heights], axis=1)
    assert _constant(_points(wide)).doubt.startswith("does not fit this shape (chi-")
    assert _constant(_points(wide), kind="circle").doubt == ""


def test_unknown_range_errors_leave_the_values_without_an_error() -> None:
    heights = np.array([1.0, 1.002, 0.999, 1.001])
    place = np.stack([0 * heights, 0 * heights, heights], axis=1)
    points = _points(place)
    points.covariance[0, 0] = np.nan
    found = _constant(points)
    assert found.values["height"] == pytest.approx(heights.mean())
    assert np.isnan(list(found.uncertainties.values())).all()
    assert found.misfit == pytest.approx(np.var(heights, ddof=1) / 1e-6, rel=1e-5)


def test_a_fit_that_settles_nothing_is_one_line() -> None:
    place = np.stack([*_grid(), 1 + _grid()[0]], axis=1)
    with pytest.raises(CubeError) as caught:
        fitted(
            "cone", _points(place),
            lambda values, position: (position[:, 2] - values[0] - values[1])[None],
            [np.zeros(2)],
            lambda values: {"sum": float(values.sum())},
        )  # fmt: skip
    assert str(caught.value) == (
        "the pixels do not settle a cone; take a larger part of it"
    )


def test_slopes_are_central_differences() -> None:
    def function(at: np.ndarray) -> np.ndarray:
        return np.array([at[0] ** 2, at[0] * at[1], 3 * at[1]])

    found = fits._slope(function, np.array([2.0, 50.0]))
    assert_allclose(found, [[4, 0], [50, 2], [0, 3]], rtol=1e-6, atol=1e-6)


def test_regions_are_thinned_evenly_and_checked() -> None:
    image = scenes.plane((0, 0, 1), 1.5, rows=9, columns=11)
    image["slant_range"].values[0, 0] = np.nan
    everything = np.ones((9, 11), dtype=bool)
    whole = points_in(image, everything, fewest=4, shape="a plane")
    assert len(whole.position) == 98
    assert_allclose(whole.position[:, 2], 1.5)
    kept = points_in(image, everything, fewest=98, shape="a plane", most=98)
    assert len(kept.position) == 98
    thin = points_in(image, everything, fewest=4, shape="a plane", most=97)
    # Every second row and column, without the first pixel.
    assert len(thin.position) == 5 * 6 - 1
    with pytest.raises(CubeError) as caught:
        points_in(image, everything, fewest=99, shape="a plane")
    assert str(caught.value) == (
        "a plane needs at least 99 usable pixels, the region has 98"
    )
    with pytest.raises(CubeError) as caught:
        points_in(image, everything[:2], fewest=4, shape="a plane")
    assert str(caught.value) == (
        "the region has the shape (2, 11), the image (9, 11); they must agree"
    )
    image["slant_range_uncertainty"].values[:, 4:] = np.nan
    with pytest.raises(CubeError) as caught:
        points_in(image, everything, fewest=36, shape="a plane")
    assert str(caught.value) == (
        "a plane needs at least 36 usable pixels, the region has 35; in 63 more the "
        "noise of the range is unknown"
    )
    assert len(points_in(image, everything, fewest=4, shape="a plane").position) == 35


def test_pixels_that_are_no_points_are_one_line() -> None:
    image = scenes.plane((0, 0, 1), 1.5, rows=9, columns=11)
    image["slant_range"].values[2, 3] = np.nan
    image["quality_flag"].values[2, 3] = 4 | 8 | 32
    for row, column in ((-1, 0), (9, 0), (0, -1), (0, 11)):
        with pytest.raises(CubeError) as caught:
            points_of(image, [0, row], [0, column])
        assert str(caught.value) == (
            f"pixel ({row}, {column}) is outside of the image of 9 rows and 11 columns"
        )
    with pytest.raises(CubeError) as caught:
        points_of(image, [8, 2], [10, 3])
    assert str(caught.value) == (
        "pixel (2, 3) holds no range: no target, ambiguous; pick another"
    )
    image["quality_flag"].values[2, 3] = 32
    with pytest.raises(CubeError, match=r"no range: not measured; pick another"):
        points_of(image, [2], [3])
    twice = points_of(image, [8, 0, 8], [10, 4, 10])
    assert_allclose(twice.position[0], twice.position[2])
    assert twice.covariance[0, 2] == pytest.approx(1e-8)
    assert_allclose(twice.covariance[0, 1], 0.0)
    assert_allclose(twice.noise, 1e-8)


def test_a_reference_basis_gives_the_correlation_of_its_polynomial() -> None:
    azimuth, elevation = np.meshgrid([0.0, 0.1, 0.2], [0.5, 0.3])
    found = reference_basis(azimuth, elevation, degree=1)
    assert_allclose(found["middle"], [0.1, 0.4])
    assert_allclose(found["factor"], [10.0, 10.0])
    assert found["powers"] == [[0, 0], [0, 1], [1, 0]]
    x, y = np.array([-1, 0, 1, -1, 0, 1]), np.array([1, 1, 1, -1, -1, -1])
    monomials = np.stack([np.ones(6), y, x], axis=1)
    vectors = monomials @ np.array(found["matrix"])
    gram = 1 / 6 + np.outer(x, x) / 4 + np.outer(y, y) / 6
    assert_allclose(vectors @ vectors.T, gram, atol=1e-12)
    row = reference_basis(azimuth[:1], elevation[:1], degree=1)
    assert row["factor"] == pytest.approx([10.0, 0.0])
    assert np.array(row["matrix"]).shape == (3, 2)


def _turned(height: np.ndarray, angle: np.ndarray, radius: Any) -> np.ndarray:
    """Points of a vertical surface of revolution, 1.5 m ahead, by height and angle."""
    return np.stack(
        [0.02 + radius * np.sin(angle), -height, 1.5 - radius * np.cos(angle)], axis=1
    )


def test_heights_are_divided_into_levels_of_equal_number() -> None:
    height = np.random.default_rng(5).permutation(np.arange(100.0))
    level = round_objects._levels(height)
    assert_array_equal(np.bincount(level), [20] * 5)
    assert level[height < 20].max() == 0
    means = round_objects._level_means(height**2, height)
    assert_allclose(means[height < 20], np.median(np.arange(20.0) ** 2))
    assert_array_equal(np.unique(round_objects._levels(np.arange(30.0))), [0, 1, 2])
    # Equal heights may leave a level without a pixel.
    equal = round_objects._levels(np.repeat([0.0, 1.0, 2.0], [80, 10, 10]))
    assert_array_equal(np.unique(equal), np.arange(equal.max() + 1))
    many = round_objects._levels(np.arange(2000.0))
    assert many.max() == 39


def test_circles_of_all_levels_have_one_center() -> None:
    rng = np.random.default_rng(6)
    height, angle = rng.uniform(0, 1, 200), rng.uniform(-1.2, 1.2, 200)
    level = round_objects._levels(height)
    radius = 0.1 + 0.02 * level
    side, back = np.array([1.0, 0, 0]), np.array([0.0, 0, -1.0])
    place = _turned(height, angle, radius)
    away = place - np.array([0.0, 0.0, 1.45])
    centre = round_objects._centre(away, side, back, height)
    assert_allclose(centre, [0.02, 0.0, 0.05], atol=1e-12)
    axis = np.array([0.0, -1.0, 0.0])
    assert round_objects._misfit(away, axis, back) == pytest.approx(0.0, abs=1e-12)
    # A tenth of the points is left out.
    away[:20] *= 1.5
    assert round_objects._misfit(away, axis, back) < 1e-3
    assert round_objects._misfit(away, side, back) > 1e-4


def test_knots_lie_where_there_are_pixels() -> None:
    height = np.repeat(np.linspace(0.0, 1.0, 41), 41)
    across = np.tile(np.linspace(0.0, 1.0, 41), 41)
    knots = round_objects._knots(height, across)
    # A pixel is 1 / 41 wide, and 2.5 of them are 0.061: 17 knots.
    assert_allclose(knots, np.linspace(0, 1, 17))
    fine = np.repeat(np.linspace(0.0, 1.0, 400), 10)
    assert (
        len(round_objects._knots(fine, np.tile(np.linspace(0, 0.025, 10), 400))) == 45
    )
    few = round_objects._knots(np.linspace(0, 1, 9), np.linspace(0, 1, 9))
    assert len(few) == 5
    gap = height[(height < 0.4) | (height > 0.6)]
    beside = across[(height < 0.4) | (height > 0.6)]
    kept = round_objects._knots(gap, beside)
    assert not ((kept > 0.45) & (kept < 0.55)).any()
    assert (kept[0], kept[-1]) == (0.0, 1.0)


def _revolution(fit: dict[str, float]) -> Any:
    return Fit(
        kind="surface of revolution", values=fit, uncertainties={}, residual=0.0,
        misfit=1.0, pixels=1,
    )  # fmt: skip


def test_spread_about_a_profile_beyond_the_noise_is_unresolved() -> None:
    rng = np.random.default_rng(7)
    height, angle = rng.uniform(-0.5, 0.5, 1200), rng.uniform(-1, 1, 1200)
    off = np.where(height > 0, 5e-3, 0.0) * np.where(rng.random(1200) < 0.5, 1, -1)
    place = _turned(height, angle, 0.1 + off)
    fit = _revolution(
        {"axis_x": 0.0, "axis_y": -1.0, "axis_z": 0.0,
         "point_x": 0.02, "point_y": 0.0, "point_z": 1.5}
    )  # fmt: skip
    heights = np.linspace(-0.5, 0.5, 21)
    points = _points(place, noise=2e-3)
    found = round_objects._unresolved(points, fit, heights, np.full(21, 0.1))
    assert_array_equal(found[:8], np.zeros(8))
    # Noise counts by the square of the cosine, one and a half times.
    cosine = np.mean(np.cos(angle) ** 2)
    assert_allclose(found[13:], np.sqrt(25e-6 - 1.5 * 4e-6 * cosine), rtol=0.1)
    wrong = round_objects._unresolved(points, fit, heights, np.full(21, 0.11))
    assert_allclose(wrong[:8], np.sqrt(1e-4 - 1.5 * 4e-6 * cosine), rtol=0.03)


def test_the_axis_of_a_cone_is_upright_and_across_the_view() -> None:
    height, angle = (
        values.ravel()
        for values in np.meshgrid(np.linspace(0, 0.4, 25), np.linspace(-1.2, 1.2, 25))
    )
    place = _turned(height, angle, 0.1 - 0.1 * height)
    axis = round_objects._axis_of(_points(place))
    assert_allclose(axis, [0.0, -1.0, 0.0], atol=0.09)
    x, y = _grid(side=12)
    board = np.stack([x, y, 1.5 + 1e-3 * np.sin(400 * x * y)], axis=1)
    with pytest.raises(CubeError) as caught:
        round_objects._axis_of(_points(board))
    assert str(caught.value) == (
        "the pixels do not settle the axis of a surface of revolution: another "
        "direction fits them as well, as for a ball or a board; take a larger part"
    )


def test_a_turned_surface_measures_distances_along_normals_and_beams() -> None:
    """A cone whose radius falls by 0.2 per height."""
    height, angle = (
        values.ravel()
        for values in np.meshgrid(np.linspace(0, 0.4, 25), np.linspace(-1.2, 1.2, 25))
    )
    place = _turned(height, angle, 0.15 - 0.2 * height)
    points = _points(place)
    turned = round_objects._Turned(points, np.array([0.0, -1.0, 0.0]))
    assert_allclose(turned.across, np.cross([0.0, -1.0, 0.0], [0.0, 0.0, -1.0]))
    assert len(turned.heights) == 81
    values = turned.start
    assert_allclose(values[:2], 0.0)
    point, axis = turned.placed(values)
    assert_allclose(axis, [0.0, -1.0, 0.0])
    assert_allclose(point[[0, 2]], [0.02, 1.5], atol=1e-6)
    middle = -point[1]
    assert_allclose(
        turned.profile(values)(turned.heights),
        0.15 - 0.2 * (turned.heights + middle),
        atol=1e-6,
    )
    other = _turned(height, angle, 0.16 - 0.2 * height)
    expected = 0.01 / math.hypot(1, 0.2)
    assert_allclose(turned.apart(values, other)[0], expected, atol=1e-6)
    # The normal of the cone leans up by its slope.
    facing = np.cos(angle) / math.hypot(1, 0.2)
    cosine = (facing + np.hypot(facing, 0.4)) / 2
    assert_allclose(turned.ranges(values, other)[0], expected / cosine, rtol=1e-4)
    by_name = turned.derived(values)
    assert by_name["axis_y"] == pytest.approx(-1.0)
    assert by_name["point_x"] == pytest.approx(0.02, abs=1e-6)
    assert by_name["radius_0"] == pytest.approx(0.15, abs=1e-6)
    assert by_name["radius_80"] == pytest.approx(0.07, abs=1e-6)
    leaning = values.copy()
    leaning[:4] += [0.1, 0.2, 0.03, 0.04]
    point_of, axis_of = turned.placed(leaning)
    vector = axis + 0.1 * turned.across + 0.2 * turned.back
    assert_allclose(axis_of, vector / np.linalg.norm(vector))
    moved = point + 0.03 * turned.across + 0.04 * turned.back
    assert_allclose(point_of, moved)
    best, near = turned.robust()
    assert near.all()
    assert_allclose(turned.apart(best, place)[0], 0.0, atol=1e-6)
    fit = _revolution(
        {f"point_{at}": value for at, value in zip("xyz", point, strict=True)}
    )
    assert round_objects._behind(turned, fit) == 0.0
    fit.values["point_z"] = 1.3
    assert round_objects._behind(turned, fit) == 1.0
    part = round_objects._subset(points, np.arange(625) % 5 == 0)
    assert part.covariance.shape == (125, 125)
    assert_allclose(part.position, place[::5])
    assert part.direction.shape == (125, 3)
    assert_allclose(part.noise, 1e-6)
