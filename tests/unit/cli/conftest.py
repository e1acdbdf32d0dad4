"""Lines that commands print, and a temporary folder with inputs to run them in."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from amulor.cli import _arguments, _output, demo, export, patch_test, simulate


@pytest.fixture
def printed(capsys: pytest.CaptureFixture[str]) -> Callable[[], list[str]]:
    """Return a function that returns the lines printed so far, without more spaces."""

    def lines() -> list[str]:
        out = capsys.readouterr().out.splitlines()
        plain = (re.sub("[│┃┏┳┓┡╇┩└┴┘━─]+", " ", line) for line in out)
        return [" ".join(line.split()) for line in plain if line.strip()]

    return lines


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder, which is temporary."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def inputs(
    request: pytest.FixtureRequest, here: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """Return the current folder with the empty INPUTS of a file of tests.

    They are not looked into.
    """
    for name in request.module.INPUTS:
        (here / name).touch()
    monkeypatch.setattr(_arguments, "check_small", lambda path: None)
    return here


@pytest.fixture
def next_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    """Print the next command in a pipe, too."""
    for module in (_output, demo, export, patch_test, simulate):
        monkeypatch.setattr(
            module, "print_next", lambda command: print(f"next: {command}")
        )
