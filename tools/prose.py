"""Check the English of the documentation and of docstrings.

    python tools/prose.py              # all pages and modules that are not excused
    python tools/prose.py FILE ...     # these, excused or not
    python tools/prose.py --sample 100 --seed 7    # sentences of pages, to be judged

A line for each finding: a sentence that is too long or has too many numbers, a word of
the list, a first line of a docstring that does not begin with a noun or a verb.
"""

from __future__ import annotations

import ast
import random
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: Most words and most numbers of a sentence.
WORDS, NUMBERS = 30, 3
#: Everyday words, and British spellings, with what to write instead.
LIST = {
    r"comes? to (?!an? )": "is",
    r"makes? room": "increases the range",
    r"(was|were|is|are) left in\b": "remains",
    r"(was|were|is|are) (taken out|taken off)": "is subtracted",
    r"(was|were|is|are) put back": "is added again",
    r"(was|were|is|are) told": "states, gets",
    r"(was|were|is|are) looked at": "is examined",
    r"refused by name": "is refused, with the name",
    r"on (its|their) way (?!to|from|out)": "between",
    r"mends?\b": "repair, correct",
    r"(polar|digit|synchron|normal|author)is(e|ed|es|er|ing|ation)\b": "-ize",
    r"(neighbo|colo|harbo)ur": "-or",
    r"(centi|milli|deci|kilo)?met(re|res)\b(?! per)": "-meter",
    r"analysers?\b": "analyzer",
    r"licen[c]e\b": "license",
}
#: Openings of a docstring that hide its subject.
OPENINGS = re.compile(r"(What|Who|How|Which|That of|Return (what|that|the same))\b")
#: Pages, modules and folders still to be rewritten; none may be added.
EXCUSED = Path(__file__).with_name("prose_excused.txt")


def page(text: str) -> Iterator[str]:
    """Yield the findings of a page in Markdown."""
    for block in _blocks(text):
        if "doi:" in block:
            continue  # a reference
        for sentence in _sentences(block):
            start = " ".join(sentence.split()[:6])
            words = len(re.findall(r"[A-Za-z][\w'-]*", sentence))
            if words > WORDS:
                yield f"{words} words in a sentence, at most {WORDS}: {start} ..."
            numbers = len(re.findall(r"(?<![\w.])\d[\d,.]*", sentence))
            if numbers > NUMBERS:
                yield f"{numbers} numbers in a sentence, at most {NUMBERS}: {start} ..."
        for pattern, better in LIST.items():
            for match in re.finditer(rf"\b{pattern}", block):
                yield f"'{match[0]}': write {better}"


def _sentences(block: str) -> list[str]:
    """Parts of a paragraph that end in a full stop, a colon or a semicolon."""
    return re.split(r"(?<=[.!?:;])\s+(?=[\"(A-Z`*\[0-9]|amulor )", block)


def sample(number: int, seed: int) -> list[str]:
    """Sentences of the pages, drawn at random, with their file."""
    sentences = [
        f"{path.relative_to(ROOT)}: {sentence}"
        for path in files()
        if path.suffix == ".md"
        for block in _blocks(path.read_text(encoding="utf-8"), keep=True)
        for sentence in _sentences(block)
        if len(sentence.split()) > 4
    ]
    return random.Random(seed).sample(sentences, number)


def _blocks(text: str, *, keep: bool = False) -> Iterator[str]:
    """Yield paragraphs and list items, without blocks of code, tables and links.

    Code and formulas within a line become X, unless they are to be kept.
    """
    text = re.sub(
        r"^(```+|~~~+|:::+).*?^\1", "\n", text, flags=re.DOTALL | re.MULTILINE
    )
    text = re.sub(r"<!--.*?-->|\$\$.*?\$\$", " ", text, flags=re.DOTALL)
    if not keep:
        text = re.sub(r"\$[^$\n]+\$|`[^`]*`", "X", text)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    # Numbers of equations, and units.
    text = re.sub(r"\(\d+\)|https?://\S+|\b1/\w+", "", text)
    lines = [
        "" if re.match(r"\s*(\||#|\[\^)", line) else line for line in text.splitlines()
    ]
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )", "\n".join(lines)):
        if block.strip():
            yield " ".join(re.sub(r"^\s*([-*]|\d+\.) ", "", block).split())


def module(text: str) -> Iterator[str]:
    """Yield the findings of the docstrings of a module."""
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    for node in ast.walk(ast.parse(text)):
        first = (isinstance(node, kinds) and ast.get_docstring(node)) or ""
        if OPENINGS.match(first):
            yield f"begin with a noun or a verb: {first.splitlines()[0]}"


def findings(path: Path) -> list[str]:
    """Return the findings of a file."""
    text = path.read_text(encoding="utf-8")
    return list(page(text) if path.suffix == ".md" else module(text))


def files() -> list[Path]:
    """Return pages and modules of the repository, built and generated ones apart."""
    built = {"_build", "api", "decisions", "backreferences", "examples",
             "benchmark-tables.md"}  # fmt: skip
    pages = [
        path
        for path in (ROOT / "docs").rglob("*.md")
        if not built & set(path.relative_to(ROOT / "docs").parts)
    ]
    return [ROOT / "README.md", *sorted(pages), *sorted((ROOT / "src").rglob("*.py"))]


def excused(path: Path) -> bool:
    """Return whether a file, or its folder, is still to be rewritten."""
    name = path.relative_to(ROOT).as_posix()
    listed = EXCUSED.read_text(encoding="utf-8").split()
    return any(name == each or name.startswith(f"{each}/") for each in listed)


def main(arguments: list[str]) -> int:
    """Print the findings, and return whether there are some."""
    if arguments[:1] == ["--sample"]:
        print("\n".join(sample(int(arguments[1]), int(arguments[3]))))
        return 0
    chosen = [Path(name).resolve() for name in arguments] or [
        path for path in files() if not excused(path)
    ]
    lines = [
        f"{path.relative_to(ROOT) if path.is_relative_to(ROOT) else path}: {line}"
        for path in chosen
        for line in findings(path)
    ]
    print("\n".join(lines) or f"{len(chosen)} files read, nothing found")
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
