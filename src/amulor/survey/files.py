"""Looks for the files that a survey names, each beside the survey itself."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol, TypeVar, runtime_checkable

from amulor.survey.quantity import Description

_Described = TypeVar("_Described", bound=Description)


@runtime_checkable
class NamesFile(Protocol):
    """A description that names a file."""

    def settled(self, folder: Path, *, where: str) -> Any:
        """Return the same, for whoever is in another folder.

        Parameters
        ----------
        folder : pathlib.Path
            Where the file is looked for.
        where : str
            What messages call the description.

        Returns
        -------
        Description
            Of the same class.
        """
        ...


def settled(description: _Described, folder: Path, *, where: str) -> _Described:
    """Return a description whose files are found, or read, wherever they are named.

    Parameters
    ----------
    description : Description
        A survey, or a part of one.
    folder : pathlib.Path
        Where its files are looked for.
    where : str
        What messages call it.

    Returns
    -------
    Description
        The same object if it names no file.

    Raises
    ------
    SurveyError
        If a file is not there or cannot be used.
    """
    found = _settled(description, folder, where=f"{where}: ", path="")
    return found  # type: ignore[no-any-return]


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
