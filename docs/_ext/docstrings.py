"""Joins lines of a docstring that end with a backslash, as in long lists of names."""

from __future__ import annotations

from sphinx.application import Sphinx


def join(app: Sphinx, what: str, name: str, thing: object, options: object,
         lines: list[str]) -> None:  # fmt: skip
    """Join in place, before numpydoc looks for the parameters."""
    for i in range(len(lines) - 2, -1, -1):
        if lines[i].endswith("\\"):
            lines[i] = lines[i][:-1] + lines.pop(i + 1).strip()


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect with Sphinx."""
    app.connect("autodoc-process-docstring", join, priority=100)
    return {"parallel_read_safe": True}
