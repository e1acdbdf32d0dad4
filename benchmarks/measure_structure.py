"""The shape of the code in figures: files, imports, climbs, compiled functions.

Run with ``python benchmarks/measure_structure.py [CHECKOUT]``. A room is a folder. The
imports counted are those between files of one floor (a folder directly below
src/amulor); the level of a file is the longest chain of such imports below it. Lines
of a compiled function count from its ``def`` on, the docstring left out. Climbs are
those of `follow_value.py`.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections import defaultdict
from pathlib import Path

#: Decorators that compile: of numba, and what the folders of kernels make of them.
COMPILERS = {
    "njit", "jit", "kernel", "inner", "step", "allocating", "entry", "allocating_entry",
}  # fmt: skip


def dotted(path, source):
    """Return the dotted name of a file."""
    parts = path.relative_to(source).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(tree, names):
    """Yield the files that a file imports, of those that are known."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield full if full in names else node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def compiled(tree):
    """Yield name, lines and arguments of each compiled function."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef):
            continue
        calls = {
            name.id if isinstance(name, ast.Name) else getattr(name, "attr", "")
            for decorator in node.decorator_list
            for name in ast.walk(decorator)
            if isinstance(name, ast.Name | ast.Attribute)
        }
        if calls & COMPILERS:
            told = ast.get_docstring(node, clean=False)
            lines = node.end_lineno - node.lineno + 1
            lines -= 0 if told is None else told.count("\n") + 1
            arguments = node.args
            count = len(arguments.args) + len(arguments.kwonlyargs)
            yield node.name, lines, count


def levels(edges):
    """Return the longest chain of imports below each file; circles are reported."""
    known = {}

    def level(name, above):
        if name in above:
            raise SystemExit("a circle: " + " -> ".join([*above, name]))
        if name not in known:
            below = [level(other, (*above, name)) for other in edges[name]]
            known[name] = 1 + max(below, default=-1)
        return known[name]

    for name in list(edges):
        level(name, ())
    return known


def imports(root):
    """Return, for each floor, the files that each of its files imports."""
    source = root / "src"
    trees = {p: ast.parse(p.read_text("utf-8")) for p in source.rglob("*.py")}
    names = {dotted(path, source): path for path in trees}
    edges = defaultdict(lambda: defaultdict(set))
    for path, tree in trees.items():
        name = dotted(path, source)
        floor = name.split(".")[1] if "." in name else ""
        if path.name != "__init__.py":
            edges[floor][name] |= {
                other
                for other in imported(tree, names)
                if other in names
                and other.startswith(f"amulor.{floor}.")
                and other != name
                and names[other].name != "__init__.py"
            }
    return edges


def lines_of(text, tree):
    """Return the lines of code, docstrings apart, and the lines of docstrings."""
    layout = {
        tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT,
        tokenize.DEDENT, tokenize.ENDMARKER,
    }  # fmt: skip
    code = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in layout:
            code.update(range(token.start[0], token.end[0] + 1))
    documented = set()
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        for statement in body if isinstance(body, list) else ():
            # Docstrings of modules, classes and functions, and of fields below them.
            if (
                isinstance(statement, ast.Expr)
                and isinstance(statement.value, ast.Constant)
                and isinstance(statement.value.value, str)
            ):
                documented.update(range(statement.lineno, statement.end_lineno + 1))
    return len(code - documented), len(documented)


def main():
    """Print the figures."""
    import follow_value

    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1])
    source = root / "src"
    edges = imports(root)
    rooms, functions, counts = defaultdict(int), [], []
    for path in source.rglob("*.py"):
        rooms[path.parent.relative_to(source).as_posix()] += 1
        text = path.read_text("utf-8")
        tree = ast.parse(text)
        counts.append(lines_of(text, tree))
        functions += [(*entry, dotted(path, source)) for entry in compiled(tree)]
    print(f"files {len(counts)}")
    print(f"lines of code, docstrings apart {sum(code for code, _ in counts)}")
    print(f"lines of docstrings {sum(documented for _, documented in counts)}")
    print(f"files of fewer than 60 lines {sum(code < 60 for code, _ in counts)}")
    contracts = (root / "pyproject.toml").read_text("utf-8")
    print(f"import contracts {contracts.count('[[tool.importlinter.contracts]]')}")
    print("\nclimbs of a value                  stations  climbs")
    for title, stations, _, climbs, _ in follow_value.climbs(root):
        print(f"{title:34}{stations:9}{climbs:8}")
    print("\nroom                                  files")
    for room in sorted(rooms):
        print(f"{room:38}{rooms[room]:5}")
    print("\nfloor            files  imports  levels")
    for floor in sorted(edges):
        count = sum(map(len, edges[floor].values()))
        try:
            deepest = max(levels(edges[floor]).values()) + 1
        except SystemExit as circle:
            deepest = circle
        print(f"{floor:16}{len(edges[floor]):6}{count:9}  {deepest}")
    print("\ncompiled functions", len(functions))
    for title, key in (("longest [lines]", 1), ("widest [arguments]", 2)):
        print(title)
        for entry in sorted(functions, key=lambda e: -e[key])[:5]:
            print(f"  {entry[key]:4}  {entry[3]}.{entry[0]}")


if __name__ == "__main__":
    main()
