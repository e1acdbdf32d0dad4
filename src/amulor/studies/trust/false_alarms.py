"""Trust study of false alarms: small scans by an instrument without errors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

import numpy as np

from amulor.cube import WaterResidualCause
from amulor.simulation import simulate
from amulor.studies.trust.case import Case, case_of
from amulor.studies.trust.methods import Outcome, outcome
from amulor.studies.trust.scenes.models import around
from amulor.studies.trust.surveys import plate, stairs, survey
from amulor.studies.trust.table import resumed, score

#: Number of scans in the table.
SCANS = 300
METHODS = ("open-water", "combined", "polarization", "joint")
#: Methods and numbers of frequencies, in turn; joint estimation needs two.
TURNS = [
    (method, count)
    for method in METHODS
    for count in (1, 2, 4)
    if (method, count) != ("joint", 1)
]
#: Nearest and farthest targets in each water [m].
_DISTANCES = {"tank": (1.5, 3.2), "coastal": (1.5, 4.0), "harbour": (0.8, 1.5)}
_COLUMNS, _ROWS = 12, 8


@dataclass(frozen=True, kw_only=True)
class Scene:
    """Conditions of a scan, drawn at random from its number."""

    number: int
    """Number of the scan, the seed of all its random numbers."""
    water: str
    """Name of the water."""
    target: str
    """Kind of target: "plate" or "stairs"."""
    distance: float
    """Distance of the target [m]."""
    count: int
    """Number of modulation frequencies."""
    method: str
    """Name of the rejection method."""


@dataclass(frozen=True, kw_only=True)
class AlarmRow:
    """Row of the table: conditions, scores and failed tests of a scan."""

    scene: Scene
    """Conditions of the scan."""
    trusted: float
    """Percentage of trusted pixels [%]."""
    inside: float
    """Percentage of trusted pixels whose 95 % interval contains the surface [%]."""
    worst: float
    """Largest ratio of error to standard uncertainty of a trusted pixel [1]."""
    alarms: tuple[str, ...]
    """Failed tests of the instrument, and causes of `WaterResidualCause` that name the
    instrument or the water; "refused" for a scan without an image."""


def scene(number: int) -> Scene:
    """Draw the conditions of a scan; frequencies and methods alternate by number."""
    rng = np.random.default_rng([39, number])
    water = str(rng.choice(list(_DISTANCES)))
    method, count = TURNS[number % len(TURNS)]
    return Scene(
        number=number,
        water=water,
        target=str(rng.choice(["plate", "stairs"])),
        distance=round(float(rng.uniform(*_DISTANCES[water])), 2),
        count=count,
        method=method,
    )


def case(chosen: Scene) -> Case:
    """Simulate a scan by a perfect instrument, with a correct survey."""
    rng = np.random.default_rng([40, chosen.number])
    reflectance = round(float(np.exp(rng.uniform(np.log(0.05), np.log(0.6)))), 3)
    if chosen.target == "plate":
        lean = round(float(rng.uniform(-30, 30)), 1)
        target = plate(chosen.distance, lean=lean, reflectance=reflectance)
    else:
        target = stairs(chosen.distance, reflectance=reflectance, tread=0.05)
    planned = survey(
        chosen.count, target, water=chosen.water, columns=_COLUMNS, rows=_ROWS
    )
    return case_of(simulate(planned, rng=rng), interval=around(chosen.distance))


def measured(chosen: Scene) -> AlarmRow:
    """Simulate and process a scan, and return its row."""
    test = case(chosen)
    result = outcome(chosen.method, test)
    figures = score(test, result)
    return AlarmRow(
        scene=chosen,
        trusted=100 * figures.trusted,
        inside=100 * figures.inside_95,
        worst=figures.worst,
        alarms=_alarms(result),
    )


def _alarms(result: Outcome) -> tuple[str, ...]:
    from amulor.imaging.instrument_tests import instrument_tests

    if result.image is None or result.target is None:
        return ("refused",)
    names = [test.name for test in instrument_tests(result.image)]
    bits = np.bitwise_or.reduce(result.target["water_residual_cause"].values, axis=None)
    causes = (WaterResidualCause.INSTRUMENT, WaterResidualCause.WATER_CHANGED)
    names += [str(cause.name) for cause in causes if int(bits) & cause]
    return tuple(names)


HEADER = "scan water    target distance f  method       trust  95 % worst alarms"
LEGEND = """\
scan      number of the scan and seed
distance  distance of the target [m]
f         number of modulation frequencies
trust     fraction of the pixels without a flag [%]
95 %      fraction of the trusted whose 95 % interval contains the surface
worst     largest error of a trusted pixel over its standard uncertainty
alarms    failed tests of the instrument and causes of water residuals
"""


def line(row: AlarmRow) -> str:
    """Return one row of the table as text."""
    chosen = row.scene
    figures = "".join(
        f"{'-' if math.isnan(value) else format(value, '.1f'):>6}"
        for value in (row.trusted, row.inside, row.worst)
    )
    return (
        f"{chosen.number:<4} {chosen.water:<8} {chosen.target:<6} "
        f"{chosen.distance:>8.2f} {chosen.count:<2} {chosen.method:<12}{figures} "
        + (",".join(row.alarms) or "-")
    )


def text(rows: Iterable[AlarmRow]) -> str:
    """Return a table as text, in the order of the scans."""
    ordered = sorted(rows, key=lambda row: row.scene.number)
    return "\n".join([LEGEND, HEADER, *(line(row) for row in ordered), ""])


def written(content: str) -> Iterator[AlarmRow]:
    """Parse the text of a table, and yield its complete rows."""
    _, _, lines = content.partition(HEADER + "\n")
    for entry in lines.splitlines(keepends=True):
        # An interrupted run leaves a line without an end.
        if not entry.endswith("\n"):
            continue
        number, water, target, distance, count, method, *figures, alarms = entry.split()
        trusted, inside, worst = (
            math.nan if value == "-" else float(value) for value in figures
        )
        yield AlarmRow(
            scene=Scene(
                number=int(number),
                water=water,
                target=target,
                distance=float(distance),
                count=int(count),
                method=method,
            ),
            trusted=trusted,
            inside=inside,
            worst=worst,
            alarms=() if alarms == "-" else tuple(alarms.split(",")),
        )


def counts(rows: Iterable[AlarmRow]) -> str:
    """Return a Markdown table with false alarms and coverage by method."""
    ordered = sorted(rows, key=lambda row: METHODS.index(row.scene.method))
    lines = [
        "| method | scans | rejected | false alarms | pixels without a flag, median | "
        "trusted pixels inside the 95 % interval |",
        "|" + " --- |" * 6,
    ]
    groups = [
        (method, list(group))
        for method, group in groupby(ordered, key=lambda row: row.scene.method)
    ]
    for method, group in [*groups, ("all", ordered)]:
        images = [row for row in group if not math.isnan(row.inside)]
        trusted = sum(row.trusted for row in images)
        inside = sum(row.trusted * row.inside for row in images) / max(trusted, 1e-9)
        cells = (
            method if method == "all" else f"`{method}`",
            len(group),
            sum("refused" in row.alarms for row in group),
            len(false_alarms(group)),
            f"{np.median([row.trusted for row in group]):.0f} %",
            f"{inside:.1f} %",
        )
        lines.append("| " + " | ".join(str(cell) for cell in cells) + " |")
    return "\n".join([*lines, ""])


def false_alarms(rows: Iterable[AlarmRow]) -> list[AlarmRow]:
    """Return the rows with a failed test or cause; a refusal alone does not count."""
    return [row for row in rows if set(row.alarms) - {"refused"}]


def run(
    path: Path,
    numbers: Iterable[int],
    *,
    done: Callable[[AlarmRow], None] | None = None,
) -> list[AlarmRow]:
    """Compute the rows missing in a file, and append each when finished."""
    return resumed(
        path, numbers, lambda number: measured(scene(number)),
        key_of=lambda row: row.scene.number,
        written=written, text=text, line=line, done=done,
    )  # fmt: skip
