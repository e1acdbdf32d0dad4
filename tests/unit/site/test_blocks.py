"""Averages over blocks of pixels: exact on planes, with honest errors."""

from __future__ import annotations

from pathlib import Path

import drawn_sites
import numpy as np
import pytest
import underwater_sites as oracle
import xarray as xr
from numpy.testing import assert_allclose, assert_array_equal

from amulor.site import Site, blocks
from amulor.site.blocks import averaged, block_of, block_size, pixels_of_scan
from amulor.site.registration import align, rough
from amulor.site.registration.register import register, surface_of, surfaces_of

ROWS, COLUMNS = 90, 120
#: A plane n . p = h in instrument axes, inclined by 40 degrees.
NORMAL = np.array([0.3, -np.sin(np.radians(40)), np.cos(np.radians(40))])
HEIGHT = 2.0


def plane(noise: float = 0.0, seed: int = 1) -> xr.Dataset:
    """Return a scan of the plane with stated errors of 1 mm for each pixel."""
    beams = oracle.grid(ROWS, COLUMNS)[2]
    distance = HEIGHT / (beams @ NORMAL)
    distance = distance + noise * np.random.default_rng(seed).normal(
        size=distance.shape
    )
    return drawn_sites.range_image(
        distance, ROWS, COLUMNS, noise=oracle.Noise(), name="a"
    )


def off_plane(image: xr.Dataset) -> np.ndarray:
    """Return ranges minus those of the plane in the directions of the blocks [m]."""
    azimuth, elevation = image["azimuth"].values, image["elevation"].values
    beams = np.stack(
        [
            np.sin(azimuth) * np.cos(elevation),
            -np.sin(elevation),
            np.cos(azimuth) * np.cos(elevation),
        ],
        axis=-1,
    )
    return np.asarray(image["slant_range"].values - HEIGHT / (beams @ NORMAL))


@pytest.mark.parametrize("size", [2, 3, 4])
def test_the_average_of_a_plane_lies_on_it(size: int) -> None:
    # Blocks of 24 mrad; the mean of the directions differs from the direction of the
    # mean angles by the square of the block over 24, up to 30 um of range here.
    image = averaged(plane(), size)
    assert image["slant_range"].shape == (ROWS // size, COLUMNS // size)
    limit = (size * 0.7 / COLUMNS) ** 2 / 24 * 3 * 2
    assert np.abs(off_plane(image)).max() < limit


def test_gaps_in_blocks_do_not_move_the_average() -> None:
    image = plane()
    rng = np.random.default_rng(3)
    flag = image["quality_flag"].values.copy()
    missing = rng.random(flag.shape) < 0.15
    flag[missing] |= 4
    flag[:3, :3] |= 4
    flag[3:6, :2] |= 4
    image["quality_flag"].values[:] = flag
    image["slant_range"].values[missing] = 7.0
    coarse = averaged(image, 3)
    good = coarse["quality_flag"].values == 0
    # Of nine pixels each is missing in 15 %: 99 % of the blocks have five.
    assert good.mean() > 0.9
    assert not good[0, 0]
    assert not good[1, 0]
    # The mean of the present pixels would be off by millimeters.
    assert np.abs(off_plane(coarse)[good]).max() < 1e-4


def test_noise_averages_and_common_errors_do_not() -> None:
    image = plane(noise=1e-3)
    coarse = averaged(image, 3)
    common = coarse["slant_range_common_uncertainty"].values
    own = np.sqrt(coarse["slant_range_uncertainty"].values ** 2 - common**2)
    flagged = image["quality_flag"].values.reshape(30, 3, 40, 3).any(axis=(1, 3))
    assert flagged.mean() < 0.05
    assert_allclose(own[~flagged], 1e-3 / 3, rtol=1e-6)
    fine = image["slant_range_common_uncertainty"].values
    assert_allclose(common, fine[1::3, 1::3], rtol=1e-3)
    # 1200 blocks: the scatter has an error of 1 / sqrt(2400).
    scatter = off_plane(coarse)[coarse["quality_flag"].values == 0].std()
    assert scatter == pytest.approx(1e-3 / 3, rel=4 / np.sqrt(2400))


def test_the_noise_of_incomplete_blocks_is_that_of_their_fit() -> None:
    # A plane through three corners of four has the mean of the diagonal at its center.
    image = plane()
    image["quality_flag"].values[0, 0] |= 4
    coarse = averaged(image, 2)
    common = coarse["slant_range_common_uncertainty"].values
    own = np.sqrt(coarse["slant_range_uncertainty"].values ** 2 - common**2)
    assert own[0, 0] == pytest.approx(1e-3 * np.sqrt(0.5), rel=1e-6)
    assert own[0, 1] == pytest.approx(1e-3 / 2, rel=1e-6)


def test_blocks_of_both_sides_of_an_edge_are_flagged() -> None:
    image = plane()
    image["slant_range"].values[:, 61:] += 0.3
    coarse = averaged(image, 3)
    assert (coarse["quality_flag"].values[2:-2, 20] != 0).all()
    assert (coarse["quality_flag"].values[:, :17] == 0).all()


def test_pixels_and_blocks_are_found_from_each_other() -> None:
    image = averaged(plane(), 3)
    site = site_of({})
    surface = surface_of(site, site.scan[0], image)
    number = np.array([0, 41, 7 * 40 + 3])
    pixel = pixels_of_scan(surface, number)
    assert_array_equal(pixel, [COLUMNS + 1, 4 * COLUMNS + 4, 22 * COLUMNS + 10])
    for block, at in zip(number, pixel, strict=True):
        row, column = block_of(image, *divmod(int(at), COLUMNS))
        assert row * 40 + column == block
    # Of an even number of pixels, the center is behind the middle.
    for side, center in ((2, 1), (4, 2)):
        even = surface_of(site, site.scan[0], averaged(plane(), side))
        assert pixels_of_scan(even, np.array([0])) == center * COLUMNS + center
    assert block_of(plane(), 8, 5) == (8, 5)


def site_of(target: dict[str, object]) -> Site:
    place = {"scan": "a", "row": 45, "column": 60}
    targets = [{"name": "t", "places": [place], **target}] if target else []
    return Site.model_validate(
        {
            "name": "s",
            "epoch": [{"name": "one"}],
            "scan": [{"name": "a", "file": "a.nc", "epoch": "one"}],
            "target": targets,
        }
    )


def test_blocks_stay_small_compared_with_targets(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    image = plane()
    assert block_size(site_of({}), "a", image) == 1
    monkeypatch.setattr(blocks, "MOST_PIXELS", 1000)
    # 10,800 pixels: blocks of 4 x 4 leave 660.
    assert block_size(site_of({}), "a", image) == 4
    # Pixels are 5.9 mrad wide, 15 mm on the plane 2.6 m away.
    for radius, size in ((0.30, 3), (0.20, 2), (0.05, 1)):
        target = {"kind": "sphere", "radius": radius, "radius_uncertainty": 1e-4}
        assert block_size(site_of(target), "a", image) == size
    picked = {"kind": "point", "picking_uncertainty": 0.002}
    assert block_size(site_of(picked), "a", image) == 1


def test_averaged_scans_register_within_their_errors(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(blocks, "MOST_PIXELS", 4000)
    monkeypatch.setattr(align, "_MOST_COMPARED", 3000)
    monkeypatch.setattr(rough, "_MOST_ROUGH", 1000)
    monkeypatch.setattr(rough, "_MOST_OTHERS", 2500)
    drawn = drawn_sites.one_visit("bed", 6, rows=105)
    site = Site.from_toml(drawn_sites.written(drawn, tmp_path))
    surfaces, _ = surfaces_of(site)
    assert {surface.distance.shape for surface in surfaces.values()} == {(52, 70)}
    result = register(site)
    assert result.contradictions == ()
    assert sum(pair["points"] for pair in result.pairs) < 3000
    for name, (shift, _) in drawn.wrong(result).items():
        sigma = np.sqrt(np.trace(result.covariance_of(f"pose {name}")[:3, :3]))
        # Beyond by chance in fewer than one of 10,000 cases.
        assert shift < 4 * sigma
