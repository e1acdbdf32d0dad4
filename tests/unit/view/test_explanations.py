"""Every flag and message is explained, with limits that are those of the code."""

from __future__ import annotations

import json
import re

import pytest
from scipy.stats import chi2, norm

from amulor.acquisition.sampler import SampleFlag
from amulor.cli import main
from amulor.cube import UNUSABLE, QualityFlag, WaterResidualCause
from amulor.cube.schema import TERMS, flag_words
from amulor.errors import FormatError
from amulor.rejection import quality
from amulor.view import explanations
from amulor.view.page.progress import Change, Drift, Going, advice


def test_every_flag_and_term_is_explained() -> None:
    known = explanations.explanations()
    words = flag_words()
    for table, flags in (
        ("pixel", QualityFlag), ("cause", WaterResidualCause), ("sample", SampleFlag),
    ):  # fmt: skip
        names = [str(flag.name) for flag in flags if flag]
        assert names == list(words[table])
        assert set(names) <= set(known)
    assert {f"TERM_{name.upper()}" for name in TERMS} <= set(known)
    for one in known.values():
        assert one.meaning.endswith(".")
        assert one.compared
        assert one.remedy
    for flag in QualityFlag:
        if flag:
            gone = known[str(flag.name)].consequence == "The pixel has no range."
            assert gone == bool(flag & UNUSABLE)


def test_limits_and_chances_are_those_of_the_code(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known = explanations.explanations()

    def chance(name: str) -> float:
        found = re.search(r"in (?:at most )?1 of ([\d,]+) ", known[name].chance)
        assert found, known[name].chance
        return 1 / float(found[1].replace(",", ""))

    # Two parts of a signal, each with noise of one: chi-square of two degrees.
    assert chance("NO_TARGET") == pytest.approx(chi2.sf(5.0**2, 2), rel=0.06)
    assert chance("MIXED") == pytest.approx(norm.sf(3.5), rel=0.06)
    said = known["NO_TARGET"].chance
    monkeypatch.setattr(quality, "DETECTION_THRESHOLD", 4.0)
    changed = explanations.explanations()["NO_TARGET"]
    assert "4 standard errors" in changed.compared
    assert changed.chance != said


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("WATER_RESIDUAL", "WATER_RESIDUAL"),
        ("water residual", "WATER_RESIDUAL"),
        ("Water-Residual", "WATER_RESIDUAL"),
        ("12 mixed; 3 outlier", "MIXED"),
        ("open water drifted +4.1 % (± 0.8 %): take a reference", "OPEN_WATER_DRIFTED"),
        (
            "the newest shots of open water jumped -9.0 % (± 1 %): take a reference",
            "OPEN_WATER_DRIFTED",
        ),
        ("no open water", "NO_OPEN_WATER"),
        ("NO_OPEN_WATR", "NO_OPEN_WATER"),
        *((words["short"], name) for name, words in flag_words()["pixel"].items()),
    ],
)
def test_names_and_messages_find_their_explanation(words: str, name: str) -> None:
    assert explanations.find(words)[0].name == name


def test_everything_that_a_scan_is_told_is_explained() -> None:
    going = Going(
        running=True, done=100, scanned=50, open_water=0, dark=0, rate=10.0,
        silent=1000.0, total=200, resume="amulor acquire", reason="paused",
        drift=Drift(total=Change(size=0.2, error=0.01, chance=1e-9)),
    )  # fmt: skip
    said = advice(going)
    assert len(said) == 5
    found = [explanations.find(line)[0].name for line in said]
    assert found == [
        "SCAN_STOPPED", "NO_SAMPLE", "OPEN_WATER_DRIFTED", "NO_OPEN_WATER_SHOTS",
        "NO_DARK_READINGS",
    ]  # fmt: skip


def test_what_nobody_knows_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(FormatError, match="there are MISSING"):
        explanations.find("xyzzy")
    assert main(["explain", "xyzzy"]) == 1
    assert capsys.readouterr().err.startswith("amulor: nothing is known of")
    assert main(["explain", "water", "residual"]) == 0
    assert "what to do:" in capsys.readouterr().out
    assert main(["explain"]) == 0
    listed = capsys.readouterr().out
    assert "pixel flags" in listed
    assert "  MIXED" in listed
    assert main(["explain", "MIXED", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["MIXED"]["kind"] == "pixel flag"
