"""Frames turn points as a surveyor would, and carry the errors of the pose along."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr

from amulor import cube as cubes
from amulor import imaging
from amulor.cube import QualityFlag
from amulor.errors import CubeError
from amulor.survey import Pose


def one_pixel(*, azimuth: float, elevation: float, distance: float) -> xr.Dataset:
    value = {"slant_range": distance, "slant_range_uncertainty": 1e-3, "intensity": 1.0}
    return cubes.build(
        "range_image",
        {
            **{name: np.full((1, 1), number) for name, number in value.items()},
            "quality_flag": np.zeros((1, 1), dtype=np.int16),
        },
        {"azimuth": np.full((1, 1), azimuth), "elevation": np.full((1, 1), elevation)},
        geometry={
            "group_index": 1.38,
            "refractive_index": 1.34,
            "emitter_position": np.zeros(3),
            "receiver_position": np.zeros(3),
        },
        attributes=cubes.attributes("range_image", title="a point", source="by hand"),
    )


@pytest.mark.parametrize(
    ("degrees", "point", "expected"),
    [
        # Right 1, down 0.5, forward 2, by hand: heading north, east, and south-west.
        ((0, 0, 0), (1, 0.5, 2), (1, 2, -0.5)),
        ((90, 0, 0), (1, 0.5, 2), (2, -1, -0.5)),
        ((225, 0, 0), (0, 0, 2), (-(2**0.5), -(2**0.5), 0)),
        # Straight up and straight down; the upper edge is towards the heading below.
        ((0, 90, 0), (0, 0, 2), (0, 0, 2)),
        ((0, -90, 0), (0, -1, 2), (0, 1, -2)),
        # Rolled by a quarter the right axis points down and the down axis left.
        ((0, 0, 90), (1, 0, 0), (0, 0, -1)),
        ((0, 0, 90), (0, 1, 0), (-1, 0, 0)),
    ],
)
def test_a_pose_turns_points_as_on_a_ship(degrees, point, expected) -> None:
    heading, pitch, roll = np.radians(degrees)
    pose = Pose(position=(10, 20, -30), heading=heading, pitch=pitch, roll=roll)
    frame = imaging.frame_of(xr.Dataset(), axes="pose", pose=pose)
    found = frame.place(np.array(point, dtype=float))
    np.testing.assert_allclose(found, np.add(expected, (10, 20, -30)), atol=1e-12)
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)
    whole = frame.matrix @ np.array([*point, 1.0])
    np.testing.assert_allclose(whole[:3], found, atol=1e-12)


def test_z_up_has_forward_as_its_second_axis() -> None:
    frame = imaging.frame_of(xr.Dataset(), axes="z-up")
    np.testing.assert_allclose(frame.place([1.0, 0.5, 2.0]), [1.0, 2.0, -0.5])
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)


def test_uncertainties_of_coordinates_follow_the_beam() -> None:
    # A beam 30 degrees to the right: half of the range's error goes to x.
    image = one_pixel(azimuth=np.pi / 6, elevation=0.0, distance=2.0)
    cloud = imaging.point_cloud(image)
    found = [float(cloud[f"{axis}_uncertainty"][0]) for axis in "xyz"]
    np.testing.assert_allclose(found, [0.5e-3, 0.0, 3**0.5 / 2 * 1e-3], atol=1e-12)
    assert [float(cloud[axis][0]) for axis in "xyz"] == pytest.approx([1, 0, 3**0.5])


def test_errors_of_a_pose_are_those_of_poses_that_are_drawn() -> None:
    image = one_pixel(azimuth=0.2, elevation=-0.1, distance=4.0)
    stated = {
        "position_uncertainty": 0.01,
        "heading_uncertainty": 0.004,
        "level_uncertainty": 0.002,
    }
    angles = {"heading": 0.7, "pitch": -0.4, "roll": 0.3}
    frame = imaging.frame_of(image, axes="pose", pose=Pose(**angles, **stated))
    cloud = imaging.point_cloud(image, frame=frame)
    rng = np.random.default_rng(5)
    inside = imaging.point_cloud(image)
    at = np.array([float(inside[axis][0]) for axis in "xyz"])
    drawn = []
    for _ in range(2000):
        off = Pose(
            position=tuple(rng.normal(scale=0.01, size=3)),
            heading=0.7 + rng.normal(scale=0.004),
            pitch=-0.4 + rng.normal(scale=0.002),
            roll=0.3 + rng.normal(scale=0.002),
        )
        one = imaging.frame_of(image, axes="pose", pose=off)
        longer = at * (1 + rng.normal(scale=1e-3) / 4.0)
        drawn.append(one.place(longer))
    spread = np.std(drawn, axis=0)
    found = [float(cloud[f"{axis}_uncertainty"][0]) for axis in "xyz"]
    # Standard error of 2000 draws: 1.6 %.
    np.testing.assert_allclose(found, spread, rtol=0.065)


def test_what_a_pose_leaves_out_is_said() -> None:
    image = one_pixel(azimuth=0.0, elevation=0.0, distance=1.0)
    frame = imaging.frame_of(image, axes="pose", pose=Pose(level_uncertainty=0.01))
    assert frame.unknown == ("position", "heading")
    cloud = imaging.point_cloud(image, frame=frame)
    assert cloud.attrs["pose_unknown"] == "position, heading"
    assert imaging.frame_of(image, axes="z-up").unknown == ()


def test_no_pose_anywhere_is_refused_with_the_remedy() -> None:
    image = one_pixel(azimuth=0.0, elevation=0.0, distance=1.0)
    with pytest.raises(CubeError, match=r"states no pose.*\[pose\].*--pose"):
        imaging.frame_of(image, axes="pose")


def test_the_pose_of_the_survey_is_taken(plate_text: str) -> None:
    text = plate_text + '[pose]\nheading = "90 deg"\nposition = ["1 m", "2 m", "3 m"]\n'
    image = one_pixel(azimuth=0.0, elevation=0.0, distance=1.0)
    frame = imaging.frame_of(image.assign_attrs(survey=text), axes="pose")
    np.testing.assert_allclose(frame.place([0.0, 0.0, 5.0]), [6.0, 2.0, 3.0])


class TestLeavingOut:
    @pytest.fixture
    def image(self, written) -> xr.Dataset:
        image = written(np.full((2, 3), 1.5), common=1e-4)
        flags = [[0, QualityFlag.MIXED, QualityFlag.RELATIVE]]
        flags += [[QualityFlag.OUTLIER, 0, QualityFlag.NO_TARGET]]
        image["quality_flag"].values[:] = flags
        image["slant_range_uncertainty"].values[1, 1] = 5e-3
        return image

    @pytest.mark.parametrize(
        ("options", "left"),
        [
            ({}, 5),
            ({"good_only": True}, 2),
            ({"mixed": True}, 3),
            ({"largest_uncertainty": 2e-3}, 4),
            ({"good_only": True, "largest_uncertainty": 2e-3}, 1),
        ],
    )
    def test_points_are_those_that_were_asked_for(self, image, options, left) -> None:
        chosen = imaging.leave_out(image, **options)
        assert imaging.point_cloud(chosen).sizes["point"] == left
        gone = 5 - left
        assert int(np.isnan(chosen["slant_range"]).sum()) == gone
        if gone:
            assert "left out" in chosen.attrs["history"]

    def test_a_limit_of_nothing_is_refused(self, image) -> None:
        with pytest.raises(ValueError, match="above 0 m"):
            imaging.leave_out(image, largest_uncertainty=0.0)
