"""LAZ tiles of a merged cloud: what each point says of itself."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from amulor.cube import QualityFlag
from amulor.site.merging.cloud import Merged
from amulor.site.merging.tiles import write_tiles

laspy = pytest.importorskip("laspy")


def _cloud(**changed: Any) -> Merged:
    """Return four points of two scans on one metre."""
    site: Any = SimpleNamespace(
        name="Reef",
        frame=SimpleNamespace(crs="EPSG:32632", crs_offset=(5e5, 5.1e6, 0.0)),
        scan=[SimpleNamespace(name=name, epoch="one") for name in ("bow", "stern")],
    )
    count = 4
    apart = np.arange(count)[:, None] / 8
    fields: dict[str, Any] = {
        "position": np.array([[0.1, 0.2, -5.0]] * count) + apart,
        "covariance": np.tile(np.eye(3) * 1e-6, (count, 1, 1)),
        "own": np.full(count, 1e-3),
        "beam": np.tile([0.0, 0.0, -1.0], (count, 1)),
        "normal": np.tile([0.0, 0.0, 1.0], (count, 1)),
        "intensity": np.array([0.0, 0.25, 1.0, 2.0]),
        "scan": np.array([0, 0, 1, 1], dtype=np.int16),
        "pixel": np.arange(count),
        "flag": np.array([0, 0, QualityFlag.MIXED, 0], dtype=np.int16),
        "confirmed": np.zeros(count, dtype=np.int16),
        "moving": np.array([False, True, False, False]),
        "share": np.ones(count),
    }
    return Merged(site=site, **(fields | changed))


def _points(cloud: Merged, folder: Path) -> Any:
    (path,) = write_tiles(cloud, folder)
    return laspy.read(path)


def test_the_brightest_point_has_the_largest_intensity(tmp_path: Path) -> None:
    points = _points(_cloud(), tmp_path / "four")
    # Halves of 65,535 steps are rounded to even.
    assert points.intensity.tolist() == [0, 8192, 32768, 65535]
    dark = _points(_cloud(intensity=np.zeros(4)), tmp_path / "dark")
    assert dark.intensity.tolist() == [0, 0, 0, 0]


def test_moving_and_doubtful_points_are_withheld_and_scans_are_counted_from_one(
    tmp_path: Path,
) -> None:
    points = _points(_cloud(), tmp_path)
    assert np.asarray(points.withheld).tolist() == [0, 1, 1, 0]
    assert points.point_source_id.tolist() == [1, 1, 2, 2]
    assert points["moving"].tolist() == [0, 1, 0, 0]
    np.testing.assert_allclose(np.asarray(points.x) - 5e5, _cloud().position[:, 0])
    np.testing.assert_allclose(points["sigma_z"], 1e-3)


def test_tiles_are_squares_by_east_and_north(tmp_path: Path) -> None:
    position = np.array([[0.1, 7.0, -5.0], [12.0, 7.0, -5.0], [12.5, 9.9, -5.0],
                         [-3.0, 12.0, -5.0]])  # fmt: skip
    paths = write_tiles(_cloud(position=position), tmp_path)
    about = json.loads((tmp_path / "tiles.json").read_text())["tiles"]
    assert [path.name for path in paths] == list(about)
    found = {tuple(tile["west_south_m"]): tile["points"] for tile in about.values()}
    assert found == {(-5.0, 10.0): 1, (0.0, 5.0): 1, (10.0, 5.0): 2}
    assert {tile["size_m"] for tile in about.values()} == {5.0}
    for path in paths:
        assert len(laspy.read(path).points) == about[path.name]["points"]
    small = write_tiles(_cloud(position=position), tmp_path / "small", size=1.0)
    assert len(small) == 4


def test_coordinates_are_steps_from_whole_meters_without_a_reference_system(
    tmp_path: Path,
) -> None:
    cloud = _cloud()
    cloud.site.frame.crs_offset = (0.0, 0.0, 0.0)
    points = _points(cloud, tmp_path)
    assert np.asarray(points.header.offsets).tolist() == [0.0, 0.0, -5.0]
    np.testing.assert_allclose(np.asarray(points.xyz), cloud.position, atol=6e-6)
    assert np.asarray(points.header.scales).tolist() == [1e-5] * 3
