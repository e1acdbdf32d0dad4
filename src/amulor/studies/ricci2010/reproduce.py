"""Run of the study: figures, checks and sensitivity, written to files."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from pathlib import Path

from amulor import io
from amulor.io.files import atomic_output
from amulor.studies.ricci2010.figures import FIGURES as PAPER_FIGURES
from amulor.studies.ricci2010.results import Redrawn, Results, write_page
from amulor.studies.ricci2010.sensitivity import sensitivity
from amulor.studies.ricci2010.study import Study
from amulor.view.report import png
from amulor.view.style import style

#: Figure 2 is a drawing of the instrument.
FIGURES = tuple(PAPER_FIGURES)
#: Callback with the current step and the completed fraction of the work.
Progress = Callable[[str, float], None]


def run(
    numbers: Sequence[int] = FIGURES,
    *,
    quick: bool = False,
    depend: bool = True,
    rng: int = 1,
    scheduler: str | None = None,
    folder: Path | None = None,
    progress: Progress = lambda step, done: None,
) -> Results:
    """Redraw figures of the paper, and check its statements about them."""
    wrong = sorted(set(numbers) - set(FIGURES))
    if wrong:
        raise ValueError(
            f"figure {wrong[0]} is not redrawn; figures 1 and 3 to 15 are (figure 2 is "
            "a drawing of the instrument)"
        )
    chosen = sorted(set(numbers))
    study = Study(quick=quick, rng=rng)
    part = 0.4 if depend else 1.0
    figures = []
    for done, number in enumerate(chosen):
        progress(f"figure {number}", part * done / len(chosen))
        figures.append(_redrawn(study, number))
    dependence = None
    if depend:
        dependence = sensitivity(
            Study(quick=True, rng=rng),
            {number: PAPER_FIGURES[number].checks for number in chosen},
            workers=os.cpu_count() or 1,
            scheduler=scheduler,
            folder=folder,
            progress=lambda step, done: progress(step, part + (1 - part) * done),
        )
    progress("done", 1.0)
    return Results(tuple(figures), dependence, study.parameters)


def write(folder: Path, results: Results, *, overwrite: bool = False) -> list[str]:
    """Write figures (PNG, SVG), all results as JSON, and a report."""
    numbers = [figure.number for figure in results.figures]
    check_outputs(folder, numbers, overwrite=overwrite)
    for figure in results.figures:
        stem = folder / stem_of(figure.number)
        with atomic_output(stem.with_suffix(".png"), overwrite=overwrite) as temporary:
            temporary.write_bytes(png(figure.drawn, dots_per_inch=200))
        with (
            atomic_output(stem.with_suffix(".svg"), overwrite=overwrite) as temporary,
            style(),
        ):
            figure.drawn.savefig(
                temporary, format="svg", dpi=200, metadata={"Date": None}
            )
    with atomic_output(folder / "checks.json", overwrite=overwrite) as temporary:
        temporary.write_text(json.dumps(results.plain(), indent=2) + "\n")
    write_page(folder / "report.html", results, overwrite=overwrite)
    return output_names(numbers)


def check_outputs(folder: Path, numbers: Sequence[int], *, overwrite: bool) -> None:
    """Check that the output folder can be written, before the computation."""
    io.make_folder(folder)
    for name in output_names(numbers):
        io.check_output(folder / name, overwrite=overwrite)


def output_names(numbers: Sequence[int]) -> list[str]:
    """Return the names of all output files of `write`."""
    pictures = [
        f"{stem_of(number)}.{kind}" for number in numbers for kind in ("png", "svg")
    ]
    return [*pictures, "checks.json", "report.html"]


def stem_of(number: int) -> str:
    """Return the file-name stem of a figure."""
    return f"figure_{number:02d}"


def _redrawn(study: Study, number: int) -> Redrawn:
    figure = PAPER_FIGURES[number]
    return Redrawn(
        number=number,
        title=figure.title,
        caption=figure.caption,
        checks=tuple(figure.checks(study)),
        drawn=figure.draw(study),
    )
