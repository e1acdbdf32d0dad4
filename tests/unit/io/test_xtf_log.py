"""Trajectories from XTF files that pyxtf has written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyproj
import pytest
import pyxtf
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from amulor.cli import main
from amulor.errors import FormatError
from amulor.io.xtf_log import trajectory_from_xtf

CRS = "EPSG:32632"
#: 2026-05-04 10:20:30 UTC, as `date` has it [s].
BEGIN = 1777890030


def record(packet: object, **fields: float) -> bytes:
    """Return a packet of pyxtf with fields, as a record of 64 bytes."""
    for name, value in fields.items():
        setattr(packet, name, value)
    packet.NumBytesThisRecord = 64  # type: ignore[attr-defined]
    return bytes(packet)  # type: ignore[call-overload]


def date_of(number: int) -> dict[str, int]:
    """Return the date fields of a record, one each second."""
    return {
        "Year": 2026, "Month": 5, "Day": 4, "Hour": 10, "Minute": 20,
        "Second": 30 + number,
    }  # fmt: skip


def position(number: int, **others: float) -> bytes:
    """Return the position of a vehicle that drives north and comes up."""
    fields = {
        **date_of(number), "Microsecond": 2500, "RawYcoordinate": 44.28 + 1e-6 * number,
        "RawXcoordinate": 8.56, "RawAltitude": -8.0 + 0.1 * number, "Heading": 90.0,
        "Pitch": 2.0, "Roll": -3.0,
    } | others  # fmt: skip
    return record(pyxtf.XTFPosRawNavigation(), **fields)


def attitude(number: int, **others: float) -> bytes:
    """Return an attitude half a second after the position."""
    fields = {
        **date_of(number), "Millisecond": 750, "Heading": 30.0 + number, "Pitch": 1.0,
        "Roll": 4.0,
    } | others  # fmt: skip
    return record(pyxtf.XTFAttitudeData(), **fields)


def header(units: int = 3, **fields: int) -> bytes:
    """Return the header of a file."""
    made = pyxtf.XTFFileHeader()
    made.NavUnits = units
    for name, value in fields.items():
        setattr(made, name, value)
    return bytes(made)


def file_of(folder: Path, *parts: bytes) -> Path:
    path = folder / "dive.xtf"
    path.write_bytes(b"".join(parts))
    return path


def forward(quaternions: np.ndarray) -> np.ndarray:
    """Directions of the bow, east, north, up; the third axis of the vehicle."""
    return Rotation.from_quat(quaternions).apply([0.0, 0.0, 1.0])


def bow(heading: float, pitch: float) -> list[float]:
    """Direction of the bow by true heading and pitch, over the grid of the CRS."""
    factors = pyproj.Proj(CRS).get_factors(8.56, 44.28)
    grid = np.radians(heading - factors.meridian_convergence)
    level = np.cos(np.radians(pitch))
    return [np.sin(grid) * level, np.cos(grid) * level, np.sin(np.radians(pitch))]


def test_positions_have_their_own_angles_and_times(tmp_path: Path) -> None:
    file = file_of(tmp_path, header(), *(position(n) for n in range(4)))
    track = trajectory_from_xtf(file, crs=CRS, crs_offset=(4e5, 4.9e6, 0.0))
    assert_allclose(track.time, BEGIN + 0.25 + np.arange(4), atol=1e-6)
    east, north = pyproj.Transformer.from_crs(
        "EPSG:4326", CRS, always_xy=True
    ).transform(np.full(4, 8.56), 44.28 + 1e-6 * np.arange(4))
    expected = np.column_stack([east - 4e5, north - 4.9e6, -8 + 0.1 * np.arange(4)])
    assert_allclose(track.position, expected, atol=1e-5)
    assert_allclose(forward(track.attitude), [bow(90.0, 2.0)] * 4, atol=1e-6)
    # Roll to starboard is positive; the second axis is that downwards.
    right = Rotation.from_quat(track.attitude).apply([1.0, 0.0, 0.0])
    assert_allclose(right[:, 2], np.sin(np.radians(3.0)) * np.cos(np.radians(2.0)))
    assert np.isnan(np.einsum("nii->ni", track.covariance)).all()
    assert "the uncertainty of the poses is not stated" in track.remarks[-1]


def test_stated_uncertainties_are_those_of_positions_and_angles(tmp_path: Path) -> None:
    level = [position(n, Heading=0.0, Pitch=0.0, Roll=0.0) for n in range(3)]
    track = trajectory_from_xtf(
        file_of(tmp_path, header(), *level), crs=CRS, uncertainty=(0.02, 0.005, 0.001)
    )
    assert_allclose(
        np.sqrt(np.einsum("nii->ni", track.covariance)),
        [[0.02, 0.02, 0.02, 0.001, 0.001, 0.005]] * 3,
        rtol=1e-6,
    )


def test_poses_have_the_times_of_attitude_records(tmp_path: Path) -> None:
    parts = [part for n in range(4) for part in (position(n), attitude(n))]
    track = trajectory_from_xtf(file_of(tmp_path, header(), *parts), crs=CRS)
    # The last attitude is after the last position.
    assert_allclose(track.time, BEGIN + 0.75 + np.arange(3), atol=1e-6)
    assert_allclose(track.position[:, 2], -7.95 + 0.1 * np.arange(3), atol=1e-6)
    assert_allclose(forward(track.attitude)[1], bow(31.0, 1.0), atol=1e-6)
    assert any("attitudes before the first, after the last" in x for x in track.remarks)


def test_the_time_of_the_source_counts_before_that_of_the_clock(tmp_path: Path) -> None:
    source = [
        attitude(n, SourceEpoch=BEGIN + n, EpochMicroseconds=500_000) for n in range(3)
    ]
    parts = [part for n in range(3) for part in (position(n), source[n])]
    track = trajectory_from_xtf(file_of(tmp_path, header(), *parts), crs=CRS)
    assert_allclose(track.time, BEGIN + 0.5 + np.arange(2), atol=1e-6)


def test_attitudes_without_a_heading_are_not_used(tmp_path: Path) -> None:
    parts = [part for n in range(3) for part in (position(n), attitude(n, Heading=0))]
    track = trajectory_from_xtf(file_of(tmp_path, header(), *parts), crs=CRS)
    assert_allclose(track.time, BEGIN + 0.25 + np.arange(3), atol=1e-6)


@pytest.mark.parametrize(
    ("channels", "size"), [(6, 1024), (7, 2048), (14, 2048), (15, 3072)]
)
def test_the_header_grows_with_the_channels(
    tmp_path: Path, channels: int, size: int
) -> None:
    head = header(NumberOfSonarChannels=channels - 2, NumberOfSnippetChannels=2)
    padded = head.ljust(size, b"\0")
    file = file_of(tmp_path, padded, *(position(n) for n in range(3)))
    assert trajectory_from_xtf(file, crs=CRS).time.size == 3


def test_a_file_that_is_cut_off_keeps_its_whole_records(tmp_path: Path) -> None:
    parts = [header(), *(position(n) for n in range(3)), position(3)[:40]]
    track = trajectory_from_xtf(file_of(tmp_path, *parts), crs=CRS)
    assert track.time.size == 3
    assert track.remarks[0] == "the file is cut off in the record at byte 1216"


def test_a_record_of_no_bytes_ends_the_file(tmp_path: Path) -> None:
    empty = bytearray(position(3))
    empty[10:14] = bytes(4)
    file = file_of(tmp_path, header(), position(0), position(1), bytes(empty))
    assert trajectory_from_xtf(file, crs=CRS).time.size == 2


def test_an_impossible_date_is_left_out_and_counted(tmp_path: Path) -> None:
    parts = [position(0), position(1), position(2, Month=13), position(3)]
    track = trajectory_from_xtf(file_of(tmp_path, header(), *parts), crs=CRS)
    assert track.time.size == 3
    assert "1 x record with an impossible date left out" in track.remarks


@pytest.mark.parametrize(
    ("parts", "message"),
    [
        ((b"",), r"is no XTF file, which has a header of 1024 bytes .* \(0 bytes\)"),
        ((b"\x7c" + bytes(2000),), r"begins with 0x7B \(2001 bytes\)"),
        ((header(units=0), position(0)), r"not longitude and latitude \(unit 0, n"),
        ((header(), position(0)), r"has 1 positions .* needed are 2 or more; convert"),
        ((header(), bytes(64)), "is damaged at byte 1024, where no record begins"),
    ],
)  # fmt: skip
def test_other_files_are_refused(
    tmp_path: Path, parts: tuple[bytes, ...], message: str
) -> None:
    with pytest.raises(FormatError, match=message):
        trajectory_from_xtf(file_of(tmp_path, *parts), crs=CRS)


@given(data=st.data())
@settings(deadline=None, max_examples=60)
def test_damaged_bytes_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    parts = [part for n in range(5) for part in (position(n), attitude(n))]
    content = bytearray(header() + b"".join(parts))
    for _ in range(data.draw(st.integers(1, 6))):
        place = data.draw(st.integers(0, len(content) - 1))
        content[place] = data.draw(st.integers(0, 255))
    del content[data.draw(st.integers(0, len(content))) :]
    file = file_of(tmp_path_factory.mktemp("damaged"), bytes(content))
    try:
        track = trajectory_from_xtf(file, crs=CRS)
    except FormatError:
        return
    assert np.isfinite(track.position).all()


def test_the_command_reads_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = file_of(tmp_path, header(), *(position(n) for n in range(6)))
    words = ["import", "trajectory", str(file), "--crs", CRS]
    words += ["--uncertainty", "20 mm, 0.3 deg, 0.1 deg", "-o"]
    assert main([*words, str(tmp_path / "track.csv")]) == 0
    said = capsys.readouterr().out
    assert "6 poses over 5.0 s" in said
    assert "between poses: 20 mm a coordinate" in said
    assert main([*words[:-2], "1m", "-o", str(tmp_path / "other.csv")]) == 2
    assert (
        "'1m': state three values, a length and two angles" in capsys.readouterr().err
    )
