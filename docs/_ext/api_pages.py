"""Writes a page for each public module and a table of its names, before Sphinx reads.

What is public is what `tests/reference/public_surface.txt` lists, and a test holds that
against the package; so every public object has a page, and no other has one.
"""

from __future__ import annotations

from collections import defaultdict
from functools import cache
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.config import Config

LISTING = Path(__file__).parents[2] / "tests" / "reference" / "public_surface.txt"
#: Rooms in the order in which a scan goes through them.
_ROOMS = (
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
    return dict(found)


def _place(module: str) -> tuple[int, str]:
    room = [*module.split("."), ""][1] or "amulor"
    return (_ROOMS.index(room) if room in _ROOMS else len(_ROOMS), module)


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


def _index(modules: list[str]) -> str:
    lines = [
        "API",
        "===",
        "",
        "Every public function and class, with its units, its source equation, an",
        "example, and the gallery entries that use it. Rooms stand in the order in",
        "which a scan goes through them.",
        "",
        ".. toctree::",
        "   :maxdepth: 1",
        "",
        *(f"   {module}" for module in modules),
    ]
    return "\n".join(lines) + "\n"


def _page(module: str, names: list[str]) -> str:
    lines = [module, "=" * len(module), "", f".. automodule:: {module}", ""]
    if module == "amulor":
        # The same objects have their pages in their rooms.
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
    """Return a reference to the room of a name that `amulor` has as well."""
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
