"""Covariances, means and differences of a few pixels, by hand."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from exact_scenes import image_of
from numpy.testing import assert_allclose
from scipy.constants import speed_of_light

from amulor.errors import CubeError
from amulor.imaging import correlation
from amulor.imaging.correlation import covariance, mean_range, range_difference

PREFIX = "slant_range_uncertainty_"
#: Errors of the pixels: in all, and in common [m].
TOTAL, COMMON = 5e-3, 4e-3
ALL = np.ones((2, 3), dtype=bool)


@pytest.fixture
def image() -> xr.Dataset:
    """Image of two rows and three columns with ranges of 1 to 1.5 m."""
    column, row = np.meshgrid([-0.02, 0.0, 0.02], [0.01, -0.01])
    distance = 1.0 + 0.1 * np.arange(6.0).reshape(2, 3)
    return image_of(distance, column, row, own=3e-3, shared=COMMON)


def _cosine(first: float, second: float) -> float:
    per_range = 4 * np.pi * 39e6 * 1.38 / speed_of_light
    return float(np.cos(per_range * (first - second)))


def _with_terms(image: xr.Dataset, **sizes: float) -> xr.Dataset:
    like = image["slant_range"]
    return image.assign(
        {f"{PREFIX}{name}": xr.full_like(like, size) for name, size in sizes.items()}
    )


def test_common_errors_follow_the_phase_of_the_water(image: xr.Dataset) -> None:
    matrix = covariance(image, ALL)
    assert matrix.shape == (6, 6)
    assert_allclose(np.diag(matrix), TOTAL**2)
    assert_allclose(matrix[0, 1], COMMON**2 * _cosine(1.0, 1.1))
    assert_allclose(matrix[1, 5], COMMON**2 * _cosine(1.1, 1.5))
    assert_allclose(matrix, matrix.T)


def test_terms_that_shift_all_pixels_alike_have_no_cosine(image: xr.Dataset) -> None:
    # 2.4 mm of delay, 1.6 mm of drift, and the rest of 4 mm by the reference.
    terms = _with_terms(image, delay=2.4e-3, drift=1.6e-3)
    rest = COMMON**2 - 2.4e-3**2 - 1.6e-3**2
    expected = 2.4e-3**2 + (1.6e-3**2 + rest) * _cosine(1.0, 1.2)
    assert_allclose(covariance(terms, ALL)[0, 2], expected)
    only = _with_terms(image, delay=2.4e-3, drift=3.2e-3)
    expected = 2.4e-3**2 + 3.2e-3**2 * _cosine(1.0, 1.2)
    assert_allclose(covariance(only, ALL)[0, 2], expected)
    # Terms above the common error leave no other one.
    more = _with_terms(image, delay=5e-3)
    assert_allclose(covariance(more, ALL)[0, 2], 5e-3**2)


def test_errors_of_a_reference_correlate_as_its_polynomial(image: xr.Dataset) -> None:
    constant = covariance(image.assign_attrs(open_water_degree=0), ALL)
    assert_allclose(constant, covariance(image, ALL))
    plane = covariance(image.assign_attrs(open_water_degree=np.array([0, 1])), ALL)
    # Monomials 1, x, y over three columns and two rows: 1/6 + x x'/4 + y y'/6.
    x, y = np.array([-1, 0, 1, -1, 0, 1]), np.array([1, 1, 1, -1, -1, -1])
    gram = 1 / 6 + np.outer(x, x) / 4 + np.outer(y, y) / 6
    norm = np.sqrt(np.outer(np.diag(gram), np.diag(gram)))
    off = ~np.eye(6, dtype=bool)
    assert_allclose(plane[off], (constant * gram / norm)[off], atol=1e-18)
    few = np.array([[True, False, True], [False, False, True]])
    part = covariance(image.assign_attrs(open_water_degree=1), few)
    assert_allclose(part, plane[np.ix_([0, 2, 5], [0, 2, 5])], atol=1e-18)


def test_a_row_of_pixels_has_a_polynomial_of_its_columns(image: xr.Dataset) -> None:
    row = image.isel(row=[0]).assign_attrs(open_water_degree=1)
    matrix = covariance(row, ALL[:1])
    gram = 1 / 3 + np.outer([-1, 0, 1], [-1, 0, 1]) / 2
    norm = np.sqrt(np.outer(np.diag(gram), np.diag(gram)))
    plain = covariance(image.isel(row=[0]), ALL[:1])
    off = ~np.eye(3, dtype=bool)
    assert_allclose(matrix[off], (plain * gram / norm)[off], atol=1e-18)


def test_a_polynomial_of_the_second_degree_has_six_terms() -> None:
    column, row = np.meshgrid(np.linspace(-0.02, 0.02, 5), np.linspace(0.01, -0.01, 4))
    image = image_of(np.full((4, 5), 1.5), column, row, shared=COMMON)
    x, y = (
        values.ravel()
        for values in np.meshgrid([-1, -0.5, 0, 0.5, 1], [1, 1 / 3, -1 / 3, -1])
    )
    columns = np.stack([np.ones(20), x, y, x * x, x * y, y * y], axis=1)
    hat = columns @ np.linalg.inv(columns.T @ columns) @ columns.T
    norm = np.sqrt(np.outer(np.diag(hat), np.diag(hat)))
    which = np.ones((4, 5), dtype=bool)
    found = correlation._along_the_scan(image.assign_attrs(open_water_degree=2), which)
    assert_allclose(found, hat / norm, atol=1e-9)


def test_windows_of_phasor_lines_share_noise(image: xr.Dataset) -> None:
    lines = image.assign_attrs(phasor_line_window=4)
    plain = covariance(image, ALL)
    matrix = covariance(lines, ALL) - plain
    noise = 3e-3**2
    assert_allclose(matrix[0, 1], noise * 3 / 4)
    assert_allclose(matrix[0, 2], noise * 2 / 4)
    assert_allclose(matrix[0, 3], noise * 3 / 4)
    assert_allclose(matrix[0, 5], noise * 2 / 4 * 3 / 4)
    assert_allclose(np.diag(matrix), 0.0, atol=1e-18)
    apart = covariance(image.assign_attrs(phasor_line_window=1), ALL) - plain
    assert_allclose(apart, 0.0, atol=1e-18)


def test_images_without_a_common_part_have_noise_alone(image: xr.Dataset) -> None:
    old = image.drop_vars("slant_range_common_uncertainty")
    assert_allclose(covariance(old, ALL), TOTAL**2 * np.eye(6))


def test_means_have_the_noise_and_the_shared_error(image: xr.Dataset) -> None:
    near = np.array([[True, True, False], [False, False, False]])
    figure = mean_range(image, near)
    assert figure.value == pytest.approx(1.05)
    assert figure.random == pytest.approx(3e-3 / 2**0.5)
    variance = (2 * TOTAL**2 + 2 * COMMON**2 * _cosine(1.0, 1.1)) / 4
    assert figure.uncertainty == pytest.approx(variance**0.5)


def test_a_difference_is_the_second_less_the_first(image: xr.Dataset) -> None:
    alike = _with_terms(image, delay=COMMON)
    first = np.array([[True, True, False], [False, False, False]])
    second = np.array([[False, False, False], [False, False, True]])
    figure = range_difference(alike, first, second)
    assert figure.value == pytest.approx(1.5 - 1.05)
    # The delay cancels, and the noise of one pixel and of a mean of two is left.
    assert figure.uncertainty == pytest.approx(3e-3 * 1.5**0.5)
    assert figure.random == pytest.approx(3e-3 * 1.5**0.5)


def test_regions_omit_pixels_without_a_range(image: xr.Dataset) -> None:
    image["slant_range"].values[0, 0] = np.nan
    assert covariance(image, ALL).shape == (5, 5)
    assert mean_range(image, ALL).value == pytest.approx(1.3)


def test_regions_that_cannot_be_used_are_one_line(
    image: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refusal(function: object, *regions: np.ndarray) -> str:
        with pytest.raises(CubeError) as caught:
            function(image, *regions)  # type: ignore[operator]
        return str(caught.value)

    assert refusal(mean_range, np.ones((3, 2))) == (
        "the region has the shape (3, 2), the image (2, 3); they must agree"
    )
    nothing = np.zeros((2, 3), dtype=bool)
    assert refusal(mean_range, nothing) == (
        "the region has no usable pixel; enlarge it"
    )
    corner = nothing.copy()
    corner[0, :2] = True
    assert refusal(range_difference, corner, ALL) == (
        "the regions share 2 pixels; choose regions apart from each other"
    )
    monkeypatch.setattr(correlation, "_MOST_PIXELS", 5)
    assert refusal(covariance, ALL) == (
        "6 pixels are too many for a covariance matrix, at most 5 fit; take a smaller "
        "region"
    )
    monkeypatch.setattr(correlation, "_MOST_PIXELS", 6)
    assert covariance(image, ALL).shape == (6, 6)
