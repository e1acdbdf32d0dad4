"""Files of a scan in row ranges: which steps, which rows, how they are joined."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import h5py
import pytest

from amulor.errors import CubeError
from amulor.scale import parts
from amulor.scale.tasks import Task


def task_in(folder: Path, **changed: Any) -> Task:
    stated: dict[str, Any] = {
        "name": "near", "file": str(folder / "near.nc"), "simulated_from": None,
        "seed": 5, "method": "open-water", "polarization": "VV",
        "interval": (0.5, 3.0), "folder": str(folder / "out"), "started": "",
    }  # fmt: skip
    return Task(**(stated | changed))


def source_of(rows: int, columns: int, tile: Any = None, **sizes: int) -> Any:
    return SimpleNamespace(
        rows=rows, columns=columns, tile=tile,
        head=SimpleNamespace(sizes=sizes, attrs={}),
    )  # fmt: skip


class Written:
    """Writer of a file, which notes what is put where."""

    def __init__(self) -> None:
        self.files: list[tuple[Any, ...]] = []
        self.tiles: list[tuple[Any, int]] = []

    @contextmanager
    def open(self, path: Path, rows: int, *, overwrite: bool) -> Iterator[Written]:
        self.files.append((path.name, rows, overwrite))
        path.write_text("written")
        yield self

    def put(self, tile: Any, row: int) -> None:
        self.tiles.append((tile, row))


@pytest.fixture
def writer(monkeypatch: pytest.MonkeyPatch) -> Written:
    written = Written()
    monkeypatch.setattr(parts, "row_writer", written.open)
    return written


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Stand in for files; a name gives the source of its rows."""
    files: dict[str, Any] = {"asked": []}

    @contextmanager
    def open_rows(path: Path, *, check_digest: bool = True) -> Iterator[Any]:
        files["asked"].append((path.name, check_digest))
        yield files[path.name]

    monkeypatch.setattr(parts, "open_rows", open_rows)
    return files


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Stand in for the steps of a scan; list what they are made for."""
    asked: list[Any] = []

    def steps_from(level: str, **options: Any) -> dict[str, Any]:
        asked.append({"level": level, **options})
        return {
            name: SimpleNamespace(how={"step": name}, halo=0)
            for name in ("target_signal", "range_image")
        }

    monkeypatch.setattr(parts, "steps_from", steps_from)
    return asked


def test_each_step_takes_the_file_of_the_step_before(
    tmp_path: Path, steps: list[Any], opened: dict[str, Any]
) -> None:
    opened["near.nc"] = source_of(2, 2)
    opened["near.nc"].head.attrs["level"] = "samples"
    out = tmp_path / "out"
    task = task_in(tmp_path)
    found = [(step.name, step.of, step.how) for step in parts.chain(task)]
    assert found == [
        ("target_signal.nc", tmp_path / "near.nc", {"step": "target_signal"}),
        ("range_image.nc", out / "target_signal.nc", {"step": "range_image"}),
        ("cloud.ply", out / "range_image.nc", {"step": "cloud"}),
    ]
    assert [step.tiled is None for step in parts.chain(task)] == [False, False, True]
    assert {step.task for step in parts.chain(task)} == {task}
    options = {
        "level": "samples", "method": "open-water", "polarization": "VV",
        "interval": (0.5, 3.0),
    }  # fmt: skip
    assert steps == [options] * 3
    assert opened["asked"] == [("near.nc", False)] * 3


def test_a_simulated_scan_begins_with_its_samples_and_a_line_has_no_cloud(
    tmp_path: Path, steps: list[Any]
) -> None:
    survey = tmp_path / "tank.toml"
    task = task_in(tmp_path, simulated_from=str(survey), moves=True)
    out = tmp_path / "out"
    found = [(step.name, step.of, step.how) for step in parts.chain(task)]
    assert found == [
        ("samples.nc", survey, {"step": "simulate", "seed": 5}),
        ("target_signal.nc", out / "samples.nc", {"step": "target_signal"}),
        ("range_image.nc", out / "target_signal.nc", {"step": "range_image"}),
    ]
    assert steps[0]["level"] == "samples"


def test_samples_without_a_method_are_refused(
    tmp_path: Path, steps: list[Any], opened: dict[str, Any]
) -> None:
    opened["near.nc"] = source_of(2, 2)
    for level, message in (
        ("samples", "scan 'near': the file holds samples, not a range image"),
        ("arrivals", "scan 'near': the file holds 'arrivals'; a site takes"),
    ):
        opened["near.nc"].head.attrs["level"] = level
        with pytest.raises(CubeError, match=message):
            parts.chain(task_in(tmp_path, method=None))
    assert steps == []


def step_in(folder: Path, name: str = "a.nc", **changed: Any) -> parts.Step:
    stated: dict[str, Any] = {
        "task": task_in(folder), "name": name, "of": folder / "of.nc",
        "how": {"step": "image"}, "tiled": SimpleNamespace(halo=0),
    }  # fmt: skip
    return parts.Step(**(stated | changed))


def test_row_ranges_of_a_file_have_a_folder_of_their_own(tmp_path: Path) -> None:
    step = step_in(tmp_path, "range_image.nc")
    assert step.folder == tmp_path / "out" / "parts" / "range_image"
    other = step_in(tmp_path, "samples.nc")
    for each in (step, other):
        (each.folder / "00000000").mkdir(parents=True)
    parts.forget_parts(step)
    assert not step.folder.exists()
    assert other.folder.exists()
    parts.forget_parts(other)
    assert [path.name for path in (tmp_path / "out").iterdir()] == []
    parts.forget_parts(other)


def test_rows_are_computed_in_tiles_that_end_with_the_range(tmp_path: Path) -> None:
    source = source_of(9, 4)
    step = step_in(tmp_path, task=task_in(tmp_path, tile_rows=2))
    rows: Any = parts._Rows(source, step, lambda begin, end: (begin, end))
    assert (rows.rows, rows.columns, rows.size) == (9, 4, 2)
    assert list(rows.tiles(1, 6)) == [(1, (1, 3)), (3, (3, 5)), (5, (5, 6))]
    assert list(rows.tiles(4, 4)) == []


def test_a_simulation_is_set_up_once_for_a_survey(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[tuple[str, int]] = []

    class Simulated:
        def __init__(self, survey: str, *, rng: int) -> None:
            made.append((survey, rng))
            self.rows, self.columns = 3, 2

        def tile(self, begin: int, end: int) -> str:
            return f"rows {begin} to {end}"

    monkeypatch.setattr(parts, "SimulatedRows", Simulated)
    monkeypatch.setattr(parts.Survey, "from_toml", lambda path: path.read_text())
    path = tmp_path / "tank.toml"
    task = task_in(tmp_path, simulated_from=str(path), tile_rows=2)
    step = step_in(tmp_path, "samples.nc", task=task, of=path, tiled=None)
    parts._simulated.cache_clear()
    for text in ("clear", "clear", "milky"):
        path.write_text(text)
        with parts._opened(step, check_digest=False) as rows:
            tiles = list(rows.tiles(0, 3))
        assert tiles == [(0, "rows 0 to 2"), (2, "rows 2 to 3")]
    assert made == [("clear", 5), ("milky", 5)]
    parts._simulated.cache_clear()


def test_a_step_is_fitted_once_for_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, opened: dict[str, Any]
) -> None:
    fitted: list[Any] = []

    def prepared(tiled: Any, source: Any, rows: int) -> str:
        fitted.append((tiled, source, rows))
        return f"fit {len(fitted)}"

    def made(fit: str, source: Any) -> Any:
        return SimpleNamespace(tile=lambda begin, end: (fit, begin, end))

    monkeypatch.setattr(parts, "Prepared", prepared)
    monkeypatch.setattr(parts, "Made", made)
    monkeypatch.setattr(parts, "tile_rows", lambda source: 7)
    parts._prepared.cache_clear()
    opened["of.nc"] = source_of(4, 3)
    (tmp_path / "of.nc").write_text("one")
    step = step_in(tmp_path)
    results = []
    for text in ("one", "one", "longer"):
        if text != "one":
            (tmp_path / "of.nc").write_text(text)
        with parts._opened(step, check_digest=True) as rows:
            results.append(rows.of(1, 2))
            assert (rows.rows, rows.columns) == (4, 3)
    assert results == [("fit 1", 1, 2), ("fit 1", 1, 2), ("fit 2", 1, 2)]
    assert fitted == [(step.tiled, opened["of.nc"], 7)] * 2
    other = step_in(
        tmp_path, how={"step": "reject"}, task=task_in(tmp_path, tile_rows=2)
    )
    with parts._opened(other, check_digest=False) as rows:
        assert rows.of(0, 1) == ("fit 3", 0, 1)
    assert fitted[2][2] == 2
    assert opened["asked"] == [("of.nc", True)] * 3 + [("of.nc", False)]
    parts._prepared.cache_clear()


def test_the_size_of_a_simulated_scan_is_that_of_its_survey(
    tmp_path: Path, plate_text: str, opened: dict[str, Any]
) -> None:
    path = tmp_path / "plate.toml"
    path.write_text(plate_text.replace('["39 MHz"]', '["3 MHz", "9 MHz", "39 MHz"]'))
    sizes = parts._sizes(step_in(tmp_path, of=path, how={"step": "simulate"}))
    assert (sizes.rows, sizes.columns) == (6, 12)
    assert sizes.head.sizes == {"modulation_frequency": 3, "polarization": 2}
    assert parts.tiles.samples_of_row(sizes) == 12 * 3 * 2
    opened["of.nc"] = source_of(4, 3)
    assert parts._sizes(step_in(tmp_path)) is opened["of.nc"]
    assert opened["asked"] == [("of.nc", False)]


@pytest.mark.parametrize("kind", [CubeError, OSError, ValueError])
@pytest.mark.parametrize("name", ["chain", "_sizes"])
def test_a_scan_that_cannot_be_read_is_not_divided(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: type[Exception], name: str
) -> None:
    def refuse(*words: object) -> None:
        raise kind("unreadable")

    monkeypatch.setattr(parts, "chain", lambda task: (step_in(tmp_path),))
    monkeypatch.setattr(parts, name, refuse)
    assert parts.splits(task_in(tmp_path)) == ()


def test_a_scan_is_divided_by_the_bytes_of_a_variable(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        parts, "chain", lambda task: (step_in(tmp_path), step_in(tmp_path, "cloud.ply"))
    )
    # 8 B x 5 rows x 3 columns x 2 frequencies.
    monkeypatch.setattr(
        parts, "_sizes", lambda step: source_of(5, 3, modulation_frequency=2)
    )
    for limit, expected in (("239", ("a.nc",)), ("240", ())):
        monkeypatch.setenv("AMULOR_LARGE", limit)
        assert parts.splits(task_in(tmp_path)) == expected


def test_a_range_has_rows_for_a_large_variable_or_a_tile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = task_in(tmp_path)
    step = step_in(tmp_path, task=task)
    monkeypatch.setattr(
        parts, "chain", lambda task: (step_in(tmp_path, "b.nc", tiled=None), step)
    )
    source = source_of(11, 3, modulation_frequency=2)
    monkeypatch.setattr(parts, "_sizes", lambda step: source)
    monkeypatch.setattr(parts, "window", lambda tiled, source, rows: rows or 2)
    # A tile of two rows has 8 B x 2 x 6 samples.
    for tiles, rows in ((2, 4), (1.4, 2), (1.6, 4), (0.2, 2), (9, 11)):
        monkeypatch.setattr(parts.tiles, "LARGE", tiles * 96)
        found = parts.parts_of(task, "a.nc")
        assert found == [(row, min(row + rows, 11)) for row in range(0, 11, rows)]
    by_hand = task_in(tmp_path, tile_rows=4)
    steps = (step_in(tmp_path, task=by_hand), step_in(tmp_path, "b.nc", task=by_hand))
    monkeypatch.setattr(parts, "chain", lambda task: steps)
    assert parts.parts_of(by_hand, "a.nc") == [(0, 4), (4, 8), (8, 11)]


def test_a_step_is_found_by_the_name_of_its_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = (step_in(tmp_path, "a.nc"), step_in(tmp_path, "b.nc"))
    monkeypatch.setattr(parts, "chain", lambda task: steps)
    assert parts._step(task_in(tmp_path), "b.nc") is steps[1]


def test_a_tile_of_a_simulation_has_the_rows_of_a_block(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = source_of(11, 3)
    monkeypatch.setattr(parts, "tile_rows", lambda source: 5)
    monkeypatch.setattr(parts, "window", lambda *words: words)
    assert parts._size(step_in(tmp_path, tiled=None), source) == 5
    by_hand = step_in(tmp_path, tiled=None, task=task_in(tmp_path, tile_rows=2))
    assert parts._size(by_hand, source) == 2
    step: Any = step_in(tmp_path, task=task_in(tmp_path, tile_rows=2))
    assert parts._size(step, source) == (step.tiled, source, 2)


def test_a_range_is_written_from_its_first_row_and_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: Written
) -> None:
    checks: list[bool] = []

    @contextmanager
    def rows_of(step: parts.Step, *, check_digest: bool) -> Iterator[Any]:
        checks.append(check_digest)
        yield SimpleNamespace(
            tiles=lambda begin, end: [(row, f"row {row}") for row in range(begin, end)]
        )

    monkeypatch.setattr(parts, "_opened", rows_of)
    step = step_in(tmp_path, how={"step": "image", "n": 1})
    monkeypatch.setattr(parts, "chain", lambda task: (step,))
    (tmp_path / "of.nc").write_text("source")
    task = task_in(tmp_path, tile_rows=9)
    for _ in range(2):
        parts.make_part(task, "a.nc", 4, 7)
    assert checks == [False]
    assert writer.files == [("rows.nc", 3, True)]
    assert writer.tiles == [("row 4", 0), ("row 5", 1), ("row 6", 2)]
    folder = tmp_path / "out" / "parts" / "a" / "00000004"
    assert (folder / "rows.nc").read_text() == "written"
    record = json.loads((folder / "steps.json").read_text())["rows.nc"]["made_of"]
    how = {"step": "image", "n": 1, "rows": [4, 7], "tile_rows": 9}
    time = (tmp_path / "of.nc").stat().st_mtime_ns
    assert json.loads(record)["how"] == how
    assert json.loads(record)["of"] == f"6 B, {time} ns"
    # Rows of a changed file are made again.
    (tmp_path / "of.nc").write_text("changed")
    parts.make_part(task, "a.nc", 4, 7)
    assert checks == [False, False]


def test_a_cloud_replaces_an_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[Any] = []
    monkeypatch.setattr(
        parts, "cloud_file", lambda *words, **named: calls.append((words, named))
    )
    task = task_in(tmp_path, tile_rows=3)
    step = step_in(tmp_path, "cloud.ply", task=task, tiled=None)
    parts.whole(step, tmp_path / "cloud.ply")
    assert calls == [
        (
            (tmp_path / "of.nc", tmp_path / "cloud.ply"),
            {"rows": 3, "overwrite": True},
        )
    ]


def test_a_file_replaces_an_old_one_and_is_joined_of_all_ranges_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writer: Written
) -> None:
    step = step_in(tmp_path)
    monkeypatch.setattr(parts, "parts_of", lambda task, name: [(0, 2), (2, 3)])
    put: list[Any] = []
    monkeypatch.setattr(
        parts, "_put", lambda to, first, file, step: put.append((first, file))
    )

    @contextmanager
    def rows_of(step: parts.Step, *, check_digest: bool) -> Iterator[Any]:
        assert check_digest
        yield SimpleNamespace(tiles=lambda begin, end: [(begin, "all"), (2, str(end))])

    monkeypatch.setattr(parts, "_opened", rows_of)
    files = [step.folder / name / "rows.nc" for name in ("00000000", "00000002")]
    for file in files:
        parts.whole(step, tmp_path / "a.nc")
        assert put == []
        assert writer.tiles == [("all", 0), ("3", 2)]
        writer.tiles.clear()
        file.parent.mkdir(parents=True)
        file.touch()
    parts.whole(step, tmp_path / "a.nc")
    assert put == [(0, files[0]), (2, files[1])]
    assert writer.files == [("a.nc", 3, True)] * 3
    assert writer.tiles == []


def test_a_range_is_copied_in_tiles_with_variables_in_the_order_of_its_file(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    writer: Written,
    opened: dict[str, Any],
) -> None:
    class Tile(dict[str, str]):
        @property
        def variables(self) -> Any:
            return self.keys()

        def __getitem__(self, names: Any) -> Any:
            return names, dict.__getitem__(self, "rows")

    def tile(begin: int, end: int) -> Tile:
        return Tile(b=0, open_water_x=0, a=0, rows=f"{begin} to {end}")

    monkeypatch.setattr(
        parts, "_in_order", lambda file: ["a", "b", "c", "open_water_x"]
    )
    monkeypatch.setattr(parts, "tile_rows", lambda source: source.rows - 3)
    opened["rows.nc"] = source_of(5, 2, tile)
    opened["of.nc"] = source_of(6, 2)
    for task, last in ((task_in(tmp_path, tile_rows=2), [5]), (task_in(tmp_path), [])):
        to: Any = writer
        parts._put(to, 7, tmp_path / "rows.nc", step_in(tmp_path, task=task))
        size = 2 if last else 3
        order = ["a", "b", "open_water_x"]
        assert writer.tiles == [
            ((order, f"{row} to {min(row + size, 5)}"), 7 + row)
            for row in range(0, 5, size)
        ]
        writer.tiles.clear()


def test_variables_of_groups_follow_those_of_the_file(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.nc", "w", track_order=True) as file:
        for name in ("slant_range", "azimuth"):
            file[name] = 0
        for group, name in (("truth", "target"), ("open_water", "in_phase")):
            file.create_group(group, track_order=True)[name] = 0
        file["open_water"]["quadrature"] = 0
    names = parts._in_order(tmp_path / "a.nc")
    assert names[4:] == [
        "open_water_in_phase", "open_water_quadrature", "truth_target",
    ]  # fmt: skip
    assert set(names[:4]) == {"slant_range", "azimuth", "truth", "open_water"}
