"""Writes what the examples of the theory pages print below them, page by page.

    python docs/make_theory_outputs.py                      # all pages
    python docs/make_theory_outputs.py docs/theory/ranging.md

Examples of a page run one after the other and share their names.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parent / "theory"
EXAMPLE = re.compile(
    r"^```python\n(.*?)^```\n(?:\n```text\n(.*?)^```\n)?",
    flags=re.DOTALL | re.MULTILINE,
)


def run(page: str, *, name: str) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Return the names that a page defines, and what its examples print.

    Parameters
    ----------
    page : str
        Text of the page.
    name : str
        What a traceback calls it.

    Returns
    -------
    namespace : dict
        Names after the last example.
    outputs : list of (str, str)
        What the page shows below each example, and what the example prints.
    """
    namespace: dict[str, Any] = {}
    outputs = []
    for code, shown in EXAMPLE.findall(page):
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            exec(compile(code, name, "exec"), namespace)
        outputs.append((shown, printed.getvalue()))
    return namespace, outputs


def rewritten(page: str, *, name: str) -> str:
    """Return a page that shows what its examples print.

    Parameters
    ----------
    page : str
        Text of the page.
    name : str
        What a traceback calls it.

    Returns
    -------
    str
        The page, its outputs made anew.
    """
    _, outputs = run(page, name=name)
    printed = iter(output for _, output in outputs)

    def block(match: re.Match[str]) -> str:
        output = next(printed)
        below = f"\n```text\n{output}```\n" if output else ""
        return f"```python\n{match[1]}```\n{below}"

    return EXAMPLE.sub(block, page)


def main() -> None:
    """Rewrite the pages that are named, or all."""
    for path in [Path(name) for name in sys.argv[1:]] or sorted(FOLDER.glob("*.md")):
        page = path.read_text("utf-8")
        path.write_text(rewritten(page, name=path.name), "utf-8")


if __name__ == "__main__":
    main()
