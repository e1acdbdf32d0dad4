"""The page for newcomers leads where it says."""

import importlib
import re
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "CONTRIBUTING.md").read_text()
ROWS = re.findall(r"^\| (.+\?) \| (.+) \| (.+) \|$", PAGE, flags=re.MULTILINE)


def _named(name: str) -> Any:
    """Return what a dotted name stands for: attributes first, as a reader would."""
    found: Any = importlib.import_module("amulor")
    path = "amulor"
    for part in name.split(".")[1:]:
        path = f"{path}.{part}"
        module = not hasattr(found, part)
        found = importlib.import_module(path) if module else getattr(found, part)
    return found


def test_each_question_is_answered() -> None:
    assert len(ROWS) == 11


@pytest.mark.parametrize(("question", "files", "names"), ROWS)
def test_the_answer_is_there(question: str, files: str, names: str) -> None:
    paths = re.findall(r"`(src/[^`]+)`", files)
    # Two hops at most: one file, or one and the next.
    assert 1 <= len(paths) <= 2
    for path in paths:
        assert (ROOT / path).exists(), path
    texts = "".join((ROOT / p).read_text() for p in paths if (ROOT / p).is_file())
    for name in re.findall(r"`(amulor\.[^`]+)`", names):
        found = _named(name)
        assert callable(found)
        place = ROOT / "src" / f"{found.__module__.replace('.', '/')}.py"
        # What is named is defined in a file of the row, or used there.
        assert any(
            place == ROOT / path or place.is_relative_to(ROOT / path) for path in paths
        ) or re.search(rf"\b{found.__name__}\b", texts), name


@pytest.mark.parametrize("target", re.findall(r"^\$ make (\w+)", PAGE, re.M))
def test_the_targets_of_make_exist(target: str) -> None:
    makefile = (ROOT / "Makefile").read_text()
    assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
