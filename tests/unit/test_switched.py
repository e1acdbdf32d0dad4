"""Changes of a sample behind switches: the sources, and what takes effect in them."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
#: Lines 1 to 21.
SOURCE = '''_TURNS = 3


def wound(x, start=1):
    """Return the length."""
    if x > 5:
        print(x)
    return -x * _TURNS


@numba.njit(cache=True)
def bent(x):
    return x + 1


def named(x):
    match x:
        case 1:
            return 2
    for n in range(2):
        x += 2
    return x
'''


@pytest.fixture
def tools(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> tuple[ModuleType, Path]:
    monkeypatch.syspath_prepend(TOOLS)
    import mutate
    import switched

    monkeypatch.setattr(mutate, "PACKAGE", tmp_path)
    file = tmp_path / "coil.py"
    file.write_text(SOURCE)
    return mutate, switched, file


def test_each_change_is_on_alone(tools, monkeypatch: pytest.MonkeyPatch) -> None:
    mutate, switched, file = tools
    mutants = [m for m in mutate.mutants_of(file) if switched.can_switch(file, m.line)]
    changes = [(number, m.place, m.new) for number, m in enumerate(mutants)]
    source = switched.switched(file, changes)
    switch = ModuleType("amulor_switch")
    exec(switched.SWITCH, vars(switch))
    monkeypatch.setitem(__import__("sys").modules, "amulor_switch", switch)
    printed: list[object] = []
    names = {"print": printed.append, "numba": switched_numba()}
    exec(compile(source, "coil", "exec"), names)

    def results() -> list[object]:
        printed.clear()
        found = [names["wound"](4), names["wound"](5), names["wound"](6)]
        return [*found, names["named"](0), *printed]

    assert results() == [-12, -15, -18, 4, 6]
    expected = {
        "x > 5 -> x >= 5": [-12, -15, -18, 4, 5, 6],
        "5 -> 6": [-12, -15, -18, 4],
        "without print(x)": [-12, -15, -18, 4],
        "return -x * _TURNS -> None": [None, None, None, 4, 6],
        "-x * _TURNS -> -x / _TURNS": [-4 / 3, -5 / 3, -2, 4, 6],
        "-x -> x": [12, 15, 18, 4, 6],
        "without x += 2": [-12, -15, -18, 0, 6],
        "return x -> None": [-12, -15, -18, None, 6],
    }
    for number, mutant in enumerate(mutants):
        switch.active = number
        if mutant.said in expected:
            assert results() == expected.pop(mutant.said), mutant.said
        elif mutant.said == "2 -> 3":
            # Two of them, one after another: the number of turns, and the step.
            assert results() == [-12, -15, -18, 6, 6]
    assert not expected


def switched_numba() -> ModuleType:
    """Return a module that compiles nothing."""
    numba = ModuleType("numba")
    numba.njit = lambda **options: lambda function: function
    return numba


def test_changes_at_import_and_of_compiled_code_have_no_switch(tools) -> None:
    _, switched, file = tools
    lines = {n for n in range(1, 23) if switched.can_switch(file, n)}
    # Not: constants, heads, compiled functions, cases.
    assert lines == {5, 6, 7, 8, 20, 21, 22}
