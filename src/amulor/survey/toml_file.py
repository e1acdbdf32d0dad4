"""Reads descriptions from TOML files, with one line for each thing that is wrong."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from amulor.errors import AmulorError
from amulor.survey import messages

Model = TypeVar("Model", bound=BaseModel)


def text_of(path: str | Path, *, error: type[AmulorError]) -> str:
    """Return the text of a TOML file.

    Parameters
    ----------
    path : str or pathlib.Path
        The file.
    error : type
        What is raised if it cannot be read.

    Returns
    -------
    str
        Without a byte order mark.
    """
    path = Path(path)
    try:
        return path.read_text("utf-8-sig")
    except OSError as found:
        raise error(
            f"{path}: cannot be read ({found.strerror}); check the name"
        ) from None
    except UnicodeDecodeError as found:
        raise error(f"{path}: is no valid TOML: {found}") from None


def described(
    text: str,
    model: type[Model],
    *,
    name: str,
    what: str,
    error: type[AmulorError],
) -> Model:
    """Return what the text of a TOML file describes.

    Parameters
    ----------
    text : str
        TOML.
    model : type
        What it stands for.
    name : str
        What messages call it, such as the file.
    what : str
        What it describes, with its article.
    error : type
        What is raised, with one line for each thing that is wrong.

    Returns
    -------
    model
        In SI units.
    """
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as found:
        raise error(f"{name}: is no valid TOML: {found}") from None
    try:
        model_of_text = model.model_validate(content, context={"from_text": True})
    except ValidationError as found:
        lines = messages.lines(found, content, model=model, name=name, what=what)
        raise error("\n".join(lines)) from None
    for path in _paths(model_of_text.model_dump(mode="python")):
        # The operating system would refuse to look for it, in its own words.
        if "\0" in str(path) or any(len(os.fsencode(p)) > 255 for p in path.parts):
            raise error(f"{name}: {str(path)[:60]!r} is no name that a file can have")
    return model_of_text


def _paths(content: Any) -> Iterator[Path]:
    """Yield all names of files in a description."""
    if isinstance(content, Path):
        yield content
    elif isinstance(content, dict | list | tuple):
        for item in content.values() if isinstance(content, dict) else content:
            yield from _paths(item)
