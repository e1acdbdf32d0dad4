"""Sections of a devices file, as its validation gets them."""

from __future__ import annotations

from typing import Any

LINKED = {"address": "somewhere"}


def device_sections(**parts: Any) -> dict[str, Any]:
    """Return a lock-in, a scanner and a laser without polarizers, or other parts."""
    return {
        "lock_in": {"driver": "sr844", **LINKED},
        "scanner": {"driver": "pi_gcs", **LINKED},
        "launch": {"driver": "none"},
        "analyser": {"driver": "none"},
        "target": {"driver": "none"},
        "laser": {"driver": "lock_in_output"},
        **parts,
    }
