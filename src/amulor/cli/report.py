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

    image_report.write(
        output,
        {path.stem: io.read_cube(path) for path in images},
        overwrite=overwrite,
    )
    print(f"{output}: {len(images)} range images")
