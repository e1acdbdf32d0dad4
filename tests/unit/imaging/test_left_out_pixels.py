"""Pixels that are left out of an image: by flags, by mixed beams, by uncertainty."""

from __future__ import annotations

from typing import Any

import exact_scenes as scenes
import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_array_equal

from amulor import imaging
from amulor.cube import QualityFlag

SIGMAS = [1e-3, 2e-3, 3e-3, 4e-3, np.nan, 1e-3, 1e-3, 1e-3]
FLAGS = [
    0, QualityFlag.MIXED, QualityFlag.OUTLIER, QualityFlag.NO_OPEN_WATER, 0,
    QualityFlag.NO_TARGET, 0, QualityFlag.MIXED | QualityFlag.NO_OPEN_WATER,
]  # fmt: skip


def _image() -> xr.Dataset:
    """Image of two rows of four pixels; one has no target, one an unknown error."""
    image = scenes.plane((0, 0, 1), 1.5, rows=2, columns=4)
    image["slant_range_uncertainty"].values.ravel()[:] = SIGMAS
    image["quality_flag"].values.ravel()[:] = np.array(FLAGS, dtype=np.int16)
    return image


@pytest.mark.parametrize(
    ("options", "gone", "words"),
    [
        ({"good_only": True}, [1, 2, 3, 7], "4 doubtful"),
        ({"mixed": True}, [1, 2, 7], "3 mixed or outlying"),
        ({"largest_uncertainty": 3e-3}, [3, 4], "2 more uncertain than 3 mm"),
        ({"largest_uncertainty": 2.9e-3}, [2, 3, 4], "3 more uncertain than 2.9 mm"),
        (
            {"mixed": True, "largest_uncertainty": 1.5e-3},
            [1, 2, 3, 4, 7],
            "3 mixed or outlying, 2 more uncertain than 1.5 mm",
        ),
        (
            {"good_only": True, "mixed": True},
            [1, 2, 3, 7],
            "4 doubtful, 0 mixed or outlying",
        ),
    ],
)
def test_pixels_are_left_out_for_the_first_reason(
    options: dict[str, Any], gone: list[int], words: str
) -> None:
    image = _image()
    found = imaging.leave_out(image, **options)
    missing = (found["quality_flag"].values.ravel() & QualityFlag.MISSING) != 0
    assert np.flatnonzero(missing).tolist() == gone
    for name in ("slant_range", "slant_range_common_uncertainty"):
        values = found[name].values.ravel()
        assert np.isnan(values[gone]).all()
        kept = np.setdiff1d(np.arange(8), gone)
        assert_array_equal(values[kept], image[name].values.ravel()[kept])
    assert_array_equal(found["intensity"], image["intensity"])
    assert found.attrs["history"].endswith(f"left out: {words}")


def test_an_image_without_such_pixels_stays_as_it_is() -> None:
    image = scenes.plane((0, 0, 1), 1.5, rows=2, columns=4, own=1e-3)
    kept = imaging.leave_out(image, good_only=True, largest_uncertainty=0.1, mixed=True)
    assert "left out" not in str(kept.attrs.get("history", ""))
    assert_array_equal(kept["slant_range"], image["slant_range"])
    plain = imaging.leave_out(_image())
    assert_array_equal(plain["quality_flag"], _image()["quality_flag"])
    for limit in (0.0, -1e-3):
        with pytest.raises(ValueError, match="largest uncertainty must be") as caught:
            imaging.leave_out(image, largest_uncertainty=limit)
        assert str(caught.value) == (
            f"largest uncertainty must be above 0 m, got {limit:g} m"
        )
