import json
import runpy
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
history = runpy.run_path(str(BENCHMARKS / "history.py"))


def test_a_run_is_one_line_with_commit_and_machine(tmp_path: Path) -> None:
    file = tmp_path / "history.jsonl"
    for seconds in (1.0, 0.5):
        history["append"]("time_nothing", {"nothing_s": seconds}, file=file)
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    assert [line["figures"] for line in lines] == [{"nothing_s": 1}, {"nothing_s": 0.5}]
    for line in lines:
        assert line["benchmark"] == "time_nothing"
        assert line["processor"]
        assert line["cores"] >= 1
        assert line["commit"] == history["commit"]()
    text = history["table"](lines)
    assert text.count("time_nothing") == 2
    assert "nothing_s" in text


@pytest.mark.parametrize("script", sorted(p.stem for p in BENCHMARKS.glob("time_*.py")))
def test_every_benchmark_leaves_its_figures(script: str) -> None:
    text = (BENCHMARKS / f"{script}.py").read_text()
    assert f'history.append("{script}", ' in text
