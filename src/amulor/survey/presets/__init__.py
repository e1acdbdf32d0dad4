"""Presets: published instruments as survey files, with citations."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from importlib import resources

from amulor.errors import SurveyError

#: Words that state the basis of every number in a preset.
_BASES = ("published", "deduced", "assumed")


@dataclass(frozen=True, kw_only=True)
class Preset:
    """Published instrument: survey file, title and citation."""

    name: str
    """Name for `Survey.preset`."""
    title: str
    """Title of the instrument."""
    source: str
    """Citation of the source: authors, journal, year."""
    doi: str
    """Digital object identifier of the source."""
    use: str
    """Purpose of the instrument."""
    counts: dict[str, int]
    """Numbers of published, deduced and assumed values."""
    text: str
    """Text of the survey file, with a comment on each line."""


def names() -> list[str]:
    """Return the names of all presets."""
    folder = resources.files("amulor.survey.presets")
    return sorted(
        entry.name.removesuffix(".toml")
        for entry in folder.iterdir()
        if entry.name.endswith(".toml")
    )


@cache
def preset(name: str) -> Preset:
    """Return a preset with its title, source and text."""
    available = names()
    if name not in available:
        raise SurveyError(
            f"there is no preset {name!r}; there are {', '.join(available)}"
        )
    file = resources.files("amulor.survey.presets") / f"{name}.toml"
    text = file.read_text(encoding="utf-8")
    lines = text.splitlines()
    header = dict(
        line.removeprefix("# ").split(": ", 1) for line in lines[1:4] if ": " in line
    )
    return Preset(
        name=name,
        title=lines[0].removeprefix("# "),
        source=header["Source"],
        doi=header["DOI"],
        use=header["Use"],
        counts={
            basis: sum(bool(re.search(rf" # \[{basis}\]", line)) for line in lines)
            for basis in _BASES
        },
        text=text,
    )
