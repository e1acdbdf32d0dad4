"""The frame of the study: its numbers, its memory, checks and sensitivity."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from amulor.cli import main
from amulor.errors import SurveyError
from amulor.studies.ricci2010 import parameters, reproduce, results
from amulor.studies.ricci2010.figures import figure_01
from amulor.studies.ricci2010.results import Check, Statements, holds, within
from amulor.studies.ricci2010.sensitivity import sensitivity
from amulor.studies.ricci2010.study import Study

ENTRY = """
[width]
value = "2 cm"
quantity = "length"
basis = "assumed"
range = ["1 cm", "4 cm"]
reason = "for the test"
[height]
value = "3 m"
quantity = "length"
basis = "text"
reason = "printed"
[depth]
value = "5 m"
quantity = "length"
basis = "deduced"
range = ["5 m", "6 m"]
reason = "for the test"
"""


def test_numbers_have_units_a_basis_and_a_range() -> None:
    found = parameters.parse(ENTRY)
    assert found["width"].value == 0.02
    assert found["width"].limits == (0.01, 0.04)
    assert found["height"].limits is None
    assert list(found) == ["width", "height", "depth"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('basis = "assumed"', 'basis = "guessed"', "text, deduced or assumed"),
        ('reason = "printed"', "", "missing or unknown reason"),
        ('reason = "printed"', 'reason = "printed"\nsource = 1', "source"),
        ('"1 cm", "4 cm"', '"3 cm", "4 cm"', "outside its range"),
        ('"1 cm", "4 cm"', '"2 cm", "2 cm"', "outside its range"),
        ('basis = "text"', 'basis = "assumed"', "a printed number has no range"),
        ('"3 m"', '"3 s"', "length"),
    ],
)
def test_an_entry_that_is_wrong_is_refused(old: str, new: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        parameters.parse(ENTRY.replace(old, new))


def test_every_number_of_the_paper_says_where_it_is_from() -> None:
    every = parameters.load()
    assert {p.basis for p in every.values()} == {"text", "deduced", "assumed"}
    for entry in every.values():
        assert len(entry.reason) > 10, entry.name
        assert math.isfinite(entry.value)


def test_results_are_shared_until_a_number_they_read_changes() -> None:
    calls = []

    def area(study: Study) -> float:
        calls.append(1)
        return study["width"] * study["height"]

    numbers = parameters.parse(ENTRY)
    study = Study(numbers)
    names, first = study.read_by(lambda s: s.once(area))
    assert (first, names) == (0.06, {"width", "height"})
    # Remembered results say what they read, too.
    names, again = study.read_by(lambda s: s.once(area))
    assert (again, names, len(calls)) == (0.06, {"width", "height"}, 1)
    other = study.with_parameters(parameters.varied(numbers, "depth", 6.0))
    assert (other.once(area), len(calls)) == (0.06, 1)
    other = study.with_parameters(parameters.varied(numbers, "width", 0.04))
    assert (other.once(area), len(calls)) == (0.12, 2)
    assert (study.once(area), len(calls)) == (0.06, 2)


def test_noise_is_the_same_for_a_label_and_another_for_others() -> None:
    study = Study(parameters.parse(ENTRY))
    a, b = (study.rng("a").standard_normal(100) for _ in range(2))
    assert np.array_equal(a, b)
    assert abs(np.corrcoef(a, study.rng("b").standard_normal(100))[0, 1]) < 0.4
    other = Study(parameters.parse(ENTRY), rng=2).rng("a").standard_normal(100)
    assert abs(np.corrcoef(a, other)[0, 1]) < 0.4


@pytest.mark.parametrize(
    ("value", "passes"), [(1.0, True), (2.0, True), (2.1, False), (math.nan, False)]
)
def test_a_number_passes_between_its_limits(value: float, passes: bool) -> None:
    check = within("x", value, 1.0, 2.0, place="here", unit="m", uncertainty=0.1)
    assert check.passed is passes
    assert "± 0.1 m" in check.found
    assert check.wanted == "1 to 2 m"
    assert within("x", 1.0, -math.inf, 2.0, place="").wanted == "at most 2"
    assert within("x", 1.0, 2.0, math.inf, place="").wanted == "at least 2"


def test_a_row_of_statements_takes_words_limits_and_a_note() -> None:
    row = {"statement": "{count} m wide", "place": "section {count}", "low": 1.0}
    rows = Statements("title", "caption", {"width": {**row, "unit": "m"}})
    check = rows.within("width", 1.5, high=2.0, note=" (measured)", count=3)
    assert (check.statement, check.place) == ("3 m wide", "section 3")
    assert (check.found, check.wanted) == ("1.5 m (measured)", "1 to 2 m")
    assert (check.passed, check.role) == (True, "test")
    assert not rows.within("width", 0.5, high=2.0, count=3).passed


def _checks(study: Study) -> list[Check]:
    if study["width"] > 0.03:
        raise SurveyError("too wide")
    return [
        within("narrow", study["width"], 0.0, 0.025, place="here"),
        within("not too narrow", study["width"], 0.015, 1.0, place=""),
        holds("always", True, place="here", found="yes", wanted="yes", role="set"),
    ]


def test_a_cluster_varies_numbers_as_one_machine_does(tmp_path: Path) -> None:
    from distributed import LocalCluster

    study = Study(parameters.parse(ENTRY))
    here = sensitivity(study, {3: _checks})
    size = {"threads_per_worker": 1, "processes": False, "dashboard_address": None}
    content = []
    for count in (1, 2):
        folder = tmp_path / str(count)
        with LocalCluster(n_workers=count, **size) as cluster:
            where = {"scheduler": cluster.scheduler_address, "folder": folder}
            assert sensitivity(study, {3: _checks}, **where) == here
            files = sorted(folder.rglob("end.json"))
            whole = [path.read_bytes() for path in files]
            times = [path.stat().st_mtime_ns for path in files]
            files[1].write_bytes(whole[1].replace(b"true", b"false"))
            assert sensitivity(study, {3: _checks}, **where) == here
        assert [path.read_bytes() for path in files] == whole
        # The damaged one is made again, the other is kept.
        again = [path.stat().st_mtime_ns for path in files]
        assert [new != old for new, old in zip(again, times, strict=True)] == [
            False,
            True,
        ]
        content.append(whole)
    assert content[0] == content[1]


def test_a_conclusion_that_flips_is_said_to_flip() -> None:
    study = Study(parameters.parse(ENTRY))
    narrow, not_narrow, always = sensitivity(study, {3: _checks})
    # 4 cm cannot be computed, so nothing holds there; depth and height are not read.
    assert [c.parameter for c in narrow.changes] == ["width", "width"]
    assert [f.shown for f in narrow.flips] == ["4 cm"]
    assert [f.shown for f in not_narrow.flips] == ["1 cm", "4 cm"]
    assert "cannot be computed: too wide" in always.flips[0].found
    assert narrow.strongest is not None
    assert narrow.strongest.shown == "1 cm"
    rows = results.dependence_rows([narrow, not_narrow, always])
    assert rows[1] == ["3", "not too narrow", "holds", "width = 1 cm; width = 4 cm"]


def test_the_tally_counts_set_statements_and_those_of_ours_apart() -> None:
    checks = _checks(Study(parameters.parse(ENTRY)))
    text = results.tally(checks)
    assert text.startswith("1 of 1 statements of the paper hold. For 1 more")
    assert text.endswith("the paper does not state, and 1 of these hold.")


def test_a_statement_of_the_paper_says_where_it_stands_there() -> None:
    assert [c.role for c in _checks(Study(parameters.parse(ENTRY)))] == [
        "test",
        "own",
        "set",
    ]
    with pytest.raises(ValueError, match="says where it stands"):
        within("x", 1.0, 0.0, 2.0, place="", role="set")
    with pytest.raises(ValueError, match="says where it stands"):
        within("x", 1.0, 0.0, 2.0, place="section 7", role="own")


def test_every_figure_is_there_with_a_caption() -> None:
    assert reproduce.FIGURES == (1, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
    with pytest.raises(ValueError, match="figure 2 is a drawing"):
        reproduce.run([2])


def test_wrong_use_of_the_command_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["reproduce", "ricci2010", "--output", str(tmp_path), "--quick"]
    assert main([*words, "--figure", "2"]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    (tmp_path / "figure_09.svg").write_text("mine")
    assert main([*words, "--figure", "9"]) == 1
    assert "figure_09.svg exists already" in capsys.readouterr().err
    assert (tmp_path / "figure_09.svg").read_text() == "mine"
    assert main(["reproduce", "ricci2011"]) == 2


@pytest.mark.slow
def test_the_command_writes_pictures_checks_and_a_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "out"
    words = ["reproduce", "ricci2010", "--output", str(folder), "--quick"]
    assert main([*words, "--figure", "9"]) == 0
    text = capsys.readouterr().out
    assert "Figure 9. Contrast" in text
    assert "statements of the paper hold" in text
    names = {"figure_09.png", "figure_09.svg", "checks.json", "report.html"}
    assert {path.name for path in folder.iterdir()} == names
    written = json.loads((folder / "checks.json").read_text())
    assert [figure["number"] for figure in written["figures"]] == [9]
    assert len(written["parameters"]) == len(parameters.load())
    assert "synthetic" in (folder / "figure_09.svg").read_text()


@pytest.mark.slow
def test_several_processes_find_what_one_finds() -> None:
    chosen = {
        name: entry
        for name, entry in parameters.load().items()
        if entry.limits is None or name in ("receiver_radius", "acceptance")
    }
    fixed = {
        name: replace(entry, limits=None, shown_limits=None)
        for name, entry in parameters.load().items()
        if name not in chosen
    }
    study = Study({**fixed, **chosen}, quick=True)
    one, several = (
        sensitivity(study, {1: figure_01.checks}, workers=workers) for workers in (1, 2)
    )
    assert one == several
    # A receiver of 5 cm is near enough to 20 cm to see light right at the instrument.
    assert [flip.shown for entry in one for flip in entry.flips].count("5 cm") == 1
