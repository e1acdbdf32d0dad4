"""Changes one thing in a module at a time, and looks whether its tests notice.

Run from the root of the repository: `python tools/mutate.py --sample 60 --seed 1`, with
names of rooms or files (`rejection`, `io/ply.py`) to stay within them. The sources are
copied, the copy is changed; what is in the repository stays as it is. It prints the
share that was caught, with its binomial interval of 95 %, and each change that no test
noticed: close it by a test of behaviour, or see that it changes nothing that can be
observed and write it, with the reason, into `tools/equivalent_mutants.toml`. Changes
that stand there are drawn and counted, but not tried. With `--contexts`, data of
coverage.py with a context for each test, what the tests of its room let pass is shown
to every other test that runs the changed line.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from covering import Covering
from scipy.stats import binomtest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "amulor"
EQUIVALENT = Path(__file__).with_name("equivalent_mutants.toml")
#: Rooms whose tests take minutes, or need devices; kernels are compiled each time.
_LEFT_OUT = ("_kernels", "studies", "acquisition/drivers", "view/page/files")
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

    @property
    def code(self) -> str:
        """The line that it begins in, without its margin."""
        return self.file.read_text("utf-8").splitlines()[self.line - 1].strip()

    @property
    def key(self) -> tuple[str, str, str]:
        """File, line and change, as the list of equivalent ones names them."""
        return self.file.relative_to(PACKAGE).as_posix(), self.code, self.said

    @property
    def source(self) -> str:
        """The whole file with the change."""
        raw = self.file.read_bytes()
        return (raw[: self.start] + self.new.encode() + raw[self.end :]).decode()


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
    for node, new, said in _changes(ast.parse(raw)):
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        found.append(
            Mutant(
                file=file, line=node.lineno, said=said, new=new,
                start=begins[node.lineno - 1] + node.col_offset,
                end=begins[node.end_lineno - 1] + node.end_col_offset,
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
                new = _with(node, ops=[_COMPARISONS[type(op)]()])
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
    for path in sorted(tests.glob("**/test_*.py")):
        if "browser" in path.parts or "soak" in path.parts:
            continue
        text = path.read_text("utf-8")
        beside = inside.stem in text
        named = name in text or (beside and name in _imported(text))
        if path.is_relative_to(room):
            close = stem in path.stem or named or (defined and defined.search(text))
            (near if close else far).append(path)
        elif named:
            far.append(path)
    near.sort(key=lambda path: stem not in path.stem)
    staged = [[str(path.relative_to(ROOT)) for path in found] for found in (near, far)]
    return [found for found in staged if found]


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
    """Return what a campaign found, in a line.

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


def caught(
    mutant: Mutant, copy: Path, *, longest: float, covering: Covering | None = None
) -> bool:
    """Return whether a test fails, or does not end, with a change.

    Parameters
    ----------
    mutant : Mutant
        The change.
    copy : pathlib.Path
        A copy of the sources.
    longest : float
        Time after which the tests count as hanging [s].
    covering : Covering, optional
        Who runs which line. Its tests, and the longer ones of `make check`, do not
        count as hanging if they take more time than that together.

    Returns
    -------
    bool
        False if all pass.
    """
    place = copy / "amulor" / mutant.file.relative_to(PACKAGE)
    kept = place.read_text("utf-8")
    place.write_text(mutant.source, "utf-8")
    try:
        stages = tests_of(mutant.file)
        if ">>>" in kept:
            stages = [[str(place)], *stages]
        if any(_fails(stage, copy, longest=longest) for stage in stages):
            return True
        near = [file for stage in stages for file in stage]
        if _fails(near, copy, longest=longest, hangs=False, marks=_LONGER):
            return True
        running = covering.tests(mutant.file, mutant.line) if covering else []
        far = [one for one in running if one.partition("::")[0] not in near]
        return _fails(far, copy, longest=longest, hangs=False, marks="not study")
    finally:
        place.write_text(kept, "utf-8")


def _fails(
    tests: list[str],
    copy: Path,
    *,
    longest: float,
    hangs: bool = True,
    marks: str | None = None,
) -> bool:
    if not tests:
        # Told no test, pytest would run all of them.
        return False
    words = [
        *(sys.executable, "-m", "pytest", "-c", str(ROOT / "pyproject.toml")),
        *("-x", "-q", "-p", "no:cacheprovider"),
        *(() if marks is None else ("-m", marks)),
    ]
    threads = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment = {**os.environ, **threads, "PYTHONPATH": str(copy)}
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as listed:
        # More tests than a command line holds.
        listed.write("\n".join(tests))
        listed.flush()
        try:
            done = subprocess.run(
                [*words, f"@{listed.name}"], cwd=ROOT, env=environment,
                timeout=longest, check=False,
                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return hangs
    # 5: no test at all, which is no catch; 4: nor is a test that is gone, but a change
    # with which the set-up of all tests fails is one.
    return done.returncode not in ((0, 5) if hangs else (0, 4, 5))


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


def main() -> int:
    """Try some changes and print what no test noticed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("places", nargs="*", help="rooms or files, all by default")
    parser.add_argument("--sample", type=int, default=100, help="how many changes")
    parser.add_argument("--seed", type=int, default=1, help="which ones")
    parser.add_argument("--longest", type=float, default=600.0, help="of a change [s]")
    parser.add_argument("--least", type=float, default=0.0, help="share to be caught")
    parser.add_argument("--contexts", type=Path, help="data of coverage.py")
    words = parser.parse_args()
    covering = Covering(words.contexts, PACKAGE) if words.contexts else None
    rng = random.Random(words.seed)
    # A file first, then a place in it: large files do not have all of the changes.
    by_file = {file: mutants_of(file) for file in _chosen(words.places)}
    by_file = {file: found for file, found in by_file.items() if found}
    tried = []
    while by_file and len(tried) < words.sample:
        file = rng.choices(
            list(by_file), [len(found) ** 0.5 for found in by_file.values()]
        )[0]
        one = by_file[file].pop(rng.randrange(len(by_file[file])))
        if _parses(one.source):
            tried.append(one)
        if not by_file[file]:
            del by_file[file]
    known = equivalents()
    survivors, equivalent = [], 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(ROOT / "src", copy)
        for number, mutant in enumerate(tried, start=1):
            begun = time.monotonic()
            where = f"{mutant.file.relative_to(ROOT)}:{mutant.line}: {mutant.said}"
            if mutant.key in known:
                equivalent += 1
                print(f"{number}/{len(tried)} equivalent {where[:150]}", flush=True)
                continue
            noticed = caught(mutant, copy, longest=words.longest, covering=covering)
            print(
                f"{number}/{len(tried)} {'caught' if noticed else 'NOT CAUGHT'} "
                f"{time.monotonic() - begun:.0f} s {where[:150]}",
                flush=True,
            )
            if not noticed:
                survivors.append(where)
    others = len(tried) - equivalent
    noticed_all = others - len(survivors)
    print(f"\n{summary(len(tried), noticed_all, equivalent)} (seed {words.seed})")
    print("\n".join(f"  {where}" for where in survivors))
    return int(noticed_all < words.least * others)


if __name__ == "__main__":
    sys.exit(main())
