"""Rows of a cube: sources, tiles put together, and samples of a scan, by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from amulor.cube import QualityFlag, tiles
from amulor.errors import AmulorError

PIXEL = ("row", "column")


def scan(rows: int, columns: int) -> xr.Dataset:
    """Return a cube whose values say where they are, such as 203 in row 2, column 3."""
    place = 100 * np.arange(rows)[:, None] + np.arange(columns)
    return xr.Dataset(
        {
            "slant_range": (PIXEL, place.astype(float)),
            "quality_flag": (PIXEL, np.full((rows, columns), 64, np.int16)),
            "user_number": (PIXEL, place),
            "user_of_columns": ("column", np.arange(columns) / 2),
            "user_shared": ((), 5.0),
            "truth_target": (PIXEL, place),
            "open_water_in_phase": ("shot", np.ones(2)),
        },
        {
            "azimuth": (PIXEL, place / 10),
            "elevation": (PIXEL, -place / 20),
            "polarization": ["VV"],
        },
        {"level": "range_image"},
    )


class Rows:
    """Source that is not in memory; notes what is read."""

    def __init__(self, cube: xr.Dataset) -> None:
        self.cube, self.read = cube, list[tuple[str, int, int]]()
        self.rows, self.columns = cube.sizes["row"], cube.sizes["column"]
        self.head = tiles.InMemory(cube).head

    def tile(self, begin: int, end: int) -> xr.Dataset:
        self.read.append(("tile", begin, end))
        return self.cube.isel(row=slice(begin, end))

    def directions(self, begin: int, end: int) -> xr.Dataset:
        self.read.append(("directions", begin, end))
        return tiles.directions_of(self.cube.isel(row=slice(begin, end)))


def test_rows_in_memory_are_those_of_the_cube() -> None:
    cube = scan(3, 2)
    source = tiles.InMemory(cube)
    assert (source.rows, source.columns) == (3, 2)
    assert set(source.head.variables) == {
        "user_of_columns", "user_shared", "open_water_in_phase", "polarization",
    }  # fmt: skip
    assert source.head.attrs == cube.attrs
    for end in (3, 4):
        assert source.tile(0, end) is cube
    for begin, end in ((1, 3), (0, 2), (1, 2)):
        xr.testing.assert_identical(
            source.tile(begin, end), cube.isel(row=slice(begin, end))
        )
    found = source.directions(1, 3)
    assert set(found.variables) == {"azimuth", "elevation"}
    assert set(found.coords) == {"azimuth", "elevation"}
    assert found["elevation"].values.tolist() == [[-5, -5.05], [-10, -10.05]]


def test_a_changed_source_has_the_rows_and_directions_of_the_first() -> None:
    source = Rows(scan(4, 3))
    changed = tiles.Changed(source, lambda tile: tile.assign(user_new=7.0))
    assert (changed.rows, changed.columns) == (4, 3)
    assert changed.tile(1, 3)["user_new"] == 7
    assert changed.tile(1, 3)["slant_range"].values[0].tolist() == [100, 101, 102]
    source.read.clear()
    head = changed.head
    assert "user_new" in head
    assert "slant_range" not in head
    # The head is made once, from the first row.
    assert changed.head is head
    assert source.read == [("tile", 0, 1)]
    assert changed.directions(1, 2)["azimuth"].values.tolist() == [[10, 10.1, 10.2]]
    assert source.read[1:] == [("directions", 1, 2)]


def test_the_rows_of_a_base_are_not_defined() -> None:
    with pytest.raises(NotImplementedError):
        tiles.Derived(Rows(scan(1, 1))).tile(0, 1)


def test_tiles_of_a_source_have_the_samples_that_fit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sizes = {"modulation_frequency": 2, "polarization": 3}
    source: Any = SimpleNamespace(rows=5, columns=4, head=SimpleNamespace(sizes=sizes))
    assert tiles.samples_of_row(source) == 24
    for at_once, rows in ((23, 1), (24, 1), (47, 1), (48, 2), (1000, 41)):
        monkeypatch.setattr(tiles, "SAMPLES_AT_ONCE", at_once)
        assert next(tiles.bands(source)) == (0, min(rows, 5))
    assert list(tiles.bands(source, 2)) == [(0, 2), (2, 4), (4, 5)]
    plain: Any = SimpleNamespace(rows=1, columns=4, head=SimpleNamespace(sizes={}))
    assert tiles.samples_of_row(plain) == 4
    # A source without columns has one tile.
    monkeypatch.setattr(tiles, "SAMPLES_AT_ONCE", 3)
    empty: Any = SimpleNamespace(rows=3, columns=0, head=SimpleNamespace(sizes={}))
    assert list(tiles.bands(empty)) == [(0, 3)]


def test_a_scan_is_large_above_a_number_of_bytes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for text in (None, "", " "):
        monkeypatch.delenv("AMULOR_LARGE", raising=False)
        if text is not None:
            monkeypatch.setenv("AMULOR_LARGE", text)
        assert not tiles.is_large(2**24)
        assert tiles.is_large(2**24 + 1)
    monkeypatch.setenv("AMULOR_LARGE", " 1e3 ")
    assert [tiles.is_large(size) for size in (1000, 1000.5)] == [False, True]
    monkeypatch.setenv("AMULOR_LARGE", "64 MB")
    with pytest.raises(AmulorError) as caught:
        tiles.is_large(1)
    assert str(caught.value) == (
        "AMULOR_LARGE is '64 MB'; state the bytes of a variable above which a scan is "
        "processed by rows, such as 64e6"
    )


def test_tiles_put_together_are_the_cube() -> None:
    cube = scan(5, 4)
    whole = tiles.Whole(5, 4)
    for rows, columns in (
        (slice(0, 2), slice(0, 3)), (slice(0, 2), slice(3, 4)),
        (slice(2, 5), slice(0, 3)), (slice(2, 5), slice(3, 4)),
    ):  # fmt: skip
        tile = cube.isel(row=rows, column=columns)
        whole.put(tile.copy(deep=True), rows.start, columns.start)
    made = whole.made()
    xr.testing.assert_identical(made, cube)
    assert {name: v.dtype for name, v in made.variables.items()} == {
        name: v.dtype for name, v in cube.variables.items()
    }


def test_tiles_of_whole_rows_begin_at_the_first_column() -> None:
    cube = scan(3, 2)
    whole = tiles.Whole(3, 2)
    for row in range(3):
        tile = cube.isel(row=[row])
        # What no row has is that of the first tile.
        whole.put(tile.assign(user_shared=5.0 + row), row)
    xr.testing.assert_identical(whole.made(), cube)


def test_a_sample_of_a_large_scan_is_patches_with_gaps_between_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tiles, "SAMPLE", 36)
    monkeypatch.setattr(tiles, "_BAND", 2)
    source = Rows(scan(20, 30))
    found = tiles.sample_of(source)
    assert source.read == [("tile", 0, 2), ("tile", 9, 11), ("tile", 18, 20)]
    rows = np.array([0, 1, -1, 9, 10, -1, 18, 19])
    columns = np.array([0, 1, -1, 14, 15, -1, 28, 29])
    gap = (rows[:, None] < 0) | (columns < 0)
    expected = np.where(gap, np.nan, 100.0 * rows[:, None] + columns)
    np.testing.assert_array_equal(found["slant_range"].values, expected)
    flag = np.where(gap, QualityFlag.MISSING, 64)
    np.testing.assert_array_equal(found["quality_flag"].values, flag)
    assert found["quality_flag"].dtype == np.int16
    # Directions and numbers of other variables are those of a neighbor.
    number = found["user_number"].values
    np.testing.assert_array_equal(number[~gap], expected[~gap])
    assert number[:, 2].tolist() == [14, 114, 114, 914, 1014, 1014, 1814, 1914]
    assert number[2].tolist() == [100, 101, 114, 114, 115, 128, 128, 129]
    assert np.isfinite(found["azimuth"].values).all()
    columns_only = found["user_of_columns"].values
    np.testing.assert_array_equal(
        columns_only, np.where(columns < 0, np.nan, columns / 2)
    )
    assert found["user_shared"] == 5
    assert found.attrs == {"level": "range_image"}


def test_a_scan_of_65536_pixels_is_its_own_sample() -> None:
    for rows, whole in ((256, True), (257, False)):
        cube = xr.Dataset({"number": (PIXEL, np.zeros((rows, 256), np.int8))})
        assert (tiles.sample_of(tiles.InMemory(cube)) is cube) == whole


def test_a_small_scan_is_its_own_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "SAMPLE", 36)
    cube = scan(6, 6)
    assert tiles.sample_of(tiles.InMemory(cube)) is cube
    longer = Rows(scan(7, 6))
    tiles.sample_of(longer)
    assert longer.read != [("tile", 0, 7)]


@pytest.mark.parametrize(
    ("size", "count", "bands"),
    [
        (3, 3, [(0, 3)]),
        (3, 4, [(0, 3)]),
        (4, 3, [(0, 3)]),
        (9, 1, [(0, 1)]),
        (9, 5, [(0, 2), (7, 9)]),
        (9, 4, [(0, 2), (7, 9)]),
        (10, 6, [(0, 2), (4, 6), (8, 10)]),
        (8, 6, [(0, 8)]),
        (10, 7, [(0, 2), (4, 6), (8, 10)]),
    ],
)
def test_bands_of_a_number_of_rows_are_spread_evenly(
    monkeypatch: pytest.MonkeyPatch,
    size: int,
    count: int,
    bands: list[tuple[int, int]],
) -> None:
    monkeypatch.setattr(tiles, "_BAND", 2)
    index, found, gaps = tiles._spread_bands(size, count)
    assert found == bands
    inside = [n for begin, end in bands for n in range(begin, end)]
    assert np.delete(index, gaps).tolist() == inside
    assert len(gaps) == len(bands) - 1


def test_angles_of_a_scan_are_those_of_all_tiles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cube = scan(5, 2)
    cube["azimuth"].values[3, 1] = 70.0
    cube["elevation"].values[2, 0] = 3.0
    expected = tiles.Span(azimuth=(0.0, 70.0), elevation=(-20.05, 3.0))
    assert tiles.span_of(cube) == expected
    monkeypatch.setattr(tiles, "SAMPLES_AT_ONCE", 4)
    source = Rows(cube)
    assert tiles.span_of(source) == expected
    assert source.read == [("directions", 0, 2), ("directions", 2, 4),
                           ("directions", 4, 5)]  # fmt: skip


@pytest.mark.parametrize("needs_span", [True, False])
def test_a_step_is_fitted_without_the_truth_and_applied_to_rows(
    needs_span: bool,
) -> None:
    calls: list[dict[str, Any]] = []

    def step(cube: xr.Dataset, **options: Any) -> tuple[xr.Dataset, str]:
        calls.append({"names": set(cube.data_vars), **options})
        return cube.assign(user_done=1.0), "the fit"

    source = Rows(scan(3, 2))
    options: dict[str, Any] = {} if needs_span else {"needs_span": False}
    fitted = tiles.fit_on_sample(step, source, level=4, **options)
    (call,) = calls
    assert "truth_target" not in call["names"]
    assert "open_water_in_phase" in call["names"]
    span = {"span": tiles.span_of(source)} if needs_span else {}
    assert call == {"names": call["names"], "level": 4, **span}
    rows = scan(1, 2)
    assert fitted(rows, 9)["user_done"] == 1
    assert calls[1] == {"names": set(rows.data_vars), "level": 4, "fit": "the fit"}
