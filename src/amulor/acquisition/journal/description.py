"""What a journal says about its scan, and whether it still says what was written."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path

from amulor import cube
from amulor.errors import FormatError

#: Where the checksums of all other entries stand.
CHECKSUMS = "checksums"
#: Copies beside a journal, by the entry that they are copies of.
_COPIES = {"survey": "survey.toml", "devices": "devices.toml"}


def with_checksums(meta: Mapping[str, str]) -> dict[str, str]:
    """Return entries with the checksums of all of them.

    Parameters
    ----------
    meta : mapping
        Name to text.

    Returns
    -------
    dict
        One entry more.
    """
    own = {name: text for name, text in meta.items() if name != CHECKSUMS}
    sums = {name: _sum(text) for name, text in own.items()}
    return {**own, CHECKSUMS: json.dumps(sums, sort_keys=True)}


def _sum(text: str) -> int:
    return zlib.crc32(text.encode("utf-8", "replace"))


def checked(
    meta: Mapping[str, str], folder: Path, damaged: Callable[[str], None]
) -> dict[str, str]:
    """Return entries, damaged ones from their copies in the folder.

    Parameters
    ----------
    meta : mapping
        As the journal has them.
    folder : pathlib.Path
        Of the scan.
    damaged : callable
        Told in a line about each entry that is not as it was written.

    Returns
    -------
    dict
        As they were written.

    Raises
    ------
    FormatError
        If the survey or the devices are others, and there is no copy of what they were.
    """
    sums = _sums(meta, damaged)
    result = dict(meta)
    for name in sorted({*sums, *_digests(meta)}):
        if name in meta and _as_written(name, meta[name], meta, sums):
            continue
        copy = _copy(folder, name)
        if copy is not None and _as_written(name, copy, meta, sums):
            damaged(f"{name} is damaged; that of {_COPIES[name]} was taken")
            result[name] = copy
            continue
        if name in _COPIES:
            raise FormatError(
                f"{folder}: the {name} in the journal is not what the scan was begun "
                f"with (its checksum or digest is another one), and there is no "
                f"{_COPIES[name]} that is; put a copy of that file there"
            )
        damaged(f"{name} of the description is damaged")
    return result


def _sums(meta: Mapping[str, str], damaged: Callable[[str], None]) -> dict[str, int]:
    if CHECKSUMS not in meta:
        return {}
    try:
        found = json.loads(meta[CHECKSUMS])
        return {str(name): int(value) for name, value in found.items()}
    except (ValueError, TypeError, AttributeError):
        damaged("the checksums of the description are damaged")
        return {}


def _digests(meta: Mapping[str, str]) -> tuple[str, ...]:
    return ("survey",) if {"survey", "survey_digest"} <= {*meta} else ()


def _as_written(
    name: str, text: str, meta: Mapping[str, str], sums: Mapping[str, int]
) -> bool:
    if name in sums and _sum(text) != sums[name]:
        return False
    return name not in _digests(meta) or cube.digest(text) == meta["survey_digest"]


def _copy(folder: Path, name: str) -> str | None:
    if name not in _COPIES:
        return None
    try:
        return (folder / _COPIES[name]).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
