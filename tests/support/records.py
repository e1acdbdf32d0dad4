"""Records of fields as data classes, in place of results that take long to compute."""

from __future__ import annotations

from dataclasses import make_dataclass
from typing import Any


def record(**fields: Any) -> Any:
    """Return a data class with these fields and values."""
    return make_dataclass("Record", list(fields))(**fields)
