"""`amulor survey presets` and `amulor survey preset`: published instruments."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from amulor.cli._output import print_json, print_table, progress_bar

if TYPE_CHECKING:
    from amulor.design.evaluate import Reach


def presets(
    *,
    where: Annotated[bool, Parameter(negative="")] = False,
    accuracy: str = "3 mm",
    reflectance: str | None = None,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """List the published instruments that are available as surveys.

    Parameters
    ----------
    where
        Show up to which distance each instrument works, in waters known by name.
    accuracy
        Largest acceptable total error of a pixel.
    reflectance
        Reflectance of the target; by default that in the preset.
    json
        Print the list as JSON.
    """
    from amulor.cli._arguments import quantity_of
    from amulor.survey import presets as shipped

    if where:
        _print_reach(
            quantity_of("--accuracy", accuracy, "length"),
            None
            if reflectance is None
            else quantity_of("--reflectance", reflectance, "fraction"),
            json=json,
        )
        return
    shipped_presets = [shipped.preset(name) for name in shipped.names()]
    if json:
        print_json(
            [
                {
                    "name": entry.name,
                    "title": entry.title,
                    "source": entry.source,
                    "doi": entry.doi,
                    "use": entry.use,
                    **entry.counts,
                }
                for entry in shipped_presets
            ]
        )
        return
    for entry in shipped_presets:
        bases = ", ".join(f"{count} {basis}" for basis, count in entry.counts.items())
        print(f"{entry.name}: {entry.title}")
        print(f"  {entry.use}")
        print(f"  {entry.source}, doi:{entry.doi}")
        print(f"  numbers: {bases}; each line of the file says which")


def _print_reach(accuracy: float, reflectance: float | None, *, json: bool) -> None:
    """Print the distances at which each preset is accurate enough, for each water."""
    from dataclasses import asdict

    from amulor.design.evaluate import WATERS, reach
    from amulor.survey import Survey
    from amulor.survey import presets as shipped

    reaches: dict[str, list[Reach]] = {}
    with progress_bar(quiet=json) as advance:
        rows = len(shipped.names()) * len(WATERS)
        for name in shipped.names():
            survey, reaches[name] = Survey.preset(name), []
            for water in WATERS:
                count = sum(map(len, reaches.values()))
                advance(f"{name}, {water}", count / rows)
                reaches[name].append(
                    reach(
                        survey, accuracy=accuracy, water=water, reflectance=reflectance
                    )
                )
    if json:
        print_json(
            {name: [asdict(entry) for entry in row] for name, row in reaches.items()}
        )
        return
    print(f"Error of one pixel within {accuracy * 1e3:g} mm, and what ends it:")
    for name, row in reaches.items():
        print_table(
            f"{name}: phases repeat after {row[0].repetition:.3g} m",
            ["water", "attenuation 1/m", "from m", "to m", "ends by"],
            [[entry.water, f"{entry.attenuation:.2g}", *_span(entry)] for entry in row],
        )


def _span(reach: Reach) -> list[str]:
    """Return table cells: nearest and farthest distance, and cause of the limit."""
    if reach.nearest is None or reach.farthest is None:
        return ["", "none", reach.binding]
    far = "> 60" if math.isinf(reach.farthest) else f"{reach.farthest:.3g}"
    return [f"{reach.nearest:.2g}", far, reach.binding]


def preset(
    name: str,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Write the survey file of a published instrument.

    Parameters
    ----------
    name
        Name of a preset, from "amulor survey presets".
    output
        Survey file to write (TOML).
    overwrite
        Replace an existing file.
    """
    from amulor.cli._arguments import check_ending
    from amulor.io.files import atomic_output
    from amulor.survey import presets as shipped

    check_ending("--output", output, (".toml",))
    chosen = shipped.preset(name)
    with atomic_output(output, overwrite=overwrite) as path:
        path.write_text(chosen.text, encoding="utf-8")
    print(f"{output}: {chosen.title}; next: amulor survey check {output}")
