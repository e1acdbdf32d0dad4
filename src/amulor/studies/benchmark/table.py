"""Rows of the benchmark, one for each method and scene, in a CSV file."""

from __future__ import annotations

import csv
import io as text_io
import math
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np

from amulor import rejection
from amulor.errors import AmulorError, FormatError
from amulor.studies.benchmark.scenes import Scene
from amulor.studies.trust.case import Case
from amulor.studies.trust.methods import Outcome, outcome
from amulor.studies.trust.table import resumed, score

#: Least share of trusted pixels, and of those inside the 95 % interval, of a method
#: that takes part in the comparison of errors [1].
TRUSTED, INSIDE = 0.5, 0.9
#: Least share of trusted pixels, relative to the largest of all methods [1].
NEARLY_AS_MANY = 0.9


@dataclass(frozen=True, kw_only=True)
class Row:
    """Result of one method on one scene; NaN without trusted pixels."""

    scene: str
    """Name of the scene."""
    digest: str
    """Digest of the scene and its light."""
    method: str
    """Name of the method."""
    trusted: float
    """Trusted share of the pixels with a surface [1]."""
    phantoms: float
    """Trusted share of the pixels without a surface [1]."""
    inside_68: float
    """Share of trusted pixels whose 68 % interval contains the surface [1]."""
    inside_95: float
    """Share of trusted pixels whose 95 % interval contains the surface [1]."""
    worst: float
    """Largest error of a trusted pixel in standard uncertainties [1]."""
    bias: float
    """Mean error of the trusted pixels [mm]."""
    noise: float
    """Standard deviation of the error of the trusted pixels [mm]."""
    stated: float
    """Median standard uncertainty of the trusted pixels [mm]."""
    seconds: float
    """Processor time of the method and the range image [s]."""
    note: str
    """Method chosen by `auto`, or the reason for a refusal."""

    @property
    def error(self) -> float:
        """Root mean square error of the trusted pixels [mm]."""
        return math.hypot(self.bias, self.noise)

    @property
    def holds(self) -> bool:
        """Whether the intervals hold, and no pixel without a surface is trusted."""
        return not (self.inside_95 < INSIDE or self.phantoms > 0)

    @property
    def compared(self) -> bool:
        """Whether the method takes part in the comparison of errors."""
        return self.holds and self.trusted >= TRUSTED


NAMES = tuple(field.name for field in fields(Row))
_TEXTS = ("scene", "digest", "method", "note")
_DIGITS = 4


def row_of(scene: Scene, method: str, case: Case) -> Row:
    """Run a method on a scene, and compare its ranges with the surfaces."""
    begin = time.process_time()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            result = outcome(method, case)
        except Exception as error:  # the program of another package
            note = f"CRASH: {type(error).__name__}: {error}"
            result = Outcome(target=None, image=None, note=" ".join(note.split()))
    seconds = time.process_time() - begin
    scores = score(case, result)
    spread = np.sqrt(max(scores.rms**2 - scores.mean**2, 0.0))
    return Row(
        scene=scene.name,
        digest=scene.digest,
        method=method,
        trusted=scores.trusted,
        phantoms=scores.phantoms,
        inside_68=scores.inside_68,
        inside_95=scores.inside_95,
        worst=scores.worst,
        bias=1e3 * scores.mean,
        noise=1e3 * float(spread) if math.isfinite(scores.rms) else math.nan,
        stated=1e3 * scores.uncertainty,
        seconds=seconds,
        note=scores.note,
    )


def text(rows: Iterable[Row]) -> str:
    """Return a table of rows as CSV."""
    return ",".join(NAMES) + "\n" + "".join(line(row) + "\n" for row in rows)


def line(row: Row) -> str:
    """Return a row as a line of CSV."""
    cells = (getattr(row, name) for name in NAMES)
    buffer = text_io.StringIO()
    csv.writer(buffer, lineterminator="").writerow(
        [cell if isinstance(cell, str) else _number(cell) for cell in cells]
    )
    return buffer.getvalue()


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.{_DIGITS}g}"


def written(content: str) -> Iterator[Row]:
    """Parse CSV, and yield its complete rows; FormatError for another table."""
    lines = content.splitlines(keepends=True)
    if not lines or lines[0].rstrip("\n") != ",".join(NAMES):
        raise FormatError(
            "this is no table of the benchmark of this version; its first line is "
            + ",".join(NAMES)
        )
    if not lines[-1].endswith("\n"):  # the rest of an interrupted line
        del lines[-1]
    for cells in csv.reader(lines[1:]):
        values = dict(zip(NAMES, cells, strict=True))
        yield Row(
            **{
                name: value if name in _TEXTS else float(value or "nan")
                for name, value in values.items()
            }  # type: ignore[arg-type]
        )


def read(path: Path) -> list[Row]:
    """Read the table of a file; FormatError if it is none."""
    try:
        return _rows_of(path.read_text(encoding="utf-8"), path)
    except OSError as error:
        raise FormatError(f"{path}: {error}") from error


def _rows_of(content: str, path: Path) -> list[Row]:
    """Parse the table of a file; FormatError with its path if it is none."""
    try:
        return list(written(content))
    except ValueError as error:
        raise FormatError(f"{path}: {error}") from error


@dataclass(frozen=True)
class _Key:
    """Scene with its digest, and method."""

    scene: str
    digest: str
    method: str


def run(
    path: Path,
    scenes: Sequence[Scene],
    methods: Sequence[str],
    *,
    done: Callable[[Row, int, int], None] | None = None,
) -> list[Row]:
    """Compute the rows that are missing in a file; return those of scenes and methods.

    `done` is called with each new row, the number of finished rows and that of all.
    """
    keys = {
        _Key(scene.name, scene.digest, method): (scene, method)
        for scene in scenes
        for method in methods
    }
    cases: dict[str, Case] = {}
    order = {key: number for number, key in enumerate(keys, start=1)}

    def compute(key: _Key) -> Row:
        scene, method = keys[key]
        if key.scene not in cases:
            cases.clear()
            cases[key.scene] = scene.case()
        return row_of(scene, method, cases[key.scene])

    def key_of(row: Row) -> _Key:
        return _Key(row.scene, row.digest, row.method)

    def show(row: Row) -> None:
        if done is not None:
            done(row, order[key_of(row)], len(keys))

    rows = resumed(
        path,
        keys,
        compute,
        key_of=key_of,
        written=partial(_rows_of, path=path),
        text=text,
        line=line,
        done=show,
    )
    present = {key_of(row): row for row in rows}
    return [present[key] for key in keys]


def needs(method: str) -> str:
    """Return the measurements that a method needs, in words."""
    try:
        required = rejection.load(method).needs
    except AmulorError:
        return "not installed"
    words = []
    if required.open_water:
        words.append("open water")
    if required.open_water is False:
        words.append("no open water")
    if required.channel_pair:
        words.append("two channels")
    return ", ".join(words) or "nothing"
