"""Changes of a sample behind switches: the sources, and what takes effect in them."""

from __future__ import annotations

import subprocess
import sys
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


#: The first test of a module may take longer than half of a budget of 2 s.
LONG = """import time

from amulor.part import doubled


def test_long():
    assert doubled(0) == 0
    end = time.process_time() + {seconds}
    while time.process_time() < end:
        pass


def test_short():
    assert doubled({number}) == 4
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seconds", "number", "expected"),
    [
        (0.1, 2, "test_short False"),
        (2.5, 2, "test_short False"),
        # All tests have passed, the first one alone.
        (2.5, 1, "None False"),
    ],
)
def test_a_test_that_uses_up_the_budget_is_left_out(
    tmp_path: Path, seconds: float, number: int, expected: str
) -> None:
    for folder in ("src/amulor", "tests"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "pyproject.toml").write_text(
        "[tool.pytest.ini_options]\nmarkers = ['slow', 'study']\n"
    )
    (tmp_path / "src" / "amulor" / "__init__.py").touch()
    (tmp_path / "src" / "amulor" / "part.py").write_text(
        "from amulor_switch import on\n\n\ndef doubled(x):\n"
        "    return (3 if on(0) and x > 1 else 4) * max(1, x // 2) if x else 0\n"
    )
    text = LONG.format(seconds=seconds, number=number)
    (tmp_path / "tests" / "test_part.py").write_text(text)
    program = f"""import sys
from pathlib import Path
sys.path.insert(0, {str(TOOLS)!r})
from switched import Trial, try_all
none = Trial(number=0, tests=["tests/test_part.py::test_gone"])
trials = [none, Trial(number=0, tests=["tests/test_part.py"])]
try_all(Path("src"), trials, root=Path.cwd(), budget=2, done=lambda trial: True)
none, trial = trials
assert not none.failed and not none.ended
print(trial.failed.rpartition("::")[-1] or None, trial.ended)
"""
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip() == expected
