"""`amulor survey presets` and `amulor survey preset`: published instruments."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from amulor.cli._output import print_json


def presets(*, json: Annotated[bool, Parameter(negative="")] = False) -> None:
    """List published instruments that ship as surveys.

    Parameters
    ----------
    json
        Print them for other programs.
    """
    from amulor.survey import presets as shipped

    found = [shipped.preset(name) for name in shipped.names()]
    if json:
        print_json(
            [
                {
                    "name": one.name,
                    "title": one.title,
                    "source": one.source,
                    "doi": one.doi,
                    "use": one.use,
                    **one.counts,
                }
                for one in found
            ]
        )
        return
    for one in found:
        said = ", ".join(f"{count} {basis}" for basis, count in one.counts.items())
        print(f"{one.name}: {one.title}")
        print(f"  {one.use}")
        print(f"  {one.source}, doi:{one.doi}")
        print(f"  numbers: {said}; each line of the file says which")


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
        One of those that `amulor survey presets` lists.
    output
        Survey file to write (.toml).
    overwrite
        Replace a file that is there.
    """
    from amulor.cli._arguments import check_ending
    from amulor.io.files import atomic_output
    from amulor.survey import presets as shipped

    check_ending("--output", output, (".toml",))
    found = shipped.preset(name)
    with atomic_output(output, overwrite=overwrite) as path:
        path.write_text(found.text, encoding="utf-8")
    print(f"{output}: {found.title}; next: amulor survey check {output}")
