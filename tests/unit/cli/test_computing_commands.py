"""Responses, benchmark and figures: what is computed, and what is printed."""

from __future__ import annotations

import json
import math
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from records import record

from amulor import rejection
from amulor.cli import backscatter, benchmark, main
from amulor.cli import reproduce as reproduce_command
from amulor.errors import SurveyError
from amulor.survey import Survey

pytestmark = pytest.mark.usefixtures("next_commands")

INPUTS = ("a.nc", "b.nc", "s.toml", "m.ply", "c.toml", "x.csv")

Named: Any = SimpleNamespace


def response(**changes: Any) -> dict[str, Any]:
    """Return a response at two frequencies."""
    fields: dict[str, Any] = {
        "model": "closure", "power_share_unmodulated": 0.01234, "cut_off_hz": 56.78e6,
        "fitted_cut_off_hz": 60.12e6, "fitted_cut_off_uncertainty_hz": 1e6,
        "modulation_frequency_hz": np.array([10e6, 20e6]),
        "relative_amplitude": np.array([0.9, 0.75]),
        "phase_rad": np.radians([10.0, -20.5]),
    }  # fmt: skip
    return fields | changes


def test_a_response_is_printed_with_its_cut_off(printed) -> None:
    """Without errors, numbers stand alone."""
    backscatter._print("Tank", response())
    assert printed() == [
        "Tank: water signal, closure model",
        "MHz relative amplitude phase [deg]",
        "10 0.9000 10.00", "20 0.7500 -20.50",
        "Received of the unmodulated light: 0.01234",
        "Cut-off at 1/sqrt 2: 56.78 MHz; free fit: 60.12 MHz",
    ]  # fmt: skip
    backscatter._print("Tank", response(cut_off_hz=math.nan, fitted_cut_off_hz=None))
    assert printed()[-1] == "Cut-off at 1/sqrt 2: beyond these frequencies"


def test_a_response_of_photons_has_errors_and_orders(printed) -> None:
    """An interrupt and rare photons are stated."""
    more = {
        "relative_amplitude_uncertainty": np.array([0.01, 0.02]),
        "phase_uncertainty_rad": np.radians([0.5, 0.25]),
        "power_share_unmodulated_uncertainty": 0.00021,
        "cut_off_uncertainty_hz": 1.23e6,
        "histories": 1234567, "share_by_scattering_order": [0.5, 0.25, 0.125],
        "interrupted": True, "heavy_tailed": True,
    }  # fmt: skip
    backscatter._print("Tank", response(**more))
    assert printed()[2:] == [
        "10 0.9000 +- 0.0100 10.00 +- 0.50", "20 0.7500 +- 0.0200 -20.50 +- 0.25",
        "Received of the unmodulated light: 0.01234 +- 0.0002",
        "Cut-off at 1/sqrt 2: 56.78 +- 1.23 MHz; free fit: 60.12 MHz",
        "1,234,567 photons; orders of scattering 1, 2, 3, ...: 0.50, 0.25, 0.12",
        "Interrupted before the error was reached.",
        "Single photons outweigh the error stated: treat it as too small.",
    ]  # fmt: skip
    more |= {"interrupted": False, "heavy_tailed": False}
    backscatter._print("Tank", response(**more))
    assert len(printed()) == 7


@pytest.mark.parametrize(
    ("count", "rows"), [(1, 1), (12, 12), (23, 23), (24, 12), (200, 13)]
)
def test_about_a_dozen_frequencies_are_printed(printed, count: int, rows: int) -> None:
    """Evenly, beginning with the first one."""
    frequencies = np.arange(1, count + 1) * 1e6
    ones = np.ones(count)
    more = {
        "modulation_frequency_hz": frequencies, "relative_amplitude": ones,
        "phase_rad": ones,
    }  # fmt: skip
    backscatter._print("Tank", response(**more))
    lines = [line for line in printed() if line.endswith("1.0000 57.30")]
    assert len(lines) == rows
    step = max(1, count // 12)
    assert [float(line.split()[0]) for line in lines] == [
        pytest.approx(number, rel=6e-3) for number in range(1, count + 1, step)
    ]


def test_the_remaining_time_falls_with_the_square_of_the_error() -> None:
    """Twice the wanted error takes four times as long as so far, less so far."""
    state = Named(relative_error=0.02, seconds=10.0)
    assert backscatter._time_left(state, 0.01) == "30 s left, "
    assert backscatter._time_left(state, 0.04) == "0 s left, "
    state.relative_error = math.inf
    assert backscatter._time_left(state, 0.01) == ""


def low_pass(frequencies: Any) -> Any:
    """Return a low pass of 30 MHz with a delay, and a tenth of the light."""
    f = np.asarray(frequencies, dtype=float)
    return 0.1 / (1 + 1j * f / 30e6)


def test_a_formula_has_its_cut_off_and_its_fit(monkeypatch) -> None:
    """A low pass of the first order falls to 1 / sqrt 2 at its frequency."""
    from amulor.simulation import backscatter as models

    for name in ("diffusion", "small_angle", "closure"):
        monkeypatch.setattr(
            models, f"{name}_response",
            lambda survey, f, name=name: low_pass(f) * (1 if survey == name else 0),
        )  # fmt: skip
    frequencies = np.linspace(5e6, 60e6, 12)
    for name in ("diffusion", "small-angle", "closure"):
        survey: Any = name.replace("-", "_")
        found = backscatter._formula(survey, frequencies, model=name)
        assert found["model"] == name
        assert found["power_share_unmodulated"] == pytest.approx(0.1)
        assert found["cut_off_hz"] == pytest.approx(30e6, rel=1e-3)
        assert found["fitted_cut_off_hz"] == pytest.approx(30e6, rel=1e-2)
        assert found["relative_amplitude"] == pytest.approx(
            abs(low_pass(frequencies)) / 0.1
        )
        assert found["phase_rad"] == pytest.approx(np.angle(low_pass(frequencies)))
    two = backscatter._formula(survey, frequencies[:2], model="closure")
    assert two["fitted_cut_off_hz"] is None
    dark: Any = "none"
    none = backscatter._formula(dark, frequencies, model="closure")
    assert none["power_share_unmodulated"] == 0
    assert math.isnan(none["cut_off_hz"])
    assert none["relative_amplitude"].tolist() == [0.0] * 12


def test_photons_answer_at_the_asked_frequencies(monkeypatch) -> None:
    """They are followed at rising frequencies from 0 on, each once."""
    from amulor.simulation import transport

    asked: list[Any] = []
    shares: list[Any] = []

    def respond(survey: Any, rising: Any, **more: Any) -> Any:
        more.pop("progress")(Named(relative_error=0.04, seconds=1.0, histories=5000))
        asked.append((survey, rising.tolist(), more))
        return Named(
            signal=low_pass(rising), amplitude_uncertainty=1e-3 * (1 + np.arange(3)),
            phase_uncertainty=np.array([0.0, 0.1, 0.2]),
            by_part={"water 1": low_pass([0.0]) / 2, "target": low_pass([0.0])},
            histories=9, interrupted=False, heavy_tailed=True,
        )  # fmt: skip

    @contextmanager
    def bar(*, quiet: bool) -> Any:
        yield lambda *words: shares.append(words)

    monkeypatch.setattr(backscatter, "progress_bar", bar)
    monkeypatch.setattr(transport, "monte_carlo_response", respond)
    monkeypatch.setattr(transport, "half_power", lambda tally: (3e7, 1e5))
    monkeypatch.setattr(
        transport, "relative_amplitude_uncertainty", lambda t: np.array([0.0, 0.3, 0.4])
    )
    survey: Any = "survey"
    found = backscatter._followed(
        survey, np.array([40e6, 20e6]), error=0.02, seed=7, quiet=True, spread=None
    )
    assert asked == [
        ("survey", [0.0, 20e6, 40e6],
         {"relative_error": 0.02, "seed": 7, "spread": None}),
    ]  # fmt: skip
    assert shares == [
        ("first photons", 0.0),
        ("error 4 %, 3 s left, 5,000 photons", pytest.approx(0.25)),
    ]
    assert found["relative_amplitude"] == pytest.approx(
        abs(low_pass([40e6, 20e6])) / 0.1
    )
    assert found["relative_amplitude_uncertainty"].tolist() == [0.4, 0.3]
    assert found["phase_uncertainty_rad"].tolist() == [0.2, 0.1]
    assert found["phase_rad"] == pytest.approx(np.angle(low_pass([40e6, 20e6])))
    assert found["power_share_unmodulated_uncertainty"] == 1e-3
    assert (found["cut_off_hz"], found["cut_off_uncertainty_hz"]) == (3e7, 1e5)
    assert found["fitted_cut_off_hz"] is None
    assert found["share_by_scattering_order"] == [pytest.approx(0.5)]
    assert (found["histories"], found["seed"]) == (9, 7)
    assert (found["interrupted"], found["heavy_tailed"]) == (False, True)


def test_a_receiver_without_light_is_an_error_of_the_survey(
    inputs, monkeypatch, capsys
):
    """The file is named before the reason; an interrupt ends with 130."""
    found = response(power_share_unmodulated=0)
    monkeypatch.setattr(Survey, "from_toml", lambda path: Named(name="Tank"))
    monkeypatch.setattr(backscatter, "_formula", lambda *_, **__: found)
    assert main(["backscatter", "s.toml"]) == 1
    message = "amulor: s.toml: the receiver gets no light from this water; check"
    assert capsys.readouterr().err.startswith(message)
    found["power_share_unmodulated"] = 0.1
    assert main(["backscatter", "s.toml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["model"] == "closure"
    found["interrupted"] = True
    assert main(["backscatter", "s.toml"]) == 130
    found["power_share_unmodulated"] = 0
    with pytest.raises(SurveyError, match=r"^s\.toml: "):
        backscatter.backscatter(Path("s.toml"))


def scene(name: str, *, quick: bool = False) -> Any:
    """Return a scene of the benchmark."""
    return Named(name=name, title=f"title of {name}", quick=quick)


@pytest.fixture
def scenes(inputs: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the words with which the benchmark is run."""
    calls: list[Any] = []
    place = "amulor.studies.benchmark"

    def run(path: Path, chosen: Any, names: Any, *, done: Any) -> list[Any]:
        calls.append((path, [one.name for one in chosen], names))
        done(Named(scene="a", method="joint"), 1, 4)
        return [record(scene="a")]

    read = lambda path=None: [scene(path or "a", quick=True), scene("b")]  # noqa: E731
    monkeypatch.setattr(f"{place}.scenes.read", read)
    monkeypatch.setattr(f"{place}.table.run", run)
    monkeypatch.setattr(
        f"{place}.figure.figure",
        lambda rows: Named(savefig=lambda file, format: Path(file).write_text(format)),
    )
    for name, value in (
        ("page", "page"), ("row_cells", ["1"]), ("tally_rows", [["2"]]),
        ("regret_text", "regret"),
    ):  # fmt: skip
        monkeypatch.setattr(
            f"{place}.summary.{name}", lambda *_, value=value, **__: value
        )
    monkeypatch.setattr(
        f"{place}.summary.ROW_HEADER", ["row of one scene and one method"]
    )
    monkeypatch.setattr(f"{place}.summary.TALLY_HEADER", ["tally"])
    return calls


def test_a_benchmark_writes_table_figure_and_page(scenes, printed) -> None:
    """All scenes and methods by default; files of an earlier run are replaced."""
    for _ in range(2):
        assert main(["benchmark", "-o", "out"]) == 0
    names = rejection.names()
    assert scenes[0] == (Path("out/benchmark.csv"), ["a", "b"], names)
    assert Path("out/benchmark.svg").read_text() == "svg"
    assert Path("out/benchmark.md").read_text() == "page"
    lines = [f"2 scenes, {len(names)} methods",
        "row of one scene and one method", "1", "Methods", "tally", "2",
             "regret", "Table, figure and page: out"]  # fmt: skip
    assert printed() == lines * 2


def test_a_benchmark_has_the_scenes_and_methods_that_are_named(scenes, capsys) -> None:
    """Names are taken once; a method may go without shots."""
    words = ["--scenes", "b, b,a", "--methods", "joint,auto without shots", "--json"]
    assert main(["benchmark", *words]) == 0
    assert json.loads(capsys.readouterr().out) == [{"scene": "a"}]
    assert scenes == [
        (Path("benchmark/benchmark.csv"), ["b", "a"], ("joint", "auto without shots"))
    ]  # fmt: skip
    assert main(["benchmark", "--quick", "--list"]) == 0
    assert capsys.readouterr().out == f"{'a':<42} title of a\n"
    for words, message in (
        (["--scenes", "a,c"], "--scenes: there is no scene 'c'; --list prints the sce"),
        (["--methods", "odd"], "--methods: there is no method 'odd'; installed are"),
        (["--scenes", "b", "--quick"], "--quick: none of these scenes is in the quick"),
    ):
        assert main(["benchmark", *words]) == 2
        assert message in capsys.readouterr().err
    assert main(["benchmark", "--scenes", "none.toml"]) == 1
    assert "none.toml does not exist" in capsys.readouterr().err
    names = [one.name for one in benchmark._scenes("s.toml")]
    assert names == [Path("s.toml"), "b"]


def test_work_is_done_beside_the_main_thread() -> None:
    """Results and errors come back."""
    assert reproduce_command._interruptible(lambda: 3) == 3

    def fail() -> None:
        raise SurveyError("bad")

    with pytest.raises(SurveyError, match="bad"):
        reproduce_command._interruptible(fail)


def test_an_interrupt_leaves_at_once(monkeypatch, capsys) -> None:
    """Workers are killed, and nothing is written."""
    import multiprocessing
    import os

    ended: list[Any] = []
    worker = Named(kill=lambda: ended.append("killed"))
    monkeypatch.setattr(multiprocessing, "active_children", lambda: [worker])
    monkeypatch.setattr(os, "_exit", ended.append)
    monkeypatch.setattr(
        "multiprocessing.util._exit_function", lambda: ended.append("semaphores")
    )
    reproduce_command._leave()
    assert ended == ["killed", "semaphores", 130]
    assert capsys.readouterr().err == "amulor: interrupted\n"


@pytest.fixture
def redrawn(inputs: Path, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Return the words with which figures are redrawn."""
    from amulor.studies.ricci2010 import reproduce, results

    calls: list[Any] = []
    outcome = Named(
        figures=[Named(number=3, title="T", checks=["c"])], dependence="d",
        plain=lambda: {"figures": 1},
    )  # fmt: skip
    calls.append(outcome)
    monkeypatch.setattr("amulor._extras.require", lambda *w, **m: calls.append((w, m)))
    monkeypatch.setattr(reproduce, "check_outputs", lambda *_, **__: None)
    monkeypatch.setattr(
        reproduce, "run", lambda *w, **m: calls.append((w, m)) or outcome
    )
    monkeypatch.setattr(reproduce, "write", lambda *w, **m: calls.append((w, m)))
    monkeypatch.setattr(
        results, "check_rows",
        lambda checks: [("S", "P", "1", "2", "holds"), ("R", "", "3", "4", "fails")],
    )  # fmt: skip
    monkeypatch.setattr(results, "dependence_rows", lambda d: [(7, "S", "state", "x")])
    monkeypatch.setattr(results, "tally", lambda checks: f"tally of {list(checks)}")
    return calls


def test_figures_are_redrawn_with_checks(redrawn, capsys) -> None:
    """Conclusions that flip are a section of their own."""
    assert main(["reproduce", "ricci2010", "-o", "out", "--figure", "3"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "Figure 3. T",
        "  holds       S (P)", "              found 1; needed 2",
        "  fails       R", "              found 3; needed 4",
        "",
        "Conclusions that flip when one number goes to an end of its range",
        "  figure 7    S", "              state; flips at x",
        "",
        "tally of ['c']", "Report: out/report.html",
    ]  # fmt: skip
    needed, (numbers, how), (written, _) = redrawn[1:]
    assert needed == ((), {"purpose": "redrawing these figures"})
    del how["progress"]
    assert numbers == ((3,),)
    assert how == {
        "quick": False, "depend": True, "rng": 1, "scheduler": None,
        "folder": Path("out/varied"),
    }  # fmt: skip
    assert written == (Path("out"), redrawn[0])


@pytest.mark.parametrize(("figure", "extras"), [(7, ("mie",)), (12, ("mie",)), (8, ())])
def test_figures_of_milk_need_an_extra(redrawn, capsys, figure, extras) -> None:
    """A quick run varies no numbers, and a cluster needs its own extra."""
    redrawn[0].dependence = None
    words = ["reproduce", "ricci2010", "--figure", str(figure), "--json"]
    assert main([*words, "--quick", "--seed", "5"]) == 0
    assert json.loads(capsys.readouterr().out) == {"figures": 1}
    assert redrawn[1][0] == extras
    assert (redrawn[2][1]["depend"], redrawn[2][1]["rng"]) == (False, 5)
    assert main([*words, "--scheduler", "local", "-o", "new"]) == 0
    assert redrawn[5] == (("scale",), {"purpose": "a cluster"})
    assert Path("new").is_dir()
    assert main([*words, "--no-sensitivity", "--scheduler", "local"]) == 2
