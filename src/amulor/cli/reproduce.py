"""`amulor reproduce`: published figures redrawn, with checks of their statements."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, TypeVar

from cyclopts import Parameter

from amulor.cli._arguments import SEED, UsageError
from amulor.cli._output import print_json, progress_bar

Result = TypeVar("Result")
#: Interval of checks for Ctrl-C [s].
_LOOK = 0.1
#: Figures that need an extra: milk is spheres.
_EXTRAS = {"mie": {7, 10, 11, 12}}


def ricci2010(
    *,
    figure: Annotated[tuple[int, ...], Parameter(negative="", show_default=False)] = (),
    output: Annotated[Path, Parameter(alias="-o")] = Path("ricci2010"),
    quick: Annotated[bool, Parameter(negative="")] = False,
    sensitivity: bool = True,
    scheduler: str | None = None,
    seed: Annotated[int, Parameter(validator=SEED)] = 1,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Redraw the figures of Ricci et al. 2010 and check their statements.

    Parameters
    ----------
    figure
        Number of a figure; may be repeated. By default figures 1 and 3 to 15.
    output
        Folder for figures (PNG and SVG), checks.json and report.html.
    quick
        Use fewer points, pixels and photons, for a first look in less than a minute.
    sensitivity
        Vary every number that the paper does not print over its range, to see which
        conclusions change. Not part of a quick run.
    scheduler
        Vary the numbers on a cluster: address of a dask scheduler, such as
        tcp://node1:8786, or "local". Workers need access to the output folder. Results
        of earlier runs in its folder "varied" are used again.
    seed
        Seed of all synthetic noise and photons.
    overwrite
        Replace existing files.
    json
        Print the checks as JSON.
    """
    from amulor import _extras, io
    from amulor.studies.ricci2010 import reproduce, results

    numbers = figure or reproduce.FIGURES
    wrong = [number for number in numbers if number not in reproduce.FIGURES]
    if wrong:
        raise UsageError(
            f"--figure {wrong[0]}: figures 1 and 3 to 15 are redrawn; figure 2 is a "
            "drawing of the instrument"
        )
    depend = sensitivity and not quick
    if scheduler is not None and not depend:
        raise UsageError(
            "--scheduler varies numbers, which --quick and --no-sensitivity leave out"
        )
    needed = [extra for extra, few in _EXTRAS.items() if few.intersection(numbers)]
    _extras.require(*needed, purpose="redrawing these figures")
    reproduce.check_outputs(output, numbers, overwrite=overwrite)
    if scheduler is not None:
        _extras.require("scale", purpose="a cluster")
        io.make_folder(output)
    with progress_bar(quiet=json) as progress:
        outcome = _interruptible(
            lambda: reproduce.run(
                numbers,
                quick=quick,
                depend=depend,
                rng=seed,
                scheduler=scheduler,
                folder=output / "varied",
                progress=progress,
            )
        )
        progress("writing figures and report", 0.99)
        reproduce.write(output, outcome, overwrite=overwrite)
    if json:
        print_json(outcome.plain())
        return
    for redrawn in outcome.figures:
        print(f"Figure {redrawn.number}. {redrawn.title}")
        for statement, place, value, expected, verdict in results.check_rows(
            redrawn.checks
        ):
            print(f"  {verdict:<10}  {statement}{f' ({place})' if place else ''}")
            print(f"              found {value}; needed {expected}")
        print()
    if outcome.dependence is not None:
        print("Conclusions that flip when one number goes to an end of its range")
        for number, statement, state, flips in results.dependence_rows(
            outcome.dependence
        ):
            print(f"  figure {number:<3}  {statement}")
            print(f"              {state}; flips at {flips}")
        print()
    print(results.tally(c for redrawn in outcome.figures for c in redrawn.checks))
    print(f"Report: {output / 'report.html'}")


def _interruptible(work: Callable[[], Result]) -> Result:
    """Call a function; Ctrl-C ends the program and its workers at once.

    The function runs in a separate thread. In the main thread an interrupt would wait
    for the end of a compiled loop, and a photon run would take it as a request to stop
    early and use the photons so far.
    """
    from threading import Thread

    outcome: list[Result] = []
    problems: list[BaseException] = []

    def do() -> None:
        try:
            outcome.append(work())
        except BaseException as problem:
            problems.append(problem)

    thread = Thread(target=do, daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            thread.join(_LOOK)
    except KeyboardInterrupt:
        _leave()
    if problems:
        raise problems[0]
    return outcome[0]


def _leave() -> None:
    """End the program and its workers at once, without writing files."""
    import multiprocessing
    import os
    from importlib import import_module

    for process in multiprocessing.active_children():
        process.kill()
    if sys.stderr.isatty():
        print("\x1b[?25h", end="", file=sys.stderr)  # the bar hides the cursor
    # What multiprocessing does at the end of a program: semaphores of workers go.
    util: Any = import_module("multiprocessing.util")
    util._exit_function()
    print("amulor: interrupted", file=sys.stderr, flush=True)
    os._exit(130)
