"""`amulor site check`: looks for mistakes in a site file and in what it names."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def check(
    site: Path, /, *, json: Annotated[bool, Parameter(negative="")] = False
) -> None:
    """Check a site file and the files it names.

    Parameters
    ----------
    site
        Site file (TOML).
    json
        Print the findings as JSON.
    """
    from amulor.cli._arguments import check_inputs

    check_inputs(site)

    from dataclasses import asdict

    from amulor.cli._output import print_json, print_next, progress_bar
    from amulor.errors import SurveyError
    from amulor.site import Site
    from amulor.site.check import check as look

    described = Site.from_toml(site)
    with progress_bar(quiet=json):
        found = look(described)
    if json:
        print_json({"site": described.name, **asdict(found)})
    else:
        for line in found.remarks:
            print(f"note: {line}")
    if found.mistakes:
        raise SurveyError("\n".join(f"{site}: {line}" for line in found.mistakes))
    if not json:
        targets = len(described.target)
        print(
            f"{site}: {described.name}: {len(described.scan)} scans of "
            f"{len(described.epoch)} epochs, {targets} targets, "
            f"{len(described.control)} control points"
        )
        print_next(f"amulor site register {site} -o poses.json")


def schema() -> None:
    """Print the JSON Schema of site files."""
    from amulor.cli._output import print_json
    from amulor.site.description.site_file import json_schema

    print_json(json_schema())
