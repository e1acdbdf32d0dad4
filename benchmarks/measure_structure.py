"""The shape of the code in figures: files and imports a room, compiled functions.

Run with ``python benchmarks/measure_structure.py [CHECKOUT]``. A room is a folder. The
imports counted are those between files of one floor (a folder directly below
src/amulor); the level of a file is the longest chain of such imports below it. Lines
of a compiled function count from its ``def`` on, the docstring left out.
"""

from __future__ import annotations

import ast
import sys
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


def main():
    """Print the figures."""
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1])
    source = root / "src"
    edges = imports(root)
    rooms, functions = defaultdict(int), []
    for path in source.rglob("*.py"):
        rooms[path.parent.relative_to(source / "amulor").as_posix()] += 1
        tree = ast.parse(path.read_text("utf-8"))
        functions += [(*entry, dotted(path, source)) for entry in compiled(tree)]
    print("room                                  files")
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
