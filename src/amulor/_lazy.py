"""Lazy import of the public names of a package (PEP 562)."""

from __future__ import annotations

import gc
import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any


def attach(
    package: str, public: Sequence[str], *, origin: Mapping[str, str] | None = None
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return the `__getattr__` and the `__dir__` of a package.

    Type checkers and import-linter read the `TYPE_CHECKING` block; readers and tab
    completion use `__all__`. Nothing is imported before its first use::

        if TYPE_CHECKING:
            from amulor.optics import ranging, small_angle
            from amulor.optics.low_pass import cut_off

        __all__ = ["cut_off", "ranging", "small_angle"]

        if not TYPE_CHECKING:
            __getattr__, __dir__ = _lazy.attach(
                __name__, __all__, origin={"cut_off": "amulor.optics.low_pass"}
            )
    """
    origin = dict(origin or {})
    for name, module in origin.items():
        if name not in public:
            raise ValueError(f"{package}.{name} has an origin but is not in __all__")
        if module == f"{package}.{name}":
            raise ValueError(
                f"{package}.{name} cannot be lazy: importing the module of the same "
                "name would hide it; import it at the top of the package"
            )

    def getter(name: str) -> Any:
        if name in origin:
            value = getattr(_imported(origin[name]), name)
            setattr(sys.modules[package], name, value)
            return value
        if name in public:
            return _imported(f"{package}.{name}")
        raise AttributeError(f"module {package!r} has no attribute {name!r}")

    def lister() -> list[str]:
        special = [name for name in vars(sys.modules[package]) if name[:2] == "__"]
        return sorted({*special, *public})

    return getter, lister


def _imported(module: str) -> ModuleType:
    """Import a module with garbage collection off, which saves time."""
    collects = gc.isenabled()
    gc.disable()
    try:
        return importlib.import_module(module)
    finally:
        if collects:
            gc.enable()
