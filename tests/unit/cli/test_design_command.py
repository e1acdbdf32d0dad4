"""`amulor design`: files that are written, and what is computed on request."""

from __future__ import annotations

import json
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from amulor import design as designing
from amulor.cli import design as commands
from amulor.cli import main
from amulor.design import Goal

Named: Any = SimpleNamespace


class Bench:
    """Recommendation of a candidate, and what is made of it."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: list[Any] = []
        self.parts: list[Any] = []
        self.found = Named(
            best=Named(survey="best"), runner_up=Named(survey="second"),
            to_dict=lambda: {"best": 1},
        )  # fmt: skip
        monkeypatch.setattr(Goal, "from_toml", lambda path: f"goal {path}")
        monkeypatch.setattr(designing, "recommend", lambda goal: self.found)
        monkeypatch.setattr("amulor._progress.part", self._part)
        for name in ("reasons_of", "write_all", "_print", "print_reasons", "serve"):
            monkeypatch.setattr(commands, name, self._of(name))
        monkeypatch.setattr(commands, "explorer_of", lambda *words: "explorer")
        monkeypatch.setattr(
            commands, "as_json", lambda found, reasons: {"all": reasons}
        )

    @contextmanager
    def _part(self, begin: float, end: float) -> Any:
        self.parts.append((begin, end))
        yield

    def _of(self, name: str) -> Any:
        def called(*words: Any, **more: Any) -> str:
            self.calls.append((name, words[1:], more))
            return name

        return called


@pytest.fixture
def bench(here: Path, monkeypatch: pytest.MonkeyPatch) -> Bench:
    """Return a recommendation in a temporary folder with a goal."""
    (here / "g.toml").touch()
    return Bench(monkeypatch)


def test_a_survey_is_written_for_the_best_instrument(bench: Bench) -> None:
    """Reasons are computed on request only."""
    assert main(["design", "g.toml", "-o", "s.toml"]) == 0
    assert Path("s.toml").read_text() == "best"
    files = [Path("s.toml")]
    assert bench.calls == [
        ("_print", (files,), {}), ("print_reasons", (None, None, None), {})
    ]  # fmt: skip
    assert bench.parts == [(0.0, 1.0)]


def test_a_survey_is_written_for_the_runner_up(bench: Bench) -> None:
    """Without a runner-up there is no second file."""
    words = ["design", "g.toml", "-o", "s.toml", "--runner-up", "r.toml"]
    assert main(words) == 0
    assert (Path("s.toml").read_text(), Path("r.toml").read_text()) == (
        "best",
        "second",
    )
    assert bench.calls[0] == ("_print", ([Path("s.toml"), Path("r.toml")],), {})
    bench.found.runner_up = None
    Path("r.toml").unlink()
    assert main([*words, "--overwrite"]) == 0
    assert not Path("r.toml").exists()


@pytest.mark.parametrize(
    ("words", "confirm", "report", "figures"),
    [
        (["--confirm"], True, None, None),
        (["--report", "r.html"], False, Path("r.html"), None),
        (["--figures", "f"], False, None, Path("f")),
    ],
)
def test_reasons_are_half_of_the_work(
    bench: Bench, words: list[str], confirm: bool, report: Any, figures: Any
) -> None:
    """Each of three options asks for them."""
    assert main(["design", "g.toml", "-o", "s.toml", *words, "--overwrite"]) == 0
    assert bench.parts == [(0.0, 0.5), (0.5, 1.0)]
    assert [call for call in bench.calls if call[0] != "_print"] == [
        ("reasons_of", (), {"confirm": confirm}),
        ("write_all", ("reasons_of", report, figures), {"overwrite": True}),
        ("print_reasons", ("reasons_of", report, figures), {}),
    ]


def test_a_recommendation_in_json_may_have_reasons(bench: Bench, capsys) -> None:
    """Nothing else is printed."""
    assert main(["design", "g.toml", "-o", "s.toml", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"best": 1}
    assert bench.calls == []
    words = ["-o", "t.toml", "--confirm", "--json"]
    assert main(["design", "g.toml", *words]) == 0
    assert json.loads(capsys.readouterr().out) == {"all": "reasons_of"}


def test_a_page_is_served_without_a_file(bench: Bench) -> None:
    """Port and browser are those of the options."""
    assert main(["design", "g.toml", "--interactive", "--port", "8000"]) == 0
    assert bench.calls[-1] == ("serve", (), {"port": 8000, "browser": False})
    assert list(Path().iterdir()) == [Path("g.toml")]
    words = ["--interactive", "--browser", "-o", "s.toml"]
    assert main(["design", "g.toml", *words]) == 0
    assert bench.calls[-1] == ("serve", (), {"port": 0, "browser": True})


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (["-o", "x.toml"], "x.toml"),
        (["-o", "s.toml", "--runner-up", "x.toml"], "x.toml"),
        (["-o", "s.toml", "--report", "x.html"], "x.html"),
    ],
)
def test_files_of_a_design_are_kept(bench: Bench, capsys, words, name) -> None:
    """They are looked at before the work; the goal is never replaced."""
    Path(name).touch()
    assert main(["design", "g.toml", *words]) == 1
    assert f"{name} exists already" in capsys.readouterr().err
    assert bench.parts == []
    assert main(["design", "g.toml", "-o", "g.toml", "--overwrite"]) == 1
    assert main(["design", "g.toml", *words[:-1], "x.txt"]) == 2


class Parts:
    """Parts of the work that reasons take, and their shares of progress."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *, uncertain: bool) -> None:
        self.shares: list[Any] = []
        self.turns: list[Any] = []
        monkeypatch.setattr("amulor._progress.part", self._part)
        monkeypatch.setattr(
            "amulor._progress.tell", lambda *words: self.shares.append(words)
        )
        place = "amulor.design"
        monkeypatch.setattr(f"{place}.trade.trade", lambda goal, best: ("trade", best))
        monkeypatch.setattr(f"{place}.trade.what_if", self._what_if)
        monkeypatch.setattr(
            f"{place}.sensitivity.uncertain", lambda goal, best: uncertain
        )
        monkeypatch.setattr(f"{place}.sensitivity.sensitivity", lambda *words: words)
        monkeypatch.setattr(
            f"{place}.confirm.confirm", lambda goal, chosen, name: (chosen, name)
        )

    @contextmanager
    def _part(self, begin: float, end: float) -> Any:
        self.shares.append((round(begin, 9), round(end, 9)))
        yield

    def _what_if(self, *words: Any) -> tuple[Any, ...]:
        self.turns.append(words)
        return ("turn",)


def found(*, runner_up: bool) -> Any:
    """Return a recommendation with a runner-up, or without one."""
    return Named(
        goal="goal", best=Named(parameters="best"),
        runner_up=Named(parameters="second") if runner_up else None,
    )  # fmt: skip


def test_reasons_have_trade_sensitivity_and_what_if(monkeypatch) -> None:
    """Without confirmations they are all of the work."""
    parts = Parts(monkeypatch, uncertain=True)
    reasons = commands.reasons_of(found(runner_up=True), confirm=False)
    assert reasons.trade == ("trade", "best")
    assert reasons.sensitivity == ("goal", "best")
    assert reasons.turns == ("turn",)
    assert reasons.confirmations == ()
    assert parts.turns == [("goal", "best", "second")]
    step = ("trade-off of time and frequency", 0.0)
    assert parts.shares == [(0.0, 1.0), step, (0.1, 0.4), (0.4, 1.0)]


def test_confirmations_are_most_of_the_work(monkeypatch) -> None:
    """Both instruments share seven tenths of it; none has a doubtful input."""
    parts = Parts(monkeypatch, uncertain=False)
    reasons = commands.reasons_of(found(runner_up=True), confirm=True)
    assert reasons.sensitivity is None
    assert reasons.confirmations == (("best", "recommended"), ("second", "runner-up"))
    assert [share for share in parts.shares if isinstance(share[0], float)] == [
        (0.0, 0.3), (0.4, 1.0), (0.3, 0.65), (0.65, 1.0)
    ]  # fmt: skip
    parts.shares.clear()
    reasons = commands.reasons_of(found(runner_up=False), confirm=True)
    assert (reasons.turns, parts.turns[1:]) == ((), [])
    assert reasons.confirmations == (("best", "recommended"),)
    assert parts.shares[-1] == (0.3, 1.0)


def test_reasons_in_json_are_finite() -> None:
    """Counts stay counts, and what is not a number is null."""
    reasons: Any = Named(
        sensitivity=Named(to_dict=lambda: {"s": 1}), turns=(Named(label="x"),),
        trade=Named(number=3, error=np.array([1.0, np.nan])),
        confirmations=(Named(to_dict=lambda: {"c": 2}),),
    )  # fmt: skip
    recommendation: Any = Named(to_dict=lambda: {"best": 1})
    content = commands.as_json(recommendation, reasons)
    assert content == {
        "best": 1, "sensitivity": {"s": 1}, "what_if": [{"label": "x"}],
        "trade": {"number": 3, "error": [1.0, None]}, "confirmation": [{"c": 2}],
    }  # fmt: skip
    reasons.sensitivity = None
    assert commands.as_json(recommendation, reasons)["sensitivity"] is None


def requirement(name: str, *, met: bool, margin: float) -> Any:
    """Return a requirement."""
    return Named(name=name, met=met, margin=margin)


def test_of_requirements_that_are_met_the_tightest_is_told() -> None:
    """Of a kind that is missed somewhere, all missed ones are told."""
    near = requirement("range at 1 m", met=True, margin=0.5)
    far = requirement("range at 3 m", met=True, margin=0.1)
    slow = requirement("time", met=True, margin=0.9)
    missed = [
        requirement(f"noise at {k} m", met=k == 1, margin=1 - k) for k in (1, 2, 3)
    ]
    assert commands._told((near, far, slow, *missed)) == [
        (far, 2), (slow, 1), (missed[1], 1), (missed[2], 1)
    ]  # fmt: skip


def test_a_vehicle_of_an_instrument_is_told_in_two_lines(monkeypatch, printed) -> None:
    """Three texts stand in the first line; a kind of two names its number."""
    place = "amulor.design.requirements"
    texts = {"speed": "1", "lines": "2", "rows": "3", "smear": "4", "time": "5"}
    monkeypatch.setattr(f"{place}.lines_texts", lambda lines, parameters: texts)
    monkeypatch.setattr(f"{place}.parameters_text", lambda value: value)
    monkeypatch.setattr(f"{place}.quantity_text", lambda name, value: f"{value:g}")
    kinds = [
        Named(name=f"range at {k} m", met=True, margin=k, value=k, limit=9, binding="")
        for k in (1, 2)
    ]
    choice: Any = Named(
        parameters="P", cost=0.0, error=1.5e-3, worst_distance=2.5, share=0.875,
        scan_time=90.0, binding="shot_noise", lines="lines", requirements=tuple(kinds),
        shares=Named(error=0.98, even=1.0, share=(0.5, 0.5)),
    )  # fmt: skip
    commands._print_choice("best", choice, 2e-3)
    assert printed() == [
        "best: P",
        "total error 1.5 mm of 2 mm at 2.5 m, accuracy met in 88% of the draws; 1.5 "
        "min; largest term: shot noise",
        "vehicle: speed 1; lines 2; rows 3",
        "smear 4; time 5",
        "met: range at 1 m 1 of 9; the tightest of 2 distances",
    ]
    # A dwell that gains 2 % is not worth a line.
    choice.shares.error = 0.979
    choice.lines = None
    commands._print_choice("best", choice, 2e-3)
    assert printed()[2].startswith("dwell shared 50 : 50 between the frequencies: 979")


def test_report_and_figures_are_written_on_request(monkeypatch, tmp_path) -> None:
    """Each figure is a PNG file of its name, in a folder that is made."""
    calls: list[Any] = []
    place = "amulor.view.design.report"
    monkeypatch.setattr(f"{place}.write", lambda *words, **more: calls.append(words[0]))
    monkeypatch.setattr(f"{place}.figures_of", lambda *words: {"map": 1, "time": 2})
    monkeypatch.setattr("amulor.view.report.png", lambda figure: bytes([figure]))
    nothing: Any = None
    commands.write_all(nothing, nothing, None, None, overwrite=False)
    assert calls == []
    report, figures = tmp_path / "r.html", tmp_path / "f"
    commands.write_all(nothing, nothing, report, figures, overwrite=False)
    assert calls == [report]
    content = {path.name: path.read_bytes() for path in figures.iterdir()}
    assert content == {"map.png": b"\1", "time.png": b"\2"}
    written = commands.write_figures(figures, nothing, nothing, overwrite=True)
    assert written == [figures / "map.png", figures / "time.png"]


def test_the_page_begins_with_the_recommended_instrument(monkeypatch) -> None:
    """Each distance is asked for in each water once, the clearest first."""
    from amulor.survey import Survey
    from amulor.view.design import explorer

    made: list[Any] = []
    monkeypatch.setattr(
        "amulor.view.design.report.waters_of", lambda goal, chosen: [2.0, 1.0, 2.0]
    )
    monkeypatch.setattr(Survey, "from_text", lambda text, name: (text, name))
    monkeypatch.setattr(
        explorer, "Explorer", lambda survey, **more: made.append((survey, more))
    )
    goal: Any = Named(
        name="Tank", asked=(1.5, 3.0), accuracy=Named(total_error=2e-3), limits=(1, 3)
    )
    best = Named(parameters=Named(method="joint"), survey="text")
    commands.explorer_of(goal, Named(best=best))
    ((survey, more),) = made
    assert survey == ("text", "Tank")
    assert (more["method"], more["interval"]) == ("joint", (1, 3))
    asked = [(one.distance, one.attenuation, one.accuracy) for one in more["asked"]]
    assert asked == [
        (1.5, 1.0, 2e-3), (1.5, 2.0, 2e-3), (3.0, 1.0, 2e-3), (3.0, 2.0, 2e-3)
    ]  # fmt: skip
