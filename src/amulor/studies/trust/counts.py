"""Counts what a table of the study, as it was written, says about what is asked."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from amulor.studies.trust.table import COUNT_END, METHOD_END, SCENE_END

#: Scenes about which no method can be right: surfaces that share a pixel, instruments
#: that are off by what no data show, repetitions that nobody states.
_APART = (
    "mixed 2 cm", "mixed 5 cm", "delay", "baseline", "axis", "index", "far", "far two"
)  # fmt: skip
_GROUPS = (
    ("joint", ("joint", "joint, no shots")),
    (
        "open water, combination, polarization",
        ("open-water", "combined", "polarization"),
    ),
    ("`auto`", ("auto",)),
)
#: Least share of trusted pixels, and of those in their 95 % interval [%].
_TRUSTED, _INSIDE = 80.0, 93.0
#: Largest share of them beyond 3.5 standard uncertainties [%].
_FAR = 0.3


@dataclass(frozen=True, kw_only=True)
class Written:
    """A row as it stands in a table, its figures not numbers where there are none."""

    scene: str
    """Name of the scene."""
    method: str
    """Name of the method."""
    trusted: float
    """Pixels with a surface that are trusted [%]."""
    inside: float
    """Of these, in their 95 % interval [%]."""
    far: float
    """Of these, beyond 3.5 standard uncertainties [%]."""
    phantom: float
    """Pixels without a surface that are trusted [%]."""
    refused: bool
    """Whether the method refused the scan."""


def written(text: str) -> Iterator[Written]:
    """Yield the rows of a table.

    Parameters
    ----------
    text : str
        As `amulor.studies.trust.table.text` writes it; words may follow a row.

    Yields
    ------
    Written
        Row by row.

    Raises
    ------
    ValueError
        If there is no table in it.
    """
    lines = iter(text.splitlines())
    if not any(line.startswith("scene ") for line in lines):
        raise ValueError("there is no table of the study; it begins with 'scene'")
    for line in lines:
        cells = line[METHOD_END:].split()
        if len(cells) < 9:
            continue
        trusted, _, inside, _, _, far, _, _, phantom = (
            math.nan if cell == "-" else float(cell) for cell in cells[:9]
        )
        yield Written(
            scene=line[:SCENE_END].strip(),
            method=line[COUNT_END:METHOD_END].strip(),
            trusted=trusted,
            inside=inside,
            far=far,
            phantom=phantom,
            refused="refused" in line,
        )


def counts(rows: Iterable[Written]) -> str:
    """Return how many rows have what is asked, as a table in Markdown.

    Parameters
    ----------
    rows : iterable of Written
        All of a table.

    Returns
    -------
    str
        One column for each group of methods.
    """
    known = [row for row in rows if not row.refused and row.scene not in _APART]
    columns = []
    for name, methods in _GROUPS:
        own = [row for row in known if row.method in methods]
        seen = [row for row in own if not math.isnan(row.trusted)]
        empty = [row for row in own if math.isnan(row.trusted)]
        columns.append(
            (
                name,
                len(seen),
                sum(row.trusted >= _TRUSTED for row in seen),
                sum(row.inside >= _INSIDE for row in seen),
                sum(row.far <= _FAR for row in seen),
                len(empty),
                sum(row.phantom > 0 for row in empty),
            )
        )
    titles = (
        "asked",
        "rows with a target that some pixel can be right about",
        f"{_TRUSTED:g} % trusted",
        f"95 % interval holds the surface in {_INSIDE:g} % or more",
        f"at most {_FAR:g} % beyond 3.5 standard uncertainties",
        "rows of empty water",
        "of these, with a phantom",
    )
    lines = [
        f"| {' | '.join(str(cell) for cell in cells)} |"
        for cells in zip(titles, *columns, strict=True)
    ]
    return "\n".join([lines[0], "|" + " --- |" * (len(_GROUPS) + 1), *lines[1:], ""])
