"""Messages for wrong words on the command line."""

from __future__ import annotations

from cyclopts.exceptions import (
    CoercionError,
    CycloptsError,
    MissingArgumentError,
    UnknownOptionError,
    UnusedCliTokensError,
)

_NUMBERS = {int: "a whole number", float: "a number"}


def message(error: CycloptsError, example: str) -> str:
    """Return one line: command, what is wrong, and an example of the command."""
    command = " ".join(error.command_chain or ())
    text = f"{command}: {_reason(error)}" if command else _reason(error)
    usage = (MissingArgumentError, UnknownOptionError, UnusedCliTokensError)
    if not example or not isinstance(error, usage):
        return text
    return f"{text if text[-1] in '.?' else text + '.'} Example: {example}"


def _reason(error: CycloptsError) -> str:
    """Return the reason of an error without the name of the command."""
    usual = " ".join(str(error).split())
    argument = error.argument
    if isinstance(error, UnusedCliTokensError):
        return f"too many arguments: {' '.join(error.unused_tokens or [])}"
    if argument is None:
        return usual
    name = argument.name
    if type(error) is MissingArgumentError:
        if getattr(error, "keyword", None) or argument.tokens:
            return f"{name} needs a value"
        _, _, suggestion = usual.partition(" Did you mean ")
        end = f"; did you mean {suggestion}" if suggestion else ""
        return f"{name} is missing{end}"
    token = getattr(error, "token", None)
    if isinstance(error, CoercionError) and token and error.target_type in _NUMBERS:
        needed = _NUMBERS[error.target_type]
        return f"{name}: found {token.value!r}, needed is {needed}"
    return usual
