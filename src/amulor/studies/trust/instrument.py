"""Trust study of instrument errors: computed rows, appended to a table file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from amulor.studies.trust.case import Case
from amulor.studies.trust.methods import METHODS, Outcome, outcome
from amulor.studies.trust.scenes.instrument import KINDS, STATES, case
from amulor.studies.trust.table import resumed, score

#: Sizes of an error, as multiples of its typical size.
SIZES = (1.0, 3.0, 10.0)
COUNTS = (1, 2, 4)


@dataclass(frozen=True, kw_only=True, order=True)
class Key:
    """Conditions of a row: instrument error, survey, frequencies and method."""

    kind: str
    """Name of the instrument error."""
    size: float
    """Size of the error, as a multiple of the typical size."""
    count: int
    """Number of modulation frequencies."""
    state: str
    """Kind of survey: "uncalibrated", "calibrated" or "wrong"."""
    method: str
    """Name of the rejection method."""
    seed: int = 1
    """Seed of the random numbers."""


@dataclass(frozen=True, kw_only=True)
class InstrumentRow:
    """Row of the table: conditions, scores, and failed tests."""

    key: Key
    """Conditions of the row."""
    trusted: float
    """Percentage of trusted pixels [%]."""
    inside: float
    """Percentage of trusted pixels whose 95 % interval contains the surface [%]."""
    far: float
    """Percentage of trusted pixels off by over 3.5 standard uncertainties [%]."""
    worst: float
    """Largest ratio of error to standard uncertainty of a trusted pixel [1]."""
    mean: float
    """Mean error of the trusted pixels [mm]."""
    stated: float
    """Median standard uncertainty of the trusted pixels [mm]."""
    tests: tuple[str, ...]
    """Names of the failed tests of the instrument; "refused" for a refused scan."""
    cause: str
    """Verdict on the suggested cause: "right", "wrong", or "none" without a cause."""


_WIDTHS = {
    "kind": 17,
    "size": 5,
    "f": 3,
    "state": 13,
    "method": 13,
    "seed": 5,
    "trust": 7,
    "95 %": 7,
    ">3.5": 7,
    "worst": 7,
    "mean mm": 10,
    "stated": 8,
    "cause": 6,
    "tests": 40,
}
_LEFT = ("kind", "state", "method", "cause", "tests")
LEGEND = """\
kind     error of the instrument
size     multiple of its typical size
f        number of modulation frequencies
state    what the survey states about the error
trust    fraction of the pixels without a flag [%]
95 %     fraction of the trusted whose 95 % interval contains the surface
>3.5     fraction of the trusted off by more than 3.5 standard uncertainties [%]
worst    largest error of a trusted pixel over its standard uncertainty
mean mm  mean error of the trusted
stated   median standard uncertainty of the trusted [mm]
cause    whether a suggested cause is the right one
tests    failed tests of the instrument
"""


def _joined(cells: Iterable[str]) -> str:
    parts = (
        f"{cell:<{width}}" if name in _LEFT else f"{cell:>{width}}"
        for cell, (name, width) in zip(cells, _WIDTHS.items(), strict=True)
    )
    return " ".join(parts).rstrip()


HEADER = _joined(_WIDTHS)


def line(row: InstrumentRow) -> str:
    """Return one row of the table as text."""
    key = row.key
    figures = (
        (row.trusted, ".1f"),
        (row.inside, ".1f"),
        (row.far, ".1f"),
        (row.worst, ".1f"),
        (row.mean, "+.3f"),
        (row.stated, ".3f"),
    )
    return _joined(
        [
            key.kind,
            f"{key.size:g}",
            str(key.count),
            key.state,
            key.method,
            str(key.seed),
            *("-" if math.isnan(value) else format(value, f) for value, f in figures),
            row.cause,
            ",".join(row.tests) or "-",
        ]
    )


def written(text: str) -> Iterator[InstrumentRow]:
    """Parse the text of a table, and yield its complete rows."""
    lines = iter(text.splitlines(keepends=True))
    for content in lines:
        if content.rstrip() == HEADER:
            break
    else:
        raise ValueError(
            "there is no table of instrument errors; it begins with 'kind'"
        )
    for content in lines:
        # An interrupted run leaves a line without an end.
        if content.endswith("\n"):
            yield _parsed(content.rstrip("\n"))


def _parsed(content: str) -> InstrumentRow:
    cells, start = [], 0
    for width in _WIDTHS.values():
        cells.append(content[start : start + width].strip())
        start += width + 1
    kind, size, count, state, method, seed, *figures, cause, tests = cells
    numbers = [math.nan if cell == "-" else float(cell) for cell in figures]
    trusted, inside, far, worst, mean, stated = numbers
    return InstrumentRow(
        key=Key(
            kind=kind,
            size=float(size),
            count=int(count),
            state=state,
            method=method,
            seed=int(seed),
        ),
        trusted=trusted,
        inside=inside,
        far=far,
        worst=worst,
        mean=mean,
        stated=stated,
        tests=() if tests == "-" else tuple(tests.split(",")),
        cause=cause,
    )


def text(rows: Iterable[InstrumentRow]) -> str:
    """Return a table as text, in the order of its keys."""
    names = list(KINDS)

    def order(row: InstrumentRow) -> tuple[int, ...]:
        key = row.key
        state = STATES.index(key.state)
        return names.index(key.kind), state, int(key.size), key.count, key.seed

    ordered = sorted(rows, key=lambda row: (*order(row), row.key.method))
    return "\n".join([LEGEND, HEADER, *(line(row) for row in ordered), ""])


#: Least share of trusted pixels [%].
_TRUSTED = 80.0
#: Least share of them in their 95 % interval [%].
_INSIDE = 92.0


#: Method of which each kind of error is measured at each number of frequencies.
_COMPLETE = "open-water"


def counts(rows: Iterable[InstrumentRow]) -> str:
    """Return Markdown tables with the number of cases that meet each requirement.

    The first is of open water with up to four frequencies. The second has the other
    methods and numbers of frequencies, if the table contains them.
    """
    errors = [row for row in rows if row.key.kind != "perfect"]
    complete = {
        (_STATE_WORDS[state], "typical" if size == 1 else f"{size:g} times"): [
            row
            for row in errors
            if (row.key.method, row.key.state, row.key.size) == (_COMPLETE, state, size)
            and row.key.count in COUNTS
        ]
        for state in STATES
        for size in SIZES
    }
    others = {
        (f"`{method}`", str(count), _STATE_WORDS[state]): [
            row
            for row in errors
            if (row.key.method, row.key.count, row.key.state) == (method, count, state)
        ]
        for method in METHODS
        for count in (*COUNTS, 16)
        for state in STATES
        if (method, count in COUNTS) != (_COMPLETE, True)
    }
    tables = [_counted(complete.items(), "the survey states", "error")]
    if any(others.values()):
        names = "method", "number of frequencies", "the survey states"
        tables.append(_counted(others.items(), *names))
    return "\n".join(tables)


def _counted(
    groups: Iterable[tuple[tuple[str, ...], list[InstrumentRow]]], *names: str
) -> str:
    """Return a Markdown table with the numbers of cases of each group."""
    header = [
        *names,
        "cases",
        "rejected",
        f"at least {_TRUSTED:g} % trusted",
        "inside the 95 % interval",
        f"less than {_INSIDE:g} % inside",
        "beyond 3.5 uncertainties",
    ]
    lines = ["| " + " | ".join(header) + " |", "|" + " --- |" * len(header)]
    for labels, cases in groups:
        if not cases:
            continue
        images = [row for row in cases if not math.isnan(row.inside)]
        cells = (
            *labels,
            len(cases),
            sum("refused" in row.tests for row in cases),
            sum(row.trusted >= _TRUSTED for row in images),
            _pooled(images, [row.inside for row in images], digits=1),
            sum(row.inside < _INSIDE for row in images),
            _pooled(images, [row.far for row in images], digits=2),
        )
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    return "\n".join([*lines, ""])


def _pooled(images: list[InstrumentRow], shares: list[float], *, digits: int) -> str:
    """Return the mean of shares [%], weighted by the trusted pixels, as text."""
    weights = [row.trusted for row in images]
    if not sum(weights):
        return ""
    return f"{np.average(shares, weights=weights):.{digits}f} %"


#: Errors of `auto` before the error budget had a term for the instrument: share of the
#: pixels inside the 95 % interval [%] and mean error [mm], by kind, size and number of
#: frequencies. The survey stated the errors of delay and geometry.
_BEFORE: dict[tuple[str, float], dict[int, tuple[float, float]]] = {
    ("leakage, scan", 1.0): {1: (14, -7.7), 2: (100, -14.5), 4: (100, 0.7)},
    ("leakage, scan", 3.0): {1: (6, -23), 2: (100, 8.8), 4: (100, 0.6)},
    ("leakage, delay", 3.0): {1: (100, 0.7), 2: (0.3, 18.6), 4: (100, 3.3)},
    ("walk", 1.0): {1: (14, -9.5), 2: (100, 0.1), 4: (100, 0.0)},
    ("harmonic", 1.0): {1: (18, 3.2), 2: (96, 1.8), 4: (100, 0.3)},
    ("layer", 1.0): {1: (77, -1.6), 2: (0.5, -3.1), 4: (100, 0.0)},
    ("phase drift", 1.0): {1: (44, 3.1), 2: (67, 1.9), 4: (95, 1.4)},
    ("delay drift", 1.0): {1: (83, 1.7), 2: (74, 1.7), 4: (75, 1.6)},
}


def before_and_after(rows: Iterable[InstrumentRow]) -> str:
    """Return a Markdown table of `auto` without calibration, with earlier results."""
    measured = {
        (row.key.kind, row.key.size, row.key.count): row
        for row in rows
        if (row.key.method, row.key.state) == ("auto", "uncalibrated")
    }
    lines = [
        "| error | number of frequencies | before: inside, mean error | now: inside, "
        "mean error | trusted | stated uncertainty |",
        "|" + " --- |" * 6,
    ]
    for (kind, size), values in _BEFORE.items():
        times = "" if size == 1 else f", {size:g} times"
        for count, (inside, mean) in values.items():
            row = measured.get((kind, size, count))
            if row is None:
                continue
            now = "rejected |  |"
            if not math.isnan(row.inside):
                now = (
                    f"{row.inside:g} %, {row.mean:+.1f} mm | {row.trusted:.0f} % | "
                    f"{row.stated:.1f} mm"
                )
            lines.append(
                f"| {KINDS[kind].title}{times} | {count} | {inside:g} %, {mean:+.1f} mm"
                f" | {now} |"
            )
    return "\n".join([*lines, ""])


_STATE_WORDS = {
    "uncalibrated": "no calibration",
    "calibrated": "the phase error",
    "wrong": "a third of it",
}


def suggestions(rows: Iterable[InstrumentRow]) -> tuple[int, int]:
    """Count correct and all suggested causes, over scans with an instrument error."""
    causes = [row.cause for row in rows if row.key.kind != "perfect"]
    right = causes.count("right")
    return right, right + causes.count("wrong")


def false_alarms(rows: Iterable[InstrumentRow]) -> tuple[int, int]:
    """Return the number of false alarms, and of all scans, for a perfect instrument."""
    perfect = [row for row in rows if row.key.kind == "perfect"]
    return sum(bool(row.tests) for row in perfect), len(perfect)


def measured(key: Key, test: Case) -> InstrumentRow:
    """Process a test case by the key's method, and return its row."""
    result = outcome(key.method, test)
    figures = score(test, result)
    tests, cause = _suggested(KINDS[key.kind].causes, result)
    return InstrumentRow(
        key=key,
        trusted=100 * figures.trusted,
        inside=100 * figures.inside_95,
        far=100 * figures.far,
        worst=figures.worst,
        mean=1e3 * figures.mean,
        stated=1e3 * figures.uncertainty,
        tests=tests,
        cause=cause,
    )


def _suggested(causes: tuple[str, ...], result: Outcome) -> tuple[tuple[str, ...], str]:
    """Return the failed tests of a result, and the verdict on their causes."""
    from amulor.imaging.instrument_tests import instrument_tests

    if result.image is None:
        names, words = ["refused"], result.note
    else:
        failed = instrument_tests(result.image)
        names = [test.name for test in failed]
        words = "; ".join(test.cause for test in failed)
    if not words:
        return (), "none"
    right = any(cause in words for cause in causes)
    return tuple(names), "right" if right else "wrong"


def run(
    path: Path,
    keys: Iterable[Key],
    *,
    done: Callable[[InstrumentRow], None] | None = None,
) -> list[InstrumentRow]:
    """Compute the rows missing in a file, and append each when finished."""
    # Methods of the same scan follow each other.
    scan = lru_cache(maxsize=1)(case)

    def compute(key: Key) -> InstrumentRow:
        return measured(key, scan(key.kind, key.size, key.count, key.state, key.seed))

    return resumed(
        path, keys, compute, key_of=lambda row: row.key,
        written=written, text=text, line=line, done=done,
    )  # fmt: skip
