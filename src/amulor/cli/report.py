"""`amulor report`: range images drawn into one HTML file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def report(
    images: list[Path],
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Draw range images into one HTML file.

    Parameters
    ----------
    images
        Range images (netCDF), from `amulor image`.
    output
        File to write (HTML).
    overwrite
        Replace a file that is there.
    """
    from amulor import io
    from amulor.view import image_report

    io.check_output(output, overwrite=overwrite, inputs=images)
    stems = [path.stem for path in images]
    cubes = {
        path.stem
        if stems.count(path.stem) == 1
        else f"{number + 1}: {path.resolve().parent.name}/{path.stem}": io.read_cube(
            path
        )
        for number, path in enumerate(images)
    }
    image_report.write(output, cubes, overwrite=overwrite)
    print(f"{output}: {len(cubes)} range image{'s' if len(cubes) > 1 else ''}")
