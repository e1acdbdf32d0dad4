"""Table of instrument errors: written at once, continued, and counted."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from amulor.studies.trust import instrument
from amulor.studies.trust.__main__ import main
from amulor.studies.trust.instrument import InstrumentRow, Key


def _key(kind: str = "walk", size: float = 1.0, **others: object) -> Key:
    usual: dict[str, object] = {"count": 2, "state": "wrong", "method": "auto"}
    return Key(kind=kind, size=size, **(usual | others))  # type: ignore[arg-type]


def _row(key: Key, **others: object) -> InstrumentRow:
    usual: dict[str, object] = dict.fromkeys(
        ("inside", "far", "worst", "mean", "stated"), 1.0
    )
    usual |= {"trusted": 100.0, "tests": (), "cause": "none"}
    return InstrumentRow(key=key, **(usual | others))  # type: ignore[arg-type]


REFUSED = dict.fromkeys(("inside", "far", "worst", "mean", "stated"), math.nan)
ROWS = [
    _row(_key(), inside=97.5, far=0.0, mean=-1.25, cause="right", tests=("channels",)),
    _row(_key("harmonic"), inside=40.0, far=2.0, trusted=50.0),
    _row(
        _key("leakage, scan"),
        **REFUSED,
        trusted=0.0,
        tests=("refused",),
        cause="wrong",
    ),
    _row(_key("perfect"), tests=("drift", "methods"), cause="wrong"),
    _row(_key("perfect", seed=2)),
]


def test_rows_are_read_as_they_were_written() -> None:
    rows = {row.key: row for row in instrument.written(instrument.text(ROWS))}
    assert len(rows) == len(ROWS)
    assert rows[_key()] == ROWS[0]
    assert rows[_key("perfect")].tests == ("drift", "methods")
    refused = rows[_key("leakage, scan")]
    assert math.isnan(refused.inside)
    assert refused.tests == ("refused",)
    with pytest.raises(ValueError, match="no table"):
        list(instrument.written("nothing"))


def test_requirements_causes_and_false_alarms_are_counted() -> None:
    complete, others = instrument.counts(ROWS).split("\n\n")
    assert len(complete.splitlines()) == 2
    (counted,) = others.splitlines()[2:]
    # Inside: 97.5 % of 100 and 40 % of 50 pixels; far off: 2 % of 50 of 150.
    assert [cell.strip() for cell in counted.split("|")[1:-1]] == [
        "`auto`",
        "2",
        "a third of it",
        "3",
        "1",
        "1",
        "78.3 %",
        "1",
        "0.67 %",
    ]
    alone = _row(_key(method="open-water"))
    (line,) = instrument.counts([alone]).splitlines()[2:]
    assert [cell.strip() for cell in line.split("|")[1:4]] == [
        "a third of it",
        "typical",
        "1",
    ]
    assert instrument.suggestions(ROWS) == (1, 2)
    assert instrument.false_alarms(ROWS) == (1, 2)


def test_earlier_errors_stand_beside_those_of_the_table() -> None:
    key = _key("harmonic", state="uncalibrated", count=1)
    image = _row(key, inside=99.5, mean=3.25, stated=18.9, trusted=97.4)
    refused = _row(
        _key("walk", state="uncalibrated"), **REFUSED, trusted=0.0, tests=("refused",)
    )
    lines = instrument.before_and_after([image, refused, *ROWS]).splitlines()[2:]
    assert [[cell.strip() for cell in line.split("|")[2:-1]] for line in lines] == [
        ["2", "100 %, +0.1 mm", "rejected", "", ""],
        ["1", "18 %, +3.2 mm", "99.5 %, +3.2 mm", "97 %", "18.9 mm"],
    ]


def test_an_interrupted_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "table.txt"
    keys = [_key(), _key("harmonic"), _key("perfect")]
    calls: list[Key] = []

    def measured(key: Key, _: object) -> InstrumentRow:
        calls.append(key)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return _row(key)

    monkeypatch.setattr(instrument, "measured", measured)
    monkeypatch.setattr(instrument, "case", lambda *_: None)
    with pytest.raises(KeyboardInterrupt):
        instrument.run(file, keys)
    with file.open("a", encoding="utf-8") as broken:
        broken.write("perfect           1   2 wro")
    rows = instrument.run(file, keys)
    assert calls == [*keys, keys[2]]
    assert [row.key for row in rows] == [_key(), _key("harmonic"), _key("perfect")]
    instrument.run(file, keys)
    assert len(calls) == 4
    assert len(list(instrument.written(file.read_text(encoding="utf-8")))) == 3


def test_the_command_measures_one_case_and_counts_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "table.txt"
    options = ["--scenes", "instrument", "--scene", "phase drift", "--size", "1"]
    options += ["--frequencies", "1", "--state", "wrong", "--method", "open-water"]
    assert main([*options, "--output", str(file)]) == 0
    (row,) = instrument.written(file.read_text(encoding="utf-8"))
    assert row.key == _key("phase drift", count=1, method="open-water")
    # References show a drift of one degree.
    assert row.tests == ("drift",)
    assert row.cause == "right"
    capsys.readouterr()
    assert main(["--count", str(file)]) == 0
    out = capsys.readouterr().out
    assert out.startswith(instrument.counts([row]))
    assert out.endswith(instrument.before_and_after([]))


def test_the_page_shows_what_the_table_says() -> None:
    folder = Path(__file__).parents[4] / "docs/trust"
    table = (folder / "instrument.txt").read_text(encoding="utf-8")
    rows = list(instrument.written(table))
    page = (folder / "README.md").read_text(encoding="utf-8")
    for table in instrument.counts(rows).split("\n\n"):
        assert table.strip() in page
    assert instrument.before_and_after(rows) in page
    words = " ".join(page.split())
    errors = [row for row in rows if row.key.method == "open-water"]
    right, suggested = instrument.suggestions(errors)
    assert f"right in {right} of {suggested} cases" in words
    failed, perfect = instrument.false_alarms(rows)
    assert f"fails in {failed} of {perfect} scans" in words
