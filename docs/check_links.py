"""Looks for links of the built site that lead nowhere, as `make docs` does last."""

from __future__ import annotations

import re
import sys
from html import unescape
from pathlib import Path
from urllib.parse import unquote, urlsplit

BUILT = Path(__file__).parent / "_build" / "html"
_TAG = re.compile(r"<[a-z][^>]*>")
_ATTRIBUTE = re.compile(r'\s(id|name|href|src)="([^"]*)"')


class _Page:
    """Anchors and links of a page."""

    def __init__(self, path: Path) -> None:
        self.anchors: set[str] = set()
        self.links: dict[str, None] = {}
        for tag in _TAG.findall(path.read_text("utf-8")):
            for name, value in _ATTRIBUTE.findall(tag):
                if name == "id" or (name == "name" and tag.startswith("<a ")):
                    self.anchors.add(unescape(value))
                elif name in {"href", "src"}:
                    self.links[unescape(value)] = None


def broken(folder: Path) -> list[str]:
    """Return a line for each link inside of a site whose file or anchor is not there.

    Parameters
    ----------
    folder : pathlib.Path
        Where the HTML files are.

    Returns
    -------
    list of str
        Page and link; links to other sites are not looked at.
    """
    folder = folder.resolve()
    # Below _static are templates of the theme.
    paths = [path for path in folder.rglob("*.html") if "_static" not in path.parts]
    pages = {path: _Page(path) for path in paths}
    found = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            file = unquote(parts.path)
            there = (path.parent / file).resolve() if file else path
            if there.is_dir():
                there /= "index.html"
            anchor = unquote(parts.fragment)
            if not there.exists():
                what = "no such file"
            elif anchor and there in pages and anchor not in pages[there].anchors:
                what = "no such place in it"
            else:
                continue
            found.append(f"{path.relative_to(folder)}: {link}: {what}")
    return found


if __name__ == "__main__":
    lines = broken(BUILT)
    print("\n".join(lines) or f"each link inside of {BUILT} leads somewhere")
    sys.exit(bool(lines))
