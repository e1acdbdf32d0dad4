"""Comparison of methods by the rows of the benchmark: best methods, regret, page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from amulor.studies.benchmark.scenes import Scene
from amulor.studies.benchmark.table import NEARLY_AS_MANY, Row, needs

AUTO = "auto"
#: Errors within this ratio count as equal [1].
_EQUAL = 1.05


@dataclass(frozen=True, kw_only=True)
class Regret:
    """Errors of `auto` relative to the best method of each scene in hindsight."""

    median: float
    """Median of error ratio minus 1 [1]."""
    worst: float
    """Largest error ratio minus 1 [1]."""
    worst_scene: str
    """Name of its scene."""
    scenes: int
    """Number of scenes with an error ratio."""
    failures: tuple[str, ...]
    """Scenes in which a method takes part in the comparison, and `auto` does not."""
    too_narrow: tuple[str, ...]
    """Scenes in which the intervals of `auto` do not hold."""


def by_scene(rows: Sequence[Row]) -> dict[str, dict[str, Row]]:
    """Return the rows by scene and method, in their order."""
    table: dict[str, dict[str, Row]] = {}
    for row in rows:
        table.setdefault(row.scene, {})[row.method] = row
    return table


def candidates(rows: dict[str, Row]) -> dict[str, Row]:
    """Return the methods of a scene whose errors are compared, smallest error first.

    Their intervals hold, and they trust nearly as many pixels as the best of them.
    """
    valid = {name: row for name, row in rows.items() if row.compared}
    most = max((row.trusted for row in valid.values()), default=math.nan)
    many = [name for name, row in valid.items() if row.trusted >= NEARLY_AS_MANY * most]
    return {name: rows[name] for name in sorted(many, key=lambda n: rows[n].error)}


def best(rows: dict[str, Row]) -> str | None:
    """Return the method with the smallest error except `auto`; None without one."""
    names = [name for name in candidates(rows) if name != AUTO]
    return names[0] if names else None


def regret(rows: Sequence[Row]) -> Regret | None:
    """Return the regret of `auto`; None if no scene has a result of it."""
    ratios: dict[str, float] = {}
    failures, too_narrow = [], []
    for scene, methods in by_scene(rows).items():
        chosen = methods.get(AUTO)
        if chosen is None:
            continue
        if not chosen.holds:
            too_narrow.append(scene)
        winner = best(methods)
        if winner is None:
            continue
        if chosen.compared:
            ratios[scene] = chosen.error / methods[winner].error - 1
        else:
            failures.append(scene)
    if not ratios:
        return None
    worst = max(ratios, key=lambda scene: ratios[scene])
    return Regret(
        median=float(np.median(list(ratios.values()))),
        worst=ratios[worst],
        worst_scene=worst,
        scenes=len(ratios),
        failures=tuple(failures),
        too_narrow=tuple(too_narrow),
    )


@dataclass(frozen=True, kw_only=True)
class Tally:
    """Counts of a method over the scenes."""

    method: str
    """Name of the method."""
    scenes: int
    """Number of scenes with a surface."""
    refused: int
    """Number of scenes that the method refuses."""
    compared: int
    """Number of scenes in which its intervals hold and half of the pixels are
    trusted."""
    too_narrow: int
    """Number of scenes in which its intervals do not hold."""
    wins: int
    """Number of scenes in which no method has a smaller error, within 5 %."""
    excess: float
    """Median ratio of its error to that of the best method [1]."""
    worst: float
    """Largest error of a trusted pixel in standard uncertainties, where its intervals
    hold [1]."""
    seconds: float
    """Median processor time [s]."""


def tallies(rows: Sequence[Row]) -> list[Tally]:
    """Return the counts of each method, most wins first."""
    table = by_scene(rows)
    result = []
    for method in dict.fromkeys(row.method for row in rows):
        of_method = [table[scene][method] for scene in table if method in table[scene]]
        met = [row for row in of_method if not math.isnan(row.trusted)]
        ratios = []
        for row in met:
            winner = best(table[row.scene])
            if row.compared and winner is not None:
                ratios.append(row.error / table[row.scene][winner].error)
        held = [row.worst for row in met if row.compared]
        result.append(
            Tally(
                method=method,
                scenes=len(met),
                refused=sum(row.note.startswith(("refused", "CRASH")) for row in met),
                compared=sum(row.compared for row in met),
                too_narrow=sum(not row.holds for row in of_method),
                wins=sum(
                    row.method in candidates(table[row.scene])
                    and row.error <= _EQUAL * table[row.scene][winner].error
                    for row in met
                    if (winner := best(table[row.scene])) is not None
                ),
                excess=float(np.median(ratios)) if ratios else math.nan,
                worst=max(held, default=math.nan),
                seconds=float(np.median([row.seconds for row in of_method])),
            )
        )
    return sorted(result, key=lambda tally: (-tally.wins, -tally.compared))


TALLY_HEADER = (
    "method",
    "needs",
    "scenes",
    "refused",
    "compared",
    "intervals too narrow",
    "wins",
    "error / best",
    "worst",
    "time [s]",
)


def tally_rows(rows: Sequence[Row]) -> list[tuple[str, ...]]:
    """Return the counts of each method as cells."""
    return [
        (
            tally.method,
            needs(tally.method),
            str(tally.scenes),
            str(tally.refused),
            str(tally.compared),
            str(tally.too_narrow),
            str(tally.wins),
            number(tally.excess, ".2f"),
            number(tally.worst, ".1f"),
            number(tally.seconds, ".2g"),
        )
        for tally in tallies(rows)
    ]


ROW_HEADER = (
    "scene", "method", "trusted [%]", "inside 68 % [%]", "inside 95 % [%]", "worst",
    "bias [mm]", "noise [mm]", "stated [mm]", "time [s]", "note",
)  # fmt: skip


def row_cells(row: Row) -> tuple[str, ...]:
    """Return a row as cells."""
    return (
        row.scene,
        row.method,
        number(100 * row.trusted, ".0f"),
        number(100 * row.inside_68, ".0f"),
        number(100 * row.inside_95, ".0f"),
        number(row.worst, ".1f"),
        number(row.bias, "+.3g"),
        number(row.noise, ".3g"),
        number(row.stated, ".3g"),
        number(row.seconds, ".2g"),
        row.note[:60],
    )


def number(value: float, form: str) -> str:
    """Format a number; a dash for NaN."""
    return "-" if math.isnan(value) else format(value, form)


def regret_text(rows: Sequence[Row]) -> str:
    """Return the regret of `auto` in sentences; empty without a result of it."""
    found = regret(rows)
    if found is None:
        return ""
    lines = [
        f"Regret of auto in {found.scenes} scenes: median {found.median:.1%}, worst "
        f"{found.worst:.0%} ({found.worst_scene})."
    ]
    if found.failures:
        lines.append(
            "Scenes in which another method is valid and auto is not: "
            f"{', '.join(found.failures)}."
        )
    if found.too_narrow:
        lines.append(
            f"Scenes in which the intervals of auto do not hold: "
            f"{', '.join(found.too_narrow)}."
        )
    return "\n".join(lines)


def page(rows: Sequence[Row], scenes: Sequence[Scene], *, figure: str) -> str:
    """Return the tables of the page of the benchmark as Markdown."""
    table = by_scene(rows)
    titles = {scene.name: scene for scene in scenes}
    winners = []
    beaten = []
    for name, methods in table.items():
        ranked = [row for key, row in candidates(methods).items() if key != AUTO]
        scene = titles[name]
        first = ranked[0] if ranked else None
        second = ranked[1] if len(ranked) > 1 else None
        chosen = methods.get(AUTO)
        winners.append(
            (
                scene.title,
                f"{scene.count}",
                f"`{first.method}`" if first else "none",
                number(first.error, ".3g") if first else "-",
                number(first.stated, ".3g") if first else "-",
                f"`{second.method}`" if second else "none",
                number(second.error, ".3g") if second else "-",
                number(chosen.error, ".3g") if chosen and chosen.compared else "-",
            )
        )
        if chosen and first and chosen.compared and chosen.error > _EQUAL * first.error:
            beaten.append(
                (
                    scene.title,
                    f"`{chosen.note or AUTO}`",
                    number(chosen.error, ".3g"),
                    f"`{first.method}`",
                    number(first.error, ".3g"),
                    f"{chosen.error / first.error - 1:.0%}",
                )
            )
    parts = [
        f":::{{figure}} {figure}\n:alt: Error of each method in each scene\n:width: "
        "100%\n\nError of each method, relative to the best method of the scene. "
        "A cross marks intervals that do not hold. An empty cell marks a method that "
        "refuses the scene or trusts less than half of the pixels. A gray square marks "
        "a row that was not computed.\n:::",
        "## Methods\n\n" + _markdown(TALLY_HEADER, _coded(tally_rows(rows))),
        "## Best method of each scene\n\n"
        + _markdown(
            (
                "scene",
                "frequencies",
                "best",
                "error [mm]",
                "stated [mm]",
                "second",
                "error [mm]",
                "`auto` [mm]",
            ),
            winners,
        ),
        "## Choice of `auto`\n\n"
        + regret_text(rows).replace("auto", "`auto`")
        + "\n\nIn these scenes another method has an error more than 5 % smaller:\n\n"
        + _markdown(
            (
                "scene",
                "choice of `auto`",
                "error [mm]",
                "better",
                "error [mm]",
                "regret",
            ),
            beaten,
        ),
    ]
    return "\n\n".join(parts) + "\n"


def _coded(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    return [(f"`{row[0]}`", *row[1:]) for row in rows]


def _markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
