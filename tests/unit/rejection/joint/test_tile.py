"""Joint estimation row by row: what all at once gives, in bounded memory."""

from __future__ import annotations

import tracemalloc

import numba
import numpy as np
import pytest
import xarray as xr

from amulor.cube import tiles, without_groups
from amulor.rejection import joint
from amulor.rejection.joint import estimate as joint_tile
from amulor.rejection.joint.estimate import prepared

INTERVAL = (0.8, 4.0)


def in_tiles(cube: xr.Dataset, rows: int) -> xr.Dataset:
    """Return the estimate of tiles of some rows, put together."""
    source = tiles.InMemory(cube)
    common = prepared(source, interval=INTERVAL)
    whole = tiles.Whole(source.rows, source.columns)
    for begin, end in tiles.bands(source, rows):
        tile = source.tile(begin, end).copy(deep=True)
        whole.put(joint_tile.of_rows(tile, common, begin), begin)
    return whole.made()


@pytest.fixture(scope="module")
def odd_samples(samples: xr.Dataset) -> xr.Dataset:
    """Return samples with what makes pixels differ: gaps, spikes, open water, times."""
    rng = np.random.default_rng(3)
    cube = samples.copy(deep=True)
    signal = cube["in_phase"].values
    signal[..., 1, 3] = np.nan
    signal[:, :, 4, 8] += 40 * cube["in_phase_uncertainty"].values[:, :, 4, 8]
    signal[2, :, 2, 5] *= 1.5
    shape = cube["azimuth"].shape
    time = np.arange(cube["azimuth"].size, dtype=float).reshape(shape) + rng.random(
        shape
    )
    stated = {"long_name": "time since the start of the scan", "units": "s"}
    return cube.assign_coords(time=(("row", "column"), time, stated))


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 4])
def test_tiles_of_rows_give_what_the_whole_gives(
    rows: int, odd_samples: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = joint(odd_samples, interval=INTERVAL)
    # Small blocks, which begin in the middle of a row, and a first look in pieces.
    monkeypatch.setattr(joint_tile, "_AT_ONCE", 5)
    monkeypatch.setattr(tiles, "SAMPLES_AT_ONCE", 100)
    tiled = in_tiles(odd_samples, rows)
    assert whole["quality_flag"].values.any()
    xr.testing.assert_identical(
        *(one.assign_attrs(history="") for one in (whole, tiled))
    )


@pytest.mark.study
def test_memory_does_not_grow_with_the_pixels(
    samples: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(joint_tile, "_AT_ONCE", 512)
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 1)

    def beyond(times: int) -> tuple[int, int]:
        """Return pixels, and the memory beyond the cubes that go in and out [B]."""
        rows = np.tile(np.arange(samples.sizes["row"]), times)
        cube = without_groups(samples, "truth").isel(row=rows)
        tracemalloc.start()
        try:
            result = joint(cube, interval=INTERVAL)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        made = sum(variable.nbytes for variable in result.variables.values())
        return cube["azimuth"].size, peak - made

    joint(samples, interval=INTERVAL)  # what is compiled and imported stays
    few, small = beyond(30)
    many, large = beyond(150)
    assert (large - small) / (many - few) < 300


@pytest.mark.slow
def test_a_tile_may_hold_what_the_first_one_has() -> None:
    plane = xr.Dataset(
        {"a": (("f", "row", "column"), np.arange(24.0).reshape(2, 3, 4)), "b": 3},
        {"place": (("row", "column"), np.arange(12).reshape(3, 4))},
        {"title": "one"},
    )
    whole = tiles.Whole(3, 4)
    for row, column in ((0, 0), (0, 3), (2, 0), (2, 3)):
        part = plane.isel(row=slice(row, row + 2), column=slice(column, column + 3))
        whole.put(part, row, column)
    xr.testing.assert_identical(whole.made(), plane)
