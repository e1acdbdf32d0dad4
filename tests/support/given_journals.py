"""Journals of a scan with given samples, as if devices had measured them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from amulor import cube
from amulor.acquisition.journal.journal import Journal
from amulor.acquisition.journal.record import Record
from amulor.acquisition.plan import SCAN, Key
from amulor.survey import Survey

RECORD = Record(
    in_phase=1e-3, quadrature=-2e-3, mean=None, readings=1, full_scale=1.0, flags=0,
    commanded_azimuth=0.1, commanded_elevation=-0.1, azimuth=0.11, elevation=-0.12,
    modulation_frequency=39e6, elapsed=1.5, segment=1,
)  # fmt: skip


def record(signal: complex = 1e-3 - 2e-3j, **changes: Any) -> Record:
    """Return a record of a signal [V]."""
    signal = complex(signal)
    parts = {"in_phase": signal.real, "quadrature": signal.imag}
    return Record(**{**vars(RECORD), **parts, **changes})


def key(
    kind: str = SCAN, row: int = 0, column: int = 0, pair: str = "VV",
    *, frequency: float = 39e6, repeat: int = 0,
) -> Key:  # fmt: skip
    """Return the key of a sample."""
    return Key(kind, row, column, frequency, pair, repeat)


def journal_of(
    folder: Path,
    survey: Survey,
    entries: Iterable[tuple[Key, Record]],
    *,
    devices: str = "",
    identities: Any = None,
    **meta: str,
) -> Journal:
    """Return an open journal of a scan that holds these samples."""
    folder.mkdir(exist_ok=True)
    text = survey.to_toml()
    journal = Journal.create(
        folder,
        meta={
            "survey": text,
            "survey_digest": cube.digest(text),
            "devices": devices,
            "instrument_digest": "sha256:2222",
            "identities": json.dumps(identities or {"lock_in": "a lock-in"}),
            **meta,
        },
    )
    journal.commit_together([*entries])
    return journal
