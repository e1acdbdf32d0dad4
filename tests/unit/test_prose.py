"""The check of the English of pages and docstrings finds what it is meant to find."""

from __future__ import annotations

from pathlib import Path

import pytest
from scripts import script

prose = script("tools/prose.py")
LONG = "Long " * 31


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (f"{LONG.strip()}.", "31 words"),
        (f"- an item\n- {LONG.strip()}.", "31 words"),
        ("It has 1, 2, 3 and 4.", "4 numbers"),
        ("The water was taken out.", "is subtracted"),
        ("Two polarisation channels.", "-ize"),
        ("Ten millimetres.", "-meter"),
    ],
)
def test_a_fault_of_a_page_is_found(text: str, found: str) -> None:
    (line,) = prose.page(f"# Title\n\nPlain text. {text}\n")
    assert found in line


@pytest.mark.parametrize(
    "text",
    [
        "Short. " * 40,
        "It has 1, 2 and 3.",
        f"| a | b |\n| --- | --- |\n| {LONG} | 1, 2, 3, 4, 5 |",
        f"```text\n{LONG} 1, 2, 3, 4 was taken out\n```",
        "`--was-taken-out 1 2 3 4` and [a link](page-1-2-3-4.md).",
        "By equations (1), (2), (3), (4) and 2 1/m.",
    ],
)
def test_tables_code_and_short_sentences_pass(text: str) -> None:
    assert list(prose.page(text)) == []


def test_openings_of_docstrings_are_found() -> None:
    text = '"""Scans."""\n\ndef f():\n    """What a scan came to."""\n\n'
    assert len(list(prose.module(text))) == 1
    assert list(prose.module(text.replace("What a scan came to", "Result"))) == []


def test_a_fault_ends_with_an_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"{LONG}.\n")
    assert prose.main([str(page)]) == 1
    assert "31 words" in capsys.readouterr().out
    page.write_text("Short.\n")
    assert prose.main([str(page)]) == 0


def test_what_is_excused_is_there_and_the_summary_pages_are_not() -> None:
    listed = prose.EXCUSED.read_text().split()
    assert [each for each in listed if not (prose.ROOT / each).exists()] == []
    for name in ("README.md", "docs/trust/README.md", "docs/how-to/reject.md"):
        assert not prose.excused(prose.ROOT / name)
