"""What a table of the trust study says is counted as it is written."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from amulor.studies.trust.__main__ import main
from amulor.studies.trust.table import Row, Score, counts, text, written


def _row(scene: str, method: str, **figures: float | str) -> Row:
    usual: dict[str, float | str] = dict.fromkeys(
        ("phantoms", "inside_68", "inside_95", "echo_95", "worst", "far"), math.nan
    )
    usual |= {"trusted": 1.0, "rms": 1e-3, "uncertainty": 1e-3, "note": ""}
    return Row(
        scene=scene,
        count=16,
        method=method,
        score=Score(pixels=384, empty=0, **(usual | figures)),  # type: ignore[arg-type]
    )


TABLE = text(
    [
        _row("flat", "joint, no shots", inside_95=0.95, far=0.0),
        _row("spikes", "open-water", trusted=0.9, inside_95=0.92, far=0.004),
        _row("stairs", "combined", trusted=0.7, inside_95=0.97, far=0.003),
        _row("mixed 2 cm", "combined", inside_95=0.0, far=1.0),
        _row("empty", "polarization", trusted=math.nan, phantoms=0.01),
        _row("harbour", "auto", inside_95=0.93, far=0.0, note="joint"),
        _row("flat", "joint", trusted=0.0, note="refused: one frequency"),
    ]
)


def test_rows_are_read_as_they_were_written() -> None:
    rows = list(written(TABLE + "\n"))
    assert [row.scene for row in rows][:3] == ["flat", "spikes", "stairs"]
    assert rows[0].method == "joint, no shots"
    assert (rows[1].trusted, rows[1].inside, rows[1].far) == (90.0, 92.0, 0.4)
    assert math.isnan(rows[4].trusted)
    assert rows[4].phantom == 1.0
    assert rows[6].refused


def test_each_demand_is_counted() -> None:
    lines = counts(written(TABLE)).splitlines()
    assert [line.split("|")[2:5] for line in lines[2:]] == [
        [" 1 ", " 2 ", " 1 "],  # rows with a target, the mixed one apart
        [" 1 ", " 1 ", " 1 "],  # 80 % trusted
        [" 1 ", " 1 ", " 1 "],  # 93 % inside
        [" 1 ", " 1 ", " 1 "],  # at most 0.3 % far off
        [" 0 ", " 1 ", " 0 "],
        [" 0 ", " 1 ", " 0 "],
    ]


def test_the_command_counts_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "table.txt"
    file.write_text(TABLE, encoding="utf-8")
    assert main(["--count", str(file)]) == 0
    assert capsys.readouterr().out == counts(written(TABLE))
    with pytest.raises(ValueError, match="no table"):
        counts(written("nothing"))


def test_the_page_shows_what_the_table_says() -> None:
    folder = Path(__file__).parents[4] / "docs/trust"
    table = (folder / "default.txt").read_text(encoding="utf-8")
    assert counts(written(table)) in (folder / "details.md").read_text(encoding="utf-8")
