"""`amulor report`: range images drawn into one HTML file, ready to be printed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from amulor.cli._arguments import UsageError, check_ending, quantity_of
from amulor.cli._output import progress_bar

if TYPE_CHECKING:
    from amulor.imaging.measure import Check


def report(
    images: list[Path],
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    checks: Path | None = None,
    check: tuple[str, ...] = (),
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Draw range images into one HTML file.

    Parameters
    ----------
    images
        Range images (netCDF), from `amulor image`.
    output
        File to write (HTML); a browser prints it as a clean A4 document.
    checks
        TOML file with check distances, a table [[checks]] each: name, first, second
        (row and column), expected, and where known expected_uncertainty, tolerance,
        reach, kind.
    check
        A check distance "ROW,COLUMN ROW,COLUMN LENGTH [TOLERANCE]", such as "20,10
        20,60 40mm 1mm"; may be given several times.
    overwrite
        Replace a file that is there.
    """
    from amulor import io
    from amulor.imaging import measure
    from amulor.view import image_report

    known = [_check_of(text, number) for number, text in enumerate(check)]
    inputs = [*images, *([checks] if checks else [])]
    io.check_output(output, overwrite=overwrite, inputs=inputs)
    check_ending("--output", output, (".html", ".htm"))
    if checks is not None:
        known = [*measure.read_checks(checks), *known]
    stems = [path.stem for path in images]
    with progress_bar() as progress:
        progress("reading", 0.0)
        cubes = {
            path.stem
            if stems.count(path.stem) == 1
            else f"{number + 1}: {path.resolve().parent.name}/{path.stem}": (
                io.read_cube(path)
            )
            for number, path in enumerate(images)
        }
        image_report.write(output, cubes, checks=known, overwrite=overwrite)
    print(f"{output}: {len(cubes)} range image{'s' if len(cubes) > 1 else ''}")


def _check_of(text: str, number: int) -> Check:
    """Return the check distance that an option states."""
    from amulor.imaging.measure import Check

    words = text.split()
    try:
        first, second = (
            tuple(int(part) for part in word.split(",")) for word in words[:2]
        )
        length, *rest = words[2:]
        ((row, column), (other_row, other_column)) = first, second
    except ValueError:
        raise UsageError(
            f'--check {text!r}: write "ROW,COLUMN ROW,COLUMN LENGTH [TOLERANCE]", such '
            'as "20,10 20,60 40mm 1mm"'
        ) from None
    if len(rest) > 1 or min(row, column, other_row, other_column) < 0:
        raise UsageError(f"--check {text!r}: too many words, or a negative number")
    expected = quantity_of("--check", length, "length")
    tolerance = quantity_of("--check", rest[0], "length") if rest else None
    if expected < 0 or (tolerance is not None and not tolerance > 0):
        raise UsageError(f"--check {text!r}: lengths must be above 0 m")
    return Check(
        name=f"check {number + 1}",
        first=(row, column),
        second=(other_row, other_column),
        expected=expected,
        tolerance=tolerance,
    )
