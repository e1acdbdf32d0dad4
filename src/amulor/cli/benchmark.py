"""`amulor benchmark`: all rejection methods on public scenes with known ranges."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from amulor.cli._arguments import UsageError, check_inputs
from amulor.cli._output import print_json, print_table, progress_bar

if TYPE_CHECKING:
    from amulor.studies.benchmark.scenes import Scene


def benchmark(
    *,
    scenes: str | None = None,
    methods: str | None = None,
    output: Annotated[Path, Parameter(alias="-o")] = Path("benchmark"),
    quick: Annotated[bool, Parameter(negative="")] = False,
    list_scenes: Annotated[bool, Parameter(name="--list", negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Compare the rejection methods on public scenes with known ranges.

    Parameters
    ----------
    scenes
        Names of scenes with commas between them, or a TOML file of scenes. By default
        all scenes.
    methods
        Names of methods with commas between them, also of other packages. By default
        all installed methods.
    output
        Folder for the table (benchmark.csv), the figure and the page. Rows that the
        table has are not computed again.
    quick
        Use seven scenes, which take three minutes.
    list_scenes
        List the scenes.
    json
        Print the rows as JSON.
    """
    from dataclasses import asdict

    from amulor import io, rejection
    from amulor.io.files import atomic_output
    from amulor.studies.benchmark import summary, table

    chosen = _scenes(scenes)
    if quick:
        chosen = [scene for scene in chosen if scene.quick]
        if not chosen:
            raise UsageError("--quick: none of these scenes is in the quick form")
    if list_scenes:
        for scene in chosen:
            print(f"{scene.name:<42} {scene.title}")
        return
    names = rejection.names() if methods is None else _listed(methods)
    wrong = [
        name
        for name in names
        if name.removesuffix(" without shots") not in rejection.names()
    ]
    if wrong:
        raise UsageError(
            f"--methods: there is no method {wrong[0]!r}; installed are "
            f"{', '.join(rejection.names())}"
        )
    io.make_folder(output)
    path = output / "benchmark.csv"
    with progress_bar(quiet=json) as progress:
        rows = table.run(
            path,
            chosen,
            names,
            done=lambda row, number, count: progress(
                f"{row.scene}, {row.method}", number / count
            ),
        )
    from amulor.studies.benchmark.figure import figure

    with atomic_output(output / "benchmark.svg", overwrite=True) as file:
        figure(rows).savefig(file, format="svg")
    with atomic_output(output / "benchmark.md", overwrite=True) as file:
        file.write_text(
            summary.page(rows, chosen, figure="benchmark.svg"), encoding="utf-8"
        )
    if json:
        print_json([asdict(row) for row in rows])
        return
    print_table(
        f"{len(chosen)} scenes, {len(names)} methods",
        summary.ROW_HEADER,
        [summary.row_cells(row) for row in rows],
    )
    print_table("Methods", summary.TALLY_HEADER, summary.tally_rows(rows))
    if text := summary.regret_text(rows):
        print(text)
    print(f"Table, figure and page: {output}")


def _scenes(text: str | None) -> list[Scene]:
    """Return the scenes of the option --scenes: names, or a file."""
    from amulor.studies.benchmark.scenes import read

    if text is None:
        return read()
    if text.endswith(".toml"):
        check_inputs(Path(text))
        return read(Path(text))
    available = {scene.name: scene for scene in read()}
    names = _listed(text)
    if wrong := [name for name in names if name not in available]:
        raise UsageError(
            f"--scenes: there is no scene {wrong[0]!r}; --list prints the scenes"
        )
    return [available[name] for name in names]


def _listed(text: str) -> tuple[str, ...]:
    """Return the names of an option with commas between them, each once."""
    names = (name.strip() for name in text.split(","))
    return tuple(dict.fromkeys(name for name in names if name))
