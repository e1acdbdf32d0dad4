"""Changes some fields of a description, each named by its path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from amulor.errors import SurveyError


def changed(content: Any, changes: Mapping[str, Any], *, name: str) -> Any:
    """Return the content of a description with other values in some places.

    Examples
    --------
    >>> changed({"water": {"salinity": 0}}, {"water.salinity": 35}, name="survey")
    {'water': {'salinity': 35}}
    """
    result = _plain(content)
    for path in changes:
        for other in changes:
            if other.startswith(f"{path}."):
                raise SurveyError(
                    f"{name}: {other}: is a part of {path}, which is changed as well; "
                    f"state it in the new {path}"
                )
    for path, value in changes.items():
        *way, last = path.split(".")
        here = result
        for depth, part in enumerate(way, start=1):
            here = _at(here, part, path=".".join(way[:depth]), name=name)
            if not isinstance(here, dict | list):
                missing = "is not there" if here is None else "is no table"
                raise SurveyError(
                    f"{name}: {path}: cannot be changed, since "
                    f"{'.'.join(way[:depth])} {missing}; state it as a whole"
                )
        if isinstance(here, list):
            _at(here, last, path=path, name=name)
            here[int(last)] = _plain(value)
        else:
            here[last] = _plain(value)
    return result


def _at(here: Any, part: str, *, path: str, name: str) -> Any:
    """Return what a table or list holds under one part of a path."""
    if isinstance(here, dict):
        return here.get(part)
    if not part.isdigit() or int(part) >= len(here):
        raise SurveyError(
            f"{name}: {path}: found {part!r}, but it must be the number of an item, "
            f"from 0 to {len(here) - 1}"
        )
    return here[int(part)]


def _plain(value: Any) -> Any:
    """Return tables and lists of their own, as a file has them."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    dump = getattr(value, "model_dump", None)
    return value if dump is None else _plain(dump(exclude_none=True))
