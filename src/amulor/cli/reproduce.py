"""`amulor reproduce`: published figures redrawn, with what the text says of them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from amulor.cli._arguments import SEED, UsageError
from amulor.cli._output import print_json, progress_bar

#: Which figures need an extra: targets are seen by ray casting, milk is spheres.
_EXTRAS = {"scene": {*range(5, 16)}, "mie": {7, 10, 11, 12}}


def ricci2010(
    *,
    figure: Annotated[tuple[int, ...], Parameter(negative="")] = (),
    output: Annotated[Path, Parameter(alias="-o")] = Path("ricci2010"),
    quick: Annotated[bool, Parameter(negative="")] = False,
    sensitivity: bool = True,
    seed: Annotated[int, Parameter(validator=SEED)] = 1,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Redraw the figures of Ricci et al. 2010 and check their statements.

    Parameters
    ----------
    figure
        Number of a figure, may be given several times; 1 and 3 to 15 by default.
    output
        Folder for figures (PNG and SVG), checks.json and report.html.
    quick
        Fewer points, pixels and photons: a first look in less than a minute.
    sensitivity
        Vary every number that is not printed over its range, to see which conclusions
        flip; left out of a quick run.
    seed
        Seed of all synthetic noise and photons.
    overwrite
        Replace files that are there.
    json
        Print the checks for other programs.
    """
    from amulor import _extras
    from amulor.studies.ricci2010 import reproduce, tables

    numbers = figure or reproduce.FIGURES
    wrong = [number for number in numbers if number not in reproduce.FIGURES]
    if wrong:
        raise UsageError(
            f"--figure {wrong[0]}: figures 1 and 3 to 15 are redrawn; figure 2 is a "
            "drawing of the instrument"
        )
    needed = [extra for extra, few in _EXTRAS.items() if few.intersection(numbers)]
    _extras.require(*needed, purpose="redrawing these figures")
    reproduce.check_outputs(output, numbers, overwrite=overwrite)
    with progress_bar(quiet=json) as progress:
        results = reproduce.run(
            numbers,
            quick=quick,
            depend=sensitivity and not quick,
            rng=seed,
            progress=progress,
        )
        progress("writing figures and report", 0.99)
        reproduce.write(output, results, overwrite=overwrite)
    if json:
        print_json(results.plain())
        return
    for redrawn in results.figures:
        print(f"Figure {redrawn.number}. {redrawn.title}")
        for statement, place, found, wanted, verdict in tables.check_rows(
            redrawn.checks
        ):
            print(f"  {verdict:<10}  {statement}{f' ({place})' if place else ''}")
            print(f"              found {found}; needed {wanted}")
        print()
    if results.dependence is not None:
        print("Conclusions that flip when one number goes to an end of its range")
        for number, statement, state, flips in tables.dependence_rows(
            results.dependence
        ):
            print(f"  figure {number:<3}  {statement}")
            print(f"              {state}; flips at {flips}")
        print()
    print(tables.tally(c for redrawn in results.figures for c in redrawn.checks))
    print(f"Report: {output / 'report.html'}")
