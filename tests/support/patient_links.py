"""Simulated instruments on ports are waited for, however busy the machine is."""

from __future__ import annotations

import pytest

from amulor.acquisition import rehearsal
from amulor.acquisition.settings import Settings

#: How long an answer may take where a test states nothing else [s].
_PATIENCE = 120.0


@pytest.fixture(autouse=True)
def links_are_patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let devices files of rehearsals have a long time for each answer."""
    addressed = rehearsal._addressed

    def patient(*words: object) -> Settings:
        content = addressed(*words).model_dump(exclude_unset=True)  # type: ignore
        for part in content.values():
            if isinstance(part, dict) and part.get("address"):
                part.setdefault("timeout", _PATIENCE)
        return Settings.model_validate(content)

    monkeypatch.setattr(rehearsal, "_addressed", patient)
