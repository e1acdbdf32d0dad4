"""`amulor design`: which instrument, as a survey that runs, with the reasons."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

if TYPE_CHECKING:
    from amulor.design import Choice, Recommendation, Requirement


def design(
    goal: Path,
    /,
    *,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    runner_up: Path | None = None,
    report: Path | None = None,
    figures: Path | None = None,
    confirm: Annotated[bool, Parameter(negative="")] = False,
    interactive: Annotated[bool, Parameter(negative="")] = False,
    port: Annotated[int, Parameter(validator=validators.Number(gte=0, lt=65536))] = 0,
    browser: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Recommend an instrument for a goal; write its survey.

    Parameters
    ----------
    goal
        Goal file (TOML).
    output
        Survey file (TOML) of the recommended instrument.
    runner_up
        Survey file of the second best one.
    report
        Report to write: one page (HTML) with maps, what to measure before buying, and
        what would change the answer.
    figures
        Folder for the figures of the report (PNG).
    confirm
        Simulate scans of the recommended instrument and of the runner-up, work on
        them, and follow photons; say where these differ from what was predicted.
    interactive
        Open a page with sliders and the map of errors that they move, until Ctrl-C.
    port
        Port of that page; a free one by default.
    browser
        Open it in the browser of this computer.
    json
        Print the recommendation as JSON, with all that --report and --confirm find.
    overwrite
        Replace files that are there.
    """
    from amulor.cli._arguments import UsageError, check_ending, check_inputs
    from amulor.cli._output import print_json, progress_bar

    if output is None and not interactive:
        raise UsageError("needed is --output survey.toml, or --interactive")
    files = [one for one in (output, runner_up) if one is not None]
    for option, file, ending in (
        ("--output", output, ".toml"),
        ("--runner-up", runner_up, ".toml"),
        ("--report", report, ".html"),
    ):
        if file is not None:
            check_ending(option, file, (ending,))
    if runner_up is not None and output is None:
        raise UsageError("--runner-up goes with --output")
    if runner_up is not None and runner_up == output:
        raise UsageError("--runner-up and --output name the same file")
    check_inputs(goal)

    from amulor import _progress, io
    from amulor.cli.design import outputs
    from amulor.design import Goal, recommend
    from amulor.io.files import atomic_output

    asked = Goal.from_toml(goal)
    for file in [*files, *([] if report is None else [report])]:
        io.check_output(file, overwrite=overwrite, inputs=[goal])
    more = report is not None or figures is not None or confirm
    reasons = None
    with progress_bar(quiet=json):
        with _progress.part(0.0, 0.5 if more else 1.0):
            found = recommend(asked)
        if more:
            with _progress.part(0.5, 1.0):
                reasons = outputs.reasons_of(found, confirm=confirm)
    for file, choice in zip(files, (found.best, found.runner_up), strict=False):
        if choice is not None:
            with atomic_output(file, overwrite=overwrite) as path:
                path.write_text(choice.survey, "utf-8")
    if reasons is not None:
        outputs.write_all(found, reasons, report, figures, overwrite=overwrite)
    if json:
        print_json(
            found.to_dict() if reasons is None else outputs.as_json(found, reasons)
        )
    else:
        _print(found, files)
        outputs.print_reasons(found, reasons, report, figures)
    if interactive:
        outputs.serve(outputs.explorer_of(asked, found), port=port, browser=browser)


def _print(found: Recommendation, files: list[Path]) -> None:
    """Print what is recommended, why, and what speaks against it."""
    asked = found.goal
    print(f"{asked.name}: {found.looked_at} candidates")
    for line in found.impossible:
        print(f"  impossible: {line.text}")
    word = "nearest to the goal" if found.impossible else "best"
    _print_choice(word, found.best, asked.accuracy.total_error)
    for bound in found.bounds:
        print(f"  bound: {bound.text}")
    between = found.best.between
    if between.error > 1.01 * max(asked.accuracy.total_error, found.best.error):
        print(
            f"  note: the error is {1e3 * between.error:.3g} mm at "
            f"{between.distance:.3g} m, between the distances that are asked for; name "
            "nearest and farthest in [distances] if it must be met from end to end"
        )
    if found.runner_up is not None:
        _print_choice("runner-up", found.runner_up, asked.accuracy.total_error)
    for file in files[: 1 if found.runner_up is None else 2]:
        print(f"{file}: survey written")
    from amulor.cli._output import print_next

    print_next(f"amulor survey check {files[0]}")


def _print_choice(word: str, choice: Choice, accuracy: float) -> None:
    """Print an instrument, its requirements and what binds."""
    from amulor.design.requirements import parameters_text, quantity_text

    print(f"  {word}: {parameters_text(choice.parameters)}")
    cost = f", price {choice.cost:g}" if choice.cost else ""
    print(
        f"    total error {1e3 * choice.error:.3g} mm of {1e3 * accuracy:.3g} mm at "
        f"{choice.worst_distance:.4g} m, accuracy met in {choice.share:.0%} of the "
        f"draws; {choice.scan_time / 60:.3g} min{cost}; largest term: "
        f"{choice.binding.replace('_', ' ')}"
    )
    shares = choice.shares
    if shares is not None and shares.error < 0.98 * shares.even:
        divided = " : ".join(f"{100 * part:.0f}" for part in shares.share)
        print(
            f"    dwell shared {divided} between the frequencies: "
            f"{1e3 * shares.error:.3g} mm (a survey shares it evenly)"
        )
    for one, count in _told(choice.requirements):
        state = "met" if one.met else "MISSED"
        binding = f"; {one.binding.replace('_', ' ')}" if one.binding else ""
        among = f"; the tightest of {count} distances" if count > 1 else ""
        print(
            f"    {state}: {one.name} {quantity_text(one.name, one.value)} of "
            f"{quantity_text(one.name, one.limit)}{binding}{among}"
        )


def _told(requirements: tuple[Requirement, ...]) -> list[tuple[Requirement, int]]:
    """Return what is missed, and of what is met at all distances the tightest."""
    kinds: dict[str, list[Requirement]] = {}
    for one in requirements:
        kinds.setdefault(one.name.partition(" at ")[0], []).append(one)
    told = []
    for each in kinds.values():
        if all(one.met for one in each):
            told.append((min(each, key=lambda one: one.margin), len(each)))
        else:
            told += [(one, 1) for one in each if not one.met]
    return told
