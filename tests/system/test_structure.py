"""The shape of the code: compiled functions that can be read, no imports in circles."""

from __future__ import annotations

import ast
from pathlib import Path
from types import ModuleType

import pytest
from scripts import script

ROOT = Path(__file__).parents[2]
#: What a person can hold in mind at once, docs/decisions/0010-rooms.md.
MOST_LINES, MOST_ARGUMENTS = 100, 8


@pytest.fixture(scope="module")
def measure() -> ModuleType:
    """Return the script that measures the code."""
    return script("benchmarks/measure_structure.py")


@pytest.mark.slow
def test_compiled_functions_are_short_and_take_few_arguments(
    measure: ModuleType,
) -> None:
    functions = [
        (f"{path.relative_to(ROOT)}:{name}", lines, arguments)
        for path in (ROOT / "src").rglob("*.py")
        for name, lines, arguments in measure.compiled(ast.parse(path.read_text()))
    ]
    assert len(functions) > 100
    assert [entry for entry in functions if entry[1] > MOST_LINES] == []
    assert [entry for entry in functions if entry[2] > MOST_ARGUMENTS] == []


def test_kernels_of_every_folder_are_among_those_measured(measure: ModuleType) -> None:
    # A decorator that the script does not know would hide what it compiles.
    for path in (ROOT / "src").rglob("_kernels/*.py"):
        tree = ast.parse(path.read_text())
        decorated = {
            node.name
            for node in ast.walk(tree)
            if isinstance(node, ast.FunctionDef)
            and any(
                "overload" not in ast.unparse(decorator)
                for decorator in node.decorator_list
            )
        }
        known = {name for name, *_ in measure.compiled(tree)}
        assert decorated == known, path


@pytest.mark.slow
def test_no_file_imports_itself_by_way_of_others(measure: ModuleType) -> None:
    edges = measure.imports(ROOT)
    for floor in edges:
        measure.levels(edges[floor])  # stops at a circle
