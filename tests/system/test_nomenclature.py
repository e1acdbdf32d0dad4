"""The nomenclature page: names of arguments in the formulas, their units, equations."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import amulor.optics

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "glossary.md").read_text("utf-8")
ROW = re.compile(
    r"^\| ([^|]*) \| `(\w+)` \| ([^|]+) \| ([^|]+) \| ([^|]*) ?\|$", flags=re.MULTILINE
)
PARAMETERS = re.compile(r"Parameters\n-+\n(.*?)(?:\n\n[A-Z][\w ]+\n-+\n|\Z)", re.DOTALL)
ENTRY = re.compile(r"^(\w[\w, \\\n]*?) ?: ?[^\n]*\n((?: {4}[^\n]*\n?)+)", re.MULTILINE)
# Functions, of which the docstring states the unit of what they take as well.
CALLABLES = {"phase_function", "response_function", "vsf", "weight"}


def _functions() -> Iterator[Callable[..., Any]]:
    """Return the public functions and methods of optics."""
    for file in pkgutil.walk_packages(amulor.optics.__path__, "amulor.optics."):
        if any(part.startswith("_") for part in file.name.split(".")):
            continue
        module = importlib.import_module(file.name)
        names = getattr(module, "__all__", vars(module))
        for name in names:
            value = vars(module).get(name)
            if getattr(value, "__module__", "") != file.name or name.startswith("_"):
                continue
            if inspect.isfunction(value):
                yield value
            elif inspect.isclass(value):
                for method, function in vars(value).items():
                    if inspect.isfunction(function) and not method.startswith("_"):
                        yield function


FUNCTIONS = list(_functions())
UNITS = {name: unit.strip() for _, name, unit, _, _ in ROW.findall(PAGE)}


def _arguments() -> set[str]:
    names: set[str] = set()
    for function in FUNCTIONS:
        for name, parameter in inspect.signature(function).parameters.items():
            if parameter.kind is not inspect.Parameter.VAR_KEYWORD and name != "self":
                names.add(name)
    return names


def _stated() -> dict[str, dict[str, list[str]]]:
    """Return the units that docstrings state of each argument, and where."""
    stated: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for function in FUNCTIONS:
        section = PARAMETERS.search(inspect.getdoc(function) or "")
        for listed, body in ENTRY.findall(section[1] + "\n") if section else []:
            names = re.findall(r"\w+", listed)
            brackets = re.findall(r"\[([^\]]*)\](?!_)", body)
            if not brackets:
                continue
            units = re.split(r", ", brackets[-1])
            units = units * len(names) if len(units) == 1 else units
            assert len(units) == len(names), (function.__qualname__, names, units)
            for name, unit in zip(names, units, strict=True):
                stated[name][unit].append(function.__qualname__)
    return stated


STATED = _stated()


def test_every_argument_of_optics_is_on_the_page() -> None:
    assert len(FUNCTIONS) > 90
    missing = _arguments() - set(UNITS)
    assert not missing, f"add to docs/glossary.md: {sorted(missing)}"


def test_every_name_on_the_page_is_an_argument_of_optics() -> None:
    unused = set(UNITS) - _arguments()
    assert not unused, f"no public function of amulor.optics takes {sorted(unused)}"


def test_no_name_stands_on_the_page_twice() -> None:
    names = [name for _, name, _, _, _ in ROW.findall(PAGE)]
    assert len(names) == len(set(names))
    assert len(names) == len(re.findall(r"^\| [^|]*\| `", PAGE, flags=re.MULTILINE))


@pytest.mark.parametrize("name", sorted(set(UNITS) - CALLABLES))
def test_a_name_has_the_unit_of_the_page_in_every_docstring(name: str) -> None:
    expected = UNITS[name]
    for unit, places in STATED.get(name, {}).items():
        if expected == "any":
            assert unit in ("any unit", "1", "that unit", "1/sr", "1/(m sr)"), places
        else:
            assert unit == expected, places


def test_every_number_has_a_unit_in_some_docstring() -> None:
    numbers = {name for name, unit in UNITS.items() if unit not in ("any", "-")}
    assert numbers <= set(STATED), sorted(numbers - set(STATED))


def test_equations_are_those_of_the_paper() -> None:
    for _, name, _, _, equations in ROW.findall(PAGE):
        cited = [int(number) for number in re.findall(r"\((\d+)\)", equations)]
        assert all(1 <= number <= 72 for number in cited), name
        assert re.sub(r"\((\d+)\)|[, ]", "", equations) == "", name
