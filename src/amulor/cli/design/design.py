"""`amulor design`: which instrument, as a survey that runs, with the reasons."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from amulor.design import Choice, Recommendation


def design(
    goal: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    runner_up: Path | None = None,
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
    json
        Print the recommendation as JSON.
    overwrite
        Replace files that are there.
    """
    from amulor import io
    from amulor.cli._arguments import UsageError, check_ending
    from amulor.cli._output import print_json, progress_bar
    from amulor.design import Goal, recommend

    files = [output] if runner_up is None else [output, runner_up]
    for option, file in zip(("--output", "--runner-up"), files, strict=False):
        check_ending(option, file, (".toml",))
    if runner_up == output:
        raise UsageError("--runner-up and --output name the same file")
    asked = Goal.from_toml(goal)
    for file in files:
        io.check_output(file, overwrite=overwrite, inputs=[goal])
    with progress_bar(quiet=json):
        found = recommend(asked)
    for file, choice in zip(files, (found.best, found.runner_up), strict=False):
        if choice is not None:
            file.write_text(choice.survey, "utf-8")
    if json:
        print_json(found.to_dict())
        return
    _print(found, files)


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
    if found.runner_up is not None:
        _print_choice("runner-up", found.runner_up, asked.accuracy.total_error)
    for file in files[: 1 if found.runner_up is None else 2]:
        print(f"{file}: survey written")


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
    for one in choice.requirements:
        state = "met" if one.met else "MISSED"
        binding = f"; {one.binding.replace('_', ' ')}" if one.binding else ""
        print(
            f"    {state}: {one.name} {quantity_text(one.name, one.value)} of "
            f"{quantity_text(one.name, one.limit)}{binding}"
        )
