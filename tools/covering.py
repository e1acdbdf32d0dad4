"""Says which tests run a line of the package, from data of coverage.py with contexts.

The data come from a run of the tests with `--cov --cov-context=test`. Compiled code is
not seen by it, and what a fixture of a file or a cache made is booked on the first test
that asked for it: so files of tests count as wholes where a fixture ran the line.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

from coverage import CoverageData

__all__ = ["Covering", "statement_lines"]


class Covering:
    """Tests by the lines that they run.

    Parameters
    ----------
    data : pathlib.Path
        What coverage.py wrote.
    package : pathlib.Path
        The sources, as they are now. Those of the run may have stood elsewhere.

    Raises
    ------
    FileNotFoundError
        If there are no data.
    """

    def __init__(self, data: Path, package: Path) -> None:
        if not data.is_file():
            raise FileNotFoundError(
                f"{data} is missing; make it with pytest --cov --cov-context=test"
            )
        self._data = CoverageData(str(data))
        self._data.read()
        self._package = package
        name = f"/{package.name}/"
        self._measured = {
            path.rpartition(name)[2]: path for path in self._data.measured_files()
        }

    def tests(self, file: Path, line: int) -> list[str]:
        """Return the tests that run a line.

        Parameters
        ----------
        file : pathlib.Path
            A module of the package.
        line : int
            A line of it. For a constant of a module or a class the lines that name it
            count, in all modules.

        Returns
        -------
        list of str
            Tests, one case of each, and files, as pytest calls them.
        """
        tree = ast.parse(file.read_bytes())
        constant = _constant_at(tree, line)
        if constant is None:
            return self._running(file, set(statement_lines(tree, line)))
        word = re.compile(rf"\b{constant}\b")
        found: list[str] = []
        private = constant.startswith("_")
        for place in [file] if private else sorted(self._package.rglob("*.py")):
            text = place.read_text("utf-8")
            if not word.search(text):
                continue
            users = ast.parse(text)
            lines: set[int] = set()
            for number, row in enumerate(text.splitlines(), start=1):
                if word.search(row):
                    lines.update(statement_lines(users, number))
            found += self._running(place, lines)
        return list(dict.fromkeys(found))

    def _running(self, file: Path, lines: set[int]) -> list[str]:
        measured = self._measured.get(file.relative_to(self._package).as_posix())
        if measured is None:
            return []
        by_line = self._data.contexts_by_lineno(measured)
        contexts = {one for line in lines for one in by_line.get(line, [])}
        whole, single = set(), set()
        for context in contexts:
            node, _, phase = context.rpartition("|")
            if not node.startswith("tests/"):
                continue
            path, _, _ = node.partition("::")
            if phase == "run":
                single.add(node.partition("[")[0])
            else:
                whole.add(path)
        return sorted(one for one in single if one.partition("::")[0] not in whole) + (
            sorted(whole)
        )


def statement_lines(tree: ast.Module, line: int) -> range:
    """Return the lines of the innermost statement at a line.

    Parameters
    ----------
    tree : ast.Module
        A source.
    line : int
        A line of it.

    Returns
    -------
    range
        Of a loop or a condition its head only; of the head of a function, which runs
        when the module is imported, the whole function.
    """
    inside = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or 0)
    ]
    if not inside:
        return range(line, line + 1)
    node = min(inside, key=lambda one: (one.end_lineno or 0) - one.lineno)
    end = (node.end_lineno or node.lineno) + 1
    body = getattr(node, "body", None)
    defines = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
    if body and not defines:
        return range(node.lineno, max(body[0].lineno, line + 1))
    return range(node.lineno, end)


def _constant_at(tree: ast.Module, line: int) -> str | None:
    """Return the name that a module or a class gives to a value at a line, or None."""
    bodies = [tree.body]
    bodies += [node.body for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    for node in (one for body in bodies for one in body):
        if not isinstance(node, ast.Assign | ast.AnnAssign):
            continue
        if not node.lineno <= line <= (node.end_lineno or 0):
            continue
        target = node.targets[0] if isinstance(node, ast.Assign) else node.target
        return target.id if isinstance(target, ast.Name) else None
    return None
