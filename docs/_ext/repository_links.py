"""Turns links of a page to files of the repository into what a site can show.

The pages are read in the repository, too, where they link to source files. On the site
a public module has its page in the API, and any other file is named in plain type.
"""

from __future__ import annotations

import re
from pathlib import Path

from api_pages import modules
from sphinx.application import Sphinx

ROOT = Path(__file__).parents[2]
_LINK = re.compile(r"(?<!!)\[([^\]\n]*)\]\(([^)\s#]+)(#[^)\s]*)?\)")


def replace(app: Sphinx, name: str, content: list[str]) -> None:
    """Rewrite the links of a page that lead out of the documentation."""
    source = Path(app.env.doc2path(name))
    if source.suffix != ".md":
        return
    known, docs = modules(), Path(app.srcdir)

    def target(match: re.Match[str]) -> str:
        text, link, _ = match.groups()
        if "://" in link or link.startswith("mailto:"):
            return match[0]
        path = (source.parent / link).resolve()
        if path.is_file() and path.is_relative_to(docs):
            if path.suffix == ".md":
                return match[0]
            return f"{{download}}`{text.replace('`', '')} <{link}>`"
        if not path.exists() or not path.is_relative_to(ROOT):
            return match[0]  # Sphinx says that it is broken
        parts = path.relative_to(ROOT).with_suffix("").parts
        module = ".".join(parts[1:]).removesuffix(".__init__")
        while parts[0] == "src" and module and module not in known:
            module = module.rpartition(".")[0]
        if parts[0] == "src" and module:
            up = "../" * len(Path(name).parent.parts)
            return f"[{text}]({up}api/{module}.rst)"
        return text if text.startswith("`") else f"`{text}`"

    content[0] = _LINK.sub(target, content[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect with Sphinx."""
    app.connect("source-read", replace)
    return {"parallel_read_safe": True}
