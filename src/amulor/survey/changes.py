"""Changes of fields of a description, each field by its path."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from amulor.errors import SurveyError


def changed(content: Any, changes: Mapping[str, Any], *, name: str) -> Any:
    """Return the content of a description with some values changed.

    Examples
    --------
    >>> changed({"water": {"salinity": 0}}, {"water.salinity": 35}, name="survey")
    {'water': {'salinity': 35}}
    """
    result = _plain(content)
    for path in changes:
        for nested in changes:
            if nested.startswith(f"{path}."):
                raise SurveyError(
                    f"{name}: {nested}: is a part of {path}, which is changed as well; "
                    f"state it in the new {path}"
                )
    for path, value in changes.items():
        *parents, last = path.split(".")
        table = result
        for depth, part in enumerate(parents, start=1):
            table = _at(table, part, path=".".join(parents[:depth]), name=name)
            if not isinstance(table, dict | list):
                missing = "is not there" if table is None else "is no table"
                raise SurveyError(
                    f"{name}: {path}: cannot be changed, since "
                    f"{'.'.join(parents[:depth])} {missing}; state it as a whole"
                )
        if isinstance(table, list):
            _at(table, last, path=path, name=name)
            table[int(last)] = _plain(value)
        else:
            table[last] = _plain(value)
    return result


def _at(table: Any, part: str, *, path: str, name: str) -> Any:
    """Return the entry of a table or list at one part of a path."""
    if isinstance(table, dict):
        return table.get(part)
    if not part.isdigit() or int(part) >= len(table):
        raise SurveyError(
            f"{name}: {path}: found {part!r}, but it must be the number of an item, "
            f"from 0 to {len(table) - 1}"
        )
    return table[int(part)]


def _plain(value: Any) -> Any:
    """Return copies of tables and lists, as in a file."""
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    dump = getattr(value, "model_dump", None)
    return value if dump is None else _plain(dump(exclude_none=True))
