"""Changes one thing in a module at a time, and looks whether its tests notice.

Run from the root of the repository: `python tools/mutate.py --sample 200 --seed 1`,
with names of folders or files (`rejection`, `io/ply.py`) to stay within them. The
sample is stratified: each folder gets its share of the changes, at least eight. A
change of a line alters whether that line is drawn, and no other draw. Each worker
changes a copy of the sources and forks a process per change from one that has imported
all libraries. A change has a budget of processor time. The result of each change is a
line of `tools/mutations.csv`; a second run continues from there. It prints the share
that was caught with its interval of 95 %, by folder, and each change that no test
noticed: close it by a test of behavior, or see that it changes nothing that can be
observed and write it, with the reason, into `tools/equivalent_mutants.toml`. Changes
listed there are drawn and counted, but not tried. Neither are changes that by their
kind alter nothing: sizes of letters and lines in figures, the bar of progress, sizes of
caches and blocks, None in place of False, another negative number as the open length of
`reshape`, and whether `zip` compares lengths, which differ by mistakes of programs
only; seeds inside of functions, one more repetition of an iteration, one more of 100
points or more that stand for all, how a function is compiled, and numbers of at most
1e-9 that are tolerances or keep a divisor from 0. Counts and limits of 0 or 1 are tried
with `<=` in place of `<`. Other limits of real numbers, which no value meets exactly,
are tried with `>`.

`--cover tests/unit --covering FILE` runs these tests once, and writes the tests that
run each change of the sample to a file. A campaign with `--covering FILE` then runs
those tests: the short ones first, and of them the nearest. A test that takes more than
half of the budget is tried alone; the others go on with what is left of the budget. A
change whose budget ended before all of its tests is `survived` by `budget`. `--part
1/2` tries every second change; run the parts at once, each with `--results` of its own.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import csv
import functools
import hashlib
import importlib
import io
import json
import math
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import tomllib
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import pytest
from covering import covering, parsed, search_path
from scipy.stats import binomtest
from switched import Trial, can_switch, limit_time, place_of, switched, try_all

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "amulor"
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.toml")
RESULTS = Path(__file__).with_name("mutations.csv")
#: Changes of a folder, at least.
_LEAST = 8
#: Libraries that a worker imports once; none of the package itself.
_LIBRARIES = (
    "numba",
    "xarray",
    "pandas",
    "pydantic",
    "h5netcdf",
    "hypothesis",
    "matplotlib.figure",
    "scipy.optimize",
    "scipy.special",
    "scipy.interpolate",
    "scipy.spatial",
    "scipy.ndimage",
    "scipy.stats",
    "cyclopts",
    "rich.console",
    "_pytest.doctest",
    "hypothesis.extra.numpy",
)
#: Rooms whose tests take minutes, or need devices; kernels are compiled each time.
_LEFT_OUT = ("_kernels", "studies", "acquisition/drivers", "view/page/files")
#: Arguments of figures that only change their appearance.
_APPEARANCE = re.compile(
    r"(bottom|left|right|top)|[hw]space|(height|width)_ratios|(fig|font|label|marker)size"
    r"|alpha|cap(size|thick)|dpi|elev|handle(height|length)|(label)?pad|lw|linewidths?"
    r"|mew|ms|ncols?|shrink|xytext|zorder"
)
#: Functions whose arguments are places on the bar of progress, or sizes of caches.
_UNSEEN = frozenset(
    {"part", "_progress.part", "tell", "lru_cache", "functools.lru_cache"}
)
#: Numbers that are computed at once; results do not depend on them.
_SIZES = frozenset(
    {
        "_AT_ONCE",
        "_BLOCK",
        "_BLOCK_SEGMENTS",
        "_HALOS",
        "_PIECE",
        "_PIXELS",
        "_TOGETHER",
    }
)
#: Arguments that results do not depend on: how a function is compiled, or a sum formed;
#: one more evaluation; a tolerance, if it is tiny; a seed.
_HOW = re.compile(r"cache|nogil|optimize|check_finite|max_nfev|maxiter|seed")
_TOLERANCE = re.compile(r"[afgrx]tol")
#: Largest number that only keeps a divisor from 0, or ends an iteration.
_TINY = 1e-9
#: A sample of at least so many points is as good with one point more.
_MANY = 100
#: Functions whose numbers keep divisors from 0, if they are tiny.
_GUARDS = frozenset({"max", "np.clip", "np.fmax", "np.maximum"})
#: Counts, of which a comparison is changed by one.
_COUNTS = re.compile(r"\blen\(|\.(size|ndim|shape|count)\b")
#: Tests that look at all modules.
_OF_ALL = ("test_messages.py", "test_public_surface.py")
_LISTINGS = ("tests/unit/test_public_surface.py",)
#: Least budget of a change for which slow tests run, too [s].
_LONG = 30.0
#: Longest time of a test that is tried before all longer ones [s].
_SHORT = 0.5
#: Tests of `make check` that are not of `make test`.
_LONGER = "slow and not study"
_ARITHMETIC: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult, ast.Pow: ast.Mult,
}  # fmt: skip
_COMPARISONS: dict[type, type] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq, ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is,
    ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_REVERSED: dict[type, type] = {
    ast.Lt: ast.Gt, ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """One change of one file."""

    file: Path
    """Which one, in the repository."""
    line: int
    """Where."""
    said: str
    """What was changed."""
    start: int
    """First byte that is replaced."""
    end: int
    """The byte after the last one."""
    new: str
    """What comes in its place."""
    place: tuple[int, ...]
    """Kind, begin and end of what is replaced, in lines and bytes."""
    unseen: bool = False
    """Whether it alters no result by its kind."""

    @property
    def code(self) -> str:
        """The line that it begins in, without its margin."""
        return _lines(self.file, self.file.stat().st_mtime_ns)[self.line - 1].strip()

    @property
    def key(self) -> tuple[str, str, str]:
        """File, line and change, as the list of equivalent ones names them."""
        return self.file.relative_to(PACKAGE).as_posix(), self.code, self.said

    @property
    def source(self) -> str:
        """The whole file with the change."""
        raw = self.file.read_bytes()
        return (raw[: self.start] + self.new.encode() + raw[self.end :]).decode()


@functools.lru_cache(maxsize=1000)
def _lines(file: Path, time: int) -> list[str]:
    """Return the lines of a file that was last written at a time."""
    return file.read_text("utf-8").splitlines()


def mutants_of(file: Path) -> list[Mutant]:
    """Return all changes of a file that are worth a try.

    Parameters
    ----------
    file : pathlib.Path
        A module.

    Returns
    -------
    list of Mutant
        In the order of its lines.
    """
    raw = file.read_bytes()
    # Columns of `ast` are bytes.
    begins = [0]
    for line in raw.splitlines(keepends=True):
        begins.append(begins[-1] + len(line))
    found = []
    tree = ast.parse(raw)
    unseen = _unseen(tree)
    for node, new, said in _changes(tree):
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        found.append(
            Mutant(
                file=file, line=node.lineno, said=said, new=new,
                start=begins[node.lineno - 1] + node.col_offset,
                end=begins[node.end_lineno - 1] + node.end_col_offset,
                place=place_of(node),
                unseen=id(node) in unseen,
            )
        )  # fmt: skip
    return found


def _changes(tree: ast.Module) -> Iterator[tuple[ast.expr | ast.stmt, str, str]]:
    """Yield what is replaced, by what, and how that is called."""
    quiet = _quiet(tree)
    for node in ast.walk(tree):
        if id(node) in quiet:
            continue
        match node:
            case ast.Constant(value=bool() as value):
                yield node, str(not value), f"{value} -> {not value}"
            case ast.Constant(value=int() | float() as value):
                new = repr(value + 1) if isinstance(value, int) else repr(value * 1.1)
                new = "1.0" if value == 0.0 and isinstance(value, float) else new
                yield node, new, f"{value!r} -> {new}"
            case ast.BinOp(op=op) if type(op) in _ARITHMETIC:
                new = _with(node, op=_ARITHMETIC[type(op)]())
                yield node, f"({new})", f"{ast.unparse(node)} -> {new}"
            case ast.Compare(ops=[op]) if type(op) in _COMPARISONS:
                table = _REVERSED if _is_of_reals(node) else _COMPARISONS
                new = _with(node, ops=[table[type(op)]()])
                yield node, f"({new})", f"{ast.unparse(node)} -> {new}"
            case ast.BoolOp(op=op):
                other = ast.Or() if isinstance(op, ast.And) else ast.And()
                new = _with(node, op=other)
                yield node, f"({new})", f"{ast.unparse(node)} -> {new}"
            case ast.UnaryOp(op=ast.USub() | ast.Not(), operand=operand):
                new = ast.unparse(operand)
                yield node, f"({new})", f"{ast.unparse(node)} -> {new}"
            case ast.Return(value=ast.expr() as value):
                yield node, "return None", f"return {ast.unparse(value)} -> None"
            case ast.Expr(value=ast.Call()) | ast.AugAssign() | ast.Raise():
                yield node, "pass", f"without {ast.unparse(node)}"


def _is_of_reals(node: ast.Compare) -> bool:
    """Return whether a comparison has a limit that no value meets exactly."""
    sides = node.left, *node.comparators
    return (
        type(node.ops[0]) in _REVERSED
        and not any(
            isinstance(side, ast.Constant)
            and (isinstance(side.value, int) or side.value in (0.0, 1.0))
            for side in sides
        )
        and not _COUNTS.search(ast.unparse(node))
    )


def _unseen(tree: ast.Module) -> set[int]:
    """Return parts whose change alters no result by its kind."""
    parts: list[ast.AST] = []
    single: set[int] = _thinned_to(tree)
    for node in ast.walk(tree):
        match node:
            case ast.Call() if ast.unparse(node.func) in _UNSEEN:
                parts += node.args
                parts += [word.value for word in node.keywords]
            case ast.Expr(value=ast.Call(func=called)):
                # The statement as a whole; its arguments are parts of the call.
                single |= {id(node)} if ast.unparse(called) in _UNSEEN else set()
            case ast.Return(value=ast.Constant(value=False | None)):
                single.add(id(node))
            case ast.Assign(targets=[ast.Name(id=name)]) if name in _SIZES:
                numbers = [
                    n for n in ast.walk(node.value) if isinstance(n, ast.Constant)
                ]
                whole = all(isinstance(number.value, int) for number in numbers)
                parts += [node.value] if whole else []
            case ast.For(
                target=ast.Name(id="_"),
                iter=ast.Call(
                    func=ast.Name(id="range"), args=[ast.Constant(value=int() as count)]
                ),
            ) if count > 2:
                # One more repetition of an iteration.
                single.add(id(node.iter.args[0]))  # type: ignore[attr-defined]
        if isinstance(node, ast.Call):
            parts += [w.value for w in node.keywords if _is_looks(w.arg)]
            single |= _without_effect(node)
            if ast.unparse(node.func) == "zip":
                parts += [word.value for word in node.keywords]
            if ast.unparse(node.func).endswith("reshape"):
                # -1 and -2 are the length that is left; 1 is another one.
                single |= {
                    id(part.operand)
                    for part in ast.walk(node)
                    if isinstance(part, ast.UnaryOp) and ast.unparse(part) == "-1"
                }
    return single | {id(part) for whole in parts for part in ast.walk(whole)}


def _thinned_to(tree: ast.Module) -> set[int]:
    """Return numbers of points that are looked at in place of all of many."""
    steps = [
        part.right
        for node in ast.walk(tree)
        if isinstance(node, ast.Slice) and node.step is not None
        for part in ast.walk(node.step)
        if isinstance(part, ast.BinOp) and isinstance(part.op, ast.FloorDiv)
    ]
    names = {step.id for step in steps if isinstance(step, ast.Name)}
    found: list[ast.expr] = [*steps]
    for node in tree.body:
        match node:
            case ast.Assign(targets=[ast.Name(id=name)], value=value) if name in names:
                found.append(value)
            case ast.Assign(
                targets=[ast.Tuple(elts=left)], value=ast.Tuple(elts=right)
            ):
                found += [
                    value
                    for target, value in zip(left, right, strict=True)
                    if isinstance(target, ast.Name) and target.id in names
                ]
    return {
        id(part)
        for part in found
        if isinstance(part, ast.Constant)
        and isinstance(part.value, int)
        and part.value >= _MANY
    }


def _without_effect(call: ast.Call) -> set[int]:
    """Return numbers and flags of a call that no result depends on."""
    name = ast.unparse(call.func)
    found: list[ast.expr] = []
    for word in call.keywords:
        how, value = word.arg or "", word.value
        if not isinstance(value, ast.Constant):
            continue
        tiny = _TOLERANCE.fullmatch(how) and _is_tiny(value)
        if tiny or _HOW.fullmatch(how) or (how == "copy" and value.value is False):
            found.append(value)
    if name.endswith("default_rng"):
        found += [part for part in call.args if isinstance(part, ast.Constant)]
    if name in _GUARDS:
        found += [part for part in call.args if _is_tiny(part)]
    return {id(part) for part in found}


def _is_tiny(node: ast.expr) -> bool:
    return (
        isinstance(node, ast.Constant)
        and isinstance(node.value, float)
        and 0 < node.value <= _TINY
    )


def _is_looks(argument: str | None) -> bool:
    return argument is not None and _APPEARANCE.fullmatch(argument) is not None


def _parses(source: str) -> bool:
    try:
        ast.parse(source)
    except SyntaxError:
        return False
    return True


def _with(node: ast.expr, **changed: object) -> str:
    fields = {name: getattr(node, name) for name in node._fields} | changed
    return ast.unparse(type(node)(**fields))


def _quiet(tree: ast.Module) -> set[int]:
    """Return parts that no test could judge: texts, types, names that are exported."""
    quiet: set[int] = set()
    for node in ast.walk(tree):
        parts: list[ast.AST | None] = []
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            arguments = [*node.args.args, *node.args.kwonlyargs]
            parts += [node.returns, *(one.annotation for one in arguments)]
        elif isinstance(node, ast.AnnAssign):
            parts.append(node.annotation)
        elif isinstance(node, ast.JoinedStr | ast.Raise):
            # Of what a message says the words are tested, not each digit.
            parts += list(ast.iter_child_nodes(node))
        elif isinstance(node, ast.ClassDef):
            # What must not be done with a data class is for the type checker to see.
            parts += node.decorator_list
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            parts.append(node)
        for part in parts:
            quiet.update(id(one) for one in ast.walk(part)) if part else None
    return quiet


def equivalents(listed: Path = EQUIVALENT) -> dict[tuple[str, str, str], str]:
    """Return the changes that are known to change nothing that can be observed.

    Parameters
    ----------
    listed : pathlib.Path
        A file with tables `[[mutant]]` of `file`, `code`, `change` and `reason`.

    Returns
    -------
    dict
        The reason of each, by file, code of the line and change.
    """
    rows = tomllib.loads(listed.read_text("utf-8"))["mutant"]
    return {(row["file"], row["code"], row["change"]): row["reason"] for row in rows}


def tests_of(file: Path) -> list[list[str]]:
    """Return the tests that touch a module: the nearest ones, then all others.

    Parameters
    ----------
    file : pathlib.Path
        A module of the package.

    Returns
    -------
    list of list of str
        Files of tests that are called after the module, name it, or name what it
        defines for others; then those of its room, and of the whole program those that
        name the module or its package. None is empty, and none holds a file twice.
    """
    inside = file.relative_to(PACKAGE)
    tests = ROOT / "tests"
    own = [tests / "unit" / part for part in (inside.parent, inside.parts[0])]
    room = next((place for place in own if place.is_dir()), tests / "unit")
    name = ".".join(("amulor", *inside.with_suffix("").parts))
    public = [
        node.name
        for node in ast.parse(file.read_bytes()).body
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
        and not node.name.startswith("_")
    ]
    defined = re.compile(rf"\b({'|'.join(public)})\b") if public else None
    stem = inside.stem.strip("_")
    near, far = [], []
    for path, text in _test_texts(tests):
        beside = inside.stem in text
        named = name in text or (beside and name in _imported(text))
        if path.is_relative_to(room):
            close = stem in path.stem or named or (defined and defined.search(text))
            (near if close else far).append(path)
        elif named or path.name in _OF_ALL:
            far.append(path)
    near.sort(key=lambda path: stem not in path.stem)
    staged = [[str(path.relative_to(ROOT)) for path in found] for found in (near, far)]
    return [found for found in staged if found]


@functools.cache
def _test_texts(tests: Path) -> list[tuple[Path, str]]:
    """Return the files of tests without a browser, and their texts."""
    return [
        (path, path.read_text("utf-8"))
        for path in sorted(tests.glob("**/test_*.py"))
        if not {"browser", "soak"} & set(path.parts)
    ]


@functools.cache
def _imported(text: str) -> set[str]:
    """Return what a source imports by whole names, in whatever form it says so."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {one.name for one in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{one.name}" for one in node.names}
    return found


def summary(tried: int, noticed: int, equivalent: int) -> str:
    """Return the share of changes that were noticed, in a line.

    Parameters
    ----------
    tried : int
        Changes that were drawn.
    noticed : int
        Those that a test noticed.
    equivalent : int
        Those that are known to change nothing.

    Returns
    -------
    str
        Share of the others that was noticed, with its interval of 95 % (Clopper and
        Pearson).
    """
    others = tried - equivalent
    if not others:
        return f"all {tried} changes are equivalent"
    interval = binomtest(noticed, others).proportion_ci(0.95, method="exact")
    return (
        f"{noticed} of {others} changes that are not equivalent were caught: "
        f"{noticed / others:.1%}, 95 % within {interval.low:.1%} and "
        f"{interval.high:.1%}; {equivalent} of {tried} drawn are equivalent"
    )


def folder_of(name: str) -> str:
    """Return the folder of the package that a file is in; "." for its own files."""
    return name.partition("/")[0] if "/" in name else "."


def weighted(counts: dict[str, tuple[int, int]], sizes: dict[str, int]) -> str:
    """Return the share of all changes that tests notice, from a stratified sample.

    Parameters
    ----------
    counts : dict
        Changes that were noticed, and all that were tried, by folder.
    sizes : dict
        Number of possible changes by folder, the weights.

    Returns
    -------
    str
        Weighted share with its interval of 95 %. Each folder's variance is that of
        (k + 1) of (n + 2), which is not zero where all changes were noticed.
    """
    tried = {name: count for name, count in counts.items() if count[1]}
    total = sum(sizes[name] for name in tried)
    share = variance = 0.0
    for name, (noticed, count) in tried.items():
        weight = sizes[name] / total
        near = (noticed + 1) / (count + 2)
        share += weight * noticed / count
        variance += weight**2 * near * (1 - near) / count
    spread = 1.96 * math.sqrt(variance)
    return (
        f"weighted by the changes of each folder: {share:.1%}, 95 % within "
        f"{share - spread:.1%} and {min(share + spread, 1):.1%}"
    )


class _Watch:
    """Plug-in of pytest: the first failure, and an end when the budget is used."""

    def __init__(
        self, budget: float, longest: float, without: frozenset[str], current: Path
    ) -> None:
        self._budget, self.failed, self.count, self.ended = budget, "", 0, False
        self._longest, self._without, self._current = longest, without, current

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if item.nodeid not in self._without]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.count += report.when == "call"
        if report.failed:
            self.failed = self.failed or report.nodeid

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self.failed = self.failed or report.nodeid

    def pytest_runtest_setup(self, item: pytest.Item) -> None:
        if _used() > self._budget:
            self.ended = True
            pytest.exit("the budget is used", returncode=5)
        limit_time(self._longest)
        with self._current.open("a") as file:
            file.write(item.nodeid + "\n")


def _used() -> float:
    """Return the processor time of this process and its children [s]."""
    parts = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return sum(sum(resource.getrusage(part)[:2]) for part in parts)


@dataclass
class Outcome:
    """Result of the tests of a change."""

    failed: str = ""
    """First test that failed, or that did not end."""
    seconds: float = 0.0
    """Processor time [s]."""
    count: int = 0
    """Number of tests that ran."""
    hangs: bool = False
    """Whether that test did not end."""
    ended: bool = False
    """Whether the budget ended before the tests."""
    started: frozenset[str] = frozenset()
    """Tests that began."""

    @property
    def by(self) -> str:
        """Test that noticed the change, "hang", or "budget"."""
        if self.failed:
            return "hang" if self.hangs else self.failed
        return "budget" if self.ended else ""


class Worker:
    """Copy of the sources, and tests against it in forked processes."""

    def __init__(
        self, folder: Path, *, budget: float, tests: dict[str, dict[str, float]]
    ) -> None:
        self._copy, self._budget, self._tests = folder / "src", budget, tests
        # Compiled functions come along.
        shutil.copytree(ROOT / "src", self._copy)
        self._sound: set[str] = set()
        self._broken: set[str] = set()
        for name in _LIBRARIES:
            with contextlib.suppress(ImportError):
                importlib.import_module(name)

    def outcome(self, mutant: Mutant) -> Outcome:
        """Run the tests of a change, and return their result."""
        place = self._copy / "amulor" / mutant.file.relative_to(PACKAGE)
        kept, times = place.read_bytes(), place.stat()
        place.write_text(mutant.source, "utf-8")
        try:
            while True:
                outcome = self._tried(mutant, place)
                if not outcome.failed or outcome.failed in self._sound:
                    return outcome
                # A test that fails without the change, too, is left out.
                place.write_bytes(kept)
                os.utime(place, ns=(times.st_atime_ns, times.st_mtime_ns))
                again = self._run([outcome.failed], self._budget, marks="not study")
                (self._broken if again.failed else self._sound).add(outcome.failed)
                if not again.failed:
                    return outcome
                place.write_text(mutant.source, "utf-8")
        finally:
            place.write_bytes(kept)
            os.utime(place, ns=(times.st_atime_ns, times.st_mtime_ns))

    def _tried(self, mutant: Mutant, place: Path) -> Outcome:
        near = tests_of(mutant.file)
        stem = mutant.file.stem.strip("_")
        first = [file for file in near[0] if stem in Path(file).stem]
        running = self._tests.get("\t".join(mutant.key), {})
        if running and "" not in running:
            stages = [ordered(running, near)]
            if parsed(mutant.file).is_definition(mutant.line):
                stages.insert(0, list(_LISTINGS))
        else:
            stages = [first, [file for file in near[0] if file not in first], *near[1:]]
        if ">>>" in place.read_text("utf-8"):
            stages.insert(0, [str(place)])
        plan = [(stage, "not slow and not study") for stage in stages]
        plan += [([file for stage in near for file in stage], _LONGER)]
        total = Outcome()
        for number, (tests, marks) in enumerate(plan):
            left = self._budget - total.seconds
            if tests and left > 0:
                part = self._row(tests, left, marks)
                total.failed, total.hangs = part.failed, part.hangs
                total.seconds += part.seconds
                total.count += part.count
                # Long tests are more than a budget has room for.
                total.ended |= part.ended and number < len(plan) - 1
            else:
                total.ended |= bool(tests) and number < len(plan) - 1
            if total.failed:
                break
        return total

    def _row(self, tests: list[str], budget: float, marks: str) -> Outcome:
        """Run tests; one that takes too long is tried alone, then the others go on."""
        started: frozenset[str] = frozenset()
        seconds, count = 0.0, 0
        while True:
            part = self._run(
                tests, budget - seconds, marks=marks, without=started,
                longest=self._budget / 2,
            )  # fmt: skip
            seconds, count = seconds + part.seconds, count + part.count
            if part.hangs:
                started |= part.started
                alone = self._run([part.failed], self._budget, marks="not study")
                if not alone.failed and part.started and seconds < budget:
                    continue
                part = alone
                part.ended = not part.failed
            part.seconds, part.count = seconds, count
            return part

    def _run(
        self,
        tests: list[str],
        budget: float,
        *,
        marks: str,
        without: frozenset[str] = frozenset(),
        longest: float = math.inf,
    ) -> Outcome:
        """Run tests in a forked process, until one fails or the budget is used."""
        # A file that cannot be imported is broken as a whole.
        tests = [test for test in tests if test not in self._broken]
        if not tests:
            return Outcome()
        with (
            tempfile.NamedTemporaryFile("r", suffix=".json") as answer,
            tempfile.NamedTemporaryFile("r", suffix=".txt") as current,
        ):
            child = os.fork()
            if child == 0:
                files = Path(answer.name), Path(current.name)
                try:
                    plugin = _Watch(budget, longest, without | self._broken, files[1])
                    self._test(tests, marks, plugin, files[0])
                except BaseException:
                    files[0].write_text(traceback.format_exc())
                    os._exit(1)
                os._exit(0)
            _, status, usage = _waited(child, 6 * self._budget + 60)
            seconds = usage.ru_utime + usage.ru_stime
            text, started = answer.read(), current.read().splitlines()
        if not text:  # ended by a limit of time, or by a crash
            return Outcome(
                [*tests[:1], *started][-1], seconds, len(started),
                hangs=status is None or not os.WIFEXITED(status),
                started=frozenset(started),
            )  # fmt: skip
        if status:
            raise RuntimeError(text)
        return Outcome(**{**json.loads(text), "seconds": seconds})

    def _test(self, tests: list[str], marks: str, watch: _Watch, answer: Path) -> None:
        os.setpgid(0, 0)
        null = os.open(os.devnull, os.O_RDWR)
        for number in range(3):
            os.dup2(null, number)
        # A test that begins at the end of the budget has half of a budget to end.
        limit = math.ceil(1.5 * self._budget + 5)
        resource.setrlimit(resource.RLIMIT_CPU, (limit, limit + 5))
        os.chdir(ROOT)
        sys.dont_write_bytecode = True
        sys.path.insert(0, str(self._copy))
        os.environ |= {
            "PYTHONPATH": search_path(self._copy),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        options = ["-c", str(ROOT / "pyproject.toml"), "-x", "-q", "-m", marks]
        options += ["-p", "no:cacheprovider"]
        options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
        with (
            contextlib.redirect_stdout(io.StringIO()) as output,
            contextlib.redirect_stderr(output),
        ):
            code = pytest.main([*options, *tests], plugins=[watch])
        if code not in (0, 1, 4, 5) and not watch.failed:
            raise RuntimeError(f"pytest ended with {code}: {output.getvalue()}")
        # 5: no test at all; 4: a test that is gone; others are catches.
        failed = watch.failed or ("set-up" if code not in (0, 4, 5) else "")
        found = {"failed": failed, "count": watch.count, "ended": watch.ended}
        answer.write_text(json.dumps(found))


def ordered(tests: dict[str, float], near: list[list[str]]) -> list[str]:
    """Return tests in the order in which they are tried.

    Parameters
    ----------
    tests : dict
        Time of each test, or file of tests [s].
    near : list of list of str
        Files of tests, the nearest first.

    Returns
    -------
    list of str
        Those of at most `_SHORT` first, so that one long test does not use up the
        budget of many short ones. Then files one after another, as near ones before
        others, then by their fastest test; of a file the fast ones first.
    """
    files = [file for stage in near for file in stage]
    rank = {file: number // 4 for number, file in enumerate(files)}
    fastest: dict[str, float] = {}
    for test, seconds in tests.items():
        file = test.partition("::")[0]
        fastest[file] = min(seconds, fastest.get(file, math.inf))

    def key(test: str) -> tuple[bool, float, float, str, float]:
        file, seconds = test.partition("::")[0], tests[test]
        near_by = rank.get(file, math.inf)
        return seconds > _SHORT, near_by, fastest[file], file, seconds

    return sorted(tests, key=key)


def _waited(
    child: int, longest: float
) -> tuple[int, int | None, resource.struct_rusage]:
    """Wait for a process; end it, with all that it started, after a time [s]."""
    deadline = time.monotonic() + longest
    while True:
        number, status, usage = os.wait4(child, os.WNOHANG)
        if number:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(child, signal.SIGKILL)
            return number, status, usage
        if time.monotonic() > deadline:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(child, signal.SIGKILL)
            number, _, usage = os.wait4(child, 0)
            return number, None, usage
        time.sleep(0.05)


def sampled(by_folder: dict[str, list[Mutant]], count: int, seed: int) -> list[Mutant]:
    """Return a stratified sample, in an order in which each folder comes early.

    Parameters
    ----------
    by_folder : dict
        All changes of each folder.
    count : int
        Number of changes.
    seed : int
        Which draws.

    Returns
    -------
    list of Mutant
        Of each folder a share in proportion to the root of its changes, at least 8.
        Each change has a random number that follows from its line and the seed alone;
        the lowest numbers are drawn.
    """
    roots = {name: len(found) ** 0.5 for name, found in by_folder.items()}
    placed: list[tuple[float, Mutant]] = []
    for name, found in by_folder.items():
        share = max(round(count * roots[name] / sum(roots.values())), _LEAST)
        rng = random.Random(f"{seed} {name}")
        drawn = _by_chance(found, seed)[:share]
        placed += [
            ((n + rng.random()) / len(drawn), one) for n, one in enumerate(drawn)
        ]
    placed.sort(key=lambda pair: pair[0])
    return [mutant for _, mutant in placed]


def _by_chance(found: list[Mutant], seed: int) -> list[Mutant]:
    """Return changes in the order of random numbers of their own."""
    before: Counter[tuple[str, str, str]] = Counter()
    numbers = []
    for mutant in found:
        # The same change of the same line may stand at several places of a file.
        before[mutant.key] += 1
        text = "\t".join((str(seed), *mutant.key, str(before[mutant.key])))
        numbers.append(hashlib.sha256(text.encode()).digest())
    order = sorted(range(len(found)), key=numbers.__getitem__)
    return [found[n] for n in order]


def results(path: Path) -> dict[tuple[str, str, str], dict[str, str]]:
    """Return the lines of a campaign, by file, code and change.

    Parameters
    ----------
    path : pathlib.Path
        Table of results; it may be missing.

    Returns
    -------
    dict
        Columns of each line.
    """
    if not path.exists():
        return {}
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {(row["file"], row["code"], row["change"]): row for row in rows}


#: Columns of the table of results.
COLUMNS = ("file", "line", "code", "change", "result", "by", "seconds", "seed")


def _chosen(names: list[str]) -> list[Path]:
    files = [
        path
        for name in names or ["."]
        for path in sorted(
            [PACKAGE / name] if name.endswith(".py") else (PACKAGE / name).rglob("*.py")
        )
    ]
    return [
        path for path in files
        if not any(part in str(path.relative_to(PACKAGE)) for part in _LEFT_OUT)
    ]  # fmt: skip


_worker: Worker


def _begin(folder: str, budget: float, tests: dict[str, dict[str, float]]) -> None:
    global _worker
    place = tempfile.mkdtemp(dir=folder)
    _worker = Worker(Path(place), budget=budget, tests=tests)


def _try(mutant: Mutant) -> tuple[Mutant, Outcome]:
    return mutant, _worker.outcome(mutant)


def shares(
    rows: list[dict[str, str]], sizes: dict[str, int]
) -> dict[str, tuple[int, int, float, float]]:
    """Return the shares that were caught by folder, and in all of them together.

    Parameters
    ----------
    rows : list of dict
        Lines of the table of results.
    sizes : dict
        Number of possible changes by folder.

    Returns
    -------
    dict
        Changes that were caught and tried, and limits of 95 % of the share (Clopper and
        Pearson).
    """
    counts: dict[str, tuple[int, int]] = {}
    for name in sorted(sizes):
        found = Counter(row["result"] for row in rows if folder_of(row["file"]) == name)
        if others := found["caught"] + found["survived"]:
            counts[name] = found["caught"], others
    if counts:
        every = list(counts.values())
        counts["all"] = sum(one for one, _ in every), sum(one for _, one in every)
    return {
        name: (*count, *binomtest(*count).proportion_ci(0.95, method="exact"))
        for name, count in counts.items()
    }


def table(rows: list[dict[str, str]], sizes: dict[str, int]) -> str:
    """Return the shares that were caught as a table in Markdown, and weighted."""
    lines = [
        "| folder | caught | of | share | 95 % |",
        "| --- | --- | --- | --- | --- |",
    ]
    found = shares(rows, sizes)
    for name, (noticed, others, low, high) in found.items():
        lines.append(
            f"| {name} | {noticed} | {others} | {noticed / others:.0%} | "
            f"{low:.0%} to {high:.0%} |"
        )
    counts = {name: count[:2] for name, count in found.items() if name in sizes}
    return "\n".join([*lines, "", weighted(counts, sizes)])


def _write_shares(
    path: Path, rows: list[dict[str, str]], sizes: dict[str, int]
) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("folder", "caught", "tried", "share_%", "low_%", "high_%"))
        for name, (noticed, others, *ends) in shares(rows, sizes).items():
            numbers = (100 * value for value in (noticed / others, *ends))
            writer.writerow((name, noticed, others, *(f"{n:.0f}" for n in numbers)))


def main() -> int:
    """Try some changes and print what no test noticed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("places", nargs="*", help="folders or files, all by default")
    parser.add_argument("--sample", type=int, default=200, help="how many changes")
    parser.add_argument("--seed", type=int, default=1, help="which ones")
    parser.add_argument("--budget", type=float, default=40.0, help="of a change [s]")
    parser.add_argument("--minutes", type=float, default=25.0, help="of this run")
    parser.add_argument("--jobs", type=int, default=2, help="changes at once")
    parser.add_argument("--least", type=float, default=0.0, help="share to be caught")
    parser.add_argument("--covering", type=Path, help="tests of each change (JSON)")
    parser.add_argument("--cover", nargs="+", help="write that file: tests to run")
    parser.add_argument("--results", type=Path, default=RESULTS, help="table")
    parser.add_argument("--shares", type=Path, help="table of shares to write (CSV)")
    parser.add_argument("--part", default="1/1", help="of the changes, such as 1/2")
    parser.add_argument("--again", action="store_true", help="all survivors")
    words = parser.parse_args()
    by_folder: dict[str, list[Mutant]] = {}
    for file in _chosen(words.places):
        name = folder_of(file.relative_to(PACKAGE).as_posix())
        by_folder.setdefault(name, []).extend(mutants_of(file))
    sizes = {name: len(found) for name, found in by_folder.items() if found}
    by_folder = {name: by_folder[name] for name in sizes}
    known, earlier = equivalents(), results(words.results)
    drawn = sampled(by_folder, words.sample, words.seed)
    if words.again:
        left = {key for key, row in earlier.items() if row["result"] == "survived"}
        every = [mutant for found in by_folder.values() for mutant in found]
        drawn = list({m.key: m for m in every if m.key in left}.values())
    drawn = [mutant for mutant in drawn if _parses(mutant.source)]
    tests: dict[str, dict[str, float]] = {}
    if words.covering and words.covering.exists():
        tests = json.loads(words.covering.read_text())
    if words.cover:
        _cover(drawn, words.cover, words.covering, tests)
        return 0
    for mutant in drawn:
        if mutant.unseen or mutant.key in known:
            seed = earlier.get(mutant.key, {}).get("seed", str(words.seed))
            earlier[mutant.key] = _row(mutant, "equivalent", Outcome(), seed)
    part, parts = map(int, words.part.split("/"))
    # Parts of what is drawn, not of what is left, so that each goes on with its own.
    mine = drawn[part - 1 :: parts]
    waiting = [m for m in mine if words.again or m.key not in earlier]
    deadline = time.monotonic() + 60 * words.minutes
    os.environ |= {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    if tests:

        def done(mutant: Mutant, trial: Trial) -> bool:
            outcome = Outcome(
                trial.failed, trial.seconds, trial.count, trial.hangs, trial.ended
            )
            _record(words, earlier, mutant, outcome)
            return time.monotonic() < deadline

        _switch(waiting, tests, words.budget, done)
        waiting = [m for m in waiting if not _switches(m, tests)]
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(
            words.jobs, multiprocessing.get_context("spawn"), _begin,
            (folder, words.budget, tests),
        ) as pool,
    ):  # fmt: skip
        order = iter(waiting)
        jobs = 0 if tests and time.monotonic() > deadline else words.jobs
        running = {pool.submit(_try, mutant) for mutant in islice(order, jobs)}
        while running:
            ended, running = wait(running, return_when=FIRST_COMPLETED)
            for ended_one in ended:
                _record(words, earlier, *ended_one.result())
                if time.monotonic() < deadline:
                    running |= {pool.submit(_try, m) for m in islice(order, 1)}
    _write(words.results, list(earlier.values()))
    rows = [earlier[mutant.key] for mutant in drawn if mutant.key in earlier]
    found = Counter(row["result"] for row in rows)
    print(f"\n{table(rows, sizes)}\n")
    if words.shares:
        _write_shares(words.shares, rows, sizes)
    print(summary(len(rows), found["caught"], found["equivalent"]))
    for row in rows:
        if row["result"] == "survived":
            print(f"  {row['file']}:{row['line']}: {row['change']}")
    others = found["caught"] + found["survived"]
    return int(found["caught"] < words.least * others)


def _record(
    words: argparse.Namespace,
    earlier: dict[tuple[str, str, str], dict[str, str]],
    mutant: Mutant,
    outcome: Outcome,
) -> None:
    """Write the result of a change to the table, and print it."""
    result = "caught" if outcome.failed else "survived"
    seed = earlier.get(mutant.key, {}).get("seed", str(words.seed))
    earlier[mutant.key] = _row(mutant, result, outcome, seed)
    _write(words.results, list(earlier.values()))
    place = f"{mutant.key[0]}:{mutant.line}: {mutant.said}"
    # The tests of changes run with another standard output.
    line = f"{result} {outcome.seconds:.0f} s {place[:150]}"
    print(line, file=sys.__stdout__, flush=True)


def _switches(mutant: Mutant, tests: dict[str, dict[str, float]]) -> bool:
    """Return whether a change takes effect behind a switch, and its tests are known.

    A cache of a function that runs before the tests has the result without the change.
    """
    running = tests.get("\t".join(mutant.key), {})
    return bool(running) and "" not in running and can_switch(mutant.file, mutant.line)


def _switch(
    waiting: list[Mutant],
    tests: dict[str, dict[str, float]],
    budget: float,
    done: Callable[[Mutant, Trial], bool],
) -> None:
    """Try the changes inside functions, all in one process that forks."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(ROOT / "src", copy)
        mutants = dict(enumerate(m for m in waiting if _switches(m, tests)))
        by_file: dict[Path, list[tuple[int, tuple[int, ...], str]]] = {}
        trials = []
        for number, mutant in mutants.items():
            by_file.setdefault(mutant.file, []).append(
                (number, mutant.place, mutant.new)
            )
            near = tests_of(mutant.file)
            running = tests.get("\t".join(mutant.key), {})
            chosen = ordered(running, near)
            place = copy / "amulor" / mutant.file.relative_to(PACKAGE)
            if ">>>" in mutant.file.read_text("utf-8"):
                chosen = [str(place), *chosen]
            # Slow tests only where there is time for them.
            longer = near[0] if budget >= _LONG else []
            trials.append(Trial(number=number, tests=chosen, longer=longer))
        for file, changes in by_file.items():
            place = copy / "amulor" / file.relative_to(PACKAGE)
            place.write_text(switched(file, changes), "utf-8")
        try_all(
            copy, trials, root=ROOT, budget=budget,
            done=lambda trial: done(mutants[trial.number], trial),
        )  # fmt: skip


def _cover(
    drawn: list[Mutant],
    chosen: list[str],
    output: Path,
    tests: dict[str, dict[str, float]],
) -> None:
    """Add the tests that run each change to a file."""
    lines = [(mutant.file, mutant.line) for mutant in drawn]
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(ROOT / "src", copy)
        found = covering(copy, PACKAGE, lines, chosen)
    for mutant, running in zip(drawn, found, strict=True):
        tests.setdefault("\t".join(mutant.key), {}).update(running)
    output.write_text(json.dumps(tests, indent=1))
    print(f"{sum(map(bool, found))} of {len(drawn)} changes are run by these tests")


def _row(mutant: Mutant, result: str, outcome: Outcome, seed: str) -> dict[str, str]:
    file, code, change = mutant.key
    values = (
        file, str(mutant.line), code, change, result, outcome.by,
        f"{outcome.seconds:.0f}", seed,
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def _write(path: Path, rows: list[dict[str, str]]) -> None:
    """Write the table of results under another name, then rename it."""
    with tempfile.NamedTemporaryFile(
        "w", dir=path.parent, delete=False, newline="", encoding="utf-8"
    ) as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted(rows, key=lambda row: (row["file"], int(row["line"]))))
    os.replace(file.name, path)


if __name__ == "__main__":
    sys.exit(main())
