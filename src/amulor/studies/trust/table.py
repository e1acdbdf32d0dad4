"""Scores of the trust study: errors of trusted pixels, and their table."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from amulor.studies.trust.case import Case
from amulor.studies.trust.methods import Outcome

Floats = NDArray[np.float64]
Key = TypeVar("Key", bound=Hashable)
AnyRow = TypeVar("AnyRow")

#: Half widths of the intervals with 68 and 95 of 100 normal errors [1].
ONE, TWO = 1.0, 1.96
#: Beyond it lie 5 of 10,000 normal errors [1].
FAR = 3.5


@dataclass(frozen=True, kw_only=True)
class Score:
    """Scores of one method on one test case, NaN without trusted pixels."""

    pixels: int
    """Number of judged pixels with a surface."""
    empty: int
    """Number of judged pixels without a surface."""
    trusted: float
    """Trusted fraction of the pixels with a surface [1]."""
    phantoms: float
    """Trusted fraction of the pixels without a surface [1]."""
    inside_68: float
    """Fraction of trusted pixels whose 68 % interval contains the surface [1]."""
    inside_95: float
    """Fraction of trusted pixels whose 95 % interval contains the surface [1]."""
    echo_95: float
    """Fraction of trusted pixels whose 95 % interval contains the echo range [1]."""
    worst: float
    """Largest ratio of error to standard uncertainty of a trusted pixel [1]."""
    far: float
    """Fraction of trusted pixels with errors beyond 3.5 standard uncertainties [1]."""
    rms: float
    """Root-mean-square error of the trusted pixels [m]."""
    uncertainty: float
    """Median standard uncertainty of the trusted pixels [m]."""
    note: str
    """Method chosen by `auto`, or the reason for a missing image."""
    mean: float = math.nan
    """Mean error of the trusted pixels [m]."""


def score(case: Case, outcome: Outcome) -> Score:
    """Compare a method's range image with the true surfaces, and return its scores."""
    met = np.isfinite(case.surfaces).any(axis=0) & case.judged
    empty = ~np.isfinite(case.surfaces).any(axis=0) & case.judged
    trusted = _trusted(outcome, met.shape)
    good = trusted & met
    nan = math.nan
    result = Score(
        pixels=int(met.sum()),
        empty=int(empty.sum()),
        trusted=_mean(trusted[met]),
        phantoms=_mean(trusted[empty]),
        inside_68=nan,
        inside_95=nan,
        echo_95=nan,
        worst=nan,
        far=nan,
        rms=nan,
        uncertainty=nan,
        note=outcome.note,
    )
    if outcome.image is None or not good.any():
        return result
    distance = outcome.image["slant_range"].values
    if "slant_range_bias" in outcome.image:
        distance = distance - outcome.image["slant_range_bias"].values
    sigma = outcome.image["slant_range_uncertainty"].values[good]
    error = _nearest(distance - case.surfaces)[good]
    echo = _nearest(distance - case.surfaces - case.late)[good]
    off = np.abs(error) / sigma
    return replace(
        result,
        inside_68=_mean(off < ONE),
        inside_95=_mean(off < TWO),
        echo_95=_mean(np.abs(echo) / sigma < TWO),
        worst=float(off.max()),
        far=_mean(off > FAR),
        rms=float(np.sqrt(np.mean(error**2))),
        uncertainty=float(np.median(sigma)),
        mean=float(error.mean()),
    )


def _trusted(outcome: Outcome, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    if outcome.target is None or outcome.image is None:
        return np.zeros(shape, dtype=bool)
    good = outcome.image["quality_flag"].values == 0
    return np.asarray(good & np.isfinite(outcome.image["slant_range"].values))


def _nearest(error: Floats) -> Floats:
    """Return the range error to the closest true surface, shape (row, column) [m]."""
    size = np.where(np.isfinite(error), np.abs(error), np.inf)
    chosen = size.argmin(axis=0)
    nearest: Floats = np.take_along_axis(error, chosen[None], axis=0)[0]
    return nearest


def _mean(values: NDArray[np.bool_]) -> float:
    return float(values.mean()) if values.size else math.nan


#: Scenes without a correct answer from the data: surfaces that share a pixel,
#: undetectable instrument errors, ambiguity without a stated interval.
_APART = (
    "mixed 2 cm", "mixed 5 cm", "corner", "delay", "baseline", "axis", "index", "far",
    "far two",
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
    """Row read from a table, NaN where it has no number."""

    scene: str
    """Name of the scene."""
    method: str
    """Name of the method."""
    trusted: float
    """Trusted percentage of the pixels with a surface [%]."""
    inside: float
    """Percentage of trusted pixels whose 95 % interval contains the surface [%]."""
    far: float
    """Percentage of trusted pixels off by over 3.5 standard uncertainties [%]."""
    phantom: float
    """Trusted percentage of the pixels without a surface [%]."""
    refused: bool
    """Whether the method refused the scan."""


def written(text: str) -> Iterator[Written]:
    """Parse the text of a table, and yield its rows."""
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
    """Return a Markdown table with the number of rows that meet each requirement."""
    accepted = [row for row in rows if not row.refused and row.scene not in _APART]
    columns = []
    for name, methods in _GROUPS:
        of_group = [row for row in accepted if row.method in methods]
        with_surface = [row for row in of_group if not math.isnan(row.trusted)]
        empty = [row for row in of_group if math.isnan(row.trusted)]
        columns.append(
            (
                name,
                len(with_surface),
                sum(row.trusted >= _TRUSTED for row in with_surface),
                sum(row.inside >= _INSIDE for row in with_surface),
                sum(row.far <= _FAR for row in with_surface),
                len(empty),
                sum(row.phantom > 0 for row in empty),
            )
        )
    titles = (
        "requirement",
        "rows with a target that the method can measure",
        f"at least {_TRUSTED:g} % of the pixels trusted",
        f"95 % interval contains the surface in at least {_INSIDE:g} % of the pixels",
        f"at most {_FAR:g} % of the pixels beyond 3.5 standard uncertainties",
        "rows of empty water",
        "rows of empty water with a false target",
    )
    lines = [
        f"| {' | '.join(str(cell) for cell in cells)} |"
        for cells in zip(titles, *columns, strict=True)
    ]
    return "\n".join([lines[0], "|" + " --- |" * (len(_GROUPS) + 1), *lines[1:], ""])


@dataclass(frozen=True, kw_only=True)
class Row:
    """Scores of one method on one scene with one number of frequencies."""

    scene: str
    """Name of the scene."""
    count: int
    """Number of modulation frequencies."""
    method: str
    """Name of the method."""
    score: Score
    """Scores of the method."""


#: Where in a row the name of its scene ends, its count of frequencies, its method.
SCENE_END, COUNT_END, METHOD_END = 28, 31, 48


def _begin(scene: str, count: int | str, method: str) -> str:
    counted = f"{scene:<{SCENE_END}}{count:>{COUNT_END - SCENE_END}} "
    return f"{counted + method:<{METHOD_END}}"


_HEADER = (
    f"{_begin('scene', 'f', 'method')} {'trust':>6} {'68 %':>6} {'95 %':>6} "
    f"{'echo':>6} {'worst':>7} {'>3.5':>6} {'rms mm':>9} {'stated':>8} {'phantom':>7} "
    f"{'mean mm':>9}"
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
mean mm  mean error of the trusted against the surface
"""


def line(row: Row) -> str:
    """Return one row of the table as text."""
    figures = row.score
    cells = [
        _begin(row.scene, row.count, row.method),
        f"{_percent(figures.trusted):>6}",
        f"{_percent(figures.inside_68):>6}",
        f"{_percent(figures.inside_95):>6}",
        f"{_percent(figures.echo_95):>6}",
        f"{_number(figures.worst, '.1f'):>7}",
        f"{_percent(figures.far):>6}",
        f"{_number(figures.rms * 1e3, '.3f'):>9}",
        f"{_number(figures.uncertainty * 1e3, '.3f'):>8}",
        f"{_percent(figures.phantoms):>7}",
        f"{_number(figures.mean * 1e3, '+.3f'):>9}",
    ]
    note = f"  {figures.note[:60]}" if figures.note else ""
    return " ".join(cells) + note


def text(rows: Iterable[Row]) -> str:
    """Return the whole table as text."""
    return "\n".join([LEGEND, _HEADER, *(line(row) for row in rows), ""])


def _percent(value: float) -> str:
    return "-" if math.isnan(value) else f"{100 * value:.1f}"


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)


def resumed(
    path: Path,
    keys: Iterable[Key],
    compute: Callable[[Key], AnyRow],
    *,
    key_of: Callable[[AnyRow], Key],
    written: Callable[[str], Iterable[AnyRow]],
    text: Callable[[Iterable[AnyRow]], str],
    line: Callable[[AnyRow], str],
    done: Callable[[AnyRow], None] | None = None,
) -> list[AnyRow]:
    """Compute the rows missing in a file, and append each when finished.

    A run that was interrupted goes on where it stopped. `written`, `text` and `line`
    parse a table, and format a table and a row.
    """
    rows = list(written(path.read_text(encoding="utf-8"))) if path.exists() else []
    # Also removes the rest of an interrupted line.
    path.write_text(text(rows), encoding="utf-8")
    present = {key_of(row) for row in rows}
    for key in keys:
        if key in present:
            continue
        row = compute(key)
        rows.append(row)
        present.add(key)
        with path.open("a", encoding="utf-8") as file:
            file.write(line(row) + "\n")
        if done is not None:
            done(row)
    return rows
