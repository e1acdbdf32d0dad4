"""Sources in which each change of a sample is switched on in a process of its own.

All changes inside functions stand in one copy of the sources, each behind a switch. One
process imports it and collects the tests once. It forks for each change, so that a
change costs no import and no collection. Changes of modules, classes, heads of
functions and compiled functions take effect at import; the caller tries them otherwise.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import importlib
import io
import json
import math
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from _pytest.runner import runtestprotocol
from covering import is_compiled, parsed, search_path

__all__ = [
    "SWITCH",
    "Trial",
    "can_switch",
    "limit_time",
    "place_of",
    "switched",
    "try_all",
]

#: The module that the switches call.
SWITCH = '''"""Number of the change that is switched on."""

import os

active = int(os.environ.get("AMULOR_MUTANT", "-1"))


def on(number):
    return active == number
'''


def can_switch(file: Path, line: int) -> bool:
    """Return whether a change at a line takes effect in a function that is run.

    Parameters
    ----------
    file : pathlib.Path
        A module.
    line : int
        A line of it.

    Returns
    -------
    bool
        False for lines of modules, classes, heads of functions, compiled functions and
        cases of `match`.
    """
    module = parsed(file)
    statement, above = module.at(line) or (None, [])
    if statement is None or module.is_definition(line):
        return False
    return not any(
        isinstance(node, ast.Match) or is_compiled(node) for node in [*above, statement]
    )


class _Switches(ast.NodeTransformer):
    def __init__(self, changes: dict[tuple[int, ...], list[tuple[int, str]]]) -> None:
        self._changes = changes

    def visit(self, node: ast.AST) -> ast.AST:
        changes = self._changes.get(place_of(node), [])
        result = self.generic_visit(node)
        for number, new in changes:
            test = ast.parse(f"__import__('amulor_switch').on({number})", mode="eval")
            if isinstance(result, ast.stmt):
                body = ast.parse(f"def f():\n {new}").body[0].body  # type: ignore[attr-defined]
                result = ast.If(test=test.body, body=body, orelse=[result])
            else:
                body = ast.parse(new, mode="eval").body
                result = ast.IfExp(test=test.body, body=body, orelse=result)
        return ast.fix_missing_locations(result) if changes else result


def place_of(node: ast.AST) -> tuple[int, ...]:
    """Return kind, begin and end of an expression or statement, in lines and bytes."""
    if not isinstance(node, ast.expr | ast.stmt):
        return ()
    end = node.end_lineno or 0, node.end_col_offset or 0
    return (isinstance(node, ast.stmt), node.lineno, node.col_offset, *end)


def switched(file: Path, changes: list[tuple[int, tuple[int, ...], str]]) -> str:
    """Return a source with changes behind switches.

    Parameters
    ----------
    file : pathlib.Path
        A module.
    changes : list
        Number of each change, the place that it replaces, and the new source.
    """
    table: dict[tuple[int, ...], list[tuple[int, str]]] = defaultdict(list)
    for number, place, new in changes:
        table[place].append((number, new))
    return ast.unparse(_Switches(table).visit(ast.parse(file.read_bytes())))


@dataclass
class Trial:
    """Tests of a change, and their result."""

    number: int
    """Number of the switch."""
    tests: list[str]
    """Tests and files of tests, in order."""
    longer: list[str] = field(default_factory=list)
    """Files whose slow tests run after them."""
    failed: str = ""
    """First test that failed."""
    hangs: bool = False
    """Whether that test did not end."""
    ended: bool = False
    """Whether the budget ended before the tests."""
    seconds: float = 0.0
    """Processor time [s]."""
    count: int = 0
    """Number of tests that ran."""


class _Loop:
    """Plug-in of pytest that runs the trials in place of all tests."""

    def __init__(
        self, trials: list[Trial], budget: float, done: Callable[[Trial], bool]
    ) -> None:
        self._trials, self._budget, self._done = trials, budget, done
        self._sound: set[str] = set()
        self._broken: set[str] = set()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        by_test: dict[str, list[pytest.Item]] = defaultdict(list)
        for item in session.items:
            name = item.nodeid.partition("[")[0]
            by_test[name].append(item)
            by_test[name.partition("::")[0]].append(item)
            by_test[str(item.path)].append(item)
        for trial in self._trials:
            items = [
                item
                for tests, slow in ((trial.tests, False), (trial.longer, True))
                for test in tests
                for item in by_test.get(test, [])
                if bool(item.get_closest_marker("slow")) == slow
            ]
            self._try(trial, items)
            if not self._done(trial):
                break
        return True

    def _try(self, trial: Trial, items: list[pytest.Item]) -> None:
        """Run the tests of a change; those before a test that is left out ran once."""
        left, half = self._budget, self._budget / 2
        while True:
            items = [item for item in items if item.nodeid not in self._broken]
            before = trial.seconds
            started = self._fork(items, trial, budget=left, longest=half)
            left -= trial.seconds - before
            last = [item for item in items if item.nodeid == trial.failed]
            if trial.hangs:
                # Its time may have gone into other tests, or be longer than half.
                self._fork(last, trial, budget=self._budget)
            elif not trial.failed:
                return
            if trial.failed in self._sound:
                return
            if trial.failed:
                # A test that fails without the change, too, is left out.
                again = Trial(number=-1, tests=[])
                self._fork(last, again, budget=self._budget)
                (self._broken if again.failed else self._sound).add(trial.failed)
                if not again.failed:
                    return
            items = [item for item in items if item.nodeid not in started]
            if left <= 0 or not started:
                trial.failed, trial.hangs, trial.ended = "", False, True
                return

    def _fork(
        self,
        items: list[pytest.Item],
        trial: Trial,
        *,
        budget: float,
        longest: float = math.inf,
    ) -> set[str]:
        """Run tests in a process, until one fails or the budget is used.

        A test of more than the longest time ends it. Returns the tests that began.
        """
        with (
            tempfile.NamedTemporaryFile("r") as answer,
            tempfile.NamedTemporaryFile("r") as current,
        ):
            child = os.fork()
            if child == 0:
                try:
                    files = Path(answer.name), Path(current.name)
                    self._child(items, trial.number, budget, longest, *files)
                except BaseException:
                    Path(answer.name).write_text(traceback.format_exc())
                    os._exit(1)
                os._exit(0)
            status, usage = _waited(child, 6 * self._budget + 60)
            trial.seconds += usage.ru_utime + usage.ru_stime
            text, started = answer.read(), current.read().splitlines()
        if not text:
            # Ended by a limit of time, or by a crash.
            trial.failed, trial.hangs = started[-1] if started else "start", True
            trial.count += len(started)
            return set(started)
        if status:
            raise RuntimeError(text)
        found = json.loads(text)
        trial.failed, trial.ended, trial.hangs = found["failed"], found["ended"], False
        trial.count += len(started)
        return set(started)

    def _child(
        self,
        items: list[pytest.Item],
        number: int,
        budget: float,
        longest: float,
        answer: Path,
        current: Path,
    ) -> None:
        os.setpgid(0, 0)
        null = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(null, stream)
        limit = math.ceil(1.5 * self._budget + 5)
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
        os.environ["AMULOR_MUTANT"] = str(number)
        sys.modules["amulor_switch"].active = number  # type: ignore[attr-defined]
        failed, ended = "", False
        # Without a test there is nothing after it, either.
        for item, after in zip(items, [*items[1:], None], strict=False):
            if time.process_time() + _of_children() > budget:
                ended = True
                break
            limit_time(longest)
            with current.open("a") as file:
                file.write(item.nodeid + "\n")
            reports = runtestprotocol(item, log=False, nextitem=after)
            if any(report.failed for report in reports):
                failed = item.nodeid
                break
        answer.write_text(json.dumps({"failed": failed, "ended": ended}))


def limit_time(longest: float) -> None:
    """End this process where it uses more than a time from now on.

    Parameters
    ----------
    longest : float
        Processor time [s]; infinity for none.
    """
    signal.setitimer(signal.ITIMER_PROF, longest if math.isfinite(longest) else 0.0)


def _of_children() -> float:
    return sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])


def _waited(child: int, longest: float) -> tuple[int, resource.struct_rusage]:
    """Wait for a process; end it, with all that it started, after a time [s]."""
    deadline = time.monotonic() + longest
    while True:
        number, status, usage = os.wait4(child, os.WNOHANG)
        if not number and time.monotonic() > deadline:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
            number, status, usage = os.wait4(child, 0)
        if number:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(child, signal.SIGKILL)
            return status, usage
        time.sleep(0.02)


def _keep_compiled(copy: Path, root: Path) -> None:
    """Let compiled functions of the repository count as those of the copy.

    No switch is in their sources.
    """
    if not (copy / "amulor" / "_compiled.py").exists():
        return
    compiled = importlib.import_module("amulor._compiled")

    def source(path: Path, package: Path) -> tuple[bytes, bytes]:
        text = (root / "src" / path.relative_to(copy)).read_bytes()
        return text, hashlib.sha256(text).digest()

    compiled._source = source  # type: ignore[attr-defined]


def try_all(
    copy: Path,
    trials: list[Trial],
    *,
    root: Path,
    budget: float,
    done: Callable[[Trial], bool],
) -> None:
    """Run the tests of each change, and state each result.

    Parameters
    ----------
    copy : pathlib.Path
        Copy of the folder of the package, with switches.
    trials : list of Trial
        Numbers of switches with their tests.
    root : pathlib.Path
        Root of the repository.
    budget : float
        Processor time of a change [s].
    done : callable
        Takes the trial after its tests; the campaign ends if it returns False.
    """
    (copy / "amulor_switch.py").write_text(SWITCH, "utf-8")
    os.chdir(root)
    sys.dont_write_bytecode = True
    sys.path.insert(0, str(copy))
    os.environ |= {"PYTHONPATH": search_path(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    __import__("amulor_switch")
    _keep_compiled(copy, root)
    files = dict.fromkeys(
        test.partition("::")[0]
        for trial in trials
        for test in [*trial.tests, *trial.longer]
    )
    options = ["-c", str(root / "pyproject.toml"), "-q", "-p", "no:cacheprovider"]
    options += ["-m", "not study", f"--basetemp={copy.parent / 'tests'}"]
    options += ["--continue-on-collection-errors"]
    options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
    with contextlib.redirect_stdout(io.StringIO()) as output:
        code = pytest.main([*options, *files], plugins=[_Loop(trials, budget, done)])
    if code not in (0, 1, 2, 5):
        raise RuntimeError(f"pytest ended with {code}: {output.getvalue()[-2000:]}")
