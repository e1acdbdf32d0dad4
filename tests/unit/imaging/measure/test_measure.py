"""What is measured in range images lies as far off as its stated uncertainty says."""

from __future__ import annotations

from collections.abc import Callable

import exact_shapes as shapes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor.errors import CubeError
from amulor.imaging import measure
from amulor.imaging.measure import fits

DRAWS = 200
FIRST, SECOND, THIRD, FOURTH = (4, 5), (18, 27), (19, 4), (5, 28)


def unit(*parts: float) -> np.ndarray:
    vector = np.array(parts)
    return vector / np.linalg.norm(vector)


@pytest.fixture(scope="module")
def scan() -> shapes.Beams:
    return shapes.beams()


@pytest.fixture(scope="module")
def wall(scan: shapes.Beams) -> np.ndarray:
    return shapes.to_plane(scan, unit(0.3, -0.2, 1.0), 1.5)


def places(scan: shapes.Beams, ranges: np.ndarray, *pixels: tuple[int, int]):
    return [ranges[pixel] * scan.unit[pixel] for pixel in pixels]


def coverage(
    scan: shapes.Beams,
    exact: np.ndarray,
    true: float | list[float],
    take: Callable[[xr.Dataset], tuple[object, object]],
    *,
    draws: int = DRAWS,
) -> None:
    scores = []
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        found, uncertainty = take(shapes.image(scan, exact + shapes.errors(exact, rng)))
        scores.append((np.asarray(found) - true) / np.asarray(uncertainty))
    score = np.abs(scores)
    for limit, share in ((1.0, 0.6827), (1.96, 0.95)):
        # Four standard errors of a share among so many draws.
        room = 4 * (share * (1 - share) / draws) ** 0.5
        inside = np.mean(score < limit, axis=0)
        assert np.all(np.abs(inside - share) < room), (limit, inside)


@pytest.mark.parametrize("reach", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_a_distance_is_covered(
    scan: shapes.Beams, wall: np.ndarray, reach: int
) -> None:
    one, other = (
        np.mean(
            places(
                scan,
                wall,
                *(
                    (row + i, column + j)
                    for i in range(-reach, reach + 1)
                    for j in range(-reach, reach + 1)
                ),
            ),
            axis=0,
        )
        for row, column in (FIRST, SECOND)
    )

    def take(image: xr.Dataset) -> tuple[float, float]:
        found = measure.distance(image, FIRST, SECOND, reach=reach)
        assert found.pixels == 2 * (2 * reach + 1) ** 2
        return found.value, found.uncertainty

    coverage(scan, wall, float(np.linalg.norm(other - one)), take)


def test_a_height_is_covered(scan: shapes.Beams, wall: np.ndarray) -> None:
    one, other = places(scan, wall, FIRST, SECOND)
    axis = unit(0.2, -1.0, -0.7)

    def take(image: xr.Dataset) -> tuple[float, float]:
        found = measure.height(image, FIRST, SECOND, axis=3 * axis)
        return found.value, found.uncertainty

    coverage(scan, wall, float(axis @ (other - one)), take)


def test_an_angle_is_covered(scan: shapes.Beams, wall: np.ndarray) -> None:
    one, corner, other = places(scan, wall, FIRST, THIRD, SECOND)
    a, b = one - corner, other - corner
    true = np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))

    def take(image: xr.Dataset) -> tuple[float, float]:
        found = measure.angle(image, FIRST, THIRD, SECOND)
        return found.value, found.uncertainty

    coverage(scan, wall, float(true), take)


def test_an_area_is_covered(scan: shapes.Beams, wall: np.ndarray) -> None:
    corners = (FIRST, FOURTH, SECOND, THIRD)
    a, b, c, d = places(scan, wall, *corners)
    # A plane quadrilateral by its diagonals.
    true = np.linalg.norm(np.cross(c - a, d - b)) / 2

    def take(image: xr.Dataset) -> tuple[float, float]:
        found = measure.area(image, corners)
        return found.value, found.uncertainty

    coverage(scan, wall, float(true), take)


def every(image: xr.Dataset) -> np.ndarray:
    return np.isfinite(image["slant_range"].values)


def picked(
    fit: Callable[[xr.Dataset, np.ndarray], measure.Fit], *names: str
) -> Callable[[xr.Dataset], tuple[object, object]]:
    def take(image: xr.Dataset) -> tuple[object, object]:
        found = fit(image, every(image))
        assert 0.4 < found.misfit < 1.8
        assert found.doubt == ""
        return (
            [found.values[name] for name in names],
            [found.uncertainties[name] for name in names],
        )

    return take


def test_a_plane_is_covered(scan: shapes.Beams) -> None:
    normal = unit(0.3, -0.2, 1.0)
    small = shapes.Beams(scan.azimuth[::4, ::4], scan.elevation[::4, ::4])
    exact = shapes.to_plane(small, normal, 1.5)
    take = picked(measure.plane, "normal_x", "offset", "tilt")
    coverage(small, exact, [-normal[0], -1.5, np.arccos(normal[2])], take)


def test_a_plane_is_covered_where_noise_is_as_large_as_the_region() -> None:
    # The plane that is nearest to such points lies along the beams: its offset would be
    # 0 and not 1.5 m, its misfit ten to a thousand.
    normal = unit(0.2, -0.1, 1.0)
    scan = shapes.beams(rows=13, columns=15, half=1.5 * shapes.OWN)
    exact = shapes.to_plane(scan, normal, 1.5)
    assert np.ptp(exact * scan.azimuth) < 5 * shapes.OWN
    coverage(
        scan,
        exact,
        [-normal[0], -normal[1]],
        picked(measure.plane, "normal_x", "normal_y"),
    )


@pytest.mark.slow
def test_a_sphere_is_covered() -> None:
    scan = shapes.beams(rows=14, columns=18, half=0.1)
    centre = np.array([0.02, -0.01, 1.6])
    exact = shapes.to_sphere(scan, centre, 0.14)
    take = picked(measure.sphere, "radius", "centre_x", "centre_z")
    coverage(scan, exact, [0.14, 0.02, 1.6], take, draws=250)


@pytest.mark.slow
def test_a_cylinder_is_covered() -> None:
    scan = shapes.beams(rows=14, columns=18, half=0.1)
    axis, point = unit(0.3, 1.0, 0.1), np.array([0.01, 0.0, 1.6])
    exact = shapes.to_cylinder(scan, point, axis, 0.1)
    take = picked(measure.cylinder, "radius", "axis_x", "axis_z")
    coverage(scan, exact, [0.1, axis[0], axis[2]], take, draws=250)


def circle() -> tuple[shapes.Beams, np.ndarray, np.ndarray, np.ndarray]:
    """Return beams that meet a circle on a tilted plane, in two rows, and the circle.

    These are ranges, center and normal; the radius is 0.1 m.
    """
    normal, centre = unit(0.2, -0.1, -1.0), np.array([0.0, 0.02, 1.5])
    turn = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    one = unit(*np.cross(normal, [0.0, 1.0, 0.0]))
    other = np.cross(normal, one)
    rim = centre + 0.1 * (np.cos(turn)[:, None] * one + np.sin(turn)[:, None] * other)
    exact = np.linalg.norm(rim, axis=1).reshape(2, 20)
    direction = (rim / np.linalg.norm(rim, axis=1)[:, None]).reshape(2, 20, 3)
    scan = shapes.Beams(
        np.arctan2(direction[..., 0], direction[..., 2]), -np.arcsin(direction[..., 1])
    )
    return scan, exact, centre, normal


def test_a_circle_without_error_is_found_exactly() -> None:
    scan, exact, centre, normal = circle()
    rim = shapes.image(scan, exact)
    found = measure.circle(rim, every(rim)).values
    assert_allclose(found["radius"], 0.1, rtol=0, atol=1e-9)
    for name, expected in (("centre", centre), ("normal", normal)):
        parts = [found[f"{name}_{axis}"] for axis in "xyz"]
        assert_allclose(parts, expected, rtol=0, atol=1e-7)


@pytest.mark.slow
def test_a_circle_is_covered() -> None:
    scan, exact, _, _ = circle()

    def take(image: xr.Dataset) -> tuple[float, float]:
        found = measure.circle(image, every(image))
        return found.values["radius"], found.uncertainties["radius"]

    coverage(scan, exact, 0.1, take)


def test_shapes_without_error_are_found_exactly() -> None:
    scan = shapes.beams(rows=14, columns=18, half=0.1)
    centre, axis = np.array([0.02, -0.01, 1.6]), unit(0.3, 1.0, 0.1)
    ball = shapes.image(scan, shapes.to_sphere(scan, centre, 0.14))
    found = measure.sphere(ball, every(ball)).values
    assert_allclose(
        [found[f"centre_{name}"] for name in "xyz"], centre, rtol=0, atol=1e-9
    )
    assert_allclose(found["radius"], 0.14, rtol=0, atol=1e-9)
    pipe = shapes.image(scan, shapes.to_cylinder(scan, centre, axis, 0.1))
    found = measure.cylinder(pipe, every(pipe)).values
    assert_allclose([found[f"axis_{name}"] for name in "xyz"], axis, atol=1e-7)
    assert_allclose(found["radius"], 0.1, rtol=0, atol=1e-9)


def test_noise_alone_of_a_plane_seen_straight_on_follows_the_textbook() -> None:
    # Nearly parallel beams: the offset of a plane is a mean, u = sigma / sqrt(n); its
    # slope along x is sigma / sqrt(sum x^2).
    scan = shapes.beams(rows=11, columns=15, half=1e-3)
    image = shapes.image(scan, shapes.to_plane(scan, unit(0.0, 0.0, 1.0), 2.0))
    own = image.drop_vars(
        [str(name) for name in image if str(name).startswith("slant_range_unc")]
        + ["slant_range_common_uncertainty"]
    ).assign(slant_range_uncertainty=image["slant_range_uncertainty"] * 0 + shapes.OWN)
    found = measure.plane(own, every(own))
    assert_allclose(found.uncertainties["offset"], shapes.OWN / 165**0.5, rtol=1e-3)
    x = 2.0 * np.tan(scan.azimuth)
    slope = shapes.OWN / np.sqrt(np.sum((x - x.mean()) ** 2))
    assert_allclose(found.uncertainties["normal_x"], slope, rtol=1e-3)


def test_what_all_pixels_share_cancels_in_a_height_along_parallel_beams() -> None:
    scan = shapes.beams(rows=11, columns=15, half=1e-6)
    image = shapes.image(scan, shapes.to_plane(scan, unit(0.0, 0.0, 1.0), 2.0))
    found = measure.height(image, (2, 2), (8, 12), axis=(0, 0, -1))
    # Equal ranges: delay, index and reference are the same for both.
    assert_allclose(found.uncertainty, 2**0.5 * shapes.OWN, rtol=1e-6)
    assert_allclose(found.random, 2**0.5 * shapes.OWN, rtol=1e-6)
    far = measure.distance(image, (2, 2), (8, 12))
    assert far.value < 1e-4


@pytest.mark.slow
def test_a_bent_surface_enlarges_the_error_of_a_plane(scan: shapes.Beams) -> None:
    flat = shapes.to_plane(scan, unit(0.0, 0.0, 1.0), 1.5)
    bent = flat + 0.02 * (scan.azimuth / 0.16) ** 2
    exact, wrong = (shapes.image(scan, ranges) for ranges in (flat, bent))
    one, other = (measure.plane(image, every(image)) for image in (exact, wrong))
    assert other.misfit > 3
    assert other.uncertainties["normal_x"] > 1.5 * one.uncertainties["normal_x"]


@pytest.mark.parametrize("noise", [6e-3, pytest.param(1e-3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("fit", [measure.sphere, measure.cylinder])
def test_a_flat_patch_gives_no_radius(
    fit: Callable[[xr.Dataset, np.ndarray], measure.Fit], noise: float
) -> None:
    # 45 mm wide at 1.5 m; with 6 mm of noise, points are as deep as the patch is high.
    scan = shapes.beams(rows=10, columns=18, half=0.015)
    exact = shapes.to_plane(scan, unit(0.1, -0.1, 1.0), 1.5)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        scatter = rng.normal(size=exact.shape)
        image = shapes.image(scan, exact + noise * scatter)
        image["slant_range_uncertainty_counting"][:] = noise
        common = image["slant_range_common_uncertainty"]
        image["slant_range_uncertainty"] = np.hypot(common, noise)
        found = fit(image, every(image))
        assert "radius not constrained by these pixels, above " in found.doubt
        # The plane and two or one parameters more leave as much of chi-square.
        flat = measure.plane(image, every(image))
        assert found.misfit == pytest.approx(flat.misfit, abs=0.15)
    # Of ranges whose error is not known, noise alone says as much.
    image["slant_range_uncertainty"] = image["slant_range_uncertainty"] * np.nan
    found = fit(image, every(image))
    assert "radius not constrained by these pixels, above " in found.doubt
    assert np.isnan(found.uncertainties["radius"])


@pytest.mark.parametrize("fit", [measure.plane, measure.sphere, measure.cylinder])
def test_steps_fit_no_shape_and_the_fit_says_so(
    scan: shapes.Beams, fit: Callable[[xr.Dataset, np.ndarray], measure.Fit]
) -> None:
    treads = 1.5 - 0.04 * np.floor((scan.azimuth + 0.16) / 0.064)
    exact = treads / np.cos(scan.azimuth) / np.cos(scan.elevation)
    ranges = exact + shapes.errors(exact, np.random.default_rng(1))
    image = shapes.image(scan, ranges)
    found = fit(image, every(image))
    assert found.misfit > 5
    said = f"does not fit this shape (chi-square {found.misfit:.3g} per degree"
    assert found.doubt.startswith(said)


def test_a_mean_near_a_step_is_of_its_own_side() -> None:
    # 40 mm between the columns 15 and 16, 6 mm of noise, picks one and two pixels off.
    scan = shapes.beams(rows=24, columns=32, half=0.016)
    exact = np.where(scan.azimuth < 0, 1.5, 1.46)
    scores, counts = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        image = shapes.image(scan, exact + 6e-3 * rng.normal(size=exact.shape))
        common = image["slant_range_common_uncertainty"]
        image["slant_range_uncertainty"] = np.hypot(common, 6e-3)
        found = measure.height(image, (12, 14), (12, 17), axis=(0, 0, -1), reach=6)
        scores.append((found.value - 0.04) / found.uncertainty)
        counts.append(found.pixels)
        assert found.uncertainty < 2e-3
    # At most 13 rows of 8 columns each; squares of 60 scores are within four errors.
    assert max(counts) <= 2 * 13 * 8
    assert np.median(counts) > 150
    assert abs(np.mean(np.square(scores)) - 1) < 4 * (2 / 60) ** 0.5


def test_what_cannot_be_measured_is_explained(
    scan: shapes.Beams, wall: np.ndarray
) -> None:
    holed = wall.copy()
    holed[3, 4] = np.nan
    image = shapes.image(scan, holed)
    with pytest.raises(CubeError, match=r"pixel \(3, 4\) holds no range: no target"):
        measure.distance(image, (3, 4), (5, 5))
    with pytest.raises(CubeError, match="outside of the image of 24 rows"):
        measure.distance(image, (0, 0), (24, 0), reach=1)
    with pytest.raises(CubeError, match="both points are the same"):
        measure.distance(image, (5, 5), (5, 5))
    with pytest.raises(CubeError, match="at least 3 corners, got 2"):
        measure.area(image, [(0, 0), (1, 1)])
    with pytest.raises(CubeError, match="needs at least 5 usable pixels"):
        measure.sphere(image, np.eye(24, 32) * 0)
    # The middle row of an odd number is straight on a wall across the beams.
    odd = shapes.beams(rows=11, columns=15)
    across = shapes.image(odd, shapes.to_plane(odd, unit(0.0, 0.0, 1.0), 1.5))
    with pytest.raises(CubeError, match="lie on a line"):
        measure.plane(across, np.arange(11)[:, None] * np.ones(15) == 5)
    with pytest.raises(ValueError, match="axis must be a vector"):
        measure.height(image, (0, 0), (5, 5), axis=(0, 0, 0))
    with pytest.raises(ValueError, match="reach must be at least 0"):
        measure.distance(image, (0, 0), (5, 5), reach=-1)


def test_a_fit_is_doubted_beyond_its_limits() -> None:
    # The limit of the misfit is that of chance, or of all shapes if larger.
    def doubt(misfit: float, chance: float, error: float, kind: str = "sphere") -> str:
        return fits._doubt(kind, misfit, chance, {"radius": 0.1}, {"radius": error})

    limit = 1.5
    for chance in (limit / 2, 2 * limit):
        at = max(limit, chance)
        assert doubt(at, chance, 0.0) == ""
        assert "does not fit this shape" in doubt(1.001 * at, chance, 0.0)
        assert doubt(1.001 * at, chance, 0.0, kind="circle") == ""
    sure = 0.1 / 4
    assert doubt(1.0, 1.0, 0.999 * sure) == ""
    text = doubt(1.0, 1.0, 1.001 * sure)
    # The curvature 1 / r is normal: its upper limit at two errors is (1 + 2 s) / r.
    least = 100 / (1 + 2 * 1.001 / 4)
    assert f"above {least:.3g} mm" in text


def test_an_angle_between_arms_of_different_length_has_the_error_of_each() -> None:
    # Own noise alone, so that three draws of one pixel each are independent.
    beams = shapes.beams()
    flat = shapes.to_plane(beams, unit(0.3, -0.2, 1.0), 1.5)
    pixels = (12, 14), (12, 10), (23, 31)
    found = measure.angle(shapes.image(beams, flat), *pixels)

    def angle(ranges: np.ndarray) -> float:
        first, corner, second = places(beams, ranges, *pixels)
        a, b = first - corner, second - corner
        return float(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))

    assert found.value == pytest.approx(angle(flat))
    square = 0.0
    for pixel in pixels:
        ends = []
        for sign in (1, -1):
            moved = flat.copy()
            moved[pixel] += sign * 1e-6
            ends.append(angle(moved))
        square += ((ends[0] - ends[1]) / 2e-6 * shapes.OWN) ** 2
    assert found.random == pytest.approx(np.sqrt(square), rel=1e-4)


@pytest.mark.parametrize(
    ("shape", "fewest"),
    # A plane has 3 numbers, a circle 6 for two conditions a point, a sphere 4, a
    # cylinder 5; one pixel more shows a misfit.
    [("plane", 4), ("circle", 4), ("sphere", 5), ("cylinder", 6)],
)
def test_a_shape_needs_one_pixel_more_than_it_has_numbers(
    scan: shapes.Beams, shape: str, fewest: int
) -> None:
    ball = shapes.to_sphere(scan, np.array([0.0, 0.0, 1.6]), 0.3)
    image = shapes.image(scan, ball)
    region = np.zeros(ball.shape, dtype=bool)
    places = [(4, 5), (18, 27), (19, 4), (5, 28), (12, 16), (9, 20)]
    fit = getattr(measure, shape)
    for row, column in places[: fewest - 1]:
        region[row, column] = True
    assert np.isfinite(ball[region]).all()
    with pytest.raises(CubeError, match=f"at least {fewest} usable pixels"):
        fit(image, region)
    region[places[fewest - 1]] = True
    assert fit(image, region).pixels == fewest
