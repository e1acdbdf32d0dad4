"""Clouds by rows are byte for byte those of the whole image."""

from __future__ import annotations

import datetime
import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from site_scenes import scanning

from amulor import imaging, io
from amulor.cli import main
from amulor.cube import QualityFlag, provenance
from amulor.errors import CubeError, FormatError
from amulor.io import e57, laz
from amulor.pipeline import CloudSummary, Selection, cloud_file

#: When a cube was made; the only thing that differs.
WHEN = re.compile(rb"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ")


@pytest.fixture(scope="module")
def image() -> xr.Dataset:
    """Return a range image with gaps, doubtful pixels and a whole row without any."""
    rng = np.random.default_rng(3)
    azimuth, elevation, unit = scanning.grid(9, 17, 0.3)
    image = scanning.image(
        2.0 / unit[..., 2], azimuth, elevation, errors=scanning.Errors(),
        draw=scanning.Draw(rng), scan="a",
    )  # fmt: skip
    flag = np.zeros(azimuth.shape, dtype=np.int16)
    flag[rng.random(flag.shape) < 0.1] = QualityFlag.MIXED
    flag[rng.random(flag.shape) < 0.1] = QualityFlag.MISSING
    flag[4:6] = QualityFlag.MISSING
    sigma = image["slant_range_uncertainty"]
    larger = sigma * (1 + 0.5 * rng.random(flag.shape))
    return image.assign(
        quality_flag=image["quality_flag"].copy(data=flag),
        slant_range_uncertainty=sigma.copy(data=larger.values),
    )


def content(path: Path) -> bytes:
    return WHEN.sub(b"when", path.read_bytes())


@pytest.mark.parametrize(
    ("ending", "selection"),
    [
        ("ply", Selection(True, 4e-3, False)),
        pytest.param("laz", Selection(True), marks=pytest.mark.slow),
        ("e57", Selection(mixed=True)),
        pytest.param("las", Selection(), marks=pytest.mark.slow),
        pytest.param("csv", Selection(), marks=pytest.mark.slow),
        pytest.param("xyz", Selection(mixed=True), marks=pytest.mark.slow),
    ],
)
def test_a_cloud_by_rows_is_that_of_the_whole(
    image: xr.Dataset,
    tmp_path: Path,
    ending: str,
    selection: Selection,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Blocks that end within rows.
    monkeypatch.setattr(laz, "_BLOCK", 20)
    monkeypatch.setattr(e57, "BLOCK", 23)
    monkeypatch.setattr(e57, "BLOCK", 23)
    name, one, other = (tmp_path / n for n in ("i.nc", f"1.{ending}", f"2.{ending}"))
    io.write_cube(image, name)
    frame = imaging.frame_of(image, axes="z-up")
    with provenance.dated(datetime.datetime(2026, 1, 2, tzinfo=datetime.UTC)):
        left = imaging.leave_out(
            io.read_cube(name),
            good_only=selection.good_only,
            largest_uncertainty=selection.largest_uncertainty,
            mixed=selection.mixed,
        )
        cloud = imaging.point_cloud(left, frame=frame)
        io.write_cloud(cloud, one)
        for rows in (1, 4):
            made = cloud_file(
                name, other, frame=frame, selection=selection, rows=rows, overwrite=True
            )
            assert one.read_bytes() == other.read_bytes()
            assert made.points == cloud.sizes["point"]
    assert (made.doubtful > 0) == (selection == Selection())


def test_the_command_writes_the_same_by_rows(
    image: xr.Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = tmp_path / "i.nc"
    io.write_cube(image, name)
    said = []
    for number, words in enumerate(([], ["--tile-rows", "4"])):
        output = tmp_path / f"{number}.ply"
        options = ["--largest-uncertainty", "4 mm", "-o", str(output)]
        assert main(["export", str(name), *options, *words]) == 0
        said.append(capsys.readouterr().out.split(": ")[1])
    assert said[0] == said[1]
    assert content(tmp_path / "0.ply") == content(tmp_path / "1.ply")
    words = ["export", str(name), "-o", str(tmp_path / "d.tif"), "--tile-rows", "4"]
    assert main(words) == 2
    assert "other products need the whole image" in " ".join(
        capsys.readouterr().err.split()
    )


def test_a_cloud_as_a_cube_by_rows_is_that_of_the_whole(
    image: xr.Dataset, tmp_path: Path
) -> None:
    name, output = tmp_path / "i.nc", tmp_path / "c.nc"
    io.write_cube(image, name)
    left = imaging.leave_out(io.read_cube(name), good_only=True)
    cloud = imaging.point_cloud(left).assign_attrs(history="")
    for rows in (1, 4):
        cloud_file(name, output, selection=Selection(True), rows=rows, overwrite=True)
        found = io.read_cube(output)
        xr.testing.assert_identical(found.assign_attrs(history=""), cloud)


def test_parts_of_an_e57_scan_come_in_the_order_of_their_rows(
    image: xr.Dataset, tmp_path: Path
) -> None:
    cloud = imaging.point_cloud(image)
    number = cloud["row"].values
    parts = [cloud.isel(point=number >= 4), cloud.isel(point=number < 4)]
    count = cloud.sizes["point"]
    with pytest.raises(CubeError, match="row 0 comes after those of row 8"):
        e57.write_e57_parts(lambda: parts, count, tmp_path / "c.e57", shape=(9, 17))
    assert not (tmp_path / "c.e57").exists()


def test_what_is_no_cloud_leaves_no_file(image: xr.Dataset, tmp_path: Path) -> None:
    name, output = tmp_path / "i.nc", tmp_path / "c.ply"
    flag = image["quality_flag"]
    missing = flag.copy(data=np.full_like(flag.values, QualityFlag.MISSING))
    io.write_cube(image.assign(quality_flag=missing), name)
    with pytest.raises(CubeError, match="there is no point in it"):
        cloud_file(name, output, rows=4)
    with pytest.raises(FormatError, match=r"names no format.*use one of .ply"):
        cloud_file(name, tmp_path / "c.stl")
    assert not output.exists()
    io.write_cube(image, name, overwrite=True)
    assert isinstance(cloud_file(name, output), CloudSummary)


def test_a_cloud_of_unknown_errors_says_why(image: xr.Dataset, tmp_path: Path) -> None:
    flag = image["quality_flag"].values.copy()
    # The last row alone is raw.
    flag[-1] |= QualityFlag.NO_OPEN_WATER
    io.write_cube(image, tmp_path / "known.nc")
    raw = image.assign(quality_flag=image["quality_flag"].copy(data=flag))
    io.write_cube(raw, tmp_path / "raw.nc")
    said = [
        cloud_file(tmp_path / f"{name}.nc", tmp_path / f"{name}.ply", rows=2)
        for name in ("known", "raw")
    ]
    assert said[0].error_unknown == ""
    assert said[1].error_unknown.startswith("water not removed: error unknown")
    assert said[1].points == said[0].points
