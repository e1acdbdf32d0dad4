"""List every public name of amulor with its kind; `make surface` writes it anew.

A public module is one that `__all__` of a package names, from `amulor` down. Its public
names are its `__all__`, or, where it has none, the functions and classes defined in it.
"""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from types import ModuleType
from typing import Any

LISTING = Path(__file__).parents[1] / "tests" / "reference" / "public_surface.txt"


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


if __name__ == "__main__":
    LISTING.write_text("\n".join(surface()) + "\n", encoding="utf-8")
    print(f"{LISTING}: {len(surface())} names")
