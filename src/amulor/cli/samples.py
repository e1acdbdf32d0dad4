"""`amulor samples`: sample data, to start without an instrument."""

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
    """List the sample data, or write a sample to try other commands.

    Parameters
    ----------
    names
        Names of the sample data to write; without names, all are listed.
    output
        Folder for the files.
    overwrite
        Replace existing files.
    json
        Print the list as JSON.
    """
    from dataclasses import asdict

    from amulor import samples as room
    from amulor.cli._arguments import UsageError
    from amulor.cli._output import print_json

    if not names:
        listed = room.samples()
        if json:
            print_json({name: asdict(entry) for name, entry in listed.items()})
            return
        width = max(map(len, listed))
        for name, entry in listed.items():
            print(f"{name:<{width}}  {entry.size / 1e3:4.0f} kB  {entry.title}")
            print(f"{'':{width + 11}}shows {entry.shows}")
        print("`amulor samples NAME` writes its files here.")
        return
    try:
        chosen = [room.sample(name) for name in dict.fromkeys(names)]
    except ValueError as error:
        raise UsageError(str(error)) from None
    written = {
        entry.name: room.copy(entry.name, output, overwrite=overwrite)
        for entry in chosen
    }
    if json:
        print_json(
            {name: [str(entry) for entry in paths] for name, paths in written.items()}
        )
        return
    for entry in chosen:
        for path in written[entry.name]:
            print(f"{path}: {entry.title}")
        print(f"  {entry.origin}; {entry.licence}")
        for command in entry.commands:
            print(f"  $ {command}")
