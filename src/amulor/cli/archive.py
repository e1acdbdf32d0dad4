"""`amulor archive`: the archive folder of a project, and its check."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from amulor.cli._arguments import UsageError
from amulor.cli._output import print_json, print_next, progress_bar
from amulor.errors import FormatError


def archive(
    project: Path | None = None,
    /,
    *,
    output: Annotated[Path | None, Parameter(alias="-o")] = None,
    check: Path | None = None,
    json: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Write the archive folder of a project, or check one.

    Parameters
    ----------
    project
        Description of the project (TOML), with the sections [project] and
        [registration], and a table [[scans]] for each scan.
    output
        Folder to create; it must not exist.
    check
        Archive folder to check instead of writing one. Prints what is missing; the exit
        code is then 1.
    json
        Print the result as JSON.
    """
    if check is not None:
        if project is not None or output is not None:
            raise UsageError("--check looks at an archive; give no project or --output")
        _look_through(check, json=json)
        return
    if project is None or output is None:
        raise UsageError(
            "name a project file and the folder to make (--output), or an archive to "
            "look through (--check)"
        )
    from amulor import _extras
    from amulor.handover.archive import read_project, write_archive

    if output.exists():
        raise FormatError(f"{output} exists already; choose another name")
    described = read_project(project)
    _extras.require("export", "e57", purpose="the archive")
    with progress_bar(quiet=json):
        counts = write_archive(described, output)
    if json:
        print_json({"folder": output, **counts})
        return
    scans = f"{counts['scans']} scan{'s' if counts['scans'] > 1 else ''}"
    print(f"{output}: {scans}, {counts['points']} points, {counts['files']} files")
    print_next(f"amulor archive --check {output}")


def _look_through(folder: Path, *, json: bool) -> None:
    from amulor.handover.archive import missing_of

    with progress_bar(quiet=json) as progress:
        progress("comparing checksums", 0.0)
        problems = missing_of(folder)
    if json:
        print_json({"folder": folder, "complete": not problems, "missing": problems})
    if problems:
        raise FormatError(
            "\n".join(problems)
            if not json
            else f"{folder}: {len(problems)} things are missing"
        )
    if not json:
        print(f"{folder}: complete, all checksums agree")
