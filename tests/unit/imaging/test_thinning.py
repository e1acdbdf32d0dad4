"""Large range images: what is drawn of them, and what is said of all their pixels."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from site_scenes import scanning

from amulor import io
from amulor.cli import main
from amulor.cube import QualityFlag, tiles
from amulor.errors import CubeError
from amulor.imaging import selection
from amulor.imaging.measure import Check, compared

CHECKS = (
    Check(name="far", first=(1, 2), second=(29, 38), expected=0.7),
    Check(name="near", first=(9, 5), second=(12, 9), expected=0.1, reach=2),
    Check(name="at the rim", first=(0, 0), second=(30, 40), expected=0.8, reach=1),
)


@pytest.fixture(scope="module")
def image() -> xr.Dataset:
    """Return a range image with gaps that no check meets."""
    rng = np.random.default_rng(7)
    azimuth, elevation, unit = scanning.grid(31, 41, 0.3)
    image = scanning.image(
        2.0 / unit[..., 2], azimuth, elevation, errors=scanning.Errors(),
        draw=scanning.Draw(rng), scan="a",
    )  # fmt: skip
    flag = np.zeros(azimuth.shape, dtype=np.int16)
    flag[14:28][rng.random((14, 41)) < 0.2] = QualityFlag.MISSING
    flag[14:28][rng.random((14, 41)) < 0.2] = QualityFlag.MIXED
    gone = (flag & int(QualityFlag.MISSING)) != 0
    ranges = image["slant_range"]
    return image.assign(
        quality_flag=image["quality_flag"].copy(data=flag),
        slant_range=ranges.copy(data=np.where(gone, np.nan, ranges.values)),
    )


def test_what_is_shown_is_some_of_the_rows_and_columns(
    image: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(selection, "LARGEST", 31 * 41 - 1)
    monkeypatch.setattr(selection, "SHOWN", 150)
    found = {
        rows: selection.thinned(tiles.InMemory(image), rows=rows, checks=CHECKS)
        for rows in (1, 4, 31)
    }
    # sqrt(31 * 41 / 150) = 2.9: every third row and column, from the second one on.
    expected = image.isel(row=slice(1, None, 3), column=slice(1, None, 3))
    flag = image["quality_flag"].values
    for shown, whole in found.values():
        xr.testing.assert_identical(shown, expected)
        assert (whole.rows, whole.columns, whole.step) == (31, 41, 3)
        assert whole.usable == np.isfinite(image["slant_range"].values).sum()
        assert whole.flags == {
            name: int(((flag & int(bit)) != 0).sum())
            for name, bit in (
                ("missing", QualityFlag.MISSING), ("mixed", QualityFlag.MIXED),
            )
        }  # fmt: skip
        # Lengths are measured in the pixels that they name, not in those shown.
        for check, checked in zip(CHECKS, whole.checks, strict=True):
            alone = compared(image, check)
            assert dataclasses.asdict(checked) == dataclasses.asdict(alone)
    outside = Check(name="outside", first=(1, 2), second=(31, 3), expected=1.0)
    with pytest.raises(CubeError, match=r"\(31, 3\) is outside of the image"):
        selection.thinned(tiles.InMemory(image), checks=[outside])


def test_an_image_that_can_be_drawn_is_left_as_it_is(image: xr.Dataset) -> None:
    shown, whole = selection.thinned(tiles.InMemory(image), rows=7)
    xr.testing.assert_identical(shown, image)
    assert whole.step == 1


@pytest.mark.slow
def test_a_report_by_rows_says_what_it_shows(
    image: xr.Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = tmp_path / "image.nc"
    io.write_cube(image, name)

    def report(*words: str) -> str:
        output = tmp_path / "report.html"
        check = ["--check", "1,2 29,38 40cm"]
        words = ("report", str(name), "-o", str(output), *check, *words)
        assert main([*words, "--overwrite"]) == 0
        return output.read_text()

    whole = report()
    assert report("--tile-rows", "4") == whole
    monkeypatch.setattr(selection, "LARGEST", 1000)
    monkeypatch.setattr(selection, "SHOWN", 150)
    thin = report()
    assert thin == report("--tile-rows", "1")
    said = "image has 41 x 31 pixels: one row and column of every 3 is drawn"
    assert said in thin
    assert said not in whole
    for text in (whole, thin):
        assert "Flags, of 1271 pixels" in text
