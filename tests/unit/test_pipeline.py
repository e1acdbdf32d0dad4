"""Steps in their order; by rows, for whatever tiles, bit for bit the whole."""

from __future__ import annotations

import gc
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from amulor import imaging, io, pipeline, rejection
from amulor.cube import tiles, without_groups
from amulor.errors import CubeError
from amulor.pipeline import (
    TiledStep,
    image_file,
    image_step,
    reject_file,
    reject_step,
    run_step,
)
from amulor.simulation import simulate
from amulor.survey import Survey

INTERVAL = (0.8, 4.0)
SLOW = pytest.mark.slow
METHODS = [
    ("open-water", rejection.open_water, {"interval": INTERVAL}),
    ("cross-polarized", rejection.cross_polarized, {}),
    pytest.param("combined", rejection.combined, {}, marks=SLOW),
    pytest.param("frequency", rejection.frequency, {"interval": INTERVAL}, marks=SLOW),
    pytest.param("polarization", rejection.polarization, {}, marks=SLOW),
    pytest.param("joint", rejection.joint, {"interval": INTERVAL}, marks=SLOW),
]


@pytest.fixture(scope="module")
def samples(plate_text: str) -> xr.Dataset:
    """Return samples whose pixels differ: gaps, spikes, and a beam beside the plate."""
    text = plate_text.replace('["39 MHz"]', '["20 MHz", "60 MHz"]')
    text = text.replace("columns = 12\nrows = 6", "columns = 14\nrows = 11")
    text = text.replace('azimuth_span = "3.81 deg"', 'azimuth_span = "14 deg"')
    cube = simulate(Survey.from_text(text), rng=3)
    signal = cube["in_phase"].values
    signal[:, :, 4, 5] = np.nan
    signal[1, 0, 8, 6] *= 3
    return cube


def in_tiles(step: TiledStep, cube: xr.Dataset, rows: int) -> xr.Dataset:
    """Return what a step makes of tiles that share no memory, put together."""
    source = tiles.InMemory(cube)
    whole = tiles.Whole(source.rows, source.columns)
    for begin, tile in run_step(step, source, rows=rows):
        whole.put(tile.copy(deep=True), begin)
    return whole.made()


def assert_same(one: xr.Dataset, other: xr.Dataset) -> None:
    """Compare bit for bit; the history says when."""
    one, other = (each.assign_attrs(history="") for each in (one, other))
    xr.testing.assert_identical(one, other)


def test_the_order_of_steps_is_that_of_the_functions(samples: xr.Dataset) -> None:
    target = rejection.open_water(samples, interval=INTERVAL)
    image = imaging.range_image(target, polarization="VV", interval=INTERVAL)
    flagged = imaging.flag_outliers(imaging.flag_mixed(image))
    assert (flagged["quality_flag"] != image["quality_flag"]).any()
    how = {"polarization": "VV", "interval": INTERVAL}
    found = pipeline.run(samples, method="open-water", **how)
    assert_same(found, flagged)
    done = [line.split(": ")[1] for line in found.attrs["history"].splitlines()]
    assert done[1].startswith("reject, open water")
    assert done[2:] == ["image, channel VV", "mixed pixels marked", "outliers flagged"]
    assert_same(pipeline.run(target, **how), flagged)
    assert_same(pipeline.run(flagged, **how), flagged)


@pytest.mark.parametrize("rows", [1, 4])
def test_the_image_by_rows_is_that_of_one_piece(samples: xr.Dataset, rows: int) -> None:
    how = {"method": "cross-polarized", "polarization": "VH", "interval": INTERVAL}
    by_rows = samples
    for step in pipeline.steps_from("samples", **how).values():
        by_rows = in_tiles(step, by_rows, rows)
    assert_same(by_rows, pipeline.run(samples, **how))


def test_samples_without_a_method_are_refused(samples: xr.Dataset) -> None:
    with pytest.raises(CubeError, match="rejection method"):
        pipeline.run(samples)


@pytest.mark.parametrize(("method", "function", "options"), METHODS)
def test_a_rejection_in_tiles_is_that_of_the_whole(
    method: str, function: Any, options: dict[str, Any], samples: xr.Dataset
) -> None:
    whole = function(samples, **options)
    step = reject_step(method, **options)
    # A single row, and tiles that do not divide the scan.
    for rows in (1, 4):
        assert_same(in_tiles(step, samples, rows), whole)


@pytest.mark.slow
def test_shots_of_another_file_in_tiles_are_those_of_the_whole(
    samples: xr.Dataset, tmp_path: Path
) -> None:
    shots = [name for name in samples.data_vars if str(name).startswith("open_water_")]
    names = [tmp_path / name for name in ("bare.nc", "shots.nc", "target.nc")]
    bare = samples.drop_vars(shots)
    io.write_cube(bare, names[0])
    io.write_cube(samples, names[1])
    joined = rejection.with_open_water(io.read_cube(names[0]), io.read_cube(names[1]))
    whole = rejection.open_water(joined, interval=INTERVAL)
    for rows in (1, 4):
        reject_file(
            names[0], names[2], "open-water", open_water=names[1], rows=rows,
            overwrite=True, interval=INTERVAL,
        )  # fmt: skip
        assert_same(io.read_cube(names[2]), whole)


@pytest.mark.parametrize("shots", [True, False])
@pytest.mark.study
def test_auto_in_tiles_is_that_of_the_whole(
    samples: xr.Dataset, tmp_path: Path, shots: bool
) -> None:
    cube = samples if shots else without_groups(samples, "open_water")
    name, output = tmp_path / "samples.nc", tmp_path / "target.nc"
    io.write_cube(cube, name)
    comparison = rejection.compare(cube, interval=INTERVAL)
    whole = rejection.auto(cube, interval=INTERVAL, comparison=comparison)
    for rows in (None, 1, 4):
        made = reject_file(
            name, output, "auto", rows=rows, overwrite=True, interval=INTERVAL
        )
        assert repr(made.comparison) == repr(comparison)
        assert_same(io.read_cube(output), whole)
    # A recommendation without the shots is carried out without them.
    chosen = replace(comparison, method="joint without shots", polarization="VV")
    step = reject_step("auto", interval=INTERVAL, comparison=chosen)
    whole = rejection.auto(cube, interval=INTERVAL, comparison=chosen)
    assert_same(in_tiles(step, cube, 4), whole)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["open-water", "joint"])
def test_an_image_in_tiles_is_that_of_the_whole(
    method: str, samples: xr.Dataset
) -> None:
    options = {"interval": INTERVAL}
    target = (rejection.open_water if method == "open-water" else rejection.joint)(
        samples.sel(polarization=["VV"]), interval=INTERVAL
    )
    found = imaging.range_image(target, **options)
    whole = imaging.flag_outliers(imaging.flag_mixed(found))
    assert (whole["quality_flag"].values != 0).any()
    for rows in (1, 4):
        assert_same(in_tiles(image_step(**options), target, rows), whole)


@pytest.mark.slow
def test_a_scan_larger_than_its_sample_is_the_same_in_any_tiles(
    samples: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = np.repeat(np.arange(samples.sizes["row"]), 5)
    cube = samples.isel(row=rows, column=np.tile(np.arange(14), 2))
    # Enough pixels for a table of the column, fewer than all.
    monkeypatch.setattr(tiles, "SAMPLE", 1000)
    step = reject_step("open-water", interval=INTERVAL)
    whole = in_tiles(step, cube, cube.sizes["row"])
    assert_same(in_tiles(step, cube, 9), whole)
    # The sample is not all, and says nearly what all would say.
    every = rejection.open_water(cube, interval=INTERVAL)
    change = [each.attrs["open_water_change"] for each in (whole, every)]
    assert change[0] != change[1]
    error = every.attrs["open_water_change_uncertainty"]
    assert abs(change[0] - change[1]) < 3 * error


def test_a_sample_has_patches_from_edge_to_edge(
    samples: xr.Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tiles, "SAMPLE", 40 * 40)
    many = np.arange(90)
    cube = samples.isel(row=many % 11, column=many % 14).assign(
        user_row=(("row", "column"), np.repeat(many[:, None], 90, axis=1)),
        user_column=(("row", "column"), np.repeat(many[None], 90, axis=0)),
    )
    sample = tiles.sample_of(tiles.InMemory(cube))
    size = sample["azimuth"].size
    assert 0.5 * tiles.SAMPLE < size < 1.5 * tiles.SAMPLE
    there = sample["in_phase"].notnull().any(["modulation_frequency", "polarization"])
    for axis, name in (("row", "user_row"), ("column", "user_column")):
        place = sample[name].values
        assert (place.min(), place.max()) == (0, 89)
        step = np.diff(place, axis=0 if axis == "row" else 1)
        both = there.values[1:] & there.values[:-1]
        if axis == "column":
            both = there.values[:, 1:] & there.values[:, :-1]
        # Samples that stand side by side stand so in the scan.
        assert both.any()
        assert (step[both] == 1).all()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["open-water", "joint"])
def test_files_are_worked_on_by_rows(
    method: str, samples: xr.Dataset, tmp_path: Path
) -> None:
    cube = samples.sel(polarization=["VV"])
    names = [tmp_path / name for name in ("a.nc", "b.nc", "c.nc")]
    function = rejection.joint if method == "joint" else rejection.open_water
    io.write_cube(cube, names[0])
    made = reject_file(*names[:2], method, rows=3, interval=INTERVAL)
    io.write_cube(
        function(io.read_cube(names[0]), interval=INTERVAL), tmp_path / "w.nc"
    )
    target = io.read_cube(tmp_path / "w.nc")
    assert_same(io.read_cube(names[1]), target)
    assert made.count == target["quality_flag"].size
    assert made.flagged == int((target["quality_flag"] != 0).sum())
    image = image_file(*names[1:], rows=3, interval=INTERVAL)
    found = imaging.range_image(io.read_cube(names[1]), interval=INTERVAL)
    found = imaging.flag_outliers(imaging.flag_mixed(found))
    assert_same(io.read_cube(names[2]), found)
    assert image.usable == int(found["slant_range"].notnull().sum())


@pytest.mark.parametrize("rows", [None, 5])
def test_a_file_of_another_level_is_refused_by_its_name(
    samples: xr.Dataset, tmp_path: Path, rows: int | None
) -> None:
    io.write_cube(samples, tmp_path / "samples.nc")
    with pytest.raises(CubeError, match=r"samples\.nc: is of level samples.* reject"):
        image_file(tmp_path / "samples.nc", tmp_path / "image.nc", rows=rows)
    assert not (tmp_path / "image.nc").exists()


def test_methods_that_are_not_installed_are_refused() -> None:
    with pytest.raises(CubeError, match=r"no rejection method 'magic'.*open-water"):
        reject_step("magic")


@pytest.mark.parametrize(
    "level", ["samples", pytest.param("target_signal", marks=pytest.mark.slow)]
)
def test_no_tile_stays_in_memory(level: str, samples: xr.Dataset) -> None:
    cube, step = samples, reject_step("open-water", interval=INTERVAL)
    if level == "target_signal":
        cube = rejection.open_water(samples, interval=INTERVAL)
        step = image_step(interval=INTERVAL, polarization="VV")
    counts = []
    gc.collect()
    gc.disable()
    try:
        for _, tile in run_step(step, tiles.InMemory(cube), rows=2):
            del tile
            found = [each for each in gc.get_objects() if isinstance(each, xr.Dataset)]
            counts.append(len(found))
            del found
    finally:
        gc.enable()
    # The first has nothing before it; from the second on none is added.
    assert len(counts) == 6
    assert max(counts[2:]) <= counts[1]


def test_a_cube_in_memory_is_one_piece_unless_rows_are_stated(plate: Survey) -> None:
    cube = simulate(plate, rng=1)
    source = tiles.InMemory(cube)
    step: Any = lambda whole: whole.assign_attrs(seen=True)  # noqa: E731
    ((begin, made),) = pipeline.run_step(step, source)
    assert begin == 0
    xr.testing.assert_identical(made, cube.assign_attrs(seen=True))
    asked: Any = SimpleNamespace(halo=3)
    assert pipeline.window(asked, source, 7) == 7


@pytest.mark.parametrize("halo", [0, 2, 5])
def test_a_tile_has_its_own_rows_and_none_of_those_beside_them(halo: int) -> None:
    cube = xr.Dataset({"number": ("row", np.arange(12))}).expand_dims(column=2)
    seen = []

    def treat(wide: xr.Dataset, first: int) -> xr.Dataset:
        seen.append((first, first + wide.sizes["row"]))
        return wide

    prepared: Any = SimpleNamespace(halo=halo, treat=treat, input=lambda source: source)
    made = pipeline.Made(prepared, tiles.InMemory(cube))
    for begin, end in ((0, 4), (4, 9), (9, 12)):
        rows = made.tile(begin, end)["number"].values
        np.testing.assert_array_equal(rows[0], np.arange(begin, end))
        assert seen[-1] == (max(begin - halo, 0), min(end + halo, 12))


def numbered(rows: int) -> xr.Dataset:
    values = np.arange(2 * rows).reshape(rows, 2)
    return xr.Dataset({"number": (("row", "column"), values)})


@pytest.mark.parametrize("at_once", [1, 3, 20])
@pytest.mark.parametrize(
    "asked",
    [
        # Overlapping, with a gap, inside of the last one, backwards, and the same.
        [(0, 4), (2, 7), (6, 12)],
        [(3, 5), (8, 12), (9, 11), (9, 12), (0, 2), (0, 2)],
        [(5, 9), (4, 6), (5, 12)],
    ],
)
def test_rows_that_are_kept_are_those_of_the_source(
    asked: list[tuple[int, int]], at_once: int
) -> None:
    cube = numbered(12)
    read: list[int] = []

    class Counted(tiles.InMemory):
        def tile(self, begin: int, end: int) -> xr.Dataset:
            read.extend(range(begin, end))
            assert end - begin <= at_once
            return super().tile(begin, end)

    kept = pipeline._Kept(Counted(cube), at_once)
    for begin, end in asked:
        made = kept.tile(begin, end)
        xr.testing.assert_identical(made, cube.isel(row=slice(begin, end)))
    if asked[0] == (0, 4):
        # No row is read twice where tiles ascend.
        assert read == list(range(12))


def test_rows_of_a_file_are_worked_on_in_tiles_without_being_asked(
    plate: Survey, tmp_path: Path
) -> None:
    cube = simulate(plate, rng=1)
    io.write_cube(cube, tmp_path / "samples.nc")
    step: Any = SimpleNamespace(
        halo=0, of=None, fit=lambda source: lambda tile, first: tile.assign_attrs(a=1)
    )
    with io.netcdf.open_rows(tmp_path / "samples.nc") as source:
        made = list(run_step(step, source))
    assert made[0][0] == 0
    assert sum(tile.sizes["row"] for _, tile in made) == cube.sizes["row"]
    assert {tile.attrs["a"] for _, tile in made} == {1}


def test_a_small_file_is_in_memory_unless_rows_are_stated(
    plate: Survey, tmp_path: Path
) -> None:
    io.write_cube(simulate(plate, rng=1), tmp_path / "samples.nc")
    path = tmp_path / "samples.nc"
    with pipeline.opened(path, level="samples") as source:
        assert isinstance(source, tiles.InMemory)
        # Methods are compared on the cube itself, or on a sample without the truth.
        assert pipeline._judged(source, None) is source.cube
        judged = pipeline._judged(source, 2)
    assert any(str(name).startswith("truth_") for name in source.cube)
    assert not any(str(name).startswith("truth_") for name in judged)
    with pipeline.opened(path, 2, level="samples") as source:
        assert not isinstance(source, tiles.InMemory)


@pytest.mark.parametrize("rows", [0, -1])
def test_a_tile_without_rows_is_refused(rows: int) -> None:
    step: Any = None
    with pytest.raises(ValueError, match=f"a tile has 1 row at least, got {rows}"):
        next(run_step(step, tiles.InMemory(numbered(3)), rows=rows))


@pytest.mark.parametrize(
    ("rows", "columns", "wide"),
    # Of 1,600 pixels, 40 x 40: all columns of a scan that is up to 160 wide and high.
    [(90, 90, 90), (90, 161, 40), (41, 160, 160), (40, 100, 40), (500, 30, 30)],
)
def test_a_sample_has_all_columns_of_a_scan_that_is_not_much_wider(
    monkeypatch: pytest.MonkeyPatch, rows: int, columns: int, wide: int
) -> None:
    monkeypatch.setattr(tiles, "SAMPLE", 40 * 40)
    asked: list[int] = []
    kept = tiles._spread_bands

    def spread(size: int, room: int) -> Any:
        asked.append(room)
        return kept(size, room)

    monkeypatch.setattr(tiles, "_spread_bands", spread)
    cube = xr.Dataset({"number": (("row", "column"), np.zeros((rows, columns)))})
    tiles.sample_of(tiles.InMemory(cube))
    assert asked[0] == wide
    assert asked[1] == max(1600 // wide, 1)
