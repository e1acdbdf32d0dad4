"""Steps of a scan with stand-ins: what is called with what, and what is counted."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from amulor import _progress, pipeline, rejection
from amulor.cube import QualityFlag, schema, tiles
from amulor.errors import CubeError
from amulor.pipeline import Selection, TiledStep

PIXEL = ("row", "column")


def numbers(rows: int, columns: int = 2, **variables: Any) -> xr.Dataset:
    values = np.arange(float(rows * columns)).reshape(rows, columns)
    return xr.Dataset({"slant_range": (PIXEL, values), **variables})


class Rows:
    """Source of a few rows that is not in memory."""

    def __init__(self, cube: xr.Dataset) -> None:
        self.rows, self.columns = cube.sizes["row"], cube.sizes["column"]
        self.cube, self.head = cube, tiles.InMemory(cube).head

    def tile(self, begin: int, end: int) -> xr.Dataset:
        return self.cube.isel(row=slice(begin, end))


def told_by(work: Callable[[], object]) -> list[tuple[str, float]]:
    told: list[tuple[str, float]] = []
    with _progress.listening(lambda step, share: told.append((step, round(share, 9)))):
        work()
    return told


def step_of(whole: Any, **options: Any) -> TiledStep:
    return TiledStep(level="samples", whole=whole, fit=lambda source: whole, **options)


def test_a_step_runs_after_the_step_before_it() -> None:
    def named(name: str) -> Callable[[Any], Any]:
        def run(cube: Any) -> Any:
            _progress.tell(name, 1.0)
            return f"{name} of {cube}"

        return run

    first = step_of(named("first"))
    assert (first.halo, first.of, first.how) == (0, None, {})
    cube: Any = "cube"
    assert first(cube) == "first of cube"
    second = step_of(named("second"), of=first)
    assert second(cube) == "second of first of cube"
    assert told_by(lambda: first(cube)) == [("first", 1.0)]
    assert [step for step, _ in told_by(lambda: second(cube))] == ["first", "second"]


def test_a_rejection_is_recorded_with_its_options(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def method(cube: Any, **options: Any) -> Any:
        return cube, options

    method.fit = lambda source, **options: ("fit", source, options)
    monkeypatch.setattr(rejection, "load", {"ours": method}.get)
    step: Any = pipeline.reject_step("ours", interval=(1, 2))
    assert (step.level, step.halo, step.of) == ("samples", 0, None)
    assert step.how == {"step": "reject", "method": "ours", "interval": (1, 2)}
    assert step("cube") == ("cube", {"interval": (1, 2)})
    assert step.fit("source") == ("fit", "source", {"interval": (1, 2)})


def test_an_image_is_made_and_then_flagged(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[tuple[Any, ...]] = []

    def fitted(step: Any, source: Any, **options: Any) -> Any:
        calls.append((step, source, options))
        return "fitted"

    monkeypatch.setattr(
        pipeline, "fitted_range_image", lambda cube, **options: ((cube, options), "fit")
    )
    monkeypatch.setattr(
        pipeline, "_flagged", lambda image, *, fit=None: (("flagged", image), "limits")
    )
    monkeypatch.setattr(pipeline.tiles, "fit_on_sample", fitted)
    step: Any = pipeline.image_step(polarization="VV")
    assert (step.level, step.of.level) == ("target_signal", "target_signal")
    assert (step.halo, step.of.halo, step.of.of) == (8, 0, None)
    assert step.how == {"step": "image", "polarization": "VV"}
    assert step("cube") == ("flagged", ("cube", {"polarization": "VV"}))
    assert (step.fit("one"), step.of.fit("two")) == ("fitted", "fitted")
    assert calls == [
        (pipeline._flagged, "one", {"needs_span": False}),
        (pipeline.fitted_range_image, "two", {"polarization": "VV"}),
    ]


def test_outliers_are_flagged_after_edges(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline.imaging, "flag_mixed", lambda image: f"mixed {image}")
    monkeypatch.setattr(
        pipeline, "fitted_outliers", lambda image, fit: (f"outliers of {image}", fit)
    )
    image: Any = "image"
    assert pipeline._flagged(image) == ("outliers of mixed image", None)
    assert pipeline._flagged(image, fit=(2.0,)) == ("outliers of mixed image", (2.0,))
    told = told_by(lambda: pipeline._flagged(image))
    assert told == [("edges and outliers", 0.0)]


@pytest.fixture
def named_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Stand in for steps by their names and options."""
    monkeypatch.setattr(
        pipeline, "reject_step", lambda *words, **o: ("reject", words, o)
    )
    monkeypatch.setattr(pipeline, "image_step", lambda **options: ("image", options))


@pytest.mark.usefixtures("named_steps")
@pytest.mark.parametrize("level", ["samples", "target_signal", "range_image"])
def test_steps_lead_from_a_level_to_the_range_image(level: str) -> None:
    found = pipeline.steps_from(
        level, method="ours", polarization="VH", interval=(1.0, 2.0), extra=3
    )
    expected: dict[str, Any] = {
        "target_signal": ("reject", ("ours",), {"interval": (1.0, 2.0), "extra": 3}),
        "range_image": ("image", {"interval": (1.0, 2.0), "polarization": "VH"}),
    }
    left = {"samples": 2, "target_signal": 1, "range_image": 0}[level]
    assert list(found.items()) == list(expected.items())[2 - left :]
    bare = pipeline.steps_from("target_signal")
    image = ("image", {"interval": None, "polarization": None})
    assert bare == {"range_image": image}


@pytest.mark.usefixtures("named_steps")
def test_samples_need_a_method() -> None:
    with pytest.raises(
        CubeError, match=r"^samples become a range image by a rejection method only$"
    ):
        pipeline.steps_from("samples", polarization="VV")


def test_a_run_passes_a_cube_from_step_to_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Any] = []

    def step(name: str, cube: xr.Dataset) -> xr.Dataset:
        _progress.tell(name, 0.5)
        return cube.assign_attrs(steps=cube.attrs.get("steps", "") + name)

    def steps_from(level: str, **options: Any) -> Any:
        asked.append((level, options))
        return {name: partial(step, name) for name in "abc"}

    monkeypatch.setattr(pipeline, "steps_from", steps_from)
    cube = xr.Dataset(attrs={"level": "samples"})
    options: dict[str, Any] = {
        "method": "ours", "polarization": "VH", "interval": (1.0, 2.0), "extra": 3,
    }  # fmt: skip
    assert pipeline.run(cube, **options).attrs["steps"] == "abc"
    assert [name for name, _ in told_by(lambda: pipeline.run(cube))] == ["a", "b", "c"]
    pipeline.run(xr.Dataset())
    nothing = dict.fromkeys(("method", "polarization", "interval"))
    assert asked == [("samples", options), ("samples", nothing), ("", nothing)]


def test_a_range_image_is_checked_and_returned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline.cubes, "checked", lambda cube, level: (cube, level))
    image = xr.Dataset(attrs={"level": "range_image"})
    assert pipeline.run(image) == (image, "range_image")


@pytest.mark.parametrize(
    ("few", "halo", "expected"),
    [
        (5, 0, 5),
        (5, 1, 5),
        (5, 2, 10),
        (40, 8, 40),
        (32, 8, 32),
        (31, 8, 62),
        (1, 8, 32),
    ],
)
def test_a_tile_has_rows_for_four_halos(
    monkeypatch: pytest.MonkeyPatch, few: int, halo: int, expected: int
) -> None:
    monkeypatch.setattr(pipeline, "tile_rows", lambda source: few)
    step = step_of(None, halo=halo)
    source: Any = None
    assert pipeline.window(step, source) == expected
    assert pipeline.window(step, source, 3) == 3


@pytest.mark.parametrize(("rows", "size"), [(1, 1), (2, 2), (None, 3)])
def test_a_step_by_rows_is_fitted_once(
    monkeypatch: pytest.MonkeyPatch, rows: int | None, size: int
) -> None:
    monkeypatch.setattr(pipeline, "tile_rows", lambda source: 3)
    fitted: list[Any] = []

    def fit(source: Any) -> Any:
        fitted.append(source)
        return lambda tile, first: tile.assign_attrs(first=first)

    source: Any = Rows(numbers(5))
    step = TiledStep(level="samples", whole=lambda cube: cube, fit=fit)
    made: list[tuple[int, xr.Dataset]] = []
    told = told_by(lambda: made.extend(pipeline.run_step(step, source, rows=rows)))
    assert fitted == [source]
    begins = list(range(0, 5, size))
    assert [begin for begin, _ in made] == begins
    for begin, tile in made:
        assert tile["slant_range"].values[0, 0] == 2 * begin
        assert tile.attrs["first"] == begin
    assert told == [
        ("scan-wide statistics", 0.0),
        *[(f"row {begin} of 5", begin / 5) for begin in begins],
    ]


def test_a_step_after_another_sees_rows_around_its_own() -> None:
    seen: list[tuple[int, int]] = []

    def fit(name: str, source: Any) -> Any:
        assert source.head.attrs == ({} if name == "one" else {"one": 4})

        def treat(tile: xr.Dataset, first: int) -> xr.Dataset:
            seen.append((first, tile.sizes["row"]))
            return tile.assign_attrs({name: source.rows})

        return treat

    first = TiledStep(level="", whole=lambda cube: cube, fit=partial(fit, "one"))
    second = TiledStep(
        level="", whole=lambda cube: cube, fit=partial(fit, "two"), halo=1, of=first
    )
    source: Any = Rows(numbers(4))
    made = [tile for _, tile in pipeline.run_step(second, source, rows=2)]
    assert [tile["slant_range"].values[:, 0].tolist() for tile in made] == [
        [0, 2], [4, 6],
    ]  # fmt: skip
    assert made[1].attrs == {"one": 4, "two": 4}
    # The second step takes 0 to 2 and 1 to 3, of which the first computes each once.
    assert seen == [(0, 1), (0, 2), (2, 1), (0, 3), (3, 1), (1, 3)]


def test_a_file_is_opened_by_rows_if_it_is_large_or_rows_are_stated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[tuple[Any, ...]] = []

    @contextmanager
    def open_rows(path: str) -> Iterator[Any]:
        yield SimpleNamespace(tile=lambda begin, end: (path, begin, end))

    def checked(cube: Any, level: str, *, name: str) -> Any:
        calls.append((cube, level, name))
        return cube

    monkeypatch.setattr(pipeline, "open_rows", open_rows)
    monkeypatch.setattr(pipeline, "is_large", lambda path: path == "large.nc")
    monkeypatch.setattr(pipeline.io, "read_cube", lambda path: f"all of {path}")
    monkeypatch.setattr(pipeline.cubes, "checked", checked)
    monkeypatch.setattr(pipeline.cubes, "check", checked)
    for path, rows, whole in (
        ("small.nc", None, True), ("small.nc", 4, False), ("large.nc", None, False)
    ):  # fmt: skip
        with pipeline.opened(path, rows, level="samples") as source:
            assert isinstance(source, tiles.InMemory) == whole
        content = f"all of {path}" if whole else (path, 0, 1)
        assert calls.pop() == (content, "samples", path)


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Note what is written to which file."""
    listed: list[Any] = []

    @contextmanager
    def row_writer(path: Any, rows: int, *, overwrite: bool) -> Iterator[Any]:
        listed.append((path, rows, overwrite))
        yield SimpleNamespace(
            put=lambda tile, row: listed.append((row, tile.sizes["row"]))
        )

    monkeypatch.setattr(pipeline, "row_writer", row_writer)
    return listed


def flagged(values: Any, flags: Any, name: str) -> xr.Dataset:
    attributes = schema.flag_attributes()
    return xr.Dataset(
        {
            name: (PIXEL, np.array(values)),
            "quality_flag": (PIXEL, np.array(flags, np.int16), attributes),
        },
        attrs={"number": len(values)},
    )


@pytest.mark.parametrize("name", ["in_phase", "slant_range"])
def test_a_summary_counts_the_pixels_of_all_tiles(
    monkeypatch: pytest.MonkeyPatch, written: list[Any], name: str
) -> None:
    nan = np.nan
    made = [
        (0, flagged([[1, nan], [3, 4]], [[0, 64], [64, 0]], name)),
        (2, flagged([[nan, 6]], [[64 | 128, 128]], name)),
    ]
    asked: list[Any] = []

    def run_step(step: Any, source: Any, *, rows: int | None) -> Any:
        asked.append((step, source, rows))
        return iter(made)

    monkeypatch.setattr(pipeline, "run_step", run_step)
    source: Any = SimpleNamespace(rows=3)
    step: Any = "step"
    found = pipeline._written(step, source, "a.nc", 2, overwrite=True)
    assert asked == [(step, source, 2)]
    assert written == [("a.nc", 3, True), (0, 2), (2, 1)]
    assert (found.count, found.usable, found.flagged, found.doubtful) == (6, 4, 4, 2)
    attributes = schema.flag_attributes()
    names = dict(zip(attributes["flag_masks"].tolist(),
                     attributes["flag_meanings"].split(), strict=True))  # fmt: skip
    assert found.flags == {names[64]: 3, names[128]: 2}
    assert (found.whole, found.comparison) == (None, None)
    assert found.head.attrs == {"number": 2}
    assert not found.head.variables
    # In one piece, the result itself is kept.
    del made[1]
    source.rows = 2
    found = pipeline._written(step, source, "a.nc", None, overwrite=False)
    assert found.whole is made[0][1]


@pytest.fixture
def rejected(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Stand in for files and methods; note what a rejection is called with."""
    called: dict[str, Any] = {"cube": tiles.InMemory(numbers(3))}
    summary = pipeline.Summary(
        head=xr.Dataset(),
        count=0,
        usable=0,
        flagged=0,
        doubtful=0,
        flags={},
        whole=None,
    )

    @contextmanager
    def opened(path: Any, rows: int | None, *, level: str) -> Iterator[Any]:
        called["opened"] = (path, rows, level)
        yield called["cube"]

    def write(step: Any, cube: Any, output: Any, rows: Any, *, overwrite: bool) -> Any:
        _progress.tell("writing", 0.5)
        called["written"] = (step, cube, output, rows, overwrite)
        return summary

    def compare(cube: Any, *, interval: Any) -> str:
        _progress.tell("comparing", 1.0)
        called["compared"] = (cube, interval)
        return "comparison"

    stand_ins: dict[Any, dict[str, Any]] = {
        pipeline: {
            "opened": opened,
            "_written": write,
            "reject_step": lambda method, **options: (method, options),
        },
        pipeline.io: {"read_cube": lambda path: f"shots of {path}"},
        rejection: {
            "with_open_water": lambda cube, reference: cube.assign_attrs(of=reference),
            "load": lambda name: SimpleNamespace(
                options=["interval", *(["comparison"] if name == "auto" else [])]
            ),
            "compare": compare,
        },
    }
    for owner, names in stand_ins.items():
        for name, stand_in in names.items():
            monkeypatch.setattr(owner, name, stand_in)
    return called


def test_a_file_is_rejected_by_one_method(rejected: dict[str, Any]) -> None:
    found = pipeline.reject_file("a.nc", "b.nc", "ours", interval=(1, 2))
    assert rejected["opened"] == ("a.nc", None, "samples")
    step = ("ours", {"interval": (1, 2)})
    assert rejected["written"] == (step, rejected["cube"], "b.nc", None, False)
    assert "compared" not in rejected
    assert found.comparison is None
    pipeline.reject_file("a.nc", "b.nc", "ours", rows=4, overwrite=True)
    assert rejected["opened"] == ("a.nc", 4, "samples")
    assert rejected["written"][3:] == (4, True)


def test_shots_of_another_file_join_the_cube_or_its_rows(
    rejected: dict[str, Any],
) -> None:
    pipeline.reject_file("a.nc", "b.nc", "ours", open_water="c.nc")
    cube = rejected["written"][1]
    assert isinstance(cube, tiles.InMemory)
    assert cube.cube.attrs["of"] == "shots of c.nc"
    rejected["cube"] = Rows(numbers(3))
    pipeline.reject_file("a.nc", "b.nc", "ours", open_water="c.nc")
    cube = rejected["written"][1]
    assert isinstance(cube, tiles.Changed)
    assert cube.tile(1, 2).attrs["of"] == "shots of c.nc"
    assert cube.tile(1, 2)["slant_range"].values.tolist() == [[2, 3]]


def test_methods_are_compared_before_the_best_one_is_used(
    rejected: dict[str, Any],
) -> None:
    found = pipeline.reject_file("a.nc", "b.nc", "auto", interval=(1, 2))
    compared, interval = rejected["compared"]
    assert compared is rejected["cube"].cube
    assert interval == (1, 2)
    options = {"interval": (1, 2), "comparison": "comparison"}
    assert rejected["written"][0] == ("auto", options)
    assert found.comparison == "comparison"
    told = told_by(lambda: pipeline.reject_file("a.nc", "b.nc", "auto"))
    assert told == [("comparing", 0.6), ("writing", 0.8)]
    told = told_by(lambda: pipeline.reject_file("a.nc", "b.nc", "ours"))
    assert told == [("writing", 0.5)]
    # By rows, they are compared on a sample without the truth.
    truth = {"truth_target": (PIXEL, np.zeros((3, 2)))}
    rejected["cube"] = Rows(numbers(3, 2, **truth))
    pipeline.reject_file("a.nc", "b.nc", "auto", rows=2)
    compared, interval = rejected["compared"]
    assert (set(compared.data_vars), interval) == ({"slant_range"}, None)


def test_a_step_runs_from_file_to_file(rejected: dict[str, Any]) -> None:
    step = step_of(None)
    pipeline.run_file(step, "a.nc", "b.nc")
    assert rejected["opened"] == ("a.nc", None, "samples")
    assert rejected["written"] == (step, rejected["cube"], "b.nc", None, False)
    pipeline.image_file("a.nc", "b.nc", rows=3, overwrite=True, polarization="VV")
    assert rejected["opened"] == ("a.nc", 3, "target_signal")
    step, _, *rest = rejected["written"]
    assert step.how == {"step": "image", "polarization": "VV"}
    assert rest == ["b.nc", 3, True]
    pipeline.image_file("a.nc", "b.nc")
    assert rejected["written"][3:] == (None, False)


MISSING, NO_TARGET = QualityFlag.MISSING, QualityFlag.NO_TARGET
FLAGS = np.array(
    [[0, MISSING], [QualityFlag.MIXED, 0], [QualityFlag.OUTLIER, NO_TARGET],
     [QualityFlag.RELATIVE, 0], [0, QualityFlag.CORNER]]
)  # fmt: skip


def image() -> xr.Dataset:
    sigma = np.array([[1, 1], [1, 5], [1, 1], [1, 1], [9, 1]]) * 1e-3
    return numbers(
        5,
        quality_flag=(PIXEL, FLAGS.astype(np.int16), schema.flag_attributes()),
        slant_range_uncertainty=(PIXEL, sigma),
    )


@pytest.mark.parametrize(
    ("selection", "points", "counts"),
    [
        (Selection(), 8, {}),
        (Selection(good_only=True), 4, {"doubtful": 4}),
        (Selection(mixed=True), 6, {"mixed or outlying": 2}),
        (Selection(largest_uncertainty=4e-3), 6, {"more uncertain than 4 mm": 2}),
        (Selection(largest_uncertainty=1.0), 8, {"more uncertain than 1000 mm": 0}),
    ],
)
@pytest.mark.parametrize("size", [2, 5])
def test_points_and_reasons_of_all_tiles_are_counted(
    monkeypatch: pytest.MonkeyPatch,
    selection: Selection,
    points: int,
    counts: dict[str, int],
    size: int,
) -> None:
    told: list[Any] = []
    monkeypatch.setattr(pipeline, "tell", lambda *words: told.append(words))
    source: Any = Rows(image())
    found, reasons = pipeline._counted(source, selection, size)
    assert found.points == points
    assert reasons == counts
    assert found.error_unknown != ""  # of the pixel whose range is relative
    begins = range(0, 5, size)
    assert told == [(f"counting, row {n} of 5", n / 5) for n in begins]


def test_doubtful_points_are_those_that_stay() -> None:
    source: Any = Rows(image())
    doubtful = int((FLAGS & int(pipeline.DOUBTFUL) != 0).sum()) - int(
        (FLAGS & int(pipeline.DOUBTFUL) & int(pipeline.UNUSABLE) != 0).sum()
    )
    assert pipeline._counted(source, Selection(), 2)[0].doubtful == doubtful > 0
    assert pipeline._counted(source, Selection(good_only=True), 2)[0].doubtful == 0


@pytest.fixture
def cloud(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """Stand in for a file with an image; note the parts of its cloud."""
    called: dict[str, Any] = {"tiles": [], "source": Rows(image())}

    @contextmanager
    def open_rows(path: Any) -> Iterator[Any]:
        called["opened"] = path
        yield called["source"]

    def point_cloud(tile: xr.Dataset, *, frame: Any, covariance: bool) -> xr.Dataset:
        called["options"] = (frame, covariance)
        called["tiles"].append(tile)
        rows = np.arange(tile.sizes["row"], dtype=np.int32)
        return xr.Dataset({"row": ("point", rows, {"units": "1"})})

    def write(parts: Any, points: int, output: Any, **options: Any) -> None:
        called["parts"] = [part["row"] for part in parts()]
        called["written"] = (points, output, options)

    monkeypatch.setattr(pipeline, "open_rows", open_rows)
    monkeypatch.setattr(pipeline.cubes, "checked", lambda *words: called.update(
        checked=words))  # fmt: skip
    monkeypatch.setattr(pipeline, "tile_rows", lambda source: 3)
    monkeypatch.setattr(pipeline.imaging, "point_cloud", point_cloud)
    monkeypatch.setattr(pipeline.io, "write_cloud_parts", write)
    return called


def test_a_cloud_has_the_rows_of_the_scan(cloud: dict[str, Any]) -> None:
    found = pipeline.cloud_file("a.nc", "b.ply", rows=2)
    assert found.points == 8
    assert [part.values.tolist() for part in cloud["parts"]] == [[0, 1], [2, 3], [4]]
    assert {part.dtype for part in cloud["parts"]} == {np.dtype(np.int32)}
    assert cloud["parts"][1].attrs == {"units": "1"}
    options = {"shape": (5, 2), "slim": False, "overwrite": False}
    assert cloud["written"] == (8, "b.ply", options)
    assert cloud["options"] == (None, False)
    level = cloud["checked"]
    assert (level[0].sizes["row"], level[1]) == (1, "range_image")


def test_a_selection_leaves_pixels_out_of_a_cloud(cloud: dict[str, Any]) -> None:
    frame: Any = "frame"
    found = pipeline.cloud_file(
        "a.nc", Path("b.MCAP"), frame=frame, selection=Selection(mixed=True), rows=5,
        slim=True, overwrite=True,
    )  # fmt: skip
    assert found.points == 6
    # Covariances are for files that hold them.
    assert cloud["options"] == ("frame", True)
    (tile,) = cloud["tiles"]
    assert np.isnan(tile["slant_range"].values[[1, 2], 0]).all()
    assert int(tile["slant_range"].isnull().sum()) == 2
    assert "left out: 2 mixed or outlying" in tile.attrs["history"]
    options = {"shape": (5, 2), "slim": True, "overwrite": True}
    assert cloud["written"] == (6, Path("b.MCAP"), options)


@pytest.mark.parametrize(("pixels", "size"), [(6, 3), (4, 2), (5, 2), (1, 1), (99, 3)])
def test_parts_of_a_cloud_have_a_largest_number_of_pixels(
    monkeypatch: pytest.MonkeyPatch, cloud: dict[str, Any], pixels: int, size: int
) -> None:
    monkeypatch.setattr(pipeline, "_PIXELS", pixels)
    pipeline.cloud_file("a.nc", "b.ply")
    assert [tile.sizes["row"] for tile in cloud["tiles"]] == [
        min(size, 5 - row) for row in range(0, 5, size)
    ]
