"""List public names, defaults, limits and constants of amulor, for `make surface`.

A public module is one that `__all__` of a package names, from `amulor` down. Its public
names are its `__all__`, or, where it has none, the functions and classes defined in it.
Defaults are those of arguments of public functions, of fields of public classes, and of
the keys of all files that users write. Limits are those of these keys, in SI units.
Constants are all numbers that modules define, such as thresholds.
"""

from __future__ import annotations

import ast
import dataclasses
import hashlib
import importlib
import inspect
import re
import typing
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

REFERENCE = Path(__file__).parents[1] / "tests" / "reference"
LISTING = REFERENCE / "public_surface.txt"
DEFAULTS = REFERENCE / "public_defaults.txt"
CONSTANTS = REFERENCE / "constants.txt"
#: Longest value that the listing of constants contains as text; others have a digest.
_LONGEST = 120


def kind(value: Any) -> str:
    """Return what a reader of the documentation would call it."""
    if inspect.ismodule(value):
        return "module"
    if inspect.isclass(value):
        return "error" if issubclass(value, BaseException) else "class"
    return "function" if callable(value) else "constant"


def names(module: ModuleType) -> list[str]:
    """Return the public names of a module."""
    stated = getattr(module, "__all__", None)
    if stated is not None:
        return sorted(stated)
    return sorted(
        name
        for name, value in vars(module).items()
        if not name.startswith("_")
        and getattr(value, "__module__", None) == module.__name__
        and (inspect.isclass(value) or callable(value))
    )


def surface(module: ModuleType | None = None) -> list[str]:
    """Return "name kind" for all that is public in a module and in those it names."""
    module = module or importlib.import_module("amulor")
    lines = []
    for name in names(module):
        value = getattr(module, name)
        full = f"{module.__name__}.{name}"
        lines.append(f"{full} {kind(value)}")
        if inspect.ismodule(value):
            lines += surface(value)
    return sorted(lines)


def defaults() -> list[str]:
    """Return "name(argument=value)" and "name.field = value" for all defaults."""
    lines = []
    described = {f"{cls.__module__}.{cls.__qualname__}": cls for cls in _descriptions()}
    for line in surface():
        full, _, what = line.rpartition(" ")
        if what in ("function", "class"):
            module, _, name = full.rpartition(".")
            value = getattr(importlib.import_module(module), name)
            if inspect.isclass(value):
                described[f"{value.__module__}.{value.__qualname__}"] = value
            else:
                lines += [f"{full}({entry})" for entry in _arguments(value)]
    for full, cls in described.items():
        lines += [f"{full}.{entry}" for entry in [*_fields(cls), *_limits(cls)]]
    return sorted(set(lines))


def _descriptions() -> list[type]:
    """Return the classes of all tables of TOML files."""
    import amulor
    from amulor.survey.quantity import Description

    # A class exists once its module is imported.
    package = Path(amulor.__file__).parent
    for file in sorted(package.rglob("*.py")):
        if re.search(r"^class \w+\(", file.read_text("utf-8"), re.MULTILINE):
            parts = file.relative_to(package.parent).with_suffix("").parts
            name = ".".join(parts).removesuffix(".__init__")
            if not name.endswith("__main__"):
                importlib.import_module(name)
    classes, waiting = [], [Description]
    while waiting:
        subclasses = waiting.pop().__subclasses__()
        classes += subclasses
        waiting += subclasses
    return [cls for cls in classes if cls.__module__.startswith("amulor.")]


#: A constant of a module, up to the next line without a margin.
_CONSTANT = re.compile(
    r"^(?=\(?_?[A-Z][A-Z0-9_, ]*\)?(?::[^=\n]+)? = (?!\x22{3})).+(?:\n(?:[ )\]}].*)?)*",
    re.MULTILINE,
)


def constants() -> list[str]:
    """Return "file NAME = value" for the constants of all modules with a number."""
    import amulor

    package = Path(amulor.__file__).parent
    lines = []
    for file in sorted(package.rglob("*.py")):
        place = file.relative_to(package).as_posix()
        for found in _CONSTANT.finditer(file.read_text("utf-8")):
            node = ast.parse(found[0]).body[0]
            assert isinstance(node, ast.Assign | ast.AnnAssign)
            assert node.value is not None
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            text = _expression(node.value, found[0])
            if re.search(r"\b\d|\bTrue\b|\bFalse\b", text):
                lines.append(f"{place} {ast.unparse(target)} = {_short(text)}")
    return lines


def _expression(node: ast.expr, source: str) -> str:
    """Return an expression in words that are the same in all versions of Python."""
    if any(isinstance(part, ast.JoinedStr) for part in ast.walk(node)):
        # From 3.12 on, f-strings are written with other quotes.
        return " ".join((ast.get_source_segment(source, node) or "").split())
    return ast.unparse(node)


def _short(text: str) -> str:
    """Return a text, or its begin and its digest if it is long."""
    if len(text) <= _LONGEST:
        return text
    digest = hashlib.sha256(text.encode()).hexdigest()
    return f"{text[: _LONGEST // 2]}... {digest[:16]}"


def _arguments(function: Any) -> list[str]:
    """Return the arguments that have a default, with it."""
    return [
        f"{name}={_value(parameter.default)}"
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.default is not parameter.empty
    ]


def _fields(cls: type) -> list[str]:
    """Return the fields of a class that have a default, with it."""
    if hasattr(cls, "model_fields"):
        return [
            f"{name} = {_value(field.default)}"
            for name, field in cls.model_fields.items()
            if name in vars(cls).get("__annotations__", {})
            and field.default_factory is None
            and not field.is_required()
        ]
    if dataclasses.is_dataclass(cls):
        return [
            f"{field.name} = {_value(field.default)}"
            for field in dataclasses.fields(cls)
            if field.default is not dataclasses.MISSING
        ]
    return []


def _limits(cls: type) -> list[str]:
    """Return the limits of the keys of a table."""
    if not hasattr(cls, "model_fields"):
        return []
    return [
        f"{name}: {limit}"
        for name, field in cls.model_fields.items()
        if name in vars(cls).get("__annotations__", {})
        for limit in _limits_in([*field.metadata, field.annotation])
    ]


def _limits_in(parts: Sequence[Any]) -> Iterator[str]:
    """Yield the limits of an annotation, and of those inside it."""
    for part in parts:
        inside = [*getattr(part, "metadata", ()), *typing.get_args(part)]
        yield from _limits_in([one for one in inside if not isinstance(one, str)])
        for name in ("gt", "ge", "lt", "le", "min_length", "max_length"):
            limit = getattr(part, name, None)
            if isinstance(limit, int | float):
                yield f"{name} {_value(limit)}"


def _value(value: Any) -> str:
    """Return a plain value as text, and the type of any other."""
    if isinstance(value, float | np.floating):
        return f"{float(value):.12g}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_value, value))})"
    if value is None or isinstance(value, str | int | np.ndarray):
        return repr(value)
    return type(value).__name__


if __name__ == "__main__":
    LISTING.write_text("\n".join(surface()) + "\n", encoding="utf-8")
    DEFAULTS.write_text("\n".join(defaults()) + "\n", encoding="utf-8")
    CONSTANTS.write_text("\n".join(constants()) + "\n", encoding="utf-8")
    print(
        f"{LISTING}: {len(surface())} names, {len(defaults())} defaults, "
        f"{len(constants())} constants"
    )
