"""Parts of a line: random walks and their forms, and rows of both directions."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from amulor.cube import QualityFlag
from amulor.platform import Mounting, Trajectory
from amulor.site.registration import line
from amulor.site.registration.line import (
    Motion,
    by_direction,
    row_of_image,
    rows_of_scan,
)
from amulor.site.registration.pose import ScanPose


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


def a_line(**changes: Any) -> tuple[Any, Trajectory]:
    """Return a line of 10 s without errors of the mounting, and its trajectory."""
    fields: dict[str, Any] = {
        "poses": SimpleNamespace(
            vehicle=SimpleNamespace(time=np.array([5.0, 9.0, 15.0])),
            mounting=Mounting(),
        ),
        "mounting": np.zeros((0, 8)), "bend": 0.0, "drift": (4e-3, 2e-3),
        "forms": (2, 1), "keys": tuple("k" * 9),
        "start": ScanPose(np.eye(3), np.array([1.0, 2.0, 3.0])),
    }  # fmt: skip
    stamps = np.arange(0.0, 20.5, 0.5)
    track = Trajectory(
        time=stamps, position=np.stack([0.2 * stamps, 0 * stamps, 0 * stamps], axis=1),
        attitude=np.tile([0.0, 0.0, 0.0, 1.0], (len(stamps), 1)),
        covariance=np.zeros((len(stamps), 6, 6)), longest_gap=1.0,
    )  # fmt: skip
    return SimpleNamespace(**(fields | changes)), track


@pytest.mark.parametrize(
    ("number", "size", "form", "axis", "kind"),
    [(0, 4e-3, 1, 0, "position"), (4, 4e-3, 2, 1, "position"), (8, 2e-3, 1, 2, "turn")],
)
def test_a_line_is_corrected_by_the_forms_of_its_drift(
    number: int, size: float, form: int, axis: int, kind: str
) -> None:
    motion, track = a_line()
    errors, spread = np.zeros(9), np.zeros((15, 15))
    errors[number], spread[6 + number, 6 + number] = 1.5, 0.25
    found, _ = line.refined(track, motion, motion.start, errors, spread)
    # The messages of the line, and three before and after it.
    assert_allclose(found.time, np.arange(3.5, 17.0, 0.5))
    share = (found.time - 5) / 10
    walk = size * 2**0.5 / (form * np.pi) * np.cos(form * np.pi * share)
    moved = found.position - track.position[7:34]
    turned = Rotation.from_quat(found.attitude).as_rotvec()
    assert_allclose(
        moved[:, axis], -1.5 * walk if kind == "position" else 0, atol=1e-12
    )
    assert_allclose(turned[:, axis], -1.5 * walk if kind == "turn" else 0, atol=1e-12)
    at = axis if kind == "position" else 3 + axis
    assert_allclose(found.covariance[:, at, at], (0.5 * walk) ** 2, atol=1e-15)
    assert_allclose(np.delete(moved, axis, axis=1), 0, atol=1e-12)


def test_the_track_of_a_line_is_turned_about_its_middle() -> None:
    motion, track = a_line(bend=0.03, keys=tuple("k" * 12))
    errors = np.zeros(12)
    errors[1] = 2.0
    found, _ = line.refined(track, motion, motion.start, errors, np.zeros((18, 18)))
    # North, by 2 x 30 mm at the ends of the line, of opposite sign.
    moved = found.position - track.position[7:34]
    share = (found.time - 5) / 10
    assert_allclose(moved[:, 1], -0.06 * (2 * share - 1), atol=1e-12)
    assert_allclose(moved[:, [0, 2]], 0, atol=1e-12)


def test_a_line_moves_with_the_pose_in_its_middle() -> None:
    motion, track = a_line()
    pose = motion.start.changed(np.array([0.1, -0.2, 0.3, 0.0, 0.0, np.pi / 2]))
    spread = np.zeros((15, 15))
    spread[5, 5] = 1e-4
    found, _ = line.refined(track, motion, pose, np.zeros(9), spread)
    old = track.position[7:34] - [1.0, 2.0, 3.0]
    expected = np.stack([-old[:, 1], old[:, 0], old[:, 2]], axis=1)
    expected += np.array([1.1, 1.8, 3.3])
    assert_allclose(found.position, expected, atol=1e-12)
    turned = Rotation.from_quat(found.attitude).as_rotvec()
    assert_allclose(turned, np.tile([0, 0, np.pi / 2], (27, 1)), atol=1e-12)
    # A turn about the vertical of 10 mrad moves a point by its distance.
    away = np.linalg.norm((found.position - pose.position)[:, :2], axis=1)
    sides = found.covariance[:, 0, 0] + found.covariance[:, 1, 1]
    assert_allclose(sides, (0.01 * away) ** 2)
    assert_allclose(found.covariance[:, 5, 5], 1e-4)
