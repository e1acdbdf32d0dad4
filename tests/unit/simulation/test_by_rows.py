"""Scans that are simulated by rows are bit for bit the whole ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from amulor import cube as cubes
from amulor import io
from amulor.cli import main
from amulor.cube import tiles
from amulor.errors import SurveyError
from amulor.scale.simulated import simulate_file
from amulor.simulation import (
    ClosureModel,
    DiffusionModel,
    PhotonModel,
    SignalModel,
    SmallAngleModel,
    scene_light,
    simulate,
)
from amulor.simulation.by_rows import RowNoise, SimulatedRows
from amulor.survey import Survey

#: What the noise and the way of the light depend on, over a plate in a tank.
CHANGED = (
    ('["39 MHz"]', '["20 MHz", "60 MHz"]'),
    ("columns = 12\nrows = 6", "columns = 14\nrows = 11"),
    ('azimuth_span = "3.81 deg"', 'azimuth_span = "14 deg"'),
    ('width = "30 cm"', 'width = "20 cm"'),
)
BEHIND_GLASS = (
    *CHANGED,
    ('acceptance = "0.08 rad"', 'acceptance = "0.08 rad"\nspeckle_cells = 40'),
    ('dwell = "125 ms"', 'dwell = "125 ms"\norder = "serpentine"\nmoves = "both"'),
    (
        "[instrument.detector]",
        '[instrument.window]\ndistance = "20 cm"\nthickness = "2 cm"\n'
        "refractive_index = 1.5\ngroup_index = 1.52\n[instrument.detector]",
    ),
)


def surveyed(text: str, changes: tuple[tuple[str, str], ...]) -> Survey:
    for found, other in changes:
        assert found in text
        text = text.replace(found, other)
    return Survey.from_text(text)


def assert_same(one: xr.Dataset, other: xr.Dataset) -> None:
    """Compare bit for bit; the history says when."""
    one, other = (each.assign_attrs(history="") for each in (one, other))
    xr.testing.assert_identical(one, other)


def in_tiles(source: SimulatedRows, rows: int) -> xr.Dataset:
    whole = tiles.Whole(source.rows, source.columns)
    for begin, end in tiles.bands(source, rows):
        whole.put(source.tile(begin, end), begin)
    return whole.made()


@pytest.mark.parametrize(
    ("changes", "model"),
    [
        (BEHIND_GLASS, SmallAngleModel()),
        pytest.param(
            CHANGED,
            ClosureModel(),
            marks=[
                pytest.mark.slow,
                # It does not hold in some of these columns, and says so.
                pytest.mark.filterwarnings("ignore::amulor.errors.AmulorWarning"),
            ],
        ),
        pytest.param(CHANGED, DiffusionModel(), marks=pytest.mark.slow),
    ],
)
def test_rows_are_those_of_the_whole(
    plate_text: str, changes: tuple[tuple[str, str], ...], model: SignalModel
) -> None:
    survey = surveyed(plate_text, changes)
    whole = simulate(survey, rng=3, model=model)
    assert (whole["truth_target"].values < 0).any()
    # A single row, and tiles that do not divide the scan.
    for rows in (1, 4):
        assert_same(in_tiles(SimulatedRows(survey, rng=3, model=model), rows), whole)
    # In any order, and again.
    source = SimulatedRows(survey, rng=3, model=model)
    assert (source.rows, source.columns) == (11, 14)
    assert "open_water_in_phase" in source.head
    for begin in (7, 2, 7):
        rows = slice(begin, begin + 3)
        assert_same(source.tile(begin, begin + 3), whole.isel(row=rows))


@pytest.mark.parametrize(
    ("columns", "rows"), [(14, 90), pytest.param(1, 90, marks=pytest.mark.slow)]
)
def test_scans_larger_than_their_sample_are_the_same_whole(
    plate_text: str, monkeypatch: pytest.MonkeyPatch, columns: int, rows: int
) -> None:
    larger = ("columns = 14\nrows = 11", f"columns = {columns}\nrows = {rows}")
    survey = surveyed(plate_text, (*CHANGED, larger))
    every = simulate(survey, rng=3)
    monkeypatch.setattr(tiles, "SAMPLE", 80)
    whole = simulate(survey, rng=3)
    for count in (1, 40):
        assert_same(in_tiles(SimulatedRows(survey, rng=3), count), whole)
    # The light of the water from a table of other pixels is the same to a millionth.
    for part in ("in_phase", "quadrature"):
        name = f"truth_water_{part}"
        one, other = whole[name].values, every[name].values
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-6 * np.abs(other).max())


def test_files_are_simulated_by_rows(
    plate_text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    described = surveyed(plate_text, CHANGED)
    survey, whole, tiled = (tmp_path / n for n in ("s.toml", "w.nc", "t.nc"))
    survey.write_text(described.to_toml())
    said = []
    for output, words in ((whole, []), (tiled, ["--tile-rows", "4"])):
        assert main(["simulate", str(survey), "-o", str(output), *words]) == 0
        said.append(capsys.readouterr().out.split(": ", 1)[1])
    assert said[0] == said[1]
    assert_same(io.read_cube(tiled), io.read_cube(whole))
    for group in ("truth", "open_water"):
        assert cubes.group(io.read_cube(tiled), group) is not None
    words = ["simulate", str(survey), "-o", str(tiled), "--tile-rows", "0"]
    assert main([*words, "--overwrite"]) == 2
    assert "must be 1 or more" in capsys.readouterr().err


def test_scans_beyond_memory_are_refused_where_they_are_needed_whole(
    plate_text: str, tmp_path: Path
) -> None:
    huge = (("columns = 12\nrows = 6", "columns = 2600\nrows = 2000"),)
    survey = surveyed(plate_text, huge)
    for whole in (lambda: simulate(survey, rng=1), lambda: scene_light(survey)):
        with pytest.raises(SurveyError, match=r"1\.04e\+07 samples .* works by rows"):
            whole()
    with pytest.raises(SurveyError, match=r"photon.* needs the whole scan in memory"):
        simulate_file(survey, tmp_path / "a.nc", rng=1, model=PhotonModel())
    # Some rows of it are there at once.
    rows = SimulatedRows(survey, rng=1, model=DiffusionModel()).tile(0, 1)
    assert rows.sizes["column"] == 2600


def test_noise_that_is_not_announced_is_an_error() -> None:
    draws = [("standard_normal", 2), ("gamma", 1)]
    noise = RowNoise(np.random.default_rng(1), draws, shape=(4, 3), gamma=2.5)
    rng = np.random.default_rng(1)
    normal, gamma = rng.standard_normal((2, 4, 3)), rng.gamma(2.5, 0.4, size=(1, 4, 3))
    asked = noise.rows(1, 3)
    np.testing.assert_array_equal(asked.standard_normal((2, 2, 3)), normal[:, 1:3])
    with pytest.raises(RuntimeError, match=r"gamma\(3\) is asked for, not 2\.5"):
        asked.gamma(3.0, 0.4, size=(1, 2, 3))
    np.testing.assert_array_equal(asked.gamma(2.5, 0.4, size=(1, 2, 3)), gamma[:, 1:3])
    with pytest.raises(RuntimeError, match="draw 3 of a scan is standard_normal"):
        asked.standard_normal((2, 2, 3))
    with pytest.raises(RuntimeError, match="draw 1 of a scan is gamma"):
        noise.rows(0, 1).gamma(2.5, 0.4, size=(1, 1, 3))
