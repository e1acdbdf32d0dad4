"""Flags of pixels: which samples can be left out, and when a pixel is doubtful."""

from __future__ import annotations

import numpy as np
import pytest

from amulor.cube import QualityFlag
from amulor.cube.error import JOINT_OUTLIERS, flags_of_pixels

FREQUENCIES = 6


def _flags(flag: int, count: int) -> np.ndarray:
    """Return flags of one pixel, of which so many samples carry one."""
    samples = np.zeros((FREQUENCIES, 1, 1), dtype=np.int16)
    samples[:count] = flag
    return samples


@pytest.mark.parametrize(
    ("flag", "count", "stays"),
    [
        # Up to a third of the frequencies, and up to a half.
        (QualityFlag.OUTLIER, 2, False),
        (QualityFlag.OUTLIER, 3, True),
        (QualityFlag.NO_TARGET, 3, False),
        (QualityFlag.NO_TARGET, 4, True),
        # Nothing else is a matter of how many.
        (QualityFlag.SATURATED, 1, True),
        (QualityFlag.WATER_RESIDUAL, 1, True),
    ],
)
def test_few_samples_are_left_out_of_a_pixel(
    flag: QualityFlag, count: int, stays: bool
) -> None:
    pixel, left_out = flags_of_pixels(_flags(flag, count))
    assert pixel[0, 0] == (flag if stays else 0)
    assert left_out[:, 0, 0].tolist() == [
        not stays and k < count for k in range(FREQUENCIES)
    ]


def test_other_flags_of_a_sample_that_is_left_out_stay() -> None:
    samples = _flags(QualityFlag.OUTLIER | QualityFlag.SATURATED, 1)
    assert flags_of_pixels(samples)[0][0, 0] == QualityFlag.SATURATED


@pytest.mark.parametrize(("count", "stays"), [(5, False), (6, True)])
def test_joint_estimation_may_leave_out_any_but_all(count: int, stays: bool) -> None:
    samples = _flags(QualityFlag.OUTLIER, count)
    pixel, _ = flags_of_pixels(samples, most_outliers=JOINT_OUTLIERS)
    assert pixel[0, 0] == (QualityFlag.OUTLIER if stays else 0)


def test_flags_of_a_pixel_are_those_of_all_its_samples() -> None:
    samples = np.array([[[1, 0]], [[2, 0]], [[64, 4]]], dtype=np.int16)
    pixel, left_out = flags_of_pixels(samples)
    assert pixel.tolist() == [[67, 0]]
    assert pixel.dtype == np.int16
    assert left_out.tolist() == [[[False, False]], [[False, False]], [[False, True]]]


def test_outliers_and_missing_targets_are_left_out_together() -> None:
    samples = np.zeros((6, 1, 1), dtype=np.int16)
    samples[0], samples[1] = QualityFlag.OUTLIER, QualityFlag.NO_TARGET
    pixel, left_out = flags_of_pixels(samples)
    assert pixel[0, 0] == 0
    assert left_out[:, 0, 0].tolist() == [True, True] + 4 * [False]
