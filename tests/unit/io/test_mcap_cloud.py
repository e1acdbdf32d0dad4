"""Clouds in MCAP, read back by the decoder of mcap-ros2-support."""

import numpy as np
import pytest
import xarray as xr
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from amulor import imaging, io, rejection, samples
from amulor.cli import main
from amulor.io import mcap_cloud
from amulor.platform import Mounting, Trajectory, instrument_poses

#: Types of fields, from the definition of sensor_msgs/PointField.
TYPES = {3: "<i2", 5: "<i4", 8: "<f8"}
MOUNTING = {"lever_arm": (0.2, 0.3, 1.0), "pitch": -1.5, "clock_offset": 0.05}


@pytest.fixture(scope="module")
def image():
    image = imaging.range_image(rejection.cross_polarized(samples.cube("ladder")))
    # The sample states no uncertainty without its water.
    sigma = image["slant_range_uncertainty"]
    sigma.values[:] = np.linspace(1e-3, 4e-3, sigma.size).reshape(sigma.shape)
    return image


@pytest.fixture(scope="module")
def moving(image):
    """A cloud of a vehicle whose mounting alone is uncertain."""
    time = np.arange(-5.0, float(image["time"].max()) + 5.0, 0.5)
    track = Trajectory.of_angles(
        time=time,
        position=time[:, None] * [0.1, 0.2, 0.01] + [5.0, 7.0, -8.0],
        heading=0.4 + 0.01 * time, pitch=0.02 * np.sin(time), roll=0.1,
        position_uncertainty=0.0, heading_uncertainty=0.0, level_uncertainty=0.0,
    )  # fmt: skip
    mounting = Mounting(
        **MOUNTING, lever_arm_uncertainties=(0.002, 0.003, 0.004),
        boresight_uncertainty=0.001, clock_uncertainty=0.01,
    )  # fmt: skip
    frame = imaging.moving_frame(image, trajectory=track, mounting=mounting)
    return imaging.point_cloud(image, frame=frame, covariance=True), frame, track


def _decoded(path):
    """Messages and their points as records."""
    messages, records = [], []
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        metadata = {entry.name: entry.metadata for entry in reader.iter_metadata()}
        for _, channel, _, message in reader.iter_decoded_messages():
            assert channel.topic == "/points"
            fields = message.fields
            kind = np.dtype({
                "names": [field.name for field in fields],
                "formats": [TYPES[field.datatype] for field in fields],
                "offsets": [field.offset for field in fields],
                "itemsize": message.point_step,
            })  # fmt: skip
            records.append(np.frombuffer(bytes(message.data), dtype=kind))
            assert message.row_step == message.point_step * message.width
            assert len(message.data) == message.row_step * message.height
            messages.append(message)
    return messages, np.concatenate(records), metadata["amulor"]


def test_points_and_covariances_are_equal_to_the_bit(moving, tmp_path, monkeypatch):
    monkeypatch.setattr(mcap_cloud, "BLOCK", 1000)
    cloud, *_ = moving
    io.write_cloud(cloud, tmp_path / "cloud.mcap")
    messages, points, metadata = _decoded(tmp_path / "cloud.mcap")
    assert len(messages) == -(-cloud.sizes["point"] // 1000) > 1
    for name in ("x", "y", "z", "intensity", "quality_flag", "row", "column", "time"):
        np.testing.assert_array_equal(points[name], cloud[name].values)
    for name in ("xy", "xz", "yz"):
        np.testing.assert_array_equal(
            points[f"covariance_{name}"], cloud[f"{name}_covariance"].values
        )
    for axis in "xyz":
        np.testing.assert_array_equal(
            points[f"covariance_{axis}{axis}"], cloud[f"{axis}_uncertainty"].values ** 2
        )
    assert messages[0].header.frame_id == "map"
    first = messages[1].header.stamp
    # The time of the first point of the message, to a nanosecond.
    assert first.sec + 1e-9 * first.nanosec == pytest.approx(
        float(cloud["time"][1000]), abs=1e-9
    )
    assert messages[0].is_dense
    assert not messages[0].is_bigendian
    assert "x east" in metadata["axes"]


def test_e57_has_the_pose_in_the_middle_of_the_scan(moving, tmp_path):
    pye57 = pytest.importorskip("pye57")
    cloud, frame, _ = moving
    io.write_cloud(cloud, tmp_path / "cloud.e57")
    scan = pye57.E57(str(tmp_path / "cloud.e57"))
    header = scan.get_header(0)
    time = np.sort(frame.poses.vehicle.time)
    vehicle = time[len(time) // 2] * np.array([0.1, 0.2, 0.01]) + [5.0, 7.0, -8.0]
    # The instrument is 1.06 m from the reference point of the vehicle.
    arm = np.linalg.norm(header.translation - vehicle)
    assert arm == pytest.approx(np.linalg.norm(MOUNTING["lever_arm"]), abs=2e-3)
    raw = scan.read_scan_raw(0)
    local = np.stack([raw[f"cartesian{axis}"] for axis in "XYZ"], axis=1)
    local = local[np.asarray(raw["cartesianInvalidState"]) != 2]
    site = local @ header.rotation_matrix.T + header.translation
    stored = np.stack([cloud[axis].values for axis in "xyz"], axis=1)
    np.testing.assert_allclose(site, stored, rtol=0, atol=1e-9)


def test_covariances_are_those_of_shifts_by_each_error(moving):
    """Each quantity of the mounting changed by its uncertainty, one after another."""
    cloud, frame, track = moving
    place = cloud["row"].values, cloud["column"].values
    poses = frame.at(*place)
    points = np.stack([cloud[axis].values for axis in "xyz"], axis=1)
    local = np.einsum("nji,nj->ni", poses.rotation, points - poses.position)
    at = poses.vehicle.time - MOUNTING["clock_offset"]
    origin = frame.poses.mounting.model_dump()

    def moved(name, index, step):
        value = origin[name]
        if index is None:
            value = value + step
        else:
            value = tuple(v + step * (k == index) for k, v in enumerate(value))
        changed = Mounting(**{**origin, name: value})
        return instrument_poses(track, changed, at).place(local) - points

    shifts = [moved("lever_arm", k, (0.002, 0.003, 0.004)[k]) for k in range(3)]
    shifts += [moved("boresight", k, 1e-5) * 100 for k in range(3)]
    shifts.append(moved("clock_offset", None, 1e-5) * 1000)
    beam = local - np.asarray(cloud["geometry"].attrs["emitter_position"])
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    beam = np.einsum("nij,nj->ni", poses.rotation, beam)
    shifts.append(beam * cloud["slant_range_uncertainty"].values[:, None])
    rate = np.einsum("ni,ni->n", poses.velocity, beam)
    shifts.append(beam * (rate * poses.duration / np.sqrt(12))[:, None])
    expected = sum(s[:, :, None] * s[:, None, :] for s in shifts)
    assert (np.einsum("nii->ni", expected) > 1e-12).all()
    scale = np.sqrt(np.einsum("ni,nj->nij", *[np.einsum("nii->ni", expected)] * 2))
    for i, j in ((0, 1), (0, 2), (1, 2)):
        name = f"{'xyz'[i]}{'xyz'[j]}_covariance"
        np.testing.assert_allclose(
            cloud[name].values / scale[:, i, j], expected[:, i, j] / scale[:, i, j],
            atol=2e-3,
        )  # fmt: skip
    for axis in range(3):
        np.testing.assert_allclose(
            cloud[f"{'xyz'[axis]}_uncertainty"].values ** 2,
            expected[:, axis, axis], rtol=4e-3,
        )  # fmt: skip


def test_tiles_give_the_same_file(image, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    io.write_cube(image, "range.nc")
    assert main(["export", "range.nc", "-o", "whole.mcap"]) == 0
    assert main(["export", "range.nc", "-o", "tiles.mcap", "--tile-rows", "7"]) == 0
    assert "amulor view" not in capsys.readouterr().out
    whole, tiles = (_decoded(tmp_path / name) for name in ("whole.mcap", "tiles.mcap"))
    assert whole[1].tobytes() == tiles[1].tobytes()
    assert whole[0][0].header.frame_id == "instrument_optical_frame"
    # Without a pose, all errors of a point lie along its beam: the rank is one.
    points = whole[1]
    product = points["covariance_xx"] * points["covariance_zz"]
    np.testing.assert_allclose(points["covariance_xz"] ** 2, product, rtol=1e-9)


@pytest.mark.parametrize(
    ("start", "seconds"),
    [("1970-01-02T00:00:01Z", 86401.0), ("1970-01-02T00:00:01.5", 86401.5),
     ("1970-01-02T01:00:00+01:00", 86400.0), ("1969-01-01T00:00:00Z", 0.0), ("", 0.0)],
)  # fmt: skip
def test_a_message_has_the_time_of_its_points_or_of_the_scan(start, seconds):
    cloud = xr.Dataset(attrs={"time_coverage_start": start})
    plain = np.zeros(2, dtype=[("x", "f4")])
    assert mcap_cloud._stamp(cloud, plain) == round(seconds * 1e9)
    timed = np.array([(12.25,), (13.0,)], dtype=[("time", "f8")])
    assert mcap_cloud._stamp(cloud, timed) == 12_250_000_000
    timed["time"] = -1.0
    assert mcap_cloud._stamp(cloud, timed) == 0
