"""`amulor demo`: a simulated scan with its report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from amulor.cli._arguments import SEED
from amulor.cli._output import print_json, print_next, print_table, progress_bar


def demo(
    *,
    output: Annotated[Path, Parameter(alias="-o")] = Path("amulor-demo"),
    seed: Annotated[int, Parameter(validator=SEED)] = 1,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Simulate scans of a ladder in clear and milky water; write a report.

    Parameters
    ----------
    output
        Folder for surveys, cubes, range images, point clouds and report.html.
    seed
        Seed of the simulated noise.
    overwrite
        Replace existing files.
    json
        Print the result as JSON.
    """
    from amulor.studies import ladder
    from amulor.studies.ladder import mean_error

    with progress_bar(quiet=json) as progress:
        cases = ladder.run(output, rng=seed, overwrite=overwrite, progress=progress)
    if json:
        print_json(ladder.summary(cases))
        return
    print_table(
        "Mean error of the slant range [mm]",
        ["case", "before", "after", "noise", "stated noise"],
        [
            [
                after.name,
                mean_error(before),
                mean_error(after),
                f"{after.noise * 1e3:.2f}",
                f"{after.stated * 1e3:.2f}",
            ]
            for before, after in zip(cases[::2], cases[1::2], strict=True)
        ],
    )
    print(f"Report, for a browser: {output / 'report.html'}")
    for name, extra in ladder.left_out().items():
        print(
            f"No {name.upper()} files: pip install 'amulor[{extra}]' lets it write them"
        )
    print_next(f"amulor view {output / 'ladder_milk_target_signal.nc'}")
