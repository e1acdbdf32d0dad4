"""What commands printed, and a temporary folder to run them in."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest


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
