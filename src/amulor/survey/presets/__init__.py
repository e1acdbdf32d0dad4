"""Instruments from public sources, as survey files with their citations."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from importlib import resources

from amulor.errors import SurveyError

#: What every line that states a number says about where it comes from.
_BASES = ("published", "deduced", "assumed")


@dataclass(frozen=True, kw_only=True)
class Preset:
    """An instrument that was published, as a survey."""

    name: str
    """What `Survey.preset` calls it."""
    title: str
    """What it is."""
    source: str
    """Authors, journal, year."""
    doi: str
    """Digital object identifier of the source."""
    use: str
    """What it is for."""
    counts: dict[str, int]
    """Number of statements that are published, deduced from it, and assumed."""
    text: str
    """The survey file, with a remark on each line."""


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
    """Return a preset with what it says about itself."""
    known = names()
    if name not in known:
        raise SurveyError(f"there is no preset {name!r}; there are {', '.join(known)}")
    file = resources.files("amulor.survey.presets") / f"{name}.toml"
    text = file.read_text(encoding="utf-8")
    lines = text.splitlines()
    said = dict(
        line.removeprefix("# ").split(": ", 1) for line in lines[1:4] if ": " in line
    )
    return Preset(
        name=name,
        title=lines[0].removeprefix("# "),
        source=said["Source"],
        doi=said["DOI"],
        use=said["Use"],
        counts={
            basis: sum(bool(re.search(rf" # \[{basis}\]", line)) for line in lines)
            for basis in _BASES
        },
        text=text,
    )
