"""`amulor design`: recommend an instrument for a goal, with the reasons."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter, validators

if TYPE_CHECKING:
    from amulor.design import Choice, Goal, Recommendation, Requirement
    from amulor.view.design.explorer import Explorer
    from amulor.view.design.report import Reasons


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
        Survey file (TOML) to write for the recommended instrument.
    runner_up
        Survey file (TOML) to write for the second-best instrument.
    report
        Report to write (HTML): maps, quantities to measure before buying, and
        assumptions that would change the recommendation.
    figures
        Folder for the figures of the report (PNG).
    confirm
        Check the recommended instrument and the runner-up by simulated scans and by
        photon transport, and print the differences from the predictions.
    interactive
        Open a page with sliders and an error map, until Ctrl-C.
    port
        Port of the page; by default any free port.
    browser
        Open the page in the browser of this computer.
    json
        Print the recommendation as JSON, with the results of --report and --confirm.
    overwrite
        Replace existing files.
    """
    from amulor.cli._arguments import UsageError, check_ending, check_inputs
    from amulor.cli._output import print_json, progress_bar

    if output is None and not interactive:
        raise UsageError("needed is --output survey.toml, or --interactive")
    files = [path for path in (output, runner_up) if path is not None]
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
    from amulor.design import Goal, recommend
    from amulor.io.files import atomic_output

    goals = Goal.from_toml(goal)
    for file in [*files, *([] if report is None else [report])]:
        io.check_output(file, overwrite=overwrite, inputs=[goal])
    more = report is not None or figures is not None or confirm
    reasons = None
    with progress_bar(quiet=json):
        with _progress.part(0.0, 0.5 if more else 1.0):
            recommendation = recommend(goals)
        if more:
            with _progress.part(0.5, 1.0):
                reasons = reasons_of(recommendation, confirm=confirm)
    for file, choice in zip(
        files, (recommendation.best, recommendation.runner_up), strict=False
    ):
        if choice is not None:
            with atomic_output(file, overwrite=overwrite) as path:
                path.write_text(choice.survey, "utf-8")
    if reasons is not None:
        write_all(recommendation, reasons, report, figures, overwrite=overwrite)
    if json:
        print_json(
            recommendation.to_dict()
            if reasons is None
            else as_json(recommendation, reasons)
        )
    else:
        _print(recommendation, files)
        print_reasons(recommendation, reasons, report, figures)
    if interactive:
        serve(explorer_of(goals, recommendation), port=port, browser=browser)


def _print(recommendation: Recommendation, files: list[Path]) -> None:
    """Print the recommended instrument, its limits, the runner-up and the files."""
    goal = recommendation.goal
    print(f"{goal.name}: {recommendation.looked_at} candidates")
    for line in recommendation.impossible:
        print(f"  impossible: {line.text}")
    word = "nearest to the goal" if recommendation.impossible else "best"
    _print_choice(word, recommendation.best, goal.accuracy.total_error)
    for bound in recommendation.bounds:
        print(f"  bound: {bound.text}")
    between = recommendation.best.between
    if between.error > 1.01 * max(goal.accuracy.total_error, recommendation.best.error):
        print(
            f"  note: the error is {1e3 * between.error:.3g} mm at "
            f"{between.distance:.3g} m, between the distances that are asked for; name "
            "nearest and farthest in [distances] if it must be met from end to end"
        )
    if recommendation.runner_up is not None:
        _print_choice("runner-up", recommendation.runner_up, goal.accuracy.total_error)
    for file in files[: 1 if recommendation.runner_up is None else 2]:
        print(f"{file}: survey written")
    if files:
        from amulor.cli._output import print_next

        print_next(f"amulor survey check {files[0]}")


def _print_choice(word: str, choice: Choice, accuracy: float) -> None:
    """Print an instrument, its requirements and its largest error sources."""
    from amulor.design.requirements import lines_texts, parameters_text, quantity_text

    print(f"  {word}: {parameters_text(choice.parameters)}")
    cost = f", price {choice.cost:g}" if choice.cost else ""
    print(
        f"    total error {1e3 * choice.error:.3g} mm of {1e3 * accuracy:.3g} mm at "
        f"{choice.worst_distance:.4g} m, accuracy met in {choice.share:.0%} of the "
        f"draws; {choice.scan_time / 60:.3g} min{cost}; largest term: "
        f"{choice.binding.replace('_', ' ')}"
    )
    if choice.lines is not None:
        texts = lines_texts(choice.lines, choice.parameters).items()
        told = [f"{label} {text}" for label, text in texts]
        print(f"    vehicle: {'; '.join(told[:3])}")
        print(f"      {'; '.join(told[3:])}")
    shares = choice.shares
    if shares is not None and shares.error < 0.98 * shares.even:
        divided = " : ".join(f"{100 * part:.0f}" for part in shares.share)
        print(
            f"    dwell shared {divided} between the frequencies: "
            f"{1e3 * shares.error:.3g} mm (a survey shares it evenly)"
        )
    for requirement, count in _told(choice.requirements):
        state = "met" if requirement.met else "MISSED"
        binding = (
            f"; {requirement.binding.replace('_', ' ')}" if requirement.binding else ""
        )
        among = f"; the tightest of {count} distances" if count > 1 else ""
        name = requirement.name
        print(
            f"    {state}: {name} {quantity_text(name, requirement.value)} of "
            f"{quantity_text(name, requirement.limit)}{binding}{among}"
        )


def _told(requirements: tuple[Requirement, ...]) -> list[tuple[Requirement, int]]:
    """Return all missed requirements; of each kind fully met, only the tightest."""
    kinds: dict[str, list[Requirement]] = {}
    for requirement in requirements:
        kinds.setdefault(requirement.name.partition(" at ")[0], []).append(requirement)
    listed = []
    for kind in kinds.values():
        if all(requirement.met for requirement in kind):
            listed.append(
                (min(kind, key=lambda requirement: requirement.margin), len(kind))
            )
        else:
            listed += [(requirement, 1) for requirement in kind if not requirement.met]
    return listed


def reasons_of(recommendation: Recommendation, *, confirm: bool) -> Reasons:
    """Compute trade-offs, sensitivity, what-if and, if requested, confirmations."""
    from amulor import _progress
    from amulor.design.confirm import confirm as confirmed
    from amulor.design.sensitivity import sensitivity, uncertain
    from amulor.design.trade import trade, what_if
    from amulor.view.design.report import Reasons

    goal, best = recommendation.goal, recommendation.best.parameters
    choices = [("recommended", best)]
    if recommendation.runner_up is not None:
        choices.append(("runner-up", recommendation.runner_up.parameters))
    begin = 0.3 if confirm else 1.0
    with _progress.part(0.0, begin):
        _progress.tell("trade-off of time and frequency", 0.0)
        bought = trade(goal, best)
        share = None
        if uncertain(goal, best):
            with _progress.part(0.1, 0.4):
                share = sensitivity(goal, best)
        with _progress.part(0.4, 1.0):
            turns = (
                ()
                if recommendation.runner_up is None
                else what_if(goal, best, recommendation.runner_up.parameters)
            )
    fixed = []
    for number, (name, chosen) in enumerate(choices if confirm else ()):
        span = (1 - begin) / len(choices)
        with _progress.part(begin + number * span, begin + (number + 1) * span):
            fixed.append(confirmed(goal, chosen, name=name))
    return Reasons(
        trade=bought, sensitivity=share, turns=turns, confirmations=tuple(fixed)
    )


def as_json(recommendation: Recommendation, reasons: Reasons) -> dict[str, Any]:
    """Return the recommendation and its reasons as a dictionary for JSON."""
    from amulor.design.recommend import finite

    return {
        **recommendation.to_dict(),
        "sensitivity": None
        if reasons.sensitivity is None
        else reasons.sensitivity.to_dict(),
        "what_if": [vars(entry) for entry in reasons.turns],
        "trade": {
            name: value if isinstance(value, int) else finite(value.tolist())
            for name, value in vars(reasons.trade).items()
        },
        "confirmation": [entry.to_dict() for entry in reasons.confirmations],
    }


def write_all(
    recommendation: Recommendation,
    reasons: Reasons,
    report: Path | None,
    figures: Path | None,
    *,
    overwrite: bool,
) -> None:
    """Write report and figures, if requested."""
    from amulor.view.design.report import write

    if report is not None:
        write(report, recommendation, reasons, overwrite=overwrite)
    if figures is not None:
        write_figures(figures, recommendation, reasons, overwrite=overwrite)


def print_reasons(
    recommendation: Recommendation,
    reasons: Reasons | None,
    report: Path | None,
    figures: Path | None,
) -> None:
    """Print sensitivity, what-if results and confirmations, and the written files."""
    if reasons is None:
        return
    if reasons.sensitivity is not None:
        share = reasons.sensitivity.total.max()
        print(
            f"  measure first: {reasons.sensitivity.largest.label} ({share:.0%} of the "
            "variance of the error)"
        )
    for turn in reasons.turns:
        if turn.factor is not None:
            print(
                f"  the runner-up wins with {turn.label} at {turn.factor:.3g} times "
                "what is stated"
            )
    for confirmation in reasons.confirmations:
        scans = confirmation.scans
        print(
            f"  confirmed: {confirmation.name}, {scans.ranges} simulated ranges "
            f"scatter by {scans.ratio:.3f} ± {scans.ratio_error:.3f} of what is "
            "predicted"
        )
        for line in confirmation.said:
            print(f"  differs: {line}")
    for path in (report, figures):
        if path is not None:
            print(f"{path}: written")


def serve(shown: Explorer, *, port: int, browser: bool) -> None:
    """Serve the design page with its sliders until Ctrl-C."""
    from amulor import _extras
    from amulor.cli._output import announcing

    _extras.require("view", purpose="the page")
    from amulor.view import page

    page.serve(shown, port=port, announce=announcing(browser=browser))


def write_figures(
    folder: Path, recommendation: Recommendation, reasons: Reasons, *, overwrite: bool
) -> list[Path]:
    """Write each figure of a recommendation into a folder, as PNG."""
    from amulor.io.files import atomic_output, make_folder
    from amulor.view.design.report import figures_of
    from amulor.view.report import png

    if not folder.is_dir():
        make_folder(folder)
    written = []
    for name, figure in figures_of(recommendation, reasons).items():
        path = folder / f"{name}.png"
        with atomic_output(path, overwrite=overwrite) as temporary:
            temporary.write_bytes(png(figure))
        written.append(path)
    return written


def explorer_of(goal: Goal, recommendation: Recommendation) -> Explorer:
    """Return the explorer of the design page, set to the recommended instrument."""
    from amulor.survey import Survey
    from amulor.view.design.explorer import Asked, Explorer
    from amulor.view.design.report import waters_of

    chosen = recommendation.best.parameters
    limits = [
        Asked(
            distance=distance,
            attenuation=water,
            accuracy=goal.accuracy.total_error,
        )
        for distance in goal.asked
        for water in sorted(set(waters_of(goal, chosen)))
    ]
    return Explorer(
        Survey.from_text(recommendation.best.survey, name=goal.name),
        method=chosen.method,
        asked=limits,
        interval=goal.limits,
    )
