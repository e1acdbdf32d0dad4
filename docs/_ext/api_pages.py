"""Writes a page for each public module and a table of its names, before Sphinx reads.

Public names are those of `tests/reference/public_surface.txt`, which a test compares
with the package. Functions and classes that pages and examples import are added.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.config import Config

ROOT = Path(__file__).parents[2]
LISTING = ROOT / "tests" / "reference" / "public_surface.txt"
#: Long names break after a dot, at a space of no width.
BREAK = ".\u200b"
#: Modules in the order in which a scan uses them.
_ORDER = (
    "amulor", "survey", "simulation", "acquisition", "cube", "rejection", "imaging",
    "pipeline", "site", "design", "scale", "io", "view", "samples", "optics",
    "transport", "studies", "units", "errors",
)  # fmt: skip


@cache
def modules() -> dict[str, list[str]]:
    """Return the public names of each public module, under the full module name."""
    found: dict[str, list[str]] = defaultdict(list)
    kinds = dict(line.split()[:2] for line in LISTING.read_text().splitlines())
    for name, kind in kinds.items():
        if kind == "module":
            found[name]
        else:
            found[name.rpartition(".")[0]].append(name)
    public = {id(_object(name)) for name in kinds}
    for name in sorted(set(_imported())):
        thing = _object(name)
        if id(thing) not in public and (
            inspect.isfunction(thing) or inspect.isclass(thing)
        ):
            found[name.rpartition(".")[0]].append(name)
    return dict(found)


def _object(name: str) -> object:
    module, _, attribute = name.rpartition(".")
    try:
        return getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError):
        return None


def _imported() -> Iterator[str]:
    """Yield the names of amulor that pages and examples import."""
    built = {"_build", "api", "examples", "decisions"}
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    texts = [path.read_text() for path in (ROOT / "examples").rglob("*.py")]
    for page in pages:
        if not built & set(page.relative_to(ROOT).parts[1:]):
            texts += re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    for text in texts:
        try:
            nodes = ast.walk(ast.parse(text))
        except SyntaxError:  # a part of a program
            continue
        for node in nodes:
            if isinstance(node, ast.ImportFrom) and node.module:
                yield from (
                    f"{node.module}.{name.name}"
                    for name in node.names
                    if node.module.startswith("amulor")
                )


def _place(module: str) -> tuple[int, str]:
    folder = [*module.split("."), ""][1] or "amulor"
    return (_ORDER.index(folder) if folder in _ORDER else len(_ORDER), module)


def write(app: Sphinx, config: Config) -> None:
    """Write `api/index.rst` and `api/<module>.rst`, where their text has changed."""
    folder = Path(app.srcdir) / "api"
    folder.mkdir(exist_ok=True)
    names = modules()
    pages = {"index": _index(sorted(names, key=_place))}
    pages |= {module: _page(module, names[module]) for module in names}
    for stem, text in pages.items():
        path = folder / f"{stem}.rst"
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
    # Pages that are new in this build get pages of their names, too.
    config.autosummary_generate = [f"api/{stem}.rst" for stem in pages]


def _index(modules: list[str]) -> str:
    lines = [
        "API",
        "===",
        "",
        "Every public function and class, with its units, its source equation, an",
        "example, and the gallery entries that use it. Modules are listed in the order",
        "in which a scan uses them.",
        "",
        ".. toctree::",
        "   :maxdepth: 1",
        "",
        *(f"   {module.replace('.', BREAK)} <{module}>" for module in modules),
    ]
    return "\n".join(lines) + "\n"


def _page(module: str, names: list[str]) -> str:
    lines = [module, "=" * len(module), "", f".. automodule:: {module}", ""]
    if module == "amulor":
        # The same objects have their pages in their modules.
        short = [name.rpartition(".")[2] for name in names]
        lines += [f"- ``amulor.{name}``: {_home(name)}" for name in short]
    elif names:
        lines += [
            f".. currentmodule:: {module}",
            "",
            ".. autosummary::",
            "   :toctree: generated",
            "",
            *(f"   {name.rpartition('.')[2]}" for name in names),
        ]
    return "\n".join(lines) + "\n"


def _home(name: str) -> str:
    """Return a reference to the module of a name that `amulor` has as well."""
    return next(
        f":py:obj:`{full}`"
        for module, names in modules().items()
        for full in names
        if module != "amulor" and full.rpartition(".")[2] == name
    )


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect with Sphinx."""
    # Before Sphinx looks which pages there are.
    app.connect("config-inited", write)
    return {"parallel_read_safe": True}
