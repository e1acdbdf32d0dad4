"""The study's results as a text table."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from amulor.studies.trust.score import Score


@dataclass(frozen=True, kw_only=True)
class Row:
    """One method on one scene with one number of frequencies."""

    scene: str
    """Name of the scene."""
    count: int
    """Number of modulation frequencies."""
    method: str
    """Name of the method."""
    score: Score
    """Its figures."""


#: Where in a row the name of its scene ends, its count of frequencies, its method.
SCENE_END, COUNT_END, METHOD_END = 28, 31, 48


def _begin(scene: str, count: int | str, method: str) -> str:
    counted = f"{scene:<{SCENE_END}}{count:>{COUNT_END - SCENE_END}} "
    return f"{counted + method:<{METHOD_END}}"


_HEADER = (
    f"{_begin('scene', 'f', 'method')} {'trust':>6} {'68 %':>6} {'95 %':>6} "
    f"{'echo':>6} {'worst':>7} {'>3.5':>6} {'rms mm':>9} {'stated':>8} {'phantom':>7}"
)
LEGEND = """\
trust    fraction of the pixels with a surface whose flags are zero [%]
68 %     fraction of the trusted whose 68 % interval holds the surface [%]
95 %     the same of the 95 % interval
echo     fraction of the trusted whose 95 % interval holds the range of the echo alone
worst    largest error of a trusted pixel over its standard uncertainty
>3.5     fraction of the trusted off by more than 3.5 standard uncertainties [%]
rms mm   root mean square error of the trusted against the surface
stated   median standard uncertainty of the trusted [mm]
phantom  fraction of the pixels without a surface that are trusted [%]
"""


def line(row: Row) -> str:
    """Return one row as text.

    Parameters
    ----------
    row : Row
        What to write.

    Returns
    -------
    str
        Without an end of line.
    """
    found = row.score
    cells = [
        _begin(row.scene, row.count, row.method),
        f"{_percent(found.trusted):>6}",
        f"{_percent(found.inside_68):>6}",
        f"{_percent(found.inside_95):>6}",
        f"{_percent(found.echo_95):>6}",
        f"{_number(found.worst, '.1f'):>7}",
        f"{_percent(found.far):>6}",
        f"{_number(found.rms * 1e3, '.3f'):>9}",
        f"{_number(found.stated * 1e3, '.3f'):>8}",
        f"{_percent(found.phantoms):>7}",
    ]
    note = f"  {found.note[:60]}" if found.note else ""
    return " ".join(cells) + note


def text(rows: Iterable[Row]) -> str:
    """Return the whole table.

    Parameters
    ----------
    rows : iterable of Row
        In order.

    Returns
    -------
    str
        Legend, header and one line a row.
    """
    return "\n".join([LEGEND, _HEADER, *(line(row) for row in rows), ""])


def _percent(value: float) -> str:
    return "-" if math.isnan(value) else f"{100 * value:.1f}"


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
