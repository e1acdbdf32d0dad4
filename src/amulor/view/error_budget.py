"""The error budgets of range images as tables of a report."""

from __future__ import annotations

import math
from collections.abc import Mapping

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from amulor.cube.schema import ALIKE_TERMS, SHARED_TERMS
from amulor.imaging import ErrorBudget, error_budget
from amulor.imaging.budget import age_in_words
from amulor.view.report import Heading, Paragraph, Part, Picture, Table
from amulor.view.style import COLOURS, new_figure, style

#: Terms that pixels have in common, of the whole scan or of their surroundings.
_SHARED = {*ALIKE_TERMS, *SHARED_TERMS}


def error_budgets(images: Mapping[str, xr.Dataset]) -> list[Part]:
    """Return what a report says of the errors of range images, term by term."""
    parts: list[Part] = [Heading("Where the uncertainty comes from")]
    for name, image in images.items():
        budget = error_budget(image)
        if budget.lines and math.isfinite(budget.combined):
            parts += [
                Picture(
                    budget_figure({name: budget}),
                    _key(budget),
                ),
                _table(name, budget),
                Paragraph(_limits(budget)),
            ]
    return parts if len(parts) > 1 else []


def _key(budget: ErrorBudget) -> str:
    """Return the caption of the bars; it explains what is drawn and nothing else."""
    parts = ["Standard uncertainty of each term, median over the usable pixels."]
    if any(line.term.name in _SHARED for line in budget.lines):
        parts.append("Dark terms are shared by pixels: a mean keeps them.")
    if budget.unknown:
        parts.append("Hatched terms are not known and not in the combined one.")
    return " ".join(parts)


def budget_figure(budgets: Mapping[str, ErrorBudget]) -> Figure:
    """Draw the terms of error budgets as bars."""
    most = max(len(b.lines) + len(b.unknown) + 1 for b in budgets.values())
    with style():
        figure = new_figure(6.4 * len(budgets), 0.5 + 0.24 * most)
        panels = figure.subplots(1, len(budgets), squeeze=False)[0]
        for axis, (name, budget) in zip(panels, budgets.items(), strict=True):
            _bars(axis, budget)
            axis.set_title(name)
    return figure


def _bars(axis: Axes, budget: ErrorBudget) -> None:
    """Draw one bar a term, the largest at the right end of the axis."""
    names = [line.term.name for line in budget.lines]
    names += [term.name for term in budget.unknown] + ["combined"]
    known = [line.uncertainty * 1e3 for line in budget.lines]
    colours = [
        COLOURS[0] if name in _SHARED else COLOURS[5] for name in names[: len(known)]
    ]
    place = list(range(len(names)))
    axis.barh(place[: len(known)], known, color=colours, height=0.7)
    for number, value in enumerate(known):
        axis.text(value, number, f" {value:.3g}", va="center", fontsize=7)
    unsaid = place[len(known) : -1]
    longest = budget.combined * 1e3
    axis.barh(
        unsaid, longest, color="none", edgecolor="#d9d9d9", hatch="////", height=0.7
    )
    for number in unsaid:
        axis.text(0, number, "  not known", va="center", fontsize=7)
    axis.barh(place[-1], longest, color=COLOURS[6], height=0.7)
    axis.text(longest, place[-1], f" {longest:.3g}", va="center", fontsize=7)
    axis.set_yticks(place, [name.replace("_", " ") for name in names])
    axis.invert_yaxis()
    axis.set_xlim(0, 1.12 * longest)
    axis.set_xlabel("standard uncertainty [mm]")


def _table(name: str, budget: ErrorBudget) -> Table:
    rows = [
        [
            line.term.name.replace("_", " "),
            line.term.meaning,
            line.term.kind,
            "" if line.samples is None else f"{line.samples} shots",
            f"{line.uncertainty * 1e3:.3g}",
            f"{line.share:.1%}",
        ]
        for line in budget.lines
    ]
    for term in budget.unknown:
        rows.append(
            [term.name.replace("_", " "), term.meaning, term.kind, "", "!not known", ""]
        )
    rows.append(
        ["combined", "all that are known", "", "", f"{budget.combined * 1e3:.3g}", ""]
    )
    rows.append(
        [
            "expanded, k = 2",
            "about 95 of 100 errors lie within",
            "",
            "",
            f"{budget.expanded * 1e3:.3g}",
            "",
        ]
    )
    return Table(
        ["term", "what it is", "type", "found from", "standard [mm]", "of variance"],
        rows,
        f"{name}: standard uncertainty of the slant range, medians over the usable "
        "pixels. Type A is found from the scatter of measurements, type B from other "
        "knowledge (GUM). The squares of the terms add up to that of the combined one.",
    )


def _limits(budget: ErrorBudget) -> str:
    """Return what the combined uncertainty holds and what it does not."""
    said = []
    if math.isfinite(budget.common):
        said.append(
            f"All pixels share {budget.common * 1e3:.3g} mm of it: no mean over "
            "pixels takes that away."
        )
    if math.isfinite(budget.late):
        said.append(
            f"Light scattered on its way made the echoes {budget.late * 1e3:.3g} mm "
            "late; that is taken off."
        )
    elif budget.late_echo:
        said.append(f"Late light: {budget.late_echo}.")
    if budget.calibrated:
        old = age_in_words(budget.age)
        said.append(f"The delay was calibrated on {budget.calibrated}{old}.")
    if budget.unknown:
        names = ", ".join(term.name.replace("_", " ") for term in budget.unknown)
        said.append(
            f"Not in it, since nobody says how large they are: {names}. The section "
            "[calibration] of the survey states them."
        )
    return " ".join(said)
