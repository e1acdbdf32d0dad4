"""Reads descriptions from TOML files, with one line for each thing that is wrong."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TypeVar

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
        return model.model_validate(content, context={"from_text": True})
    except ValidationError as found:
        lines = messages.lines(found, content, model=model, name=name, what=what)
        raise error("\n".join(lines)) from None
