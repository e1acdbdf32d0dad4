"""Parts of a line: random walks and their forms, and rows of both directions."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.cube import QualityFlag
from amulor.platform import Mounting
from amulor.site.registration import line
from amulor.site.registration.line import (
    Motion,
    by_direction,
    row_of_image,
    rows_of_scan,
)


def test_forms_of_a_walk_have_its_covariance_about_its_mean() -> None:
    share = np.array([0.0, 0.2, 0.5, 0.9, 1.0])
    forms = line._walk(share, 3.0, range(1, 20_000))
    first, second = share[:, None], share[None, :]
    # Of a walk of variance s: E (w(s) - mean)(w(t) - mean).
    larger = np.maximum(first, second)
    expected = 9 * (1 / 3 - larger + (first**2 + second**2) / 2)
    assert_allclose(forms.T @ forms, expected, atol=1e-3)
    assert_allclose(line._walk(share, 3.0, range(2, 3))[0, 0], 3 * 2**0.5 / (2 * np.pi))


@pytest.mark.parametrize(
    ("drift", "noise", "expected"),
    [
        (0.0, 1e-3, 0),
        (1e-4, 1e-3, 6),
        # The rest, drift / (pi sqrt(K)), is a third of the noise: K = (3 d / pi n)^2.
        (np.pi / 3 * 9.9**0.5 * 1e-3, 1e-3, 10),
        (np.pi / 3 * 10.1**0.5 * 1e-3, 1e-3, 11),
        (np.pi / 3 * 31.9**0.5 * 2e-3, 2e-3, 32),
        (1.0, 1e-3, 32),
    ],
)
def test_a_walk_has_as_many_forms_as_the_noise_of_a_range_needs(
    drift: float, noise: float, expected: int
) -> None:
    assert line._forms(drift, noise) == expected


@pytest.mark.parametrize(("bend", "turns"), [(0.0, 0), (0.02, 1)])
def test_a_line_without_length_has_no_turn_of_its_track(
    bend: float, turns: int
) -> None:
    motion: Any = SimpleNamespace(
        bend=bend, drift=(1e-3, 1e-4), forms=(3, 2), mounting=np.zeros((4, 8)),
    )  # fmt: skip
    share = np.array([0.0, 0.5, 1.0])
    turn, position, attitude = Motion._along(motion, share)
    assert (len(turn), len(position), len(attitude)) == (turns, 3, 2)
    if turns:
        # From one end to the other, none in the middle.
        assert_allclose(turn[0], [-0.02, 0.0, 0.02])
    firsts = Motion._firsts.fget(motion)  # type: ignore[attr-defined]
    assert firsts == (4, 4 + 3 * turns, 4 + 3 * turns + 9)


def test_errors_of_a_line_are_named_in_order() -> None:
    scan: Any = SimpleNamespace(instrument="lidar", epoch="one", name="line 1")
    mounting = Mounting.model_validate(
        {
            "lever_arm_uncertainties": (1e-3, 0.0, 2e-3), "boresight_uncertainty": 0.0,
            "clock_uncertainty": 1e-3,
        }
    )  # fmt: skip
    keys = line._keys(scan, mounting, 3, (1, 2), bent=True)
    assert keys == (
        "lever arm right: lidar, one",
        "lever arm forward: lidar, one",
        "clock offset: lidar, one",
        *(f"turn of the track {axis}: line 1" for axis in ("east", "north", "up")),
        *(f"drift 1 of position {axis}: line 1" for axis in ("east", "north", "up")),
        *(f"drift 1 of attitude {axis}: line 1" for axis in ("east", "north", "up")),
        *(f"drift 2 of attitude {axis}: line 1" for axis in ("east", "north", "up")),
    )
    assert line._keys(scan, Mounting(), 0, (0, 0), bent=False) == ()


def swinging(rows: int, columns: int) -> xr.Dataset:
    """Return an image whose odd rows were measured from right to left."""
    time = np.arange(rows * columns, dtype=float).reshape(rows, columns)
    time[1::2] = time[1::2, ::-1].copy()
    values = np.arange(rows * columns).reshape(rows, columns)
    return xr.Dataset(
        {
            "slant_range": (("row", "column"), values.astype(float)),
            "quality_flag": (("row", "column"), np.zeros_like(values, dtype=np.int16)),
            "count": (("row", "column"), values),
            "level": ((), 3.0),
        },
        coords={"time": (("row", "column"), time)},
    )


def test_rows_of_both_directions_are_apart_by_empty_rows() -> None:
    image = by_direction(swinging(5, 4))
    order = image.attrs["rows_of_scan"]
    assert_array_equal(order, [0, 2, 4, *([-1] * 8), 1, 3])
    assert_array_equal(image["slant_range"][[0, 1, 2, 11, 12], 0], [0, 8, 16, 4, 12])
    assert np.isnan(image["slant_range"][3:11]).all()
    assert (image["quality_flag"][3:11] == int(QualityFlag.MISSING)).all()
    assert (image["quality_flag"][[0, 1, 2, 11, 12]] == 0).all()
    assert (image["count"][3:11] == 0).all()
    assert float(image["level"]) == 3.0
    assert_array_equal(rows_of_scan(image.attrs, np.array([1, 12])), [2, 3])
    assert row_of_image(image.attrs, 3) == 12
    # A row that is not in the image is beyond it.
    assert row_of_image(image.attrs, 7) == 13 + 7


def test_rows_of_one_direction_stay_as_they_are() -> None:
    both = swinging(4, 3)
    for chosen in (
        both.isel(row=[0, 2]),
        both.isel(row=[1, 3]),
        both.drop_vars("time"),
    ):
        assert by_direction(chosen) is chosen
    assert row_of_image({}, 7) == 7
    assert_array_equal(rows_of_scan({}, np.array([3, 1])), [3, 1])


def test_gaps_of_the_times_do_not_hide_a_direction() -> None:
    image = swinging(4, 5)
    image["time"].values[1, 2] = np.nan
    image["time"].values[2, 0] = np.nan
    assert_array_equal(
        by_direction(image).attrs["rows_of_scan"], [0, 2, *([-1] * 8), 1, 3]
    )
