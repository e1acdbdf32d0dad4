"""Tests that run a line of a package, found by probes in a copy of it."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import ModuleType

import pytest

TOOLS = Path(__file__).parents[2] / "tools"
#: Lines 1 to 18.
SOURCE = '''"""Winds coils."""

_TURNS, _ENDS = 3, 2
LIMIT = 2.5


def wound(
    x,
):
    """Return the length."""
    if x > LIMIT:
        x = LIMIT
    return x * _TURNS


@njit(cache=True)
def bent(x):
    return x + _ENDS
'''
USER = """from part.coil import LIMIT, bent

SPARE = 2 * LIMIT


def used():
    return bent(SPARE)
"""


@pytest.fixture
def tool(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.syspath_prepend(TOOLS)
    import covering

    return covering


@pytest.fixture
def package(tmp_path: Path) -> Path:
    package = tmp_path / "src" / "part"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "coil.py").write_text(SOURCE)
    (package / "user.py").write_text(USER)
    return package


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (11, [("coil.py", 11)]),
        (12, [("coil.py", 12)]),
        # The head of a function runs with its first statement.
        (8, [("coil.py", 10)]),
        # A constant, and a constant of it in another module.
        (4, [("coil.py", 11), ("coil.py", 12), ("user.py", 7)]),
        (3, [("coil.py", 13), ("user.py", 7)]),
        # Compiled code has no probes: its caller does.
        (18, [("user.py", 7)]),
        (1, []),
    ],
)
def test_a_line_is_run_with_the_statements_that_use_it(
    tool: ModuleType, package: Path, line: int, expected: list[tuple[str, int]]
) -> None:
    places = tool.places(package, package / "coil.py", line)
    assert sorted((path.name, row) for path, row, _ in places) == expected


def test_a_probe_stands_before_its_statement(tool: ModuleType, package: Path) -> None:
    source = tool.probed(package / "coil.py", {(12, 8): [4], (10, 4): [5]})
    assert source.splitlines()[-10:-3] == [
        '    """Return the length."""',
        "    __import__('amulor_probe').hit(5)",
        "    if x > LIMIT:",
        "        __import__('amulor_probe').hit(4)",
        "        x = LIMIT",
        "    return x * _TURNS",
        "",
    ]


TESTS = """import subprocess, sys
import pytest
from part.coil import wound

@pytest.fixture(scope="module")
def length():
    return wound(9)

def test_fixture(length):
    assert length == 7.5

@pytest.mark.parametrize("x", [1, 2])
def test_small(x):
    wound(x)

def test_program():
    code = "from part.coil import wound; wound(8)"
    subprocess.run([sys.executable, "-c", code], check=True)
"""


def test_tests_of_a_line_are_found_in_other_programs_and_in_fixtures(
    tool: ModuleType, package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (package / "coil.py").write_text(SOURCE.partition("@njit")[0])
    tests = tmp_path / "tests"
    tests.mkdir()
    (tests / "test_a.py").write_text(TESTS)
    # A file of tests that runs a line when it is collected.
    (tests / "test_c.py").write_text("from part.coil import wound\nwound(7)\n")
    (tests / "test_b.py").write_text(TESTS.replace("(length)", "()").replace(
        "    assert length == 7.5", "    pass"
    ))  # fmt: skip
    (tmp_path / "pytest.ini").touch()
    monkeypatch.chdir(tmp_path)
    copy = shutil.copytree(tmp_path / "src", tmp_path / "copy")
    coil = package / "coil.py"
    large, every = tool.covering(copy, package, [(coil, 12), (coil, 13)], ["tests"])
    assert set(large) == {"", "tests/test_a.py", "tests/test_b.py::test_program"}
    assert set(every) == {
        "",
        "tests/test_a.py",
        "tests/test_b.py::test_small",
        "tests/test_b.py::test_program",
    }
    assert min(every.values()) >= 0
    # A program of its own takes longer than a multiplication.
    times = every["tests/test_b.py::test_small"], every["tests/test_b.py::test_program"]
    assert times[0] < times[1]
