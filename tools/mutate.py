"""Changes one thing in a module at a time, and looks whether its tests notice.

Run from the root of the repository: `python tools/mutate.py --sample 60 --seed 1`, with
names of rooms or files (`rejection`, `io/ply.py`) to stay within them. The sources are
copied, the copy is changed; what is in the repository stays as it is. It prints the
share that was caught, and each change that no test noticed: close it by a test of
behaviour, or see that it changes nothing that can be observed.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "amulor"
#: Rooms whose tests take minutes, or need devices; kernels are compiled each time.
_LEFT_OUT = ("_kernels", "studies", "acquisition/drivers", "view/page/files")
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
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            parts.append(node)
        for part in parts:
            quiet.update(id(one) for one in ast.walk(part)) if part else None
    return quiet


def tests_of(file: Path) -> list[str]:
    """Return the tests that touch a module, by the layout of the folders.

    Parameters
    ----------
    file : pathlib.Path
        A module of the package.

    Returns
    -------
    list of str
        Folders and files of tests, those of its room first; of the whole program those
        that name the module or its package.
    """
    inside = file.relative_to(PACKAGE)
    tests = ROOT / "tests"
    own = [tests / "unit" / part for part in (inside.parent, inside.parts[0])]
    found = [next((place for place in own if place.is_dir()), tests / "unit")]
    name = ".".join(("amulor", *inside.with_suffix("").parts))
    called = (name, name.rpartition(".")[0] + " import " + inside.stem)
    for path in sorted(tests.glob("**/test_*.py")):
        if any(path.is_relative_to(place) for place in found):
            continue
        if "browser" in path.parts or "soak" in path.parts:
            continue
        if any(word in path.read_text("utf-8") for word in called):
            found.append(path)
    return [str(path.relative_to(ROOT)) for path in found]


def caught(mutant: Mutant, copy: Path, *, longest: float) -> bool:
    """Return whether a test fails, or does not end, with a change.

    Parameters
    ----------
    mutant : Mutant
        The change.
    copy : pathlib.Path
        A copy of the sources.
    longest : float
        Time after which the tests count as hanging [s].

    Returns
    -------
    bool
        False if all pass.
    """
    place = copy / "amulor" / mutant.file.relative_to(PACKAGE)
    kept = place.read_text("utf-8")
    place.write_text(mutant.source, "utf-8")
    try:
        return _fails(tests_of(mutant.file), copy, longest=longest)
    finally:
        place.write_text(kept, "utf-8")


def _fails(tests: list[str], copy: Path, *, longest: float) -> bool:
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    threads = {"NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment = {**os.environ, **threads, "PYTHONPATH": str(copy)}
    try:
        done = subprocess.run(
            [*words, *tests], cwd=ROOT, env=environment, timeout=longest, check=False,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return True
    # 5: no test at all, which is no catch.
    return done.returncode not in (0, 5)


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
    words = parser.parse_args()
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
    survivors = []
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(ROOT / "src", copy)
        for number, mutant in enumerate(tried, start=1):
            begun = time.monotonic()
            noticed = caught(mutant, copy, longest=words.longest)
            where = f"{mutant.file.relative_to(ROOT)}:{mutant.line}: {mutant.said}"
            print(
                f"{number}/{len(tried)} {'caught' if noticed else 'NOT CAUGHT'} "
                f"{time.monotonic() - begun:.0f} s {where[:150]}",
                flush=True,
            )
            if not noticed:
                survivors.append(where)
    share = 1 - len(survivors) / max(len(tried), 1)
    print(f"\n{share:.1%} of {len(tried)} changes were caught (seed {words.seed})")
    print("\n".join(f"  {where}" for where in survivors))
    return int(share < words.least)


if __name__ == "__main__":
    sys.exit(main())
