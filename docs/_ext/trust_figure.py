"""Figures of the trust page, drawn from the tables whenever the site is built."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from amulor.studies.benchmark import figure as benchmark_figure
from amulor.studies.benchmark import scenes as public
from amulor.studies.benchmark import summary
from amulor.studies.benchmark import table as benchmark_table
from amulor.studies.trust import instrument
from amulor.studies.trust.table import TWO, Written, written
from amulor.view.style import COLOURS, new_figure, style

if TYPE_CHECKING:
    from sphinx.application import Sphinx

TABLE = "trust/default.txt"
DRAWN = "trust/intervals.svg"
INSTRUMENT_TABLE = "trust/instrument.txt"
INSTRUMENT_DRAWN = "trust/instrument.svg"
BENCHMARK_TABLE = "trust/benchmark.csv"
BENCHMARK_DRAWN = "trust/benchmark.svg"
BENCHMARK_PAGE = "trust/benchmark-tables.md"

#: Kinds of scenes, from top to bottom of the figure.
KINDS = {
    "plates, stairs, wide scans": (
        "flat", "slope 60", "slope 75", "dark", "stairs", "tall", "wide",
        "wide paper's form",
    ),
    "other waters, circular light": (
        "coastal", "harbour", "circular", "small-angle 90", "small-angle 15",
        "paper's form",
    ),
    "photons followed one by one": (
        "wide photons", "photons petzold grey", "photons petzold dim",
        "photons fournier-forand grey", "photons fournier-forand dim",
        "photons two-term grey", "photons two-term dim", "photons c 0.25 1/m",
        "photons c 1 1/m", "photons c 2 1/m",
    ),
    "simulated acquisition": ("acquired", "acquired twice"),
    "moving vehicle": ("moving",),
    "spikes, particles": ("spikes", "particles"),
    "water that changes": ("change 5 %", "drift 3 %", "drift 10 %"),
    "errors of survey and noise": (
        "noise", "a, b doubled", "a, b halved", "delay stated", "baseline stated",
        "index stated",
    ),
}  # fmt: skip
METHODS = {
    "open-water": ("open water", "o"),
    "polarization": ("polarization", "s"),
    "combined": ("combination", "^"),
    "joint": ("joint", "D"),
    "auto": ("auto", "v"),
}
#: Range of a quantity over the scenes of a kind: least, median, largest [%].
Span = tuple[float, float, float]


def spans(
    rows: Iterable[Written],
) -> dict[tuple[str, str], tuple[Span, Span]]:
    """Return share trusted and coverage by kind of scene and method [%]."""
    table = list(rows)
    result = {}
    for kind, scenes in KINDS.items():
        for method in METHODS:
            cells = [
                row
                for row in table
                if row.method == method and row.scene in scenes and not row.refused
            ]
            coverage = [row.inside for row in cells if not np.isnan(row.inside)]
            result[kind, method] = (
                _span([row.trusted for row in cells]),
                _span(coverage),
            )
    return result


def _span(values: list[float]) -> Span:
    return min(values), float(np.median(values)), max(values)


def figure(rows: Iterable[Written]) -> Figure:
    """Draw medians and ranges of both quantities."""
    values = spans(rows)
    with style():
        drawn = new_figure(5.0, 6.0)
        panels = drawn.subplots(1, 2, sharey=True)
        for index, (method, (label, marker)) in enumerate(METHODS.items()):
            height = np.arange(len(KINDS)) + 0.15 * (index - 2)
            for panel, quantity in zip(panels, (0, 1), strict=True):
                low, middle, high = np.transpose(
                    [values[kind, method][quantity] for kind in KINDS]
                )
                panel.hlines(height, low, high, color=COLOURS[index], linewidth=1.5)
                panel.plot(
                    middle, height, marker, color=COLOURS[index], label=label,
                    linestyle="none", markersize=4,
                )  # fmt: skip
        panels[0].set_xlabel("pixels without a flag [%]")
        panels[0].set_xlim(55, 102)
        panels[1].set_xlabel("surface inside the 95 % interval [%]")
        panels[1].set_xlim(90.5, 100.5)
        panels[1].axvline(95, color="0.4", linewidth=1, linestyle=":")
        panels[0].set_yticks(range(len(KINDS)), [_wrapped(kind) for kind in KINDS])
        panels[0].invert_yaxis()
        for edge in np.arange(len(KINDS) - 1) + 0.5:
            for panel in panels:
                panel.axhline(edge, color="0.85", linewidth=0.8)
        drawn.legend(
            *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=5
        )
    return drawn


def _wrapped(kind: str) -> str:
    words = kind.split()
    half = (len(words) + 1) // 2
    return "\n".join([" ".join(words[:half]), " ".join(words[half:])])


#: Method and state of the survey in the figure of instrument errors; sizes of panels.
SHOWN = ("open-water", "uncalibrated")
PANELS = {1.0: "typical size", 3.0: "three times the typical size"}


def errors(
    rows: Iterable[instrument.InstrumentRow],
) -> dict[tuple[str, float, int], float]:
    """Return mean errors in stated uncertainties, not a number if all is flagged.

    By kind of error, its size and the number of frequencies.
    """
    return {
        (row.key.kind, row.key.size, row.key.count): abs(row.mean) / row.stated
        for row in rows
        if (row.key.method, row.key.state) == SHOWN and row.key.size in PANELS
    }


def instrument_figure(rows: Iterable[instrument.InstrumentRow]) -> Figure:
    """Draw the range error by each instrument error in stated uncertainties."""
    values = errors(rows)
    kinds = list(dict.fromkeys(kind for kind, _, _ in values if kind != "perfect"))
    with style():
        drawn = new_figure(5.0, 6.0)
        panels = drawn.subplots(1, len(PANELS), sharey=True)
        for panel, (size, title) in zip(panels, PANELS.items(), strict=True):
            panel.set_title(title)
            panel.set_xlabel("error / stated uncertainty")
            panel.axvline(TWO, color="0.4", linewidth=1, linestyle=":")
            panel.set_xlim(-0.7, 5)
            for index, count in enumerate(instrument.COUNTS):
                height = np.arange(len(kinds)) + 0.2 * (index - 1)
                error = np.array(
                    [values.get((kind, size, count), -1) for kind in kinds]
                )
                flagged = np.isnan(error)
                panel.plot(
                    error[error >= 0], height[error >= 0], "osD"[index],
                    color=COLOURS[index], label=_counted(count), linestyle="none",
                    markersize=4,
                )  # fmt: skip
                panel.plot(
                    np.full(flagged.sum(), -0.4), height[flagged], "x",
                    color=COLOURS[index], markersize=4, linestyle="none",
                )  # fmt: skip
        panels[0].set_yticks(range(len(kinds)), kinds)
        panels[0].invert_yaxis()
        drawn.legend(
            *panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3
        )
    return drawn


def _counted(count: int) -> str:
    return f"{count} frequenc{'y' if count == 1 else 'ies'}"


def draw(app: Sphinx) -> None:
    """Write the figures beside their page."""
    folder = Path(app.srcdir)
    rows = written((folder / TABLE).read_text(encoding="utf-8"))
    figure(rows).savefig(folder / DRAWN, metadata={"Date": None})
    table = (folder / INSTRUMENT_TABLE).read_text(encoding="utf-8")
    drawn = instrument_figure(instrument.written(table))
    drawn.savefig(folder / INSTRUMENT_DRAWN, metadata={"Date": None})
    compared = benchmark_table.read(folder / BENCHMARK_TABLE)
    drawn = benchmark_figure.figure(compared)
    drawn.savefig(folder / BENCHMARK_DRAWN, metadata={"Date": None})
    tables = summary.page(compared, public.read(), figure="benchmark.svg")
    (folder / BENCHMARK_PAGE).write_text(tables, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect with Sphinx."""
    app.connect("builder-inited", draw)
    return {"parallel_read_safe": True}
