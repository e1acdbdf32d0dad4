"""Messages of errors that no test names.

A message is named if a test has three of its words in a row, or two of a message that
has no more. `tests/reference/unnamed_messages.txt` lists the others, of which most only
pass on the text of another error; it must not grow.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LISTING = ROOT / "tests" / "reference" / "unnamed_messages.txt"
#: Errors that are no messages: they end a wait or a thread.
SILENT = ("KeyboardInterrupt", "NotImplementedError", "_BufferIsFull", "_Ended")


def _words(text: str) -> list[str]:
    return re.sub(r"[^a-z0-9]+", " ", text.lower()).split()


def _messages(file: Path) -> Iterator[tuple[str, list[list[str]]]]:
    """Yield the kind of each error that a file raises, and the words of its text."""
    for node in ast.walk(ast.parse(file.read_text("utf-8"))):
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            kind = ast.unparse(node.exc.func)
            texts = [
                _words(part.value)
                for part in ast.walk(node.exc)
                if isinstance(part, ast.Constant) and isinstance(part.value, str)
            ]
            if kind not in SILENT:
                yield kind, texts


def _unnamed() -> set[str]:
    """Return the messages that no test names."""
    joined = " ".join(
        # Texts of two lines are one.
        re.sub(r"[\"']\s*\n\s*[rf]*[\"']", "", path.read_text("utf-8"))
        for path in sorted((ROOT / "tests").rglob("*.py"))
    )
    named = " ".join(_words(joined))
    unnamed = set()
    for file in sorted((ROOT / "src" / "amulor").rglob("*.py")):
        if "studies" in file.parts:
            continue
        for kind, texts in _messages(file):
            runs = [
                " ".join(text[start : start + 3])
                for text in texts
                for start in range(max(len(text) - 2, 1))
                if len(text) > 1
            ]
            if not any(f" {run} " in named for run in runs):
                words = " ".join(word for text in texts for word in text)
                place = file.relative_to(ROOT / "src" / "amulor").as_posix()
                unnamed.add(f"{place}: {kind} {words[:60]}".strip())
    return unnamed


@pytest.mark.slow
def test_messages_that_no_test_names_are_those_of_the_listing() -> None:
    unnamed = _unnamed()
    listed = set(LISTING.read_text("utf-8").splitlines())
    assert sorted(unnamed - listed) == [], "test these messages, or list them"
    assert sorted(listed - unnamed) == [], "take these out of the listing"
