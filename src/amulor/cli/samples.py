"""`amulor samples`: small data to begin with, without an instrument."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def samples(
    *names: str,
    output: Annotated[Path, Parameter(alias="-o")] = Path(),
    overwrite: Annotated[bool, Parameter(negative="")] = False,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """List sample data, or write some of them to try the other commands on.

    Parameters
    ----------
    names
        What to write; without any, a list of what there is.
    output
        Folder to write into.
    overwrite
        Replace files that are there.
    json
        For other programs.
    """
    from dataclasses import asdict

    from amulor import samples as room
    from amulor.cli._arguments import UsageError
    from amulor.cli._output import print_json

    if not names:
        known = room.samples()
        if json:
            print_json({name: asdict(one) for name, one in known.items()})
            return
        width = max(map(len, known))
        for name, one in known.items():
            print(f"{name:<{width}}  {one.size / 1e3:4.0f} kB  {one.title}")
            print(f"{'':{width + 11}}shows {one.shows}")
        print("`amulor samples NAME` writes its files here.")
        return
    try:
        wanted = [room.sample(name) for name in dict.fromkeys(names)]
    except ValueError as error:
        raise UsageError(str(error)) from None
    written = {
        one.name: room.copy(one.name, output, overwrite=overwrite) for one in wanted
    }
    if json:
        print_json(
            {name: [str(one) for one in paths] for name, paths in written.items()}
        )
        return
    for one in wanted:
        for path in written[one.name]:
            print(f"{path}: {one.title}")
        print(f"  {one.origin}; {one.licence}")
        for command in one.commands:
            print(f"  $ {command}")
