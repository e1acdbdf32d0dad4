"""Recordings by rows become the files that they become as a whole."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from amulor import io
from amulor.errors import FormatError
from amulor.io.recording_table import RecordingMap
from amulor.io.recordings import BREAKDOWN, NO_NUMBER, ZERO, read_recordings
from amulor.scale import recorded
from amulor.survey import Survey

ROWS, COLUMNS, SHOTS = 9, 7, 5
TEXT = """
[columns]
in_phase = "x"
quadrature = "y"
frequency = "f"
polarization = "pol"
what = "what"
mean = "dc"
temperature = "t"
"""
PLACES = {
    "rows": 'row = "row"\ncolumn = "column"\n',
    "angles": 'azimuth = "az"\nelevation = "el"\n',
    "order": "",
}


@pytest.fixture(scope="module")
def survey(plate: Survey) -> Survey:
    return plate.with_(
        {
            "scan.columns": COLUMNS,
            "scan.rows": ROWS,
            "scan.azimuth": "0 deg",
            "scan.elevation": "0 deg",
            "scan.azimuth_span": "6 deg",
            "scan.elevation_span": "8 deg",
            "scan.order": "serpentine",
        }
    )


def recording(known_by: str) -> dict[str, np.ndarray]:
    """Return columns with all that can stand in the way of a sample."""
    rng = np.random.default_rng(8)
    parts = []
    for frequency in (41e6, 30e6):
        for pair in ("VH", "VV"):
            for what, count in (("open_water", SHOTS), ("scan", ROWS * COLUMNS)):
                place = np.arange(count)
                part = {
                    "x": 1e-3 + 1e-6 * rng.standard_normal(count),
                    "y": 2e-3 + 1e-6 * rng.standard_normal(count),
                    # As a generator reads it back: never twice the same.
                    "f": frequency * (1 + 1e-8 * rng.standard_normal(count)),
                    "row": place // COLUMNS,
                    "column": place % COLUMNS,
                    "az": place % COLUMNS - 3.0,
                    "el": 4.0 - place // COLUMNS,
                    "dc": 0.1 + 1e-3 * rng.standard_normal(count),
                    "t": 20 + 0.01 * rng.standard_normal(count),
                    "pol": np.full(count, pair),
                    "what": np.full(count, what),
                }
                if what == "scan":
                    part["x"][8] = 0.5  # stands alone
                    # Each other's neighbours, on both sides of the border of tiles.
                    part["x"][24] += 0.7
                    part["x"][31] += 0.7
                    part["y"][40] = np.nan
                    part["x"][50] = part["y"][50] = 0.0
                parts.append(part)
    columns = {name: np.concatenate([part[name] for part in parts]) for name in part}
    if known_by != "order":  # samples come in any order, and some places twice
        order = rng.permutation(np.concatenate([np.arange(len(columns["x"])), [60]]))
        columns = {name: values[order] for name, values in columns.items()}
    return columns


def saved(folder: Path, columns: dict[str, np.ndarray], form: str) -> Path:
    path = folder / f"recording.{form}"
    if form == "hdf5":
        with h5py.File(path, "w") as file:
            for name, values in columns.items():
                file[name] = values.astype("S") if values.dtype.kind == "U" else values
        return path
    names = ",".join(columns)
    lines = [
        ",".join(str(value) if str(value) != "nan" else "" for value in line)
        for line in zip(*columns.values(), strict=True)
    ]
    path.write_text("\n".join([names, *lines]) + "\n")
    return path


def mapped(folder: Path, known_by: str, form: str) -> RecordingMap:
    path = folder / "map.toml"
    path.write_text(f'{TEXT}{PLACES[known_by]}[table]\nformat = "{form}"\n')
    return RecordingMap.from_toml(path)


def same(one: xr.Dataset, other: xr.Dataset) -> None:
    """Compare values, types and attributes, but for the time of day in the history."""
    histories = [cube.attrs.pop("history").split(" ", 1)[1] for cube in (one, other)]
    assert histories[0] == histories[1]
    xr.testing.assert_identical(one, other)
    for name, variable in other.variables.items():
        assert one[name].dtype == variable.dtype


@pytest.fixture(autouse=True)
def _small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read so few samples at once that all that goes from part to part counts."""
    monkeypatch.setattr(recorded, "_LINES", 37)
    monkeypatch.setattr(recorded, "_SAMPLES", 29)


@pytest.mark.parametrize("known_by", PLACES)
@pytest.mark.parametrize("form", ["csv", pytest.param("hdf5", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "rows", [2, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 4, ROWS, 50))]
)
def test_any_tiles_give_the_file_of_the_whole(
    tmp_path, survey, known_by, form, rows
) -> None:
    described = mapped(tmp_path, known_by, form)
    path = saved(tmp_path, recording(known_by), form)
    whole = read_recordings(path, described, survey)
    io.write_cube(whole, tmp_path / "whole.nc")
    made = recorded.import_file(
        path, described, survey, tmp_path / "tiled.nc", rows=rows
    )
    found = io.read_cube(tmp_path / "tiled.nc")
    same(found, io.read_cube(tmp_path / "whole.nc"))
    flag = found["user_sample_flag"].values.reshape(4, -1)
    assert {int(v) for v in flag.ravel()} == {0, ZERO, BREAKDOWN, NO_NUMBER}
    assert made.marked == {"zero output": 4, "breakdown": 4, "no number": 4}
    assert made.sizes["row"] == ROWS
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        [path.name, "map.toml", "tiled.nc", "whole.nc"]
    )


def test_one_of_several_temperatures_by_rows(tmp_path, survey) -> None:
    described = mapped(tmp_path, "rows", "csv")
    columns = recording("rows")
    warm = {**columns, "t": columns["t"] + 5, "x": columns["x"] * 2}
    path = saved(
        tmp_path, {k: np.concatenate([warm[k], columns[k]]) for k in columns}, "csv"
    )
    output = tmp_path / "tiled.nc"
    for temperature, message in ((None, "several temp.*20.*25"), (31.0, "no sample")):
        with pytest.raises(FormatError, match=message):
            recorded.import_file(
                path, described, survey, output, temperature=temperature, rows=2
            )
        assert not output.exists()
    recorded.import_file(path, described, survey, output, temperature=20.0, rows=2)
    io.write_cube(
        read_recordings(path, described, survey, temperature=20.0),
        tmp_path / "whole.nc",
    )
    same(io.read_cube(output), io.read_cube(tmp_path / "whole.nc"))


@pytest.mark.parametrize("count", [1, 2, 7, 200])
def test_a_median_of_a_file_is_that_of_numpy(tmp_path, count) -> None:
    values = np.random.default_rng(count).lognormal(sigma=9, size=count)
    values[: count // 3] = values[0]
    values.tofile(tmp_path / "values")
    assert recorded._median_of(tmp_path / "values") == np.median(values)
