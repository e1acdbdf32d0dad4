"""`amulor image`: from the target signal to a range image."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter


def image(
    cube: Path,
    /,
    *,
    output: Annotated[Path, Parameter(alias="-o")],
    polarization: str | None = None,
    nearest: str | None = None,
    farthest: str | None = None,
    tile_rows: int | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Turn a target signal into a range image.

    Parameters
    ----------
    cube
        Target signal (netCDF), from `amulor reject`.
    output
        File to write (netCDF).
    polarization
        Channel to take, such as VH; needed if there are several.
    nearest
        Nearest possible slant range, such as "0.5 m"; with --farthest.
    farthest
        Farthest possible slant range, such as "3 m"; with --nearest.
    tile_rows
        Work on so many rows at a time, in bounded memory; files of more than
        2.1 million samples are worked on by rows without being asked.
    overwrite
        Replace a file that is there.
    """
    from amulor.cli._arguments import check_cube_output, interval_of
    from amulor.cli._output import print_flags, print_next, progress_bar

    interval = interval_of(nearest, farthest)
    check_cube_output(output, overwrite=overwrite, inputs=[cube])

    from amulor import _progress, imaging, io
    from amulor.cube import flag_counts
    from amulor.io.netcdf import is_large

    if tile_rows is not None or is_large(cube):
        _by_rows(cube, output, tile_rows, polarization, interval, overwrite=overwrite)
        return
    with progress_bar() as advance:
        advance(f"reading {cube}", 0.0)
        target = io.read_cube(cube)
        with _progress.part(0.2, 0.6):
            result = imaging.range_image(
                target, polarization=polarization, interval=interval
            )
        advance("edges and outliers", 0.6)
        result = imaging.flag_outliers(imaging.flag_mixed(result))
        advance(f"writing {output}", 0.8)
        io.write_cube(result, output, overwrite=overwrite)
    usable = result["slant_range"].notnull()
    flags = result["quality_flag"]
    if not usable.any():
        print(
            f"{output}: range image without a usable pixel; see: amulor info {output}"
        )
        return
    from amulor.cube import error_unknown

    if "interval_unsettled" in result.attrs:
        print(_unsettled(output, result.attrs))
        return
    median = float(result["slant_range_uncertainty"].median())
    doubtful = float(((flags != 0) & usable).mean())
    print(
        f"{output}: range image, {float(usable.mean()):.1%} of the pixels usable "
        f"({doubtful:.1%} flagged), "
        + (error_unknown(result) or f"median uncertainty {median * 1e3:.2f} mm")
    )
    print_flags(flag_counts(result), flags.size)
    print_next(f"amulor view {output}")


def _unsettled(output: Path, attributes: Mapping[Any, Any]) -> str:
    from amulor.cube import WATER_NOT_REMOVED

    water = str(attributes.get("error_unknown", "")).startswith(WATER_NOT_REMOVED)
    return (
        f"{output}: ranges relative to an unknown number of intervals, all pixels "
        f"flagged: {attributes['interval_unsettled']}; state --nearest and --farthest, "
        "no farther apart than the phases repeat"
        + (f"; {WATER_NOT_REMOVED}" if water else "")
    )


def _by_rows(
    cube: Path,
    output: Path,
    rows: int | None,
    polarization: str | None,
    interval: tuple[float, float] | None,
    *,
    overwrite: bool,
) -> None:
    """Make the image tile by tile, and print what came out."""
    from amulor import scale
    from amulor.cli._arguments import UsageError
    from amulor.cli._output import print_flags, print_next, progress_bar

    if rows is not None and rows < 1:
        raise UsageError(f"--tile-rows must be 1 or more, got {rows}")
    with progress_bar():
        made = scale.image_file(
            cube, output, rows=rows, overwrite=overwrite,
            polarization=polarization, interval=interval,
        )  # fmt: skip
    if "interval_unsettled" in made.head.attrs:
        print(_unsettled(output, made.head.attrs))
        return
    words = str(made.head.attrs.get("error_unknown", ""))
    print(
        f"{output}: range image, {made.usable / made.count:.1%} of the pixels usable "
        f"({made.doubtful / made.count:.1%} flagged)" + (f", {words}" if words else "")
    )
    print_flags(made.flags, made.count)
    print_next(f"amulor view {output}")
