"""Files that a survey refers to, relative to the survey file."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from pydantic import BaseModel, ValidationError

from amulor.errors import SurveyError
from amulor.survey.quantity import Description

_Described = TypeVar("_Described", bound=Description)


@runtime_checkable
class NamesFile(Protocol):
    """Interface of survey sections that name a file."""

    def settled(self, folder: Path, *, where: str) -> Any:
        """Return a copy with the full path of the file, or with its content."""
        ...


def settled(description: _Described, folder: Path, *, where: str) -> _Described:
    """Return a survey section with full paths of meshes and contents of table files."""
    copy = _settled(description, folder, where=f"{where}: ", path="")
    return copy  # type: ignore[no-any-return]


def _settled(value: Any, folder: Path, *, where: str, path: str) -> Any:
    def below(part: str) -> str:
        return f"{path}.{part}" if path else part

    if isinstance(value, tuple):
        items = tuple(
            _settled(item, folder, where=where, path=below(str(number)))
            for number, item in enumerate(value)
        )
        same = all(a is b for a, b in zip(items, value, strict=True))
        return value if same else items
    if not isinstance(value, Description):
        return value
    changes = {}
    for name in type(value).model_fields:
        old = getattr(value, name)
        new = _settled(old, folder, where=where, path=below(name))
        if new is not old:
            changes[name] = new
    if changes:
        value = value.model_copy(update=changes)
    if isinstance(value, NamesFile):
        return value.settled(folder, where=f"{where}{path}")
    return value


_Model = TypeVar("_Model", bound=BaseModel)
#: Largest number in a table; peaks of phase functions are far smaller [1].
_LARGEST = 1e15
_SIZE_LIMIT = 1_000_000


def columns(path: Path, *, count: int, where: str) -> list[list[float]]:
    """Return the columns of a text file of numbers."""
    needed = f"needed is a text of {count} columns of numbers"
    try:
        if path.stat().st_size > _SIZE_LIMIT:
            raise SurveyError(f"{where}: {path} has more than 1 MB; {needed}")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise SurveyError(
            f"{where}: {path} cannot be read ({error.strerror}); check the name"
        ) from None
    except UnicodeDecodeError:
        raise SurveyError(f"{where}: {path} is no text; {needed}") from None
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        parts = line.partition("#")[0].replace(",", " ").split()
        if not parts:
            continue
        try:
            row = [float(part) for part in parts]
        except ValueError:
            row = []
        if len(row) != count or not np.all(np.isfinite(row)):
            raise SurveyError(
                f"{where}: {path}, line {number}: found {line.strip()[:60]!r}; {needed}"
            )
        if max(map(abs, row)) > _LARGEST:
            raise SurveyError(
                f"{where}: {path}, line {number}: found {max(row, key=abs):g}; no "
                f"angle and no share of light is beyond {_LARGEST:.0e}"
            )
        rows.append(row)
    if not rows:
        raise SurveyError(f"{where}: {path} holds no numbers; {needed}")
    return [list(column) for column in zip(*rows, strict=True)]


def validated(model: type[_Model], content: Any, *, where: str) -> _Model:
    """Validate a table as a survey section; SurveyError with the first problem."""
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        reason = first.get("ctx", {}).get("error", first["msg"])
        raise SurveyError(f"{where}: {reason}") from None
