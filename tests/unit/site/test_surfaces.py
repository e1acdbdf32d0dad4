"""Surfaces of scans by closed forms: planes, polynomials, gaps and shared errors."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose
from site_scenes import scanning

from amulor.cube import QualityFlag, schema
from amulor.errors import CubeError
from amulor.site.registration import surface as surfaces
from amulor.site.registration.surface import (
    ScanSurface,
    Shared,
    corrected,
    range_correction,
    scan_surface,
    shared_errors,
    usable_pixels,
    with_correction,
)

#: Speed of light in vacuum [m/s].
LIGHT = 299_792_458.0
OWN = 5e-4
NORMAL = np.array([0.1, -0.2, -1.0]) / np.linalg.norm([0.1, -0.2, -1.0])


def plane(rng: np.random.Generator | None = None, **changes: Any) -> xr.Dataset:
    """Return an image of a tilted plane 2 m ahead, with noise if drawn."""
    azimuth, elevation, unit = scanning.grid(24, 30, 0.09)
    errors = scanning.Errors(**({"own": OWN, "delay": 1e-3} | changes))
    distance = (2.0 * NORMAL[2]) / (unit @ NORMAL)
    image = scanning.image(
        distance, azimuth, elevation, errors=errors,
        draw=scanning.Draw(rng or np.random.default_rng(1)), scan="a",
    )  # fmt: skip
    if rng is None:
        exact = image["slant_range"].copy(data=distance)
        image = image.assign(slant_range=exact)
    return image


def surface_of(image: xr.Dataset, *, window: int = 7) -> ScanSurface:
    shared = shared_errors(image, scan="a", instrument="i", water="w")
    return scan_surface(image, name="a", shared=shared, window=window)


def test_a_plane_is_smooth_where_a_window_fits_and_has_its_normal() -> None:
    surface = surface_of(plane())
    expected = np.zeros((24, 30), dtype=bool)
    expected[3:-3, 3:-3] = True
    np.testing.assert_array_equal(surface.smooth, expected)
    assert_allclose(
        surface.normal[surface.smooth], np.tile(NORMAL, (expected.sum(), 1)), atol=2e-4
    )
    assert np.isnan(surface.normal[~surface.smooth]).all()
    # Points by neighbors are on the same plane.
    apart = surface.apart[surface.smooth]
    assert_allclose(apart, surface.position[surface.smooth], atol=1e-5)
    assert_allclose(surface.position @ NORMAL, 2.0 * NORMAL[2], atol=1e-9)
    assert_allclose(surface.own, OWN, rtol=1e-6)


def test_the_place_of_a_pixel_by_neighbors_does_not_use_its_own_range() -> None:
    image = plane()
    other = image["slant_range"].copy(deep=True)
    other[10, 12] += 4 * OWN
    one, two = surface_of(image), surface_of(image.assign(slant_range=other))
    assert_allclose(two.apart[10, 12], one.apart[10, 12], atol=1e-12)
    assert np.linalg.norm(two.apart[10, 13] - one.apart[10, 13]) > OWN / 100
    assert_allclose(two.patch[0, 10, 12], one.patch[0, 10, 12], rtol=1e-3)
    assert two.patch[0, 10, 12] != one.patch[0, 10, 12]


@pytest.mark.parametrize(("window", "degree"), [(7, 4), (5, 4), (3, 2)])
def test_patches_follow_a_polynomial_of_their_degree(window: int, degree: int) -> None:
    surface = surface_of(plane(), window=window)
    powers = [tuple(row) for row in surface.powers]
    terms = [(i, n - i) for n in range(degree + 1) for i in range(n, -1, -1)]
    assert powers == terms
    row, column = np.mgrid[-3:4, -3:4].astype(float)
    half = window // 2
    inside = np.s_[3 - half : 4 + half, 3 - half : 4 + half]
    for number, (i, j) in enumerate(terms):
        values = (row**i * column**j)[inside]
        found = np.einsum("kij,ij->k", surface.kernels, values)
        assert_allclose(found, np.arange(len(terms)) == number, atol=1e-9)


def test_the_noise_of_a_slope_is_that_of_least_squares_of_second_degree() -> None:
    # In a window of 7 x 7 the squares of one coordinate add up to 7 * 28.
    assert surface_of(plane()).slope == pytest.approx(1 / np.sqrt(7 * 28))


def test_a_step_is_not_smooth_in_any_window_that_contains_it() -> None:
    rng = np.random.default_rng(4)
    image = plane(rng)
    distance = image["slant_range"].copy(deep=True)
    distance[:, 15:] += 0.05
    surface = surface_of(image.assign(slant_range=distance))
    assert not surface.smooth[:, 12:18].any()
    # Few windows of noise are beyond the limit.
    assert surface.smooth[3:-3, 3:12].mean() > 0.98
    assert surface.smooth[3:-3, 18:-3].mean() > 0.98


@pytest.mark.parametrize(("size", "is_smooth"), [(0.98, True), (1.02, False)])
@pytest.mark.parametrize("scatter", [1.0, 2.0, 4.0])
def test_a_window_is_smooth_below_its_limit_of_chi_square(
    scatter: float, size: float, is_smooth: bool
) -> None:
    # Waves of the rows that no polynomial of degree four follows, of which each window
    # contains seven rows with equal signs in turn: the usual scatter.
    image = plane()
    distance = 3.0 * image["slant_range"].values / 2.0
    inverse = 1 / distance
    noise = OWN / distance**2
    row, column = np.mgrid[-3:4, -3:4]
    terms = [(row**i * column**j).ravel() for i in range(5) for j in range(5 - i)]
    hat = np.linalg.pinv(np.stack(terms, axis=1).astype(float))
    rest = np.eye(49) - np.stack(terms, axis=1) @ hat
    board = np.where((row + column) % 2 == 0, 1.0, -1.0).ravel()
    # Sums of squares of residuals of a board of size 1, and of a point in its middle.
    of_board, of_point = float(board @ rest @ board), float(rest[24, 24])
    both = float(rest[24] @ board)
    usual = scatter if scatter > 1 else 1.0
    # Five times the scatter of chi-squares with 34 degrees of freedom, 2 / 34; where
    # the usual scatter is three or more, three times it.
    most = 1 + 5 * (2 / 34) ** 0.5 if usual < 3 else 3.0
    base = (34 * scatter / of_board) ** 0.5 if scatter > 1 else 0.0
    signs = np.where(np.add.outer(np.arange(24), np.arange(30)) % 2 == 0, 1.0, -1.0)
    signs *= signs[12, 15]
    # base^2 of_board + 2 base x both + x^2 of_point = 34 most usual.
    a, b, c = of_point, 2 * base * both, base**2 * of_board - 34 * most * usual
    point = (-b + (b * b - 4 * a * c) ** 0.5) / (2 * a)
    moved = inverse + base * signs * noise
    moved[12, 15] += size * point * noise[12, 15]
    other = image["slant_range"].copy(data=1 / moved)
    surface = surface_of(image.assign(slant_range=other))
    # Noise varies by some percent over a window of this plane, and means are of those.
    assert surface.smooth[12, 15] == is_smooth


def test_normals_have_the_noise_of_slopes_of_second_degree() -> None:
    rng = np.random.default_rng(6)
    noise = OWN * rng.normal(size=(24, 30))
    image = plane()
    surface = surface_of(image.assign(slant_range=image["slant_range"] + noise))
    # Slopes of 7 x 7 points have 1 / 14 of the noise of one, over a spacing; of the
    # third degree it would be 2.4 times as much.
    expected = OWN / 14 / surface.spacing
    found = surface.normal[surface.smooth].std(axis=0)[:2]
    np.testing.assert_allclose(found, expected, rtol=0.5)


def test_normals_face_the_instrument_in_whichever_order_rows_are() -> None:
    image = plane()
    for turned in (image.isel(row=slice(None, None, -1)), image):
        surface = surface_of(turned)
        np.testing.assert_allclose(
            surface.normal[surface.smooth].mean(axis=0), NORMAL, atol=1e-4
        )


def test_noise_ten_times_larger_than_stated_is_smooth_as_everywhere_else() -> None:
    # The limit grows with the usual scatter, so that poor statements leave surfaces.
    rng = np.random.default_rng(5)
    image = plane(rng)
    noise = 10 * OWN * rng.normal(size=(24, 30))
    surface = surface_of(image.assign(slant_range=image["slant_range"] + noise))
    assert surface.smooth[3:-3, 3:-3].mean() > 0.95


@pytest.mark.parametrize("rows", [8, 9])
def test_a_scan_needs_fifty_smooth_pixels(rows: int) -> None:
    image = plane().isel(row=slice(0, rows), column=slice(0, 31))
    # 24 columns of windows in each of two or three rows.
    if rows == 9:
        assert surface_of(image).smooth.sum() == 72
    else:
        with pytest.raises(
            CubeError, match=r"48 of 240 pixels lie on a smooth.* 50 are"
        ):
            surface_of(image)


def test_pixels_are_usable_with_a_good_range_on_one_surface() -> None:
    image = plane().isel(row=slice(0, 2), column=slice(0, 5)).copy(deep=True)
    flag = np.zeros((2, 5), dtype=np.int16)
    flag[0, 1:4] = [QualityFlag.MIXED, QualityFlag.OUTLIER, QualityFlag.MISSING]
    image["quality_flag"] = image["quality_flag"].copy(data=flag)
    image["slant_range"][1, :3] = [np.nan, 0.0, -1.0]
    np.testing.assert_array_equal(
        usable_pixels(image), [[1, 0, 0, 0, 1], [0, 0, 0, 1, 1]]
    )


def grid_scan(distance: np.ndarray, **changes: Any) -> ScanSurface:
    """Return a scan of parallel beams a centimeter from each other."""
    rows, columns = distance.shape
    origin = np.zeros((rows, columns, 3))
    origin[..., 0], origin[..., 1] = np.meshgrid(
        0.01 * np.arange(columns), 0.02 * np.arange(rows)
    )
    direction = np.zeros_like(origin)
    direction[..., 2] = 1.0
    full = np.ones(distance.shape, dtype=bool)
    shapes = np.stack([np.full(distance.shape, 1e-3), 1e-3 * distance])
    fields: dict[str, Any] = {
        "name": "a", "usable": full, "smooth": full, "origin": origin,
        "direction": direction, "distance": distance, "own": 0 * distance + OWN,
        "shared": Shared(keys=("delay", "index"), shapes=shapes, growth=0 * shapes),
        "patch": np.zeros((1, *distance.shape)), "powers": np.zeros((1, 2), int),
        "apart": origin, "kernels": np.zeros((1, 3, 3)), "slope": 0.1,
        "normal": -direction, "attributes": {},
    }  # fmt: skip
    return ScanSurface(**(fields | changes))


def test_the_spacing_is_the_median_along_rows_of_smooth_pixels() -> None:
    flat = np.full((4, 6), 2.0)
    assert grid_scan(flat).spacing == pytest.approx(0.01)
    steep = 2.0 + 0.03 * np.arange(6) + np.zeros((4, 1))
    assert grid_scan(steep).spacing == pytest.approx(np.hypot(0.01, 0.03))
    smooth = np.ones((4, 6), dtype=bool)
    # Only steps between two smooth pixels count: here those of the first columns.
    smooth[:, 2:] = False
    bent = np.where(np.arange(6) < 2, 2.0, steep)
    assert grid_scan(bent[:, ::-1], smooth=smooth[:, ::-1]).spacing == pytest.approx(
        0.01
    )
    assert grid_scan(bent, smooth=smooth).spacing == pytest.approx(0.01)
    assert np.isnan(grid_scan(flat, smooth=np.zeros_like(smooth)).spacing)


def test_steps_of_beams_are_central_inside_and_one_sided_at_the_rim() -> None:
    scan = grid_scan(np.full((3, 4), 2.0))
    # Origins that grow with the square of the column.
    scan.origin[..., 0] = np.arange(4) ** 2
    of_origin, of_direction = scan.steps(np.arange(12))
    along_rows, along_columns = of_origin.reshape(2, 3, 4, 3)
    assert_allclose(along_columns[1, :, 0], [1.0, 2.0, 4.0, 5.0])
    assert_allclose(along_rows[..., 1], 0.02)
    assert_allclose(along_columns[..., 1:], 0.0)
    assert_allclose(of_direction, 0.0)
    single = grid_scan(np.full((1, 1), 2.0)).steps(np.zeros(1, int))
    assert_allclose(single, 0.0)


def test_points_and_corrections_go_along_the_beams() -> None:
    scan = grid_scan(np.full((2, 3), 2.0))
    assert_allclose(scan.points(np.array([4])), [[0.01, 0.02, 2.0]])
    errors = {"delay": 2.0, "index": -1.5, "of others": 9.0}
    # 2 mm, less 1.5 of a thousandth of 2 m.
    assert_allclose(range_correction(scan, errors), 2e-3 - 3e-3)
    assert_allclose(corrected(scan, errors)[..., 2], 2.001)
    assert scan.keys == ("delay", "index")
    assert scan.moved(np.arange(2), np.zeros((2, 3))).shape == (0, 2, 3)


def test_a_corrected_surface_has_new_patches_and_places() -> None:
    surface = surface_of(plane())
    change = np.full((24, 30), 0.1)
    nearer = with_correction(surface, change)
    assert_allclose(nearer.distance, surface.distance - 0.1)
    inside = surface.smooth
    assert_allclose(1 / nearer.patch[0][inside], nearer.distance[inside], rtol=1e-4)
    off = np.linalg.norm(nearer.apart - nearer.position, axis=-1)[inside]
    assert off.max() < 1e-3
    # Nearer by a constant it is no plane through the same normal.
    assert np.abs(nearer.normal[inside] - surface.normal[inside]).max() > 1e-3


def image_of(distance: list[list[float]], **terms: float) -> xr.Dataset:
    values = np.array(distance)
    image = xr.Dataset(
        {"slant_range": (("row", "column"), values)},
        attrs={"modulation_frequencies": [5e7]},
    )
    image["geometry"] = ((), 0, {"group_index": 1.35})
    for name, size in terms.items():
        image[f"slant_range_{name}"] = image["slant_range"] * 0 + size
    return image


def errors_of(image: xr.Dataset, **changes: Any) -> dict[str, tuple[Any, Any]]:
    found = shared_errors(image, scan="s", instrument="i", water="w", **changes)
    return {
        key: (shape, growth)
        for key, shape, growth in zip(
            found.keys, found.shapes, found.growth, strict=True
        )
    }


def test_errors_of_instrument_and_water_grow_with_their_power_of_the_range() -> None:
    image = image_of(
        [[2.0, 4.0], [np.nan, 1.0]], uncertainty_delay=1e-3, uncertainty_geometry=2e-3,
        uncertainty_group_index=3e-3, uncertainty_late_echo=4e-3,
    )  # fmt: skip
    found = errors_of(image)
    growth = {"delay: i": 0, "geometry: i": 0, "group_index: w": 3, "late_echo: w": 8}
    assert found.keys() == growth.keys()
    sizes = {"delay: i": 1e-3, "geometry: i": 2e-3, "group_index: w": 3e-3, "late_echo: w": 4e-3}  # fmt: skip  # noqa: E501
    for key, (shape, slope) in found.items():
        # Where nothing was measured there is no error.
        assert_allclose(shape, sizes[key] * np.array([[1, 1], [0, 1]]))
        expected = 1e-3 * growth[key] * np.array([[0.5, 0.25], [0, 1]])
        assert_allclose(slope, expected)


def test_each_term_that_moves_all_pixels_alike_has_a_shape() -> None:
    terms = {f"uncertainty_{name}": 1e-3 for name in schema.ALIKE_TERMS}
    found = errors_of(image_of([[2.0, 4.0]], **terms))
    assert {key.partition(": ")[0] for key in found} == set(schema.ALIKE_TERMS)
    for name in ("instrument", "corners", "surroundings"):
        # Their errors differ from scan to scan, and do not grow with the range.
        shape, growth = found[f"{name}: s"]
        assert_allclose(shape, 1e-3)
        assert_allclose(growth, 0.0)


def test_a_term_without_an_error_is_none() -> None:
    found = errors_of(image_of([[2.0, 4.0]], uncertainty_delay=0.0))
    assert found == {}


def test_a_drift_goes_from_minus_to_plus_over_the_rows_or_a_course() -> None:
    image = image_of([[2.0, 2.0], [2.0, np.nan], [2.0, 2.0]])
    (shape, growth) = errors_of(image, drift=1e-3)["drift: s"]
    assert_allclose(shape, [[-1e-3, -1e-3], [0, 0], [1e-3, 1e-3]])
    assert_allclose(growth, 0.0)
    course = np.array([[0.0, 0.25], [0.5, 0.75], [np.nan, 1.0]])
    (shape, _) = errors_of(image, drift=1e-3, course=course)["drift: s"]
    assert_allclose(shape, [[-1e-3, -5e-4], [0, 0], [0, 1e-3]])
    assert errors_of(image) == {}


@pytest.mark.parametrize("name", ["uncertainty_drift", "uncertainty_column"])
def test_errors_of_the_water_turn_with_the_phase_of_the_modulation(name: str) -> None:
    image = image_of([[2.0, 2.3, 2.9, 3.1]], **{name: 1e-3})
    found = errors_of(image)
    assert list(found) == ["shape 1: s", "shape 2: s"]
    shapes = np.array([shape.ravel() for shape, _ in found.values()])
    # Their covariance is that of equal errors times the cosine of the difference of
    # phases, 4 pi f n / c times that of ranges.
    factor = 4 * np.pi * 5e7 * 1.35 / LIGHT
    apart = image["slant_range"].values.T - image["slant_range"].values
    assert_allclose(shapes.T @ shapes, 1e-6 * np.cos(factor * apart), atol=1e-15)
    slopes = np.array([growth.ravel() for _, growth in found.values()])
    # The derivative by the range, by hand: minus the sine.
    assert_allclose(
        slopes.T @ shapes, -1e-6 * factor * np.sin(factor * apart), atol=1e-13
    )


def test_errors_of_the_water_are_means_over_frequencies() -> None:
    image = image_of([[2.0, 2.3, 2.9, 3.1]], uncertainty_column=1e-3)
    frequencies = [2e7, 5e7, 9e7]
    found = errors_of(image.assign_attrs(modulation_frequencies=frequencies))
    shapes = np.array([shape.ravel() for shape, _ in found.values()])
    factor = 4 * np.pi * np.array(frequencies) * 1.35 / LIGHT
    apart = image["slant_range"].values.T - image["slant_range"].values
    expected = np.mean([np.cos(one * apart) for one in factor], axis=0)
    assert_allclose(shapes.T @ shapes, 1e-6 * expected, atol=1e-14)


def test_the_rest_of_the_common_error_turns_with_the_phase_too() -> None:
    image = image_of(
        [[2.0, 2.3, 2.9, 3.1]], uncertainty_delay=3e-3, uncertainty_column=4e-3,
        common_uncertainty=13e-3,
    )  # fmt: skip
    found = {key: one for key, one in errors_of(image).items() if "shape" in key}
    shapes, slopes = (
        np.array([one[n].ravel() for one in found.values()]) for n in (0, 1)
    )
    # 3, 4 and 12 are 13: of the delay, of the column, and of the rest.
    assert_allclose((shapes**2).sum(axis=0), 1.6e-5 + 1.44e-4)
    factor = 4 * np.pi * 5e7 * 1.35 / LIGHT
    apart = image["slant_range"].values.T - image["slant_range"].values
    assert_allclose(
        slopes.T @ shapes, -1.6e-4 * factor * np.sin(factor * apart), atol=1e-10
    )


def test_functions_of_the_open_water_fit_have_squares_that_add_up_to_one() -> None:
    image = image_of([[2.0] * 6] * 5)
    assert len(surfaces._basis(image)) == 1
    azimuth, elevation = np.meshgrid(np.linspace(0.1, 0.3, 6), np.linspace(-0.1, 0, 5))
    image = image.assign_coords(
        azimuth=(("row", "column"), azimuth), elevation=(("row", "column"), elevation)
    )
    for degree, count in ((0, 1), (1, 3), (2, 6)):
        basis = surfaces._basis(image.assign_attrs(open_water_degree=[0, degree]))
        assert len(basis) == count
        assert_allclose(np.sum(np.square(basis), axis=0), 1.0)
        # Any polynomial of that degree is a sum of them, up to the common scale.
        scale = basis[0] if degree == 0 else 1.0
        assert np.isfinite(scale).all()
    level = image.assign_coords(elevation=(("row", "column"), 0 * elevation))
    # Without extent upwards the powers of one angle are left.
    flat = surfaces._basis(level.assign_attrs(open_water_degree=2))
    assert len(flat) == 3


def test_components_are_the_strongest_of_many_shapes() -> None:
    rng = np.random.default_rng(2)
    directions = np.linalg.qr(rng.normal(size=(50, 30)))[0].T
    sizes = 0.7 ** np.arange(30)
    shapes = [
        (size * one.reshape(5, 10), 2 * size * one.reshape(5, 10))
        for size, one in zip(sizes, directions, strict=True)
    ]
    found = surfaces._principal(shapes)
    # At most 24, the strongest first, and each with its own slope.
    assert len(found) == 24
    assert_allclose([np.linalg.norm(shape) for shape, _ in found], sizes[:24])
    for shape, slope in found:
        assert_allclose(slope, 2 * shape)
    # One of less than a billionth of the variance is left out.
    weak = (3e-5 * directions[1].reshape(5, 10), 0 * directions[1].reshape(5, 10))
    assert len(surfaces._principal([shapes[0], weak])) == 1
    strong = (4e-5 * directions[1].reshape(5, 10), weak[1])
    assert len(surfaces._principal([shapes[0], strong])) == 2
    assert surfaces._principal([]) == []


def test_a_moving_instrument_adds_its_noise() -> None:
    image = plane()
    shared = shared_errors(image, scan="a", instrument="i", water="w")
    motion: Any = SimpleNamespace(own=np.full((24, 30), 12e-4))
    surface = scan_surface(image, name="a", shared=shared, motion=motion)
    # 5 and 12 are 13.
    assert_allclose(surface.own, 13e-4, rtol=1e-6)
