"""Points of all pixels of averaged scans: place, covariance, files."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import drawn_sites
import numpy as np
import pytest
import underwater_sites as oracle
from numpy.testing import assert_allclose, assert_array_equal
from site_scenes import scanning

from amulor.site import blocks
from amulor.site.merging import pixels
from amulor.site.merging.cloud import Merged, merge, seen_by_others
from amulor.site.merging.pixels import all_points, joined, scan_clouds
from amulor.site.merging.tiles import write_tiles
from amulor.site.registration.pose import ScanPose
from amulor.site.registration.register import surfaces_of
from amulor.site.registration.surface import scan_surface, shared_errors


class Both:
    """One site merged from all pixels, and from averaged scans in pieces."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def fish(distance: np.ndarray) -> np.ndarray:
            nearer = distance.copy()
            nearer[60:90, 60:108] -= 0.6
            return nearer

        rng = np.random.default_rng(5)
        scene = oracle.bed(rng)
        stations = {f"a{k + 1}": one for k, one in enumerate(oracle.ring(3, rng))}
        starts = {
            name: oracle.start_of(one, rng, position=1e-3, angle=1e-3)
            for name, one in stations.items()
        }
        drawn = drawn_sites.drawn_site(
            {"one": scene}, {"one": stations}, starts, rng, rows=156,
            spoiled={"a2": fish},
        )  # fmt: skip
        self.registration = drawn_sites.known_registration(drawn)
        # Poses with errors, so that covariances depend on the places of points.
        for name in stations:
            size = len(self.registration.covariance)
            self.registration.places[f"pose {name}"] = (size, size + 6)
            larger = np.zeros((size + 6, size + 6))
            larger[:size, :size] = self.registration.covariance
            larger[size:, size:] = 1e-6 * np.eye(6)
            object.__setattr__(self.registration, "covariance", larger)
        self.site = drawn.site.model_copy(
            update={
                "scan": tuple(
                    scan.model_copy(update={"file": folder / scan.file.name})
                    for scan in drawn.site.scan
                )
            }
        )
        drawn_sites.written(drawn, folder)
        self.full = merge(self.site, self.registration, drawn.surfaces, drawn.images)
        monkeypatch.setattr(blocks, "MOST_PIXELS", 10_000)
        monkeypatch.setattr(pixels, "_AT_ONCE", 1000)
        self.surfaces, self.images = surfaces_of(self.site)
        self.cloud = merge(self.site, self.registration, self.surfaces, self.images)

    def pieces(self) -> list[Merged]:
        return list(all_points(self.cloud, self.registration, self.surfaces))


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Both]:
    with pytest.MonkeyPatch.context() as patch:
        yield Both(tmp_path_factory.mktemp("site"), patch)


def test_pieces_contain_the_points_of_all_pixels(both: Both) -> None:
    pieces = both.pieces()
    assert len(pieces) > 10
    assert len(both.cloud.position) < len(both.full.position) / 3
    points = joined(pieces)
    for name in ("scan", "pixel", "flag", "intensity", "own", "beam"):
        assert_array_equal(getattr(points, name), getattr(both.full, name))
    assert_allclose(points.position, both.full.position, atol=1e-12)
    # Shapes of shared errors are those of the block, at the range of the pixel.
    scale = np.sqrt(np.einsum("ni,nj->nij", *[both.full.sigma**2] * 2))
    off = np.abs(points.covariance - both.full.covariance) / scale
    assert np.quantile(off, 0.99) < 0.01
    assert off.max() < 0.1


def test_a_fish_is_marked_in_its_pixels(both: Both) -> None:
    points = joined(both.pieces())
    row, column = np.divmod(points.pixel, 208)
    inside = (points.scan == 1) & (row >= 60) & (row < 90)
    inside &= (column >= 60) & (column < 108)
    assert inside.sum() > 1000
    # Elsewhere no smooth surface of another scan lies behind the fish.
    assert points.moving[inside].mean() > 0.8
    assert points.moving[~inside].mean() < 0.005


def test_weights_are_close_to_those_of_all_pixels(both: Both) -> None:
    points = joined(both.pieces())
    assert np.median(np.abs(points.share - both.full.share)) < 0.05
    # Fewer at the rim of each scan and of humps: windows of blocks are wider.
    confirmed = (points.confirmed > 0).mean()
    assert 0.7 < confirmed / (both.full.confirmed > 0).mean() < 1.05


def test_tiles_of_pieces_contain_every_point_once(both: Both, tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    files = write_tiles(both.cloud, tmp_path / "t", size=1.0, pieces=both.pieces())
    listed = json.loads((tmp_path / "t" / "tiles.json").read_text())["tiles"]
    assert [file.name for file in files] == list(listed)
    total, brightest = 0, 0
    for file in files:
        points = laspy.read(file)
        assert len(points.points) == listed[file.name]["points"]
        total += len(points.points)
        brightest = max(brightest, int(points.intensity.max()))
        low = np.array(listed[file.name]["west_south_m"])
        place = np.stack([points.x, points.y], axis=1)
        assert ((place >= low - 1e-5) & (place <= low + 1.00001)).all()
    assert total == len(both.full.position)
    assert brightest == 65535


def test_clouds_of_scans_contain_all_pixels(both: Both) -> None:
    clouds = scan_clouds(both.cloud, both.registration, both.surfaces, both.images)
    for number, cloud in enumerate(clouds):
        mine = both.full.scan == number
        assert cloud.attrs["title"] == f"a{number + 1}"
        assert cloud.sizes["point"] > 0.95 * mine.sum()


def test_scans_that_were_not_averaged_are_one_piece(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = drawn_sites.one_visit("bed", 2, rows=36)
    registration = drawn_sites.known_registration(drawn)
    for name in drawn.stations:
        registration.places[f"pose {name}"] = (0, 0)
    monkeypatch.setattr(pixels, "_pieces", None)
    cloud = both_of(drawn)
    (piece,) = all_points(cloud, registration, drawn.surfaces)
    assert piece is cloud


def both_of(drawn: drawn_sites.DrawnSite) -> Merged:
    """Return a cloud of a drawn site without points."""
    empty = np.zeros((0, 3))
    fields = dict.fromkeys(Merged.__dataclass_fields__, empty)
    return Merged(**(fields | {"site": drawn.site, "brightest": 0.0}))  # type: ignore[arg-type]


def test_a_scan_does_not_confirm_its_own_points() -> None:
    azimuth, elevation, unit = scanning.grid(20, 24, 0.09)
    errors = scanning.Errors(own=5e-4, delay=0.0, index=0.0, reference=0.0)
    wall = 2.0 / unit[..., 2]
    draw = scanning.Draw(np.random.default_rng(1))
    image = scanning.image(wall, azimuth, elevation, errors=errors, draw=draw, scan="a")
    shared = shared_errors(image, scan="a", instrument="i", water="w")
    surface = scan_surface(image, name="a", shared=shared)
    here = ScanPose(np.eye(3), np.zeros(3))
    point = wall[8:12, 10:14].reshape(-1, 1) * unit[8:12, 10:14].reshape(-1, 3)
    sigma = np.full(len(point), 5e-4)
    for names, count in ((["a"], 0), (["a", "b"], 1), (["b", "c"], 2)):
        surfaces, poses = dict.fromkeys(names, surface), dict.fromkeys(names, here)
        confirmed, through = seen_by_others("a", surfaces, poses, point, sigma)
        assert_array_equal(confirmed, count)
        assert_array_equal(through, 0)
        # 10 cm nearer the wall behind is seen through them.
        nearer = 0.95 * point
        confirmed, through = seen_by_others("a", surfaces, poses, nearer, sigma)
        assert_array_equal(confirmed, 0)
        assert_array_equal(through, count)
