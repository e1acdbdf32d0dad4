"""From a goal file to a range image: the commands that follow one another."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from amulor import io
from amulor.cli import main
from amulor.design import Goal, evaluate
from amulor.survey import Survey

GOALS = Path(__file__).parents[2] / "examples" / "goals"


@pytest.mark.slow
def test_the_survey_that_is_written_runs_to_a_range_image(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    goal = str(GOALS / "paper_milk.toml")
    words = ["design", goal, "-o", "best.toml", "--runner-up", "second.toml", "--json"]
    assert main(words) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["best"]["survey"] == Path("best.toml").read_text("utf-8")
    assert said["runner_up"]["survey"] == Path("second.toml").read_text("utf-8")
    # Less of it is enough to see that it runs.
    few = Survey.from_toml("best.toml").with_({"scan.columns": 20, "scan.rows": 8})
    Path("few.toml").write_text(few.to_toml(), "utf-8")
    assert main(["survey", "check", "best.toml"]) == 0
    assert "warning" not in capsys.readouterr().out
    limits = ["--nearest", "0.5 m", "--farthest", "2 m"]
    for words in (
        ["simulate", "few.toml", "-o", "samples.nc", "--seed", "3"],
        ["reject", "samples.nc", "--method", "open-water", "-o", "target.nc", *limits],
        ["image", "target.nc", "-o", "range.nc", *limits],
    ):
        assert main(words) == 0, words
    image = io.read_cube("range.nc")
    truth = image.amulor.truth["slant_range"].values
    error = image["slant_range"].values - truth
    found = evaluate(
        few,
        distance=1.48,
        method="open-water",
        interval=Goal.from_toml(goal).limits,
        late_light=False,
    )
    predicted = float(found["standard_uncertainty"])
    count = error.size
    assert abs(np.std(error) / predicted - 1) < 0.1 + 3 / np.sqrt(2 * count)


@pytest.mark.slow
def test_the_command_says_what_binds_and_what_must_give(
    tmp_path: Path, monkeypatch, capsys
) -> None:
    monkeypatch.chdir(tmp_path)
    text = (GOALS / "paper_milk.toml").read_text("utf-8")
    Path("goal.toml").write_text(text.replace('"5 mm"', '"1 mm"'), "utf-8")
    assert main(["design", "goal.toml", "-o", "best.toml"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "impossible: total error:" in out
    assert "in place of 1 mm" in out
    assert "nearest to the goal: diode 405 nm, 20 mW; 39 MHz" in out
    assert "largest term: fluctuation" in out
    assert main(["design", "goal.toml", "-o", "best.toml"]) == 1
    assert "exists" in capsys.readouterr().err
