"""Errors of means and differences: what a shared reference does to them."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose

from amulor import imaging, rejection
from amulor.errors import CubeError
from amulor.imaging import correlation
from amulor.simulation import simulate
from amulor.survey import Survey

LEFT = np.zeros((6, 12), dtype=bool)
LEFT[:, :3] = True
RIGHT = LEFT[:, ::-1]
ALL = np.ones((6, 12), dtype=bool)


def _images(text: str, seeds: int) -> list[xr.Dataset]:
    survey = Survey.from_text(text)
    return [
        imaging.range_image(
            rejection.open_water(simulate(survey, rng=seed)), polarization="VV"
        )
        for seed in range(seeds)
    ]


@pytest.fixture(scope="module")
def images(plate_text: str) -> list[xr.Dataset]:
    # Few shots, so that the reference is the larger part of the error of a mean.
    return _images(plate_text.replace("repeats = 8", "repeats = 3"), 1)


@pytest.mark.study
def test_means_and_differences_scatter_as_stated(plate_text: str) -> None:
    images = _images(plate_text.replace("repeats = 8", "repeats = 3"), 60)
    scores = {"mean": [], "difference": []}
    naive = []
    for image in images:
        error = image["slant_range"] - image["truth_slant_range"]
        error = error - image["slant_range_bias"]
        values = error.values
        mean = correlation.mean_range(image, ALL)
        # Drift and column are stated from other knowledge; this simulation has neither,
        # and in a mean they stand with their whole size.
        other = sum(
            image[f"slant_range_uncertainty_{name}"].values.mean() ** 2
            for name in ("drift", "column")
        )
        scatter = np.sqrt(mean.uncertainty**2 - other)
        scores["mean"].append(values.mean() / scatter)
        naive.append(values.mean() / mean.random)
        found = correlation.range_difference(image, LEFT, RIGHT)
        difference = values[RIGHT].mean() - values[LEFT].mean()
        scores["difference"].append(difference / found.uncertainty)
    # 60 draws: a standard deviation to 9 %; three of them, and the shots' own scatter.
    # In a difference the column of one frequency stands with what both sides share.
    for name, least in (("mean", 0.7), ("difference", 0.5)):
        assert least < np.std(scores[name]) < 1.35, name
    # Noise alone would promise too much: 1.46 of 1 as drawn, 9 % by chance.
    assert np.std(naive) > 1.2


def test_the_matrix_is_a_covariance(images: list[xr.Dataset]) -> None:
    matrix = correlation.covariance(images[0], ALL)
    assert_allclose(matrix, matrix.T, rtol=1e-12)
    assert_allclose(
        np.diag(matrix), images[0]["slant_range_uncertainty"].values.ravel() ** 2
    )
    assert np.linalg.eigvalsh(matrix).min() > 0
    shared = images[0]["slant_range_common_uncertainty"].values
    # Neighbours share nearly all, the two ends of the scan less.
    near = matrix[29, 30] / (shared[2, 5] * shared[2, 6])
    far = matrix[0, 71] / (shared[0, 0] * shared[5, 11])
    assert 0.8 < near <= 1
    assert abs(far) < near


def test_without_a_reference_pixels_are_independent(plate: Survey) -> None:
    image = imaging.range_image(
        rejection.keep_water(simulate(plate, rng=1)), polarization="VV"
    )
    matrix = correlation.covariance(image, LEFT)
    assert (matrix[~np.eye(len(matrix), dtype=bool)] == 0).all()
    found = correlation.mean_range(image, LEFT)
    assert np.isnan(found.uncertainty)  # the water is in
    counting = image["slant_range_uncertainty_counting"].values[LEFT]
    expected = np.sqrt(np.sum(counting**2)) / 18
    assert found.random == pytest.approx(expected)


def test_odd_regions_are_refused(images: list[xr.Dataset]) -> None:
    with pytest.raises(CubeError, match="share 18 pixels"):
        correlation.range_difference(images[0], LEFT, ALL)
    with pytest.raises(CubeError, match="no usable pixel"):
        correlation.mean_range(images[0], np.zeros((6, 12)))
    with pytest.raises(CubeError, match="they must agree"):
        correlation.mean_range(images[0], np.ones((2, 2)))
