"""Reads tables of numbers that a survey names, with errors that say where."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import BaseModel, ValidationError

from amulor.errors import SurveyError

_Model = TypeVar("_Model", bound=BaseModel)
#: Largest number of a table: peaks of phase functions stay far below [1].
_LARGEST = 1e15
_SIZE_LIMIT = 1_000_000


def columns(path: Path, *, count: int, where: str) -> list[list[float]]:
    """Return the columns of a table of numbers.

    Parameters
    ----------
    path : pathlib.Path
        Text with commas or spaces between numbers and # before notes.
    count : int
        How many columns it must have.
    where : str
        What messages call the field that names it.

    Returns
    -------
    list of list of float
        As many as asked for.

    Raises
    ------
    SurveyError
        If there is no such file, or no such table in it.
    """
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
    """Return a description made of a table, its mistakes in one line.

    Parameters
    ----------
    model : type
        What is described.
    content : dict
        Its fields.
    where : str
        What messages call it.

    Returns
    -------
    model
        The description.

    Raises
    ------
    SurveyError
        If the table is not allowed.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        reason = first.get("ctx", {}).get("error", first["msg"])
        raise SurveyError(f"{where}: {reason}") from None
