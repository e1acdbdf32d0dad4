"""Every export refuses what is no cloud, and the suffix picks the format."""

import subprocess
import sys

import numpy as np
import pytest

from amulor.errors import CubeError, FormatError
from amulor.io import CLOUD_SUFFIXES, write_cloud

SIGNATURES = {
    ".ply": b"ply\n",
    ".laz": b"LASF",
    ".las": b"LASF",
    ".e57": b"ASTM-E57",
    ".mcap": b"\x89MCAP0\r\n",
    ".xyz": b"# axes: ",
    ".csv": b"# axes: ",
    ".PLY": b"ply\n",
    ".LAZ": b"LASF",
    ".E57": b"ASTM-E57",
}


@pytest.mark.parametrize("suffix", SIGNATURES)
def test_the_suffix_picks_the_format(point_cloud, tmp_path, suffix):
    path = tmp_path / f"cloud{suffix}"
    write_cloud(point_cloud, path, shape=(7, 9))
    assert path.read_bytes().startswith(SIGNATURES[suffix])
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["cloud.obj", "cloud", "cloud.nc"])
def test_an_unknown_suffix_is_refused_with_the_known_ones(point_cloud, tmp_path, name):
    with pytest.raises(FormatError, match=r"\.ply, \.laz, \.las, \.e57") as info:
        write_cloud(point_cloud, tmp_path / name, shape=(7, 9))
    assert name in str(info.value)


@pytest.mark.parametrize("suffix", CLOUD_SUFFIXES)
class TestEveryExport:
    def refuse(self, cloud, tmp_path, suffix, words):
        path = tmp_path / f"cloud{suffix}"
        with pytest.raises(CubeError, match=words) as info:
            write_cloud(cloud, path, shape=(7, 9))
        assert str(path) in str(info.value)
        assert str(info.value).isprintable()
        assert list(tmp_path.iterdir()) == []

    def test_refuses_another_level(self, make, rng, tmp_path, suffix):
        cube = make.range_image(rng)
        words = "is of level range_image, but level point_cloud.*amulor export"
        self.refuse(cube, tmp_path, suffix, words)

    def test_refuses_an_empty_cloud(self, point_cloud, tmp_path, suffix):
        empty = point_cloud.isel(point=slice(0))
        self.refuse(empty, tmp_path, suffix, "no point in it")

    @pytest.mark.parametrize("variable", ["x", "y", "z", "intensity"])
    @pytest.mark.parametrize("value", [np.nan, np.inf])
    def test_refuses_what_is_not_finite(
        self, point_cloud, tmp_path, suffix, variable, value
    ):
        point_cloud[variable].values[[2, 7]] = value
        self.refuse(point_cloud, tmp_path, suffix, f"'{variable}' of 2 points")

    @pytest.mark.parametrize("variable", ["row", "column", "quality_flag"])
    @pytest.mark.parametrize("value", [-1.0, 0.5, 2.0**31, np.nan])
    def test_refuses_numbers_that_count_nothing(
        self, point_cloud, tmp_path, suffix, variable, value
    ):
        cloud = point_cloud.assign({variable: point_cloud[variable].astype(float)})
        cloud[variable].values[4] = value
        self.refuse(cloud, tmp_path, suffix, f"'{variable}' must hold whole numbers")

    def test_keeps_an_existing_file(self, point_cloud, tmp_path, suffix):
        path = tmp_path / f"cloud{suffix}"
        path.write_bytes(b"old")
        with pytest.raises(FormatError, match="--overwrite"):
            write_cloud(point_cloud, path, shape=(7, 9))
        assert path.read_bytes() == b"old"
        write_cloud(point_cloud, path, shape=(7, 9), overwrite=True)
        assert path.read_bytes().startswith(SIGNATURES[suffix])


@pytest.mark.slow
def test_the_packages_of_the_formats_are_loaded_only_when_used():
    program = (
        "import sys, amulor.io\n"
        "print({'laspy', 'pye57', 'h5py', 'h5netcdf'} & set(sys.modules))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    )
    assert done.stdout.strip() == "set()"
