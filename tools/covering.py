"""Tests that run given statements, by a run of the tests on sources with probes.

A probe is a call before a statement. It writes the test that runs the statement, also
in programs that the test starts. Statements of a module or a class run at import, so
all statements that use their name are probed. Compiled functions have no probes; their
callers do. A fixture or a cache belongs to the first test that needs it: files of tests
count as wholes where a fixture ran the statement.
"""

from __future__ import annotations

import ast
import functools
import os
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

__all__ = [
    "PROBE",
    "covering",
    "is_compiled",
    "parsed",
    "places",
    "probed",
    "search_path",
]

#: The module that probes call; a plug-in of pytest that measures times, too.
PROBE = '''"""Writes the tests that run the probes."""

import hashlib
import importlib
import os
from pathlib import Path

_FILE = os.environ.get("AMULOR_PROBES")
_SOURCES = os.environ.get("AMULOR_SOURCES")
_seen = set()


def _write(*words):
    if _FILE:
        line = "\\t".join(map(str, words)) + "\\n"
        with open(_FILE, "a", encoding="utf-8") as file:
            file.write(line)


def hit(number):
    test = os.environ.get("PYTEST_CURRENT_TEST", "")
    if (number, test) not in _seen:
        _seen.add((number, test))
        _write("hit", number, test)


def pytest_configure():
    """Let compiled functions of the sources count as those of the copy."""
    if not _SOURCES or not (Path(_SOURCES) / "_compiled.py").exists():
        return
    compiled = importlib.import_module("amulor._compiled")
    copy = Path(compiled.__file__).parent

    def source(path, package):
        text = (Path(_SOURCES) / path.relative_to(copy)).read_bytes()
        return text, hashlib.sha256(text).digest()

    compiled._source = source


def pytest_runtest_logreport(report):
    _write("time", report.nodeid, f"{report.duration:.3f}")
'''
_Functions = ast.FunctionDef | ast.AsyncFunctionDef
#: Decorators of the package that compile a function with certain options.
_COMPILERS = frozenset(
    {"allocating", "allocating_entry", "entry", "inner", "kernel", "step"}
)
#: A file and the first line and column of a statement.
Place = tuple[Path, int, int]


class _Module:
    """Statements of a module, and the function that each of them is in."""

    def __init__(self, file: Path) -> None:
        self.tree = ast.parse(file.read_bytes())
        self.statements: list[tuple[ast.stmt, list[ast.AST]]] = []
        self._walk(self.tree, [])

    def _walk(self, node: ast.AST, above: list[ast.AST]) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.stmt):
                self.statements.append((child, above))
            self._walk(child, [*above, child])

    def at(self, line: int) -> tuple[ast.stmt, list[ast.AST]] | None:
        """Return the innermost statement at a line and the nodes above it."""
        inside = [
            (statement, above)
            for statement, above in self.statements
            if statement.lineno <= line <= (statement.end_lineno or 0)
        ]
        return max(inside, key=lambda pair: len(pair[1]), default=None)

    def is_definition(self, line: int) -> bool:
        """Return whether a line is of a module, a class or the head of a function."""
        statement, above = self.at(line) or (None, [])
        return isinstance(statement, _Functions) or not any(
            isinstance(node, _Functions) for node in above
        )


@functools.cache
def parsed(file: Path) -> _Module:
    """Return the statements of a module; it is parsed once."""
    return _Module(file)


def places(package: Path, file: Path, line: int) -> set[Place]:
    """Return the statements whose execution uses a line.

    Parameters
    ----------
    package : pathlib.Path
        The sources.
    file : pathlib.Path
        A module of them.
    line : int
        A line of it.

    Returns
    -------
    set
        File, line and column of statements in functions that are not compiled.
    """
    found: set[Place] = set()
    start = parsed(file).at(line)
    waiting = [(file, *start)] if start else []
    done: set[tuple[Path, str]] = set()
    while waiting:
        path, statement, above = waiting.pop()
        functions = [node for node in above if isinstance(node, _Functions)]
        compiled = [node for node in functions if is_compiled(node)]
        if functions and not compiled:
            found.add((path, statement.lineno, statement.col_offset))
            continue
        if isinstance(statement, _Functions) and not is_compiled(statement):
            first = statement.body[0]
            found.add((path, first.lineno, first.col_offset))
            continue
        for name in _names(compiled[0] if compiled else statement):
            if (path, name) in done:
                continue
            done.add((path, name))
            users = [path] if name.startswith("_") else sorted(package.rglob("*.py"))
            for user in users:
                if user == path or name in user.read_text("utf-8"):
                    waiting += _uses(user, name)
    return found


def _names(statement: ast.AST) -> list[str]:
    """Return the names that a statement of a module or a class defines."""
    match statement:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
            return [name]
        case ast.Assign(targets=targets):
            parts = [part for target in targets for part in ast.walk(target)]
            return [part.id for part in parts if isinstance(part, ast.Name)]
        case ast.AnnAssign(target=ast.Name(id=name)):
            return [name]
    return []


def _uses(file: Path, name: str) -> list[tuple[Path, ast.stmt, list[ast.AST]]]:
    """Return the statements of a file that use a name."""
    module, found = parsed(file), {}
    for node in ast.walk(module.tree):
        match node:
            case ast.Name(id=word, ctx=ast.Load()) | ast.Attribute(attr=word):
                place = module.at(node.lineno) if word == name else None
                if place is not None:
                    found[id(place[0])] = (file, *place)
    return list(found.values())


def is_compiled(function: ast.AST) -> bool:
    """Return whether a function is compiled by its decorators."""
    decorators = getattr(function, "decorator_list", [])
    words = [ast.unparse(decorator).partition("(")[0] for decorator in decorators]
    return any("jit" in word or word in _COMPILERS for word in words)


def search_path(copy: Path) -> str:
    """Return a PYTHONPATH on which a copy of the package comes first."""
    before = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    others = [place for place in before if place and place != str(copy)]
    return os.pathsep.join([str(copy), *others])


class _Probes(ast.NodeTransformer):
    def __init__(self, numbers: dict[tuple[int, int], list[int]]) -> None:
        self._numbers = numbers

    def generic_visit(self, node: ast.AST) -> ast.AST:
        super().generic_visit(node)
        for field in ("body", "orelse", "finalbody"):
            body = getattr(node, field, None)
            if isinstance(body, list):
                setattr(node, field, [new for old in body for new in self._before(old)])
        return node

    def _before(self, statement: ast.AST) -> list[ast.AST]:
        key = getattr(statement, "lineno", 0), getattr(statement, "col_offset", 0)
        if not isinstance(statement, ast.stmt) or key not in self._numbers:
            return [statement]
        calls = "\n".join(
            f"__import__('amulor_probe').hit({number})" for number in self._numbers[key]
        )
        probes = ast.parse(calls).body
        text = isinstance(statement, ast.Expr) and isinstance(
            statement.value, ast.Constant
        )
        return [statement, *probes] if text else [*probes, statement]


def probed(file: Path, numbers: dict[tuple[int, int], list[int]]) -> str:
    """Return a source with probes before statements, by line and column."""
    return ast.unparse(_Probes(numbers).visit(ast.parse(file.read_bytes())))


def covering(
    copy: Path, package: Path, lines: list[tuple[Path, int]], tests: list[str]
) -> list[dict[str, float]]:
    """Run tests on sources with probes.

    Parameters
    ----------
    copy : pathlib.Path
        Copy of the folder that contains the package; probes are written into it.
    package : pathlib.Path
        The sources.
    lines : list
        Modules and lines of them.
    tests : list of str
        Tests, files or folders, and options of pytest.

    Returns
    -------
    list of dict
        For each line, the tests that run it, and files whose fixtures do, with their
        times [s]. Parameters of a test are left out. An empty name is for a line that
        runs outside of tests, such as during their collection.
    """
    by_file: dict[Path, dict[tuple[int, int], list[int]]] = defaultdict(dict)
    for number, (file, line) in enumerate(lines):
        for path, row, column in places(package, file, line):
            by_file[path].setdefault((row, column), []).append(number)
    for file, numbers in by_file.items():
        place = copy / package.name / file.relative_to(package)
        place.write_text(probed(file, numbers), "utf-8")
    (copy / "amulor_probe.py").write_text(PROBE, "utf-8")
    answer = copy / "probes.txt"
    answer.touch()
    environment = os.environ | {
        "PYTHONPATH": search_path(copy), "PYTHONDONTWRITEBYTECODE": "1",
        "AMULOR_PROBES": str(answer), "AMULOR_SOURCES": str(package),
    }  # fmt: skip
    environment.pop("PYTEST_CURRENT_TEST", None)
    words = [sys.executable, "-m", "pytest", "-q", "-p", "amulor_probe"]
    words += ["-p", "no:cacheprovider", "--continue-on-collection-errors"]
    subprocess.run([*words, *tests], env=environment, check=False)
    return _read(answer.read_text("utf-8"), len(lines))


def _read(text: str, count: int) -> list[dict[str, float]]:
    """Return the tests of each probe and their times, from the lines of the probes."""
    times: dict[str, float] = defaultdict(float)
    hits: list[set[str]] = [set() for _ in range(count)]
    for row in text.splitlines():
        kind, *words = row.split("\t")
        if kind == "time" and len(words) == 2:
            test = words[0].partition("[")[0]
            times[test] += float(words[1])
            times[test.partition("::")[0]] += float(words[1])
        elif kind == "hit" and not words[1]:
            hits[int(words[0])].add("")
        elif kind == "hit" and words[1].startswith("tests/"):
            test, _, phase = words[1].rpartition(" (")
            test = test.partition("[")[0]
            hits[int(words[0])].add(
                test if phase == "call)" else test.partition("::")[0]
            )
    return [
        {
            test: times[test]
            for test in sorted(found)
            if "::" not in test or test.partition("::")[0] not in found
        }
        for found in hits
    ]
