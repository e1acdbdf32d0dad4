"""The study as one HTML file."""

from __future__ import annotations

from pathlib import Path

from amulor.studies.ricci2010 import tables
from amulor.studies.ricci2010.results import Results
from amulor.view.report import Heading, Paragraph, Part, Picture, Table, write_report

#: What a reader must know before the first figure.
FOREWORD = (
    "The data points and many numbers of the paper survive only in pictures that are "
    "not at hand. What is drawn here as measured is synthetic: computed with the "
    "models of amulor from the numbers listed at the end, with the noise that they "
    'state. "FAIL" means that the statement could not be met with these physics. '
    '"(set)" marks statements from which a number of the study was deduced, so that '
    'they prove nothing; "(own)" marks checks that the paper does not state.'
)


def write(path: Path, results: Results, *, overwrite: bool) -> None:
    """Write figures, checks, dependences and numbers as one HTML file."""
    every = [check for figure in results.figures for check in figure.checks]
    parts: list[Part] = [Paragraph(FOREWORD), Paragraph(tables.tally(every))]
    for figure in results.figures:
        rows = [
            [*row[:-1], f"!{row[-1]}" if row[-1].startswith("FAIL") else row[-1]]
            for row in tables.check_rows(figure.checks)
        ]
        parts += [
            Heading(f"Figure {figure.number}. {figure.title}"),
            Picture(figure.drawn, figure.caption),
            Table(tables.CHECK_HEADER, rows, "What the paper says, and what was found"),
        ]
    if results.dependence is not None:
        parts += [
            Heading("What the conclusions depend on"),
            Paragraph(
                "Every number that is not printed was taken to both ends of its range, "
                "one at a time. These conclusions flip:"
            ),
            Table(
                tables.DEPENDENCE_HEADER,
                tables.dependence_rows(results.dependence),
                "Conclusions that are not listed hold, or fail, at both ends of every "
                "range.",
            ),
        ]
    parts += [
        Heading("The numbers"),
        Table(
            tables.PARAMETER_HEADER,
            tables.parameter_rows(results.parameters),
            "text: printed in the paper; deduced: follows from what is printed; "
            "assumed: chosen, as nothing fixes it",
        ),
    ]
    title = "Ricci et al. 2010, figures 1 and 3 to 15 redrawn"
    write_report(path, title, parts, overwrite=overwrite)
