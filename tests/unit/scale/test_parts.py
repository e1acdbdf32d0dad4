"""Row ranges of a scan, joined, are the file that is made at once."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import xarray as xr

from amulor import io
from amulor.scale import parts, site_run
from amulor.scale.tasks import Done, Task

WHEN = "2026-05-04T12:30:00Z"


@pytest.fixture
def task(plate_text: str, tmp_path: Path) -> Task:
    survey = tmp_path / "plate.toml"
    small = plate_text.replace("columns = 12\nrows = 6", "columns = 3\nrows = 4")
    assert small != plate_text
    survey.write_text(small)
    folder = tmp_path / "scan"
    folder.mkdir()
    return Task(
        name="scan",
        file="",
        simulated_from=str(survey),
        seed=3,
        method="co-polarized",
        polarization="VV",
        interval=(0.8, 3.0),
        folder=str(folder),
        started=WHEN,
        tile_rows=2,
    )


def content(path: Path) -> xr.Dataset:
    """Return a cube without the lines that say when and how it was made."""
    return io.read_cube(path).assign_attrs(history="")


def test_parts_joined_are_the_whole_and_replace_an_old_file(task: Task) -> None:
    folder = Path(task.folder)
    samples, step, image, cloud = parts.chain(task)
    names = [each.name for each in (samples, step, image, cloud)]
    assert names == ["samples.nc", "target_signal.nc", "range_image.nc", "cloud.ply"]
    parts.whole(samples, folder / samples.name)
    path = folder / step.name
    path.write_bytes(b"of an earlier survey")
    parts.whole(step, path)
    whole = content(path)
    assert parts.parts_of(task, step.name) == [(0, 2), (2, 4)]
    for begin, end in ((0, 2), (2, 4)):
        parts.make_part(task, step.name, begin, end)
    # A part that exists is not computed again.
    (file,) = (step.folder / "00000002").glob("*.nc")
    before = file.stat().st_mtime_ns
    parts.make_part(task, step.name, 2, 4)
    assert file.stat().st_mtime_ns == before
    parts.whole(step, path)
    xr.testing.assert_identical(content(path), whole)
    parts.forget_parts(step)
    assert not (folder / "parts").exists()


@pytest.mark.parametrize("fault", ["", "the disk is full"])
def test_a_scan_goes_on_after_the_last_of_its_parts(task: Task, fault: str) -> None:
    samples, step, *_ = parts.chain(task)
    parts.whole(samples, Path(task.folder) / samples.name)
    orders: list[tuple[Any, ...]] = []
    waiting: list[Any] = []

    def submit(function: Any, _: Task, *words: object, **options: object) -> object:
        orders.append((function.__name__, *words))
        return SimpleNamespace(key=str(len(orders)))

    def answer(number: int, value: object) -> Done | None:
        waiting[number].result = lambda: value
        return spread.after(waiting[number], "")

    client = SimpleNamespace(submit=submit)
    spread = site_run._Spread(client, SimpleNamespace(add=waiting.append))
    spread.begin(task, [step.name])
    assert orders == [("is_made", step.name)]
    assert answer(0, False) is None
    rows = [("work_on_rows", step.name, 0, 2), ("work_on_rows", step.name, 2, 4)]
    assert orders[1:] == rows
    assert answer(2, fault) is None
    assert len(orders) == 3
    if fault:
        stopped = Done(name="scan", files={}, made=(), error=fault)
        assert answer(1, "") == stopped
        assert len(orders) == 3
        return
    assert answer(1, "") is None
    assert orders[3:] == [("work", step.name)]
    one = Done(name="scan", files={}, made=("a",), error="")
    assert answer(3, one) is None
    assert orders[4:] == [("work",)]
    last = Done(name="scan", files={"c": "d"}, made=("b",), error="")
    assert answer(4, last) == Done(
        name="scan", files={"c": "d"}, made=("a", "b"), error=""
    )


def test_a_file_of_three_parts_has_the_rows_of_all(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    written: list[tuple[int, str]] = []
    asked: list[int] = []

    @contextmanager
    def writer(path: Path, rows: int, *, overwrite: bool) -> Iterator[Any]:
        asked.append(rows)
        yield SimpleNamespace(put=lambda tile, at: written.append((at, tile)))

    @contextmanager
    def opened(step: Any, *, check_digest: bool) -> Iterator[Any]:
        assert check_digest
        yield SimpleNamespace(
            tiles=lambda begin, end: [(n, f"row {n}") for n in range(begin, end)]
        )

    monkeypatch.setattr(parts, "parts_of", lambda *_: [(0, 2), (2, 4), (4, 5)])
    monkeypatch.setattr(parts, "row_writer", writer)
    monkeypatch.setattr(parts, "_opened", opened)
    step: Any = SimpleNamespace(name="ranges.nc", task=None, folder=tmp_path)
    # Without the parts, all rows are computed.
    parts.whole(step, tmp_path / "ranges.nc")
    assert asked == [5]
    assert written == [(n, f"row {n}") for n in range(5)]
    written.clear()
    monkeypatch.setattr(
        parts, "_put", lambda to, first, file, step: to.put(file.parent.name, first)
    )
    for begin in (0, 2, 4):
        (tmp_path / f"{begin:08d}").mkdir()
        (tmp_path / f"{begin:08d}" / parts.ROWS).touch()
    parts.whole(step, tmp_path / "ranges.nc")
    assert asked == [5, 5]
    assert written == [(0, "00000000"), (2, "00000002"), (4, "00000004")]


@pytest.mark.parametrize(
    ("rows", "tile_rows", "expected"),
    [(100, 99, True), (100, 100, False), (100, None, False), (10**6, None, True)],
)
def test_large_files_are_split_but_for_a_cloud_in_one_file(
    monkeypatch: pytest.MonkeyPatch, rows: int, tile_rows: int | None, expected: bool
) -> None:
    names = ("samples.nc", "ranges.nc", "cloud.ply")
    steps = tuple(SimpleNamespace(name=name) for name in names)
    monkeypatch.setattr(parts, "chain", lambda task: steps)
    monkeypatch.setattr(parts, "_sizes", lambda step: SimpleNamespace(rows=rows))
    monkeypatch.setattr(parts.tiles, "samples_of_row", lambda sizes: 100)
    task: Any = SimpleNamespace(tile_rows=tile_rows)
    assert parts.splits(task) == (names[:2] if expected else ())
