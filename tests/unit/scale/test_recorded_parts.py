"""Parts of an import by rows: samples on disk, common properties, tiles, medians."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.typing import NDArray

from amulor import _progress
from amulor.errors import FormatError
from amulor.io import recordings
from amulor.io.recording_table import RecordingMap
from amulor.scale import recorded
from amulor.survey import Survey

ROWS, COLUMNS = 5, 3


@pytest.fixture(autouse=True)
def _small_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read two lines, or three samples, at once."""
    monkeypatch.setattr(recorded, "_LINES", 2)
    monkeypatch.setattr(recorded, "_SAMPLES", 3)


@pytest.fixture(scope="module")
def survey(plate: Survey) -> Survey:
    return plate.with_(
        {"scan.columns": COLUMNS, "scan.rows": ROWS, "scan.order": "serpentine"}
    )


def samples_of(count: int, **columns: Any) -> NDArray[np.void]:
    """Return samples on the disk; numbers that are not stated are not known."""
    part = np.zeros(count, dtype=recorded._SAMPLE)
    stated = {"signal": 1 + 2j, "frequency": 30e6, "pair": 0, "water": False}
    for name in part.dtype.names or ():
        part[name] = {**stated, **columns}.get(name, np.nan)
    return part


def known(
    folder: Path, part: NDArray[np.void], pairs: list[str], warmth: float | None = None
) -> recorded._Known:
    part.tofile(folder / "samples")
    return recorded._known(folder, pairs, warmth)


def described(folder: Path, **columns: str) -> RecordingMap:
    lines = [
        f'{name} = "{column}"'
        for name, column in {"in_phase": "x", "quadrature": "y", **columns}.items()
    ]
    path = folder / "map.toml"
    path.write_text("\n".join(["[columns]", *lines, "[constants]", "scale = 2.0"]))
    return RecordingMap.from_toml(path)


def test_samples_are_copied_with_the_number_of_their_polarization(
    tmp_path: Path, survey: Survey
) -> None:
    mapped = described(
        tmp_path, polarization="p", frequency="f", azimuth="a", elevation="e",
        row="r", column="c", mean="m", temperature="t", what="w",
    )  # fmt: skip
    path = tmp_path / "lines.csv"
    path.write_text(
        "x,y,p,f,a,e,r,c,m,t,w\n"
        "1,2,VH,30,90,45,4,3,7,20,open_water\n"
        "3,4,VV,40,180,-90,2,1,8,20.2,scan\n"
        "5,6,VH,50,0,0,0,0,9,,scan\n"
    )
    told: list[str] = []
    with _progress.listening(lambda step, share: told.append(step)):
        pairs = recorded._spilled(path, mapped, survey, tmp_path, None)
    assert pairs == ["VH", "VV"]
    assert told == ["reading, sample 0", "reading, sample 2"]
    found = np.fromfile(tmp_path / "samples", recorded._SAMPLE)
    factor = 2 * 2**0.5
    np.testing.assert_allclose(
        found["signal"], factor * np.array([1 - 2j, 3 - 4j, 5 - 6j]), rtol=1e-12
    )
    expected: dict[str, list[float]] = {
        "mean": [7, 8, 9],
        "frequency": [30, 40, 50],
        "azimuth": [np.pi / 2, np.pi, 0],
        "elevation": [np.pi / 4, -np.pi / 2, 0],
        "row": [4, 2, 0],
        "column": [3, 1, 0],
        "temperature": [20, 20.2, np.nan],
        "pair": [0, 1, 0],
        "water": [True, False, False],
    }
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=1e-12)


@pytest.mark.parametrize(
    ("degrees", "chosen", "refused"),
    [
        ([20, 20.5, 20.9], None, ""),
        ([20, 20.5, 21.2], None, "(20, 20.5, 21.2 degC)"),
        ([21.2, 20.5, 20], None, "(20, 20.5, 21.2 degC)"),
        ([10, 20, 30, 31], 20.4, ""),
        ([20, 30, 10, 10], 20.4, ""),
        ([10, 20, 30], 20.4, ""),
        ([10, 30, 20, 31], 29.6, ""),
        ([10, 20, 30], 24.0, "at 24 degC; there are 10, 20, 30"),
    ],
)
def test_temperatures_of_all_parts_decide_whether_one_must_be_chosen(
    tmp_path: Path,
    survey: Survey,
    degrees: list[float],
    chosen: float | None,
    refused: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(recorded, "_LINES", 3)
    mapped = described(tmp_path, polarization="p", temperature="t")
    path = tmp_path / "lines.csv"
    path.write_text("x,y,p,t\n" + "".join(f"1,1,VV,{t}\n" for t in degrees))
    if not refused:
        assert recorded._spilled(path, mapped, survey, tmp_path, chosen) == ["VV"]
        return
    with pytest.raises(FormatError) as caught:
        recorded._spilled(path, mapped, survey, tmp_path, chosen)
    assert refused in str(caught.value)


def test_channels_have_the_order_in_which_they_are_met(tmp_path: Path) -> None:
    part = samples_of(
        5,
        pair=[2, 2, 0, 3, 0],
        # Three readings of one frequency, in two blocks, and a lower one.
        frequency=[40e6, 30e6, 40e6, 40e6 + 3, 30e6],
    )
    shared = known(tmp_path, part, ["VV", "VH", "HV", "HH"])
    assert shared.pairs == ["HV", "VV", "HH"]
    assert shared.pair[[2, 0, 3]].tolist() == [0, 1, 2]
    assert shared.frequencies.tolist() == [30e6, 40e6 + 1]
    assert shared.values.tolist() == [30e6, 40e6, 40e6 + 3]
    assert shared.frequency(part).tolist() == [1, 0, 1, 1, 0]


def test_polarizations_of_one_block_are_met_in_its_order(tmp_path: Path) -> None:
    shared = known(tmp_path, samples_of(3, pair=[1, 2, 0]), ["VV", "VH", "HV"])
    assert shared.pairs == ["VH", "HV", "VV"]
    assert shared.pair.tolist() == [2, 0, 1]


def test_only_samples_at_the_chosen_temperature_count(tmp_path: Path) -> None:
    part = samples_of(
        5, temperature=[30, 20, 20.4, 30, np.nan], frequency=[9e6, 1e6, 1e6, 8e6, 7e6],
        pair=[1, 0, 0, 1, 1],
    )  # fmt: skip
    shared = known(tmp_path, part, ["VH", "VV"], 20.0)
    assert (shared.frequencies.tolist(), shared.pairs) == ([1e6], ["VH"])
    blocks = [block["temperature"].tolist() for block in shared.samples(tmp_path)]
    assert blocks == [[20, 20.4], []]
    everything = known(tmp_path, part, ["VH", "VV"])
    assert [len(block) for block in everything.samples(tmp_path)] == [3, 2]
    assert everything.pairs == ["VV", "VH"]


def test_without_samples_there_are_no_channels(tmp_path: Path) -> None:
    shared = known(tmp_path, samples_of(0), ["VV"])
    assert (shared.pairs, shared.frequencies.size) == ([], 0)
    assert not shared.any_scan


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({}, "scan, order"),
        ({"water": True, "mean": 1.0, "temperature": 1.0, "row": 1.0}, "order"),
        ({"water": [True, False, True, True]}, "scan, order"),
        ({"mean": [np.nan, 1, np.nan, np.nan]}, "scan, mean, order"),
        ({"mean": [np.nan, 1, np.nan, np.nan], "signal": [1, 0, 1, 1]}, "scan, order"),
        ({"temperature": [1, np.nan, np.nan, np.nan]}, "scan, warm, order"),
        ({"row": [1, np.nan, np.nan, np.nan]}, "scan, rows"),
        ({"azimuth": [1, np.nan, np.nan, np.nan]}, "scan, angles"),
        ({"azimuth": 1.0, "row": [np.nan, 1, np.nan, np.nan]}, "scan, rows"),
        ({"elevation": 1.0, "column": 1.0}, "scan, order"),
    ],
)
def test_quantities_of_a_recording_are_those_of_any_sample_of_the_scan(
    tmp_path: Path, columns: dict[str, Any], expected: str
) -> None:
    shared = known(tmp_path, samples_of(4, **columns), ["VV"])
    words = {"scan": shared.any_scan, "mean": shared.mean, "warm": shared.warm}
    found = [word for word, value in words.items() if value] + [shared.places]
    assert ", ".join(found) == expected


def test_properties_of_a_recording_begin_with_nothing() -> None:
    shared = recorded._Known(temperature=None)
    assert (shared.any_scan, shared.mean, shared.warm) == (False, False, False)
    assert (shared.pairs, shared.places) == ([], "order")
    assert (shared.pair.size, shared.values.size, shared.frequencies.size) == (0, 0, 0)


def sorted_samples(
    folder: Path,
    survey: Survey,
    part: NDArray[np.void],
    size: int,
    monkeypatch: pytest.MonkeyPatch,
) -> tuple[recordings.Recording, dict[str, Any]]:
    """Sort samples into tiles; return the recording, and what its shots are made of."""
    shots: dict[str, Any] = {}

    def shots_of(
        path: Path, samples: Any, channel: Any, survey: Any, mapped: Any, **named: Any
    ) -> str:
        shots.update(
            path=path, samples=samples, channel=channel, mapped=mapped, **named
        )
        return "shots"

    monkeypatch.setattr(recordings, "shots_of", shots_of)
    shared = known(folder, part, ["VH", "VV"])
    mapped: Any = "map"
    path = folder / "lines.csv"
    found = recorded._sorted(path, mapped, survey, folder, shared, size)
    assert (found.path, found.survey, found.described) == (path, survey, "map")
    assert found.frequencies is shared.frequencies
    assert (found.pairs, found.shots) == (shared.pairs, "shots")
    return found, shots


def places_in(folder: Path) -> dict[str, list[list[int]]]:
    """Return frequency, polarization, row and column of the samples of each tile."""
    return {
        path.name: np.fromfile(path, recorded._PLACED)["at"].tolist()
        for path in sorted(folder.glob("tile *"))
    }


def test_samples_are_sorted_into_a_file_for_each_tile(
    tmp_path: Path, survey: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = samples_of(
        7,
        signal=np.arange(1, 8),
        water=[False, False, False, True, True, True, False],
        row=[4, 0, 3, 0, 0, 0, 1],
        column=[0, 2, 1, 0, 0, 0, 1],
        pair=[1, 0, 1, 0, 1, 0, 0],
        frequency=[4e6, 3e6, 3e6, 4e6, 3e6, 3e6, 4e6],
    )
    _, shots = sorted_samples(tmp_path, survey, part, 2, monkeypatch)
    # Polarization VV, the second of the list, is met first.
    assert places_in(tmp_path) == {
        "tile 0": [[0, 1, 0, 2], [1, 1, 1, 1]],
        "tile 1": [[0, 0, 3, 1]],
        "tile 2": [[1, 0, 4, 0]],
    }
    tile = np.fromfile(tmp_path / "tile 0", recorded._PLACED)
    assert tile["sample"].tobytes() == part[[1, 6]].tobytes()
    assert not (tmp_path / "samples").exists()
    assert shots["samples"].signal.tolist() == [4, 5, 6]
    assert shots["samples"].water.tolist() == [True] * 3
    assert [each.tolist() for each in shots["channel"]] == [[1, 0, 0], [1, 0, 1]]
    assert [each.tolist() for each in shots["scanned"]] == [[0, 0, 1, 1], [0, 1, 0, 1]]
    assert shots["names"][0].tolist() == [3e6, 4e6]
    assert shots["names"][1] == ["VV", "VH"]


def test_samples_without_a_place_are_counted_on_from_part_to_part(
    tmp_path: Path, survey: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    sorted_samples(tmp_path, survey, samples_of(7), 4, monkeypatch)
    # Of a serpentine the second row goes back.
    assert places_in(tmp_path) == {
        "tile 0": [
            [0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 0, 2],
            [0, 0, 1, 2], [0, 0, 1, 1], [0, 0, 1, 0], [0, 0, 2, 0],
        ]
    }  # fmt: skip


def test_rows_are_divided_into_bands_that_end_with_the_scan(survey: Survey) -> None:
    assert list(recorded._bands(survey, 2)) == [(0, 2), (2, 4), (4, 5)]
    assert list(recorded._bands(survey, 9)) == [(0, 5)]


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ((0, 2), [0, 1, 2]),
        ((2, 4), [1, 2, 3, 4]),
        ((4, 5), [3, 4]),
        ((1, 2), [0, 1, 2]),
    ],
)
def test_a_band_has_the_samples_of_its_rows_and_their_neighbors(
    tmp_path: Path,
    survey: Survey,
    monkeypatch: pytest.MonkeyPatch,
    rows: tuple[int, int],
    expected: list[int],
) -> None:
    for tile in range(3):
        numbers = [row for row in (2 * tile + 1, 2 * tile) if row < ROWS]
        part = np.zeros(len(numbers), dtype=recorded._PLACED)
        part["sample"] = samples_of(len(numbers), signal=numbers)
        part["at"] = [[7, 8, row, 10 * row] for row in numbers]
        part.tofile(tmp_path / f"tile {tile}")
    monkeypatch.setattr(recordings, "gathered_band", lambda *words: words)
    recording: Any = SimpleNamespace(survey=survey, pairs=["VV", "VH"])
    found: Any = recorded._band(recording, tmp_path, 2, rows)
    assert (found[0], found[3]) == (recording, rows)
    assert sorted(found[1].signal.real.tolist()) == expected
    assert [axis.tolist() for axis in found[2]] == [
        [7] * len(expected),
        [8] * len(expected),
        found[1].signal.real.tolist(),
        (10 * found[1].signal.real).tolist(),
    ]
    assert found[1].polarization.tolist() == ["VV"] * len(expected)


def test_a_band_without_samples_is_empty(
    tmp_path: Path, survey: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recordings, "gathered_band", lambda *words: words)
    recording: Any = SimpleNamespace(survey=survey, pairs=["VV"])
    found: Any = recorded._band(recording, tmp_path, 2, (0, 2))
    assert found[1].signal.size == 0
    assert [axis.size for axis in found[2]] == [0] * 4


def test_a_typical_difference_is_the_median_of_all_rows_of_a_channel(
    tmp_path: Path, survey: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Two frequencies, one polarization, five rows of one pixel each.
    nearest = np.array([[9.0, 1.0, np.nan, 4.0, 2.0], np.full(5, np.nan)])

    def band(recording: Any, folder: Path, size: int, rows: tuple[int, int]) -> Any:
        assert (folder, size) == (tmp_path, 2)
        begin = max(rows[0] - 1, 0)
        near = nearest[:, None, begin : rows[1], None]
        return SimpleNamespace(
            nearest=near, inner=slice(rows[0] - begin, rows[1] - begin)
        )

    monkeypatch.setattr(recorded, "_band", band)
    recording: Any = SimpleNamespace(
        survey=survey, frequencies=np.array([3e6, 4e6]), pairs=["VV"]
    )
    found = recorded._typical(recording, tmp_path, 2)
    assert found.shape == (2, 1, 1, 1)
    np.testing.assert_array_equal(found.ravel(), [3.0, np.nan])


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 9])
def test_medians_of_files_are_those_of_sorted_numbers(
    tmp_path: Path, count: int
) -> None:
    values = np.array([3e-300, 5.0, 0.0, 5.0, 7e200, 5.0000001, 1e-3, 2.0, 4.0])[:count]
    values.tofile(tmp_path / "values")
    expected = np.median(values) if count else np.nan
    np.testing.assert_equal(recorded._median_of(tmp_path / "values"), expected)
    ranked = [recorded._ranked(tmp_path / "values", rank) for rank in range(count)]
    assert ranked == sorted(values)


@pytest.fixture
def stages(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Stand in for the stages of an import; note what they are called with."""
    called: dict[str, Any] = {"written": [], "bands": []}
    shared = recorded._Known(temperature=None, any_scan=True, mean=True)
    shared.pairs, shared.frequencies = ["VV", "VH"], np.array([1e6, 2e6, 3e6])
    called["shared"] = shared

    @contextmanager
    def row_writer(path: Path, rows: int, *, overwrite: bool) -> Iterator[Any]:
        called["file"] = (path, rows, overwrite)
        yield SimpleNamespace(
            put=lambda tile, row: called["written"].append((row, tile.sizes["row"]))
        )

    def spilled(*words: Any) -> list[str]:
        called["spilled"] = words
        called["folder"] = words[3]
        assert words[3].is_dir()
        return ["VV", "VH"]

    def known(folder: Path, pairs: list[str], temperature: float | None) -> Any:
        called["known"] = (pairs, temperature)
        return shared

    def of_size(*words: Any) -> str:
        called["size"] = words[-1]
        return "recording"

    def band(recording: str, folder: Path, size: int, rows: tuple[int, int]) -> Any:
        called["bands"].append((recording, size))
        return rows

    def cube_of(
        recording: str, rows: Any, typical: Any, *, mean: bool, temperature: bool
    ) -> xr.Dataset:
        assert (recording, typical) == ("recording", "typical")
        called["quantities"] = (mean, temperature)
        shape = (rows[1] - rows[0], COLUMNS)
        return xr.Dataset(
            {
                "in_phase": (("row", "column"), np.zeros(shape)),
                "open_water_in_phase": ("shot", np.zeros(2)),
            }
        )

    def marked(tile: xr.Dataset) -> dict[str, int]:
        lost = {"lost": 1} if "open_water_in_phase" in tile else {}
        return {"zero": tile.sizes["row"], **lost}

    for owner, stand_ins in (
        (recorded, {"row_writer": row_writer, "_spilled": spilled, "_known": known}),
        (recorded, {"_sorted": of_size, "_band": band}),
        (recorded, {"_typical": lambda *words: "typical"}),
        (recordings, {"cube_of": cube_of, "marked": marked}),
    ):
        for name, stand_in in stand_ins.items():
            monkeypatch.setattr(owner, name, stand_in)
    return called


def test_an_import_counts_the_flags_of_all_rows_and_of_shots_once(
    tmp_path: Path, survey: Survey, stages: dict[str, Any]
) -> None:
    told: list[tuple[str, float]] = []
    with _progress.listening(lambda step, share: told.append((step, share))):
        found = recorded.import_file(
            "lines.csv", "map", survey, tmp_path / "a.nc",
            rows=2, temperature=20.0, overwrite=True,
        )  # fmt: skip
    assert found == recorded.RecordedSummary(
        sizes={"row": 5, "column": 3, "shot": 2}, marked={"zero": 5, "lost": 1}
    )
    assert stages["file"] == (tmp_path / "a.nc", 5, True)
    folder = stages["folder"]
    assert stages["spilled"] == (Path("lines.csv"), "map", survey, folder, 20.0)
    assert (folder.parent, folder.name[:8]) == (tmp_path, ".amulor-")
    assert not folder.exists()
    assert stages["known"] == (["VV", "VH"], 20.0)
    assert stages["written"] == [(0, 2), (2, 2), (4, 1)]
    assert stages["bands"] == [("recording", 2)] * 3
    assert stages["quantities"] == (True, False)
    assert told == [("row 0 of 5", 0), ("row 2 of 5", 0.4), ("row 4 of 5", 0.8)]


@pytest.mark.parametrize(
    ("at_once", "expected"), [(53, 2), (54, 3), (17, 1), (18, 1), (36, 2)]
)
def test_a_tile_of_an_import_has_the_samples_that_fit_into_memory(
    tmp_path: Path,
    survey: Survey,
    stages: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    at_once: int,
    expected: int,
) -> None:
    # Three columns, three frequencies and two polarizations.
    monkeypatch.setattr(recorded.tiles, "SAMPLES_AT_ONCE", at_once)
    recorded.import_file(
        "a.csv", "map", survey, tmp_path / "a.nc"
    )  # fmt: skip
    assert stages["size"] == expected
    assert stages["file"][2] is False
    assert stages["spilled"][4] is None


def test_a_recording_of_open_water_only_is_refused(
    tmp_path: Path, survey: Survey, stages: dict[str, Any]
) -> None:
    stages["shared"].any_scan = False
    with pytest.raises(FormatError, match=r"lines.csv: holds open-water shots and no"):
        recorded.import_file(
            "lines.csv", "map", survey, tmp_path / "a.nc"
        )  # fmt: skip
    assert stages["written"] == []
