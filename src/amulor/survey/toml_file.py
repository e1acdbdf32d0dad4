"""Reading of TOML files, and messages for errors in them."""

from __future__ import annotations

import difflib
import json
import os
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from amulor import units
from amulor.errors import AmulorError


def lines(
    error: ValidationError,
    content: Any,
    *,
    model: type[BaseModel],
    name: str,
    what: str = "a survey",
) -> list[str]:
    """Return the validation errors of a file, one line each."""
    problems = error.errors()
    above = {
        problem["loc"][:end]
        for problem in problems
        for end in range(len(problem["loc"]))
    }
    # A list whose items are all wrong counts as empty, which it is not.
    shown = [
        problem
        for problem in problems
        if problem["type"] != "too_short" or problem["loc"] not in above
    ]
    result = [
        _line(problem, content, model, name, what) for problem in shown[:_MOST_LINES]
    ]
    if len(shown) > _MOST_LINES:
        result.append(f"{name}: {len(shown) - _MOST_LINES} further errors are left out")
    return list(dict.fromkeys(result))


#: Errors of a file that are printed.
_MOST_LINES = 20
#: Longest name of a field in a message.
_LONGEST = 100


def _line(
    problem: Mapping[str, Any],
    content: Any,
    model: type[BaseModel],
    name: str,
    what: str,
) -> str:
    location = _location(problem["loc"], content)
    field = ".".join(str(part) for part in location) or what.partition(" ")[2]
    field = field if len(field) <= _LONGEST else f"{field[:_LONGEST]}..."
    kind, bounds = problem["type"], problem.get("ctx", {})
    result = _value_text(location, content)
    if kind == "extra_forbidden":
        allowed = list(_table(location[:-1], content, model).model_fields)
        close = difflib.get_close_matches(str(location[-1]), allowed, n=1)
        hint = f"did you mean {close[0]!r}? " if close else ""
        return (
            f"{name}: {field}: is no field of {what}; {hint}"
            f"allowed here: {', '.join(allowed)}"
        )
    if kind == "missing":
        return f"{name}: {field}: is missing; {_needed(location, content, model)}"
    if kind == "value_error":
        return f"{name}: {field}: {bounds['error']}"
    limit: Any = next(iter(bounds.values()), None)
    if kind in _LIMITS:
        bound = f"{_LIMITS[kind]} {_bound(_at(location, content), limit)}"
        return f"{name}: {field}: found {result}, but it must be {bound}"
    if kind == "literal_error":
        return f"{name}: {field}: found {result}, but it must be {limit}"
    if kind == "string_pattern_mismatch" and "polarizations" not in location:
        return (
            f"{name}: {field}: found {result}; {_description(location, content, model)}"
        )
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        kinds = ", ".join(_kinds_at(location, content, model))
        needed = f"it must be a table with kind = one of {kinds}"
        return f"{name}: {field}: found {result}, but {needed}"
    if kind in _NEEDED:
        return f"{name}: {field}: found {result}, but {_NEEDED[kind]}"
    text = str(problem["msg"])
    return f"{name}: {field}: found {result}; {text[:1].lower()}{text[1:]}"


_LIMITS = {
    "greater_than": "above",
    "greater_than_equal": "at least",
    "less_than": "below",
    "less_than_equal": "at most",
}
_NEEDED = {
    "finite_number": "it must be finite",
    "string_pattern_mismatch": (
        'it must be "none" or two of the letters V, H, P, M, R, L'
    ),
    "too_short": "at least one is needed",
    "tuple_type": "it must be a list, in square brackets",
    "model_type": "it must be a table of fields",
    "model_attributes_type": "it must be a table of fields",
    "string_type": "it must be a text in quotation marks",
    "int_from_float": "it must be a whole number",
    "int_type": "it must be a whole number",
    "float_type": "it must be a number",
}


def _location(loc: tuple[Any, ...], content: Any) -> list[Any]:
    """Return the path of an error in a file, without pydantic's type labels."""
    location: list[Any] = []
    value = content
    for position, part in enumerate(loc):
        last = position == len(loc) - 1
        if isinstance(value, list) and isinstance(part, int):
            location.append(part)
            value = value[part] if part < len(value) else None
        elif isinstance(value, dict) and (part in value or last):
            location.append(part)
            value = value.get(part)
    return location


def _at(location: list[Any], content: Any) -> Any:
    """Return the value at a path in a file; None if there is none."""
    value = content
    for part in location:
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            return None
    return value


def _bound(value: Any, limit: float) -> str:
    """Return a limit as text, in the unit of the value in the file."""
    if isinstance(value, str):
        return units.write_like(limit, value)
    return f"{limit:g} in SI units" if isinstance(value, float) else f"{limit:g}"


def _value_text(location: list[Any], content: Any) -> str:
    value = _at(location, content)
    if value is None:
        return "nothing"
    text = json.dumps(value, default=str)
    return text if len(text) <= 60 else text[:57] + "..."


def _table(
    location: list[Any], content: Any, model: type[BaseModel]
) -> type[BaseModel]:
    """Return the model class of the table at a path in a file."""
    value = content
    annotation: Any = model
    for part in location:
        value = value[part]
        if not isinstance(part, int):  # an item of a list has the kinds of the list
            annotation = model.model_fields[part].annotation
        model = next(
            (
                candidate
                for candidate in _models(annotation)
                if _is_of_kind(value, candidate)
            ),
            model,
        )
    return model


def _models(annotation: Any) -> Iterator[type[BaseModel]]:
    """Yield all model classes within a type annotation."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from _models(part)


def _is_of_kind(table: Any, model: type[BaseModel]) -> bool:
    """Return whether the field `kind` of a table matches a model class."""
    field = model.model_fields.get("kind")
    if field is None or not isinstance(table, dict):
        return True
    if "kind" not in table:
        return not field.is_required()
    return table["kind"] in _kinds(model)


def _kinds(model: type[BaseModel]) -> list[str]:
    """Return the values of `kind` that a model class allows."""

    def texts(annotation: Any) -> Iterator[str]:
        for part in get_args(annotation):
            if isinstance(part, str):
                yield part
            yield from texts(part)

    return list(texts(model.model_fields["kind"].annotation))


def _kinds_at(location: list[Any], content: Any, model: type[BaseModel]) -> list[str]:
    """Return the values of `kind` that a table at a path in a file allows."""
    fields = [part for part in location if not isinstance(part, int)]
    above = location[: location.index(fields[-1])]
    annotation = _table(above, content, model).model_fields[fields[-1]].annotation
    return [
        kind
        for candidate in _models(annotation)
        if "kind" in candidate.model_fields
        for kind in _kinds(candidate)
    ]


def _needed(location: list[Any], content: Any, model: type[BaseModel]) -> str:
    if isinstance(location[-1], int):
        return f"needed are at least {location[-1] + 1} values"
    return _description(location, content, model)


def _description(location: list[Any], content: Any, model: type[BaseModel]) -> str:
    """Return the description of the field at a path, or of its parent."""
    for end in range(len(location) - 1, -1, -1):
        fields = _table(location[:end], content, model).model_fields
        if location[end] in fields:
            text = fields[location[end]].description or "a value"
            return "needed is: " + " ".join(text.split())
    return "needed is a value"


Model = TypeVar("Model", bound=BaseModel)


def text_of(path: str | Path, *, error: type[AmulorError]) -> str:
    """Return the text of a TOML file."""
    path = Path(path)
    try:
        return path.read_text("utf-8-sig")
    except OSError as problem:
        raise error(
            f"{path}: cannot be read ({problem.strerror}); check the name"
        ) from None
    except UnicodeDecodeError as problem:
        raise error(f"{path}: is no valid TOML: {problem}") from None


def read(
    path: str | Path, model: type[Model], *, what: str, error: type[AmulorError]
) -> Model:
    """Read a TOML file and validate it as a model."""
    text = text_of(path, error=error)
    return described(text, model, name=str(Path(path)), what=what, error=error)


def described(
    text: str,
    model: type[Model],
    *,
    name: str,
    what: str,
    error: type[AmulorError],
) -> Model:
    """Parse a TOML text and validate it as a model."""
    content = _content(text, name=name, what=what, error=error)
    try:
        model_of_text = model.model_validate(content, context={"from_text": True})
    except ValidationError as problem:
        complaints = lines(problem, content, model=model, name=name, what=what)
        raise error("\n".join(complaints)) from None
    for path in _paths(model_of_text.model_dump(mode="python")):
        # The operating system would refuse to look for it, in its own words.
        if "\0" in str(path) or any(len(os.fsencode(p)) > 255 for p in path.parts):
            raise error(f"{name}: {str(path)[:60]!r} is no name that a file can have")
    return model_of_text


def _content(
    text: str, *, name: str, what: str, error: type[AmulorError]
) -> dict[str, Any]:
    """Parse a TOML text; raise an error if it is invalid or nested too deeply."""
    deep = f"{name}: is nested deeper than {_DEEPEST} levels, and no part of {what} is"
    for line in text.splitlines():
        # Thousands of dotted keys would take the parser minutes.
        key, equals, _ = line.partition("=")
        is_key = equals or (line.lstrip().startswith("[") and "," not in line)
        if is_key and key.count(".") > _DOTS:
            raise error(deep)
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise error(f"{name}: is no valid TOML: {problem}") from None
    except RecursionError:
        raise error(deep) from None
    except ValueError:  # of an integer with thousands of digits
        raise error(
            f"{name}: has a whole number with more digits than any number of {what}"
        ) from None
    level: list[Any] = [content]
    for _ in range(_DEEPEST):
        level = [
            item
            for part in level
            if isinstance(part, dict | list)
            for item in (part.values() if isinstance(part, dict) else part)
        ]
        if not level:
            return content
    raise error(deep)


#: Deepest level of tables and lists in a description, and most dots of a key.
_DEEPEST, _DOTS = 20, 100


def _paths(content: Any) -> Iterator[Path]:
    """Yield the names of all files that a survey uses."""
    if isinstance(content, Path):
        yield content
    elif isinstance(content, dict | list | tuple):
        for item in content.values() if isinstance(content, dict) else content:
            yield from _paths(item)
