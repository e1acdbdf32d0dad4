"""Commands that process cubes: what they ask for, and how they sum up the result."""

from __future__ import annotations

import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

from amulor import handover, imaging, io, pipeline, rejection, samples
from amulor.cli import _arguments, info, main, presets, reject
from amulor.cli import archive as archive_command
from amulor.cli import export as export_command
from amulor.cli import image as image_command
from amulor.cli import report as report_command
from amulor.errors import CubeError
from amulor.imaging.moving import MovingFrame
from amulor.rejection.compare import Row

pytestmark = pytest.mark.usefixtures("next_commands")

INPUTS = ("a.nc", "b.nc", "p.toml", "t.csv")

Named: Any = SimpleNamespace
WATER = "water not removed: error unknown, expect centimeters"


def summary(**changes: Any) -> Any:
    """Return the result of a processing step."""
    fields: dict[str, Any] = {
        "head": Named(attrs={}), "count": 200, "usable": 150, "flagged": 30,
        "doubtful": 20, "flags": {"mixed": 25, "outlier": 5}, "whole": None,
        "comparison": None,
    }  # fmt: skip
    return Named(**(fields | changes))


REJECT = ["reject", "a.nc", "-o", "t.nc", "--method"]


@pytest.fixture
def rejected(inputs: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return a list of a result of `reject`, and of the words that made it."""
    calls: list[Any] = [summary()]

    def reject_file(*words: Any, **more: Any) -> Any:
        calls.append((words, more))
        if isinstance(calls[0], Exception):
            raise calls[0]
        return calls[0]

    monkeypatch.setattr(pipeline, "reject_file", reject_file)
    return calls


def test_a_rejection_has_options_in_si_units(rejected, printed) -> None:
    """Options that are not stated are none."""
    words = ["--water-fluctuation", "5 %", "--target-ratio", "0.25", "--tile-rows", "3"]
    words += ["--open-water", "b.nc", "--overwrite", "--water-ratio", "0.1"]
    assert main([*REJECT, "polarization", *words]) == 0
    assert printed() == [
        "t.nc: target signal, 15.0% of the samples flagged",
        "commonest flag: mixed (12.5%); what it means: amulor explain MIXED",
        "next: amulor image t.nc -o range.nc",
    ]
    ((given, more),) = rejected[1:]
    assert given == (Path("a.nc"), Path("t.nc"), "polarization")
    assert more == {
        "rows": 3, "overwrite": True, "open_water": Path("b.nc"), "interval": None,
        "target_ratio": 0.25, "water_ratio": 0.1,
        "water_fluctuation": pytest.approx(0.05), "column_uncertainty": None,
        "modulation_frequency": None,
    }  # fmt: skip


def test_a_rejection_at_one_frequency_says_which(rejected, printed) -> None:
    """Each warning is a note."""
    attributes = {"frequency_choice": "39 MHz", "frequency_warnings": "one; two"}
    rejected[0] = summary(head=Named(attrs=attributes), flags={}, flagged=0, count=0)
    assert main([*REJECT, "frequency", "--frequency", "39 MHz"]) == 0
    assert rejected[1][1]["modulation_frequency"] == 39e6
    assert printed() == [
        "39 MHz", "note: one", "note: two",
        "t.nc: target signal, 0.0% of the samples flagged",
        "next: amulor image t.nc -o range.nc",
    ]  # fmt: skip


def test_a_rejection_in_json_has_method_channels_and_reason(rejected, capsys) -> None:
    """The method is that of the comparison, if there is one."""
    head = xr.Dataset(
        coords={"polarization": ["VV", "VH"], "modulation_frequency": [2e7, 4e7]},
        attrs={"target_ratio": 0.25, "frequency_choice": "40 MHz"},
    )
    rejected[0] = summary(head=head)
    assert main([*REJECT, "auto", "--json"]) == 0
    content = {
        "output": "t.nc", "method": "auto", "polarizations": ["VV", "VH"],
        "modulation_frequencies_hz": [2e7, 4e7], "frequency_choice": "40 MHz",
        "target_ratio": 0.25, "flagged_share": 0.15,
        "flags": {"mixed": 25, "outlier": 5},
    }  # fmt: skip
    assert json.loads(capsys.readouterr().out) == content
    rows = [_row(method="joint")]
    compared = Named(method="joint", reason="R", rows=rows)
    assert reject._figures(Path("t.nc"), "auto", head, compared)["comparison"] == [
        vars(rows[0])
    ]
    figures = reject._figures(Path("t.nc"), "auto", head, compared)
    assert (figures["method"], figures["reason"]) == ("joint", "R")


def _row(**changes: Any) -> Any:
    """Return a row of a comparison of methods."""
    fields: dict[str, Any] = {
        "method": "open-water", "polarization": "VV", "bias": 1.2345e-3,
        "noise": math.nan, "usable": 0.95, "flagged": 0.25, "trusted": 0.5,
        "recommended": False, "note": "",
    }  # fmt: skip
    return Row(**(fields | changes))


def test_methods_are_compared_in_a_table_with_notes(printed) -> None:
    """Methods with one reason share its line; the recommended one has no note."""
    rows = [
        _row(),
        _row(method="joint", polarization="VH", recommended=True, note="no"),
        _row(method="unmix", polarization="VH", note="too few"),
        _row(method="stokes", polarization="", note="too few"),
    ]
    reject._print_comparison(Named(rows=rows, reason="joint is best"))
    assert printed() == [
        "Rejection methods",
        "method channel bias noise usable flagged trusted",
        "open-water VV 1.23 mm unknown 95% 25% 50%",
        "->joint VH 1.23 mm unknown 95% 25% 50%",
        "unmix VH 1.23 mm unknown 95% 25% 50%",
        "unmix VH, stokes: too few",
        "recommended: joint is best",
    ]


@pytest.mark.parametrize(("words", "code"), [([], 1), (["--water-ratio", "1"], 2)])
def test_formulas_refuse_options_or_cubes(rejected, capsys, words, code) -> None:
    """Without options, the problem is one of the cube."""
    rejected[0] = ValueError("bad numbers")
    assert main([*REJECT, "polarization", *words]) == code
    assert capsys.readouterr().err == "amulor: bad numbers\n"


def test_options_of_other_methods_are_named(rejected, capsys) -> None:
    """Options of methods of other packages are given by name and value."""
    assert main([*REJECT, "none", "--frequency", "39 MHz"]) == 2
    message = "none does not use --frequency; it uses no option"
    assert message in capsys.readouterr().err
    found = reject._as_options(["interval", "target_ratio", "odd"])
    assert found == "--nearest, --farthest, --target-ratio"
    stated = reject._stated(["a=1.5", " b = x=y", "c_1=nearest"])
    assert stated == {"a": 1.5, "b": " x=y", "c_1": "nearest"}
    for wrong in ("a", "=1", "a b=1"):
        with pytest.raises(_arguments.UsageError, match='--option must be "name=value'):
            reject._stated([wrong])
    assert rejection.load("none").name == "none"


IMAGE = ["image", "a.nc", "-o", "i.nc"]


@pytest.fixture
def imaged(inputs: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return a list of a result of `image`, and of the words that made it."""
    calls: list[Any] = [summary()]

    def image_file(*words: Any, **more: Any) -> Any:
        calls.append((words, more))
        return calls[0]

    monkeypatch.setattr(pipeline, "image_file", image_file)
    tests = [Named(result="drift")]
    monkeypatch.setattr(
        "amulor.imaging.instrument_tests.instrument_tests", lambda head: tests
    )
    return calls


def test_an_image_is_summed_up_by_shares_and_uncertainty(imaged, printed) -> None:
    """By rows no median is known; failed tests of the instrument are named."""
    words = ["--polarization", "vh", "--nearest", "50 cm", "--farthest", "3 m"]
    assert main([*IMAGE, *words, "--tile-rows", "2", "--overwrite"]) == 0
    rest = [
        "commonest flag: mixed (12.5%); what it means: amulor explain MIXED",
        "instrument: drift; see: amulor info i.nc",
        "next: amulor view i.nc",
    ]
    start = "i.nc: range image, 75.0% of the pixels usable (10.0% flagged)"
    assert printed() == [start, *rest]
    ((given, more),) = imaged[1:]
    assert given == (Path("a.nc"), Path("i.nc"))
    assert more == {
        "rows": 2, "overwrite": True, "polarization": "VH", "interval": (0.5, 3.0)
    }  # fmt: skip
    flags = np.zeros((1, 3), dtype=np.int16)
    errors = np.array([[1e-3, 2.5e-3, 9e-3]])
    dims = ("row", "column")
    imaged[0].whole = xr.Dataset(
        {"slant_range_uncertainty": (dims, errors), "quality_flag": (dims, flags)}
    )
    assert main(IMAGE) == 0
    assert printed() == [f"{start}, median uncertainty 2.50 mm", *rest]
    imaged[0].head.attrs["error_unknown"] = "E"
    imaged[0].whole = None
    assert main(IMAGE) == 0
    assert printed() == [f"{start}, E", *rest]


def test_an_image_without_ranges_says_so(imaged, printed) -> None:
    """Relative ranges are no ranges, and need an interval."""
    imaged[0].usable = 0
    assert main(IMAGE) == 0
    line = "i.nc: range image without a usable pixel; see: amulor info i.nc"
    assert printed() == [line]
    imaged[0].usable = 5
    imaged[0].head.attrs["interval_unsettled"] = "R"
    assert main(IMAGE) == 0
    line = (
        "i.nc: ranges relative to an unknown number of intervals, all pixels flagged: "
        "R; state --nearest and --farthest, no farther apart than the phases repeat"
    )
    assert printed() == [line]
    attributes = {"interval_unsettled": "R", "error_unknown": f"{WATER}; x"}
    words = image_command._unsettled(Path("i.nc"), attributes)
    assert words == f"{line}; {WATER}"


EXPORT = ["export", "a.nc", "-o"]


@pytest.fixture
def exported(inputs: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the words that are handed over."""
    calls: list[Any] = []

    def hand_over(cube: Any, output: Any, order: Any, **more: Any) -> str:
        calls.append((cube, output, order, more))
        return "said"

    cube = xr.Dataset(attrs={"title": "cube"})
    monkeypatch.setattr(handover, "hand_over", hand_over)
    monkeypatch.setattr(io, "read_cube", lambda path: cube)
    monkeypatch.setattr("amulor.io.netcdf.is_large", lambda path: False)
    monkeypatch.setattr(
        export_command, "_chosen", lambda cube, *words, moved: ((words, moved), cube)
    )
    return calls


def test_a_cloud_is_exported_with_its_selection(exported, printed) -> None:
    """A page shows clouds, but no MCAP files and no drawings."""
    words = [
        "--good-only",
        "--largest-uncertainty",
        "2 mm",
        "--without-mixed",
        "--slim",
    ]
    assert main([*EXPORT, "c.laz", *words, "--axes", "z-up", "--pose", "p.toml"]) == 0
    assert printed() == ["c.laz: said", "next: amulor view c.laz"]
    _, output, order, more = exported[0]
    assert output == Path("c.laz")
    assert order == handover.Order(product="cloud", slim=True)
    selection = ("z-up", Path("p.toml"), pytest.approx(2e-3), True, True)
    assert more == {"frame": (selection, None), "overwrite": False}
    assert main([*EXPORT, "c.mcap", "--overwrite"]) == 0
    assert printed() == ["c.mcap: said"]
    assert exported[1][3] == {
        "frame": (("instrument", None, None, False, False), None), "overwrite": True
    }  # fmt: skip


def test_a_drawing_is_exported_with_all_settings(exported, printed) -> None:
    """Lengths are in meters, and the sheet has its number."""
    words = [
        "--scale",
        "1:20",
        "--cell",
        "2 mm",
        "--contours",
        "5mm",
        "--show",
        "height",
    ]
    words += ["--seen-from", "top", "--dpi", "600", "--exaggeration", "2", "--title"]
    words += ["T", "--sheet", "3 of 7"]
    assert main([*EXPORT, "d.pdf", *words]) == 0
    assert printed() == ["d.pdf: said"]
    assert exported[0][2] == handover.Order(
        product="orthoimage", side="top", show="height", scale=20.0, exaggeration=2.0,
        dots_per_inch=600.0, cell=2e-3, contours=5e-3, title="T",
        fields={"sheet": "3 of 7"},
    )  # fmt: skip
    assert main([*EXPORT, "s.csv", "--line=-6cm,0m,6cm,1cm"]) == 0
    order = exported[1][2]
    assert (order.product, order.line) == ("section", (-0.06, 0.0, 0.06, 0.01))
    against = ["--against", "b.nc", "--unit", "mm", "--farthest", "2 cm"]
    assert main([*EXPORT, "v.csv", *against]) == 0
    order = exported[2][2]
    assert (order.product, order.against, order.unit) == (
        "deviation", Path("b.nc"), "mm"
    )  # fmt: skip
    assert order.farthest == pytest.approx(0.02)


def test_a_moving_scan_states_its_track(exported, printed, monkeypatch) -> None:
    """The number of the line is an attribute; readings lie along the track."""

    class Moving(MovingFrame):
        def __init__(self) -> None:
            pass

        spread = np.array([[1e-3, np.nan], [12.3e-3, 2e-3]])  # type: ignore[assignment]

    moved: list[Any] = []
    monkeypatch.setattr(
        export_command,
        "_chosen",
        lambda cube, *words, moved: (moved_of(moved), cube),
    )

    def moved_of(words: Any) -> Moving:
        moved.append(words)
        return Moving()

    words = ["--trajectory", "t.csv", "--mounting", "p.toml", "--line-number", "7"]
    assert main([*EXPORT, "c.las", *words]) == 0
    assert printed() == [
        "c.las: said",
        "readings of a point: taken along up to 12.3 mm of track",
        "next: amulor view c.las",
    ]
    assert moved == [(Path("t.csv"), Path("p.toml"))]
    assert exported[0][0].attrs["line_number"] == 7


def test_a_large_cloud_is_written_by_rows(exported, monkeypatch, printed) -> None:
    """A stated number of rows, or a large file, makes it so."""
    asked: list[Any] = []
    monkeypatch.setattr(
        export_command, "_by_rows", lambda *words, **more: asked.append((words, more))
    )
    assert main([*EXPORT, "c.laz", "--tile-rows", "1", "--slim"]) == 0
    monkeypatch.setattr("amulor.io.netcdf.is_large", lambda path: True)
    assert main([*EXPORT, "c.ply", "--good-only", "--overwrite"]) == 0
    assert exported == []
    start = (Path("a.nc"), Path("c.laz"), 1, "instrument", None, None, False, False)
    assert asked == [
        (start, {"slim": True, "overwrite": False}),
        ((Path("a.nc"), Path("c.ply"), None, "instrument", None, None, True, False),
         {"slim": False, "overwrite": True}),
    ]  # fmt: skip
    # Other products, and scans from a vehicle, are read as a whole.
    assert main([*EXPORT, "d.tif"]) == 0
    assert main([*EXPORT, "c.ply", "--trajectory", "t.csv"]) == 0
    assert len(exported) == 2


@pytest.mark.parametrize(
    ("doubtful", "unknown", "words"),
    [(0, "", ""), (3, "", ", 3 of them doubtful"), (3, "E", ", 3 of them doubtful: E")],
)
def test_a_cloud_by_rows_counts_points_and_doubts(
    inputs, monkeypatch, printed, doubtful: int, unknown: str, words: str
) -> None:
    """Its frame is that of the first row."""
    from contextlib import contextmanager

    asked: list[Any] = []

    @contextmanager
    def open_rows(path: Path) -> Any:
        yield Named(tile=lambda first, last: (first, last))

    def cloud_file(*given: Any, **more: Any) -> Any:
        asked.append((given, more))
        return Named(points=9, doubtful=doubtful, error_unknown=unknown)

    frame = imaging.Frame(name="z-up", rotation=np.eye(3), position=np.zeros(3))
    monkeypatch.setattr("amulor.io.netcdf.open_rows", open_rows)
    monkeypatch.setattr(pipeline, "cloud_file", cloud_file)
    monkeypatch.setattr(
        export_command, "_chosen", lambda *given: asked.append(given) or (frame, None)
    )
    for name in ("c.laz", "c.MCAP"):
        export_command._by_rows(
            Path("a.nc"), Path(name), 4, "z-up", None, 2e-3, True, False, slim=True,
            overwrite=False,
        )  # fmt: skip
    assert printed() == [
        f"c.laz: 9 points{words}", "next: amulor view c.laz", f"c.MCAP: 9 points{words}"
    ]  # fmt: skip
    assert asked[0] == ((0, 1), "z-up", None, None, False, False)
    given, more = asked[1]
    assert given == (Path("a.nc"), Path("c.laz"))
    assert more == {
        "frame": frame, "selection": pipeline.Selection(True, 2e-3, False), "rows": 4,
        "slim": True, "overwrite": False,
    }  # fmt: skip


def test_pixels_of_a_cloud_are_chosen_in_the_frame_of_a_pose(monkeypatch) -> None:
    """A file of a pose goes before the axes; a track before both."""
    from amulor import cube as cubes
    from amulor import survey

    monkeypatch.setattr(cubes, "checked", lambda cube, level: (cube, level))
    monkeypatch.setattr(survey, "read_pose", lambda path: f"pose {path}")
    monkeypatch.setattr(imaging, "frame_of", lambda cube, **more: more)
    monkeypatch.setattr(imaging, "leave_out", lambda cube, **more: (cube, more))
    monkeypatch.setattr(imaging, "moving_frame", lambda cube, **more: more)
    monkeypatch.setattr(
        "amulor.io.trajectories.read_trajectory", lambda path: f"track {path}"
    )
    monkeypatch.setattr("amulor.platform.read_mounting", lambda path: f"on {path}")
    cube: Any = "cube"
    chosen = export_command._chosen
    frame, left = chosen(cube, "z-up", None, 2e-3, True, False)
    assert frame == {"axes": "z-up", "pose": None}
    assert left == (
        ("cube", "range_image"),
        {"good_only": True, "largest_uncertainty": 2e-3, "mixed": False},
    )
    frame, _ = chosen(cube, "z-up", Path("p"), None, False, True)
    assert frame == {"axes": "pose", "pose": "pose p"}
    frame, _ = chosen(cube, "z-up", None, None, False, True, moved=(Path("t"), None))
    assert frame == {"trajectory": "track t", "mounting": None}
    moved = (Path("t"), Path("m"))
    frame, _ = chosen(cube, "z-up", None, None, False, True, moved=moved)
    assert frame == {"trajectory": "track t", "mounting": "on m"}


def test_endings_of_all_products_are_listed_once() -> None:
    """Of one product they are its own."""
    assert export_command._endings("mesh") == [".ply"]
    endings = export_command._endings(None)
    assert len(endings) == len(set(endings))
    assert {".laz", ".tif", ".pdf", ".dxf"} <= set(endings)


def budget(**changes: Any) -> dict[str, Any]:
    """Return the error budget of an image, as for JSON."""
    fields: dict[str, Any] = {
        "error_unknown": "", "combined_m": 1.5e-3, "expanded_m": 3e-3,
        "coverage_factor": 2.0, "common_m": 0.5e-3,
        "terms": {
            "counting": {"standard_uncertainty_m": 1.2e-3, "share_of_variance": 0.64,
                         "type": "A", "measurements": 12},
            "delay": {"standard_uncertainty_m": 0.9e-3, "share_of_variance": 0.36,
                      "type": "B", "measurements": None},
        },
        "unknown": ["drift", "gain"], "late_echo": "subtracted",
        "late_echo_taken_off_m": 0.25e-3, "delay_calibrated": "",
        "delay_calibration_age_days": math.nan,
        "instrument_tests": [
            {"result": "R", "probability": 0.012, "cause": "C", "measurement": "M"},
        ],
    }  # fmt: skip
    return fields | changes


def test_an_error_budget_is_printed_in_lines() -> None:
    """Without a combined uncertainty, the reason is all."""
    assert info._lines({}) == []
    assert info._lines(budget()) == [
        "1.5 mm combined standard uncertainty (median), 3 mm with k = 2",
        "0.5 mm of it shared by all pixels",
        "1.2 mm counting (64% of the variance, type A, from 12 shots)",
        "0.9 mm delay (36% of the variance, type B)",
        "not known, and not in it: drift, gain",
        "late echo: 0.25 mm subtracted",
        "R (chance below 0.01): C; to do: M",
    ]
    few = budget(
        common_m=math.nan, terms={}, unknown=[], late_echo_taken_off_m=math.nan,
        delay_calibrated="2026-05-01", instrument_tests=[], error_unknown="E",
    )  # fmt: skip
    combined = "1.5 mm combined standard uncertainty (median), 3 mm with k = 2"
    lines = info._lines(few)
    assert lines[:3] == ["E", combined, "late echo: subtracted"]
    assert lines[3].startswith("delay calibrated on 2026-05-01")
    assert len(lines) == 4
    unknown = budget(combined_m=math.nan)
    assert info._lines(unknown) == []
    assert info._lines(unknown | {"error_unknown": "E"}) == ["E"]


def test_a_file_is_described_from_its_level_on(printed) -> None:
    """Flags are sorted by their number, the commonest first."""
    flags = np.array([[0, 64], [64, 128]], dtype=np.int16)
    cube = xr.Dataset(
        {
            "slant_range": (("row", "column"), [[1.0, 2.0], [3.0, np.nan]]),
            "quality_flag": (("row", "column"), flags),
        },
        attrs={"polarization": "VH", "modulation_frequencies": np.array([2e7, 4e7])},
    )
    content: dict[str, Any] = {
        "file": "i.nc", "level": "range_image", "title": "T",
        "sizes": {"row": 2, "column": 2}, "modulation_frequencies_hz": [],
        "polarizations": [], "simulated": True, "flags": {"outlier": 1, "mixed": 2},
        "uncertainty": {}, "history": ["one", "two"],
    }  # fmt: skip
    info._print(cube, content)
    lines = printed()
    assert lines[:5] == [
        'i.nc: range image "T", simulated',
        "2 rows, 2 columns",
        "channel: VH",
        "modulation: 20, 40 MHz",
        "slant range: median 2.0000 m, 1.0200 to 2.9800 m (1 to 99 % of the pixels); 3 "
        "of 4 hold a range",
    ]
    assert lines[5].startswith("flag mixed, 2 (50.0%): ")
    assert lines[6].startswith("flag outlier, 1 (25.0%): ")
    assert lines[7].startswith("what to do: amulor explain")
    assert lines[8:] == ["history: one", "history: two"]
    plain = xr.Dataset({"quality_flag": (("row",), np.zeros(3, dtype=np.int16))})
    content |= {
        "title": "", "simulated": False, "flags": {}, "history": [],
        "polarizations": ["VV", "VH"], "modulation_frequencies_hz": [5e7],
        "sizes": {"row": 3}, "level": "samples",
    }  # fmt: skip
    info._print(plain, content)
    assert printed() == [
        "i.nc: samples, measured", "3 rows", "channel: VV, VH", "modulation: 50 MHz",
        "flags: none",
    ]  # fmt: skip


def test_reaches_of_presets_have_limits_and_causes() -> None:
    """Sixty meters are the farthest distance that is looked at."""
    span = presets._span
    near = Named(nearest=0.123, farthest=4.567, binding="noise")
    assert span(near) == ["0.12", "4.57", "noise"]
    assert span(Named(nearest=0.5, farthest=math.inf, binding="x"))[1] == "> 60"
    for nearest, farthest in ((None, 1.0), (1.0, None)):
        none = Named(nearest=nearest, farthest=farthest, binding="x")
        assert span(none) == ["", "none", "x"]


def test_samples_are_listed_with_sizes_and_written_once(here, monkeypatch, capsys):
    """Names stand in a column; a sample that is named twice is written once."""
    entry = Named(
        name="ladder", size=12_345, title="Ladder", shows="steps", origin="O",
        licence="L", commands=("amulor info x",),
    )  # fmt: skip
    copied: list[Any] = []
    monkeypatch.setattr(samples, "samples", lambda: {"ladder": entry, "x": entry})
    monkeypatch.setattr(samples, "sample", lambda name: entry)
    monkeypatch.setattr(
        samples, "copy",
        lambda name, output, overwrite: copied.append((name, output, overwrite))
        or [output / "a.nc"],
    )  # fmt: skip
    assert main(["samples"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "ladder    12 kB  Ladder",
        "                 shows steps",
        "x         12 kB  Ladder",
        "                 shows steps",
        "`amulor samples NAME` writes its files here.",
    ]
    assert main(["samples", "ladder", "ladder", "-o", "f", "--overwrite"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "f/a.nc: Ladder", "  O; L", "  $ amulor info x"
    ]  # fmt: skip
    assert copied == [("ladder", Path("f"), True)]


def test_an_archive_is_written_and_looked_through(here, monkeypatch, printed) -> None:
    """Missing things are lines of an error."""
    from amulor.handover import archive

    counts = {"scans": 2, "points": 9, "files": 7}
    monkeypatch.setattr(archive_command, "print_next", lambda c: print(f"next: {c}"))
    monkeypatch.setattr(archive, "read_project", lambda path: path)
    monkeypatch.setattr(archive, "write_archive", lambda project, folder: counts)
    monkeypatch.setattr("amulor._extras.require", lambda *_, **__: None)
    assert main(["archive", "p.toml", "-o", "out"]) == 0
    counts["scans"] = 1
    assert main(["archive", "p.toml", "-o", "out"]) == 0
    assert printed() == [
        "out: 2 scans, 9 points, 7 files", "next: amulor archive --check out",
        "out: 1 scan, 9 points, 7 files", "next: amulor archive --check out",
    ]  # fmt: skip
    assert main(["archive", "p.toml", "-o", "out", "--json"]) == 0
    assert json.loads(" ".join(printed())) == {"folder": "out", **counts}
    monkeypatch.setattr(archive, "missing_of", lambda folder: ["one", "two"])
    assert main(["archive", "--check", "out"]) == 1
    assert main(["archive", "--check", "out", "--json"]) == 1
    assert json.loads(" ".join(printed())) == {
        "folder": "out", "complete": False, "missing": ["one", "two"]
    }  # fmt: skip
    monkeypatch.setattr(archive, "missing_of", lambda folder: [])
    assert main(["archive", "--check", "out"]) == 0
    assert printed() == ["out: complete, all checksums agree"]


def test_a_report_names_its_images_and_shares_the_work(inputs, monkeypatch, printed):
    """Images of one name have a number and a folder; checks of files come first."""
    asked: list[Any] = []
    shares: list[float] = []
    written: list[Any] = []
    (inputs / "deep").mkdir()
    (inputs / "deep" / "a.nc").touch()

    def shown(path: Path, rows: int | None, checks: list[Any]) -> tuple[str, str]:
        asked.append((path, rows, [check.name for check in checks]))
        return f"cube {path}", f"whole {path}"

    def write(path: Path, cubes: Any, **more: Any) -> None:
        written.append((path, cubes, more))

    monkeypatch.setattr(report_command, "_shown", shown)
    monkeypatch.setattr("amulor.view.image_report.write", write)
    monkeypatch.setattr(
        "amulor.imaging.measure.read_checks", lambda path: [Named(name="from file")]
    )
    monkeypatch.setattr(
        "amulor._progress.part", lambda *ends: shares.append(ends) or _nothing()
    )
    words = ["report", "a.nc", "deep/a.nc", "b.nc", "-o", "r.html", "--tile-rows", "5"]
    words += ["--checks", "p.toml", "--check", "1,2 3,4 5cm", "--overwrite"]
    assert main(words) == 0
    assert printed() == ["r.html: 3 range images; open it in a browser"]
    names = ["from file", "check 1"]
    assert asked == [
        (Path(path), 5, names) for path in ("a.nc", "deep/a.nc", "b.nc")
    ]  # fmt: skip
    folder = inputs.resolve().name
    ((path, cubes, more),) = written
    assert path == Path("r.html")
    assert cubes == {
        f"1: {folder}/a": "cube a.nc", "2: deep/a": "cube deep/a.nc", "b": "cube b.nc"
    }  # fmt: skip
    assert list(more["wholes"]) == list(cubes)
    assert more["overwrite"] is True
    assert [check.name for check in more["checks"]] == names
    ends = [(0.0, 1 / 6), (1 / 6, 1 / 3), (1 / 3, 0.5), (0.5, 1.0)]
    assert shares == [pytest.approx(pair) for pair in ends]
    assert main(["report", "a.nc", "-o", "s.html"]) == 0
    assert printed() == ["s.html: 1 range image; open it in a browser"]


def _nothing() -> Any:
    from contextlib import nullcontext

    return nullcontext()


def test_a_cube_of_a_wrong_level_is_an_error_of_the_file() -> None:
    """The check of a level names what is needed."""
    with pytest.raises(CubeError):
        export_command._chosen(
            xr.Dataset(attrs={"level": "samples"}), "z-up", None, None, False, False
        )
