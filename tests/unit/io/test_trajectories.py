"""Trajectory files: tables with a map, files of amulor, NMEA 0183 logs, ROS 2 bags."""

from datetime import UTC, datetime

import moving_pass
import numpy as np
import pytest
from mcap_ros2.writer import Writer
from scipy.spatial.transform import Rotation

from amulor.errors import FormatError
from amulor.io.navigation_logs import (
    nmea_sentence,
    trajectory_from_bag,
    trajectory_from_nmea,
)
from amulor.io.trajectories import (
    TrajectoryMap,
    projected,
    read_trajectory,
    trajectory_from_table,
    write_trajectory,
)
from amulor.platform import Trajectory

COLUMNS = {
    "time": "t", "east": "E", "north": "N", "up": "U",
    "heading": "h", "pitch": "p", "roll": "r",
}  # fmt: skip


def _table(folder, header, rows):
    path = folder / "log.csv"
    path.write_text("\n".join([header, *rows]))
    return path


def _rows(count=12, step=0.5):
    return [
        f"{step * i:.3f},{0.1 * i:.2f},{2 * i},-8,{90 + i},3,-2" for i in range(count)
    ]


def _map(columns=COLUMNS, **constants):
    return TrajectoryMap(
        columns=columns,
        constants={"time": "seconds", "clock": "relative", **constants},
    )


def test_a_table_becomes_the_poses_that_it_states(tmp_path):
    path = _table(tmp_path, "t,E,N,U,h,p,r", _rows())
    track = trajectory_from_table(path, _map())
    poses = track.at([2.0])
    assert poses.position[0].tolist() == pytest.approx([0.4, 8.0, -8.0])
    expected = moving_pass.attitude(*np.radians([94.0, 3.0, -2.0]))
    np.testing.assert_allclose(poses.rotation[0], expected, atol=1e-12)
    assert track.clock == "relative"


def test_depths_times_and_angles_in_other_units(tmp_path):
    rows = [
        f"{500 * i},{0.1 * i:.2f},{2 * i},8,{1.5 + 0.01 * i},0.05,0" for i in range(12)
    ]
    path = _table(tmp_path, "t,E,N,U,h,p,r", rows)
    columns = {**COLUMNS, "down": "U"}
    del columns["up"]
    described = _map(columns, time="milliseconds", angle_unit="rad")
    poses = trajectory_from_table(path, described).at([1.5])
    assert poses.position[0].tolist() == pytest.approx([0.3, 6.0, -8.0])
    np.testing.assert_allclose(
        poses.rotation[0], moving_pass.attitude(1.53, 0.05, 0.0), atol=1e-12
    )


def test_dates_are_unix_times(tmp_path):
    rows = [f"2026-05-04T10:20:{30 + i}.25Z,{i},0,-8,0,0,0" for i in range(5)]
    path = _table(tmp_path, "t,E,N,U,h,p,r", rows)
    track = trajectory_from_table(path, _map(time="iso8601"))
    first = datetime(2026, 5, 4, 10, 20, 30, 250_000, tzinfo=UTC).timestamp()
    assert track.time[0] == pytest.approx(first, abs=1e-6)
    assert track.clock == "unix"


@pytest.mark.parametrize("axes", ["FRD in NED", "FLU in ENU"])
def test_quaternions_of_both_conventions_are_one_attitude(axes, tmp_path):
    """Quaternions by half angles: NED about down, then right, then forward."""
    heading, pitch, roll = 0.7, 0.2, -0.3

    def product(a, b):
        w = a[3] * b[3] - np.dot(a[:3], b[:3])
        return np.append(a[3] * b[:3] + b[3] * a[:3] + np.cross(a[:3], b[:3]), w)

    def about(axis, angle):
        return np.append(np.sin(angle / 2) * np.eye(3)[axis], np.cos(angle / 2))

    if axes == "FRD in NED":
        turn = product(product(about(2, heading), about(1, pitch)), about(0, roll))
    else:  # forward east at zero yaw, left, up: yaw counts from east, pitch bow down
        yaw = np.pi / 2 - heading
        turn = product(product(about(2, yaw), about(1, -pitch)), about(0, roll))
    numbers = ",".join(f"{value:.15f}" for value in turn)
    rows = [f"{i},0,0,-8,{numbers}" for i in range(5)]
    path = _table(tmp_path, "t,E,N,U,x,y,z,w", rows)
    columns = {"time": "t", "east": "E", "north": "N", "up": "U",
               "qx": "x", "qy": "y", "qz": "z", "qw": "w"}  # fmt: skip
    track = trajectory_from_table(path, _map(columns, quaternion_axes=axes))
    np.testing.assert_allclose(
        track.at([2.0]).rotation[0],
        moving_pass.attitude(heading, pitch, roll),
        atol=1e-12,
    )


def test_geographic_positions_lie_where_geodesy_says(tmp_path):
    """One second of latitude is 30.86 m; true north is turned by the convergence."""
    rows = [f"{i},{44 + i / 3600:.9f},10.5,8,0,0,0" for i in range(5)]
    path = _table(tmp_path, "t,la,lo,d,h,p,r", rows)
    columns = {"time": "t", "latitude": "la", "longitude": "lo", "down": "d",
               "heading": "h", "pitch": "p", "roll": "r"}  # fmt: skip
    described = _map(columns, crs="EPSG:32632", heading_from="true")
    track = trajectory_from_table(path, described)
    offset = (600_000.0, 4_870_000.0, -3.0)
    described = _map(columns, crs="EPSG:32632", heading_from="true", crs_offset=offset)
    less = trajectory_from_table(path, described)
    np.testing.assert_allclose(less.position, track.position - offset, atol=1e-6)
    step = np.linalg.norm(np.diff(track.position, axis=0), axis=1)
    # Arc of the meridian at 44 degrees, times the scale 0.9996 and more beside 9 E.
    np.testing.assert_allclose(step, 30.8627 * 0.9998, rtol=2e-4)
    forward = track.at([2.0]).rotation[0, :, 2]
    moved = track.position[4] - track.position[0]
    # A vehicle that heads and moves to true north: the angles agree in the grid.
    assert np.arctan2(*forward[:2]) == pytest.approx(np.arctan2(*moved[:2]), abs=2e-5)
    # The convergence is nearly (longitude - 9 deg) sin(latitude).
    assert np.degrees(-np.arctan2(*forward[:2])) == pytest.approx(
        1.5 * np.sin(np.radians(44)), rel=1e-3
    )


def test_quaternions_from_true_north_turn_by_the_convergence_like_headings(tmp_path):
    heading, pitch, roll = np.radians([40.0, 12.0, -17.0])
    turn = Rotation.from_euler("ZYX", [heading, pitch, roll]).as_quat()
    angles = ",".join(f"{np.degrees(value):.12f}" for value in (heading, pitch, roll))
    numbers = ",".join(f"{value:.15f}" for value in turn)
    rows = [f"{i},{44 + i / 3600:.9f},10.5,8,{angles},{numbers}" for i in range(5)]
    path = _table(tmp_path, "t,la,lo,d,h,p,r,x,y,z,w", rows)
    place = {"time": "t", "latitude": "la", "longitude": "lo", "down": "d"}
    found = [
        trajectory_from_table(
            path, _map({**place, **names}, crs="EPSG:32632", heading_from="true")
        ).at([2.0]).rotation[0]
        for names in (
            {"heading": "h", "pitch": "p", "roll": "r"},
            {"qx": "x", "qy": "y", "qz": "z", "qw": "w"},
        )
    ]  # fmt: skip
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)
    # By 1 degree, see above.
    turned = moving_pass.attitude(heading, pitch, roll)
    assert np.abs(found[1] - turned).max() > 0.01


def test_files_of_amulor_hold_a_trajectory_to_the_bit(tmp_path):
    rng = np.random.default_rng(4)
    track = Trajectory.of_angles(
        time=1.7e9 + np.sort(rng.uniform(0, 10, 30)),
        position=rng.normal(size=(30, 3)),
        heading=rng.uniform(0, 6, 30),
        position_uncertainty=rng.uniform(0.01, 0.02, 30),
        heading_uncertainty=1e-3,
    )
    path = tmp_path / "track.csv"
    write_trajectory(track, path)
    again = read_trajectory(path)
    for name in ("time", "position", "attitude", "covariance"):
        np.testing.assert_array_equal(getattr(again, name), getattr(track, name))
    assert (again.longest_gap, again.clock, again.remarks) == (
        track.longest_gap, track.clock, track.remarks,
    )  # fmt: skip
    with pytest.raises(FormatError, match="exists"):
        write_trajectory(track, path)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("t,x\n1,2\n", "is no trajectory of amulor; import the file with"),
        ("# amulor trajectory, version 1\n# clock: unix\na\n1,2\n", "is damaged"),
    ],
)
def test_other_files_are_no_trajectories(content, words, tmp_path):
    path = tmp_path / "track.csv"
    path.write_text(content)
    with pytest.raises(FormatError, match=words):
        read_trajectory(path)
    with pytest.raises(FormatError, match="cannot be read"):
        read_trajectory(tmp_path / "nowhere.csv")


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ({"down": "d"}, "needed are columns for up or down, once"),
        ({"latitude": "la"}, "latitude, longitude belong together"),
        ({"qx": "x"}, "qx, qy, qz, qw belong together; state all"),
        ({"east": None}, "east, north belong together; state all"),
    ],
)
def test_maps_without_one_pose_are_refused(columns, words):
    with pytest.raises(ValueError, match=words):
        _map({**COLUMNS, **columns})


def test_wrong_units_are_named_with_their_line(tmp_path):
    path = _table(tmp_path, "t,E,N,U,h,p,r", _rows())
    with pytest.raises(FormatError, match=r"log\.csv, line 2: heading 5157 deg is"):
        trajectory_from_table(path, _map(angle_unit="rad"))
    columns = {"time": "t", "latitude": "N", "longitude": "E", "up": "U",
               "heading": "h", "pitch": "p", "roll": "r"}  # fmt: skip
    rows = [f"{i},431000,4883000,-8,0,0,0" for i in range(4)]
    path = _table(tmp_path, "t,E,N,U,h,p,r", rows)
    with pytest.raises(FormatError, match="are they metres, or in the wrong order"):
        trajectory_from_table(path, _map(columns, crs="EPSG:32632"))


def _nmea(seconds, *, start=(10, 20, 0), extra=()):
    """Sentences of a vehicle that drives north, 0.1 seconds of arc in a second."""
    lines = [nmea_sentence("GPZDA,102000.00,04,05,2026,00,00"), *extra]
    for second in seconds:
        total = start[0] * 3600 + start[1] * 60 + start[2] + second
        hour, minute = int(total // 3600) % 24, int(total // 60) % 60
        clock = f"{hour:02d}{minute:02d}{total % 60:05.2f}"
        latitude = 17.1 + second / 600
        lines += [
            nmea_sentence(
                f"GPGGA,{clock},44{latitude:010.7f},N,00900.0000000,E,4,12,0.8,-8.0,M,"
                "48.0,M,,"
            ),
            nmea_sentence(f"GPGST,{clock},,,,,0.03,0.02,0.05"),
            nmea_sentence(
                f"PASHR,{clock},{second % 360:.2f},T,1.0,-2.0,0.0,0.05,0.05,0.1,2,1"
            ),
        ]
    return lines


def test_a_log_of_nmea_sentences_becomes_a_trajectory(tmp_path):
    path = tmp_path / "rov.nmea"
    path.write_text("".join(_nmea(range(20))))
    track = trajectory_from_nmea(
        path, crs="EPSG:32632", crs_offset=(500_000.0, 4_903_000.0, 0.0)
    )
    start = datetime(2026, 5, 4, 10, 20, tzinfo=UTC).timestamp()
    assert track.time.tolist() == [start + second for second in range(20)]
    # On the central meridian: easting 500 km, no convergence, scale 0.9996.
    np.testing.assert_allclose(track.position[:, 0], 0.0, atol=1e-6)
    np.testing.assert_allclose(
        np.diff(track.position[:, 1]), 3.0866 * 0.9996, rtol=2e-4
    )
    np.testing.assert_allclose(track.position[:, 2], -8.0)
    expected = moving_pass.attitude(*np.radians([7.0, -2.0, 1.0]))
    np.testing.assert_allclose(track.at([start + 7]).rotation[0], expected, atol=1e-9)
    sigma = np.sqrt(np.einsum("nii->ni", track.covariance)[9])
    assert sigma[:3].tolist() == pytest.approx([0.02, 0.03, 0.05], rel=0.01)
    assert sigma[5] == pytest.approx(np.radians(0.1), rel=1e-3)


def test_a_log_goes_on_across_midnight(tmp_path):
    path = tmp_path / "rov.nmea"
    path.write_text("".join(_nmea(range(20), start=(23, 59, 50))))
    track = trajectory_from_nmea(path, crs="EPSG:32632")
    np.testing.assert_allclose(np.diff(track.time), 1.0)


def test_broken_sentences_are_counted(tmp_path):
    lines = _nmea(range(12))
    lines[4] = lines[4].replace("44", "45", 1)
    lines.insert(8, "booting\r\n")
    path = tmp_path / "rov.nmea"
    path.write_text("".join(lines))
    remarks = trajectory_from_nmea(path, crs="EPSG:32632").remarks
    assert "1 x sentence with a wrong checksum or field left out" in remarks
    assert "1 x line without a sentence left out" in remarks


@pytest.mark.parametrize(
    ("without", "words"),
    [("GPZDA", r"no date \(ZDA"), ("GPGGA", r"no position \(GGA"), ("PASHR", "no att")],
)
def test_logs_that_lack_a_quantity_are_refused(without, words, tmp_path):
    path = tmp_path / "rov.nmea"
    path.write_text("".join(line for line in _nmea(range(9)) if without not in line))
    with pytest.raises(FormatError, match=words):
        trajectory_from_nmea(path, crs="EPSG:32632")


_ODOMETRY = """std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
float64[36] covariance
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""


def _odometry(number, frame, covariance):
    return {
        "header": {
            "stamp": {"sec": 1_780_000_000 + number, "nanosec": 5 * 10**8},
            "frame_id": frame,
        },
        "child_frame_id": "base_link",
        "pose": {
            "pose": {
                "position": {"x": 1.0 + number, "y": 2.0, "z": -8.0},
                "orientation": {"x": 0.0, "y": 0.0, "z": np.sin(0.2), "w": np.cos(0.2)},
            },
            "covariance": covariance,
        },
    }


def _bag(path, topics=("/odom",), frame="map", covariance=(0.0,) * 36):
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("nav_msgs/msg/Odometry", _ODOMETRY)
        for number in range(8):
            message = _odometry(number, frame, list(covariance))
            for topic in topics:
                writer.write_message(topic, schema, message, log_time=number)
        writer.finish()
    return path


def test_a_bag_of_ros_becomes_a_trajectory(tmp_path):
    covariance = np.diag([1e-4, 4e-4, 9e-4, 1e-6, 2e-6, 3e-6]).ravel()
    track = trajectory_from_bag(_bag(tmp_path / "a.mcap", covariance=covariance))
    assert track.time[0] == 1_780_000_000.5
    assert track.position[3].tolist() == [4.0, 2.0, -8.0]
    # A yaw of 0.4 rad from east, counter-clockwise, is a heading of 90 deg - 0.4 rad.
    expected = moving_pass.attitude(np.pi / 2 - 0.4, 0.0, 0.0)
    np.testing.assert_allclose(
        track.at(track.time[3:4]).rotation[0], expected, atol=1e-9
    )
    np.testing.assert_allclose(track.covariance[0], np.reshape(covariance, (6, 6)))


def test_a_bag_in_north_east_down(tmp_path):
    covariance = np.diag([1e-4, 4e-4, 9e-4, 1e-6, 2e-6, 3e-6]).ravel()
    path = _bag(tmp_path / "a.mcap", frame="map_ned", covariance=covariance)
    track = trajectory_from_bag(path)
    assert track.position[3].tolist() == [2.0, 4.0, 8.0]
    expected = moving_pass.attitude(0.4, 0.0, 0.0)
    np.testing.assert_allclose(
        track.at(track.time[3:4]).rotation[0], expected, atol=1e-9
    )
    np.testing.assert_allclose(
        np.diag(track.covariance[0]), [4e-4, 1e-4, 9e-4, 2e-6, 1e-6, 3e-6]
    )


def test_a_bag_without_one_topic_of_poses_is_refused(tmp_path):
    path = _bag(tmp_path / "a.mcap", topics=("/odom", "/ekf"))
    with pytest.raises(FormatError, match="in the topics /ekf, /odom; state one"):
        trajectory_from_bag(path)
    assert trajectory_from_bag(path, topic="/ekf").time.size == 8
    with pytest.raises(FormatError, match="holds no pose of topic /imu"):
        trajectory_from_bag(path, topic="/imu")


def test_unknown_covariances_of_a_bag_stay_unknown(tmp_path):
    track = trajectory_from_bag(_bag(tmp_path / "a.mcap"))
    assert np.isnan(track.covariance).all()
    assert "the uncertainty of the poses is not stated" in track.remarks[-1]


@pytest.mark.parametrize("keep", [0, 20, 400])
def test_a_bag_that_is_cut_off_is_refused(keep, tmp_path):
    path = _bag(tmp_path / "a.mcap")
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(FormatError, match=r"is damaged, or no MCAP file|holds no pose"):
        trajectory_from_bag(path)


@pytest.mark.parametrize(("length", "shown"), [(199, 199), (200, 200), (201, 200)])
def test_a_long_reason_of_a_damaged_bag_is_shortened(
    length, shown, tmp_path, monkeypatch
):
    def refuse(*_, **__):
        raise ValueError("x" * length)

    monkeypatch.setattr("mcap.reader.make_reader", refuse)
    with pytest.raises(FormatError) as refused:
        trajectory_from_bag(_bag(tmp_path / "a.mcap"))
    assert str(refused.value).count("x") == shown


@pytest.mark.parametrize(
    ("latitude", "longitude", "right"),
    [
        (45.0, 360.0, True), (45.0, -360.0, True), (45.0, 360.1, False),
        (90.1, 9.0, False), (-90.1, 9.0, False), (45.0, -360.1, False),
    ],
)  # fmt: skip
def test_a_full_turn_of_longitude_is_the_largest(latitude, longitude, right):
    angles = np.array([45.0, latitude]), np.array([9.0, longitude])
    if right:
        east, _ = projected(*angles, "EPSG:32631", place=str)
        start, _ = projected(np.array([45.0]), np.array([0.0]), "EPSG:32631", place=str)
        assert east[1] == pytest.approx(start[0], abs=1e-3)
        return
    with pytest.raises(FormatError, match=r"^1: latitude .* are no angles in degrees"):
        projected(*angles, "EPSG:32631", place=str)


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (560000.0, 4870000.0, 0.0)])
def test_true_north_is_that_of_the_place_whatever_is_taken_off(tmp_path, offset):
    # At 10.5 degrees east and 44 degrees north: 1.5 degrees sin(44 degrees).
    rows = [f"{i},620241,{4872900 + i},8,0,0,0" for i in range(5)]
    path = _table(tmp_path, "t,E,N,U,h,p,r", rows)
    described = _map(crs="EPSG:32632", crs_offset=offset, heading_from="true")
    forward = trajectory_from_table(path, described).at([2.0]).rotation[0, :, 2]
    assert np.degrees(-np.arctan2(*forward[:2])) == pytest.approx(
        1.5 * np.sin(np.radians(44)), rel=2e-3
    )
