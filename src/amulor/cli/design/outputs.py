"""What `amulor design` writes besides the survey: report, figures, JSON, the page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from amulor.design.goal import Goal
    from amulor.design.recommend import Recommendation
    from amulor.view.design.explorer import Explorer
    from amulor.view.design.report import Reasons


def reasons_of(found: Recommendation, *, confirm: bool) -> Reasons:
    """Return what is found out about a recommendation, told as it goes on.

    Parameters
    ----------
    found : Recommendation
        What is recommended.
    confirm : bool
        Whether scans are simulated and photons followed.

    Returns
    -------
    Reasons
        For report, figures and JSON.
    """
    from amulor import _progress
    from amulor.design.reasons.confirm import confirm as confirmed
    from amulor.design.reasons.sensitivity import sensitivity, uncertain
    from amulor.design.reasons.trade import trade
    from amulor.design.reasons.what_if import what_if
    from amulor.view.design.report import Reasons

    goal, best = found.goal, found.best.parameters
    choices = [("recommended", best)]
    if found.runner_up is not None:
        choices.append(("runner-up", found.runner_up.parameters))
    begin = 0.3 if confirm else 1.0
    with _progress.part(0.0, begin):
        _progress.tell("what time and frequency buy", 0.0)
        bought = trade(goal, best)
        share = None
        if uncertain(goal, best):
            with _progress.part(0.1, 0.4):
                share = sensitivity(goal, best)
        with _progress.part(0.4, 1.0):
            turns = (
                ()
                if found.runner_up is None
                else what_if(goal, best, found.runner_up.parameters)
            )
    held = []
    for number, (name, chosen) in enumerate(choices if confirm else ()):
        span = (1 - begin) / len(choices)
        with _progress.part(begin + number * span, begin + (number + 1) * span):
            held.append(confirmed(goal, chosen, name=name))
    return Reasons(
        trade=bought, sensitivity=share, turns=turns, confirmations=tuple(held)
    )


def as_json(found: Recommendation, reasons: Reasons) -> dict[str, Any]:
    """Return all that was found as plain numbers, texts and lists."""
    from amulor.design.recommend import finite

    return {
        **found.to_dict(),
        "sensitivity": None
        if reasons.sensitivity is None
        else reasons.sensitivity.to_dict(),
        "what_if": [vars(one) for one in reasons.turns],
        "trade": {
            name: value if isinstance(value, int) else finite(value.tolist())
            for name, value in vars(reasons.trade).items()
        },
        "confirmation": [one.to_dict() for one in reasons.confirmations],
    }


def write_all(
    found: Recommendation,
    reasons: Reasons,
    report: Path | None,
    figures: Path | None,
    *,
    overwrite: bool,
) -> None:
    """Write report and figures, whichever is asked for."""
    from amulor.view.design.report import write

    if report is not None:
        write(report, found, reasons, overwrite=overwrite)
    if figures is not None:
        write_figures(figures, found, reasons, overwrite=overwrite)


def print_reasons(
    found: Recommendation,
    reasons: Reasons | None,
    report: Path | None,
    figures: Path | None,
) -> None:
    """Print in a few lines what was found out, and where it was written."""
    if reasons is None:
        return
    if reasons.sensitivity is not None:
        share = reasons.sensitivity.total.max()
        print(
            f"  measure first: {reasons.sensitivity.largest.label} ({share:.0%} of the "
            "variance of the error)"
        )
    for one in reasons.turns:
        if one.factor is not None:
            print(
                f"  the runner-up wins with {one.label} at {one.factor:.3g} times what "
                "is stated"
            )
    for each in reasons.confirmations:
        scans = each.scans
        print(
            f"  confirmed: {each.name}, {scans.ranges} simulated ranges scatter by "
            f"{scans.ratio:.3f} ± {scans.ratio_error:.3f} of what is predicted"
        )
        for line in each.said:
            print(f"  differs: {line}")
    for path in (report, figures):
        if path is not None:
            print(f"{path}: written")


def serve(shown: Explorer, *, port: int, browser: bool) -> None:
    """Serve the page with sliders until Ctrl-C."""
    from amulor import _extras
    from amulor.cli._output import announcing

    _extras.require("view", purpose="the page")
    from amulor.view import page

    page.serve(shown, port=port, announce=announcing(browser=browser))


def write_figures(
    folder: Path, found: Recommendation, reasons: Reasons, *, overwrite: bool
) -> list[Path]:
    """Write each figure of a recommendation into a folder, as PNG."""
    from amulor.io.files import atomic_output, make_folder
    from amulor.view.design.report import figures_of
    from amulor.view.report import png

    if not folder.is_dir():
        make_folder(folder)
    written = []
    for name, figure in figures_of(found, reasons).items():
        path = folder / f"{name}.png"
        with atomic_output(path, overwrite=overwrite) as temporary:
            temporary.write_bytes(png(figure))
        written.append(path)
    return written


def explorer_of(goal: Goal, found: Recommendation) -> Explorer:
    """Return the page with sliders that begins at the recommended instrument."""
    from amulor.survey import Survey
    from amulor.view.design.explorer import Asked, Explorer
    from amulor.view.design.report import waters_of

    chosen = found.best.parameters
    asked = [
        Asked(
            distance=distance,
            attenuation=water,
            accuracy=goal.accuracy.total_error,
        )
        for distance in goal.asked
        for water in sorted(set(waters_of(goal, chosen)))
    ]
    return Explorer(
        Survey.from_text(found.best.survey, name=goal.name),
        method=chosen.method,
        asked=asked,
        interval=goal.limits,
    )
