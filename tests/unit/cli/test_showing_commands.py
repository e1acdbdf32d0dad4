"""Commands that show, explain and serve: what they open, and what they print."""

from __future__ import annotations

import json
import signal
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from records import record

from amulor import handover, io
from amulor.cli import devices, main
from amulor.cli import explain as explain_command
from amulor.cli import view as view_command
from amulor.cli import warm_up as warm_up_command
from amulor.survey import Survey

pytestmark = pytest.mark.usefixtures("next_commands")

INPUTS = ("a.nc", "b.nc", "s.toml", "m.ply", "c.toml", "x.csv")

Named: Any = SimpleNamespace


def beam(**changes: Any) -> Any:
    """Return a range profile with two surfaces."""
    fields: dict[str, Any] = {
        "surface": [1.23456, 2.5], "surface_uncertainty": [1.2e-3, 3.4e-3],
        "amplitude": [0.0123, 0.4], "amplitude_uncertainty": [0.002, 0.03],
        "resolution": 0.1234, "unambiguous_span": 7.654, "noise": 0.00123,
        "misfit": 10.4, "freedom": 8,
    }  # fmt: skip
    return record(**(fields | changes))


def test_surfaces_along_a_beam_are_printed_in_order(
    inputs, monkeypatch, printed
) -> None:
    """Scatter of more than four standard deviations of chi-square is warned of."""
    asked: list[Any] = []
    found = [beam()]
    monkeypatch.setattr(
        "amulor.imaging.beam_profile.beam_profile",
        lambda cube, **more: asked.append(more) or found[0],
    )
    monkeypatch.setattr(io, "read_cube", lambda path: path)
    assert main(["profile", "a.nc", "--pixel", "2,3", "--polarization", "vv"]) == 0
    lines = [
        "a.nc: row 2, column 3",
        "surface range [m] uncertainty [mm] amplitude [V]",
        "1 1.2346 1.2 0.0123 +- 0.002", "2 2.5000 3.4 0.4 +- 0.03",
        "Range resolution: 12.3 cm", "Unambiguous span: 7.65 m",
        "Noise level of the profile: 0.0012 V",
        "Chi-square: 10 with 8 degrees of freedom",
    ]  # fmt: skip
    assert printed() == lines
    assert asked == [
        {"row": 2, "column": 3, "polarization": "VV", "interval": None, "most": 4}
    ]
    # Sixteen is the variance of chi-square; four standard deviations are sixteen.
    for misfit, warned in ((24.0, False), (24.1, True)):
        found[0] = beam(misfit=misfit)
        assert main(["profile", "a.nc", "--pixel", "2,3"]) == 0
        assert (len(printed()) > len(lines)) is warned
    figures: list[Any] = []
    monkeypatch.setattr(
        "amulor.view.beam_profile.write_profile",
        lambda *words, **more: figures.append((words, more)),
    )
    words = ["--json", "-o", "p.svg", "--most", "2", "--nearest=1m", "--farthest=2m"]
    assert main(["profile", "a.nc", "--pixel", "2,3", *words]) == 0
    assert json.loads(" ".join(printed()))["surface"] == [1.23456, 2.5]
    assert figures == [
        ((Path("p.svg"), found[0]),
         {"title": "a.nc: row 2, column 3", "overwrite": False}),
    ]  # fmt: skip
    assert asked[-1]["most"] == 2
    assert asked[-1]["interval"] == (1.0, 2.0)


def test_flags_of_a_pixel_are_explained(inputs, monkeypatch, printed, capsys) -> None:
    """A flag with a cause is explained by the cause, and each is explained once."""
    from amulor.view import explanations

    reason = record(
        flag="MIXED", cause="", modulation_frequencies=(2e7, 4e7), quantity="q",
        value=1.2345, limit="> 1", unit="mm",
    )  # fmt: skip
    other = record(
        flag="WATER", cause="DRIFT", modulation_frequencies=(), quantity="r",
        value=None, limit="< 2", unit="V",
    )  # fmt: skip
    asked: list[Any] = []
    found = {"VV": [reason, other, reason], "VH": []}
    monkeypatch.setattr(
        explanations, "reasons", lambda *words: asked.append(words) or found
    )
    texts = {
        name: Named(
            name=name, kind="flag", meaning=f"means {name}", remedy=f"do {name}"
        )
        for name in ("MIXED", "DRIFT")
    }
    monkeypatch.setattr(explanations, "explanations", lambda: texts)
    assert main(["explain", "a.nc", "--pixel", "2,3"]) == 0
    assert printed() == [
        "a.nc: row 2, column 3", "channel VV",
        "flag MHz quantity value flagged if unit",
        "MIXED 20, 40 q 1.23 > 1 mm", "WATER (DRIFT) all r < 2",
        "MIXED 20, 40 q 1.23 > 1 mm", "channel VH: no flags",
        "MIXED, what to do: do MIXED", "DRIFT, what to do: do DRIFT",
    ]  # fmt: skip
    assert asked == [(Path("a.nc"), 2, 3)]
    assert main(["explain", "a.nc", "--pixel", "2,3", "--json"]) == 0
    content = json.loads(" ".join(printed()))
    assert (content["row"], content["column"]) == (2, 3)
    assert content["to_do"] == {"MIXED": "do MIXED", "DRIFT": "do DRIFT"}
    assert [len(rows) for rows in content["channels"].values()] == [3, 0]
    for words, message in (
        (["--pixel", "2,3"], "--pixel needs one file before it, got 0; for example"),
        (["a.nc", "b.nc", "--pixel", "2,3"], "one file before it, got 2"),
        (["a.nc", "--pixel", "2"], "--pixel: '2' is no row and column"),
    ):
        assert main(["explain", *words]) == 1
        assert message in capsys.readouterr().err


def test_names_are_listed_by_kind(monkeypatch, capsys) -> None:
    """Each kind has a title; a name is explained in lines of up to 100 letters."""
    from amulor.view import explanations

    texts = {
        "MIXED": record(name="MIXED", kind="flag", meaning="two surfaces"),
        "LONGER": record(name="LONGER", kind="flag", meaning="x"),
        "odd": record(name="odd", kind="message", meaning="y"),
    }
    monkeypatch.setattr(explanations, "explanations", lambda: texts)
    monkeypatch.setattr(explanations, "find", lambda words: [texts["MIXED"]])
    monkeypatch.setattr(
        explanations, "lines_of", lambda text: ["meaning:    " + "word " * 30]
    )
    assert main(["explain"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "flags", "  MIXED   two surfaces", "  LONGER  x", "messages", "  odd     y"
    ]  # fmt: skip
    assert main(["explain", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["odd"]["meaning"] == "y"
    for columns, width in ((80, 80), (300, 100)):
        monkeypatch.setattr(
            explain_command.shutil, "get_terminal_size",
            lambda columns=columns: Named(columns=columns),
        )  # fmt: skip
        assert main(["explain", "mixed"]) == 0
        first, *lines = capsys.readouterr().out.splitlines()
        assert first == "MIXED (flag)"
        assert width - 6 < max(map(len, lines)) <= width
        assert lines[1].startswith(" " * 12 + "word")
    assert main(["explain", "mixed", "--json"]) == 0
    assert list(json.loads(capsys.readouterr().out)) == ["MIXED"]


@pytest.fixture
def pages(inputs: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the pages that are shown and served."""
    from amulor.view import page
    from amulor.view.page import space

    calls: list[Any] = []

    class Live:
        def __init__(self, path: Path) -> None:
            self.path, self.looks, self.recording = path, 0, "recording"

        def look(self) -> None:
            self.looks += 1

    monkeypatch.setattr("amulor._extras.require", lambda *_, **__: None)
    monkeypatch.setattr(page, "Live", Live)
    monkeypatch.setattr(
        page, "opened",
        lambda path, **more: calls.append((path, more)) or Named(against=None),
    )  # fmt: skip
    monkeypatch.setattr(
        page, "serve", lambda shown, **more: calls.append((shown, more))
    )
    monkeypatch.setattr(
        page, "save_page",
        lambda shown, path, overwrite: path.write_bytes(b"x" * 1_250_000),
    )  # fmt: skip
    monkeypatch.setattr(space, "is_space", lambda path: path.suffix == ".ply")
    monkeypatch.setattr(
        space, "opened", lambda path, unit: calls.append((path, unit)) or "space"
    )
    monkeypatch.setattr(
        handover, "comparison", lambda path, unit: f"against {path} in {unit}"
    )
    monkeypatch.setattr(view_command, "_site", lambda path, poses: (path, poses))
    return calls


def test_a_file_is_shown_with_its_samples_and_a_reference(pages) -> None:
    """Port, address and products are those of the options."""
    words = [
        "--samples",
        "b.nc",
        "--against",
        "m.ply",
        "--unit",
        "mm",
        "--port",
        "8000",
    ]
    limits = ["--nearest", "1m", "--farthest", "2m", "--host", "0.0.0.0"]
    assert main(["view", "a.nc", *words, *limits]) == 0
    opened, (shown, how) = pages
    more = {"samples": Path("b.nc"), "interval": (1.0, 2.0)}
    assert opened == (Path("a.nc"), more)
    assert shown.against == "against m.ply in mm"
    assert (how["host"], how["port"]) == ("0.0.0.0", 8000)
    products = how["products"]
    assert (products._against, products._unit) == (Path("m.ply"), "mm")
    assert main(["view", "a.nc"]) == 0
    shown, how = pages[3]
    assert shown.against is None
    assert (how["host"], how["port"]) == ("127.0.0.1", 0)
    assert (how["products"]._against, how["products"]._unit) == (None, "m")


def test_clouds_sites_and_scans_are_shown(pages, inputs) -> None:
    """A cloud may have a unit, a site its poses; a scan is looked at once."""
    assert main(["view", "m.ply", "--unit", "inch"]) == 0
    assert pages[0] == (Path("m.ply"), 0.0254)
    assert pages[1][0] == "space"
    assert main(["view", "m.ply"]) == 0
    assert pages[2] == (Path("m.ply"), None)
    assert main(["view", "s.toml", "--poses", "c.toml"]) == 0
    assert pages[4][0] == (Path("s.toml"), Path("c.toml"))
    (inputs / "scan").mkdir()
    assert main(["view", "scan"]) == 0
    assert (pages[5][0].path, pages[5][0].looks) == (Path("scan"), 1)


def test_a_page_is_saved_as_one_file(pages, inputs, printed, capsys) -> None:
    """An existing file is kept; of a running scan the recording is saved."""
    assert main(["view", "a.nc", "--save", "p.html"]) == 0
    assert printed() == ["p.html: one page, 1.2 MB"]
    assert len(pages) == 1
    assert main(["view", "a.nc", "--save", "p.html"]) == 1
    assert "p.html exists already" in capsys.readouterr().err
    (inputs / "scan").mkdir()
    assert main(["view", "scan", "--save", "p.html", "--overwrite"]) == 0
    for words in (["a.nc", "--against", "gone.ply"], ["s.toml", "--poses", "gone"]):
        assert main(["view", *words]) == 1


def test_a_demo_prints_errors_of_pairs(here, monkeypatch, printed) -> None:
    """Before and after the rejection of water; missing extras are named."""
    from amulor.studies import ladder

    cases = [
        Named(name=f"{water} {k}", noise=1e-3 * k, stated=2e-3 * k)
        for water in ("clear", "milk")
        for k in (1, 2)
    ]
    monkeypatch.setattr(ladder, "run", lambda output, rng, overwrite, progress: cases)
    monkeypatch.setattr(
        ladder, "mean_error", lambda case: case.name[:2] + case.name[-1]
    )
    monkeypatch.setattr(ladder, "left_out", lambda: {"laz": "export"})
    monkeypatch.setattr(ladder, "summary", lambda cases: {"cases": len(cases)})
    assert main(["demo", "-o", "out"]) == 0
    assert printed() == [
        "Mean error of the slant range [mm]",
        "case before after noise stated noise",
        "clear 2 cl1 cl2 2.00 4.00", "milk 2 mi1 mi2 2.00 4.00",
        "Report, for a browser: out/report.html",
        "No LAZ files: pip install 'amulor[export]' lets it write them",
        "next: amulor view out/ladder_milk_target_signal.nc",
    ]  # fmt: skip
    assert main(["demo", "-o", "out", "--json"]) == 0
    assert json.loads(" ".join(printed())) == {"cases": 4}


def test_loops_are_compiled_step_by_step(monkeypatch, printed) -> None:
    """Each step has an equal share of the work."""
    parts: list[Any] = []
    told: list[Any] = []

    @contextmanager
    def part(begin: float, end: float) -> Any:
        parts.append((begin, end))
        yield

    @contextmanager
    def bar() -> Any:
        yield lambda *words: told.append(words)

    monkeypatch.setattr(warm_up_command._progress, "part", part)
    monkeypatch.setattr(warm_up_command, "progress_bar", bar)
    steps = {name: (lambda name=name: told.append(name)) for name in ("one", "two")}
    monkeypatch.setattr(warm_up_command, "_work", lambda: steps)
    monkeypatch.setattr(warm_up_command, "_ready", lambda: (12, "/cache"))
    assert main(["warm-up"]) == 0
    assert printed() == ["12 compiled loops are ready in /cache"]
    assert parts == [(0.0, 0.5), (0.5, 1.0)]
    assert told == [("one", 0.0), "one", ("two", 0.5), "two"]


def test_devices_are_served_until_a_signal(inputs, monkeypatch, capsys) -> None:
    """Addresses are printed; faults of options are added to those of the file."""
    from amulor.acquisition import Settings

    asked: list[Any] = []
    served = Named(
        settings=Named(
            to_toml=lambda: "devices", lock_in=Named(address="L"),
            scanner=Named(address="S"), navigation=Named(address="N"),
        )
    )  # fmt: skip

    @contextmanager
    def rehearse(survey: Any, settings: Any, **more: Any) -> Any:
        asked.append((settings, more))
        yield served

    monkeypatch.setattr(Survey, "from_toml", lambda path: path)
    monkeypatch.setattr("amulor.acquisition.rehearsal.rehearse", rehearse)
    monkeypatch.setattr(devices, "_wait_for_the_end", lambda: None)
    words = ["devices", "simulate", "s.toml", "-o", "d.toml"]
    faults = ["--fault", "unlock@500x3", "--fault", "stuck@7", "--speed", "2"]
    ports = ["--lock-in-port", "1", "--stage-port", "2", "--navigation-port", "3"]
    assert main([*words, *faults, *ports, "--lock-in", "sr865a"]) == 0
    lines = ["d.toml: sr865a at L", "d.toml: stages at S", "d.toml: navigation at N",
             "Ctrl-C ends it."]  # fmt: skip
    assert capsys.readouterr().out.splitlines() == lines
    assert Path("d.toml").read_text() == "devices"
    settings, more = asked[0]
    assert isinstance(settings, Settings)
    assert len(settings.simulation.faults) == 2
    assert (more["model"], more["speed"], more["host"]) == ("sr865a", 2.0, "127.0.0.1")
    assert more["ports"] == (1, 2, 3)
    served.settings.navigation = None
    assert main([*words, "--overwrite"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 3
    assert main([*words, "--overwrite", "--fault", "odd"]) == 2
    assert "--fault odd: needed is kind@reading" in capsys.readouterr().err
    assert main(words) == 1
    assert "d.toml exists already" in capsys.readouterr().err


def test_an_address_that_cannot_be_served_is_named(inputs, monkeypatch, capsys) -> None:
    """The reason is that of the operating system."""

    def refuse(*_: Any, **__: Any) -> None:
        raise OSError(98, "Address already in use")

    monkeypatch.setattr(Survey, "from_toml", lambda path: path)
    monkeypatch.setattr("amulor.acquisition.rehearsal.rehearse", refuse)
    words = ["devices", "simulate", "s.toml", "-o", "d.toml", "--host", "h"]
    assert main(words) == 1
    message = "amulor: cannot serve at h: Address already in use\n"
    assert capsys.readouterr().err == message


def test_the_end_of_devices_is_a_signal() -> None:
    """Handlers of before come back."""
    before = signal.getsignal(signal.SIGTERM)
    import os
    import threading

    threading.Timer(0.02, os.kill, (os.getpid(), signal.SIGTERM)).start()
    devices._wait_for_the_end()
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_run_of_a_site_counts_files_and_stops(inputs, monkeypatch, capsys) -> None:
    """Scans that stopped are an error after all results are printed."""
    asked: list[Any] = []
    results = [
        record(name="a", files={"x": 1, "y": 2, "z": 3}, made=("x",), error=""),
        record(name="b", files={}, made=(), error="bad"),
    ]
    monkeypatch.setattr(
        "amulor.scale.site_run.run_site",
        lambda *words, **more: asked.append((words, more)) or results,
    )
    assert main(["run", "s.toml", "-o", "out"]) == 1
    text = capsys.readouterr()
    assert text.out.splitlines() == [
        "a: 1 files made, 2 were there", "b: 0 files made, 0 were there"
    ]  # fmt: skip
    assert text.err == "amulor: 1 of 2 scans stopped: b: bad\n"
    results.pop()
    words = ["--scheduler", "local", "--workers", "2", "--tile-rows", "3", "--json"]
    assert main(["run", "s.toml", "-o", "out", *words]) == 0
    content = json.loads(capsys.readouterr().out)
    assert (content["output"], content["scans"][0]["name"]) == ("out", "a")
    given = (Path("s.toml"), Path("out"))
    assert asked == [
        (given, {"scheduler": None, "workers": None, "tile_rows": None}),
        (given, {"scheduler": "local", "workers": 2, "tile_rows": 3}),
    ]


def test_a_recording_is_imported_whole_or_by_rows(inputs, monkeypatch, printed) -> None:
    """Marked samples are counted by their word."""
    asked: list[Any] = []
    dims = ("row", "column", "modulation_frequency", "polarization")
    cube = xr.Dataset({"x": (dims, np.zeros((2, 3, 4, 1)))})
    place = "amulor.io"
    monkeypatch.setattr(f"{place}.recording_table.RecordingMap.from_toml", lambda p: p)
    monkeypatch.setattr(Survey, "from_toml", lambda path: path)
    samples = [10]
    monkeypatch.setattr(
        "amulor.survey.directions.samples_of", lambda survey: samples[0]
    )
    monkeypatch.setattr(
        f"{place}.recordings.read_recordings",
        lambda *words, **more: asked.append((words, more)) or cube,
    )
    monkeypatch.setattr(f"{place}.recordings.marked", lambda cube: {})
    monkeypatch.setattr(io, "write_cube", lambda *_, **__: None)
    summary = Named(
        sizes={"row": 9, "column": 8, "modulation_frequency": 7, "polarization": 6},
        marked={"overloads": 5, "unlocks": 4},
    )
    monkeypatch.setattr(
        "amulor.scale.recorded.import_file",
        lambda *words, **more: asked.append((words, more)) or summary,
    )
    words = ["import", "recordings", "x.csv", "--survey", "s.toml", "-o", "o.nc"]
    words += ["--columns", "c.toml"]
    end = "next: amulor reject o.nc --method auto -o target.nc"
    assert main([*words, "--temperature", "12.5"]) == 0
    assert printed() == [
        "o.nc: 2 x 3 pixels at 4 frequencies in 1 polarizations; marked: none", end
    ]  # fmt: skip
    line = (
        "o.nc: 9 x 8 pixels at 7 frequencies in 6 polarizations; marked: 5 overloads, "
        "4 unlocks"
    )
    assert main([*words, "--tile-rows", "2", "--overwrite"]) == 0
    samples[0] = 10_000_000
    assert main(words) == 0
    assert printed() == [line, end] * 2
    files = (Path("x.csv"), Path("c.toml"), Path("s.toml"))
    assert asked == [
        (files, {"temperature": 12.5}),
        ((*files, Path("o.nc")),
         {"temperature": None, "rows": 2, "overwrite": True}),
        ((*files, Path("o.nc")),
         {"temperature": None, "rows": None, "overwrite": False}),
    ]  # fmt: skip
