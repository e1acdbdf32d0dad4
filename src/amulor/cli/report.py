"""`amulor report`: range images in one HTML file, ready to print."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from amulor.cli._arguments import (
    UsageError,
    check_ending,
    check_inputs,
    check_tile_rows,
    quantity_of,
)
from amulor.cli._output import progress_bar

if TYPE_CHECKING:
    import xarray as xr

    from amulor.imaging.measure import Check
    from amulor.imaging.selection import Whole


def report(
    images: list[Path],
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    checks: Path | None = None,
    check: Annotated[tuple[str, ...], Parameter(show_default=False)] = (),
    tile_rows: int | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Write a report of range images in one HTML file.

    Parameters
    ----------
    images
        Range images (netCDF), from "amulor image".
    output
        Report to write (HTML); a browser prints it on A4 paper.
    checks
        TOML file with check distances, one table [[checks]] each: name, first and
        second pixel (row and column), expected length. Optional: expected_uncertainty,
        tolerance, reach, kind.
    check
        Check distance "ROW,COLUMN ROW,COLUMN LENGTH [TOLERANCE]", such as "20,10 20,60
        40mm 1mm"; may be repeated.
    tile_rows
        Read this many rows at a time, with bounded memory. Images of more than 2.1
        million pixels are always read by rows.
    overwrite
        Replace an existing file.
    """
    endings = (".html", ".htm")
    if not check and output.suffix.lower() in endings:
        check_inputs(*images, checks)

    from amulor import _progress, io
    from amulor.imaging import measure
    from amulor.view import image_report

    distances = [_check_of(text, number) for number, text in enumerate(check)]
    check_tile_rows(tile_rows)
    inputs = [*images, *([checks] if checks else [])]
    io.check_output(output, overwrite=overwrite, inputs=inputs)
    check_ending("--output", output, endings)
    if checks is not None:
        distances = [*measure.read_checks(checks), *distances]
    stems = [path.stem for path in images]
    names = [
        path.stem
        if stems.count(path.stem) == 1
        else f"{number + 1}: {path.resolve().parent.name}/{path.stem}"
        for number, path in enumerate(images)
    ]
    cubes, wholes = {}, {}
    with progress_bar() as progress:
        for number, (name, path) in enumerate(zip(names, images, strict=True)):
            progress(f"reading {path}", 0.5 * number / len(images))
            ends = 0.5 * number / len(images), 0.5 * (number + 1) / len(images)
            with _progress.part(*ends):
                cubes[name], wholes[name] = _shown(path, tile_rows, distances)
        with _progress.part(0.5, 1.0):
            image_report.write(
                output, cubes, checks=distances, wholes=wholes, overwrite=overwrite
            )
    print(
        f"{output}: {len(cubes)} range image{'s' if len(cubes) > 1 else ''}; open it "
        "in a browser"
    )


def _shown(
    path: Path, rows: int | None, checks: list[Check]
) -> tuple[xr.Dataset, Whole]:
    """Return a range image, every n-th pixel if large, and statistics of all pixels."""
    from amulor import pipeline
    from amulor.imaging import selection
    from amulor.io.netcdf import tile_rows

    with pipeline.opened(path, rows, level="range_image") as source:
        return selection.thinned(source, rows=rows or tile_rows(source), checks=checks)


def _check_of(text: str, number: int) -> Check:
    """Parse an option that states a known distance between two pixels."""
    from amulor.imaging.measure import Check

    words = text.split()
    try:
        first, second = (
            tuple(int(part) for part in word.split(",")) for word in words[:2]
        )
        length, *position = words[2:]
        ((row, column), (other_row, other_column)) = first, second
    except ValueError:
        raise UsageError(
            f'--check {text!r}: write "ROW,COLUMN ROW,COLUMN LENGTH [TOLERANCE]", such '
            'as "20,10 20,60 40mm 1mm"'
        ) from None
    if len(position) > 1 or min(row, column, other_row, other_column) < 0:
        raise UsageError(f"--check {text!r}: too many words, or a negative number")
    expected = quantity_of("--check", length, "length")
    tolerance = quantity_of("--check", position[0], "length") if position else None
    if expected < 0 or (tolerance is not None and not tolerance > 0):
        raise UsageError(
            f"--check {text!r}: needed are a length of 0 m or more and a tolerance "
            "above 0 m"
        )
    return Check(
        name=f"check {number + 1}",
        first=(row, column),
        second=(other_row, other_column),
        expected=expected,
        tolerance=tolerance,
    )
