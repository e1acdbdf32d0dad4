"""False alarms of the instrument tests: the table, its counts, and one scan."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from amulor.studies.trust import false_alarms
from amulor.studies.trust.__main__ import main
from amulor.studies.trust.false_alarms import AlarmRow, scene


def _row(number: int, *alarms: str, inside: float = 90.0) -> AlarmRow:
    return AlarmRow(
        scene=scene(number), trusted=100.0, inside=inside, worst=2.5, alarms=alarms
    )


def test_a_table_is_read_as_it_was_written() -> None:
    rows = [_row(5), _row(0, "water", "WATER_CHANGED"), _row(1, "refused")]
    rows[2] = replace(rows[2], trusted=0.0, inside=float("nan"), worst=float("nan"))
    content = false_alarms.text(rows)
    again = list(false_alarms.written(content))
    assert [row.scene.number for row in again] == [0, 1, 5]
    assert again[0] == rows[1]
    assert again[1].alarms == ("refused",)
    assert again[1].inside != again[1].inside
    # The rest of an interrupted line is no row.
    assert len(list(false_alarms.written(content[:-5]))) == 2


def test_frequencies_and_methods_take_turns() -> None:
    pairs = {(scene(n).method, scene(n).count) for n in range(11)}
    # Three numbers of frequencies for four methods; joint estimation needs two.
    assert len(pairs) == 11
    assert ("joint", 1) not in pairs
    assert scene(7) == scene(7)
    assert len({scene(n).distance for n in range(40)}) > 20


def test_a_refusal_is_no_alarm_and_a_failed_test_is() -> None:
    rows = [_row(0), _row(11, "frequencies", inside=100.0), _row(1, "refused")]
    assert [row.scene.number for row in false_alarms.false_alarms(rows)] == [11]
    table = false_alarms.counts(rows)
    # 11 scans are one turn, so the scans 0, 1 and 11 have the first method.
    assert "| `open-water` | 3 | 1 | 1 | 100 % | 93.3 % |" in table
    assert "| all | 3 | 1 | 1 |" in table


def test_the_command_continues_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "perfect.txt"
    file.write_text(false_alarms.text([_row(0)]), encoding="utf-8")
    monkeypatch.setattr(false_alarms, "SCANS", 2)
    assert main(["--scenes", "perfect", "--output", str(file)]) == 0
    first, second = false_alarms.written(file.read_text(encoding="utf-8"))
    assert first == _row(0)
    assert second.scene == scene(1)
    # A perfect instrument and a correct survey.
    assert second.trusted > 50
    assert second.worst < 5
    assert second.alarms == ()
    capsys.readouterr()
    assert main(["--count", str(file)]) == 0
    assert "| all | 2 | 0 | 0 |" in capsys.readouterr().out


def test_the_page_shows_the_table_of_perfect_scans() -> None:
    folder = Path(__file__).parents[4] / "docs/trust"
    rows = list(false_alarms.written((folder / "perfect.txt").read_text("utf-8")))
    assert [row.scene for row in rows] == [scene(n) for n in range(false_alarms.SCANS)]
    page = (folder / "README.md").read_text(encoding="utf-8")
    assert false_alarms.counts(rows) in page
    alarms = len(false_alarms.false_alarms(rows))
    assert "No scan fails a test." in page
    # The exact upper limit for no event in 300 trials.
    assert alarms == 0
    assert 1 - 0.05 ** (1 / len(rows)) < 0.01
